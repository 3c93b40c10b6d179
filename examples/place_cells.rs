//! From a video to place cells: slow features of what a small animal sees, and independent components of them.
//!
//! `cargo run --release --example place_cells [PICTURE.png]`
//!
//! A "rat" runs slowly through the lab's room and turns its head quickly. What varies slowly in its pictures is then where
//! it is, and not where it looks (Franzius, Sprekeler & Wiskott 2007; thesis §4.2.3). The steps:
//!
//! 1. render the video,
//! 2. kernel SFA, as a stream,
//! 3. compare with the optimal responses of theory,
//! 4. independent components of the slowest features: each is active in one part of the room only,
//! 5. draw both over the room.

use std::error::Error;
use std::f64::consts::TAU;
use std::path::{Path, PathBuf};

use adagio::dictionary::{Ald, Parameters, WhenFull, width_for_size};
use adagio::kernel::Kernel;
use adagio::policy::columns;
use adagio::random::stream;
use adagio::scenario::Scenario;
use adagio::slow::ica::{Contrast, Options as IcaOptions, fast_ica};
use adagio::slow::theory::{Axis, OptimalResponses, plane_motion};
use adagio::slow::{Link, SlowModel, SlowStream, StreamOptions, solve};
use adagio::vision::{Observation, observe};
use adagio::world::{Pose, World};
use faer::{Mat, Par};
use image::{Rgb, RgbImage};
use nalgebra::{Point2, Vector2};
use rand_distr::{Distribution, StandardNormal};

/// Three cameras side by side see 320°, like the virtual rat of Franzius et al.
const EYES: [f64; 3] = [1.0, 0.0, -1.0];
const EYE_DEG: f64 = 320.0 / 3.0;
/// Frames of the video.
const FRAMES: usize = 16_000;
/// The rat keeps this distance from the walls, metres.
const MARGIN: f64 = 0.15;
/// Way in one frame, metres.
const STRIDE: f64 = 0.05;
/// Standard deviation of the turn of the head in one frame, radians.
const TURN: f64 = 0.5;
/// Place cells to look for.
const CELLS: usize = 16;
/// Maps in one line of the picture.
const LINE: usize = 8;
/// The maps have this many places along each metre, and look in this many directions at each.
const PLACES: f64 = 12.0;
const DIRECTIONS: usize = 8;

fn main() -> Result<(), Box<dyn Error>> {
    adagio::random::fix_parallelism();
    let scenario = Scenario::load(
        &Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/lab.toml"),
        &[format!("camera.field_of_view_deg={EYE_DEG}"), "vision.width=12".to_owned()],
    )?;
    let world = World::new(&scenario)?;
    let see = |poses: &[Pose]| {
        let look = |(t, pose): (usize, &Pose)| {
            let mut wide = Observation { frame: t as u64, pixels: Vec::new() };
            for side in EYES {
                let image = world.looks.camera(0).render(&turned(pose, side * EYE_DEG));
                wide.pixels.extend(observe(&image, &scenario.vision, t as u64).pixels);
            }
            wide
        };
        let seen: Vec<Observation> = poses.iter().enumerate().map(look).collect();
        columns(seen.iter())
    };

    // 1. The video: one picture of 36 × 16 pixels a column.
    let path = walk(&world);
    let video = see(&path);
    println!("{FRAMES} frames of {} values", video.nrows());

    // 2. Kernel SFA: the width at which 700 of the first 1000 frames become support vectors, then one pass over the video.
    let first = video.as_ref().subcols(0, 1000);
    let sigma = width_for_size(first, 0.01, 700, Kernel::gaussian, Par::Seq)?.sigma;
    let kernel = Kernel::gaussian(sigma)?;
    let ald = Ald::new(Parameters { kernel, nu: 0.01, budget: 2000, when_full: WhenFull::Stop, par: Par::Seq })?;
    let mut features = SlowStream::new(ald, StreamOptions::default())?;
    let links = Link::regular(FRAMES, 1.0)?;
    for start in (0..FRAMES).step_by(250) {
        let end = (start + 250).min(FRAMES);
        features.push(video.as_ref().subcols(start, end - start), &links[start..end])?;
    }
    println!("{} support vectors, sigma {sigma:.0} grey levels", features.dictionary().len());
    let solved = solve(features.settled_moments()?, 40, 1e-7, None)?;
    let model = SlowModel::new(features.dictionary(), &solved)?;

    // 3. What theory says of a room of this size and this way of moving.
    let (low, high) = world.plan.walls_box();
    let room = [
        Axis::free(low.x + MARGIN, high.x - MARGIN)?,
        Axis::free(low.y + MARGIN, high.y - MARGIN)?,
        Axis::cyclic(0.0, TAU)?,
    ];
    let optimal = OptimalResponses::slowest(&room, &plane_motion(STRIDE * STRIDE, TURN * TURN), 40)?;
    let still = optimal.invariant_to(2)?.min(CELLS);
    println!("of theory's 40 slowest responses, the first {} depend on the place alone", optimal.invariant_to(2)?);
    println!("feature  slowness  in theory");
    for (j, (found, response)) in solved.slowness.iter().zip(optimal.responses()).enumerate().take(6) {
        println!("{:>7}  {found:>8.4}  {:>9.4}", j + 1, response.slowness);
    }

    // 4. Independent components of those features.
    let slow = model.apply(video.as_ref(), Par::Seq)?;
    let options = IcaOptions { contrast: Contrast::Cube, ..IcaOptions::default() };
    let cells = fast_ica(slow.as_ref().subrows(1, still), options, &mut stream(1, "place cells"))?;

    // 5. Both, over the room.
    let map = Map::new(&world);
    let seen = see(&map.poses);
    let slow = model.apply(seen.as_ref(), Par::Seq)?;
    let slow = slow.as_ref().subrows(1, still).to_owned();
    let place = cells.apply(slow.as_ref())?;
    println!("\n                          slow features  place cells");
    let (a, b) = (map.summary(&slow), map.summary(&place));
    println!("variance by place alone    {:>11.0} %  {:>9.0} %", 100.0 * a.by_place, 100.0 * b.by_place);
    println!("room with half the peak    {:>11.0} %  {:>9.0} %", 100.0 * a.field, 100.0 * b.field);

    let out = std::env::args_os().nth(1).map_or_else(|| std::env::temp_dir().join("place_cells.png"), PathBuf::from);
    map.draw(&[&slow, &place]).save(&out)?;
    println!("slow features above, place cells below, seen from above: {}", out.display());
    Ok(())
}

fn turned(pose: &Pose, degrees: f64) -> Pose {
    Pose::new(pose.position, pose.heading + degrees.to_radians())
}

/// A smooth run between the walls, and a head that turns at random.
fn walk(world: &World) -> Vec<Pose> {
    let mut rng = stream(1, "rat");
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let (low, high) = world.plan.walls_box();
    let mut place = Point2::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y));
    let (mut course, mut heading) = (0.0f64, 0.0);
    (0..FRAMES)
        .map(|_| {
            course += 0.3 * normal();
            heading += TURN * normal();
            let mut next = place + STRIDE * Vector2::new(course.cos(), course.sin());
            while world.plan.clearance(next) < MARGIN {
                course += normal();
                next = place + STRIDE * Vector2::new(course.cos(), course.sin());
            }
            place = next;
            Pose::new(place, heading)
        })
        .collect()
}

/// Poses on a grid over the room, all directions of a place one after the other.
struct Map {
    width: usize,
    height: usize,
    poses: Vec<Pose>,
}

/// How feature maps look on average.
struct Summary {
    /// Share of the variance that the place explains, and the direction does not.
    by_place: f64,
    /// Share of the places where the mean over directions is above half of its peak.
    field: f64,
}

impl Map {
    fn new(world: &World) -> Self {
        let (low, high) = world.plan.walls_box();
        let size = high - low - Vector2::repeat(2.0 * MARGIN);
        let (width, height) = ((size.x * PLACES).round() as usize, (size.y * PLACES).round() as usize);
        let at = |i: usize, n: usize, from: f64, size: f64| from + MARGIN + size * (i as f64 + 0.5) / n as f64;
        let mut poses = Vec::with_capacity(width * height * DIRECTIONS);
        for row in 0..height {
            for column in 0..width {
                let place = Point2::new(at(column, width, low.x, size.x), at(row, height, low.y, size.y));
                poses.extend((0..DIRECTIONS).map(|d| Pose::new(place, TAU * d as f64 / DIRECTIONS as f64)));
            }
        }
        Map { width, height, poses }
    }

    /// Means over directions of one feature, at each place.
    fn means(&self, features: &Mat<f64>, feature: usize) -> Vec<f64> {
        let of_place = |place: usize| {
            (0..DIRECTIONS).map(|d| features[(feature, place * DIRECTIONS + d)]).sum::<f64>() / DIRECTIONS as f64
        };
        (0..self.width * self.height).map(of_place).collect()
    }

    fn summary(&self, features: &Mat<f64>) -> Summary {
        let variance = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64
        };
        let k = features.nrows() as f64;
        let mut summary = Summary { by_place: 0.0, field: 0.0 };
        for feature in 0..features.nrows() {
            let means = self.means(features, feature);
            let all: Vec<f64> = features.row(feature).iter().copied().collect();
            let peak = means.iter().copied().fold(f64::MIN, f64::max);
            summary.by_place += variance(&means) / variance(&all) / k;
            summary.field += means.iter().filter(|&&mean| mean > 0.5 * peak).count() as f64 / means.len() as f64 / k;
        }
        summary
    }

    /// The maps of each list of features in lines: blue below zero, red above, white at zero.
    fn draw(&self, lists: &[&Mat<f64>]) -> RgbImage {
        const PIXELS: usize = 4;
        const GAP: usize = 8;
        let (wide, high) = (self.width * PIXELS + GAP, self.height * PIXELS + GAP);
        let lines = |features: &&Mat<f64>| features.nrows().div_ceil(LINE);
        let size = |count: usize, step: usize| (count * step + GAP) as u32;
        let all = lists.iter().map(lines).sum();
        let mut picture = RgbImage::from_pixel(size(LINE, wide), size(all, high), Rgb([90, 90, 90]));
        let mut top = GAP;
        for features in lists {
            for feature in 0..features.nrows() {
                let (left, top) = (GAP + feature % LINE * wide, top + feature / LINE * high);
                let means = self.means(features, feature);
                let largest = means.iter().fold(0.0f64, |largest, mean| largest.max(mean.abs()));
                for y in 0..self.height * PIXELS {
                    for x in 0..self.width * PIXELS {
                        // The y axis points up.
                        let place = (self.height - 1 - y / PIXELS) * self.width + x / PIXELS;
                        let pale = (255.0 * (1.0 - (means[place] / largest).abs())) as u8;
                        let colour = if means[place] < 0.0 { [pale, pale, 255] } else { [255, pale, pale] };
                        picture.put_pixel((left + x) as u32, (top + y) as u32, Rgb(colour));
                    }
                }
            }
            top += lines(features) * high;
        }
        picture
    }
}
