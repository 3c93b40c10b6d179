//! What the agent learns in a short run: the lab's goals, a small goal off the centre that least squares over smooth features
//! miss, and the way from one room through a corridor into another.

use std::sync::{Arc, Mutex};

use adagio::cli::export::model_of;
use adagio::evaluate::Evaluator;
use adagio::export::Model;
use adagio::policy::Pilot;
use adagio::world::World;

use crate::common::{adagio, package_file, report, stderr};
use serde_json::Value;

/// The lab with a third goal, off the centre and no larger than a step of the robot.
fn lab() -> String {
    let lab = std::fs::read_to_string(package_file("scenarios/lab.toml")).unwrap();
    lab + "\n[[task]]\nname = \"small\"\ngoal = [2.1, 0.9]\nradius = 0.20\n"
}

fn run(text: &str, arguments: &[&str]) -> Value {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("world.toml"), text).unwrap();
    let fixed = [
        "run",
        "world.toml",
        "--quiet",
        "--no-report",
        "--out",
        "run",
        "--set",
        "evaluate.every=0",
        "--set",
        "camera.detail=vision",
    ];
    let output = adagio(folder.path(), &[&fixed, arguments].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    report(&folder.path().join("run"))
}

/// The first gate is 99 % of 1000 starts with quality 0.8 at the end of a run; this is a third of one with 200 starts, so 98 % are
/// asked for. Over linear values small goals off the centre are missed (docs/tried.md).
#[test]
fn in_the_lab_all_goals_are_reached_after_five_thousand_actions() {
    let found = run(&lab(), &["--seed", "21", "--actions", "5000", "--set", "evaluate.starts=200"]);
    for task in found["tasks"].as_array().unwrap() {
        let (success, quality) = (task["success"].as_f64().unwrap(), task["convergence_quality"].as_f64().unwrap());
        assert!(success >= 0.98, "{}: {success}", task["name"]);
        assert!(quality >= 0.8, "{}: {quality}", task["name"]);
        // What it takes is about what was expected; that counts penalties near walls as a longer way, so it may be more.
        let (expected, taken) = (task["expected_steps"].as_f64().unwrap(), task["mean_steps"].as_f64().unwrap());
        assert!(
            taken / expected > 0.6 && taken / expected < 1.2,
            "{}: {taken} where {expected} were expected",
            task["name"]
        );
    }
}

/// The thesis's two rooms at half their size: the same texture_seed, goals in both, a corridor of 1.4 m between them.
const TWO_ROOMS: [&str; 20] = [
    "--set",
    "world.room.0.corners=[[0.0,0.0],[2.8,2.8]]",
    "--set",
    "world.room.1.corners=[[4.2,0.0],[7.0,2.8]]",
    "--set",
    "world.room.2.corners=[[2.8,0.8],[4.2,2.0]]",
    "--set",
    "robot.start=[1.4,1.4]",
    "--set",
    "task.0.goal=[0.8,2.0]",
    "--set",
    "task.1.goal=[6.2,0.8]",
    "--set",
    "dictionary.budget=2000",
    "--set",
    "dictionary.sigma_share=0.65",
    "--set",
    "dictionary.sigma_frames=1000",
    "--set",
    "slow.features=200",
];

/// The first gate of two rooms, 90 % with quality 0.7, asked of a smaller world, a seventh of the run and its only model. Half of the
/// starts are in the other room; the reference policy, which drives straight at the goal, reaches about 60 %.
#[test]
fn from_one_room_the_goal_in_the_other_is_reached() {
    let two_rooms = std::fs::read_to_string(package_file("scenarios/two_rooms.toml")).unwrap();
    let short = ["--seed", "22", "--actions", "8000", "--set", "policy.explore_share=1"];
    let models = ["--set", "agent.resolve_frames=20000", "--set", "agent.latency_frames=2000"];
    let found = run(&two_rooms, &[&short[..], &TWO_ROOMS, &models, &["--set", "evaluate.starts=60"]].concat());
    for task in found["tasks"].as_array().unwrap() {
        let (success, quality) = (task["success"].as_f64().unwrap(), task["convergence_quality"].as_f64().unwrap());
        let reference = task["reference_success"].as_f64().unwrap();
        assert!(reference < 0.8, "{}: {reference} by driving straight at it", task["name"]);
        assert!(success >= 0.9, "{}: {success}", task["name"]);
        assert!(quality >= 0.7, "{}: {quality}", task["name"]);
    }
}

/// Who acts on what was learned takes the very ways of trials, with a belief about where it is.
#[test]
fn a_pilot_goes_the_ways_of_trials() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("world.toml"), lab()).unwrap();
    let command = ["run", "world.toml", "--quiet", "--no-report", "--actions", "1500", "--out", "run"];
    let places = ["--set", "value.places=true", "--set", "value.odometry=false", "--set", "evaluate.starts=1"];
    let output = adagio(folder.path(), &[&command[..], &places].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    let Ok(Model { learned, scenario, .. }) = model_of(&folder.path().join("run")) else { panic!("no model") };
    let (scenario, starts) = (Arc::new(scenario), 20);
    let world = Arc::new(World::new(&scenario).unwrap());
    let evaluator = Evaluator::new(scenario.clone(), world, starts, 5);
    let ways = evaluator.evaluate_and_show(&learned, false);
    for (task, (result, trips)) in ways.into_iter().enumerate() {
        let pilots: Vec<Mutex<Pilot>> = (0..starts).map(|_| Mutex::new(Pilot::new(&scenario, task))).collect();
        let found = evaluator.trips(task, true, &|situation| {
            let (seen, blocked) = (situation.seen.unwrap(), situation.recent.blocked.is_some());
            pilots[situation.trial].lock().unwrap().act(&learned, seen, blocked, None).unwrap()
        });
        assert!(result.success > 0.5, "{}: {}", result.name, result.success);
        assert_eq!(found, trips, "{}", result.name);
    }
}
