//! The thesis's two-room environment (§5.1.2, *other environments*): what both of its experiments share.
//!
//! As in the thesis, the training set is no walk, which would hardly ever cross the corridor, but pairs of frames: a random pose,
//! a random action, and where it leads.

mod floor;
pub mod lspi;
pub mod responses;

pub use floor::Single;

use faer::{Mat, Par};
use nalgebra::Point2;
use serde::Serialize;

use super::lab::{Data, Lab};
use super::pairs::Pairs;
use super::pipeline::{LAMBDA, NU};
use super::trained::seen;
use super::{Bench, ExperimentError};
use crate::scenario::Room;
use crate::slow::SlowModel;
use crate::slow::region::{Region, RegionResponses};

/// Transitions of the thesis's training set (§5.3, *two room training set*).
const TRANSITIONS: usize = 50_000;
/// Its support vectors (figure *egyptfeats*).
const VECTORS: usize = 6800;
/// Side of the cells on which optimal responses are computed, metres: seven of them across the robot's lane in the corridor.
const CELL: f64 = 0.1;

/// What slow features are made of.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Training {
    data: Data,
    vectors: usize,
    features: usize,
    nu: f64,
    lambda: f64,
    cell: f64,
}

impl Training {
    fn new(lab: &Lab, pairs: usize, vectors: usize, features: usize) -> Self {
        Training { data: Data::new(lab, pairs), vectors, features, nu: NU, lambda: LAMBDA, cell: CELL }
    }
}

/// Slow features of what the camera sees at some pairs: the frames, and the model.
fn train(
    lab: &Lab,
    pairs: &Pairs,
    training: &Training,
    bench: &Bench<'_>,
) -> Result<(Mat<f32>, SlowModel<f32>), ExperimentError> {
    let links = pairs.links(lab, lab.scenario.slow.move_weight);
    seen(lab, &pairs.poses, &links, (training.vectors, training.features), bench)
}

/// Mean squares of speed and turn of some pairs, m²/s² and rad²/s², with the scenario's weight of moves.
fn speeds(lab: &Lab, pairs: &Pairs) -> (f64, f64) {
    pairs.steps().speeds(lab.scenario.slow.move_weight, lab.scenario.robot.action_seconds)
}

/// The `k` slowest optimal responses of the floor plan, for the speeds of some pairs.
fn optimal_responses(lab: &Lab, pairs: &Pairs, k: usize) -> Result<RegionResponses, ExperimentError> {
    let (low, high) = lab.world.plan.reachable_box();
    let size = [0, 1].map(|axis| ((high[axis] - low[axis]) / CELL).round() as usize);
    let plan = &lab.world.plan;
    let region = Region::new([low.x, low.y], CELL, size, |[x, y]| plan.is_reachable(Point2::new(x, y)))?;
    let (speed, turn) = speeds(lab, pairs);
    Ok(RegionResponses::slowest(region, speed, turn, k, Par::Seq)?)
}

/// The room that a place is in: the first of the scenario that holds it.
fn room_of(lab: &Lab, place: Point2<f64>) -> Option<usize> {
    lab.scenario.world.rooms.iter().position(|room| room.contains(place))
}

/// The two rooms, and what joins them: the scenario has them in this order.
fn rooms(lab: &Lab) -> [&Room; 3] {
    std::array::from_fn(|room| &lab.scenario.world.rooms[room])
}
