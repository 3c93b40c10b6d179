//! What several tests share.
#![allow(dead_code)] // each test binary uses its own part of it

use faer::{Mat, MatRef, Par};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use adagio::dictionary::Parameters;
use adagio::kernel::Kernel;

pub fn generator(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A smooth random path of `n` points in `[0, 1]^d`, one a column: what a camera stream looks like to a dictionary.
pub fn random_path(d: usize, n: usize, seed: u64) -> Mat<f64> {
    let mut rng = generator(seed);
    let mut point = vec![0.5f64; d];
    let mut path = Mat::zeros(d, n);
    for j in 0..n {
        for (i, value) in point.iter_mut().enumerate() {
            *value = (*value + rng.random_range(-0.08..0.08)).clamp(0.0, 1.0);
            path[(i, j)] = *value;
        }
    }
    path
}

pub fn parameters(sigma: f64, nu: f64, budget: usize) -> Parameters {
    Parameters { kernel: Kernel::gaussian(sigma).unwrap(), nu, budget, par: Par::Seq }
}

/// Largest difference of two matrices, as a share of the largest entry of the second.
pub fn relative_difference(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
    assert_eq!((a.nrows(), a.ncols()), (b.nrows(), b.ncols()));
    (a - b).norm_max() / b.norm_max()
}
