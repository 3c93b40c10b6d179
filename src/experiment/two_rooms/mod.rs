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
use rand::RngExt;
use serde::Serialize;

use super::lab::{Data, Lab, Transition};
use super::pipeline::{LAMBDA, NU};
use super::trained::seen;
use super::{Bench, ExperimentError};
use crate::evaluate::draw_pose;
use crate::policy::Recent;
use crate::random::stream;
use crate::robot::{Action, Pose, wrap};
use crate::scenario::Room;
use crate::slow::region::{Region, RegionResponses};
use crate::slow::{Link, SlowModel};
use crate::world::Robot;

/// Transitions of the thesis's training set (§5.3, *two room training set*).
const TRANSITIONS: usize = 50_000;
/// Its support vectors (figure *egyptfeats*).
const VECTORS: usize = 6800;
/// Side of the cells on which optimal responses are computed, metres: seven of them across the robot's lane in the corridor.
const CELL: f64 = 0.1;

/// Random poses, and where a random action leads from each: frames 0 and 1, 2 and 3, and so on.
struct Pairs {
    poses: Vec<Pose>,
    transitions: Vec<Transition>,
}

impl Pairs {
    /// `count` pairs, drawn evenly over all places that the robot can reach, all headings and all actions.
    fn draw(lab: &Lab, count: usize) -> Self {
        let (scenario, world) = (&lab.scenario, &lab.world);
        let mut random = stream(scenario.seed, "pairs");
        let start = Pose::new(Point2::from(scenario.robot.start), 0.0);
        let mut robot = Robot::new(&scenario.robot, start, stream(scenario.seed, "motion"));
        let cells: Vec<Point2<f64>> = world.plan.reachable_cells().collect();
        let mut pairs = Pairs { poses: Vec::new(), transitions: Vec::new() };
        for _ in 0..count {
            let action = Action::DRIVE[random.random_range(0..Action::DRIVE.len())];
            robot.pose = draw_pose(&world.plan, &cells, &mut random, |_| false);
            pairs.poses.push(robot.pose);
            let motion = robot.draw(action);
            let blocked = robot.drive(motion, &world.arena);
            pairs.poses.push(robot.pose);
            let to = pairs.poses.len() - 1;
            let recent = Recent::default().then(action, blocked, &scenario.robot.actions);
            pairs.transitions.push(Transition { from: to - 1, to, action, blocked, recent });
        }
        pairs
    }

    /// Rewards of a task.
    fn rewards(&self, lab: &Lab, task: usize) -> Vec<f64> {
        let reward = |t: &Transition| lab.world.plan.reward(lab.task(task), self.poses[t.to].position);
        self.transitions.iter().map(reward).collect()
    }

    /// What joins the frames: the second of each pair to the first.
    fn links(&self, lab: &Lab) -> Vec<Option<Link>> {
        let weight = |t: &Transition| if t.action == Action::FORWARD { lab.scenario.slow.move_weight } else { 1.0 };
        let dt = lab.scenario.robot.action_seconds;
        self.transitions.iter().flat_map(|t| [None, Some(Link { dt, weight: weight(t) })]).collect()
    }

    /// Weighted mean squares of speed and turn, m²/s² and rad²/s²: what slowness in theory depends on.
    fn speeds(&self, lab: &Lab) -> (f64, f64) {
        let (mut way, mut turned, mut weights) = (0.0, 0.0, 0.0);
        for (t, link) in self.transitions.iter().zip(self.links(lab).chunks(2)) {
            let weight = link[1].map_or(0.0, |link| link.weight);
            let (from, to) = (&self.poses[t.from], &self.poses[t.to]);
            way += weight * (to.position - from.position).norm_squared();
            turned += weight * wrap(to.heading - from.heading).powi(2);
            weights += weight;
        }
        let seconds = lab.scenario.robot.action_seconds;
        (way / weights / seconds.powi(2), turned / weights / seconds.powi(2))
    }
}

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
    seen(lab, &pairs.poses, &pairs.links(lab), (training.vectors, training.features), bench)
}

/// The `k` slowest optimal responses of the floor plan, for the speeds of some pairs.
fn optimal_responses(lab: &Lab, pairs: &Pairs, k: usize) -> Result<RegionResponses, ExperimentError> {
    let (low, high) = lab.world.plan.reachable_box();
    let size = [0, 1].map(|axis| ((high[axis] - low[axis]) / CELL).round() as usize);
    let plan = &lab.world.plan;
    let region = Region::new([low.x, low.y], CELL, size, |[x, y]| plan.is_reachable(Point2::new(x, y)))?;
    let (speed, turn) = pairs.speeds(lab);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pairs_cover_all_rooms_and_actions_evenly() {
        let lab = Lab::two_rooms(12, &[]).unwrap();
        let pairs = Pairs::draw(&lab, 6000);
        assert_eq!((pairs.poses.len(), pairs.transitions.len()), (12_000, 6000));
        for action in Action::DRIVE {
            let count = pairs.transitions.iter().filter(|t| t.action == action).count();
            assert!((1850..2150).contains(&count), "{action:?}: {count}");
        }
        // The robot's centre has 5 m × 5 m in each room, and 4 m × 0.7 m between them.
        let share = |room: usize| {
            let inside = pairs.poses.iter().step_by(2).filter(|pose| room_of(&lab, pose.position) == Some(room));
            inside.count() as f64 / 6000.0
        };
        let expected = [25.0, 25.0, 2.1].map(|area| area / 52.8);
        for (room, expected) in expected.into_iter().enumerate() {
            assert!((share(room) - expected).abs() < 0.03, "room {room}: {}", share(room));
        }
        for t in &pairs.transitions {
            let way = (pairs.poses[t.to].position - pairs.poses[t.from].position).norm();
            assert!(if t.action == Action::FORWARD { t.blocked || way > 0.2 } else { way == 0.0 });
        }
    }
}
