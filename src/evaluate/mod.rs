//! How good a policy is: trials from random starts, against the optimal number of steps, and what its features know.
//!
//! Two measuring rods know the true pose: the optimal number of steps, and the thesis's reference policy.
//!
//! Trials run in the scenario's world with robots of their own, so a live run does not notice. Starts are drawn from a
//! random stream of their own, never from states that were seen in training.

mod decode;
mod maps;
mod optimal;
mod reference;
mod results;
mod spans;
mod trials;

pub use decode::{PoseDecode, PoseError, decode_pose};
pub use maps::{FEATURES, Fineness, Grid, HEADINGS, Map, RoomMaps, angle, features_of};
pub use optimal::{Circle, OptimalSteps};
pub use reference::reference_action;
pub use results::{Arrival, Avoided, TaskResult, WithoutReflexes};
pub use spans::overlap;
pub use trials::{Evaluator, Situation, Trip};

use nalgebra::{Point2, Vector2};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::robot::Pose;
use crate::scenario::Plan;

/// A pose drawn uniformly from all places that the robot can reach, except those that `refuse` names.
///
/// A checked scenario leaves at least one cell of the plan outside of each goal, so the loop ends.
pub(crate) fn draw_pose(
    plan: &Plan,
    cells: &[Point2<f64>],
    rng: &mut ChaCha8Rng,
    refuse: impl Fn(Point2<f64>) -> bool,
) -> Pose {
    let half = 0.5 * Plan::CELL;
    loop {
        let offset = Vector2::new(rng.random_range(-half..=half), rng.random_range(-half..=half));
        let position = cells[rng.random_range(0..cells.len())] + offset;
        if plan.is_reachable(position) && !refuse(position) {
            return Pose::new(position, rng.random_range(0.0..std::f64::consts::TAU));
        }
    }
}

/// Lower end of the 95 % Wilson interval of a share.
pub fn wilson_low(successes: usize, trials: usize) -> f64 {
    const Z: f64 = 1.959_963_985;
    if trials == 0 {
        return 0.0;
    }
    let n = trials as f64;
    let p = successes as f64 / n;
    let centre = p + Z * Z / (2.0 * n);
    let spread = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    ((centre - spread) / (1.0 + Z * Z / n)).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_interval_has_its_known_values() {
        // Wilson 1927, as tabulated in many places: 8 of 10 gives 0.4902, 200 of 200 gives 0.9812.
        assert!((wilson_low(8, 10) - 0.4902).abs() < 1e-4);
        assert!((wilson_low(200, 200) - 0.9812).abs() < 1e-4);
        assert_eq!(wilson_low(0, 10), 0.0);
    }
}
