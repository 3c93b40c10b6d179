//! The actor that decides what the robot does next.

use std::sync::Arc;

use super::messages::Percept;
use crate::parts::{Parts, PartsError, Persist};
use crate::policy::{Behaviour, Learned, Leg, Reflexes, Tally, Walk};
use crate::random::stream;
use crate::scenario::Scenario;
use crate::world::Action;

/// What was decided, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Number of the action, from 0.
    pub number: usize,
    /// The action.
    pub action: Action,
    /// What it is for.
    pub leg: Leg,
    /// Epoch of the policy, 0 without one.
    pub epoch: u32,
    /// Q-values of the pursued task.
    pub q_values: Option<[f64; 3]>,
    /// Whether a reflex replaced the policy's wish.
    pub reflex: bool,
}

/// Exploration, pursuit and reflexes.
pub struct Act {
    learned: Option<Arc<Learned>>,
    behaviour: Behaviour,
    walk: Walk,
    reflexes: Reflexes,
    number: usize,
}

impl Act {
    /// An actor without a policy: it explores.
    pub fn new(scenario: &Scenario) -> Self {
        let radius = scenario.robot.radius;
        Act {
            learned: None,
            behaviour: Behaviour::new(scenario, stream(scenario.seed, "legs")),
            walk: Walk::new(&scenario.policy, radius, stream(scenario.seed, "explore")),
            reflexes: Reflexes::new(&scenario.policy),
            number: 0,
        }
    }

    /// Act on what was learned from now on.
    pub fn install(&mut self, learned: Arc<Learned>) {
        self.learned = Some(learned);
    }

    /// The next action. What was executed last is in the percept: a replay executes what was recorded, whatever is decided.
    pub fn step(&mut self, percept: &Percept) -> Decision {
        let leg = self.behaviour.next(self.number, &percept.judged.in_goal, self.learned.is_some());
        let (action, q_values, reflex) = match (leg, &self.learned) {
            (Leg::Pursue(task), Some(learned)) => {
                let values = learned.q_values(&percept.observation, task);
                let (action, reflex) = self.reflexes.best(values, percept.recent);
                (action, Some(values), reflex)
            }
            _ => (self.walk.choose(&percept.sonar, self.reflexes, percept.recent), None, false),
        };
        self.number += 1;
        let epoch = self.learned.as_ref().map_or(0, |learned| learned.epoch);
        Decision { number: self.number - 1, action, leg, epoch, q_values, reflex }
    }

    /// How pursuits ended so far, by task.
    pub fn tallies(&self) -> &[Tally] {
        self.behaviour.tallies()
    }
}

/// What was learned is not among its parts: it is installed again.
impl Persist for Act {
    fn persist(&mut self, parts: &mut Parts) -> Result<(), PartsError> {
        parts.inner("behaviour", &mut self.behaviour)?;
        parts.inner("walk", &mut self.walk)?;
        parts.value("number", &mut self.number)
    }
}
