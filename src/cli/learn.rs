//! `adagio learn LOG…`, and the work on single logs that it shares out: `adagio members`, `adagio moments`, `adagio merge`.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use faer::Par;
use serde::Serialize;

use super::drive::write;
use super::run::{load, within_memory};
use super::workers::{INTERRUPTED, read_hosts, work_off};
use super::{Ending, LearnArgs, MergeArgs, PartArgs, folder, print, print_json};
use crate::agent::steps::parallelism;
use crate::agent::{CHECKPOINT_NAME, checkpoint_bytes, peak_resident_bytes, write_checkpoint};
use crate::evaluate::{Evaluator, PoseDecode, TaskResult, decode_pose};
use crate::learn::{
    Candidates, Dictionary, Job, LeftOut, Log, ManyError, Piece, Recordings, Setting, Sums, Work, first_dictionary,
    merge, model, union,
};
use crate::lock::lock;
use crate::policy::Learned;
use crate::random::fix_parallelism;
use crate::replay::Recording;
use crate::report::{self, Numbered, Program, RunInfo, tasks_table};
use crate::scenario::{Plan, Scenario};
use crate::world::World;

/// How often logs are asked for what the dictionary lacks.
const ROUNDS: usize = 6;
/// Where parts are, in the folder of the result.
const PARTS: &str = "parts";
/// The complete scenario, in the folder of a result.
pub const SCENARIO: &str = "scenario.toml";
const REPORT: &str = "report.json";

/// `report.json` of what was learned from many logs or robots: keys as in that of a run, and `learned_from`.
#[derive(Serialize)]
pub struct Report<F = LearnedFrom> {
    adagio: Program,
    scenario: RunInfo,
    pub(super) learned_from: F,
    dictionary: report::Dictionary,
    model: report::Model,
    tasks: Vec<TaskResult>,
    pose_decode: Option<PoseDecode>,
    memory: report::Memory,
    digest: String,
}

/// Logs that a model is of.
#[derive(Default, Serialize)]
pub struct LearnedFrom {
    logs: Vec<PathBuf>,
    left_out: Vec<String>,
    frames: u64,
    transitions: usize,
    /// How often logs were asked for what the dictionary lacks.
    rounds: usize,
    /// Whether the last round found nothing more.
    settled: bool,
    /// The largest share of a frame that the dictionary lacks, 0 to 1.
    largest_residual: f64,
    seconds: f64,
}

/// What is to be learned from.
pub struct Order<'a> {
    /// Run folders or log files.
    pub logs: &'a [PathBuf],
    /// Scenario file; without, that of the first log.
    pub scenario: Option<&'a Path>,
    /// Keys that are changed, `KEY=VALUE`.
    pub set: &'a [String],
    /// Folder of the result; without, a new one.
    pub out: Option<&'a Path>,
    /// Whether policies are tried in the scenario's simulated world.
    pub evaluate: bool,
    /// No progress on stderr.
    pub quiet: bool,
    /// Set from outside to end it between two stages.
    pub stop: &'a AtomicBool,
}

/// Has work done, wherever, in any order; and calls the function after each. Why it was not.
pub type Engine<'a> = dyn Fn(&[Work], &(dyn Fn() + Sync)) -> Result<(), String> + 'a;

/// One model from many logs.
pub fn learn(args: &LearnArgs, stop: &AtomicBool) -> Result<(), Ending> {
    let workers = match &args.hosts {
        Some(file) => read_hosts(file)?,
        None => vec![None; args.workers.get().into()],
    };
    let order = Order {
        logs: &args.logs,
        scenario: args.scenario.as_deref(),
        set: &args.set,
        out: args.out.as_deref(),
        evaluate: !args.no_evaluate,
        quiet: args.quiet,
        stop,
    };
    let (said, out) = learn_with(&order, &|work, done| work_off(&workers, work, done, stop))?;
    match args.json {
        true => print_json(&said)?,
        false => print(&format!("{}kept in {}\n", text(&said), out.display()))?,
    }
    match said.learned_from.left_out.len() {
        0 => Ok(()),
        left => Err(Ending::DataLoss(format!("{left} of {} logs were left out", args.logs.len()))),
    }
}

/// One model from many logs, by any engine: its report, and its folder.
///
/// # Errors
/// Logs that do not fit, an engine that gave up, sums that cannot be solved.
pub fn learn_with(order: &Order<'_>, engine: &Engine<'_>) -> Result<(Report, PathBuf), Ending> {
    let begin = Instant::now();
    fix_parallelism();
    let scenario = match order.scenario {
        Some(file) => load(file, order.set)?,
        None => {
            // A damaged one may say anything.
            let whole = |log: &&PathBuf| Recording::open(log).is_ok_and(|recording| recording.damage.is_empty());
            let log = order.logs.iter().find(whole).or(order.logs.first());
            let log = log.ok_or_else(|| Ending::Usage("there is no log to learn from".into()))?;
            let recording = Recording::open(log)?;
            let text = recording.metadata.get("scenario").map_or("", String::as_str);
            within_memory(log, order.set, |sets| Scenario::parse(text, log, sets))?
        }
    };
    let world = Arc::new(World::new(&scenario)?);
    // While dictionaries are united and policies fitted, workers have nothing to do.
    let setting = Setting { scenario: Arc::new(scenario), plan: world.plan.clone(), par: Par::rayon(0) };
    let progress = Progress::new(order.quiet, begin);
    let tell = |done: usize| {
        progress.tell("looked at", (done, 0), order.logs.len());
        !order.stop.load(Ordering::Relaxed)
    };
    let Recordings { logs, left_out } = Recordings::open(order.logs, &setting.scenario, &tell).map_err(ending)?;
    left_out.iter().for_each(|log| eprintln!("warning: {log}: it is left out"));
    let first = first_dictionary(&setting, &logs).map_err(ending)?;
    let out = begin_folder(order.out, &setting.scenario)?;
    let all = All {
        setting: &setting,
        logs: &logs,
        out: &std::path::absolute(&out)?,
        engine,
        progress: &progress,
        stop: order.stop,
    };
    let (dictionary, sums, rounds, settled) = all.passes(first).map_err(|error| go_on(error, &out))?;
    let from = LearnedFrom {
        logs: logs.iter().map(|log| log.path.clone()).collect(),
        left_out: left_out.iter().map(LeftOut::to_string).collect(),
        rounds,
        settled,
        ..LearnedFrom::default()
    };
    let said = finish(&setting, &world, (&dictionary, sums), &out, from, (order.evaluate, order.quiet, begin))?;
    Ok((said, out))
}

/// The passes over all logs.
struct All<'a> {
    setting: &'a Setting,
    logs: &'a [Log],
    /// Where parts go.
    out: &'a Path,
    engine: &'a Engine<'a>,
    progress: &'a Progress,
    stop: &'a AtomicBool,
}

impl All<'_> {
    /// From the rule of a dictionary to the sums over it; how often the logs were asked for what it lacks, and whether that was all.
    fn passes(&self, first: Dictionary) -> Result<(Dictionary, Sums, usize, bool), Ending> {
        let parts = self.out.join(PARTS);
        let logs: Vec<&str> = self.logs.iter().map(|log| log.digest.as_str()).collect();
        let (mut dictionary, mut rounds, mut more) = (first, 0, true);
        // A full one takes nothing more.
        while more && rounds < ROUNDS && !dictionary.is_full() {
            let path = parts.join(format!("dictionary-{rounds}.safetensors"));
            dictionary.write(&path, &self.setting.scenario).map_err(ending)?;
            rounds += 1;
            let candidates = self.parts(&Job::Members, &format!("members-{rounds}"), (&path, &dictionary))?;
            (dictionary, more) = union(self.setting, &dictionary, (&candidates, Some(&logs))).map_err(ending)?;
        }
        let path = parts.join("dictionary.safetensors");
        dictionary.write(&path, &self.setting.scenario).map_err(ending)?;
        let moments = self.parts(&Job::Moments, "moments", (&path, &dictionary))?;
        let sums = merge(self.setting, &dictionary, (&moments, Some(&logs))).map_err(ending)?;
        let settled = !more && !dictionary.is_full();
        Ok((dictionary, sums, rounds, settled))
    }

    /// The parts of all logs; those that are there already are not made again.
    fn parts(&self, job: &Job, name: &str, (path, of): (&Path, &Dictionary)) -> Result<Vec<PathBuf>, Ending> {
        let digest = of.digest();
        let pieces: Vec<Piece<'_>> = self.logs.iter().flat_map(Log::pieces).collect();
        let part = |Piece { log, frames }: &Piece<'_>| {
            let from = if frames.start == 0 { String::new() } else { format!("-{}", frames.start) };
            self.out.join(PARTS).join(format!("{}{from}.{name}.safetensors", &log.digest[..16]))
        };
        let parts: Vec<PathBuf> = pieces.iter().map(part).collect();
        let todo = pieces.iter().zip(&parts).filter(|(piece, part)| !job.is_done(self.setting, piece, &digest, part));
        let work = todo.map(|(Piece { log, frames }, part)| {
            let (log, frames, scenario) = (std::path::absolute(&log.path)?, frames.clone(), self.out.join(SCENARIO));
            Ok(Work { verb: job.verb(), log, frames, scenario, dictionary: path.to_owned(), out: part.clone() })
        });
        let work: Vec<Work> = work.collect::<std::io::Result<_>>()?;
        let already = parts.len() - work.len();
        let done = AtomicUsize::new(already);
        self.progress.tell(name, (already, already), parts.len());
        let tell = || self.progress.tell(name, (done.fetch_add(1, Ordering::Relaxed) + 1, already), parts.len());
        (self.engine)(&work, &tell)?;
        match self.stop.load(Ordering::Relaxed) {
            true => Err(INTERRUPTED.into()),
            false => Ok(parts),
        }
    }
}

/// Solve, fit, try it out, and keep it.
fn finish(
    setting: &Setting,
    world: &Arc<World>,
    (dictionary, sums): (&Dictionary, Sums),
    out: &Path,
    from: LearnedFrom,
    (evaluate, quiet, begin): (bool, bool, Instant),
) -> Result<Report, Ending> {
    let scenario = &setting.scenario;
    let (frames, largest_residual) = (sums.frames, sums.residual);
    let made = model(setting, dictionary, sums).map_err(ending)?;
    made.notes.iter().for_each(|note| eprintln!("warning: {note}"));
    let (transitions, seconds) = (made.transitions, begin.elapsed().as_secs_f64());
    let from = LearnedFrom { frames, largest_residual, transitions, seconds, ..from };
    conclude((scenario, world), (&made.learned, Some(dictionary.nu())), from, out, (evaluate, quiet))
}

/// Keep what was learned in a folder, try it, and report it.
pub fn conclude<F: Serialize>(
    (scenario, world): (&Arc<Scenario>, &Arc<World>),
    (learned, nu): (&Learned, Option<f64>),
    learned_from: F,
    out: &Path,
    (evaluate, quiet): (bool, bool),
) -> Result<Report<F>, Ending> {
    write_checkpoint(&out.join(CHECKPOINT_NAME), &checkpoint_bytes(learned, scenario)?)?;
    let (mut tasks, mut pose_decode) = (Vec::new(), None);
    if evaluate {
        if !quiet {
            eprintln!("evaluating {} starts per task, with and without reflexes", scenario.evaluate.starts);
        }
        let evaluator = Evaluator::new(scenario.clone(), world.clone(), scenario.evaluate.starts, scenario.seed);
        tasks = evaluator.evaluate(learned, true);
        pose_decode = decode_pose(scenario, world, learned, scenario.seed)
            .inspect_err(|error| eprintln!("warning: the pose cannot be decoded: {error}"))
            .ok();
    }
    let said = Report {
        adagio: Program::this(),
        scenario: RunInfo { name: scenario.name.clone(), seed: scenario.seed, sha256: scenario.sha256() },
        learned_from,
        dictionary: report::Dictionary {
            support_vectors: learned.model.members.ncols(),
            sigma: learned.model.kernel.sigma().unwrap_or(f64::NAN),
            nu,
        },
        model: report::Model {
            epoch: learned.epoch,
            features: learned.model.slowness.len(),
            slowness: learned.model.slowness.clone(),
            lambda: scenario.slow.lambda,
        },
        tasks,
        pose_decode,
        memory: report::Memory { peak_rss_bytes: peak_resident_bytes() },
        digest: learned.digest(),
    };
    write(out, REPORT, serde_json::to_string_pretty(&said)?.as_bytes())?;
    Ok(said)
}

impl<F> Report<F> {
    /// How features and policies came out.
    pub fn outcome(&self) -> String {
        format!(
            "{} features, slowness {:.3} to {:.3} /s²\n\n{}\ndigest {}\n",
            self.model.features,
            self.model.slowness.first().copied().unwrap_or(f64::NAN),
            self.model.slowness.last().copied().unwrap_or(f64::NAN),
            tasks_table(&self.tasks, self.pose_decode.as_ref()),
            self.digest
        )
    }
}

fn text(said: &Report) -> String {
    let from = &said.learned_from;
    let settled =
        if from.settled { "" } else { ", and there would be more (dictionary.budget is used up, or rounds are)" };
    format!(
        "{}: {} frames of {} logs in {:.0} s\n{} support vectors (sigma {:.0}, nu {}) in {} rounds{settled}; a frame lacks at most {:.4} of \
         itself\n{}",
        said.scenario.name,
        Numbered(from.frames),
        from.logs.len(),
        from.seconds,
        Numbered(said.dictionary.support_vectors as u64),
        said.dictionary.sigma,
        said.dictionary.nu.unwrap_or(f64::NAN),
        from.rounds,
        from.largest_residual,
        said.outcome()
    )
}

fn ending(error: ManyError) -> Ending {
    match error {
        ManyError::AllUnlike(_) | ManyError::Unlike(_) | ManyError::Together(_) => Ending::Usage(error.to_string()),
        _ => Ending::Failed(error.to_string()),
    }
}

fn go_on(error: Ending, out: &Path) -> Ending {
    let kept = format!("what is done is kept in {}: the same command with --out goes on from there", out.display());
    match error {
        Ending::Failed(text) => Ending::Failed(format!("{text}\n{kept}")),
        other => other,
    }
}

/// The folder of the result: a new one, or one in which the same was begun and is not done.
fn begin_folder(out: Option<&Path>, scenario: &Scenario) -> Result<PathBuf, Ending> {
    let begun = |out: &&Path| {
        out.join(PARTS).is_dir()
            && !out.join(REPORT).exists()
            && std::fs::read_to_string(out.join(SCENARIO)).is_ok_and(|text| text == scenario.text)
    };
    if let Some(out) = out.filter(begun) {
        return Ok(out.to_owned());
    }
    let out = folder::create(out, scenario)?;
    write(&out, SCENARIO, scenario.text.as_bytes())?;
    let parts = out.join(PARTS);
    std::fs::create_dir(&parts).map_err(|cause| format!("cannot create the folder {}: {cause}", parts.display()))?;
    Ok(out)
}

/// Says how far it is, about every second and at the end of each stage.
struct Progress {
    quiet: bool,
    begin: Instant,
    /// The stage, when it began, and when something was said last.
    last: Mutex<(String, Instant, Instant)>,
}

impl Progress {
    const EVERY: Duration = Duration::from_secs(1);

    fn new(quiet: bool, begin: Instant) -> Self {
        Progress { quiet, begin, last: Mutex::new((String::new(), begin, begin)) }
    }

    /// So many are done, some of them already when the stage began.
    fn tell(&self, stage: &str, (done, already): (usize, usize), of: usize) {
        let (mut last, now) = (lock(&self.last), Instant::now());
        if last.0 != stage {
            let begin = if last.0.is_empty() { self.begin } else { now };
            *last = (stage.to_owned(), begin, last.2);
        }
        if self.quiet || done < of && now - last.2 < Self::EVERY {
            return;
        }
        last.2 = now;
        let left = (now - last.1).as_secs_f64() * (of - done) as f64 / (done - already).max(1) as f64;
        let left = if done > already && left > 1.0 { format!(", about {left:.0} s left") } else { String::new() };
        eprintln!("{:.0} s, {stage}: {done} of {of}{left}", self.begin.elapsed().as_secs_f64());
    }
}

/// One part: candidates for support vectors, or sums.
pub fn part(args: &PartArgs, job: &Job) -> Result<(), Ending> {
    fix_parallelism();
    let setting = scenario(&args.scenario)?;
    let dictionary = dictionary(&setting, args.dictionary.as_deref())?;
    job.run(&setting, &args.log, args.frames.clone(), &dictionary, &args.out).map_err(ending)
}

/// A scenario that was checked where the work was shared out.
fn scenario(file: &Path) -> Result<Setting, Ending> {
    let scenario = Scenario::load(file, &[]).map_err(Ending::usage)?;
    let plan = Plan::new(&scenario).map_err(|fault| Ending::Usage(format!("{}: {fault:?}", file.display())))?;
    let par = parallelism(&scenario.agent);
    Ok(Setting { scenario: Arc::new(scenario), plan: Arc::new(plan), par })
}

/// What stands in a file, or the rule before there are any support vectors.
fn dictionary(setting: &Setting, file: Option<&Path>) -> Result<Dictionary, Ending> {
    match file {
        Some(file) => Dictionary::read(file, setting),
        None => first_dictionary(setting, &[]),
    }
    .map_err(ending)
}

/// The union of candidates, as a dictionary; or the model of all sums, in a folder like that of a run.
pub fn merge_parts(args: &MergeArgs) -> Result<(), Ending> {
    let begin = Instant::now();
    fix_parallelism();
    let setting = scenario(&args.scenario)?;
    let before = dictionary(&setting, args.dictionary.as_deref())?;
    if Candidates::read(&args.parts[0], &setting.scenario).is_ok() {
        if args.out.exists() {
            return Err(Ending::Usage(format!(
                "{} exists already, and nothing is ever overwritten",
                args.out.display()
            )));
        }
        let (after, more) = union(&setting, &before, (&args.parts, None)).map_err(ending)?;
        after.write(&args.out, &setting.scenario).map_err(ending)?;
        let support_vectors = after.members().ncols();
        let said = if more { "parts had more than the dictionary" } else { "no part had more than the dictionary" };
        return match args.json {
            true => print_json(&serde_json::json!({ "support_vectors": support_vectors, "more": more })),
            false => print(&format!("{support_vectors} support vectors: {said}\n")),
        };
    }
    let sums = merge(&setting, &before, (&args.parts, None)).map_err(ending)?;
    let world = Arc::new(World::new(&setting.scenario)?);
    let out = folder::create(Some(&args.out), &setting.scenario)?;
    write(&out, SCENARIO, setting.scenario.text.as_bytes())?;
    let from = LearnedFrom { logs: args.parts.clone(), settled: true, ..LearnedFrom::default() };
    let said = finish(&setting, &world, (&before, sums), &out, from, (!args.no_evaluate, args.quiet, begin))?;
    if args.json { print_json(&said) } else { print(&format!("{}kept in {}\n", text(&said), out.display())) }
}
