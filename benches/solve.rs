//! From moments to slow features.
//!
//! The moments are those of `1.25 m` frames over a dictionary of `m`. The number of threads stands in the names where it is
//! not one.

mod common;

use common::data::{D, frames};
use common::operations::DENSE_MOST;
use common::{Size, allowed, operations, standard};

use adagio::slow::Moments;
use divan::Bencher;
use faer::Par;

fn main() {
    common::main();
}

/// Features that are asked for.
const K: usize = 128;

/// Sizes up to `most`, each with all of these numbers of threads.
fn up_to(most: usize, threads: &[usize]) -> Vec<Size> {
    let sizes = standard().into_iter().filter(|size| size.m <= most);
    sizes.flat_map(|size| threads.iter().map(move |&threads| size.k(K).threads(threads))).collect()
}

/// The solver of the running agent, without an earlier solution.
#[divan::bench(args = up_to(usize::MAX, &[1, 2]), sample_size = 1, sample_count = 5, max_time = 10)]
fn cold(bencher: Bencher, size: Size) {
    solve_cold(bencher, size);
}

/// The same at the thesis's full size.
#[divan::bench(args = allowed([1, 2].map(|threads| Size::of(8000).k(500).threads(threads))), sample_size = 1, sample_count = 1)]
fn cold_full_size(bencher: Bencher, size: Size) {
    solve_cold(bencher, size);
}

/// Against the number of features.
#[divan::bench(args = allowed([32, 128, 200, 500].map(|k| Size::of(2000).k(k).threads(2))), sample_size = 1, sample_count = 5, max_time = 10)]
fn cold_of_k(bencher: Bencher, size: Size) {
    solve_cold(bencher, size);
}

fn solve_cold(bencher: Bencher, size: Size) {
    let (moments, k) = (moments(size.m), size.k.unwrap_or(K));
    bencher.bench_local(|| operations::resolve(&moments, k, None, size.par()));
}

/// As the running agent does it: aligned with an earlier solution, here that for the first four fifths of the frames.
#[divan::bench(args = up_to(usize::MAX, &[2]), sample_size = 1, sample_count = 5, max_time = 10)]
fn warm(bencher: Bencher, size: Size) {
    let (x, k) = (frames(D, size.m + size.m / 4), size.k.unwrap_or(K));
    let dictionary = operations::dictionary(&x, size.m, Par::rayon(2));
    let first = x.as_ref().subcols(0, size.m).to_owned();
    let previous =
        operations::resolve(&operations::moments(&dictionary, &first, Par::rayon(2)), k, None, Par::rayon(2));
    let moments = operations::moments(&dictionary, &x, Par::rayon(2));
    bencher.bench_local(|| operations::resolve(&moments, k, Some(&previous), size.par()));
}

/// The dense reference solver.
#[divan::bench(args = up_to(DENSE_MOST, &[2]), sample_size = 1, sample_count = 3, max_time = 10)]
fn dense(bencher: Bencher, size: Size) {
    let (moments, k) = (moments(size.m), size.k.unwrap_or(K));
    bencher.bench_local(|| operations::resolve_dense(&moments, k, size.par()));
}

fn moments(m: usize) -> Moments {
    let x = frames(D, m + m / 4);
    let dictionary = operations::dictionary(&x, m, Par::rayon(2));
    operations::moments(&dictionary, &x, Par::rayon(2))
}
