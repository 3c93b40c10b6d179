//! Promise: a recorded run is repeated bit for bit, and a run that was interrupted goes on as if it had not been.

use std::path::Path;

use crate::common::{adagio, copy, report, smoke_run, stderr, stdout};
use crate::export::{export, messages};
use adagio::log::messages::{PlaceBelief, Prospect};
use adagio::log::{LogReader, Record};
use serde_json::Value;

fn verify(folder: &Path, run: &str) -> Value {
    let output = adagio(folder, &["replay", run, "--verify", "--json", "--quiet"]);
    assert!(output.status.success(), "{}\n{}", stdout(&output), stderr(&output));
    serde_json::from_slice(&output.stdout).expect("stdout is one JSON value")
}

/// Cut the newest log file of a run, as a kill does: to `share` of its bytes, anywhere.
fn cut(run: &Path, share: f64) {
    let (_, path) = adagio::log::log_files(run).unwrap().pop().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, &bytes[..(share * bytes.len() as f64) as usize]).unwrap();
    let _ = std::fs::remove_file(run.join("report.json"));
}

#[test]
fn a_lockstep_run_is_repeated_from_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &[]);
    let verified = verify(folder.path(), "run");
    assert_eq!(verified["digest"], report(&run)["digest"]);
    assert_eq!(verified["frames"], 2001);
    assert_eq!((&verified["beyond"], &verified["first_difference"]), (&Value::from(0), &Value::Null));
    // Observations and frames; transitions, decisions and commands; blocks, requests, models.
    assert!(verified["recorded_messages"].as_u64().unwrap() > 2 * 2001 + 3 * 400);
    // With another queue and more threads, too.
    let output = adagio(folder.path(), &["replay", "run", "--out", "again", "--quiet", "--no-report"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let again = report(&folder.path().join("again"));
    assert_eq!(again["digest"], report(&run)["digest"]);
    assert_eq!(again["run"]["replay_of"], "run");
    assert_eq!(again["tasks"], report(&run)["tasks"]);
}

#[test]
fn a_realtime_run_is_repeated_from_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let realtime = ["--set", "agent.mode=realtime", "--set", "agent.resolve_frames=100"];
    let realtime = [&realtime[..], &["--set", "agent.latency_frames=50", "--set", "agent.queue=8"]].concat();
    let run = smoke_run(folder.path(), "run", &realtime);
    assert_eq!(verify(folder.path(), "run")["digest"], report(&run)["digest"]);
}

#[test]
fn frames_that_were_dropped_are_missing_in_the_replay_too() {
    let folder = tempfile::tempdir().unwrap();
    // Nothing waits: a queue of one frame overflows whenever a block is learned from.
    let hurried = [
        "--set",
        "agent.mode=realtime",
        "--set",
        "agent.when_behind=drop",
        "--set",
        "agent.queue=1",
        "--actions",
        "600",
    ];
    let run = smoke_run(folder.path(), "run", &hurried);
    let ran = report(&run);
    let dropped = ran["run"]["dropped_frames"].as_u64().unwrap();
    assert!(dropped > 0, "the queue never overflowed");
    assert_eq!(ran["run"]["frames"].as_u64().unwrap() + dropped, 3001);
    let verified = verify(folder.path(), "run");
    assert_eq!((&verified["digest"], &verified["frames"]), (&ran["digest"], &ran["run"]["frames"]));
    // Each drop is a hole in the numbers of the frames, and the log says how many there were.
    let checked = adagio(folder.path(), &["check", "run", "--json"]);
    assert!(checked.status.success(), "{}", stderr(&checked));
    let checked: Value = serde_json::from_slice(&checked.stdout).unwrap();
    assert_eq!(checked[0]["missing_observations"], dropped);
    // Other settings see the same frames, and no fewer because they are given faster; twice they learn the same.
    let analysed = ["one", "two"].map(|name| {
        let set =
            ["replay", "run", "--set", "slow.features=20", "--out", name, "--quiet", "--no-evaluate", "--no-report"];
        let output = adagio(folder.path(), &set);
        assert!(output.status.success(), "{}", stderr(&output));
        let analysis = report(&folder.path().join(name));
        assert_eq!(analysis["run"]["frames"], ran["run"]["frames"]);
        analysis["digest"].clone()
    });
    assert_eq!(analysed[0], analysed[1]);
}

#[test]
fn other_settings_learn_otherwise_from_the_same_frames_and_compare_says_so() {
    let folder = tempfile::tempdir().unwrap();
    smoke_run(folder.path(), "run", &[]);
    let set = [
        "replay",
        "run",
        "--set",
        "slow.features=20",
        "--set",
        "value.gamma=0.8",
        "--out",
        "other",
        "--quiet",
        "--no-report",
    ];
    let output = adagio(folder.path(), &set);
    assert!(output.status.success(), "{}", stderr(&output));
    let other = report(&folder.path().join("other"));
    assert_eq!((&other["model"]["features"], &other["run"]["frames"]), (&Value::from(20), &Value::from(2001)));
    let compared = adagio(folder.path(), &["compare", "run", "other", "--json"]);
    let compared: Value = serde_json::from_slice(&compared.stdout).unwrap();
    assert_eq!(compared["settings"]["slow.features"], serde_json::json!(["60", "20"]));
    assert_eq!(compared["settings"].as_object().unwrap().len(), 2, "{}", compared["settings"]);
    assert_eq!(compared["first_model_that_differs"], 1);
    let same =
        serde_json::json!({"frames": 2001, "parted_at": null, "first_that_differs": null, "share": 0.0, "largest": 0});
    assert_eq!(compared["observations"], same);
    let same = adagio(folder.path(), &["compare", "run", "run"]);
    assert!(stdout(&same).contains("equal, bit for bit"), "{}", stdout(&same));
    assert!(stdout(&same).contains("observations: the same in all common frames (2 001)"), "{}", stdout(&same));
    // Another course from the first action on, and another sensor's errors.
    smoke_run(folder.path(), "elsewhere", &["--seed", "77", "--actions", "50"]);
    let parted = adagio(folder.path(), &["compare", "run", "elsewhere"]);
    assert!(
        stdout(&parted).contains("observations in the common frames (1), before the runs part at frame 1: "),
        "{}",
        stdout(&parted)
    );
    // What vision threw away is not in the log.
    let refused = adagio(folder.path(), &["replay", "run", "--set", "vision.width=16"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(stderr(&refused).contains("vision"), "{}", stderr(&refused));
}

#[test]
fn the_first_difference_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--actions", "100", "--set", "log.compression=none"]);
    let path = run.join("run_000.mcap");
    // Another value in the 60th observation, with a checksum that agrees: as if vision had seen another world.
    let mut copy = adagio::log::LogWriter::create(&folder.path().join("other.mcap"), &Default::default(), &{
        let mut metadata = Default::default();
        for record in LogReader::open(&path).unwrap() {
            if let Record::Metadata { map, .. } = record.unwrap() {
                metadata = map;
            }
        }
        metadata
    })
    .unwrap();
    let mut observations = 0;
    for record in LogReader::open(&path).unwrap() {
        let Record::Message { topic, sequence, log_time_ns, mut data, .. } = record.unwrap() else { continue };
        if &*topic == "/camera/observation" {
            observations += 1;
            if observations == 60 {
                *data.last_mut().unwrap() ^= 128;
            }
        }
        copy.write_encoded(&topic, sequence, log_time_ns, &data).unwrap();
    }
    copy.finish().unwrap();
    let output = adagio(folder.path(), &["replay", "other.mcap", "--verify", "--json", "--quiet"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let verified: Value = serde_json::from_slice(&output.stdout).unwrap();
    // The observation itself is repeated; the first model over it is not, nor what was accepted if that changed.
    let difference = &verified["first_difference"];
    assert!(["/adagio/dictionary", "/adagio/model"].contains(&difference["topic"].as_str().unwrap()), "{difference}");
    assert!(!difference["fields"].as_array().unwrap().is_empty());
    let compared = adagio(folder.path(), &["compare", "run", "other.mcap", "--json"]);
    let compared: Value = serde_json::from_slice(&compared.stdout).unwrap();
    let seen = serde_json::json!({
        "frames": observations, "parted_at": null, "first_that_differs": 59, "largest": 128, "share": 1.0 / (f64::from(observations) * 1536.0)
    });
    assert_eq!(compared["observations"], seen);
    let said = stdout(&adagio(folder.path(), &["compare", "run", "other.mcap"]));
    assert!(said.contains("by 128 at most; the first difference is in frame 59"), "{said}");
}

#[test]
fn a_run_that_was_cut_off_anywhere_goes_on_to_the_same_end() {
    let folder = tempfile::tempdir().unwrap();
    let whole = report(&smoke_run(folder.path(), "whole", &[]));
    for (number, share) in [0.03, 0.31, 0.62, 0.97].into_iter().enumerate() {
        let name = format!("cut_{number}");
        let run = folder.path().join(&name);
        copy(&folder.path().join("whole"), &run);
        cut(&run, share);
        let output = adagio(folder.path(), &["resume", &name, "--quiet", "--no-report"]);
        assert!(output.status.success(), "cut to {share}: {}", stderr(&output));
        let resumed = report(&run);
        assert_eq!(resumed["digest"], whole["digest"], "cut to {share}");
        assert_eq!((&resumed["run"]["resumed"], &resumed["run"]["frames"]), (&Value::from(true), &Value::from(2001)));
        assert_eq!(resumed["tasks"], whole["tasks"]);
        // Both files together are the log of a whole run: nothing is missing, nothing is there twice.
        let checked = adagio(folder.path(), &["check", &name]);
        assert!(checked.status.success(), "{}{}", stdout(&checked), stderr(&checked));
        assert_eq!(verify(folder.path(), &name)["digest"], whole["digest"]);
    }
}

#[test]
fn a_realtime_run_that_was_cut_off_goes_on_and_is_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--set", "agent.mode=realtime"]);
    cut(&run, 0.5);
    for _ in 0..2 {
        // The second time there is nothing left to do but to evaluate.
        let output = adagio(folder.path(), &["resume", "run", "--quiet", "--no-report"]);
        assert!(output.status.success(), "{}", stderr(&output));
        assert_eq!(report(&run)["run"]["frames"], 2001);
        assert_eq!(verify(folder.path(), "run")["digest"], report(&run)["digest"]);
    }
}

/// Begin a run of the smoke scenario, end it by a signal once its log has some bytes, and wait for it.
fn signalled(folder: &Path, arguments: &[&str], bytes: u64, signal: &str) {
    let scenario = crate::common::package_file("scenarios/smoke.toml");
    let mut running = std::process::Command::new(env!("CARGO_BIN_EXE_adagio"))
        .args(["run", scenario.to_str().unwrap(), "--quiet", "--no-report", "--json", "--out", "run"])
        .args(arguments)
        .current_dir(folder)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let log = folder.join("run/run_000.mcap");
    while std::fs::metadata(&log).map_or(0, |data| data.len()) < bytes {
        assert!(running.try_wait().unwrap().is_none(), "it ended before");
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let sent = std::process::Command::new("kill").args([signal, &running.id().to_string()]).status().unwrap();
    assert!(sent.success());
    assert_eq!(running.wait().unwrap().success(), signal == "-INT");
}

#[test]
fn a_run_that_was_interrupted_goes_on_to_the_end_of_one_that_was_not() {
    let folder = tempfile::tempdir().unwrap();
    // Fewer models than usual: each looks for a map.
    let actions = ["--actions", "800", "--set", "value.places=true", "--set", "agent.resolve_frames=800"];
    let whole = report(&smoke_run(folder.path(), "whole", &actions));
    let checkpoint = std::fs::read(folder.path().join("whole/checkpoint.safetensors")).unwrap();
    let (learned, _) = adagio::agent::read_checkpoint(&checkpoint, &folder.path().join("whole")).unwrap();
    assert!(learned.places.is_some_and(|map| map.poses().len() > 600), "few states have a place");
    // Of each decision with places the export has a row.
    let believed = messages::<PlaceBelief>(&folder.path().join("whole"), "/adagio/places");
    assert!(believed.len() > 200 && believed.iter().all(|of| (0.0..=1.001).contains(&of.probabilities.iter().sum())));
    assert!(believed.iter().all(|of| of.probabilities.is_sorted_by(|a, b| a >= b) && of.x.len() == of.y.len()));
    // Of each pursuit it is stated how long it takes, and how probable it is to arrive.
    let stated = messages::<Prospect>(&folder.path().join("whole"), "/adagio/prospect");
    assert!(stated.iter().any(|of| of.done == 0) && stated.iter().any(|of| of.done > 0), "{} are stated", stated.len());
    assert!(stated.iter().all(|of| of.actions >= 1.0 && of.arrival > 0.0 && of.arrival < 1.0));
    let about = export(folder.path(), &["whole", "--out", "arrays"]);
    assert_eq!(about["files"]["places.npz"]["probability"]["shape"], serde_json::json!([believed.len(), 8]));
    assert_eq!(about["files"]["prospects.npz"]["arrival"]["shape"], serde_json::json!([stated.len()]));
    signalled(folder.path(), &actions, 500_000, "-INT");
    let run = folder.path().join("run");
    let frames = report(&run)["run"]["frames"].as_u64().unwrap();
    assert!(frames < 4001, "it was not interrupted");
    // Its log is that of a whole, short run.
    assert_eq!(verify(folder.path(), "run")["digest"], report(&run)["digest"]);
    // From the state that it left, and without one from the log.
    let from_log = folder.path().join("from_log");
    copy(&run, &from_log);
    std::fs::remove_file(from_log.join("state.safetensors")).unwrap();
    for (name, expected) in [("run", "where the state of the run was kept"), ("from_log", "learning again from")] {
        let output = adagio(folder.path(), &["resume", name, "--no-report"]);
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{name}: {}", stderr(&output));
        let resumed = report(&folder.path().join(name));
        assert_eq!(resumed["digest"], whole["digest"], "{name}");
        for same in ["tasks", "curve", "pursuits", "dictionary", "model"] {
            assert_eq!(resumed[same], whole[same], "{name}: {same}");
        }
        assert_eq!(verify(folder.path(), name)["digest"], whole["digest"], "{name}");
        assert!(!folder.path().join(name).join("state.safetensors").exists(), "{name}: nothing is left to go on with");
    }
}

#[test]
fn a_run_that_was_killed_goes_on_from_the_last_state_that_was_kept() {
    for (mode, selection, method, places) in [
        ("lockstep", "ald", "local", "true"),
        ("lockstep", "random", "lspi", "false"),
        ("realtime", "ald", "local", "false"),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let sets = [
            format!("agent.mode={mode}"),
            format!("dictionary.selection={selection}"),
            format!("value.method={method}"),
            format!("value.places={places}"),
            "agent.snapshot_minutes=0.002".to_owned(),
        ];
        let mut settings = vec!["--actions", "1000"];
        settings.extend(sets.iter().flat_map(|set| ["--set", set]));
        signalled(folder.path(), &settings, 1_200_000, "-KILL");
        let run = folder.path().join("run");
        assert!(run.join("state.safetensors").is_file(), "{mode}, {selection}: no state was kept");
        let output = adagio(folder.path(), &["resume", "run", "--no-report"]);
        assert!(output.status.success(), "{mode}, {selection}: {}", stderr(&output));
        assert!(stderr(&output).contains("where the state of the run was kept"), "{}", stderr(&output));
        let resumed = report(&run);
        assert_eq!(resumed["run"]["frames"], 5001);
        // The log of both parts gives the same, also from its beginning and without any state.
        assert_eq!(verify(folder.path(), "run")["digest"], resumed["digest"], "{mode}, {selection}");
        let believed: Vec<u64> = messages::<PlaceBelief>(&run, "/adagio/places").iter().map(|of| of.frame).collect();
        assert_eq!(believed.is_empty(), places == "false", "{mode}, {selection}");
        // None is there twice, and none is missing.
        assert!(believed.windows(2).all(|two| two[1] == two[0] + 5), "{believed:?}");
        if mode == "lockstep" {
            let whole = report(&smoke_run(folder.path(), "whole", &settings));
            assert_eq!(resumed["digest"], whole["digest"], "{selection}");
            assert_eq!(resumed["tasks"], whole["tasks"], "{selection}");
        }
    }
}

#[test]
fn a_state_that_is_damaged_or_ahead_of_the_log_is_left_aside() {
    let folder = tempfile::tempdir().unwrap();
    let whole = report(&smoke_run(folder.path(), "whole", &[]));
    signalled(folder.path(), &[], 300_000, "-INT");
    let (run, state) = (folder.path().join("run"), folder.path().join("run/state.safetensors"));
    let kept = std::fs::read(&state).unwrap();
    let mut damaged = kept.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    std::fs::write(&state, damaged).unwrap();
    let output = adagio(folder.path(), &["resume", "run", "--no-report"]);
    assert!(output.status.success() && stderr(&output).contains("its digest is not that of its content"));
    assert_eq!(report(&run)["digest"], whole["digest"]);
    // The log is shorter than it was when the state was kept, as after a power loss.
    std::fs::write(&state, kept).unwrap();
    for (_, path) in adagio::log::log_files(&run).unwrap().into_iter().skip(1) {
        std::fs::remove_file(path).unwrap();
    }
    cut(&run, 0.1);
    let output = adagio(folder.path(), &["resume", "run", "--no-report"]);
    assert!(output.status.success() && stderr(&output).contains("is ahead of the log"), "{}", stderr(&output));
    assert_eq!(report(&run)["digest"], whole["digest"]);
}
