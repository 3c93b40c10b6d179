//! `adagio soak SCENARIO --hours H`

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::drive::{self, Drive};
use super::run::load;
use super::{Ending, SoakArgs, folder, print, print_json, robot};
use crate::log::{Ending as LogEnding, log_files, summarise};
use crate::report::Report;
use crate::scenario::{Change, ChangeKind, Scenario};
use crate::soak::{Sampler, Soak, check_rules, page};
use crate::world::World;

/// Longest soak test, hours: ten years.
const MOST_HOURS: f64 = 87_600.0;

/// Run a scenario for so many hours of driving, watched, and judge the run.
pub fn soak(args: &SoakArgs, stop: &Arc<AtomicBool>) -> Result<(), Ending> {
    if !(args.hours > 0.0 && args.hours <= MOST_HOURS) {
        return Err(Ending::Usage(format!("--hours {} is not allowed: it must be in (0, {MOST_HOURS}]", args.hours)));
    }
    let mut sets = args.set.clone();
    sets.extend(args.seed.map(|seed| format!("seed={seed}")));
    // Its length is not known yet, nor what memory it needs.
    let first = Scenario::load(&args.scenario, &sets).map_err(Ending::usage)?;
    sets.push(format!("actions={}", (args.hours * 3600.0 / first.robot.action_seconds).ceil()));
    let scenario = Arc::new(load(&args.scenario, &sets)?);
    let world = Arc::new(World::new(&scenario)?);
    let robot = robot::open(&scenario, &world, stop, None)?;
    let run = folder::create(args.out.as_deref(), &scenario)?;
    let sampler = Sampler::new(&run, scenario.actions as u64, scenario.robot.action_seconds);
    let drive = Drive { sampler: Some(&sampler), ..Drive::new(&scenario, &world, &run, stop, args.quiet) };
    let soak = drive
        .with_robot(robot)
        .and_then(|report| judged(&scenario, &run, &report, &sampler))
        .map_err(|reason| drive::kept(&reason, &run))?;
    if args.json {
        print_json(&soak)?;
    } else {
        print(&format!("{}kept in {}\n", soak.text(), run.join("soak.html").display()))?;
    }
    let failing: Vec<&str> = soak.rules.iter().filter(|rule| !rule.holds).map(|rule| rule.rule.as_str()).collect();
    if failing.is_empty() { Ok(()) } else { Err(format!("it should be that {}", failing.join("; that ")).into()) }
}

fn judged(scenario: &Scenario, run: &Path, report: &Report, sampler: &Sampler) -> Result<Soak, String> {
    let mut damage = report.log.failures.clone();
    for (number, path) in log_files(run).map_err(|error| format!("cannot read {}: {error}", run.display()))? {
        let summary = summarise(&path).map_err(|error| error.to_string())?;
        if summary.ending != LogEnding::Complete || summary.damaged > 0 {
            damage.push(format!("file {number} of the log is not whole"));
        }
    }
    let samples = sampler.samples();
    let hour = |actions: f64| actions * scenario.robot.action_seconds / 3600.0;
    let curve: Vec<_> = report.curve.iter().map(|point| (hour(point.actions as f64), point.clone())).collect();
    let done = report.run.actions;
    let happened = scenario.changes.iter().filter(|change| (change.action as u64) < done);
    let changes: Vec<_> =
        happened.clone().map(|change| (hour(change.action as f64), change.what.to_string())).collect();
    let per_action = scenario.robot.frames_per_action;
    let lost = |change: &Change| match change.what {
        // All but the last ones of actions, up to the end of the run.
        ChangeKind::Lose { frames } => {
            let frames = frames.min((done as usize).saturating_sub(change.action) * per_action);
            (frames - frames / per_action) as u64
        }
        _ => 0,
    };
    let lost_on_purpose = happened.map(lost).sum();
    let hours: Vec<f64> = changes.iter().map(|change| change.0).collect();
    let rules = check_rules(&samples, &curve, &damage, lost_on_purpose, &hours);
    let soak = Soak {
        scenario: scenario.name.clone(),
        seed: scenario.seed,
        hours: hour(done as f64),
        seconds: report.run.seconds,
        passed: rules.iter().all(|rule| rule.holds),
        rules,
        changes,
        samples,
        curve,
    };
    let json = serde_json::to_string_pretty(&soak).map_err(|error| error.to_string())?;
    drive::write(run, "soak.json", json.as_bytes())?;
    let html = page(&soak).map_err(|error| format!("there is no soak.html: {error}"))?;
    drive::write(run, "soak.html", html.as_bytes())?;
    Ok(soak)
}
