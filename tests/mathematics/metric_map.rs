//! A map of the floor out of features and actions: a robot walks through a room, and what it knows are smooth functions of its pose.

use adagio::random::stream;
use adagio::value::{LocalOptions, MapStep, MetricMap, ValueError};
use faer::Mat;
use rand::RngExt;
use std::f64::consts::{PI, TAU};

const SIZE: [f64; 2] = [3.0, 2.0];
const MOVE: f64 = 0.3;

/// Poses of a random walk, and what each action did.
fn walk(actions: usize, seed: u64) -> (Vec<[f64; 3]>, Vec<Option<MapStep>>) {
    let mut rng = stream(seed, "walk");
    let (mut poses, mut steps) = (vec![[1.0, 1.0, 0.0]], Vec::new());
    for _ in 0..actions {
        let [x, y, heading]: [f64; 3] = poses[poses.len() - 1];
        let error = 1.0 + 0.05 * rng.random_range(-1.7..1.7);
        let (pose, step) = if rng.random_bool(0.5) {
            let turn = if rng.random_bool(0.5) { PI / 4.0 } else { -PI / 4.0 };
            ([x, y, heading + error * turn], MapStep { turn, distance: Some(0.0) })
        } else {
            let to = [x + error * MOVE * heading.cos(), y + error * MOVE * heading.sin()];
            let free = (0..2).all(|i| (0.0..=SIZE[i]).contains(&to[i]));
            let pose = if free { [to[0], to[1], heading] } else { [x, y, heading] };
            (pose, MapStep { turn: 0.0, distance: free.then_some(MOVE) })
        };
        poses.push(pose);
        steps.push(Some(step));
    }
    (poses, steps)
}

/// Products of cosines over the room with cosines and sines of the heading, white: what slow features of such a walk are like.
fn features(poses: &[[f64; 3]]) -> Mat<f64> {
    let mut rows: Vec<Vec<f64>> = vec![vec![1.0; poses.len()]];
    for (i, j, k) in (0..4).flat_map(|i| (0..4).flat_map(move |j| (0..3).map(move |k| (i, j, k)))) {
        let place =
            |[x, y, _]: [f64; 3]| (PI * f64::from(i) * x / SIZE[0]).cos() * (PI * f64::from(j) * y / SIZE[1]).cos();
        if i + j + k > 0 {
            rows.push(poses.iter().map(|&pose| place(pose) * (f64::from(k) * pose[2]).cos()).collect());
        }
        if k > 0 {
            rows.push(poses.iter().map(|&pose| place(pose) * (f64::from(k) * pose[2]).sin()).collect());
        }
    }
    for row in rows.iter_mut().skip(1) {
        let n = row.len() as f64;
        let mean = row.iter().sum::<f64>() / n;
        let deviation = (row.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / n).sqrt();
        row.iter_mut().for_each(|value| *value = (*value - mean) / deviation);
    }
    Mat::from_fn(rows.len(), poses.len(), |i, t| rows[i][t])
}

/// Root mean square distance between positions and true ones, after the best shift and rotation.
fn misses(found: &[[f64; 2]], poses: &[[f64; 3]]) -> f64 {
    let n = found.len() as f64;
    let mean = |of: &dyn Fn(usize) -> f64| (0..found.len()).map(of).sum::<f64>() / n;
    let (mx, my) = (mean(&|t| found[t][0]), mean(&|t| found[t][1]));
    let (tx, ty) = (mean(&|t| poses[t][0]), mean(&|t| poses[t][1]));
    let at = |t: usize| (found[t][0] - mx, found[t][1] - my, poses[t][0] - tx, poses[t][1] - ty);
    let (mut along, mut across) = (0.0, 0.0);
    for (a, b, x, y) in (0..found.len()).map(at) {
        along += a * x + b * y;
        across += a * y - b * x;
    }
    let (sin, cos) = across.atan2(along).sin_cos();
    let squared = |t: usize| {
        let (a, b, x, y) = at(t);
        (a * cos - b * sin - x).powi(2) + (a * sin + b * cos - y).powi(2)
    };
    mean(&squared).sqrt()
}

#[test]
fn positions_and_headings_follow_from_what_actions_do() {
    for seed in [1, 2] {
        let (poses, steps) = walk(4000, seed);
        let phi = features(&poses);
        let points = Mat::from_fn(phi.nrows() - 1, phi.ncols(), |i, t| phi[(i + 1, t)] as f32);
        let map = MetricMap::new(phi.as_ref(), points.as_ref(), &steps, LocalOptions::default()).unwrap().unwrap();
        let missed = misses(map.positions(), &poses);
        assert!(missed < 0.4 * MOVE, "seed {seed}: {missed} m");
        assert!(map.error() < 0.5, "seed {seed}: {}", map.error());
        // Headings are right up to a rotation.
        let off: Vec<f64> = (0..poses.len()).map(|t| map.headings()[t] - poses[t][2]).collect();
        let (sin, cos) = off.iter().fold((0.0, 0.0), |sum, off| (sum.0 + off.sin(), sum.1 + off.cos()));
        let length = f64::hypot(sin, cos) / off.len() as f64;
        assert!(length > 0.98, "seed {seed}: {length}");
    }
}

/// A map of a mirrored world turns the other way: it is told apart from this one by the turns alone.
#[test]
fn turns_say_which_side_is_left() {
    let (poses, steps) = walk(3000, 3);
    let phi = features(&poses);
    let points = Mat::from_fn(phi.nrows() - 1, phi.ncols(), |i, t| phi[(i + 1, t)] as f32);
    let mirrored: Vec<Option<MapStep>> =
        steps.iter().map(|step| step.map(|step| MapStep { turn: -step.turn, ..step })).collect();
    let of = |steps: &[Option<MapStep>]| {
        let map = MetricMap::new(phi.as_ref(), points.as_ref(), steps, LocalOptions::default()).unwrap().unwrap();
        misses(map.positions(), &poses)
    };
    let (right, wrong) = (of(&steps), of(&mirrored));
    assert!(right < 0.15 && wrong > 0.5, "{right} and {wrong}");
}

#[test]
fn without_moves_or_turns_there_is_no_map_and_odd_input_is_refused() {
    let (poses, steps) = walk(600, 4);
    let phi = features(&poses);
    let points = Mat::from_fn(phi.nrows() - 1, phi.ncols(), |i, t| phi[(i + 1, t)] as f32);
    let map = |steps: &[Option<MapStep>]| MetricMap::new(phi.as_ref(), points.as_ref(), steps, LocalOptions::default());
    let straight: Vec<Option<MapStep>> =
        steps.iter().map(|step| step.map(|step| MapStep { turn: 0.0, ..step })).collect();
    let still: Vec<Option<MapStep>> =
        steps.iter().map(|step| step.map(|step| MapStep { distance: None, ..step })).collect();
    for few in [straight, still, vec![None; 600]] {
        assert_eq!(map(&few), Ok(None));
    }
    assert!(matches!(map(&steps[1..]), Err(ValueError::Length { what: "the steps", found: 599, expected: 600 })));
    let mut odd = steps.clone();
    odd[7] = Some(MapStep { turn: f64::NAN, distance: None });
    assert!(map(&odd).unwrap_err().to_string().contains("turn"));
    let short = points.subcols(0, 600);
    assert!(MetricMap::new(phi.as_ref(), short, &steps, LocalOptions::default()).is_err());
    assert!(map(&steps).unwrap().is_some_and(|map| map.headings().iter().all(|heading| heading.abs() <= TAU)));
}
