//! Kernels and their principal components against known answers.

use crate::common::{generator, random_path, relative_difference};
#[cfg(feature = "snapshot")]
use adagio::kernel::Form;
use adagio::kernel::{Approximation, Kernel, KernelError, KernelPca, Scaling, median_distance, squared_norms};
use faer::{Mat, MatRef, Par, Side};
use proptest::prelude::*;
use rand::RngExt;

const APPROXIMATIONS: [Approximation; 3] =
    [Approximation::SubsetOfData, Approximation::Nystrom, Approximation::ProjectedProcess];

fn random(d: usize, n: usize, seed: u64) -> Mat<f64> {
    let mut rng = generator(seed);
    Mat::from_fn(d, n, |_, _| rng.random_range(-1.0..1.0))
}

fn gram(kernel: Kernel, x: MatRef<'_, f64>) -> Mat<f64> {
    let norms = squared_norms(x);
    kernel.matrix(x, &norms, x, &norms, Par::Seq).unwrap()
}

fn trace(matrix: MatRef<'_, f64>) -> f64 {
    (0..matrix.nrows()).map(|i| matrix[(i, i)]).sum()
}

fn centred(x: MatRef<'_, f64>) -> Mat<f64> {
    let n = x.ncols() as f64;
    Mat::from_fn(x.nrows(), x.ncols(), |i, j| x[(i, j)] - x.row(i).iter().sum::<f64>() / n)
}

/// Largest difference of rows that may have opposite signs, as a share of the largest entry.
fn difference_up_to_sign(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
    assert_eq!((a.nrows(), a.ncols()), (b.nrows(), b.ncols()));
    let scale = b.norm_max();
    (0..a.nrows())
        .map(|i| {
            let worst = |sign: f64| (0..a.ncols()).map(|j| (a[(i, j)] - sign * b[(i, j)]).abs()).fold(0.0, f64::max);
            worst(1.0).min(worst(-1.0)) / scale
        })
        .fold(0.0, f64::max)
}

// ---- kernels
// ---------------------------------------------------------------------------------------------------------

#[test]
fn kernel_values_are_those_of_the_explicit_expansions() {
    // Thesis §2.2.3: ψ(x) = [x₁², x₂², √2 x₁x₂, √2 x₁, √2 x₂, 1] for (xᵀx′ + 1)².
    let x = random(2, 9, 1);
    let root = 2.0f64.sqrt();
    let psi = Mat::from_fn(6, 9, |i, j| {
        let (a, b) = (x[(0, j)], x[(1, j)]);
        [a * a, b * b, root * a * b, root * a, root * b, 1.0][i]
    });
    let explicit = psi.transpose() * &psi;
    let kernel = Kernel::polynomial(2, 1.0).unwrap();
    assert!(relative_difference(gram(kernel, x.as_ref()).as_ref(), explicit.as_ref()) < 1e-14);

    let linear = x.transpose() * &x;
    assert!(relative_difference(gram(Kernel::linear(), x.as_ref()).as_ref(), linear.as_ref()) < 1e-15);

    let unit = Mat::from_fn(2, 9, |i, j| x[(i, j)] / x[(0, j)].hypot(x[(1, j)]));
    let cubes = {
        let cosine = unit.transpose() * &unit;
        Mat::from_fn(9, 9, |i, j| cosine[(i, j)].powi(3))
    };
    let kernel = Kernel::normalised_polynomial(3).unwrap();
    assert!(relative_difference(gram(kernel, x.as_ref()).as_ref(), cubes.as_ref()) < 1e-14);
}

#[test]
fn an_exponent_above_two_would_not_be_positive_definite() {
    // 0, 1, 2 on a line and exp(−c·distance^2.5). With v = (1, −2, 1): vᵀKv = 6k(0) − 8k(1) + 2k(2) ≈ c(8 − 2·2^2.5) =
    // −3.31c for a small c. Computed here with c = 0.01, by hand and by eigenvalues.
    let k = |distance: f64| (-0.01 * distance.powf(2.5)).exp();
    let quadratic_form = 6.0 * k(0.0) - 8.0 * k(1.0) + 2.0 * k(2.0);
    assert!(quadratic_form < -0.03, "{quadratic_form}");
    let matrix = Mat::from_fn(3, 3, |i, j| k((i as f64 - j as f64).abs()));
    assert!(matrix.self_adjoint_eigenvalues(Side::Lower).unwrap()[0] < -0.005);
    // At 2 the same form is not negative, and an exponent of 2.5 is refused.
    let k = |distance: f64| (-0.01 * distance * distance).exp();
    assert!(6.0 * k(0.0) - 8.0 * k(1.0) + 2.0 * k(2.0) > 0.0);
    assert_eq!(Kernel::radial(1.0, 2.5), Err(KernelError::Exponent(2.5)));
}

#[test]
fn a_zero_vector_has_no_direction() {
    let mut x = random(3, 4, 5);
    x.col_mut(2).fill(0.0);
    let k = gram(Kernel::normalised_polynomial(2).unwrap(), x.as_ref());
    for i in 0..4 {
        assert_eq!(k[(i, 2)], 0.0);
        assert_eq!(k[(2, i)], 0.0);
    }
    assert_eq!(Kernel::normalised_polynomial(2).unwrap().diagonal(0.0), 0.0);
}

#[cfg(feature = "snapshot")]
#[test]
fn a_kernel_is_stored_as_its_form_and_an_invalid_form_is_not_read() {
    for kernel in [
        Kernel::linear(),
        Kernel::polynomial(3, 0.5).unwrap(),
        Kernel::normalised_polynomial(2).unwrap(),
        Kernel::radial(2.5, 1.5).unwrap(),
    ] {
        let text = serde_json::to_string(&kernel).unwrap();
        assert_eq!(serde_json::from_str::<Kernel>(&text).unwrap(), kernel, "{text}");
        assert_eq!(Kernel::try_from(kernel.form()), Ok(kernel));
    }
    let invalid = serde_json::to_string(&Form::Radial { sigma: 1.0, exponent: 3.0 }).unwrap();
    let error = serde_json::from_str::<Kernel>(&invalid).unwrap_err().to_string();
    assert!(error.contains("exponent = 3"), "{error}");
}

/// Whole numbers, whose products are exact: so block and single value see the same numbers.
fn pixels(d: usize, n: usize, seed: u64) -> Mat<f32> {
    let mut rng = generator(seed);
    Mat::from_fn(d, n, |_, _| f32::from(rng.random_range(-60i8..60)))
}

/// More observations than one tile holds, in both directions.
#[cfg(feature = "rayon")]
#[test]
fn a_block_has_the_bits_of_single_values_on_any_number_of_threads() {
    let (s, x) = (pixels(48, 1100, 1), pixels(48, 530, 2));
    let (ns, nx) = (squared_norms(s.as_ref()), squared_norms(x.as_ref()));
    for kernel in [
        Kernel::gaussian(150.0),
        Kernel::gaussian(5.0),
        Kernel::laplacian(200.0),
        Kernel::radial(200.0, 1.3),
        Kernel::polynomial(3, 2.0),
        Kernel::normalised_polynomial(4),
        Ok(Kernel::linear()),
    ] {
        let kernel = kernel.unwrap();
        let block = kernel.matrix(s.as_ref(), &ns, x.as_ref(), &nx, Par::Seq).unwrap();
        for threads in 1..5 {
            let again = kernel.matrix(s.as_ref(), &ns, x.as_ref(), &nx, Par::rayon(threads)).unwrap();
            assert!(block == again, "{kernel} on {threads} threads");
        }
        for (i, j) in [(0, 0), (511, 511), (512, 512), (1099, 529), (700, 3), (5, 528)] {
            let product: f32 = (0..48).map(|r| s[(r, i)] * x[(r, j)]).sum();
            assert_eq!(block[(i, j)], kernel.value(f64::from(product), ns[i], nx[j]), "{kernel} at ({i}, {j})");
        }
    }
}

/// What is narrower than the smallest normal number is 0, and an observation is as near to itself as can be.
#[test]
fn the_far_and_the_near_end_of_a_radial_kernel_are_exact() {
    let x = pixels(48, 40, 3);
    let norms = squared_norms(x.as_ref());
    for kernel in [Kernel::gaussian(0.5), Kernel::laplacian(0.5), Kernel::radial(0.01, 0.9)].map(Result::unwrap) {
        let k = kernel.matrix(x.as_ref(), &norms, x.as_ref(), &norms, Par::Seq).unwrap();
        for j in 0..40 {
            assert_eq!(k[(j, j)], 1.0);
        }
    }
    let narrow = Kernel::gaussian(0.5).unwrap().matrix(x.as_ref(), &norms, x.as_ref(), &norms, Par::Seq).unwrap();
    assert_eq!(narrow[(0, 1)], 0.0);
}

fn valid_kernels() -> impl Strategy<Value = Kernel> {
    prop_oneof![
        Just(Kernel::linear()),
        (1u32..6, 0.0..3.0f64).prop_map(|(degree, offset)| Kernel::polynomial(degree, offset).unwrap()),
        (1u32..8).prop_map(|degree| Kernel::normalised_polynomial(degree).unwrap()),
        (0.05..20.0f64, 0.05..=2.0f64).prop_map(|(sigma, exponent)| Kernel::radial(sigma, exponent).unwrap()),
        (0.05..20.0f64).prop_map(|sigma| Kernel::gaussian(sigma).unwrap()),
    ]
}

/// Kernels at the ends of what is allowed, too.
fn extreme_kernels() -> impl Strategy<Value = Kernel> {
    let extreme = [
        Kernel::polynomial(i32::MAX as u32, 1.0),
        Kernel::polynomial(3, 1e308),
        Kernel::normalised_polynomial(i32::MAX as u32),
        Kernel::gaussian(1e-150),
        Kernel::gaussian(1e150),
        Kernel::radial(1.0, f64::MIN_POSITIVE),
    ];
    prop_oneof![4 => valid_kernels(), 1 => prop::sample::select(extreme.map(Result::unwrap).to_vec())]
}

/// Values a caller might have in a matrix, good and bad.
fn any_value() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -10.0..10.0f64,
        2 => Just(0.0),
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e308, -1e200, 1e-310]),
    ]
}

fn any_matrix() -> impl Strategy<Value = Mat<f64>> {
    (0usize..5, 0usize..9, any::<bool>()).prop_flat_map(|(d, n, constant)| {
        let values = prop::collection::vec(any_value(), if constant { 1 } else { (d * n).max(1) });
        values.prop_map(move |v| Mat::from_fn(d, n, |i, j| v[(j * d + i) % v.len()]))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// For valid parameters no Gram matrix has a negative eigenvalue, zero observations and copies included.
    #[test]
    fn gram_matrices_are_positive_definite(kernel in valid_kernels(), seed in any::<u64>(), d in 1usize..6, n in 2usize..30) {
        let mut x = random(d, n, seed);
        x.col_mut(0).fill(0.0);
        if n > 3 {
            let copy = x.col(1).to_owned();
            x.col_mut(n - 1).copy_from(&copy);
        }
        let k = gram(kernel, x.as_ref());
        let norms = squared_norms(x.as_ref());
        for i in 0..n {
            let diagonal = kernel.diagonal(norms[i]);
            prop_assert!((k[(i, i)] - diagonal).abs() <= 1e-12 * diagonal.max(1.0));
        }
        let smallest = k.self_adjoint_eigenvalues(Side::Lower).unwrap()[0];
        prop_assert!(smallest >= -1e-10 * trace(k.as_ref()), "{kernel}: {smallest}");
    }

    /// Nothing that is given makes the public functions panic.
    #[test]
    fn nothing_panics(
        kernel in extreme_kernels(),
        x in any_matrix(),
        s in any_matrix(),
        components in 0usize..6,
        which in 0usize..3,
        unit in any::<bool>(),
    ) {
        let norms = squared_norms(x.as_ref());
        let square = kernel.matrix(x.as_ref(), &norms, x.as_ref(), &norms, Par::Seq).unwrap();
        prop_assert_eq!(square.ncols(), x.ncols());
        let mismatch = kernel.matrix(s.as_ref(), &norms, x.as_ref(), &norms, Par::Seq);
        prop_assert!(mismatch.is_ok() == (s.ncols() == x.ncols() && s.nrows() == x.nrows()));
        for (product, norm) in x.as_ref().col_iter().flat_map(|column| column.iter().zip(&norms).collect::<Vec<_>>()) {
            let value = kernel.value(*product, *norm, 1.0);
            prop_assert!(!product.is_nan() || value.is_nan() || *norm == 0.0);
            prop_assert!(!norm.is_nan() || kernel.diagonal(*norm).is_nan() || kernel.sigma().is_some());
        }
        if let Ok(width) = median_distance(x.as_ref()) {
            prop_assert!(width > 0.0 && width.is_finite());
        }
        let scaling = if unit { Scaling::UnitVariance } else { Scaling::Principal };
        let pca = KernelPca::approximate(kernel, s.as_ref(), x.as_ref(), APPROXIMATIONS[which], components, scaling, Par::Seq);
        if let Ok(pca) = pca {
            if let Ok(phi) = pca.apply(x.as_ref(), Par::Seq) {
                prop_assert!(phi.is_all_finite());
            }
            if let Ok(phi) = pca.apply(square.as_ref(), Par::Seq) {
                prop_assert!(phi.is_all_finite());
            }
        }
    }
}

#[test]
fn observations_that_are_not_finite_spoil_their_own_values_only() {
    let mut x = random(3, 5, 8);
    let clean = gram(Kernel::gaussian(1.0).unwrap(), x.as_ref());
    x[(1, 2)] = f64::NAN;
    x[(0, 4)] = f64::INFINITY;
    let k = gram(Kernel::gaussian(1.0).unwrap(), x.as_ref());
    for i in [0, 1, 3] {
        assert!(k[(i, 2)].is_nan());
        assert!(k[(i, 4)].is_nan() || k[(i, 4)] == 0.0);
        for j in [0, 1, 3] {
            assert_eq!(k[(i, j)], clean[(i, j)]);
        }
    }
}

// ---- principal components
// --------------------------------------------------------------------------------------------

#[test]
fn with_the_linear_kernel_it_is_ordinary_pca() {
    let x = Mat::from_fn(4, 120, |i, j| random_path(4, 120, 3)[(i, j)] * [1.0, 5.0, 2.0, 0.5][i] + 3.0);
    let middle = centred(x.as_ref());
    let svd = middle.thin_svd().unwrap();
    let coordinates = svd.U().transpose() * &middle;
    for method in APPROXIMATIONS {
        let pca =
            KernelPca::approximate(Kernel::linear(), x.as_ref(), x.as_ref(), method, 4, Scaling::Principal, Par::Seq);
        let pca = pca.unwrap();
        for i in 0..4 {
            let exact = svd.S()[i] * svd.S()[i] / 120.0;
            assert!((pca.variances()[i] / exact - 1.0).abs() < 1e-9, "{method:?} {i}");
        }
        let phi = pca.apply(x.as_ref(), Par::Seq).unwrap();
        let difference = difference_up_to_sign(phi.as_ref(), coordinates.as_ref());
        assert!(difference < 1e-9, "{method:?}: {difference}");
    }
    // The samples span 4 directions, so there is no fifth component.
    let fifth = KernelPca::exact(Kernel::linear(), x.as_ref(), 5, Scaling::Principal, Par::Seq).unwrap_err();
    assert_eq!(fifth, KernelError::Components { asked: 5, rank: 4 });
}

#[test]
fn with_all_samples_as_support_vectors_every_approximation_is_exact() {
    let x = random_path(3, 60, 7);
    for kernel in [Kernel::gaussian(0.5).unwrap(), Kernel::laplacian(0.5).unwrap(), Kernel::polynomial(3, 1.0).unwrap()]
    {
        let exact = KernelPca::exact(kernel, x.as_ref(), 5, Scaling::Principal, Par::Seq).unwrap();
        // The oracle: eigenvalues of the centred kernel matrix, computed apart.
        let k = gram(kernel, x.as_ref());
        let once = centred(k.as_ref());
        let both = centred(once.transpose());
        let values = both.self_adjoint_eigenvalues(Side::Lower).unwrap();
        let new = random(3, 20, 1);
        let expected = exact.apply(new.as_ref(), Par::Seq).unwrap();
        for method in APPROXIMATIONS {
            let pca = KernelPca::approximate(kernel, x.as_ref(), x.as_ref(), method, 5, Scaling::Principal, Par::Seq)
                .unwrap();
            for i in 0..5 {
                assert!((pca.variances()[i] * 60.0 / values[59 - i] - 1.0).abs() < 1e-8, "{kernel} {method:?} {i}");
            }
            let phi = pca.apply(new.as_ref(), Par::Seq).unwrap();
            let difference = difference_up_to_sign(phi.as_ref(), expected.as_ref());
            assert!(difference < 1e-7, "{kernel} {method:?}: {difference}");
        }
    }
}

/// Observations that no sample equals: against ordinary PCA of the explicit expansion, whose centre is the samples' mean.
#[test]
fn new_observations_are_centred_by_the_samples() {
    // ψ of (xᵀx′ + 1)²; means far from zero, so that a wrong centre shows.
    let root = 2.0f64.sqrt();
    let expand = |x: &Mat<f64>| {
        Mat::from_fn(6, x.ncols(), |i, j| {
            let (a, b) = (x[(0, j)], x[(1, j)]);
            [a * a, b * b, root * a * b, root * a, root * b, 1.0][i]
        })
    };
    let shifted = |x: Mat<f64>| Mat::from_fn(2, x.ncols(), |i, j| x[(i, j)] + [2.0, -1.0][i]);
    let (x, new) = (shifted(random(2, 50, 1)), shifted(random(2, 20, 2)));
    let kernel = Kernel::polynomial(2, 1.0).unwrap();
    // Eight samples span the six dimensions, so every projected process is exact too.
    for (method, m) in [
        (Approximation::SubsetOfData, 50),
        (Approximation::Nystrom, 50),
        (Approximation::ProjectedProcess, 50),
        (Approximation::ProjectedProcess, 8),
        (Approximation::SubsetOfData, 8),
    ] {
        let s = x.as_ref().subcols(0, m);
        // The subset of data knows the mean and the directions of its support vectors alone.
        let over = if method == Approximation::SubsetOfData { s.to_owned() } else { x.clone() };
        let psi = expand(&over);
        let middle = centred(psi.as_ref());
        let svd = middle.thin_svd().unwrap();
        let mean = |i: usize| psi.row(i).iter().sum::<f64>() / psi.ncols() as f64;
        let moved = expand(&new);
        let moved = Mat::from_fn(6, new.ncols(), |i, j| moved[(i, j)] - mean(i));
        let known = svd.U().subcols(0, 5).transpose() * &moved;
        let pca = KernelPca::approximate(kernel, s, x.as_ref(), method, 5, Scaling::Principal, Par::Seq).unwrap();
        let found = pca.apply(new.as_ref(), Par::Seq).unwrap();
        let difference = difference_up_to_sign(found.as_ref(), known.as_ref());
        assert!(difference < 1e-8, "{method:?} of {m}: {difference}");
    }
}

#[test]
fn projections_of_the_training_samples_have_mean_zero_and_the_variances_named() {
    let x = random_path(3, 150, 11);
    let s = x.as_ref().subcols(0, 40);
    let kernel = Kernel::gaussian(0.4).unwrap();
    for method in APPROXIMATIONS {
        let over = if method == Approximation::SubsetOfData { s } else { x.as_ref() };
        for scaling in [Scaling::Principal, Scaling::UnitVariance] {
            let pca = KernelPca::approximate(kernel, s, x.as_ref(), method, 6, scaling, Par::Seq).unwrap();
            let phi = pca.apply(over, Par::Seq).unwrap();
            let n = phi.ncols() as f64;
            let scale = phi.norm_max();
            for i in 0..6 {
                let mean = phi.row(i).iter().sum::<f64>() / n;
                assert!(mean.abs() < 1e-9 * scale, "{method:?} {scaling:?}: mean {mean}");
                let expected = if scaling == Scaling::UnitVariance { 1.0 } else { pca.variances()[i] };
                for j in 0..6 {
                    let product = (0..phi.ncols()).map(|t| phi[(i, t)] * phi[(j, t)]).sum::<f64>() / n;
                    if i == j {
                        assert!((product / expected - 1.0).abs() < 1e-8, "{method:?} {scaling:?} {i}: {product}");
                    } else if method != Approximation::Nystrom {
                        assert!(product.abs() < 1e-8 * scale * scale, "{method:?} {scaling:?} {i} {j}: {product}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_projected_process_explains_the_most_variance_that_the_support_vectors_can() {
    let x = random_path(4, 200, 23);
    let s = Mat::from_fn(4, 30, |i, j| x[(i, 6 * j)]);
    let kernel = Kernel::gaussian(0.4).unwrap();
    let explained = |method| {
        let pca = KernelPca::approximate(kernel, s.as_ref(), x.as_ref(), method, 5, Scaling::Principal, Par::Seq);
        pca.unwrap().variances().iter().sum::<f64>()
    };
    let exact: f64 =
        KernelPca::exact(kernel, x.as_ref(), 5, Scaling::Principal, Par::Seq).unwrap().variances().iter().sum();
    let (nystrom, projected) = (explained(Approximation::Nystrom), explained(Approximation::ProjectedProcess));
    assert!(nystrom <= projected && projected <= exact * (1.0 + 1e-12), "{nystrom} {projected} {exact}");
    assert!(projected > 0.9 * exact, "{projected} of {exact}");
}

#[test]
fn the_kernel_matrix_is_approximated_better_with_more_support_vectors() {
    let x = random_path(3, 80, 31);
    let kernel = Kernel::gaussian(0.5).unwrap();
    let k = gram(kernel, x.as_ref());
    let once = centred(k.as_ref());
    let both = centred(once.transpose());
    for method in [Approximation::Nystrom, Approximation::ProjectedProcess] {
        let mut errors = Vec::new();
        for m in [4, 8, 16, 32, 80] {
            let s = Mat::from_fn(3, m, |i, j| x[(i, (37 * j) % 80)]);
            // As many components as there are.
            let make = |components| {
                KernelPca::approximate(kernel, s.as_ref(), x.as_ref(), method, components, Scaling::Principal, Par::Seq)
            };
            let Err(KernelError::Components { rank, .. }) = make(1000) else { panic!("1000 of {m}") };
            let phi = make(rank).unwrap().apply(x.as_ref(), Par::Seq).unwrap();
            errors.push((&both - phi.transpose() * &phi).norm_l2() / both.norm_l2());
        }
        assert!(errors.windows(2).all(|pair| pair[1] < pair[0]), "{method:?}: {errors:?}");
        assert!(errors[4] < 1e-6, "{method:?}: {errors:?}");
    }
}

#[test]
fn support_vectors_that_repeat_change_nothing_but_the_rank() {
    let x = random_path(2, 40, 41);
    let s = x.as_ref().subcols(0, 10);
    let doubled = Mat::from_fn(2, 20, |i, j| x[(i, j % 10)]);
    let kernel = Kernel::gaussian(0.3).unwrap();
    let method = Approximation::ProjectedProcess;
    let once = KernelPca::approximate(kernel, s, x.as_ref(), method, 3, Scaling::UnitVariance, Par::Seq).unwrap();
    let twice =
        KernelPca::approximate(kernel, doubled.as_ref(), x.as_ref(), method, 3, Scaling::UnitVariance, Par::Seq)
            .unwrap();
    let (a, b) = (once.apply(x.as_ref(), Par::Seq).unwrap(), twice.apply(x.as_ref(), Par::Seq).unwrap());
    assert!(difference_up_to_sign(a.as_ref(), b.as_ref()) < 1e-7);
    let all = KernelPca::approximate(kernel, doubled.as_ref(), x.as_ref(), method, 11, Scaling::Principal, Par::Seq);
    let Err(KernelError::Components { asked: 11, rank }) = all else { panic!("{all:?}") };
    assert!(rank <= 10);
    let constant = Mat::<f64>::from_fn(2, 9, |_, _| 7.0);
    let none = KernelPca::exact(kernel, constant.as_ref(), 1, Scaling::Principal, Par::Seq).unwrap_err();
    assert_eq!(none, KernelError::Components { asked: 1, rank: 0 });
}
