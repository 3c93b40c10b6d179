//! What a graphics processor does, beside the processor and beside its own rates: `cargo bench --bench gpu`.
//!
//! `-- --software` takes a driver in software where there is no other: that everything runs, not how fast.

mod common;

use std::time::Instant;

use common::simulation;

use adagio::gpu::{Adapters, Gpu};
use adagio::world::{Image, Looks, Pose, World};
use rayon::prelude::*;

/// Width and height of a view.
const SIZES: [(usize, usize); 3] = [(64, 32), (128, 64), (320, 240)];

/// Views asked for at once.
const AT_ONCE: [usize; 4] = [1, 64, 1024, 16_384];

/// A rate is the best of several tries; all of them together take about so long.
const SECONDS: f64 = 1.0;

fn main() {
    let software = std::env::args().any(|argument| argument == "--software");
    common::machine::header();
    let gpu = match Gpu::open(if software { Adapters::Any } else { Adapters::Hardware }) {
        Ok(gpu) => gpu,
        Err(error) => return println!("nothing is measured: {error}"),
    };
    println!("{}", gpu.name());
    match gpu.copy_rates() {
        Ok(rates) => println!(
            "copies {:.0} GB/s within the device (read and written), {:.1} GB/s from it to memory",
            rates.within / 1e9,
            rates.to_memory / 1e9
        ),
        Err(error) => return println!("{error}"),
    }
    println!("\n| view | at once | device, views/s | processor, views/s | ratio |\n|---|---|---|---|---|");
    for (width, height) in SIZES {
        for count in AT_ONCE {
            // What would take gigabytes of pictures is no use to anybody.
            if width * height * count <= 1 << 27 {
                views(&gpu, (width, height), count);
            }
        }
    }
}

fn views(gpu: &std::sync::Arc<Gpu>, (width, height): (usize, usize), count: usize) {
    let sets = [
        "camera.detail=\"full\"".to_owned(),
        format!("camera.width={width}"),
        format!("camera.height={height}"),
        format!("vision.cut_rows={}", height / 3),
        format!("vision.width={}", width / 4),
        format!("vision.height={}", height / 4),
    ];
    let scenario = simulation::scenario("lab.toml", &sets.each_ref().map(String::as_str));
    let world = World::new(&scenario).expect("a scenario without image files");
    let device = Looks::new(&scenario).expect("a scenario without image files").on(gpu.clone());
    let poses: Vec<(Pose, u64)> =
        simulation::poses(&scenario).into_iter().cycle().take(count).map(|pose| (pose, 0)).collect();
    let mut images = vec![Image::default(); count];
    let by_device = rate(count, || assert!(device.render_by_device(0, &poses, &mut images), "the device has failed"));
    let by_processor = rate(count, || {
        let each = |(image, (pose, _)): (&mut Image, &(Pose, u64))| world.looks.render_into(pose, 0, 0, image);
        images.par_iter_mut().zip(&poses).for_each(each);
    });
    println!("| {width} × {height} | {count} | {by_device:.0} | {by_processor:.0} | {:.2} |", by_device / by_processor);
}

/// Things done in a second, if `work` does so many.
fn rate(count: usize, mut work: impl FnMut()) -> f64 {
    work();
    let (begin, mut best) = (Instant::now(), f64::INFINITY);
    while begin.elapsed().as_secs_f64() < SECONDS {
        let start = Instant::now();
        work();
        best = best.min(start.elapsed().as_secs_f64());
    }
    count as f64 / best
}
