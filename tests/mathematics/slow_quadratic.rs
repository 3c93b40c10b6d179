//! Quadratic forms: their largest value on a sphere against a search, invariances of an energy detector, forms of features.

use crate::common::{generator, rotation};
use adagio::slow::{Expansion, Keep, LinearSfa, Link, Pca, QuadraticForm, SlowError};
use faer::Mat;
use proptest::prelude::*;
use rand::RngExt;

fn form(h: &[&[f64]], f: &[f64]) -> QuadraticForm {
    QuadraticForm::new(Mat::from_fn(f.len(), f.len(), |i, j| h[i][j]), f.to_vec(), 0.5).unwrap()
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|value| value * value).sum::<f64>().sqrt()
}

proptest! {
    #[test]
    fn on_a_circle_it_is_largest_where_a_search_finds_it(
        h in prop::array::uniform3(-3.0..3.0f64), f in prop::array::uniform2(-2.0..2.0f64), radius in 0.1..5.0f64,
    ) {
        let form = form(&[&[h[0], h[1]], &[h[1], h[2]]], &f);
        let best = form.largest_at(radius).unwrap();
        prop_assert!((norm(&best) - radius).abs() < 1e-9 * radius);
        let around = (0..20_000).map(|i| std::f64::consts::TAU * f64::from(i) / 20_000.0);
        let searched = around.map(|angle| form.at(&[radius * angle.cos(), radius * angle.sin()])).fold(f64::MIN, f64::max);
        prop_assert!(form.at(&best) > searched - 1e-9);
        prop_assert!(form.at(&best) < searched + 1e-6 * (1.0 + radius * radius * 10.0));
    }

    #[test]
    fn no_point_of_a_sphere_has_more_and_the_gradient_points_outwards(seed in 0..500u64, n in 2..9usize) {
        let mut rng = generator(seed);
        let h = Mat::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
        let f: Vec<f64> = (0..n).map(|_| rng.random_range(-0.5..0.5)).collect();
        let form = QuadraticForm::new(h, f, 0.0).unwrap();
        let best = form.largest_at(1.5).unwrap();
        let gradient: Vec<f64> = (0..n).map(|i| (0..n).map(|j| form.h[(i, j)] * best[j]).sum::<f64>() + form.f[i]).collect();
        let along = gradient.iter().zip(&best).map(|(g, x)| g * x).sum::<f64>() / 2.25;
        let aside = norm(&gradient.iter().zip(&best).map(|(g, x)| g - along * x).collect::<Vec<_>>());
        prop_assert!(aside < 1e-7 * (1.0 + norm(&gradient)), "{aside}");
        for _ in 0..200 {
            let x: Vec<f64> = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
            let x: Vec<f64> = x.iter().map(|value| 1.5 * value / norm(&x)).collect();
            prop_assert!(form.at(&x) <= form.at(&best) + 1e-9);
        }
        // The smallest value is the largest of the negative form.
        let worst = form.negative().largest_at(1.5).unwrap();
        prop_assert!(form.at(&worst) <= form.at(&best));
    }
}

#[test]
fn without_one_of_its_parts_the_largest_value_is_known() {
    let plain = form(&[&[2.0, 0.0, 0.0], &[0.0, 5.0, 0.0], &[0.0, 0.0, -1.0]], &[0.0; 3]);
    let best = plain.largest_at(2.0).unwrap();
    assert!(best[0].abs() < 1e-12 && (best[1].abs() - 2.0).abs() < 1e-12);
    assert!((plain.at(&best) - (0.5 * 5.0 * 4.0 + 0.5)).abs() < 1e-12);
    let linear = form(&[&[0.0; 2], &[0.0; 2]], &[3.0, 4.0]);
    let best = linear.largest_at(10.0).unwrap();
    assert!((best[0] - 6.0).abs() < 1e-9 && (best[1] - 8.0).abs() < 1e-9);
    // The hard case: f has nothing along the first eigenvector, and is too weak.
    let hard = form(&[&[1.0, 0.0], &[0.0, 0.0]], &[0.0, 0.5]);
    let best = hard.largest_at(1.0).unwrap();
    assert!((best[1] - 0.5).abs() < 1e-9 && (best[0].abs() - 0.75f64.sqrt()).abs() < 1e-9);
    // And almost so.
    let near = form(&[&[1.0, 0.0], &[0.0, 0.0]], &[1e-13, 0.5]);
    assert!((near.at(&near.largest_at(1.0).unwrap()) - near.at(&best)).abs() < 1e-9);
}

#[test]
fn an_energy_detector_does_not_care_about_phase() {
    let n = 6;
    let basis = rotation(n, 4);
    let h = Mat::from_fn(n, n, |i, j| basis[(i, 0)] * basis[(j, 0)] + basis[(i, 1)] * basis[(j, 1)]);
    let energy = QuadraticForm::new(h, vec![0.0; n], 0.0).unwrap();
    let best = energy.largest_at(3.0).unwrap();
    assert!((energy.at(&best) - 4.5).abs() < 1e-9);
    let (second, directions) = energy.invariances(&best).unwrap();
    assert_eq!((second.len(), directions.ncols()), (5, 5));
    // In the plane of the two nothing changes; to leave it costs as much in every direction.
    assert!(second[0].abs() < 1e-9 && second[1..].iter().all(|value| (value + 1.0).abs() < 1e-9), "{second:?}");
    let in_plane: f64 = (0..2).map(|k| (0..n).map(|i| basis[(i, k)] * directions[(i, 0)]).sum::<f64>().powi(2)).sum();
    assert!((in_plane - 1.0).abs() < 1e-9);
    let across: f64 = (0..n).map(|i| best[i] * directions[(i, 0)]).sum();
    assert!(across.abs() < 1e-9);
}

#[test]
fn second_derivatives_on_the_sphere_are_those_of_a_walk_on_it() {
    let form = form(&[&[1.0, 0.3, 0.0], &[0.3, -0.5, 0.2], &[0.0, 0.2, 0.7]], &[0.2, -0.1, 0.4]);
    let radius = 2.0;
    let best = form.largest_at(radius).unwrap();
    let (second, directions) = form.invariances(&best).unwrap();
    for (j, second) in second.iter().enumerate() {
        let at = |way: f64| {
            let angle = way / radius;
            form.at(&(0..3)
                .map(|i| best[i] * angle.cos() + radius * directions[(i, j)] * angle.sin())
                .collect::<Vec<_>>())
        };
        let step = 1e-3;
        let measured = (at(step) - 2.0 * at(0.0) + at(-step)) / (step * step);
        assert!((measured - second).abs() < 1e-5, "{measured} {second}");
    }
}

#[test]
fn the_form_of_a_feature_has_its_values() {
    let mut rng = generator(8);
    let x = Mat::from_fn(7, 600, |i, t| {
        (0.05 * (i + 1) as f64 * t as f64).sin() * (i + 1) as f64 + 0.1 * rng.random_range(-1.0..1.0)
    });
    for whiten in [true, false] {
        let pca = Pca::fit(x.as_ref(), Keep::Components(4), whiten).unwrap();
        let monomials = Expansion::Quadratic.apply(pca.apply(x.as_ref()).unwrap().as_ref()).unwrap();
        let sfa = LinearSfa::fit(monomials.as_ref(), &Link::regular(600, 1.0).unwrap(), 3, 0.0).unwrap();
        let y = sfa.apply(monomials.as_ref()).unwrap();
        for feature in 0..3 {
            let form = QuadraticForm::of_feature(&sfa, &pca, feature).unwrap();
            for t in (0..600).step_by(37) {
                // Components in the orthonormal basis.
                let plain: Vec<f64> = (0..4)
                    .map(|k| {
                        let column = pca.projection.col(k);
                        (0..7).map(|i| column[i] * (x[(i, t)] - pca.mean[i])).sum::<f64>() / column.norm_l2()
                    })
                    .collect();
                assert!((form.at(&plain) - y[(feature, t)]).abs() < 1e-8 * (1.0 + y[(feature, t)].abs()));
            }
        }
        assert!(matches!(QuadraticForm::of_feature(&sfa, &pca, 3), Err(SlowError::Features { .. })));
        let fewer = Pca::fit(x.as_ref(), Keep::Components(3), whiten).unwrap();
        assert!(matches!(QuadraticForm::of_feature(&sfa, &fewer, 0), Err(SlowError::Shape { .. })));
    }
}

#[test]
fn what_is_no_form_or_no_radius_is_refused() {
    assert!(matches!(QuadraticForm::new(Mat::zeros(2, 2), vec![0.0; 3], 0.0), Err(SlowError::Shape { .. })));
    assert!(matches!(QuadraticForm::new(Mat::zeros(1, 1), vec![f64::NAN], 0.0), Err(SlowError::NotFinite(_))));
    let plain = form(&[&[1.0]], &[0.0]);
    for radius in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(plain.largest_at(radius), Err(SlowError::Radius(_))));
    }
    assert!(matches!(plain.invariances(&[0.0]), Err(SlowError::Radius(_))));
    assert!(matches!(plain.invariances(&[0.0, 1.0]), Err(SlowError::Shape { .. })));
}
