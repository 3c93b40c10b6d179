//! `adagio fleet SCENARIO`: the learner of several robots.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use serde::Serialize;

use super::drive::write;
use super::learn::{SCENARIO, conclude};
use super::run::{load, not_served};
use super::{Ending, FleetArgs, folder, print, print_json};
use crate::agent::{CHECKPOINT_NAME, STATE_NAME, checkpoint_bytes, write_checkpoint};
use crate::fleet::{LOST, Learner, Server, Told};
use crate::random::fix_parallelism;
use crate::report::Numbered;
use crate::scenario::Scenario;
use crate::world::World;

/// What a fleet's model is of.
#[derive(Serialize)]
struct LearnedFrom {
    robots: Vec<RobotFrames>,
    frames: u64,
    transitions: usize,
    /// Frames that were left out: their values are not finite.
    quarantined: u64,
    seconds: f64,
}

#[derive(Serialize)]
struct RobotFrames {
    name: String,
    frames: u64,
}

/// Learn from robots until all have left.
pub fn fleet(args: &FleetArgs, stop: &AtomicBool) -> Result<(), Ending> {
    let begin = Instant::now();
    fix_parallelism();
    let scenario = Arc::new(load(&args.scenario, &args.set)?);
    let world = Arc::new(World::new(&scenario)?);
    let server = Server::new(args.listen, args.token.clone()).map_err(not_served)?;
    let mut learner = Learner::new(&scenario, &world.plan);
    let out = begin_folder(args.out.as_deref(), &scenario, &mut learner)?;
    // Who starts robots needs it, also where progress is not wanted.
    let token = if args.token.is_some() { String::new() } else { format!(" --fleet-token {}", server.token()) };
    eprintln!("robots: adagio run SCENARIO --fleet {}{token}", server.address());
    if !args.listen.ip().is_loopback() {
        eprintln!(
            "warning: {} can be reached from other machines, and what is sent is not encrypted",
            server.address().ip()
        );
    }
    let state = out.join(STATE_NAME);
    let mut tell = |learner: &Learner, told: Told| {
        if let Told::Model(..) = told
            && let Some(Ok(learned)) = learner.update.as_ref().map(|update| &update.learned)
        {
            // For `adagio evaluate`, and who looks.
            let kept = checkpoint_bytes(learned, &scenario)
                .and_then(|bytes| write_checkpoint(&out.join(CHECKPOINT_NAME), &bytes));
            kept.unwrap_or_else(|error| eprintln!("warning: {error}"));
        }
        say(&told, args.quiet);
    };
    server.learn(&mut learner, &scenario, (args.robots.get().into(), &state), stop, &mut tell)?;
    let without = || format!("there is no model: the robots left too soon; what there is is kept in {}", out.display());
    let update = learner.update.as_ref().ok_or_else(without)?;
    let learned = update.learned.as_ref().map_err(|reason| format!("there is no model: {reason}"))?;
    let robots = learner.robots().iter();
    let from = LearnedFrom {
        robots: robots.map(|(name, robot)| RobotFrames { name: name.clone(), frames: robot.frames }).collect(),
        frames: learned.frames,
        transitions: update.transitions,
        quarantined: learner.quarantined,
        seconds: begin.elapsed().as_secs_f64(),
    };
    let said = conclude((&scenario, &world), (learned, None), from, &out, (!args.no_evaluate, args.quiet))?;
    if args.json {
        return print_json(&said);
    }
    let from = &said.learned_from;
    print(&format!(
        "{}: {} frames of {} robots in {:.0} s\n{} support vectors, {}kept in {}\n",
        scenario.name,
        Numbered(from.frames),
        from.robots.len(),
        from.seconds,
        Numbered(learned.model.members.ncols() as u64),
        said.outcome(),
        out.display()
    ))
}

fn say(told: &Told, quiet: bool) {
    let (warns, text) = match told {
        Told::Joined(name, count) => (false, format!("{name} has joined: {count} robots")),
        Told::Lost(name) => {
            (true, format!("{name} was not heard for {} s: the others go on without it", LOST.as_secs()))
        }
        Told::Back(name) => (false, format!("{name} is heard again")),
        Told::Left(name, frames) => (false, format!("{name} has left after {} frames", Numbered(*frames))),
        Told::Model(epoch, frames, robots, seconds) => (
            false,
            format!("model {epoch} of {} frames, new ones from {robots} robots, in {seconds} s", Numbered(*frames)),
        ),
        Told::Warning(text) => (true, text.clone()),
    };
    if warns {
        eprintln!("warning: {text}");
    } else if !quiet {
        eprintln!("{text}");
    }
}

/// A new folder, or that of a learner that was interrupted, whose state it goes on from.
fn begin_folder(out: Option<&Path>, scenario: &Scenario, learner: &mut Learner) -> Result<PathBuf, Ending> {
    let text = |out: &Path| std::fs::read_to_string(out.join(SCENARIO)).ok();
    if let Some(out) = out
        && let Ok(bytes) = std::fs::read(out.join(STATE_NAME))
    {
        if text(out).as_ref() != Some(&scenario.text) {
            return Err(Ending::Usage(format!(
                "{} is of another scenario: name another folder with --out",
                out.display()
            )));
        }
        learner.restore(&bytes).map_err(|cause| format!("cannot go on in {}: {cause}", out.display()))?;
        return Ok(out.to_owned());
    }
    let out = folder::create(out, scenario)?;
    write(&out, SCENARIO, scenario.text.as_bytes())?;
    Ok(out)
}
