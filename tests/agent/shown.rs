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
const SHORT: [&str; 11] = [
    "dictionary.sigma_frames=500",
    "agent.resolve_frames=1000",
    "agent.latency_frames=100",
    "actions=900",
    "show.0.action=400",
    "show.1.action=420",
    "dictionary.budget=400",
    "policy.explore_actions=430",
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
    let short = "--seed 41 --actions 5000 --set world.texture_seed=77 --set evaluate.every=0 --set evaluate.starts=200";
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

#[test]
fn marks_are_in_the_log_and_a_replay_has_them_again() {
    let folder = tempfile::tempdir().unwrap();
    let sets: Vec<&str> = SHORT.iter().flat_map(|set| ["--set", set]).collect();
    let run = run_of(folder.path(), "run", &sets);
    let file = std::fs::File::open(run.join("run_000.mcap")).unwrap();
    let (mut marks, mut arrived) = (Vec::new(), 0);
    for record in adagio::log::LogReader::new(file, "run_000.mcap") {
        let record = record.unwrap();
        let adagio::log::Record::Message { topic, .. } = &record else { continue };
        match &**topic {
            "/adagio/mark" => marks.push(record.decode::<adagio::log::messages::Text>().unwrap().data),
            "/adagio/pursuit" => {
                arrived += usize::from(record.decode::<adagio::log::messages::PursuitEnded>().unwrap().arrived);
            }
            _ => {}
        }
    }
    // 8 headings of 5 frames.
    assert_eq!(marks.iter().filter(|mark| *mark == "centre").count(), 40);
    assert_eq!(marks.iter().filter(|mark| *mark == "corner").count(), 40);
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
    for (task, kind) in [(0, MarkKind::Goal), (1, MarkKind::Forget)] {
        let name = &scenario.tasks[task].name;
        let mark = parse_mark(&mark_text(name, kind), &scenario.tasks).unwrap();
        assert_eq!((mark.task, mark.kind), (task, kind));
    }
    let error = parse_mark("center", &scenario.tasks).unwrap_err();
    assert!(error.contains("center") && error.contains("centre, corner"), "{error}");
}
