//! Hierarchical SFA: shapes, weight sharing, and a slow position that linear functions of the pixels cannot tell.

use crate::common::generator;
use adagio::slow::{Expansion, Keep, Layer, LinearSfa, Link, Network, Pipeline, Shape, SlowError, Step};
use faer::Mat;
use proptest::prelude::*;
use rand::RngExt;

/// Correlation of a row of a matrix with a series.
fn correlation(y: &Mat<f64>, row: usize, series: &[f64]) -> f64 {
    let n = series.len() as f64;
    let (my, ms) = (y.row(row).sum() / n, series.iter().sum::<f64>() / n);
    let (mut ys, mut yy, mut ss) = (0.0, 0.0, 0.0);
    for (t, s) in series.iter().enumerate() {
        let (a, b) = (y[(row, t)] - my, s - ms);
        ys += a * b;
        yy += a * a;
        ss += b * b;
    }
    ys / (yy * ss).sqrt()
}

/// A blob on `width × height` pixels that moves slowly back and forth along the width, quickly along the height, and whose
/// polarity is tossed anew in every frame. The position along the width is returned with it.
fn blobs(shape: Shape, n: usize, seed: u64) -> (Mat<f64>, Vec<f64>) {
    let mut rng = generator(seed);
    let triangle = |t: f64| 1.0 - (t.rem_euclid(2.0) - 1.0).abs();
    let place: Vec<f64> = (0..n).map(|t| (shape.width - 1) as f64 * triangle(t as f64 / 150.0)).collect();
    let other: Vec<f64> = (0..n).map(|_| rng.random_range(0.0..(shape.height - 1) as f64)).collect();
    let polarity: Vec<f64> = (0..n).map(|_| if rng.random_range(0.0..1.0) < 0.5 { -1.0 } else { 1.0 }).collect();
    let x = Mat::from_fn(shape.values(), n, |index, t| {
        let (i, j) = ((index % shape.width) as f64, (index / shape.width) as f64);
        let distance = (i - place[t]).powi(2) + (j - other[t]).powi(2);
        polarity[t] * (-distance / 4.5).exp() + 0.01 * rng.random_range(-1.0..1.0)
    });
    (x, place)
}

#[test]
fn the_top_finds_a_slow_position_that_linear_functions_do_not() {
    let shape = Shape { width: 12, height: 4, channels: 1 };
    let (x, place) = blobs(shape, 3000, 1);
    let (unseen, there) = blobs(shape, 1000, 2);
    let links = Link::regular(3000, 1.0).unwrap();
    // No linear function of the pixels is slow, so the first nodes begin with principal components.
    let steps = vec![
        Step::Pca { keep: Keep::Components(14), whiten: true },
        Step::Expand(Expansion::Quadratic),
        Step::Sfa { features: 8, lambda: 0.0 },
        Step::Clip(4.0),
    ];
    let first = Layer { field: (6, 4), stride: (3, 4), steps, shared: false };
    let layers = [first, Layer::quadratic((3, 1), (1, 1), 10, 3, false)];
    let network = Network::train(shape, &layers, x.as_ref(), &links).unwrap();
    let (seen, new) = (network.apply(x.as_ref()).unwrap(), network.apply(unseen.as_ref()).unwrap());
    let (on_seen, on_new) = (correlation(&seen, 0, &place).abs(), correlation(&new, 0, &there).abs());
    println!("hierarchy: |corr| with the position {on_seen:.4} in training, {on_new:.4} on unseen frames");
    assert!(on_seen > 0.95 && on_new > 0.95, "{on_seen} in training, {on_new} on unseen frames");

    // The polarity makes every pixel's mean zero at every place: no linear function knows the place.
    let linear = LinearSfa::fit(x.as_ref(), &links, 10, 0.0).unwrap().apply(x.as_ref()).unwrap();
    let known: f64 = (0..10).map(|row| correlation(&linear, row, &place).powi(2)).sum();
    println!("linear SFA: R² of its ten slowest outputs together {known:.4}");
    assert!(known < 0.05, "linear SFA knows {known} of the variance");
}

#[test]
fn shapes_follow_fields_and_strides() {
    let shape = Shape { width: 10, height: 6, channels: 3 };
    let mut rng = generator(3);
    let x = Mat::from_fn(180, 400, |_, _| rng.random_range(-1.0..1.0));
    let links = Link::regular(400, 1.0).unwrap();
    let layers = [Layer::quadratic((4, 4), (3, 2), 6, 5, true), Layer::quadratic((3, 2), (1, 1), 4, 2, false)];
    let network = Network::train(shape, &layers, x.as_ref(), &links).unwrap();
    assert_eq!(network.shape(), shape);
    assert_eq!(network.layers()[0].output(), Shape { width: 3, height: 2, channels: 5 });
    assert_eq!(network.layers()[1].output(), Shape { width: 1, height: 1, channels: 2 });
    assert_eq!(network.apply(x.as_ref().subcols(0, 7)).unwrap().ncols(), 7);

    let train = |layer: Layer| Network::train(shape, &[layer], x.as_ref(), &links).unwrap_err().to_string();
    let text = train(Layer::quadratic((4, 4), (4, 2), 6, 5, true));
    assert!(text.starts_with("layer 1: fields of 4 with a stride of 4 do not tile a width of 10"), "{text}");
    let text = train(Layer::quadratic((4, 7), (3, 1), 6, 5, true));
    assert!(text.starts_with("layer 1: fields of 7 with a stride of 1 do not tile a height of 6"), "{text}");
    let text = train(Layer::quadratic((4, 4), (3, 2), 6, 99, false));
    assert!(text.starts_with("layer 1: node (0, 0): step 3: 99 features are asked for"), "{text}");
    let wrong = Network::train(shape, &layers, x.as_ref().subrows(0, 179), &links).unwrap_err();
    assert!(matches!(wrong, SlowError::Shape { found: 179, expected: 180, .. }));
    assert!(network.apply(x.as_ref().subrows(0, 179)).is_err());
    assert!(matches!(Network::train(shape, &[], x.as_ref(), &links), Err(SlowError::Empty(_))));
}

#[test]
fn one_node_over_the_whole_frame_is_its_pipeline() {
    let shape = Shape { width: 3, height: 2, channels: 1 };
    let x = Mat::from_fn(6, 300, |i, t| (0.05 * (i + 1) as f64 * t as f64).sin());
    let links = Link::regular(300, 1.0).unwrap();
    let steps = vec![Step::Expand(Expansion::Quadratic), Step::Sfa { features: 3, lambda: 0.0 }];
    let pipeline = Pipeline::fit(&steps, x.as_ref(), &links).unwrap();
    for shared in [false, true] {
        let layer = Layer { field: (3, 2), stride: (1, 1), steps: steps.clone(), shared };
        let network = Network::train(shape, &[layer], x.as_ref(), &links).unwrap();
        assert_eq!(network.layers()[0].nodes().next().unwrap().pipeline, &pipeline);
        assert_eq!(network.apply(x.as_ref()).unwrap(), pipeline.apply(x.as_ref()).unwrap());
    }
}

#[test]
fn shared_nodes_have_the_same_weights_and_see_all_places() {
    let shape = Shape { width: 8, height: 4, channels: 1 };
    let (x, _) = blobs(shape, 600, 4);
    let links = Link::regular(600, 1.0).unwrap();
    let layer = |shared| Layer::quadratic((4, 4), (2, 2), 6, 3, shared);
    let shared = Network::train(shape, &[layer(true)], x.as_ref(), &links).unwrap();
    let single = Network::train(shape, &[layer(false)], x.as_ref(), &links).unwrap();
    let pipelines: Vec<&Pipeline> = shared.layers()[0].nodes().map(|node| node.pipeline).collect();
    assert_eq!(pipelines.len(), 3);
    assert!(pipelines.iter().all(|pipeline| *pipeline == pipelines[0]));
    let places: Vec<(usize, usize)> = shared.layers()[0].nodes().map(|node| (node.column, node.row)).collect();
    assert_eq!(places, [(0, 0), (1, 0), (2, 0)]);
    let apart: Vec<&Pipeline> = single.layers()[0].nodes().map(|node| node.pipeline).collect();
    assert!(apart[0] != apart[1] && apart[1] != apart[2]);
    // Before clipping, variance is 1 over all places together; clipping at ±4 takes little of it.
    let y = shared.apply(x.as_ref()).unwrap();
    let variance = (0..3).map(|place| (y.row(3 * place) * y.row(3 * place).transpose()) / 1800.0).sum::<f64>();
    assert!((variance - 1.0).abs() < 0.1, "{variance}");
    // The same picture two pixels to the right is told at the next place in the same words.
    let moved = Mat::from_fn(32, 600, |index, t| if index % 8 < 2 { 0.0 } else { x[(index - 2, t)] });
    let z = shared.apply(moved.as_ref()).unwrap();
    for t in 0..600 {
        for channel in 0..6 {
            assert_eq!(z[(channel + 3, t)], y[(channel, t)]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    /// Whatever is given: an error, or as many outputs as promised.
    #[test]
    fn no_network_panics(
        width in 0usize..5,
        height in 0usize..4,
        channels in 0usize..3,
        n in 0usize..20,
        field in (0usize..5, 0usize..4),
        stride in (0usize..3, 0usize..3),
        shared in any::<bool>(),
        reduced in 0usize..4,
        features in 0usize..3,
        scale in prop_oneof![5 => Just(1.0), 1 => Just(0.0), 1 => Just(f64::NAN), 1 => Just(1e90)],
        seed in any::<u64>(),
    ) {
        let mut rng = generator(seed);
        let shape = Shape { width, height, channels };
        let x = Mat::from_fn(shape.values(), n, |_, _| scale * rng.random_range(-1.0..1.0));
        let links = Link::regular(n, 1.0).unwrap();
        let layers = [Layer::quadratic(field, stride, reduced, features, shared), Layer::quadratic((1, 1), (1, 1), 1, 1, false)];
        if let Ok(network) = Network::train(shape, &layers, x.as_ref(), &links) {
            let y = network.apply(x.as_ref()).unwrap();
            prop_assert_eq!(y.nrows(), network.layers()[1].output().values());
        }
    }
}
