//! The perceive actor: vision, dictionary, moments, the window of transitions.
//!
//! [`Perceive`] is the step; its loop is in `thread`, its saved form in `saved`.

mod saved;
mod thread;

pub use thread::PerceiveLoop;

use std::sync::Arc;

use faer::{Mat, Par};
use nalgebra::Point2;
use thiserror::Error;

use super::messages::{Growth, Percept, SolveRequest, TaskTransition};
use super::tasks::{ActionEnd, Tasks};
use crate::agent::error::PerceiveError;
use crate::agent::runtime::threads::parallelism;
use crate::agent::runtime::timing::ModelTiming;
use crate::dictionary::{Ald, DictionaryError, Parameters, Reservoir, Selection, width_for_size};
use crate::kernel::{Kernel, KernelError, median_distance};
use crate::policy::{Recent, Reflexes, columns};
use crate::robot::{Action, ActionSet};
use crate::scenario::{self, Plan, Scenario, SelectionRule};
use crate::slow::{Link, SlowError, SlowStream, StreamOptions};
use crate::source::{Frame, GoalMove, Mark, View};
use crate::value::{Transition, Window};
use crate::vision::{Observation, Observer};

/// How many new support vectors are gathered before retained frames get their coordinates.
const SETTLE_AT: usize = 128;

/// An automatic width is at least this share of the median distance of the first frames: where a robot stood still for
/// long, the search for a size would else go down to the noise of the camera.
const NARROWEST: f64 = 0.5;

/// A frame that waits for its block.
struct Pending {
    observation: Arc<Observation>,
    link: Option<Link>,
    /// For the last frame of an action: where it ended, and which actions may follow, as bits.
    boundary: Option<(ActionEnd, u32)>,
    action: Option<Action>,
}

/// What came of a frame.
#[derive(Default)]
pub struct Learning {
    pub growth: Option<Growth>,
    pub request: Option<SolveRequest>,
}

/// What was seen in a frame.
pub struct SeenFrame {
    pub observation: Arc<Observation>,
    /// At the end of an action.
    pub percept: Option<Percept>,
    /// Tasks that moved with it.
    pub moved: Vec<GoalMove>,
    /// Marks that count, and why others do not.
    pub marks: Vec<Mark>,
    pub refused: Vec<String>,
}

/// Vision, dictionary, moments and window.
pub struct Perceive {
    scenario: Arc<Scenario>,
    timing: Arc<ModelTiming>,
    par: Par,
    observer: Observer,
    stream: Option<SlowStream<f32>>,
    pending: Vec<Pending>,
    goals: Tasks,
    /// Tasks may move: the window keeps where an action ended, and rewards follow from that when they are needed.
    window: Window<Arc<Observation>, ActionEnd>,
    last_number: Option<u64>,
    reflexes: Reflexes,
    actions: ActionSet,
    /// What the reflexes are to know of the actions so far.
    recent: Recent,
    /// The observation before the action that is going on, and its cell.
    last_boundary: Option<(Arc<Observation>, usize)>,
    asked: Vec<u64>,
    /// Whether a model is due that was not asked for yet.
    owed: bool,
    /// Whether policies for where the goals are now were not asked for yet.
    refit: bool,
    /// Whether somebody marks, or did with the last action: policies follow when that is over.
    marking: bool,
    last_request: Option<u64>,
    frames: u64,
    stamp_ns: u64,
}

impl Perceive {
    /// An actor that has seen nothing.
    pub fn new(scenario: Arc<Scenario>, plan: Arc<Plan>, timing: Arc<ModelTiming>) -> Self {
        Perceive {
            goals: Tasks::new(&scenario, plan),
            window: Window::new(scenario.value.window),
            par: parallelism(&scenario.agent),
            reflexes: Reflexes::new(&scenario),
            actions: scenario.robot.actions(),
            scenario,
            timing,
            observer: Observer::default(),
            stream: None,
            pending: Vec::new(),
            last_number: None,
            recent: Recent::default(),
            last_boundary: None,
            asked: Vec::new(),
            owed: false,
            refit: false,
            marking: false,
            last_request: None,
            frames: 0,
            stamp_ns: 0,
        }
    }

    /// See a frame: its observation, and at the end of an action the percept to act on. Tasks move at the end of actions, too,
    /// and what the action came to is judged by where they are then.
    pub fn see(&mut self, frame: Frame) -> SeenFrame {
        let pixels = match frame.view {
            View::Observation(pixels) => pixels,
            View::Image(image) => {
                let mut pixels = Vec::new();
                self.observer.observe(&image, &self.scenario.vision, &mut pixels);
                pixels
            }
        };
        let observation = Arc::new(Observation { frame: frame.number, pixels });
        let follows = self.last_number.is_some_and(|last| last + 1 == frame.number);
        let link = frame.action.filter(|_| follows).map(|action| Link {
            dt: self.scenario.robot.frame_seconds(),
            weight: if self.actions.advances(action) { self.scenario.slow.move_weight } else { 1.0 },
        });
        // Nothing is near a place that nobody knows: no reward, no goal.
        let place = frame.truth.map_or(Point2::new(f64::NAN, f64::NAN), |pose| pose.position);
        if let Some(boundary) = &frame.boundary {
            // Without an action the recording was interrupted: what was before has nothing to do with it.
            let after = |action| self.recent.then(action, boundary.blocked);
            self.recent = frame.action.map_or(Recent::default(), after);
        }
        let rewards = frame.rewards;
        let end_of = |blocked: bool| ActionEnd { place, blocked, rewards: rewards.clone() };
        self.pending.push(Pending {
            observation: observation.clone(),
            link,
            boundary: frame.boundary.map(|end| (end_of(end.blocked), self.reflexes.allowed(self.recent))),
            action: frame.action,
        });
        self.last_number = Some(frame.number);
        self.stamp_ns = frame.stamp_ns;
        self.frames += 1;
        let moved = match frame.boundary {
            Some(_) => self.goals.follow(frame.number, &frame.moved),
            None => Vec::new(),
        };
        let (marks, refused) = self.goals.mark(&frame.marks, &observation, place);
        self.marking |= !marks.is_empty();
        let marked = frame.boundary.is_some() && marks.is_empty() && std::mem::take(&mut self.marking);
        // Before the first model there is nothing to fit again.
        self.refit |= (marked || !moved.is_empty()) && self.last_request.is_some();
        if self.timing.announces(frame.number, self.refit || self.timing.is_due(self.frames)) {
            self.asked.push(frame.number);
        }
        let percept = frame.boundary.map(|boundary| Percept {
            observation: observation.clone(),
            stamp_ns: frame.stamp_ns,
            sonar: frame.sonar,
            action: frame.action,
            recent: self.recent,
            outcomes: self.goals.outcomes_of(&end_of(boundary.blocked)),
            goto: frame.goto,
            asked: std::mem::take(&mut self.asked),
        });
        SeenFrame { observation, percept, moved, marks, refused }
    }

    /// Learn from what was seen, when a block is full or a model is asked for. A model that is due, but is not asked for now,
    /// is owed. `has_room`: whether the solver is free.
    pub fn learn(&mut self, has_room: bool) -> Result<Learning, PerceiveError> {
        self.owed |= self.timing.is_due(self.frames);
        let wanted = self.owed || self.refit;
        let due = self.last_number.is_some_and(|frame| self.timing.asks(frame, wanted, has_room));
        let keeps_features = self.refit && !self.owed;
        self.owed &= !due;
        self.refit &= !due;
        let gathering = self.stream.is_none() && self.scenario.dictionary.sigma.is_none();
        let block =
            if gathering { self.scenario.dictionary.sigma_frames } else { self.scenario.dictionary.block_frames };
        let growth = if due || self.pending.len() >= block { self.flush()? } else { None };
        let request = if due { self.request(keeps_features)? } else { None };
        Ok(Learning { growth, request })
    }

    /// Learn from the last frames, and ask for the last model.
    pub fn finish(&mut self) -> Result<Learning, PerceiveError> {
        let growth = self.flush()?;
        let already = self.last_request.is_some() && self.last_request == self.last_number;
        let request = if already { None } else { self.request(false)? };
        Ok(Learning { growth, request })
    }

    fn request(&mut self, keeps_features: bool) -> Result<Option<SolveRequest>, PerceiveError> {
        let (Some(asked_at), Some(stream)) = (self.last_number, self.stream.as_mut()) else { return Ok(None) };
        self.last_request = Some(asked_at);
        let refuse = |cause| PerceiveError::Block { last_frame: asked_at, cause };
        let sums = match keeps_features {
            true => None,
            false => {
                let moments = stream.settled_moments().map_err(refuse)?.clone();
                Some((stream.dictionary().clone(), moments))
            }
        };
        Ok(Some(SolveRequest {
            asked_at,
            stamp_ns: self.stamp_ns,
            frames: self.frames,
            sums,
            window: self.window_with_outcomes(),
            goals: self.goals.centres(),
            marks: self.goals.marks.clone(),
        }))
    }

    fn window_with_outcomes(&self) -> Vec<TaskTransition> {
        let with_outcomes = |t: Transition<Arc<Observation>, ActionEnd>| {
            let Transition { from, action, allowed, result, to, cell } = t;
            Transition { from, action, allowed, result: self.goals.outcomes_of(&result), to, cell }
        };
        self.window.snapshot().into_iter().map(with_outcomes).collect()
    }

    /// Put all pending frames into the stream, and the transitions that end in them into the window.
    fn flush(&mut self) -> Result<Option<Growth>, PerceiveError> {
        let pending = std::mem::take(&mut self.pending);
        let (Some(first), Some(last)) = (pending.first(), pending.last()) else { return Ok(None) };
        let (first_frame, last_frame) = (first.observation.frame, last.observation.frame);
        let x = columns(pending.iter().map(|frame| frame.observation.as_ref()));
        let refuse = |cause| PerceiveError::Block { last_frame, cause };
        if self.stream.is_none() {
            self.stream = Some(self.begin(&x).map_err(|error| error.at_frame(last_frame))?);
        }
        let Some(stream) = self.stream.as_mut() else { return Ok(None) };
        let links: Vec<Option<Link>> = pending.iter().map(|frame| frame.link).collect();
        let (mut accepted, mut quarantined) = (Vec::new(), Vec::new());
        let mut start = 0;
        while start < pending.len() {
            let size = self.scenario.dictionary.block_frames.min(pending.len() - start);
            let screened =
                stream.push_finite(x.as_ref().subcols(start, size), &links[start..start + size]).map_err(refuse)?;
            let frame_at = |index: usize| pending[start + index].observation.frame;
            accepted.extend(screened.block.accepted.iter().map(|&index| frame_at(screened.taken[index])));
            quarantined.extend(screened.quarantined.iter().map(|&index| frame_at(index)));
            let mut cells = screened.block.nearest.iter();
            for (index, frame) in pending[start..start + size].iter().enumerate() {
                let cell = if screened.quarantined.contains(&index) { None } else { cells.next().copied() };
                if frame.link.is_none() {
                    // Frames are missing before this one: the outcome of the action is not known.
                    self.last_boundary = None;
                }
                let Some((end, allowed)) = frame.boundary.clone() else { continue };
                let Some(cell) = cell else {
                    // Nothing is known of where this action ended and the next one began.
                    self.last_boundary = None;
                    continue;
                };
                let before = self.last_boundary.replace((frame.observation.clone(), cell));
                if let (Some((from, cell)), Some(action)) = (before, frame.action) {
                    self.window.push(Transition {
                        from,
                        action: action.index(),
                        allowed,
                        result: end,
                        to: frame.observation.clone(),
                        cell,
                    });
                }
            }
            start += size;
        }
        let dictionary = stream.dictionary();
        Ok(Some(Growth {
            first_frame,
            last_frame,
            stamp_ns: self.stamp_ns,
            accepted,
            quarantined,
            size: dictionary.len(),
            sigma: dictionary.kernel().sigma().unwrap_or(f64::NAN),
            nu: stream.selection().nu(),
            at_budget: stream.selection().is_full(),
        }))
    }

    /// The stream, with the kernel width of the scenario or of the first frames.
    fn begin(&self, first: &Mat<f32>) -> Result<SlowStream<f32>, BeginError> {
        let settings = &self.scenario.dictionary;
        let sigma = match settings.sigma {
            Some(sigma) => sigma,
            None => automatic_width(first, settings, self.par)?,
        };
        self.stream_of_width(sigma)
    }

    fn stream_of_width(&self, sigma: f64) -> Result<SlowStream<f32>, BeginError> {
        let settings = &self.scenario.dictionary;
        let (kernel, budget, par) = (Kernel::radial(sigma, settings.exponent)?, settings.budget, self.par);
        let selection: Box<dyn Selection<f32>> = match settings.selection {
            SelectionRule::Ald => {
                let (nu, when_full) = (settings.nu, settings.when_full);
                Box::new(Ald::new(Parameters { kernel, nu, budget, when_full, par })?)
            }
            SelectionRule::Random => Box::new(Reservoir::new(kernel, budget, self.scenario.seed, par)?),
        };
        Ok(SlowStream::from_boxed(selection, stream_options(&self.scenario))?)
    }
}

impl Perceive {
    /// Whether the frames of all actions of the scenario have been seen.
    pub fn has_all_frames(&self) -> bool {
        let end = self.scenario.actions * self.scenario.robot.frames_per_action;
        self.last_number.is_some_and(|last| last >= end as u64)
    }

    /// Frames seen, and the last one.
    pub fn progress(&self) -> (u64, Option<u64>) {
        (self.frames, self.last_number)
    }
}

/// How the stream of a scenario retains frames.
pub fn stream_options(scenario: &Scenario) -> StreamOptions {
    StreamOptions {
        retained: scenario.dictionary.retained_frames,
        memory_frames: scenario.slow.memory_frames,
        settle_at: SETTLE_AT,
        ..StreamOptions::default()
    }
}

/// The width at which the scenario's share of the first frames become support vectors, but not below [`NARROWEST`].
fn automatic_width(first: &Mat<f32>, settings: &scenario::Dictionary, par: Par) -> Result<f64, BeginError> {
    let median = median_distance(first.as_ref())?;
    let target = ((settings.sigma_share * first.ncols() as f64).round() as usize).max(1);
    let kernel = |sigma| Kernel::radial(sigma, settings.exponent);
    let width = match width_for_size(first.as_ref(), settings.nu, target, kernel, par) {
        Ok(found) => found.sigma,
        // So many frames do not differ at all.
        Err(DictionaryError::Target { .. }) => 0.0,
        Err(other) => return Err(other.into()),
    };
    Ok(width.max(NARROWEST * median))
}

/// Why the stream could not begin.
#[derive(Debug, Error)]
enum BeginError {
    #[error(transparent)]
    Kernel(#[from] KernelError),
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    #[error(transparent)]
    Stream(#[from] SlowError),
}

impl BeginError {
    fn at_frame(self, last_frame: u64) -> PerceiveError {
        match self {
            BeginError::Kernel(error) => PerceiveError::Width(error),
            BeginError::Dictionary(cause) => PerceiveError::Block { last_frame, cause: cause.into() },
            BeginError::Stream(cause) => PerceiveError::Block { last_frame, cause },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Pose;
    use crate::snapshot::{Persist, Snapshot};
    use crate::source::Boundary;

    #[test]
    fn percepts_know_the_turn_before_a_push_until_a_recording_is_interrupted() {
        let text = include_str!("../../../../scenarios/lab.toml");
        let scenario = Arc::new(Scenario::parse(text, std::path::Path::new("lab.toml"), &[]).unwrap());
        let plan = Arc::new(Plan::new(&scenario).unwrap());
        let timing = || Arc::new(ModelTiming::new(&scenario.agent, None));
        let mut perceive = Perceive::new(scenario.clone(), plan.clone(), timing());
        let frame = |number: u64, action: Option<Action>, blocked: bool| {
            let pose = Pose::new(Point2::new(1.5, 0.9), 0.0);
            let pixels = vec![128; 3 * scenario.vision.width * scenario.vision.height];
            let (sonar, moved) = (vec![1.0; 16], Vec::new());
            let (view, boundary) = (View::Observation(pixels), Some(Boundary { blocked }));
            let marks = Vec::new();
            let truth = Some(pose);
            let rewards = Vec::new();
            Frame {
                number,
                stamp_ns: number,
                view,
                truth,
                odometry: pose,
                sonar,
                action,
                boundary,
                moved,
                marks,
                goto: None,
                rewards,
            }
        };
        let mut see =
            |frame| (perceive.see(frame).percept.unwrap().recent, perceive.pending.last().unwrap().boundary.clone());
        assert_eq!(see(frame(0, None, false)).0, Recent::default());
        see(frame(1, Some(Action::TURN_LEFT), false));
        let (recent, boundary) = see(frame(2, Some(Action::FORWARD), true));
        assert_eq!(recent, Recent { action: Some(Action::TURN_LEFT), blocked: Some(Action::FORWARD) });
        // Only the same turn may follow, and that is what values will count on.
        assert_eq!(boundary.as_ref().unwrap().1, 1 << Action::TURN_LEFT.index());

        // It is the same after it was saved and restored.
        let mut snapshot = Snapshot::new();
        perceive.persist(&mut snapshot).unwrap();
        let mut again = Perceive::new(scenario.clone(), plan, timing());
        again.persist(&mut Snapshot::restoring(snapshot.matrices, snapshot.texts)).unwrap();
        assert_eq!(again.recent, recent);
        assert_eq!(again.pending.last().unwrap().boundary, boundary);

        assert_eq!(again.see(frame(3, None, false)).percept.unwrap().recent, Recent::default());
    }
}
