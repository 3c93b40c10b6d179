//! The loop of the perceive actor.

use std::sync::atomic::Ordering;
use std::time::Instant;

use super::super::messages::{Item, Percept, SolveRequest};
use super::super::record::{Level, Recorder};
use super::{Learning, Perceive, SeenFrame};
use crate::agent::error::RunError;
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::marker::{Marker, Quiescence};
use crate::agent::runtime::queue::{Closed, Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::source::Frame;

/// What the perceive actor has when it ends.
pub struct PerceiveResult {
    pub frames: u64,
    pub quarantined: u64,
    pub support_vectors: usize,
    pub nu: Option<f64>,
    pub clock: Clock,
}

/// The perceive actor's surroundings.
pub struct PerceiveLoop<'a> {
    pub percepts: Outbox<Percept>,
    pub solve: Outbox<Item<SolveRequest>>,
    pub record: Recorder,
    pub status: &'a Status,
    pub quiescence: &'a Quiescence,
}

impl PerceiveLoop<'_> {
    /// The perceive actor. A percept leaves before its block is learned from, so that control does not wait for learning.
    pub fn run(&self, mut perceive: Perceive, frames: &Inbox<Item<Frame>>) -> Result<PerceiveResult, RunError> {
        let (record, status) = (&self.record, self.status);
        let mut done = PerceiveResult { frames: 0, quarantined: 0, support_vectors: 0, nu: None, clock: Clock::new() };
        // A run that goes on does so behind the last frame of an action.
        let (seen, mut last_number) = perceive.progress();
        let mut last_boundary = last_number;
        done.frames = seen;
        loop {
            let frame = match frames.take() {
                Ok(Item::Work(frame)) => frame,
                Ok(Item::Save(marker)) => {
                    self.save(&mut perceive, marker);
                    continue;
                }
                Err(Closed) => {
                    if let Some(frame) = last_number {
                        let _ = record.end(frame, status.now().stamp_ns);
                    }
                    let last = match perceive.finish() {
                        // It was stopped before there was enough to learn from: there is no model, and that is no failure.
                        Err(_) if !perceive.has_all_frames() => Learning::default(),
                        last => last?,
                    };
                    // Whoever is gone by now has failed, and that is reported.
                    let _ = self.deliver(last, &mut done);
                    return Ok(done);
                }
            };
            let begin = Instant::now();
            let (stamp, action, goto) = (frame.stamp_ns, frame.action, frame.goto);
            let mut sent = record.frame(&frame);
            // Frames are missing before this one: the outcome of the action is not known.
            if last_number.replace(frame.number).is_none_or(|last| last + 1 != frame.number) {
                last_boundary = None;
            }
            let SeenFrame { observation, percept, moved, marks, refused } = perceive.see(frame);
            // With an observation, a replay has the whole frame.
            sent = sent.and_then(|()| record.goals(&moved, observation.frame, stamp));
            sent = sent.and_then(|()| record.marks(&marks, observation.frame, stamp));
            sent = sent.and_then(|()| record.goto(goto, observation.frame, stamp));
            sent = sent.and_then(|()| record.observation(&observation, stamp));
            for text in refused {
                sent = sent.and_then(|()| record.diagnostic(Level::Warn, stamp, text));
            }
            if let Some(percept) = percept {
                let before = last_boundary.replace(observation.frame);
                if let (Some(from), Some(action)) = (before, action) {
                    sent = sent.and_then(|()| record.transition(from, action, &percept));
                }
                sent = sent.and_then(|()| self.percepts.put(percept));
            }
            let has_room = self.solve.has_room() && !self.quiescence.hold.load(Ordering::Relaxed);
            let learned = perceive.learn(has_room)?;
            done.frames += 1;
            if sent.and_then(|()| self.deliver(learned, &mut done)).is_err() {
                return Ok(done);
            }
            done.clock.keep(begin.elapsed());
            let p99 = done.clock.p99_now_and_then();
            status.update(|s| {
                (s.frames, s.stamp_ns) = (done.frames, stamp);
                s.frame_p99_ms = p99.unwrap_or(s.frame_p99_ms);
            });
        }
    }

    /// Add what was learned to the state of the run, and pass it on. If a model was asked for after the state began, that one
    /// belongs to neither side of it: it is given up, and begun again at the next occasion.
    fn save(&self, perceive: &mut Perceive, mut marker: Box<Marker>) {
        // In any case models may be asked for again.
        self.quiescence.hold.store(false, Ordering::Relaxed);
        if self.quiescence.requests.load(Ordering::Relaxed) != marker.requests {
            return;
        }
        if marker.snapshot.inner("perceive", perceive).is_ok() {
            let _ = self.solve.put(Item::Save(marker));
        }
    }

    fn deliver(&self, learned: Learning, done: &mut PerceiveResult) -> Result<(), Closed> {
        let (record, status) = (&self.record, self.status);
        if let Some(growth) = learned.growth {
            done.support_vectors = growth.size;
            done.nu = growth.nu;
            done.quarantined += growth.quarantined.len() as u64;
            status.update(|s| (s.support_vectors, s.quarantined) = (growth.size, done.quarantined));
            if !growth.quarantined.is_empty() {
                let text = format!("frames {:?} are left out: their values are not finite", growth.quarantined);
                record.diagnostic(Level::Warn, growth.stamp_ns, text)?;
            }
            record.growth(growth)?;
        }
        let Some(request) = learned.request else { return Ok(()) };
        self.quiescence.requests.fetch_add(1, Ordering::Relaxed);
        record.request(&request)?;
        self.solve.put(Item::Work(request))
    }
}
