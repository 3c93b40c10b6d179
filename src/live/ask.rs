//! What people may ask of a run, whichever way they ask.

use nalgebra::Point2;

use crate::scenario::{Plan, Scenario};
use crate::source::GoalMove;

/// A goal of a task that is given by coordinates, at another place.
///
/// # Errors
/// A text for people: the robot cannot be there, or the goal is no place that coordinates tell.
pub fn goal_move(scenario: &Scenario, plan: &Plan, task: usize, goal: [f64; 2]) -> Result<GoalMove, String> {
    let of = &scenario.tasks[task];
    if !of.needs_pose() {
        return Err(format!(
            "the goal of {:?} is told by marks or by a topic: it cannot be moved to coordinates",
            of.name
        ));
    }
    let [x, y] = goal;
    let place = Point2::new(x, y);
    // JSON has no numbers that are not finite, but some that become so.
    if !(x.is_finite() && y.is_finite() && plan.is_reachable(place)) {
        let (low, high) = plan.reachable_box();
        return Err(format!(
            "the robot cannot be at ({x}, {y}) m: what it reaches lies within ({:.2}, {:.2}) and ({:.2}, {:.2})",
            low.x, low.y, high.x, high.y
        ));
    }
    if !plan.leaves_circle(place, of.radius) {
        return Err(format!("a goal at ({x}, {y}) m would cover all that the robot reaches"));
    }
    Ok(GoalMove { task, goal })
}
