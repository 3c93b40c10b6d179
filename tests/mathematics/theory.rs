//! Optimal responses and state representations against what is known of them exactly.

use std::f64::consts::{PI, TAU};

use crate::common::generator;
use adagio::slow::theory::{Axis, Boundary, OptimalResponses, TheoryError, discrete_walk, plane_motion};
use adagio::slow::{Moments, SlowFeatures, solve};
use adagio::value::{RepresentationError, Tabular, Trigonometric};
use faer::{Mat, Par};
use proptest::prelude::*;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

fn room() -> [Axis; 3] {
    [Axis::free(-0.5, 2.5).unwrap(), Axis::free(0.0, 1.8).unwrap(), Axis::cyclic(-PI, PI).unwrap()]
}

/// `ψ_j` and its derivative along the axis, written down from the propositions and not from the library.
fn wave(axis: &Axis, j: usize, s: f64) -> (f64, f64) {
    let u = (s - axis.low()) / axis.width();
    let norm = if j == 0 { 1.0 } else { 2f64.sqrt() };
    let turns = if j.is_multiple_of(2) { j as f64 * PI } else { (j as f64 + 1.0) * PI };
    match axis.boundary() {
        Boundary::Free => {
            let a = j as f64 * PI;
            (norm * (a * u).cos(), -norm * a / axis.width() * (a * u).sin())
        }
        Boundary::Cyclic if j % 2 == 1 => (norm * (turns * u).sin(), norm * turns / axis.width() * (turns * u).cos()),
        Boundary::Cyclic => (norm * (turns * u).cos(), -norm * turns / axis.width() * (turns * u).sin()),
    }
}

/// The midpoint rule on a grid: exact for all products of the waves used here.
fn grid(axes: &[Axis], per_axis: usize) -> Mat<f64> {
    let total = per_axis.pow(axes.len() as u32);
    Mat::from_fn(axes.len(), total, |d, point| {
        let cell = (point / per_axis.pow(d as u32)) % per_axis;
        axes[d].low() + axes[d].width() * (cell as f64 + 0.5) / per_axis as f64
    })
}

/// Mean 0, variance 1, no correlation, and orthogonal derivatives with the claimed power: by proposition *orthogonal
/// derivatives* (thesis §4.1.2) this makes them the optimum.
fn assert_optimal(axes: &[Axis], speeds: &[f64], k: usize, per_axis: usize) {
    let theory = OptimalResponses::slowest(axes, speeds, k).unwrap();
    let points = grid(axes, per_axis);
    let n = points.ncols() as f64;
    let phi = theory.evaluate(points.as_ref()).unwrap();
    let covariance = &phi * phi.transpose() * faer::Scale(1.0 / n);
    let mut power = Mat::<f64>::zeros(k, k);
    for (d, speed) in speeds.iter().enumerate() {
        let slope = Mat::from_fn(k, points.ncols(), |i, point| {
            (0..axes.len())
                .map(|axis| {
                    let (value, slope) = wave(&axes[axis], theory.responses()[i].indices[axis], points[(axis, point)]);
                    if axis == d { slope } else { value }
                })
                .product::<f64>()
        });
        power += &slope * slope.transpose() * faer::Scale(speed / n);
    }
    for i in 0..k {
        let mean = phi.row(i).iter().sum::<f64>() / n;
        assert!(mean.abs() < 1e-9, "response {i} has mean {mean}");
        let slowness = theory.responses()[i].slowness;
        for j in 0..k {
            let expected = f64::from(u8::from(i == j));
            assert!((covariance[(i, j)] - expected).abs() < 1e-9, "covariance of {i}, {j}: {}", covariance[(i, j)]);
            let found = power[(i, j)];
            assert!((found - expected * slowness).abs() < 1e-9 * slowness, "derivatives of {i}, {j}: {found}");
        }
    }
}

#[test]
fn optimal_responses_obey_their_constraints_exactly() {
    let box_of_four = [
        Axis::free(0.0, 1.0).unwrap(),
        Axis::cyclic(0.0, 2.0).unwrap(),
        Axis::free(-1.0, 0.3).unwrap(),
        Axis::cyclic(0.0, 1.0).unwrap(),
    ];
    assert_optimal(&[Axis::free(0.0, 1.0).unwrap()], &[0.01], 9, 50);
    assert_optimal(&[Axis::cyclic(-1.0, 1.0).unwrap()], &[0.3], 9, 50);
    assert_optimal(&room(), &plane_motion(0.04, 0.2), 60, 24);
    assert_optimal(&box_of_four, &[1.0, 0.7, 1.3, 0.2], 30, 9);
}

#[test]
fn responses_come_in_the_order_of_brute_force() {
    let boxes: [(Vec<Axis>, Vec<f64>); 4] = [
        (room().to_vec(), plane_motion(0.04, 0.2).to_vec()),
        (room().to_vec(), plane_motion(2.0, 0.01).to_vec()),
        // A square room: pairs of equal slowness.
        (
            vec![Axis::free(0.0, 2.0).unwrap(), Axis::free(0.0, 2.0).unwrap(), Axis::cyclic(0.0, TAU).unwrap()],
            vec![0.3, 0.3, 1.0],
        ),
        (vec![Axis::cyclic(0.0, 1.0).unwrap(), Axis::free(0.0, 5.0).unwrap()], vec![1.0, 20.0]),
    ];
    for (axes, speeds) in boxes {
        let k = 150;
        let theory = OptimalResponses::slowest(&axes, &speeds, k).unwrap();
        // All products of the first 60 functions of each axis; the 150 slowest lie well within.
        let side = 60usize;
        let mut all: Vec<(f64, Vec<usize>)> = (1..side.pow(axes.len() as u32))
            .map(|code| {
                let indices: Vec<usize> = (0..axes.len()).map(|d| (code / side.pow(d as u32)) % side).collect();
                let slowness = (0..axes.len()).map(|d| axes[d].wave_number(indices[d]).powi(2) * speeds[d]).sum();
                (slowness, indices)
            })
            .collect();
        // Equal slowness up to rounding: in the order of the numbers.
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut start = 0;
        for i in 1..=all.len() {
            if i == all.len() || all[i].0 > all[start].0 * (1.0 + 1e-9) {
                all[start..i].sort_by(|a, b| a.1.cmp(&b.1));
                start = i;
            }
        }
        for (found, (slowness, indices)) in theory.responses().iter().zip(&all) {
            assert!(indices.iter().all(|&j| j + 1 < side));
            assert_eq!(&found.indices, indices);
            assert!((found.slowness - slowness).abs() <= 1e-12 * slowness);
        }
        let rest =
            all[k..].iter().take_while(|(slowness, _)| *slowness <= theory.responses()[k - 1].slowness * (1.0 + 1e-9));
        // The group of the last one may begin earlier than it; what is cut is as slow as that group.
        assert_eq!(theory.cut(), rest.count());
    }
}

#[test]
fn equal_slowness_and_invariance_are_told() {
    let square = [Axis::free(0.0, 1.0).unwrap(), Axis::free(0.0, 1.0).unwrap()];
    let theory = OptimalResponses::slowest(&square, &[1.0, 1.0], 4).unwrap();
    let numbers: Vec<_> = theory.responses().iter().map(|r| r.indices.clone()).collect();
    assert_eq!(numbers, [[0, 1], [1, 0], [1, 1], [0, 2]]);
    assert_eq!(theory.groups(), [0..2, 2..3, 3..4]);
    assert_eq!(theory.cut(), 1); // (2, 0)
    // Fast turning puts the heading behind many places (thesis §4.2.3); slow turning puts it first.
    let fast = OptimalResponses::slowest(&room(), &plane_motion(0.01, 1.0), 100).unwrap();
    let slow = OptimalResponses::slowest(&room(), &plane_motion(1.0, 0.01), 100).unwrap();
    let invariant = fast.invariant_to(2).unwrap();
    assert!(fast.responses()[..invariant].iter().all(|r| r.indices[2] == 0) && invariant > 50, "{invariant}");
    assert_eq!(slow.invariant_to(2).unwrap(), 0);
    assert_eq!(slow.responses()[0].indices, [0, 0, 1]);
}

fn features_of(moments: &Moments, k: usize, lambda: f64) -> SlowFeatures {
    solve(moments, k, lambda, None).unwrap()
}

#[test]
fn discrete_walks_have_the_slowness_of_theory() {
    for (boundary, states) in
        [(Boundary::Free, 20), (Boundary::Cyclic, 20), (Boundary::Cyclic, 15), (Boundary::Free, 2)]
    {
        // Every transition of the walk once.
        let mut v = Mat::<f64>::zeros(states, 0);
        let mut rates = Mat::<f64>::zeros(states, 0);
        let one = |i, s| f64::from(u8::from(i == s));
        for s in 0..states {
            let neighbours = match boundary {
                Boundary::Free => [s.saturating_sub(1), (s + 1).min(states - 1)],
                Boundary::Cyclic => [(s + states - 1) % states, (s + 1) % states],
            };
            for next in neighbours {
                let column = v.ncols();
                v.resize_with(states, column + 1, |i, _| one(i, s));
                rates.resize_with(states, column + 1, |i, _| one(i, next) - one(i, s));
            }
        }
        let mut moments = Moments::new(Par::Seq);
        moments.widen(states).unwrap();
        moments.add(v.as_ref(), rates.as_ref(), rates.ncols() as f64).unwrap();
        let k = states - 1;
        let walk = discrete_walk(states, boundary, k).unwrap();
        let found = features_of(&moments, k, 1e-13);
        for (j, (found, known)) in found.slowness.iter().zip(&walk.slowness).enumerate() {
            assert!((found - known).abs() < 1e-9, "{boundary:?} {states}, {j}: {found} against {known}");
        }
        // The responses are orthonormal over the states and have the slowness they claim.
        let n = states as f64;
        let covariance = &walk.responses * walk.responses.transpose() * faer::Scale(1.0 / n);
        let identity = Mat::<f64>::identity(k, k);
        assert!((&covariance - &identity).norm_max() < 1e-12);
        let derivative = &walk.responses * &rates;
        let power = &derivative * derivative.transpose() * faer::Scale(1.0 / rates.ncols() as f64);
        for j in 0..k {
            assert!((power[(j, j)] - walk.slowness[j]).abs() < 1e-12);
        }
    }
}

/// Short walks from random places in the room: the driving velocity does not depend on the pose.
#[test]
fn a_sampled_walk_has_the_slowness_of_theory() {
    let axes = room();
    let (step, turn) = (0.03, 0.12);
    // Mean squares per frame, and Δt = 1: ⟨v²⟩ counts both directions of the plane.
    let theory = OptimalResponses::slowest(&axes, &plane_motion(2.0 * step * step, turn * turn), 12).unwrap();
    let basis = Trigonometric::new(&[(axes[0], 4), (axes[1], 4), (axes[2], 2)]).unwrap();
    let m = basis.size() - 1;
    let mut rng = generator(1);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let mut places = generator(2);
    let mut moments = Moments::new(Par::Seq);
    moments.widen(m).unwrap();
    let fold = |axis: &Axis, s: f64| {
        let u = ((s - axis.low()) / axis.width()).rem_euclid(2.0);
        axis.low() + axis.width() * if u > 1.0 { 2.0 - u } else { u }
    };
    let length = 6;
    for _ in 0..250 {
        let walks = 400;
        let mut poses = Mat::<f64>::zeros(3, walks * length);
        for walk in 0..walks {
            let mut pose: Vec<f64> = axes.iter().map(|a| a.low() + a.width() * places.random_range(0.0..1.0)).collect();
            for t in 0..length {
                if t > 0 {
                    pose[0] = fold(&axes[0], pose[0] + step * normal());
                    pose[1] = fold(&axes[1], pose[1] + step * normal());
                    pose[2] += turn * normal();
                }
                for d in 0..3 {
                    poses[(d, walk * length + t)] = pose[d];
                }
            }
        }
        let phi = basis.apply(poses.as_ref()).unwrap();
        let v = phi.as_ref().subrows(1, m);
        let linked: Vec<usize> = (0..walks * length).filter(|t| t % length > 0).collect();
        let rates = Mat::from_fn(m, linked.len(), |i, j| v[(i, linked[j])] - v[(i, linked[j] - 1)]);
        moments.add(v, rates.as_ref(), linked.len() as f64).unwrap();
    }
    let found = features_of(&moments, 12, 0.0);
    for (i, (found, known)) in found.slowness.iter().zip(theory.responses()).enumerate() {
        let off = found / known.slowness - 1.0;
        println!("{i} {:?}: {found:.6} against {:.6} ({:+.2} %)", known.indices, known.slowness, 100.0 * off);
        assert!(off.abs() < 0.04, "{i}: {found} against {}", known.slowness);
    }
}

#[test]
fn the_index_function_counts_all_products_once() {
    let basis = Trigonometric::new(&[
        (Axis::cyclic(-1.0, 1.0).unwrap(), 1),
        (Axis::cyclic(-1.0, 1.0).unwrap(), 2),
        (Axis::free(0.0, 1.0).unwrap(), 3),
    ])
    .unwrap();
    assert_eq!((basis.size(), basis.counts()), (3 * 5 * 4, &[3usize, 5, 4][..]));
    // μ as printed: Σ n_i Π_{j>i} (2d_j + 1).
    assert_eq!(basis.index(&[1, 2, 3]).unwrap(), 20 + 2 * 4 + 3);
    for feature in 0..basis.size() {
        assert_eq!(basis.index(&basis.numbers(feature).unwrap()).unwrap(), feature);
    }
    let state = [0.3, -0.7, 0.2];
    let phi = basis.point(&state).unwrap();
    let block = basis.apply(Mat::from_fn(3, 2, |i, _| state[i]).as_ref()).unwrap();
    for feature in 0..basis.size() {
        let n = basis.numbers(feature).unwrap();
        // On [−1, 1] the printed functions have half the argument; u runs from 0 to 1.
        let psi = |j: usize, u: f64| match j % 2 {
            0 => (j as f64 * PI * u).cos(),
            _ => ((j + 1) as f64 * PI * u).sin(),
        };
        let known = psi(n[0], 0.65) * psi(n[1], 0.15) * (n[2] as f64 * PI * 0.2).cos();
        assert!((phi[feature] - known).abs() < 1e-14);
        assert_eq!(block[(feature, 1)], phi[feature]);
    }
    assert_eq!(phi[0], 1.0);
}

/// Erratum: with the printed period of 1, x and x + 1 would look the same on [−1, 1]; here they do not.
#[test]
fn different_states_look_different() {
    let basis = Trigonometric::new(&[(Axis::cyclic(-1.0, 1.0).unwrap(), 1)]).unwrap();
    let (a, b) = (basis.point(&[-0.6]).unwrap(), basis.point(&[0.4]).unwrap());
    assert!(a.iter().zip(&b).any(|(a, b)| (a - b).abs() > 0.5));
    // A bounded axis tells its walls apart, a cyclic one does not.
    let free = Trigonometric::new(&[(Axis::free(0.0, 1.0).unwrap(), 1)]).unwrap();
    assert_eq!((free.point(&[0.0]).unwrap()[1], free.point(&[1.0]).unwrap()[1]), (1.0, -1.0));
    let (low, high) = (basis.point(&[-1.0]).unwrap(), basis.point(&[1.0]).unwrap());
    assert!(low.iter().zip(&high).all(|(low, high)| (low - high).abs() < 1e-15));
}

#[test]
fn a_table_has_one_feature_per_state() {
    let table = Tabular::new(4).unwrap();
    let phi = table.apply(&[2, 0]).unwrap();
    assert_eq!((phi.nrows(), phi.ncols()), (4, 2));
    assert_eq!((phi[(2, 0)], phi[(0, 1)], phi.sum()), (1.0, 1.0, 2.0));
    assert!(matches!(table.apply(&[4]), Err(RepresentationError::Range { found: 4, largest: 3, .. })));
    assert_eq!(Tabular::new(0).unwrap_err(), RepresentationError::Size { found: 0 });
    assert_eq!(table.apply(&[]).unwrap().ncols(), 0);
}

#[test]
fn impossible_requests_are_refused() {
    let axis = Axis::free(0.0, 1.0).unwrap();
    assert_eq!(Axis::free(1.0, 1.0), Err(TheoryError::Axis { low: 1.0, high: 1.0 }));
    assert!(Axis::cyclic(f64::NAN, 1.0).is_err() && Axis::free(-f64::MAX, f64::MAX).is_err());
    assert_eq!(OptimalResponses::slowest(&[], &[], 1), Err(TheoryError::Axes(0)));
    assert!(matches!(OptimalResponses::slowest(&[axis], &[0.0], 1), Err(TheoryError::Speed { axis: 0, .. })));
    assert!(matches!(OptimalResponses::slowest(&[axis], &[1.0, 2.0], 1), Err(TheoryError::Shape { .. })));
    assert!(OptimalResponses::slowest(&[axis], &[1.0], 0).is_err());
    assert!(discrete_walk(5, Boundary::Free, 5).is_err() && discrete_walk(0, Boundary::Cyclic, 1).is_err());
    assert!(Trigonometric::new(&[(axis, usize::MAX), (axis, 3)]).is_err());
    assert!(Trigonometric::new(&[]).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn nothing_panics(
        lows in prop::collection::vec(prop::num::f64::ANY, 0..4),
        widths in prop::collection::vec(prop::num::f64::ANY, 0..4),
        speeds in prop::collection::vec(prop_oneof![prop::num::f64::ANY, 1e-3..1e3], 0..4),
        degrees in prop::collection::vec(0usize..6, 0..4),
        k in 0usize..60,
        points in prop::collection::vec(prop_oneof![prop::num::f64::ANY, -2.0..2.0], 0..12),
        states in 0usize..30,
    ) {
        let axes: Vec<Axis> = lows.iter().zip(&widths).enumerate().filter_map(|(i, (&low, &width))| {
            if i % 2 == 0 { Axis::free(low, low + width).ok() } else { Axis::cyclic(low, low + width).ok() }
        }).chain(Axis::free(0.0, 1.0).ok()).collect();
        let rows = axes.len();
        let block = Mat::from_fn(rows, points.len() / rows, |i, j| points[j * rows + i]);
        let finite = |m: &Mat<f64>| m.col_iter().all(|c| c.iter().all(|v| v.is_finite()));
        if let Ok(theory) = OptimalResponses::slowest(&axes, &speeds, k) {
            if let Ok(phi) = theory.evaluate(block.as_ref()) {
                prop_assert!(finite(&phi));
            }
            let _ = theory.invariant_to(k);
        }
        let sized: Vec<(Axis, usize)> = axes.iter().copied().zip(degrees).collect();
        if let Ok(basis) = Trigonometric::new(&sized) {
            if let Ok(phi) = basis.apply(block.as_ref()) {
                prop_assert!(finite(&phi));
            }
            let _ = (basis.point(&points), basis.index(&[k, states]), basis.numbers(k));
        }
        for boundary in [Boundary::Free, Boundary::Cyclic] {
            if let Ok(walk) = discrete_walk(states, boundary, k) {
                prop_assert!(finite(&walk.responses));
            }
        }
    }
}
