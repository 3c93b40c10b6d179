//! `[agent]`, `[log]`: how a run is made and kept.

use super::robot::{Body, Robot};
use crate::log::{Compression, MAX_CHUNK_TARGET_BYTES};
use crate::scenario::keys::{Section, above, within};

/// How model swaps are timed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// A model asked for at frame t takes effect at frame t + L exactly.
    Lockstep,
    /// A model takes effect when it is ready.
    Realtime,
}

/// What to do where a run would need more memory than there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OverMemory {
    /// Refuse the scenario.
    Refuse,
    /// Lower the budget of support vectors, and the number of features with it, to what fits.
    Shrink,
}

/// Who computes kernel values of many observations. They are the same, whoever does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compute {
    /// Whichever is faster on this machine.
    Auto,
    /// The processor.
    Cpu,
    /// A graphics processor, if there is one.
    Gpu,
}

/// `[agent]`
#[derive(Debug, Clone, PartialEq)]
pub struct Agent {
    /// Timing of model swaps.
    pub mode: Mode,
    /// Frames between two requests for a new model.
    pub resolve_frames: usize,
    /// L: frames from the request to the effect.
    pub latency_frames: usize,
    /// Capacity of the queues between actors, messages.
    pub queue: usize,
    /// Threads for each matrix product; results do not depend on them.
    pub threads: usize,
    /// Who computes kernel values of many observations.
    pub compute: Compute,
    /// Most memory that a run may need, GB; `None`: what the machine has.
    pub memory_gb: Option<f64>,
    /// What to do where a run would need more.
    pub over_memory: OverMemory,
    /// What happens to frames that are not taken in time.
    pub when_behind: WhenBehind,
    /// Times real time at which a simulated robot drives; `None`: as fast as its frames are taken.
    pub speed: Option<f64>,
    /// Time between two states of the run that are saved, minutes; 0: none but when it is interrupted.
    pub snapshot_minutes: f64,
}

impl Agent {
    /// Time between two states of the run that are saved; none of them but when it is interrupted, if that is `None`.
    pub fn snapshot_every(&self) -> Option<std::time::Duration> {
        (self.snapshot_minutes > 0.0).then(|| std::time::Duration::from_secs_f64(60.0 * self.snapshot_minutes))
    }
}

/// What happens to frames that are not taken in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenBehind {
    /// The source waits.
    Wait,
    /// The oldest ones are dropped, counted and reported.
    Drop,
}

/// `[log]`
#[derive(Debug, Clone, PartialEq)]
pub struct Log {
    /// Compression of chunks.
    pub compression: Compression,
    /// Size of a chunk before compression, bytes.
    pub chunk_bytes: usize,
    /// Longest time that a message stays in memory only, seconds.
    pub flush_seconds: f64,
    /// Size at which a file is closed and the next one begun, megabytes.
    pub file_mb: f64,
    /// Age at which a file is closed; `None`: none is closed for its age, minutes.
    pub file_minutes: Option<f64>,
    /// Most that all files may take before the oldest ones are deleted; `None`: all are kept, megabytes.
    pub budget_mb: Option<f64>,
}

impl Agent {
    pub(super) fn read(s: &mut Section<'_, '_>, robot: &Robot) -> Self {
        // A model for each 1 000 actions, as in the lab, however many frames a program gives of each.
        let resolve_frames = if robot.body == Body::Program { 1000 * robot.frames_per_action } else { 5000 };
        Agent {
            mode: s.choice(
                "mode",
                &[("lockstep", Mode::Lockstep), ("realtime", Mode::Realtime)],
                "a model takes effect latency_frames after the request, or when it is ready"),
            resolve_frames: s.count(
                "resolve_frames",
                resolve_frames,
                "frames",
                10..=1_000_000_000,
                "between two requests for a model"),
            latency_frames: s.count(
                "latency_frames",
                resolve_frames / 2,
                "frames",
                0..=1_000_000_000,
                "from request to effect (lockstep)"),
            queue: s.count("queue", 64, "messages", 1..=65_536, "capacity of the queues between actors"),
            threads: s.count(
                "threads",
                1,
                "",
                1..=256,
                "for each matrix product, of the stream and of the solvers beside it; results do not depend on it"),
            compute: s.choice(
                "compute",
                &[("auto", Compute::Auto), ("cpu", Compute::Cpu), ("gpu", Compute::Gpu)],
                "who computes kernel values of the window; auto: a graphics processor, where that is faster; results do not depend on it"),
            memory_gb: s.number_or_auto(
                "memory_gb",
                "GB",
                above(0.0, 1e6),
                "most memory; auto: four fifths of what the machine has",
            ),
            over_memory: s.choice(
                "over_memory",
                &[("refuse", OverMemory::Refuse), ("shrink", OverMemory::Shrink)],
                "a scenario that needs more is refused, or its budget of support vectors is lowered"),
            when_behind: s.choice(
                "when_behind",
                &[("wait", WhenBehind::Wait), ("drop", WhenBehind::Drop)],
                "frames wait until they are learned from, or some are dropped, never the last one of an action (realtime only)"),
            speed: s.number_or_auto(
                "speed",
                "times real time",
                within(0.01, 1e6),
                "of a simulated robot; auto: as fast as its frames are taken",
            ),
            snapshot_minutes: s.number(
                "snapshot_minutes",
                10.0,
                "min",
                within(0.0, 1e6),
                "between two states from which the run can go on; 0: only when it is interrupted",
            ),
        }
    }
}

impl Log {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Log {
            compression: s.choice(
                "compression",
                &[("zstd", Compression::Zstd), ("lz4", Compression::Lz4), ("none", Compression::None)],
                "of chunks",
            ),
            chunk_bytes: s.count(
                "chunk_bytes",
                262_144,
                "bytes",
                1024..=MAX_CHUNK_TARGET_BYTES as usize,
                "size of a chunk before compression",
            ),
            flush_seconds: s.number("flush_seconds", 1.0, "s", above(0.0, 1.0), "longest time in memory only"),
            file_mb: s.number(
                "file_mb",
                1000.0,
                "MB",
                within(0.1, 1e9),
                "a file that is larger is closed, and the next one begun",
            ),
            file_minutes: s.number_or_auto(
                "file_minutes",
                "min",
                within(0.01, 1e9),
                "a file that is older is closed; auto: never for its age",
            ),
            budget_mb: s.number_or_auto(
                "budget_mb",
                "MB",
                within(0.2, 1e12),
                "all files together; beyond, this run's oldest are deleted; auto: none is",
            ),
        }
    }
}
