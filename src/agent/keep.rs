//! What a run is, put together from its actors at one moment: a boundary between two actions.
//!
//! The actor that acts begins: it puts its own state into a [`Mark`] and sends that the way of an action. Each actor that it
//! comes to adds what it is and passes it on, in order with everything else, so all parts are of the same moment although
//! nobody stops. No model is being made at that moment: the mark finds the solvers idle.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

use faer::Mat;
use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::act::Act;
use super::goals::Judged;
use super::messages::{Percept, Update};
use crate::kernel::Kernel;
use crate::parts::{Parts, PartsError, Persist};
use crate::policy::{Learned, Recent};
use crate::slow::{Link, SlowModel};
use crate::value::{Fit, Instances, LocalOptions, Transition, Window};
use crate::vision::Observation;
use crate::world::Action;

/// A state of the run on its way through the actors.
#[derive(Debug)]
pub struct Mark {
    /// What was added so far.
    pub parts: Parts,
    /// The last frame before the moment.
    pub frame: u64,
    /// Its time.
    pub stamp_ns: u64,
    /// Models that had been asked for, as far as the actor that acts knows.
    pub requests: u64,
}

impl Mark {
    /// With the state of one more actor; nothing if that cannot be put away.
    pub fn with(mut self: Box<Self>, name: &str, actor: &mut impl Persist) -> Option<Box<Self>> {
        self.parts.inner(name, actor).is_ok().then_some(self)
    }
}

/// How quiet the solvers are, between the actor that asks for models and the one that acts on them.
#[derive(Default)]
pub struct Quiet {
    /// No models are to be asked for, where that is not fixed: the state of the run is to be put away.
    pub hold: AtomicBool,
    /// Models asked for so far.
    pub requests: AtomicU64,
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

fn learned(parts: &mut Parts, name: &str, learned: &mut Option<Arc<Learned>>) -> Result<(), PartsError> {
    parts.scope(name, |parts| {
        let of = learned.as_ref();
        let mut numbers = of.map(|of| (of.epoch, of.asked_at, of.frames, of.weights.len()));
        parts.value("there", &mut numbers)?;
        let mut goals: Vec<[u64; 2]> =
            of.map_or(Vec::new(), |of| of.goals.iter().map(|goal| goal.map(f64::to_bits)).collect());
        let Some((epoch, asked_at, frames, tasks)) = numbers else { return Ok(()) };
        parts.value("goals", &mut goals)?;
        let mut model = of.map(|of| of.model.clone());
        slow_model(parts, "model", &mut model)?;
        let mut weights: Vec<Mat<f64>> = of.map_or(Vec::new(), |of| of.weights.clone());
        for task in 0..tasks {
            let mut of_task = weights.get(task).cloned().unwrap_or_else(Mat::new);
            parts.matrix(&format!("weights.{task}"), &mut of_task, |rows, columns| (rows, columns))?;
            if parts.is_restoring() {
                weights.push(of_task);
            }
        }
        let mut instances = of.and_then(|of| of.instances.clone());
        places(parts, &mut instances)?;
        if let Some(model) = model.filter(|_| parts.is_restoring()) {
            let restored = match instances {
                None => Learned::new(epoch, asked_at, frames, model, weights),
                Some(instances) => Learned::local(epoch, asked_at, frames, model, instances, weights),
            };
            *learned = Some(Arc::new(
                restored
                    .map_err(|cause| wrong("learned", cause))?
                    .for_goals(goals.into_iter().map(|goal| goal.map(f64::from_bits)).collect()),
            ));
        }
        Ok(())
    })
}

/// Where actions were tried, of local values.
fn places(parts: &mut Parts, instances: &mut Option<Arc<Instances>>) -> Result<(), PartsError> {
    parts.scope("instances", |parts| {
        let of = instances.as_ref();
        let mut there = of.map(|of| (of.counts().to_vec(), of.options().neighbours, of.options().ridge.to_bits()));
        parts.value("there", &mut there)?;
        let Some((counts, neighbours, ridge)) = there else { return Ok(()) };
        let mut points = of.map_or(Mat::new(), |of| of.points().to_owned());
        parts.matrix("points", &mut points, |rows, columns| (rows, columns))?;
        if parts.is_restoring() {
            let options = LocalOptions { neighbours, ridge: f64::from_bits(ridge) };
            *instances =
                Some(Arc::new(Instances::new(points, counts, options).map_err(|cause| wrong("instances", cause))?));
        }
        Ok(())
    })
}

/// A model over a radial kernel, as a scenario's are.
pub fn slow_model(parts: &mut Parts, name: &str, model: &mut Option<SlowModel<f32>>) -> Result<(), PartsError> {
    parts.scope(name, |parts| {
        let room = |rows: usize, columns: usize| (rows, columns);
        let of = model.as_ref();
        let mut there = of.is_some();
        parts.value("there", &mut there)?;
        if !there {
            return Ok(());
        }
        let mut sigma = of.and_then(|of| of.kernel.sigma()).unwrap_or(f64::NAN);
        let mut exponent = of.and_then(|of| of.kernel.exponent()).unwrap_or(f64::NAN);
        let mut members = of.map_or(Mat::new(), |of| of.members.as_ref().clone());
        let mut projection = of.map_or(Mat::new(), |of| of.projection.clone());
        let mut offset = of.map_or(Vec::new(), |of| of.offset.clone());
        let mut slowness = of.map_or(Vec::new(), |of| of.slowness.clone());
        parts.number("sigma", &mut sigma)?;
        parts.number("exponent", &mut exponent)?;
        parts.matrix("members", &mut members, room)?;
        parts.matrix("projection", &mut projection, room)?;
        parts.numbers("offset", &mut offset)?;
        parts.numbers("slowness", &mut slowness)?;
        if parts.is_restoring() {
            let kernel = Kernel::radial(sigma, exponent).map_err(|cause| wrong("kernel", cause))?;
            let restored = SlowModel::from_parts(kernel, members, projection, offset, slowness);
            *model = Some(restored.map_err(|cause| wrong("model", cause))?);
        }
        Ok(())
    })
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

/// Bits of a link.
pub fn link_bits(link: Link) -> (u64, u64) {
    (link.dt.to_bits(), link.weight.to_bits())
}

/// A link from its bits.
pub fn link_of((dt, weight): (u64, u64)) -> Link {
    Link { dt: f64::from_bits(dt), weight: f64::from_bits(weight) }
}

/// Bits of a place.
pub fn place_bits(place: Point2<f64>) -> [u64; 2] {
    [place.x.to_bits(), place.y.to_bits()]
}

/// A place from its bits.
pub fn place_of(bits: [u64; 2]) -> Point2<f64> {
    bits.map(f64::from_bits).into()
}

/// An action from its number.
pub fn action_of(parts: &Parts, number: usize) -> Result<Action, PartsError> {
    let action = Action::ALL.get(number).copied();
    parts.check("action", action.is_some(), "no action has this number")?;
    Ok(action.unwrap_or(Action::Forward))
}

/// What the robot did last, by the numbers of actions.
pub fn recent_numbers(recent: Recent) -> [Option<usize>; 2] {
    [recent.action, recent.blocked].map(|action| action.map(Action::index))
}

/// What the robot did last, from the numbers of actions.
pub fn recent_of(parts: &Parts, [action, blocked]: [Option<usize>; 2]) -> Result<Recent, PartsError> {
    let of = |number: Option<usize>| number.map(|number| action_of(parts, number)).transpose();
    Ok(Recent { action: of(action)?, blocked: of(blocked)? })
}

/// Observations that several others refer to by their frames: each is kept once.
#[derive(Default)]
pub struct Seen {
    observations: BTreeMap<u64, Arc<Observation>>,
}

impl Seen {
    /// Take note of one, and name it by its frame.
    pub fn add(&mut self, observation: &Arc<Observation>) -> u64 {
        self.observations.entry(observation.frame).or_insert_with(|| observation.clone()).frame
    }

    /// One that was added.
    pub fn get(&self, frame: u64) -> Result<Arc<Observation>, PartsError> {
        self.observations
            .get(&frame)
            .cloned()
            .ok_or_else(|| PartsError::Missing(format!("the observation of frame {frame}")))
    }

    /// Put away or make again all of them, each of `values` pixels.
    pub fn persist(&mut self, parts: &mut Parts, values: usize) -> Result<(), PartsError> {
        let mut frames: Vec<u64> = self.observations.keys().copied().collect();
        let mut pixels = Vec::with_capacity(if parts.is_restoring() { 0 } else { values * frames.len() });
        self.observations.values().for_each(|seen| pixels.extend_from_slice(&seen.pixels));
        parts.value("seen", &mut frames)?;
        parts.numbers("seen_pixels", &mut pixels)?;
        parts.check("seen_pixels", pixels.len() == values * frames.len(), "another number than the frames have")?;
        if parts.is_restoring() {
            let of = |(frame, pixels): (u64, &[u8])| (frame, Arc::new(Observation { frame, pixels: pixels.to_vec() }));
            self.observations = frames.into_iter().zip(pixels.chunks_exact(values)).map(of).collect();
        }
        Ok(())
    }
}

/// A transition whose observations are named by their frames.
#[derive(Serialize, Deserialize)]
struct Stored {
    arrival: u64,
    from: u64,
    action: usize,
    allowed: u32,
    /// Where it ended.
    place: [u64; 2],
    to: u64,
    cell: usize,
}

/// The window of transitions, each with the place where it ended.
type Lives = Window<Arc<Observation>, Point2<f64>>;

/// Put away a window of transitions: what they refer to is added to `seen`.
pub fn put_window(window: &Lives, seen: &mut Seen, parts: &mut Parts) -> Result<(), PartsError> {
    let (entries, mut next) = window.arrivals();
    let mut stored: Vec<Stored> = entries
        .into_iter()
        .map(|(arrival, t)| Stored {
            arrival,
            from: seen.add(&t.from),
            action: t.action,
            allowed: t.allowed,
            place: place_bits(t.result),
            to: seen.add(&t.to),
            cell: t.cell,
        })
        .collect();
    parts.value("window", &mut stored)?;
    parts.value("arrivals", &mut next)
}

/// Make a window again.
pub fn take_window(capacity: usize, seen: &Seen, parts: &mut Parts) -> Result<Lives, PartsError> {
    let (mut stored, mut next): (Vec<Stored>, u64) = (Vec::new(), 0);
    parts.value("window", &mut stored)?;
    parts.value("arrivals", &mut next)?;
    parts.check("window", stored.len() <= capacity, "more than it has room for")?;
    let transition = |t: Stored| {
        action_of(parts, t.action)?;
        let (from, to, result) = (seen.get(t.from)?, seen.get(t.to)?, place_of(t.place));
        Ok((t.arrival, Transition { from, action: t.action, allowed: t.allowed, result, to, cell: t.cell }))
    };
    let entries: Result<Vec<_>, PartsError> = stored.into_iter().map(transition).collect();
    Ok(Window::restored(capacity, entries?, next))
}

pub fn wrong(name: &str, cause: impl std::fmt::Display) -> PartsError {
    PartsError::Wrong { name: name.to_owned(), cause: cause.to_string() }
}
