//! The loops that run the actors on their threads: take from queues, step, put into queues.
//!
//! An actor whose neighbour is gone ends quietly: the neighbour has ended for a reason, and that one is reported.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::act::Act;
use super::checkpoint::{checkpoint_bytes, write_checkpoint};
use super::clock::Clock;
use super::messages::{Percept, SolveRequest, Update};
use super::perceive::{self, Perceive};
use super::queue::{Closed, Inbox, Outbox};
use super::record::{Level, Recorder};
use super::run::{CurvePoint, RunError};
use super::schedule::Schedule;
use super::status::{Status, resident_bytes};
use crate::evaluate::{Evaluator, TaskResult};
use crate::policy::{Learned, Tally};
use crate::scenario::{Mode, Scenario};
use crate::source::{Frame, Source};
use crate::world::Action;

/// How often the run's health goes into the log.
const HEALTH_INTERVAL: Duration = Duration::from_secs(1);

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
    pub actions: Inbox<Action>,
    pub frames: Outbox<Frame>,
    /// The other end of `frames`, where frames that are not taken in time are dropped.
    pub drop_from: Option<Inbox<Frame>>,
    /// Times real time at which frames come; `None`: as fast as they are taken.
    pub speed: Option<f64>,
    pub status: &'a Status,
}

impl Supply<'_> {
    /// The source actor: the first frame, then the frames of each action. The last frame of an action is never dropped: nothing
    /// comes after it before it was seen and answered.
    pub fn run(self, source: &mut (dyn Source + Send)) {
        let Some(first) = source.first() else { return };
        let (begin, first_ns) = (Instant::now(), first.stamp_ns);
        let give = |frame: Frame| {
            if let Some(speed) = self.speed {
                let due = Duration::from_nanos(frame.stamp_ns.saturating_sub(first_ns)).div_f64(speed);
                std::thread::sleep(due.saturating_sub(begin.elapsed()));
            }
            let Some(taker) = &self.drop_from else { return self.frames.put(frame).is_ok() };
            let dropped = self.frames.put_newest(frame, taker);
            if dropped > 0 {
                self.status.update(|s| s.dropped += dropped);
            }
            true
        };
        if !give(first) {
            return;
        }
        while let Ok(action) = self.actions.take() {
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
}

/// The perceive actor. A percept leaves before its block is learned from, so that control does not wait for learning.
pub fn perceive(
    scenario: &Arc<Scenario>,
    schedule: &Arc<Schedule>,
    frames: &Inbox<Frame>,
    percepts: &Outbox<Percept>,
    solve: &Outbox<SolveRequest>,
    record: &Recorder,
    status: &Status,
) -> Result<Perceived, RunError> {
    let mut perceive = Perceive::new(scenario.clone(), schedule.clone());
    let mut done = Perceived { frames: 0, quarantined: 0, support_vectors: 0, nu: None, clock: Clock::new() };
    let (mut last_boundary, mut last_number) = (None, None);
    loop {
        let Ok(frame) = frames.take() else {
            if let Some(frame) = last_number {
                let _ = record.end(frame, status.snapshot().stamp_ns);
            }
            let last = perceive.finish()?;
            // Whoever is gone by now has failed, and that is reported.
            let _ = deliver(last, &mut done, solve, record, status);
            return Ok(done);
        };
        let begin = Instant::now();
        let (stamp, action) = (frame.stamp_ns, frame.action);
        let mut sent = record.frame(&frame);
        // Frames are missing before this one: what the action came to cannot be told.
        if last_number.replace(frame.number).is_none_or(|last| last + 1 != frame.number) {
            last_boundary = None;
        }
        let (observation, percept) = perceive.see(frame);
        sent = sent.and_then(|()| record.observation(&observation, stamp));
        if let Some(percept) = percept {
            let before = last_boundary.replace(observation.frame);
            if let (Some(from), Some(action)) = (before, action) {
                sent = sent.and_then(|()| record.transition(from, action, &percept));
            }
            sent = sent.and_then(|()| percepts.put(percept));
        }
        let learned = perceive.learn(solve.has_room())?;
        done.frames += 1;
        if sent.and_then(|()| deliver(learned, &mut done, solve, record, status)).is_err() {
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

fn deliver(
    learned: perceive::Learning,
    done: &mut Perceived,
    solve: &Outbox<SolveRequest>,
    record: &Recorder,
    status: &Status,
) -> Result<(), Closed> {
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
    record.request(&request)?;
    solve.put(request)
}

/// What the act actor has when it ends.
pub struct Acted {
    pub learned: Option<Arc<Learned>>,
    pub without_model: Option<String>,
    pub actions: u64,
    pub pursuits: Vec<Tally>,
    pub clock: Clock,
    /// The newest model, until it is passed on.
    to_assess: Option<(Arc<Learned>, u64)>,
}

impl Acted {
    fn new() -> Self {
        let (pursuits, clock) = (Vec::new(), Clock::new());
        Acted { learned: None, without_model: None, actions: 0, pursuits, clock, to_assess: None }
    }

    /// Pass on the newest model; waits for room.
    fn pass_on(&mut self, assess: &Outbox<(Arc<Learned>, u64)>) {
        if let Some(model) = self.to_assess.take() {
            // An assess actor that is gone has failed, and that is reported.
            let _ = assess.put(model);
        }
    }
}

/// The act actor's surroundings.
pub struct Deciding<'a> {
    pub scenario: &'a Arc<Scenario>,
    pub schedule: &'a Schedule,
    /// Actions after which the run ends.
    pub most_actions: u64,
    pub record: &'a Recorder,
    pub status: &'a Status,
    pub stop: &'a AtomicBool,
    pub ended: &'a AtomicBool,
}

impl Deciding<'_> {
    /// Decide until the last action, then wait for the last model.
    pub fn run(
        &self,
        percepts: &Inbox<Percept>,
        updates: &Inbox<Update>,
        actions: Outbox<Action>,
        assess: &Outbox<(Arc<Learned>, u64)>,
    ) -> Result<Acted, RunError> {
        let mut act = Act::new(self.scenario);
        let mut acted = Acted::new();
        // Frames at which models were asked for whose answers come into effect at a fixed frame.
        let mut asked = VecDeque::new();
        let realtime = self.scenario.agent.mode == Mode::Realtime;
        let mut last_frame = 0;
        while let Ok(percept) = percepts.take() {
            let frame = percept.observation.frame;
            last_frame = frame;
            asked.extend(percept.asked.iter().copied());
            loop {
                let update = if asked.pop_front_if(|at| self.schedule.effective(*at) <= frame).is_some() {
                    updates.take().map(Some)
                } else if self.schedule.polls(frame) {
                    updates.poll()
                } else {
                    Ok(None)
                };
                match update {
                    Ok(Some(update)) => self.install(&mut act, &mut acted, update, frame, percept.stamp_ns),
                    Ok(None) => break,
                    Err(Closed) => return Ok(acted),
                }
            }
            // A robot does not wait until the models before this one were tried: it passes on the newest when it can.
            if !realtime || assess.has_room() {
                acted.pass_on(assess);
            }
            let stop = self.stop.load(Ordering::Relaxed) || self.ended.load(Ordering::Relaxed);
            if stop || acted.actions >= self.most_actions {
                break;
            }
            let decision = acted.clock.time(|| act.step(&percept));
            acted.actions += 1;
            let sent = self.record.decision(&decision, frame, percept.stamp_ns);
            if sent.is_err() || actions.put(decision.action).is_err() {
                break;
            }
            let pursuits = act.tallies().iter().fold(Tally::default(), |sum, tally| Tally {
                reached: sum.reached + tally.reached,
                ended: sum.ended + tally.ended,
            });
            let p99 = acted.clock.p99_now_and_then();
            self.status.update(|s| {
                (s.actions, s.pursuits) = (acted.actions as usize, pursuits);
                s.act_p99_ms = p99.unwrap_or(s.act_p99_ms);
            });
        }
        // No more actions: the source ends, then perceive with its last request, and then the solvers.
        drop(actions);
        while percepts.take().is_ok() {}
        while let Ok(update) = updates.take() {
            // It would act from the frame after the last one.
            let stamp_ns = self.status.snapshot().stamp_ns;
            self.install(&mut act, &mut acted, update, last_frame + 1, stamp_ns);
            acted.pass_on(assess);
        }
        acted.pass_on(assess);
        acted.pursuits = act.tallies().to_vec();
        Ok(acted)
    }

    fn install(&self, act: &mut Act, acted: &mut Acted, update: Update, frame: u64, stamp_ns: u64) {
        match &update.learned {
            Ok(learned) => {
                act.install(learned.clone());
                acted.learned = Some(learned.clone());
                acted.without_model = None;
                // A closed log ends the run at the next decision.
                let _ = self.record.update(&update, learned, frame, stamp_ns);
                let slowness = &learned.model.slowness;
                let mean = slowness.iter().sum::<f64>() / slowness.len() as f64;
                self.status.update(|s| (s.epoch, s.slowness_mean) = (learned.epoch, Some(mean)));
                acted.to_assess = Some((learned.clone(), stamp_ns));
            }
            Err(reason) => {
                let text = format!("no model from the frames up to {}: {reason}", update.asked_at);
                let _ = self.record.diagnostic(Level::Warn, stamp_ns, text.clone());
                self.status.update(|s| s.without_model = Some(text.clone()));
                acted.without_model = Some(text);
            }
        }
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
) -> Result<Vec<CurvePoint>, RunError> {
    let mut curve = Vec::new();
    let every = scenario.evaluate.every as u32;
    while let Ok((learned, stamp_ns)) = models.take() {
        if let Some(path) = checkpoint {
            write_checkpoint(path, &checkpoint_bytes(&learned, scenario)?)?;
        }
        let Some(evaluator) = evaluator.filter(|_| every > 0 && learned.epoch.is_multiple_of(every)) else { continue };
        let results = evaluator.evaluate(&learned, false);
        let point = curve_point(&learned, &results, scenario);
        status.update(|s| s.success = Some(point.success));
        curve.push(point);
        if record.evaluation(&results, &learned, stamp_ns).is_err() {
            break;
        }
    }
    Ok(curve)
}

/// One evaluation as a point of the curve.
fn curve_point(learned: &Learned, results: &[TaskResult], scenario: &Scenario) -> CurvePoint {
    let tasks = results.len() as f64;
    let slowness = &learned.model.slowness;
    CurvePoint {
        frames: learned.frames,
        actions: (learned.frames - 1) / scenario.robot.frames_per_action as u64,
        support_vectors: learned.model.members.ncols(),
        success: results.iter().map(|result| result.success).sum::<f64>() / tasks,
        convergence_quality: results.iter().map(|result| result.convergence_quality).sum::<f64>() / tasks,
        slowness_mean: slowness.iter().sum::<f64>() / slowness.len() as f64,
    }
}

/// The health actor: how the run is doing, once a second.
pub fn watch_health(record: &Recorder, status: &Status, over: &AtomicBool) {
    let (mut last, mut frames) = (Instant::now(), 0);
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
        if record.health(&now, rate, resident_bytes().unwrap_or(0)).is_err() || ends {
            return;
        }
    }
}
