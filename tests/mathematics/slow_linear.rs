//! Linear SFA against known answers: redundant and weak channels, lags, uneven sampling, streams.

use crate::common::{generator, random_path, relative_difference, rotation};
use adagio::slow::{LinearSfa, LinearStream, Link, Moments, SlowError, solve};
use faer::{Mat, MatRef, Par};
use proptest::prelude::*;
use rand::RngExt;

/// Mean 0, variance 1, covariance 0, slowness ascending and equal to its definition.
fn assert_constraints(sfa: &LinearSfa, x: MatRef<'_, f64>, links: &[Option<Link>], tolerance: f64) {
    let y = sfa.apply(x).unwrap();
    let n = y.ncols() as f64;
    for i in 0..y.nrows() {
        let mean = y.row(i).sum() / n;
        assert!(mean.abs() < tolerance, "output {i} has mean {mean:e}");
        for j in 0..=i {
            let product = (y.row(i) * y.row(j).transpose()) / n;
            let expected = f64::from(u8::from(i == j));
            assert!((product - expected).abs() < tolerance, "outputs {i}, {j}: covariance {product}");
        }
        let (mut sum, mut weight) = (0.0, 0.0);
        for (t, link) in links.iter().enumerate().skip(1) {
            if let Some(link) = link {
                sum += link.weight * ((y[(i, t)] - y[(i, t - 1)]) / link.dt).powi(2);
                weight += link.weight;
            }
        }
        assert!((sfa.slowness[i] - sum / weight).abs() <= 1e-9 * (sum / weight) + 1e-12, "slowness of output {i}");
        assert!(i == 0 || sfa.slowness[i] >= sfa.slowness[i - 1], "not ascending at {i}");
    }
}

fn correlation(a: impl Iterator<Item = f64>, b: impl Iterator<Item = f64>) -> f64 {
    let (a, b): (Vec<f64>, Vec<f64>) = (a.collect(), b.collect());
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let (ma, mb) = (mean(&a), mean(&b));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(&b) {
        ab += (x - ma) * (y - mb);
        aa += (x - ma).powi(2);
        bb += (y - mb).powi(2);
    }
    ab / (aa * bb).sqrt()
}

/// Mixed sines of many speeds: d independent channels with distinct slowness.
fn sines(d: usize, n: usize) -> Mat<f64> {
    Mat::from_fn(d, n, |i, t| (0.011 * (i + 1) as f64 * t as f64 + 0.7 * i as f64).sin())
}

#[test]
fn redundant_dimensions_change_nothing_and_are_counted() {
    let n = 2000;
    let mut rng = generator(31);
    let base = Mat::from_fn(300, n, |_, _| rng.random_range(-1.0..1.0))
        + Mat::from_fn(300, n, |i, t| (0.001 * (i + 1) as f64 * t as f64).sin());
    let links = Link::regular(n, 1.0).unwrap();
    let without = LinearSfa::fit(base.as_ref(), &links, 5, 0.0).unwrap();
    assert_eq!(without.rank_deficit, 0);
    let plain = without.apply(base.as_ref()).unwrap();
    let mix = Mat::from_fn(100, 300, |_, _| rng.random_range(-1.0..1.0)) * &base;
    for copies in [1, 100, 200] {
        // The first hundred are copies, the others linear combinations; all 500 stand in another order.
        let d = 300 + copies;
        let x = Mat::from_fn(d, n, |i, t| match (i * 13) % d {
            i if i < 300 => base[(i, t)],
            i if i < 400 => base[(2 * (i - 300), t)] * if i % 2 == 0 { 1.0 } else { -3.0 },
            i => mix[(i - 400, t)] + 5.0,
        });
        let with = LinearSfa::fit(x.as_ref(), &links, 5, 0.0).unwrap();
        assert_eq!(with.rank_deficit, copies);
        let y = with.apply(x.as_ref()).unwrap();
        for j in 0..5 {
            let sign = if y[(j, 0)] * plain[(j, 0)] < 0.0 { -1.0 } else { 1.0 };
            for t in 0..n {
                assert!((sign * y[(j, t)] - plain[(j, t)]).abs() < 1e-5, "feature {j} at {t} with {copies} copies");
            }
            assert!((with.slowness[j] - without.slowness[j]).abs() < 1e-5 * without.slowness[j]);
        }
        assert_constraints(&with, x.as_ref(), &links, 1e-10);
    }
}

#[test]
fn a_weak_slow_signal_is_not_lost_among_strong_fast_noise() {
    let (d, n) = (10, 5000);
    let mut rng = generator(5);
    let turn = rotation(d, 6);
    for amplitude in [1e-4, 1e-5] {
        let hidden = Mat::from_fn(d, n, |i, t| match i {
            0 => amplitude * (0.004 * t as f64).sin(),
            _ => rng.random_range(-1.0..1.0),
        });
        let x = &turn * hidden;
        let links = Link::regular(n, 1.0).unwrap();
        let sfa = LinearSfa::fit(x.as_ref(), &links, 3, 0.0).unwrap();
        assert_eq!(sfa.rank_deficit, 0);
        assert_constraints(&sfa, x.as_ref(), &links, 1e-10);
        let y = sfa.apply(x.as_ref()).unwrap();
        let found = correlation((0..n).map(|t| y[(0, t)]), (0..n).map(|t| (0.004 * t as f64).sin()));
        assert!(found.abs() > 1.0 - 1e-6, "amplitude {amplitude}: {found}");
        // The noise is white, so its slowness is about 2; the sine's about 0.004².
        assert!(sfa.slowness[0] < 2e-5 && sfa.slowness[1] > 1.5, "{:?}", sfa.slowness);

        let mut moments = Moments::new(Par::Seq);
        moments.widen(d).unwrap();
        moments.add_series(x.as_ref(), &links, None).unwrap();
        let solved = solve(&moments, 1, 0.0, None).unwrap();
        let y = solved.weights.transpose() * &x;
        let found = correlation((0..n).map(|t| y[(0, t)]), (0..n).map(|t| (0.004 * t as f64).sin()));
        assert!(found.abs() > 1.0 - 1e-6, "from moments, amplitude {amplitude}: {found}");
    }
}

#[test]
fn large_means_and_scales_do_not_harm() {
    let x = sines(4, 3000);
    let links = Link::regular(3000, 1.0).unwrap();
    let plain = LinearSfa::fit(x.as_ref(), &links, 4, 0.0).unwrap();
    let far =
        Mat::from_fn(4, 3000, |i, t| 10f64.powi(6 * (i as i32 - 1)) * x[(i, t)] + 1e3 * 10f64.powi(6 * (i as i32 - 1)));
    let moved = LinearSfa::fit(far.as_ref(), &links, 4, 0.0).unwrap();
    assert_eq!(moved.rank_deficit, 0);
    assert_constraints(&moved, far.as_ref(), &links, 1e-9);
    for (a, b) in plain.slowness.iter().zip(&moved.slowness) {
        assert!((a - b).abs() < 1e-9 * a, "{a} against {b}");
    }
}

#[test]
fn a_direction_that_moves_only_across_restarts_has_slowness_zero() {
    let x = Mat::from_fn(2, 60, |i, t| if i == 0 { f64::from(u8::from(t >= 30)) } else { (1.1 * t as f64).sin() });
    let links = Link::sequences(&[30, 30], 1.0).unwrap();
    let sfa = LinearSfa::fit(x.as_ref(), &links, 2, 0.0).unwrap();
    assert!(sfa.slowness[0].abs() < 1e-14);
    assert_constraints(&sfa, x.as_ref(), &links, 1e-12);
    let y = sfa.apply(x.as_ref()).unwrap();
    assert!((0..60).all(|t| (y[(0, t)].abs() - 1.0).abs() < 1e-12));
}

#[test]
fn a_lag_finds_what_repeats_after_it() {
    // Channel 1 repeats after 20 frames; channel 2 is slower from frame to frame, but not after 20.
    let n = 4000;
    let x = Mat::from_fn(2, n, |i, t| (std::f64::consts::TAU * t as f64 / [20.0, 93.0][i]).sin());
    let mixed = rotation(2, 3) * &x;
    let links = Link::regular(n, 0.5).unwrap();
    let which = |lags: &[usize]| {
        let sfa = LinearSfa::fit_lagged(mixed.as_ref(), &links, lags, 2, 0.0).unwrap();
        let y = sfa.apply(mixed.as_ref()).unwrap();
        let of = |i: usize| correlation((0..n).map(|t| y[(0, t)]), (0..n).map(|t| x[(i, t)])).abs();
        (of(0), of(1), sfa.slowness)
    };
    assert!(which(&[1]).1 > 0.999);
    let (first, _, slowness) = which(&[20]);
    assert!(first > 0.999 && slowness[0] < 1e-5, "{first} {slowness:?}");
    // Δ·(τ dt)² = 2(1 − autocorrelation): for a sine of period P that is 2(1 − cos 2πτ/P).
    let expected = 2.0 * (1.0 - (std::f64::consts::TAU * 20.0 / 93.0).cos()) / 100.0;
    assert!((slowness[1] - expected).abs() < 0.01 * expected, "{} against {expected}", slowness[1]);
    // Averaged over lags 1 and 20, the slower one wins by lag 1, where derivatives are largest.
    assert!(which(&[1, 20]).1 > 0.999);
    let average = which(&[1, 20]).2[0];
    let one = LinearSfa::fit(x.as_ref().subrows(1, 1), &links, 1, 0.0).unwrap().slowness[0];
    let twenty = LinearSfa::fit_lagged(x.as_ref().subrows(1, 1), &links, &[20], 1, 0.0).unwrap().slowness[0];
    assert!((average - 0.5 * (one + twenty)).abs() < 1e-3 * average);
}

#[test]
fn uneven_sampling_gives_the_derivative_of_the_signal() {
    let n = 20_000;
    let mut rng = generator(17);
    let mut times = vec![0.0];
    for t in 1..n {
        times.push(times[t - 1] + rng.random_range(0.002..0.02) + if t % 5000 == 0 { 7.0 } else { 0.0 });
    }
    let links = Link::at_times(&times, 1.0).unwrap();
    assert_eq!(links.iter().filter(|link| link.is_none()).count(), 4);
    let x = Mat::from_fn(1, n, |_, t| (3.0 * times[t]).sin());
    let sfa = LinearSfa::fit(x.as_ref(), &links, 1, 0.0).unwrap();
    // √2 sin 3t has the mean squared derivative 9.
    assert!((sfa.slowness[0] - 9.0).abs() < 0.1, "{}", sfa.slowness[0]);
}

#[test]
fn a_stream_and_a_batch_agree() {
    let x = random_path(5, 700, 9);
    let far = Mat::from_fn(5, 700, |i, t| x[(i, t)] + 1e5 * i as f64);
    let links = Link::sequences(&[300, 400], 0.1).unwrap();
    let batch = LinearSfa::fit(far.as_ref(), &links, 3, 0.0).unwrap();
    let mut stream = LinearStream::new();
    for (start, size) in [(0, 1), (1, 250), (251, 49), (300, 400)] {
        stream.push(far.as_ref().subcols(start, size), &links[start..start + size]).unwrap();
    }
    let streamed = stream.solve(3, 0.0).unwrap();
    for j in 0..3 {
        assert!((batch.slowness[j] - streamed.slowness[j]).abs() < 1e-9 * batch.slowness[j]);
        let sign = if batch.weights[(0, j)] * streamed.weights[(0, j)] < 0.0 { -1.0 } else { 1.0 };
        let turned = Mat::from_fn(5, 1, |i, _| sign * streamed.weights[(i, j)]);
        assert!(relative_difference(turned.as_ref(), batch.weights.as_ref().subcols(j, 1)) < 1e-7);
    }
}

#[cfg(feature = "rayon")]
#[test]
fn the_blocks_of_a_stream_and_its_threads_do_not_change_the_bits() {
    let x = random_path(5, 1300, 9);
    let links = Link::sequences(&[300, 1000], 0.1).unwrap();
    let mut whole = LinearStream::new();
    whole.push(x.as_ref(), &links).unwrap();
    let expected = whole.solve(3, 0.0).unwrap();
    for blocks in [vec![1; 1300], vec![256, 256, 788], vec![1299, 1], vec![0, 100, 0, 1200]] {
        let (mut stream, mut start) = (LinearStream::on(Par::rayon(3)), 0);
        for size in blocks {
            stream.push(x.as_ref().subcols(start, size), &links[start..start + size]).unwrap();
            start += size;
        }
        assert_eq!((stream.inputs(), stream.solve(3, 0.0).unwrap()), (Some(5), expected.clone()));
    }
}

#[test]
fn streams_add_up_without_a_derivative_from_one_to_the_other() {
    let x = random_path(4, 900, 10);
    // The second begins far from the first: sums have to move to another origin.
    let x = Mat::from_fn(4, 900, |i, t| x[(i, t)] + if t < 400 { 0.0 } else { 50.0 * (i + 1) as f64 });
    let links = Link::sequences(&[400, 500], 0.5).unwrap();
    let stream_of = |from: usize, to: usize| {
        let mut stream = LinearStream::new();
        stream.push(x.as_ref().subcols(from, to - from), &links[from..to]).unwrap();
        stream
    };
    let (whole, mut both) = (stream_of(0, 900), stream_of(0, 400));
    // Frames after the sum follow the last one of the second stream.
    both.append(&stream_of(400, 700)).unwrap();
    both.push(x.as_ref().subcols(700, 200), &links[700..]).unwrap();
    let (expected, found) = (whole.solve(4, 0.0).unwrap(), both.solve(4, 0.0).unwrap());
    for j in 0..4 {
        assert!((found.slowness[j] / expected.slowness[j] - 1.0).abs() < 1e-9, "feature {j}");
        assert!((found.mean[j] / expected.mean[j] - 1.0).abs() < 1e-12, "channel {j}");
    }
    let outputs = [&expected, &found].map(|sfa| sfa.apply(x.as_ref()).unwrap());
    for j in 0..4 {
        let sign = if outputs[0][(j, 0)] * outputs[1][(j, 0)] < 0.0 { -1.0 } else { 1.0 };
        assert!((0..900).all(|t| (outputs[0][(j, t)] - sign * outputs[1][(j, t)]).abs() < 1e-9), "feature {j}");
    }
    // Nothing adds nothing; other channels are refused.
    let mut empty = LinearStream::new();
    empty.append(&whole).unwrap();
    empty.append(&LinearStream::new()).unwrap();
    assert_eq!(empty.solve(4, 0.0).unwrap(), expected);
    let mut narrow = LinearStream::new();
    narrow.push(x.as_ref().subrows(0, 3), &links).unwrap();
    let refused = whole.clone().append(&narrow).unwrap_err();
    assert!(matches!(refused, SlowError::Shape { found: 3, expected: 4, .. }));
}

#[test]
fn sums_of_other_frames_and_of_moved_ones() {
    let x = random_path(3, 200, 11);
    let sums_of = |x: MatRef<'_, f64>, n| {
        let mut moments = Moments::new(Par::Seq);
        moments.widen(3).unwrap();
        moments.add_series(x, &Link::regular(n, 1.0).unwrap(), None).unwrap();
        moments
    };
    let by = [3.0, -1.0, 0.5];
    let mut moved = sums_of(x.as_ref(), 200);
    moved.shift(&by).unwrap();
    let expected = sums_of(Mat::from_fn(3, 200, |i, t| x[(i, t)] + by[i]).as_ref(), 200);
    assert!((&moved.mean() - expected.mean()).norm_max() < 1e-12);
    assert!((&moved.covariance() - expected.covariance()).norm_max() < 1e-11);
    assert!((&moved.rate() - expected.rate()).norm_max() < 1e-12);
    let mut twice = moved.clone();
    twice.append(&moved).unwrap();
    assert_eq!((twice.frames(), twice.links()), (400.0, 398.0));
    assert!((&twice.covariance() - moved.covariance()).norm_max() < 1e-11);
    assert!(twice.shift(&by[..2]).is_err() && twice.append(&Moments::new(Par::Seq)).is_err());
}

#[test]
fn impossible_requests_are_refused_with_their_numbers() {
    let x = random_path(3, 50, 6);
    let links = Link::regular(50, 1.0).unwrap();
    let fit = |features, lambda| LinearSfa::fit(x.as_ref(), &links, features, lambda).unwrap_err();
    assert_eq!(fit(4, 0.0), SlowError::Features { asked: 4, rank: 3 });
    assert_eq!(fit(0, 0.0), SlowError::Features { asked: 0, rank: 3 });
    assert_eq!(fit(1, -1.0), SlowError::Lambda(-1.0));
    let one = LinearSfa::fit(x.as_ref().subcols(0, 1), &links[..1], 1, 0.0).unwrap_err();
    assert!(matches!(one, SlowError::TooFewFrames { frames: 1.0, .. }));
    let unlinked = LinearSfa::fit(x.as_ref(), &vec![None; 50], 1, 0.0).unwrap_err();
    assert_eq!(unlinked, SlowError::TooFewFrames { frames: 50.0, links: 0.0 });
    let lagged = |lags: &[usize]| LinearSfa::fit_lagged(x.as_ref(), &links, lags, 1, 0.0).unwrap_err();
    assert_eq!(lagged(&[50]), SlowError::Lag { lag: 50, frames: 50 });
    assert_eq!(lagged(&[1, 0]), SlowError::Lag { lag: 0, frames: 50 });
    assert!(matches!(lagged(&[]), SlowError::Empty(_)));
    assert!(matches!(Link::at_times(&[0.0, 2.0, 1.0], 9.0), Err(SlowError::Link { at: 2, .. })));
    assert!(Link::regular(3, 0.0).is_err() && Link::at_times(&[0.0], f64::NAN).is_err());
}

/// Any number a signal may hold by mistake.
fn any_value() -> impl Strategy<Value = f64> {
    prop_oneof![6 => -2.0..2.0f64, 1 => Just(0.0), 1 => Just(1e200), 1 => Just(1e-300), 1 => Just(f64::NAN), 1 => Just(f64::INFINITY)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Whatever is given: an error, or finite features that obey their constraints.
    #[test]
    fn no_input_panics(
        d in 0usize..5,
        n in 0usize..12,
        off in 0usize..2,
        values in prop::collection::vec(any_value(), 60),
        tame in any::<bool>(),
        dt in prop_oneof![4 => 0.1..2.0f64, 1 => Just(0.0), 1 => Just(f64::NAN), 1 => Just(1e-200)],
        lag in 0usize..4,
        features in 0usize..4,
        lambda in prop_oneof![3 => Just(0.0), 2 => 1e-9..10.0f64, 1 => Just(f64::NAN), 1 => Just(1e-300), 1 => Just(1e300)],
    ) {
        let value = |v: f64| if !tame || v.abs() < 10.0 { v } else { 0.5 };
        let x = Mat::from_fn(d, n, |i, t| value(values[i * 12 + t]));
        let links: Vec<_> = (0..n + off).map(|t| (t % 5 != 3).then_some(Link { dt, weight: 1.0 })).collect();
        if let Ok(sfa) = LinearSfa::fit_lagged(x.as_ref(), &links, &[lag], features, lambda) {
            let y = sfa.apply(x.as_ref()).unwrap();
            for i in 0..features {
                prop_assert!(sfa.slowness[i].is_finite());
                let variance = (y.row(i) * y.row(i).transpose()) / n as f64;
                prop_assert!((variance - 1.0).abs() < 1e-8, "variance {}", variance);
            }
        }
        let mut stream = LinearStream::new();
        if stream.push(x.as_ref(), &links).is_ok() {
            let _ = stream.push(x.as_ref(), &links);
            if let Ok(sfa) = stream.solve(features, lambda) {
                prop_assert!(sfa.slowness.iter().all(|s| s.is_finite()));
            }
        }
        let _ = LinearSfa::fit(Mat::from_fn(d, n, |_, _| 3.3).as_ref(), &links, features, lambda).map(|sfa| sfa.slowness);
    }
}
