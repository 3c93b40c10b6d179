//! Learning elsewhere: frames go to the learner of a fleet in batches, and its models come back.
//!
//! Two actors take the place of learn, solve and fit. [`Gather`] puts frames together until a model is due, as the learn actor would;
//! [`exchange`] hands them over and waits for the model. Where nobody answers, the robot goes on with the model that it has.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::learn::saved::{put_samples, take_samples};
use super::learn::{LearnResult, Sample, Seen};
use super::messages::{Item, Marked, Update};
use super::record::Recorder;
use super::saved::{Observations, SavedMark};
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::queue::{Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::agent::runtime::timing::ModelTiming;
use crate::scenario::Scenario;
use crate::snapshot::{Snapshot, SnapshotError};

/// How often a learner hears of a robot that has nothing to tell.
const BEAT: Duration = Duration::from_secs(1);

/// Frames of one robot in their order, none missing between them but where links say so.
#[derive(Default)]
pub struct Batch {
    /// The frames.
    pub samples: Vec<Sample>,
    /// All that is marked with the last of them.
    pub marks: Vec<Marked>,
}

impl Batch {
    /// Numbers of its first and its last frame.
    pub fn span(&self) -> Option<(u64, u64)> {
        let number = |sample: &Sample| sample.observation.frame;
        Some((number(self.samples.first()?), number(self.samples.last()?)))
    }

    /// Save or restore it.
    pub fn persist(&mut self, snapshot: &mut Snapshot, scenario: &Scenario) -> Result<(), SnapshotError> {
        let (mut seen, values) = (Observations::default(), scenario.vision.values());
        let mut marks: Vec<SavedMark> = self.marks.iter().map(|marked| seen.add_mark(marked)).collect();
        if snapshot.is_restoring() {
            seen.persist(snapshot, values)?;
            self.samples = take_samples(&seen, snapshot)?;
            snapshot.value("marks", &mut marks)?;
            self.marks = marks.into_iter().map(|mark| seen.mark(mark)).collect::<Result<_, _>>()?;
            let is_sorted = self.samples.is_sorted_by_key(|sample| sample.observation.frame);
            let names = scenario.names().count();
            snapshot.check("pending", is_sorted && !self.samples.is_empty(), "frames in their order are expected")?;
            snapshot.check("marks", self.marks.iter().all(|mark| mark.task < names), "of a task that there is not")
        } else {
            put_samples(&self.samples, &mut seen, snapshot)?;
            snapshot.value("marks", &mut marks)?;
            seen.persist(snapshot, values)
        }
    }
}

/// The learner of a fleet, as one of its robots sees it.
pub trait Fleet: Send {
    /// The model that is there already; none where robots have begun just now.
    fn newest(&mut self) -> Option<Update>;

    /// Hand over a batch, and wait for a model of it. Where nobody answers the batch is kept for later, and the answer says so. No model
    /// is waited for once `stop` is set.
    fn learn(&mut self, batch: Batch, stop: &AtomicBool) -> Update;

    /// Say that the robot is there.
    fn beat(&mut self);

    /// Say that the robot leaves: frames that are not handed over by then, and why.
    fn leave(&mut self) -> Option<String>;
}

/// Gathers frames until a model is due.
pub struct Gather {
    pub timing: Arc<ModelTiming>,
    pub batches: Outbox<Batch>,
    pub record: Recorder,
}

impl Gather {
    /// Gather until there are no more frames.
    pub fn run(self, frames: &Inbox<Item<Seen>>) -> LearnResult {
        let (mut batch, mut count, mut owed, mut refit, mut asked) = (Batch::default(), 0, false, false, false);
        let mut last = None;
        while let Ok(item) = frames.take() {
            // The state of a robot of a fleet is its learner's.
            let Item::Work(seen) = item else { continue };
            let (frame, stamp_ns) = (seen.sample.observation.frame, seen.stamp_ns);
            last = Some((frame, stamp_ns));
            count += 1;
            refit |= seen.changed && asked;
            batch.marks.clone_from(&seen.tasks.marks);
            batch.samples.push(seen.sample);
            owed |= self.timing.is_due(count);
            if !self.timing.asks(frame, owed || refit, self.batches.has_room()) {
                continue;
            }
            (owed, refit, asked) = (false, false, true);
            if self.record.request(frame, stamp_ns, count, 0).is_err()
                || self.batches.put(std::mem::take(&mut batch)).is_err()
            {
                break;
            }
        }
        // Whoever is gone by now has failed, and that is reported.
        if let Some((frame, stamp_ns)) = last {
            let _ = self.record.end(frame, stamp_ns);
        }
        if !batch.samples.is_empty() {
            let _ = self.batches.put(batch);
        }
        LearnResult { quarantined: 0, support_vectors: 0, nu: None, clock: Clock::new() }
    }
}

/// Hand batches over until there are no more: why some were not taken, if so, and how long models took.
pub fn exchange(
    fleet: &mut dyn Fleet,
    batches: &Inbox<Batch>,
    updates: &Outbox<Update>,
    status: &Status,
    stop: &AtomicBool,
) -> (Option<String>, Clock) {
    let mut clock = Clock::new();
    loop {
        match batches.take_within(BEAT) {
            Ok(None) => fleet.beat(),
            Ok(Some(batch)) => {
                let update = clock.time(|| fleet.learn(batch, stop));
                if let Ok(learned) = &update.learned {
                    let size = learned.model.members.ncols();
                    status.update(|s| s.support_vectors = size);
                }
                if updates.put(update).is_err() {
                    break;
                }
            }
            Err(_) => break,
        }
    }
    (fleet.leave(), clock)
}
