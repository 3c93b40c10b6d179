//! The learn actor: dictionary, moments, the window of transitions.
//!
//! [`Learn`] is the step; its loop is in `thread`, its saved form in `saved`.

pub mod saved;
mod thread;

pub use thread::{LearnLoop, LearnResult};

use std::collections::BTreeMap;
use std::sync::Arc;

use faer::{Mat, Par};
use thiserror::Error;

use super::messages::{Growth, SolveRequest};
use super::tasks::{ActionEnd, Tasks};
use crate::agent::error::LearnError;
use crate::agent::runtime::threads::parallelism;
use crate::agent::runtime::timing::ModelTiming;
use crate::dictionary::{Ald, DictionaryError, Parameters, Reservoir, Selection, wider_for_share, width_for_share};
use crate::kernel::{Kernel, KernelError};
use crate::policy::columns;
use crate::robot::Action;
use crate::scenario::{Scenario, SelectionRule};
use crate::slow::{Link, SlowError, SlowStream, StreamOptions};
use crate::value::{Transition, Window};
use crate::vision::Observation;

/// How many new support vectors are gathered before retained frames get their coordinates.
const SETTLE_AT: usize = 128;

/// Frames of several robots, each numbered from a multiple of this on.
pub const SERIES: u64 = 1 << 40;

/// A frame to be learned from.
#[derive(Clone)]
pub struct Sample {
    pub observation: Arc<Observation>,
    /// From the frame before; none if that is missing.
    pub link: Option<Link>,
    /// For the last frame of an action: where it ended, and which actions may follow, as bits.
    pub boundary: Option<(ActionEnd, u32)>,
    pub action: Option<Action>,
}

/// From perceive to learn.
pub struct Seen {
    pub sample: Sample,
    pub stamp_ns: u64,
    /// The tasks as they are with it.
    pub tasks: Arc<Tasks>,
    /// Whether policies are wanted for what changed about them.
    pub changed: bool,
}

/// A window of the transitions of frames.
pub struct Transitions {
    pub window: Window<Arc<Observation>, ActionEnd>,
    /// The observation before the action that is going on, and its cell; by robot, see [`SERIES`].
    boundaries: BTreeMap<u64, (Arc<Observation>, usize)>,
}

impl Transitions {
    /// None yet, and at most so many.
    pub fn new(capacity: usize) -> Self {
        Transitions { window: Window::new(capacity), boundaries: BTreeMap::new() }
    }

    /// The next frame, and its cell; `None` where nothing is known of it.
    pub fn add(&mut self, frame: &Sample, cell: Option<usize>) {
        let series = frame.observation.frame / SERIES;
        if frame.link.is_none() {
            // Frames are missing before this one: the outcome of the action is not known.
            self.boundaries.remove(&series);
        }
        let Some((end, allowed)) = frame.boundary.clone() else { return };
        let Some(cell) = cell else {
            // Nothing is known of where this action ended and the next one began.
            self.boundaries.remove(&series);
            return;
        };
        let before = self.boundaries.insert(series, (frame.observation.clone(), cell));
        if let (Some((from, cell)), Some(action)) = (before, frame.action) {
            let (action, to) = (action.index(), frame.observation.clone());
            self.window.push(Transition { from, action, allowed, result: end, to, cell });
        }
    }
}

/// What came of a frame.
#[derive(Default)]
pub struct Learning {
    pub growth: Option<Growth>,
    pub request: Option<SolveRequest>,
}

/// Dictionary, moments and window.
pub struct Learn {
    scenario: Arc<Scenario>,
    timing: Arc<ModelTiming>,
    par: Par,
    stream: Option<SlowStream<f32>>,
    /// Frames that wait for their block.
    pending: Vec<Sample>,
    /// Frames since the beginning, until the width of the kernel was looked at again; none where that is not done.
    begun: Option<Vec<Sample>>,
    /// As they were with the last frame. They may change: the window keeps where an action ended, and rewards follow from that when
    /// they are needed.
    tasks: Arc<Tasks>,
    transitions: Transitions,
    last_number: Option<u64>,
    /// Whether a model is due that was not asked for yet.
    owed: bool,
    /// Whether policies for the tasks as they are now were not asked for yet.
    refit: bool,
    last_request: Option<u64>,
    frames: u64,
    stamp_ns: u64,
}

impl Learn {
    /// An actor that has learned nothing.
    pub fn new(scenario: Arc<Scenario>, tasks: Arc<Tasks>, timing: Arc<ModelTiming>) -> Self {
        Learn {
            transitions: Transitions::new(scenario.value.window),
            par: parallelism(&scenario.agent),
            timing,
            tasks,
            stream: None,
            pending: Vec::new(),
            begun: scenario.dictionary.looks_again().map(|_| Vec::new()),
            scenario,
            last_number: None,
            owed: false,
            refit: false,
            last_request: None,
            frames: 0,
            stamp_ns: 0,
        }
    }

    /// The tasks as they are, where that is not known from a frame.
    pub fn set_tasks(&mut self, tasks: Arc<Tasks>) {
        self.tasks = tasks;
    }

    /// Learn from a frame: when a block is full, or a model is asked for. A model that is due, but is not asked for now, is owed.
    /// `has_room`: whether the solver is free.
    pub fn step(&mut self, seen: Seen, has_room: bool) -> Result<Learning, LearnError> {
        let frame = seen.sample.observation.frame;
        self.last_number = Some(frame);
        self.stamp_ns = seen.stamp_ns;
        self.frames += 1;
        self.tasks = seen.tasks;
        // Before the first model there is nothing to fit again.
        self.refit |= seen.changed && self.last_request.is_some();
        self.pending.push(seen.sample);
        self.owed |= self.timing.is_due(self.frames);
        let due = self.timing.asks(frame, self.owed || self.refit, has_room);
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
    pub fn finish(&mut self) -> Result<Learning, LearnError> {
        let growth = self.flush()?;
        let already = self.last_request.is_some() && self.last_request == self.last_number;
        let request = if already { None } else { self.request(false)? };
        Ok(Learning { growth, request })
    }

    fn request(&mut self, keeps_features: bool) -> Result<Option<SolveRequest>, LearnError> {
        let (Some(asked_at), Some(stream)) = (self.last_number, self.stream.as_mut()) else { return Ok(None) };
        self.last_request = Some(asked_at);
        let refuse = |cause| LearnError::Block { last_frame: asked_at, cause };
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
            window: self.tasks.judged(&self.transitions.window),
            goals: self.tasks.centres(),
            marks: self.tasks.marks.clone(),
        }))
    }

    /// Put all pending frames into the stream, and the transitions that end in them into the window.
    fn flush(&mut self) -> Result<Option<Growth>, LearnError> {
        let mut pending = std::mem::take(&mut self.pending);
        let Some(last_frame) = pending.last().map(|last| last.observation.frame) else { return Ok(None) };
        let began_anew = self.look_again(&mut pending).map_err(|error| error.at_frame(last_frame))?;
        let first_frame = pending[0].observation.frame;
        let x = columns(pending.iter().map(|frame| frame.observation.as_ref()));
        let refuse = |cause| LearnError::Block { last_frame, cause };
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
                self.transitions.add(frame, cell);
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
            began_anew,
        }))
    }

    /// If the width of the kernel, which the first frames gave, is far too narrow for those behind them, begin anew: these frames and all before are pending
    /// then. The width before, if so.
    fn look_again(&mut self, pending: &mut Vec<Sample>) -> Result<Option<f64>, BeginError> {
        let settings = &self.scenario.dictionary;
        let (Some(begun), Some((frames, share))) = (&mut self.begun, settings.looks_again()) else { return Ok(None) };
        begun.extend_from_slice(pending);
        let sigma = self.stream.as_ref().and_then(|stream| stream.dictionary().kernel().sigma());
        let Some(sigma) = sigma.filter(|_| begun.len() >= frames) else { return Ok(None) };
        let begun = self.begun.take().unwrap_or_default();
        let x = columns(begun.iter().map(|frame| frame.observation.as_ref()));
        let kernel = |sigma| Kernel::radial(sigma, settings.exponent);
        let wider = wider_for_share(x.as_ref(), settings.nu, share, sigma, kernel, self.par)?;
        let Some(wider) = wider else { return Ok(None) };
        self.stream = Some(self.stream_of_width(wider)?);
        self.transitions = Transitions::new(self.scenario.value.window);
        *pending = begun;
        Ok(Some(sigma))
    }

    /// The stream, with the kernel width of the scenario or of the first frames.
    fn begin(&self, first: &Mat<f32>) -> Result<SlowStream<f32>, BeginError> {
        let settings = &self.scenario.dictionary;
        let sigma = match settings.sigma {
            Some(sigma) => sigma,
            None => {
                let kernel = |sigma| Kernel::radial(sigma, settings.exponent);
                match width_for_share(first.as_ref(), settings.nu, settings.sigma_share, kernel, self.par) {
                    Err(DictionaryError::Kernel(cause)) => return Err(cause.into()),
                    found => found?,
                }
            }
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

impl Learn {
    /// Whether the frames of all actions of the scenario have been seen.
    pub fn has_all_frames(&self) -> bool {
        let end = self.scenario.actions * self.scenario.robot.frames_per_action;
        self.last_number.is_some_and(|last| last >= end as u64)
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
    fn at_frame(self, last_frame: u64) -> LearnError {
        match self {
            BeginError::Kernel(error) => LearnError::Width(error),
            BeginError::Dictionary(cause) => LearnError::Block { last_frame, cause: cause.into() },
            BeginError::Stream(cause) => LearnError::Block { last_frame, cause },
        }
    }
}
