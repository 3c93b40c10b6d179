//! What one model of many logs costs on 2 to 2 000 machines: each step of `adagio learn` is measured on this machine, and its messages are
//! simulated with these figures. Beside it a check: the same for drives that are learned from here, by the program.
//!
//! `--link`, `--server`: MB/s of a worker's link, and of the machine that logs and parts lie on, its disk included, as assumed.
//! `--failures N`: failures in 1 000 hours of computing, for the rows that have some. `--check`: the check alone.

mod common;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::Instant;

use common::machine::{Rates, Spread};
use common::machines::{Costs, Logs, Machines, PER_ACTION, RATE, STAGES, WINDOW, learn};
use common::{argument, max_m, simulation};

use adagio::agent::peak_resident_bytes;
use adagio::learn::{
    Candidates, Dictionary, Log, Piece, Setting, Sums, candidates, first_dictionary, merge, model, sums, union,
};
use adagio::scenario::Plan;

/// Narrow enough that nearly every frame becomes a support vector.
const SIGMA: &str = "dictionary.sigma=700";
/// A measurement is repeated so often, unless so many seconds have passed; the median counts.
const RUNS: usize = 3;
const ENOUGH: f64 = 20.0;

fn main() {
    adagio::random::fix_parallelism();
    common::machine::header();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let bench = Bench { folder: folder.path().to_owned() };
    let small = bench.check();
    if std::env::args().any(|argument| argument == "--check") {
        return;
    }
    // Where sums are small, what a transition costs is more than their noise.
    let of_hour = bench.costs(200, SIGMA, (3600, 40));
    for m in [2000, 8000].into_iter().filter(|&m| m <= max_m()) {
        let costs = bench.costs(m, SIGMA, (m / 5 + 250, m / 5));
        let costs = Costs { search: small.search, transition: of_hour.transition, ..costs };
        print(&costs);
        tables(&costs);
    }
}

/// The median time of some runs, and the last result.
fn timed<R>(mut work: impl FnMut() -> R) -> (f64, R) {
    timed_of(|| once(&mut work))
}

/// As [`timed`], of what says itself how long it took.
fn timed_of<R>(mut work: impl FnMut() -> (f64, R)) -> (f64, R) {
    let (begin, mut all) = (Instant::now(), Vec::new());
    loop {
        let (seconds, result) = work();
        all.push(seconds);
        if all.len() == RUNS || begin.elapsed().as_secs_f64() > ENOUGH {
            return (Spread::of(&all).median, result);
        }
    }
}

fn once<R>(work: impl FnOnce() -> R) -> (f64, R) {
    let begin = Instant::now();
    let result = work();
    (begin.elapsed().as_secs_f64(), result)
}

fn bytes(path: &Path) -> f64 {
    std::fs::metadata(path).expect("a file that was written").len() as f64
}

/// Drives and parts on this machine.
struct Bench {
    folder: PathBuf,
}

impl Bench {
    fn program(&self, arguments: &[&str]) -> Vec<u8> {
        let mut program = Command::new(env!("CARGO_BIN_EXE_adagio"));
        let output = program.args(arguments).current_dir(&self.folder).stdin(Stdio::null()).output();
        let output = output.expect("a program that was built with this bench");
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    }

    fn lab() -> String {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/lab.toml").display().to_string()
    }

    /// A drive through the lab, recorded once.
    fn drive(&self, seed: usize, actions: usize) -> PathBuf {
        let path = self.folder.join(format!("drive-{seed}-{actions}"));
        if !path.exists() {
            let (seed, actions, out) = (seed.to_string(), actions.to_string(), path.display().to_string());
            let little = ["dictionary.budget=10", "slow.features=5", "evaluate.every=0", "evaluate.starts=1"];
            let sets: Vec<&str> = little.iter().flat_map(|set| ["--set", *set]).collect();
            let lab = Self::lab();
            let run = ["run", &lab, "--seed", &seed, "--actions", &actions, "--no-report", "--quiet", "--out", &out];
            self.program(&[&run[..], &sets].concat());
        }
        path
    }

    /// Each step, by the calls of the program; a drive of so many actions, the second number, has about m support vectors.
    fn costs(&self, m: usize, width: &str, (actions, filling): (usize, usize)) -> Costs {
        // A full dictionary judges nothing.
        let scenario = simulation::scenario("lab.toml", &[&format!("dictionary.budget={}", 2 * m), width]);
        let plan = Arc::new(Plan::new(&scenario).expect("a floor plan"));
        let setting = Setting { scenario: scenario.clone(), plan, par: faer::Par::Seq };
        let open = |path: &Path| Log::open(path, &scenario).expect("a whole log");
        let long = self.drive(101, actions);
        let (looked, long) = timed(|| open(&long));
        let short = [102, 103].map(|seed| open(&self.drive(seed, 300)));
        let (frames, few) = (long.frames as f64, short[0].frames as f64);
        let (decoded, _) = timed(|| {
            let mut samples = Piece::whole(&long).samples(&setting);
            while !samples.next(512).is_empty() {}
        });
        let decode = decoded / frames;
        let (searched, first) = timed(|| first_dictionary(&setting, std::slice::from_ref(&long)).expect("a width"));
        let begin = |name: &str| {
            let path = self.folder.join(name);
            let _ = std::fs::remove_file(&path);
            path
        };

        let filling = open(&self.drive(104, filling));
        let members = |of: &Dictionary| candidates(&setting, &Piece::whole(&filling), of).expect("a whole log");
        let (grown, found) = timed(|| members(&first));
        let (all, none) = (begin("candidates"), begin("no-candidates"));
        found.write(&all, &scenario).expect("room for a part");
        let (known, _) = union(&setting, &first, (std::slice::from_ref(&all), None)).expect("candidates");
        let found_m = known.members().ncols() as f64;
        assert!((found_m / m as f64 - 1.0).abs() < 0.1, "{found_m} support vectors where {m} are wanted");
        // The same frames once more: none of them is new.
        let (judged, found) = timed(|| members(&known));
        let judge = judged / filling.frames as f64;
        found.write(&none, &scenario).expect("room for a part");
        let [read, read_none] =
            [&all, &none].map(|path| timed(|| Candidates::read(path, &scenario).expect("a part")).0);
        let [written, written_none] = [&all, &none].map(|path| {
            let written = timed_of(|| {
                let of = Candidates::read(path, &scenario).expect("a part");
                once(|| of.write(path, &scenario).expect("room for a part"))
            });
            written.0
        });

        let path = begin("dictionary");
        let (dictionary_written, ()) = timed(|| known.write(&path, &scenario).expect("room for a dictionary"));
        let (dictionary_read, _) = timed(|| Dictionary::read(&path, &setting).expect("a dictionary"));
        let (digest, _) = timed(|| known.digest());

        let parts = ["sums-long", "sums-a", "sums-b"].map(begin);
        let (summed, of_long) = timed(|| sums(&setting, &Piece::whole(&long), &known).expect("a whole log"));
        of_long.write(&parts[0], &scenario).expect("room for a part");
        for (log, part) in short.iter().zip(&parts[1..]) {
            sums(&setting, &Piece::whole(log), &known)
                .expect("a whole log")
                .write(part, &scenario)
                .expect("room for a part");
        }
        let sums_of = |part: &Path| Sums::read(part, &scenario).expect("a part");
        let (sums_written, ()) = timed_of(|| {
            let of = sums_of(&parts[1]);
            once(|| of.write(&parts[1], &scenario).expect("room for a part"))
        });
        let merging = |parts: &[PathBuf]| timed(|| merge(&setting, &known, (parts, None)).expect("parts")).0;
        let (merged_one, merged_two) = (merging(&parts[1..2]), merging(&parts[1..]));
        let [few_read, many_read] = [1, 0].map(|of| timed(|| sums_of(&parts[of])).0);
        let [with_few, with_many] = [1, 0].map(|of| {
            let modelled = timed_of(|| {
                let of = sums_of(&parts[of]);
                once(|| model(&setting, &known, of).expect("a model"))
            });
            modelled.0
        });
        // A process that finds its part there reads it, and looks at the log.
        let (file, empty) = (self.folder.join("scenario.toml"), begin("no-dictionary"));
        std::fs::write(&file, &scenario.text).expect("room for a scenario");
        first.write(&empty, &scenario).expect("room for a dictionary");
        let [log, file, empty, all] = [&filling.path, &file, &empty, &all].map(|path| path.display().to_string());
        let again = ["members", &log, "--scenario", &file, "--dictionary", &empty, "--out", &all];
        let (found_there, _) = timed(|| self.program(&again));

        let [many, few] = [frames, few].map(|frames| (frames / PER_ACTION).floor());
        let of_transition = |few_took: f64, many_took: f64| ((many_took - few_took) / (many - few)).max(0.0);
        let (transition, fitted) = (of_transition(few_read, many_read), of_transition(with_few, with_many));
        let sums_bytes = 8.0 * (2.0 * found_m * found_m + found_m);
        Costs {
            m: m as f64,
            d: scenario.vision.values() as f64,
            start: (found_there - looked / frames * filling.frames as f64 - read).max(0.0),
            look: looked / frames,
            decode,
            judge,
            sum: summed / frames,
            growth: grown - judged,
            search: searched - decode * frames.min(scenario.dictionary.sigma_frames as f64),
            dictionary_written,
            dictionary_read,
            digest,
            candidates_written: [written_none, (written - written_none).max(0.0) / found_m],
            candidates_read: [read_none, (read - read_none).max(0.0) / found_m],
            sums_written,
            merged: (merged_two - merged_one - transition * few).max(0.0),
            transition,
            model: [(with_few - fitted * few).max(0.0), fitted],
            frame_bytes: long.files.iter().map(|file| bytes(file)).sum::<f64>() / frames,
            dictionary_bytes: bytes(&path),
            candidate_bytes: bytes(Path::new(&all)) / found_m,
            sums_bytes,
            transition_bytes: (bytes(&parts[0]) - sums_bytes) / many,
        }
    }

    /// The same drives by the program and by the simulation.
    fn check(&self) -> Costs {
        const LOGS: usize = 6;
        const ACTIONS: usize = 600;
        const FILLING: usize = 400;
        let m = max_m().min(1000);
        let (budget, lab) = (format!("dictionary.budget={m}"), Self::lab());
        let drives: Vec<String> = (1..=LOGS).map(|seed| self.drive(seed, ACTIONS).display().to_string()).collect();
        let names: Vec<&str> = drives.iter().map(String::as_str).collect();
        let costs = || self.costs(m, "dictionary.sigma=\"auto\"", (m, FILLING));
        let before = costs();
        let learned = [1, 2].map(|workers| {
            let before = speed(workers);
            let (out, of) = (format!("model-{workers}"), workers.to_string());
            let order = ["learn", "--scenario", &lab, "--set", &budget, "--workers", &of, "--no-evaluate", "--json"];
            let learned = timed(|| {
                let _ = std::fs::remove_dir_all(self.folder.join(&out));
                self.program(&[&order[..], &["--quiet", "--out", &out], &names].concat())
            });
            (learned, 0.5 * (before + speed(workers)))
        });
        let after = costs();
        print(&after);
        println!(
            "\n{LOGS} drives of {ACTIONS} actions, m = {m}: simulated with costs before and after, and by the program"
        );
        for (workers, ((seconds, said), speed)) in [1, 2].into_iter().zip(learned) {
            let said: serde_json::Value = serde_json::from_slice(&said).expect("report.json");
            let number = |section: &str, key: &str| said[section][key].as_f64().expect("a number of the report");
            let parts = self.folder.join(format!("model-{workers}/parts"));
            let found = |round: u64| {
                let parts = std::fs::read_dir(&parts).expect("parts").map(|entry| entry.expect("a part").path());
                let of_round = parts.filter(|path| path.to_string_lossy().contains(&format!("members-{round}.")));
                of_round.map(|path| bytes(&path)).sum::<f64>() / (LOGS as f64 * before.candidate_bytes)
            };
            let rounds = 1..=number("learned_from", "rounds") as u64;
            let frames = number("learned_from", "frames") / LOGS as f64;
            let judged = frames.min(FILLING as f64 * PER_ACTION);
            let logs = Logs { count: LOGS, frames, judged, found: rounds.map(found).collect(), changed: false };
            let machines = Machines { workers, speed, link: 1e15, server: 1e15, failures: 0.0 };
            let simulated = [&before, &after].map(|costs| learn(costs, &logs, &machines).expect("no failures"));
            println!(
                "{workers} workers, each at {speed:.2} of the speed of one alone, candidates of a log in each round {:.0?}: {:.1} and {:.1} s, by the program {seconds:.1} s, ratio {:.2}",
                logs.found,
                simulated[0].seconds(),
                simulated[1].seconds(),
                0.5 * (simulated[0].seconds() + simulated[1].seconds()) / seconds
            );
            println!("  simulated stages {STAGES:?}: {:.2?} s", simulated[1].stages);
            println!("  peak memory of the collector {:.0} MB", 1e-6 * number("memory", "peak_rss_bytes"));
        }
        after
    }
}

/// Speed of so many processes at a time on this machine, as a share of that of one: of products of matrices, which know nothing of logs.
fn speed(workers: usize) -> f64 {
    let rate = || Rates::now(faer::Par::Seq).double;
    let share = || {
        let alone = rate();
        let together: f64 = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..workers).map(|_| scope.spawn(rate)).collect();
            threads.into_iter().map(|thread| thread.join().expect("a product")).sum()
        });
        together / workers as f64 / alone
    };
    Spread::of(&[(); 5].map(|()| share())).median
}

/// Costs as a table.
fn print(c: &Costs) {
    let ms = |seconds: f64| 1e3 * seconds;
    println!("\nm = {}, d = {}", c.m, c.d);
    for (what, value) in [
        ("a log is looked at and hashed, frames/s", 1.0 / c.look),
        ("frames decoded, frames/s", 1.0 / c.decode),
        ("members over m support vectors, frames/s", 1.0 / c.judge),
        ("moments, frames/s", 1.0 / c.sum),
        ("members while a dictionary grows to m: difference, ms", ms(c.growth)),
        ("width of the kernel from 1000 observations, ms", ms(c.search)),
        ("a process, ms", ms(c.start)),
        ("dictionary written, ms", ms(c.dictionary_written)),
        ("dictionary read, ms", ms(c.dictionary_read)),
        ("dictionary hashed, ms", ms(c.digest)),
        ("m candidates written, ms", ms(c.candidates_written[0] + c.m * c.candidates_written[1])),
        ("m candidates read, ms", ms(c.candidates_read[0] + c.m * c.candidates_read[1])),
        ("sums written, ms", ms(c.sums_written)),
        ("sums read and added, ms", ms(c.merged)),
        ("1000 transitions of a part read, ms", ms(1e3 * c.transition)),
        ("features and policies, 20 000 transitions, ms", ms(c.model[0] + WINDOW * c.model[1])),
        ("a frame in a log, bytes", c.frame_bytes),
        ("a dictionary, MB", 1e-6 * c.dictionary_bytes),
        ("m candidates, MB", 1e-6 * c.m * c.candidate_bytes),
        ("sums, MB", 1e-6 * c.sums_bytes),
        ("1000 transitions, MB", 1e-3 * c.transition_bytes),
    ] {
        println!("| {what} | {value:.*} |", if value < 10.0 { 2 } else { 0 });
    }
    let peak = peak_resident_bytes().map_or(f64::NAN, |bytes| 1e-9 * bytes as f64);
    println!("peak resident memory of the bench so far {peak:.1} GB");
}

/// Robot-hours, hours of a log, workers.
fn tables(costs: &Costs) {
    let [link, server] =
        [("--link", 125.0), ("--server", 1000.0)].map(|(name, usual)| 1e6 * argument(name).unwrap_or(usual));
    let often = argument("--failures").unwrap_or(10.0) / 3.6e6;
    let usual = [(10, 1), (10, 10), (1000, 1), (1000, 10), (100_000, 1), (100_000, 10)].map(|of| (of, "", 0.0));
    let changed = [(100_000, 1), (100_000, 10), (100_000, 100)].map(|of| (of, ", changed", 0.0));
    println!("\nm = {}, links {link:.1e} B/s, server {server:.1e} B/s: shares of the time in %\n", costs.m);
    let last = "wire | workers | wire, TB | parts, TB | memory, GB";
    println!("| robot-hours | of a log | workers | time, h | {} | {last} |", STAGES.join(" | "));
    println!("|{}", "---|".repeat(4 + STAGES.len() + 5));
    for ((hours, log), how, failures) in usual.into_iter().chain([((100_000, 10), ", failures", often)]).chain(changed)
    {
        let changed = how == ", changed";
        let frames = 3600.0 * RATE * log as f64;
        let logs = Logs { count: hours / log, frames, judged: frames, found: vec![costs.m], changed };
        for workers in [2, 20, 200, 2000].into_iter().filter(|&workers| workers <= 2 * logs.count) {
            print!("| {hours}{how} | {log} | {workers} | ");
            let Some(of) = learn(costs, &logs, &Machines { workers, speed: 1.0, link, server, failures }) else {
                println!("never: no worker is left |{}", " |".repeat(STAGES.len() + 5));
                continue;
            };
            let percent = |part: f64| format!("{:.0}", 100.0 * part / of.seconds());
            let stages: Vec<String> = of.stages.iter().map(|&stage| percent(stage)).collect();
            println!(
                "{:.2} | {} | {} | {} | {:.3} | {:.3} | {:.1} |",
                of.seconds() / 3600.0,
                stages.join(" | "),
                percent(of.passed.wire / server),
                percent(of.passed.busy / workers as f64),
                1e-12 * of.passed.wire,
                1e-12 * of.parts,
                1e-9 * of.memory
            );
        }
    }
}
