//! The act actor: decides what the robot does next.
//!
//! [`Act`] is the step: exploration, pursuit and reflexes. [`ActLoop`] runs it: models come into effect, snapshots of the run begin
//! now and then, actions are decided.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::{Deserialize, Serialize};

use super::messages::{Decision, Item, Percept, TaskOutcomes, Update};
use super::record::{Level, Recorder};
use super::saved::{StepBits, action_of, learned, recent_numbers, recent_of, step_bits, step_from};
use super::way::Way;
use crate::agent::error::RunError;
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::controls::Controls;
use crate::agent::runtime::marker::{Marker, Quiescence, SnapshotSettings};
use crate::agent::runtime::queue::{Closed, Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::agent::runtime::timing::ModelTiming;
use crate::policy::{Behaviour, BehaviourSchedule, Directed, Learned, Prospects, Recent, Reflexes, Tally, Walk};
use crate::random::stream;
use crate::robot::Action;
use crate::scenario::{Body, Mode, Scenario, Task, Then};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::value::Fit;
use crate::vision::Observation;

/// Exploration, pursuit and reflexes.
pub struct Act {
    /// Which tasks have goals that are shown.
    shown: Vec<bool>,
    gamma: f64,
    learned: Option<Arc<Learned>>,
    behaviour: BehaviourSchedule,
    walk: Walk,
    directed: Directed,
    prospects: Prospects,
    reflexes: Reflexes,
    way: Way,
    number: usize,
}

impl Act {
    /// An actor without a policy: it explores.
    pub fn new(scenario: &Scenario) -> Self {
        Act {
            shown: scenario.tasks.iter().map(Task::is_shown).collect(),
            gamma: scenario.value.gamma,
            learned: None,
            behaviour: BehaviourSchedule::new(scenario, stream(scenario.seed, "legs")),
            walk: Walk::new(scenario, stream(scenario.seed, "explore")),
            directed: Directed::new(scenario, stream(scenario.seed, "directed")),
            prospects: Prospects::default(),
            reflexes: Reflexes::new(scenario),
            way: Way::new(scenario),
            number: 0,
        }
    }

    /// Act on what was learned from now on.
    pub fn install(&mut self, learned: Arc<Learned>) {
        self.way.find_again(&learned);
        self.directed.begin();
        self.learned = Some(learned);
    }

    /// The next action. What was executed last is in the percept: a replay executes what was recorded, whatever is decided.
    pub fn step(&mut self, percept: &Percept) -> Decision {
        let state = self.way.state(self.learned.as_deref(), percept);
        // Where a goal was shown, what the camera sees decides whether this is it.
        let in_goal = |task: usize| match (self.shown[task], &state) {
            (true, state) => state.as_ref().is_some_and(|state| state.is_there(task)),
            (false, _) => percept.outcomes.in_goal[task],
        };
        let able = |task: usize| self.learned.as_ref().is_some_and(|learned| learned.has_goal(task, self.shown[task]));
        if let Some(goto) = percept.goto {
            self.behaviour.send(goto);
        }
        let (leg, ended) = self.behaviour.next(self.number, &in_goal, &able);
        ended.iter().for_each(|end| self.prospects.ended(end));
        let mut prospect = None;
        let values = match (leg, &state) {
            (Behaviour::Pursue(task), Some(state)) => {
                self.directed.begin();
                let expected = state.expected_actions(task, self.gamma);
                prospect = self.prospects.of(task, self.behaviour.pursued(), expected);
                Some(state.q_values(task))
            }
            (Behaviour::Pursue(_), None) => None,
            (Behaviour::Explore, state) => self.directed.values(state.as_ref()),
        };
        let (action, reflex) = match &values {
            Some(values) => self.reflexes.best(values, percept.recent),
            None => (self.walk.choose(&percept.sonar, self.reflexes, percept.recent), false),
        };
        // Values of a decision are those of a task.
        let q_values = values.filter(|_| leg != Behaviour::Explore);
        self.number += 1;
        let places = state.as_ref().map_or(Vec::new(), |state| state.places().to_vec());
        let epoch = self.learned.as_ref().map_or(0, |learned| learned.epoch);
        let ends_run = ended.is_some_and(|end| end.arrived && self.behaviour.then(end.task) == Then::Stop);
        Decision { number: self.number - 1, action, leg, epoch, places, prospect, q_values, reflex, ended, ends_run }
    }

    /// How pursuits ended so far, by task.
    pub fn tallies(&self) -> &[Tally] {
        self.behaviour.tallies()
    }
}

/// What was learned is not among its parts: it is installed again.
impl Persist for Act {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("behaviour", &mut self.behaviour)?;
        snapshot.inner("walk", &mut self.walk)?;
        snapshot.inner("directed", &mut self.directed)?;
        snapshot.inner("prospects", &mut self.prospects)?;
        snapshot.inner("way", &mut self.way)?;
        snapshot.value("number", &mut self.number)
    }
}

/// The state of the actor that acts.
pub struct ActState {
    pub act: Act,
    pub actions: u64,
    pub learned: Option<Arc<Learned>>,
    pub without_model: Option<String>,
    /// Models that were asked for and do not act yet: the frame of the request, and the answer if it is there.
    pub waiting: VecDeque<(u64, Option<Update>)>,
    /// The percept that is to be answered, where a run goes on.
    pub percept: Option<Percept>,
}

impl ActState {
    pub fn new(act: Act) -> Self {
        let (learned, without_model, percept) = (None, None, None);
        ActState { act, actions: 0, learned, without_model, waiting: VecDeque::new(), percept }
    }
}

impl Persist for ActState {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("act", &mut self.act)?;
        snapshot.value("actions", &mut self.actions)?;
        snapshot.value("without_model", &mut self.without_model)?;
        learned(snapshot, "learned", &mut self.learned)?;
        if let Some(learned) = self.learned.clone().filter(|_| snapshot.is_restoring()) {
            self.act.way.find_again(&learned);
            self.act.learned = Some(learned);
        }
        self.act.way.persist_belief(snapshot)?;
        let mut count = self.waiting.len();
        snapshot.value("waiting", &mut count)?;
        if snapshot.is_restoring() {
            self.waiting.clear();
        }
        for place in 0..count {
            let mut update = self.waiting.get_mut(place).and_then(|(_, update)| update.take());
            snapshot.scope(&format!("waiting.{place}"), |snapshot| answer(snapshot, &mut update))?;
            let asked_at = update.as_ref().map_or(0, |update| update.asked_at);
            match self.waiting.get_mut(place) {
                Some(entry) => entry.1 = update,
                None => self.waiting.push_back((asked_at, update)),
            }
        }
        snapshot.scope("percept", |snapshot| percept(snapshot, &mut self.percept))
    }
}

fn percept(snapshot: &mut Snapshot, percept: &mut Option<Percept>) -> Result<(), SnapshotError> {
    let of = percept.as_ref();
    let (mut frame, mut stamp_ns) = of.map_or((0, 0), |p| (p.observation.frame, p.stamp_ns));
    let mut pixels = of.map_or(Vec::new(), |p| p.observation.pixels.clone());
    let mut sonar = of.map_or(Vec::new(), |p| p.sonar.clone());
    let mut action = of.and_then(|p| p.action).map(Action::index);
    let mut recent = recent_numbers(of.map_or(Recent::default(), |p| p.recent));
    let mut came_to = of.map(SavedOutcomes::of);
    let mut goto = of.and_then(|p| p.goto);
    snapshot.value("frame", &mut frame)?;
    snapshot.value("stamp_ns", &mut stamp_ns)?;
    snapshot.numbers("pixels", &mut pixels)?;
    snapshot.numbers("sonar", &mut sonar)?;
    snapshot.value("action", &mut action)?;
    snapshot.value("recent", &mut recent)?;
    snapshot.value("came_to", &mut came_to)?;
    snapshot.value("goto", &mut goto)?;
    if snapshot.is_restoring() {
        let action = action.map(|number| action_of(snapshot, number)).transpose()?;
        let recent = recent_of(snapshot, recent)?;
        *percept = came_to.map(|came_to| Percept {
            observation: Arc::new(Observation { frame, pixels }),
            stamp_ns,
            sonar,
            action,
            recent,
            outcomes: came_to.outcomes(),
            goto,
            asked: Vec::new(),
        });
        snapshot.check("came_to", percept.is_some(), "nothing")?;
    }
    Ok(())
}

/// An answer to a request, on its way.
pub fn answer(snapshot: &mut Snapshot, update: &mut Option<Update>) -> Result<(), SnapshotError> {
    let mut asked_at = update.as_ref().map_or(0, |update| update.asked_at);
    let mut transitions = update.as_ref().map_or(0, |update| update.transitions);
    let mut reason = update.as_ref().and_then(|update| update.learned.as_ref().err().cloned());
    let mut fits: Vec<(usize, bool, Option<usize>)> = update.as_ref().map_or(Vec::new(), |update| {
        update.fits.iter().map(|fit| (fit.iterations, fit.converged, fit.cycle)).collect()
    });
    let mut model = update.as_ref().and_then(|update| update.learned.as_ref().ok().cloned());
    snapshot.value("asked_at", &mut asked_at)?;
    snapshot.value("transitions", &mut transitions)?;
    let mut notes = update.as_ref().map_or(Vec::new(), |update| update.notes.clone());
    snapshot.value("notes", &mut notes)?;
    snapshot.value("reason", &mut reason)?;
    snapshot.value("fits", &mut fits)?;
    learned(snapshot, "learned", &mut model)?;
    if snapshot.is_restoring() {
        let weights = model.as_ref().map_or(Vec::new(), |learned| learned.weights.clone());
        snapshot.check("fits", fits.len() == weights.len(), "another number than of policies")?;
        let fits = weights.into_iter().zip(fits).map(|(weights, (iterations, converged, cycle))| Fit {
            weights,
            iterations,
            converged,
            cycle,
            untried: Vec::new(),
        });
        let learned = match (model, reason) {
            (Some(model), None) => Ok(model),
            (None, Some(reason)) => Err(reason),
            _ => return snapshot.check("reason", false, "there is either a model or a reason"),
        };
        *update = Some(Update { asked_at, learned, fits: fits.collect(), transitions, notes });
    }
    Ok(())
}

/// What an action came to, with numbers as bits.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct SavedOutcomes {
    blocked: bool,
    rewards: Vec<u64>,
    in_goal: Vec<bool>,
    #[serde(default)]
    avoided: u64,
    #[serde(default)]
    step: Option<StepBits>,
}

impl SavedOutcomes {
    fn of(percept: &Percept) -> Self {
        let TaskOutcomes { rewards, in_goal, avoided, blocked, step } = percept.outcomes.clone();
        let rewards = rewards.into_iter().map(f64::to_bits).collect();
        SavedOutcomes { blocked, rewards, in_goal, avoided: avoided.to_bits(), step: step.map(step_bits) }
    }

    fn outcomes(self) -> TaskOutcomes {
        let rewards = self.rewards.into_iter().map(f64::from_bits).collect();
        let (avoided, step) = (f64::from_bits(self.avoided), self.step.map(step_from));
        TaskOutcomes { rewards, in_goal: self.in_goal, avoided, blocked: self.blocked, step }
    }
}

/// What the act actor has when it ends.
pub struct ActResult {
    pub learned: Option<Arc<Learned>>,
    pub without_model: Option<String>,
    pub actions: u64,
    pub pursuits: Vec<Tally>,
    pub clock: Clock,
}

/// The act actor's surroundings.
pub struct ActLoop<'a> {
    pub scenario: &'a Arc<Scenario>,
    pub timing: &'a ModelTiming,
    /// Actions after which the run ends.
    pub most_actions: u64,
    pub record: &'a Recorder,
    pub status: &'a Status,
    pub quiescence: &'a Quiescence,
    pub keep: Option<&'a SnapshotSettings>,
    pub stop: &'a AtomicBool,
    pub controls: Option<&'a Controls>,
    pub ended: &'a AtomicBool,
    pub percepts: Inbox<Percept>,
    pub updates: Inbox<Update>,
    /// To the evaluate actor.
    pub models: Outbox<(Arc<Learned>, u64)>,
}

/// What changes while the act actor runs.
struct Progress {
    acting: ActState,
    clock: Clock,
    /// Answers that have come in.
    answered: u64,
    /// Models until they are passed on; of a robot's, which waits for no trials, only the newest.
    to_evaluate: Vec<(Arc<Learned>, u64)>,
    /// When the state of the run was last saved.
    kept: Instant,
}

impl ActLoop<'_> {
    /// Decide until the last action, then wait for the last model.
    pub fn run(&self, acting: ActState, actions: Outbox<Item<Action>>) -> Result<ActResult, RunError> {
        let (clock, answered, to_evaluate, kept) = (Clock::new(), 0, Vec::new(), Instant::now());
        let mut progress = Progress { acting, clock, answered, to_evaluate, kept };
        let realtime = self.scenario.agent.mode == Mode::Realtime;
        let mut last_frame = 0;
        // A run that goes on has the percept that is to be answered.
        let first = progress.acting.percept.take();
        let percepts = first.into_iter().chain(std::iter::from_fn(|| self.percepts.take().ok()));
        for percept in percepts {
            let frame = percept.observation.frame;
            last_frame = frame;
            self.pause(percept.stamp_ns);
            progress.acting.waiting.extend(percept.asked.iter().map(|&asked_at| (asked_at, None)));
            if self.bring_into_effect(&mut progress, frame, percept.stamp_ns).is_err() {
                return Ok(progress.ended());
            }
            // A robot does not wait until the models before this one were tried: it passes on the newest when it can.
            if !realtime || self.models.has_room() {
                progress.pass_on(&self.models);
            }
            let done = progress.acting.actions >= self.most_actions || self.ended.load(Ordering::Relaxed);
            let stop = self.stop.load(Ordering::Relaxed);
            if self
                .keep
                .is_some_and(|keep| !done && (stop || keep.every.is_some_and(|every| progress.kept.elapsed() >= every)))
                && self.begin_snapshot(&mut progress, &percept, &actions).is_err()
            {
                break;
            }
            if stop || done {
                break;
            }
            let begin = Instant::now();
            let decision = progress.acting.act.step(&percept);
            // An action of a random walk takes no time.
            if decision.q_values.is_some() {
                progress.clock.keep(begin.elapsed());
            }
            if let Some(end) = decision.ended
                && self.record.pursuit(end, frame, percept.stamp_ns).is_err()
            {
                break;
            }
            if decision.ends_run {
                break;
            }
            if decision.ended.is_some_and(|end| end.sent) {
                self.wait_there(percept.stamp_ns);
            }
            progress.acting.actions += 1;
            let sent = self.record.decision(&decision, frame, percept.stamp_ns);
            if sent.is_err() || actions.put(Item::Work(decision.action)).is_err() {
                break;
            }
            self.tell(&mut progress);
        }
        // No more actions: the source ends, then perceive, learn with its last request, and then the solvers.
        drop(actions);
        while self.percepts.take().is_ok() {}
        let mut updates: Vec<Update> = progress.acting.waiting.drain(..).filter_map(|(_, answer)| answer).collect();
        // When the solvers have ended, learn has, too, and the end of the run is in the log before these models, which finish it.
        updates.extend(std::iter::from_fn(|| self.updates.take().ok()));
        for update in updates {
            // It would act from the frame after the last one.
            let stamp_ns = self.status.now().stamp_ns;
            self.install(&mut progress, update, last_frame + 1, stamp_ns);
            progress.pass_on(&self.models);
        }
        progress.pass_on(&self.models);
        Ok(progress.ended())
    }

    /// The robot is where somebody has sent it: it waits there until it is to go on. A recording has nobody who could say so, and a
    /// program waits for its next action.
    fn wait_there(&self, stamp_ns: u64) {
        if let Some(controls) = self.controls.filter(|_| self.scenario.robot.body != Body::Program) {
            controls.arrive();
            self.pause(stamp_ns);
        }
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
    fn bring_into_effect(&self, progress: &mut Progress, frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        loop {
            let fixed = |waiting: &mut (u64, Option<Update>)| self.timing.effective(waiting.0) <= frame;
            let update = match progress.acting.waiting.pop_front_if(fixed) {
                Some((_, Some(answer))) => answer,
                Some((_, None)) => {
                    progress.answered += 1;
                    self.updates.take()?
                }
                None if self.timing.polls(frame) => {
                    let Some(update) = self.updates.poll()? else { return Ok(()) };
                    progress.answered += 1;
                    progress.acting.waiting.retain(|(asked_at, _)| *asked_at != update.asked_at);
                    update
                }
                None => return Ok(()),
            };
            self.install(progress, update, frame, stamp_ns);
        }
    }

    /// Begin to save the state of the run: between two actions, with no model being made. In lockstep that is waited for;
    /// otherwise no more models are asked for until it is so.
    fn begin_snapshot(
        &self,
        progress: &mut Progress,
        percept: &Percept,
        actions: &Outbox<Item<Action>>,
    ) -> Result<(), Closed> {
        if self.scenario.agent.mode == Mode::Lockstep {
            for (_, answer) in progress.acting.waiting.iter_mut().filter(|(_, answer)| answer.is_none()) {
                *answer = Some(self.updates.take()?);
                progress.answered += 1;
            }
        } else {
            // Learn may be asking for a model just now. By the next boundary it has seen that it must not, or it gives this state up.
            let held = self.quiescence.hold.swap(true, Ordering::Relaxed) || self.stop.load(Ordering::Relaxed);
            if !held || self.quiescence.requests.load(Ordering::Relaxed) != progress.answered {
                return Ok(());
            }
            // Announced by a recording that ended before they acted.
            progress.acting.waiting.clear();
        }
        progress.kept = Instant::now();
        progress.acting.percept = Some(Percept { asked: Vec::new(), ..percept.clone() });
        let mut snapshot = Snapshot::new();
        let put = snapshot.inner("acting", &mut progress.acting);
        progress.acting.percept = None;
        if let Err(cause) = put {
            let text = format!("the state of the run cannot be saved: {cause}");
            return self.record.diagnostic(Level::Warn, percept.stamp_ns, text);
        }
        let (frame, stamp_ns, requests) = (percept.observation.frame, percept.stamp_ns, progress.answered);
        actions.put(Item::Save(Box::new(Marker { snapshot, frame, stamp_ns, requests })))
    }

    fn tell(&self, progress: &mut Progress) {
        let pursuits = progress.acting.act.tallies().iter().fold(Tally::default(), |sum, tally| Tally {
            reached: sum.reached + tally.reached,
            ended: sum.ended + tally.ended,
        });
        let p99 = progress.clock.p99_now_and_then();
        self.status.update(|s| {
            (s.actions, s.pursuits) = (progress.acting.actions as usize, pursuits);
            s.act_p99_ms = p99.unwrap_or(s.act_p99_ms);
        });
    }

    fn install(&self, progress: &mut Progress, update: Update, frame: u64, stamp_ns: u64) {
        for note in &update.notes {
            // A closed log ends the run at the next decision.
            let _ = self.record.diagnostic(Level::Warn, stamp_ns, note.clone());
        }
        match &update.learned {
            Ok(learned) => {
                progress.acting.act.install(learned.clone());
                progress.acting.learned = Some(learned.clone());
                progress.acting.without_model = None;
                // A closed log ends the run at the next decision.
                let _ = self.record.update(&update, learned, frame, stamp_ns);
                let slowness = &learned.model.slowness;
                let mean = slowness.iter().sum::<f64>() / slowness.len() as f64;
                self.status.update(|s| (s.epoch, s.slowness_mean) = (learned.epoch, Some(mean)));
                if self.scenario.agent.mode == Mode::Realtime {
                    progress.to_evaluate.clear();
                }
                progress.to_evaluate.push((learned.clone(), stamp_ns));
            }
            Err(reason) => {
                let text = format!("no model from the frames up to {}: {reason}", update.asked_at);
                let _ = self.record.diagnostic(Level::Warn, stamp_ns, text.clone());
                self.status.update(|s| s.without_model = Some(text.clone()));
                progress.acting.without_model = Some(text);
            }
        }
    }
}

impl Progress {
    /// Pass on the models that wait; waits for room.
    fn pass_on(&mut self, models: &Outbox<(Arc<Learned>, u64)>) {
        for model in self.to_evaluate.drain(..) {
            // An evaluate actor that is gone has failed, and that is reported.
            let _ = models.put(model);
        }
    }

    fn ended(self) -> ActResult {
        let ActState { act, actions, learned, without_model, .. } = self.acting;
        ActResult { learned, without_model, actions, pursuits: act.tallies().to_vec(), clock: self.clock }
    }
}
