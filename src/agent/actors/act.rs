//! The act actor: decides what the robot does next.
//!
//! [`Act`] is the step: exploration, pursuit and reflexes. [`ActLoop`] runs it: models come into effect, snapshots of the run begin
//! now and then, actions are decided.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::messages::{Decision, Item, Judged, Percept, Update};
use super::record::{Level, Recorder};
use super::saved::{action_of, learned, recent_numbers, recent_of};
use crate::agent::error::RunError;
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::controls::Controls;
use crate::agent::runtime::marker::{Keep, Marker, Quiet};
use crate::agent::runtime::queue::{Closed, Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::agent::runtime::timing::Schedule;
use crate::parts::{Parts, PartsError, Persist};
use crate::policy::{Behaviour, Learned, Leg, Recent, Reflexes, Tally, Walk};
use crate::random::stream;
use crate::robot::Action;
use crate::scenario::{Mode, Scenario};
use crate::value::Fit;
use crate::vision::Observation;

/// Exploration, pursuit and reflexes.
pub struct Act {
    learned: Option<Arc<Learned>>,
    behaviour: Behaviour,
    walk: Walk,
    reflexes: Reflexes,
    number: usize,
}

impl Act {
    /// An actor without a policy: it explores.
    pub fn new(scenario: &Scenario) -> Self {
        Act {
            learned: None,
            behaviour: Behaviour::new(scenario, stream(scenario.seed, "legs")),
            walk: Walk::new(scenario, stream(scenario.seed, "explore")),
            reflexes: Reflexes::new(scenario),
            number: 0,
        }
    }

    /// Act on what was learned from now on.
    pub fn install(&mut self, learned: Arc<Learned>) {
        self.learned = Some(learned);
    }

    /// The next action. What was executed last is in the percept: a replay executes what was recorded, whatever is decided.
    pub fn step(&mut self, percept: &Percept) -> Decision {
        let leg = self.behaviour.next(self.number, &percept.judged.in_goal, self.learned.is_some());
        let (action, q_values, reflex) = match (leg, &self.learned) {
            (Leg::Pursue(task), Some(learned)) => {
                let values = learned.q_values(&percept.observation, task);
                let (action, reflex) = self.reflexes.best(&values, percept.recent);
                (action, Some(values), reflex)
            }
            _ => (self.walk.choose(&percept.sonar, self.reflexes, percept.recent), None, false),
        };
        self.number += 1;
        let epoch = self.learned.as_ref().map_or(0, |learned| learned.epoch);
        Decision { number: self.number - 1, action, leg, epoch, q_values, reflex }
    }

    /// How pursuits ended so far, by task.
    pub fn tallies(&self) -> &[Tally] {
        self.behaviour.tallies()
    }
}

/// What was learned is not among its parts: it is installed again.
impl Persist for Act {
    fn persist(&mut self, parts: &mut Parts) -> Result<(), PartsError> {
        parts.inner("behaviour", &mut self.behaviour)?;
        parts.inner("walk", &mut self.walk)?;
        parts.value("number", &mut self.number)
    }
}

/// The state of the actor that acts.
pub struct Acting {
    pub act: Act,
    pub actions: u64,
    pub learned: Option<Arc<Learned>>,
    pub without_model: Option<String>,
    /// Models that were asked for and do not act yet: the frame of the request, and the answer if it is there.
    pub waiting: VecDeque<(u64, Option<Update>)>,
    /// The percept that is to be answered, where a run goes on.
    pub percept: Option<Percept>,
}

impl Acting {
    pub fn new(act: Act) -> Self {
        let (learned, without_model, percept) = (None, None, None);
        Acting { act, actions: 0, learned, without_model, waiting: VecDeque::new(), percept }
    }
}

impl Persist for Acting {
    fn persist(&mut self, parts: &mut Parts) -> Result<(), PartsError> {
        parts.inner("act", &mut self.act)?;
        parts.value("actions", &mut self.actions)?;
        parts.value("without_model", &mut self.without_model)?;
        learned(parts, "learned", &mut self.learned)?;
        if let Some(learned) = self.learned.clone().filter(|_| parts.is_restoring()) {
            self.act.install(learned);
        }
        let mut count = self.waiting.len();
        parts.value("waiting", &mut count)?;
        if parts.is_restoring() {
            self.waiting.clear();
        }
        for place in 0..count {
            let mut update = self.waiting.get_mut(place).and_then(|(_, update)| update.take());
            parts.scope(&format!("waiting.{place}"), |parts| answer(parts, &mut update))?;
            let asked_at = update.as_ref().map_or(0, |update| update.asked_at);
            match self.waiting.get_mut(place) {
                Some(entry) => entry.1 = update,
                None => self.waiting.push_back((asked_at, update)),
            }
        }
        parts.scope("percept", |parts| percept(parts, &mut self.percept))
    }
}

fn percept(parts: &mut Parts, percept: &mut Option<Percept>) -> Result<(), PartsError> {
    let of = percept.as_ref();
    let (mut frame, mut stamp_ns) = of.map_or((0, 0), |p| (p.observation.frame, p.stamp_ns));
    let mut pixels = of.map_or(Vec::new(), |p| p.observation.pixels.clone());
    let mut sonar = of.map_or(Vec::new(), |p| p.sonar.clone());
    let mut action = of.and_then(|p| p.action).map(Action::index);
    let mut recent = recent_numbers(of.map_or(Recent::default(), |p| p.recent));
    let mut came_to = of.map(CameTo::of);
    parts.value("frame", &mut frame)?;
    parts.value("stamp_ns", &mut stamp_ns)?;
    parts.numbers("pixels", &mut pixels)?;
    parts.numbers("sonar", &mut sonar)?;
    parts.value("action", &mut action)?;
    parts.value("recent", &mut recent)?;
    parts.value("came_to", &mut came_to)?;
    if parts.is_restoring() {
        let action = action.map(|number| action_of(parts, number)).transpose()?;
        let recent = recent_of(parts, recent)?;
        *percept = came_to.map(|came_to| Percept {
            observation: Arc::new(Observation { frame, pixels }),
            stamp_ns,
            sonar,
            action,
            blocked: came_to.blocked,
            recent,
            judged: came_to.judged(),
            asked: Vec::new(),
        });
        parts.check("came_to", percept.is_some(), "nothing")?;
    }
    Ok(())
}

/// An answer to a request, on its way.
fn answer(parts: &mut Parts, update: &mut Option<Update>) -> Result<(), PartsError> {
    let mut asked_at = update.as_ref().map_or(0, |update| update.asked_at);
    let mut transitions = update.as_ref().map_or(0, |update| update.transitions);
    let mut reason = update.as_ref().and_then(|update| update.learned.as_ref().err().cloned());
    let mut fits: Vec<(usize, bool, Option<usize>)> = update.as_ref().map_or(Vec::new(), |update| {
        update.fits.iter().map(|fit| (fit.iterations, fit.converged, fit.cycle)).collect()
    });
    let mut model = update.as_ref().and_then(|update| update.learned.as_ref().ok().cloned());
    parts.value("asked_at", &mut asked_at)?;
    parts.value("transitions", &mut transitions)?;
    parts.value("reason", &mut reason)?;
    parts.value("fits", &mut fits)?;
    learned(parts, "learned", &mut model)?;
    if parts.is_restoring() {
        let weights = model.as_ref().map_or(Vec::new(), |learned| learned.weights.clone());
        parts.check("fits", fits.len() == weights.len(), "another number than of policies")?;
        let fits = weights.into_iter().zip(fits).map(|(weights, (iterations, converged, cycle))| Fit {
            weights,
            iterations,
            converged,
            cycle,
        });
        let learned = match (model, reason) {
            (Some(model), None) => Ok(model),
            (None, Some(reason)) => Err(reason),
            _ => return parts.check("reason", false, "there is either a model or a reason"),
        };
        *update = Some(Update { asked_at, learned, fits: fits.collect(), transitions });
    }
    Ok(())
}

/// What an action came to, with numbers as bits.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct CameTo {
    blocked: bool,
    rewards: Vec<u64>,
    in_goal: Vec<bool>,
}

impl CameTo {
    fn of(percept: &Percept) -> Self {
        let Judged { rewards, in_goal } = percept.judged.clone();
        CameTo { blocked: percept.blocked, rewards: rewards.into_iter().map(f64::to_bits).collect(), in_goal }
    }

    fn judged(self) -> Judged {
        Judged { rewards: self.rewards.into_iter().map(f64::from_bits).collect(), in_goal: self.in_goal }
    }
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
pub struct ActLoop<'a> {
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
    /// To the evaluate actor.
    pub models: Outbox<(Arc<Learned>, u64)>,
}

/// What changes while the act actor runs.
struct Helm {
    acting: Acting,
    clock: Clock,
    /// Answers that have come in.
    answered: u64,
    /// Models until they are passed on; of a robot's, which waits for no trials, only the newest.
    to_evaluate: Vec<(Arc<Learned>, u64)>,
    /// When the state of the run was last put away.
    kept: Instant,
}

impl ActLoop<'_> {
    /// Decide until the last action, then wait for the last model.
    pub fn run(&self, acting: Acting, actions: Outbox<Item<Action>>) -> Result<Acted, RunError> {
        let (clock, answered, to_evaluate, kept) = (Clock::new(), 0, Vec::new(), Instant::now());
        let mut helm = Helm { acting, clock, answered, to_evaluate, kept };
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
            if !realtime || self.models.has_room() {
                helm.pass_on(&self.models);
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
            helm.pass_on(&self.models);
        }
        helm.pass_on(&self.models);
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
        actions.put(Item::Save(Box::new(Marker { parts, frame, stamp_ns, requests })))
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
                    helm.to_evaluate.clear();
                }
                helm.to_evaluate.push((learned.clone(), stamp_ns));
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
    fn pass_on(&mut self, models: &Outbox<(Arc<Learned>, u64)>) {
        for model in self.to_evaluate.drain(..) {
            // An evaluate actor that is gone has failed, and that is reported.
            let _ = models.put(model);
        }
    }

    fn ended(self) -> Acted {
        let Acting { act, actions, learned, without_model, .. } = self.acting;
        Acted { learned, without_model, actions, pursuits: act.tallies().to_vec(), clock: self.clock }
    }
}
