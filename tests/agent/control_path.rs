//! From an image to an action: the Q-values are those of the features, and where they are linear nothing is allocated.

use std::sync::Arc;

use adagio::kernel::Kernel;
use adagio::policy::{Directed, FloorMap, GoalRegion, Learned, PolicyError, Recent, Reflexes, columns};
use adagio::random::stream;
use adagio::robot::{Action, ActionSet};
use adagio::scenario::{Scenario, Vision};
use adagio::slow::{SlowError, SlowModel};
use adagio::value::{Instances, LocalOptions};
use adagio::vision::Image;
use adagio::vision::{Observation, Observer};
use faer::{Mat, Par};
use rand::RngExt;

fn drive() -> ActionSet {
    ActionSet::differential_drive(0.3, 0.8)
}

fn reflexes() -> Reflexes {
    Reflexes::all(&drive())
}

/// A random observation, which is dark enough that products of two are exact in `f32`.
fn observation(values: usize, rng: &mut impl RngExt) -> Observation {
    Observation { frame: 0, pixels: (0..values).map(|_| rng.random_range(40..=215u8)).collect() }
}

fn model(kernel: Kernel, d: usize, m: usize, k: usize, seed: u64) -> SlowModel<f32> {
    let mut rng = stream(seed, "model");
    let members: Vec<Observation> = (0..m).map(|_| observation(d, &mut rng)).collect();
    let projection = Mat::from_fn(m, k, |_, _| rng.random_range(-1.0..1.0));
    let offset = (0..k).map(|_| rng.random_range(-1.0..1.0)).collect();
    SlowModel::from_parts(kernel, columns(members.iter()), projection, offset, vec![1.0; k]).unwrap()
}

fn weights(k: usize, tasks: usize, seed: u64) -> Vec<Mat<f64>> {
    let mut rng = stream(seed, "weights");
    (0..tasks).map(|_| Mat::from_fn(k + 1, 3, |_, _| rng.random_range(-1.0..1.0))).collect()
}

fn learned(kernel: Kernel, d: usize, m: usize, k: usize, tasks: usize) -> Learned {
    Learned::new(1, 0, 0, model(kernel, d, m, k, 1), weights(k, tasks, 1)).unwrap()
}

#[test]
fn q_values_are_those_of_the_features() {
    let (d, m, k) = (147, 90, 25);
    // Pairs of random observations are about √(2 · 147) · 50 = 860 grey levels apart.
    let kernels = [Kernel::gaussian(600.0), Kernel::laplacian(600.0), Kernel::radial(600.0, 1.3)];
    for kernel in kernels.map(Result::unwrap) {
        let learned = learned(kernel, d, m, k, 2);
        let mut rng = stream(2, "seen");
        let seen: Vec<Observation> = (0..200).map(|_| observation(d, &mut rng)).collect();
        let phi = learned.features(columns(seen.iter()).as_ref(), Par::Seq);
        for task in 0..2 {
            let q = learned.weights[task].transpose() * &phi;
            // Rounding is relative to the terms that are summed.
            let size = learned.weights[task].norm_max() * phi.norm_max() * (k + 1) as f64;
            for (j, seen) in seen.iter().enumerate() {
                let found = learned.q_values(seen, task);
                let known = [q[(0, j)], q[(1, j)], q[(2, j)]];
                for (found, known) in found.iter().zip(known) {
                    assert!((found - known).abs() < 1e-10 * size, "{kernel}: {found} against {known}");
                }
                for action in Action::DRIVE {
                    let recent = Recent::default().then(action, j % 2 == 0, &drive());
                    assert_eq!(reflexes().best(&found, recent), reflexes().best(&known, recent));
                }
            }
        }
    }
}

/// Where actions were tried: `of_each` transitions of each action at random places.
fn instances(p: usize, of_each: usize) -> Arc<Instances> {
    let mut rng = stream(5, "places");
    let points = Mat::from_fn(p, 3 * of_each, |_, _| rng.random_range(-2.0..2.0f32));
    Arc::new(Instances::new(points, vec![of_each; 3], LocalOptions { neighbours: 8, ridge: 0.1 }).unwrap())
}

#[test]
fn local_values_are_those_of_the_features() {
    let model = model(Kernel::gaussian(600.0).unwrap(), 147, 90, 25, 1);
    let instances = instances(12, 200);
    let mut rng = stream(6, "worth");
    let worth = (0..2).map(|_| Mat::from_fn(600, 1, |_, _| rng.random_range(0.0..1.0))).collect();
    let learned = Learned::local(1, 0, 0, model, instances, worth, None).unwrap();
    let seen: Vec<Observation> = (0..50).map(|_| observation(147, &mut rng)).collect();
    let phi = learned.features(columns(seen.iter()).as_ref(), Par::Seq);
    let known = learned.q_values_of(phi.as_ref());
    for (j, seen) in seen.iter().enumerate() {
        for (task, known) in known.iter().enumerate() {
            for (a, found) in learned.q_values(seen, task).iter().enumerate() {
                // Points are rounded to 32 bits.
                assert!((found - known[(a, j)]).abs() < 1e-3, "{found} against {}", known[(a, j)]);
            }
        }
    }
    // They are not all the same.
    assert!((known[0][(0, 0)] - known[1][(0, 0)]).abs() > 1e-3 && (known[0][(0, 0)] - known[0][(1, 0)]).abs() > 1e-3);
}

#[test]
fn a_region_without_marks_or_with_places_of_another_shape_is_refused() {
    let options = LocalOptions { neighbours: 2, ridge: 0.3 };
    let region = |places: (usize, usize), marks: (usize, usize)| {
        let (places, marks) = (Mat::zeros(places.0, places.1), Mat::zeros(marks.0, marks.1));
        let states = Mat::from_fn(3, 5, |i, j| (i + j) as f32);
        let instances = Arc::new(Instances::new(states.clone(), vec![5], options)?);
        let map = FloorMap::new(instances, places.as_ref())?;
        GoalRegion::new(&map, marks, 0.8, [states.as_ref(); 2])
    };
    assert!(region((2, 5), (3, 1)).is_ok());
    for (places, marks) in [((2, 5), (3, 0)), ((1, 5), (3, 1)), ((2, 4), (3, 1)), ((2, 5), (2, 1))] {
        assert!(region(places, marks).is_err(), "{places:?} {marks:?}");
    }
}

/// A run whose first actions happen to be all of two kinds, and rewards below 0: of the third nothing is known, and no one takes it.
#[test]
fn an_action_that_was_never_tried_is_not_chosen() {
    let model = model(Kernel::gaussian(600.0).unwrap(), 147, 90, 25, 1);
    let points = Mat::from_fn(12, 200, |i, j| ((i * 7 + j * 3) % 19) as f32 / 9.0 - 1.0);
    let options = LocalOptions { neighbours: 8, ridge: 0.1 };
    let instances = Arc::new(Instances::new(points, vec![100, 100, 0], options).unwrap());
    let local = Learned::local(
        1,
        0,
        0,
        model.clone(),
        instances,
        vec![Mat::from_fn(200, 1, |i, _| -1.0 - (i % 3) as f64)],
        None,
    )
    .unwrap();
    let untried = Mat::from_fn(26, 3, |i, a| match (i, a) {
        (0, 2) => f64::NEG_INFINITY,
        (0, _) => -1.0,
        (_, a) => 0.01 * a as f64,
    });
    let linear = Learned::new(1, 0, 0, model, vec![untried]).unwrap();
    let mut rng = stream(8, "seen");
    let seen: Vec<Observation> = (0..50).map(|_| observation(147, &mut rng)).collect();
    for learned in [linear, local] {
        let phi = learned.features(columns(seen.iter()).as_ref(), Par::Seq);
        let of_features = learned.q_values_of(phi.as_ref()).swap_remove(0);
        for (j, seen) in seen.iter().enumerate() {
            let q = learned.q_values(seen, 0);
            assert!(q[0].is_finite() && q[1].is_finite() && q[2] == f64::NEG_INFINITY, "{:?}", &q[..]);
            assert!(of_features[(0, j)].is_finite() && of_features[(2, j)] == f64::NEG_INFINITY);
            assert_ne!(reflexes().best(&q, Recent::default()).0, Action::TURN_RIGHT);
        }
    }
}

#[test]
fn local_values_that_cannot_be_acted_on_are_refused() {
    let make = |instances: Arc<Instances>, worth: Mat<f64>| {
        let model = model(Kernel::gaussian(300.0).unwrap(), 4, 2, 3, 1);
        Learned::local(1, 0, 0, model, instances, vec![worth], None).unwrap_err()
    };
    let error = make(instances(4, 5), Mat::zeros(15, 1));
    assert_eq!(error, PolicyError::Coordinates { found: 4, features: 3 });
    let error = make(instances(3, 5), Mat::zeros(14, 1));
    assert_eq!(error, PolicyError::Worth { task: 0, found: 14, expected: 15 });
    let many = Instances::new(Mat::zeros(3, 33), vec![1; 33], LocalOptions { neighbours: 1, ridge: 1.0 }).unwrap();
    assert_eq!(make(Arc::new(many), Mat::zeros(33, 1)), PolicyError::Instances { actions: 33 });
}

/// The size of an observation is what the vector instructions divide: every remainder.
#[test]
fn one_support_vector_gives_its_kernel_value_whatever_the_length() {
    let kernel = Kernel::gaussian(300.0).unwrap();
    for d in 1..70 {
        let model = model(kernel, d, 1, 1, d as u64);
        let mut rng = stream(d as u64, "seen");
        let seen = observation(d, &mut rng);
        let x = columns([&seen].into_iter());
        let rows = model.kernel_rows(x.as_ref(), Par::Seq).unwrap();
        let mut by_hand = model.clone();
        (by_hand.projection, by_hand.offset) = (Mat::from_fn(1, 1, |_, _| 1.0), vec![0.0]);
        let weights = vec![Mat::from_fn(2, 3, |i, a| if i == 1 && a == 1 { 1.0 } else { 0.0 })];
        let learned = Learned::new(1, 0, 0, by_hand, weights).unwrap();
        let [zero, value, _] = learned.q_values(&seen, 0)[..] else { panic!("three actions") };
        assert_eq!(zero, 0.0);
        assert!((value - rows[(0, 0)]).abs() <= 2.0 * f64::EPSILON * value, "{d} values: {value} and {}", rows[(0, 0)]);
    }
}

#[test]
fn a_decision_allocates_nothing() {
    let (reflexes, actions) = (reflexes(), drive());
    let learned = learned(Kernel::laplacian(2000.0).unwrap(), 1536, 300, 40, 2);
    let mut rng = stream(3, "seen");
    let seen: Vec<Observation> = (0..1000).map(|_| observation(1536, &mut rng)).collect();
    let decide = |seen: &Observation, task| {
        let recent = Recent::default().then(Action::TURN_LEFT, false, &actions);
        std::hint::black_box(reflexes.best(&learned.q_values(seen, task), recent));
    };
    decide(&seen[0], 0);
    let counted = allocation_counter::measure(|| seen.iter().enumerate().for_each(|(i, seen)| decide(seen, i % 2)));
    assert_eq!((counted.count_total, counted.bytes_total), (0, 0));
    // The counter counts.
    assert!(allocation_counter::measure(|| drop(std::hint::black_box(vec![1u8; 9]))).count_total == 1);
}

#[test]
fn an_observer_at_work_allocates_nothing() {
    let settings = Vision { cut_rows: 80, width: 32, height: 16, brightness: Some(128.0) };
    let mut rng = stream(4, "images");
    let mut image = || {
        let rgb = (0..3 * 320 * 240).map(|_| rng.random_range(0..=255u8)).collect();
        Image { width: 320, height: 240, cropped: false, rgb }
    };
    let (first, second) = (image(), image());
    let (mut observer, mut pixels) = (Observer::default(), Vec::new());
    observer.observe(&first, &settings, &mut pixels);
    let before = pixels.clone();
    let counted = allocation_counter::measure(|| observer.observe(&second, &settings, &mut pixels));
    assert_eq!((counted.count_total, counted.bytes_total), (0, 0));
    assert_ne!(pixels, before);
    assert_eq!(pixels, adagio::vision::observe(&second, &settings, 0).pixels);
}

#[test]
fn models_that_cannot_be_acted_on_are_refused() {
    let kernel = Kernel::gaussian(300.0).unwrap();
    let make = |model: SlowModel<f32>, weights| Learned::new(1, 0, 0, model, weights).unwrap_err();
    for value in [0.5, 128.0, -129.0, f32::NAN, f32::INFINITY] {
        let mut members = Mat::<f32>::zeros(4, 2);
        members[(3, 1)] = value;
        let model = SlowModel::from_parts(kernel, members, Mat::zeros(2, 1), vec![0.0], vec![1.0]).unwrap();
        let error = make(model, weights(1, 1, 1));
        assert!(matches!(error, PolicyError::NotAnObservation { index: 1, .. }), "{error}");
    }
    let error = make(model(kernel, 4, 2, 3, 1), weights(2, 1, 1));
    assert!(matches!(error, PolicyError::Features(SlowError::Shape { .. })), "{error}");
    let four = vec![Mat::zeros(4, 3), Mat::zeros(4, 4)];
    assert_eq!(make(model(kernel, 4, 2, 3, 1), four), PolicyError::Actions { task: 1, actions: 4 });
}

/// Exploration goes to rarely visited places as often as it is told to, on the values for them; and walks on where it is there.
#[test]
fn exploration_goes_to_rarely_visited_places() {
    let text = include_str!("../../scenarios/lab.toml");
    let model = model(Kernel::gaussian(600.0).unwrap(), 147, 90, 25, 1);
    let mut rng = stream(7, "worth");
    let seen = observation(147, &mut rng);
    let mut of_place = |least: f64| Mat::from_fn(600, 1, |_, _| rng.random_range(least..least + 0.01));
    let tasks = vec![Mat::zeros(600, 1); 2];
    let learned = Learned::local(1, 0, 0, model, instances(12, 200), tasks, None).unwrap();
    let on_the_way = |share: f64, learned: &Learned| {
        let set = [format!("policy.directed_share={share}")];
        let scenario = Scenario::parse(text, "lab.toml".as_ref(), &set).unwrap();
        let mut directed = Directed::new(&scenario, stream(1, "directed"));
        let state = learned.state(&seen);
        let length = scenario.policy.explore_length;
        (0..400 * length).filter(|_| directed.values(Some(&state)).is_some()).count() as f64 / (400 * length) as f64
    };
    let far = learned.clone().with_rare(vec![of_place(0.3); 3]);
    assert_eq!((on_the_way(1.0, &far), on_the_way(0.0, &far), on_the_way(1.0, &learned)), (1.0, 0.0, 0.0));
    let half = on_the_way(0.5, &far);
    assert!((half - 0.5).abs() < 0.08, "{half}");
    // One action of each period, until it sees that it is there.
    let there = on_the_way(1.0, &learned.with_rare(vec![of_place(0.95)]));
    let scenario = Scenario::parse(text, "lab.toml".as_ref(), &[]).unwrap();
    assert_eq!(there, 1.0 / scenario.policy.explore_length as f64);
}

/// Local values know no way to a goal that was never met: what was met costs, at most.
#[test]
fn a_goal_that_was_never_met_is_not_pursued() {
    let model = || model(Kernel::gaussian(600.0).unwrap(), 147, 90, 25, 1);
    let mut met = Mat::full(600, 1, -0.1);
    met[(7, 0)] = 0.2;
    let tasks = vec![met, Mat::full(600, 1, -0.1), Mat::zeros(600, 1)];
    let local = Learned::local(1, 0, 0, model(), instances(12, 200), tasks, None).unwrap();
    assert_eq!([0, 1, 2].map(|task| local.has_goal(task, false)), [true, false, false]);
    assert!(!local.has_goal(0, true), "where it is was not shown");
    let linear = learned(Kernel::gaussian(600.0).unwrap(), 147, 90, 25, 2);
    assert!(linear.has_goal(0, false) && linear.has_goal(1, false));
}
