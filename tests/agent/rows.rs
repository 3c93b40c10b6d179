//! Kernel rows by a graphics processor: products of whole numbers are the processor's to the last bit, kernel values close.
//!
//! See `tests/common` for the device that computes.

use std::sync::Arc;

use adagio::gpu::{Gpu, Of, Rows};
use adagio::kernel::{Kernel, squared_norms};
use faer::{Mat, Par};
use proptest::prelude::*;
use rand::RngExt;

use crate::common::{adagio_on, device, generator, package_file, report, stderr};

/// Observations as cameras give them: whole numbers, `d × n`, near each other in pairs.
fn observations(d: usize, n: usize, seed: u64) -> Mat<f32> {
    let mut rng = generator(seed);
    let base: Vec<f32> = (0..d * n).map(|_| f32::from(rng.random_range(-128..=127i16))).collect();
    let mut near = |value: f32| (value + f32::from(rng.random_range(-3..=3i16))).clamp(-128.0, 127.0);
    Mat::from_fn(d, n, |i, j| if j % 2 == 0 { base[j * d + i] } else { near(base[(j - 1) * d + i]) })
}

fn rows(gpu: &Arc<Gpu>, members: &Arc<Mat<f32>>, x: &Mat<f32>, of: Of) -> Mat<f32> {
    let mut rows = Rows::new(gpu.clone(), x.nrows()).unwrap();
    rows.hold(members, &squared_norms(members.as_ref().as_ref())).unwrap();
    let pending = rows.begin(x.as_ref(), &squared_norms(x.as_ref()), of).unwrap();
    rows.finish(pending).unwrap()
}

#[test]
fn products_of_whole_numbers_are_exact_and_so_are_the_kernel_values_of_them() {
    let Some((_turn, gpu)) = device() else { return };
    for (d, m, n) in [(1536, 300, 70), (1536, 150, 130), (7, 1, 1)] {
        let (s, x) = (Arc::new(observations(d, m, 1)), observations(d, n, 2));
        let (of_s, of_x) = (squared_norms(s.as_ref().as_ref()), squared_norms(x.as_ref()));
        assert!(of_s.iter().chain(&of_x).all(|&norm| norm < 16_777_216.0));
        let products = rows(&gpu, &s, &x, Of::Products);
        let kernel = Kernel::gaussian(3000.0).unwrap();
        let found = kernel.matrix_of_products(products.as_ref(), &of_s, &of_x, Par::rayon(2)).unwrap();
        assert_eq!(
            found,
            kernel.matrix(s.as_ref().as_ref(), &of_s, x.as_ref(), &of_x, Par::Seq).unwrap(),
            "{d} × {m} with {n}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// On the processor from the same observations in double precision.
    #[test]
    fn kernel_values_are_within_a_ten_thousandth(
        (d, m, n) in (1usize..200, 1usize..150, 1usize..150),
        share in 0.05..5.0f64,
        exponent in prop_oneof![Just(2.0), Just(1.0), 0.3..2.0f64],
        seed in any::<u64>(),
    ) {
        let Some((_turn, gpu)) = device() else { return Ok(()) };
        let (s, x) = (Arc::new(observations(d, m, seed)), observations(d, n, seed ^ 1));
        // A typical distance is that of independent values.
        let kernel = Kernel::radial(share * 105.0 * (d as f64).sqrt(), exponent).unwrap();
        let found = rows(&gpu, &s, &x, Of::Values(kernel));
        let [s, x] = [s.as_ref(), &x].map(|of| Mat::from_fn(d, of.ncols(), |i, j| f64::from(of[(i, j)])));
        let (of_s, of_x) = (squared_norms(s.as_ref()), squared_norms(x.as_ref()));
        let exact = kernel.matrix(s.as_ref(), &of_s, x.as_ref(), &of_x, Par::Seq).unwrap();
        let worst = (0..n).flat_map(|j| (0..m).map(move |i| (i, j)));
        let worst = worst.map(|at| (f64::from(found[at]) - exact[at]).abs()).fold(0.0, f64::max);
        prop_assert!(worst <= 1e-4, "{worst:e}");
    }
}

#[test]
fn vectors_grow_in_place_change_and_leave() {
    let Some((_turn, gpu)) = device() else { return };
    let (d, n) = (48, 20);
    let (all, x) = (observations(d, 700, 3), observations(d, n, 4));
    let of_x = squared_norms(x.as_ref());
    let mut rows = Rows::new(gpu, d).unwrap();
    // Grown by a few, beyond what there was room for, all but the first few changed, fewer.
    let sets: [Vec<usize>; 6] = [
        (0..60).collect(),
        (0..63).collect(),
        (0..500).collect(),
        (0..700).collect(),
        (0..10).chain(40..400).collect(),
        (0..5).collect(),
    ];
    for set in sets {
        let members = Arc::new(Mat::from_fn(d, set.len(), |i, j| all[(i, set[j])]));
        rows.hold(&members, &squared_norms(members.as_ref().as_ref())).unwrap();
        // Two blocks under way.
        let half = n / 2;
        let first = rows.begin(x.as_ref().subcols(0, half), &of_x[..half], Of::Products).unwrap();
        let second = rows.begin(x.as_ref().subcols(half, n - half), &of_x[half..], Of::Products).unwrap();
        let found = [rows.finish(first).unwrap(), rows.finish(second).unwrap()];
        let product = |i: usize, j: usize| (0..d).map(|r| members[(r, i)] * x[(r, j)]).sum::<f32>();
        for j in 0..n {
            for i in 0..set.len() {
                assert_eq!(found[j / half][(i, j % half)], product(i, j), "{} vectors: ({i}, {j})", set.len());
            }
        }
    }
}

#[test]
fn a_device_that_is_lost_gives_an_error_and_nothing_else() {
    let Some((_turn, gpu)) = device() else { return };
    let (members, x) = (Arc::new(observations(16, 10, 5)), observations(16, 4, 6));
    let norms = squared_norms(members.as_ref().as_ref());
    let mut rows = Rows::new(gpu.clone(), 16).unwrap();
    rows.hold(&members, &norms).unwrap();
    gpu.lose();
    let error = rows.hold(&members, &norms).unwrap_err().to_string();
    assert!(error.contains(gpu.name()) && error.contains("has failed"), "{error}");
    let error = rows.begin(x.as_ref(), &squared_norms(x.as_ref()), Of::Products).and_then(|begun| rows.finish(begun));
    assert!(error.is_err());
    assert!(Rows::new(gpu, 16).is_err());
}

#[test]
fn more_than_a_device_has_room_for_is_refused_with_both_numbers() {
    let Some((_turn, gpu)) = device() else { return };
    // Vectors so long that those of one group are too large.
    let d = (gpu.largest_buffer() / (4 * 128)) as usize + 1;
    let mut rows = Rows::new(gpu.clone(), d).unwrap();
    let members = Arc::new(Mat::<f32>::zeros(d, 1));
    let error = rows.hold(&members, &[0.0]).unwrap_err().to_string();
    assert!(error.contains("bytes of support vectors") && error.contains(gpu.name()), "{error}");
    assert!(error.ends_with(&format!("allows {}", gpu.largest_buffer())), "{error}");
    // It is no failure of the device.
    assert_eq!(gpu.check(), Ok(()));
}

/// Products by a device are exact, so that everything a run learns is the same to the last bit.
#[test]
fn a_run_on_a_device_has_the_digest_of_one_without() {
    if device().is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let smoke = package_file("scenarios/smoke.toml");
    let run = |name: &str, compute: &str, allowed: &str| {
        let set = format!("agent.compute={compute}");
        let arguments = ["run", smoke.to_str().unwrap(), "--quiet", "--no-report", "--out", name, "--set", &set];
        let output = adagio_on(allowed, folder.path(), &arguments);
        assert!(output.status.success(), "{}", stderr(&output));
        (report(&folder.path().join(name)), stderr(&output))
    };
    let (by_cpu, _) = run("cpu", "cpu", "software");
    assert!(by_cpu["computed_by"]["kernel_values"].is_null());
    let (by_gpu, warnings) = run("gpu", "gpu", "software");
    assert!(by_gpu["computed_by"]["kernel_values"]["gpu"].is_string(), "{}", by_gpu["computed_by"]);
    assert!(!warnings.contains("warning"), "{warnings}");
    assert_eq!(by_gpu["digest"], by_cpu["digest"]);
    // By default the faster one computes, and both times are told.
    let (by_default, _) = run("default", "auto", "software");
    let why = by_default["computed_by"]["kernel_values"]["why"].as_str().unwrap();
    assert!(why.contains("kernel values in") && why.contains("on the processor"), "{why}");
    assert_eq!(by_default["digest"], by_cpu["digest"]);
    // Without a device the processor computes, and one warning says so.
    let (without, warnings) = run("without", "gpu", "none");
    assert!(without["computed_by"]["kernel_values"]["gpu"].is_null());
    assert_eq!(warnings.matches("warning: agent.compute is \"gpu\"").count(), 1, "{warnings}");
    assert_eq!(without["digest"], by_cpu["digest"]);
}
