//! Moments and slow features against known answers.

use crate::common::{ald, batch_moments, correlation, parameters, random_links, random_path, relative_difference};
use adagio::dictionary::{Ald, DictionaryError, Parameters};
use adagio::kernel::Kernel;
use adagio::slow::{
    Link, MOST_COORDINATES, Moments, SlowError, SlowFeatures, SlowModel, SlowStream, StreamOptions, solve,
};
use faer::{Mat, MatRef, Par};
use proptest::prelude::*;

fn series_links(n: usize, dt: f64) -> Vec<Option<Link>> {
    (0..n).map(|t| (t > 0).then_some(Link { dt, weight: 1.0 })).collect()
}

fn outputs(features: &SlowFeatures, v: MatRef<'_, f64>) -> Mat<f64> {
    let centred = Mat::from_fn(v.nrows(), v.ncols(), |i, j| v[(i, j)] - features.mean[(i, 0)]);
    features.weights.transpose() * centred
}

/// Mean 0, variance 1, no correlation, slowness ascending and true, over the given frames.
fn assert_constraints(y: MatRef<'_, f64>, features: &SlowFeatures, links: &[Option<Link>], tolerance: f64) {
    let n = y.ncols() as f64;
    for i in 0..y.nrows() {
        let mean = (0..y.ncols()).map(|t| y[(i, t)]).sum::<f64>() / n;
        assert!(mean.abs() < tolerance, "feature {i} has mean {mean}");
        for j in 0..=i {
            let product = (0..y.ncols()).map(|t| y[(i, t)] * y[(j, t)]).sum::<f64>() / n;
            let expected = if i == j { 1.0 } else { 0.0 };
            assert!((product - expected).abs() < tolerance, "features {i}, {j} have covariance {product}");
        }
        let (mut delta, mut weight) = (0.0, 0.0);
        for (t, link) in links.iter().enumerate() {
            if let Some(link) = link {
                delta += link.weight * ((y[(i, t)] - y[(i, t - 1)]) / link.dt).powi(2);
                weight += link.weight;
            }
        }
        let delta = delta / weight;
        assert!(
            (delta - features.slowness[i]).abs() < 1e-6 * delta.max(1e-9),
            "feature {i}: {delta} against {}",
            features.slowness[i]
        );
        assert!(i == 0 || features.slowness[i] >= features.slowness[i - 1], "not ascending at {i}");
    }
}

#[test]
fn wiskott_sejnowski_signal_has_the_known_slow_features() {
    let n = 2000;
    // Both ends of [0, 2π] are included.
    let step = 2.0 * std::f64::consts::PI / (n - 1) as f64;
    let signal: Vec<(f64, f64)> = (0..n)
        .map(|i| {
            let t = i as f64 * step;
            (t.sin() + (11.0 * t).cos().powi(2), (11.0 * t).cos())
        })
        .collect();
    let v = Mat::from_fn(5, n, |i, t| {
        let (a, b) = signal[t];
        [a, b, a * a, a * b, b * b][i]
    });
    let links = series_links(n, step);
    let features = solve(&batch_moments(v.as_ref(), &links), 5, 0.0, None).unwrap();
    let y = outputs(&features, v.as_ref());
    let slowest: Vec<f64> = (0..n).map(|t| y[(0, t)]).collect();
    let sine: Vec<f64> = (0..n).map(|t| (t as f64 * step).sin()).collect();
    assert!((correlation(&slowest, &sine).abs() - 1.0).abs() < 1e-12);
    for (found, known) in features.slowness.iter().zip([1.0005, 120.93, 229.41, 357.47, 483.57]) {
        assert!((found - known).abs() < 6e-5 * known.max(1.0), "{found} against {known}");
    }
    assert_constraints(y.as_ref(), &features, &links, 1e-8);
}

#[test]
fn reflecting_walk_has_the_cosines_of_theory() {
    let states = 20;
    let mut v = Mat::<f64>::zeros(states, 0);
    let mut links: Vec<Option<Link>> = Vec::new();
    let mut push = |v: &mut Mat<f64>, state: usize, linked: bool| {
        let column = v.ncols();
        v.resize_with(states, column + 1, |i, _| f64::from(u8::from(i == state)));
        links.push(linked.then_some(Link { dt: 1.0, weight: 1.0 }));
    };
    // Every transition of the walk once: to the left, to the right, and standing at the ends.
    for state in 0..states {
        for next in [state.saturating_sub(1), (state + 1).min(states - 1)] {
            push(&mut v, state, false);
            push(&mut v, next, true);
        }
    }
    let features = solve(&batch_moments(v.as_ref(), &links), 6, 1e-13, None).unwrap();
    let known = [0.024623, 0.097887, 0.217987, 0.381966, 0.585786, 0.824429];
    for (j, (found, known)) in features.slowness.iter().zip(known).enumerate() {
        assert!((found - known).abs() < 1e-6, "feature {}: {found} against {known}", j + 1);
        let one_hot = Mat::<f64>::identity(states, states);
        let y = outputs(&features, one_hot.as_ref());
        let found: Vec<f64> = (0..states).map(|s| y[(j, s)]).collect();
        let cosine: Vec<f64> = (0..states)
            .map(|s| ((j + 1) as f64 * std::f64::consts::PI * (s as f64 + 0.5) / states as f64).cos())
            .collect();
        assert!((correlation(&found, &cosine).abs() - 1.0).abs() < 1e-9);
    }
}

#[test]
fn a_gap_gives_no_derivative() {
    let mut v = random_path(3, 200, 5);
    for t in 100..200 {
        for i in 0..3 {
            v[(i, t)] += 50.0;
        }
    }
    let mut links = series_links(200, 1.0);
    links[100] = None;
    let features = solve(&batch_moments(v.as_ref(), &links), 1, 0.0, None).unwrap();
    // The jump itself is free, so a feature that only tells the two halves apart is almost still.
    assert!(features.slowness[0] < 1e-4);
    let y = outputs(&features, v.as_ref());
    assert_constraints(y.as_ref(), &features, &links, 1e-8);
    let jump = solve(&batch_moments(v.as_ref(), &series_links(200, 1.0)), 1, 0.0, None).unwrap();
    assert!(jump.slowness[0] > 10.0 * features.slowness[0]);
}

fn options(settle_at: usize) -> StreamOptions {
    StreamOptions { retained: 100_000, chunk: 64, memory_frames: None, settle_at }
}

fn streamed(
    x: &Mat<f64>,
    links: &[Option<Link>],
    sizes: &[usize],
    ald: Ald<f64>,
    options: StreamOptions,
) -> SlowStream<f64> {
    let mut stream = SlowStream::new(ald, options).unwrap();
    let (mut start, mut turn) = (0, 0);
    while start < x.ncols() {
        let size = sizes[turn % sizes.len()].min(x.ncols() - start);
        stream.push(x.as_ref().subcols(start, size), &links[start..start + size]).unwrap();
        start += size;
        turn += 1;
    }
    stream
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Moments that grew with the dictionary are those of a batch with the final dictionary over the same frames.
    #[test]
    fn grown_moments_equal_those_of_a_batch_moments(
        seed in any::<u64>(),
        sizes in prop::collection::vec(1usize..50, 1..5),
        settle_at in 1usize..40,
    ) {
        let x = random_path(4, 300, seed);
        let links = random_links(300, seed ^ 1);
        let mut stream = streamed(&x, &links, &sizes, ald(0.3, 0.01, 10_000), options(settle_at));
        let v = stream.dictionary().coordinates(x.as_ref()).unwrap();
        let exact = batch_moments(v.as_ref(), &links);
        let grown = stream.settled_moments().unwrap();
        prop_assert_eq!(grown.size(), exact.size());
        prop_assert!(relative_difference(grown.mean().as_ref(), exact.mean().as_ref()) < 1e-9);
        prop_assert!(relative_difference(grown.covariance().as_ref(), exact.covariance().as_ref()) < 1e-9);
        prop_assert!(relative_difference(grown.rate().as_ref(), exact.rate().as_ref()) < 1e-9);
    }

    /// From the first re-solve on, a stream has the features of a batch run over the frames so far.
    #[test]
    fn streamed_and_batch_solutions_agree_from_the_first_re_solve_on(
        seed in any::<u64>(),
        sizes in prop::collection::vec(1usize..40, 1..5),
        settle_at in 1usize..40,
    ) {
        let x = random_path(3, 240, seed);
        let links = random_links(240, seed ^ 3);
        let mut stream = SlowStream::new(ald(0.4, 0.01, 10_000), options(settle_at)).unwrap();
        let (mut start, mut turn) = (0, 0);
        while start < 240 {
            let end = (start + sizes[turn % sizes.len()]).min(240);
            stream.push(x.as_ref().subcols(start, end - start), &links[start..end]).unwrap();
            (start, turn) = (end, turn + 1);
            let moments = stream.settled_moments().unwrap().clone();
            if end < 20 || moments.size() < 4 {
                continue;
            }
            let seen = x.as_ref().subcols(0, end);
            let v = stream.dictionary().coordinates(seen).unwrap();
            let batch = batch_moments(v.as_ref(), &links[..end]);
            let (a, b) = (solve(&moments, 2, 1e-3, None).unwrap(), solve(&batch, 2, 1e-3, None).unwrap());
            let (y, z) = (outputs(&a, v.as_ref()), outputs(&b, v.as_ref()));
            for j in 0..2 {
                prop_assert!((a.slowness[j] - b.slowness[j]).abs() < 1e-8 * b.slowness[j]);
            }
            // Features as slow as each other may be rotated: compare their span.
            let overlap = &y * z.transpose() * faer::Scale(1.0 / end as f64);
            let gap = (b.slowness[1] - b.slowness[0]) / b.slowness[1];
            for j in 0..2 {
                prop_assert!(gap < 1e-3 || overlap[(j, j)].abs() > 1.0 - 1e-7, "{overlap:?} after {end} frames");
            }
        }
    }

    /// Features that are solved from a stream obey their constraints on the frames it was made of.
    #[test]
    fn features_of_a_stream_obey_their_constraints(seed in any::<u64>(), block in 1usize..80) {
        let x = random_path(4, 400, seed);
        let links = random_links(400, seed ^ 2);
        let mut stream = streamed(&x, &links, &[block], ald(0.4, 0.01, 10_000), options(16));
        let features = solve(stream.settled_moments().unwrap(), 8, 1e-7, None).unwrap();
        let model = SlowModel::new(stream.dictionary(), &features).unwrap();
        let phi = model.apply(x.as_ref(), Par::Seq).unwrap();
        prop_assert!((0..400).all(|t| phi[(0, t)] == 1.0));
        assert_constraints(phi.as_ref().subrows(1, 8), &features, &links, 1e-7);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    /// Frames that are not finite, or too large for the kernel, leave no trace but a gap and a count.
    #[test]
    fn frames_that_are_not_finite_are_left_out(
        seed in any::<u64>(),
        size in 1usize..50,
        bad in prop::collection::btree_set(0usize..240, 0..40),
        what in prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e200, 1e120]),
        memory in prop::option::of(Just(90.0)),
    ) {
        // Cubes of products: 1e120 has a norm, but no kernel value.
        let kernel = Kernel::polynomial(3, 1.0).unwrap();
        let new = || {
            let options = StreamOptions { memory_frames: memory, ..options(8) };
            SlowStream::new(Ald::new(Parameters { kernel, ..parameters(1.0, 0.01, 1000) }).unwrap(), options).unwrap()
        };
        let x = random_path(3, 240, seed);
        let links = random_links(240, seed ^ 1);
        let spoiled = Mat::from_fn(3, 240, |i, t| if bad.contains(&t) && i == t % 3 { what } else { x[(i, t)] });
        let (mut screened, mut clean) = (new(), new());
        for start in (0..240).step_by(size) {
            let end = (start + size).min(240);
            let part = |matrix: &Mat<f64>| matrix.as_ref().subcols(start, end - start).to_owned();
            let found = screened.push_finite(part(&spoiled).as_ref(), &links[start..end]).unwrap();
            let places: Vec<usize> = found.quarantined.iter().map(|place| start + place).collect();
            prop_assert_eq!(&places, &bad.range(start..end).copied().collect::<Vec<_>>());

            let kept: Vec<usize> = (start..end).filter(|t| !bad.contains(t)).collect();
            prop_assert_eq!(found.taken.iter().map(|place| start + place).collect::<Vec<_>>(), kept.clone());
            let good = Mat::from_fn(3, kept.len(), |i, j| x[(i, kept[j])]);
            let cut: Vec<Option<Link>> =
                kept.iter().map(|&t| links[t].filter(|_| t > 0 && !bad.contains(&(t - 1)))).collect();
            let block = clean.push(good.as_ref(), &cut).unwrap();
            prop_assert_eq!(block.accepted, found.block.accepted);
            // As before, a block with such a frame is refused as a whole where nobody asked for less.
            if !places.is_empty() {
                let strict = new().push(part(&spoiled).as_ref(), &links[start..end]).unwrap_err();
                prop_assert!(matches!(strict, SlowError::Dictionary(DictionaryError::NotFinite(_))), "{strict}");
            }
        }
        prop_assert_eq!((screened.quarantined(), screened.frames()), (bad.len(), 240 - bad.len()));
        prop_assert!(screened.dictionary().members() == clean.dictionary().members());
        let (a, b) = (screened.settled_moments().unwrap(), clean.settled_moments().unwrap());
        prop_assert_eq!((a.frames(), a.links()), (b.frames(), b.links()));
        prop_assert!(a.mean() == b.mean() && a.covariance() == b.covariance());
        prop_assert!(a.links() == 0.0 || a.rate() == b.rate());
    }
}

/// Large enough that everything is cut into parts.
#[cfg(feature = "rayon")]
#[test]
fn a_stream_has_the_same_bits_on_any_number_of_threads() {
    let (n, budget) = (1500, 700);
    let x = random_path(40, n, 5);
    let links = random_links(n, 6);
    let run = |par: Par| {
        let ald = Ald::new(Parameters { par, ..parameters(0.35, 0.01, budget) }).unwrap();
        let options = StreamOptions { memory_frames: Some(3000.0), chunk: 256, ..StreamOptions::default() };
        let mut stream = SlowStream::new(ald, options).unwrap();
        // Sums over one coordinate are products with one column.
        stream.push(x.as_ref().subcols(0, 1), &links[..1]).unwrap();
        stream.settle().unwrap();
        for start in (1..n).step_by(300) {
            let size = 300.min(n - start);
            stream.push(x.as_ref().subcols(start, size), &links[start..start + size]).unwrap();
        }
        let moments = stream.settled_moments().unwrap();
        assert_eq!(moments.size(), budget);
        (moments.covariance(), moments.rate())
    };
    let alone = run(Par::Seq);
    for threads in 1..5 {
        assert!(run(Par::rayon(threads)) == alone, "{threads} threads");
    }
}

#[test]
fn a_stream_takes_the_memory_that_its_formula_says() {
    let (d, budget, n, block) = (64, 320, 3000, 50);
    let path = random_path(d, n, 5);
    let x = Mat::from_fn(d, n, |i, t| path[(i, t)] as f32);
    let links = series_links(n, 1.0);
    for (retained, chunk) in [(1000, 64), (900, 256), (100_000, 512), (10, 128)] {
        let options = StreamOptions { retained, chunk, memory_frames: None, settle_at: 20 };
        let parameters = Parameters { kernel: Kernel::gaussian(0.4).unwrap(), ..parameters(0.4, 0.01, budget) };
        let mut stream = SlowStream::<f32>::new(Ald::new(parameters).unwrap(), options).unwrap();
        let mut most = 0;
        for start in (0..n).step_by(block) {
            stream.push(x.as_ref().subcols(start, block), &links[start..start + block]).unwrap();
            most = most.max(stream.held_bytes());
        }
        assert_eq!(stream.dictionary().len(), budget);
        let kept = StreamOptions { retained: retained.min(n), ..options };
        let formula = SlowStream::<f32>::bytes(&kept, budget, d, block);
        assert!(most <= formula, "{most} bytes held, {formula} by the formula");
        // What is not held all the time is the work of the moment, and up to a chunk of frames and a block.
        let work = 2 * budget * budget + 16 * budget * (block + chunk + 70) + 32 * 70 * chunk;
        let passing = work + (chunk + block) * (8 * budget + 4 * d + 40);
        assert!(most + passing as u64 >= formula, "{most} bytes held, {formula} by the formula");
    }
}

#[test]
fn an_empty_block_changes_nothing() {
    let x = random_path(3, 40, 8);
    let links = series_links(40, 1.0);
    let mut stream = streamed(&x, &links, &[20], ald(0.4, 0.01, 10_000), options(4));
    let before = stream.settled_moments().unwrap().covariance();
    stream.push(x.as_ref().subcols(0, 0), &[]).unwrap();
    stream.push(x.as_ref().subcols(0, 1), &[None]).unwrap();
    assert_eq!(stream.frames(), 41);
    assert_eq!(stream.settled_moments().unwrap().size(), before.nrows());
}

#[test]
fn fading_moments_weigh_frames_by_their_age() {
    let x = random_path(3, 60, 4);
    let links = series_links(60, 1.0);
    let fading = StreamOptions { memory_frames: Some(20.0), ..options(1) };
    let mut stream = streamed(&x, &links, &[10], ald(0.5, 0.05, 10_000), fading);
    let v = stream.dictionary().coordinates(x.as_ref()).unwrap();
    let weight = |t: usize| (-0.5 * (5 - t / 10) as f64).exp();
    let total: f64 = (0..60).map(weight).sum();
    let mean = stream.settled_moments().unwrap().mean();
    for i in 0..v.nrows() {
        let exact = (0..60).map(|t| weight(t) * v[(i, t)]).sum::<f64>() / total;
        assert!((mean[(i, 0)] - exact).abs() < 1e-12);
    }
}

#[test]
fn a_new_solution_keeps_the_signs_of_the_one_before() {
    let x = random_path(4, 900, 12);
    let links = series_links(900, 1.0);
    let mut stream =
        streamed(&x.as_ref().subcols(0, 700).to_owned(), &links[..700], &[50], ald(0.4, 0.01, 10_000), options(8));
    let first = solve(stream.settled_moments().unwrap(), 5, 1e-7, None).unwrap();
    let mut turned = first.clone();
    turned.weights *= faer::Scale(-1.0);
    stream.push(x.as_ref().subcols(700, 200), &links[700..]).unwrap();
    let moments = stream.settled_moments().unwrap().clone();
    for previous in [&first, &turned] {
        let second = solve(&moments, 5, 1e-7, Some(previous)).unwrap();
        let mut old = previous.weights.clone();
        old.resize_with(moments.size(), 5, |_, _| 0.0);
        let agreement = second.weights.transpose() * (moments.covariance() * old);
        assert!(agreement[(0, 0)] > 0.5, "the slowest feature turned: {}", agreement[(0, 0)]);
        for j in 0..5 {
            assert!(agreement[(j, j)] > 0.0, "feature {j} turned");
        }
    }
}

/// On a ring sines and cosines are equally slow: any rotation of the two is a solution. The one nearest to the earlier one is
/// taken.
#[test]
fn equally_slow_features_are_rotated_towards_the_solution_before() {
    let states = 12;
    let one = |i: usize, s: usize| f64::from(u8::from(i == s % states));
    // Every step of the ring once, there and back.
    let v = Mat::from_fn(states, states, one);
    let rates = Mat::from_fn(states, 2 * states, |i, t| {
        let (here, there) = if t < states { (t, t + 1) } else { (t + 1, t) };
        one(i, there) - one(i, here)
    });
    let mut moments = Moments::new(Par::Seq);
    moments.widen(states).unwrap();
    moments.add(v.as_ref(), rates.as_ref(), rates.ncols() as f64).unwrap();
    let first = solve(&moments, 6, 1e-9, None).unwrap();
    for angle in [0.3f64, 1.9, 4.0] {
        let (sin, cos) = angle.sin_cos();
        let mut earlier = first.clone();
        for pair in [0, 2, 4] {
            for i in 0..states {
                let (a, b) = (first.weights[(i, pair)], first.weights[(i, pair + 1)]);
                earlier.weights[(i, pair)] = cos * a + sin * b;
                earlier.weights[(i, pair + 1)] = cos * b - sin * a;
            }
        }
        let aligned = solve(&moments, 6, 1e-9, Some(&earlier)).unwrap();
        // Within a pair the order is that of slownesses which are equal up to rounding.
        for pair in [0, 2, 4] {
            let agreement =
                aligned.weights.transpose() * (moments.covariance() * earlier.weights.as_ref().subcols(pair, 2));
            let largest = |j: usize| (pair..pair + 2).map(|i| agreement[(i, j)]).fold(f64::NEG_INFINITY, f64::max);
            assert!((largest(0) - 1.0).abs() < 1e-6 && (largest(1) - 1.0).abs() < 1e-6, "{agreement:?}");
        }
    }
}

#[test]
fn impossible_requests_are_refused_with_their_numbers() {
    let v = random_path(3, 50, 6);
    let moments = batch_moments(v.as_ref(), &series_links(50, 1.0));
    assert_eq!(solve(&moments, 4, 0.0, None).unwrap_err(), SlowError::Features { asked: 4, rank: 3 });
    assert_eq!(solve(&moments, 0, 0.0, None).unwrap_err(), SlowError::Features { asked: 0, rank: 3 });
    assert_eq!(solve(&moments, 1, -1.0, None).unwrap_err(), SlowError::Lambda(-1.0));
    let empty = Moments::new(Par::Seq);
    assert!(matches!(solve(&empty, 1, 0.0, None), Err(SlowError::TooFewFrames { .. })));
    // One coordinate never changes: it is dropped and counted, with λ and without.
    let still = Mat::from_fn(2, 50, |i, t| if i == 0 { v[(0, t)] } else { 1.0 });
    let singular = batch_moments(still.as_ref(), &series_links(50, 1.0));
    assert_eq!(solve(&singular, 1, 0.0, None).unwrap().rank_deficit(), Some(1));
    assert_eq!(solve(&singular, 1, 1e-9, None).unwrap().rank_deficit(), Some(1));
    assert_eq!(solve(&singular, 2, 0.0, None).unwrap_err(), SlowError::Features { asked: 2, rank: 1 });
}

/// The rounding of a sum of equal numbers grows with their number; it must not count as variance.
#[test]
fn a_constant_coordinate_is_left_out_however_many_frames_there_are() {
    let (n, block) = (100_000, 1000);
    for constant in [0.1, 0.7, 1e3 / 3.0] {
        let (mut still, mut half) = (Moments::new(Par::Seq), Moments::new(Par::Seq));
        still.widen(2).unwrap();
        half.widen(2).unwrap();
        for start in (0..n).step_by(block) {
            let value = |i: usize, t: usize| if i == 0 { constant } else { (0.01 * (start + t) as f64).sin() };
            let links = vec![Some(Link { dt: 1.0, weight: 1.0 }); block];
            let before = |rows: &dyn Fn(usize) -> f64| Mat::from_fn(2, 1, |i, _| rows(i));
            let v = Mat::from_fn(2, block, value);
            half.add_series(v.as_ref(), &links, Some(before(&|i| value(i, 0)).as_ref())).unwrap();
            let v = Mat::from_fn(2, block, |_, _| constant);
            still.add_series(v.as_ref(), &links, Some(before(&|_| constant).as_ref())).unwrap();
        }
        let found = solve(&half, 1, 0.0, None).unwrap();
        assert_eq!(found.rank_deficit(), Some(1));
        assert_eq!(found.weights[(0, 0)], 0.0);
        for lambda in [0.0, 1e-9] {
            let refused = solve(&still, 1, lambda, None).unwrap_err();
            assert_eq!(refused, SlowError::Features { asked: 1, rank: 0 }, "{constant}, lambda {lambda}");
        }
    }
}

#[test]
fn sums_refuse_what_does_not_fit_them() {
    let mut moments = Moments::new(Par::Seq);
    moments.widen(2).unwrap();
    let (two, three) = (Mat::<f64>::zeros(2, 4), Mat::<f64>::zeros(3, 4));
    assert_eq!(moments.widen(1).unwrap_err(), SlowError::Narrower { size: 2, asked: 1 });
    assert!(matches!(moments.add(three.as_ref(), two.as_ref(), 1.0), Err(SlowError::Shape { found: 3, .. })));
    assert!(matches!(moments.add(two.as_ref(), three.as_ref(), 1.0), Err(SlowError::Shape { found: 3, .. })));
    assert_eq!(moments.add(two.as_ref(), two.as_ref(), -1.0).unwrap_err(), SlowError::Weight(-1.0));
    assert!(matches!(moments.reserve(MOST_COORDINATES + 1), Err(SlowError::TooMany { .. })));
    let link = Some(Link { dt: 1.0, weight: 1.0 });
    assert_eq!(moments.add_series(two.as_ref(), &[link; 4], None).unwrap_err(), SlowError::NoPredecessor);
    let backwards = Some(Link { dt: -1.0, weight: 1.0 });
    let refused = moments.add_series(two.as_ref(), &[None, None, backwards, None], None).unwrap_err();
    assert_eq!(refused, SlowError::Link { at: 2, dt: -1.0, weight: 1.0 });
    assert_eq!(moments.frames(), 0.0);
    let holes = Mat::from_fn(2, 4, |i, t| if (i, t) == (1, 2) { f64::NAN } else { t as f64 });
    moments.add_series(holes.as_ref(), &series_links(4, 1.0), None).unwrap();
    assert!(matches!(solve(&moments, 1, 0.0, None), Err(SlowError::NotFinite(_))));
}
