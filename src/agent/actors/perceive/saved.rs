//! The perceive actor in a snapshot of the run.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::super::messages::Marked;
use super::super::saved::{action_of, link_bits, link_of, place_bits, place_of, recent_numbers, recent_of, wrong};
use super::super::tasks::ActionEnd;
use super::{Pending, Perceive};
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
    rewards: Vec<u64>,
    action: Option<usize>,
}

/// A mark: its task, the frame of its observation, and the bits of its place.
type SavedMark = (usize, u64, Option<[u64; 2]>);

/// It is restored into a new one of the same scenario.
impl Persist for Perceive {
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
        snapshot.inner("goals", &mut self.goals)?;
        snapshot.value("last_number", &mut self.last_number)?;
        let mut recent = recent_numbers(self.recent);
        snapshot.value("recent", &mut recent)?;
        self.recent = recent_of(snapshot, recent)?;
        snapshot.value("owed", &mut self.owed)?;
        snapshot.value("refit", &mut self.refit)?;
        snapshot.value("last_request", &mut self.last_request)?;
        snapshot.value("frames", &mut self.frames)?;
        snapshot.value("stamp_ns", &mut self.stamp_ns)?;
        let values = 3 * self.scenario.vision.width * self.scenario.vision.height;
        if snapshot.is_restoring() { self.take_seen(snapshot, values) } else { self.put_seen(snapshot, values) }
    }
}

impl Perceive {
    fn put_seen(&self, snapshot: &mut Snapshot, values: usize) -> Result<(), SnapshotError> {
        let mut seen = Observations::default();
        put_window(&self.window, &mut seen, snapshot)?;
        let mut last_boundary = self.last_boundary.as_ref().map(|(before, cell)| (seen.add(before), *cell));
        let mut pending: Vec<Waiting> = self
            .pending
            .iter()
            .map(|frame| Waiting {
                frame: seen.add(&frame.observation),
                link: frame.link.map(link_bits),
                came_to: frame.boundary.as_ref().map(|(end, allowed)| (place_bits(end.place), *allowed)),
                blocked: frame.boundary.as_ref().is_some_and(|(end, _)| end.blocked),
                rewards: frame.boundary.as_ref().map_or(Vec::new(), |(end, _)| bits(&end.rewards)),
                action: frame.action.map(Action::index),
            })
            .collect();
        snapshot.value("last_boundary", &mut last_boundary)?;
        snapshot.value("pending", &mut pending)?;
        if self.scenario.shows_any() {
            let of = |marked: &Marked| {
                (marked.task, seen.add(&marked.observation), marked.place.map(|at| at.map(f64::to_bits)))
            };
            let mut marks: Vec<SavedMark> = self.goals.marks.iter().map(of).collect();
            snapshot.value("marks", &mut marks)?;
            snapshot.value("marking", &mut self.marking.clone())?;
        }
        seen.persist(snapshot, values)
    }

    fn take_seen(&mut self, snapshot: &mut Snapshot, values: usize) -> Result<(), SnapshotError> {
        let mut seen = Observations::default();
        seen.persist(snapshot, values)?;
        self.window = take_window(self.scenario.value.window, &seen, snapshot)?;
        let (mut last_boundary, mut pending): (Option<(u64, usize)>, Vec<Waiting>) = (None, Vec::new());
        snapshot.value("last_boundary", &mut last_boundary)?;
        snapshot.value("pending", &mut pending)?;
        self.last_boundary = match last_boundary {
            Some((frame, cell)) => Some((seen.get(frame)?, cell)),
            None => None,
        };
        let frame = |waiting: Waiting| {
            Ok(Pending {
                observation: seen.get(waiting.frame)?,
                link: waiting.link.map(link_of),
                boundary: waiting
                    .came_to
                    .map(|(place, allowed)| (end_of(place, waiting.blocked, &waiting.rewards), allowed)),
                action: waiting.action.map(|number| action_of(snapshot, number)).transpose()?,
            })
        };
        self.pending = pending.into_iter().map(frame).collect::<Result<_, SnapshotError>>()?;
        if self.scenario.shows_any() {
            let mut marks: Vec<SavedMark> = Vec::new();
            snapshot.value("marks", &mut marks)?;
            snapshot.value("marking", &mut self.marking)?;
            let marked = |(task, frame, place): SavedMark| {
                Ok(Marked { task, observation: seen.get(frame)?, place: place.map(|bits| bits.map(f64::from_bits)) })
            };
            self.goals.marks = marks.into_iter().map(marked).collect::<Result<_, SnapshotError>>()?;
            let tasks = self.scenario.names().count();
            snapshot.check("marks", self.goals.marks.iter().all(|marked| marked.task < tasks), "other tasks")?;
        }
        Ok(())
    }
}

/// Observations that several others refer to by their frames: each is kept once.
#[derive(Default)]
struct Observations {
    observations: BTreeMap<u64, Arc<Observation>>,
}

impl Observations {
    /// Take note of one, and name it by its frame.
    fn add(&mut self, observation: &Arc<Observation>) -> u64 {
        self.observations.entry(observation.frame).or_insert_with(|| observation.clone()).frame
    }

    /// One that was added.
    fn get(&self, frame: u64) -> Result<Arc<Observation>, SnapshotError> {
        self.observations
            .get(&frame)
            .cloned()
            .ok_or_else(|| SnapshotError::Missing(format!("the observation of frame {frame}")))
    }

    /// Save or restore all of them, each of `values` pixels.
    fn persist(&mut self, snapshot: &mut Snapshot, values: usize) -> Result<(), SnapshotError> {
        let mut frames: Vec<u64> = self.observations.keys().copied().collect();
        let mut pixels = Vec::with_capacity(if snapshot.is_restoring() { 0 } else { values * frames.len() });
        self.observations.values().for_each(|seen| pixels.extend_from_slice(&seen.pixels));
        snapshot.value("seen", &mut frames)?;
        snapshot.numbers("seen_pixels", &mut pixels)?;
        snapshot.check("seen_pixels", pixels.len() == values * frames.len(), "another number than the frames have")?;
        if snapshot.is_restoring() {
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
    #[serde(default)]
    blocked: bool,
    #[serde(default)]
    rewards: Vec<u64>,
}

/// How an action ended, from what was saved of it.
fn end_of(place: [u64; 2], blocked: bool, rewards: &[u64]) -> ActionEnd {
    let rewards = rewards.iter().map(|&bits| f64::from_bits(bits)).collect();
    ActionEnd { place: place_of(place), blocked, rewards }
}

fn bits(numbers: &[f64]) -> Vec<u64> {
    numbers.iter().map(|number| number.to_bits()).collect()
}

/// The window of transitions, each with how it ended.
type PlaceWindow = Window<Arc<Observation>, ActionEnd>;

/// Save a window of transitions: what they refer to is added to `seen`.
fn put_window(window: &PlaceWindow, seen: &mut Observations, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
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
            rewards: bits(&t.result.rewards),
            to: seen.add(&t.to),
            cell: t.cell,
        })
        .collect();
    snapshot.value("window", &mut stored)?;
    snapshot.value("arrivals", &mut next)
}

/// Restore a window.
fn take_window(capacity: usize, seen: &Observations, snapshot: &mut Snapshot) -> Result<PlaceWindow, SnapshotError> {
    let (mut stored, mut next): (Vec<Stored>, u64) = (Vec::new(), 0);
    snapshot.value("window", &mut stored)?;
    snapshot.value("arrivals", &mut next)?;
    snapshot.check("window", stored.len() <= capacity, "more than it has room for")?;
    let transition = |t: Stored| {
        action_of(snapshot, t.action)?;
        let (from, to) = (seen.get(t.from)?, seen.get(t.to)?);
        let result = end_of(t.place, t.blocked, &t.rewards);
        Ok((t.arrival, Transition { from, action: t.action, allowed: t.allowed, result, to, cell: t.cell }))
    };
    let entries: Result<Vec<_>, SnapshotError> = stored.into_iter().map(transition).collect();
    Ok(Window::restored(capacity, entries?, next))
}
