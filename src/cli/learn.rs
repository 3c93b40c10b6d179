//! `adagio learn LOG…`, and the work on single logs that it shares out: `adagio members`, `adagio moments`, `adagio merge`.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use serde::Serialize;

use super::drive::write;
use super::run::load;
use super::{Ending, LearnArgs, MergeArgs, PartArgs, folder, print, print_json};
use crate::agent::{CHECKPOINT_NAME, checkpoint_bytes, peak_resident_bytes, write_checkpoint};
use crate::evaluate::{Evaluator, PoseDecode, TaskResult, decode_pose};
use crate::learn::{
    Candidates, Dictionary, Job, LeftOut, Log, ManyError, Recordings, Sums, Task, first_dictionary, merge, model, union,
};
use crate::random::fix_parallelism;
use crate::replay::Recording;
use crate::report::{self, Numbered, Program, RunInfo, tasks_table};
use crate::scenario::Scenario;
use crate::world::World;

/// How often a part is tried.
const TRIES: usize = 3;
/// How often logs are asked for what the dictionary lacks.
const ROUNDS: usize = 6;
/// Where parts are, in the folder of the result.
const PARTS: &str = "parts";
const SCENARIO: &str = "scenario.toml";
const REPORT: &str = "report.json";

/// `report.json` of what was learned from many logs: keys as in that of a run, and `learned_from`.
#[derive(Serialize)]
struct Report {
    adagio: Program,
    scenario: RunInfo,
    learned_from: LearnedFrom,
    dictionary: report::Dictionary,
    model: report::Model,
    tasks: Vec<TaskResult>,
    pose_decode: Option<PoseDecode>,
    memory: report::Memory,
    digest: String,
}

#[derive(Serialize)]
struct LearnedFrom {
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
    workers: usize,
    seconds: f64,
}

/// One model from many logs.
pub fn learn(args: &LearnArgs, stop: &AtomicBool) -> Result<(), Ending> {
    let begin = Instant::now();
    fix_parallelism();
    let hosts = args.hosts.as_deref().map(read_hosts).transpose()?;
    let scenario = match &args.scenario {
        Some(file) => load(file, &args.set)?,
        None => Recording::open(&args.logs[0])?.scenario(&args.set).map_err(Ending::usage)?,
    };
    let world = Arc::new(World::new(&scenario)?);
    let task = Task { scenario: Arc::new(scenario), plan: world.plan.clone() };
    let tell = |what: &str, done: usize, of: usize| {
        if !args.quiet {
            eprintln!("{what}: {done} of {of} logs, {:.0} s", begin.elapsed().as_secs_f64());
        }
    };
    let looked = Recordings::open(&args.logs, &task.scenario, &|done| tell("looked at", done, args.logs.len()));
    let Recordings { logs, left_out } = looked.map_err(ending)?;
    left_out.iter().for_each(|log| eprintln!("warning: {log}: it is left out"));
    let first = first_dictionary(&task, &logs).map_err(ending)?;
    let out = begin_folder(args.out.as_deref(), &task.scenario)?;
    let pool = Pool {
        task: &task,
        logs: &logs,
        out: &out,
        workers: hosts.unwrap_or_else(|| vec![None; args.workers.get().into()]),
        stop,
        tell: &tell,
    };
    let made = (|| {
        let (mut dictionary, mut rounds, mut settled) = (first, 0, false);
        while !settled && rounds < ROUNDS {
            let path = out.join(PARTS).join(format!("dictionary-{rounds}.safetensors"));
            dictionary.write(&path, &task.scenario).map_err(ending)?;
            rounds += 1;
            let parts = pool.run(&Job::Members, rounds, &path, &dictionary)?;
            let (next, more) = union(&task, &dictionary, &parts).map_err(ending)?;
            (dictionary, settled) = (next, !more);
        }
        let path = out.join(PARTS).join("dictionary.safetensors");
        dictionary.write(&path, &task.scenario).map_err(ending)?;
        let parts = pool.run(&Job::Sums, 0, &path, &dictionary)?;
        let sums = merge(&task, &dictionary, &parts).map_err(ending)?;
        Ok::<_, Ending>((dictionary, sums, rounds, settled))
    })();
    let (dictionary, sums, rounds, settled) = made.map_err(|error| go_on(error, &out))?;
    let from = LearnedFrom {
        logs: logs.iter().map(|log| log.path.clone()).collect(),
        left_out: left_out.iter().map(LeftOut::to_string).collect(),
        frames: 0,
        transitions: 0,
        rounds,
        settled,
        largest_residual: sums.residual,
        workers: pool.workers.len(),
        seconds: 0.0,
    };
    let said = finish(&task, &world, (&dictionary, sums), &out, from, (args.no_evaluate, args.quiet, begin))?;
    match args.json {
        true => print_json(&said)?,
        false => print(&format!("{}kept in {}\n", text(&said), out.display()))?,
    }
    match left_out.is_empty() {
        true => Ok(()),
        false => Err(Ending::DataLoss(format!("{} of {} logs were left out", left_out.len(), args.logs.len()))),
    }
}

/// Solve, fit, try it out, and keep it.
fn finish(
    task: &Task,
    world: &Arc<World>,
    (dictionary, sums): (&Dictionary, Sums),
    out: &Path,
    from: LearnedFrom,
    (no_evaluate, quiet, begin): (bool, bool, Instant),
) -> Result<Report, Ending> {
    let scenario = &task.scenario;
    let frames = sums.frames();
    let made = model(task, dictionary, sums).map_err(ending)?;
    made.notes.iter().for_each(|note| eprintln!("warning: {note}"));
    let learned = made.learned;
    write_checkpoint(&out.join(CHECKPOINT_NAME), &checkpoint_bytes(&learned, scenario)?)?;
    let seconds = begin.elapsed().as_secs_f64();
    let (mut tasks, mut pose_decode) = (Vec::new(), None);
    if !no_evaluate {
        if !quiet {
            eprintln!("evaluating {} starts per task, with and without reflexes", scenario.evaluate.starts);
        }
        let evaluator = Evaluator::new(scenario.clone(), world.clone(), scenario.evaluate.starts, scenario.seed);
        tasks = evaluator.evaluate(&learned, true);
        pose_decode = decode_pose(scenario, world, &learned, scenario.seed)
            .inspect_err(|error| eprintln!("warning: the pose cannot be decoded: {error}"))
            .ok();
    }
    let said = Report {
        adagio: Program::this(),
        scenario: RunInfo { name: scenario.name.clone(), seed: scenario.seed, sha256: scenario.sha256() },
        learned_from: LearnedFrom { frames, transitions: made.transitions, seconds, ..from },
        dictionary: report::Dictionary {
            support_vectors: dictionary.members().ncols(),
            sigma: dictionary.sigma,
            nu: Some(dictionary.nu()),
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

fn text(said: &Report) -> String {
    let from = &said.learned_from;
    let settled = if from.settled { "" } else { ", and there would be more" };
    format!(
        "{}: {} frames of {} logs in {:.0} s\n{} support vectors (sigma {:.0}, nu {}) in {} rounds{settled}, {} features, slowness {:.3} to \
         {:.3} /s²\na frame lacks at most {:.4} of itself\n\n{}\ndigest {}\n",
        said.scenario.name,
        Numbered(from.frames),
        from.logs.len(),
        from.seconds,
        Numbered(said.dictionary.support_vectors as u64),
        said.dictionary.sigma,
        said.dictionary.nu.unwrap_or(f64::NAN),
        from.rounds,
        said.model.features,
        said.model.slowness.first().copied().unwrap_or(f64::NAN),
        said.model.slowness.last().copied().unwrap_or(f64::NAN),
        from.largest_residual,
        tasks_table(&said.tasks, said.pose_decode.as_ref()),
        said.digest
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
        !out.join(REPORT).exists()
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

/// A host in each line, for one worker.
fn read_hosts(file: &Path) -> Result<Vec<Option<String>>, Ending> {
    let text = std::fs::read_to_string(file)
        .map_err(|cause| Ending::Usage(format!("cannot read the hosts {}: {cause}", file.display())))?;
    let hosts: Vec<Option<String>> = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(|line| Some(line.to_owned()))
        .collect();
    match hosts.iter().flatten().find(|host| host.starts_with('-') || host.contains(char::is_whitespace)) {
        Some(host) => Err(Ending::Usage(format!("{}: {host:?} is no host: there is one in each line", file.display()))),
        None if hosts.is_empty() => Err(Ending::Usage(format!("{} names no host", file.display()))),
        None => Ok(hosts),
    }
}

/// Processes that each work on one log at a time.
struct Pool<'a> {
    task: &'a Task,
    logs: &'a [Log],
    out: &'a Path,
    /// One each: on this machine, or on a host.
    workers: Vec<Option<String>>,
    stop: &'a AtomicBool,
    tell: &'a (dyn Fn(&str, usize, usize) + Sync),
}

impl Pool<'_> {
    /// The parts of all logs; those that are there already are not made again.
    fn run(&self, job: &Job, round: usize, dictionary: &Path, of: &Dictionary) -> Result<Vec<PathBuf>, Ending> {
        let (verb, name) = match job {
            Job::Members => ("members", format!("members-{round}")),
            Job::Sums => ("moments", "moments".to_owned()),
        };
        let parts: Vec<PathBuf> = self
            .logs
            .iter()
            .map(|log| self.out.join(PARTS).join(format!("{}.{name}.safetensors", &log.digest[..16])))
            .collect();
        let todo = (0..parts.len()).filter(|&k| !job.is_done(self.task, &self.logs[k], of, &parts[k]));
        let todo: Mutex<VecDeque<(usize, usize)>> = Mutex::new(todo.map(|k| (k, 0)).collect());
        let left = lock(&todo).len();
        let (done, failed) = (Mutex::new(parts.len() - left), Mutex::new(None::<String>));
        std::thread::scope(|scope| {
            for host in &self.workers {
                scope.spawn(|| {
                    while !self.stop.load(Ordering::Relaxed) && lock(&failed).is_none() {
                        let Some((k, tries)) = lock(&todo).pop_front() else { break };
                        match self.work(verb, host.as_deref(), &self.logs[k], dictionary, &parts[k]) {
                            Ok(()) => {
                                let mut done = lock(&done);
                                *done += 1;
                                (self.tell)(verb, *done, parts.len());
                            }
                            Err(_) if self.stop.load(Ordering::Relaxed) => {}
                            Err(text) if tries + 1 < TRIES => {
                                eprintln!("warning: {}: {text}: once more", self.logs[k].path.display());
                                lock(&todo).push_back((k, tries + 1));
                            }
                            Err(text) => *lock(&failed) = Some(format!("{}: {text}", self.logs[k].path.display())),
                        }
                    }
                });
            }
        });
        if let Some(text) = lock(&failed).take() {
            return Err(Ending::Failed(text));
        }
        match self.stop.load(Ordering::Relaxed) {
            true => Err(Ending::Failed("it was interrupted".into())),
            false => Ok(parts),
        }
    }

    /// One part, by a process of its own.
    fn work(&self, verb: &str, host: Option<&str>, log: &Log, dictionary: &Path, part: &Path) -> Result<(), String> {
        let scenario = self.out.join(SCENARIO);
        let program = std::env::current_exe().map_err(|error| error.to_string())?;
        let of = |path: &Path| std::path::absolute(path).map_err(|error| error.to_string()).map(OsString::from);
        let words = [
            program.into_os_string(),
            verb.into(),
            of(&log.path)?,
            "--scenario".into(),
            of(&scenario)?,
            "--dictionary".into(),
            of(dictionary)?,
            "--out".into(),
            of(part)?,
        ];
        let mut command = match host {
            None => {
                let mut command = Command::new(&words[0]);
                command.args(&words[1..]);
                command
            }
            Some(host) => {
                let quoted = words.iter().map(|word| format!("'{}'", word.to_string_lossy().replace('\'', "'\\''")));
                let mut command = Command::new("ssh");
                command.args(["-o", "BatchMode=yes", host, &quoted.collect::<Vec<String>>().join(" ")]);
                command
            }
        };
        let output = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).output();
        let output = output.map_err(|error| format!("a worker cannot be started: {error}"))?;
        if output.status.success() {
            return Ok(());
        }
        let said = String::from_utf8_lossy(&output.stderr);
        let host = host.map_or(String::new(), |host| format!(" on {host}"));
        Err(format!("a worker{host} ended with {}: {}", output.status, said.trim()))
    }
}

fn lock<T>(of: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One part: candidates for support vectors, or sums.
pub fn part(args: &PartArgs, job: &Job) -> Result<(), Ending> {
    fix_parallelism();
    let (task, _) = task(&args.scenario)?;
    let dictionary = dictionary(&task, args.dictionary.as_deref())?;
    job.run(&task, &args.log, &dictionary, &args.out).map_err(ending)
}

fn task(file: &Path) -> Result<(Task, Arc<World>), Ending> {
    let scenario = Arc::new(load(file, &[])?);
    let world = Arc::new(World::new(&scenario)?);
    Ok((Task { scenario, plan: world.plan.clone() }, world))
}

/// What stands in a file, or the rule before there are any support vectors.
fn dictionary(task: &Task, file: Option<&Path>) -> Result<Dictionary, Ending> {
    match file {
        Some(file) => Dictionary::read(file, &task.scenario),
        None => first_dictionary(task, &[]),
    }
    .map_err(ending)
}

/// The union of candidates, as a dictionary; or the model of all sums, in a folder like that of a run.
pub fn merge_parts(args: &MergeArgs) -> Result<(), Ending> {
    let begin = Instant::now();
    fix_parallelism();
    let (task, world) = task(&args.scenario)?;
    let before = dictionary(&task, args.dictionary.as_deref())?;
    if Candidates::read(&args.parts[0], &task.scenario).is_ok() {
        let (after, more) = union(&task, &before, &args.parts).map_err(ending)?;
        after.write(&args.out, &task.scenario).map_err(ending)?;
        let support_vectors = after.members().ncols();
        let said = if more { "parts had more than the dictionary" } else { "no part had more than the dictionary" };
        return match args.json {
            true => print_json(&serde_json::json!({ "support_vectors": support_vectors, "more": more })),
            false => print(&format!("{support_vectors} support vectors: {said}\n")),
        };
    }
    let sums = merge(&task, &before, &args.parts).map_err(ending)?;
    let out = folder::create(Some(&args.out), &task.scenario)?;
    write(&out, SCENARIO, task.scenario.text.as_bytes())?;
    let from = LearnedFrom {
        logs: args.parts.clone(),
        left_out: Vec::new(),
        frames: 0,
        transitions: 0,
        rounds: 0,
        settled: true,
        largest_residual: sums.residual,
        workers: 0,
        seconds: 0.0,
    };
    let said = finish(&task, &world, (&before, sums), &out, from, (args.no_evaluate, args.quiet, begin))?;
    if args.json { print_json(&said) } else { print(&format!("{}kept in {}\n", text(&said), out.display())) }
}
