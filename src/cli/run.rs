//! `adagio run SCENARIO`

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::drive::{self, Drive};
use super::{Ending, RunArgs, folder, robot, ros_args};
use crate::agent::{self, Memory};
use crate::fleet::{Connection, FleetError};
use crate::live::serve::{ServeError, Server};
use crate::scenario::{OverMemory, Scenario, ScenarioError};
use crate::world::World;

/// Run a scenario in a new folder, evaluate what was learned, and write the report.
pub fn run(args: &RunArgs, stop: &Arc<AtomicBool>) -> Result<(), Ending> {
    let mut sets = args.set.clone();
    sets.extend(args.seed.map(|seed| format!("seed={seed}")));
    sets.extend(args.actions.map(|actions| format!("actions={actions}")));
    let mut scenario = load(&args.scenario, &sets)?;
    if !args.ros_args.is_empty() {
        sets.extend(ros_args::sets(&args.ros_args, &scenario)?);
        scenario = load(&args.scenario, &sets)?;
    }
    let scenario = Arc::new(scenario);
    // Before there is a folder: an address that is taken, or a robot that is not there, leaves nothing behind.
    let server = server(args)?;
    let fleet = join(args, &scenario)?;
    let world = Arc::new(World::new(&scenario)?);
    let robot = robot::open(&scenario, &world, stop, None)?;
    let run = folder::create(args.out.as_deref(), &scenario)?;
    if let Some(server) = &server {
        eprintln!("the run can be watched at {}", server.url());
        server.warning().into_iter().for_each(|warning| eprintln!("warning: {warning}"));
    }
    let (report, server) = (!args.no_report, server.as_ref());
    let drive = Drive { report, server, fleet, ..Drive::new(&scenario, &world, &run, stop, args.quiet) };
    drive::ending(drive.with_robot(robot), &run, args.json)
}

/// The page that is asked for, if one is.
fn server(args: &RunArgs) -> Result<Option<Server>, Ending> {
    let Some(address) = args.serve else { return Ok(None) };
    Server::new(address, args.token.clone()).map(Some).map_err(not_served)
}

/// A token that cannot be used is wrong usage.
pub fn not_served(error: ServeError) -> Ending {
    match error {
        ServeError::Token(_) => Ending::usage(error),
        ServeError::Bind { .. } => error.into(),
    }
}

/// The learner of the fleet that it joins, if it does.
fn join(args: &RunArgs, scenario: &Scenario) -> Result<Option<Connection>, Ending> {
    let (Some(address), Some(token)) = (args.fleet, &args.fleet_token) else { return Ok(None) };
    match Connection::join(address, token.clone(), scenario) {
        Ok(fleet) => {
            eprintln!("{} learns with the fleet at {address}", fleet.name());
            Ok(Some(fleet))
        }
        Err(error @ FleetError::Unlike(_)) => Err(Ending::Usage(error.to_string())),
        Err(error) => Err(error.into()),
    }
}

/// Read a scenario; a file that cannot be read, or is not valid, or needs more memory than there is, is wrong usage.
///
/// Where the scenario says so, its budget is lowered to what fits instead: the scenario that is returned, and kept in
/// the run's folder, is the one with the lower budget.
pub fn load(path: &Path, sets: &[String]) -> Result<Scenario, Ending> {
    within_memory(path, sets, |sets| Scenario::load(path, sets))
}

/// The same of a scenario that is read in another way; `path` is for messages.
pub fn within_memory(
    path: &Path,
    sets: &[String],
    read: impl Fn(&[String]) -> Result<Scenario, ScenarioError>,
) -> Result<Scenario, Ending> {
    let read = |sets: &[String]| read(sets).map_err(|error| Ending::Usage(error.to_string()));
    let scenario = read(sets)?;
    scenario.notes.iter().for_each(|note| eprintln!("note: {}: {note}", path.display()));
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
