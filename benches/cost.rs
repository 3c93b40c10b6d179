//! How cost grows with each size, the others fixed: curves with their slopes on logarithmic axes, by how much ten times the work costs.
//!
//! All cores. Each point is the least of a few runs, so that what else the machine does counts little. Arguments: `--svg FILE`, which draws
//! the curves; `ADAGIO_BENCH_MAX_M` leaves out larger sets of support vectors.

mod common;

use std::error::Error;
use std::path::PathBuf;
use std::time::Instant;

use adagio::agent::Memory;
use adagio::slow::SlowStream;
use adagio::vision::{Observation, ZERO};
use common::data::{D, frames};
use common::operations::{self, Transitions};
use common::{Size, allowed, argument, cores, simulation};
use faer::Par;
use plotters::prelude::*;

/// Features, coordinates and transitions where they are not what grows.
const K: usize = 128;
const COORDINATES: usize = 40;
const TRANSITIONS: usize = 20_000;
/// Transitions where they are what grows.
const WINDOWS: [usize; 5] = [5000, 10_000, 20_000, 40_000, 80_000];
/// Decisions that are timed together.
const DECISIONS: usize = 200;
/// Runs of which the shortest counts: at least so many, and for so long, s.
const RUNS: usize = 3;
const LEAST: f64 = 1.0;

/// What it costs at each size.
struct Curve {
    name: &'static str,
    /// What grows.
    of: &'static str,
    /// Of the cost.
    unit: &'static str,
    /// Size and cost.
    points: Vec<(usize, f64)>,
}

fn main() -> Result<(), Box<dyn Error>> {
    adagio::random::fix_parallelism();
    common::machine::header();
    let par = Par::rayon(cores());
    let ms: Vec<usize> = allowed([500, 1000, 2000, 4000, 8000, 16_000].map(Size::of)).iter().map(|of| of.m).collect();
    let (by_frame, solving) = of_support_vectors(&ms, par);
    let m = 2000.min(ms.last().copied().unwrap_or(500));
    let curves = [
        by_frame,
        of_values(m / 2, par),
        solving,
        of_features(m, par),
        Curve { points: WINDOWS.map(values).to_vec(), ..curve("local values of a task", "transitions N", "s") },
        Curve {
            points: decisions(ms.iter().map(|&m| (m, m, TRANSITIONS))),
            ..curve("a decision", "support vectors m", "ms")
        },
        Curve {
            points: decisions(WINDOWS.map(|n| (n, m, n)).into_iter()),
            ..curve("a decision", "transitions N", "ms")
        },
        Curve {
            points: ms.iter().map(|&m| (m, memory(m, TRANSITIONS))).collect(),
            ..curve("memory, by its formula", "support vectors m", "GB")
        },
        Curve {
            points: [5000, 10_000, 20_000, 40_000, 80_000, 160_000].map(|n| (n, memory(m, n))).to_vec(),
            ..curve("memory, by its formula", "transitions N", "GB")
        },
    ];
    for curve in &curves {
        curve.print();
    }
    if let Some(path) = argument::<PathBuf>("--svg") {
        draw(&curves, &path)?;
    }
    Ok(())
}

fn curve(name: &'static str, of: &'static str, unit: &'static str) -> Curve {
    Curve { name, of, unit, points: Vec::new() }
}

impl Curve {
    /// By how much the logarithm of the cost grows with that of the size, over the last two points: small sizes have costs of their own.
    fn slope(&self) -> f64 {
        let [.., (less, cheap), (more, dear)] = self.points[..] else { return f64::NAN };
        (dear / cheap).ln() / (more as f64 / less as f64).ln()
    }

    fn print(&self) {
        println!("\n{} by {}: at last ~ {:.2}", self.name, self.of, self.slope());
        for (size, cost) in &self.points {
            println!("{size:>10} {cost:>10.3} {}", self.unit);
        }
    }
}

/// The seconds of the shortest of some runs.
fn shortest(mut work: impl FnMut()) -> f64 {
    let (mut shortest, mut runs, begin) = (f64::INFINITY, 0, Instant::now());
    while runs < RUNS || begin.elapsed().as_secs_f64() < LEAST {
        let begin = Instant::now();
        work();
        shortest = begin.elapsed().as_secs_f64().min(shortest);
        runs += 1;
    }
    shortest
}

/// Seconds of the local values of so many transitions.
fn values(transitions: usize) -> (usize, f64) {
    let of_walk = Transitions::of_walk(transitions, COORDINATES);
    (transitions, shortest(|| drop(of_walk.refit_locally(1))))
}

/// A stream whose dictionary of `m` frames of `d` values is full, and the milliseconds that it takes for a frame.
fn learning(m: usize, d: usize, par: Par) -> (SlowStream<f32>, f64) {
    let chunk = operations::chunk();
    let x = frames(d, m + 2 * chunk);
    let mut stream = operations::full_stream(&x, m, m, par);
    let seconds = shortest(|| operations::push(&mut stream, &x, m + chunk..m + 2 * chunk));
    (stream, 1e3 * seconds / chunk as f64)
}

/// A frame once the dictionary is full, and new features from its moments.
fn of_support_vectors(sizes: &[usize], par: Par) -> (Curve, Curve) {
    let mut by_frame = curve("learning from a frame", "support vectors m", "ms");
    let mut solving = curve("new slow features", "support vectors m", "s");
    for &m in sizes {
        let (mut stream, milliseconds) = learning(m, D, par);
        by_frame.points.push((m, milliseconds));
        let moments = stream.settled_moments().expect("frames that were accepted");
        solving.points.push((m, shortest(|| drop(operations::resolve(moments, K, None, par)))));
    }
    (by_frame, solving)
}

/// A frame, by the values of an observation.
fn of_values(m: usize, par: Par) -> Curve {
    let of = |d: usize| (d, learning(m, d, par).1);
    Curve { points: [384, 768, 1536, 3072, 6144].map(of).to_vec(), ..curve("learning from a frame", "values d", "ms") }
}

/// New features, by their number.
fn of_features(m: usize, par: Par) -> Curve {
    let x = frames(D, m + m / 4);
    let moments = operations::moments(&operations::dictionary(&x, m, par), &x, par);
    let of = |k: usize| (k, shortest(|| drop(operations::resolve(&moments, k, None, par))));
    let sizes = [32, 64, 128, 256, 512].into_iter().filter(|&k| k < m / 2);
    Curve { points: sizes.map(of).collect(), ..curve("new slow features", "features k", "s") }
}

/// Milliseconds from an observation to the values of all actions, by a size, for so many support vectors and transitions.
fn decisions(sizes: impl Iterator<Item = (usize, usize, usize)>) -> Vec<(usize, f64)> {
    let of = |(size, m, n): (usize, usize, usize)| {
        let x = frames(D, m);
        let learned = operations::learned_locally(&x, m, K, COORDINATES, n / operations::ACTIONS);
        let seen = |t: usize| Observation {
            frame: t as u64,
            pixels: x.col(t % m).iter().map(|&value| (value + f32::from(ZERO)) as u8).collect(),
        };
        let seen: Vec<Observation> = (0..DECISIONS).map(|t| seen(7 * t)).collect();
        let decide = || {
            for seen in &seen {
                std::hint::black_box(learned.state(seen).q_values(0));
            }
        };
        (size, 1e3 * shortest(decide) / DECISIONS as f64)
    };
    sizes.map(of).collect()
}

/// Gigabytes of a run in two rooms with places.
fn memory(m: usize, transitions: usize) -> f64 {
    let sets = [format!("actions={transitions}"), format!("value.window={transitions}")];
    let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
    1e-9 * Memory::with_budget(&simulation::scenario("two_rooms.toml", &sets), m).total() as f64
}

fn draw(curves: &[Curve], path: &PathBuf) -> Result<(), Box<dyn Error>> {
    let root = SVGBackend::new(path, (1050, 900)).into_drawing_area();
    root.fill(&WHITE)?;
    for (area, curve) in root.split_evenly((3, 3)).iter().zip(curves) {
        let sizes = curve.points.iter().map(|of| of.0 as f64);
        let costs = curve.points.iter().map(|of| of.1);
        let (least, most) =
            costs.fold((f64::INFINITY, 0.0f64), |(least, most), cost| (least.min(cost), most.max(cost)));
        let last = sizes.clone().fold(0.0, f64::max);
        let first = sizes.fold(last, f64::min);
        let mut chart = ChartBuilder::on(area)
            .caption(format!("{}, {}: ~ {:.1}", curve.name, curve.unit, curve.slope()), ("sans-serif", 15))
            .margin(8)
            .margin_right(36)
            .x_label_area_size(36)
            .y_label_area_size(48)
            .build_cartesian_2d((first..last).log_scale(), (0.7 * least..1.4 * most).log_scale())?;
        let number = |value: &f64| format!("{value}");
        let mut mesh = chart.configure_mesh();
        mesh.x_desc(curve.of).x_labels(4).y_labels(4).x_label_formatter(&number).y_label_formatter(&number);
        mesh.light_line_style(TRANSPARENT).bold_line_style(BLACK.mix(0.15)).draw()?;
        let points = || curve.points.iter().map(|of| (of.0 as f64, of.1));
        let blue = RGBColor(31, 95, 160);
        chart.draw_series(LineSeries::new(points(), blue.stroke_width(2)))?;
        chart.draw_series(points().map(|point| Circle::new(point, 3, blue.filled())))?;
        let costs = points().map(|point| {
            let text = Text::new(format!("{:.2}", point.1), (6, 4), ("sans-serif", 12));
            EmptyElement::at(point) + text
        });
        chart.draw_series(costs)?;
    }
    root.present()?;
    Ok(())
}
