//! The health actor: how the run is doing, once a second.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::record::{Level, Recorder};
use crate::agent::runtime::status::{Status, resident_bytes};
use crate::gpu::Choice;

/// How often the run's health goes into the log.
const HEALTH_INTERVAL: Duration = Duration::from_secs(1);

/// Its loop, until the run is `over`.
pub fn run(record: &Recorder, status: &Status, rendered_by: impl Fn() -> Option<Choice>, over: &AtomicBool) {
    let (mut last, mut frames) = (Instant::now(), 0);
    let mut told = false;
    loop {
        std::thread::sleep(Duration::from_millis(20));
        // Once more at the end: it counts all that was dropped.
        let ends = over.load(Ordering::Relaxed);
        if last.elapsed() < HEALTH_INTERVAL && !ends {
            continue;
        }
        let now = status.now();
        let rate = (now.frames - frames) as f64 / last.elapsed().as_secs_f64();
        (last, frames) = (Instant::now(), now.frames);
        // From about here on pictures are another renderer's.
        let failed = rendered_by().and_then(|by| by.failed).filter(|_| !told);
        if let Some(failed) = failed {
            told = true;
            let text = format!("images: {failed}; the processor goes on");
            let _ = record.diagnostic(Level::Warn, now.stamp_ns, text);
        }
        if record.health(&now, rate, resident_bytes().unwrap_or(0)).is_err() || ends {
            return;
        }
    }
}
