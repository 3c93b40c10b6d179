//! The random walk of exploration, with a sonar reflex at walls.
//!
//! The reflex is heeded most of the time, not always: policy iteration must have seen that driving against a wall leads
//! nowhere, else it believes what its features extrapolate. (In the lab, with a reflex that is always heeded, the greedy
//! policy pushed against walls from most starts.)

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::reflex::{Recent, Reflexes};
use crate::robot::{Action, ActionSet, ActionValues};
use crate::scenario::Scenario;
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// A random walk that does not drive into walls it can hear.
#[derive(Debug, Clone)]
pub struct Walk {
    forward_probability: f64,
    stop: f64,
    heed: f64,
    radius: f64,
    actions: ActionSet,
    rng: ChaCha8Rng,
}

impl Walk {
    /// The walk of a scenario; `rng` makes its choices.
    pub fn new(scenario: &Scenario, rng: ChaCha8Rng) -> Self {
        let settings = &scenario.policy;
        Walk {
            forward_probability: settings.forward_probability,
            stop: settings.sonar_stop,
            heed: settings.sonar_heed,
            radius: scenario.robot.radius,
            actions: scenario.robot.actions.clone(),
            rng,
        }
    }

    /// The next action, of those that sonar and reflexes allow.
    pub fn choose(&mut self, sonar: &[f32], reflexes: Reflexes, recent: Recent) -> Action {
        let heeds = self.rng.random_range(0.0..1.0) < self.heed;
        let free = !heeds || clearance_ahead(sonar, self.radius) >= self.stop;
        let advancing = self.actions.iter().filter(|&action| self.actions.advances(action)).count();
        let turning = self.actions.len() - advancing;
        // Actions that drive ahead share one probability, the others the rest.
        let (ahead, turn) =
            (self.forward_probability / advancing as f64, (1.0 - self.forward_probability) / turning as f64);
        let weight = |action: Action| match self.actions.advances(action) {
            _ if !reflexes.allow(action, recent) => 0.0,
            true if free => ahead,
            true => 0.0,
            false => turn,
        };
        let weights = ActionValues::new(self.actions.iter().map(weight));
        if weights.iter().all(|&weight| weight == 0.0) {
            // A blocked turn beside a wall forbids everything: then any turn is better than none.
            let any = self.actions.iter().find(|&action| !self.actions.advances(action));
            return any.unwrap_or(Action::FORWARD);
        }
        let mut left = self.rng.random_range(0.0..weights.iter().sum());
        let mut last = Action::FORWARD;
        for (action, &weight) in self.actions.iter().zip(weights.iter()).filter(|(_, weight)| **weight > 0.0) {
            if left < weight {
                return action;
            }
            left -= weight;
            last = action;
        }
        // Rounding can leave a remainder: the last action that has weight.
        last
    }
}

impl Persist for Walk {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.random("random", &mut self.rng)
    }
}

/// How far a disc can drive straight ahead before it meets something that the sonars hear, metres.
///
/// `sonar`: distances from the centre in equal angles, the first straight ahead, counter-clockwise.
pub fn clearance_ahead(sonar: &[f32], radius: f64) -> f64 {
    let mut clearance = f64::INFINITY;
    for (i, distance) in sonar.iter().map(|&distance| f64::from(distance)).enumerate() {
        let angle = std::f64::consts::TAU * i as f64 / sonar.len() as f64;
        let (ahead, aside) = (distance * angle.cos(), distance * angle.sin());
        if ahead > 0.0 && aside.abs() < radius {
            clearance = clearance.min(ahead - (radius * radius - aside * aside).sqrt());
        }
    }
    clearance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;

    fn walk() -> Walk {
        let actions = ActionSet::differential_drive(0.3, 0.8);
        Walk { forward_probability: 0.6, stop: 0.1, heed: 1.0, radius: 0.25, actions, rng: stream(1, "test") }
    }

    fn shares(sonar: &[f32], recent: Recent) -> [f64; 3] {
        let reflexes = Reflexes::all(&ActionSet::differential_drive(0.3, 0.8));
        let mut walk = walk();
        let mut counts = [0u32; 3];
        for _ in 0..4000 {
            counts[walk.choose(sonar, reflexes, recent).index()] += 1;
        }
        counts.map(|count| f64::from(count) / 4000.0)
    }

    #[test]
    fn the_walk_has_its_probabilities_and_heeds_sonar_and_reflexes() {
        let open = [5.0; 8];
        let all = shares(&open, Recent::default());
        assert!((all[0] - 0.6).abs() < 0.03 && (all[1] - 0.2).abs() < 0.03);
        let mut wall = open;
        wall[0] = 0.3;
        let turning = shares(&wall, Recent::default());
        assert!(turning[0] == 0.0 && (turning[1] - 0.5).abs() < 0.03);
        let after_left = shares(&wall, Recent::default().then(Action::TURN_LEFT, false, &walk().actions));
        assert_eq!(after_left[1], 1.0);
    }

    #[test]
    fn clearance_counts_what_a_disc_would_touch() {
        assert!((clearance_ahead(&[1.0, 5.0, 5.0, 5.0], 0.25) - 0.75).abs() < 1e-12);
        // 0.2 m aside at 45°: in the way; a wall beside the disc is not.
        let aside = (2.0f32 * 0.2 * 0.2).sqrt();
        let found = clearance_ahead(&[5.0, aside, 5.0, 5.0, 5.0, 5.0, 5.0, 5.0], 0.25);
        assert!((found - (0.2 - 0.15)).abs() < 1e-7);
        assert_eq!(clearance_ahead(&[f32::INFINITY, 0.26, 5.0, 0.26], 0.25), f64::INFINITY);
    }
}
