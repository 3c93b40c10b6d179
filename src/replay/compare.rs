//! What two runs have in common, and what not.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;
use serde_json::Value;

use super::{Recording, RecordingError};
use crate::log::messages::{ModelUpdate, PolicyUpdate};
use crate::log::{LogError, Record, topics};
use crate::robot::{Pose, wrap};
use crate::source::{Frame, Recorded, View};

/// Two runs side by side.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// Keys of the scenario that differ, with both values; an empty one where a run does not have the key.
    pub settings: BTreeMap<String, (String, String)>,
    /// Frames of both runs.
    pub frames: (u64, u64),
    /// What both saw; `None` if observations have other sizes, or this version cannot read the scenario of one of them.
    pub observations: Option<Observations>,
    /// Models of both runs.
    pub models: (usize, usize),
    /// Epoch of the first model whose digest differs, if one does; the models after it are not comparable.
    pub first_model_that_differs: Option<u32>,
    /// Epoch and task of the first policy whose digest differs.
    pub first_policy_that_differs: Option<(u32, String)>,
    /// Epoch by epoch, where both have one: support vectors and mean slowness.
    pub epochs: Vec<Epoch>,
}

/// What two runs saw while they took the same course: frames that both have, of the same action, from the same true pose.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Observations {
    /// Frames of the same course.
    pub frames: u64,
    /// Number of the frame with which their courses part.
    pub parted_at: Option<u64>,
    /// Number of the first of them whose observations differ.
    pub first_that_differs: Option<u64>,
    /// Share of all their values that differ by more than one grey level.
    pub share: f64,
    /// The largest difference of two values, grey levels.
    pub largest: u8,
}

/// One model of both runs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Epoch {
    /// Its number.
    pub epoch: u32,
    /// The frame at which it was asked for.
    pub asked_at: (u64, u64),
    /// Support vectors.
    pub support_vectors: (u32, u32),
    /// Mean slowness, 1/s².
    pub slowness: (f64, f64),
    /// Whether all bits are equal.
    pub equal: bool,
}

/// Poses that are no farther apart are the same, metres and radians: a log holds headings as quaternions, and what was read from
/// it and logged again is off by rounding.
const SAME_POSE: f64 = 1e-9;

#[derive(Default)]
struct Models {
    models: BTreeMap<u32, ModelUpdate>,
    policies: BTreeMap<(u32, String), String>,
}

/// Compare two recorded runs.
///
/// # Errors
/// A file that cannot be read.
pub fn compare(a: &Recording, b: &Recording) -> Result<Comparison, RecordingError> {
    let (of_a, of_b) = (models(a)?, models(b)?);
    let epochs: Vec<Epoch> = of_a
        .models
        .values()
        .filter_map(|model| of_b.models.get(&model.epoch).map(|other| epoch(model, other)))
        .collect();
    let first_policy_that_differs = of_a
        .policies
        .iter()
        .find(|(key, digest)| of_b.policies.get(key).is_some_and(|other| other != *digest))
        .map(|(key, _)| key.clone());
    Ok(Comparison {
        settings: settings(a, b),
        frames: (a.frames, b.frames),
        observations: observations(a, b),
        models: (of_a.models.len(), of_b.models.len()),
        first_model_that_differs: epochs.iter().find(|epoch| !epoch.equal).map(|epoch| epoch.epoch),
        first_policy_that_differs,
        epochs,
    })
}

fn observations(a: &Recording, b: &Recording) -> Option<Observations> {
    let open = |run: &Recording| Some(Recorded::new(Arc::new(run.scenario(&[]).ok()?), run.records()));
    let (mut a, mut b) = (open(a)?, open(b)?);
    let course = |frame: &Frame| (frame.action, frame.boundary.is_some());
    let apart = |a: &Pose, b: &Pose| (a.position - b.position).norm().max(wrap(a.heading - b.heading).abs());
    let mut found = Observations::default();
    let (mut values, mut differ) = (0u64, 0u64);
    let (mut of_a, mut of_b) = (a.take(), b.take());
    while let (Some(one), Some(other)) = (&of_a, &of_b) {
        // Frames that one of the two lacks: lost, damaged, deleted.
        if one.number != other.number {
            let behind = if one.number < other.number { (&mut of_a, &mut a) } else { (&mut of_b, &mut b) };
            *behind.0 = behind.1.take();
            continue;
        }
        let poses = one.truth.zip(other.truth);
        if course(one) != course(other) || poses.is_some_and(|(one, other)| apart(&one, &other) > SAME_POSE) {
            found.parted_at = Some(one.number);
            break;
        }
        let (View::Observation(seen), View::Observation(also)) = (&one.view, &other.view) else { return None };
        if seen.len() != also.len() {
            return None;
        }
        found.frames += 1;
        values += seen.len() as u64;
        if seen != also {
            found.first_that_differs.get_or_insert(one.number);
            for difference in seen.iter().zip(also).map(|(a, b)| a.abs_diff(*b)) {
                found.largest = found.largest.max(difference);
                differ += u64::from(difference > 1);
            }
        }
        (of_a, of_b) = (a.take(), b.take());
    }
    found.share = differ as f64 / values.max(1) as f64;
    Some(found)
}

fn epoch(a: &ModelUpdate, b: &ModelUpdate) -> Epoch {
    let mean = |model: &ModelUpdate| model.slowness.iter().sum::<f64>() / model.slowness.len() as f64;
    Epoch {
        epoch: a.epoch,
        asked_at: (a.asked_at_frame, b.asked_at_frame),
        support_vectors: (a.support_vectors, b.support_vectors),
        slowness: (mean(a), mean(b)),
        equal: a.digest == b.digest,
    }
}

fn models(recording: &Recording) -> Result<Models, LogError> {
    let mut found = Models::default();
    for record in recording.records() {
        let record = match record {
            Ok(record) => record,
            Err(error @ (LogError::Open { .. } | LogError::Read { .. })) => return Err(error),
            // Damage is told by whoever opened the recording.
            Err(_) => continue,
        };
        let Record::Message { topic, .. } = &record else { continue };
        if **topic == *topics::MODEL.name() {
            if let Ok(model) = record.decode::<ModelUpdate>() {
                found.models.insert(model.epoch, model);
            }
        } else if **topic == *topics::POLICY.name()
            && let Ok(policy) = record.decode::<PolicyUpdate>()
        {
            found.policies.insert((policy.epoch, policy.task), policy.digest);
        }
    }
    Ok(found)
}

/// Keys of both scenarios whose values differ.
fn settings(a: &Recording, b: &Recording) -> BTreeMap<String, (String, String)> {
    let (a, b) = (flat(a), flat(b));
    let value = |of: &BTreeMap<String, String>, key: &String| of.get(key).cloned().unwrap_or_default();
    let both = a.keys().chain(b.keys()).map(|key| (key.clone(), (value(&a, key), value(&b, key))));
    both.filter(|(_, (one, other))| one != other).collect()
}

fn flat(recording: &Recording) -> BTreeMap<String, String> {
    let mut keys = BTreeMap::new();
    let text = recording.metadata.get("scenario").map_or("", String::as_str);
    if let Ok(table) = text.parse::<toml::Table>()
        && let Ok(value) = serde_json::to_value(table)
    {
        flatten("", &value, &mut keys);
    }
    keys
}

fn flatten(name: &str, value: &Value, keys: &mut BTreeMap<String, String>) {
    let inner = |key: &str| if name.is_empty() { key.to_owned() } else { format!("{name}.{key}") };
    match value {
        Value::Object(table) => table.iter().for_each(|(key, value)| flatten(&inner(key), value, keys)),
        Value::Array(list) if list.iter().any(Value::is_object) => {
            list.iter().enumerate().for_each(|(place, value)| flatten(&inner(&place.to_string()), value, keys));
        }
        other => {
            keys.insert(name.to_owned(), other.to_string());
        }
    }
}
