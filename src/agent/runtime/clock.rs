//! Durations of repeated work, as percentiles in bounded memory.

use std::time::{Duration, Instant};

use hdrhistogram::Histogram;
use serde::Serialize;

/// Durations of repeated work, milliseconds.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Timing {
    /// To decide on an action by values, once its percept is there.
    pub act_p50: f64,
    /// To decide on an action by values, once its percept is there.
    pub act_p99: f64,
    /// To learn from a frame, and to wait for the solver. Frames are learned in blocks: the last one of a block takes all the time.
    pub frame_p50: f64,
    /// To learn from a frame, and to wait for the solver.
    pub frame_p99: f64,
    /// To learn from a frame, and to wait for the solver, in the mean.
    pub frame_mean: f64,
    /// To solve slow features.
    pub resolve_p50: f64,
    /// To solve slow features.
    pub resolve_max: f64,
    /// To fit all policies.
    pub refit_p50: f64,
    /// To fit all policies.
    pub refit_max: f64,
}

/// Durations with three digits from a microsecond up to an hour, in bounded memory.
pub struct Clock {
    durations: Histogram<u64>,
    /// When a percentile was last published, see [`Clock::p99_now_and_then`].
    published: Instant,
}

/// Time between percentiles of a running clock: each one walks through all counts, and the log gets one a second.
const PUBLISH_INTERVAL: Duration = Duration::from_secs(1);

impl Clock {
    /// No durations yet.
    pub fn new() -> Self {
        // The crate asks for low ≥ 1, high ≥ 2·low and at most 5 digits.
        let durations = Histogram::new_with_bounds(1, 3_600_000_000, 3).expect("valid bounds");
        Clock { durations, published: Instant::now() }
    }

    /// Do some work and keep how long it took.
    pub fn time<R>(&mut self, work: impl FnOnce() -> R) -> R {
        let begin = Instant::now();
        let result = work();
        self.keep(begin.elapsed());
        result
    }

    /// Keep a duration.
    pub fn keep(&mut self, duration: Duration) {
        self.durations.saturating_record(duration.as_micros() as u64);
    }

    /// The duration that a share `q` of all stays below, milliseconds.
    pub fn quantile_ms(&self, q: f64) -> f64 {
        self.durations.value_at_quantile(q) as f64 / 1000.0
    }

    /// The duration that 99 % of all stay below, milliseconds, if none was given within the last second.
    pub fn p99_now_and_then(&mut self) -> Option<f64> {
        if self.published.elapsed() < PUBLISH_INTERVAL {
            return None;
        }
        self.published = Instant::now();
        Some(self.quantile_ms(0.99))
    }

    /// The mean, milliseconds; 0 of none.
    pub fn mean_ms(&self) -> f64 {
        if self.durations.is_empty() { 0.0 } else { self.durations.mean() / 1000.0 }
    }

    /// The longest duration, milliseconds.
    pub fn max_ms(&self) -> f64 {
        self.durations.max() as f64 / 1000.0
    }
}
