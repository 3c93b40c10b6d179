//! What was learned, as a safetensors file: written aside, synced, renamed.
//!
//! Tensors: `members` (m × d, f32), `projection` (k × m), `offset` (k), `slowness` (k), `weights.N` (3 × (k + 1)) for each task
//! N, all f64 and row by row. The metadata has the complete scenario, so the file alone is enough to evaluate.

use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::{Path, PathBuf};

use faer::{Mat, MatRef};
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use thiserror::Error;

use crate::kernel::Kernel;
use crate::policy::Learned;
use crate::scenario::{Scenario, ScenarioError};
use crate::slow::SlowModel;

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
    let entries = BTreeMap::from([
        ("scenario".to_owned(), scenario.text.clone()),
        ("epoch".to_owned(), learned.epoch.to_string()),
        ("asked_at".to_owned(), learned.asked_at.to_string()),
        ("frames".to_owned(), learned.frames.to_string()),
        ("sigma_bits".to_owned(), learned.sigma().to_bits().to_string()),
        ("exponent".to_owned(), learned.exponent().to_string()),
        ("scenario_sha256".to_owned(), scenario.sha256()),
        ("digest".to_owned(), learned.digest()),
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
    let scenario = Scenario::parse(entry("scenario")?, path, &[])?;
    if scenario.sha256() != *entry("scenario_sha256")? {
        return Err(damaged("its scenario is not the one that it names"));
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(damaged)?;
    let read = |name: &str| -> Result<(Vec<usize>, Vec<f64>), CheckpointError> {
        let view = tensors.tensor(name).map_err(|e| damaged(format!("{name}: {e}")))?;
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
    let mut weights = Vec::new();
    for task in 0..scenario.tasks.len() {
        let of_task = read_matrix(&format!("weights.{task}"))?;
        if of_task.nrows() != k + 1 || of_task.ncols() != 3 {
            return Err(damaged(format!("weights.{task} has a shape that does not fit {k} features")));
        }
        weights.push(of_task);
    }
    let values = 3 * scenario.vision.width * scenario.vision.height;
    if members.nrows() != values {
        let found = members.nrows();
        return Err(damaged(format!("its support vectors have {found} values, observations have {values}")));
    }
    let members = Mat::from_fn(members.nrows(), members.ncols(), |i, j| members[(i, j)] as f32);
    let model = SlowModel::from_parts(kernel, members, projection, offset, slowness).map_err(damaged)?;
    let epoch = u32::try_from(number("epoch")?).map_err(damaged)?;
    let (asked_at, frames) = (number("asked_at")?, number("frames")?);
    let learned = Learned::new(epoch, asked_at, frames, model, weights).map_err(damaged)?;
    if learned.digest() != *entry("digest")? {
        return Err(damaged("its digest is not that of its content"));
    }
    Ok((learned, scenario))
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
