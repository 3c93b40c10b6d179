//! A map of a walk by appearance: odometry from keyframe to keyframe, closures where images are alike, the pose graph of both.
//!
//! A keyframe is the state at the end of each action. How alike two images have to be, and how exact a closure then is, is read off
//! the walk itself: images that few actions apart were seen have relative poses that odometry knows well.
//!
//! # Reference
//! Cummins & Newman 2008 (loops closed by appearance); Lu & Milios 1997.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

use nalgebra::{UnitComplex, Vector2};

use crate::robot::{Pose, wrap};
use crate::scenario::Vision;
use crate::value::place::{Factor, GraphError, PoseGraph};

/// Pixels of an observation that make one of a keyframe, along each axis.
const BINNED: usize = 2;
/// Images that are at most so many actions apart tell what alike means; closures are of those that are further apart.
const WINDOW: usize = 40;
/// Every so many keyframes one closure is looked for: all of them would make the normal equations dense.
const EVERY: usize = 5;
/// Two poses are one place up to so many metres and radians; of pairs as alike as a closure needs, at least this share are.
const PLACE: (f64, f64) = (0.2, 15.0 * std::f64::consts::PI / 180.0);
const SHARE: f64 = 0.9;
/// With fewer such pairs nothing is known.
const LEAST: usize = 20;
/// Of pairs that differ by less, in metres and radians, the robot has not moved.
const STOOD: f64 = 1e-3;
/// A closure that contradicts the way up to there by more than so many metres and radians does not count for the first guess.
const GATE: (f64, f64) = (0.6, 40.0 * std::f64::consts::PI / 180.0);
/// What odometry is inexact by however short a step is: metres and radians.
const FLOOR: f64 = 0.002;
/// Cauchy's width for closures, standard deviations.
const CAUCHY: f64 = 1.0;
/// Steps of the optimisation; one that moves no pose further (metres, radians) is the last.
const STEPS: usize = 30;
const TOLERANCE: f64 = 1e-3;
/// Keyframes that are compared with all others at once.
const BLOCK: usize = 256;

/// A small image of a keyframe, of an observation's values (RGB, row by row): zero mean and unit norm; 0 of an image of one colour. In grey
/// alone, half of the pairs that are most alike are views of different walls from nearby.
pub fn thumbnail(values: impl IntoIterator<Item = f32>, vision: &Vision) -> Vec<f32> {
    let width = vision.width.div_ceil(BINNED);
    let mut cells = vec![[0.0; 3]; width * vision.height.div_ceil(BINNED)];
    for (i, value) in values.into_iter().enumerate() {
        let (column, row) = (i / 3 % vision.width, i / 3 / vision.width);
        cells[row / BINNED * width + column / BINNED][i % 3] += value;
    }
    let mut pixels = cells.into_flattened();
    let mean = pixels.iter().sum::<f32>() / pixels.len() as f32;
    pixels.iter_mut().for_each(|value| *value -= mean);
    let norm = pixels.iter().map(|value| value * value).sum::<f32>().sqrt();
    if norm > 0.0 {
        pixels.iter_mut().for_each(|value| *value /= norm);
    }
    pixels
}

/// A closure: two keyframes that are one place.
pub type Closure = (usize, usize);

/// The map of a walk.
#[derive(Debug)]
pub struct Chart {
    /// Poses of all keyframes, metres; the first one is the origin.
    pub poses: Vec<Pose>,
    /// The earlier keyframe, and the later one.
    pub closures: Vec<Closure>,
}

/// How alike images of one place are, and how far apart their poses: metres ahead and aside, radians.
#[derive(Debug, Clone, Copy)]
struct Likeness {
    least: f32,
    sigmas: [f64; 3],
}

impl Chart {
    /// What odometry alone says, from the origin on.
    pub fn reckoned(odometry: &[Pose]) -> Self {
        let poses = odometry.iter().map(|pose| pose.seen_from(&odometry[0])).collect();
        Chart { poses, closures: Vec::new() }
    }

    /// The map of keyframes with their thumbnails, `p × n`, and where odometry places them, `n`. `noise`: standard deviation of odometry, as a share of
    /// each motion.
    ///
    /// # Errors
    /// Those of the graph.
    pub fn new(thumbnails: MatRef<'_, f32>, odometry: &[Pose], noise: f64, par: Par) -> Result<Self, GraphError> {
        let Some(likeness) = likeness(thumbnails, odometry) else { return Ok(Chart::reckoned(odometry)) };
        let closures = closures(thumbnails, likeness.least, par);
        let step = |t: usize| odometry[t + 1].seen_from(&odometry[t]);
        let odometric = |t: usize| {
            let measured = step(t);
            let [ahead, turned] = [measured.position.coords.norm(), measured.heading.abs()];
            let sigmas = [FLOOR + noise * ahead, FLOOR, FLOOR + noise * turned];
            Factor { from: t, to: t + 1, measured: measured.into(), sigmas, cauchy: None }
        };
        let closing = |&(from, to): &Closure| Factor {
            from,
            to,
            measured: Pose::default().into(),
            sigmas: likeness.sigmas,
            cauchy: Some(CAUCHY),
        };
        let factors = (0..odometry.len() - 1).map(odometric).chain(closures.iter().map(closing)).collect();
        let mut graph = PoseGraph::new(guess(odometry, &closures).into_iter().map(Into::into).collect(), factors)?;
        graph.optimise(STEPS, TOLERANCE)?;
        Ok(Chart { poses: graph.poses().iter().map(|&pose| pose.into()).collect(), closures })
    }
}

/// Whether poses that are so far from each other are one place.
fn is_within(apart: &Pose, (distance, angle): (f64, f64)) -> bool {
    apart.position.coords.norm() <= distance && apart.heading.abs() <= angle
}

/// From pairs of images that are few actions apart; `None` where too few of them show one place.
fn likeness(thumbnails: MatRef<'_, f32>, odometry: &[Pose]) -> Option<Likeness> {
    let n = odometry.len();
    let pairs = (0..n).flat_map(|i| (i + 2..n.min(i + 1 + WINDOW)).map(move |j| (i, j)));
    let moved = pairs.filter_map(|(i, j)| {
        let apart = odometry[j].seen_from(&odometry[i]);
        // Who stands before a wall sees the same again and again: that says nothing about other places.
        (!is_within(&apart, (STOOD, STOOD))).then(|| (alike(thumbnails, i, j), apart))
    });
    let mut moved: Vec<(f32, Pose)> = moved.collect();
    moved.sort_by(|a, b| b.0.total_cmp(&a.0));
    let (mut near, mut count) = (0, 0);
    for (number, (_, apart)) in moved.iter().enumerate() {
        near += usize::from(is_within(apart, PLACE));
        if near as f64 >= SHARE * (number + 1) as f64 {
            count = number + 1;
        }
    }
    if count < LEAST {
        return None;
    }
    let (mut sums, alike) = ([0.0; 3], &moved[..count]);
    for (_, apart) in alike.iter().filter(|of| is_within(&of.1, PLACE)) {
        let parts = [apart.position.x, apart.position.y, apart.heading];
        sums.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part * part);
    }
    let least = alike[count - 1].0;
    Some(Likeness { least, sigmas: sums.map(|sum| FLOOR + (sum / count as f64).sqrt()) })
}

fn alike(thumbnails: MatRef<'_, f32>, i: usize, j: usize) -> f32 {
    thumbnails.col(i).iter().zip(thumbnails.col(j).iter()).map(|(a, b)| a * b).sum()
}

/// Of every few keyframes one, and the one that is most like it of those that are further off in time.
fn closures(thumbnails: MatRef<'_, f32>, least: f32, par: Par) -> Vec<Closure> {
    let n = thumbnails.ncols();
    let asked: Vec<usize> = (0..n).step_by(EVERY).collect();
    let mut found = Vec::new();
    for block in asked.chunks(BLOCK) {
        let of = Mat::from_fn(thumbnails.nrows(), block.len(), |i, k| thumbnails[(i, block[k])]);
        let mut products = Mat::<f32>::zeros(n, block.len());
        matmul(products.as_mut(), Accum::Replace, thumbnails.transpose(), of.as_ref(), 1.0, par);
        for (k, &i) in block.iter().enumerate() {
            let others = (0..n).filter(|&j| j.abs_diff(i) > WINDOW && products[(j, k)] >= least);
            let best = others.max_by(|&a, &b| products[(a, k)].total_cmp(&products[(b, k)]));
            found.extend(best.map(|j| (i.min(j), i.max(j))));
        }
    }
    found.sort_unstable_by_key(|&(from, to)| (to, from));
    found.dedup();
    found
}

/// A first guess of all poses: odometry, and half of the way towards the earlier keyframe of each closure.
fn guess(odometry: &[Pose], closures: &[Closure]) -> Vec<Pose> {
    let mut poses = vec![Pose::default()];
    let mut closures = closures.iter().peekable();
    for t in 1..odometry.len() {
        let mut pose = poses[t - 1].then(&odometry[t].seen_from(&odometry[t - 1]));
        while let Some((from, _)) = closures.next_if(|closure| closure.1 == t) {
            let off = poses[*from].seen_from(&pose);
            if is_within(&off, GATE) {
                pose = pose.then(&Pose::new(off.position * 0.5, 0.5 * off.heading));
            }
        }
        poses.push(pose);
    }
    poses
}

/// The rigid motion that brings poses nearest to others in the least squares of their positions: its [`then`](Pose::then) moves each of them.
///
/// # Reference
/// Umeyama 1991, in the plane and without a scale.
pub fn alignment(poses: &[Pose], to: &[Pose]) -> Pose {
    let n = poses.len().min(to.len()).max(1) as f64;
    let mean = |of: &[Pose]| of.iter().map(|pose| pose.position.coords).sum::<Vector2<f64>>() / n;
    let (from_mean, to_mean) = (mean(poses), mean(to));
    let (mut dot, mut cross) = (0.0, 0.0);
    for (a, b) in poses.iter().zip(to) {
        let (a, b) = (a.position.coords - from_mean, b.position.coords - to_mean);
        (dot, cross) = (dot + a.dot(&b), cross + a.perp(&b));
    }
    let angle = cross.atan2(dot);
    Pose::new((to_mean - UnitComplex::new(angle) * from_mean).into(), angle)
}

/// Root mean square distance, metres, and angle, degrees, between poses.
pub fn rms(poses: impl Iterator<Item = (Pose, Pose)>) -> (f64, f64) {
    let (mut squares, mut n) = ([0.0; 2], 0usize);
    for (a, b) in poses {
        squares[0] += (a.position - b.position).norm_squared();
        squares[1] += wrap(a.heading - b.heading).to_degrees().powi(2);
        n += 1;
    }
    let [distance, angle] = squares.map(|sum| (sum / n.max(1) as f64).sqrt());
    (distance, angle)
}
