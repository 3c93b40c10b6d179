//! Pairs of frames in place of a walk, as the thesis has for its two rooms (§5.1.3): a random pose, a random action, and where it
//! leads.

use nalgebra::Point2;
use rand::RngExt;

use super::lab::{Lab, Steps, Transition};
use crate::evaluate::draw_pose;
use crate::policy::Recent;
use crate::random::stream;
use crate::robot::{Action, Pose};
use crate::slow::Link;
use crate::world::Robot;

/// Random poses, and where a random action leads from each: frames 0 and 1, 2 and 3, and so on.
pub struct Pairs {
    /// Both of each pair, one after the other.
    pub poses: Vec<Pose>,
    /// What led from the first to the second.
    pub transitions: Vec<Transition>,
}

impl Pairs {
    /// `count` pairs, drawn evenly over all places that the robot can reach, all headings and all actions.
    pub fn draw(lab: &Lab, count: usize) -> Self {
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

    /// [Links](Lab::link) of the frames: the second of each pair to the first.
    pub fn links(&self, lab: &Lab, move_weight: f64) -> Vec<Option<Link>> {
        self.transitions.iter().flat_map(|t| [None, lab.link(t.action, move_weight)]).collect()
    }

    /// How far the actions led.
    pub fn steps(&self) -> Steps {
        Steps::of(self.transitions.iter().map(|t| (&self.poses[t.from], &self.poses[t.to], t.action)))
    }
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
            let room = &lab.scenario.world.rooms[room];
            let inside = pairs.poses.iter().step_by(2).filter(|pose| room.contains(pose.position));
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
