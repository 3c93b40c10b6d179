//! A robot's clock against ours.
//!
//! A stamp says when something was sensed by the robot's clock. What came in with the least delay of the last seconds tells how the
//! two clocks stand to each other, up to that delay; everything else came in later than it could have, and is older by that. A
//! robot's clock that is set back looks like a network that has become slow: what comes counts as old until the last seconds
//! know nothing else. Stamps that go back are told from late ones by a second one that agrees.

use std::collections::VecDeque;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// The least delay is that of the last so many seconds.
const WINDOW: Duration = Duration::from_secs(5);

/// A change of the clocks against each other that is worth a word, nanoseconds.
const WORTH_A_WORD: i64 = 100_000_000;

/// A stamp that is earlier than the one before by more than this may be of a clock that was set back, nanoseconds.
const SET_BACK: u64 = 1_000_000_000;

/// Two stamps agree on how the clocks stand to each other if they differ by less than this, nanoseconds.
const AGREE: i64 = 100_000_000;

/// The stamps of one topic.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Stamps {
    last_ns: Option<u64>,
    /// By how much later than its stamp something came in whose stamp had gone back.
    back: Option<i64>,
}

impl Stamps {
    /// The newest one.
    pub fn last(&self) -> Option<u64> {
        self.last_ns
    }
}

/// How the robot's clock stands to ours.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RobotClock {
    /// When something came in, and by how much later that was than its stamp, nanoseconds: only what no later one is below.
    least: VecDeque<(Duration, i64)>,
    told: Option<i64>,
}

impl RobotClock {
    /// Something with a stamp came in at a time: when it was sensed on our clock, if the fastest was not delayed. Nothing where
    /// its stamp is not later than that of its topic before, unless the robot's clock was set back.
    pub fn sensed_at(&mut self, stamps: &mut Stamps, at: Duration, stamp_ns: u64) -> Option<Duration> {
        let delay = (at.as_nanos() as i64).wrapping_sub(stamp_ns as i64);
        match stamps.last_ns {
            Some(last) if stamp_ns <= last => {
                let before = stamps.back.replace(delay);
                let agrees = before.is_some_and(|before| before.abs_diff(delay) < AGREE as u64);
                if last - stamp_ns <= SET_BACK || !agrees {
                    return None;
                }
                // What was known of the clocks is known no more.
                self.least.retain(|&(_, other)| other.abs_diff(delay) < AGREE as u64);
            }
            _ => {}
        }
        (stamps.last_ns, stamps.back) = (Some(stamp_ns), None);
        while self.least.back().is_some_and(|&(_, other)| other >= delay) {
            self.least.pop_back();
        }
        self.least.push_back((at, delay));
        while self.least.front().is_some_and(|&(then, _)| at.saturating_sub(then) > WINDOW) {
            self.least.pop_front();
        }
        let base = self.least.front().map_or(delay, |&(_, least)| least);
        Some(at.saturating_sub(Duration::from_nanos(delay.saturating_sub(base).max(0) as u64)))
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
        let (mut clock, mut stamps) = (RobotClock::default(), Stamps::default());
        let mut sensed_at = |at, of| clock.sensed_at(&mut stamps, ms(at), stamp(of));
        assert_eq!(sensed_at(1000, 0), Some(ms(1000)));
        assert_eq!(sensed_at(1100, 50), Some(ms(1050)));
        // A faster one shows that the others were slow.
        assert_eq!(sensed_at(1120, 150), Some(ms(1120)));
        assert_eq!(sensed_at(1200, 200), Some(ms(1170)));
        // Twice, and out of order.
        assert_eq!(sensed_at(1201, 200), None);
        assert_eq!(sensed_at(1202, 100), None);
        assert_eq!(sensed_at(1250, 250), Some(ms(1220)));
        // One that took more than a second stands alone.
        assert_eq!(sensed_at(2300, 1260), Some(ms(2230)));
        assert_eq!(sensed_at(2310, 200), None);
        assert_eq!(sensed_at(2320, 1350), Some(ms(2320)));
        assert_eq!(clock.jump(), None);
    }

    #[test]
    fn a_clock_that_is_set_is_found_and_survived() {
        for jump in [10_000_i64, -10_000] {
            let (mut clock, mut stamps) = (RobotClock::default(), Stamps::default());
            let after = |at: u64| stamp((at as i64 + 20_000 + jump) as u64);
            for at in (0..2000).step_by(20) {
                clock.sensed_at(&mut stamps, ms(1000 + at), stamp(20_000 + at));
                assert_eq!(clock.jump(), None);
            }
            // The first stamp that has gone back is not believed, the second is.
            assert_eq!(clock.sensed_at(&mut stamps, ms(3000), after(2000)).is_none(), jump < 0);
            assert_eq!(clock.sensed_at(&mut stamps, ms(3020), after(2020)), Some(ms(3020)), "{jump}");
            assert_eq!(clock.jump(), Some(jump as f64 / 1e3));
            assert_eq!(clock.sensed_at(&mut stamps, ms(3040), after(2040)), Some(ms(3040)));
            assert_eq!(clock.jump(), None);
        }
    }

    #[test]
    fn a_clock_that_drifts_is_followed() {
        let (mut clock, mut stamps) = (RobotClock::default(), Stamps::default());
        for at in (0..100_000).step_by(20) {
            // A millisecond a second slow.
            let sensed = clock.sensed_at(&mut stamps, ms(at), stamp(100_000 + at - at / 1000)).unwrap();
            assert!(ms(at) - sensed <= ms(6), "{at}: {sensed:?}");
        }
        assert_eq!(clock.jump().map(|jump| jump < 0.0), None, "asked for the first time");
    }
}
