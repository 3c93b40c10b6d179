//! Scenario files: all faults at once, each with its line, key, value and allowed range.

use std::fmt::Write as _;
use std::path::Path;

use crate::common::package_file;
use adagio::scenario::{Fault, Scenario, ScenarioError};

const ROOM: &str = "
[[world.wall]]
points = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.8], [0.0, 1.8]]
closed = true
";

const TASK: &str = "
[[task]]
name = \"centre\"
goal = [1.5, 0.9]
";

pub fn faults_of(text: &str, sets: &[&str]) -> Vec<Fault> {
    let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
    match Scenario::parse(text, Path::new("test.toml"), &sets) {
        Err(ScenarioError::Invalid { faults, .. }) => faults,
        Err(other) => panic!("{other}"),
        Ok(_) => Vec::new(),
    }
}

/// One fault is expected, at this key, with these parts in its text.
fn assert_fault(text: &str, sets: &[&str], key: &str, parts: &[&str]) {
    let faults = faults_of(text, sets);
    assert_eq!(faults.len(), 1, "{faults:?}");
    assert_eq!(faults[0].key, key);
    for part in parts {
        assert!(faults[0].text.contains(part), "{:?} lacks {part:?}", faults[0].text);
    }
}

#[test]
fn the_scenarios_that_come_along_are_valid_and_complete_files_mean_the_same() {
    for name in ["scenarios/lab.toml", "scenarios/smoke.toml", "scenarios/distractors.toml", "scenarios/goals.toml"] {
        let scenario = Scenario::load(&package_file(name), &[]).unwrap();
        let again = Scenario::parse(&scenario.text, Path::new("again.toml"), &[]).unwrap();
        assert_eq!(again, scenario, "{name}");
        assert_eq!(again.sha256(), scenario.sha256());
    }
}

#[test]
fn the_lab_is_the_one_of_the_thesis() {
    let lab = Scenario::load(&package_file("scenarios/lab.toml"), &[]).unwrap();
    assert_eq!(lab.value.gamma, 0.9);
    assert_eq!((lab.robot.radius, lab.robot.forward, lab.robot.turn_deg), (0.25, 0.30, 45.0));
    assert_eq!((lab.camera.width, lab.camera.height, lab.camera.field_of_view_deg), (320, 240, 66.0));
    assert_eq!((lab.vision.cut_rows, lab.vision.width, lab.vision.height), (80, 32, 16));
    assert!(lab.world.walls.iter().all(|wall| wall.height == 0.9));
    assert_eq!((lab.tasks[0].goal, lab.tasks[0].radius), (Some([1.5, 0.9]), 0.20));
    assert_eq!((lab.tasks[1].goal, lab.tasks[1].radius), (Some([2.4, 0.6]), 0.45));
    // All but its reward near walls, −1 within 0.5 m, which costs steps between walls (docs/tried.md).
    assert!(lab.tasks.iter().all(|task| (task.reward, task.wall_reward, task.wall_distance) == (1.0, -0.3, 0.3)));
    assert!(lab.actions <= 15_000);
}

#[test]
fn all_faults_are_reported_at_once_with_their_lines() {
    let text = "seed = -3
actoins = 10
[robot]
radius = \"wide\"
[dictionary]
nu = 0
budget = 5
[slow]
lambda = -1.0
[colour]
x = 1
[[world.wall]]
points = [[0.0, 0.0], [3.0, 0.0], [3.0, 1.8], [0.0, 1.8]]
closed = true
[[task]]
goal = [1.5]
radius = 0.0
";
    let found: Vec<(Option<usize>, String)> =
        faults_of(text, &[]).into_iter().map(|fault| (fault.line, fault.key)).collect();
    let expected = [
        (1, "seed"),
        (2, "actoins"),
        (4, "robot.radius"),
        (6, "dictionary.nu"),
        (7, "dictionary.budget"),
        (9, "slow.lambda"),
        (10, "colour"),
        (16, "task.0.goal"),
        (17, "task.0.radius"),
    ];
    let expected: Vec<_> = expected.iter().map(|&(line, key)| (Some(line), key.to_owned())).collect();
    assert_eq!(found, expected);
}

#[test]
fn a_fault_names_value_range_and_the_key_that_was_meant() {
    let room = format!("{ROOM}{TASK}");
    assert!(faults_of(&room, &[]).is_empty());
    assert_fault(&room, &["dictionary.nu=0"], "dictionary.nu", &["= 0 ", "(0, 0.999]"]);
    assert_fault(&room, &["dictionary.kernel=linear"], "dictionary.kernel", &["linear", "gaussian", "laplacian"]);
    assert_fault(&room, &["dictionary.bugdet=9"], "dictionary.bugdet", &["is not a key"]);
    assert_fault(&room, &["nonsense"], "nonsense", &["KEY=VALUE"]);
    let misspelt = format!("{room}[value]\ngama = 0.5\n");
    assert_fault(&misspelt, &[], "value.gama", &["did you mean gamma?"]);
    assert_fault(&room, &["value.gamma=1.0"], "value.gamma", &["= 1 ", "[0, 0.9999]"]);
    assert_fault(&room, &["robot.turn_deg=nan"], "robot.turn_deg", &["NaN", "(0, 180]"]);
    assert_fault(&room, &["world.texture_seed=-1"], "world.texture_seed", &["-1", "[0, 1000000]"]);
    let upside_down = format!("{room}[[world.distractor]]\npath = [[0.5, 0.5], [1.0, 1.0]]\nbottom = 2.0\n");
    assert_fault(&upside_down, &[], "world.distractor.0.bottom", &["= 2 ", "below top = 1.7"]);
}

#[test]
fn contradictions_are_reported_beside_other_faults_but_not_of_faulty_keys() {
    let text = format!("{ROOM}{TASK}");
    let sets =
        ["dictionary.nu=0", "dictionary.bogus=1", "slow.features=5000", "robot.radius=1.2", "task.0.goal=[0.0, 0.0]"];
    let keys: Vec<String> = faults_of(&text, &sets).into_iter().map(|fault| fault.key).collect();
    for key in ["dictionary.nu", "dictionary.bogus", "slow.features", "robot.start", "task.0.goal"] {
        assert!(keys.iter().any(|found| found == key), "{key} is not among {keys:?}");
    }
    assert_eq!(keys.len(), 5);
    // The budget itself is at fault: nothing is said of features against it.
    assert_fault(&text, &["dictionary.budget=-5", "slow.features=3000"], "dictionary.budget", &["-5"]);
}

#[test]
fn contradictions_are_faults() {
    let room = format!("{ROOM}{TASK}");
    assert_fault(
        &room,
        &["task.0.goal=[0.1, 0.9]", "task.0.radius=0.1"],
        "task.0.goal",
        &["in a wall or out of reach"],
    );
    assert_fault(
        &room,
        &["task.0.goal=[9.0, 0.9]"],
        "task.0.goal",
        &["[0.1, 0.9]".replace("0.1, 0.9", "9.0, 0.9").as_str()],
    );
    assert_fault(&room, &["task.0.radius=9.0"], "task.0.radius", &["= 9 m", "no start is left"]);
    assert_fault(&room, &["robot.radius=1.0"], "robot.start", &["0.900 m from a wall", "robot.radius = 1 m"]);
    assert_fault(&room, &["robot.start=[0.1, 0.9]"], "robot.start", &["0.100 m from a wall"]);
    assert_fault(&room, &["robot.start=[8.0, 0.9]"], "robot.start", &["not enclosed"]);
    assert_fault(&room.replace("closed = true", ""), &[], "robot.start", &["not enclosed"]);
    assert_fault(&room, &["vision.cut_rows=230"], "vision.cut_rows", &["leaves 10 of 240", "[0, 224]"]);
    assert!(faults_of(&room, &["camera.detail=vision"]).is_empty());
    assert_fault(
        &room,
        &["camera.detail=vision", "vision.width=100"],
        "camera.detail",
        &["400 × 64 samples", "320 × 160 pixels", "must be \"full\""],
    );
    assert_fault(&room, &["camera.detail=half"], "camera.detail", &["half", "\"full\" | \"vision\""]);
    assert_fault(&room, &["slow.features=3000"], "slow.features", &["[1, "]);
    assert_fault(
        &room,
        &["agent.latency_frames=9000"],
        "agent.latency_frames",
        &["not less than agent.resolve_frames"],
    );
    assert_fault(&room, &["dictionary.retained_frames=1"], "dictionary.retained_frames", &["at least 128"]);
    assert_fault(ROOM, &[], "task", &["at least one [[task]]"]);
    assert_fault(TASK, &[], "world.wall", &["at least one [[world.wall]]"]);
    assert_fault(&format!("{room}{TASK}"), &[], "task.1.name", &["unique"]);
    let image = room.replace("closed = true", "closed = true\nimage = \"none.png\"");
    assert_fault(&image, &[], "world.wall.0.image", &["none.png", "cannot be read"]);
}

/// A robot of another program, with these actions.
fn program(actions: &[&str], task: &str) -> String {
    let actions: String = actions.iter().map(|keys| format!("[[action]]\n{keys}\n")).collect();
    format!("robot.body = \"program\"\n{actions}[[task]]\nname = \"vest\"\n{task}\n")
}

#[test]
fn actions_of_another_program_have_names_and_inverses() {
    let rewarded = |actions: &[&str]| program(actions, "reward = \"topic\"");
    let [left, right] = ["name = \"left\"\ninverse = \"right\"", "name = \"right\"\nturn_deg = -45.0"];
    let scenario = Scenario::parse(&rewarded(&[left, right]), Path::new("test.toml"), &[]).unwrap();
    let actions: Vec<_> = scenario.robot.actions.iter().collect();
    assert_eq!(actions.len(), 2);
    assert_eq!(scenario.robot.actions.inverse(actions[0]), Some(actions[1]));
    assert_eq!(scenario.robot.actions.inverse(actions[1]), None);
    assert_fault(&rewarded(&[right, right]), &[], "action.1.name", &["\"right\"", "unique"]);
    assert_fault(&rewarded(&[right, "name = \"\""]), &[], "action.1.name", &["\"\"", "not empty"]);
    assert_fault(
        &rewarded(&[right, left, "inverse = \"back\""]),
        &[],
        "action.2.inverse",
        &["\"back\"", "right, left"],
    );
    assert!(faults_of(&rewarded(&[""; 32]), &[]).is_empty());
    assert_fault(&rewarded(&[""; 33]), &[], "action.32.name", &["one of 33", "at most 32"]);
    assert_fault(&rewarded(&["turn_deg = 400.0"]), &[], "action.0.turn_deg", &["400", "360"]);
    // A goal that is shown needs to know how far it is to it.
    let shown = |action| program(&[right, action], "goal = \"shown\"");
    assert!(faults_of(&shown("forward = 0.5"), &[]).is_empty());
    assert_fault(&shown("name = \"jump\""), &[], "action.1.forward", &["goals that are shown"]);
    // Of a robot that is ours, actions are known.
    let ours = format!("{ROOM}{TASK}[[action]]\n{right}\n");
    assert!(faults_of(&ours, &[]).iter().all(|fault| fault.text.contains("robot.body = \"program\"")));
    assert!(!faults_of(&ours, &[]).is_empty());
}

#[test]
fn a_building_of_three_rooms_tells_places_of_all_its_actions_unless_the_scenario_says_otherwise() {
    let building = |rooms: usize| {
        let room =
            |k: usize| format!("[[world.room]]\nname = \"room {k}\"\ncorners = [[{k}.0, 0.0], [{}.0, 4.0]]\n", k + 1);
        (0..rooms).map(room).collect::<String>() + TASK
    };
    let value = |rooms: usize, sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
        Scenario::parse(&building(rooms), Path::new("test.toml"), &sets).unwrap().value
    };
    let places = |rooms: usize, sets: &[&str]| value(rooms, sets).places;
    assert!(!places(2, &[]) && places(3, &[]) && places(4, &[]));
    assert!(places(2, &["value.places=true"]) && !places(3, &["value.places=false"]));
    let window = |rooms: usize, sets: &[&str]| value(rooms, sets).window;
    assert_eq!([100, 30_000, 200_000].map(|n| window(3, &[&format!("actions={n}")])), [20_000, 30_000, 100_000]);
    assert_eq!((window(2, &["actions=30000"]), window(3, &["actions=30000", "value.window=500"])), (20_000, 500));
}

#[test]
fn broken_toml_is_reported_with_its_line() {
    let faults = faults_of("seed = 1\n[robot\nradius = 0.2\n", &[]);
    assert!(faults.iter().any(|fault| fault.line == Some(2) && fault.text.contains("broken TOML")), "{faults:?}");
}

#[test]
fn an_image_file_can_paper_a_wall() {
    let folder = tempfile::tempdir().unwrap();
    let mut picture = image::RgbImage::new(4, 2);
    picture.pixels_mut().for_each(|pixel| pixel.0 = [10, 200, 30]);
    picture.save(folder.path().join("paper.png")).unwrap();
    let text = format!("{ROOM}image = \"paper.png\"\n{TASK}");
    std::fs::write(folder.path().join("room.toml"), &text).unwrap();
    let scenario = Scenario::load(&folder.path().join("room.toml"), &[]).unwrap();
    let world = adagio::world::World::new(&scenario).unwrap();
    let pose = adagio::robot::Pose::new(nalgebra::Point2::new(1.0, 0.9), 0.0);
    let seen = world.appearance.camera(0).render(&pose);
    let middle = 3 * (seen.width * (seen.height / 2) + seen.width / 2);
    assert_eq!(seen.rgb[middle..middle + 3], [10, 200, 30]);
    // The complete file names the picture by its absolute path, so it can be read from anywhere.
    let again = Scenario::parse(&scenario.text, Path::new("elsewhere/again.toml"), &[]).unwrap();
    assert_eq!(again.world.walls[0].texture.image, scenario.world.walls[0].texture.image);
}

/// In docs/scenario.md everything below this line is made by [`reference`]; what is above is written by hand.
const REFERENCE: &str =
    "<!-- Everything below is made from the keys: ADAGIO_BLESS=1 cargo test --release --test agent reference -->\n";

/// Robots that take velocities, and one that another program drives.
const OTHER_BODIES: [&str; 3] = [
    "robot.body = \"dynamic\"\n[[world.room]]\ncorners = [[0, 0], [3, 2]]\n[[world.movable]]\nat = [0.5, 0.5]\n[[task]]\n",
    "robot.body = \"ros2\"\n[[world.room]]\ncorners = [[0, 0], [3, 2]]\n[[task]]\n",
    "robot.body = \"program\"\n[[action]]\n[[task]]\nreward = \"topic\"\n",
];

/// The titles of a text's sections.
fn titles(text: &str) -> impl Iterator<Item = &str> {
    text.lines()
        .filter(|line| line.starts_with('['))
        .map(|line| line.split_once("  # ").map_or(line, |(title, _)| title))
}

/// A scenario with every kind of section, each with the keys alone that it needs.
const EVERYTHING: &str = "
[[world.room]]
corners = [[0.0, 0.0], [3.0, 1.8]]
[[world.wall]]
points = [[1.0, 0.0], [1.1, 0.0]]
[[world.pyramid]]
[[world.distractor]]
path = [[1.0, 1.0], [2.0, 1.0]]
[[change]]
kind = \"light\"
[[change]]
kind = \"wall\"
[[change]]
kind = \"goal\"
[[change]]
kind = \"freeze\"
[[change]]
kind = \"lose\"
[[task]]
[[task]]
goal = \"shown\"
[[task]]
reward = \"topic\"
[[task]]
avoid = \"shown\"
[[show]]
task = \"task 2\"
";

/// The reference of all keys in Markdown: a table for each section of a complete scenario.
fn reference() -> String {
    let missing = faults_of("[[world.room]]\n[[world.wall]]\n[[world.distractor]]\n", &[]);
    let is_required = |key: &str| missing.iter().any(|fault| fault.key.rsplit('.').next() == Some(key));
    let written = |text: &str| Scenario::parse(text, Path::new("FILE.toml"), &[]).unwrap().text;
    let mut all = written(EVERYTHING);
    // What only other bodies have.
    let known: Vec<String> = titles(&all).map(str::to_owned).collect();
    for body in OTHER_BODIES {
        let other = written(body);
        let new =
            other.split("\n\n").filter(|section| titles(section).any(|title| !known.iter().any(|of| of == title)));
        for section in new.filter(|section| !all.contains(*section)).collect::<Vec<_>>() {
            all = format!("{}\n\n{section}", all.trim_end());
        }
    }
    let written = all;
    let mut out = String::new();
    // The top of the file has no title; its keys come first.
    for section in format!("\nTop of the file\n{written}").split("\n\n") {
        let (head, keys) = section.trim_start().split_once('\n').unwrap();
        let (title, doc) = head.split_once("  # ").unwrap_or((head, ""));
        let mut title = if title.starts_with('[') { format!("`{title}`") } else { title.to_owned() };
        // The other sides of a room have the same keys.
        if ["east", "north", "west"].iter().any(|side| title == format!("`[world.room.{side}]`")) {
            continue;
        }
        let rows: Vec<(&str, &str, &str)> = keys
            .lines()
            .map(|line| {
                let (setting, meaning) = line.split_once(" # ").unwrap();
                let (key, value) = setting.trim_end().split_once(" = ").unwrap();
                (key, value, meaning)
            })
            .collect();
        let tells = |row: &&(&str, &str, &str)| row.0 == "kind" || ["\"shown\"", "\"topic\""].contains(&row.1);
        if let Some((key, value, _)) = rows.iter().find(tells) {
            let _ = write!(title, " with `{key} = {value}`");
        }
        let _ = writeln!(out, "\n## {title}\n");
        if !doc.is_empty() {
            let _ = writeln!(out, "{doc}\n");
        }
        let _ = writeln!(out, "| key | default | unit, allowed values: meaning |\n|---|---|---|");
        for (key, value, meaning) in rows {
            let value = if is_required(key) { "required".to_owned() } else { format!("`{value}`") };
            let _ = writeln!(out, "| `{key}` | {value} | {} |", meaning.replace('|', "\\|"));
        }
    }
    out
}

#[test]
fn the_reference_in_the_docs_is_what_the_keys_say() {
    let path = package_file("docs/scenario.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let (head, stands) = page.split_once(REFERENCE).unwrap();
    let reference = reference();
    if std::env::var("ADAGIO_BLESS").is_ok_and(|value| value == "1") {
        std::fs::write(&path, format!("{head}{REFERENCE}{reference}")).unwrap();
        return;
    }
    let differs = reference.lines().zip(stands.lines().chain([""])).find(|(made, stands)| made != stands);
    assert!(
        stands == reference,
        "docs/scenario.md is not what the keys say, first at {differs:?}: write it again with ADAGIO_BLESS=1 (see CONTRIBUTING.md)"
    );
}

#[test]
fn keys_with_their_old_names_mean_the_same_and_are_noted() {
    let text = format!("[policy]\nexplore_leg = 7\nexplore_actions = 6_000\n[agent]\nkeep_minutes = 3.0\n{ROOM}{TASK}");
    let sets = ["world.papers=2".to_owned()];
    let old = Scenario::parse(&text, Path::new("old.toml"), &sets).unwrap();
    let text = text.replace("explore_leg", "explore_length").replace("keep_minutes", "snapshot_minutes");
    let text = text.replace("explore_actions = 6_000", "explore_share = 0.4");
    let new = Scenario::parse(&text, Path::new("old.toml"), &["world.texture_seed=2".to_owned()]).unwrap();
    assert_eq!((old.text, old.policy, old.agent, old.world), (new.text, new.policy, new.agent, new.world));
    let noted = [
        "world.papers is now called world.texture_seed",
        "policy.explore_actions (line 3) is now called policy.explore_share",
        "policy.explore_leg (line 2) is now called policy.explore_length",
        "agent.keep_minutes (line 5) is now called agent.snapshot_minutes",
    ];
    assert_eq!((old.notes, new.notes), (noted.map(str::to_owned).to_vec(), Vec::new()));
    // Both names at once are a fault, and faults of a value name the key as it is called now.
    let both = format!("[policy]\nexplore_leg = 7\nexplore_length = 7\n{ROOM}{TASK}");
    assert_fault(&both, &[], "policy.explore_leg", &["is not a key of this section"]);
    let wrong = format!("[policy]\nexplore_leg = 0\n{ROOM}{TASK}");
    assert_fault(&wrong, &[], "policy.explore_length", &["0", "[1, 1000000]"]);
    let wrong = format!("[policy]\nexplore_actions = 0.5\n{ROOM}{TASK}");
    assert_fault(&wrong, &[], "policy.explore_share", &["0.5", "a whole number"]);
    let never = Scenario::parse(&wrong.replace("0.5", "20_000"), Path::new("old.toml"), &[]).unwrap();
    assert_eq!(never.policy.explore_share, 1.0);
}
