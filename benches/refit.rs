//! Policy iteration over the window of transitions, and what a new model costs before it.

mod common;

use common::data::{D, frames};
use common::operations::Transitions;
use common::{Size, allowed, operations, standard};

use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    common::main();
}

/// Policy iteration against the number of transitions. It does not depend on `m`.
#[divan::bench(args = [5000, 20_000, 50_000].map(|n| Size::of(0).n(n).k(128)), sample_size = 1, sample_count = 5, max_time = 10)]
fn fit_of_n(bencher: Bencher, size: Size) {
    fit(bencher, size);
}

/// Policy iteration against the number of features.
#[divan::bench(args = [32, 128, 500].map(|k| Size::of(0).n(20_000).k(k)), sample_size = 1, sample_count = 5, max_time = 10)]
fn fit_of_k(bencher: Bencher, size: Size) {
    fit(bencher, size);
}

fn fit(bencher: Bencher, size: Size) {
    let n = size.n.unwrap_or(20_000);
    let transitions = Transitions::of_walk(n, size.k.unwrap_or(128));
    bencher.counter(ItemsCount::new(n)).bench_local(|| transitions.refit(size.par()));
}

/// The features of a window under a new model, from its observations.
#[divan::bench(args = allowed(standard().into_iter().map(|size| size.n(4096).k(128))), sample_size = 1, sample_count = 5, max_time = 5)]
fn project(bencher: Bencher, size: Size) {
    let n = size.n.unwrap_or(4096);
    let x = frames(D, size.m.max(n));
    let model = operations::random_model(&x, size.m, size.k.unwrap_or(128));
    let window = x.as_ref().subcols(0, n);
    bencher.counter(ItemsCount::new(n)).bench_local(|| operations::features(&model, window, size.par()));
}
