//! Kernel SFA against known answers: theory, linear SFA, the projected process, the direct regularised problem.

use crate::common::{ald, generator, random_path, relative_difference};
use adagio::kernel::{Kernel, squared_norms};
use adagio::slow::{KernelSfa, LinearSfa, Link, SlowError, SlowModel, SlowStream, StreamOptions, solve};
use faer::{Mat, MatRef, Par, Side};
use proptest::prelude::*;
use rand::RngExt;

fn gram(kernel: Kernel, s: MatRef<'_, f64>, x: MatRef<'_, f64>) -> Mat<f64> {
    kernel.matrix(s, &squared_norms(s), x, &squared_norms(x), Par::Seq).unwrap()
}

/// Rows with each sign such that the first frame's value is positive.
fn signed(y: Mat<f64>) -> Mat<f64> {
    Mat::from_fn(y.nrows(), y.ncols(), |i, t| y[(i, t)] * y[(i, 0)].signum())
}

#[test]
fn a_kernel_of_full_rank_gives_the_cosines_of_time() {
    let n = 60;
    let x = random_path(3, n, 1);
    let k = gram(Kernel::laplacian(0.2).unwrap(), x.as_ref(), x.as_ref());
    let links = Link::regular(n, 1.0).unwrap();
    for sfa in [
        KernelSfa::exact(k.as_ref(), &links, 8, 0.0).unwrap(),
        KernelSfa::projected(k.as_ref(), k.as_ref(), &links, 8, 0.0).unwrap(),
    ] {
        let y = sfa.apply(k.as_ref()).unwrap();
        for j in 0..8 {
            let angle = (j + 1) as f64 * std::f64::consts::PI / n as f64;
            // n − 1 differences, but n frames.
            let slowness = 2.0 * (1.0 - angle.cos()) * n as f64 / (n - 1) as f64;
            assert!((sfa.slowness[j] - slowness).abs() < 1e-9 * slowness, "{} against {slowness}", sfa.slowness[j]);
            let sign = y[(j, 0)].signum();
            for t in 0..n {
                let cosine = 2f64.sqrt() * (angle * (t as f64 + 0.5)).cos();
                assert!((sign * y[(j, t)] - cosine).abs() < 1e-7, "feature {j} at {t}");
            }
        }
    }
    assert_eq!(KernelSfa::exact(k.as_ref(), &links, 1, 0.0).unwrap().rank, n - 1);
}

#[test]
fn with_a_linear_kernel_it_is_linear_sfa() {
    let x = random_path(4, 150, 2);
    let new = random_path(4, 40, 3);
    let links = Link::sequences(&[70, 80], 0.2).unwrap();
    let linear = LinearSfa::fit(x.as_ref(), &links, 4, 0.0).unwrap();
    let k = x.transpose() * &x;
    let exact = KernelSfa::exact(k.as_ref(), &links, 4, 0.0).unwrap();
    assert_eq!(exact.rank, 4);
    for j in 0..4 {
        assert!((exact.slowness[j] - linear.slowness[j]).abs() < 1e-9 * linear.slowness[j]);
    }
    for frames in [&x, &new] {
        let by_kernel = signed(exact.apply((x.transpose() * frames).as_ref()).unwrap());
        let directly = signed(linear.apply(frames.as_ref()).unwrap());
        assert!(relative_difference(by_kernel.as_ref(), directly.as_ref()) < 1e-8);
    }
    // λ means the same in both: the norm of the weights.
    let linear = LinearSfa::fit(x.as_ref(), &links, 4, 0.05).unwrap();
    let exact = KernelSfa::exact(k.as_ref(), &links, 4, 0.05).unwrap();
    let by_kernel = signed(exact.apply(k.as_ref()).unwrap());
    assert!(relative_difference(by_kernel.as_ref(), signed(linear.apply(x.as_ref()).unwrap()).as_ref()) < 1e-8);
}

#[test]
fn the_projected_process_with_all_support_vectors_is_exact() {
    let x = random_path(3, 120, 4);
    let new = random_path(3, 50, 5);
    let links = Link::regular(120, 0.5).unwrap();
    for (kernel, lambda, tolerance) in
        [(Kernel::laplacian(0.3).unwrap(), 0.0, 1e-6), (Kernel::gaussian(0.4).unwrap(), 1e-3, 1e-6)]
    {
        let k = gram(kernel, x.as_ref(), x.as_ref());
        let exact = KernelSfa::exact(k.as_ref(), &links, 5, lambda).unwrap();
        let projected = KernelSfa::projected(k.as_ref(), k.as_ref(), &links, 5, lambda).unwrap();
        let rows = gram(kernel, x.as_ref(), new.as_ref());
        let (a, b) = (signed(exact.apply(rows.as_ref()).unwrap()), signed(projected.apply(rows.as_ref()).unwrap()));
        assert!(relative_difference(a.as_ref(), b.as_ref()) < tolerance);
        for j in 0..5 {
            assert!((exact.slowness[j] - projected.slowness[j]).abs() < 1e-7 * exact.slowness[j]);
        }
        let model = KernelSfa::model(kernel, x.as_ref(), &links, 5, lambda).unwrap();
        let phi = model.apply(new.as_ref(), Par::Seq).unwrap();
        let c = signed(phi.as_ref().subrows(1, 5).to_owned());
        assert!(relative_difference(c.as_ref(), a.as_ref()) < 1e-9);
    }
}

#[test]
fn the_projected_process_is_linear_sfa_on_kernel_rows() {
    let x = random_path(3, 400, 6);
    let links = Link::regular(400, 1.0).unwrap();
    let kernel = Kernel::laplacian(0.5).unwrap();
    let support = Mat::from_fn(3, 20, |i, j| x[(i, 20 * j)]);
    let k = gram(kernel, support.as_ref(), support.as_ref());
    let rows = gram(kernel, support.as_ref(), x.as_ref());
    let projected = KernelSfa::projected(k.as_ref(), rows.as_ref(), &links, 6, 0.0).unwrap();
    let linear = LinearSfa::fit(rows.as_ref(), &links, 6, 0.0).unwrap();
    let (a, b) = (signed(projected.apply(rows.as_ref()).unwrap()), signed(linear.apply(rows.as_ref()).unwrap()));
    assert!(relative_difference(a.as_ref(), b.as_ref()) < 1e-8);
    for j in 0..6 {
        assert!((projected.slowness[j] - linear.slowness[j]).abs() < 1e-10 * linear.slowness[j]);
    }
}

/// Regularised sparse kernel SFA straight from its definition: minimise αᵀ(K̇K̇ᵀ/l + λK)α subject to
/// αᵀ(K̂K̂ᵀ/n − k̄k̄ᵀ)α = 1, by whitening the constraint.
fn direct(k: &Mat<f64>, rows: &Mat<f64>, features: usize, lambda: f64) -> (Mat<f64>, Vec<f64>) {
    let (m, n) = (rows.nrows(), rows.ncols());
    let mean: Vec<f64> = (0..m).map(|i| rows.row(i).sum() / n as f64).collect();
    let centred = Mat::from_fn(m, n, |i, t| rows[(i, t)] - mean[i]);
    let rates = Mat::from_fn(m, n - 1, |i, t| rows[(i, t + 1)] - rows[(i, t)]);
    let covariance = &centred * centred.transpose() * faer::Scale(1.0 / n as f64);
    let cost = &rates * rates.transpose() * faer::Scale(1.0 / (n - 1) as f64) + k * faer::Scale(lambda);
    let eigen = covariance.self_adjoint_eigen(Side::Lower).unwrap();
    let white = Mat::from_fn(m, m, |i, j| eigen.U()[(i, j)] / eigen.S()[j].sqrt());
    let inner = (white.transpose() * cost * &white).self_adjoint_eigen(Side::Lower).unwrap();
    let alpha = white * inner.U().subcols(0, features);
    let values = (0..features).map(|j| inner.S()[j]).collect();
    (alpha.transpose() * centred, values)
}

#[test]
fn a_stream_solves_regularised_sparse_kernel_sfa() {
    let x = random_path(3, 500, 7);
    let links = Link::regular(500, 1.0).unwrap();
    let options = StreamOptions { retained: 1000, settle_at: 5, ..StreamOptions::default() };
    let mut stream = SlowStream::new(ald(0.5, 0.05, 1000), options).unwrap();
    for start in (0..500).step_by(50) {
        stream.push(x.as_ref().subcols(start, 50), &links[start..start + 50]).unwrap();
    }
    let members = stream.dictionary().members().to_owned();
    let kernel = Kernel::gaussian(0.5).unwrap();
    let k = gram(kernel, members.as_ref(), members.as_ref());
    let rows = gram(kernel, members.as_ref(), x.as_ref());
    for lambda in [1e-4, 1e-2] {
        let (y, values) = direct(&k, &rows, 3, lambda);
        let features = solve(stream.settled_moments().unwrap(), 3, lambda, None).unwrap();
        let model = SlowModel::new(stream.dictionary(), &features).unwrap();
        let phi = model.apply(x.as_ref(), Par::Seq).unwrap();
        let projected = KernelSfa::projected(k.as_ref(), rows.as_ref(), &links, 3, lambda).unwrap();
        let z = projected.apply(rows.as_ref()).unwrap();
        // Δ + λ‖w‖² is the direct problem's eigenvalue.
        for j in 0..3 {
            let norm: f64 = (0..features.weights.nrows()).map(|i| features.weights[(i, j)].powi(2)).sum();
            let cost = features.slowness[j] + lambda * norm;
            assert!(values.iter().any(|value| (cost - value).abs() < 1e-6 * value), "{cost} is none of {values:?}");
        }
        for j in 0..3 {
            let agreement = |f: &dyn Fn(usize) -> f64| {
                (0..3).map(|i| ((0..500).map(|t| y[(i, t)] * f(t)).sum::<f64>() / 500.0).powi(2)).fold(0.0, f64::max)
            };
            assert!((agreement(&|t| phi[(j + 1, t)]) - 1.0).abs() < 1e-6);
            assert!((agreement(&|t| z[(j, t)]) - 1.0).abs() < 1e-6);
        }
    }
}

#[test]
fn what_is_no_kernel_matrix_is_refused() {
    let links = Link::regular(4, 1.0).unwrap();
    let exact = |gram: Mat<f64>| KernelSfa::exact(gram.as_ref(), &links, 1, 0.0).unwrap_err();
    assert!(matches!(exact(Mat::zeros(4, 3)), SlowError::Shape { found: 3, expected: 4, .. }));
    assert!(matches!(exact(Mat::from_fn(4, 4, |i, j| (i * 4 + j) as f64)), SlowError::Gram(_)));
    assert!(matches!(exact(Mat::<f64>::identity(4, 4) * faer::Scale(-1.0)), SlowError::Gram(_)));
    assert!(matches!(exact(Mat::from_fn(4, 4, |_, _| f64::NAN)), SlowError::NotFinite(_)));
    assert_eq!(exact(Mat::from_fn(4, 4, |_, _| 1.0)), SlowError::Features { asked: 1, rank: 0 });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Whatever is given: an error, or finite features.
    #[test]
    fn no_matrix_panics(
        m in 0usize..5,
        n in 0usize..8,
        off in 0usize..2,
        scale in prop_oneof![4 => Just(1.0), 1 => Just(0.0), 1 => Just(1e200), 1 => Just(1e-200), 1 => Just(f64::NAN)],
        seed in any::<u64>(),
        features in 0usize..4,
        lambda in prop_oneof![2 => Just(0.0), 1 => 0.0..1.0f64, 1 => Just(-1.0)],
    ) {
        let mut rng = generator(seed);
        let mut random = |rows, columns| Mat::from_fn(rows, columns, |_, _| scale * rng.random_range(-1.0..1.0));
        let (a, b) = (random(m, m + off), random(m, n));
        let k = &a * a.transpose();
        let links = Link::regular(n, 1.0).unwrap();
        let all_links = Link::regular(m, 1.0).unwrap();
        for sfa in [
            KernelSfa::exact(k.as_ref(), &all_links, features, lambda),
            KernelSfa::exact(a.as_ref(), &all_links, features, lambda),
            KernelSfa::projected(k.as_ref(), b.as_ref(), &links, features, lambda),
        ].into_iter().flatten() {
            prop_assert!(sfa.slowness.iter().all(|s| s.is_finite()));
            prop_assert!(sfa.apply(b.as_ref()).unwrap().nrows() == features);
        }
    }
}
