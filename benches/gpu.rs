//! What a graphics processor does, beside the processor and beside its own rates: `cargo bench --bench gpu`.
//!
//! `-- --software` takes a driver in software where there is no other: that everything runs, not how fast.

mod common;

use std::sync::Arc;
use std::time::Instant;

use common::data::D;
use common::simulation;

use adagio::gpu::{Adapters, Gpu, GpuError, Of, Rows};
use adagio::kernel::{Kernel, squared_norms};
use adagio::slow::SlowModel;
use adagio::vision::Image;
use adagio::world::{Appearance, Eye, World};
use faer::{Mat, MatRef, Par};
use rayon::prelude::*;

/// Width and height of a view.
const SIZES: [(usize, usize); 3] = [(64, 32), (128, 64), (320, 240)];

/// Views asked for at once.
const AT_ONCE: [usize; 4] = [1, 64, 1024, 16_384];

/// Support vectors.
const VECTORS: [usize; 3] = [4000, 8000, 32_000];

/// Observations at once, and features.
const N: usize = 1024;
const K: usize = 128;

/// A rate is the best of several tries; all of them together take about so long.
const SECONDS: f64 = 1.0;

fn main() {
    let software = std::env::args().any(|argument| argument == "--software");
    common::machine::header();
    let gpu = match Gpu::open(if software { Adapters::Any } else { Adapters::Hardware }) {
        Ok(gpu) => gpu,
        Err(error) => return println!("nothing is measured: {error}"),
    };
    if let Err(error) = measure(&gpu) {
        println!("{error}");
    }
}

fn measure(gpu: &Arc<Gpu>) -> Result<(), GpuError> {
    let (copies, single) = (gpu.copy_rates()?, gpu.single_precision_rate()?);
    println!(
        "device: {}; copies {:.1} GB/s within it (read and written), {:.1} GB/s from it to memory; f32 {:.1} GF/s",
        gpu.name(),
        copies.within / 1e9,
        copies.to_memory / 1e9,
        single / 1e9
    );
    println!("\n| view | at once | device, views/s | processor, views/s | ratio |\n|---|---|---|---|---|");
    for (width, height) in SIZES {
        for count in AT_ONCE {
            // What would take gigabytes of pictures is no use to anybody.
            if width * height * count <= 1 << 27 {
                views(gpu, (width, height), count);
            }
        }
    }
    println!(
        "\n{N} observations of {D} values; `without transfers`: of the device's f32 rate; features: kernel values and {K} features of them, as a refit has them"
    );
    println!(
        "\n| support vectors | without transfers | kernel values on the device, frames/s | products there, values here | processor | features, with the device | processor |"
    );
    println!("|---|---|---|---|---|---|---|");
    for m in VECTORS {
        // In software the smallest takes a minute.
        if !gpu.is_software() {
            rows(gpu, m, single)?;
        }
    }
    if gpu.is_software() {
        rows(gpu, 200, single)?;
    }
    Ok(())
}

/// Kernel values and features of `N` observations over `m` support vectors.
fn rows(gpu: &Arc<Gpu>, m: usize, single: f64) -> Result<(), GpuError> {
    let par = Par::rayon(0);
    let (members, x) = (Arc::new(frames(m, 1)), frames(N, 2));
    let (of_members, of_x) = (squared_norms(members.as_ref().as_ref()), squared_norms(x.as_ref()));
    let kernel = Kernel::gaussian(3000.0).expect("a positive width");
    let projection = Mat::from_fn(m, K, |i, j| ((i * 31 + j * 17) % 97) as f64 / 97.0 - 0.5);
    let model = SlowModel::from_parts(kernel, (*members).clone(), projection, vec![0.0; K], vec![1.0; K])
        .expect("parts that fit each other");
    let mut device = Rows::new(gpu.clone(), D)?;
    device.hold(&members, &of_members)?;
    let mut failure = None;
    let mut compute = |of: Of, then: &dyn Fn(MatRef<'_, f32>)| {
        rate(N, || {
            let begun = device.begin(x.as_ref(), &of_x, of);
            failure = begun.and_then(|begun| device.finish_with(begun, then)).err().or(failure.take());
        })
    };
    let values = compute(Of::Values(kernel), &|found| drop(std::hint::black_box(found.to_owned())));
    let here = |products: MatRef<'_, f32>| {
        kernel.matrix_of_products(products, &of_members, &of_x, par).expect("sizes that fit")
    };
    let finished_here = compute(Of::Products, &|products| drop(std::hint::black_box(here(products))));
    let features = compute(Of::Products, &|products| {
        drop(std::hint::black_box(model.apply_to_rows(here(products).as_ref(), par)));
    });
    if let Some(error) = failure {
        return Err(error);
    }
    let times = if gpu.is_software() { 1 } else { 50 };
    let share = 2.0 * (D * m * N) as f64
        / device.seconds_without_transfers(x.as_ref(), &of_x, Of::Values(kernel), times)?
        / single;
    let by_processor = rate(N, || drop(std::hint::black_box(model.kernel_rows(x.as_ref(), par))));
    let features_by_processor = rate(N, || drop(std::hint::black_box(model.apply(x.as_ref(), par))));
    println!(
        "| {m} | {:.0} % | {values:.0} | {finished_here:.0} | {by_processor:.0} | {features:.0} | {features_by_processor:.0} |",
        100.0 * share
    );
    Ok(())
}

/// Observations as cameras give them: whole numbers.
fn frames(n: usize, seed: usize) -> Mat<f32> {
    Mat::from_fn(D, n, |i, j| ((i * 37 + j * 101 + i * j + seed * 53) % 181) as f32 - 90.0)
}

fn views(gpu: &Arc<Gpu>, (width, height): (usize, usize), count: usize) {
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
    let device = Appearance::new(&scenario).expect("a scenario without image files").on(gpu.clone());
    let poses = simulation::poses(&scenario).into_iter().cycle();
    let poses: Vec<Eye> = poses.take(count).map(|pose| Eye::from((pose, 0))).collect();
    let mut images = vec![Image::default(); count];
    let by_device = rate(count, || assert!(device.render_by_device(0, &poses, &mut images), "the device has failed"));
    let by_processor = rate(count, || {
        let each = |(image, eye): (&mut Image, &Eye)| world.appearance.render_into(eye, 0, image);
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
