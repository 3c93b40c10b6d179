//! Slow features and dictionaries refuse odd input with a typed error: no panic from any public function.

use crate::common::{ald, generator, parameters, random_links, random_path};
use adagio::dictionary::{
    Ald, Block, Dictionary, DictionaryError, FeatureAld, FeatureMap, FeatureParameters, GreedyResidual, Parameters,
    Reservoir, Selection, Thinning, WhenFull,
};
use adagio::kernel::Kernel;
use adagio::slow::coherence::CoherenceError;
use adagio::slow::coherence::gradient::{AscentOptions, Coherence, OnlineCoherence, OnlineOptions, ascend};
use adagio::slow::coherence::incremental::{IncrementalSlow, Options as IncrementalOptions};
use adagio::slow::ica::{IcaError, IndependentComponents};
use adagio::slow::{
    KernelSfa, Layer, LinearSfa, LinearStream, Link, MOST_COORDINATES, Method, Moments, Network, Pca, Shape, SlowError,
    SlowFeatures, SlowModel, SlowStream, Solver, Stage, Step, StreamOptions, solve, solve_bytes,
};
use faer::{Mat, MatRef, Par};
use proptest::prelude::*;

/// Numbers as they come, with those that break things.
fn odd() -> impl Strategy<Value = f64> {
    prop_oneof![
        12 => -2.0..2.0f64,
        2 => Just(0.0),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(1e308),
        1 => Just(-1e160),
        1 => Just(1e-160),
        1 => Just(5e-324),
    ]
}

fn link(dt: f64, weight: f64) -> Option<Link> {
    Some(Link { dt, weight })
}

fn matrix(rows: usize, columns: usize, values: &[f64]) -> Mat<f64> {
    Mat::from_fn(rows, columns, |i, j| values[(i * 7 + j) % values.len()])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn moments_and_solver(
        m in 0usize..5, rows in 0usize..5, n in 0usize..8, l in 0usize..8,
        values in prop::collection::vec(odd(), 1..40),
        weight in odd(), dt in odd(), factor in odd(), from in prop_oneof![0usize..6, Just(usize::MAX)],
        k in prop_oneof![0usize..6, Just(usize::MAX)], lambda in odd(), before in 0usize..3,
    ) {
        let mut moments = Moments::new(Par::Seq);
        moments.widen(m).unwrap();
        let (v, rates) = (matrix(m, n, &values), matrix(rows, l, &values));
        let _ = moments.add(v.as_ref(), rates.as_ref(), weight);
        let links: Vec<Option<Link>> = (0..l).map(|t| (t % 4 != 1).then_some(Link { dt, weight })).collect();
        let earlier = matrix(rows, before, &values);
        let _ = moments.add_series(v.as_ref(), &links, Some(earlier.as_ref()));
        let _ = moments.add_series(v.as_ref(), &links[..l.min(n)], None);
        let _ = moments.reserve(from);
        let _ = moments.fade(factor);
        let _ = moments.widen(from);
        let _ = (moments.mean(), moments.covariance(), moments.rate());
        if let Ok(first) = solve(&moments, k, lambda, None) {
            prop_assert!(first.weights.is_all_finite() && first.slowness.iter().all(|s| s.is_finite()));
            let previous = SlowFeatures { weights: matrix(rows, l, &values), ..first };
            if let Ok(second) = solve(&moments, k, lambda, Some(&previous)) {
                prop_assert!(second.weights.nrows() == moments.size());
            }
        }
    }

    #[test]
    fn streams_and_models(
        d in 0usize..4, n in 0usize..8, other in 0usize..4,
        values in prop::collection::vec(odd(), 1..40), tame in any::<bool>(),
        rule in 0usize..6, kernel in 0usize..4,
        budget in 1usize..5, nu in prop::sample::select(vec![1e-300, 1e-3, 0.5, 2.0]),
        retained in prop::sample::select(vec![0, 3, usize::MAX]), settle_at in prop::sample::select(vec![0, 2, usize::MAX]),
        memory in prop::option::of(odd()), k in 0usize..4, lambda in odd(), fails in 0usize..6,
    ) {
        let kernel = [
            Kernel::gaussian(0.5).unwrap(), Kernel::linear(), Kernel::polynomial(7, 1.0).unwrap(), Kernel::laplacian(0.5).unwrap(),
        ][kernel];
        let when_full = [WhenFull::Stop, WhenFull::RaiseNu, WhenFull::Replace][rule % 3];
        let parameters = Parameters { kernel, nu, budget, when_full, par: Par::Seq };
        let over = FeatureParameters { kernel, nu };
        let selection: Box<dyn Selection<f64>> = match rule {
            0..3 => Box::new(Ald::new(parameters).unwrap()),
            3 => Box::new(Reservoir::new(kernel, budget, 1, Par::Seq).unwrap()),
            _ => Box::new(FeatureAld::new(parameters, over).unwrap()),
        };
        let value = |v: f64| if !tame || v.abs() < 10.0 { v } else { 0.5 };
        let values: Vec<f64> = values.into_iter().map(value).collect();
        let options = StreamOptions { retained, chunk: retained % 7, memory_frames: memory, settle_at };
        if let Ok(mut stream) = SlowStream::from_boxed(selection, options) {
            let calls = std::sync::atomic::AtomicUsize::new(0);
            let map = FeatureMap::new(move |x: MatRef<'_, f64>| {
                let call = calls.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                if call >= fails { Err("no features".to_owned()) } else { Ok(x.to_owned()) }
            });
            let _ = stream.adopt(map);
            let links: Vec<Option<Link>> = (0..n).map(|t| (t % 3 != 1).then_some(Link { dt: 0.5, weight: 1.0 })).collect();
            for (rows, start) in [(d, 0), (d, 1), (other, 0), (d, 2), (d, 3)] {
                let x = Mat::from_fn(rows, n, |i, t| values[(i * 5 + t + 11 * start) % values.len()]);
                let _ = stream.push(x.as_ref(), &links);
                let _ = stream.push(x.as_ref(), &links[..n / 2]);
                let _ = stream.push_finite(x.as_ref(), &links);
                if let Ok(moments) = stream.settled_moments().cloned() {
                    prop_assert_eq!(moments.size(), stream.dictionary().len());
                    if let Ok(features) = solve(&moments, k, lambda, None) {
                        let model = SlowModel::new(stream.dictionary(), &features).unwrap();
                        let _ = model.apply(x.as_ref(), Par::Seq);
                        let _ = stream.adopt(model.feature_map());
                    }
                }
            }
        }
    }

    #[test]
    fn dictionaries(
        d in 0usize..4, n in 0usize..7, rows in 0usize..6, columns in 0usize..4,
        values in prop::collection::vec(odd(), 1..30),
        places in prop::collection::vec(prop_oneof![0usize..8, Just(usize::MAX)], 0..6),
        kernel in 0usize..3, expected in prop::sample::select(vec![0, 3, usize::MAX]),
    ) {
        let kernel =
            [Kernel::gaussian(0.5).unwrap(), Kernel::linear(), Kernel::polynomial(i32::MAX as u32, 1.0).unwrap()][kernel];
        let mut dictionary = Dictionary::<f64>::new(kernel, expected, Par::Seq);
        let x = matrix(d, n, &values);
        let _ = dictionary.grow(x.as_ref(), |_, residual| residual > 1e-9);
        let other = matrix(rows, columns, &values);
        let _ = (dictionary.coordinates(other.as_ref()), dictionary.kernel_rows(other.as_ref()));
        let _ = dictionary.new_coordinates(x.as_ref(), &values, other.as_ref());
        let _ = dictionary.new_coordinates(x.as_ref(), &vec![1.0; n], matrix(rows, n, &values).as_ref());
        if let Ok(thinning) = dictionary.keep(&places) {
            let _ = thinning.apply(other.as_ref());
            let mut moments = Moments::new(Par::Seq);
            moments.widen(rows).unwrap();
            let _ = moments.thin(&thinning);
        }
        if let Ok(mut greedy) = GreedyResidual::new(kernel, 1e-300, 5, Par::Seq) {
            let _ = greedy.observe(x.as_ref());
            let _ = greedy.observe(other.as_ref());
        }
    }

    /// Fields are public, so anyone can put models together; what does not fit is refused where it is used.
    #[test]
    fn models_of_any_parts(
        rows in 0usize..4, columns in 0usize..4, length in 0usize..4, d in 0usize..4, n in 0usize..4,
        values in prop::collection::vec(odd(), 1..20), limit in odd(),
    ) {
        let (w, x) = (matrix(rows, columns, &values), matrix(d, n, &values));
        let list = vec![0.5; length];
        let sfa = LinearSfa { weights: w.clone(), mean: list.clone(), slowness: list.clone(), rank_deficit: 0 };
        let _ = (sfa.offset(), sfa.apply(x.as_ref()), sfa.inputs(), sfa.outputs());
        let pca = Pca { mean: list.clone(), projection: w.clone(), variances: list.clone(), total_variance: 1.0 };
        let _ = (pca.apply(x.as_ref()), pca.outputs());
        for stage in [Stage::Sfa(sfa), Stage::Pca(pca), Stage::Clip(limit)] {
            let _ = stage.apply(x.as_ref());
        }
        let kernel = KernelSfa { projection: w.clone(), offset: list.clone(), slowness: list.clone(), rank: 0 };
        let _ = kernel.apply(x.as_ref());
        let found = IndependentComponents {
            unmixing: w.clone(), mean: list.clone(), kurtosis: list.clone(), skewness: list.clone(), iterations: 1,
        };
        let _ = found.apply(x.as_ref());
        let mut selection = ald(0.5, 0.1, 10);
        selection.observe(random_path(2, 20, 1).as_ref()).unwrap();
        let features = SlowFeatures {
            weights: w.clone(), mean: x.clone(), slowness: list.clone(), lambda: 0.0,
            solver: Solver::Dense { rank_deficit: 0 },
        };
        let _ = SlowModel::new(selection.dictionary(), &features);
        let members = random_path(2, rows, 1);
        if let Ok(mut model) =
            SlowModel::from_parts(Kernel::linear(), members, w.clone(), vec![0.0; columns], vec![0.0; columns])
        {
            let points = random_path(2, 3, 2);
            prop_assert!(model.apply(points.as_ref(), Par::Seq).is_ok());
            model.offset = list;
            let _ = (model.features(), model.apply(points.as_ref(), Par::Seq));
            model.projection = x;
            let _ = model.apply(points.as_ref(), Par::Seq);
            model.members = std::sync::Arc::new(Mat::zeros(length, n));
            let _ = (model.apply(points.as_ref(), Par::Seq), model.feature_map());
        }
    }

    /// Large, tiny and constant signals: an error, or features of variance 1.
    #[test]
    fn any_scale(
        d in 1usize..4, n in 2usize..40, exponent in -320i32..309, seed in any::<u64>(), constant in any::<bool>(),
        lambda in prop::sample::select(vec![0.0, 1e-9, 1.0]),
    ) {
        let scale = 10f64.powi(exponent);
        let x = random_path(d, n, seed);
        let x = Mat::from_fn(d, n, |i, t| scale * if constant { 0.7 } else { x[(i, t)] });
        let links = Link::regular(n, 1.0).unwrap();
        if let Ok(sfa) = LinearSfa::fit(x.as_ref(), &links, 1, lambda) {
            let y = sfa.apply(x.as_ref()).unwrap();
            let variance = (y.row(0) * y.row(0).transpose()) / n as f64;
            prop_assert!(!constant && (variance - 1.0).abs() < 1e-8, "variance {variance} at scale {scale:e}");
        }
        let mut stream = LinearStream::new();
        let again = stream.push(x.as_ref(), &links);
        prop_assert_eq!(again, stream.push(x.as_ref(), &links));
        if let Ok(sfa) = stream.solve(1, lambda) {
            prop_assert!(!constant && sfa.weights.is_all_finite() && sfa.slowness[0].is_finite());
        }
        let mut moments = Moments::new(Par::Seq);
        moments.widen(d).unwrap();
        moments.add_series(x.as_ref(), &links, None).unwrap();
        if let Ok(found) = solve(&moments, 1, lambda, None) {
            prop_assert!(!constant && found.weights.is_all_finite(), "a constant has slow features at scale {scale:e}");
        }
    }
}

#[test]
fn sizes_beyond_all_memory_are_refused() {
    let most = usize::MAX;
    let too_many = |error| matches!(error, SlowError::TooMany { asked: usize::MAX, .. });
    assert!(too_many(Link::regular(most, 1.0).unwrap_err()));
    assert!(too_many(Link::sequences(&[most, most], 1.0).unwrap_err()));
    let refused = Moments::new(Par::Seq).widen(most).unwrap_err();
    assert_eq!(refused, SlowError::TooMany { what: "coordinates", asked: most, most: MOST_COORDINATES });
    let shape = Shape { width: most, height: most, channels: 0 };
    let layer = Layer { field: (1, 1), stride: (1, 1), steps: vec![Step::Clip(1.0)], shared: true };
    let refused = Network::train(shape, &[layer], Mat::zeros(0, 3).as_ref(), &[None; 3]).unwrap_err();
    assert!(matches!(refused, SlowError::Empty(_)));
    let options = OnlineOptions {
        objective: Coherence { decorrelation: 1.0, mean: 0.0 },
        features: 1,
        learning_rate: 0.1,
        decay: 0.0,
        forgetting: 0.1,
    };
    let refused = OnlineCoherence::new(most, options, &mut generator(1)).unwrap_err();
    assert_eq!(refused, CoherenceError::TooManyWeights { features: 1, inputs: most });
    for size in [1, most] {
        let options = IncrementalOptions::new(1, size);
        let refused = IncrementalSlow::new(most, options, &mut generator(1)).unwrap_err();
        assert_eq!(refused, CoherenceError::TooManyWeights { features: size, inputs: most });
    }
    let links = Link::regular(9, 1.0).unwrap();
    let x = random_path(2, 9, 1);
    assert!(LinearSfa::fit(x.as_ref(), &links, most, 0.0).is_err());
    assert_eq!(
        LinearSfa::fit_lagged(x.as_ref(), &links, &[most], 1, 0.0).unwrap_err(),
        SlowError::Lag { lag: most, frames: 9 }
    );
}

#[test]
fn a_stream_refuses_a_memory_that_is_none() {
    for memory in [0.0, -3.0, f64::NAN] {
        let options = StreamOptions { memory_frames: Some(memory), ..StreamOptions::default() };
        let refused = SlowStream::new(ald(0.5, 0.1, 10), options).unwrap_err();
        assert_eq!(refused.to_string(), SlowError::Memory(memory).to_string());
    }
    assert_eq!(Moments::new(Par::Seq).fade(1.5).unwrap_err(), SlowError::Fade(1.5));
}

#[test]
fn a_stream_refuses_chunks_of_no_frames_or_beyond_all_memory() {
    let with = |chunk| StreamOptions { chunk, ..StreamOptions::default() };
    let refused = SlowStream::new(ald(0.5, 0.1, 10), with(0)).unwrap_err();
    assert_eq!(refused, SlowError::Empty("a chunk of frames is"));
    let refused = SlowStream::new(ald(0.5, 0.1, 10), with(usize::MAX)).unwrap_err();
    assert!(matches!(refused, SlowError::TooMany { asked: usize::MAX, .. }));
    let most = usize::MAX;
    assert_eq!(SlowStream::<f64>::bytes(&with(most), most, most, most), u64::MAX);
    assert_eq!(solve_bytes(most, most, Method::Dense), u64::MAX);
}

/// With nothing accepted, the dictionary cannot tell that frames of another length do not belong to the stream.
#[test]
fn a_stream_refuses_frames_of_another_length_before_the_first_support_vector() {
    let none = Parameters { kernel: Kernel::linear(), ..parameters(1.0, 0.1, 10) };
    let mut stream = SlowStream::new(Ald::new(none).unwrap(), StreamOptions::default()).unwrap();
    stream.push(Mat::<f64>::zeros(3, 2).as_ref(), &[None, link(1.0, 1.0)]).unwrap();
    assert!(stream.dictionary().is_empty());
    let refused = stream.push(Mat::<f64>::from_fn(4, 1, |_, _| 1.0).as_ref(), &[None]).unwrap_err();
    assert_eq!(refused, SlowError::Dictionary(DictionaryError::Dimension { expected: 3, found: 4 }));
    stream.push(Mat::<f64>::from_fn(3, 1, |_, _| 1.0).as_ref(), &[None]).unwrap();
    assert_eq!(stream.settled_moments().unwrap().size(), 1);
}

/// A selection that loses support vectors behind the back of its stream.
#[derive(Debug)]
struct Forgetful(Ald<f64>, Dictionary<f64>, bool);

impl Selection<f64> for Forgetful {
    fn dictionary(&self) -> &Dictionary<f64> {
        if self.2 { &self.1 } else { self.0.dictionary() }
    }
    fn is_streaming(&self) -> bool {
        true
    }
    fn observe(&mut self, x: MatRef<'_, f64>) -> Result<Block, DictionaryError> {
        self.2 = !self.0.dictionary().is_empty();
        if self.2 { self.1.grow(x, |_, _| false) } else { self.0.observe(x) }
    }
    fn budget(&self) -> usize {
        0
    }
    fn is_full(&self) -> bool {
        false
    }
    fn nu(&self) -> Option<f64> {
        None
    }
}

#[test]
fn a_stream_refuses_a_selection_that_drops_support_vectors_on_its_own() {
    let empty = Dictionary::new(Kernel::gaussian(0.5).unwrap(), 10, Par::Seq);
    let options = StreamOptions { settle_at: 1, ..StreamOptions::default() };
    let mut stream = SlowStream::new(Forgetful(ald(0.1, 0.1, 10), empty, false), options).unwrap();
    let x = random_path(2, 20, 3);
    let links = random_links(20, 3);
    stream.push(x.as_ref(), &links).unwrap();
    assert!(matches!(stream.push(x.as_ref(), &links), Err(SlowError::Narrower { asked: 0, .. })));
}

/// Features that fail while support vectors have to leave: nothing leaves, and the stream goes on.
#[test]
fn features_that_fail_at_the_budget_leave_the_stream_whole() {
    let over = FeatureParameters { kernel: Kernel::gaussian(0.3).unwrap(), nu: 0.01 };
    let replace = Parameters { when_full: WhenFull::Replace, ..parameters(0.3, 0.01, 10) };
    let selection = FeatureAld::new(replace, over).unwrap();
    let mut stream = SlowStream::new(selection, StreamOptions::default()).unwrap();
    // They work for the blocks, of 50 columns, but not for support vectors.
    let picky = |x: MatRef<'_, f64>| {
        if x.ncols() == 50 { Ok(x.to_owned()) } else { Err(format!("{} columns are not 50", x.ncols())) }
    };
    stream.adopt(FeatureMap::new(picky)).unwrap();
    let x = random_path(3, 100, 5);
    let links = random_links(100, 6);
    let refused = stream.push(x.as_ref().subcols(0, 50), &links[..50]).unwrap_err();
    assert!(matches!(refused, SlowError::Dictionary(DictionaryError::Features(_))));
    stream.adopt(FeatureMap::new(|x: MatRef<'_, f64>| Ok(x.to_owned()))).unwrap();
    stream.push(x.as_ref().subcols(50, 50), &links[50..]).unwrap();
    assert_eq!(stream.dictionary().len(), 10);
    let v = stream.dictionary().coordinates(x.as_ref()).unwrap();
    crate::common::assert_same_moments(
        stream.settled_moments().unwrap(),
        &crate::common::batch_moments(v.as_ref(), &links),
        1e-8,
    );
}

#[test]
fn parts_that_do_not_fit_are_refused_with_their_sizes() {
    let sfa = LinearSfa { weights: Mat::zeros(3, 1), mean: vec![0.0; 2], slowness: vec![1.0], rank_deficit: 0 };
    let refused = sfa.apply(Mat::zeros(2, 5).as_ref()).unwrap_err();
    assert!(matches!(refused, SlowError::Shape { found: 3, expected: 2, .. }));
    assert_eq!(Stage::Clip(-1.0).apply(Mat::zeros(2, 5).as_ref()).unwrap_err(), SlowError::Clip(-1.0));
    let found = IndependentComponents {
        unmixing: Mat::zeros(1, 3),
        mean: vec![0.0; 2],
        kurtosis: vec![0.0],
        skewness: vec![0.0],
        iterations: 1,
    };
    assert_eq!(found.apply(Mat::zeros(2, 5).as_ref()).unwrap_err(), IcaError::Inputs { found: 2, expected: 3 });
    // A thinning can only be had from a dictionary, so it always fits itself.
    let mut dictionary = Dictionary::new(Kernel::gaussian(0.5).unwrap(), 10, Par::Seq);
    dictionary.grow(random_path(2, 9, 1).as_ref(), |_, _| true).unwrap();
    let thinning: Thinning = dictionary.keep(&[0, 2, 5]).unwrap();
    assert_eq!((thinning.before(), thinning.after(), thinning.from()), (9, 3, 1));
    assert!(thinning.apply(Mat::zeros(10, 1).as_ref()).is_err());
}

#[test]
fn a_channel_that_is_too_large_is_named() {
    let x = random_path(3, 40, 3);
    let huge = Mat::from_fn(3, 40, |i, t| [1.0, 1e200, 1e190][i] * x[(i, t)]);
    let refused = LinearSfa::fit(huge.as_ref(), &Link::regular(40, 1.0).unwrap(), 1, 0.0).unwrap_err().to_string();
    assert!(
        refused.starts_with("channel 1, which reaches ") && refused.contains("e199 from its mean: the squares"),
        "{refused}"
    );
}

#[test]
fn a_refused_block_does_not_spoil_a_stream() {
    let x = random_path(2, 40, 3);
    let links = Link::regular(40, 1.0).unwrap();
    let mut stream = LinearStream::new();
    let huge = Mat::from_fn(2, 2, |_, t| [0.0, 1e200][t]);
    assert_eq!(
        stream.push(huge.as_ref(), &links[..2]).unwrap_err(),
        SlowError::NotFinite("the squares of the signal are")
    );
    stream.push(x.as_ref(), &links).unwrap();
    let before = stream.solve(2, 0.0).unwrap();
    let moment = link(1e-200, 1.0);
    assert_eq!(
        stream.push(x.as_ref().subcols(0, 2), &[moment, moment]).unwrap_err(),
        SlowError::NotFinite("the squares of its derivative are")
    );
    assert!(stream.push(huge.as_ref(), &links[..2]).is_err());
    assert_eq!(stream.solve(2, 0.0).unwrap(), before);
}

#[test]
fn an_ascent_of_tiny_inputs_ends() {
    let x = Mat::from_fn(2, 50, |i, t| 1e-153 * ((i + 1) as f64 * 0.3 * t as f64).sin());
    let options = AscentOptions {
        objective: Coherence { decorrelation: 1.0, mean: 0.0 },
        features: 1,
        tolerance: 1e-300,
        most_steps: 5000,
    };
    let _ = ascend(x.as_ref(), &Link::regular(50, 1.0).unwrap(), options, &mut generator(1));
}
