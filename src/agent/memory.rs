//! What a run will hold in memory, and what the machine has.

use super::perceive::stream_options;
use crate::dictionary::WhenFull;
use crate::scenario::{Scenario, SelectionRule};
use crate::slow::{Method, SlowStream, solve_bytes};

/// Bytes of everything that grows with the settings of a run, at its full size.
///
/// With `m` support vectors (the budget), `d` values of an observation, `r` retained frames, `k` features and `N`
/// transitions in the window:
///
/// | part | bytes |
/// |---|---|
/// | stream: dictionary, moments, retained frames | `24m² + 4md + r(8m + 4d)` and what [`SlowStream::bytes`] adds |
/// | requests: copies of dictionary and moments, one with the solver, one that waits | `2(24m² + 4md)` |
/// | solver | [`solve_bytes`]: about `8m² + 48mk` |
/// | values: the window, its features, policy iteration | `N(d + 48(k + 1)) + 216(k + 1)²` |
///
/// Beside it stand the program, images and messages in the queues, and what the allocator keeps.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Memory {
    /// Name and bytes of each part.
    pub parts: Vec<(&'static str, u64)>,
}

impl Memory {
    /// What a scenario will need.
    pub fn of(s: &Scenario) -> Self {
        // Where members can leave, a block may exceed the budget before they do.
        let exceeds = s.dictionary.selection != SelectionRule::Ald || s.dictionary.when_full != WhenFull::Stop;
        let m = s.dictionary.budget + if exceeds { s.dictionary.block_frames } else { 0 };
        let d = 3 * s.vision.width * s.vision.height;
        let mut stream = stream_options(s);
        stream.retained = stream.retained.min(s.actions.saturating_mul(s.robot.frames_per_action));
        let (k, n) = (s.slow.features as u64 + 1, s.value.window.min(s.actions) as u64);
        Memory {
            parts: vec![
                ("stream", SlowStream::<f32>::bytes(&stream, m, d, s.dictionary.block_frames)),
                ("requests", 2 * (24 * m * m + 4 * m * d) as u64),
                ("solver", solve_bytes(m, s.slow.features, Method::Automatic) as u64),
                ("values", n * (d as u64 + 48 * k) + 216 * k * k),
            ],
        }
    }

    /// All parts together.
    pub fn total(&self) -> u64 {
        self.parts.iter().map(|part| part.1).sum()
    }
}

/// The memory that this process may use at most, bytes: that of the machine, or of the control group that it runs in;
/// `None` where the system does not say.
pub fn machine_memory() -> Option<u64> {
    let machine = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = machine.lines().find_map(|line| line.strip_prefix("MemTotal:"))?;
    let bytes = 1024 * line.split_whitespace().next()?.parse::<u64>().ok()?;
    let group = std::fs::read_to_string("/sys/fs/cgroup/memory.max").ok();
    // It reads "max" where there is no limit.
    let limit = group.and_then(|text| text.trim().parse::<u64>().ok());
    Some(limit.map_or(bytes, |limit| limit.min(bytes)))
}
