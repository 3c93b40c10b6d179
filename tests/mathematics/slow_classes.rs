//! Slow features of classes against exact theory: Berkes's theorem, Fisher's discriminant analysis, the errors of Bayes's rule.

use crate::common::{generator, relative_difference};
use adagio::slow::classes::{Gaussians, Spread, class_moments};
use adagio::slow::{Expansion, Moments, SlowError, solve};
use faer::{Mat, MatRef, Par};
use rand_distr::{Distribution, StandardNormal};

fn moments_of(x: MatRef<'_, f64>, classes: &[usize], par: Par) -> Moments {
    class_moments(classes, |part| Ok(x.subcols(part.start, part.len()).to_owned()), par).unwrap()
}

/// Samples of Gaussian classes with these means, one class after the other in turn.
fn gaussian_classes(means: &[&[f64]], samples: usize, seed: u64) -> (Mat<f64>, Vec<usize>) {
    let (mut rng, d) = (generator(seed), means[0].len());
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let classes: Vec<usize> = (0..samples).map(|t| t % means.len()).collect();
    let mut x = Mat::zeros(d, samples);
    for (t, &class) in classes.iter().enumerate() {
        let mut before = 0.0;
        for i in 0..d {
            // Each value depends on the one before, so that the covariance is no multiple of the identity.
            let value = normal() + 0.5 * before;
            (x[(i, t)], before) = (means[class][i] + value, value);
        }
    }
    (x, classes)
}

#[test]
fn sums_over_all_pairs_are_those_of_a_series_of_all_pairs() {
    let (x, classes) = gaussian_classes(&[&[0.0, 0.0, 1.0], &[1.0, -1.0, 0.0]], 11, 3);
    // Eleven samples: six of the one class, five of the other. A sample counts as often as any other, whatever its class.
    let mut series = Moments::new(Par::Seq);
    series.widen(3).unwrap();
    for class in 0..2 {
        let members: Vec<usize> = (0..11).filter(|&t| classes[t] == class).collect();
        let pairs = members.len() * (members.len() - 1);
        for &a in &members {
            series.add(x.subcols(a, 1), Mat::zeros(3, 0).as_ref(), 0.0).unwrap();
            for &b in members.iter().filter(|&&b| b != a) {
                let weight = members.len() as f64 / pairs as f64;
                let rate = Mat::from_fn(3, 1, |i, _| weight.sqrt() * (x[(i, a)] - x[(i, b)]));
                series.add(Mat::zeros(3, 0).as_ref(), rate.as_ref(), weight).unwrap();
            }
        }
    }
    let closed = moments_of(x.as_ref(), &classes, Par::Seq);
    assert_eq!(closed.frames(), series.frames());
    assert!((closed.links() - series.links()).abs() < 1e-9);
    assert!(relative_difference(closed.covariance().as_ref(), series.covariance().as_ref()) < 1e-12);
    assert!(relative_difference(closed.rate().as_ref(), series.rate().as_ref()) < 1e-12);
}

#[test]
fn the_slowest_linear_feature_of_two_classes_is_fishers_discriminant() {
    let (x, classes) = gaussian_classes(&[&[0.0, 0.0, 0.0, 0.0], &[1.0, 0.5, -1.0, 0.2]], 2000, 7);
    let moments = moments_of(x.as_ref(), &classes, Par::Seq);
    let features = solve(&moments, 1, 0.0, None).unwrap();
    // Fisher: the direction S⁻¹(μ₁ − μ₀), where S is the covariance within classes.
    let mut means = Mat::<f64>::zeros(4, 2);
    classes.iter().enumerate().for_each(|(t, &class)| (0..4).for_each(|i| means[(i, class)] += x[(i, t)] / 1000.0));
    let within = Mat::from_fn(4, 2000, |i, t| x[(i, t)] - means[(i, classes[t])]);
    let scatter = &within * within.transpose();
    let between = Mat::from_fn(4, 1, |i, _| means[(i, 1)] - means[(i, 0)]);
    let fisher = faer::linalg::solvers::Solve::solve(&scatter.llt(faer::Side::Lower).unwrap(), &between);
    let w = features.weights.col(0);
    let cosine = w.transpose() * fisher.col(0) / (w.norm_l2() * fisher.norm_l2());
    assert!(1.0 - cosine.abs() < 1e-12, "{cosine}");
    // Its slowness: twice the variance within classes over that of all, n/(n − 1) in each class.
    let along = |of: MatRef<'_, f64>| (w.transpose() * (of * w)) / 2000.0;
    let whole = along(scatter.as_ref()) + ((between.transpose() * w)[0] / 2.0).powi(2);
    let expected = 2.0 * along(scatter.as_ref()) * (1000.0 / 999.0) / whole;
    assert!((features.slowness[0] / expected - 1.0).abs() < 1e-9);
}

#[test]
fn with_enough_functions_all_but_one_of_the_classes_have_a_feature_that_is_constant_in_each() {
    // Berkes's theorem. Nine cubic monomials of two values tell eight samples apart.
    let (x, classes) = gaussian_classes(&[&[0.0, 0.0], &[0.5, 0.0], &[0.0, 0.5]], 8, 5);
    let monomials = Expansion::Cubic.apply(x.as_ref()).unwrap();
    let features = solve(&moments_of(monomials.as_ref(), &classes, Par::Seq), 2, 0.0, None).unwrap();
    assert!(features.slowness[1] < 1e-9, "{:?}", features.slowness);
    let y = features.weights.transpose() * &monomials;
    for i in 0..2 {
        let spread = (0..8).map(|t| (y[(i, t)] - y[(i, classes[t])]).abs()).fold(0.0, f64::max);
        assert!(spread < 1e-4, "feature {i}: {spread}");
    }
    // A third would have to vary within classes.
    assert!(solve(&moments_of(monomials.as_ref(), &classes, Par::Seq), 3, 0.0, None).unwrap().slowness[2] > 0.1);
}

#[test]
fn the_gaussian_classifier_makes_the_errors_of_bayess_rule() {
    // Two classes of unit variance, 2 apart, as frequent as each other: Φ(−1) of the samples are taken for the other one.
    let mut rng = generator(9);
    let n = 40_000;
    let classes: Vec<usize> = (0..n).map(|t| t % 2).collect();
    let mut draw = || {
        Mat::from_fn(1, n, |_, t| {
            2.0 * (t % 2) as f64 + f64::from(<StandardNormal as Distribution<f32>>::sample(&StandardNormal, &mut rng))
        })
    };
    let (train, test) = (draw(), draw());
    let bayes = 0.158655;
    for spread in [Spread::Own, Spread::Shared] {
        let gaussians = Gaussians::fit(train.as_ref(), &classes, spread, 0.0).unwrap();
        let found = gaussians.classify(test.as_ref()).unwrap();
        let error = found.iter().zip(&classes).filter(|(found, class)| found != class).count() as f64 / n as f64;
        // Three standard errors.
        assert!((error - bayes).abs() < 3.0 * (bayes * (1.0 - bayes) / n as f64).sqrt(), "{spread:?}: {error}");
    }
    // Same mean, other variances: only covariances of their own tell them apart.
    let apart = Mat::from_fn(1, n, |_, t| train[(0, t)] - 2.0 * (t % 2) as f64).to_owned();
    let apart = Mat::from_fn(1, n, |_, t| apart[(0, t)] * if t % 2 == 0 { 1.0 } else { 5.0 });
    let errors = |spread| {
        let found = Gaussians::fit(apart.as_ref(), &classes, spread, 0.0).unwrap().classify(apart.as_ref()).unwrap();
        found.iter().zip(&classes).filter(|(found, class)| found != class).count() as f64 / n as f64
    };
    assert!(errors(Spread::Own) < 0.25 && errors(Spread::Shared) > 0.45);
}

#[cfg(feature = "rayon")]
#[test]
fn threads_change_no_bit() {
    let (x, classes) = gaussian_classes(&[&[0.0, 0.0], &[3.0, 0.0]], 1200, 1);
    let bits = |par| {
        let rate = moments_of(x.as_ref(), &classes, par).rate();
        rate.col_iter()
            .flat_map(|column| column.iter().map(|value| value.to_bits()).collect::<Vec<_>>())
            .collect::<Vec<_>>()
    };
    assert_eq!(bits(Par::Seq), bits(Par::rayon(2)));
}

#[test]
fn what_is_wrong_is_refused() {
    let (x, classes) = gaussian_classes(&[&[0.0, 0.0], &[3.0, 0.0]], 1200, 1);
    // A class of one sample has no pair.
    let alone: Vec<usize> = (0..1200).map(|t| usize::from(t == 7)).collect();
    assert_eq!(moments_of(x.as_ref(), &alone, Par::Seq).links(), 1199.0);
    let none: Vec<usize> = (0..1200).collect();
    assert!(matches!(
        solve(&moments_of(x.as_ref(), &none, Par::Seq), 1, 0.0, None),
        Err(SlowError::TooFewFrames { .. })
    ));
    assert!(matches!(class_moments(&classes, |_| Ok(Mat::zeros(2, 3)), Par::Seq), Err(SlowError::Shape { .. })));
    let fit = |x: MatRef<'_, f64>, classes: &[usize], floor| Gaussians::fit(x, classes, Spread::Own, floor);
    assert!(matches!(fit(x.as_ref(), &classes[1..], 0.0), Err(SlowError::Shape { .. })));
    assert!(matches!(fit(Mat::zeros(2, 0).as_ref(), &[], 0.0), Err(SlowError::Empty(_))));
    assert_eq!(fit(x.as_ref(), &alone, 0.0).unwrap_err(), SlowError::Singular(1));
    assert!(fit(x.as_ref(), &alone, 1e-3).is_ok());
    let twice = Mat::from_fn(2, 1200, |_, t| x[(0, t)]);
    assert_eq!(fit(twice.as_ref(), &classes, 0.0).unwrap_err(), SlowError::Singular(0));
    let gaussians = fit(x.as_ref(), &classes, 0.0).unwrap();
    assert!(matches!(gaussians.classify(x.as_ref().subrows(0, 1)), Err(SlowError::Shape { .. })));
    let infinite = Mat::from_fn(2, 1200, |i, t| if (i, t) == (0, 5) { f64::NAN } else { x[(i, t)] });
    assert!(matches!(fit(infinite.as_ref(), &classes, 0.0), Err(SlowError::NotFinite(_))));
}
