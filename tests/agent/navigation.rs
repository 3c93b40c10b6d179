//! What the agent learns in a short run: the lab's goals, and a small goal off the centre that least squares over smooth
//! features miss.

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
    let fixed = ["run", "world.toml", "--quiet", "--no-report", "--out", "run", "--set", "evaluate.every=0"];
    let output = adagio(folder.path(), &[&fixed, arguments].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    report(&folder.path().join("run"))
}

/// The first gate is 99 % of 1000 starts with quality 0.8 at the end of a run; this is a third of one with 200 starts, so 98 % are
/// asked for. Over linear values the small goal has a quality of 0.4 after a whole run (docs/navigation.md).
#[test]
fn in_the_lab_all_goals_are_reached_after_five_thousand_actions() {
    let found = run(&lab(), &["--seed", "21", "--actions", "5000", "--set", "evaluate.starts=200"]);
    for task in found["tasks"].as_array().unwrap() {
        let (success, quality) = (task["success"].as_f64().unwrap(), task["convergence_quality"].as_f64().unwrap());
        assert!(success >= 0.98, "{}: {success}", task["name"]);
        assert!(quality >= 0.8, "{}: {quality}", task["name"]);
    }
}
