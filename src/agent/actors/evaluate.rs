//! The evaluate actor: keeps every model in the run's folder, and runs trials with it beside the run.

use std::path::Path;
use std::sync::Arc;

use serde::Serialize;

use super::record::Recorder;
use crate::agent::error::RunError;
use crate::agent::runtime::checkpoint::{checkpoint_bytes, write_checkpoint};
use crate::agent::runtime::queue::Inbox;
use crate::agent::runtime::status::Status;
use crate::evaluate::{Evaluator, TaskResult, overlap};
use crate::policy::Learned;
use crate::scenario::Scenario;

/// Number of features, from the slowest on, whose drift from model to model is measured.
const DRIFTING: usize = 20;

/// One evaluation during a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CurvePoint {
    /// Frames seen.
    pub frames: u64,
    /// Actions executed.
    pub actions: u64,
    /// Support vectors.
    pub support_vectors: usize,
    /// Success, mean over tasks.
    pub success: f64,
    /// Convergence quality, mean over tasks.
    pub convergence_quality: f64,
    /// Slowness of the features, mean, 1/s².
    pub slowness_mean: f64,
    /// Root mean square angle between the spans of the slowest features (20 at most) of this model and the one evaluated
    /// before, degrees; `None` for the first.
    pub feature_drift_deg: Option<f64>,
}

/// Its loop, until there are no more models.
pub fn run(
    models: &Inbox<(Arc<Learned>, u64)>,
    evaluator: Option<&Evaluator>,
    checkpoint: Option<&Path>,
    scenario: &Scenario,
    record: &Recorder,
    status: &Status,
    mut curve: Vec<CurvePoint>,
) -> Result<Vec<CurvePoint>, RunError> {
    let every = scenario.evaluate.every as u32;
    let mut last: Option<faer::Mat<f64>> = None;
    while let Ok((learned, stamp_ns)) = models.take() {
        if let Some(path) = checkpoint {
            write_checkpoint(path, &checkpoint_bytes(&learned, scenario)?)?;
        }
        let Some(evaluator) = evaluator.filter(|_| every > 0 && learned.epoch.is_multiple_of(every)) else { continue };
        let results = evaluator.evaluate(&learned, false);
        let features = evaluator.features(&learned, DRIFTING);
        let before = last.replace(features.clone());
        // Features that are not finite have no angle.
        let alike = before.and_then(|before| overlap(before.as_ref(), features.as_ref()).ok());
        let drift = alike.map(|(mean, _)| mean.clamp(0.0, 1.0).sqrt().acos().to_degrees());
        let point = curve_point(&learned, &results, scenario, drift);
        status.update(|s| s.success = Some(point.success));
        curve.push(point);
        if record.evaluation(&results, &learned, stamp_ns).is_err() {
            break;
        }
    }
    Ok(curve)
}

/// One evaluation as a point of the curve.
fn curve_point(
    learned: &Learned,
    results: &[TaskResult],
    scenario: &Scenario,
    feature_drift_deg: Option<f64>,
) -> CurvePoint {
    let tasks = results.len() as f64;
    let slowness = &learned.model.slowness;
    CurvePoint {
        frames: learned.frames,
        actions: (learned.frames - 1) / scenario.robot.frames_per_action as u64,
        support_vectors: learned.model.members.ncols(),
        success: results.iter().map(|result| result.success).sum::<f64>() / tasks,
        convergence_quality: results.iter().map(|result| result.convergence_quality).sum::<f64>() / tasks,
        slowness_mean: slowness.iter().sum::<f64>() / slowness.len() as f64,
        feature_drift_deg,
    }
}
