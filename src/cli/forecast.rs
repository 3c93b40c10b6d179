//! How large the log of a run will be, from the log of its first actions.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use crate::agent::{RunError, RunOptions, Status, checkpoint_bytes, run};
use crate::log::NullStorage;
use crate::log::{LogError, LogOptions, Rotation, RunLog};
use crate::scenario::{Method, Mode, Scenario, WhenBehind};
use crate::world::Simulated;
use crate::world::World;

/// Frames that are made, logged and thrown away again to learn how large a frame is.
const FRAMES: usize = 1500;

/// Bytes that a second of real time adds, whatever happens in it: a message about the run's health, compressed among others.
const HEALTH_BYTES: f64 = 200.0;

/// How large the log of a run will be.
///
/// The size of a frame is measured: the first frames of the scenario are driven and logged with its options, nowhere. Models,
/// policies and what was learned, which come later, follow from their dimensions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LogForecast {
    /// All files of the run, before the oldest ones are deleted; bytes.
    pub bytes: u64,
    /// Of it, what was learned, at the end; bytes. At most: the dictionary may stay smaller than it can become.
    pub learned_bytes: u64,
    /// What a frame adds, with its share of actions and models, bytes.
    pub bytes_per_frame: f64,
    /// What an hour of driving adds, bytes.
    pub bytes_per_hour: f64,
    /// Driving time of the run, hours.
    pub hours: f64,
    /// Frames on which this was measured.
    pub measured_frames: u64,
}

impl LogForecast {
    /// Measure, which takes one to three seconds.
    ///
    /// # Errors
    /// As [`run`], without anything to do with files.
    pub fn of(
        scenario: &Scenario,
        world: &Arc<World>,
        options: &LogOptions,
        rotation: Rotation,
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, RunError> {
        let empty = open(options, metadata)?.finish()?.bytes;
        let per_action = scenario.robot.frames_per_action;
        let mut first = scenario.clone();
        first.actions = scenario.actions.min(FRAMES.div_ceil(per_action));
        // As fast as it goes, and with one small model, at the end.
        (first.agent.resolve_frames, first.slow.features) = (1 << 40, 1);
        (first.agent.mode, first.agent.when_behind) = (Mode::Lockstep, WhenBehind::Wait);
        let speed = first.agent.speed.take();
        let first = Arc::new(first);
        let mut source = Simulated::new(first.clone(), world.clone());
        let (stop, status) = (AtomicBool::new(false), Status::default());
        let options_of_run = RunOptions { flush_by_stamps: speed, ..RunOptions::new(&stop, &status) };
        let outcome = run(&first, &world.plan, &mut source, open(options, metadata)?, options_of_run)?;
        let attached = match &outcome.learned {
            Some(learned) => checkpoint_bytes(learned, &first)?.len() as u64,
            None => 0,
        };
        let measured = outcome.log.bytes.saturating_sub(empty + attached) as f64 / outcome.frames as f64;

        let frames = (scenario.actions * per_action) as f64 + 1.0;
        let (d, k) = (3 * scenario.vision.width * scenario.vision.height, scenario.slow.features + 1);
        let m =
            (frames * outcome.support_vectors as f64 / outcome.frames as f64).min(scenario.dictionary.budget as f64);
        // What transitions are worth is not in the messages.
        let of_policies = match scenario.value.method {
            Method::Lspi => scenario.robot.actions.len() * scenario.tasks.len(),
            Method::Local => 0,
        };
        let numbers = k * (1 + of_policies);
        let model = (size_of::<f64>() * numbers) as f64 / scenario.agent.resolve_frames as f64;
        let health = speed.map_or(0.0, |speed| HEALTH_BYTES * scenario.robot.frame_seconds() / speed);
        let per_frame = measured + model + health;
        let transitions = scenario.value.window.min(scenario.actions);
        let coordinates = size_of::<f32>() * scenario.value.metric_features.min(k - 1);
        // With places, four of the pose, and what is shown has its states beside.
        let of_pose = if scenario.value.places { 4 * size_of::<f32>() } else { 0 };
        let fits = if scenario.avoids.is_empty() { 1 } else { 2 };
        let of_values = match scenario.value.method {
            Method::Lspi => 0,
            Method::Local => transitions * (coordinates + of_pose + size_of::<f64>() * fits * scenario.tasks.len()),
        };
        // The map of the floor: two coordinates of each state.
        let of_map = match (scenario.shows_any(), scenario.value.method) {
            (false, _) => 0,
            (true, Method::Local) if !scenario.value.places => transitions * 2 * size_of::<f64>(),
            (true, _) => (transitions + 1) * (coordinates + 2 * size_of::<f64>()),
        };
        let learned = m * (size_of::<f32>() * d) as f64
            + m * m.min(k as f64) * size_of::<f64>() as f64
            + (of_values + of_map) as f64;
        let of_messages = frames * per_frame;
        let files = 1.0 + (of_messages / rotation.file_bytes as f64).floor();
        let hours = frames * scenario.robot.frame_seconds() / 3600.0;
        Ok(LogForecast {
            bytes: (of_messages + learned + files * empty as f64) as u64,
            learned_bytes: learned as u64,
            bytes_per_frame: per_frame,
            bytes_per_hour: 3600.0 / scenario.robot.frame_seconds() * per_frame,
            hours,
            measured_frames: outcome.frames,
        })
    }
}

fn open(options: &LogOptions, metadata: &BTreeMap<String, String>) -> Result<RunLog, LogError> {
    RunLog::create(NullStorage, options, Rotation::NEVER, metadata)
}
