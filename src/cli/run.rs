//! `adagio run SCENARIO`

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::{Ending, RunArgs, folder, print, print_json, progress};
use crate::agent::{self, CHECKPOINT_NAME, Memory, Outcome, RunOptions, Status};
use crate::evaluate::{Evaluator, decode_pose};
use crate::log::{LogOptions, LogWriter};
use crate::report::{OVERVIEW_NAME, Program, Report, overview, table};
use crate::scenario::{OverMemory, Scenario, ScenarioError};
use crate::source::Simulated;
use crate::world::World;

/// Run a scenario in a new folder, evaluate what was learned, and write the report.
pub fn run(args: &RunArgs, stop: &AtomicBool) -> Ending {
    let mut sets = args.set.clone();
    sets.extend(args.seed.map(|seed| format!("seed={seed}")));
    sets.extend(args.actions.map(|actions| format!("actions={actions}")));
    let scenario = match load(&args.scenario, &sets) {
        Ok(scenario) => Arc::new(scenario),
        Err(ending) => return ending,
    };
    let run = match folder::create(args.out.as_deref(), &scenario) {
        Ok(run) => run,
        Err(ending) => return ending,
    };
    match in_folder(&scenario, &run, args, stop) {
        Ok(report) if args.json => print_json(&report),
        Ok(report) => print(&format!("{}kept in {}\n", table(&report), run.display())),
        Err(reason) => Ending::Failed(format!("{reason}\nwhat was recorded is kept in {}", run.display())),
    }
}

/// Read a scenario; a file that cannot be read, or is not valid, or needs more memory than there is, is wrong usage.
///
/// Where the scenario says so, its budget is lowered to what fits instead: the scenario that is returned, and kept in
/// the run's folder, is the one with the lower budget.
pub fn load(path: &Path, sets: &[String]) -> Result<Scenario, Ending> {
    let read =
        |sets: &[String]| Scenario::load(path, sets).map_err(|error: ScenarioError| Ending::Usage(error.to_string()));
    let scenario = read(sets)?;
    let machine = || agent::machine_memory().map(|bytes| bytes / 5 * 4);
    let allowed = scenario.agent.memory_gb.map(|gigabytes| (1e9 * gigabytes) as u64).or_else(machine);
    let (needed, Some(allowed)) = (Memory::of(&scenario).total(), allowed) else { return Ok(scenario) };
    if needed <= allowed {
        return Ok(scenario);
    }
    let what = format!(
        "{}: dictionary.budget = {} needs {:.1} GB at its full size, agent.memory_gb allows {:.1} GB",
        path.display(),
        scenario.dictionary.budget,
        needed as f64 / 1e9,
        allowed as f64 / 1e9
    );
    let Some(budget) = largest_budget(&scenario, allowed) else {
        let (part, bytes) = Memory::with_budget(&scenario, SMALLEST_BUDGET).largest();
        let of_it =
            format!("the part \"{part}\" takes {:.3} GB of it with a budget of {SMALLEST_BUDGET}", bytes as f64 / 1e9);
        return Err(Ending::Usage(format!("{what}: no budget fits; {of_it}")));
    };
    let features = scenario.slow.features.min(budget);
    if scenario.agent.over_memory == OverMemory::Refuse {
        let fewer =
            if features < scenario.slow.features { format!(", with {features} features") } else { String::new() };
        return Err(Ending::Usage(format!("{what}: the largest budget that fits is {budget}{fewer}")));
    }
    eprintln!("warning: {what}: it is lowered to {budget}, with {features} features");
    let mut sets = sets.to_vec();
    sets.extend([format!("dictionary.budget={budget}"), format!("slow.features={features}")]);
    read(&sets)
}

/// The smallest budget that a scenario may have.
const SMALLEST_BUDGET: usize = 10;

/// The largest budget of a scenario that needs no more than `allowed` bytes.
fn largest_budget(scenario: &Scenario, allowed: u64) -> Option<usize> {
    // One by one: where the solver begins to iterate, more support vectors take less memory.
    let fits = |budget: &usize| Memory::with_budget(scenario, *budget).total() <= allowed;
    (SMALLEST_BUDGET..=scenario.dictionary.budget).rev().find(fits)
}

fn in_folder(scenario: &Arc<Scenario>, run: &Path, args: &RunArgs, stop: &AtomicBool) -> Result<Report, String> {
    let text = |error: &dyn std::fmt::Display| error.to_string();
    let write = |name: &str, bytes: &[u8]| {
        let path = run.join(name);
        std::fs::write(&path, bytes).map_err(|cause| format!("cannot write {}: {cause}", path.display()))
    };
    write("scenario.toml", scenario.text.as_bytes())?;
    let options = LogOptions {
        compression: scenario.log.compression,
        chunk_bytes: scenario.log.chunk_bytes as u64,
        flush_interval: Duration::from_secs_f64(scenario.log.flush_seconds),
    };
    let log_path = run.join("run_000.mcap");
    let log = LogWriter::create(&log_path, &options, &metadata(scenario)).map_err(|e| text(&e))?;
    let world = Arc::new(World::new(scenario).map_err(|e| text(&e))?);
    let starts = scenario.evaluate.starts;
    let evaluator = Evaluator::new(scenario.clone(), world.clone(), starts, scenario.seed);
    let mut source = Simulated::new(scenario.clone(), world.clone());
    let checkpoint = run.join(CHECKPOINT_NAME);
    let (status, over) = (Status::default(), AtomicBool::new(false));
    let outcome = std::thread::scope(|scope| {
        if !args.quiet {
            scope.spawn(|| progress::show(&status, scenario.actions as u64, &over));
        }
        let options = RunOptions { stop, status: &status, checkpoint: Some(&checkpoint), evaluator: Some(&evaluator) };
        // Also if the run panics: the progress thread must end, or this scope never does.
        let _over = SetWhenDropped(&over);
        agent::run(scenario, &mut source, log, &options)
    });
    let outcome: Outcome = outcome.map_err(|e| text(&e))?;
    let (mut tasks, mut pose) = (Vec::new(), None);
    if let Some(learned) = &outcome.learned {
        if !args.quiet {
            eprintln!("evaluating {starts} starts per task, with and without reflexes");
        }
        tasks = evaluator.evaluate(learned, true);
        pose = decode_pose(scenario, &world, learned, scenario.seed)
            .inspect_err(|error| eprintln!("warning: the pose cannot be decoded: {error}"))
            .ok();
    }
    let report = Report::new(scenario, &outcome, tasks, pose);
    let json = serde_json::to_string_pretty(&report).map_err(|e| text(&e))?;
    write("report.json", json.as_bytes())?;
    // The picture shows what is kept elsewhere already: a run does not fail for it.
    let drawn = overview(scenario, &world, outcome.learned.as_deref(), &report, &log_path).map_err(|e| text(&e));
    if let Err(reason) = drawn.and_then(|picture| write(OVERVIEW_NAME, picture.as_bytes())) {
        eprintln!("warning: there is no {OVERVIEW_NAME}: {reason}");
    }
    Ok(report)
}

struct SetWhenDropped<'a>(&'a AtomicBool);

impl Drop for SetWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

fn metadata(scenario: &Scenario) -> BTreeMap<String, String> {
    let program = Program::this();
    BTreeMap::from([
        ("scenario".to_owned(), scenario.text.clone()),
        ("scenario_name".to_owned(), scenario.name.clone()),
        ("scenario_sha256".to_owned(), scenario.sha256()),
        ("seed".to_owned(), scenario.seed.to_string()),
        ("version".to_owned(), program.version.to_owned()),
        ("commit".to_owned(), program.commit.unwrap_or("unknown").to_owned()),
    ])
}
