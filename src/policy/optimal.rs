//! The optimal number of steps to a goal, by breadth-first search over noise-free moves.

use std::collections::HashSet;

use nalgebra::Point2;

use crate::scenario::{Robot, Task};
use crate::world::{Action, Arena, FrameMotion, Pose, drive, in_goal};

/// Poses that agree within this distance (metres) and angle (degrees) count as one.
const SAME_PLACE: f64 = 0.02;
const SAME_HEADING: f64 = 2.0;

/// The least number of noise-free actions from a pose into a task's goal area, or `None` beyond `most`.
///
/// The lattice of poses is laid out from the start pose itself, so the first steps are exact; only poses that are reached
/// again within 2 cm and 2° are dropped.
pub fn optimal_steps(arena: &Arena, robot: &Robot, task: &Task, start: Pose, most: usize) -> Option<usize> {
    if in_goal(task, start.position) {
        return Some(0);
    }
    let turn = robot.turn_deg.to_radians();
    let motions = Action::ALL.map(|action| match action {
        Action::Forward => FrameMotion { length: robot.forward, angle: 0.0 },
        Action::TurnLeft => FrameMotion { length: 0.0, angle: turn },
        Action::TurnRight => FrameMotion { length: 0.0, angle: -turn },
    });
    let key = |pose: &Pose| {
        let place = |value: f64, origin: f64| ((value - origin) / SAME_PLACE).round() as i32;
        let degrees = (pose.heading - start.heading).to_degrees().rem_euclid(360.0);
        let headings = (360.0 / SAME_HEADING) as i32;
        let Point2 { coords } = pose.position;
        (
            place(coords.x, start.position.x),
            place(coords.y, start.position.y),
            (degrees / SAME_HEADING).round() as i32 % headings,
        )
    };
    let mut seen = HashSet::from([key(&start)]);
    let mut frontier = vec![start];
    for steps in 1..=most {
        let mut next = Vec::new();
        for pose in &frontier {
            for motion in motions {
                let (moved, _) = drive(*pose, motion, arena, robot.radius);
                if in_goal(task, moved.position) {
                    return Some(steps);
                }
                if seen.insert(key(&moved)) {
                    next.push(moved);
                }
            }
        }
        if next.is_empty() {
            return None;
        }
        frontier = next;
    }
    None
}
