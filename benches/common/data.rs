//! Frames as a robot's camera gives them, made without rendering.
//!
//! A pose walks smoothly through a room; each pixel is a smooth function of the pose; a camera adds 1 % noise; what comes
//! out are whole numbers as [`adagio::vision`] gives them. The noise keeps kernel matrices well conditioned, so every frame
//! can be a support vector: that reaches a wanted `m` after `m` frames, and costs what any other way to the same `m` costs.

use std::ops::Range;

use adagio::kernel::median_distance;
use adagio::random;
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

/// Values per observation: 32 × 16 pixels, RGB.
pub const D: usize = 1536;

/// Frames that are handled together.
pub const BLOCK: usize = 256;

/// Waves that each pixel is made of.
const WAVES: usize = 48;

/// Range of a pixel around zero, and its noise: 1 % of that range.
const RANGE: f32 = 120.0;
const NOISE: f32 = 0.01 * RANGE;

/// `n` frames of `d` values, one a column.
pub fn frames(d: usize, n: usize) -> Mat<f32> {
    let mut rng = random::stream(1, "bench frames");
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let waves: Vec<([f64; 2], f64, f64)> = (0..WAVES)
        .map(|i| ([1.5 * normal(), 1.5 * normal()], (i % 4) as f64, std::f64::consts::TAU * normal()))
        .collect();
    let mixing = Mat::from_fn(d, WAVES, |_, _| (normal() / (WAVES as f64).sqrt()) as f32);
    let poses = walk(n);
    let phase = |i: usize, t: usize| {
        let ([x, y], heading, offset) = waves[i];
        let [px, py, angle] = poses[t];
        (2.0 * (x * px + y * py + heading * angle + offset).cos()) as f32
    };
    let seen = Mat::from_fn(WAVES, n, phase);
    let mut image = Mat::<f32>::zeros(d, n);
    matmul(image.as_mut(), Accum::Replace, mixing.as_ref(), seen.as_ref(), 1.0, Par::Seq);
    let mut rng = random::stream(1, "bench noise");
    for j in 0..n {
        for pixel in image.col_mut(j).iter_mut() {
            let noise: f32 = StandardNormal.sample(&mut rng);
            *pixel = (RANGE * pixel.tanh() + NOISE * noise).round().clamp(-128.0, 127.0);
        }
    }
    image
}

/// The given columns in blocks of `size`.
pub fn blocks(x: &Mat<f32>, range: Range<usize>, size: usize) -> impl Iterator<Item = MatRef<'_, f32>> {
    let end = range.end;
    range.step_by(size).map(move |start| x.as_ref().subcols(start, size.min(end - start)))
}

/// Positions (m) and heading (rad) of a robot that drives and turns smoothly in a room of 3 m × 1.8 m.
pub fn walk(n: usize) -> Vec<[f64; 3]> {
    let mut rng = random::stream(1, "bench walk");
    let (mut pose, mut turn) = ([1.5, 0.9, 0.0], 0.0);
    (0..n)
        .map(|_| {
            turn = 0.8 * turn + rng.random_range(-0.1..0.1);
            pose[2] += turn;
            let (x, y) = (pose[0] + 0.06 * f64::cos(pose[2]), pose[1] + 0.06 * f64::sin(pose[2]));
            if (0.25..=2.75).contains(&x) && (0.25..=1.55).contains(&y) {
                (pose[0], pose[1]) = (x, y);
            } else {
                pose[2] += 0.3;
            }
            pose
        })
        .collect()
}

/// The kernel width for frames: this share of the median distance of the first ones.
const WIDTH_SHARE: f64 = 0.4;

/// The kernel width for these frames.
pub fn width(x: &Mat<f32>) -> f64 {
    let first = x.as_ref().subcols(0, x.ncols().min(512));
    WIDTH_SHARE * median_distance(first).expect("frames differ")
}
