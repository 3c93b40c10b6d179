//! `online`: how good policies are by what was seen, for our stream and for what it is to be compared with.
//!
//! All learn from the camera of the same room and are tried from the same starts; success and quality are means over the two
//! goals. The batch pipeline, IncSFA and the true pose learn from one random walk, of which they are shown more and more;
//! the stream explores and pursues goals; Stream-Q(λ) acts on its own values, once for each goal.

use std::collections::BTreeMap;
use std::sync::Arc;

use faer::{Mat, Par};
use nalgebra::Point2;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::lab::{Data, Lab, Walked, points};
use super::plot::{Line, Scale, chart};
use super::quality::{Quality, reference_trips};
use super::trained::{Iteration, Sampled, Training, train, trips};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::agent::{self, RunOptions, Status};
use crate::evaluate::{Evaluator, Situation, Trip, draw_pose};
use crate::log::{Folder, LogOptions, Rotation, RunLog};
use crate::policy::Reflexes;
use crate::random::stream;
use crate::slow::SlowModel;
use crate::slow::coherence::incremental::{IncrementalSlow, Options as IncrementalOptions};
use crate::source::Simulated;
use crate::value::{Fit, StreamQ, StreamQOptions};
use crate::vision::{Observation, Observer};
use crate::world::{Action, Image, Pose, Robot, Sensor, in_goal};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "online",
    line: "success by frames seen: our stream, the batch pipeline, IncSFA, Stream-Q(λ), true pose, random, optimal",
    lasts: Sizes { full: "about half an hour", quick: "8 min", smoke: "seconds" },
    run,
};

/// Actions after which policies are tried.
const ACTIONS: Sizes<&[usize]> =
    Sizes { full: &[1000, 2000, 4000, 8000, 15_000], quick: &[1000, 2000, 4000], smoke: &[150, 300] };
/// Features, the constant included, and random starts for each goal.
const FEATURES: Sizes<(usize, usize)> = Sizes { full: (128, 200), quick: (128, 100), smoke: (16, 10) };
/// Features of the true pose: within the thesis's working regime, see `pose-lspi`.
const POSE_FEATURES: usize = 70;
/// One support vector of the batch pipeline for so many frames (the thesis had 4.4), at most [`MOST_VECTORS`].
const FRAMES_PER_VECTOR: usize = 4;
const MOST_VECTORS: usize = 2000;
/// Features of IncSFA, and the principal components that they are made of.
const INCREMENTAL: Sizes<(usize, usize)> = Sizes { full: (64, 100), quick: (64, 100), smoke: (8, 12) };
/// Stream-Q(λ): probability of a random action, at first and from the middle of the run on; actions of an episode at most.
const EPSILON: (f64, f64) = (1.0, 0.1);
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
    const ALL: [Method; 9] = [
        Method::Stream,
        Method::Batch,
        Method::Incremental,
        Method::QOnPixels,
        Method::QOnSlowFeatures,
        Method::TruePose,
        Method::Random,
        Method::Reference,
        Method::Optimal,
    ];

    fn name(self) -> &'static str {
        match self {
            Method::Stream => "our stream",
            Method::Batch => "the thesis's batch pipeline",
            Method::Incremental => "IncSFA on pixels, our LSPI",
            Method::QOnPixels => "Stream-Q(λ) on pixels",
            Method::QOnSlowFeatures => "Stream-Q(λ) on slow features",
            Method::TruePose => "true pose, our LSPI",
            Method::Random => "random actions",
            Method::Reference => "reference policy",
            Method::Optimal => "optimum",
        }
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

/// How good a policy is after some actions, mean over tasks.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Point {
    /// Actions that were executed.
    pub actions: usize,
    /// Frames that were seen.
    pub frames: usize,
    /// Share of starts that arrive.
    pub success: f64,
    /// Convergence quality against the optimum.
    pub quality: f64,
}

/// The lab of a seed, its walk, and the trials.
struct Field<'a> {
    lab: &'a Lab,
    walked: Walked,
    video: Mat<f32>,
    evaluator: Evaluator,
    reference: Vec<Vec<Trip>>,
    bench: &'a Bench<'a>,
}

fn field<'a>(lab: &'a Lab, settings: &Settings, bench: &'a Bench<'a>) -> Result<Field<'a>, ExperimentError> {
    let most = settings.actions.iter().copied().max().unwrap_or(1);
    let walked = lab.walk(most);
    let video = lab.video(&walked.poses, bench)?;
    let evaluator = Evaluator::new(lab.scenario.clone(), lab.world.clone(), settings.starts, lab.scenario.seed);
    let reference = (0..lab.scenario.tasks.len()).map(|task| reference_trips(lab, &evaluator, task)).collect();
    Ok(Field { lab, walked, video, evaluator, reference, bench })
}

impl Field<'_> {
    /// How good the trips of all tasks are.
    fn point(
        &self,
        actions: usize,
        mut trips_of: impl FnMut(usize) -> Result<Vec<Trip>, ExperimentError>,
    ) -> Result<Point, ExperimentError> {
        let tasks = self.lab.scenario.tasks.len();
        let mut point = Point { actions, frames: actions + 1, success: 0.0, quality: 0.0 };
        for task in 0..tasks {
            self.bench.go_on()?;
            let quality = Quality::of(&trips_of(task)?, &self.reference[task], self.lab.scenario.value.gamma);
            point.success += quality.success / tasks as f64;
            point.quality += quality.quality / tasks as f64;
        }
        Ok(point)
    }

    /// Trips of the greedy policy over features of what is seen, with our reflexes.
    fn greedy_trips(
        &self,
        task: usize,
        camera: bool,
        weights: &Mat<f64>,
        features: impl Fn(&Situation<'_>) -> Mat<f64> + Sync,
    ) -> Vec<Trip> {
        let reflexes = Reflexes::new(&self.lab.scenario.policy);
        self.evaluator.trips(task, camera, &|situation| {
            let q = weights.transpose() * features(situation);
            reflexes.best([q[(0, 0)], q[(1, 0)], q[(2, 0)]], situation.recent).0
        })
    }

    /// The first part of the walk.
    fn part(&self, actions: usize) -> Walked {
        Walked {
            poses: self.walked.poses[..=actions].to_vec(),
            actions: self.walked.actions[..actions].to_vec(),
            blocked: self.walked.blocked[..actions].to_vec(),
        }
    }

    fn batch(&self, actions: usize, features: usize) -> Result<Point, ExperimentError> {
        let vectors = (actions / FRAMES_PER_VECTOR).min(MOST_VECTORS);
        let training = Training::new(self.lab, actions, vectors, features - 1);
        let trained = train(self.lab, &training, self.bench)?;
        let sampled = Sampled::new(&trained, actions, Iteration::Thesis, self.bench)?;
        self.point(actions, |task| {
            let fit = sampled.fit(features, task, Iteration::Thesis)?;
            trips(&trained.model, &fit, (&self.evaluator, task), Reflexes::OFF)
        })
    }

    fn true_pose(&self, actions: usize) -> Result<Point, ExperimentError> {
        let part = self.part(actions);
        let theory = self.lab.optimal_responses(&part, self.lab.thesis_weight(&part), POSE_FEATURES - 1)?;
        let features = |poses: &[Pose]| {
            let waves = theory.evaluate(points(poses).as_ref()).expect("the robot is near the room");
            Mat::from_fn(POSE_FEATURES, poses.len(), |i, j| if i == 0 { 1.0 } else { waves[(i - 1, j)] })
        };
        let phi = features(&part.poses);
        let sampled = Sampled::whole(self.lab, &part, &phi);
        self.point(actions, |task| {
            let Fit { weights, .. } = sampled.fit(POSE_FEATURES, task, Iteration::Ours)?;
            Ok(self.greedy_trips(task, false, &weights, |situation| features(&[*situation.pose])))
        })
    }

    /// IncSFA sees the walk once; policies are made on its features of each of these moments.
    fn incremental(&self, actions: &[usize], (k, whitened): (usize, usize)) -> Result<Vec<Point>, ExperimentError> {
        let links = self.lab.links(&self.walked, self.lab.thesis_weight(&self.walked));
        let mut rng = stream(self.lab.scenario.seed, "incremental features");
        let options = IncrementalOptions::new(k, whitened);
        let mut learner = IncrementalSlow::new(self.video.nrows(), options, &mut rng)?;
        let (mut points, mut seen) = (Vec::new(), 0);
        for &count in actions {
            while seen <= count {
                if seen.is_multiple_of(200) {
                    self.bench.go_on()?;
                }
                let frame: Vec<f64> = self.video.col(seen).iter().map(|&value| scaled(value)).collect();
                learner.update(&frame, links[seen])?;
                seen += 1;
            }
            let map = learner.map();
            let of = |x: Mat<f64>| {
                let phi = map.apply(x.as_ref()).expect("frames are as long as those that were learned from");
                Mat::from_fn(k + 1, phi.ncols(), |i, j| if i == 0 { 1.0 } else { phi[(i - 1, j)] })
            };
            let part = self.part(count);
            let phi = of(Mat::from_fn(self.video.nrows(), count + 1, |i, j| scaled(self.video[(i, j)])));
            let sampled = Sampled::whole(self.lab, &part, &phi);
            points.push(self.point(count, |task| {
                let Fit { weights, .. } = sampled.fit(k + 1, task, Iteration::Ours)?;
                Ok(self.greedy_trips(task, true, &weights, |situation| of(pixels(situation))))
            })?);
        }
        Ok(points)
    }

    /// Stream-Q(λ) drives by itself, from a new random start whenever a goal was reached or an episode is over.
    fn stream_q(
        &self,
        actions: &[usize],
        f: usize,
        features: impl Fn(Mat<f64>) -> Mat<f64> + Sync,
    ) -> Result<Vec<Point>, ExperimentError> {
        let scenario = &self.lab.scenario;
        let most = actions.iter().copied().max().unwrap_or(1);
        let cells: Vec<Point2<f64>> = self.lab.world.plan.reachable_cells().collect();
        // Of each task, the weights at each of the moments.
        let mut weights: Vec<Vec<Mat<f64>>> = Vec::new();
        for (number, task) in scenario.tasks.iter().enumerate() {
            let named = |what: &str| stream(scenario.seed, &format!("stream-q: {what} of {}", task.name));
            let (mut explore, mut starts) = (named("choices"), named("starts"));
            let mut sensor = Sensor::new(scenario, scenario.robot.frame_seconds(), named("camera"));
            let mut values = StreamQ::new(f, 3, StreamQOptions { gamma: scenario.value.gamma, ..Default::default() })?;
            let (mut image, mut observer) = (Image::default(), Observer::default());
            let mut look = |pose: &Pose| -> Vec<f64> {
                self.lab.world.camera.render_into(pose, &mut image);
                sensor.expose(&mut image);
                let mut seen = Observation { frame: 0, pixels: Vec::new() };
                observer.observe(&image, &scenario.vision, &mut seen.pixels);
                features(of_observation(&seen)).col(0).iter().copied().collect()
            };
            let mut begin = || {
                let pose = draw_pose(&self.lab.world.plan, &cells, &mut starts, |place| in_goal(task, place));
                let noise = stream(scenario.seed, &format!("stream-q: motion {}", starts.random::<u64>()));
                Robot::new(&scenario.robot, pose, noise)
            };
            let mut robot = begin();
            let mut phi = look(&robot.pose);
            let (mut left, mut taken) = (EPISODE, Vec::new());
            for done in 1..=most {
                if done.is_multiple_of(100) {
                    self.bench.go_on()?;
                }
                let share = (2.0 * done as f64 / most as f64).min(1.0);
                let epsilon = EPSILON.0 + (EPSILON.1 - EPSILON.0) * share;
                let action = values.choose(&phi, epsilon, &mut explore)?;
                let motion = robot.draw(Action::ALL[action]);
                robot.drive(motion, &self.lab.world.arena);
                let reward = self.lab.world.reward(task, robot.pose.position);
                let next = look(&robot.pose);
                let arrived = in_goal(task, robot.pose.position);
                values.learn(&phi, action, reward, (!arrived).then_some(next.as_slice()))?;
                left -= 1;
                phi = next;
                if arrived || left == 0 {
                    values.interrupt();
                    robot = begin();
                    phi = look(&robot.pose);
                    left = EPISODE;
                }
                if actions.contains(&done) {
                    taken.push(values.weights().to_owned());
                }
            }
            debug_assert_eq!(weights.len(), number);
            weights.push(taken);
        }
        let point = |(moment, &count): (usize, &usize)| {
            self.point(count, |task| {
                let weights = &weights[task][moment];
                Ok(self.greedy_trips(task, true, weights, |situation| features(pixels(situation))))
            })
        };
        actions.iter().enumerate().map(point).collect()
    }

    /// Actions that have nothing to do with what is seen.
    fn random(&self) -> Result<Point, ExperimentError> {
        let seed = self.lab.scenario.seed;
        self.point(0, |task| {
            Ok(self.evaluator.trips(task, false, &|Situation { pose, .. }| {
                // A choice of its own for each pose: no pose comes twice.
                let name = format!("random action at {:?}", (pose.position.x.to_bits(), pose.heading.to_bits()));
                Action::ALL[stream(seed, &name).random_range(0..3)]
            }))
        })
    }
}

/// Grey levels as numbers of about 1.
fn scaled(value: f32) -> f64 {
    f64::from(value) / 128.0
}

fn of_observation(seen: &Observation) -> Mat<f64> {
    let values: Vec<f64> = seen.values().map(scaled).collect();
    Mat::from_fn(values.len(), 1, |i, _| values[i])
}

/// What is seen in a trial with a camera, `d × 1`.
fn pixels(situation: &Situation<'_>) -> Mat<f64> {
    situation.seen.map_or(Mat::zeros(0, 1), of_observation)
}

/// Our agent: one run, tried with each of its models.
fn our_stream(settings: &Settings, seed: u64, bench: &Bench<'_>) -> Result<Vec<Point>, ExperimentError> {
    let most = settings.actions.iter().copied().max().unwrap_or(1);
    let scenario = stream_scenario(seed, most, settings)?;
    let world = Arc::new(crate::world::World::new(&scenario)?);
    let evaluator = Evaluator::new(scenario.clone(), world.clone(), settings.starts, seed);
    let work = bench.scope.cache.join(format!("work-{}", std::process::id()));
    std::fs::create_dir(&work).map_err(ExperimentError::file("create the folder", &work))?;
    let ran = (|| {
        let (options, rotation) = (LogOptions::default(), Rotation::NEVER);
        let log = RunLog::create(Folder::new(&work), &options, rotation, &BTreeMap::new())
            .map_err(|error| ExperimentError::Run(error.to_string()))?;
        let status = Status::default();
        let mut source = Simulated::new(scenario.clone(), world.clone());
        let options = RunOptions {
            stop: bench.stop(),
            status: &status,
            checkpoint: None,
            evaluator: Some(&evaluator),
            recording: None,
            most_actions: None,
            keep: None,
            state: None,
            curve: Vec::new(),
        };
        agent::run(&scenario, &mut source, log, options).map_err(|error| ExperimentError::Run(error.to_string()))
    })();
    // The log was only needed to run at all.
    std::fs::remove_dir_all(&work).map_err(ExperimentError::file("remove", &work))?;
    bench.go_on()?;
    let point = |point: agent::CurvePoint| Point {
        actions: point.actions as usize,
        frames: point.frames as usize,
        success: point.success,
        quality: point.convergence_quality,
    };
    Ok(ran?.curve.into_iter().map(point).collect())
}

/// The lab as the agent drives in it, for so many actions.
fn stream_scenario(
    seed: u64,
    actions: usize,
    settings: &Settings,
) -> Result<Arc<crate::scenario::Scenario>, ExperimentError> {
    let mut sets = vec![
        format!("actions={actions}"),
        "camera.detail=vision".into(),
        "robot.frames_per_action=5".into(),
        format!("evaluate.starts={}", settings.starts),
    ];
    if actions < 1000 {
        // The smallest version: models soon, and small.
        let small = [
            "dictionary.sigma_frames=200",
            "dictionary.budget=200",
            "slow.features=40",
            "policy.explore_actions=100",
            "agent.resolve_frames=500",
            "agent.latency_frames=200",
            "evaluate.max_steps=30",
        ];
        sets.extend(small.map(str::to_owned));
    } else {
        sets.push(format!("policy.explore_actions={}", actions * 2 / 5));
    }
    let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
    Ok(Lab::new(seed, &sets)?.scenario)
}

/// By method, the points of each seed.
type Found = BTreeMap<Method, Vec<Vec<Point>>>;

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let actions = scope.pick(ACTIONS);
    let (features, starts) = scope.pick(FEATURES);
    let most = actions.iter().copied().max().unwrap_or(1);
    bench.plan(scope.seeds.clone().count() * Method::ALL.len());
    let mut found = Found::new();
    for seed in scope.seeds.clone() {
        let lab = Lab::new(seed, &[])?;
        let shared = Once::default();
        for method in Method::ALL {
            let data = Data::new(&lab, most);
            let settings = Settings { data, method, actions: actions.to_vec(), features, starts };
            let points = bench.result(&format!("{}, seed {seed}", method.name()), &settings, || {
                if method == Method::Stream {
                    return our_stream(&settings, seed, bench);
                }
                let field: &Field<'_> = shared.get(|| field(&lab, &settings, bench))?;
                match method {
                    Method::Stream => our_stream(&settings, seed, bench),
                    Method::Batch => actions.iter().map(|&count| field.batch(count, features)).collect(),
                    Method::TruePose => actions.iter().map(|&count| field.true_pose(count)).collect(),
                    Method::Incremental => field.incremental(actions, scope.pick(INCREMENTAL)),
                    Method::QOnPixels => {
                        let f = field.video.nrows() + 1;
                        let with_one =
                            |x: Mat<f64>| Mat::from_fn(f, 1, |i, _| if i == 0 { 1.0 } else { x[(i - 1, 0)] });
                        field.stream_q(actions, f, with_one)
                    }
                    Method::QOnSlowFeatures => {
                        let vectors = (most / FRAMES_PER_VECTOR).min(MOST_VECTORS);
                        let training = Training::new(&lab, most, vectors, features - 1);
                        let model = train(&lab, &training, bench)?.model;
                        field.stream_q(actions, model.features(), |x| slow_of(&model, &x))
                    }
                    Method::Random => Ok(vec![field.random()?]),
                    Method::Reference => Ok(vec![field.point(0, |task| Ok(field.reference[task].clone()))?]),
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
    let mut table = Table::new("Policies by what was seen", &["method", "actions", "frames", "success", "quality"]);
    for (&method, seeds) in found {
        let (success, quality) = (over_seeds(seeds, |point| point.success), over_seeds(seeds, |point| point.quality));
        for ((actions, frames, success), (_, _, quality)) in success.into_iter().zip(quality) {
            let seen = |count: usize| if count > 1 { Cell::count(count) } else { Cell::Empty };
            table.push(
                vec![
                    Cell::text(method.name()),
                    seen(actions),
                    seen(frames),
                    Cell::band(success, 3),
                    Cell::band(quality, 3),
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
    let x = Scale::new("actions");
    let y = |name: &str| Scale::new(name).within(0.0, 1.0);
    Ok(vec![
        (
            "success.svg".into(),
            chart("Success by actions seen", (&x, &y("share of starts that arrive")), &lines(|p| p.success))?,
        ),
        (
            "quality.svg".into(),
            chart(
                "Convergence quality by actions seen",
                (&x, &y("convergence quality C, against the optimum")),
                &lines(|p| p.quality),
            )?,
        ),
    ])
}
