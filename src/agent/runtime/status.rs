//! What a run is doing right now, for those who watch.

use std::sync::{Arc, Mutex};

use super::queue::Gauge;
use crate::lock::lock;
use crate::policy::Tally;

/// A view of a run at one moment.
#[derive(Debug, Clone, Default)]
pub struct StatusValues {
    /// Frames seen.
    pub frames: u64,
    /// Actions decided.
    pub actions: usize,
    /// Simulated or real time of the newest frame, nanoseconds since 1970.
    pub stamp_ns: u64,
    /// Frames that the source dropped, because they were not taken in time.
    pub dropped: u64,
    /// Frames left out of learning, because their values are not finite.
    pub quarantined: u64,
    /// Support vectors.
    pub support_vectors: usize,
    /// Epoch of the policy in use.
    pub epoch: u32,
    /// Mean slowness of the features in use, 1/s².
    pub slowness_mean: Option<f64>,
    /// How pursuits ended so far, all tasks together.
    pub pursuits: Tally,
    /// Success of the newest evaluation, mean over tasks.
    pub success: Option<f64>,
    /// 99th percentile of the time from percept to an action that values decide on, milliseconds.
    pub act_p99_ms: f64,
    /// 99th percentile of the time to learn from a frame, milliseconds.
    pub frame_p99_ms: f64,
    /// What a robot that takes velocities is doing, and why it may not move.
    pub robot: Option<String>,
    /// Models that could not be made, with the reason of the last one.
    pub without_model: Option<String>,
    /// Name, depth and capacity of each queue.
    pub queues: Vec<(&'static str, usize, usize)>,
}

/// Shared between the actors, which write it, and whoever watches; clones are the same.
#[derive(Clone, Default)]
pub struct Status {
    inner: Arc<Mutex<StatusValues>>,
    gauges: Arc<Mutex<Vec<Gauge>>>,
}

impl Status {
    /// A view of now.
    pub fn now(&self) -> StatusValues {
        let mut snapshot = lock(&self.inner).clone();
        snapshot.queues = lock(&self.gauges).iter().map(|gauge| (gauge.name, gauge.depth(), gauge.capacity)).collect();
        snapshot
    }

    pub(in crate::agent) fn update(&self, change: impl FnOnce(&mut StatusValues)) {
        change(&mut lock(&self.inner));
    }

    pub(in crate::agent) fn watch(&self, gauge: Gauge) {
        lock(&self.gauges).push(gauge);
    }
}

/// Memory that this process holds now, bytes; `None` where the system does not say.
pub fn resident_bytes() -> Option<u64> {
    proc_status("VmRSS:")
}

/// The most memory that this process has held, bytes; `None` where the system does not say.
pub fn peak_resident_bytes() -> Option<u64> {
    proc_status("VmHWM:")
}

/// Linux tells a process about itself in lines such as `VmRSS:  1234 kB`.
fn proc_status(key: &str) -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(key))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kilobytes| 1024 * kilobytes)
}
