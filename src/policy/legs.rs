//! What the robot is up to: legs of exploration and of pursuit, mixed by the scenario's schedule.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::parts::{Parts, PartsError, Persist};
use crate::scenario::{Scenario, Then};

/// What a leg is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Leg {
    /// Random walk.
    Explore,
    /// The greedy policy of a task, by its number.
    Pursue(usize),
}

/// How pursuits of one task ended so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Tally {
    /// Pursuits that reached the goal.
    pub reached: usize,
    /// Pursuits that ended, reached or not.
    pub ended: usize,
}

/// The schedule of legs.
///
/// The share of pursuits is 0 during `explore_actions` and then rises linearly to `pursue_share` at the end of the run.
#[derive(Debug, Clone)]
pub struct Behaviour {
    scenario_actions: usize,
    explore_actions: usize,
    pursue_share: f64,
    explore_leg: usize,
    pursue_leg: usize,
    then: Vec<Then>,
    rng: ChaCha8Rng,
    leg: Leg,
    left: usize,
    last_task: usize,
    tallies: Vec<Tally>,
}

impl Behaviour {
    /// The schedule of a scenario; `rng` draws the legs.
    pub fn new(scenario: &Scenario, rng: ChaCha8Rng) -> Self {
        let policy = &scenario.policy;
        Behaviour {
            scenario_actions: scenario.actions,
            explore_actions: policy.explore_actions,
            pursue_share: policy.pursue_share,
            explore_leg: policy.explore_leg,
            pursue_leg: policy.pursue_leg,
            then: scenario.tasks.iter().map(|task| task.then).collect(),
            rng,
            leg: Leg::Explore,
            left: 0,
            last_task: scenario.tasks.len() - 1,
            tallies: vec![Tally::default(); scenario.tasks.len()],
        }
    }

    /// The leg of action number `action` (from 0). `in_goal`: which tasks' goals the robot is in now; `able`: whether
    /// there is a policy to pursue with.
    pub fn next(&mut self, action: usize, in_goal: &[bool], able: bool) -> Leg {
        if let Leg::Pursue(task) = self.leg
            && (in_goal[task] || self.left == 0)
        {
            self.tallies[task].ended += 1;
            self.tallies[task].reached += usize::from(in_goal[task]);
            let then = if in_goal[task] { self.then[task] } else { Then::Schedule };
            self.begin(then, action, in_goal, able);
        } else if self.left == 0 {
            self.begin(Then::Schedule, action, in_goal, able);
        }
        self.left -= 1;
        self.leg
    }

    /// How pursuits ended so far, by task.
    pub fn tallies(&self) -> &[Tally] {
        &self.tallies
    }

    fn begin(&mut self, then: Then, action: usize, in_goal: &[bool], able: bool) {
        let drawn = self.rng.random_range(0.0..1.0) < self.share(action);
        let pursue = able && (then == Then::NextTask || then == Then::Schedule && drawn);
        // A pursuit of a goal in which the robot stands would be over at once: the next task's turn.
        let tasks = self.tallies.len();
        let next = (1..=tasks).map(|step| (self.last_task + step) % tasks).find(|&task| !in_goal[task]);
        (self.leg, self.left) = match next {
            Some(task) if pursue => {
                self.last_task = task;
                (Leg::Pursue(task), self.pursue_leg)
            }
            _ => (Leg::Explore, self.explore_leg),
        };
    }

    fn share(&self, action: usize) -> f64 {
        let rest = self.scenario_actions.saturating_sub(self.explore_actions).max(1);
        let done = action.saturating_sub(self.explore_actions) as f64 / rest as f64;
        if action < self.explore_actions { 0.0 } else { self.pursue_share * done.min(1.0) }
    }
}

impl Persist for Behaviour {
    fn persist(&mut self, parts: &mut Parts) -> Result<(), PartsError> {
        let tasks = self.tallies.len();
        parts.random("random", &mut self.rng)?;
        parts.value("leg", &mut self.leg)?;
        parts.value("left", &mut self.left)?;
        parts.value("last_task", &mut self.last_task)?;
        parts.value("tallies", &mut self.tallies)?;
        let known = match self.leg {
            Leg::Pursue(task) => task < tasks,
            Leg::Explore => true,
        };
        parts.check("tallies", known && self.last_task < tasks && self.tallies.len() == tasks, "other tasks")
    }
}
