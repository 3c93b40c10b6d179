//! Promise: what a scenario says changes during a run does change then, and nothing else; a run with changes is repeated and
//! goes on like any other.

use std::path::Path;
use std::sync::Arc;

use crate::common::{adagio, package_file, report, smoke_run, stderr, stdout};
use adagio::log::messages::{GoalMoved, ModelUpdate};
use adagio::log::{LogReader, Record, topics};
use adagio::robot::Action;
use adagio::scenario::Scenario;
use adagio::source::{Frame, Source};
use adagio::world::Simulated;
use adagio::world::World;

const ACTIONS: usize = 40;
/// Actions before the change, and the first frame of the next one.
const BEFORE: usize = 20;
const FIRST: u64 = 101;

/// The frames of a robot that drives by a fixed plan, in smoke with some changes.
fn drive(changes: &str) -> Vec<Frame> {
    let text = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap() + changes;
    let scenario = Arc::new(Scenario::parse(&text, Path::new("smoke.toml"), &[]).unwrap());
    assert_eq!(scenario.robot.frames_per_action as u64 * BEFORE as u64 + 1, FIRST);
    let world = Arc::new(World::new(&scenario).unwrap());
    let mut robot = Simulated::new(scenario, world);
    let mut frames: Vec<Frame> = robot.first().into_iter().collect();
    for action in 0..ACTIONS {
        let action = Action::DRIVE[[0, 1, 0, 2, 1][action % 5]];
        robot.execute(action, &mut |frame| {
            frames.push(frame);
            true
        });
    }
    frames
}

fn pixels(frame: &Frame) -> &[u8] {
    &frame.view.image().unwrap().rgb
}

fn brightness(frame: &Frame) -> f64 {
    pixels(frame).iter().map(|&value| f64::from(value)).sum::<f64>() / pixels(frame).len() as f64
}

#[test]
fn light_changes_the_brightness_from_its_action_on_and_nothing_else() {
    let plain = drive("");
    let darker = drive("\n[[change]]\naction = 20\nkind = \"light\"\nfactor = 0.6\n");
    assert_eq!(plain.len(), darker.len());
    for (a, b) in plain.iter().zip(&darker) {
        assert_eq!((a.truth, a.odometry, &a.sonar), (b.truth, b.odometry, &b.sonar), "frame {}", a.number);
        if a.number < FIRST {
            assert_eq!(pixels(a), pixels(b), "frame {}", a.number);
        } else {
            let ratio = brightness(b) / brightness(a);
            // What is white in the brighter picture is cut off there.
            assert!((0.58..0.66).contains(&ratio), "frame {}: {ratio}", a.number);
        }
    }
}

#[test]
fn light_that_drifts_gets_there_evenly() {
    let plain = drive("");
    let drifting = drive("\n[[change]]\naction = 20\nkind = \"light\"\nfactor = 0.5\nover = 16\n");
    let ratio = |number: u64| brightness(&drifting[number as usize]) / brightness(&plain[number as usize]);
    assert!(ratio(FIRST) > 0.97);
    assert!((ratio(FIRST + 40) - 0.75).abs() < 0.05, "{}", ratio(FIRST + 40));
    assert!((ratio(FIRST + 80) - 0.5).abs() < 0.05 && (ratio(200) - 0.5).abs() < 0.05, "{}", ratio(FIRST + 80));
}

#[test]
fn a_wall_that_is_papered_anew_looks_different_where_it_is_seen() {
    let plain = drive("");
    let papered = drive("\n[[change]]\naction = 20\nkind = \"wall\"\nwall = 1\nhue = 10\npattern = \"stripes\"\n");
    let differ = |frame: &&(&Frame, &Frame)| pixels(frame.0) != pixels(frame.1);
    let pairs: Vec<_> = plain.iter().zip(&papered).collect();
    assert!(pairs[..FIRST as usize].iter().find(differ).is_none());
    let changed = pairs[FIRST as usize..].iter().filter(differ).count();
    assert!(changed > 20 && changed < 100, "{changed} of 100 frames differ");
    assert!(pairs.iter().all(|(a, b)| a.truth == b.truth));
}

#[test]
fn a_camera_that_freezes_gives_one_picture_and_then_what_it_would_have_given() {
    let plain = drive("");
    let frozen = drive("\n[[change]]\naction = 20\nkind = \"freeze\"\nframes = 12\n");
    for (a, b) in plain.iter().zip(&frozen) {
        let same = if (FIRST..FIRST + 12).contains(&a.number) { &plain[FIRST as usize - 1] } else { a };
        assert_eq!(pixels(same), pixels(b), "frame {}", a.number);
        assert_eq!((a.truth, &a.boundary), (b.truth, &b.boundary));
    }
}

#[test]
fn a_camera_that_loses_frames_gives_the_last_ones_of_actions() {
    let plain = drive("");
    let losing = drive("\n[[change]]\naction = 20\nkind = \"lose\"\nframes = 11\n");
    let lost: Vec<u64> = plain
        .iter()
        .map(|frame| frame.number)
        .filter(|number| !losing.iter().any(|frame| frame.number == *number))
        .collect();
    assert_eq!(lost, [101, 102, 103, 104, 106, 107, 108, 109, 111]);
    assert!(losing.iter().all(|frame| frame.truth == plain[frame.number as usize].truth));
}

const CHANGES: [&str; 10] = [
    "camera.detail=vision",
    "change.0.action=100",
    "change.0.kind=light",
    "change.0.factor=0.7",
    "change.1.action=120",
    "change.1.kind=lose",
    "change.1.frames=30",
    "change.2.action=150",
    "change.2.kind=freeze",
    "change.2.frames=40",
];

#[test]
fn a_run_with_changes_counts_what_was_lost_is_repeated_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let smoke = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    std::fs::write(folder.path().join("changing.toml"), smoke + "\n[[change]]\n[[change]]\n[[change]]\n").unwrap();
    let sets: Vec<&str> = CHANGES.iter().flat_map(|&set| ["--set", set]).collect();
    let run = ["run", "changing.toml", "--out", "whole", "--quiet", "--no-report"];
    let output = adagio(folder.path(), &[&run, &sets[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let whole = report(&folder.path().join("whole"));
    // 30 frames are 6 actions, of which the last frames are there.
    assert_eq!(whole["run"]["dropped_frames"], 24);
    let verified = adagio(folder.path(), &["replay", "whole", "--verify", "--quiet"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));
    let checked = adagio(folder.path(), &["check", "whole"]);
    assert!(checked.status.success() && stdout(&checked).contains("24 frames dropped"), "{}", stdout(&checked));
    let plain = report(&smoke_run(folder.path(), "plain", &["--set", "camera.detail=vision"]));
    assert_ne!(plain["digest"], whole["digest"]);

    // Cut off while the camera is frozen, it goes on from the log and ends alike.
    let log = folder.path().join("whole/run_000.mcap");
    let bytes = std::fs::read(&log).unwrap();
    std::fs::write(&log, &bytes[..bytes.len() / 3]).unwrap();
    std::fs::remove_file(folder.path().join("whole/report.json")).unwrap();
    let resumed = adagio(folder.path(), &["resume", "whole", "--quiet", "--no-report"]);
    assert!(resumed.status.success(), "{}", stderr(&resumed));
    assert_eq!(report(&folder.path().join("whole"))["digest"], whole["digest"]);
}

/// Smoke with more lines, run in a folder.
fn changing_run(folder: &Path, name: &str, lines: &str, sets: &[&str]) -> std::path::PathBuf {
    let smoke = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    let file = format!("{name}.toml");
    std::fs::write(folder.join(&file), smoke + lines).unwrap();
    let sets: Vec<&str> = sets.iter().flat_map(|&set| ["--set", set]).collect();
    let fixed = ["run", &file, "--out", name, "--quiet", "--no-report", "--set", "camera.detail=vision"];
    let output = adagio(folder, &[&fixed, &sets[..]].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    folder.join(name)
}

const GOAL: &str = "\n[[change]]\naction = 199\nkind = \"goal\"\ntask = 0\ngoal = [2.2, 1.2]\n";

/// Only the features and the policies change with what is learned, not the way that is driven; and a model is asked for at
/// the very frame that is judged by the new goal first, so that the scenario asks for no other models than without.
const WALKS: [&str; 2] = ["policy.pursue_share=0.0", "agent.resolve_frames=1001"];

#[test]
fn policies_after_a_goal_has_moved_are_those_of_a_run_whose_goal_was_always_there() {
    let folder = tempfile::tempdir().unwrap();
    let moved = report(&changing_run(folder.path(), "moved", GOAL, &WALKS));
    let there = [&WALKS[..], &["task.0.goal=[2.2, 1.2]"]].concat();
    let always = report(&changing_run(folder.path(), "always", "", &there));
    let never = report(&changing_run(folder.path(), "never", "", &WALKS));
    // All that was seen before the goal moved is judged anew: bit for bit the same policies.
    assert_eq!(moved["digest"], always["digest"]);
    assert_ne!(moved["digest"], never["digest"]);
    assert_eq!(moved["model"]["slowness"], never["model"]["slowness"]);
    // Trials are about the goal where it is.
    assert_eq!(moved["tasks"], always["tasks"]);
    let evaluated = |name: &str| {
        let output = adagio(folder.path(), &["evaluate", name, "--starts", "20", "--seed", "5", "--json"]);
        assert!(output.status.success(), "{}", stderr(&output));
        serde_json::from_str::<serde_json::Value>(&stdout(&output)).unwrap()["tasks"].clone()
    };
    assert_eq!(evaluated("moved"), evaluated("always"));
    assert_ne!(evaluated("moved")[0], evaluated("never")[0]);
}

#[test]
fn a_goal_that_moves_is_in_the_log_once_and_a_replay_moves_it_again() {
    let folder = tempfile::tempdir().unwrap();
    let run = changing_run(folder.path(), "moved", GOAL, &[]);
    let bytes = std::fs::read(run.join("run_000.mcap")).unwrap();
    let (mut moves, mut models) = (Vec::new(), Vec::new());
    for record in LogReader::new(bytes.as_slice(), "moved") {
        let record = record.unwrap();
        if matches!(&record, Record::Message { topic, .. } if **topic == *topics::GOAL.name()) {
            moves.push(record.decode::<GoalMoved>().unwrap());
        }
        if matches!(&record, Record::Message { topic, .. } if **topic == *topics::MODEL.name()) {
            models.push(record.decode::<ModelUpdate>().unwrap());
        }
    }
    let [moved] = &moves[..] else { panic!("{moves:?}") };
    // Judged at the end of the action before which it moved.
    assert_eq!((moved.frame, moved.task.as_str(), moved.x, moved.y), (1000, "centre", 2.2, 1.2));
    // Policies for it are fitted at once, on the features that there are.
    let [before, at_once] = [999, 1000].map(|frame| models.iter().find(|model| model.asked_at_frame == frame).unwrap());
    assert_eq!((&at_once.digest, at_once.epoch), (&before.digest, before.epoch + 1));
    assert_eq!(at_once.effective_at_frame, 1250);
    let verified = adagio(folder.path(), &["replay", "moved", "--verify", "--quiet"]);
    assert!(verified.status.success(), "{}{}", stdout(&verified), stderr(&verified));

    let digest = report(&run)["digest"].clone();
    // It goes on from before and from after the move.
    for share in [3, 6] {
        std::fs::write(run.join("run_000.mcap"), &bytes[..bytes.len() / 8 * share]).unwrap();
        let _ = std::fs::remove_file(run.join("run_001.mcap"));
        std::fs::remove_file(run.join("report.json")).unwrap();
        let resumed = adagio(folder.path(), &["resume", "moved", "--quiet", "--no-report"]);
        assert!(resumed.status.success(), "{}", stderr(&resumed));
        assert_eq!(report(&run)["digest"], digest, "{share} of 8 parts");
    }
}

#[test]
fn a_goal_cannot_move_into_a_wall_nor_one_that_is_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let smoke = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    let changes = "\n[[change]]\nkind = \"goal\"\ntask = 9\n[[change]]\nkind = \"goal\"\ngoal = [7, 1]\n";
    std::fs::write(folder.path().join("bad.toml"), smoke + changes).unwrap();
    let output = adagio(folder.path(), &["check", "bad.toml"]);
    assert_eq!(output.status.code(), Some(2));
    for part in ["change.0.task = 9 is not there", "change.1.goal = [7.0, 1.0] with radius"] {
        assert!(stderr(&output).contains(part), "{part}: {}", stderr(&output));
    }
}

#[test]
fn a_wall_that_is_not_there_cannot_be_papered() {
    let folder = tempfile::tempdir().unwrap();
    let smoke = std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap();
    let changes = "\n[[change]]\nkind = \"wall\"\nwall = 9\n[[change]]\nkind = \"light\"\nfactor = 0.0\nwall = 1\n";
    std::fs::write(folder.path().join("bad.toml"), smoke + changes).unwrap();
    let output = adagio(folder.path(), &["check", "bad.toml"]);
    assert_eq!(output.status.code(), Some(2));
    for part in ["change.0.wall = 9 is not there: it must be in [0, 3]", "change.1.factor", "change.1.wall"] {
        assert!(stderr(&output).contains(part), "{part}: {}", stderr(&output));
    }
}
