//! What `run`, `replay` and `resume` have in common: drive a scenario from a source, evaluate, report.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::robot::{self, Robot, Voice};
use super::{Ending, print, print_json, progress, report};
use crate::agent::{
    self, CHECKPOINT_NAME, Controls, CurvePoint, Fleet, Outcome, RecordedEvents, RunOptions, STATE_NAME,
    SnapshotSettings, Status,
};
use crate::evaluate::{Evaluator, decode_pose};
use crate::fleet::Connection;
use crate::live::SetWhenDropped;
use crate::live::serve::{ServedRun, Server};
use crate::log::{Folder, LogOptions, Rotation, RunLog};
use crate::report::gather::ROOM;
use crate::report::{ComputedBy, Origin, Program, Report, table};
use crate::scenario::{Compute, Scenario};
use crate::snapshot::Snapshot;
use crate::soak::Sampler;
use crate::source::Source;
use crate::source::live::Switches;
use crate::world::World;

/// Says of a log that its models are from the learner of a fleet.
pub const FLEET: &str = "fleet";

/// A run that is to be made in a folder.
pub struct Drive<'a> {
    pub scenario: &'a Arc<Scenario>,
    pub world: &'a Arc<World>,
    /// The folder, which exists.
    pub run: &'a Path,
    /// Set from outside to end the run cleanly.
    pub stop: &'a AtomicBool,
    pub quiet: bool,
    /// What happened in a recording that is repeated.
    pub recording: Option<&'a RecordedEvents>,
    /// The run ends after this many actions.
    pub most_actions: Option<u64>,
    /// About how many actions there will be, for the progress, where only a bound of them is known.
    pub likely_actions: Option<u64>,
    /// Whether what was learned is tried out in the simulated world, and drawn there.
    pub evaluate: bool,
    /// Whether there is a page with drawings at the end.
    pub report: bool,
    /// Who watches the run.
    pub sampler: Option<&'a Sampler>,
    /// Where a page shows it.
    pub server: Option<&'a Server>,
    pub origin: Origin,
    /// Who learns in its place.
    pub fleet: Option<Connection>,
    /// Whether the state of the run is saved now and then, so that it can go on from there.
    pub keep: bool,
    /// The state that it goes on from.
    pub state: Option<Snapshot>,
    /// Evaluations before that.
    pub curve: Vec<CurvePoint>,
    /// What people ask of a robot.
    pub switches: Switches,
    /// What the run says to a robot's network.
    pub voice: Option<Voice>,
}

impl<'a> Drive<'a> {
    /// A run from its start to its end that nobody watches and that is not kept, with a report.
    pub fn new(
        scenario: &'a Arc<Scenario>,
        world: &'a Arc<World>,
        run: &'a Path,
        stop: &'a AtomicBool,
        quiet: bool,
    ) -> Self {
        Drive {
            scenario,
            world,
            run,
            stop,
            quiet,
            recording: None,
            most_actions: None,
            likely_actions: None,
            evaluate: true,
            report: true,
            sampler: None,
            server: None,
            origin: Origin::default(),
            fleet: None,
            keep: false,
            state: None,
            curve: Vec::new(),
            switches: Switches::default(),
            voice: None,
        }
    }

    /// A run in a folder that was made for it, of a robot.
    pub fn with_robot(self, robot: Robot) -> Result<Report, String> {
        let Robot { mut source, switches, is_real, voice } = robot;
        let origin = Origin { elsewhere: is_real, fleet: self.fleet.is_some(), ..Origin::default() };
        let keep = self.fleet.is_none();
        Drive { origin, keep, evaluate: !is_real, switches, voice, ..self }.begin(&mut *source)
    }

    /// A run in a folder that was made for it: its log begins there.
    pub fn begin(self, source: &mut (dyn Source + Send)) -> Result<Report, String> {
        let (run, scenario) = (self.run, self.scenario);
        write(run, "scenario.toml", scenario.text.as_bytes())?;
        let (options, rotation) = log_options(scenario);
        let log = RunLog::create(Folder::new(run), &options, rotation, &metadata(scenario, &self.origin));
        self.go(source, log.map_err(|error| error.to_string())?)
    }

    /// Run to the end, evaluate what was learned, and write the report. The error is one for people.
    pub fn go(self, source: &mut (dyn Source + Send), log: RunLog) -> Result<Report, String> {
        let (scenario, world) = (self.scenario, self.world);
        let no_device = world.appearance.prepare();
        if let Some(warning) = &no_device {
            eprintln!("warning: {warning}");
        }
        let starts = scenario.evaluate.starts;
        if self.evaluate && !self.quiet {
            // On a large floor that takes minutes.
            eprintln!("searching the shortest ways of {starts} starts per task");
        }
        let evaluator = self.evaluate.then(|| Evaluator::new(scenario.clone(), world.clone(), starts, scenario.seed));
        let (checkpoint, state) = (self.run.join(CHECKPOINT_NAME), self.run.join(STATE_NAME));
        let most = self.most_actions.unwrap_or(u64::MAX).min(scenario.actions as u64);
        let likely = self.likely_actions.unwrap_or(u64::MAX).min(most);
        let dock = scenario.motion.as_ref().and_then(|motion| motion.safety.battery_task.as_ref());
        let dock = dock.and_then(|name| scenario.tasks.iter().position(|task| task.name == *name));
        let controls = Arc::new(Controls::sharing(self.switches.clone(), dock));
        let rendered_by = || world.appearance.rendered_by();
        let outcome = watched(self.quiet, likely, self.sampler, |status| {
            let options = RunOptions {
                controls: (self.keep || self.fleet.is_some()).then_some(&*controls),
                checkpoint: Some(&checkpoint),
                evaluator: evaluator.as_ref(),
                recording: self.recording,
                most_actions: self.most_actions,
                keep: self
                    .keep
                    .then(|| SnapshotSettings { path: state.clone(), every: scenario.agent.snapshot_every() }),
                state: self.state,
                curve: self.curve,
                fleet: self.fleet.map(|fleet| Box::new(fleet) as Box<dyn Fleet>),
                rendered_by: Some(&rendered_by),
                ..RunOptions::new(self.stop, status)
            };
            let (run_folder, stop) = (self.run, self.stop);
            let stage = ServedRun { run: run_folder, scenario, world, controls: &controls, stop };
            let run = || agent::run(scenario, &world.plan, &mut *source, log, options);
            let run = || match self.voice {
                None => run(),
                Some(voice) => robot::beside(voice, &stage, run),
            };
            match self.server {
                None => run(),
                Some(server) => server.beside(&stage, run),
            }
        });
        let outcome: Outcome = outcome.map_err(|error| error.to_string())?;
        if outcome.actions >= scenario.actions as u64 {
            // It is large, and there is nothing left to go on with. That there was none is no failure.
            let _ = std::fs::remove_file(&state);
        }
        for failure in &outcome.log.failures {
            eprintln!("warning: {failure}");
        }
        if let Some(reason) = &outcome.not_saved {
            eprintln!("warning: {reason}: the run would go on from its log alone");
        }
        if let Some(reason) = &outcome.not_taken {
            eprintln!("warning: {reason}");
        }
        if outcome.log.deleted_files > 0 {
            let (files, bytes) = (outcome.log.deleted_files, outcome.log.deleted_bytes as f64 / 1e6);
            eprintln!("warning: the {files} oldest log files ({bytes:.1} MB) were deleted: log.budget_mb");
        }
        let (mut trials, mut pose) = (Err(report::NOT_TRIED.to_owned()), None);
        if let (Some(learned), Some(evaluator)) = (&outcome.learned, &evaluator) {
            if !self.quiet {
                eprintln!("evaluating {starts} starts per task, with and without reflexes");
            }
            trials = Ok(evaluator.evaluate_and_show(learned, true));
            pose = decode_pose(scenario, world, learned, scenario.seed)
                .inspect_err(|error| eprintln!("warning: the pose cannot be decoded: {error}"))
                .ok();
        }
        let tasks = trials.iter().flatten().map(|(result, _)| result.clone()).collect();
        let kernel_values = outcome.kernel_values_by.clone();
        let computed_by = ComputedBy { pictures: world.appearance.rendered_by(), kernel_values };
        if let Some(by) = &computed_by.kernel_values {
            if let Some(failed) = &by.failed {
                eprintln!("warning: kernel values: {failed}; the processor went on");
            } else if by.gpu.is_none() && scenario.agent.compute == Compute::Gpu {
                eprintln!("warning: agent.compute is \"gpu\", and the processor computed: {}", by.why);
            }
        }
        if no_device.is_none()
            && let Some(warning) = world.appearance.missing_device()
        {
            eprintln!("warning: {warning}");
        }
        let made = Report::new(scenario, &outcome, tasks, pose, self.origin, source.imported(), computed_by);
        let report = Report { movables: world.movables(), ..made };
        let json = serde_json::to_string_pretty(&report).map_err(|error| error.to_string())?;
        write(self.run, "report.json", json.as_bytes())?;
        if !self.report {
            return Ok(report);
        }
        let without = outcome.without_model.clone();
        let without = || without.unwrap_or_else(|| "the run ended before its first model".to_owned());
        let learned = outcome.learned.as_deref().ok_or_else(without);
        let known = report::RunContext { scenario, world, simulated: self.evaluate, learned, trials, pose };
        // The report shows what is kept elsewhere already: a run does not fail for it.
        if let Err(reason) = report::at_end(self.run, &known, self.quiet) {
            eprintln!("warning: there is no new report.html: {reason}");
        }
        Ok(report)
    }
}

/// Do something with its progress on stderr, unless `quiet`, and watched by a sampler, if there is one.
pub fn watched<R>(quiet: bool, actions: u64, sampler: Option<&Sampler>, work: impl FnOnce(&Status) -> R) -> R {
    let (status, over) = (Status::default(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        if let Some(sampler) = sampler {
            scope.spawn(|| sampler.watch(&status, &over));
        }
        if !quiet {
            scope.spawn(|| progress::show(&status, actions, &over));
        }
        // Also if the run panics: the progress thread must end, or this scope never does.
        let _over = SetWhenDropped(&over);
        work(&status)
    })
}

/// Print what came of a run in a folder.
pub fn ending(result: Result<Report, String>, run: &Path, json: bool) -> Result<(), Ending> {
    let report = result.map_err(|reason| kept(&reason, run))?;
    if json { print_json(&report) } else { print(&format!("{}kept in {}\n", table(&report), run.display())) }
}

/// What to say of a run that failed in its folder.
pub fn kept(reason: &str, run: &Path) -> Ending {
    Ending::Failed(format!("{reason}\nwhat was recorded is kept in {}", run.display()))
}

/// Write a file of a run folder: aside, then renamed, so that it is whole or not there. A report says that a run is done.
pub fn write(run: &Path, name: &str, bytes: &[u8]) -> Result<(), String> {
    let (path, aside) = (run.join(name), run.join(format!("{name}.part")));
    let written = File::create(&aside).and_then(|mut file| {
        file.write_all(bytes)?;
        file.sync_all()
    });
    let renamed = written.and_then(|()| std::fs::rename(&aside, &path));
    renamed.map_err(|cause| format!("cannot write {}: {cause}", path.display()))
}

/// How a scenario wants its log written.
pub fn log_options(scenario: &Scenario) -> (LogOptions, Rotation) {
    let log = &scenario.log;
    let bytes = |megabytes: f64| (1e6 * megabytes) as u64;
    let options = LogOptions {
        compression: log.compression,
        chunk_bytes: log.chunk_bytes as u64,
        flush_interval: Duration::from_secs_f64(log.flush_seconds),
    };
    let rotation = Rotation {
        file_bytes: bytes(log.file_mb),
        file_age: log.file_minutes.map(|minutes| Duration::from_secs_f64(60.0 * minutes)),
        budget_bytes: log.budget_mb.map(bytes),
    };
    (options, rotation)
}

/// What every file of a run's log says about the run.
pub fn metadata(scenario: &Scenario, origin: &Origin) -> BTreeMap<String, String> {
    let program = Program::this();
    let mut metadata = BTreeMap::from([
        ("scenario".to_owned(), scenario.text.clone()),
        ("scenario_name".to_owned(), scenario.name.clone()),
        ("scenario_sha256".to_owned(), scenario.sha256()),
        ("seed".to_owned(), scenario.seed.to_string()),
        ("part".to_owned(), origin.part.to_string()),
        ("version".to_owned(), program.version.to_owned()),
        ("commit".to_owned(), program.commit.unwrap_or("unknown").to_owned()),
    ]);
    if origin.elsewhere {
        metadata.insert(ROOM.0.to_owned(), ROOM.1.to_owned());
    }
    if origin.fleet {
        metadata.insert(FLEET.to_owned(), "true".to_owned());
    }
    if let Some(of) = &origin.replay_of {
        metadata.insert("replay_of".to_owned(), of.clone());
    }
    metadata
}
