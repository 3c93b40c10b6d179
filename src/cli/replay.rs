//! `adagio replay RUN`

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use super::drive::{self, Drive, FLEET, log_options, watched};
use super::{Ending, ReplayArgs, folder, import, print, print_json};
use crate::agent::{self, RunOptions};
use crate::log::RunLog;
use crate::log::run::{NullStorage, Repeating};
use crate::replay::{Recording, ShownDifference, show};
use crate::report::{Numbered, Origin};
use crate::scenario::Scenario;
use crate::source::Recorded;
use crate::world::World;

/// Feed a run's recorded frames to the actors again: to learn from them with other settings, or to verify the recording.
pub fn replay(args: &ReplayArgs, stop: &AtomicBool) -> Result<(), Ending> {
    if let Some(file) = &args.scenario {
        return import::import(args, file, stop);
    }
    let recording = Recording::open(&args.run)?;
    let scenario = recording.scenario(&changes(&args.set)).map_err(Ending::usage)?;
    for damage in &recording.damage {
        eprintln!("warning: {damage}");
    }
    same_vision(&recording, &scenario).map_err(Ending::Usage)?;
    let scenario = Arc::new(scenario);
    let world = Arc::new(folder::world(&args.run, &scenario)?);
    if args.verify {
        return verify(args, &recording, &scenario, &world, stop);
    }
    let run = folder::create(args.out.as_deref(), &scenario)?;
    let (replay_of, elsewhere) = (Some(args.run.display().to_string()), args.no_evaluate);
    let mut source = Recorded::new(scenario.clone(), recording.records());
    let unchanged = args.set.is_empty() && !recording.metadata.contains_key(FLEET);
    let drive = Drive {
        recording: unchanged.then_some(&recording.events),
        most_actions: Some(recording.events.decisions()),
        evaluate: !args.no_evaluate,
        report: !args.no_report,
        origin: Origin { replay_of, elsewhere, ..Origin::default() },
        ..Drive::new(&scenario, &world, &run, stop, args.quiet)
    };
    let result = drive.begin(&mut source);
    if result.is_ok() && source.damaged() > 0 {
        eprintln!("warning: {} frames or records of the recording could not be used", source.damaged());
    }
    drive::ending(result, &run, args.json)
}

/// The keys that a replay changes. With other settings the recorded moments of requests and swaps mean nothing: models come by
/// the number of frames, so that the analysis gives the same again, and no frame is waited for or dropped.
fn changes(sets: &[String]) -> Vec<String> {
    let of_replay = ["agent.mode=lockstep", "agent.when_behind=wait", "agent.speed=auto"];
    let of_replay = of_replay.into_iter().filter(|_| !sets.is_empty()).map(str::to_owned);
    of_replay.chain(sets.iter().cloned()).collect()
}

/// What a log holds of the camera is what vision made of it.
fn same_vision(recording: &Recording, scenario: &Scenario) -> Result<(), String> {
    let recorded = recording.scenario(&[]).map_err(|error| error.to_string())?;
    if recorded.vision == scenario.vision {
        return Ok(());
    }
    Err(format!(
        "vision.* cannot be changed in a replay: the log holds observations of {} × {} pixels, not camera images",
        recorded.vision.width, recorded.vision.height
    ))
}

/// What `--verify --json` prints.
#[derive(Serialize)]
struct Verified {
    equal: bool,
    /// Messages that had to be repeated.
    recorded_messages: u64,
    /// Messages that came after the end of the recording, which was not closed.
    beyond: u64,
    frames: u64,
    models: u64,
    digest: Option<String>,
    first_difference: Option<ShownDifference>,
}

/// Repeat a run and compare it with its recording, message by message.
fn verify(
    args: &ReplayArgs,
    recording: &Recording,
    scenario: &Arc<Scenario>,
    world: &World,
    stop: &AtomicBool,
) -> Result<(), Ending> {
    if !args.set.is_empty() {
        return Err(Ending::Usage("--verify repeats a run as it was: --set cannot be given with it".into()));
    }
    if recording.metadata.contains_key(FLEET) {
        return Err(Ending::Failed(format!(
            "{} cannot be verified: its models were made of what other robots saw, too; without --verify it is learned from alone",
            args.run.display()
        )));
    }
    if recording.first_frame > 0 {
        return Err(Ending::Failed(format!(
            "{} begins with frame {}: earlier files were deleted (log.budget_mb), so it cannot be repeated from its start",
            args.run.display(),
            recording.first_frame
        )));
    }
    let (options, rotation) = log_options(scenario);
    let log = RunLog::create(NullStorage, &options, rotation, &recording.metadata)?;
    let log = log.expecting(recording.expected(), Repeating::Write);
    let mut source = Recorded::new(scenario.clone(), recording.records());
    // A recording that was not closed may end in the middle of an action, or before a decision.
    let most_actions = recording.events.decisions() + u64::from(!recording.closed);
    let outcome = watched(args.quiet, most_actions, None, |status| {
        let options = RunOptions {
            recording: Some(&recording.events),
            most_actions: Some(most_actions),
            ..RunOptions::new(stop, status)
        };
        agent::run(scenario, &world.plan, &mut source, log, options)
    })?;
    let expected = outcome.log.expected.unwrap_or_default();
    let beyond = if recording.closed { 0 } else { expected.beyond() };
    let first_difference = expected.first_difference().map(|difference| show(recording, &difference)).transpose()?;
    let verified = Verified {
        equal: first_difference.is_none() && (!recording.closed || expected.beyond() == 0),
        recorded_messages: expected.recorded(),
        beyond,
        frames: outcome.frames,
        models: outcome.learned.as_ref().map_or(0, |learned| u64::from(learned.epoch)),
        digest: outcome.learned.as_ref().map(|learned| learned.digest()),
        first_difference,
    };
    summary(args, &verified)
}

fn summary(args: &ReplayArgs, verified: &Verified) -> Result<(), Ending> {
    let text = match &verified.first_difference {
        _ if args.json => String::new(),
        Some(difference) => {
            let ShownDifference { topic, index, fields, .. } = difference;
            let fields: Vec<String> =
                fields.iter().map(|(name, before, now)| format!("  {name}: recorded {before}, now {now}\n")).collect();
            format!("first difference: message {index} on {topic}\n{}", fields.concat())
        }
        None => {
            let messages = Numbered(verified.recorded_messages);
            let digest = verified.digest.as_deref().unwrap_or("none: no model was made");
            format!(
                "{} frames, {} models: all {messages} messages are repeated bit for bit\ndigest {digest}\n",
                Numbered(verified.frames),
                verified.models
            )
        }
    };
    if args.json { print_json(verified) } else { print(&text) }?;
    // Damage cost nothing where everything after it is repeated.
    if verified.equal { Ok(()) } else { Err(format!("{} is not repeated bit for bit", args.run.display()).into()) }
}
