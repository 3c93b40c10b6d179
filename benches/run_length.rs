//! What a frame costs as a run gets longer, at a fixed number of support vectors: it must not grow.
//!
//! Frames are those of the lab's robot on its random walk; rendering is not timed. Arguments, each with a value: `--frames`,
//! `--m`, `--retained`, and `--svg FILE`, which draws the curve.

mod common;

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use common::data::BLOCK;
use common::simulation::{Frames, Walker};
use common::{argument, max_m};

use adagio::agent::resident_bytes;
use adagio::dictionary::{Ald, Parameters, WhenFull};
use adagio::kernel::Kernel;
use adagio::slow::{SlowStream, StreamOptions};
use faer::Par;
use plotters::prelude::*;

/// Frames of a run; each point of the curve is over [`STEP`] of them.
const FRAMES: usize = 250_000;
const STEP: usize = 10_000;

/// Narrow enough that the dictionary is full early in the first step.
const SIGMA: f64 = 1000.0;
const NU: f64 = 0.01;

/// A point of the curve.
struct Point {
    frames: usize,
    support_vectors: usize,
    microseconds: f64,
    resident_mib: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    adagio::random::fix_parallelism();
    common::machine::header();
    let quick = max_m() < 8000;
    let total: usize = argument("--frames").unwrap_or(if quick { 2 * STEP } else { FRAMES });
    let m = argument("--m").unwrap_or(1000);
    let retained = argument("--retained").unwrap_or(5000);

    let kernel = Kernel::gaussian(SIGMA)?;
    let selection = Ald::new(Parameters { kernel, nu: NU, budget: m, when_full: WhenFull::Stop, par: Par::Seq })?;
    let mut stream = SlowStream::new(selection, StreamOptions { retained, ..StreamOptions::default() })?;
    let mut walker = Walker::new();
    let mut points: Vec<Point> = Vec::new();
    println!("learning, m ≤ {m}, {retained} frames retained, blocks of {BLOCK}, 1 thread");
    println!("{:>10} {:>16} {:>10} {:>14}", "frames", "support vectors", "µs/frame", "resident MiB");
    while stream.frames() < total {
        let frames = walker.frames(STEP);
        let seconds = learn(&mut stream, &frames)?;
        let point = Point {
            frames: stream.frames(),
            support_vectors: stream.dictionary().len(),
            microseconds: 1e6 * seconds / STEP as f64,
            resident_mib: resident_bytes().map_or(f64::NAN, |bytes| bytes as f64 / f64::from(1 << 20)),
        };
        let Point { frames, support_vectors, microseconds, resident_mib } = point;
        println!("{frames:>10} {support_vectors:>16} {microseconds:>10.1} {resident_mib:>14.0}");
        points.push(point);
    }
    if let Some((first, last)) = quarters(&points) {
        println!(
            "with a full dictionary: {first:.1} µs per frame in the first quarter, {last:.1} in the last one, ratio {:.3}",
            last / first
        );
    }
    if let Some(path) = argument::<PathBuf>("--svg") {
        draw(&points, m, &path)?;
    }
    Ok(())
}

/// The seconds that frames need.
fn learn(stream: &mut SlowStream<f32>, frames: &Frames) -> Result<f64, Box<dyn Error>> {
    let begin = Instant::now();
    for start in (0..STEP).step_by(BLOCK) {
        let size = BLOCK.min(STEP - start);
        stream.push(frames.x.as_ref().subcols(start, size), &frames.links[start..start + size])?;
    }
    Ok(begin.elapsed().as_secs_f64())
}

/// Mean cost in the first and the last quarter of the points with a full dictionary, if there are enough of them.
fn quarters(points: &[Point]) -> Option<(f64, f64)> {
    let full = points.last()?.support_vectors;
    // The point in which the dictionary became full has paid for growing.
    let begin = points.iter().position(|point| point.support_vectors == full)? + 1;
    let (steady, quarter) = (&points[begin..], points[begin..].len() / 4);
    let mean = |part: &[Point]| part.iter().map(|point| point.microseconds).sum::<f64>() / part.len() as f64;
    (quarter > 0).then(|| (mean(&steady[..quarter]), mean(&steady[steady.len() - quarter..])))
}

fn draw(points: &[Point], m: usize, path: &PathBuf) -> Result<(), Box<dyn Error>> {
    let most = |value: fn(&Point) -> f64| 1.2 * points.iter().map(value).fold(0.0, f64::max);
    let frames = points.last().map_or(0, |point| point.frames) as f64;
    let root = SVGBackend::new(path, (900, 420)).into_drawing_area();
    root.fill(&WHITE)?;
    let (cost, memory) = (RGBColor(31, 95, 160), RGBColor(190, 90, 20));
    let mut chart = ChartBuilder::on(&root)
        .caption(format!("Learning at m = {m}: cost per frame and resident memory"), ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(40)
        .y_label_area_size(60)
        .right_y_label_area_size(60)
        .build_cartesian_2d(0.0..frames, 0.0..most(|point| point.microseconds))?
        .set_secondary_coord(0.0..frames, 0.0..most(|point| point.resident_mib));
    chart.configure_mesh().x_desc("frames").y_desc("µs per frame").x_label_formatter(&|x| format!("{x:.0}")).draw()?;
    chart.configure_secondary_axes().y_desc("resident MiB").draw()?;
    let line = |value: fn(&Point) -> f64| points.iter().map(move |point| (point.frames as f64, value(point)));
    chart
        .draw_series(LineSeries::new(line(|point| point.microseconds), cost.stroke_width(2)))?
        .label("µs per frame")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], cost));
    chart
        .draw_secondary_series(LineSeries::new(line(|point| point.resident_mib), memory.stroke_width(2)))?
        .label("resident MiB")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], memory));
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE)
        .label_font(("sans-serif", 14))
        .draw()?;
    root.present()?;
    Ok(())
}
