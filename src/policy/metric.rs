//! How near states are to each other: slow features as coordinates.
//!
//! Features have variance 1 and slowness `Δ`, so divided by `√Δ` they are coordinates in which the squared distance of two states
//! goes with the time that the robot takes, at random, from one to the other and back: slow features span what takes long.
//!
//! # Reference
//! The commute time of a random walk, Fouss et al. 2007; of slow features, Richthofer & Wiskott 2018.

use faer::{Mat, MatRef};

use crate::slow::SlowModel;

/// Features whose slowness is a smaller share of the mean count as that slow: rounding would make coordinates of any size.
const LEAST_SLOWNESS: f64 = 1e-3;

/// Factors of the `p` slowest features, or of as many as there are, the constant one left out.
fn factors(model: &SlowModel<f32>, p: usize) -> Vec<f64> {
    let slowness = &model.slowness[..p.min(model.slowness.len())];
    let mean = slowness.iter().sum::<f64>() / slowness.len().max(1) as f64;
    slowness.iter().map(|&slowness| (1.0 / (slowness / mean).max(LEAST_SLOWNESS)).sqrt()).collect()
}

/// Points of features `phi`, `f × n`: `p × n`.
pub fn points(model: &SlowModel<f32>, phi: MatRef<'_, f64>, p: usize) -> Mat<f32> {
    let factors = factors(model, p);
    Mat::from_fn(factors.len(), phi.ncols(), |i, j| (factors[i] * phi[(i + 1, j)]) as f32)
}

/// The same points as linear functions of the features: weights `f × p`.
pub fn weights(model: &SlowModel<f32>, p: usize) -> Mat<f64> {
    let factors = factors(model, p);
    Mat::from_fn(model.features(), factors.len(), |i, j| if i == j + 1 { factors[j] } else { 0.0 })
}
