//! How far it seems to be to a goal, and how probable it is to arrive in time.
//!
//! Discounted values tell how many actions a goal is away ([`State::expected_actions`](super::State::expected_actions)). How far that can be
//! relied on, the robot's own pursuits tell: their actions as a multiple of what was expected at their beginning. A pursuit arrives
//! in time as often as earlier ones did that had as much room. One that was given up tells that its multiple is larger than that.
//!
//! # Reference
//! Vovk, Gammerman & Shafer 2005, chapter 7 (conformal predictive distributions, here of that multiple, in the middle of its
//! range); Kaplan & Meier 1958 (of lifetimes that were not seen to their end).

use std::collections::VecDeque;

use super::PursuitEnd;
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Pursuits that are remembered, the newest ones: policies become better, and then these tell more.
const REMEMBERED: usize = 100;

/// What is expected of a pursuit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prospect {
    /// Actions of it so far.
    pub done: usize,
    /// Actions until the goal that are expected from here.
    pub actions: f64,
    /// Probability of arriving before it is given up.
    pub arrival: f64,
}

/// How earlier pursuits went, beside what was expected of them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Prospects {
    /// Actions as a multiple of those expected, and whether it arrived; otherwise it was given up.
    multiples: VecDeque<(f64, bool)>,
    /// Task and expected actions of the pursuit under way.
    begun: Option<(usize, f64)>,
}

impl Prospects {
    /// What is expected of the pursuit of a task with so many actions `done`, so many `left`, and so many `expected` from here.
    pub fn of(&mut self, task: usize, (done, left): (usize, usize), expected: Option<f64>) -> Option<Prospect> {
        if done == 0 {
            self.begun = expected.map(|actions| (task, actions));
        }
        let actions = expected?;
        Some(Prospect { done, actions, arrival: self.within(left as f64 / actions) })
    }

    /// Probability of arriving within a multiple of what is expected; with nothing to go by it is even.
    fn within(&self, most: f64) -> f64 {
        let mut sorted: Vec<(f64, bool)> = self.multiples.iter().copied().collect();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut longer = 1.0;
        let within = sorted.iter().take_while(|(multiple, _)| *multiple <= most).count();
        for (place, _) in sorted[..within].iter().enumerate().filter(|(_, pursuit)| pursuit.1) {
            // Of those that went on so long, and this one.
            longer *= 1.0 - 1.0 / (sorted.len() - place + 1) as f64;
        }
        1.0 - longer * (1.0 - 0.5 / (sorted.len() - within + 1) as f64)
    }

    /// A pursuit is over. One that was there when it began tells nothing.
    pub fn ended(&mut self, end: &PursuitEnd) {
        let Some((_, expected)) = self.begun.take().filter(|begun| begun.0 == end.task && end.actions > 0) else {
            return;
        };
        if self.multiples.len() >= REMEMBERED {
            self.multiples.pop_front();
        }
        self.multiples.push_back((end.actions as f64 / expected, end.arrived));
    }
}

impl Persist for Prospects {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let mut multiples: Vec<(u64, bool)> = self.multiples.iter().map(|of| (of.0.to_bits(), of.1)).collect();
        let mut begun = self.begun.map(|(task, actions)| (task, actions.to_bits()));
        snapshot.value("multiples", &mut multiples)?;
        snapshot.value("begun", &mut begun)?;
        self.multiples = multiples.into_iter().map(|(bits, arrived)| (f64::from_bits(bits), arrived)).collect();
        self.begun = begun.map(|(task, actions)| (task, f64::from_bits(actions)));
        let mut numbers = self.multiples.iter().map(|of| of.0).chain(self.begun.map(|begun| begun.1));
        snapshot.check(
            "multiples",
            numbers.all(|number| number > 0.0 && number.is_finite()),
            "not positive or not finite",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pursuit_arrives_in_time_as_often_as_earlier_ones_with_as_much_room() {
        let mut prospects = Prospects::default();
        let pursue = |prospects: &mut Prospects, expected, end: Option<usize>| {
            let stated = prospects.of(0, (0, 40), Some(expected)).unwrap();
            let (arrived, actions) = (end.is_some(), end.unwrap_or(40));
            prospects.ended(&PursuitEnd { task: 0, arrived, actions, sent: false });
            stated.arrival
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} in place of {b}");
        near(pursue(&mut prospects, 10.0, Some(10)), 0.5);
        // There is room for four times as much, and one of one took as much as was expected.
        near(pursue(&mut prospects, 10.0, Some(20)), 1.5 / 2.0);
        // Now for one and a half times as much: one of two.
        let stated = prospects.of(0, (25, 15), Some(10.0)).unwrap();
        assert_eq!((stated.done, stated.actions), (25, 10.0));
        near(stated.arrival, 1.5 / 3.0);
        // One is given up after four times as much: it tells nothing of more, and for less it counts.
        near(pursue(&mut prospects, 10.0, None), 2.5 / 3.0);
        near(prospects.of(0, (0, 40), Some(10.0)).unwrap().arrival, 1.0 - 0.5 * (1.0 - 0.5));
        near(prospects.of(0, (0, 15), Some(10.0)).unwrap().arrival, 1.5 / 4.0);
        // What nothing was expected of tells nothing, nor does another task than was begun.
        assert_eq!(prospects.of(0, (0, 40), None), None);
        prospects.ended(&PursuitEnd { task: 0, arrived: false, actions: 40, sent: false });
        prospects.of(0, (0, 40), Some(5.0));
        prospects.ended(&PursuitEnd { task: 1, arrived: true, actions: 4, sent: false });
        near(prospects.of(0, (0, 15), Some(10.0)).unwrap().arrival, 1.5 / 4.0);
        // The oldest are forgotten.
        (0..REMEMBERED).for_each(|_| _ = pursue(&mut prospects, 10.0, Some(10)));
        near(prospects.of(0, (0, 40), Some(10.0)).unwrap().arrival, 100.5 / 101.0);
    }
}
