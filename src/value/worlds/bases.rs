//! Features of numbered states: one column for each state. The actions' blocks need no features of their own
//! (thesis §3.2.2). One feature for each state ([`Tabular`](crate::value::Tabular)) is the identity,
//! `Mat::identity(states, states)`.

use faer::Mat;

use crate::value::ValueError;
use crate::value::error::{parameter, size};

/// Powers 0 to `degree` of the place in the row, `s/(S − 1)` in [0, 1]: the polynomial basis of Lagoudakis & Parr 2003,
/// which they take in `s`, in units that are better conditioned. Values and policies are the same.
///
/// # Shapes
/// `(degree + 1) × S`.
///
/// # Errors
/// Too many states and powers.
pub fn powers(states: usize, degree: u32) -> Result<Mat<f64>, ValueError> {
    let rows = (degree as usize).saturating_add(1);
    size("the basis", rows, states)?;
    let place = |s: usize| s as f64 / states.saturating_sub(1).max(1) as f64;
    let mut powers = Mat::from_fn(rows, states, |_, _| 1.0);
    for s in 0..states {
        for i in 1..rows {
            powers[(i, s)] = powers[(i - 1, s)] * place(s);
        }
    }
    Ok(powers)
}

/// A constant and `centres` Gaussian bumps, evenly spread over the row, each as wide as their distance.
///
/// # Shapes
/// `(centres + 1) × S`.
///
/// # Errors
/// Fewer than two centres, too many states and centres.
pub fn bumps(states: usize, centres: usize) -> Result<Mat<f64>, ValueError> {
    parameter("centres", centres as f64, centres >= 2, "≥ 2")?;
    size("the basis", centres.saturating_add(1), states)?;
    let distance = states.saturating_sub(1).max(1) as f64 / (centres - 1) as f64;
    let bump = |i: usize, s: usize| (-0.5 * (s as f64 / distance - (i - 1) as f64).powi(2)).exp();
    Ok(Mat::from_fn(centres + 1, states, |i, s| if i == 0 { 1.0 } else { bump(i, s) }))
}
