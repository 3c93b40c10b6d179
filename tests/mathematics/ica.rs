//! Independent components against known sources, and place cells from optimal responses.

use crate::common::generator;
use adagio::slow::ica::{Contrast, Decorrelation, IcaError, Options, fast_ica};
use adagio::slow::theory::{Axis, OptimalResponses};
use faer::Mat;
use proptest::prelude::*;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// Amari's index of `P = BA`: 0 if it is a permutation with scales, 1 at worst.
fn amari(p: &Mat<f64>) -> f64 {
    let k = p.nrows();
    let excess = |values: Vec<f64>| values.iter().sum::<f64>() / values.iter().copied().fold(0.0, f64::max) - 1.0;
    let rows: f64 = (0..k).map(|i| excess((0..k).map(|j| p[(i, j)].abs()).collect())).sum();
    let columns: f64 = (0..k).map(|j| excess((0..k).map(|i| p[(i, j)].abs()).collect())).sum();
    (rows + columns) / (2.0 * k as f64 * (k as f64 - 1.0))
}

/// Sources: uniform, Laplacian, skewed, two-valued, and mostly zero.
fn sources(k: usize, n: usize, seed: u64) -> Mat<f64> {
    let mut rng = generator(seed);
    let mut s = Mat::zeros(k, n);
    for t in 0..n {
        for i in 0..k {
            let u: f64 = rng.random_range(0.0..1.0);
            s[(i, t)] = match i {
                0 => u - 0.5,
                1 => (u - 0.5).signum() * -(1.0 - 2.0 * (u - 0.5).abs()).max(1e-300).ln(),
                2 => -(1.0 - u).ln(),
                3 => f64::from(u8::from(u < 0.5)),
                _ => {
                    if rng.random_range(0.0..1.0) < 0.05 {
                        u
                    } else {
                        0.0
                    }
                }
            };
        }
    }
    s
}

fn mixing(d: usize, k: usize, seed: u64) -> Mat<f64> {
    let mut rng = generator(seed ^ 77);
    Mat::from_fn(d, k, |_, _| StandardNormal.sample(&mut rng))
}

#[test]
fn known_sources_are_separated() {
    for decorrelation in [Decorrelation::Symmetric, Decorrelation::Deflation] {
        for contrast in [Contrast::Tanh, Contrast::Gauss, Contrast::Cube] {
            let mut worst = 0.0f64;
            for k in 3..=5 {
                for seed in 0..5 {
                    let s = sources(k, 10_000, seed);
                    // More inputs than sources: the rank must be found.
                    let a = mixing(k + 2, k, seed);
                    let x = &a * &s;
                    let options = Options { contrast, decorrelation, ..Options::default() };
                    let found = fast_ica(x.as_ref(), options, &mut generator(seed + 100)).unwrap();
                    assert_eq!(found.unmixing.nrows(), k);
                    // Sources of variance 1, else the index would compare units.
                    let scale: Vec<f64> = (0..k)
                        .map(|i| {
                            let mean = s.row(i).iter().sum::<f64>() / 1e4;
                            (s.row(i).iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 1e4).sqrt()
                        })
                        .collect();
                    let p = &found.unmixing * Mat::from_fn(k + 2, k, |i, j| a[(i, j)] * scale[j]);
                    worst = worst.max(amari(&p));
                    let y = found.apply(x.as_ref()).unwrap();
                    for i in 0..k {
                        let moment = |power| y.row(i).iter().map(|v| v.powi(power)).sum::<f64>() / 1e4;
                        assert!(moment(1).abs() < 1e-9 && (moment(2) - 1.0).abs() < 1e-9);
                        assert!(moment(3) >= 0.0 && (moment(3) - found.skewness[i]).abs() < 1e-9);
                        assert!((moment(4) - 3.0 - found.kurtosis[i]).abs() < 1e-6);
                        assert!(i == 0 || found.kurtosis[i] <= found.kurtosis[i - 1]);
                    }
                }
            }
            println!("{decorrelation:?} {contrast:?}: worst Amari index {worst:.4}");
            assert!(worst < 0.03, "{decorrelation:?} {contrast:?}: {worst}");
        }
    }
}

#[test]
fn the_start_does_not_matter_but_repeats() {
    let x = mixing(4, 4, 3) * sources(4, 5000, 3);
    let find = |seed| fast_ica(x.as_ref(), Options::default(), &mut generator(seed)).unwrap();
    let (a, b) = (find(1), find(2));
    assert_eq!(a, find(1));
    assert!((&a.unmixing - &b.unmixing).norm_max() < 1e-4 * a.unmixing.norm_max());
}

/// Thesis §4.2.3: slow features are waves over the whole room, their independent components are places.
#[test]
fn optimal_responses_of_a_room_become_place_cells() {
    let room = [Axis::free(0.0, 3.0).unwrap(), Axis::free(0.0, 1.8).unwrap()];
    let k = 20;
    let theory = OptimalResponses::slowest(&room, &[1.0, 1.0], k).unwrap();
    let mut rng = generator(5);
    let points = Mat::from_fn(2, 10_000, |d, _| room[d].width() * rng.random_range(0.0..1.0));
    let phi = theory.evaluate(points.as_ref()).unwrap();
    let n = phi.ncols() as f64;
    let kurtosis = |y: &Mat<f64>, i: usize| {
        let power = |p: i32| y.row(i).iter().map(|v| v.powi(p)).sum::<f64>() / n;
        power(4) / power(2).powi(2) - 3.0
    };
    let peak = |y: &Mat<f64>, i: usize| y.row(i).iter().fold(0.0f64, |a, v| a.max(v.abs()));
    // Share of the room in which a feature is above half of its peak.
    let field = |y: &Mat<f64>, i: usize| {
        let half = 0.5 * peak(y, i);
        y.row(i).iter().filter(|v| v.abs() > half).count() as f64 / n
    };
    let mean = |f: &dyn Fn(usize) -> f64| (0..k).map(f).sum::<f64>() / k as f64;
    for seed in 1..=3 {
        let options = Options { contrast: Contrast::Cube, ..Options::default() };
        let found = fast_ica(phi.as_ref(), options, &mut generator(seed)).unwrap();
        let y = found.apply(phi.as_ref()).unwrap();
        let (k_in, k_out) = (mean(&|i| kurtosis(&phi, i)), mean(&|i| kurtosis(&y, i)));
        let (p_in, p_out) = (mean(&|i| peak(&phi, i)), mean(&|i| peak(&y, i)));
        let (f_in, f_out) = (mean(&|i| field(&phi, i)), mean(&|i| field(&y, i)));
        println!(
            "start {seed}, {} iterations: kurtosis {k_in:.2} -> {k_out:.2}, peak {p_in:.2} -> {p_out:.2}, field {:.1} % -> {:.1} %",
            found.iterations,
            100.0 * f_in,
            100.0 * f_out
        );
        assert!(k_in < 0.0 && k_out > 5.0, "kurtosis {k_in} -> {k_out}");
        assert!(p_out > 2.5 * p_in, "peak {p_in} -> {p_out}");
        assert!(f_out < 0.2 * f_in, "field {f_in} -> {f_out}");
    }
}

#[test]
fn impossible_requests_are_refused() {
    let x = mixing(3, 3, 1) * sources(3, 100, 1);
    let ica = |x: &Mat<f64>, options| fast_ica(x.as_ref(), options, &mut generator(1));
    let of = |components| Options { components: Some(components), ..Options::default() };
    assert_eq!(ica(&x, of(4)).unwrap_err(), IcaError::Components { asked: 4, rank: 3 });
    assert_eq!(ica(&x, of(0)).unwrap_err(), IcaError::Components { asked: 0, rank: 3 });
    assert_eq!(ica(&Mat::from_fn(3, 1, |_, _| 1.0), of(1)).unwrap_err(), IcaError::TooFewSamples(1));
    // Two samples span one direction.
    let two = x.as_ref().subcols(0, 2).to_owned();
    assert_eq!(ica(&two, of(2)).unwrap_err(), IcaError::Components { asked: 2, rank: 1 });
    let constant = Mat::from_fn(3, 50, |i, _| 0.1 + i as f64);
    assert_eq!(ica(&constant, of(1)).unwrap_err(), IcaError::Components { asked: 1, rank: 0 });
    let mut holes = x.clone();
    holes[(1, 7)] = f64::NAN;
    assert!(matches!(ica(&holes, of(1)), Err(IcaError::NotFinite { row: 1, sample: 7, .. })));
    assert!(matches!(ica(&x, Options { tolerance: 0.0, ..of(1) }), Err(IcaError::Parameter { .. })));
    let hasty = Options { most_iterations: 1, ..Options::default() };
    assert!(matches!(ica(&x, hasty), Err(IcaError::NotConverged { iterations: 1, .. })));
    let found = ica(&x, Options::default()).unwrap();
    assert_eq!(found.apply(two.as_ref().subrows(0, 2)), Err(IcaError::Inputs { found: 2, expected: 3 }));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn nothing_panics(
        d in 0usize..5,
        values in prop::collection::vec(prop_oneof![8 => -1.0..1.0, 1 => prop::num::f64::ANY, 1 => Just(0.0)], 0..60),
        components in prop::option::of(0usize..5),
        deflate in any::<bool>(),
        which in 0usize..3,
    ) {
        let n = values.len() / d.max(1);
        let x = Mat::from_fn(d, n, |i, j| values[j * d + i]);
        let options = Options {
            components,
            contrast: [Contrast::Tanh, Contrast::Cube, Contrast::Gauss][which],
            decorrelation: if deflate { Decorrelation::Deflation } else { Decorrelation::Symmetric },
            most_iterations: 50,
            ..Options::default()
        };
        if let Ok(found) = fast_ica(x.as_ref(), options, &mut generator(1)) {
            prop_assert!(found.unmixing.col_iter().all(|c| c.iter().all(|v| v.is_finite())));
        }
    }
}
