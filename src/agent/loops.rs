//! The loops that run the actors on their threads: take from queues, step, put into queues.
//!
//! An actor whose neighbour is gone ends quietly: the neighbour has ended for a reason, and that one is reported.

use std::convert::Infallible;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::checkpoint::{checkpoint_bytes, write_checkpoint, write_state};
use super::clock::Clock;
use super::controls::Controls;
use super::decide::Keep;
use super::keep::{Mark, Quiet};
use super::messages::{Item, Percept, SolveRequest};
use super::perceive::{self, Perceive, Sight};
use super::queue::{Closed, Inbox, Outbox};
use super::record::{Level, Recorder};
use super::run::{CurvePoint, RunError};
use super::status::{Status, resident_bytes};
use crate::evaluate::{Evaluator, TaskResult, overlap};
use crate::policy::Learned;
use crate::scenario::Scenario;
use crate::source::{Frame, Source};
use crate::world::{Action, Looks};

/// How often the run's health goes into the log.
const HEALTH_INTERVAL: Duration = Duration::from_secs(1);

/// Number of features, from the slowest on, whose drift from model to model is told.
const DRIFTING: usize = 20;

/// Longest time that the source waits for the state of the run to be on its way.
const HAND_OVER: Duration = Duration::from_secs(10);

/// What the perceive actor has when it ends.
pub struct Perceived {
    pub frames: u64,
    pub quarantined: u64,
    pub support_vectors: usize,
    pub nu: Option<f64>,
    pub clock: Clock,
}

/// How the source actor hands on its frames.
pub struct Supply<'a> {
    pub actions: Inbox<Item<Action>>,
    pub frames: Outbox<Item<Frame>>,
    /// The other end of `frames`, where frames that are not taken in time are dropped.
    pub drop_from: Option<Inbox<Item<Frame>>>,
    /// The source stands behind a frame that was given already: the run goes on.
    pub goes_on: bool,
    pub quiet: &'a Quiet,
    /// Times real time at which frames come; `None`: as fast as they are taken.
    pub speed: Option<f64>,
    pub controls: Option<&'a Controls>,
    pub status: &'a Status,
}

impl Supply<'_> {
    /// The source actor: the first frame, then the frames of each action. The last frame of an action is never dropped: nothing
    /// comes after it before it was seen and answered.
    pub fn run(self, source: &mut (dyn Source + Send)) {
        let (mut first_ns, mut next) = (None, None);
        let begin = Instant::now();
        let mut give = |mut frame: Frame| {
            // The last frame of an action is never dropped.
            if let (Some(controls), Some(_)) = (self.controls, frame.boundary) {
                frame.moved.extend(controls.take_moves());
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
                Item::Save(mut mark) => {
                    if mark.parts.scope("source", |parts| source.persist(parts)).is_err() {
                        // A robot cannot be put away; its runs go on from their logs.
                        self.quiet.hold.store(false, Ordering::Relaxed);
                        continue;
                    }
                    if self.frames.put(Item::Save(mark)).is_err() {
                        return;
                    }
                    self.wait_until_taken();
                    continue;
                }
            };
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

/// The perceive actor's surroundings.
pub struct Perceiving<'a> {
    pub percepts: Outbox<Percept>,
    pub solve: Outbox<Item<SolveRequest>>,
    pub record: Recorder,
    pub status: &'a Status,
    pub quiet: &'a Quiet,
}

impl Perceiving<'_> {
    /// The perceive actor. A percept leaves before its block is learned from, so that control does not wait for learning.
    pub fn run(&self, mut perceive: Perceive, frames: &Inbox<Item<Frame>>) -> Result<Perceived, RunError> {
        let (record, status) = (&self.record, self.status);
        let mut done = Perceived { frames: 0, quarantined: 0, support_vectors: 0, nu: None, clock: Clock::new() };
        // A run that goes on does so behind the last frame of an action.
        let (seen, mut last_number) = perceive.progress();
        let mut last_boundary = last_number;
        done.frames = seen;
        loop {
            let frame = match frames.take() {
                Ok(Item::Work(frame)) => frame,
                Ok(Item::Save(mark)) => {
                    self.save(&mut perceive, mark);
                    continue;
                }
                Err(Closed) => {
                    if let Some(frame) = last_number {
                        let _ = record.end(frame, status.snapshot().stamp_ns);
                    }
                    let last = match perceive.finish() {
                        // It was stopped before there was enough to learn from: there is no model, and that is no failure.
                        Err(_) if !perceive.has_all_frames() => perceive::Learning::default(),
                        last => last?,
                    };
                    // Whoever is gone by now has failed, and that is reported.
                    let _ = self.deliver(last, &mut done);
                    return Ok(done);
                }
            };
            let begin = Instant::now();
            let (stamp, action) = (frame.stamp_ns, frame.action);
            let mut sent = record.frame(&frame);
            // Frames are missing before this one: what the action came to cannot be told.
            if last_number.replace(frame.number).is_none_or(|last| last + 1 != frame.number) {
                last_boundary = None;
            }
            let Sight { observation, percept, moved } = perceive.see(frame);
            // With an observation, a replay has the whole frame.
            sent = sent.and_then(|()| record.goals(&moved, observation.frame, stamp));
            sent = sent.and_then(|()| record.observation(&observation, stamp));
            if let Some(percept) = percept {
                let before = last_boundary.replace(observation.frame);
                if let (Some(from), Some(action)) = (before, action) {
                    sent = sent.and_then(|()| record.transition(from, action, &percept));
                }
                sent = sent.and_then(|()| self.percepts.put(percept));
            }
            let has_room = self.solve.has_room() && !self.quiet.hold.load(Ordering::Relaxed);
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
    fn save(&self, perceive: &mut Perceive, mut mark: Box<Mark>) {
        // In any case models may be asked for again.
        self.quiet.hold.store(false, Ordering::Relaxed);
        if self.quiet.requests.load(Ordering::Relaxed) != mark.requests {
            return;
        }
        if mark.parts.inner("perceive", perceive).is_ok() {
            let _ = self.solve.put(Item::Save(mark));
        }
    }

    fn deliver(&self, learned: perceive::Learning, done: &mut Perceived) -> Result<(), Closed> {
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
        self.quiet.requests.fetch_add(1, Ordering::Relaxed);
        record.request(&request)?;
        self.solve.put(Item::Work(request))
    }
}

/// The assess actor: keeps every model in the run's folder, and runs trials with it beside the run.
pub fn assess(
    models: &Inbox<(Arc<Learned>, u64)>,
    evaluator: Option<&Evaluator>,
    checkpoint: Option<&Path>,
    scenario: &Scenario,
    record: &Recorder,
    status: &Status,
    mut curve: Vec<CurvePoint>,
) -> Result<Vec<CurvePoint>, RunError> {
    let every = scenario.evaluate.every as u32;
    let mut last: Option<faer::Mat<f64>> = None;
    while let Ok((learned, stamp_ns)) = models.take() {
        if let Some(path) = checkpoint {
            write_checkpoint(path, &checkpoint_bytes(&learned, scenario)?)?;
        }
        let Some(evaluator) = evaluator.filter(|_| every > 0 && learned.epoch.is_multiple_of(every)) else { continue };
        let results = evaluator.evaluate(&learned, false);
        let features = evaluator.features(&learned, DRIFTING);
        let before = last.replace(features.clone());
        // Features that are not finite have no angle.
        let alike = before.and_then(|before| overlap(before.as_ref(), features.as_ref()).ok());
        let drift = alike.map(|(mean, _)| mean.clamp(0.0, 1.0).sqrt().acos().to_degrees());
        let point = curve_point(&learned, &results, scenario, drift);
        status.update(|s| s.success = Some(point.success));
        curve.push(point);
        if record.evaluation(&results, &learned, stamp_ns).is_err() {
            break;
        }
    }
    Ok(curve)
}

/// The keep actor: writes the states of the run, each after everything before it is in the log. What it returns is why the last
/// one could not be written, if so: what is in the log is not lost, and the run goes on.
pub fn keep(
    marks: &Inbox<Item<Infallible>>,
    keep: Option<&Keep>,
    scenario: &Scenario,
    record: &Recorder,
) -> Result<Option<String>, RunError> {
    let mut failure = None;
    while let Ok(Item::Save(mark)) = marks.take() {
        let Some(keep) = keep else { continue };
        if record.flush().is_err() {
            break;
        }
        let (frame, stamp) = (mark.frame, mark.stamp_ns);
        failure = write_state(&keep.path, *mark, scenario).err();
        if let Some(error) = &failure {
            let text = format!("the state after frame {frame} is not kept: {error}");
            let _ = record.diagnostic(Level::Warn, stamp, text);
        }
    }
    Ok(failure.map(|error| error.to_string()))
}

/// One evaluation as a point of the curve.
fn curve_point(
    learned: &Learned,
    results: &[TaskResult],
    scenario: &Scenario,
    feature_drift_deg: Option<f64>,
) -> CurvePoint {
    let tasks = results.len() as f64;
    let slowness = &learned.model.slowness;
    CurvePoint {
        frames: learned.frames,
        actions: (learned.frames - 1) / scenario.robot.frames_per_action as u64,
        support_vectors: learned.model.members.ncols(),
        success: results.iter().map(|result| result.success).sum::<f64>() / tasks,
        convergence_quality: results.iter().map(|result| result.convergence_quality).sum::<f64>() / tasks,
        slowness_mean: slowness.iter().sum::<f64>() / slowness.len() as f64,
        feature_drift_deg,
    }
}

/// The health actor: how the run is doing, once a second.
pub fn watch_health(record: &Recorder, status: &Status, looks: &Looks, over: &AtomicBool) {
    let (mut last, mut frames) = (Instant::now(), 0);
    let mut told = false;
    loop {
        std::thread::sleep(Duration::from_millis(20));
        // Once more at the end: it counts all that was dropped.
        let ends = over.load(Ordering::Relaxed);
        if last.elapsed() < HEALTH_INTERVAL && !ends {
            continue;
        }
        let now = status.snapshot();
        let rate = (now.frames - frames) as f64 / last.elapsed().as_secs_f64();
        (last, frames) = (Instant::now(), now.frames);
        // From about here on pictures are another renderer's.
        let failed = looks.rendered_by().and_then(|by| by.failed).filter(|_| !told);
        if let Some(failed) = failed {
            told = true;
            let text = format!("pictures: {failed}; the processor goes on");
            let _ = record.diagnostic(Level::Warn, now.stamp_ns, text);
        }
        if record.health(&now, rate, resident_bytes().unwrap_or(0)).is_err() || ends {
            return;
        }
    }
}
