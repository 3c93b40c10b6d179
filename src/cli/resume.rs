//! `adagio resume RUN`

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::drive::{self, Drive, FLEET, log_options, metadata};
use super::robot::{self, Robot};
use super::{Ending, ResumeArgs};
use crate::agent::{STATE_NAME, SavedState, read_state};
use crate::log::run::Repeating;
use crate::log::{Folder, RunLog, log_files};
use crate::replay::Recording;
use crate::report::{Numbered, Origin, Program, Report};
use crate::scenario::Scenario;
use crate::source::{Recorded, Resumed};
use crate::world::World;

/// Go on with a run that was ended before its last action: by Ctrl-C, by a kill, by a power loss.
pub fn resume(args: &ResumeArgs, stop: &Arc<AtomicBool>) -> Result<(), Ending> {
    if !args.run.is_dir() {
        return Err(Ending::Usage(format!("{} is no run folder: a run goes on in its folder", args.run.display())));
    }
    let recording = Recording::open(&args.run)?;
    can_go_on(&args.run, &recording)?;
    let scenario = Arc::new(recording.scenario(&[]).map_err(Ending::usage)?);
    let done = recording.closed && recording.events.decisions() >= scenario.actions as u64;
    if done && args.run.join("report.json").is_file() {
        let actions = Numbered(scenario.actions as u64);
        eprintln!("{} has done all of its {actions} actions: there is nothing to go on with", args.run.display());
        return Ok(());
    }
    let open = |scenario: &Arc<Scenario>, world: &Arc<World>, last| robot::open(scenario, world, stop, last);
    drive::ending(go_on(args, &recording, scenario, stop, open), &args.run, args.json)
}

/// Whether this program goes on with a recording.
pub fn can_go_on(run: &Path, recording: &Recording) -> Result<(), String> {
    if let Some(of) = recording.metadata.get("replay_of") {
        return Err(format!("{} is a replay of {of}: there is no robot to go on with", run.display()));
    }
    if recording.metadata.contains_key(FLEET) {
        return Err(format!(
            "{} is of a robot of a fleet, whose learner has its state: begin a new run with --fleet, which acts on the newest model",
            run.display()
        ));
    }
    let recorded = recording.metadata.get("version").map_or("unknown", String::as_str);
    let version = Program::this().version;
    if recorded != version {
        return Err(format!(
            "{} was recorded by version {recorded}, this is {version}: it may learn otherwise",
            run.display()
        ));
    }
    Ok(())
}

/// Go on with a recording; `open` gives the robot, whose frames come behind the number and the stamp of the last one that is
/// recorded. The error is one for people.
pub fn go_on(
    args: &ResumeArgs,
    recording: &Recording,
    scenario: Arc<Scenario>,
    stop: &Arc<AtomicBool>,
    open: impl FnOnce(&Arc<Scenario>, &Arc<World>, Option<(u64, u64)>) -> Result<Robot, Ending>,
) -> Result<Report, String> {
    let world = Arc::new(World::new(&scenario).map_err(|e| e.to_string())?);
    let kept = state(&args.run, recording, &scenario);
    if recording.first_frame > kept.as_ref().map_or(0, |kept| kept.frame + 1) {
        return Err(format!(
            "{} begins with frame {}: earlier files were deleted (log.budget_mb), and no state of the run was kept after that",
            args.run.display(),
            recording.first_frame
        ));
    }
    if !args.quiet {
        match &kept {
            Some(kept) => {
                eprintln!("going on behind frame {}, where the state of the run was kept", Numbered(kept.frame))
            }
            None => eprintln!("learning again from {} recorded frames, then going on", Numbered(recording.frames)),
        }
    }
    for damage in &recording.damage {
        eprintln!("warning: {damage}");
    }
    let origin = Origin { part: recording.part + 1, ..Origin::default() };
    let mut sizes = Vec::new();
    for (number, path) in log_files(&args.run).map_err(|e| e.to_string())? {
        sizes.push((number, path.metadata().map_err(|e| e.to_string())?.len()));
    }
    let (options, rotation) = log_options(&scenario);
    let metadata = metadata(&scenario, &origin);
    let log =
        RunLog::append(Folder::new(&args.run), &options, rotation, &metadata, &sizes).map_err(|e| e.to_string())?;
    let (mut expected, course) = recording.open_end();
    let mut recorded = Recorded::new(scenario.clone(), recording.records());
    let mut curve = Vec::new();
    if let Some(kept) = &kept {
        expected.skip_to(kept.stamp_ns);
        recorded.skip_to(kept.frame);
        curve = recording.curve(kept.frame, &scenario);
    }
    let last = course.last_frame().map(|number| (number, recording.last_stamp_ns));
    let Robot { source: live, switches, is_real, voice } = open(&scenario, &world, last).map_err(Ending::into_text)?;
    if is_real {
        // It says nothing twice, whatever its clock does.
        expected.forget_robot();
    }
    let log = log.expecting(expected, Repeating::Skip);
    let mut source = match is_real {
        // It is where it is, and has done already what the log says.
        true => Resumed::beside(recorded, live),
        false => Resumed::repeating(recorded, live),
    };
    let drive = Drive {
        recording: Some(&course),
        report: !args.no_report,
        origin,
        keep: true,
        state: kept.map(|kept| kept.snapshot),
        curve,
        evaluate: !is_real,
        switches,
        voice,
        ..Drive::new(&scenario, &world, &args.run, stop, args.quiet)
    };
    drive.go(&mut source, log)
}

/// The state that the run was saved with, if there is one that can be used: without it, everything is learned again from
/// the log.
fn state(run: &Path, recording: &Recording, scenario: &Scenario) -> Option<SavedState> {
    let path = run.join(STATE_NAME);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(cause) if cause.kind() == std::io::ErrorKind::NotFound => return None,
        Err(cause) => {
            eprintln!("warning: cannot read {}: {cause}", path.display());
            return None;
        }
    };
    let (_, course) = recording.open_end();
    match read_state(&bytes, scenario) {
        Ok(kept) if course.last_frame().is_some_and(|last| kept.frame <= last) => return Some(kept),
        Ok(kept) => eprintln!("warning: {} is ahead of the log, at frame {}", path.display(), kept.frame),
        Err(error) => eprintln!("warning: {}: {error}", path.display()),
    }
    None
}
