//! Random walks on `S` places in a row: one step left or right, with probability ½ each.
//!
//! Between *reflecting* walls (a step into a wall stays) the eigenvectors of the transition matrix are the cosines
//! `√2 cos(jπ(s + ½)/S)` with eigenvalues `cos(jπ/S)`; in a *circle* they are `√2 cos` and `√2 sin` of `2πjs/S` with
//! `cos(2πj/S)`. They are the optimal responses of slow feature analysis on these walks (thesis §4.1.2). A reward that
//! is such an eigenvector, paid at the state entered, has the value `μ/(1 − γμ)` times itself.

use std::f64::consts::{PI, SQRT_2, TAU};

use faer::Mat;

use crate::value::error::size;
use crate::value::{FiniteMdp, ValueError};

/// The walk between walls, as a reward process with `R(s′)` = `rewards[s′]`.
///
/// # Errors
/// No places, a reward that is not finite, γ outside [0, 1].
pub fn reflecting(rewards: &[f64], gamma: f64) -> Result<FiniteMdp, ValueError> {
    let states = rewards.len();
    let ends = |s: usize| [s.saturating_sub(1), (s + 1).min(states - 1)];
    FiniteMdp::with_target_rewards(states, 1, gamma, rewards, |s, _| ends(s).map(|to| (to, 0.5)).to_vec())
}

/// The walk in a circle.
///
/// # Errors
/// As [`reflecting`].
pub fn cyclic(rewards: &[f64], gamma: f64) -> Result<FiniteMdp, ValueError> {
    let states = rewards.len();
    let ends = |s: usize| [(s + states - 1) % states, (s + 1) % states];
    FiniteMdp::with_target_rewards(states, 1, gamma, rewards, |s, _| ends(s).map(|to| (to, 0.5)).to_vec())
}

/// The first `count` eigenvectors of the walk between walls, the constant first (which is 1).
///
/// # Shapes
/// `count × S`.
///
/// # Errors
/// Too many states and vectors.
pub fn cosines(states: usize, count: usize) -> Result<Mat<f64>, ValueError> {
    size("the eigenvectors", count, states)?;
    Ok(Mat::from_fn(count, states, |j, s| {
        if j == 0 { 1.0 } else { SQRT_2 * (j as f64 * PI * (s as f64 + 0.5) / states as f64).cos() }
    }))
}

/// Eigenvalue `j` of the walk between walls on `states` ≥ 1 places.
pub fn reflecting_eigenvalue(states: usize, j: usize) -> f64 {
    (j as f64 * PI / states as f64).cos()
}

/// Eigenvalue of frequency `j` of the walk in a circle of `states` ≥ 1 places.
pub fn cyclic_eigenvalue(states: usize, j: usize) -> f64 {
    (j as f64 * TAU / states as f64).cos()
}
