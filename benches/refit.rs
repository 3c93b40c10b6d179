//! Policy iteration over the window of transitions, and all that a new model costs.

mod common;

use common::data::{D, frames};
use common::operations::Transitions;
use common::relearning::Relearning;
use common::{Size, allowed, cores, max_m, operations, standard};

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

/// Local values of ten tasks, as an agent has them that explores for two, against the number of transitions, in 40 coordinates.
#[divan::bench(args = allowed([5000, 20_000, 50_000].map(|n| Size::of(0).n(n).k(40))), sample_size = 1, sample_count = 5, max_time = 10)]
fn local_of_n(bencher: Bencher, size: Size) {
    let n = size.n.unwrap_or(20_000);
    let transitions = Transitions::of_walk(n, size.k.unwrap_or(40));
    bencher.counter(ItemsCount::new(n)).bench_local(|| transitions.refit_locally(10));
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

/// The agent's new model, all cores: a window of 20 000 transitions, two tasks.
fn new_model() -> Vec<Size> {
    let size = |m: usize, k: usize| Size::of(m).n(20_000).k(k).threads(cores());
    if max_m() < 2000 { vec![Size { n: Some(2000), ..size(500, 50) }] } else { vec![size(2000, 200)] }
}

fn relearning(size: Size) -> Relearning {
    Relearning::new(size.m, size.n.unwrap_or(20_000), size.k.unwrap_or(200))
}

/// From moments to policies, where a tenth of the window and a twentieth of the support vectors is new: re-solve, project the window,
/// policy iteration for both tasks.
#[divan::bench(args = new_model(), sample_size = 1, sample_count = 5, max_time = 60)]
fn new_model_whole(bencher: Bencher, size: Size) {
    let relearning = relearning(size);
    bencher.with_inputs(|| relearning.kept()).bench_local_values(|kept| relearning.whole(kept));
}

/// Its first part: the solver, aligned with an earlier solution.
#[divan::bench(args = new_model(), sample_size = 1, sample_count = 5, max_time = 60)]
fn new_model_solve(bencher: Bencher, size: Size) {
    let relearning = relearning(size);
    bencher.bench_local(|| relearning.solve());
}

/// Its second part: the window's features.
#[divan::bench(args = new_model(), sample_size = 1, sample_count = 5, max_time = 60)]
fn new_model_project(bencher: Bencher, size: Size) {
    let relearning = relearning(size);
    let model = relearning.solve();
    bencher.with_inputs(|| relearning.kept()).bench_local_values(|kept| relearning.project(&model, kept));
}

/// Its third part: policy iteration for both tasks at once.
#[divan::bench(args = new_model(), sample_size = 1, sample_count = 5, max_time = 60)]
fn new_model_fit(bencher: Bencher, size: Size) {
    let relearning = relearning(size);
    let projected = relearning.project(&relearning.solve(), relearning.kept());
    bencher.bench_local(|| relearning.fit(&projected));
}
