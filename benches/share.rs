//! Growth and moments as a share of the machine's own matrix-product rate.
//!
//! Counted are the operations of the dense form (see `Useful::growth_and_moments`). With a full dictionary no algorithm over
//! the same coordinates avoids them. *From nothing* they are a convention: there every frame is a member, the kernel matrix is
//! symmetric and the coordinates are triangular, so that a batch algorithm which knew that beforehand would need fewer.
//!
//! These operations take so many seconds at the rate of faer's matrix product in their precision; the share is these seconds
//! divided by those that were needed. Rates are measured before and after each measurement, and their mean counts, so that
//! a neighbour on the machine slows down both.
//!
//! `--m M`: that number of support vectors alone.

mod common;

use std::time::Instant;

use common::data::{BLOCK, D, frames};
use common::machine::{Rates, Spread, Useful};
use common::{Size, argument, operations, standard};

use faer::Mat;

fn main() {
    adagio::random::fix_parallelism();
    common::machine::header();
    println!("growth and moments, d = {D}, blocks of {BLOCK}; median (least to most); operations of the dense form");
    println!("{:>40} {:>8} {:>10} {:>10}   share of the rate", "", "runs", "s", "frames/s");
    let sizes = argument("--m").map_or_else(standard, |m| vec![Size::of(m)]);
    for size in sizes {
        for threads in [1, 2] {
            of_size(size.threads(threads));
        }
    }
}

/// Chunks of one measurement with a full dictionary, up to about a second's worth. Whole ones: each measurement then has
/// the moments of as many frames as it took.
fn chunks_at(m: usize) -> usize {
    (8_000_000 / (m * m)).clamp(1, 8)
}

/// Measurements with a full dictionary.
const RUNS: usize = 7;

fn of_size(size: Size) {
    let count = operations::chunk() * chunks_at(size.m);
    let x = frames(D, size.m + count);
    let runs = if size.m <= 1000 { 5 } else { 1 };
    let mut stream = None;
    let mut shares = Shares::new(size.m);
    for _ in 0..runs {
        // The stream before it goes first: two of them would take twice the memory.
        drop(stream.take());
        stream = Some(shares.measure(size, || grown(&x, size)));
    }
    shares.print(&format!("from nothing to {size}"));

    let mut stream = stream.expect("at least one run");
    operations::finish_growing(&mut stream, &x, size.m);
    let mut shares = Shares::new(count);
    for _ in 0..RUNS {
        shares.measure(size, || operations::push(&mut stream, &x, size.m..size.m + count));
    }
    shares.print(&format!("full, {size}"));
}

fn grown(x: &Mat<f32>, size: Size) -> adagio::slow::SlowStream<f32> {
    let mut stream = operations::empty_stream(x, size.m, size.m, size.par());
    operations::push(&mut stream, x, 0..size.m);
    stream.settle().expect("frames that were accepted");
    stream
}

/// Measurements of the same work.
struct Shares {
    frames: usize,
    seconds: Vec<f64>,
    shares: Vec<f64>,
}

impl Shares {
    fn new(frames: usize) -> Self {
        Shares { frames, seconds: Vec::new(), shares: Vec::new() }
    }

    fn measure<R>(&mut self, size: Size, work: impl FnOnce() -> R) -> R {
        let useful = Useful::growth_and_moments(D, size.m, self.frames);
        let before = Rates::now(size.par()).seconds(useful);
        let begin = Instant::now();
        let result = work();
        let seconds = begin.elapsed().as_secs_f64();
        let after = Rates::now(size.par()).seconds(useful);
        self.seconds.push(seconds);
        self.shares.push(0.5 * (before + after) / seconds);
        result
    }

    fn print(&self, what: &str) {
        let (seconds, share) = (Spread::of(&self.seconds), Spread::of(&self.shares));
        println!(
            "{what:>40} {:>8} {:>10.3} {:>10.0}   {:.0} % ({:.0} to {:.0})",
            self.seconds.len(),
            seconds.median,
            self.frames as f64 / seconds.median,
            100.0 * share.median,
            100.0 * share.least,
            100.0 * share.most
        );
    }
}
