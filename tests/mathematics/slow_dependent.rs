//! Coordinates that depend on each other: there are as many features as directions with variance, whatever λ and the scales,
//! and asking for more is an error that says how many there are.

use crate::common::{batch_moments, correlation, generator, random_path, rotation};
use adagio::random::fix_parallelism;
use adagio::slow::{LinearSfa, LinearStream, Link, Method, SlowError, SlowFeatures, SolveOptions, Solver, solve_with};
use faer::{Mat, MatRef, Par};
use proptest::prelude::*;
use rand::RngExt;

/// From none at all over those that vanish in the rounding of the sums to some that outweigh all slowness.
const LAMBDAS: [f64; 12] = [0.0, 1e-14, 1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4, 1e-3, 1e-2, 1e-1];

fn links(n: usize) -> Vec<Option<Link>> {
    Link::regular(n, 1.0).unwrap()
}

/// Independent channels, and `more` random sums of them.
fn with_sums(independent: usize, more: usize, n: usize, seed: u64) -> Mat<f64> {
    let x = random_path(independent, n, seed);
    let mut generator = generator(seed ^ 1);
    let sums = Mat::from_fn(more, independent, |_, _| generator.random_range(-1.0..1.0)) * &x;
    Mat::from_fn(independent + more, n, |i, t| if i < independent { x[(i, t)] } else { sums[(i - independent, t)] })
}

/// Largest distance of the outputs' covariances on the frames from the identity.
fn constraint_error(weights: MatRef<'_, f64>, x: MatRef<'_, f64>) -> f64 {
    let n = x.ncols() as f64;
    let means: Vec<f64> = (0..x.nrows()).map(|i| x.row(i).sum() / n).collect();
    let y = weights.transpose() * Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)] - means[i]);
    (&y * y.transpose() * faer::Scale(1.0 / n) - Mat::<f64>::identity(y.nrows(), y.nrows())).norm_max()
}

fn dense(x: MatRef<'_, f64>, k: usize, lambda: f64) -> Result<SlowFeatures, SlowError> {
    let options = SolveOptions { method: Method::Dense, par: Par::Seq };
    solve_with(&batch_moments(x, &links(x.ncols())), k, lambda, None, &options)
}

fn linear(x: MatRef<'_, f64>, k: usize, lambda: f64) -> Result<LinearSfa, SlowError> {
    LinearSfa::fit(x, &links(x.ncols()), k, lambda)
}

fn streamed(x: MatRef<'_, f64>, k: usize, lambda: f64) -> Result<LinearSfa, SlowError> {
    let mut stream = LinearStream::new();
    stream.push(x, &links(x.ncols()))?;
    stream.solve(k, lambda)
}

/// One feature and all are found, with the true rank; one more is refused with it.
fn assert_rank(x: MatRef<'_, f64>, rank: usize, lambda: f64, tolerances: [f64; 2]) -> Result<(), TestCaseError> {
    let missing = x.nrows() - rank;
    for k in [1, rank] {
        let (moments, batch, stream) = (dense(x, k, lambda), linear(x, k, lambda), streamed(x, k, lambda));
        let (moments, batch, stream) = (moments.unwrap(), batch.unwrap(), stream.unwrap());
        prop_assert_eq!((moments.rank_deficit(), batch.rank_deficit), (Some(missing), missing), "{} features", k);
        prop_assert_eq!(stream.rank_deficit, missing);
        for (weights, slowness, tolerance) in [
            (&moments.weights, &moments.slowness, tolerances[0]),
            (&stream.weights, &stream.slowness, tolerances[0]),
            (&batch.weights, &batch.slowness, tolerances[1]),
        ] {
            let error = constraint_error(weights.as_ref(), x);
            prop_assert!(error < tolerance, "{k} features, lambda {lambda}: off by {error}, more than {tolerance}");
            prop_assert!(slowness.is_sorted() && slowness.iter().all(|s| (0.0..10.0).contains(s)), "{:?}", slowness);
        }
    }
    for k in [rank + 1, x.nrows()] {
        let refused = SlowError::Features { asked: k, rank };
        prop_assert_eq!(dense(x, k, lambda).unwrap_err(), refused.clone(), "lambda {}", lambda);
        prop_assert_eq!(linear(x, k, lambda).unwrap_err(), refused.clone(), "lambda {}", lambda);
        prop_assert_eq!(streamed(x, k, lambda).unwrap_err(), refused, "lambda {}", lambda);
    }
    Ok(())
}

#[test]
fn two_channels_and_their_sum_have_two_features_with_any_lambda() {
    for seed in 0..20 {
        let x = random_path(2, 500, seed);
        let x = Mat::from_fn(3, 500, |i, t| if i < 2 { x[(i, t)] } else { x[(0, t)] + x[(1, t)] });
        for lambda in LAMBDAS {
            assert_rank(x.as_ref(), 2, lambda, [1e-12, 1e-13]).unwrap();
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn sums_of_channels_are_no_features(
        independent in 1usize..9, more in 1usize..5, n in 100usize..600, seed in any::<u64>(),
        lambda in prop::sample::select(LAMBDAS.to_vec()),
    ) {
        assert_rank(with_sums(independent, more, n, seed).as_ref(), independent, lambda, [1e-9, 1e-12])?;
    }

    /// `n` frames span `n − 1` directions from their mean.
    #[test]
    fn few_frames_have_fewer_features_than_frames(
        n in 2usize..12, more in 0usize..8, seed in any::<u64>(), lambda in prop::sample::select(LAMBDAS.to_vec()),
    ) {
        assert_rank(random_path(n + more, n, seed).as_ref(), n - 1, lambda, [1e-7, 1e-12])?;
    }

    /// Scales of channels are units, which say nothing: without λ the features are the same.
    #[test]
    fn scales_do_not_change_what_depends_on_what(
        independent in 1usize..6, more in 1usize..5, seed in any::<u64>(),
        exponents in prop::collection::vec(-14..15i32, 9), lambda in prop::sample::select(LAMBDAS.to_vec()),
    ) {
        let x = with_sums(independent, more, 400, seed);
        let scaled = Mat::from_fn(x.nrows(), 400, |i, t| 10f64.powi(exponents[i]) * x[(i, t)]);
        assert_rank(scaled.as_ref(), independent, lambda, [1e-6, 1e-12])?;
        let (plain, other) = (linear(x.as_ref(), independent, 0.0).unwrap(), linear(scaled.as_ref(), independent, 0.0).unwrap());
        for (a, b) in plain.slowness.iter().zip(&other.slowness) {
            prop_assert!((a - b).abs() < 1e-9 * a, "{} against {}", a, b);
        }
    }

    /// A channel that is another and 10⁻¹⁴ to 10¹⁴ times a third.
    #[test]
    fn sums_of_channels_of_other_scales_are_no_features(
        exponent in -14..15i32, seed in any::<u64>(), lambda in prop::sample::select(LAMBDAS.to_vec()),
    ) {
        let (x, scale) = (random_path(2, 500, seed), 10f64.powi(exponent));
        let y = Mat::from_fn(3, 500, |i, t| [x[(0, t)], scale * x[(1, t)], x[(0, t)] + scale * x[(1, t)]][i]);
        assert_rank(y.as_ref(), 2, lambda, [1e-6, 1e-12])?;
    }
}

/// The iteration finds what there is, and does not find more.
#[test]
fn few_of_many_coordinates_are_found_without_those_that_are_none() {
    fix_parallelism();
    let options = |method| SolveOptions { method, par: Par::Seq };
    let iterate = options(Method::Lanczos { tolerance: 1e-6 });
    for (name, x, rank) in [
        ("12 of 640", with_sums(12, 628, 400, 3), 12),
        ("50 of 640", with_sums(50, 590, 900, 4), 50),
        ("40 frames", random_path(640, 40, 5), 39),
    ] {
        let moments = batch_moments(x.as_ref(), &links(x.ncols()));
        for lambda in [1e-12, 1e-10, 1e-8, 1e-6, 1e-3, 1e-1] {
            for k in [1, rank] {
                let found = solve_with(&moments, k, lambda, None, &iterate).unwrap();
                let error = constraint_error(found.weights.as_ref(), x.as_ref());
                assert!(error < 1e-4, "{name}, lambda {lambda}, {k} features: off by {error}, {:?}", found.solver);
                assert!(found.slowness.iter().all(|slowness| *slowness >= 0.0));
                let iterated = matches!(found.solver, Solver::Lanczos { .. });
                assert!(
                    iterated || found.rank_deficit() == Some(640 - rank),
                    "{name}, lambda {lambda}: {:?}",
                    found.solver
                );
            }
            for k in [rank + 1, rank + 9] {
                let refused = solve_with(&moments, k, lambda, None, &iterate).unwrap_err();
                assert_eq!(refused, SlowError::Features { asked: k, rank }, "{name}, lambda {lambda}");
            }
        }
    }
}

/// A direction of little variance is one all the same, beside some that have none.
#[test]
fn a_weak_direction_is_found_beside_dependent_ones() {
    let (n, turn) = (5000, rotation(10, 6));
    for amplitude in [1e-3, 1e-4, 1e-5, 2e-6] {
        let mut generator = generator(5);
        let hidden = Mat::from_fn(10, n, |i, t| match i {
            0 => amplitude * (0.004 * t as f64).sin(),
            _ => generator.random_range(-1.0..1.0),
        });
        let turned = &turn * hidden;
        let x =
            Mat::from_fn(13, n, |i, t| if i < 10 { turned[(i, t)] } else { turned[(i - 10, t)] - turned[(i - 5, t)] });
        // Where λ‖w‖² outweighs slownesses, the sine comes after the noise, as what is not correlated with that.
        for (lambda, off) in [(0.0, 1e-6), (1e-16, 1e-6), (1e-14, 1e-6), (1e-1, 1e-2)] {
            let sfa = linear(x.as_ref(), 10, lambda).unwrap();
            assert_eq!((sfa.rank_deficit, dense(x.as_ref(), 1, lambda).unwrap().rank_deficit()), (3, Some(3)));
            assert_eq!(linear(x.as_ref(), 11, lambda).unwrap_err(), SlowError::Features { asked: 11, rank: 10 });
            let y = sfa.apply(x.as_ref()).unwrap();
            let first: Vec<f64> = (0..n).map(|t| y[(0, t)]).collect();
            let sine: Vec<f64> = (0..n).map(|t| (0.004 * t as f64).sin()).collect();
            let found = correlation(&first, &sine).abs();
            assert!(found > 1.0 - off, "amplitude {amplitude}, lambda {lambda}: {found}, {:?}", sfa.slowness);
        }
    }
}
