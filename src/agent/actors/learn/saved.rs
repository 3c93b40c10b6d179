//! The learn actor in a snapshot of the run.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::super::saved::{
    Observations, StepBits, action_of, link_bits, link_of, place_bits, place_of, step_bits, step_from, wrong,
};
use super::super::tasks::ActionEnd;
use super::{Learn, SERIES, Sample};
use crate::robot::Action;
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::value::{Transition, Window};
use crate::vision::Observation;

/// A frame that waits, with its observation named by its frame.
#[derive(Serialize, Deserialize)]
struct Waiting {
    frame: u64,
    link: Option<(u64, u64)>,
    came_to: Option<([u64; 2], u32)>,
    #[serde(default)]
    blocked: bool,
    #[serde(default)]
    step: Option<StepBits>,
    #[serde(default)]
    rewards: Vec<u64>,
    action: Option<usize>,
}

/// It is restored into a new one of the same scenario; the tasks as they are come with the next frame, or by [`Learn::set_tasks`].
impl Persist for Learn {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let kernel = self.stream.as_ref().map(|stream| stream.dictionary().kernel());
        let mut sigma = kernel.and_then(|kernel| kernel.sigma()).map(f64::to_bits);
        snapshot.value("sigma", &mut sigma)?;
        if snapshot.is_restoring() {
            let begun = sigma.map(|bits| self.stream_of_width(f64::from_bits(bits))).transpose();
            self.stream = begun.map_err(|cause| wrong("sigma", cause))?;
        }
        if let Some(stream) = &mut self.stream {
            snapshot.inner("stream", stream)?;
        }
        snapshot.value("last_number", &mut self.last_number)?;
        snapshot.value("owed", &mut self.owed)?;
        snapshot.value("refit", &mut self.refit)?;
        snapshot.value("last_request", &mut self.last_request)?;
        snapshot.value("frames", &mut self.frames)?;
        snapshot.value("stamp_ns", &mut self.stamp_ns)?;
        let values = self.scenario.vision.values();
        if snapshot.is_restoring() { self.take_seen(snapshot, values) } else { self.put_seen(snapshot, values) }
    }
}

impl Learn {
    fn put_seen(&self, snapshot: &mut Snapshot, values: usize) -> Result<(), SnapshotError> {
        let mut seen = Observations::default();
        put_window(&self.transitions.window, &mut seen, snapshot)?;
        let boundaries = self.transitions.boundaries.values();
        let mut boundaries: Vec<(u64, usize)> = boundaries.map(|(before, cell)| (seen.add(before), *cell)).collect();
        snapshot.value("boundaries", &mut boundaries)?;
        put_samples(&self.pending, &mut seen, snapshot)?;
        let mut looks_again = self.begun.is_some();
        snapshot.value("looks_again", &mut looks_again)?;
        let begun = self.begun.as_deref().unwrap_or_default();
        snapshot.scope("begun", |snapshot| put_samples(begun, &mut seen, snapshot))?;
        seen.persist(snapshot, values)
    }

    fn take_seen(&mut self, snapshot: &mut Snapshot, values: usize) -> Result<(), SnapshotError> {
        let mut seen = Observations::default();
        seen.persist(snapshot, values)?;
        self.transitions.window = take_window(self.scenario.value.window, &seen, snapshot)?;
        let mut boundaries: Vec<(u64, usize)> = Vec::new();
        snapshot.value("boundaries", &mut boundaries)?;
        let of = boundaries.into_iter().map(|(frame, cell)| Ok((frame / SERIES, (seen.get(frame)?, cell))));
        self.transitions.boundaries = of.collect::<Result<_, SnapshotError>>()?;
        self.pending = take_samples(&seen, snapshot)?;
        let mut looks_again = false;
        snapshot.value("looks_again", &mut looks_again)?;
        let begun = snapshot.scope("begun", |snapshot| take_samples(&seen, snapshot))?;
        self.begun = looks_again.then_some(begun);
        Ok(())
    }
}

/// Save frames that wait: what they show is added to `seen`.
pub fn put_samples(samples: &[Sample], seen: &mut Observations, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
    let waiting = |frame: &Sample| Waiting {
        frame: seen.add(&frame.observation),
        link: frame.link.map(link_bits),
        came_to: frame.boundary.as_ref().map(|(end, allowed)| (place_bits(end.place), *allowed)),
        blocked: frame.boundary.as_ref().is_some_and(|(end, _)| end.blocked),
        step: frame.boundary.as_ref().and_then(|(end, _)| end.step.map(step_bits)),
        rewards: frame.boundary.as_ref().map_or(Vec::new(), |(end, _)| bits(&end.rewards)),
        action: frame.action.map(Action::index),
    };
    let mut pending: Vec<Waiting> = samples.iter().map(waiting).collect();
    snapshot.value("pending", &mut pending)
}

/// Restore frames that wait.
pub fn take_samples(seen: &Observations, snapshot: &mut Snapshot) -> Result<Vec<Sample>, SnapshotError> {
    let mut pending: Vec<Waiting> = Vec::new();
    snapshot.value("pending", &mut pending)?;
    let frame = |waiting: Waiting| {
        Ok(Sample {
            observation: seen.get(waiting.frame)?,
            link: waiting.link.map(link_of),
            boundary: waiting
                .came_to
                .map(|(place, allowed)| (end_of(place, waiting.blocked, waiting.step, &waiting.rewards), allowed)),
            action: waiting.action.map(|number| action_of(snapshot, number)).transpose()?,
        })
    };
    pending.into_iter().map(frame).collect()
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
    #[serde(default)]
    blocked: bool,
    #[serde(default)]
    step: Option<StepBits>,
    #[serde(default)]
    rewards: Vec<u64>,
}

/// How an action ended, from what was saved of it.
fn end_of(place: [u64; 2], blocked: bool, step: Option<StepBits>, rewards: &[u64]) -> ActionEnd {
    let rewards = rewards.iter().map(|&bits| f64::from_bits(bits)).collect();
    ActionEnd { place: place_of(place), blocked, step: step.map(step_from), rewards }
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// The window of transitions, each with how it ended.
pub type PlaceWindow = Window<Arc<Observation>, ActionEnd>;

/// Save a window of transitions: what they refer to is added to `seen`.
pub fn put_window(window: &PlaceWindow, seen: &mut Observations, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
    let (entries, mut next) = window.arrivals();
    let mut stored: Vec<Stored> = entries
        .into_iter()
        .map(|(arrival, t)| Stored {
            arrival,
            from: seen.add(&t.from),
            action: t.action,
            allowed: t.allowed,
            place: place_bits(t.result.place),
            blocked: t.result.blocked,
            step: t.result.step.map(step_bits),
            rewards: bits(&t.result.rewards),
            to: seen.add(&t.to),
            cell: t.cell,
        })
        .collect();
    snapshot.value("window", &mut stored)?;
    snapshot.value("arrivals", &mut next)
}

/// Restore a window.
pub fn take_window(
    capacity: usize,
    seen: &Observations,
    snapshot: &mut Snapshot,
) -> Result<PlaceWindow, SnapshotError> {
    let (mut stored, mut next): (Vec<Stored>, u64) = (Vec::new(), 0);
    snapshot.value("window", &mut stored)?;
    snapshot.value("arrivals", &mut next)?;
    snapshot.check("window", stored.len() <= capacity, "more than it has room for")?;
    let transition = |t: Stored| {
        action_of(snapshot, t.action)?;
        let (from, to) = (seen.get(t.from)?, seen.get(t.to)?);
        let result = end_of(t.place, t.blocked, t.step, &t.rewards);
        Ok((t.arrival, Transition { from, action: t.action, allowed: t.allowed, result, to, cell: t.cell }))
    };
    let entries: Result<Vec<_>, SnapshotError> = stored.into_iter().map(transition).collect();
    Ok(Window::restored(capacity, entries?, next))
}
