//! `adagio replay BAG --scenario FILE`: learn from the log of another program.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::drive::{self, Drive};
use super::run::load;
use super::{Ending, ReplayArgs, folder};
use crate::log::topics;
use crate::report::Origin;
use crate::scenario::Scenario;
use crate::source::Imported;
use crate::source::imported::{ImportError, LogContents, Roles, frames_per_action};
use crate::world::World;

/// Fewest actions that a scenario may have.
const FEWEST_ACTIONS: u64 = 10;

/// Learn from another program's log, with a scenario that says what is what.
pub fn import(args: &ReplayArgs, file: &Path, stop: &AtomicBool) -> Result<(), Ending> {
    let (survey, roles, scenario) = prepare(args, file)?;
    for damage in &survey.damage {
        eprintln!("warning: {damage}");
    }
    if !args.quiet {
        eprintln!("{}", summary(&roles, &scenario));
    }
    let scenario = Arc::new(scenario);
    let world = Arc::new(World::new(&scenario)?);
    // That nothing can be learned shows before there is a folder.
    let mut source = Imported::open(scenario.clone(), &survey, &roles)?;
    let run = folder::create(args.out.as_deref(), &scenario)?;
    let (replay_of, elsewhere) = (Some(args.run.display().to_string()), args.no_evaluate);
    let drive = Drive {
        likely_actions: Some((scenario.actions / scenario.robot.frames_per_action) as u64),
        evaluate: !args.no_evaluate,
        report: !args.no_report,
        origin: Origin { replay_of, elsewhere, ..Origin::default() },
        ..Drive::new(&scenario, &world, &run, stop, args.quiet)
    };
    drive::ending(drive.begin(&mut source), &run, args.json)
}

/// What the log holds, which topic is what, and the scenario with what follows from the log: the run ends with the log, and
/// has as many frames in an action as images come. `--set` has the last word in both.
fn prepare(args: &ReplayArgs, file: &Path) -> Result<(LogContents, Roles, Scenario), Ending> {
    let wanted = Scenario::load(file, &args.set).map_err(|error| Ending::Usage(error.to_string()))?;
    wanted.notes.iter().for_each(|note| eprintln!("note: {}: {note}", file.display()));
    let refuse = |error: ImportError| match error {
        ImportError::Topic { .. } | ImportError::Rate(_) => Ending::Usage(error.to_string()),
        _ => error.into(),
    };
    let survey = LogContents::of(&args.run, wanted.topics.stamps).map_err(refuse)?;
    if survey.topics.contains_key(topics::FRAME.name()) {
        return Err(Ending::Usage(format!(
            "{} is a log of our own, which has its scenario in it: replay it without --scenario, and change what is to be \
             otherwise with --set",
            args.run.display()
        )));
    }
    let roles = survey.roles(&wanted).map_err(refuse)?;
    let frames = frames_per_action(&survey, &roles, &wanted).map_err(refuse)?;
    let images = survey.topics.get(&roles.camera).map_or(0, |seen| seen.messages);
    let mut sets = vec![
        format!("actions={}", images.max(FEWEST_ACTIONS)),
        format!("robot.frames_per_action={frames}"),
        // There is no robot that could be late, and no frame to drop.
        "agent.speed=auto".to_owned(),
        "agent.when_behind=wait".to_owned(),
        // What was done stands in the log: nobody pursues anything.
        "policy.explore_share=1".to_owned(),
    ];
    sets.extend(args.set.iter().cloned());
    Ok((survey, roles, load(file, &sets)?))
}

/// Which topic is what, for people.
fn summary(roles: &Roles, scenario: &Scenario) -> String {
    let name = |role: &Option<String>| role.clone().unwrap_or_else(|| "none".to_owned());
    let actions = match &roles.action {
        Some(topic) => format!("actions {topic}"),
        None => format!("actions cut from the motion, commands {}", name(&roles.command)),
    };
    format!(
        "camera {}, pose {}, odometry {}, {actions}, sonar {}; {} images in an action",
        roles.camera,
        name(&roles.pose),
        name(&roles.odometry),
        name(&roles.sonar),
        scenario.robot.frames_per_action
    )
}
