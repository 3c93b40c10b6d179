//! Optimal responses of a region, against exact and published eigenvalues of the Laplacian.

use std::f64::consts::PI;

use adagio::slow::region::{Region, RegionError, RegionResponses};
use adagio::slow::theory::{Axis, OptimalResponses, plane_motion};
use faer::{Mat, Par};

fn rectangle(columns: usize, rows: usize, side: f64) -> Region {
    Region::new([0.0, 0.0], side, [columns, rows], |_| true).unwrap()
}

/// Turns so fast that only functions of the position are slow.
fn of_position(region: Region, k: usize) -> RegionResponses {
    RegionResponses::slowest(region, 2.0, 1e9, k, Par::Seq).unwrap()
}

#[test]
fn a_rectangle_has_the_exact_eigenvalues_of_its_grid() {
    let (columns, rows, side) = (24, 15, 0.1);
    // Of a row of n cells: 4 sin²(jπ/2n) / h², for each number of half waves.
    let line = |j: usize, n: usize| (2.0 * (0.5 * PI * j as f64 / n as f64).sin() / side).powi(2);
    let mut exact: Vec<f64> =
        (0..columns).flat_map(|i| (0..rows).map(move |j| line(i, columns) + line(j, rows))).collect();
    exact.sort_by(f64::total_cmp);
    for k in [5, 40, 300] {
        let found = of_position(rectangle(columns, rows, side), k);
        for (value, exact) in found.wave_numbers_squared().iter().zip(&exact[1..]) {
            assert!((value / exact - 1.0).abs() < 1e-7, "{k}: {value}, exactly {exact}");
        }
    }
}

#[test]
fn an_l_has_the_published_eigenvalues() {
    // The square [−1, 1]² less a quadrant. M. Dauge, Benchmark computations for Maxwell equations (2004): the Neumann
    // Laplacian in the L-shaped domain; the third and fourth are exactly π².
    let published = [1.475_621_824_08, 3.534_031_366_78, PI * PI, PI * PI, 11.389_479_397_9];
    let error = |cells: usize| {
        let side = 2.0 / cells as f64;
        let region = Region::new([-1.0, -1.0], side, [cells, cells], |[x, y]| !(x > 0.0 && y < 0.0)).unwrap();
        let found = of_position(region, 5);
        let shares =
            found.wave_numbers_squared().iter().zip(published).map(|(value, exact)| (value / exact - 1.0).abs());
        shares.collect::<Vec<f64>>()
    };
    let (coarse, fine) = (error(50), error(100));
    for (i, (coarse, fine)) in coarse.iter().zip(&fine).enumerate() {
        assert!(*fine < 0.006, "{i}: {fine}");
        assert!(fine < coarse, "{i}: {coarse}, then {fine}");
    }
}

#[test]
fn in_a_box_order_and_functions_are_those_of_theory() {
    let (width, depth, side) = (3.0, 2.0, 0.02);
    let (speed, turn) = (0.02, 0.11);
    let region = rectangle((width / side) as usize, (depth / side) as usize, side);
    let found = RegionResponses::slowest(region, speed, turn, 20, Par::Seq).unwrap();
    let axes = [Axis::free(0.0, width).unwrap(), Axis::free(0.0, depth).unwrap(), Axis::cyclic(-PI, PI).unwrap()];
    let exact = OptimalResponses::slowest(&axes, &plane_motion(speed, turn), 20).unwrap();
    for (found, exact) in found.responses().iter().zip(exact.responses()) {
        assert!((found.slowness / exact.slowness - 1.0).abs() < 1e-3, "{found:?}, {exact:?}");
    }
    // The first ones are a single wave each: the same functions, up to their sign.
    let points = Mat::from_fn(3, 500, |i, j| {
        let t = j as f64 / 500.0;
        [0.3 + 2.4 * t, 1.0 + 0.8 * (7.0 * t).sin(), 6.0 * t - 3.0][i]
    });
    let (phi, theory) = (found.evaluate(points.as_ref()), exact.evaluate(points.as_ref()).unwrap());
    for i in 0..3 {
        let sign = (0..500).map(|j| phi[(i, j)] * theory[(i, j)]).sum::<f64>().signum();
        for j in 0..500 {
            assert!((phi[(i, j)] - sign * theory[(i, j)]).abs() < 2e-3, "response {i} at point {j}");
        }
    }
}

#[test]
fn responses_have_variance_one_and_share_nothing() {
    // Two rooms and a corridor.
    let inside = |[x, y]: [f64; 2]| !(2.0..=3.0).contains(&x) || (0.8..1.2).contains(&y);
    let region = Region::new([0.0, 0.0], 0.1, [50, 20], inside).unwrap();
    let cells = region.cells();
    let points: Vec<[f64; 3]> = region
        .centres()
        .flat_map(|[x, y]| (0..16).map(move |h| [x, y, 2.0 * PI * (f64::from(h) + 0.5) / 16.0]))
        .collect();
    let found = RegionResponses::slowest(region, 0.03, 0.002, 30, Par::Seq).unwrap();
    assert!(found.responses().windows(2).all(|pair| pair[0].slowness <= pair[1].slowness));
    let phi = found.evaluate(Mat::from_fn(3, points.len(), |i, j| points[j][i]).as_ref());
    let gram = &phi * phi.transpose();
    for i in 0..30 {
        for j in 0..30 {
            let expected = if i == j { 1.0 } else { 0.0 };
            let value = gram[(i, j)] / (16 * cells) as f64;
            assert!((value - expected).abs() < 1e-7, "({i}, {j}): {value}");
        }
    }
    // The slowest function of two rooms tells them apart.
    let first = found.responses().iter().position(|response| response.position == 1 && response.heading == 0).unwrap();
    let rooms: Vec<f64> = points.iter().enumerate().filter(|(_, p)| p[0] < 2.0).map(|(j, _)| phi[(first, j)]).collect();
    let mean = rooms.iter().sum::<f64>() / rooms.len() as f64;
    assert!(rooms.iter().all(|value| value * mean > 0.0) && mean.abs() > 0.9, "{mean}");
}

#[test]
fn what_is_no_region_is_refused() {
    let two = Region::new([0.0, 0.0], 0.1, [9, 3], |[x, _]| !(0.3..0.6).contains(&x));
    assert!(matches!(two, Err(RegionError::Pieces(2))), "{two:?}");
    let none = Region::new([0.0, 0.0], 0.1, [9, 3], |_| false);
    assert!(matches!(none, Err(RegionError::Cells { cells: 0, .. })));
    assert!(Region::new([0.0, 0.0], f64::NAN, [9, 3], |_| true).is_err());
    for k in [0, 27] {
        let found = RegionResponses::slowest(rectangle(9, 3, 0.1), 1.0, 1.0, k, Par::Seq);
        assert!(matches!(found, Err(RegionError::Responses { most: 26, .. })));
    }
    assert!(RegionResponses::slowest(rectangle(9, 3, 0.1), 0.0, 1.0, 3, Par::Seq).is_err());
}
