//! What a run will hold in memory, and what the machine has.

use crate::dictionary::WhenFull;
use crate::scenario::{Scenario, SelectionRule};

/// Bytes of everything that grows with the settings of a run, at its full size.
///
/// With `m` support vectors (the budget), `d` values of an observation, `r` retained frames, `k` features and `N`
/// transitions in the window:
///
/// | part | bytes |
/// |---|---|
/// | dictionary | `8m² + 4md` |
/// | moments | `16m²` |
/// | retained frames | `r(8m + 4d)` |
/// | request: a copy of dictionary and moments that waits for the solver | `24m² + 4md` |
/// | solver | `48m²` |
/// | values | `N(d + 24(k + 1)) + 72(k + 1)²` |
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
        let m = (s.dictionary.budget + if exceeds { s.dictionary.block_frames } else { 0 }) as u64;
        let d = 3 * (s.vision.width * s.vision.height) as u64;
        let r = s.dictionary.retained_frames.min(s.actions.saturating_mul(s.robot.frames_per_action)) as u64;
        let (k, n) = (s.slow.features as u64 + 1, s.value.window.min(s.actions) as u64);
        let square = 8 * m * m;
        let dictionary = square + 4 * m * d;
        let moments = 2 * square;
        Memory {
            parts: vec![
                ("dictionary", dictionary),
                ("moments", moments),
                ("retained frames", r * (8 * m + 4 * d)),
                ("request", dictionary + moments),
                ("solver", 6 * square),
                ("values", n * (d + 24 * k) + 72 * k * k),
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
