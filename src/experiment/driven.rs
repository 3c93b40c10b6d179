//! Runs of the agent itself, as `adagio run` makes them, without files.

use std::collections::BTreeMap;

use super::field::Point;
use super::lab::Lab;
use super::{Bench, ExperimentError};
use crate::agent::{self, CurvePoint, Outcome, RunOptions, Status};
use crate::evaluate::Evaluator;
use crate::log::{LogOptions, NullStorage, Rotation, RunLog};
use crate::world::Simulated;

/// What changes in a scenario so that a run is over in seconds: models soon, and small.
pub const SMALL: [&str; 7] = [
    "robot.frames_per_action=5",
    "dictionary.sigma_frames=200",
    "dictionary.budget=200",
    "slow.features=40",
    "agent.resolve_frames=500",
    "agent.latency_frames=200",
    "evaluate.max_steps=30",
];

/// One run; its curve is made by an evaluator.
pub fn drive(lab: &Lab, evaluator: &Evaluator, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
    let Lab { scenario, world } = lab;
    let log = RunLog::create(NullStorage, &LogOptions::default(), Rotation::NEVER, &BTreeMap::new());
    let log = log.map_err(|error| ExperimentError::Run(error.to_string()))?;
    let status = Status::default();
    let mut source = Simulated::new(scenario.clone(), world.clone());
    let options = RunOptions { evaluator: Some(evaluator), ..RunOptions::new(bench.stop(), &status) };
    let ran = agent::run(scenario, &world.plan, &mut source, log, options)
        .map_err(|error| ExperimentError::Run(error.to_string()));
    bench.go_on()?;
    ran
}

/// Evaluations during a run.
pub fn curve(points: Vec<CurvePoint>) -> Vec<Point> {
    let point = |point: CurvePoint| Point {
        actions: point.actions as usize,
        frames: point.frames as usize,
        success: point.success,
        quality: point.convergence_quality,
    };
    points.into_iter().map(point).collect()
}
