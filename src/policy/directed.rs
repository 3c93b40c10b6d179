//! Exploration that goes where the robot has hardly been.
//!
//! A random walk comes through narrow doors rarely: of a floor with many rooms it misses some for a long time. So some periods of exploration
//! begin with a way to a place that was rarely visited, by values of its own; there the walk goes on.
//!
//! # Reference
//! Ecoffet et al. 2021 (first return, then explore); Tang et al. 2017 (counts of states that are alike).

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::learned::State;
use crate::robot::ActionValues;
use crate::scenario::Scenario;
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Who expects so much of the 1 that the place is worth is there, or some actions before it: two with γ = 0.9, four with 0.97.
const THERE: f64 = 0.9;

/// Ways to rarely visited places, at the beginning of periods of exploration.
#[derive(Debug, Clone)]
pub struct Directed {
    share: f64,
    length: usize,
    /// The place that it is on the way to.
    place: Option<usize>,
    /// Actions until the period is over.
    left: usize,
    rng: ChaCha8Rng,
}

impl Directed {
    /// As a scenario has it; `rng` makes its choices.
    pub fn new(scenario: &Scenario, rng: ChaCha8Rng) -> Self {
        let policy = &scenario.policy;
        Directed { share: policy.directed_share, length: policy.explore_length, place: None, left: 0, rng }
    }

    /// Begin a new period with the next action.
    pub fn begin(&mut self) {
        (self.place, self.left) = (None, 0);
    }

    /// What actions are worth on the way; `None`: it walks at random.
    pub fn values(&mut self, state: Option<&State<'_>>) -> Option<ActionValues> {
        if self.left == 0 {
            self.left = self.length;
            let places = state.map_or(0, State::rare_places);
            let goes = places > 0 && self.rng.random_range(0.0..1.0) < self.share;
            self.place = goes.then(|| self.rng.random_range(0..places));
        }
        self.left -= 1;
        let values = state?.rare_values(self.place?)?;
        let most = values.iter().fold(f64::NEG_INFINITY, |most, &value| most.max(value));
        // It is there, or no way is known.
        if most >= THERE || most <= 0.0 {
            self.place = None;
        }
        (most > 0.0).then_some(values)
    }
}

impl Persist for Directed {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.random("random", &mut self.rng)?;
        snapshot.value("place", &mut self.place)?;
        snapshot.value("left", &mut self.left)
    }
}
