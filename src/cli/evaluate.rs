//! `adagio evaluate RUN`

use std::sync::Arc;

use serde::Serialize;

use super::{Ending, EvaluateArgs, folder, print, print_json};
use crate::evaluate::{Evaluator, PoseDecode, TaskResult, decode_pose};
use crate::report::{ComputedBy, tasks_table};

/// What `--json` prints: the same keys as in `report.json`.
#[derive(Serialize)]
struct Evaluation {
    tasks: Vec<TaskResult>,
    pose_decode: Option<PoseDecode>,
    computed_by: ComputedBy,
}

/// Try a run's policies from random starts in the run's own world.
pub fn evaluate(args: &EvaluateArgs) -> Result<(), Ending> {
    let (learned, scenario) = folder::learned(&args.run)?;
    let scenario = Arc::new(scenario);
    let world = Arc::new(folder::world(&args.run, &scenario)?);
    let no_device = world.appearance.prepare();
    if let Some(warning) = &no_device {
        eprintln!("warning: {warning}");
    }
    let starts = args.starts.map_or(scenario.evaluate.starts, |starts| starts as usize);
    let seed = args.seed.unwrap_or(scenario.seed);
    let tasks = Evaluator::new(scenario.clone(), world.clone(), starts, seed).evaluate(&learned, true);
    let pose_decode = decode_pose(&scenario, &world, &learned, seed)
        .inspect_err(|error| eprintln!("warning: the pose cannot be decoded: {error}"))
        .ok();
    if no_device.is_none()
        && let Some(warning) = world.appearance.missing_device()
    {
        eprintln!("warning: {warning}");
    }
    let computed_by = ComputedBy { pictures: world.appearance.rendered_by(), kernel_values: None };
    let result = Evaluation { tasks, pose_decode, computed_by };
    if args.json {
        return print_json(&result);
    }
    print(&tasks_table(&result.tasks, result.pose_decode.as_ref()))
}
