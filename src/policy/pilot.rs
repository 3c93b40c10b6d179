//! Acting on what was learned, and no more: one observation after another to the goal of one task.

use super::learned::{Learned, step_between, step_of};
use super::reflex::{Recent, Reflexes};
use crate::robot::{Action, ActionSet, Pose};
use crate::scenario::Scenario;
use crate::value::place::Belief;
use crate::vision::Observation;

/// The policy of a task with its reflexes and, where the model has places, a belief about where the robot is. It acts as in trials:
/// who goes on has not arrived. It learns nothing, and repeats itself from the same observations on.
#[derive(Debug, Clone)]
pub struct Pilot {
    task: usize,
    actions: ActionSet,
    reflexes: Reflexes,
    /// Of the goals up to the task's, whether the robot is in them: of the others nobody knows.
    in_goal: Vec<Option<bool>>,
    belief: Option<Belief>,
    recent: Recent,
    last: Option<Action>,
    stood: Option<Pose>,
}

impl Pilot {
    /// For a task by its number, with the actions and reflexes of the scenario that the model was learned with.
    pub fn new(scenario: &Scenario, task: usize) -> Self {
        Pilot {
            task,
            actions: scenario.robot.actions.clone(),
            reflexes: Reflexes::new(scenario),
            in_goal: (0..=task).map(|of| (of == task).then_some(false)).collect(),
            belief: None,
            recent: Recent::default(),
            last: None,
            stood: None,
        }
    }

    /// Begin anew, from anywhere.
    pub fn begin(&mut self) {
        (self.belief, self.recent, self.last, self.stood) = (None, Recent::default(), None, None);
    }

    /// The action behind an observation, by a model; none where the model tells that this is the goal, which it does where that was shown.
    /// `blocked`: whether something has stopped the action before; `odometry`: where it counts itself to be, if it does.
    ///
    /// # Panics
    /// If the observation is not of the size that the model has learned from, or the model has no such task.
    pub fn act(
        &mut self,
        learned: &Learned,
        seen: &Observation,
        blocked: bool,
        odometry: Option<Pose>,
    ) -> Option<Action> {
        let step = self.last.map(|action| match (&self.stood, &odometry) {
            (Some(from), Some(to)) => step_between(from, to),
            _ => step_of(&self.actions, action, blocked),
        });
        if let Some(action) = self.last {
            self.recent = self.recent.then(action, blocked, &self.actions);
        }
        let state = learned.state_on_way(seen, &mut self.belief, step, &self.in_goal);
        let chosen =
            (!state.is_there(self.task)).then(|| self.reflexes.best(&state.q_values(self.task), self.recent).0);
        (self.last, self.stood) = (chosen, odometry);
        chosen
    }
}
