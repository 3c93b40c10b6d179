//! Moments of a block of coordinates: two symmetric updates.

mod common;

use common::data::BLOCK;
use common::{Size, allowed, operations, standard};

use adagio::slow::Moments;
use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    common::main();
}

/// Against the number of coordinates.
#[divan::bench(args = standard(), sample_size = 1, sample_count = 20, max_time = 3)]
fn of_m(bencher: Bencher, size: Size) {
    add(bencher, size);
}

/// On two threads.
#[divan::bench(args = allowed([Size::of(4000).threads(2)]), sample_size = 1, sample_count = 20, max_time = 3)]
fn on_two_threads(bencher: Bencher, size: Size) {
    add(bencher, size);
}

/// Against the size of a block.
#[divan::bench(args = allowed([1, 16, 64, 256, 1024].map(|n| Size::of(1000).n(n))), sample_size = 1, max_time = 3)]
fn of_n(bencher: Bencher, size: Size) {
    add(bencher, size);
}

fn add(bencher: Bencher, size: Size) {
    let n = size.n.unwrap_or(BLOCK);
    let v = operations::random(size.m, n + 1);
    let (before, block) = v.as_ref().split_at_col(1);
    let links = operations::links(n);
    let mut moments = Moments::new(size.par());
    moments.widen(size.m).expect("not too many coordinates");
    bencher
        .counter(ItemsCount::new(n))
        .bench_local(|| operations::add_series(&mut moments, block, &links, Some(before)));
}
