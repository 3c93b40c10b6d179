//! The few slowest features by block Lanczos iteration, against the dense reference.

use crate::common::{ald, batch_moments, generator, random_path};
use adagio::dictionary::Selection;
use adagio::random::fix_parallelism;
use adagio::slow::{Link, Method, Moments, SlowError, SlowFeatures, SolveOptions, Solver, TOLERANCE, solve_with};
use faer::{Mat, Par};
use proptest::prelude::*;
use rand::RngExt;

fn by(method: Method) -> SolveOptions {
    SolveOptions { method, par: Par::Seq }
}

const LANCZOS: Method = Method::Lanczos { tolerance: TOLERANCE };

fn dense(moments: &Moments, k: usize, lambda: f64) -> Result<SlowFeatures, SlowError> {
    solve_with(moments, k, lambda, None, &by(Method::Dense))
}

fn lanczos(moments: &Moments, k: usize, lambda: f64) -> Result<SlowFeatures, SlowError> {
    solve_with(moments, k, lambda, None, &by(LANCZOS))
}

fn iterated(features: &SlowFeatures) -> bool {
    matches!(features.solver, Solver::Lanczos { .. })
}

fn links(n: usize) -> Vec<Option<Link>> {
    Link::regular(n, 1.0).unwrap()
}

/// A point wanders in a hypercube; its Newton coordinates over a Gaussian dictionary.
fn wanderer(frames: usize, seed: u64) -> Moments {
    let x = random_path(6, frames, seed);
    let mut selection = ald(0.5, 1e-3, 640);
    selection.observe(x.as_ref()).unwrap();
    let v = selection.dictionary().coordinates(x.as_ref()).unwrap();
    batch_moments(v.as_ref(), &links(frames))
}

/// Largest distance of `WᵀCW` from the identity.
fn constraint_error(moments: &Moments, features: &SlowFeatures) -> f64 {
    let w = &features.weights;
    let covariances = w.transpose() * (moments.covariance() * w);
    (covariances - Mat::<f64>::identity(w.ncols(), w.ncols())).norm_max()
}

/// Sine of the largest angle between the spans of two sets of uncorrelated features of unit variance.
fn sine_of_angle(moments: &Moments, a: &SlowFeatures, b: &SlowFeatures) -> f64 {
    let c = moments.covariance();
    let overlap = a.weights.transpose() * (&c * &b.weights);
    // What of b is not in the span of a has the covariance of the differences.
    let rest = &b.weights - &a.weights * overlap;
    let covariance = rest.transpose() * (&c * &rest);
    let largest = covariance.self_adjoint_eigenvalues(faer::Side::Lower).unwrap().into_iter().fold(0.0, f64::max);
    largest.max(0.0).sqrt()
}

/// Largest relative difference of slownesses, as a share of what the solver minimises, `Δ + λ‖w‖² = 1/μ`.
fn slowness_error(found: &SlowFeatures, known: &SlowFeatures) -> f64 {
    let minimal = |f: &SlowFeatures, j: usize| f.slowness[j] + f.lambda * f.weights.col(j).squared_norm_l2();
    let mut pairs: Vec<(f64, f64)> =
        (0..found.slowness.len()).map(|j| (minimal(found, j), minimal(known, j))).collect();
    // λ changes the order.
    let (mut a, mut b): (Vec<f64>, Vec<f64>) = pairs.drain(..).unzip();
    a.sort_by(f64::total_cmp);
    b.sort_by(f64::total_cmp);
    a.iter().zip(&b).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max)
}

#[test]
fn it_agrees_with_the_reference_on_the_coordinates_of_a_kernel() {
    fix_parallelism();
    let moments = wanderer(2000, 1);
    assert!(moments.size() >= 600, "{} coordinates", moments.size());
    for (k, lambda) in [(1, 1e-6), (30, 1e-9), (60, 1e-5), (64, 1e-3)] {
        let (found, known) = (lanczos(&moments, k, lambda).unwrap(), dense(&moments, k, lambda).unwrap());
        let Solver::Lanczos { residual, applied } = found.solver else { panic!("{k} features were found dense") };
        assert!(residual <= TOLERANCE && applied < moments.size(), "{k}: {residual}, {applied}");
        assert!(slowness_error(&found, &known) < 1e-6);
        assert!(found.slowness.is_sorted());
        let (error, reference) = (constraint_error(&moments, &found), constraint_error(&moments, &known));
        assert!(error < 1e-9, "{k}: covariances are off by {error}, those of the reference by {reference}");
        let sine = sine_of_angle(&moments, &known, &found);
        assert!(sine < 1e-3, "{k}: the spans have an angle of {sine}");
        // A tighter tolerance brings the span nearer.
        let fine = solve_with(&moments, k, lambda, None, &by(Method::Lanczos { tolerance: 1e-10 })).unwrap();
        let sine = sine_of_angle(&moments, &known, &fine);
        assert!(sine < 1e-6, "{k}: the spans have an angle of {sine}");
    }
}

#[test]
fn the_residual_is_what_it_says() {
    fix_parallelism();
    let (moments, k, lambda) = (wanderer(2000, 2), 20, 1e-6);
    for tolerance in [1e-2, 1e-4, 1e-6] {
        let found = solve_with(&moments, k, lambda, None, &by(Method::Lanczos { tolerance })).unwrap();
        let Solver::Lanczos { residual, .. } = found.solver else { panic!("dense") };
        // With u = √μ Rᵀw: ‖Mu − μu‖ = ‖R⁻¹(Cw − μ(Ḋ + λI)w)‖ √μ.
        let regularised = moments.rate() + Mat::<f64>::identity(moments.size(), moments.size()) * faer::Scale(lambda);
        let factor = regularised.llt(faer::Side::Lower).unwrap();
        let driven = &regularised * &found.weights;
        let mut rest = moments.covariance() * &found.weights;
        let mut worst: f64 = 0.0;
        let mut mu = Vec::new();
        for j in 0..k {
            let w = found.weights.col(j);
            mu.push(1.0 / (w.transpose() * driven.col(j)));
            let column = rest.col(j) - driven.col(j) * faer::Scale(mu[j]);
            rest.col_mut(j).copy_from(&column);
        }
        faer::linalg::triangular_solve::solve_lower_triangular_in_place(factor.L(), rest.as_mut(), Par::Seq);
        for (column, mu) in rest.col_iter().zip(&mu) {
            worst = worst.max(column.norm_l2() / mu.sqrt());
        }
        assert!(residual <= tolerance && worst < 1.001 * residual + 1e-11, "{worst} against {residual}");
        assert!(worst > 0.999 * residual - 1e-11, "{worst} against {residual}");
    }
}

/// The same bits for any number of threads.
#[cfg(feature = "rayon")]
#[test]
fn threads_do_not_change_a_bit() {
    fix_parallelism();
    let moments = wanderer(2000, 3);
    let run = |method, par| solve_with(&moments, 24, 1e-6, None, &SolveOptions { method, par }).unwrap();
    for method in [LANCZOS, Method::Dense] {
        let one = run(method, Par::Seq);
        assert_eq!(iterated(&one), method == LANCZOS);
        for threads in [1, 2, 3] {
            let more = run(method, Par::rayon(threads));
            assert_eq!(one.weights, more.weights);
            assert_eq!(one.slowness, more.slowness);
            assert_eq!(one.solver, more.solver);
        }
    }
}

/// Coordinates that are as slow and as strong as each other, in groups: `C` is the identity, `Ḋ` has the given diagonal, which
/// a rotation hides.
fn with_rates(rates: &[f64], seed: u64) -> Moments {
    let m = rates.len();
    let mut generator = generator(seed);
    let random = Mat::from_fn(m, m, |_, _| generator.random_range(-1.0..1.0));
    let q = random.qr().compute_thin_Q();
    // Frames come in pairs of opposite sign, so that the mean is zero.
    let amplitude = (m as f64).sqrt();
    let v = Mat::from_fn(m, 2 * m, |i, t| if t < m { amplitude * q[(i, t)] } else { -amplitude * q[(i, t - m)] });
    let derivatives = Mat::from_fn(m, m, |i, t| q[(i, t)] * rates[t].sqrt());
    let mut moments = Moments::new(Par::Seq);
    moments.widen(m).unwrap();
    moments.add(v.as_ref(), derivatives.as_ref(), 1.0).unwrap();
    moments
}

#[test]
fn all_of_many_equal_features_are_found() {
    fix_parallelism();
    // The slowest are 5, 31, 33, 45 times the same; others follow. A block has 32 columns.
    for equal in [5, 31, 33, 45] {
        let rates: Vec<f64> =
            (0..1200).map(|i| if i < equal { 1.0 } else { 1.5 + 0.01 * (i - equal) as f64 }).collect();
        let moments = with_rates(&rates, equal as u64);
        let k = equal + 5;
        let found = lanczos(&moments, k, 1e-9).unwrap();
        for (j, (slowness, rate)) in found.slowness.iter().zip(&rates).enumerate() {
            assert!((slowness / rate - 1.0).abs() < 1e-6, "{equal} equal: feature {j} has {slowness}, not {rate}");
        }
        assert!(constraint_error(&moments, &found) < 1e-9);
    }
    // Nothing but equals.
    let moments = with_rates(&[2.0; 600], 9);
    for k in [1, 32, 40] {
        let found = lanczos(&moments, k, 1e-9).unwrap();
        assert!(found.slowness.iter().all(|slowness| (slowness / 2.0 - 1.0).abs() < 1e-6));
        assert!(constraint_error(&moments, &found) < 1e-9);
    }
}

/// Eigenvalues without gaps are hard for iterations: the basis is restarted, or the dense solver does it.
#[test]
fn a_flat_spectrum_is_solved_too() {
    fix_parallelism();
    let rates: Vec<f64> = (0..600).map(|i| 1.0 + 1e-4 * i as f64).collect();
    let moments = with_rates(&rates, 5);
    let found = lanczos(&moments, 10, 1e-9).unwrap();
    for (slowness, rate) in found.slowness.iter().zip(&rates) {
        assert!((slowness / rate - 1.0).abs() < 1e-6, "{slowness} against {rate}, {:?}", found.solver);
    }
}

#[test]
fn fewer_directions_than_features_are_refused_as_by_the_reference() {
    fix_parallelism();
    let path = random_path(12, 400, 6);
    let mut generator = generator(7);
    let mixing = Mat::from_fn(640, 12, |_, _| generator.random_range(-1.0..1.0));
    let moments = batch_moments((mixing * path).as_ref(), &links(400));
    let known = dense(&moments, 12, 1e-3).unwrap();
    let found = lanczos(&moments, 12, 1e-3).unwrap();
    assert!(slowness_error(&found, &known) < 1e-6);
    let rank = 640 - known.rank_deficit().unwrap();
    assert_eq!(rank, 12);
    for k in [0, rank + 1, rank + 20] {
        let refused = lanczos(&moments, k, 1e-3).unwrap_err();
        assert_eq!(refused, dense(&moments, k, 1e-3).unwrap_err());
        assert_eq!(refused, SlowError::Features { asked: k, rank });
    }
}

#[test]
fn what_it_cannot_do_is_done_dense() {
    fix_parallelism();
    let moments = wanderer(2000, 8);
    assert!(iterated(&lanczos(&moments, 20, 1e-6).unwrap()));
    // λ = 0; too many features.
    for (k, lambda) in [(20, 0.0), (moments.size() / 2, 1e-6)] {
        let found = lanczos(&moments, k, lambda).unwrap();
        assert!(found.rank_deficit().is_some() && !iterated(&found));
    }
    let automatic = solve_with(&moments, 20, 1e-6, None, &SolveOptions::default()).unwrap();
    assert!(iterated(&automatic));
    for tolerance in [0.0, 1.0, -1e-6, f64::NAN, f64::INFINITY] {
        let refused = solve_with(&moments, 20, 1e-6, None, &by(Method::Lanczos { tolerance })).unwrap_err();
        assert!(matches!(refused, SlowError::Tolerance(_)), "{tolerance}");
    }
}

#[test]
fn signs_follow_the_solution_before() {
    fix_parallelism();
    let moments = wanderer(2000, 10);
    let known = dense(&moments, 16, 1e-6).unwrap();
    let mut turned = known.clone();
    turned.weights *= faer::Scale(-1.0);
    for previous in [&known, &turned] {
        let found = solve_with(&moments, 16, 1e-6, Some(previous), &by(LANCZOS)).unwrap();
        let agreement = found.weights.transpose() * (moments.covariance() * &previous.weights);
        for j in 0..16 {
            assert!(agreement[(j, j)] > 0.9, "feature {j}: {}", agreement[(j, j)]);
        }
        assert!(slowness_error(&found, &known) < 1e-6);
    }
}

/// Random coordinates with copies, sums, constants and tiny ones among them.
fn odd_moments(m: usize, copies: usize, tiny: usize, seed: u64) -> Moments {
    let mut generator = generator(seed);
    let frames = 900;
    let path = random_path(6, frames, seed ^ 1);
    let waves: Vec<(Vec<f64>, f64)> = (0..m)
        .map(|_| ((0..6).map(|_| generator.random_range(-4.0..4.0)).collect(), generator.random_range(0.0..6.0)))
        .collect();
    let mut v = Mat::from_fn(m, frames, |i, t| {
        let (direction, phase) = &waves[i];
        (direction.iter().enumerate().map(|(j, d)| d * path[(j, t)]).sum::<f64>() + phase).cos()
    });
    for copy in 0..copies {
        let (from, to) = (generator.random_range(0..m), generator.random_range(0..m));
        for t in 0..frames {
            v[(to, t)] = if copy % 3 == 2 { 0.7 } else { v[(from, t)] };
        }
    }
    for _ in 0..tiny {
        let row = generator.random_range(0..m);
        v.row_mut(row).iter_mut().for_each(|value| *value *= 1e-5);
    }
    batch_moments(v.as_ref(), &links(frames))
}

fn same_errors(a: &Result<SlowFeatures, SlowError>, b: &Result<SlowFeatures, SlowError>) -> bool {
    matches!((a, b), (Err(a), Err(b)) if a == b)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    /// Whatever the coordinates are: the reference's features, with its constraints.
    #[test]
    fn random_moments_have_the_features_of_the_reference(
        m in 540usize..640, k in 1usize..24, exponent in -9.0..-1.0f64,
        copies in 0usize..300, tiny in 0usize..100, seed in any::<u64>(),
    ) {
        fix_parallelism();
        let moments = odd_moments(m, copies, tiny, seed);
        let lambda = 10f64.powf(exponent);
        let (found, known) = (lanczos(&moments, k, lambda), dense(&moments, k, lambda));
        if same_errors(&found, &known) {
            return Ok(());
        }
        let (found, known) = (found.unwrap(), known.unwrap());
        prop_assert!(slowness_error(&found, &known) < 1e-6, "{:?}", found.solver);
        prop_assert!(found.slowness.is_sorted());
        let error = constraint_error(&moments, &found);
        prop_assert!(error < 1e-8, "covariances are off by {}, by {} of the reference", error, constraint_error(&moments, &known));
    }
}
