//! Kernel rows: a block of observations against all support vectors.

mod common;

use common::data::{BLOCK, D, frames};
use common::{Size, allowed, operations, standard};

use adagio::kernel::squared_norms;
use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    common::main();
}

/// Against the number of support vectors.
#[divan::bench(args = standard(), max_time = 2)]
fn of_m(bencher: Bencher, size: Size) {
    rows(bencher, size);
}

/// On two threads.
#[divan::bench(args = allowed([Size::of(4000).threads(2)]), max_time = 2)]
fn on_two_threads(bencher: Bencher, size: Size) {
    rows(bencher, size);
}

/// Against the length of an observation.
#[divan::bench(args = allowed([192, 768, 1536, 3072].map(|d| Size::of(1000).d(d))), max_time = 2)]
fn of_d(bencher: Bencher, size: Size) {
    rows(bencher, size);
}

/// Against the size of a block; 1 is a frame alone.
#[divan::bench(args = allowed([1, 16, 64, 256, 1024].map(|n| Size::of(1000).n(n))), max_time = 2)]
fn of_n(bencher: Bencher, size: Size) {
    rows(bencher, size);
}

fn rows(bencher: Bencher, size: Size) {
    let (d, n) = (size.d.unwrap_or(D), size.n.unwrap_or(BLOCK));
    let x = frames(d, size.m + n);
    let kernel = operations::kernel(&x);
    let (s, block) = (x.as_ref().subcols(0, size.m), x.as_ref().subcols(size.m, n));
    let norms = squared_norms(s);
    bencher
        .counter(ItemsCount::new(n))
        .bench_local(|| kernel.matrix(s, &norms, block, &squared_norms(block), size.par()).expect("shapes that fit"));
}
