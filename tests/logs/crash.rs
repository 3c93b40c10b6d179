//! Promise: whatever ends a run (kill -9 at any moment, Ctrl-C, a full disk, a folder that vanishes), what was flushed before
//! is read, nothing is there twice, and the run goes on to the end that it would have had.
//!
//! Moments are drawn from `ADAGIO_SEED` (default 1); a failure names moment and seed. Time is not repeated exactly, so the
//! folder of a run that failed is kept.

#![cfg(unix)]

use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use rand::RngExt;
use serde_json::Value;

use crate::common::{CHUNK, adagio, generator, long, package_file, records_of, report, stderr, stdout};
use adagio::agent::{CHECKPOINT_NAME, read_checkpoint};
use adagio::log::{Ending, FilesReader, LogError, Record, log_files, topics};

/// The smoke scenario in a fifth of a second: everything runs, and the log has several files and many chunks.
const SHORT: [&str; 17] = [
    "actions=120",
    "camera.detail=vision",
    "camera.height=120",
    "camera.width=80",
    "vision.height=8",
    "vision.width=16",
    "dictionary.budget=100",
    "dictionary.sigma_frames=100",
    "slow.features=20",
    "policy.explore_share=0.5",
    "agent.resolve_frames=100",
    "agent.latency_frames=50",
    "evaluate.starts=2",
    "evaluate.max_steps=10",
    "evaluate.decode_train=30",
    "evaluate.decode_test=10",
    "log.chunk_bytes=16384",
];

/// Frames of it.
const FRAMES: usize = 601;

/// Several files, and what is in memory goes to them all the time.
const ROTATING: [&str; 2] = ["log.file_mb=0.1", "log.flush_seconds=0.02"];

fn seed() -> u64 {
    std::env::var("ADAGIO_SEED").map_or(1, |text| text.parse().expect("ADAGIO_SEED is a number"))
}

fn arguments(name: &str, sets: &[&str]) -> Vec<String> {
    let scenario = package_file("scenarios/smoke.toml").display().to_string();
    let mut all = vec!["run".into(), scenario, "--quiet".into(), "--no-report".into(), "--out".into(), name.into()];
    for set in SHORT.iter().chain(sets) {
        all.extend(["--set".to_owned(), (*set).to_owned()]);
    }
    all
}

fn start(folder: &Path, arguments: &[String]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_adagio"))
        .current_dir(folder)
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn resume_arguments(name: &str) -> Vec<String> {
    ["resume", name, "--quiet", "--no-report"].map(str::to_owned).to_vec()
}

/// The run that is not interrupted: its digest, and how long it takes.
fn uninterrupted(folder: &Path) -> (Value, Duration) {
    let mut times = Vec::new();
    for _ in 0..3 {
        let _ = std::fs::remove_dir_all(folder.join("whole"));
        let begin = Instant::now();
        let output = start(folder, &arguments("whole", &ROTATING)).wait_with_output().unwrap();
        assert!(output.status.success(), "{}", stderr(&output));
        times.push(begin.elapsed());
    }
    times.sort();
    (report(&folder.join("whole"))["digest"].clone(), times[1])
}

fn kill(child: &Child, signal: &str) {
    // A process that has ended already is not there any more to be killed.
    let _ = Command::new("kill").args([signal, &child.id().to_string()]).stderr(Stdio::null()).status().unwrap();
}

/// Wait for the end of a program, but not for ever.
fn end_of(mut child: Child, what: &str) -> Output {
    let begin = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if begin.elapsed() > Duration::from_secs(60) {
            child.kill().unwrap();
            panic!("{what}: it hangs");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    child.wait_with_output().unwrap()
}

/// Wait until something is so.
fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !is_so() {
        assert!(begin.elapsed() < Duration::from_secs(60), "waited for {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The bytes of all log files of a run now.
fn bytes_of(run: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let files = log_files(run).unwrap_or_default();
    files.into_iter().filter_map(|(_, path)| std::fs::read(&path).ok().map(|bytes| (path, bytes))).collect()
}

/// Frames and observations that a run's log holds; both are there from the first on without a hole, each once, and a file
/// is damaged nowhere but at its end.
fn recorded(run: &Path, what: &str) -> (usize, usize) {
    let files: Vec<PathBuf> = log_files(run).unwrap().into_iter().map(|(_, path)| path).collect();
    let (mut frames, mut observations) = (Vec::new(), Vec::new());
    let mut records = FilesReader::new(files.clone());
    let mut errors = 0;
    for record in records.by_ref() {
        match record {
            Ok(Record::Message { topic, sequence, .. }) if *topic == *topics::FRAME.name() => frames.push(sequence),
            Ok(Record::Message { topic, sequence, .. }) if *topic == *topics::OBSERVATION.name() => {
                observations.push(sequence);
            }
            Ok(_) => {}
            Err(LogError::Damaged { cause, .. }) => {
                assert!(
                    cause.contains("the file ends after") || cause.contains("does not start with"),
                    "{what}: {cause}"
                );
                errors += 1;
            }
            Err(error) => panic!("{what}: {error}"),
        }
    }
    let ends = records.endings().iter().filter(|ending| matches!(ending, Ending::Damaged { .. })).count();
    assert_eq!(errors, ends, "{what}: more than the end of a file is damaged");
    for numbers in [&frames, &observations] {
        assert_eq!(*numbers, (0..numbers.len() as u32).collect::<Vec<_>>(), "{what}");
    }
    assert!(frames.len() - observations.len() <= 1, "{what}");
    (frames.len(), observations.len())
}

/// `adagio check` ends with a verdict.
fn check(folder: &Path, name: &str, what: &str) -> i32 {
    let output = adagio(folder, &["check", name]);
    let code = output.status.code().unwrap_or_else(|| panic!("{what}: check was ended by a signal"));
    assert!([0, 1, 3].contains(&code), "{what}: check ended with {code}: {}", stderr(&output));
    code
}

/// Resume a run, which must go on to the end that it would have had.
fn resume(folder: &Path, name: &str, digest: &Value, what: &str) {
    let run = folder.join(name);
    let begun = log_files(&run).is_ok_and(|files| !files.is_empty()) && recorded(&run, what).0 > 0;
    let output = end_of(start(folder, &resume_arguments(name)), what);
    if !begun {
        let code = output.status.code();
        // Killed before its folder was there, or before its first frame was in the log.
        assert_eq!(code, Some(if run.is_dir() { 1 } else { 2 }), "{what}: {}", stderr(&output));
        assert!(!run.is_dir() || stderr(&output).contains("adagio run SCENARIO"), "{what}: {}", stderr(&output));
        return;
    }
    assert!(output.status.success(), "{what}: {}", stderr(&output));
    assert_eq!(report(&run)["digest"], *digest, "{what}");
    assert_eq!(recorded(&run, what), (FRAMES, FRAMES), "{what}");
    assert_eq!(check(folder, name, what), 0, "{what}: nothing is lost");
}

/// Run something in a fresh folder, which is kept if it fails.
fn in_folder(work: impl FnOnce(&Path)) {
    let folder = tempfile::tempdir().unwrap().keep();
    let _told = Told(folder.clone());
    work(&folder);
    std::fs::remove_dir_all(&folder).unwrap();
}

struct Told(PathBuf);

impl Drop for Told {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("kept in {}; ADAGIO_SEED={}", self.0.display(), seed());
        }
    }
}

// ---- kill -9

#[test]
fn kills_at_random_moments() {
    in_folder(|folder| {
        let (digest, whole) = uninterrupted(folder);
        let mut rng = generator(seed());
        let kills = if long() { 200 } else { 80 };
        let (mut killed, mut empty, mut resumed, mut rotated, mut ended) = (0, 0, 0, 0, 0);
        for number in 0.. {
            if killed == kills {
                break;
            }
            assert!(ended < 2 * kills, "{ended} runs ended before they were killed, {killed} were killed");
            // More than their share for the start, where little is there yet, and for the end, where all is closed.
            let share: f64 = match number % 8 {
                0 => rng.random_range(0.0..0.1),
                1 => rng.random_range(0.75..1.0),
                _ => rng.random_range(0.0..0.9),
            };
            let what = format!("kill {number} at {share:.3} of {whole:?}");
            let name = format!("killed_{number}");
            let run = folder.join(&name);
            let child = start(folder, &arguments(&name, &ROTATING));
            std::thread::sleep(whole.mul_f64(share));
            let before = bytes_of(&run);
            kill(&child, "-KILL");
            let output = end_of(child, &what);
            assert!(stderr(&output).is_empty(), "{what}: {}", stderr(&output));
            if output.status.signal() != Some(9) {
                assert!(output.status.success(), "{what}");
                ended += 1;
            } else {
                killed += 1;
            }
            if run.is_dir() {
                // What another process saw just before is still there, byte by byte.
                for (path, seen) in &before {
                    assert!(std::fs::read(path).unwrap().starts_with(seen), "{what}: {}", path.display());
                }
                empty += usize::from(recorded(&run, &what).0 == 0);
                rotated += usize::from(log_files(&run).unwrap().len() > 1);
                check(folder, &name, &what);
                let checkpoint = run.join(CHECKPOINT_NAME);
                if checkpoint.is_file() {
                    read_checkpoint(&std::fs::read(&checkpoint).unwrap(), &checkpoint).unwrap();
                }
                if run.join("report.json").is_file() {
                    assert_eq!(report(&run)["digest"], digest, "{what}");
                }
            }
            if killed % 10 == 5 || number % 8 == 1 {
                resume(folder, &name, &digest, &what);
                resumed += 1;
            }
            let _ = std::fs::remove_dir_all(&run);
        }
        eprintln!(
            "{kills} kills: {empty} without a frame, {rotated} after a rotation, {resumed} resumed; {ended} came too late"
        );
        assert!(
            rotated > kills / 7 && resumed > kills / 7 && empty < kills / 2,
            "the moments are not spread over the run"
        );
    });
}

#[test]
fn a_run_that_is_killed_again_and_again_goes_on_each_time() {
    in_folder(|folder| {
        let (digest, whole) = uninterrupted(folder);
        let mut rng = generator(seed() + 1);
        for chain in 0..5 {
            let name = format!("chain_{chain}");
            let run = folder.join(&name);
            let what = format!("chain {chain}");
            let first = start(folder, &arguments(&name, &ROTATING));
            wait_until("the first frames", || {
                run.is_dir() && bytes_of(&run).values().any(|bytes| bytes.len() > 30_000)
            });
            kill(&first, "-KILL");
            end_of(first, &what);
            let mut frames = recorded(&run, &what).0;
            for _ in 0..3 {
                let again = start(folder, &resume_arguments(&name));
                std::thread::sleep(whole.mul_f64(rng.random_range(0.0..0.8)));
                kill(&again, "-KILL");
                end_of(again, &what);
                let now = recorded(&run, &what).0;
                assert!(now >= frames, "{what}: {now} frames after {frames}");
                frames = now;
            }
            resume(folder, &name, &digest, &what);
            let verified = adagio(folder, &["replay", &name, "--verify", "--quiet"]);
            assert!(verified.status.success(), "{what}: {}{}", stdout(&verified), stderr(&verified));
        }
    });
}

/// It has readings on their way and an action half done: it goes on from its state, or repeats what it did from the start.
#[test]
fn a_robot_with_a_mass_goes_on_to_the_end_that_it_would_have_had() {
    const SETS: [&str; 3] = ["log.flush_seconds=0.02", "robot.body=dynamic", "actions=300"];
    in_folder(|folder| {
        let begin = Instant::now();
        end_of(start(folder, &arguments("whole", &SETS)), "whole");
        let whole = begin.elapsed();
        let (digest, frames) =
            (report(&folder.join("whole"))["digest"].clone(), recorded(&folder.join("whole"), "whole").0);
        let (mut rng, mut ended_early) = (generator(seed() + 5), 0);
        for number in 0..4 {
            let (name, what) = (format!("mass_{number}"), format!("robot with a mass {number}"));
            let run = folder.join(&name);
            let child = start(folder, &arguments(&name, &SETS));
            wait_until("the first frames", || run.is_dir() && recorded(&run, &what).0 > 0);
            std::thread::sleep(whole.mul_f64(rng.random_range(0.0..0.6)));
            kill(&child, if number % 2 == 0 { "-INT" } else { "-KILL" });
            end_of(child, &what);
            ended_early += usize::from(recorded(&run, &what).0 < frames);
            let output = end_of(start(folder, &resume_arguments(&name)), &what);
            assert!(output.status.success(), "{what}: {}", stderr(&output));
            assert_eq!((&report(&run)["digest"], recorded(&run, &what)), (&digest, (frames, frames)), "{what}");
            let verified = adagio(folder, &["replay", &name, "--verify", "--quiet"]);
            assert!(verified.status.success(), "{what}: {}{}", stdout(&verified), stderr(&verified));
        }
        assert!(ended_early >= 2, "{ended_early} of 4 were ended before their end");
    });
}

#[test]
fn at_most_one_flush_interval_is_lost() {
    in_folder(|folder| {
        // 50 frames a second, which any machine can take; chunks alone would not be full for a minute.
        let paced = ["agent.speed=10", "log.flush_seconds=0.2", "actions=100000", "log.chunk_bytes=10000000"];
        let run = folder.join("paced");
        let child = start(folder, &arguments("paced", &paced));
        let frames_now = || if run.is_dir() { recorded(&run, "paced").0 } else { 0 };
        wait_until("the first frames", || frames_now() > 0);
        let (begin, first) = (Instant::now(), frames_now());
        for _ in 0..5 {
            std::thread::sleep(Duration::from_millis(600));
            let (seconds, frames) = (begin.elapsed().as_secs_f64(), frames_now());
            // A second more than the interval for a machine that is busy.
            let least = first as f64 + 50.0 * (seconds - 0.2 - 1.0);
            assert!(frames as f64 >= least, "{frames} frames are in the log after {seconds:.2} s");
        }
        let before = frames_now();
        kill(&child, "-KILL");
        end_of(child, "paced");
        assert!(frames_now() >= before && before > 90, "{before}");
    });
}

// ---- a clean end by a signal

#[test]
fn a_run_that_was_interrupted_ends_cleanly_and_goes_on() {
    in_folder(|folder| {
        let (digest, whole) = uninterrupted(folder);
        let mut rng = generator(seed() + 2);
        let mut interrupted = 0;
        for number in 0..12 {
            let name = format!("interrupted_{number}");
            let run = folder.join(&name);
            let what = format!("interruption {number}");
            let child = start(folder, &arguments(&name, &ROTATING));
            wait_until("the log", || run.join("run_000.mcap").is_file());
            // In the first moment, too: then there is not enough to learn from.
            std::thread::sleep(whole.mul_f64(if number < 3 { 0.0 } else { rng.random_range(0.0..0.6) }));
            kill(&child, if number % 2 == 0 { "-INT" } else { "-TERM" });
            let output = end_of(child, &what);
            assert_eq!(output.status.code(), Some(0), "{what}: {}", stderr(&output));
            let actions = report(&run)["run"]["actions"].as_u64().unwrap();
            interrupted += usize::from(actions < 120);
            assert_eq!(check(folder, &name, &what), 0, "{what}");
            let verified = adagio(folder, &["replay", &name, "--verify", "--quiet"]);
            assert!(verified.status.success(), "{what}: {}{}", stdout(&verified), stderr(&verified));
            resume(folder, &name, &digest, &what);
        }
        assert!(interrupted > 4, "only {interrupted} runs were interrupted before their end");
    });
}

// ---- named points

/// Where the chunks of a log begin, and where the last one ends.
fn chunk_boundaries(bytes: &[u8]) -> Vec<usize> {
    let chunks: Vec<_> = records_of(bytes).into_iter().filter(|(_, kind, _)| *kind == CHUNK).collect();
    let end = chunks.last().map(|(at, _, length)| at + 9 + length);
    chunks.iter().map(|(at, ..)| *at).chain(end).collect()
}

/// A copy of a run as a kill would have left it: its log ends in file `number` after `length` bytes.
fn cut_copy(folder: &Path, name: &str, number: usize, length: usize) -> PathBuf {
    let (whole, run) = (folder.join("whole"), folder.join(name));
    let _ = std::fs::remove_dir_all(&run);
    std::fs::create_dir(&run).unwrap();
    std::fs::copy(whole.join("scenario.toml"), run.join("scenario.toml")).unwrap();
    for (file, path) in log_files(&whole).unwrap().into_iter().take(number + 1) {
        let bytes = std::fs::read(&path).unwrap();
        let kept = if file as usize == number { &bytes[..length] } else { &bytes[..] };
        std::fs::write(run.join(path.file_name().unwrap()), kept).unwrap();
    }
    run
}

#[test]
fn a_log_that_ends_at_any_chunk_boundary_or_beside_it_goes_on() {
    in_folder(|folder| {
        let (digest, _) = uninterrupted(folder);
        let files = bytes_of(&folder.join("whole"));
        assert!(files.len() >= 4, "{} files", files.len());
        let (mut cuts, mut last) = (0, 0);
        for (number, bytes) in files.values().enumerate() {
            for boundary in chunk_boundaries(bytes) {
                for offset in [-1, 0, 1, 8, 9, 60] {
                    let length = boundary.saturating_add_signed(offset).min(bytes.len());
                    let what = format!("file {number} cut to {length} bytes, {offset} from a chunk's begin");
                    let run = cut_copy(folder, "cut", number, length);
                    let frames = recorded(&run, &what).0;
                    // A chunk is there as soon as its last byte is.
                    assert!(frames >= last, "{what}");
                    last = frames;
                    cuts += 1;
                    if cuts % 11 == 0 {
                        // A checkpoint that was being written, and one that is newer than the log.
                        std::fs::write(run.join("checkpoint.part"), b"\x10\0\0\0\0\0\0\0{\"me").unwrap();
                        if cuts % 2 == 0 {
                            std::fs::copy(folder.join("whole").join(CHECKPOINT_NAME), run.join(CHECKPOINT_NAME))
                                .unwrap();
                        }
                        resume(folder, "cut", &digest, &what);
                    }
                }
            }
        }
        assert!(cuts > 150 && last == FRAMES, "{cuts} cuts, {last} frames");
    });
}

#[test]
fn a_rotation_that_was_cut_short_goes_on() {
    in_folder(|folder| {
        let (digest, _) = uninterrupted(folder);
        let files: Vec<Vec<u8>> = bytes_of(&folder.join("whole")).into_values().collect();
        let unclosed = *chunk_boundaries(&files[0]).last().unwrap();
        // The file before is closed or not yet; the next one is empty, or ends within its magic, its first record, its first
        // chunk; or there are two of these, from a run that was killed, resumed and killed.
        for length in [files[0].len(), unclosed] {
            for next in [0, 5, 8, 12, 30, 600] {
                let what = format!("file 0 of {length} bytes, then {next} bytes");
                let run = cut_copy(folder, "rotating", 0, length);
                std::fs::write(run.join("run_001.mcap"), &files[1][..next]).unwrap();
                if next % 2 == 0 {
                    std::fs::write(run.join("run_002.mcap"), &files[2][..next]).unwrap();
                }
                resume(folder, "rotating", &digest, &what);
                let verified = adagio(folder, &["replay", "rotating", "--verify", "--quiet"]);
                assert!(verified.status.success(), "{what}: {}{}", stdout(&verified), stderr(&verified));
            }
        }
    });
}

#[test]
fn a_run_that_had_not_begun_says_what_to_do() {
    in_folder(|folder| {
        uninterrupted(folder);
        let definitions = chunk_boundaries(&std::fs::read(folder.join("whole/run_000.mcap")).unwrap())[1];
        for length in [0, 8, 20, definitions] {
            cut_copy(folder, "begun", 0, length);
            let output = adagio(folder, &["resume", "begun", "--no-report"]);
            assert_eq!(output.status.code(), Some(1), "{length}: {}", stderr(&output));
            let text = stderr(&output);
            assert!(text.contains("begun") && text.contains("adagio run SCENARIO"), "{length}: {text}");
            check(folder, "begun", "a run that had not begun");
        }
        std::fs::remove_file(folder.join("begun/run_000.mcap")).unwrap();
        let output = adagio(folder, &["resume", "begun", "--no-report"]);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains("adagio run SCENARIO"), "{}", stderr(&output));
    });
}

// ---- a disk that is full, a folder that is gone

/// The program with a limit on the size of each file, in bytes: what goes beyond is refused, as on a full disk.
fn limited(folder: &Path, bytes: u64, arguments: &[String]) -> Output {
    // POSIX counts blocks of 512 bytes. The signal would end the program before it hears of the error.
    let script = format!("trap '' XFSZ; ulimit -f {} && exec \"$0\" \"$@\"", bytes / 512);
    let child = Command::new("sh")
        .current_dir(folder)
        .args(["-c", &script, env!("CARGO_BIN_EXE_adagio")])
        .args(arguments)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    end_of(child, &format!("files of {bytes} bytes"))
}

/// One message, with these parts in it.
fn assert_told(output: &Output, parts: &[&str]) {
    let text = stderr(output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(text.lines().filter(|line| line.starts_with("adagio: ")).count(), 1, "{text}");
    assert!(!text.contains("panicked"), "{text}");
    for part in parts {
        assert!(text.contains(part), "{part:?} is not in {text}");
    }
}

#[test]
fn a_log_file_that_cannot_grow_is_followed_by_another_and_nothing_is_lost() {
    in_folder(|folder| {
        let (digest, _) = uninterrupted(folder);
        let output = limited(folder, 300_000, &arguments("limited", &["log.flush_seconds=0.02"]));
        let text = stderr(&output);
        assert_eq!(output.status.code(), Some(0), "{text}");
        assert!(text.contains("warning: writing the log limited/run_000.mcap failed"), "{text}");
        assert!(text.contains("File too large"), "{text}");
        let run = folder.join("limited");
        assert_eq!(report(&run)["digest"], digest);
        assert_eq!(recorded(&run, "limited"), (FRAMES, FRAMES));
        assert!(log_files(&run).unwrap().len() > 1);
        assert_eq!(check(folder, "limited", "limited"), 0);
        let verified = adagio(folder, &["replay", "limited", "--verify", "--quiet"]);
        assert!(verified.status.success(), "{}", stderr(&verified));
    });
}

#[test]
fn a_file_that_cannot_be_written_ends_the_run_with_its_name_and_cause() {
    in_folder(|folder| {
        let (digest, _) = uninterrupted(folder);
        // Too little for the complete scenario; for the first chunk of a log; for a checkpoint.
        for (name, bytes, place) in [
            ("nothing", 0, "nothing/scenario.toml"),
            ("little", 8192, "little/scenario.toml"),
            ("some", 24_576, "some/run_000.mcap"),
            ("more", 60_000, "more/checkpoint.safetensors"),
        ] {
            let output = limited(folder, bytes, &arguments(name, &["log.chunk_bytes=32768"]));
            assert_told(&output, &[place, "File too large"]);
            let run = folder.join(name);
            if !log_files(&run).unwrap().is_empty() && recorded(&run, name).0 > 0 {
                // With room again, it goes on.
                resume(folder, name, &digest, name);
            }
        }
    });
}

#[test]
fn a_full_disk_ends_the_run_with_its_cause_and_with_room_again_it_goes_on() {
    in_folder(|folder| {
        let (digest, _) = uninterrupted(folder);
        std::fs::create_dir(folder.join("disk")).unwrap();
        // A file system of its own, which nobody else sees. What is on it is copied, since it goes with the program.
        let script = "mount -t tmpfs -o size=160k none disk && mkdir copy && { \"$0\" \"$@\"; code=$?; cp -r disk/run copy/; exit $code; }";
        let output = Command::new("unshare")
            .current_dir(folder)
            .args(["-rm", "sh", "-c", script, env!("CARGO_BIN_EXE_adagio")])
            .args(arguments("disk/run", &ROTATING))
            .output();
        let mounted = folder.join("copy").is_dir();
        if !mounted {
            let required = std::env::var("ADAGIO_REQUIRE_MOUNT").is_ok_and(|value| value == "1");
            assert!(!required, "NOT CHECKED on a full file system: {output:?}");
            eprintln!("NOT CHECKED on a full file system, only with files that cannot grow: it cannot be mounted here");
            return;
        }
        assert_told(&output.unwrap(), &["disk/run", "No space left on device"]);
        let run = folder.join("copy/run");
        assert!(recorded(&run, "full disk").0 > 20);
        resume(&folder.join("copy"), "run", &digest, "full disk");
    });
}

#[test]
fn a_folder_that_is_removed_ends_the_run_with_its_cause() {
    in_folder(|folder| {
        for number in 0..4 {
            let name = format!("removed_{number}");
            let run = folder.join(&name);
            let child = start(folder, &arguments(&name, &["actions=1000000", "log.flush_seconds=0.05"]));
            wait_until("the log", || bytes_of(&run).values().any(|bytes| bytes.len() > 20_000 + 60_000 * number));
            // Again, if the program has just put something into it.
            wait_until("an empty folder", || std::fs::remove_dir_all(&run).is_ok());
            let output = end_of(child, &name);
            assert_told(&output, &[&name, "No such file or directory"]);
            assert!(!run.exists());
        }
    });
}
