//! `online`: how good policies are by what was seen, for our stream and for what it is to be compared with.
//!
//! All learn from the camera of the same room and are tried from the same starts; success and quality are means over the two
//! goals. The batch pipeline, IncSFA and the true pose learn from one random walk, of which they are shown more and more;
//! the stream explores and pursues goals; Stream-Q(λ) acts on its own values, once for each goal.

use std::collections::BTreeMap;

use faer::{Mat, Par};
use serde::Serialize;

use super::driven::{SMALL, curve, drive};
use super::field::{Field, Point, StreamQRun};
use super::lab::{Data, Lab};
use super::plot::{Line, chart};
use super::quality::Quality;
use super::trained::{Training, train, with_one};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::report::draw::Axis;
use crate::slow::SlowModel;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "online",
    line: "success by frames seen: our stream, the batch pipeline, IncSFA, Stream-Q(λ), true pose, random, optimal",
    lasts: Sizes { full: "5 min", quick: "8 min", smoke: "seconds" },
    run,
};

/// Actions after which policies are tried.
const ACTIONS: Sizes<&[usize]> =
    Sizes { full: &[1000, 2000, 4000, 8000, 15_000], quick: &[1000, 2000, 4000], smoke: &[150, 300] };
/// Features, the constant included, and random starts for each goal.
const FEATURES: Sizes<(usize, usize)> = Sizes { full: (128, 200), quick: (128, 100), smoke: (16, 10) };
/// Features of the true pose: as many as `pose-lspi` finds good where blocked moves are among the transitions.
const POSE_FEATURES: usize = 200;
/// One support vector of the batch pipeline for so many frames (the thesis had 4.4), at most [`MOST_VECTORS`].
const FRAMES_PER_VECTOR: usize = 4;
const MOST_VECTORS: usize = 2000;
/// Features of IncSFA, and the principal components that they are made of.
const INCREMENTAL: Sizes<(usize, usize)> = Sizes { full: (64, 100), quick: (64, 100), smoke: (8, 12) };
/// Actions of an episode of Stream-Q(λ) at most.
const EPISODE: usize = 40;

/// What learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    Stream,
    Batch,
    Incremental,
    QOnPixels,
    QOnSlowFeatures,
    TruePose,
    Random,
    Reference,
    Optimal,
}

impl Method {
    /// All of them in the order of their declaration, with their names.
    const ALL: [(Method, &str); 9] = [
        (Method::Stream, "our stream"),
        (Method::Batch, "the thesis's batch pipeline"),
        (Method::Incremental, "IncSFA on pixels, our LSPI"),
        (Method::QOnPixels, "Stream-Q(λ) on pixels"),
        (Method::QOnSlowFeatures, "Stream-Q(λ) on slow features"),
        (Method::TruePose, "true pose, our LSPI"),
        (Method::Random, "random actions"),
        (Method::Reference, "reference policy"),
        (Method::Optimal, "optimum"),
    ];

    fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }
}

#[derive(Serialize)]
struct Settings {
    data: Data,
    method: Method,
    actions: Vec<usize>,
    features: usize,
    starts: usize,
}

/// Our agent: one run, tried with each of its models.
fn our_stream(settings: &Settings, seed: u64, bench: &Bench<'_>) -> Result<Vec<Point>, ExperimentError> {
    let actions = settings.actions.iter().copied().max().unwrap_or(1);
    let (length, starts) = (format!("actions={actions}"), format!("evaluate.starts={}", settings.starts));
    let mut sets = vec![length.as_str(), "robot.frames_per_action=5", &starts];
    if actions < 1000 {
        sets.extend(SMALL);
    }
    let lab = Lab::new(seed, &sets)?;
    Ok(curve(drive(&lab, &lab.evaluator(settings.starts), bench)?.curve))
}

/// By method, the points of each seed.
type Found = BTreeMap<Method, Vec<Vec<Point>>>;

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let actions = scope.pick(ACTIONS);
    let (features, starts) = scope.pick(FEATURES);
    let most = actions.iter().copied().max().unwrap_or(1);
    bench.plan(scope.seeds.len() * Method::ALL.len());
    let mut found = Found::new();
    for &seed in scope.seeds.iter() {
        let lab = Lab::new(seed, &[])?;
        let shared = Once::default();
        for (method, name) in Method::ALL {
            let data = Data::new(&lab, most);
            let settings = Settings { data, method, actions: actions.to_vec(), features, starts };
            let points = bench.result(&format!("{name}, seed {seed}"), &settings, || {
                if method == Method::Stream {
                    return our_stream(&settings, seed, bench);
                }
                let field: &Field<'_> = shared.get(|| Field::new(&lab, most, starts, bench))?;
                match method {
                    Method::Stream => unreachable!("it needs no field"),
                    Method::Batch => {
                        let of = |&count: &usize| {
                            let (qualities, _) = field.batch(count, features, most_vectors(count))?;
                            Ok(Point::new(count, &qualities))
                        };
                        actions.iter().map(of).collect()
                    }
                    Method::TruePose => {
                        let of = |&count: &usize| Ok(Point::new(count, &field.true_pose(count, POSE_FEATURES)?));
                        actions.iter().map(of).collect()
                    }
                    Method::Incremental => field.incremental(actions, scope.pick(INCREMENTAL)),
                    Method::QOnPixels => {
                        let run = StreamQRun { actions, episode: EPISODE, features: field.video.nrows() + 1 };
                        Ok(points(actions, &field.stream_q(&run, |x| with_one(&x))?))
                    }
                    Method::QOnSlowFeatures => {
                        let training = Training::new(&lab, most, most_vectors(most), features - 1);
                        let model = train(&lab, &training, bench)?.model;
                        let run = StreamQRun { actions, episode: EPISODE, features: model.features() };
                        Ok(points(actions, &field.stream_q(&run, |x| slow_of(&model, &x))?))
                    }
                    Method::Random => Ok(points(&[0], &[field.random()?])),
                    Method::Reference => {
                        let reference = field.qualities(|task| Ok(field.trials.reference[task].clone()))?;
                        Ok(points(&[0], &[reference]))
                    }
                    Method::Optimal => Ok(vec![Point { actions: 0, frames: 0, success: 1.0, quality: 1.0 }]),
                }
            })?;
            found.entry(method).or_default().push(points);
        }
    }
    Ok(Results {
        tables: vec![table(&found)],
        notes: vec![
            format!(
                "Means over both goals, {starts} random starts each. The stream sees 5 frames an action and pursues goals from two \
                 fifths of its run on; the others see one frame an action. All have our reflexes but the batch pipeline, the \
                 reference policy and random actions."
            ),
            format!(
                "Batch: {features} features, one support vector for {FRAMES_PER_VECTOR} frames, at most {MOST_VECTORS}. Stream-Q(λ): \
                 an episode ends at the goal or after {EPISODE} actions, and the next begins at a random pose, which helps it; its \
                 slow features were learned from the whole walk beforehand."
            ),
            "The thesis has none of this over time: its batch pipeline had 35 128 frames.".into(),
        ],
        plots: plots(&found, most)?,
    })
}

/// Support vectors of the batch pipeline.
fn most_vectors(actions: usize) -> usize {
    (actions / FRAMES_PER_VECTOR).min(MOST_VECTORS)
}

fn points(actions: &[usize], qualities: &[Vec<Quality>]) -> Vec<Point> {
    actions.iter().zip(qualities).map(|(&actions, qualities)| Point::new(actions, qualities)).collect()
}

/// Slow features of one scaled observation.
fn slow_of(model: &SlowModel<f32>, x: &Mat<f64>) -> Mat<f64> {
    let grey = Mat::from_fn(x.nrows(), 1, |i, _| (128.0 * x[(i, 0)]) as f32);
    model.apply(grey.as_ref(), Par::Seq).expect("observations are as long as support vectors")
}

/// The points of a method, over seeds: seeds are tried at the same moments.
fn over_seeds(seeds: &[Vec<Point>], of: impl Fn(&Point) -> f64) -> Vec<(usize, usize, Option<Band>)> {
    let Some(first) = seeds.first() else { return Vec::new() };
    let at = |(i, point): (usize, &Point)| {
        let values: Vec<f64> = seeds.iter().filter_map(|points| points.get(i)).map(&of).collect();
        (point.actions, point.frames, Band::of(&values))
    };
    first.iter().enumerate().map(at).collect()
}

fn table(found: &Found) -> Table {
    let mut table = Table::new("Policies by what was seen");
    for (&method, seeds) in found {
        let (success, quality) = (over_seeds(seeds, |point| point.success), over_seeds(seeds, |point| point.quality));
        for ((actions, frames, success), (_, _, quality)) in success.into_iter().zip(quality) {
            let seen = |count: usize| if count > 1 { Cell::count(count) } else { Cell::Empty };
            table.push(
                [
                    ("method", Cell::text(method.name())),
                    ("actions", seen(actions)),
                    ("frames", seen(frames)),
                    ("success", Cell::band(success, 3)),
                    ("quality", Cell::band(quality, 3)),
                ],
                if method == Method::Batch { "no number for so few frames" } else { "not in the thesis" },
            );
        }
    }
    table
}

fn plots(found: &Found, most: usize) -> Result<Vec<(String, String)>, ExperimentError> {
    let lines = |of: fn(&Point) -> f64| -> Vec<Line> {
        let line = |(colour, (&method, seeds)): (usize, (&Method, &Vec<Vec<Point>>))| {
            let points = over_seeds(seeds, of);
            match points.as_slice() {
                // What does not learn is a level.
                [(0, _, Some(band))] => Line::level(method.name(), colour, (0.0, most as f64), band.mean),
                _ => Line::new(method.name(), colour, points.iter().map(|(actions, _, band)| (*actions as f64, *band))),
            }
        };
        found.iter().enumerate().map(line).collect()
    };
    let x = Axis::new("actions");
    let y = |name: &str| Axis::new(name).within(0.0, 1.0);
    let (success, quality) = (y("share of starts that arrive"), y("quality C against the optimum"));
    Ok(vec![
        chart("success.svg", "Success by actions seen", (&x, &success), &lines(|p| p.success))?,
        chart("quality.svg", "Convergence quality by actions seen", (&x, &quality), &lines(|p| p.quality))?,
    ])
}
