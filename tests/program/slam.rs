//! The pose graph of the experiment `slam`: known optima, and those that GTSAM finds.

use adagio::experiment::slam::chart::{Chart, alignment, rms};
use adagio::random::stream;
use adagio::robot;
use adagio::value::place::{Factor, Pose, PoseGraph};
use rand::RngExt;
use serde_json::{Value, json};

use crate::common::python;

fn pose(x: f64, y: f64, heading: f64) -> Pose {
    Pose { x, y, heading }
}

fn factor(from: usize, to: usize, measured: Pose) -> Factor {
    Factor { from, to, measured, sigmas: [0.1, 0.1, 0.05], cauchy: None }
}

/// How far two poses are from each other at most, in metres or radians.
fn apart(a: &Pose, b: &Pose) -> f64 {
    let apart = a.seen_from(b);
    apart.x.abs().max(apart.y.abs()).max(apart.heading.abs())
}

#[test]
fn a_loop_without_noise_is_recovered_from_a_perturbed_start() {
    let mut rng = stream(1, "loop");
    let mut poses = vec![Pose::default()];
    for step in 1..40 {
        let turn = if step % 5 == 0 { 1.2 } else { 0.02 };
        poses.push(poses[step - 1].then(&pose(0.3 * rng.random_range(0.5..1.0), 0.05, turn)));
    }
    let factors = (0..39).map(|i| (i, i + 1)).chain([(0, 39), (3, 30), (10, 22)]);
    let factors: Vec<Factor> = factors.map(|(i, j)| factor(i, j, poses[j].seen_from(&poses[i]))).collect();
    let mut off = |by: f64| rng.random_range(-by..by);
    let start =
        poses.iter().enumerate().map(|(i, of)| if i == 0 { *of } else { of.then(&pose(off(0.2), off(0.2), off(0.2))) });
    let mut graph = PoseGraph::new(start.collect(), factors).unwrap();
    let found = graph.optimise(100, 1e-12).unwrap();
    assert!(found.converged && found.cost < 1e-18, "{found:?}");
    for (found, truth) in graph.poses().iter().zip(&poses) {
        assert!(apart(found, truth) < 1e-9, "{found:?} {truth:?}");
    }
}

#[test]
fn the_error_of_a_loop_is_shared_by_its_factors() {
    // Along a line each step measures 1 m, and the last node is seen 3.3 m ahead of the first: each of the four takes 0.3 m / 4.
    let steps = (0..3).map(|i| factor(i, i + 1, pose(1.0, 0.0, 0.0)));
    let factors = steps.chain([factor(0, 3, pose(3.3, 0.0, 0.0))]).collect();
    let mut graph = PoseGraph::new((0..4).map(|i| pose(f64::from(i), 0.0, 0.0)).collect(), factors).unwrap();
    let found = graph.optimise(50, 1e-13).unwrap();
    for (i, of) in graph.poses().iter().enumerate() {
        assert!(apart(of, &pose(1.075 * i as f64, 0.0, 0.0)) < 1e-9, "{of:?}");
    }
    assert!((found.cost - 4.0 * (0.075f64 / 0.1).powi(2)).abs() < 1e-9, "{found:?}");

    // Turns on the spot that do not add up to a full one: 4 × 87° leave 12°, and each takes a quarter of it.
    let turn = |degrees: f64| pose(0.0, 0.0, degrees.to_radians());
    let factors: Vec<Factor> = (0..4).map(|i| factor(i, (i + 1) % 4, turn(87.0))).collect();
    let mut graph = PoseGraph::new((0..4).map(|i| turn(87.0 * f64::from(i))).collect(), factors).unwrap();
    let found = graph.optimise(50, 1e-13).unwrap();
    for (i, of) in graph.poses().iter().enumerate() {
        assert!(apart(of, &turn(90.0 * i as f64)) < 1e-9, "{of:?}");
    }
    assert!((found.cost - 4.0 * (3f64.to_radians() / 0.05).powi(2)).abs() < 1e-9, "{found:?}");
}

#[test]
fn a_wrong_closure_counts_little_by_cauchy_and_much_without() {
    let truth: Vec<Pose> = (0..30).map(|i| pose(0.3 * f64::from(i), 0.0, 0.0)).collect();
    let closed = |cauchy: Option<f64>| {
        let steps = (0..29).map(|i| factor(i, i + 1, pose(0.3, 0.0, 0.0)));
        let wrong = Factor { cauchy, ..factor(2, 25, Pose::default()) };
        let mut graph = PoseGraph::new(truth.clone(), steps.chain([wrong]).collect()).unwrap();
        graph.optimise(100, 1e-10).unwrap();
        graph.poses().iter().zip(&truth).map(|(a, b)| apart(a, b)).fold(0.0, f64::max)
    };
    let (robust, plain) = (closed(Some(1.0)), closed(None));
    assert!(robust < 0.05 && plain > 2.0, "{robust} {plain}");
}

#[test]
fn alike_views_close_what_odometry_leaves_open() {
    // A robot drives round and round on a square, and what it sees is as smooth as its pose.
    let mut rng = stream(3, "rounds");
    let mut off = |by: f64| rng.random_range(-by..by);
    let (mut poses, mut odometry) = (vec![Pose::default()], vec![Pose::default()]);
    for t in 0..1600 {
        // Small detours, so that rounds are not alike to the last digit.
        let step = if t % 5 == 4 { pose(0.0, 0.0, 90f64.to_radians()) } else { pose(0.3, off(0.02), off(0.01)) };
        poses.push(poses[t].then(&step));
        // The wheels say that each turn is a degree too small.
        let turn = if t % 5 == 4 { 89f64.to_radians() } else { step.heading };
        odometry.push(odometry[t].then(&Pose { heading: turn, ..step }));
        if t % 20 == 19 {
            // Back to where the first round began, as if a wall had set it right.
            let round = t + 1;
            let back = poses[0].seen_from(&poses[round]);
            poses[round] = poses[0];
            odometry[round] = odometry[round].then(&back);
        }
    }
    let seen = |pose: &Pose| {
        let parts = [pose.x, pose.y, 2.0 * pose.heading.cos(), 2.0 * pose.heading.sin()];
        let bumps = (0..48).map(|k| {
            (parts.iter().enumerate().map(|(i, x)| x * (1.3 * f64::from(k) + 2.1 * i as f64).sin()).sum::<f64>()).cos()
        });
        let norm = bumps.clone().map(|x| x * x).sum::<f64>().sqrt();
        bumps.map(|x| (x / norm) as f32).collect::<Vec<f32>>()
    };
    let columns: Vec<Vec<f32>> = poses.iter().map(seen).collect();
    let thumbnails = faer::Mat::from_fn(48, columns.len(), |i, j| columns[j][i]);
    let of_robot = |poses: &[Pose]| poses.iter().map(|&pose| pose.into()).collect::<Vec<robot::Pose>>();
    let (poses, odometry) = (of_robot(&poses), of_robot(&odometry));
    let error = |chart: &Chart| {
        let aligned = alignment(&chart.poses, &poses);
        rms(chart.poses.iter().map(|pose| aligned.then(pose)).zip(poses.iter().copied()))
    };
    let (alone, closed) =
        (Chart::reckoned(&odometry), Chart::new(thumbnails.as_ref(), &odometry, 0.02, faer::Par::Seq).unwrap());
    let ((open, _), (distance, angle)) = (error(&alone), error(&closed));
    assert!(
        open > 0.4 && distance < 0.1 && angle < 5.0,
        "{open} {distance} {angle}, {} closures",
        closed.closures.len()
    );
}

#[test]
fn a_rigid_motion_is_found_from_what_it_moves() {
    let motion = robot::Pose::from(pose(0.7, -1.1, 2.5));
    let poses: Vec<robot::Pose> = (0..9).map(|i| pose(f64::from(i), f64::from(i * i) * 0.1, 0.3).into()).collect();
    let moved: Vec<robot::Pose> = poses.iter().map(|pose| motion.then(pose)).collect();
    assert!(apart(&alignment(&poses, &moved).into(), &motion.into()) < 1e-12);
    assert!(rms(poses.iter().map(|pose| motion.then(pose)).zip(moved.iter().copied())).0 < 1e-12);
}

#[test]
fn impossible_graphs_are_refused() {
    let two = || vec![Pose::default(); 2];
    for wrong in [factor(0, 2, Pose::default()), factor(1, 1, Pose::default())] {
        let error = PoseGraph::new(two(), vec![wrong]).unwrap_err().to_string();
        assert!(error.starts_with("factor 0 joins"), "{error}");
    }
    let flat = Factor { sigmas: [0.1, 0.0, 0.1], ..factor(0, 1, Pose::default()) };
    assert!(
        PoseGraph::new(two(), vec![flat]).is_err() && PoseGraph::new(vec![pose(f64::NAN, 0.0, 0.0)], vec![]).is_err()
    );
    // Two pairs that nothing ties to each other: each has its optimum.
    let pairs = vec![factor(0, 1, pose(1.0, 0.0, 0.3)), factor(2, 3, pose(1.0, 0.0, -0.3))];
    let mut apart = PoseGraph::new(vec![Pose::default(); 4], pairs).unwrap();
    assert!(apart.optimise(50, 1e-9).unwrap().cost < 1e-12);
    let mut loose = PoseGraph::new(vec![Pose::default(); 3], vec![factor(0, 1, pose(1.0, 0.0, 0.0))]).unwrap();
    assert!(loose.optimise(10, 1e-9).unwrap_err().to_string().contains("3 nodes and 1 factors"));
}

#[test]
fn gtsam_finds_the_same_optimum() {
    let mut rng = stream(7, "graph");
    let mut off = |by: f64| rng.random_range(-by..by);
    let mut poses = vec![Pose::default()];
    for i in 1..100 {
        let turn = if i % 8 == 0 { std::f64::consts::FRAC_PI_2 } else { 0.0 };
        poses.push(poses[i - 1].then(&pose(0.3, 0.0, turn)));
    }
    let mut noisy = |from: usize, to: usize, sigmas: [f64; 3], cauchy: Option<f64>| {
        let [x, y, heading] = sigmas.map(&mut off);
        Factor { from, to, measured: poses[to].seen_from(&poses[from]).then(&pose(x, y, heading)), sigmas, cauchy }
    };
    let mut factors: Vec<Factor> = (0..99).map(|i| noisy(i, i + 1, [0.02, 0.01, 0.03], None)).collect();
    factors.extend((0..68).step_by(3).map(|i| noisy(i, i + 32, [0.1, 0.12, 0.08], Some(1.0))));
    // One that is wrong.
    factors.push(Factor { measured: pose(0.5, 0.5, 0.3), ..noisy(5, 50, [0.1; 3], Some(1.0)) });
    let mut start = vec![Pose::default()];
    factors[..99].iter().for_each(|step| start.push(start[step.from].then(&step.measured)));

    let numbers = |pose: &Pose| [pose.x, pose.y, pose.heading];
    let told = json!({
        "poses": start.iter().map(numbers).collect::<Vec<_>>(),
        "factors": factors.iter().map(|f| json!([f.from, f.to, numbers(&f.measured), f.sigmas, f.cauchy])).collect::<Vec<_>>(),
    });
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("graph.json");
    std::fs::write(&path, told.to_string()).unwrap();
    let Some(printed) = python("pose_graph.py", &[path.to_str().unwrap()]) else { return };
    let theirs: Value = serde_json::from_str(&printed).unwrap();

    let mut graph = PoseGraph::new(start, factors).unwrap();
    let found = graph.optimise(200, 1e-10).unwrap();
    assert!(found.converged, "{found:?}");
    // GTSAM's error is half of the sum.
    let error = theirs["error"].as_f64().unwrap();
    assert!((0.5 * found.cost - error).abs() < 1e-6 * error, "{found:?} {error}");
    for (ours, theirs) in graph.poses().iter().zip(theirs["poses"].as_array().unwrap()) {
        let at = |i: usize| theirs[i].as_f64().unwrap();
        assert!(apart(ours, &pose(at(0), at(1), at(2))) < 1e-6, "{ours:?} {theirs}");
    }
}
