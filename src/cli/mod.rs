//! The command line: one file per command.
//!
//! Results go to stdout, diagnostics and progress to stderr. Commands say how they ended; only `main` knows exit codes.

mod check;
mod compare;
mod doctor;
mod drive;
mod evaluate;
pub mod experiment;
pub mod export;
mod fleet;
mod folder;
mod forecast;
mod import;
mod info;
pub mod learn;
pub mod program;
mod progress;
mod recover;
mod replay;
mod report;
mod resume;
mod robot;
mod ros_args;
mod run;
mod soak;
mod steps;
mod watch;
mod workers;

use std::io::{ErrorKind, Write};
use std::net::SocketAddr;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::experiment::{Seeds, worlds};
use crate::learn::Job;
use crate::live::serve::parse_address;

/// How a command ended, if not as it should.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// It failed, for this reason.
    Failed(String),
    /// It was called wrongly, or its scenario is not valid.
    Usage(String),
    /// It finished, but data is damaged or missing.
    DataLoss(String),
}

impl Ending {
    fn into_text(self) -> String {
        match self {
            Ending::Failed(text) | Ending::Usage(text) | Ending::DataLoss(text) => text,
        }
    }

    fn usage(error: impl std::fmt::Display) -> Self {
        Ending::Usage(error.to_string())
    }
}

/// Whatever goes wrong is a failure, unless it is said to be more.
impl<E: std::fmt::Display> From<E> for Ending {
    fn from(error: E) -> Self {
        Ending::Failed(error.to_string())
    }
}

/// An agent that learns to navigate from a camera while it drives.
#[derive(Debug, Parser)]
#[command(name = "adagio", version, about, long_about = LONG_ABOUT, after_help = AFTER_HELP)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

const LONG_ABOUT: &str = "An agent that learns to navigate from a camera while it drives.

A stream of frames grows a dictionary of support vectors; running sums over it are solved into slow features now and then; \
a window of transitions over these features is solved into a policy; the robot acts on it; and everything is kept in one \
MCAP log.";

const AFTER_HELP: &str = "Start with: adagio run scenarios/smoke.toml
Exit codes: 0 done, 1 failed, 2 wrong usage or an invalid scenario, 3 finished with data loss, 130 on a second Ctrl-C.";

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Explore, learn, act and log in one continuous run.
    Run(RunArgs),
    /// Check a scenario, say what memory and log it needs and print it with every default filled in; or check a run's log for
    /// damage.
    Check(CheckArgs),
    /// Say what a run folder or log holds.
    Info(InfoArgs),
    /// Try a run's policies from random starts.
    Evaluate(EvaluateArgs),
    /// Learn from a run's recorded frames again, with the same or other settings; or verify that they give the same; or learn
    /// from the log of another program.
    Replay(ReplayArgs),
    /// Learn one model from many logs, on several processes or machines: the same bits on any number of them.
    Learn(LearnArgs),
    /// Learn from several robots while they drive: each is an `adagio run --fleet`, and all of them act on what all have seen.
    Fleet(FleetArgs),
    /// For `learn` on an engine of your own: what a log has that a dictionary lacks.
    Members(PartArgs),
    /// For `learn` on an engine of your own: a log's sums over a dictionary, and its transitions.
    Moments(PartArgs),
    /// For `learn` on an engine of your own: candidates of all logs as one dictionary, or sums of all logs as a model.
    Merge(MergeArgs),
    /// Go on with a run that was interrupted: nothing that it had recorded is lost.
    Resume(ResumeArgs),
    /// Copy what can be read of a damaged log into a new, clean file, and say what is lost.
    Recover(RecoverArgs),
    /// Say in what two runs differ.
    Compare(CompareArgs),
    /// Make a page with drawings of a run or log: did it learn, how well, and where does it fail?
    Report(ReportArgs),
    /// Write a run's observations, features, transitions and values as arrays for Python, and its images as PNG.
    Export(ExportArgs),
    /// Repeat an experiment of the thesis, with its own figures beside ours; without a name, list them.
    Experiment(ExperimentArgs),
    /// Drive for many simulated hours, watched, and judge the run: memory, losses, latencies, success over time.
    Soak(SoakArgs),
    /// Show a run in the terminal while it goes on: camera, map with value and policy, curves, features, health.
    Watch(WatchArgs),
    /// Look for a robot before a run: what its network has, what the scenario misses, the camera's first picture.
    Doctor(DoctorArgs),
}

/// Arguments of `adagio run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// Scenario file.
    pub scenario: PathBuf,
    /// Seed of all random streams (the same as --set seed=N).
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Actions after which the run ends (the same as --set actions=N).
    #[arg(long, value_name = "N")]
    pub actions: Option<u64>,
    /// Folder for the run, which must not exist yet [default: a new one under logs/].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Change a key of the scenario, such as dictionary.nu=0.02 or task.0.radius=0.3; repeatable.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// No report.html and drawings at the end: `adagio report RUN` can make them later.
    #[arg(long)]
    pub no_report: bool,
    /// Serve a local web page of the run while it goes on: camera, map with value and policy, features, curves, health; with
    /// buttons to pause, to move a goal and to stop. Its address is printed on stderr [default: 127.0.0.1 and a free port]. An
    /// address that other machines can reach gets a token.
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:0", value_parser = parse_address)]
    pub serve: Option<SocketAddr>,
    /// The token that the page of --serve asks for, 16 to 128 letters [default: a random one, on loopback none].
    #[arg(long, env = "ADAGIO_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Learn with others: frames go to the learner at this address (`adagio fleet`), and models come from there.
    #[arg(long, value_name = "ADDR", value_parser = parse_address, requires = "fleet_token")]
    pub fleet: Option<SocketAddr>,
    /// The token of that learner.
    #[arg(long, value_name = "TOKEN", env = "ADAGIO_FLEET_TOKEN", hide_env_values = true)]
    pub fleet_token: Option<String>,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Print report.json instead of a table.
    #[arg(long)]
    pub json: bool,
    /// Last of all: what launch files of ROS 2 say, -r FROM:=TO for names (also __ns and __node) and -p KEY:=VALUE for keys.
    #[arg(long, value_name = "ARGS", num_args = 0.., allow_hyphen_values = true)]
    pub ros_args: Vec<String>,
}

/// Arguments of `adagio learn`.
#[derive(Debug, Args)]
pub struct LearnArgs {
    /// Run folders or .mcap files of our own: of one camera and one set of actions, in one place.
    #[arg(required = true, value_name = "LOG")]
    pub logs: Vec<PathBuf>,
    /// Scenario file [default: that of the first log].
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change a key of the scenario; repeatable.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Folder for the result: a new one, or one in which the same was begun [default: a new one under logs/].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Processes that each work on one log at a time.
    #[arg(long, value_name = "N", default_value = "1", conflicts_with = "hosts")]
    pub workers: std::num::NonZero<u16>,
    /// Machines that work in place of this one, a name in each line, reached by ssh; a name may stand there several times. They must have
    /// this program, the logs and the folder of the result under the same names.
    #[arg(long, value_name = "FILE")]
    pub hosts: Option<PathBuf>,
    /// Do not try policies in the scenario's simulated world.
    #[arg(long)]
    pub no_evaluate: bool,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Print report.json instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio fleet`.
#[derive(Debug, Args)]
pub struct FleetArgs {
    /// Scenario file. Robots have the same camera, actions, tasks and settings of learning.
    pub scenario: PathBuf,
    /// Change a key of the scenario; repeatable.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Robots that are waited for before the first model is made; more may join at any time.
    #[arg(long, value_name = "N", default_value = "1")]
    pub robots: std::num::NonZero<u16>,
    /// Where robots find it; other machines only reach an address that is not loopback.
    #[arg(long, value_name = "ADDR", default_value = "127.0.0.1:0", value_parser = parse_address)]
    pub listen: SocketAddr,
    /// The token that robots must know, 16 to 128 letters [default: a random one, which is printed].
    #[arg(long, env = "ADAGIO_FLEET_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Folder for the result: a new one, or that of a learner that was interrupted [default: a new one under logs/].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Do not try policies in the scenario's simulated world.
    #[arg(long)]
    pub no_evaluate: bool,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Print report.json instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio members` and `adagio moments`.
#[derive(Debug, Args)]
pub struct PartArgs {
    /// Run folder or .mcap file.
    pub log: PathBuf,
    /// Its frames from A on, counted from 0, and before B [default: all].
    #[arg(long, value_name = "A..B", value_parser = frames)]
    pub frames: Option<Range<u64>>,
    /// Scenario file: the same for all logs.
    #[arg(long, value_name = "FILE")]
    pub scenario: PathBuf,
    /// The dictionary so far [default: none, where the scenario has dictionary.sigma].
    #[arg(long, value_name = "FILE")]
    pub dictionary: Option<PathBuf>,
    /// The part. One that is there, of the same log, scenario and dictionary, is not made again.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

fn frames(text: &str) -> Result<Range<u64>, String> {
    let (from, to) = text.split_once("..").ok_or("it must be A..B")?;
    let number = |text: &str| text.parse::<u64>().map_err(|cause| format!("{text:?}: {cause}"));
    let frames = number(from)?..number(to)?;
    if frames.is_empty() { Err("A must be below B".into()) } else { Ok(frames) }
}

/// Arguments of `adagio merge`.
#[derive(Debug, Args)]
pub struct MergeArgs {
    /// What `adagio members` or `adagio moments` has made, of all frames of each log.
    #[arg(required = true, value_name = "PART")]
    pub parts: Vec<PathBuf>,
    /// Scenario file: the same for all logs.
    #[arg(long, value_name = "FILE")]
    pub scenario: PathBuf,
    /// The dictionary that the parts were made with [default: none, where the scenario has dictionary.sigma].
    #[arg(long, value_name = "FILE")]
    pub dictionary: Option<PathBuf>,
    /// The dictionary of candidates, a file; or the model of sums, a new folder.
    #[arg(long, value_name = "FILE|DIR")]
    pub out: PathBuf,
    /// Do not try policies in the scenario's simulated world.
    #[arg(long)]
    pub no_evaluate: bool,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio soak`.
#[derive(Debug, Args)]
pub struct SoakArgs {
    /// Scenario file.
    pub scenario: PathBuf,
    /// Hours of driving, as the robot's clock tells them; a simulation is as fast as it can. A quarter of them should fill the
    /// dictionary and the window of transitions, or memory still grows after it.
    #[arg(long, value_name = "H")]
    pub hours: f64,
    /// Seed of all random streams (the same as --set seed=N).
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Folder for the run, which must not exist yet [default: a new one under logs/].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Change a key of the scenario; repeatable.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Print soak.json instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio watch`.
#[derive(Debug, Args)]
pub struct WatchArgs {
    /// Run folder or .mcap file, of a run that goes on or of one that is over.
    pub run: PathBuf,
    /// Print one picture as plain text and leave.
    #[arg(long)]
    pub once: bool,
}

/// What a robot is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Network {
    /// A ROS 2 network.
    Ros2,
}

/// Arguments of `adagio doctor`.
#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// What the robot is on.
    pub network: Network,
    /// Scenario file with robot.body = "ros2" [default: the names that robots usually have].
    pub scenario: Option<PathBuf>,
    /// Change a key of the scenario; repeatable.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// How long to listen, seconds.
    #[arg(long, default_value_t = 5.0)]
    pub seconds: f64,
    /// Keep the camera's first picture as a PNG file.
    #[arg(long, value_name = "FILE")]
    pub picture: Option<PathBuf>,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// Scenario file, run folder or .mcap file.
    pub target: PathBuf,
    /// Change a key of the scenario; repeatable.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio info`.
#[derive(Debug, Args)]
pub struct InfoArgs {
    /// Run folder or .mcap file.
    pub run: PathBuf,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio evaluate`.
#[derive(Debug, Args)]
pub struct EvaluateArgs {
    /// Run folder or .mcap file.
    pub run: PathBuf,
    /// Random starts per task [default: as in the scenario].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub starts: Option<u64>,
    /// Seed of the starts and of all noise [default: as in the scenario].
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Run folder or .mcap file.
    pub run: PathBuf,
    /// Learn from the log of another program, a ROS 2 bag, with this scenario: it says which topic is what (section `[topics]`), where
    /// walls and goals are, and what an action is.
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change a key of the scenario, such as slow.features=100 or task.0.goal=[1.0, 0.5]; repeatable. Keys of vision cannot be
    /// changed where the log is one of our own: it holds what vision made of the camera's images.
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Compare with the recording message by message and name the first difference; nothing is written.
    #[arg(long, conflicts_with_all = ["out", "scenario", "no_evaluate"])]
    pub verify: bool,
    /// Do not try out what was learned in the scenario's simulated world, nor draw it there: for a log of a real room that the
    /// scenario's walls do not look like.
    #[arg(long)]
    pub no_evaluate: bool,
    /// Folder for the new run, which must not exist yet [default: a new one under logs/].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// No report.html and drawings at the end: `adagio report RUN` can make them later.
    #[arg(long)]
    pub no_report: bool,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio resume`.
#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// Run folder.
    pub run: PathBuf,
    /// No report.html and drawings at the end: `adagio report RUN` can make them later.
    #[arg(long)]
    pub no_report: bool,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Print report.json instead of a table.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio recover`.
#[derive(Debug, Args)]
pub struct RecoverArgs {
    /// Log file, of this or any other program.
    pub file: PathBuf,
    /// The new file, which must not exist yet [default: FILE with .recovered.mcap for .mcap].
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio compare`.
#[derive(Debug, Args)]
pub struct CompareArgs {
    /// Run folder or .mcap file.
    pub a: PathBuf,
    /// Another one.
    pub b: PathBuf,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio report`.
#[derive(Debug, Args)]
#[command(long_about = REPORT_ABOUT)]
pub struct ReportArgs {
    /// Run folder or .mcap file, also of another program.
    pub run: PathBuf,
    /// Folder for the report, which must not exist yet [default: the run folder; RUN/report-2, -3, … where it has a report;
    /// NAME-report beside a file NAME.mcap].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Machine-readable result.
    #[arg(long)]
    pub json: bool,
}

const REPORT_ABOUT: &str = "Make a page with drawings of a run or log: did it learn, how well, and where does it fail?

Writes report.html, one file that loads nothing and can be read on a phone, and its drawings as report/NAME.svg and report/NAME.png. \
All of it comes from the log and the checkpoint that is beside or inside it: what was learned is looked at from everywhere, and tried out \
again from the same starts as at the end of the run. Where the log lacks something, the page says what and why; of a damaged log it \
shows what can be read, and the exit code is 3.

`adagio run`, `resume` and `replay` write the same report at their end; only they replace a report, and only that of their own run. \
Nothing else is ever overwritten: a second `adagio report RUN` writes into RUN/report-2.";

/// Arguments of `adagio export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Run folder or .mcap file.
    pub run: PathBuf,
    /// Folder for the files, which must not exist yet.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Kind of files.
    #[arg(long, value_enum, default_value_t)]
    pub format: ExportFormat,
    /// Write every observation as a PNG file, too: images/NNNNNNNN.png, by the number of its frame.
    #[arg(long)]
    pub images: bool,
    /// The model whose features and values are written: a checkpoint.safetensors, or a run, whose newest it is [default: the
    /// run's own newest].
    #[arg(long, value_name = "PATH")]
    pub model: Option<PathBuf>,
    /// Print about.json instead of a list.
    #[arg(long)]
    pub json: bool,
}

/// Arguments of `adagio experiment`.
#[derive(Debug, Clone, Args)]
pub struct ExperimentArgs {
    /// Which one, or all [default: list them].
    pub name: Option<String>,
    /// A coarse version, in minutes.
    #[arg(long)]
    pub quick: bool,
    /// Only see that everything runs, in seconds: the numbers mean nothing.
    #[arg(long, conflicts_with = "quick")]
    pub smoke: bool,
    /// Support vectors in place of the size's own number; the most of them, where an experiment has several.
    #[arg(long, value_name = "N", value_parser = experiment::vectors)]
    pub vectors: Option<usize>,
    /// Seeds from A to B, both included: bands over them; or one seed. Several, with commas: 11..13,20.
    #[arg(long, value_name = "A..B", default_value = "11")]
    pub seeds: Seeds,
    /// Of the experiment worlds: one world alone, the name of its scenario.
    #[arg(long, value_name = "NAME", value_parser = clap::builder::PossibleValuesParser::new(worlds::names()))]
    pub world: Option<String>,
    /// Of digits and receptive-fields: folder of packages that ship data; may be given again [default: that of python3, and node_modules].
    #[arg(long, value_name = "DIR")]
    pub data: Vec<PathBuf>,
    /// Folder for tables and plots, which must not exist yet [default: a new one under experiments/NAME/].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Folder where finished settings are kept and looked for [default: experiments/NAME/cache].
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// Threads for matrix products; results do not depend on them [default: all cores].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    pub threads: Option<u16>,
    /// No progress on stderr.
    #[arg(long)]
    pub quiet: bool,
    /// Print result.json instead of tables.
    #[arg(long)]
    pub json: bool,
}

/// Kinds of files that runs are exported to.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// NumPy's archives of arrays: numpy.load opens them.
    #[default]
    Npz,
}

/// What a command finishes when it is interrupted, if there is anything.
pub fn finishes(command: &Command) -> Option<&'static str> {
    match command {
        Command::Run(_) | Command::Replay(_) | Command::Resume(_) | Command::Soak(_) => {
            Some("the log is closed and the report written")
        }
        Command::Experiment(_) | Command::Fleet(_) | Command::Learn(_) => Some("what is done is kept"),
        Command::Watch(args) if !args.once => Some("the terminal is given back"),
        _ => None,
    }
}

/// Do what the command line says; `stop` ends a run cleanly when it is set.
///
/// # Errors
/// How it ended, if not as it should.
pub fn dispatch(cli: Cli, stop: &Arc<AtomicBool>) -> Result<(), Ending> {
    match cli.command {
        Command::Run(args) => run::run(&args, stop),
        Command::Check(args) => check::check(&args),
        Command::Info(args) => info::info(&args),
        Command::Evaluate(args) => evaluate::evaluate(&args),
        Command::Replay(args) => replay::replay(&args, stop),
        Command::Learn(args) => learn::learn(&args, stop),
        Command::Fleet(args) => fleet::fleet(&args, stop),
        Command::Members(args) => learn::part(&args, &Job::Members),
        Command::Moments(args) => learn::part(&args, &Job::Moments),
        Command::Merge(args) => learn::merge_parts(&args),
        Command::Resume(args) => resume::resume(&args, stop),
        Command::Recover(args) => recover::recover(&args),
        Command::Compare(args) => compare::compare(&args),
        Command::Report(args) => report::report(&args),
        Command::Export(args) => export::export(&args),
        Command::Experiment(args) => experiment::experiment(&args, stop),
        Command::Soak(args) => soak::soak(&args, stop),
        Command::Watch(args) => watch::watch(&args, stop),
        Command::Doctor(args) => doctor::doctor(&args),
    }
}

/// A result on stdout. A reader that has seen enough (`| head`) is no failure.
fn print(text: &str) -> Result<(), Ending> {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(format!("cannot write to stdout: {error}").into()),
        _ => Ok(()),
    }
}

/// A value as readable JSON on stdout.
fn print_json(value: &impl serde::Serialize) -> Result<(), Ending> {
    print(&(serde_json::to_string_pretty(value)? + "\n"))
}
