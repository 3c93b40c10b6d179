//! What can be seen of a run from outside: memory, files, queues, latencies, the log.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde::Serialize;

use crate::agent::{Status, resident_bytes};
use crate::lock::lock;
use crate::log::log_files;

/// Samples of a whole run.
const SAMPLES: u64 = 240;

/// Time between looks at whether a sample is due.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);

/// The run at one moment.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Sample {
    /// Hours of driving.
    pub hours: f64,
    /// Wall-clock time since the beginning, seconds.
    pub seconds: f64,
    /// Frames seen.
    pub frames: u64,
    /// Frames per second of wall-clock time since the last sample.
    pub frames_per_second: f64,
    /// Memory that the process holds, bytes; `None` where the system does not say.
    pub rss_bytes: Option<u64>,
    /// Files and the like that the process has open; `None` where the system does not say.
    pub open_files: Option<usize>,
    /// Bytes in all files of the log.
    pub log_bytes: u64,
    /// Name, depth and capacity of each queue.
    pub queues: Vec<(&'static str, usize, usize)>,
    /// 99th percentile so far of the time from percept to action, milliseconds.
    pub act_p99_ms: f64,
    /// 99th percentile so far of the time to learn from a frame, milliseconds.
    pub frame_p99_ms: f64,
    /// Support vectors.
    pub support_vectors: usize,
    /// Number of the model in use.
    pub epoch: u32,
    /// Frames that the source dropped so far.
    pub dropped: u64,
}

/// Takes samples of a run.
#[derive(Debug)]
pub struct Sampler {
    run: PathBuf,
    actions: u64,
    action_seconds: f64,
    samples: Mutex<Vec<Sample>>,
}

impl Sampler {
    /// A sampler of a run of so many actions in a folder.
    pub fn new(run: &Path, actions: u64, action_seconds: f64) -> Self {
        Sampler { run: run.to_owned(), actions, action_seconds, samples: Mutex::default() }
    }

    /// Watch until `over` is set; a last sample is taken then.
    pub fn watch(&self, status: &Status, over: &AtomicBool) {
        let begin = Instant::now();
        let (mut taken, mut last) = (0, (0, 0.0));
        loop {
            std::thread::sleep(LOOK_INTERVAL);
            let ends = over.load(Ordering::Relaxed);
            let now = status.now();
            let due = now.actions as u64 * SAMPLES / self.actions.max(1);
            if due <= taken && !ends {
                continue;
            }
            taken = due;
            let seconds = begin.elapsed().as_secs_f64();
            let frames_per_second = (now.frames - last.0) as f64 / (seconds - last.1).max(1e-9);
            last = (now.frames, seconds);
            let sample = Sample {
                hours: now.actions as f64 * self.action_seconds / 3600.0,
                seconds,
                frames: now.frames,
                frames_per_second,
                rss_bytes: resident_bytes(),
                open_files: std::fs::read_dir("/proc/self/fd").ok().map(Iterator::count),
                log_bytes: self.log_bytes(),
                queues: now.queues,
                act_p99_ms: now.act_p99_ms,
                frame_p99_ms: now.frame_p99_ms,
                support_vectors: now.support_vectors,
                epoch: now.epoch,
                dropped: now.dropped,
            };
            lock(&self.samples).push(sample);
            if ends {
                return;
            }
        }
    }

    /// All samples so far.
    pub fn samples(&self) -> Vec<Sample> {
        lock(&self.samples).clone()
    }

    fn log_bytes(&self) -> u64 {
        let files = log_files(&self.run).unwrap_or_default();
        files.iter().filter_map(|(_, path)| Some(path.metadata().ok()?.len())).sum()
    }
}
