//! A run that another program drives: it shows frames and takes actions, in its own loop.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::Duration;

use thiserror::Error;

use super::drive::Drive;
use super::robot::Robot;
use super::run::within_memory;
use super::{Ending, ResumeArgs, folder, resume};
use crate::policy::Goto;
use crate::replay::Recording;
use crate::report::Report;
use crate::robot::{Action, Pose};
use crate::scenario::{Body, Scenario};
use crate::source::live::Switches;
use crate::source::program::{Driver, Ends, Over, Shown, driven};
use crate::source::{Mark, parse_goto, parse_mark};
use crate::vision::{Image, check_size};
use crate::world::World;

/// Where a scenario that was not read from a file says that it is from.
const NO_FILE: &str = "agent.toml";

/// Why nothing can be done in a forked process.
const FORKED: &str = "the run belongs to the process that began it: a forked one cannot drive it";

/// A run that goes on beside the program that drives it.
pub struct Session {
    scenario: Arc<Scenario>,
    run: PathBuf,
    driver: Option<Driver>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<Result<Report, String>>>,
    /// What came of it, once it is over.
    outcome: Option<Result<Report, String>>,
    turn: Turn,
    /// What goes with the next frame.
    marks: Vec<Mark>,
    goto: Option<Goto>,
    /// The process that has the threads: a forked one has none of them.
    process: u32,
}

/// Whose turn it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Turn {
    /// The program's, with an image that belongs to no action.
    First,
    /// The agent's: an image was shown, and the action behind it was not taken yet.
    Decide,
    /// The program's, with what the action came to.
    Show,
}

/// Why a session refuses what it is asked for.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum SessionError {
    /// What it was given is wrong. Nothing has happened.
    #[error("{0}")]
    Wrong(String),
    /// This is not the moment for it. Nothing has happened.
    #[error("{0}")]
    Turn(&'static str),
    /// All actions are done, or it was closed.
    #[error("the run is over: {0} actions are done")]
    Over(u64),
    /// The run has failed.
    #[error("{0}")]
    Failed(String),
}

/// What an action came to, beside the image that it ended with.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Step {
    /// The true pose, where it is known.
    pub pose: Option<Pose>,
    /// Whether something stopped the robot.
    pub blocked: bool,
    /// Rewards of tasks by name; without a name, of all tasks whose rewards come from outside.
    pub rewards: Vec<(Option<String>, f64)>,
    /// Whether an episode has ended.
    pub done: bool,
    /// Whether the image is the first of an episode, and not what an action came to.
    pub reset: bool,
}

impl Session {
    /// Begin a run: `scenario` is a file, or a text of TOML that was not in one; in the folder `out`, or a new one under `logs/`.
    ///
    /// # Errors
    /// A scenario with faults, or one that is not for another program; a folder that exists.
    pub fn begin(scenario: Result<&Path, &str>, sets: &[String], out: Option<&Path>) -> Result<Self, Ending> {
        let path = scenario.unwrap_or(Path::new(NO_FILE));
        let scenario = within_memory(path, sets, |sets| match scenario {
            Ok(path) => Scenario::load(path, sets),
            Err(text) => Scenario::parse(text, path, sets),
        })?;
        if scenario.robot.body != Body::Program {
            let text = format!("{}: robot.body must be \"program\" where a program drives the robot", path.display());
            return Err(Ending::Usage(text));
        }
        let scenario = Arc::new(scenario);
        let world = Arc::new(World::new(&scenario)?);
        let run = folder::create(out, &scenario)?;
        let (driver, source) = driven(scenario.clone(), None);
        let (stop, of_run) = (Arc::new(AtomicBool::new(false)), run.clone());
        let (stopped, of_scenario) = (stop.clone(), scenario.clone());
        let thread = spawn(move || {
            Drive::new(&of_scenario, &world, &of_run, &stopped, true).with_robot(robot(source, &stopped))
        })?;
        Ok(Session::of(scenario, run, Some(driver), stop, thread))
    }

    /// Go on with a run that was interrupted.
    ///
    /// # Errors
    /// A folder that is no run, or none that this program can go on with.
    pub fn resume(run: &Path) -> Result<Self, Ending> {
        let recording = Recording::open(run)?;
        resume::can_go_on(run, &recording)?;
        let scenario = Arc::new(recording.scenario(&[]).map_err(Ending::usage)?);
        if scenario.robot.body != Body::Program {
            let text = format!("{}: its robot is driven by no program: adagio resume goes on with it", run.display());
            return Err(Ending::Usage(text));
        }
        let stop = Arc::new(AtomicBool::new(false));
        let args = ResumeArgs { run: run.to_owned(), no_report: false, quiet: true, json: false };
        let (driver_out, driver_in) = sync_channel(1);
        let (stopped, of_scenario) = (stop.clone(), scenario.clone());
        let thread = spawn(move || {
            let open = |scenario: &Arc<Scenario>, _: &Arc<World>, last| {
                let (driver, source) = driven(scenario.clone(), last);
                // Whoever waits for it is this session.
                let _ = driver_out.send(driver);
                Ok(robot(source, &stopped))
            };
            resume::go_on(&args, &recording, of_scenario, &stopped, open)
        })?;
        let driver = driver_in.recv().ok();
        let run = run.to_owned();
        let mut session = Session::of(scenario, run, driver, stop, thread);
        match session.driver {
            Some(_) => Ok(session),
            None => Err(session.why_over().into()),
        }
    }

    fn of(
        scenario: Arc<Scenario>,
        run: PathBuf,
        driver: Option<Driver>,
        stop: Arc<AtomicBool>,
        thread: JoinHandle<Result<Report, String>>,
    ) -> Self {
        let (thread, outcome, turn, process) = (Some(thread), None, Turn::First, std::process::id());
        Session { scenario, run, driver, stop, thread, outcome, turn, marks: Vec::new(), goto: None, process }
    }

    /// What is run.
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// The folder of the run.
    pub fn run(&self) -> &Path {
        &self.run
    }

    /// Show an image that was taken during an action.
    ///
    /// # Errors
    /// No action was taken, see [`show`](Session::show) for the others.
    pub fn observe(&mut self, image: Image, pose: Option<Pose>) -> Result<(), SessionError> {
        self.is_open()?;
        if self.turn != Turn::Show {
            let text = "no action is under way that this image could have been taken during: the first image of a run, and of an \
                episode, is shown with act";
            return Err(SessionError::Turn(text));
        }
        self.hand_over(image, pose, false, Ends::Nothing)
    }

    /// Show the image behind an action, and what that came to; the first image, and the first of an episode, belong to no action.
    /// Unless the episode has ended, the [next action](Session::action) is decided on from here.
    ///
    /// # Errors
    /// The run is over, with the reason; an image that is too small; a reward of a task that does not exist, or that has no rewards
    /// from outside; the action behind the last image was not taken yet.
    pub fn show(&mut self, image: Image, step: &Step) -> Result<(), SessionError> {
        if self.owes_action() {
            return Err(SessionError::Turn("the action behind the last image was not taken yet"));
        }
        let mut rewards = vec![f64::NAN; self.scenario.tasks.len()];
        for (name, reward) in &step.rewards {
            let takes = |number: &usize| self.scenario.tasks[*number].topic.is_some();
            let named = |number: &usize| name.as_ref().is_none_or(|name| self.scenario.tasks[*number].name == *name);
            let of: Vec<usize> = (0..rewards.len()).filter(takes).filter(named).collect();
            if of.is_empty() {
                let names = (0..rewards.len()).filter(takes).map(|number| self.scenario.tasks[number].name.as_str());
                let names: Vec<&str> = names.collect();
                let whose = name.as_ref().map_or(String::new(), |name| format!(" {name:?}"));
                return Err(SessionError::Wrong(format!(
                    "there is no task{whose} with reward = \"topic\", whose rewards come from outside: there are {names:?}"
                )));
            }
            of.into_iter().for_each(|number| rewards[number] = *reward);
        }
        let rewards = if rewards.iter().all(|reward| reward.is_nan()) { Vec::new() } else { rewards };
        let ends = Ends::Action { blocked: step.blocked, rewards, episode: step.done };
        self.hand_over(image, step.pose, step.reset, ends)?;
        self.turn = if step.done { Turn::First } else { Turn::Decide };
        Ok(())
    }

    /// Whether an image was shown, and the action behind it was not taken yet.
    pub fn owes_action(&self) -> bool {
        self.turn == Turn::Decide
    }

    /// The action that is to follow what was shown last; none yet where it is not decided on within a time.
    ///
    /// # Errors
    /// The run is over, with the reason.
    pub fn action(&mut self, within: Duration) -> Result<Option<Action>, SessionError> {
        let action = match &self.driver {
            Some(driver) if self.is_here() => driver.action(within),
            _ => Err(Over),
        };
        if let Ok(Some(_)) = action {
            self.turn = Turn::Show;
        }
        action.map_err(|Over| self.why_over())
    }

    /// Mark the next image as the goal of a task that is shown, by its name; with `forget` and a space before it: nothing that was
    /// marked counts any more.
    ///
    /// # Errors
    /// There is no such task, or it is not shown; the run is over.
    pub fn mark(&mut self, text: &str) -> Result<(), SessionError> {
        self.is_open()?;
        self.marks.push(parse_mark(text, &self.scenario).map_err(SessionError::Wrong)?);
        Ok(())
    }

    /// Send the robot to the goal of a task, from the next image on; to nothing: wherever the schedule has it go.
    ///
    /// # Errors
    /// There is no such task; the run is over.
    pub fn goto(&mut self, task: &str) -> Result<(), SessionError> {
        self.is_open()?;
        self.goto = Some(parse_goto(task, &self.scenario).map_err(SessionError::Wrong)?);
        Ok(())
    }

    /// End the run, if it is not over: the log is closed and the report written. What came of it, as `report.json` has it.
    ///
    /// # Errors
    /// The run has failed, with the reason.
    pub fn close(&mut self) -> Result<&Report, String> {
        if !self.is_here() {
            return Err(FORKED.to_owned());
        }
        self.stop.store(true, Ordering::Relaxed);
        self.driver = None;
        if let Some(thread) = self.thread.take() {
            self.outcome = Some(thread.join().unwrap_or_else(|_| Err("the run has panicked".to_owned())));
        }
        match &self.outcome {
            Some(outcome) => outcome.as_ref().map_err(Clone::clone),
            None => Err("the run was never begun".to_owned()),
        }
    }

    fn hand_over(&mut self, image: Image, truth: Option<Pose>, begins: bool, ends: Ends) -> Result<(), SessionError> {
        check_size(&image, &self.scenario.vision).map_err(SessionError::Wrong)?;
        let goto = match ends {
            Ends::Nothing => None,
            Ends::Action { .. } => self.goto.take(),
        };
        let shown = Shown { image, truth, begins, ends, marks: std::mem::take(&mut self.marks), goto };
        let handed = match &self.driver {
            Some(driver) if self.is_here() => driver.show(shown),
            _ => Err(Over),
        };
        handed.map_err(|Over| self.why_over())
    }

    fn is_open(&mut self) -> Result<(), SessionError> {
        match self.driver.is_some() && self.is_here() {
            true => Ok(()),
            false => Err(self.why_over()),
        }
    }

    /// Why the run takes no more frames.
    fn why_over(&mut self) -> SessionError {
        match self.close() {
            Ok(report) => SessionError::Over(report.run.actions),
            Err(reason) => SessionError::Failed(reason),
        }
    }

    fn is_here(&self) -> bool {
        self.process == std::process::id()
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        if self.is_here() {
            // Whoever wants to know what came of it closes it.
            let _ = self.close();
        } else {
            // There is nobody to wait for, and locks may be held for ever.
            std::mem::forget((self.driver.take(), self.thread.take()));
        }
    }
}

fn spawn(
    run: impl FnOnce() -> Result<Report, String> + Send + 'static,
) -> Result<JoinHandle<Result<Report, String>>, Ending> {
    Ok(std::thread::Builder::new().name("run".into()).spawn(run)?)
}

fn robot(source: crate::source::program::Driven, stop: &Arc<AtomicBool>) -> Robot {
    let switches = Switches { stop: stop.clone(), ..Switches::default() };
    Robot { source: Box::new(source), switches, voice: None, is_real: true }
}
