//! How fast a robot's time goes, by our steady clock.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use crate::lock::lock;

/// A simulator's clock is compared with ours over so much of our time.
const COMPARED: Duration = Duration::from_millis(250);

/// Paces that simulators have.
const PACES: std::ops::RangeInclusive<f64> = 0.001..=1000.0;

/// Time that goes as the robot's does, and never jumps: the steady clock, stretched to the pace of a simulator's `/clock`.
///
/// Only the pace is that of `/clock`: where that stands still, stops coming, or jumps, this goes on as before, so that silence counts as
/// silence.
pub struct Pace(Mutex<State>);

struct State {
    /// Our time at a moment, from 0.
    at: (Duration, Instant),
    pace: f64,
    /// What a simulator's clock said, and when.
    heard: Option<(u64, Instant)>,
    known: bool,
}

impl Pace {
    /// That of the steady clock until a simulator's is heard.
    pub fn new() -> Self {
        Pace(Mutex::new(State { at: (Duration::ZERO, Instant::now()), pace: 1.0, heard: None, known: false }))
    }

    /// A simulator's clock says what time it is, nanoseconds.
    pub fn hear(&self, simulated_ns: u64) {
        self.hear_at(simulated_ns, Instant::now());
    }

    fn hear_at(&self, simulated_ns: u64, now: Instant) {
        let state = &mut lock(&self.0);
        let Some((before_ns, before)) = state.heard else {
            state.heard = Some((simulated_ns, now));
            return;
        };
        let real = now.saturating_duration_since(before);
        if simulated_ns >= before_ns && real < COMPARED {
            return;
        }
        state.heard = Some((simulated_ns, now));
        let pace = simulated_ns.saturating_sub(before_ns) as f64 / 1e9 / real.as_secs_f64();
        // A clock that was set, or stood still, says nothing about the pace.
        if PACES.contains(&pace) {
            state.at = (state.time(now), now);
            (state.pace, state.known) = (pace, true);
        }
    }

    /// Whether a simulator's pace is known.
    pub fn is_known(&self) -> bool {
        lock(&self.0).known
    }

    /// Time since the beginning, as the robot's goes.
    pub fn now(&self) -> Duration {
        lock(&self.0).time(Instant::now())
    }

    /// How much of that passes in a moment of ours.
    pub fn of(&self, real: Duration) -> Duration {
        real.mul_f64(lock(&self.0).pace)
    }

    /// Our time until so much of that has passed.
    pub fn real(&self, time: Duration) -> Duration {
        time.div_f64(lock(&self.0).pace)
    }
}

impl State {
    fn time(&self, now: Instant) -> Duration {
        self.at.0 + now.saturating_duration_since(self.at.1).mul_f64(self.pace)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pace_of_a_simulator_is_followed_and_its_jumps_are_not() {
        let pace = Pace::new();
        let begin = lock(&pace.0).at.1;
        let at = |ms: u64| begin + Duration::from_millis(ms);
        // 8 times real time, then half of it; then it is set back by an hour, and stands still.
        for step in 0..=100 {
            pace.hear_at(3_600_000_000_000 + 80_000_000 * step, at(10 * step));
        }
        assert!(pace.is_known());
        assert_eq!(lock(&pace.0).pace, 8.0);
        let time = |ms: u64| lock(&pace.0).time(at(ms));
        let begun = time(1000);
        for step in 0..=100 {
            pace.hear_at(3_608_000_000_000 + 5_000_000 * step, at(1000 + 10 * step));
        }
        assert_eq!(lock(&pace.0).pace, 0.5);
        let from = time(2000);
        let passed = from - begun;
        // What was compared last began at the old pace.
        assert!((Duration::from_millis(500)..Duration::from_millis(2500)).contains(&passed), "{passed:?}");
        for step in 0..=200 {
            pace.hear_at(8_500_000_000 + if step < 100 { 5_000_000 * step } else { 500_000_000 }, at(2000 + 10 * step));
        }
        assert_eq!(lock(&pace.0).pace, 0.5);
        let passed = time(4000) - from;
        assert_eq!(passed, Duration::from_secs(1));
    }
}
