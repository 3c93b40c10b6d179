//! Where the robot may be, by the way that it came.

use std::collections::VecDeque;
use std::sync::Arc;

use super::messages::{Percept, TaskOutcomes};
use super::saved::{Observations, StepBits, step_bits, step_from, wrong};
use crate::policy::{Learned, State, step_of};
use crate::robot::ActionSet;
use crate::scenario::Scenario;
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::value::MapStep;
use crate::value::place::Belief;
use crate::vision::Observation;

/// Percepts from which a robot finds out where it is, when there is a new map.
const LENGTH: usize = 60;

/// A belief, and what was perceived last. Nothing is kept where places are not told.
pub struct Way {
    is_kept: bool,
    actions: ActionSet,
    /// Values of an observation.
    values: usize,
    belief: Option<Belief>,
    percepts: VecDeque<Passed>,
}

/// What was seen, and the step that led there; `None` where nothing is known of it. Whether it was in the goals, by task.
struct Passed {
    observation: Arc<Observation>,
    step: Option<MapStep>,
    in_goal: Vec<Option<bool>>,
}

/// The same in a snapshot, by the frame of what was seen and the bits of the step.
type SavedPassed = (u64, Option<StepBits>, Vec<Option<bool>>);

impl Way {
    /// Before the first percept.
    pub fn new(scenario: &Scenario) -> Self {
        Way {
            is_kept: scenario.value.places,
            actions: scenario.robot.actions.clone(),
            values: scenario.vision.values(),
            belief: None,
            percepts: VecDeque::new(),
        }
    }

    /// Find out where it is on the map of a new model: the last part of the way once more.
    pub fn find_again(&mut self, learned: &Learned) {
        self.belief = None;
        for Passed { observation, step, in_goal } in &self.percepts {
            learned.state_on_way(observation, &mut self.belief, *step, in_goal);
        }
    }

    /// Come to a percept, and what a model makes of it.
    pub fn state<'a>(&'a mut self, learned: Option<&'a Learned>, percept: &'a Percept) -> Option<State<'a>> {
        let TaskOutcomes { blocked, step, .. } = percept.outcomes;
        let step = percept.action.map(|action| step.unwrap_or_else(|| step_of(&self.actions, action, blocked)));
        let in_goal: Vec<Option<bool>> = percept.outcomes.in_goal.iter().copied().map(Some).collect();
        if self.is_kept {
            if self.percepts.len() == LENGTH {
                self.percepts.pop_front();
            }
            self.percepts.push_back(Passed {
                observation: percept.observation.clone(),
                step,
                in_goal: in_goal.clone(),
            });
        }
        learned.map(|learned| learned.state_on_way(&percept.observation, &mut self.belief, step, &in_goal))
    }

    /// The belief alone, which a model that is installed again would find another of.
    pub fn persist_belief(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let mut parts = self.belief.as_ref().map(Belief::to_parts);
        snapshot.value("belief", &mut parts)?;
        self.belief = parts.map(Belief::from_parts).transpose().map_err(|cause| wrong("belief", cause))?;
        Ok(())
    }
}

impl Persist for Way {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let mut seen = Observations::default();
        let passed = |of: &Passed| (seen.add(&of.observation), of.step.map(step_bits), of.in_goal.clone());
        let mut percepts: Vec<SavedPassed> = self.percepts.iter().map(passed).collect();
        snapshot.value("percepts", &mut percepts)?;
        seen.persist(snapshot, self.values)?;
        if snapshot.is_restoring() {
            self.percepts.clear();
            for (frame, step, in_goal) in percepts {
                let (observation, step) = (seen.get(frame)?, step.map(step_from));
                self.percepts.push_back(Passed { observation, step, in_goal });
            }
        }
        Ok(())
    }
}
