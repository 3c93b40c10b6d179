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
        Sensor::new(&scenario, 0.2, stream(seed, "test")).expose(&mut exposed);
        assert_ne!(exposed, clean);
        let seen = observe(&exposed, &scenario.vision, 0);
        let worst = seen.pixels.iter().zip(&target.pixels).map(|(&a, &b)| a.abs_diff(b)).max().unwrap();
        assert!(worst <= 4, "seed {seed}: {worst} grey levels");
    }
}

/// Observations from many poses through a camera of each detail, without sensor errors.
fn seen_in_both_details(poses: &[Pose]) -> [Vec<Vec<u8>>; 2] {
    ["full", "vision"].map(|detail| {
        let (scenario, world) = lab(&[&format!("camera.detail={detail}")]);
        poses.iter().map(|pose| observe(&world.camera.render(pose), &scenario.vision, 0).pixels).collect()
    })
}

#[test]
fn what_vision_needs_has_the_geometry_of_the_full_image() {
    let (scenario, world) = lab(&["camera.detail=vision"]);
    let image = world.camera.render(&Pose::new(Point2::new(1.0, 0.7), 1.0));
    assert_eq!((image.width, image.height, image.cropped), (128, 64, true));
    assert_eq!(scenario.camera.rendered(&scenario.vision), (128, 64));
    let poses: Vec<Pose> = (0..400)
        .map(|i| {
            let share = |step: f64| (f64::from(i) * step).fract();
            Pose::new(
                Point2::new(0.3 + 2.4 * share(0.618), 0.3 + 1.2 * share(0.414)),
                std::f64::consts::TAU * share(0.732),
            )
        })
        .collect();
    let [full, vision] = seen_in_both_details(&poses);
    let mut square = 0.0;
    let mut means = vec![0.0; full[0].len()];
    for (a, b) in full.iter().flatten().zip(vision.iter().flatten()).map(|(&a, &b)| (f64::from(a), f64::from(b))) {
        square += (a - b).powi(2);
    }
    for (a, b) in full.iter().zip(&vision) {
        for (mean, (&a, &b)) in means.iter_mut().zip(a.iter().zip(b)) {
            *mean += (f64::from(a) - f64::from(b)) / poses.len() as f64;
        }
    }
    let root_mean_square = (square / (poses.len() * means.len()) as f64).sqrt();
    let bias = means.iter().map(|mean| mean.abs()).fold(0.0, f64::max);
    let (a, b) = (&full[7], &full[8]);
    let other = a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>() / a.len() as f64;
    println!("rms {root_mean_square}, bias {bias}, between poses {}", other.sqrt());
    assert!(root_mean_square < 2.5, "{root_mean_square} grey levels");
    assert!(bias < 0.6, "{bias} grey levels");
}

#[test]
fn what_vision_needs_has_the_noise_and_exposure_of_the_full_image() {
    // Strong noise, so that rounding of observations does not hide it; brightness is not corrected, to see the exposure.
    let pose = Pose::new(Point2::new(1.0, 0.7), 1.0);
    let n = 300;
    let run = |detail: &str, keys: &[&str]| -> Vec<Vec<f64>> {
        let mut sets = vec!["vision.brightness=0"];
        let detail = format!("camera.detail={detail}");
        sets.push(&detail);
        sets.extend(keys);
        let (scenario, world) = lab(&sets);
        let clean = world.camera.render(&pose);
        let mut sensor = Sensor::new(&scenario, 0.2, stream(5, "test"));
        (0..n)
            .map(|_| {
                let mut image = clean.clone();
                sensor.expose(&mut image);
                observe(&image, &scenario.vision, 0).pixels.into_iter().map(f64::from).collect()
            })
            .collect()
    };
    let variance = |seen: &[Vec<f64>]| {
        let values = seen[0].len();
        let of = |i: usize| {
            let mean = seen.iter().map(|x| x[i]).sum::<f64>() / n as f64;
            seen.iter().map(|x| (x[i] - mean).powi(2)).sum::<f64>() / (n - 1) as f64
        };
        (0..values).map(of).sum::<f64>() / values as f64
    };
    let noisy = ["camera.pixel_noise=12", "camera.exposure_drift=0"];
    let (full, vision) = (variance(&run("full", &noisy)), variance(&run("vision", &noisy)));
    // Pixels of σ = 12 in areas of 100, and two roundings.
    let expected = (144.0 + 1.0 / 12.0) / 100.0 + 1.0 / 12.0;
    // 300 × 1536 values: the variance is known within 0.2 % (one standard deviation).
    println!("{full} {vision} {expected}");
    assert!((full / expected - 1.0).abs() < 0.01, "full: {full}, expected {expected}");
    assert!((vision / full - 1.0).abs() < 0.01, "vision: {vision}, full: {full}");
    // Exposure is drawn from the same numbers: gains agree frame by frame.
    let quiet = ["camera.pixel_noise=0"];
    let gains = |seen: &[Vec<f64>]| -> Vec<f64> { seen.iter().map(|x| x.iter().sum::<f64>()).collect() };
    let (full, vision) = (gains(&run("full", &quiet)), gains(&run("vision", &quiet)));
    for (a, b) in full.iter().zip(&vision) {
        assert!((a / full[0] - b / vision[0]).abs() < 2e-3, "{} and {}", a / full[0], b / vision[0]);
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
