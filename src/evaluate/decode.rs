//! What the features know of the pose: position and heading, decoded by ridge regression.
//!
//! The features are made for linear functions, so ridge regression is the measure; kernel ridge regression is its
//! non-linear check: what it decodes better is in the features, but not where a linear function finds it. The regularisers
//! are chosen by cross-validation on the poses that are learned from; the errors are those on other poses.

use faer::{Mat, MatRef, Par};
use nalgebra::Point2;
use serde::Serialize;

use super::draw_pose;
use crate::kernel::{Kernel, median_distance};
use crate::policy::{Learned, columns};
use crate::random::stream;
use crate::regression::{Bias, Folds, KernelGrid, RegressionError, Sums, ridge, select_kernel_ridge, select_ridge};
use crate::robot::{Pose, wrap};
use crate::scenario::Scenario;
use crate::vision::observe;
use crate::world::{Sensor, World};

/// Error of the pose that is read off the features, on poses that it was not learned from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseError {
    /// Root mean square distance, metres.
    pub position_rmse_m: f64,
    /// Root mean square angle, degrees.
    pub heading_rmse_deg: f64,
}

/// How well the pose can be read off the features.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseDecode {
    /// By ridge regression.
    #[serde(flatten)]
    pub linear: PoseError,
    /// By kernel ridge regression with a Gaussian kernel.
    pub kernel: PoseError,
}

/// Regularisers to choose from, per pose that is learned from: features have variance 1.
const LAMBDAS: [f64; 7] = [1e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2];
/// Kernel widths to choose from, times the median distance.
const WIDTHS: [f64; 3] = [0.5, 1.0, 2.0];
/// Support vectors of the kernel ridge regression at most.
const SUPPORT_VECTORS: usize = 500;
/// Parts into which the poses are divided to choose.
const FOLDS: usize = 4;

/// Learn `(x, y, cos θ, sin θ)` from the features of random poses, and test on others.
///
/// # Errors
/// Features that are not finite, or fewer than two poses to learn from.
pub fn decode_pose(
    scenario: &Scenario,
    world: &World,
    learned: &Learned,
    seed: u64,
) -> Result<PoseDecode, RegressionError> {
    let (train, test) = (scenario.evaluate.decode_train, scenario.evaluate.decode_test);
    let mut rng = stream(seed, "evaluate: poses to decode");
    let cells: Vec<Point2<f64>> = world.plan.reachable_cells().collect();
    let poses: Vec<Pose> = (0..train + test).map(|_| draw_pose(&world.plan, &cells, &mut rng, |_| false)).collect();
    let frame = learned.asked_at + 1;
    let mut numbered: Vec<(usize, Pose)> = poses.iter().copied().enumerate().collect();
    let place = |&(index, pose): &(usize, Pose)| (pose, (index * scenario.robot.frames_per_action) as u64);
    let seen = world.appearance.see_all(frame, &mut numbered, place, |&mut (index, _), image| {
        let noise = stream(seed, &format!("evaluate: camera of pose {index}"));
        Sensor::new(scenario, scenario.robot.frame_seconds(), noise).expose(image, world.appearance.light(frame));
        observe(image, &scenario.vision, index as u64)
    });
    // Without the constant feature: regression has its own.
    let phi = learned.features(columns(seen.iter()).as_ref(), Par::Seq);
    let phi = phi.as_ref().subrows(1, phi.nrows() - 1);
    let (known, others) = phi.split_at_col(train);
    let targets = Mat::from_fn(4, train, |i, j| {
        let pose = &poses[j];
        [pose.position.x, pose.position.y, pose.heading.cos(), pose.heading.sin()][i]
    });
    let folds = Folds::shuffled(train, FOLDS.min(train), seed)?;
    let lambdas = LAMBDAS.map(|lambda| lambda * train as f64);

    let lambda = select_ridge(known, targets.as_ref(), &lambdas, &folds, Bias::Free, Par::Seq)?.best().settings;
    let mut sums = Sums::new(known.nrows(), 4)?;
    sums.add(known, targets.as_ref(), Par::Seq)?;
    let linear = error_of(ridge(&sums, lambda, Bias::Free)?.predict(others)?.as_ref(), &poses[train..]);

    let median = median_distance(known)?;
    let kernels: Result<Vec<Kernel>, _> = WIDTHS.iter().map(|width| Kernel::gaussian(width * median)).collect();
    let grid = KernelGrid {
        kernels: kernels?,
        support_vectors: vec![SUPPORT_VECTORS],
        lambdas: lambdas.to_vec(),
        nu: 1e-6,
        bias: Bias::Free,
        seed,
    };
    let chosen = select_kernel_ridge(known, targets.as_ref(), &grid, &folds, Par::Seq)?.best().settings;
    let model = grid.fit(&chosen, known, targets.as_ref(), Par::Seq)?;
    let kernel = error_of(model.predict(others, Par::Seq)?.as_ref(), &poses[train..]);
    Ok(PoseDecode { linear, kernel })
}

/// Errors of decoded poses, `4 × n`.
fn error_of(found: MatRef<'_, f64>, poses: &[Pose]) -> PoseError {
    let (mut distance, mut angle) = (0.0, 0.0);
    for (j, pose) in poses.iter().enumerate() {
        distance += (found[(0, j)] - pose.position.x).powi(2) + (found[(1, j)] - pose.position.y).powi(2);
        angle += wrap(found[(3, j)].atan2(found[(2, j)]) - pose.heading).to_degrees().powi(2);
    }
    let n = poses.len() as f64;
    PoseError { position_rmse_m: (distance / n).sqrt(), heading_rmse_deg: (angle / n).sqrt() }
}
