//! The loop of the actor that acts: models come into effect, the state of the run is put away now and then, actions are decided.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use super::clock::Clock;
use super::controls::Controls;
use super::keep::{Acting, Mark, Quiet};
use super::messages::{Item, Percept, Update};
use super::queue::{Closed, Inbox, Outbox};
use super::record::{Level, Recorder};
use super::run::RunError;
use super::schedule::Schedule;
use super::status::Status;
use crate::parts::Parts;
use crate::policy::{Learned, Tally};
use crate::scenario::{Mode, Scenario};
use crate::world::Action;

/// Where and when the state of a run is put away.
#[derive(Debug, Clone)]
pub struct Keep {
    /// The file.
    pub path: PathBuf,
    /// Time between two states; `None`: only when the run is interrupted.
    pub every: Option<Duration>,
}

/// What the act actor has when it ends.
pub struct Acted {
    pub learned: Option<Arc<Learned>>,
    pub without_model: Option<String>,
    pub actions: u64,
    pub pursuits: Vec<Tally>,
    pub clock: Clock,
}

/// The act actor's surroundings.
pub struct Deciding<'a> {
    pub scenario: &'a Arc<Scenario>,
    pub schedule: &'a Schedule,
    /// Actions after which the run ends.
    pub most_actions: u64,
    pub record: &'a Recorder,
    pub status: &'a Status,
    pub quiet: &'a Quiet,
    pub keep: Option<&'a Keep>,
    pub stop: &'a AtomicBool,
    pub controls: Option<&'a Controls>,
    pub ended: &'a AtomicBool,
    pub percepts: Inbox<Percept>,
    pub updates: Inbox<Update>,
    pub assess: Outbox<(Arc<Learned>, u64)>,
}

/// What changes while the act actor runs.
struct Helm {
    acting: Acting,
    clock: Clock,
    /// Answers that have come in.
    answered: u64,
    /// Models until they are passed on; of a robot's, which waits for no trials, only the newest.
    to_assess: Vec<(Arc<Learned>, u64)>,
    /// When the state of the run was last put away.
    kept: Instant,
}

impl Deciding<'_> {
    /// Decide until the last action, then wait for the last model.
    pub fn run(&self, acting: Acting, actions: Outbox<Item<Action>>) -> Result<Acted, RunError> {
        let (clock, answered, to_assess, kept) = (Clock::new(), 0, Vec::new(), Instant::now());
        let mut helm = Helm { acting, clock, answered, to_assess, kept };
        let realtime = self.scenario.agent.mode == Mode::Realtime;
        let mut last_frame = 0;
        // A run that goes on has the percept that is to be answered.
        let first = helm.acting.percept.take();
        let percepts = first.into_iter().chain(std::iter::from_fn(|| self.percepts.take().ok()));
        for percept in percepts {
            let frame = percept.observation.frame;
            last_frame = frame;
            self.pause(percept.stamp_ns);
            helm.acting.waiting.extend(percept.asked.iter().map(|&asked_at| (asked_at, None)));
            if self.bring_into_effect(&mut helm, frame, percept.stamp_ns).is_err() {
                return Ok(helm.ended());
            }
            // A robot does not wait until the models before this one were tried: it passes on the newest when it can.
            if !realtime || self.assess.has_room() {
                helm.pass_on(&self.assess);
            }
            let done = helm.acting.actions >= self.most_actions || self.ended.load(Ordering::Relaxed);
            let stop = self.stop.load(Ordering::Relaxed);
            if self
                .keep
                .is_some_and(|keep| !done && (stop || keep.every.is_some_and(|every| helm.kept.elapsed() >= every)))
                && self.put_away(&mut helm, &percept, &actions).is_err()
            {
                break;
            }
            if stop || done {
                break;
            }
            let decision = helm.clock.time(|| helm.acting.act.step(&percept));
            helm.acting.actions += 1;
            let sent = self.record.decision(&decision, frame, percept.stamp_ns);
            if sent.is_err() || actions.put(Item::Work(decision.action)).is_err() {
                break;
            }
            self.tell(&mut helm);
        }
        // No more actions: the source ends, then perceive with its last request, and then the solvers.
        drop(actions);
        while self.percepts.take().is_ok() {}
        let early: Vec<Update> = helm.acting.waiting.drain(..).filter_map(|(_, answer)| answer).collect();
        for update in early.into_iter().chain(std::iter::from_fn(|| self.updates.take().ok())) {
            // It would act from the frame after the last one.
            let stamp_ns = self.status.snapshot().stamp_ns;
            self.install(&mut helm, update, last_frame + 1, stamp_ns);
            helm.pass_on(&self.assess);
        }
        helm.pass_on(&self.assess);
        Ok(helm.ended())
    }

    /// While somebody wants a pause, decide nothing: between two actions a robot stands still.
    fn pause(&self, stamp_ns: u64) {
        let Some(controls) = self.controls.filter(|controls| controls.is_paused()) else { return };
        let told = |text: String| {
            // A closed log ends the run at the next decision.
            let _ = self.record.diagnostic(Level::Info, stamp_ns, text);
        };
        told("the run is paused".to_owned());
        let paused = controls.wait(self.stop);
        told(format!("the run goes on after a pause of {:.1} s", paused.as_secs_f64()));
    }

    /// Let models act that are to act from this frame on.
    fn bring_into_effect(&self, helm: &mut Helm, frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        loop {
            let fixed = |waiting: &mut (u64, Option<Update>)| self.schedule.effective(waiting.0) <= frame;
            let update = match helm.acting.waiting.pop_front_if(fixed) {
                Some((_, Some(answer))) => answer,
                Some((_, None)) => {
                    helm.answered += 1;
                    self.updates.take()?
                }
                None if self.schedule.polls(frame) => {
                    let Some(update) = self.updates.poll()? else { return Ok(()) };
                    helm.answered += 1;
                    helm.acting.waiting.retain(|(asked_at, _)| *asked_at != update.asked_at);
                    update
                }
                None => return Ok(()),
            };
            self.install(helm, update, frame, stamp_ns);
        }
    }

    /// Begin to put away the state of the run: between two actions, with no model being made. In lockstep that is waited for;
    /// otherwise no more models are asked for until it is so.
    fn put_away(&self, helm: &mut Helm, percept: &Percept, actions: &Outbox<Item<Action>>) -> Result<(), Closed> {
        if self.scenario.agent.mode == Mode::Lockstep {
            for (_, answer) in helm.acting.waiting.iter_mut().filter(|(_, answer)| answer.is_none()) {
                *answer = Some(self.updates.take()?);
                helm.answered += 1;
            }
        } else {
            // Perceive may be asking for a model at this very frame. By the next boundary it has seen that it must not.
            let held = self.quiet.hold.swap(true, Ordering::Relaxed) || self.stop.load(Ordering::Relaxed);
            if !held || self.quiet.requests.load(Ordering::Relaxed) != helm.answered {
                return Ok(());
            }
            // Announced by a recording that ended before they acted.
            helm.acting.waiting.clear();
        }
        helm.kept = Instant::now();
        helm.acting.percept = Some(Percept { asked: Vec::new(), ..percept.clone() });
        let mut parts = Parts::new();
        let put = parts.inner("acting", &mut helm.acting);
        helm.acting.percept = None;
        if let Err(cause) = put {
            let text = format!("the state of the run cannot be put away: {cause}");
            return self.record.diagnostic(Level::Warn, percept.stamp_ns, text);
        }
        let (frame, stamp_ns, requests) = (percept.observation.frame, percept.stamp_ns, helm.answered);
        actions.put(Item::Save(Box::new(Mark { parts, frame, stamp_ns, requests })))
    }

    fn tell(&self, helm: &mut Helm) {
        let pursuits = helm.acting.act.tallies().iter().fold(Tally::default(), |sum, tally| Tally {
            reached: sum.reached + tally.reached,
            ended: sum.ended + tally.ended,
        });
        let p99 = helm.clock.p99_now_and_then();
        self.status.update(|s| {
            (s.actions, s.pursuits) = (helm.acting.actions as usize, pursuits);
            s.act_p99_ms = p99.unwrap_or(s.act_p99_ms);
        });
    }

    fn install(&self, helm: &mut Helm, update: Update, frame: u64, stamp_ns: u64) {
        match &update.learned {
            Ok(learned) => {
                helm.acting.act.install(learned.clone());
                helm.acting.learned = Some(learned.clone());
                helm.acting.without_model = None;
                // A closed log ends the run at the next decision.
                let _ = self.record.update(&update, learned, frame, stamp_ns);
                let slowness = &learned.model.slowness;
                let mean = slowness.iter().sum::<f64>() / slowness.len() as f64;
                self.status.update(|s| (s.epoch, s.slowness_mean) = (learned.epoch, Some(mean)));
                if self.scenario.agent.mode == Mode::Realtime {
                    helm.to_assess.clear();
                }
                helm.to_assess.push((learned.clone(), stamp_ns));
            }
            Err(reason) => {
                let text = format!("no model from the frames up to {}: {reason}", update.asked_at);
                let _ = self.record.diagnostic(Level::Warn, stamp_ns, text.clone());
                self.status.update(|s| s.without_model = Some(text.clone()));
                helm.acting.without_model = Some(text);
            }
        }
    }
}

impl Helm {
    /// Pass on the models that wait; waits for room.
    fn pass_on(&mut self, assess: &Outbox<(Arc<Learned>, u64)>) {
        for model in self.to_assess.drain(..) {
            // An assess actor that is gone has failed, and that is reported.
            let _ = assess.put(model);
        }
    }

    fn ended(self) -> Acted {
        let Acting { act, actions, learned, without_model, .. } = self.acting;
        Acted { learned, without_model, actions, pursuits: act.tallies().to_vec(), clock: self.clock }
    }
}
