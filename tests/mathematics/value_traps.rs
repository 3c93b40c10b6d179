//! Values that are right where a newcomer's data are not like ours: far from the origin, of any scale, of actions never tried.

use adagio::random::stream;
use adagio::value::{
    FiniteMdp, Fit, Instances, Local, LocalBatch, LocalOptions, LocalOutcomes, Lspi, LspiOptions, Outcomes, Policy,
    Samples, Successor, ValueError, greedy,
};
use faer::{Mat, Par};
use rand::RngExt;

/// Steps to the right and to the left on a unit square, and how good the greedy policy of local values is there.
struct Square {
    from: Mat<f64>,
    to: Mat<f64>,
    counts: Vec<usize>,
    rewards: Vec<f64>,
}

const STEP: f64 = 0.1;
const MOVES: [[f64; 2]; 4] = [[STEP, 0.0], [-STEP, 0.0], [0.0, STEP], [0.0, -STEP]];
const GOAL: [f64; 2] = [0.8, 0.8];

fn moved([x, y]: [f64; 2], action: usize) -> [f64; 2] {
    [x + MOVES[action][0], y + MOVES[action][1]].map(|value: f64| value.clamp(0.0, 1.0))
}

fn at_goal([x, y]: [f64; 2]) -> bool {
    (x - GOAL[0]).hypot(y - GOAL[1]) < 0.15
}

impl Square {
    fn new(seed: u64) -> Self {
        let mut rng = stream(seed, "square");
        let each = 300;
        let mut place = |_| [rng.random_range(0.0..1.0), rng.random_range(0.0..1.0)];
        let from: Vec<[f64; 2]> = (0..4 * each).map(&mut place).collect();
        let to: Vec<[f64; 2]> = (0..4 * each).map(|t| moved(from[t], t / each)).collect();
        let rewards = to.iter().map(|&place| f64::from(u8::from(at_goal(place)))).collect();
        let matrix = |points: &[[f64; 2]]| Mat::from_fn(2, points.len(), |i, j| points[j][i]);
        Square { from: matrix(&from), to: matrix(&to), counts: vec![each; 4], rewards }
    }

    /// The share of 100 starts from which the greedy policy arrives, where points are `offset + scale · place`.
    fn success(&self, offset: f64, scale: f64, neighbours: usize) -> f64 {
        let seen = |points: &Mat<f64>| {
            Mat::from_fn(points.nrows(), points.ncols(), |i, j| ((offset + points[(i, j)]) * scale) as f32)
        };
        let options = LocalOptions { neighbours, ridge: 0.1 };
        let instances = Instances::new(seen(&self.from), self.counts.clone(), options).unwrap();
        let local = Local::new(&instances, seen(&self.to).as_ref()).unwrap();
        let n = self.rewards.len();
        let outcomes = LocalOutcomes {
            rewards: &self.rewards,
            allowed: &vec![15; n],
            ended: &vec![false; n],
            bounded: &vec![false; n],
        };
        let fit = local.fit(&outcomes, 0.9).unwrap();
        let worth: Vec<f64> = (0..n).map(|i| fit.weights[(i, 0)]).collect();
        let arrives = |start: usize| {
            let mut place = [(start % 10) as f64 / 10.0 + 0.05, (start / 10) as f64 / 10.0 + 0.05];
            for _ in 0..40 {
                if at_goal(place) {
                    return true;
                }
                let point = seen(&Mat::from_fn(2, 1, |i, _| place[i]));
                let q = &instances.action_values(&[&worth], point.as_ref()).unwrap()[0];
                place = moved(place, greedy((0..4).map(|a| q[(a, 0)])));
            }
            at_goal(place)
        };
        (0..100).filter(|&start| arrives(start)).count() as f64 / 100.0
    }
}

#[test]
fn local_values_do_not_depend_on_where_points_lie_nor_on_their_scale() {
    for seed in 1..4 {
        let square = Square::new(seed);
        assert!(square.success(0.0, 1.0, 8) >= 0.99);
        // At 10 000, f32 still holds a thousandth of the square.
        for (offset, scale) in [(1e3, 1.0), (-1e4, 1.0), (0.0, 1e30), (0.0, 1e-30), (1e3, 1e-30), (-1e3, 1e30)] {
            let success = square.success(offset, scale, 8);
            assert!(success >= 0.99, "seed {seed}, moved by {offset}, times {scale}: {success}");
        }
    }
}

/// Two such squares, far from each other compared with their size: the mean of all points is near neither.
#[test]
fn local_values_know_two_worlds_that_are_far_from_each_other() {
    for seed in 1..4 {
        let square = Square::new(seed);
        let n = square.rewards.len();
        let far = [-3e4, 2e4];
        // By action, and by world for each action.
        let world = |t: usize| t % 2;
        let seen = |points: &Mat<f64>| Mat::from_fn(2, 2 * n, |i, t| (points[(i, t / 2)] + far[world(t)]) as f32);
        let options = LocalOptions { neighbours: 8, ridge: 0.1 };
        let counts = square.counts.iter().map(|count| 2 * count).collect();
        let instances = Instances::new(seen(&square.from), counts, options).unwrap();
        let worth: Vec<f64> = (0..2 * n).map(|t| square.from[(0, t / 2)] + square.from[(1, t / 2)]).collect();
        for (x, y) in [(0.3, 0.7), (0.5, 0.5), (0.9, 0.2)] {
            for far in far {
                let point = Mat::from_fn(2, 1, |i, _| ([x, y][i] + far) as f32);
                let q = &instances.action_values(&[&worth], point.as_ref()).unwrap()[0];
                for a in 0..4 {
                    // f32 holds 0.002 of a place there.
                    assert!((q[(a, 0)] - (x + y)).abs() < 0.03, "({x}, {y}) at {far}: {}", q[(a, 0)]);
                }
            }
        }
    }
}

#[test]
fn more_neighbours_than_there_are_are_all_of_them() {
    let square = Square::new(1);
    assert_eq!(square.success(0.0, 1.0, usize::MAX), square.success(0.0, 1.0, 300));
}

/// Ten places in a row, one step to the left or right at a time, and cosines over them.
fn corridor(goal: usize, cosines: usize) -> (FiniteMdp, Mat<f64>) {
    let to = |s: usize, a: usize| if a == 0 { s.saturating_sub(1) } else { (s + 1).min(9) };
    let after = |s, a| {
        let state = to(s, a);
        vec![Successor { state, probability: 1.0, reward: f64::from(u8::from(state == goal)) }]
    };
    let wave = |i: usize, s: usize| (std::f64::consts::PI * i as f64 * (s as f64 + 0.5) / 10.0).cos();
    (FiniteMdp::new(10, 2, 0.9, after).unwrap(), Mat::from_fn(cosines, 10, wave))
}

fn fitted(process: &FiniteMdp, basis: &Mat<f64>, options: &LspiOptions) -> (Fit, f64) {
    let fit = process.expected(basis.as_ref(), |_, _| 1.0).unwrap().fit(options).unwrap();
    let arrival = process.arrival(&fit.policy(basis.as_ref()).unwrap(), 20).unwrap();
    let least = arrival.into_iter().fold(1.0, f64::min);
    (fit, least)
}

#[test]
fn the_default_arrives_in_a_corridor_where_the_plain_iteration_runs_in_circles() {
    let mut circles = 0;
    for goal in 0..10 {
        for cosines in 3..8 {
            let (process, basis) = corridor(goal, cosines);
            let (plain, plain_arrives) = fitted(&process, &basis, &LspiOptions::plain());
            // What runs in circles is not called converged.
            assert!(plain.converged != plain.cycle.is_some());
            let (fit, arrives) = fitted(&process, &basis, &LspiOptions::default());
            if plain.cycle.is_some() && arrives == 1.0 {
                circles += 1;
                assert!(fit.converged && plain_arrives < 1.0, "goal {goal}, {cosines} cosines");
            }
            if cosines >= 5 && plain_arrives == 1.0 {
                assert_eq!(arrives, 1.0, "goal {goal}, {cosines} cosines: mixing loses what plain iteration finds");
            }
        }
    }
    assert!(circles >= 10, "{circles} of 50");
}

#[test]
fn arrival_is_that_of_the_policy_that_is_followed() {
    let (process, _) = corridor(9, 3);
    let right = Policy::deterministic(&[1; 10], 2).unwrap();
    assert_eq!(process.arrival(&right, 9).unwrap(), [1.0; 10]);
    assert_eq!(process.arrival(&right, 3).unwrap(), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
    // To and from between two places: converged by any measure of weights, and never there.
    let circling = Policy::deterministic(&[1, 0, 0, 0, 0, 0, 0, 0, 0, 0], 2).unwrap();
    assert_eq!(process.arrival(&circling, 1000).unwrap(), [0.0; 10]);
}

#[test]
fn an_action_that_was_never_tried_is_not_worth_more_than_bad_ones() {
    // Every step costs 1; action 2 was never tried.
    let places = 12;
    let n = 2 * places;
    let place = |t: usize| (t % places) as f64 / places as f64;
    let to = |t: usize| if t < places { (place(t) + 0.1).min(1.0) } else { (place(t) - 0.1).max(0.0) };
    let actions: Vec<usize> = (0..n).map(|t| t / places).collect();
    let (rewards, weights) = (vec![-1.0; n], vec![1.0; n]);

    let features = |x: &dyn Fn(usize) -> f64| Mat::from_fn(3, n, |i, t| x(t).powi(i as i32));
    let (phi, next) = (features(&place), features(&to));
    let lspi = Lspi::new(Samples { phi: phi.as_ref(), actions: &actions, weights: &weights }, 3, Par::Seq).unwrap();
    for (options, allowed) in [(LspiOptions::default(), None), (LspiOptions::plain(), Some(vec![0b110; n]))] {
        let options = LspiOptions { ridge: 1e-6, ..options };
        let outcomes = Outcomes { next: next.as_ref(), rewards: &rewards, allowed: allowed.as_deref() };
        let fit = lspi.fit(&outcomes, &options).unwrap();
        assert_eq!(fit.untried, [2]);
        let q = fit.action_values(phi.as_ref()).unwrap();
        assert!((0..n).all(|t| q[(2, t)] == f64::NEG_INFINITY && fit.policy(phi.as_ref()).unwrap().chosen()[t] != 2));
        // With γ = 0.9 every place costs 10 in the end.
        assert!((0..n).all(|t| (q[(0, t)] + 10.0).abs() < 0.1), "{q:?}");
    }

    let points = |x: &dyn Fn(usize) -> f64| Mat::from_fn(1, n, |_, t| x(t) as f32);
    let options = LocalOptions { neighbours: 4, ridge: 1e-3 };
    let instances = Instances::new(points(&place), vec![places, places, 0], options).unwrap();
    let local = Local::new(&instances, points(&to).as_ref()).unwrap();
    for allowed in [0b111, 0b100] {
        let outcomes = LocalOutcomes {
            rewards: &rewards,
            allowed: &vec![allowed; n],
            ended: &vec![false; n],
            bounded: &vec![false; n],
        };
        let fit = local.fit(&outcomes, 0.9).unwrap();
        let worth: Vec<f64> = (0..n).map(|i| fit.weights[(i, 0)]).collect();
        assert!(worth.iter().all(|value| (value + 10.0).abs() < 0.1), "{worth:?}");
        let q = &instances.action_values(&[&worth], points(&place).as_ref()).unwrap()[0];
        assert!((0..n).all(|t| q[(2, t)] == f64::NEG_INFINITY && q[(0, t)].is_finite()));
    }
}

/// Local values of the square from a batch, points at `offset + scale · place`.
fn batch_of(square: &Square, offset: f64, scale: f64) -> LocalBatch {
    let mut batch = LocalBatch::new(2, 4).unwrap();
    let n = square.rewards.len();
    // Not sorted by action.
    for t in (0..n).map(|t| t * 7 % n) {
        let point = |points: &Mat<f64>| [0, 1].map(|i| (offset + points[(i, t)]) * scale);
        let (from, to) = (point(&square.from), point(&square.to));
        let ended = square.rewards[t] > 0.0;
        batch.push(&from, t / 300, square.rewards[t], (!ended).then_some(&to)).unwrap();
    }
    batch
}

#[test]
fn a_batch_of_points_anywhere_gives_the_same_values() {
    let square = Square::new(1);
    let options = LocalOptions { neighbours: 8, ridge: 0.1 };
    let places = Mat::from_fn(2, 100, |i, j| [(j % 10) as f64 / 10.0 + 0.05, (j / 10) as f64 / 10.0 + 0.05][i]);
    let values = |offset: f64, scale: f64| {
        let values = batch_of(&square, offset, scale).fit(&options, 0.9).unwrap();
        assert!(values.fit().converged && values.arrival() > 0.99, "{}", values.arrival());
        let at = Mat::from_fn(2, 100, |i, j| (offset + places[(i, j)]) * scale);
        values.action_values(at.as_ref()).unwrap()
    };
    let known = values(0.0, 1.0);
    for (offset, scale) in [
        (1e3, 1.0),
        (-1e4, 1.0),
        (1e6, 1.0),
        (0.0, 1e30),
        (0.0, 1e-30),
        (1e3, 1e-30),
        (0.0, 1e300),
        (0.0, 1e-300),
        (-1.0, 1e307),
    ] {
        let worst = (&known - values(offset, scale)).norm_max();
        // The largest value is 1. Points are rounded to `f32` elsewhere.
        assert!(worst < 1e-6, "moved by {offset}, times {scale:e}: {worst:e}");
    }
}

#[test]
fn a_batch_refuses_what_does_not_fit() {
    assert!(LocalBatch::new(0, 2).is_err() && LocalBatch::new(2, 0).is_err() && LocalBatch::new(2, 33).is_err());
    let mut batch = LocalBatch::new(2, 2).unwrap();
    assert_eq!(batch.fit(&LocalOptions::default(), 0.9).unwrap_err(), ValueError::Empty);
    assert!(batch.push(&[1.0], 0, 0.0, None).is_err());
    assert!(batch.push(&[1.0, 2.0], 0, 0.0, Some(&[1.0])).is_err());
    assert!(batch.push(&[1.0, f64::NAN], 0, 0.0, None).is_err());
    assert!(batch.push(&[1.0, 2.0], 0, f64::INFINITY, None).is_err());
    assert!(batch.push(&[1.0, 2.0], 2, 0.0, None).is_err());
    assert!(batch.is_empty());
    batch.push(&[1.0, 2.0], 1, -1.0, Some(&[1.0, 3.0])).unwrap();
    assert_eq!(batch.fit(&LocalOptions::default(), 1.0).unwrap_err(), ValueError::Gamma(1.0));
    let values = batch.fit(&LocalOptions::default(), 0.5).unwrap();
    // Action 0 was never tried; the costs of action 1 sum up to 2.
    assert_eq!(values.best(&[7.0, -1e9]).unwrap(), 1);
    let q = values.action_values(Mat::from_fn(2, 1, |_, _| 1.0).as_ref()).unwrap();
    assert!(q[(0, 0)] == f64::NEG_INFINITY && (q[(1, 0)] + 2.0).abs() < 1e-5, "{q:?}");
    assert!(values.best(&[1.0]).is_err() && values.best(&[f64::NAN, 0.0]).is_err());
}

#[test]
fn values_that_settled_on_a_circle_do_not_arrive() {
    // A ring of eight places, one way round; the goal is off it, and no transition leads there.
    let mut batch = LocalBatch::new(2, 1).unwrap();
    let place = |s: usize| [(s as f64 * 0.785).cos(), (s as f64 * 0.785).sin()];
    for s in 0..8 {
        batch.push(&place(s), 0, -1.0, Some(&place((s + 1) % 8))).unwrap();
    }
    let options = LocalOptions { neighbours: 1, ridge: 1.0 };
    let values = batch.fit(&options, 0.9).unwrap();
    assert!(values.fit().converged);
    assert_eq!(values.arrival(), 0.0);
    // A way out of it, from one place.
    batch.push(&place(5), 0, 1.0, None).unwrap();
    assert_eq!(batch.fit(&options, 0.9).unwrap().arrival(), 0.0, "the first of equal transitions is followed");
    let mut batch = LocalBatch::new(2, 2).unwrap();
    for s in 0..8 {
        batch.push(&place(s), 0, -1.0, Some(&place((s + 1) % 8))).unwrap();
        batch.push(&place(s), 1, if s == 5 { 1.0 } else { -9.0 }, (s != 5).then_some(&place(s))).unwrap();
    }
    assert_eq!(batch.fit(&options, 0.9).unwrap().arrival(), 1.0);
}
