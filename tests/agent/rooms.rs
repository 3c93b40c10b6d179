//! Worlds of several rooms: their floor, what stops a robot and what it sees, and how far it is from one room to the other.

use std::f64::consts::TAU;
use std::path::Path;
use std::sync::Arc;

use crate::common::{adagio, package_file, report, stderr};
use crate::scenario::faults_of;
use adagio::evaluate::OptimalSteps;
use adagio::robot::Pose;
use adagio::scenario::Scenario;
use adagio::world::World;
use nalgebra::{Point2, Vector2};
use proptest::prelude::*;

fn two_rooms(sets: &[&str]) -> (Arc<Scenario>, World) {
    let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
    let scenario = Scenario::load(&package_file("scenarios/two_rooms.toml"), &sets).unwrap();
    let world = World::new(&scenario).unwrap();
    (Arc::new(scenario), world)
}

/// Up to three rectangles on a grid of 0.5 m, each overlapping or touching the one before or not, a start in the first, and
/// another one far away that no room joins.
fn rooms_strategy() -> impl Strategy<Value = Vec<[i32; 4]>> {
    let first = (0..4i32, 0..4i32, 3..8i32, 3..8i32);
    let other = (-4..8i32, -4..8i32, 2..8i32, 2..8i32);
    (first, prop::collection::vec(other, 0..4)).prop_map(|(first, others)| {
        std::iter::once(first).chain(others).map(|(x, y, width, depth)| [x, y, x + width, y + depth]).collect()
    })
}

fn text_of(rooms: &[[i32; 4]]) -> String {
    let room = |[x0, y0, x1, y1]: &[i32; 4]| {
        let half = |value: &i32| f64::from(*value) / 2.0;
        format!(
            "[[world.room]]\ncorners = [[{:?}, {:?}], [{:?}, {:?}]]\nheight = 0.9\npattern = \"plain\"\nhue = 0.0\n",
            half(x0),
            half(y0),
            half(x1),
            half(y1)
        )
    };
    let [x0, y0, x1, y1] = rooms[0].map(f64::from);
    let start = [(x0 + x1) / 4.0, (y0 + y1) / 4.0];
    let mut text: String = rooms.iter().map(room).collect();
    text += &format!("[robot]\nstart = {start:?}\nradius = 0.1\n[world.floor]\npattern = \"plain\"\nhue = 120.0\n");
    text += "[world.surroundings]\npattern = \"plain\"\nhue = 240.0\n";
    text + &format!("[[task]]\ngoal = {start:?}\nradius = 0.05\n")
}

/// How far it is from a point to the end of the floor: in steps of a millimetre over the rectangles alone.
fn marched(rooms: &[[i32; 4]], from: Point2<f64>, direction: Vector2<f64>) -> f64 {
    let inside = |p: Point2<f64>| {
        rooms.iter().any(|room| {
            let [x0, y0, x1, y1] = room.map(|value| f64::from(value) / 2.0);
            (x0..=x1).contains(&p.x) && (y0..=y1).contains(&p.y)
        })
    };
    let step = 1e-3;
    (0..).map(|i| step * f64::from(i)).find(|&way| !inside(from + direction * way)).unwrap()
}

/// Whether a ray passes a corner of a room within a millimetre.
fn grazes(rooms: &[[i32; 4]], from: Point2<f64>, direction: Vector2<f64>) -> bool {
    let corners = rooms.iter().flat_map(|&[x0, y0, x1, y1]| [(x0, y0), (x0, y1), (x1, y0), (x1, y1)]);
    let mut to = corners.map(|(x, y)| Vector2::new(f64::from(x), f64::from(y)) / 2.0 - from.coords);
    to.any(|to| to.dot(&direction) > 0.0 && to.perp(&direction).abs() < 1e-3)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Sonar and camera meet the first wall where the floor ends, in every direction: nothing stands inside, nothing is open.
    #[test]
    fn rays_end_where_the_floor_ends(rooms in rooms_strategy(), angle in 0.0..TAU) {
        let text = text_of(&rooms);
        let sets = ["camera.width=33".to_owned(), "camera.height=33".to_owned(), "vision.cut_rows=0".to_owned()];
        // Rooms out of reach are faults of their own: those without them are what is looked at here.
        let Ok(scenario) = Scenario::parse(&text, Path::new("rooms.toml"), &sets) else { return Ok(()) };
        let world = World::new(&scenario).unwrap();
        let start = Point2::from(scenario.robot.start);
        for turn in 0..16 {
            let heading = angle + TAU / 16.0 * f64::from(turn);
            let pose = Pose::new(start, heading);
            // Of a ray that cuts a corner by less than a step, marching sees nothing.
            if grazes(&rooms, start, pose.direction()) {
                continue;
            }
            let way = marched(&rooms, start, pose.direction());
            let heard = world.arena.range(start, pose.direction(), 100.0);
            prop_assert!((heard - way).abs() < 3e-3, "{rooms:?} at {heading}: sonar {heard}, floor {way}");
            // Lens at 0.5 m: the wall's foot is seen at a slope of 0.5 / way, floor (green) below, wall (red) above.
            let image = world.appearance.camera(0).render(&pose);
            let focal = 16.5 / 33f64.to_radians().tan();
            for row in 17..33usize {
                let depth = 0.5 * focal / (row as f64 + 0.5 - 16.5);
                let at = 3 * (33 * row + 16);
                let pixel = &image.rgb[at..at + 3];
                let is_floor = pixel[1] > pixel[0];
                if (depth - way).abs() > 0.02 * way.max(0.5) {
                    prop_assert_eq!(is_floor, depth < way, "row {}: {} m deep, wall at {} m", row, depth, way);
                }
            }
        }
    }

    /// A robot that drives blindly never leaves the floor.
    #[test]
    fn no_robot_gets_through_a_wall(rooms in rooms_strategy(), headings in prop::collection::vec(0.0..TAU, 1..40)) {
        let Ok(scenario) = Scenario::parse(&text_of(&rooms), Path::new("rooms.toml"), &[]) else { return Ok(()) };
        let world = World::new(&scenario).unwrap();
        let mut place = Point2::from(scenario.robot.start);
        for heading in headings {
            let direction = Pose::new(place, heading).direction();
            let (moved, _) = world.arena.sweep(place, direction * 0.7, scenario.robot.radius);
            place += moved;
            let clearance = world.plan.clearance(place);
            prop_assert!(clearance > scenario.robot.radius - 1e-4, "{rooms:?}: {clearance} m at {place}");
            prop_assert!(marched(&rooms, place, Vector2::x()) > 0.0, "{rooms:?}: outside at {place}");
        }
    }
}

#[test]
fn crossing_the_two_rooms_takes_45_moves() {
    let (scenario, world) = two_rooms(&[]);
    let (low, high) = world.plan.walls_box();
    let length = high.x - low.x - 2.0 * scenario.robot.radius;
    assert!((length / scenario.robot.forward - 45.0).abs() < 1e-6, "{length} m");
    assert_eq!((scenario.robot.radius, scenario.robot.forward, scenario.robot.turn_deg), (0.25, 0.30, 45.0));
    // From the west wall straight east, onto a goal that begins at the 45th move.
    let mut task = scenario.tasks[0].clone();
    (task.goal, task.radius) = (Some([13.75, 2.75]), 0.1);
    let start = Pose::new(Point2::new(0.25, 2.75), 0.0);
    let within = |most| OptimalSteps::new(&world.arena, &scenario.robot, &task, &[], most).from(start);
    assert_eq!((within(100), within(44)), (Some(45), None));
}

#[test]
fn the_optimal_way_around_a_corner_is_the_counted_one() {
    let (scenario, world) = two_rooms(&[]);
    let steps = |from: [f64; 2], degrees: f64, goal: [f64; 2]| {
        let task = adagio::scenario::Task { goal: Some(goal), radius: 0.16, ..scenario.tasks[0].clone() };
        let start = Pose::new(from.into(), f64::to_radians(degrees));
        OptimalSteps::new(&world.arena, &scenario.robot, &task, &[], 100).from(start)
    };
    // Through the corridor, 20 moves of 0.30 m along its axis.
    assert_eq!(steps([4.0, 2.75], 0.0, [10.1, 2.75]), Some(20));
    // Facing away, four turns before that.
    assert_eq!(steps([4.0, 2.75], 180.0, [10.1, 2.75]), Some(24));
    // 3.0 m east and 1.8 m north: 4 moves east, a turn, and 1.8·√2 m north-east, of which the goal's radius leaves 2.39 m, 8
    // moves.
    assert_eq!(steps([8.6, 2.75], 0.0, [11.6, 4.55]), Some(13));
    // The wall between corridor and court's corner is not crossed: straight on there would be 3 moves.
    let through = steps([7.0, 2.75], 90.0, [7.0, 3.9]);
    assert_eq!(through, None);
}

#[test]
fn rewards_know_the_walls_of_all_rooms() {
    let (scenario, world) = two_rooms(&[]);
    let reward = |x: f64, y: f64| world.plan.reward(&scenario.tasks[0], Point2::new(x, y));
    let wall = scenario.tasks[0].wall_reward;
    assert_eq!(reward(2.75, 2.75), 0.0);
    // In the doorway there is no wall; the corridor's sides are walls, of which the corners stick out.
    assert_eq!((reward(5.5, 2.75), reward(5.5, 2.4)), (0.0, wall));
    assert_eq!((reward(7.0, 2.75), reward(7.0, 2.44)), (0.0, wall));
    assert_eq!((reward(5.25, 1.0), reward(0.29, 2.0)), (wall, wall));
    let [x, y] = scenario.tasks[0].goal.unwrap();
    assert_eq!(reward(x, y), 1.0);
}

#[test]
fn all_faults_of_rooms_are_reported_at_once() {
    let text = "
[[world.room]]
name = \"hall\"
corners = [[0.0, 0.0], [3.0]]
[[world.room]]
name = \"hall\"
corners = [[3.0, 0.0], [3.0, 2.0]]
height = -1.0
[[world.room]]
colour = 1
[world.room.east]
pattern = \"marble\"
[[world.room]]
corners = [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]
[[world.pyramid]]
side = 0.0
[[task]]
goal = [1.5, 0.9]
";
    let faults = faults_of(text, &[]);
    let found: Vec<(Option<usize>, &str)> = faults.iter().map(|fault| (fault.line, fault.key.as_str())).collect();
    let expected = [
        (None, "world.room.2.corners"),
        (Some(4), "world.room.0.corners"),
        (Some(6), "world.room.1.name"),
        (Some(7), "world.room.1.corners"),
        (Some(8), "world.room.1.height"),
        (Some(10), "world.room.2.colour"),
        (Some(12), "world.room.2.east.pattern"),
        (Some(14), "world.room.3.corners"),
        (Some(16), "world.pyramid.0.side"),
    ];
    let mut found = found;
    found.sort();
    assert_eq!(found, expected);
    let text_at = |key: &str| faults.iter().find(|fault| fault.key == key).unwrap().text.clone();
    assert!(text_at("world.room.1.corners").contains("0 m × 2 m"), "{}", text_at("world.room.1.corners"));
    assert!(text_at("world.room.3.corners").contains("two opposite corners"));
    assert!(text_at("world.room.2.east.pattern").contains("\"reliefs\""));
}

#[test]
fn rooms_without_a_way_and_pyramids_within_walls_are_faults() {
    let room = |low: [f64; 2], high: [f64; 2]| format!("[[world.room]]\ncorners = [{low:?}, {high:?}]\n");
    let task = "[[task]]\ngoal = [1.5, 0.9]\n";
    let good = room([0.0, 0.0], [3.0, 1.8]) + task;
    assert_eq!(faults_of(&good, &[]), []);
    // A room apart, and one behind a door that is as wide as the robot.
    for (text, expected) in [
        (room([0.0, 0.0], [3.0, 1.8]) + &room([4.0, 0.0], [5.0, 1.8]), "world.room.1.corners"),
        (room([0.0, 0.0], [3.0, 1.8]) + &room([3.0, 1.4], [5.0, 3.0]), "world.room.1.corners"),
    ] {
        let faults = faults_of(&(text + task), &[]);
        assert_eq!(faults.len(), 1, "{faults:?}");
        assert_eq!((faults[0].key.as_str(), faults[0].line), (expected, Some(4)));
        assert!(faults[0].text.contains("out of reach") && faults[0].text.contains("0.5 m"), "{}", faults[0].text);
    }
    let near = good.clone() + "[[world.pyramid]]\ncentre = [8.0, 1.0]\nside = 10.0\n";
    let faults = faults_of(&near, &[]);
    assert!(faults.len() == 1 && faults[0].key == "world.pyramid.0.centre", "{faults:?}");
    assert!(faults[0].text.contains("5.0 m") && faults[0].text.contains("7.1 m"), "{}", faults[0].text);
    assert_eq!(faults_of(&near, &["world.pyramid.0.centre=[11.0, 1.0]"]), []);
}

#[test]
fn each_side_of_a_room_can_be_papered_by_itself_and_anew() {
    let text = "
[[world.room]]
corners = [[0.0, 0.0], [4.0, 4.0]]
pattern = \"plain\"
hue = 0.0
[world.room.north]
hue = 240.0
[robot]
start = [2.0, 2.0]
[[change]]
action = 10
kind = \"wall\"
wall = 1
pattern = \"plain\"
hue = 120.0
[[task]]
goal = [1.0, 1.0]
";
    let scenario = Scenario::parse(text, Path::new("one.toml"), &[]).unwrap();
    // The complete file means the same.
    let again = Scenario::parse(&scenario.text, Path::new("one.toml"), &[]).unwrap();
    assert_eq!(again, scenario);
    let world = World::new(&scenario).unwrap();
    let seen = |degrees: f64, frame: u64| {
        let image = world.appearance.camera(frame).render(&Pose::new(Point2::new(2.0, 2.0), degrees.to_radians()));
        let at = 3 * (image.width * (image.height / 2) + image.width / 2);
        (0..3).max_by_key(|&channel| image.rgb[at + channel]).unwrap()
    };
    // South, east, north, west: red but for the blue north; later the east is green.
    assert_eq!([-90.0, 0.0, 90.0, 180.0].map(|degrees| seen(degrees, 0)), [0, 0, 2, 0]);
    assert_eq!([-90.0, 0.0, 90.0, 180.0].map(|degrees| seen(degrees, 1000)), [0, 1, 2, 0]);
}

#[test]
fn pyramids_stand_above_the_courts_wall_where_they_are() {
    let keys = ["world.surroundings.pattern=plain", "world.surroundings.hue=240", "world.pyramid.0.hue=0"];
    let (scenario, world) = two_rooms(&keys);
    let pyramid = &scenario.world.pyramids[0];
    let from = Point2::new(11.25, 2.75);
    let to = Point2::from(pyramid.centre) - from;
    let image = world.appearance.camera(0).render(&Pose::new(from, to.y.atan2(to.x)));
    let focal = 160.0 / 33f64.to_radians().tan();
    let channel = |row: usize| {
        let at = 3 * (image.width * row + image.width / 2);
        (0..3).max_by_key(|&channel| image.rgb[at + channel]).unwrap()
    };
    // Its top, seen from 0.5 m above the floor.
    let top = 120.0 - focal * (pyramid.height - scenario.camera.mount_height) / to.norm();
    assert_eq!((channel(top as usize - 3), channel(top as usize + 3)), (2, 0));
    // From within the temple's corner no wall is low enough.
    let hidden = world.appearance.camera(0).render(&Pose::new(Point2::new(2.0, 4.0), 2.0));
    assert!(hidden.rgb.chunks(3).take(320 * 100).all(|pixel| !(pixel[2] > pixel[0] && pixel[2] > 140)));
}

#[test]
fn the_scenarios_of_several_rooms_are_valid_and_run() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["two_rooms", "l_shape", "pillars", "four_rooms", "wall_gap", "plain", "doors", "apartment", "office"] {
        let path = package_file(&format!("scenarios/{name}.toml"));
        let scenario = Scenario::load(&path, &[]).unwrap();
        let again = Scenario::parse(&scenario.text, Path::new("again.toml"), &[]).unwrap();
        assert_eq!(again, scenario, "{name}");
        if name == "office" {
            // The shortest ways to ten goals on 300 m² take minutes to find, and most are longer than those below.
            continue;
        }
        // Seconds of the real thing: everything happens, little is learned.
        let sets = [
            "policy.explore_share=0.5",
            "policy.forward_probability=0.7",
            "dictionary.budget=150",
            "dictionary.sigma_frames=200",
            "slow.features=40",
            "agent.resolve_frames=500",
            "agent.latency_frames=100",
            "evaluate.starts=5",
            "evaluate.max_steps=60",
            "evaluate.decode_train=100",
            "evaluate.decode_test=50",
            "evaluate.every=0",
            "camera.detail=vision",
        ];
        let mut arguments = vec!["run", path.to_str().unwrap(), "--quiet", "--actions", "300", "--out", name];
        let with_report = name == "two_rooms";
        arguments.extend((!with_report).then_some("--no-report"));
        sets.iter().for_each(|set| arguments.extend(["--set", set]));
        let output = adagio(folder.path(), &arguments);
        assert!(output.status.success(), "{name}: {}", stderr(&output));
        let report = report(&folder.path().join(name));
        let tasks = report["tasks"].as_array().unwrap();
        assert_eq!(tasks.len(), scenario.tasks.len());
        for task in tasks {
            let optimal = task["optimal_mean_steps"].as_f64().unwrap();
            assert!(optimal > 1.0 && optimal < 60.0, "{name}: {task}");
        }
        assert_eq!(folder.path().join(name).join("report.html").exists(), with_report);
    }
}
