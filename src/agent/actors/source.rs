//! The source actor: takes actions to the robot and hands on its frames.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::messages::Item;
use super::record::{Level, Recorder};
use crate::agent::runtime::controls::Controls;
use crate::agent::runtime::marker::Quiescence;
use crate::agent::runtime::queue::{Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::robot::Action;
use crate::source::live::Event;
use crate::source::{Frame, Source};

/// Longest time that the source waits until a snapshot has been taken out of the queue of frames.
const HAND_OVER: Duration = Duration::from_secs(10);

/// Where a robot's loop of control waits longer than this for the log, people are told: the robot stands meanwhile.
const LOG_WAIT: Duration = Duration::from_secs(1);

/// How the source actor hands on its frames.
pub struct SourceLoop<'a> {
    pub actions: Inbox<Item<Action>>,
    pub frames: Outbox<Item<Frame>>,
    /// The other end of `frames`, where frames that are not taken in time are dropped.
    pub drop_from: Option<Inbox<Item<Frame>>>,
    /// The source stands behind a frame that was given already: the run goes on.
    pub goes_on: bool,
    pub quiescence: &'a Quiescence,
    /// Times real time at which frames come; `None`: as fast as they are taken.
    pub speed: Option<f64>,
    pub controls: Option<&'a Controls>,
    pub status: &'a Status,
    pub record: Recorder,
}

impl SourceLoop<'_> {
    /// The source actor: the first frame, then the frames of each action. The last frame of an action is never dropped: nothing
    /// comes after it before it was seen and answered.
    pub fn run(self, source: &mut (dyn Source + Send)) {
        let (record, status) = (self.record.clone(), self.status.clone());
        source.keep_journal(Some(Box::new(move |event| {
            if let Event::Changed { state, causes, .. } = &event {
                let why = if causes.is_none() { String::new() } else { format!(": {causes}") };
                status.update(|s| s.robot = Some(format!("{}{why}", state.name())));
            }
            let begun = Instant::now();
            // A closed log ends the run at the next decision.
            let _ = record.robot(event);
            let waited = begun.elapsed();
            if waited > LOG_WAIT {
                let text = format!(
                    "the loop of control waited {:.1} s for the log: its disk is slow, or this program was stopped",
                    waited.as_secs_f64()
                );
                let _ = record.diagnostic(Level::Warn, status.now().stamp_ns, text);
            }
        })));
        self.drive(source);
        source.keep_journal(None);
    }

    fn drive(&self, source: &mut (dyn Source + Send)) {
        let (mut first_ns, mut next) = (None, None);
        let begin = Instant::now();
        let mut give = |mut frame: Frame| {
            if let Some(controls) = self.controls {
                frame.marks.extend(controls.take_marks(frame.boundary.is_some()));
                // The last frame of an action is never dropped.
                if frame.boundary.is_some() {
                    // In this order: whoever sends it to a goal that was just moved means where that is now.
                    frame.goto = controls.take_goto().or(frame.goto);
                    frame.moved.extend(controls.take_moves());
                }
            }
            let first_ns = *first_ns.get_or_insert(frame.stamp_ns);
            if let Some(speed) = self.speed {
                let due = Duration::from_nanos(frame.stamp_ns.saturating_sub(first_ns)).div_f64(speed);
                let paused = self.controls.map_or(Duration::ZERO, Controls::paused_for);
                std::thread::sleep(due.saturating_sub(begin.elapsed().saturating_sub(paused)));
            }
            // A camera may lose frames, too.
            let lost = next.replace(frame.number + 1).map_or(0, |next| frame.number.saturating_sub(next));
            if lost > 0 {
                self.status.update(|s| s.dropped += lost);
            }
            let frame = Item::Work(frame);
            let Some(taker) = &self.drop_from else { return self.frames.put(frame).is_ok() };
            let dropped = self.frames.put_newest(frame, taker);
            if dropped > 0 {
                self.status.update(|s| s.dropped += dropped);
            }
            true
        };
        if !self.goes_on && !source.first().is_some_and(&mut give) {
            return;
        }
        while let Ok(order) = self.actions.take() {
            let action = match order {
                Item::Work(action) => action,
                Item::Save(mut marker) => {
                    if marker.snapshot.scope("source", |snapshot| source.persist(snapshot)).is_err() {
                        // A robot cannot be saved; its runs go on from their logs.
                        self.quiescence.hold.store(false, Ordering::Relaxed);
                        continue;
                    }
                    if self.frames.put(Item::Save(marker)).is_err() {
                        return;
                    }
                    self.wait_until_taken();
                    continue;
                }
            };
            let action = self.controls.map_or(action, |controls| controls.instead_of(action));
            let mut open = true;
            let more = source.execute(action, &mut |frame| {
                open = give(frame);
                open
            });
            if !(open && more) {
                return;
            }
        }
    }

    /// Where frames are dropped, the state of the run must not be among them: no frame follows it into the queue before it was
    /// taken out.
    fn wait_until_taken(&self) {
        if let Some(taker) = &self.drop_from {
            taker.wait_until_empty(HAND_OVER);
        }
    }
}
