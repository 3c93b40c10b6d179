//! Says zero when the loop of control does not say anything.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use super::listen::Threads;

/// Silence after which zero is said, real time.
const SILENCE: Duration = Duration::from_millis(250);

/// Time between looks, and between zeros.
const INTERVAL: Duration = Duration::from_millis(50);

/// A thread that says zero by a publisher of its own, from a steady clock, as long as nobody beats.
pub struct Watchdog {
    beaten: Arc<AtomicU64>,
    begun: Instant,
    _thread: Threads,
}

impl Watchdog {
    /// Start it; `zero` publishes a velocity of zero.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn start(zero: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let (beaten, begun, mut thread) = (Arc::new(AtomicU64::new(0)), Instant::now(), Threads::default());
        let seen = beaten.clone();
        thread.spawn("watchdog", move |over| {
            while !over.load(Ordering::Relaxed) {
                std::thread::sleep(INTERVAL);
                let last = Duration::from_millis(seen.load(Ordering::Relaxed));
                if begun.elapsed().saturating_sub(last) > SILENCE {
                    zero();
                }
            }
        })?;
        Ok(Watchdog { beaten, begun, _thread: thread })
    }

    /// The loop of control goes on.
    pub fn beat(&self) {
        self.beaten.store(self.begun.elapsed().as_millis() as u64, Ordering::Relaxed);
    }
}
