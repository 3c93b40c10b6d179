//! A snapshot of the run: the state of every actor at one moment, a boundary between two actions.
//!
//! This is the marker algorithm of Chandy and Lamport (1985) on a ring: the act actor puts its own state into a [`Marker`] and
//! sends it the way of an action. Each actor that it comes to adds its state and passes it on, in order with everything else, so
//! all parts belong to one moment although nobody stops. No model is being made at that moment: the marker finds the solvers idle.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64};
use std::time::Duration;

use crate::snapshot::{Persist, Snapshot};

/// Where and when the state of a run is saved.
#[derive(Debug, Clone)]
pub struct SnapshotSettings {
    /// The file.
    pub path: PathBuf,
    /// Time between two states; `None`: only when the run is interrupted.
    pub every: Option<Duration>,
}

/// A state of the run on its way through the actors.
#[derive(Debug)]
pub struct Marker {
    /// What was added so far.
    pub snapshot: Snapshot,
    /// The last frame before the moment.
    pub frame: u64,
    /// Its time.
    pub stamp_ns: u64,
    /// Models that had been asked for, as far as the actor that acts knows.
    pub requests: u64,
}

impl Marker {
    /// With the state of one more actor; nothing if that cannot be saved.
    pub fn with(mut self: Box<Self>, name: &str, actor: &mut impl Persist) -> Option<Box<Self>> {
        self.snapshot.inner(name, actor).is_ok().then_some(self)
    }
}

/// How quiet the solvers are, between the actor that asks for models and the one that acts on them.
#[derive(Default)]
pub struct Quiescence {
    /// No models are to be asked for, where that is not fixed: the state of the run is to be saved.
    pub hold: AtomicBool,
    /// Models asked for so far.
    pub requests: AtomicU64,
}
