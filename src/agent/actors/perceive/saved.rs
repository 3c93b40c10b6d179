//! The perceive actor in a snapshot of the run.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::super::saved::{action_of, link_bits, link_of, place_bits, place_of, recent_numbers, recent_of, wrong};
use super::{Pending, Perceive};
use crate::parts::{Parts, PartsError, Persist};
use crate::robot::Action;
use crate::value::{Transition, Window};
use crate::vision::Observation;

/// A frame that waits, with its observation named by its frame.
#[derive(Serialize, Deserialize)]
struct Waiting {
    frame: u64,
    link: Option<(u64, u64)>,
    came_to: Option<([u64; 2], u32)>,
    action: Option<usize>,
}

/// It is made again into a new one of the same scenario.
impl Persist for Perceive {
    fn persist(&mut self, parts: &mut Parts) -> Result<(), PartsError> {
        let kernel = self.stream.as_ref().map(|stream| stream.dictionary().kernel());
        let mut sigma = kernel.and_then(|kernel| kernel.sigma()).map(f64::to_bits);
        parts.value("sigma", &mut sigma)?;
        if parts.is_restoring() {
            let begun = sigma.map(|bits| self.stream_of_width(f64::from_bits(bits))).transpose();
            self.stream = begun.map_err(|cause| wrong("sigma", cause))?;
        }
        if let Some(stream) = &mut self.stream {
            parts.inner("stream", stream)?;
        }
        parts.inner("goals", &mut self.goals)?;
        parts.value("last_number", &mut self.last_number)?;
        let mut recent = recent_numbers(self.recent);
        parts.value("recent", &mut recent)?;
        self.recent = recent_of(parts, recent)?;
        parts.value("owed", &mut self.owed)?;
        parts.value("refit", &mut self.refit)?;
        parts.value("last_request", &mut self.last_request)?;
        parts.value("frames", &mut self.frames)?;
        parts.value("stamp_ns", &mut self.stamp_ns)?;
        let values = 3 * self.scenario.vision.width * self.scenario.vision.height;
        if parts.is_restoring() { self.take_seen(parts, values) } else { self.put_seen(parts, values) }
    }
}

impl Perceive {
    fn put_seen(&self, parts: &mut Parts, values: usize) -> Result<(), PartsError> {
        let mut seen = Seen::default();
        put_window(&self.window, &mut seen, parts)?;
        let mut last_boundary = self.last_boundary.as_ref().map(|(before, cell)| (seen.add(before), *cell));
        let mut pending: Vec<Waiting> = self
            .pending
            .iter()
            .map(|frame| Waiting {
                frame: seen.add(&frame.observation),
                link: frame.link.map(link_bits),
                came_to: frame.boundary.map(|(place, allowed)| (place_bits(place), allowed)),
                action: frame.action.map(Action::index),
            })
            .collect();
        parts.value("last_boundary", &mut last_boundary)?;
        parts.value("pending", &mut pending)?;
        seen.persist(parts, values)
    }

    fn take_seen(&mut self, parts: &mut Parts, values: usize) -> Result<(), PartsError> {
        let mut seen = Seen::default();
        seen.persist(parts, values)?;
        self.window = take_window(self.scenario.value.window, &seen, parts)?;
        let (mut last_boundary, mut pending): (Option<(u64, usize)>, Vec<Waiting>) = (None, Vec::new());
        parts.value("last_boundary", &mut last_boundary)?;
        parts.value("pending", &mut pending)?;
        self.last_boundary = match last_boundary {
            Some((frame, cell)) => Some((seen.get(frame)?, cell)),
            None => None,
        };
        let frame = |waiting: Waiting| {
            Ok(Pending {
                observation: seen.get(waiting.frame)?,
                link: waiting.link.map(link_of),
                boundary: waiting.came_to.map(|(place, allowed)| (place_of(place), allowed)),
                action: waiting.action.map(|number| action_of(parts, number)).transpose()?,
            })
        };
        self.pending = pending.into_iter().map(frame).collect::<Result<_, PartsError>>()?;
        Ok(())
    }
}

/// Observations that several others refer to by their frames: each is kept once.
#[derive(Default)]
struct Seen {
    observations: BTreeMap<u64, Arc<Observation>>,
}

impl Seen {
    /// Take note of one, and name it by its frame.
    fn add(&mut self, observation: &Arc<Observation>) -> u64 {
        self.observations.entry(observation.frame).or_insert_with(|| observation.clone()).frame
    }

    /// One that was added.
    fn get(&self, frame: u64) -> Result<Arc<Observation>, PartsError> {
        self.observations
            .get(&frame)
            .cloned()
            .ok_or_else(|| PartsError::Missing(format!("the observation of frame {frame}")))
    }

    /// Put away or make again all of them, each of `values` pixels.
    fn persist(&mut self, parts: &mut Parts, values: usize) -> Result<(), PartsError> {
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
fn put_window(window: &Lives, seen: &mut Seen, parts: &mut Parts) -> Result<(), PartsError> {
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
fn take_window(capacity: usize, seen: &Seen, parts: &mut Parts) -> Result<Lives, PartsError> {
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
