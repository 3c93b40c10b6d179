//! The loop of the learn actor.

use std::sync::atomic::Ordering;
use std::time::Instant;

use super::super::messages::{Item, SolveRequest};
use super::super::record::{Level, Recorder};
use super::{Learn, Learning, Seen};
use crate::agent::error::{LearnError, RunError};
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::marker::{Marker, Quiescence};
use crate::agent::runtime::queue::{Closed, Inbox, Outbox};
use crate::agent::runtime::status::Status;

/// What the learn actor has when it ends.
pub struct LearnResult {
    pub quarantined: u64,
    pub support_vectors: usize,
    pub nu: Option<f64>,
    pub clock: Clock,
}

/// The learn actor's surroundings.
pub struct LearnLoop<'a> {
    pub solve: Outbox<Item<SolveRequest>>,
    pub record: Recorder,
    pub status: &'a Status,
    pub quiescence: &'a Quiescence,
}

impl LearnLoop<'_> {
    /// Learn from frames until there are no more.
    pub fn run(&self, mut learn: Learn, frames: &Inbox<Item<Seen>>) -> Result<LearnResult, RunError> {
        let mut done = LearnResult { quarantined: 0, support_vectors: 0, nu: None, clock: Clock::new() };
        loop {
            let seen = match frames.take() {
                Ok(Item::Work(seen)) => seen,
                Ok(Item::Save(marker)) => {
                    self.save(&mut learn, marker);
                    continue;
                }
                Err(Closed) => {
                    // All that a run that goes on has learned by now is in the log before its end, what finishes the run behind it. Whoever
                    // is gone by now has failed, and that is reported.
                    if let Some(frame) = learn.last_number {
                        let _ = self.record.end(frame, learn.stamp_ns);
                    }
                    let last = match learn.finish() {
                        // It was stopped before there was enough to learn from: there is no model, and that is no failure.
                        Err(LearnError::Width(_)) if !learn.has_all_frames() => Learning::default(),
                        last => last?,
                    };
                    let _ = self.deliver(last, &mut done);
                    return Ok(done);
                }
            };
            let begin = Instant::now();
            let has_room = self.solve.has_room() && !self.quiescence.hold.load(Ordering::Relaxed);
            let learned = learn.step(seen, has_room)?;
            if self.deliver(learned, &mut done).is_err() {
                return Ok(done);
            }
            done.clock.keep(begin.elapsed());
            if let Some(p99) = done.clock.p99_now_and_then() {
                self.status.update(|s| s.frame_p99_ms = p99);
            }
        }
    }

    /// Add what was learned to the state of the run, and pass it on. If a model was asked for after the state began, that one
    /// belongs to neither side of it: it is given up, and begun again at the next occasion.
    fn save(&self, learn: &mut Learn, mut marker: Box<Marker>) {
        // In any case models may be asked for again.
        self.quiescence.hold.store(false, Ordering::Relaxed);
        if self.quiescence.requests.load(Ordering::Relaxed) != marker.requests {
            return;
        }
        if marker.snapshot.inner("learn", learn).is_ok() {
            let _ = self.solve.put(Item::Save(marker));
        }
    }

    fn deliver(&self, learned: Learning, done: &mut LearnResult) -> Result<(), Closed> {
        let (record, status) = (&self.record, self.status);
        if let Some(growth) = learned.growth {
            done.support_vectors = growth.size;
            done.nu = growth.nu;
            if growth.began_anew.is_some() {
                // These are among the frames that it is chosen from again.
                done.quarantined = 0;
            }
            done.quarantined += growth.quarantined.len() as u64;
            status.update(|s| (s.support_vectors, s.quarantined) = (growth.size, done.quarantined));
            if !growth.quarantined.is_empty() {
                let text = format!("frames {:?} are left out: their values are not finite", growth.quarantined);
                record.diagnostic(Level::Warn, growth.stamp_ns, text)?;
            }
            if let Some(before) = growth.began_anew {
                let text = format!(
                    "the kernel width that the first frames gave, {before:.0}, is too narrow for those behind them: support vectors are \
                     chosen anew from all frames, with {:.0}",
                    growth.sigma
                );
                record.diagnostic(Level::Info, growth.stamp_ns, text)?;
            }
            record.growth(growth)?;
        }
        let Some(request) = learned.request else { return Ok(()) };
        self.quiescence.requests.fetch_add(1, Ordering::Relaxed);
        record.request(request.asked_at, request.stamp_ns, request.frames, request.window.len())?;
        self.solve.put(Item::Work(request))
    }
}
