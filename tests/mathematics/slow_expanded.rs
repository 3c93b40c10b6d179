//! Expanded SFA against known answers: the signal of Wiskott & Sejnowski, and what expansions and components must be.

use crate::common::{generator, random_path, relative_difference};
use adagio::slow::{Expansion, Keep, LinearSfa, Link, MOST_MONOMIALS, Pca, Pipeline, SlowError, Stage, Step};
use faer::Mat;
use proptest::prelude::*;
use rand::RngExt;

const EXPANDED: [Step; 2] = [Step::Expand(Expansion::Quadratic), Step::Sfa { features: 5, lambda: 0.0 }];

/// The signal with both ends of [0, 2π], and the time between two samples.
fn wiskott(n: usize) -> (Mat<f64>, f64) {
    let step = std::f64::consts::TAU / (n - 1) as f64;
    let x = Mat::from_fn(2, n, |row, i| {
        let t = i as f64 * step;
        let fast = (11.0 * t).cos();
        if row == 0 { t.sin() + fast * fast } else { fast }
    });
    (x, step)
}

/// Correlation of a row of a matrix with a function of the frame's index.
fn correlation(y: &Mat<f64>, row: usize, f: impl Fn(usize) -> f64) -> f64 {
    let n = y.ncols() as f64;
    let mean = |g: &dyn Fn(usize) -> f64| (0..y.ncols()).map(g).sum::<f64>() / n;
    let (my, mf) = (mean(&|t| y[(row, t)]), mean(&f));
    let product = mean(&|t| (y[(row, t)] - my) * (f(t) - mf));
    product / (mean(&|t| (y[(row, t)] - my).powi(2)) * mean(&|t| (f(t) - mf).powi(2))).sqrt()
}

#[test]
fn wiskott_sejnowski_signal_has_the_known_slow_features() {
    let (x, step) = wiskott(2000);
    let links = Link::regular(2000, step).unwrap();
    let pca_first = [Step::Pca { keep: Keep::All, whiten: true }, EXPANDED[0], EXPANDED[1]];
    let sfa_first = [Step::Sfa { features: 2, lambda: 0.0 }, EXPANDED[0], EXPANDED[1], Step::Clip(4.0)];
    for steps in [&EXPANDED[..], &pca_first, &sfa_first] {
        let pipeline = Pipeline::fit(steps, x.as_ref(), &links).unwrap();
        assert_eq!((pipeline.inputs(), pipeline.outputs()), (2, 5));
        let y = pipeline.apply(x.as_ref()).unwrap();
        let found = correlation(&y, 0, |t| (t as f64 * step).sin());
        assert!((found.abs() - 1.0).abs() < 1e-12, "{found}");
        for (found, known) in pipeline.slowness().iter().zip([1.0005, 120.93, 229.41, 357.47, 483.57]) {
            assert!((found - known).abs() < 6e-5 * known.max(1.0), "{found} against {known}");
        }
    }
    // x₁ − x₂² is the sine: the weights of x₁ and x₂² are opposite, the others nothing.
    let pipeline = Pipeline::fit(&EXPANDED, x.as_ref(), &links).unwrap();
    let Stage::Sfa(sfa) = &pipeline.stages()[1] else { panic!("the second stage is SFA") };
    let w: Vec<f64> = (0..5).map(|i| sfa.weights[(i, 0)] / sfa.weights[(0, 0)]).collect();
    for (found, exact) in w.iter().zip([1.0, 0.0, 0.0, 0.0, -1.0]) {
        assert!((found - exact).abs() < 1e-9, "{w:?}");
    }
    // Linear SFA alone does not find it.
    let y = LinearSfa::fit(x.as_ref(), &links, 2, 0.0).unwrap().apply(x.as_ref()).unwrap();
    assert!(correlation(&y, 0, |t| (t as f64 * step).sin()).abs() < 0.95);
}

#[test]
fn cubic_features_are_never_less_slow_than_quadratic_ones() {
    let x = random_path(3, 800, 21);
    let links = Link::regular(800, 1.0).unwrap();
    let slowness = |expansion| {
        let steps = [Step::Expand(expansion), Step::Sfa { features: 9, lambda: 0.0 }];
        Pipeline::fit(&steps, x.as_ref(), &links).unwrap().slowness().to_vec()
    };
    let (quadratic, cubic) = (slowness(Expansion::Quadratic), slowness(Expansion::Cubic));
    for (quadratic, cubic) in quadratic.iter().zip(&cubic) {
        assert!(cubic <= &(quadratic * (1.0 + 1e-9)), "{cubic} against {quadratic}");
    }
    assert!(cubic.iter().sum::<f64>() < 0.9 * quadratic.iter().sum::<f64>());
}

#[test]
fn monomials_are_all_there_in_their_order() {
    let order = Expansion::Quadratic.monomials(3).unwrap();
    let known: [&[usize]; 9] = [&[0], &[1], &[2], &[0, 0], &[0, 1], &[0, 2], &[1, 1], &[1, 2], &[2, 2]];
    assert_eq!(order, known);
    for d in 0..9 {
        for expansion in [Expansion::Quadratic, Expansion::Cubic] {
            let all = expansion.monomials(d).unwrap();
            assert_eq!(all.len(), expansion.outputs(d).unwrap());
            let mut different = all.clone();
            different.sort();
            different.dedup();
            assert_eq!(different.len(), all.len());
        }
    }
    // The numbers of the thesis's references: 50 inputs have 1325 monomials of degree 1 and 2.
    assert_eq!(Expansion::Quadratic.outputs(50), Ok(1325));
    let too_many = SlowError::Expansion { inputs: 50, most: MOST_MONOMIALS };
    assert_eq!(Expansion::Cubic.outputs(50), Err(too_many));
    assert!(Expansion::Cubic.outputs(usize::MAX).is_err() && Expansion::Quadratic.outputs(usize::MAX).is_err());
}

#[test]
fn components_are_those_of_the_covariance() {
    let mut rng = generator(2);
    let scales = [3.0, 1.0, 0.5, 0.1];
    let mix = Mat::from_fn(6, 4, |_, _| rng.random_range(-1.0..1.0));
    let x = mix * Mat::from_fn(4, 500, |i, _| scales[i] * rng.random_range(-1.0..1.0));
    let x = Mat::from_fn(6, 500, |i, t| x[(i, t)] + 100.0);
    let all = Pca::fit(x.as_ref(), Keep::All, false).unwrap();
    assert_eq!(all.outputs(), 4);
    // C·u = variance·u, by the covariance's definition.
    let centred = Mat::from_fn(6, 500, |i, t| x[(i, t)] - x.row(i).sum() / 500.0);
    let c = &centred * centred.transpose() * faer::Scale(1.0 / 500.0);
    let scaled = Mat::from_fn(6, 4, |i, j| all.projection[(i, j)] * all.variances[j]);
    assert!(relative_difference((&c * &all.projection).as_ref(), scaled.as_ref()) < 1e-12);
    assert!((all.total_variance - (0..6).map(|i| c[(i, i)]).sum::<f64>()).abs() < 1e-10);
    let white = Pca::fit(x.as_ref(), Keep::All, true).unwrap().apply(x.as_ref()).unwrap();
    let identity = &white * white.transpose() * faer::Scale(1.0 / 500.0);
    assert!(relative_difference(identity.as_ref(), Mat::<f64>::identity(4, 4).as_ref()) < 1e-10);
    for share in [0.3, 0.9, 0.99, 0.9999, 1.0] {
        let kept = Pca::fit(x.as_ref(), Keep::Variance(share), false).unwrap();
        let explained = |r: usize| all.variances[..r].iter().sum::<f64>() / all.total_variance;
        assert!(explained(kept.outputs()) >= share - 1e-12 && explained(kept.outputs() - 1) < share);
    }
    let asked = |keep| Pca::fit(x.as_ref(), keep, false).unwrap_err();
    assert_eq!(asked(Keep::Components(5)), SlowError::Features { asked: 5, rank: 4 });
    assert_eq!(asked(Keep::Components(0)), SlowError::Features { asked: 0, rank: 4 });
    assert_eq!(asked(Keep::Variance(1.5)), SlowError::VarianceShare(1.5));
}

#[test]
fn extreme_outputs_are_clipped() {
    let (x, step) = wiskott(500);
    let links = Link::regular(500, step).unwrap();
    let steps = [EXPANDED[0], EXPANDED[1], Step::Clip(4.0)];
    let clipped = Pipeline::fit(&steps, x.as_ref(), &links).unwrap();
    let plain = Pipeline::fit(&EXPANDED, x.as_ref(), &links).unwrap();
    let far = Mat::from_fn(2, 3, |i, t| 50.0 * (i + t) as f64 - 40.0);
    let (clipped, plain) = (clipped.apply(far.as_ref()).unwrap(), plain.apply(far.as_ref()).unwrap());
    for t in 0..3 {
        for i in 0..5 {
            assert_eq!(clipped[(i, t)], plain[(i, t)].clamp(-4.0, 4.0));
        }
    }
    assert!(plain.norm_max() > 100.0);
}

#[test]
fn faults_name_the_step() {
    let (x, step) = wiskott(50);
    let links = Link::regular(50, step).unwrap();
    let fit = |steps: &[Step]| Pipeline::fit(steps, x.as_ref(), &links).unwrap_err();
    let text = fit(&[EXPANDED[0], Step::Sfa { features: 6, lambda: 0.0 }]).to_string();
    assert!(text.starts_with("step 2: 6 features are asked for"), "{text}");
    assert_eq!(
        fit(&[Step::Clip(-1.0)]).to_string(),
        "step 1: outputs cannot be clipped at ±-1: the limit must be > 0 and finite"
    );
    assert!(matches!(fit(&[]), SlowError::Empty(_)));
    let pipeline = Pipeline::fit(&EXPANDED, x.as_ref(), &links).unwrap();
    assert!(matches!(pipeline.apply(Mat::zeros(3, 1).as_ref()), Err(SlowError::Shape { found: 3, expected: 2, .. })));
}

fn any_step() -> impl Strategy<Value = Step> {
    let keep = prop_oneof![
        Just(Keep::All),
        (0usize..4).prop_map(Keep::Components),
        prop_oneof![0.0..1.2f64, Just(f64::NAN)].prop_map(Keep::Variance)
    ];
    prop_oneof![
        (keep, any::<bool>()).prop_map(|(keep, whiten)| Step::Pca { keep, whiten }),
        Just(Step::Expand(Expansion::Quadratic)),
        Just(Step::Expand(Expansion::Cubic)),
        (0usize..4, prop_oneof![Just(0.0), 0.0..1.0f64]).prop_map(|(features, lambda)| Step::Sfa { features, lambda }),
        prop_oneof![Just(4.0), Just(f64::NAN), Just(0.0)].prop_map(Step::Clip),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Whatever is given: an error, or finite outputs.
    #[test]
    fn no_pipeline_panics(
        steps in prop::collection::vec(any_step(), 0..4),
        d in 0usize..4,
        n in 0usize..10,
        scale in prop_oneof![5 => Just(1.0), 1 => Just(0.0), 1 => Just(1e80), 1 => Just(1e-200), 1 => Just(f64::INFINITY)],
        seed in any::<u64>(),
    ) {
        let mut rng = generator(seed);
        let x = Mat::from_fn(d, n, |_, _| scale * rng.random_range(-1.0..1.0));
        let links = Link::regular(n, 0.5).unwrap();
        if let Ok(pipeline) = Pipeline::fit(&steps, x.as_ref(), &links) {
            prop_assert!(pipeline.slowness().iter().all(|s| s.is_finite()));
            let y = pipeline.apply(x.as_ref()).unwrap();
            prop_assert_eq!(y.nrows(), pipeline.outputs());
        }
    }
}
