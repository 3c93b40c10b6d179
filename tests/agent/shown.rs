//! Goals that are shown: an operator carries the robot there and turns it round once, and the camera alone has to find back.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use adagio::agent::{RunOptions, Status, run};
use adagio::log::{LogOptions, NullStorage, Rotation, RunLog};
use adagio::policy::Learned;
use adagio::random::stream;
use adagio::robot::{Action, Pose};
use adagio::scenario::Scenario;
use adagio::source::{Frame, MarkKind, Source, mark_text, parse_mark};
use adagio::world::{Simulated, World};
use nalgebra::Point2;
use rand::RngExt;

use crate::common::{adagio, package_file, report, stderr};

/// The lab of `scenarios/shown.toml`, as short as a map of it can be learned in.
const SHORT: [&str; 12] = [
    "camera.detail=vision",
    "dictionary.sigma_frames=500",
    "agent.resolve_frames=1000",
    "agent.latency_frames=100",
    "actions=900",
    "show.0.action=400",
    "show.1.action=420",
    "dictionary.budget=400",
    "policy.explore_share=0.48",
    "policy.pursue_share=0.9",
    "evaluate.every=0",
    "evaluate.starts=20",
];

fn run_of(folder: &std::path::Path, name: &str, arguments: &[&str]) -> std::path::PathBuf {
    let scenario = package_file("scenarios/shown.toml");
    let fixed = ["run", scenario.to_str().unwrap(), "--quiet", "--no-report", "--out", name];
    let output = adagio(folder, &[&fixed, arguments].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    folder.join(name)
}

/// The gate is 99 % of 400 starts, at most 1 % false arrivals and quality 0.92 at the end of a run; this is a third of one with 200
/// starts, so 95 %, 5 % and 0.85 are asked for.
#[test]
fn a_goal_that_was_shown_is_found_again() {
    let folder = tempfile::tempdir().unwrap();
    let short = "--seed 41 --actions 5000 --set world.texture_seed=77 --set evaluate.every=0 --set evaluate.starts=200 --set camera.detail=vision";
    let found = report(&run_of(folder.path(), "run", &short.split(' ').collect::<Vec<_>>()));
    for task in found["tasks"].as_array().unwrap() {
        let arrival = |key: &str| task["arrival"][key].as_f64().unwrap();
        assert!(arrival("true_rate") >= 0.95, "{task}");
        assert!(arrival("false_rate") <= 0.05, "{task}");
        assert!(arrival("quality") >= 0.85, "{task}");
        assert!(arrival("distance_p50_m") < 0.25 && arrival("distance_p99_m") < 0.45, "{task}");
        assert_eq!(task["success"], task["arrival"]["true_rate"]);
    }
    // What it pursues while it still explores, it reaches as well.
    let pursuits = found["pursuits"].as_array().unwrap();
    assert!(pursuits.iter().all(|of| of["ended"].as_u64() == of["reached"].as_u64()), "{pursuits:?}");
}

/// A robot whose pose somebody measures badly, or not at all.
struct Measured<F> {
    robot: Simulated,
    pose: F,
}

impl<F: FnMut(Option<Pose>) -> Option<Pose>> Source for Measured<F> {
    fn first(&mut self) -> Option<Frame> {
        let frame = self.robot.first()?;
        Some(Frame { truth: (self.pose)(frame.truth), ..frame })
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        self.robot.execute(action, &mut |frame| give(Frame { truth: (self.pose)(frame.truth), ..frame }))
    }
}

fn learned(pose: impl FnMut(Option<Pose>) -> Option<Pose> + Send) -> Arc<Learned> {
    let path = package_file("scenarios/shown.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let scenario = Arc::new(Scenario::parse(&text, &path, &SHORT.map(str::to_owned)).unwrap());
    let world = Arc::new(World::new(&scenario).unwrap());
    let log = RunLog::create(NullStorage, &LogOptions::default(), Rotation::NEVER, &Default::default()).unwrap();
    let (stop, status) = (AtomicBool::new(false), Status::default());
    let mut robot = Measured { robot: Simulated::new(scenario.clone(), world.clone()), pose };
    let outcome = run(&scenario, &world.plan, &mut robot, log, RunOptions::new(&stop, &status)).unwrap();
    assert!(outcome.pursuits.iter().all(|tally| tally.ended > 0), "{:?}", outcome.pursuits);
    outcome.learned.unwrap()
}

#[test]
fn what_is_learned_does_not_depend_on_any_pose() {
    let known = learned(|pose| pose);
    let mut rng = stream(1, "noise");
    let noisy = learned(move |_| {
        let mut number = || rng.random_range(-100.0..100.0);
        Some(Pose::new(Point2::new(number(), number()), number()))
    });
    let unknown = learned(|_| None);
    assert!(known.regions.iter().all(Option::is_some));
    assert_eq!((noisy.digest(), unknown.digest()), (known.digest(), known.digest()));
    // The place is for plots alone.
    let [x, y] = known.goals[0].unwrap();
    assert!((x - 1.5).hypot(y - 0.9) < 0.1, "({x}, {y})");
    assert_eq!(unknown.goals, [None, None]);
}

/// The log's diagnostics.
fn said(run: &std::path::Path) -> Vec<String> {
    let file = std::fs::File::open(run.join("run_000.mcap")).unwrap();
    let records = adagio::log::LogReader::new(file, "run_000.mcap").map(Result::unwrap);
    let text = |record: adagio::log::Record| match &record {
        adagio::log::Record::Message { topic, .. } if **topic == *"/rosout" => {
            Some(record.decode::<adagio::log::messages::Log>().unwrap().msg)
        }
        _ => None,
    };
    records.filter_map(text).collect()
}

fn topics_of(run: &std::path::Path) -> std::collections::BTreeMap<String, usize> {
    let file = std::fs::File::open(run.join("run_000.mcap")).unwrap();
    let mut counts = std::collections::BTreeMap::new();
    for record in adagio::log::LogReader::new(file, "run_000.mcap") {
        if let adagio::log::Record::Message { topic, .. } = record.unwrap() {
            *counts.entry(topic.to_string()).or_insert(0) += 1;
        }
    }
    counts
}

fn short() -> Vec<&'static str> {
    SHORT.iter().flat_map(|set| ["--set", set]).collect()
}

/// From the first frame to the report, and the same to the bit as with a pose.
#[test]
fn a_run_without_any_pose_is_the_same_run() {
    let folder = tempfile::tempdir().unwrap();
    let known = run_of(folder.path(), "known", &short());
    let scenario = package_file("scenarios/shown.toml");
    let fixed = ["run", scenario.to_str().unwrap(), "--quiet", "--out", "none", "--set", "robot.pose=none"];
    let output = adagio(folder.path(), &[&fixed[..], &short()].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let none = folder.path().join("none");
    let page = std::fs::read_to_string(none.join("report.html")).unwrap();
    assert!(page.contains("What was shown of centre"), "the pictures are there without a pose");
    assert_eq!(topics_of(&none).get("/pose"), None);
    assert!(topics_of(&known)["/pose"] > 4000);
    let (known, none) = (report(&known), report(&none));
    assert_eq!(none["digest"], known["digest"]);
    assert!(
        none["tasks"][0]["arrival"]["declared"].as_u64() > Some(0),
        "the simulation knows where it showed the goal"
    );
    let text = std::fs::read_to_string(&scenario).unwrap();
    let by_pose = text.replacen("goal = \"shown\"", "goal = [1.5, 0.9]", 1);
    let area = format!("{}[[task]]\navoid = [1.5, 0.3]\n", text.split_once("[[show]]").unwrap().0);
    for (text, key) in [(by_pose, "task.0.goal"), (area, "task.2.avoid")] {
        let error = Scenario::parse(&text, &scenario, &["robot.pose=none".to_owned()]).unwrap_err().to_string();
        assert!(error.contains("nobody knows when the robot is there") && error.contains(key), "{error}");
    }
}

#[test]
fn what_was_not_shown_yet_is_said_and_the_robot_explores_on() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = std::fs::read_to_string(package_file("scenarios/shown.toml")).unwrap();
    let (tasks, _) = scenario.split_once("[[show]]").unwrap();
    std::fs::write(folder.path().join("waiting.toml"), tasks).unwrap();
    let sets: Vec<&str> = SHORT.iter().filter(|set| !set.starts_with("show")).flat_map(|set| ["--set", set]).collect();
    let output = adagio(
        folder.path(),
        &[&["run", "waiting.toml", "--quiet", "--no-report", "--out", "run"], &sets[..]].concat(),
    );
    assert!(output.status.success(), "{}", stderr(&output));
    let run = folder.path().join("run");
    let told = said(&run);
    for name in ["centre", "corner"] {
        // Once, not with every model.
        let of_task = told.iter().filter(|text| text.contains(&format!("{name:?} was not shown yet"))).count();
        assert_eq!(of_task, 1, "{told:?}");
    }
    assert!(report(&run)["pursuits"].as_array().unwrap().iter().all(|of| of["ended"] == 0));
}

/// The gate is 2 % of the entries without, and 1.5 times the shortest way around, at the end of a run; this is a third of one.
#[test]
fn what_was_shown_to_be_avoided_is_driven_around() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = package_file("scenarios/avoid.toml");
    let short = "--seed 43 --actions 5000 --set world.texture_seed=79 --set evaluate.every=0 --set evaluate.starts=200";
    let fixed = ["run", scenario.to_str().unwrap(), "--quiet", "--no-report", "--out", "run"];
    let output = adagio(folder.path(), &[&fixed[..], &short.split(' ').collect::<Vec<_>>()].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let found = report(&folder.path().join("run"));
    let (mut entries, mut without) = (0, 0);
    for task in found["tasks"].as_array().unwrap() {
        entries += task["avoided"]["entries"].as_u64().unwrap();
        without += task["avoided"]["entries_without"].as_u64().unwrap();
        assert!(task["avoided"]["detour"].as_f64().unwrap() <= 1.5, "{task}");
        assert!(task["success"].as_f64().unwrap() >= 0.9, "{task}");
    }
    assert!(without >= 30 && 20 * entries <= without, "{entries} entries, {without} without");
    // What was kept is tried with the same result.
    let output = adagio(folder.path(), &["evaluate", "run", "--starts", "200", "--seed", "43", "--json"]);
    let again: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(again["tasks"], found["tasks"]);
}

#[test]
fn a_place_is_either_a_goal_or_to_be_avoided() {
    let path = package_file("scenarios/avoid.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let refused = |text: &str, set: &str, expected: &str| {
        let error = Scenario::parse(text, &path, &[set.to_owned()]).unwrap_err().to_string();
        assert!(error.contains(expected), "{set}: {error}");
    };
    refused(&text, "task.0.goal=[1.6, 0.6]", "is to be avoided: it must be at least 0.3 m away");
    refused(&text, "show.1.at=[1.5, 0.7]", "\"stain\" at [1.5, 0.6]");
    refused(&text, "task.2.goal=[0.4, 0.9]", "task.2.goal");
    refused(&text, "task.2.reward=1.0", "in [-1000000, -0.000001]");
    refused(&text, "task.0.avoid=shown", "must stand behind all others");
    refused(&text, "task.0.name=forget me", "not begin with \"forget \"");
}

/// A pad on the floor gives the reward, and that is all that the robot knows of it.
#[test]
fn a_reward_from_outside_is_found_again_without_a_pose() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = std::fs::read_to_string(package_file("scenarios/shown.toml")).unwrap();
    let (world, _) = scenario.split_once("[[task]]").unwrap();
    let pad = "[[task]]\nname = \"charger\"\nreward = \"topic\"\ngoal = [2.4, 0.6]\nradius = 0.2\n";
    std::fs::write(folder.path().join("pad.toml"), format!("{world}{pad}")).unwrap();
    let short = "--set robot.pose=none --actions 5000 --set policy.explore_share=0.6 --set evaluate.every=0 --set camera.detail=vision --seed 44";
    let fixed = ["run", "pad.toml", "--quiet", "--no-report", "--out", "run"];
    let output = adagio(folder.path(), &[&fixed[..], &short.split(' ').collect::<Vec<_>>()].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let run = folder.path().join("run");
    assert_eq!(topics_of(&run)["/adagio/reward"], 5000);
    let found = report(&run);
    assert!(found["tasks"][0]["success"].as_f64().unwrap() >= 0.95, "{}", found["tasks"]);
    let pursuits = &found["pursuits"][0];
    assert!(pursuits["ended"].as_u64() > Some(0) && pursuits["reached"] == pursuits["ended"], "{pursuits}");
    let output = adagio(folder.path(), &["replay", "run", "--verify", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn marks_are_in_the_log_and_a_replay_has_them_again() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_of(folder.path(), "run", &short());
    let file = std::fs::File::open(run.join("run_000.mcap")).unwrap();
    let (mut marks, mut arrived, mut frame, mut marked_at, mut asked_at) = (Vec::new(), 0, 0, 0, Vec::new());
    for record in adagio::log::LogReader::new(file, "run_000.mcap") {
        let record = record.unwrap();
        let adagio::log::Record::Message { topic, .. } = &record else { continue };
        match &**topic {
            "/adagio/frame" => frame = record.decode::<adagio::log::messages::FrameTaken>().unwrap().frame,
            // Of the actor that learns, which may be behind: where it stands in the log says nothing.
            "/adagio/request" => asked_at.push(record.decode::<adagio::log::messages::ModelRequest>().unwrap().frame),
            "/adagio/mark" => {
                marks.push(record.decode::<adagio::log::messages::Text>().unwrap().data);
                marked_at = frame;
            }
            "/adagio/pursuit" => {
                arrived += usize::from(record.decode::<adagio::log::messages::PursuitEnded>().unwrap().arrived);
            }
            _ => {}
        }
    }
    // 8 headings of 5 frames.
    assert_eq!(marks.iter().filter(|mark| *mark == "centre").count(), 40);
    assert_eq!(marks.iter().filter(|mark| *mark == "corner").count(), 40);
    // The second place has its policy with the next fit, which waits for no new frame but that by which the turn is over.
    assert!(asked_at.iter().any(|&asked| (marked_at + 1..=marked_at + 5).contains(&asked)), "{marked_at} {asked_at:?}");
    let output = adagio(folder.path(), &["export", "run", "--out", "arrays", "--json"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let about = std::fs::read_to_string(folder.path().join("arrays/about.json")).unwrap();
    let about: serde_json::Value = serde_json::from_str(&about).unwrap();
    let shape = |array: &str| about["files"]["frames.npz"][array]["shape"].clone();
    assert_eq!([shape("marked"), shape("there")], [serde_json::json!([4501, 2]), serde_json::json!([4501, 2])]);
    assert_eq!(shape("place"), serde_json::json!([4501, 2]));
    let reached: u64 =
        report(&run)["pursuits"].as_array().unwrap().iter().map(|of| of["reached"].as_u64().unwrap()).sum();
    assert_eq!(arrived as u64, reached);
    let output = adagio(folder.path(), &["replay", "run", "--verify", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let output = adagio(folder.path(), &["replay", "run", "--out", "again", "--quiet", "--no-report"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(report(&folder.path().join("again"))["digest"], report(&run)["digest"]);
}

#[test]
fn what_cannot_be_shown_is_refused_with_the_names_that_there_are() {
    let path = package_file("scenarios/shown.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    let refused = |set: &str, expected: &str| {
        let error = Scenario::parse(&text, &path, &[set.to_owned()]).unwrap_err().to_string();
        assert!(error.contains(expected), "{set}: {error}");
    };
    refused("show.0.task=\"center\"", "there are [\"centre\", \"corner\"]");
    refused("show.1.action=3004", "must be above 3008");
    refused("show.1.action=14995", "must be in [0, 14991]");
    refused("show.0.at=[9.0, 9.0]", "out of reach");
    refused("task.0.goal=\"here\"", "[x, y], or \"shown\"");
    let scenario = Scenario::parse(&text, &path, &[]).unwrap();
    for (task, kind) in [(0, MarkKind::Here), (1, MarkKind::Forget)] {
        let name = &scenario.tasks[task].name;
        let mark = parse_mark(&mark_text(name, kind), &scenario).unwrap();
        assert_eq!((mark.task, mark.kind), (task, kind));
    }
    let error = parse_mark("center", &scenario).unwrap_err();
    assert!(error.contains("center") && error.contains("centre, corner"), "{error}");
}
