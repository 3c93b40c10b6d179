//! Growth and moments together: what a stream does with its frames.
//!
//! With a full dictionary a sample is a whole chunk of frames, 512, or one block if that is more: frames go into the moments
//! by chunks, so that each sample has its share of them.

mod common;

use common::data::{BLOCK, D, blocks, frames};
use common::{Size, allowed, operations, standard};

use divan::Bencher;
use divan::counter::ItemsCount;

fn main() {
    common::main();
}

/// From nothing to `m` support vectors: each of `m` frames becomes one, and all of them are retained and filled in.
#[divan::bench(args = standard(), sample_size = 1, sample_count = 3, max_time = 10)]
fn from_nothing(bencher: Bencher, size: Size) {
    let x = frames(D, size.m);
    bencher.counter(ItemsCount::new(size.m)).bench_local(|| {
        let mut stream = operations::empty_stream(&x, size.m, size.m, size.par());
        operations::push(&mut stream, &x, 0..size.m);
        stream.settle().expect("frames that were accepted");
    });
}

/// One chunk more, in blocks, once the dictionary is full.
#[divan::bench(args = standard(), sample_size = 1, sample_count = 20, max_time = 3)]
fn full(bencher: Bencher, size: Size) {
    steady(bencher, size);
}

/// The same on two threads.
#[divan::bench(args = allowed([Size::of(4000).threads(2)]), sample_size = 1, sample_count = 20, max_time = 3)]
fn full_on_two_threads(bencher: Bencher, size: Size) {
    steady(bencher, size);
}

/// The same against the length of an observation.
#[divan::bench(args = allowed([192, 768, 1536, 3072].map(|d| Size::of(1000).d(d))), sample_size = 1, max_time = 3)]
fn full_of_d(bencher: Bencher, size: Size) {
    steady(bencher, size);
}

/// The same against the size of a block; 1 is frame by frame.
#[divan::bench(args = allowed([1, 16, 64, 256, 1024].map(|n| Size::of(1000).n(n))), sample_size = 1, max_time = 3)]
fn full_of_n(bencher: Bencher, size: Size) {
    steady(bencher, size);
}

fn steady(bencher: Bencher, size: Size) {
    let n = size.n.unwrap_or(BLOCK);
    let count = operations::chunk().max(n);
    assert_eq!((count % operations::chunk(), count % n), (0, 0), "a sample is whole chunks and whole blocks");
    let x = frames(size.d.unwrap_or(D), size.m + count);
    let mut stream = operations::full_stream(&x, size.m, 2 * count, size.par());
    bencher.counter(ItemsCount::new(count)).bench_local(|| {
        for block in blocks(&x, size.m..size.m + count, n) {
            operations::push_block(&mut stream, block);
        }
    });
}
