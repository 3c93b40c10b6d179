//! What the features know of the pose: linear decoding of position and heading.

use faer::linalg::solvers::Solve;
use faer::{Mat, Par, Side};
use nalgebra::Point2;
use rayon::prelude::*;
use serde::Serialize;

use super::draw_pose;
use crate::policy::{Learned, columns};
use crate::random::stream;
use crate::scenario::Scenario;
use crate::vision::observe;
use crate::world::{Pose, Sensor, World, wrap};

/// Error of the pose that is read off the features by ridge regression, on poses that it was not fitted on.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PoseDecode {
    /// Root mean square distance, metres.
    pub position_rmse_m: f64,
    /// Root mean square angle, degrees.
    pub heading_rmse_deg: f64,
}

/// Ridge on the mean of `φφᵀ`, whose diagonal is about 1.
const RIDGE: f64 = 1e-6;

/// Fit `(x, y, cos θ, sin θ)` on the features of random poses, and test on others.
pub fn decode_pose(scenario: &Scenario, world: &World, learned: &Learned, seed: u64) -> PoseDecode {
    let (train, test) = (scenario.evaluate.decode_train, scenario.evaluate.decode_test);
    let mut rng = stream(seed, "evaluate: poses to decode");
    let cells: Vec<Point2<f64>> = world.plan.reachable_cells().collect();
    let poses: Vec<Pose> = (0..train + test).map(|_| draw_pose(&world.plan, &cells, &mut rng, |_| false)).collect();
    let seen: Vec<_> = poses
        .par_iter()
        .enumerate()
        .map(|(index, pose)| {
            let noise = stream(seed, &format!("evaluate: camera of pose {index}"));
            let mut image = world.camera.render(pose);
            Sensor::new(&scenario.camera, scenario.robot.frame_seconds(), noise).expose(&mut image);
            observe(&image, &scenario.vision, index as u64)
        })
        .collect();
    let phi = learned.features(columns(seen.iter()).as_ref(), Par::Seq);
    let f = phi.nrows();
    let known = phi.as_ref().subcols(0, train);
    let targets = Mat::from_fn(4, train, |i, j| {
        let pose = &poses[j];
        [pose.position.x, pose.position.y, pose.heading.cos(), pose.heading.sin()][i]
    });
    let mut gram = known * known.transpose();
    for i in 0..f {
        gram[(i, i)] += RIDGE * train as f64;
    }
    let right = known * targets.transpose();
    let Ok(cholesky) = gram.llt(Side::Lower) else {
        return PoseDecode { position_rmse_m: f64::NAN, heading_rmse_deg: f64::NAN };
    };
    let weights = cholesky.solve(&right);
    let found = weights.transpose() * phi.as_ref().subcols(train, test);
    let (mut distance, mut angle) = (0.0, 0.0);
    for (j, pose) in poses[train..].iter().enumerate() {
        distance += (found[(0, j)] - pose.position.x).powi(2) + (found[(1, j)] - pose.position.y).powi(2);
        angle += wrap(found[(3, j)].atan2(found[(2, j)]) - pose.heading).to_degrees().powi(2);
    }
    PoseDecode { position_rmse_m: (distance / test as f64).sqrt(), heading_rmse_deg: (angle / test as f64).sqrt() }
}
