//! What was learned, as a safetensors file: written aside, synced, renamed.
//!
//! Tensors: `members` (m × d, f32), `projection` (k × m), `offset` (k), `slowness` (k), `weights.T` (3 × (k + 1)) for each task
//! T, all f64 and row by row. Local values have `instances` (N × p, f32), the points where actions were tried, in place of features,
//! and `weights.T` (1 × N) says what each is worth. Where places are told, these are points of a metric (N × (p + 4)), whose bits are in
//! the metadata, and `goal_places.T` (c × 3) has the squares where the goal was found. Where something is to be avoided, `heedless.T`
//! has the values without that. The metadata has the complete scenario, so the file alone is enough to evaluate.

use std::borrow::Cow;
use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use faer::{Mat, MatRef};
use safetensors::tensor::{Dtype, Metadata, SafeTensorError, SafeTensors, TensorView, View};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use thiserror::Error;

use crate::kernel::Kernel;
use crate::policy::{FloorMap, GoalRegion, Learned};
use crate::scenario::{Scenario, ScenarioError, hex};
use crate::slow::SlowModel;
use crate::snapshot::{Matrix, Snapshot, Values};
use crate::value::place::{GoalPlaces, PlaceMap, PlaceMetric};
use crate::value::{Instances, LocalOptions};

/// Name of the newest checkpoint in a run folder, and of the attachment in a log.
pub const CHECKPOINT_NAME: &str = "checkpoint.safetensors";

/// Name of the entry of the file's metadata that holds all of ours.
const METADATA: &str = "adagio";

/// Why a checkpoint cannot be written or read.
#[derive(Debug, Error)]
pub enum CheckpointError {
    /// The file system refused.
    #[error("cannot write the checkpoint {path}: {cause}")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        cause: std::io::Error,
    },
    /// The bytes are no checkpoint.
    #[error("this is not a whole checkpoint: {0}")]
    Damaged(String),
    /// The scenario in it is not valid for this version.
    #[error("the checkpoint's scenario cannot be used: {0}")]
    Scenario(#[from] ScenarioError),
}

fn damaged(what: impl std::fmt::Display) -> CheckpointError {
    CheckpointError::Damaged(what.to_string())
}

/// Bytes of a checkpoint.
///
/// # Errors
/// None in practice; the format's own refusals are passed on.
pub fn checkpoint_bytes(learned: &Learned, scenario: &Scenario) -> Result<Vec<u8>, CheckpointError> {
    let model = &learned.model;
    let members = model.members.as_ref().as_ref();
    let f32_bytes: Vec<u8> = (0..members.ncols())
        .flat_map(|j| members.col(j).iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())
        .collect();
    let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = vec![
        ("members".into(), Dtype::F32, vec![members.ncols(), members.nrows()], f32_bytes),
        matrix("projection", model.projection.as_ref()),
        vector("offset", &model.offset),
        vector("slowness", &model.slowness),
    ];
    for (task, weights) in learned.weights.iter().enumerate() {
        tensors.push(matrix(&format!("weights.{task}"), weights.as_ref()));
    }
    for (task, weights) in learned.heedless.iter().enumerate() {
        tensors.push(matrix(&format!("heedless.{task}"), weights.as_ref()));
    }
    let mut counts: &[usize] = &[];
    if let Some(instances) = &learned.instances {
        counts = instances.counts();
        tensors.push(points("instances", instances.points()));
    }
    if let Some(map) = &learned.map {
        tensors.push(matrix("map.places", map.places().as_ref()));
        if learned.instances.is_none() || learned.places.is_some() {
            tensors.push(points("map.states", map.instances().points()));
        }
    }
    let mut within: Vec<Option<[u64; 2]>> = Vec::new();
    for (task, region) in learned.regions.iter().enumerate() {
        within.push(region.as_ref().map(|region| [region.within(), region.unlike()].map(f64::to_bits)));
        let Some(region) = region else { continue };
        tensors.push(points(&format!("region.{task}.marks"), region.marks()));
        tensors.push(matrix(&format!("region.{task}.marked"), region.marked()));
    }
    for (task, goal) in learned.places.iter().flat_map(PlaceMap::goals).enumerate() {
        let goal = goal.to_matrix();
        // Of a goal that was never found there is nothing to write.
        if goal.ncols() > 0 {
            tensors.push(matrix(&format!("goal_places.{task}"), goal.as_ref()));
        }
    }
    let metric = learned.places.as_ref().map(|map| map.metric().to_bits());
    let entries = BTreeMap::from([
        ("scenario".to_owned(), scenario.text.clone()),
        ("epoch".to_owned(), learned.epoch.to_string()),
        ("asked_at".to_owned(), learned.asked_at.to_string()),
        ("frames".to_owned(), learned.frames.to_string()),
        ("sigma_bits".to_owned(), learned.sigma().to_bits().to_string()),
        ("exponent".to_owned(), learned.exponent().to_string()),
        ("scenario_sha256".to_owned(), scenario.sha256()),
        ("digest".to_owned(), learned.digest()),
        ("goals".to_owned(), serde_json::to_string(&learned.goals).map_err(damaged)?),
        ("instances".to_owned(), serde_json::to_string(counts).map_err(damaged)?),
        ("place_metric".to_owned(), serde_json::to_string(&metric).map_err(damaged)?),
        ("region_bits".to_owned(), serde_json::to_string(&within).map_err(damaged)?),
    ]);
    // One entry: the format keeps several in no fixed order, and equal runs write equal bytes.
    let metadata = HashMap::from([(METADATA.to_owned(), serde_json::to_string(&entries).map_err(damaged)?)]);
    let views: Result<Vec<(&str, TensorView<'_>)>, _> = tensors
        .iter()
        .map(|(name, dtype, shape, bytes)| {
            TensorView::new(*dtype, shape.clone(), bytes).map(|view| (name.as_str(), view))
        })
        .collect();
    safetensors::serialize(views.map_err(damaged)?, Some(metadata)).map_err(damaged)
}

/// Write a checkpoint to `path`: aside, synced, then renamed, so that the file is whole at every moment.
///
/// # Errors
/// The file system refused.
pub fn write_checkpoint(path: &Path, bytes: &[u8]) -> Result<(), CheckpointError> {
    let aside = path.with_extension("part");
    let write = || {
        let mut file = std::fs::File::create(&aside)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        std::fs::rename(&aside, path)
    };
    write().map_err(|cause| CheckpointError::Write { path: path.to_owned(), cause })
}

/// Read a checkpoint from its bytes; `path` is for messages, and image files of the scenario are relative to it.
///
/// # Errors
/// The bytes are no whole checkpoint, or its scenario is not valid.
pub fn read_checkpoint(bytes: &[u8], path: &Path) -> Result<(Learned, Scenario), CheckpointError> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let outer = header.metadata().clone().unwrap_or_default();
    let text = outer.get(METADATA).ok_or_else(|| damaged(format!("its metadata {METADATA} is missing")))?;
    let metadata: BTreeMap<String, String> = serde_json::from_str(text).map_err(damaged)?;
    let entry = |key: &str| metadata.get(key).ok_or_else(|| damaged(format!("{key} is missing")));
    let number = |key: &str| entry(key)?.parse::<u64>().map_err(|e| damaged(format!("{key}: {e}")));
    let text = entry("scenario")?;
    // Of the text as it stands there: another version may explain the same keys in other words.
    if hex(&Sha256::digest(text.as_bytes())) != *entry("scenario_sha256")? {
        return Err(damaged("its scenario is not the one that it names"));
    }
    let scenario = Scenario::parse(text, path, &[])?;
    let tensors = SafeTensors::deserialize(bytes).map_err(damaged)?;
    let read = |name: &str| -> Result<(Vec<usize>, Vec<f64>), CheckpointError> {
        let view = tensors.tensor(name).map_err(|e| damaged(format!("{name}: {e}")))?;
        // Any number of rows of no columns takes no bytes.
        if view.shape().contains(&0) {
            return Err(damaged(format!("{name} has shape {:?} and holds nothing", view.shape())));
        }
        let data = view.data();
        let values = match view.dtype() {
            Dtype::F32 => {
                data.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect()
            }
            Dtype::F64 => data
                .chunks_exact(8)
                .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]))
                .collect(),
            other => return Err(damaged(format!("{name} has type {other:?}"))),
        };
        Ok((view.shape().to_vec(), values))
    };
    let read_matrix = |name: &str| -> Result<Mat<f64>, CheckpointError> {
        let (shape, values) = read(name)?;
        let [columns, rows] = shape[..] else { return Err(damaged(format!("{name} has shape {shape:?}"))) };
        Ok(Mat::from_fn(rows, columns, |i, j| values[j * rows + i]))
    };
    let kernel = Kernel::radial(
        f64::from_bits(number("sigma_bits")?),
        entry("exponent")?.parse().map_err(|e| damaged(format!("exponent: {e}")))?,
    )
    .map_err(damaged)?;
    let (members, projection) = (read_matrix("members")?, read_matrix("projection")?);
    let (offset, slowness) = (read("offset")?.1, read("slowness")?.1);
    let k = offset.len();
    // Values are linear in the checkpoints of earlier versions.
    let counts = metadata.get("instances").map(|text| serde_json::from_str::<Vec<usize>>(text));
    let counts = counts.transpose().map_err(|e| damaged(format!("instances: {e}")))?.unwrap_or_default();
    let options = LocalOptions { neighbours: scenario.value.neighbours, ridge: scenario.value.local_ridge };
    let single = |name: &str| {
        let of = read_matrix(name)?;
        Ok::<_, CheckpointError>(Mat::from_fn(of.nrows(), of.ncols(), |i, j| of[(i, j)] as f32))
    };
    let instances = if counts.is_empty() {
        None
    } else {
        Some(Arc::new(Instances::new(single("instances")?, counts, options).map_err(damaged)?))
    };
    let actions = scenario.robot.actions.len();
    if let Some(found) = instances.as_ref().map(|instances| instances.counts().len()).filter(|&found| found != actions)
    {
        return Err(damaged(format!("its transitions are of {found} actions, and the robot has {actions}")));
    }
    let weights_of = |name: String| {
        let of_task = read_matrix(&name)?;
        if instances.is_none() && (of_task.nrows() != k + 1 || of_task.ncols() != actions) {
            return Err(damaged(format!("{name} has a shape that does not fit {k} features")));
        }
        Ok(of_task)
    };
    let tasks = 0..scenario.tasks.len();
    let weights = tasks.clone().map(|task| weights_of(format!("weights.{task}"))).collect::<Result<Vec<_>, _>>()?;
    let heedless = tasks.filter(|_| !scenario.avoids.is_empty()).map(|task| weights_of(format!("heedless.{task}")));
    let heedless = heedless.collect::<Result<Vec<_>, _>>()?;
    let places = scenario.names().count();
    let values = scenario.vision.values();
    if members.nrows() != values {
        let found = members.nrows();
        return Err(damaged(format!("its support vectors have {found} values, observations have {values}")));
    }
    let members = Mat::from_fn(members.nrows(), members.ncols(), |i, j| members[(i, j)] as f32);
    let model = SlowModel::from_parts(kernel, members, projection, offset, slowness).map_err(damaged)?;
    let epoch = u32::try_from(number("epoch")?).map_err(damaged)?;
    let (asked_at, frames) = (number("asked_at")?, number("frames")?);
    // Tasks do not move in the checkpoints of earlier versions.
    let goals = metadata.get("goals").map(|text| serde_json::from_str::<Vec<Option<[f64; 2]>>>(text));
    let goals = goals.transpose().map_err(|e| damaged(format!("goals: {e}")))?.unwrap_or_default();
    if !goals.is_empty() && goals.len() != places {
        return Err(damaged(format!("it has {} goals for {places} tasks", goals.len())));
    }
    // Places are not told in the checkpoints of earlier versions.
    let metric = metadata.get("place_metric").map(|text| serde_json::from_str::<Option<[u64; 6]>>(text));
    let metric = metric.transpose().map_err(|e| damaged(format!("place_metric: {e}")))?.flatten();
    let metric = metric.map(PlaceMetric::from_bits);
    let learned = Learned::of((epoch, asked_at, frames), model, weights, instances, metric);
    // No goals are shown in the checkpoints of earlier versions.
    let within = metadata.get("region_bits").map(|text| serde_json::from_str::<Vec<Option<[u64; 2]>>>(text));
    let within = within.transpose().map_err(|e| damaged(format!("region_bits: {e}")))?.unwrap_or_default();
    if !within.is_empty() && within.len() != places {
        return Err(damaged(format!("it has {} places that were shown for {places} tasks", within.len())));
    }
    let mut regions = Vec::new();
    for (task, bits) in within.into_iter().enumerate() {
        let region = bits.map(|bits| {
            let [within, unlike] = bits.map(f64::from_bits);
            let marked = read_matrix(&format!("region.{task}.marked"))?;
            let marks = single(&format!("region.{task}.marks"))?;
            GoalRegion::from_parts(marks, marked, within, unlike).map_err(damaged)
        });
        regions.push(region.transpose()?);
    }
    let map = match tensors.names().contains(&"map.places") {
        false => None,
        true => {
            let states =
                match &learned.as_ref().ok().filter(|of| of.places.is_none()).and_then(|of| of.instances.clone()) {
                    Some(instances) => instances.clone(),
                    None => {
                        let states = single("map.states")?;
                        let count = states.ncols();
                        Arc::new(Instances::new(states, vec![count], options).map_err(damaged)?)
                    }
                };
            Some(FloorMap::new(states, read_matrix("map.places")?.as_ref()).map_err(damaged)?)
        }
    };
    let names = tensors.names();
    let goal_places = |task: usize| match format!("goal_places.{task}") {
        name if names.contains(&name.as_str()) => GoalPlaces::from_matrix(&read_matrix(&name)?).map_err(damaged),
        _ => Ok(GoalPlaces::default()),
    };
    let goal_places = (0..scenario.tasks.len()).map(goal_places).collect::<Result<Vec<_>, _>>()?;
    let learned = learned.map_err(damaged)?.with_heedless(heedless).for_goals(goals).with_goal_places(goal_places);
    let learned = learned.with_regions(map, regions).map_err(damaged)?;
    if learned.digest() != *entry("digest")? {
        return Err(damaged("its digest is not that of its content"));
    }
    Ok((learned, scenario))
}

/// Name of the state that a run goes on from, in its folder.
pub const STATE_NAME: &str = "state.safetensors";

/// The state of a run at one moment, as it was kept.
#[derive(Debug)]
pub struct SavedState {
    /// What the actors were.
    pub snapshot: Snapshot,
    /// The last frame before the moment.
    pub frame: u64,
    /// Its time, nanoseconds.
    pub stamp_ns: u64,
}

/// What a state says of itself beside its matrices.
#[derive(Serialize, Deserialize)]
struct StateHead {
    version: String,
    scenario_sha256: String,
    frame: u64,
    stamp_ns: u64,
    texts: BTreeMap<String, String>,
    /// Of all matrices, and of the texts.
    digest: String,
}

/// A matrix on its way into a file: column by column it is its transpose row by row.
struct Stored<'a> {
    matrix: &'a Matrix,
    shape: [usize; 2],
}

impl<'a> Stored<'a> {
    fn new(matrix: &'a Matrix) -> Self {
        Stored { matrix, shape: [matrix.columns, matrix.rows] }
    }
}

impl View for Stored<'_> {
    fn dtype(&self) -> Dtype {
        match self.matrix.values {
            Values::F64(_) => Dtype::F64,
            Values::F32(_) => Dtype::F32,
            Values::U8(_) => Dtype::U8,
        }
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        match &self.matrix.values {
            Values::F64(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>().into(),
            Values::F32(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>().into(),
            Values::U8(values) => values.as_slice().into(),
        }
    }

    fn data_len(&self) -> usize {
        self.matrix.values.len() * self.dtype().bitsize() / 8
    }
}

/// A hash over everything that a state holds.
fn state_digest(head: &StateHead, matrices: &BTreeMap<String, Matrix>) -> String {
    let mut hash = Sha256::new();
    for text in [&head.version, &head.scenario_sha256, &head.frame.to_string(), &head.stamp_ns.to_string()] {
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    }
    for (name, text) in &head.texts {
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(name);
        hash.update((text.len() as u64).to_le_bytes());
        hash.update(text);
    }
    for (name, matrix) in matrices {
        hash.update((name.len() as u64).to_le_bytes());
        hash.update(name);
        hash.update([matrix.rows as u64, matrix.columns as u64].map(u64::to_le_bytes).as_flattened());
        hash.update(Stored::new(matrix).data());
    }
    hex(&hash.finalize())
}

/// The matrices of a state, and what it says of itself as metadata of a file.
type Parts = (BTreeMap<String, Matrix>, HashMap<String, String>);

fn state_parts(state: SavedState, scenario: &Scenario) -> Result<Parts, CheckpointError> {
    let SavedState { snapshot: Snapshot { matrices, texts, .. }, frame, stamp_ns } = state;
    let (version, scenario_sha256) = (env!("CARGO_PKG_VERSION").to_owned(), scenario.sha256());
    let mut head = StateHead { version, scenario_sha256, frame, stamp_ns, texts, digest: String::new() };
    head.digest = state_digest(&head, &matrices);
    let head = serde_json::to_string(&head).map_err(damaged)?;
    Ok((matrices, HashMap::from([(METADATA.to_owned(), head)])))
}

/// The bytes of a state, for another process.
///
/// # Errors
/// None of the states that there are.
pub fn state_bytes(state: SavedState, scenario: &Scenario) -> Result<Vec<u8>, CheckpointError> {
    let (matrices, metadata) = state_parts(state, scenario)?;
    let views = matrices.iter().map(|(name, matrix)| (name.as_str(), Stored::new(matrix)));
    safetensors::serialize(views, Some(metadata)).map_err(damaged)
}

/// Write the state of a run: aside, synced, then renamed, so that the one before stays whole until this one is.
///
/// # Errors
/// The file system refused.
pub fn write_state(path: &Path, state: SavedState, scenario: &Scenario) -> Result<(), CheckpointError> {
    let (matrices, metadata) = state_parts(state, scenario)?;
    let mut aside = path.to_owned().into_os_string();
    aside.push(".part");
    let aside = PathBuf::from(aside);
    let failed = |cause: std::io::Error| CheckpointError::Write { path: path.to_owned(), cause };
    let views = matrices.iter().map(|(name, matrix)| (name.as_str(), Stored::new(matrix)));
    safetensors::serialize_to_file(views, Some(metadata), &aside).map_err(|cause| match cause {
        SafeTensorError::IoError(cause) => failed(cause),
        other => damaged(other),
    })?;
    let sync = || std::fs::File::open(&aside)?.sync_all();
    sync().and_then(|()| std::fs::rename(&aside, path)).map_err(failed)
}

/// Read the state of a run of this scenario.
///
/// # Errors
/// The bytes are no whole state, or that of another scenario or version.
pub fn read_state(bytes: &[u8], scenario: &Scenario) -> Result<SavedState, CheckpointError> {
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let head = state_head(&header, scenario)?;
    let tensors = SafeTensors::deserialize(bytes).map_err(damaged)?;
    let mut matrices = BTreeMap::new();
    for (name, view) in tensors.iter() {
        let &[columns, rows] = view.shape() else {
            return Err(damaged(format!("{name} has shape {:?}", view.shape())));
        };
        let data = view.data();
        let values = match view.dtype() {
            Dtype::F64 => Values::F64(data.as_chunks().0.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect()),
            Dtype::F32 => Values::F32(data.as_chunks().0.iter().map(|&bytes| f32::from_le_bytes(bytes)).collect()),
            Dtype::U8 => Values::U8(data.to_vec()),
            other => return Err(damaged(format!("{name} has type {other:?}"))),
        };
        matrices.insert(name.to_owned(), Matrix { rows, columns, values });
    }
    if state_digest(&head, &matrices) != head.digest {
        return Err(damaged("its digest is not that of its content"));
    }
    let StateHead { frame, stamp_ns, texts, .. } = head;
    Ok(SavedState { snapshot: Snapshot::restoring(matrices, texts), frame, stamp_ns })
}

/// What the state of a run of this scenario holds beside its matrices: the file's beginning is read alone, and its digest not checked.
///
/// # Errors
/// The file cannot be read, or does not begin as that of a state, or is that of another scenario or version.
pub fn read_state_head(path: &Path, scenario: &Scenario) -> Result<Snapshot, CheckpointError> {
    let beginning = || {
        let mut file = std::fs::File::open(path)?;
        let (mut length, mut header) = ([0; 8], Vec::new());
        file.read_exact(&mut length)?;
        file.take(u64::from_le_bytes(length)).read_to_end(&mut header)?;
        Ok(header)
    };
    let header = beginning().map_err(|cause: std::io::Error| damaged(cause))?;
    let head = state_head(&serde_json::from_slice(&header).map_err(damaged)?, scenario)?;
    Ok(Snapshot::restoring(BTreeMap::new(), head.texts))
}

fn state_head(header: &Metadata, scenario: &Scenario) -> Result<StateHead, CheckpointError> {
    let text = header.metadata().as_ref().and_then(|entries| entries.get(METADATA));
    let text = text.ok_or_else(|| damaged(format!("its metadata {METADATA} is missing")))?;
    let head: StateHead = serde_json::from_str(text).map_err(damaged)?;
    if head.version != env!("CARGO_PKG_VERSION") || head.scenario_sha256 != scenario.sha256() {
        return Err(damaged("it is that of another scenario, or was written by another version"));
    }
    Ok(head)
}

/// Points, one after the other.
fn points(name: &str, points: MatRef<'_, f32>) -> (String, Dtype, Vec<usize>, Vec<u8>) {
    let bytes = points.col_iter().flat_map(|point| point.iter().copied().collect::<Vec<f32>>());
    (name.to_owned(), Dtype::F32, vec![points.ncols(), points.nrows()], bytes.flat_map(f32::to_le_bytes).collect())
}

/// A matrix column by column is its transpose row by row.
fn matrix(name: &str, matrix: MatRef<'_, f64>) -> (String, Dtype, Vec<usize>, Vec<u8>) {
    let bytes = (0..matrix.ncols())
        .flat_map(|j| matrix.col(j).iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())
        .collect();
    (name.to_owned(), Dtype::F64, vec![matrix.ncols(), matrix.nrows()], bytes)
}

fn vector(name: &str, values: &[f64]) -> (String, Dtype, Vec<usize>, Vec<u8>) {
    (name.to_owned(), Dtype::F64, vec![values.len()], values.iter().flat_map(|value| value.to_le_bytes()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scenario_that_another_version_explains_in_other_words_is_read_and_a_damaged_one_is_not() {
        let text = include_str!("../../../scenarios/lab.toml");
        let mut scenario = Scenario::parse(text, Path::new("lab.toml"), &[]).unwrap();
        let values = scenario.vision.values();
        let members = Mat::from_fn(values, 2, |i, j| ((7 * i + 3 * j) % 11) as f32);
        let (projection, one) = (Mat::from_fn(2, 1, |i, _| 1.0 - 0.5 * i as f64), vec![1.0]);
        let kernel = Kernel::radial(100.0, 2.0).unwrap();
        let model = SlowModel::from_parts(kernel, members, projection, one.clone(), one).unwrap();
        let weights = vec![Mat::from_fn(2, 3, |i, j| (i + 2 * j) as f64); scenario.tasks.len()];
        let learned = Learned::new(1, 2, 3, model, weights).unwrap();

        scenario.text = scenario.text.replace("# ", "# as others would say: ");
        let bytes = checkpoint_bytes(&learned, &scenario).unwrap();
        let (read, its_own) = read_checkpoint(&bytes, Path::new("lab.toml")).unwrap();
        assert_eq!((read.digest(), its_own.tasks), (learned.digest(), scenario.tasks));

        let place = bytes.windows(8).position(|part| part == b"seed = 1").unwrap();
        let mut damaged = bytes;
        damaged[place + 7] = b'2';
        let error = read_checkpoint(&damaged, Path::new("lab.toml")).unwrap_err().to_string();
        assert!(error.ends_with("its scenario is not the one that it names"), "{error}");
    }
}
