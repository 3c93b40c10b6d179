//! Says zero when the loop of control does not say anything.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Silence after which zero is said, real time.
const SILENCE: Duration = Duration::from_millis(250);

/// Time between looks, and between zeros.
const INTERVAL: Duration = Duration::from_millis(50);

/// A thread that says zero by a publisher of its own, from a steady clock, as long as nobody beats.
pub struct Watchdog {
    beaten: Arc<AtomicU64>,
    over: Arc<AtomicBool>,
    begun: Instant,
    thread: Option<JoinHandle<()>>,
}

impl Watchdog {
    /// Start it; `zero` publishes a velocity of zero.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn start(zero: impl Fn() + Send + 'static) -> std::io::Result<Self> {
        let (beaten, over, begun) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)), Instant::now());
        let (seen, ended) = (beaten.clone(), over.clone());
        let watch = move || {
            while !ended.load(Ordering::Relaxed) {
                std::thread::sleep(INTERVAL);
                let last = Duration::from_millis(seen.load(Ordering::Relaxed));
                if begun.elapsed().saturating_sub(last) > SILENCE {
                    zero();
                }
            }
        };
        let thread = Some(std::thread::Builder::new().name("watchdog".into()).spawn(watch)?);
        Ok(Watchdog { beaten, over, begun, thread })
    }

    /// The loop of control goes on.
    pub fn beat(&self) {
        self.beaten.store(self.begun.elapsed().as_millis() as u64, Ordering::Relaxed);
    }
}

impl Drop for Watchdog {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
