//! A robot's clock against ours.
//!
//! A stamp says when something was sensed by the robot's clock. What came in with the least delay of the last seconds tells how the
//! two clocks stand to each other, up to that delay; everything else came in later than it could have, and is older by that. A
//! robot's clock that is set back looks like a network that has become slow: what comes counts as old until the last seconds
//! know nothing else.

use std::collections::VecDeque;
use std::time::Duration;

use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// The least delay is that of the last so many seconds.
const WINDOW: Duration = Duration::from_secs(5);

/// A change of the clocks against each other that is worth a word, nanoseconds.
const WORTH_A_WORD: i64 = 100_000_000;

/// How the robot's clock stands to ours.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RobotClock {
    /// When something came in, and by how much later that was than its stamp, nanoseconds: only what no later one is below.
    least: VecDeque<(Duration, i64)>,
    told: Option<i64>,
}

impl RobotClock {
    /// Something with a stamp came in at a time: when it was sensed on our clock, if the fastest was not delayed.
    pub fn sensed_at(&mut self, at: Duration, stamp_ns: u64) -> Duration {
        let delay = (at.as_nanos() as i64).wrapping_sub(stamp_ns as i64);
        while self.least.back().is_some_and(|&(_, other)| other >= delay) {
            self.least.pop_back();
        }
        self.least.push_back((at, delay));
        while self.least.front().is_some_and(|&(then, _)| at.saturating_sub(then) > WINDOW) {
            self.least.pop_front();
        }
        let base = self.least.front().map_or(delay, |&(_, least)| least);
        at.saturating_sub(Duration::from_nanos(delay.saturating_sub(base).max(0) as u64))
    }

    /// By how much the robot's clock has gone ahead of ours since this was last asked, seconds, if that is worth a word.
    pub fn jump(&mut self) -> Option<f64> {
        let base = self.least.front()?.1;
        let before = *self.told.get_or_insert(base);
        let change = before.saturating_sub(base);
        (change.abs() >= WORTH_A_WORD).then(|| {
            self.told = Some(base);
            change as f64 / 1e9
        })
    }
}

impl Persist for RobotClock {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.value("least", &mut self.least)?;
        snapshot.value("told", &mut self.told)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAMPS_FROM: u64 = 1_800_000_000_000_000_000;

    fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    fn stamp(milliseconds: u64) -> u64 {
        STAMPS_FROM + 1_000_000 * milliseconds
    }

    #[test]
    fn what_comes_later_than_it_could_is_older() {
        let mut clock = RobotClock::default();
        assert_eq!(clock.sensed_at(ms(1000), stamp(0)), ms(1000));
        assert_eq!(clock.sensed_at(ms(1100), stamp(50)), ms(1050));
        // A faster one shows that the others were slow.
        assert_eq!(clock.sensed_at(ms(1120), stamp(150)), ms(1120));
        assert_eq!(clock.sensed_at(ms(1200), stamp(200)), ms(1170));
        assert_eq!(clock.jump(), None);
    }

    #[test]
    fn a_clock_that_is_set_is_found_and_survived() {
        for (jump, stale) in [(10_000_i64, false), (-10_000, true)] {
            let mut clock = RobotClock::default();
            let after = |at: u64| stamp((at as i64 + 20_000 + jump) as u64);
            for at in (0..2000).step_by(20) {
                clock.sensed_at(ms(1000 + at), stamp(20_000 + at));
                assert_eq!(clock.jump(), None);
            }
            let sensed = clock.sensed_at(ms(3000), after(2000));
            assert_eq!(sensed < ms(2900), stale, "{jump}");
            let mut told = clock.jump();
            for at in (2020..9000).step_by(20) {
                clock.sensed_at(ms(1000 + at), after(at));
                told = told.or(clock.jump());
            }
            assert_eq!(told, Some(jump as f64 / 1e3));
            assert_eq!(clock.sensed_at(ms(10_000), after(9000)), ms(10_000), "it is fresh again");
        }
    }

    #[test]
    fn a_clock_that_drifts_is_followed() {
        let mut clock = RobotClock::default();
        for at in (0..100_000).step_by(20) {
            // A millisecond a second slow.
            let sensed = clock.sensed_at(ms(at), stamp(100_000 + at - at / 1000));
            assert!(ms(at) - sensed <= ms(6), "{at}: {sensed:?}");
        }
        assert_eq!(clock.jump().map(|jump| jump < 0.0), None, "asked for the first time");
    }
}
