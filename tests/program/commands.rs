//! The command line keeps its promises: files, keys, exit codes, messages; nothing is overwritten.

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::{adagio, package_file, report, smoke_run, stderr, stdout};
use serde_json::Value;

fn smoke() -> String {
    package_file("scenarios/smoke.toml").to_str().unwrap().to_owned()
}

#[test]
fn a_run_leaves_its_folder_and_a_report_with_all_keys() {
    let folder = tempfile::tempdir().unwrap();
    let output = adagio(folder.path(), &["run", &smoke(), "--json", "--seed", "5"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let run = folder.path().join("logs/smoke-seed5");
    for file in ["scenario.toml", "run_000.mcap", "checkpoint.safetensors", "report.json"] {
        assert!(run.join(file).is_file(), "{file} is missing");
    }
    let printed: Value = serde_json::from_slice(&output.stdout).expect("stdout is one JSON value");
    let report = report(&run);
    assert_eq!(printed["digest"], report["digest"]);
    let keys = [
        ("adagio", "version commit"),
        ("scenario", "name seed sha256"),
        ("run", "actions frames seconds frames_per_second dropped_frames quarantined_frames resumed"),
        ("dictionary", "support_vectors sigma nu"),
        ("model", "epoch features slowness lambda"),
        ("pose_decode", "position_rmse_m heading_rmse_deg"),
        ("timing_ms", "act_p50 act_p99 frame_p50 frame_p99 frame_mean resolve_p50 resolve_max refit_p50 refit_max"),
        ("memory", "peak_rss_bytes"),
        ("log", "files bytes messages"),
    ];
    for (section, names) in keys {
        for name in names.split(' ') {
            assert!(report[section].as_object().unwrap().contains_key(name), "{section}.{name}");
        }
    }
    assert_eq!(report["run"]["actions"], 400);
    assert_eq!(report["run"]["frames"], 2001);
    assert_eq!(report["scenario"]["seed"], 5);
    assert_eq!(report["dictionary"]["support_vectors"], 300);
    assert_eq!(report["digest"].as_str().unwrap().len(), 64);
    let tasks = report["tasks"].as_array().unwrap();
    assert_eq!(tasks.len(), 2);
    let names = "name starts success success_wilson_low mean_steps expected_steps optimal_mean_steps extra_steps \
                 convergence_quality reference_success dithers_per_1000 without_reflexes";
    for task in tasks {
        for name in names.split_whitespace() {
            assert!(task.as_object().unwrap().contains_key(name), "tasks.{name}");
        }
        for name in ["success", "mean_steps", "convergence_quality"] {
            assert!(task["without_reflexes"].as_object().unwrap().contains_key(name), "without_reflexes.{name}");
        }
        assert_eq!(task["starts"], 8);
        assert!((3.0..9.0).contains(&task["optimal_mean_steps"].as_f64().unwrap()));
    }
    let curve = report["curve"].as_array().unwrap();
    assert_eq!(curve.len() as u64, report["model"]["epoch"].as_u64().unwrap());
    for name in "frames actions support_vectors success convergence_quality slowness_mean".split(' ') {
        assert!(curve[0].as_object().unwrap().contains_key(name), "curve.{name}");
    }
    // A second run of the same scenario and seed goes to a folder of its own.
    let again = adagio(folder.path(), &["run", &smoke(), "--quiet", "--no-report", "--seed", "5", "--actions", "60"]);
    assert!(again.status.success(), "{}", stderr(&again));
    assert!(folder.path().join("logs/smoke-seed5-2/report.json").is_file());
}

#[test]
fn progress_goes_to_stderr_and_the_table_to_stdout() {
    let folder = tempfile::tempdir().unwrap();
    let output = adagio(folder.path(), &["run", &smoke(), "--no-report", "--actions", "120", "--out", "run"]);
    assert!(output.status.success());
    assert!(stdout(&output).contains("centre") && stdout(&output).contains("kept in run"));
    assert!(!stdout(&output).contains('\x1b'), "no terminal codes where there is no terminal");
    assert!(!stderr(&output).contains('\x1b'));
    assert!(stderr(&output).contains("evaluating 8 starts"));
    let quiet =
        adagio(folder.path(), &["run", &smoke(), "--actions", "60", "--out", "quiet", "--quiet", "--no-report"]);
    assert!(quiet.status.success() && quiet.stderr.is_empty());
}

#[test]
fn an_existing_folder_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir(folder.path().join("mine")).unwrap();
    std::fs::write(folder.path().join("mine/report.json"), "precious").unwrap();
    let output = adagio(folder.path(), &["run", &smoke(), "--out", "mine"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("mine exists already"), "{}", stderr(&output));
    assert_eq!(std::fs::read_to_string(folder.path().join("mine/report.json")).unwrap(), "precious");
    assert_eq!(std::fs::read_dir(folder.path().join("mine")).unwrap().count(), 1);
}

#[test]
fn a_folder_that_cannot_be_made_is_a_failure_with_its_cause() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("file"), "").unwrap();
    let output = adagio(folder.path(), &["run", &smoke(), "--out", "file/run"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("cannot create the folder file/run"), "{}", stderr(&output));
}

#[test]
fn wrong_usage_has_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        &["run"][..],
        &["run", "nowhere.toml"],
        &["fly"],
        &["run", "nowhere.toml", "--seed", "minus one"],
        &["evaluate", "nowhere", "--starts", "0"],
    ] {
        let output = adagio(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", stderr(&output));
        assert!(!output.stderr.is_empty() && output.stdout.is_empty());
    }
    let missing = adagio(folder.path(), &["run", "nowhere.toml"]);
    assert!(stderr(&missing).contains("cannot read the scenario nowhere.toml"));
    let no_run = adagio(folder.path(), &["info", "nowhere"]);
    assert_eq!(no_run.status.code(), Some(1));
    assert!(stderr(&no_run).contains("cannot open the run nowhere"));
}

#[test]
fn check_prints_a_complete_scenario_that_means_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let first = adagio(folder.path(), &["check", &smoke(), "--set", "dictionary.nu=0.02"]);
    assert!(first.status.success(), "{}", stderr(&first));
    assert!(stdout(&first).contains("nu = 0.02"));
    std::fs::write(folder.path().join("complete.toml"), &first.stdout).unwrap();
    let second = adagio(folder.path(), &["check", "complete.toml"]);
    assert!(second.status.success(), "{}", stderr(&second));
    assert_eq!(stdout(&first), stdout(&second));
}

/// What `check` says of a log's size, and the size that it has in the end.
#[track_caller]
fn foretold(sets: &[&str], within: f64) {
    let folder = tempfile::tempdir().unwrap();
    let sets: Vec<&str> = sets.iter().flat_map(|&set| ["--set", set]).collect();
    let said = adagio(folder.path(), &[&["check", &smoke(), "--json"], &sets[..]].concat());
    assert!(said.status.success(), "{}", stderr(&said));
    let said: serde_json::Value = serde_json::from_str(&stdout(&said)).unwrap();
    let run = adagio(
        folder.path(),
        &[&["run", &smoke(), "--json", "--quiet", "--no-report", "--out", "run"], &sets[..]].concat(),
    );
    assert!(run.status.success(), "{}", stderr(&run));
    let run: serde_json::Value = serde_json::from_str(&stdout(&run)).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let ratio = number(&said["log"]["bytes"]) / number(&run["log"]["bytes"]);
    println!("{ratio:.3}");
    assert!((ratio - 1.0).abs() < within, "{ratio}: {} was foretold, {} it is", said["log"], run["log"]);
    assert!(
        number(&said["log"]["measured_frames"]) < number(&run["run"]["frames"]) / 2.0,
        "it was measured, not foretold"
    );
}

#[test]
fn the_size_of_a_log_is_foretold() {
    foretold(&["actions=1000", "seed=21"], 0.2);
}

#[test]
fn the_size_of_a_log_in_real_time_is_foretold() {
    // Chunks are closed by time, so they are small.
    foretold(&["actions=700", "seed=22", "agent.mode=\"realtime\"", "agent.speed=50.0", "log.flush_seconds=0.1"], 0.2);
}

#[test]
fn a_scenario_that_needs_too_much_memory_is_refused_with_numbers_or_shrunk() {
    let folder = tempfile::tempdir().unwrap();
    let small = ["--set", "dictionary.budget=2000", "--set", "agent.memory_gb=0.1"];
    let check = |more: &[&str]| adagio(folder.path(), &[&["check", &smoke()], &small[..], more].concat());
    let refused = check(&[]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(refused.stdout.is_empty());
    let text = stderr(&refused);
    assert!(text.contains("dictionary.budget = 2000 needs ") && text.contains("allows 0.1 GB"), "{text}");
    let largest = text.split("the largest budget that fits is ").nth(1).unwrap();
    let (largest, features) = largest.trim_end().split_once(", with ").unwrap_or((largest.trim_end(), ""));
    assert_eq!(features, "", "{text}");
    // What it names is the largest that is accepted.
    let next = (largest.parse::<usize>().unwrap() + 1).to_string();
    for (budget, code) in [(largest, 0), (&next, 2)] {
        let set = format!("dictionary.budget={budget}");
        assert_eq!(check(&["--set", &set]).status.code(), Some(code), "{budget}");
    }
    let shrunk = check(&["--set", "agent.over_memory=shrink"]);
    assert_eq!(shrunk.status.code(), Some(0));
    assert!(stderr(&shrunk).contains("warning: "), "{}", stderr(&shrunk));
    assert!(stdout(&shrunk).contains(&format!("\nbudget = {largest} ")), "{}", stdout(&shrunk));
    // Frames alone can be too many for any budget.
    let frames = ["--set", "agent.memory_gb=0.001", "--set", "agent.over_memory=shrink"];
    let hopeless = check(&frames);
    assert_eq!(hopeless.status.code(), Some(2));
    assert!(stderr(&hopeless).contains("no budget fits; the part "), "{}", stderr(&hopeless));
}

/// What `check` says is enough, beside the program itself.
#[test]
fn a_run_takes_no_more_memory_than_check_says() {
    let folder = tempfile::tempdir().unwrap();
    let sets = ["actions=600", "dictionary.budget=1500", "dictionary.sigma=2000", "dictionary.retained_frames=5000"];
    let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
    let check = adagio(folder.path(), &[&["check", &smoke()], &sets[..]].concat());
    let said = stderr(&check);
    let megabytes: u64 =
        said.split("matrices of ").nth(1).and_then(|text| text.split(' ').next()).unwrap().parse().unwrap();
    let report = report(&smoke_run(folder.path(), "run", &sets));
    assert!(report["dictionary"]["support_vectors"].as_u64().unwrap() > 1000);
    let peak = report["memory"]["peak_rss_bytes"].as_u64().unwrap() / 1_000_000;
    // Textures, code, the log's chunks and the picture at the end.
    let program = 100;
    assert!(peak <= megabytes + program, "{peak} MB at most, {megabytes} by the formula");
}

/// The solver needs less memory from that number of support vectors on at which it iterates.
#[test]
fn the_largest_budget_is_found_although_memory_does_not_only_grow() {
    let folder = tempfile::tempdir().unwrap();
    let of = |gigabytes: f64, more: &[&str]| {
        let set = format!("agent.memory_gb={gigabytes}");
        let common =
            ["check", &smoke(), "--set", "slow.features=500", "--set", "dictionary.budget=8000", "--set", &set];
        adagio(folder.path(), &[&common[..], more].concat())
    };
    for gigabytes in [1.0, 1.5, 2.0, 2.5, 3.0] {
        let text = stderr(&of(gigabytes, &[]));
        let largest: usize = text.split("fits is ").nth(1).unwrap().trim().parse().unwrap();
        let accepted = |budget: usize| {
            let set = format!("dictionary.budget={budget}");
            of(gigabytes, &["--set", &set]).status.success()
        };
        assert!(accepted(largest), "{gigabytes} GB: {largest}");
        for more in [1, 10, 100, 300, 600, 1000] {
            assert!(!accepted(largest + more), "{gigabytes} GB: {}", largest + more);
        }
    }
}

#[test]
fn evaluate_repeats_the_report_from_the_folder_and_from_the_log_alone() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &[]);
    let report = report(&run);
    let of_folder = adagio(folder.path(), &["evaluate", "run", "--json"]);
    let of_log = adagio(folder.path(), &["evaluate", "run/run_000.mcap", "--json"]);
    assert!(of_folder.status.success(), "{}", stderr(&of_folder));
    assert!(of_log.status.success(), "{}", stderr(&of_log));
    assert_eq!(stdout(&of_folder), stdout(&of_log));
    let result: Value = serde_json::from_slice(&of_folder.stdout).unwrap();
    assert_eq!(result["tasks"], report["tasks"]);
    assert_eq!(result["pose_decode"], report["pose_decode"]);
    let other = adagio(folder.path(), &["evaluate", "run", "--json", "--starts", "7", "--seed", "99"]);
    let other: Value = serde_json::from_slice(&other.stdout).unwrap();
    assert_eq!(other["tasks"][0]["starts"], 7);
    assert_ne!(other["tasks"][0]["optimal_mean_steps"], result["tasks"][0]["optimal_mean_steps"]);
}

#[test]
fn info_and_check_read_a_run_and_notice_a_log_that_was_cut() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--actions", "80"]);
    let info = adagio(folder.path(), &["info", "run", "--json"]);
    assert!(info.status.success());
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert_eq!(info["files"][0]["messages"]["/camera/observation"], 401);
    assert_eq!(info["files"][0]["metadata"]["scenario_name"], "smoke");
    assert_eq!(info["report"]["digest"], report(&run)["digest"]);
    assert_eq!(adagio(folder.path(), &["check", "run"]).status.code(), Some(0));

    let whole = std::fs::read(run.join("run_000.mcap")).unwrap();
    std::fs::write(folder.path().join("cut.mcap"), &whole[..whole.len() / 2]).unwrap();
    let cut = adagio(folder.path(), &["check", "cut.mcap"]);
    assert_eq!(cut.status.code(), Some(3), "{}", stdout(&cut));
    assert!(stderr(&cut).contains("1 of 1 log files are not whole"));
}

fn start(folder: &Path, out: &str) -> Child {
    Command::new(env!("CARGO_BIN_EXE_adagio"))
        .current_dir(folder)
        .args(["run", &smoke(), "--actions", "1000000", "--out", out])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn interrupt(child: &Child) {
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
}

/// Wait until the log of a run has begun to grow.
fn wait_for_log(run: &Path) {
    let begin = Instant::now();
    while std::fs::metadata(run.join("run_000.mcap")).map_or(0, |data| data.len()) < 200_000 {
        assert!(begin.elapsed() < Duration::from_secs(60), "the log does not grow");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn ctrl_c_finishes_cleanly_and_a_second_one_ends_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let once = start(folder.path(), "once");
    wait_for_log(&folder.path().join("once"));
    interrupt(&once);
    let output = once.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("finishing"));
    let run = folder.path().join("once");
    assert!(report(&run)["run"]["actions"].as_u64().unwrap() > 10);
    assert_eq!(adagio(folder.path(), &["check", "once"]).status.code(), Some(0));

    let twice = start(folder.path(), "twice");
    wait_for_log(&folder.path().join("twice"));
    interrupt(&twice);
    std::thread::sleep(Duration::from_millis(100));
    interrupt(&twice);
    assert_eq!(twice.wait_with_output().unwrap().status.code(), Some(130));
}
