//! Values planned on a lattice of poses, from the transitions of a walk whose states lie at poses that are true or were mapped.

use super::ExperimentError;
use super::lab::{Lab, Walked};
use crate::policy::step_of;
use crate::robot::Pose;
use crate::scenario::in_goal;
use crate::value::place::{MotionNoise, PlaceOutcomes, PlaceStep, Planner, Pose as PlacePose};
use crate::value::{Fit, MapStep};

/// A pose in lengths of a move.
pub fn place(lab: &Lab, pose: &Pose) -> PlacePose {
    let unit = lab.scenario.robot.forward;
    PlacePose { x: pose.position.x / unit, y: pose.position.y / unit, heading: pose.heading }
}

/// The transitions of a walk whose states lie at these poses, metres: one more than actions.
pub fn steps(lab: &Lab, walked: &Walked, poses: &[Pose]) -> Vec<PlaceStep> {
    let step = |t: usize| PlaceStep {
        action: walked.actions[t].index(),
        from: place(lab, &poses[t]),
        to: place(lab, &poses[t + 1]),
        blocked: walked.blocked[t],
    };
    (0..walked.actions.len()).map(step).collect()
}

/// Where actions lead.
pub fn planner<'a>(lab: &Lab, steps: &'a [PlaceStep]) -> Result<Planner<'a>, ExperimentError> {
    let actions = &lab.scenario.robot.actions;
    let motions: Vec<MapStep> = actions.iter().map(|action| step_of(actions, action, false)).collect();
    Ok(Planner::new(&motions, steps, MotionNoise::ROBOT, lab.scenario.robot.forward)?)
}

/// Values for a task: its rewards are those that the robot was given on its walk.
pub fn fit(lab: &Lab, planner: &Planner<'_>, walked: &Walked, task: usize) -> Result<Fit, ExperimentError> {
    let (task, ends) = (lab.task(task), &walked.poses[1..]);
    let rewards: Vec<f64> = ends.iter().map(|end| lab.world.plan.reward(task, end.position)).collect();
    let ended: Vec<bool> = ends.iter().map(|end| task.absorbing && in_goal(task, end.position)).collect();
    let outcomes = PlaceOutcomes { rewards: &rewards, avoided: &vec![0.0; ends.len()], ended: &ended };
    Ok(planner.fit(&outcomes, lab.scenario.value.gamma)?)
}

/// What actions are worth at a place; where the walk never was, any is as good.
pub fn values(lab: &Lab, (planner, fit): (&Planner<'_>, &Fit), place: PlacePose) -> Vec<f64> {
    planner.values_at(fit, place).unwrap_or_else(|| vec![0.0; lab.scenario.robot.actions.len()])
}
