//! Boyan's chain: 13 states, 12 … 0, and a walk down by one or two states that costs 3 a step, and 2 from 1 to 0. From 0 the
//! episode ends, at no cost. The value is `V(s) = −2s`, and linear in 4 features, with weights −24, −16, −8, 0.
//!
//! The end belongs to the data: without the transition out of state 0 the equations of LSTD are singular, and their
//! smallest solution is −12, −4, 4, 12: the same differences, another level.
//!
//! # Reference
//! Boyan 1999, 2002 (figure 1).

use faer::Mat;

use crate::value::{FiniteMdp, Successor, ValueError};

/// Where episodes start.
pub const START: usize = 12;
/// The end: the one state that Boyan does not number.
pub const END: usize = 13;

/// The chain as a reward process (one action), states 0 … 12 and the end, γ = 1.
///
/// # Errors
/// None.
pub fn process() -> Result<FiniteMdp, ValueError> {
    let to = |state, probability, reward| Successor { state, probability, reward };
    FiniteMdp::new(14, 1, 1.0, |s, _| match s {
        END => vec![],
        0 => vec![to(END, 1.0, 0.0)],
        1 => vec![to(0, 1.0, -2.0)],
        _ => vec![to(s - 1, 0.5, -3.0), to(s - 2, 0.5, -3.0)],
    })
}

/// Hats around the states 12, 8, 4 and 0; the end has none. `4 × 14`.
pub fn basis() -> Mat<f64> {
    Mat::from_fn(4, 14, |i, s| {
        let from_peak = s as f64 - 4.0 * (3 - i) as f64;
        if s == END { 0.0 } else { (1.0 - from_peak.abs() / 4.0).max(0.0) }
    })
}

/// The known weights.
pub const WEIGHTS: [f64; 4] = [-24.0, -16.0, -8.0, 0.0];

/// The known weights where the transition to the end is left out.
pub const WEIGHTS_WITHOUT_END: [f64; 4] = [-12.0, -4.0, 4.0, 12.0];
