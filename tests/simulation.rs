//! The simulated world: actions, walls, rewards, the camera, and the optimal number of steps.

mod common;

use std::sync::Arc;

use adagio::policy::optimal_steps;
use adagio::random::stream;
use adagio::scenario::Scenario;
use adagio::source::{Frame, Simulated, Source};
use adagio::vision::observe;
use adagio::world::{Action, Pose, Robot, Sensor, World};
use common::package_file;
use nalgebra::Point2;

fn lab(sets: &[&str]) -> (Arc<Scenario>, Arc<World>) {
    let sets: Vec<String> = sets.iter().map(|&set| set.to_owned()).collect();
    let scenario = Arc::new(Scenario::load(&package_file("scenarios/lab.toml"), &sets).unwrap());
    let world = Arc::new(World::new(&scenario).unwrap());
    (scenario, world)
}

fn frames(source: &mut dyn Source, actions: &[Action]) -> Vec<Frame> {
    let mut frames = vec![source.first()];
    for &action in actions {
        source.execute(action, &mut |frame| {
            frames.push(frame);
            true
        });
    }
    frames
}

#[test]
fn the_same_seed_gives_the_same_frames_and_another_seed_others() {
    let actions = [Action::Forward, Action::TurnLeft, Action::Forward, Action::TurnRight];
    let run = |seed: &str| {
        let (scenario, world) = lab(&[seed]);
        frames(&mut Simulated::new(scenario, world), &actions)
    };
    let (one, again, other) = (run("seed=1"), run("seed=1"), run("seed=2"));
    assert_eq!(one.len(), 21);
    for (a, b) in one.iter().zip(&again) {
        assert_eq!((&a.image, a.pose, &a.sonar, a.stamp_ns), (&b.image, b.pose, &b.sonar, b.stamp_ns));
    }
    assert_ne!(one[20].pose, other[20].pose);
    assert!(one.windows(2).all(|pair| pair[1].number == pair[0].number + 1));
    let boundaries: Vec<u64> = one.iter().filter(|f| f.boundary.is_some()).map(|f| f.number).collect();
    assert_eq!(boundaries, [0, 5, 10, 15, 20]);
}

#[test]
fn actions_have_their_length_and_angle_on_average_and_scatter() {
    let (scenario, world) = lab(&[]);
    let start = Pose::new(Point2::new(1.5, 0.9), 0.0);
    let mut robot = Robot::new(&scenario.robot, start, stream(7, "test"));
    let n = 2000.0;
    let (mut length, mut angle, mut square) = (0.0, 0.0, 0.0);
    for _ in 0..2000 {
        for (action, sum) in [(Action::Forward, &mut length), (Action::TurnLeft, &mut angle)] {
            robot.pose = start;
            let motion = robot.draw(action);
            for _ in 0..scenario.robot.frames_per_action {
                assert!(!robot.drive(motion, &world.arena));
            }
            let moved = (robot.pose.position - start.position).norm();
            *sum += if action == Action::Forward { moved } else { robot.pose.heading.to_degrees() };
            if action == Action::Forward {
                square += (moved - 0.3).powi(2);
            }
        }
    }
    assert!((length / n - 0.30).abs() < 0.002, "mean length {}", length / n);
    assert!((angle / n - 45.0).abs() < 0.3, "mean angle {}", angle / n);
    let deviation = (square / n).sqrt();
    assert!((deviation - 0.015).abs() < 0.002, "5 % of 0.30 m: {deviation}");
}

#[test]
fn walls_stop_the_robot_at_its_radius() {
    let (scenario, world) = lab(&["robot.start_heading_deg=90"]);
    let frames = frames(&mut Simulated::new(scenario, world), &[Action::Forward; 4]);
    let last = frames.last().unwrap();
    assert!(last.boundary.as_ref().unwrap().blocked);
    // 1.8 m less the radius of 0.25 m, and the skin of a millimetre.
    assert!((last.pose.position.y - 1.549).abs() < 2e-3, "{}", last.pose.position);
    assert!((last.sonar[0] - 0.25).abs() < 0.06, "sonar ahead: {}", last.sonar[0]);
    assert!(!frames[5].boundary.as_ref().unwrap().blocked);
}

#[test]
fn rewards_are_those_of_the_thesis() {
    let (scenario, world) = lab(&[]);
    let reward = |task: usize, x: f64, y: f64| world.reward(&scenario.tasks[task], Point2::new(x, y));
    assert_eq!(reward(0, 1.5, 0.9), 1.0);
    assert_eq!(reward(0, 1.69, 0.9), 1.0);
    assert_eq!(reward(0, 1.71, 0.9), 0.0);
    assert_eq!(reward(0, 1.5, 0.49), -1.0);
    assert_eq!(reward(0, 1.5, 0.51), 0.0);
    // Inside the goal, near a wall: the goal counts.
    assert_eq!(reward(1, 2.4, 0.3), 1.0);
    assert_eq!(reward(1, 0.4, 0.9), -1.0);
}

#[test]
fn the_camera_sees_floor_below_walls_below_surroundings_in_perspective() {
    let (_, world) = lab(&[
        "world.floor.pattern=plain",
        "world.floor.hue=120",
        "world.surroundings.pattern=plain",
        "world.surroundings.hue=240",
        "world.wall.1.pattern=plain",
        "world.wall.1.hue=0",
    ]);
    // 1.5 m in front of the wall at x = 3, lens 0.5 m above the floor.
    let image = world.camera.render(&Pose::new(Point2::new(1.5, 0.9), 0.0));
    let focal = 160.0 / 33f64.to_radians().tan();
    let column = image.width / 2;
    let colour = |row: usize| {
        let at = 3 * (row * image.width + column);
        let pixel = &image.rgb[at..at + 3];
        (0..3).max_by_key(|&channel| pixel[channel]).unwrap()
    };
    // Rows where the wall's upper edge (0.4 m above the lens) and its foot (0.5 m below) are seen.
    let top = 120.0 - focal * 0.4 / 1.5;
    let foot = 120.0 + focal * 0.5 / 1.5;
    for (row, expected) in
        [(top as usize - 2, 2), (top as usize + 2, 0), (foot as usize - 2, 0), (foot as usize + 2, 1)]
    {
        assert_eq!(colour(row), expected, "row {row}");
    }
}

#[test]
fn exposure_and_noise_change_pixels_and_vision_undoes_most_of_it() {
    let (scenario, world) = lab(&[]);
    let clean = world.camera.render(&Pose::new(Point2::new(1.0, 0.7), 1.0));
    let target = observe(&clean, &scenario.vision, 0);
    for seed in 0..20 {
        let mut exposed = clean.clone();
        Sensor::new(&scenario.camera, 0.2, stream(seed, "test")).expose(&mut exposed);
        assert_ne!(exposed, clean);
        let seen = observe(&exposed, &scenario.vision, 0);
        let worst = seen.pixels.iter().zip(&target.pixels).map(|(&a, &b)| a.abs_diff(b)).max().unwrap();
        assert!(worst <= 4, "seed {seed}: {worst} grey levels");
    }
}

#[test]
fn the_optimal_number_of_steps_is_that_of_simple_cases() {
    let (scenario, world) = lab(&[]);
    let steps = |x: f64, y: f64, degrees: f64| {
        let start = Pose::new(Point2::new(x, y), f64::to_radians(degrees));
        optimal_steps(&world.arena, &scenario.robot, &scenario.tasks[0], start, 50)
    };
    assert_eq!(steps(1.5, 0.9, 0.0), Some(0));
    // 0.7 m ahead: the goal begins 0.2 m before its centre.
    assert_eq!(steps(0.8, 0.9, 0.0), Some(2));
    assert_eq!(steps(0.8, 0.9, 90.0), Some(4));
    assert_eq!(steps(0.8, 0.9, 180.0), Some(6));
    let far = Pose::new(Point2::new(0.3, 0.3), 0.0);
    assert_eq!(optimal_steps(&world.arena, &scenario.robot, &scenario.tasks[0], far, 1), None);
}
