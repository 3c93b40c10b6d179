//! `slam`: appearance-based pose-graph SLAM with a planner on its map, beside slow features with local values, from the same walks
//! (the comparison that thesis §1 and §6 ask for).
//!
//! The baseline is a classical one: [`chart`] makes a map out of odometry and closures, Monte Carlo localisation ([`PlaceMap`]) finds the
//! robot on it by the same small images from no knowledge of the place, and values are planned on a lattice of its poses
//! ([`Planner`]). Where goals are, both methods learn from the rewards of the walk.

pub mod chart;

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};

use self::chart::{Chart, Closure, alignment, rms, thumbnail};
use super::lab::{Data, Lab, Walked};
use super::plot::{Line, chart as lines_chart};
use super::quality::{Quality, Trials};
use super::trained::{Trained, learned};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table, local, planned};
use crate::evaluate::{Situation, decode_pose};
use crate::policy::Reflexes;
use crate::report::draw::{Axis, INK, Mark, Panel, Panels, SERIES};
use crate::robot::{ActionValues, Pose};
use crate::scenario::plan_segments;
use crate::value::place::{Belief, MotionNoise, PlaceMap, Planner};
use crate::value::{Fit, ValueError};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "slam",
    line: "pose-graph SLAM, localisation and a planner on its map, beside slow features and local values, from the same walks",
    lasts: Sizes { full: "2 min", quick: "half a minute", smoke: "seconds" },
    run,
};

/// Actions of the walk, and of the walk on in the changed world; support vectors.
const TRAINING: Sizes<(usize, usize)> = Sizes { full: (8000, 1000), quick: (3000, 500), smoke: (300, 60) };
/// Random starts for each goal.
const STARTS: Sizes<usize> = Sizes { full: 200, quick: 100, smoke: 6 };
/// The place of the lab among the worlds; the wall that is papered anew, as in scenarios/soak/repaper.toml.
const LAB: usize = 0;
const WALL: usize = 1;
/// A closure between poses that are further from each other, metres and degrees, is wrong.
const WRONG: (f64, f64) = (0.4, 30.0);
/// Keyframes that are drawn.
const DRAWN: usize = 400;

/// What learns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    Slam,
    DeadReckoning,
    Adagio,
    TruePose,
    /// SLAM that forgets where it was before each image, as slow features do without places.
    SlamByImage,
}

impl Method {
    /// All of them, with their names.
    const ALL: [(Method, &str); 5] = [
        (Method::Slam, "SLAM and planner"),
        (Method::DeadReckoning, "the same without closures"),
        (Method::Adagio, "slow features, local values"),
        (Method::TruePose, "true pose and planner"),
        (Method::SlamByImage, "SLAM that judges each image alone"),
    ];
}

/// When policies are tried: in the world that was learned, with one wall papered anew, and learned on there.
const PHASES: [&str; 3] = ["as learned", "wall papered anew", "learned on there"];

#[derive(Serialize)]
struct Settings {
    data: Data,
    vectors: usize,
    starts: usize,
    method: Method,
    wall: usize,
}

/// What a method has learned from a walk.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Learning {
    /// Without rendering.
    seconds: f64,
    /// Root mean square errors of the poses of the map, or of those that are read off the features: metres, degrees.
    error: Option<(f64, f64)>,
    /// How many, and how many of them are wrong.
    closures: Option<(usize, usize)>,
    /// Some keyframes: the true place and that of the map, metres.
    places: Vec<[f64; 4]>,
}

/// How a policy drives.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Driven {
    /// Of each task.
    with_reflexes: Vec<Quality>,
    without: Vec<Quality>,
    /// Median distance of where the robot believes to be from where it is, metres.
    astray: Option<f64>,
    /// For a decision, from the observation on.
    milliseconds: f64,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
struct Outcome {
    /// From the first half of the walk, and from all of it.
    learned: [Learning; 2],
    /// By phase.
    driven: Vec<Driven>,
}

/// The worlds of a seed, its walk through both of them, and the trials.
struct Ground<'a> {
    labs: &'a [Lab; 2],
    walked: Walked,
    frames: Mat<f32>,
    trials: [Trials<'a>; 2],
}

impl<'a> Ground<'a> {
    fn new(labs: &'a [Lab; 2], actions: usize, starts: usize, bench: &Bench<'_>) -> Result<Self, ExperimentError> {
        // The walk does not see: it is the same in both worlds.
        let walked = labs[0].walk(2 * actions);
        let (before, after) = walked.poses.split_at(actions + 1);
        let [before, after] = [labs[0].video(before, bench)?, labs[1].video(after, bench)?];
        let n = before.ncols();
        let of = |i: usize, j: usize| if j < n { before[(i, j)] } else { after[(i, j - n)] };
        let frames = Mat::from_fn(before.nrows(), walked.poses.len(), of);
        Ok(Ground { labs, walked, frames, trials: [Trials::new(&labs[0], starts), Trials::new(&labs[1], starts)] })
    }
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let ((actions, vectors), starts) = (scope.pick(TRAINING), scope.pick(STARTS));
    let vectors = scope.vectors_or(vectors);
    bench.plan(scope.seeds.len() * Method::ALL.len());
    let mut found: Vec<Vec<Outcome>> = vec![Vec::new(); Method::ALL.len()];
    let sets = |seed: u64| [format!("world.texture_seed={seed}")];
    for &seed in scope.seeds.iter() {
        let labs = [Lab::world(LAB, seed, &sets(seed))?, Lab::repapered(LAB, seed, WALL, &sets(seed))?];
        let ground = Once::default();
        for ((method, name), outcomes) in Method::ALL.into_iter().zip(&mut found) {
            let settings = Settings { data: Data::new(&labs[0], actions), vectors, starts, method, wall: WALL };
            outcomes.push(bench.result(&format!("{name}, seed {seed}"), &settings, || {
                let ground = ground.get(|| Ground::new(&labs, actions, starts, bench))?;
                let (first, mut driven) = tried(method, ground, (actions, &[0, 1]), vectors, bench)?;
                let (second, on) = tried(method, ground, (2 * actions, &[1]), vectors, bench)?;
                driven.extend(on);
                Ok(Outcome { learned: [first, second], driven })
            })?);
        }
    }
    let lab = Lab::world(LAB, scope.seeds[0], &sets(scope.seeds[0]))?;
    Ok(Results {
        tables: vec![maps(&found), ways(&found), needs()],
        notes: vec![
            format!(
                "A random walk of {actions} actions through scenarios/lab.toml, with patterns of its own for each seed, and as many with wall {WALL} \
                 papered anew; {starts} random starts for each goal, from which SLAM does not know where it is. Success and quality are means over the \
                 goals. Slow features: {vectors} support vectors were aimed at, and the search for the kernel width is in their seconds."
            ),
            format!(
                "Odometry is the wheels', with an error of {} % of each motion; while a policy is tried, localisation knows it, too. Poses of \
                 SLAM: after the best rigid alignment; of slow features: kernel ridge regression from features of other poses.",
                100.0 * lab.scenario.robot.odometry_noise
            ),
        ],
        plots: plots(&lab, &found)?,
    })
}

/// Learn from the first actions of the walk, and drive in some of the worlds.
fn tried(
    method: Method,
    ground: &Ground<'_>,
    (actions, worlds): (usize, &[usize]),
    vectors: usize,
    bench: &Bench<'_>,
) -> Result<(Learning, Vec<Driven>), ExperimentError> {
    let lab = &ground.labs[worlds[0]];
    let walked = ground.walked.first(actions);
    let frames = ground.frames.subcols(0, actions + 1);
    let begin = Instant::now();
    if method == Method::Adagio {
        let features = lab.scenario.slow.features.min(vectors);
        let model =
            learned(frames, &lab.links(&walked, lab.thesis_weight(&walked.steps())), (vectors, features), bench)?;
        let trained = Trained { lab, walked: walked.into(), frames: frames.to_owned().into(), model };
        let rule = local::Rule { ridge: lab.scenario.value.local_ridge, walls: true, bounded: true };
        let learned = local::of_features(&trained, trained.walked.spread(actions), rule, bench)?;
        let seconds = begin.elapsed().as_secs_f64();
        let error = decode_pose(&lab.scenario, &lab.world, &learned, lab.scenario.seed)?.kernel;
        let error = Some((error.position_rmse_m, error.heading_rmse_deg));
        let decide = |situation: &Situation<'_>, task: usize| {
            situation.seen.map_or(ActionValues::new([]), |seen| learned.q_values(seen, task)).to_vec()
        };
        let driven = worlds.iter().map(|&world| drive(&ground.trials[world], true, &decide, bench));
        return Ok((Learning { seconds, error, ..Learning::default() }, driven.collect::<Result<_, _>>()?));
    }
    let (chart, map) = match method {
        Method::TruePose => (Chart { poses: walked.poses.clone(), closures: Vec::new() }, None),
        _ => charted(method, lab, &walked, frames, bench)?,
    };
    let steps = planned::steps(lab, &walked, &chart.poses);
    let planner = planned::planner(lab, &steps)?;
    let fits = (0..lab.scenario.tasks.len()).map(|task| planned::fit(lab, &planner, &walked, task));
    let fits = fits.collect::<Result<Vec<Fit>, ExperimentError>>()?;
    let mut learning = Learning { seconds: begin.elapsed().as_secs_f64(), ..Learning::default() };
    let aligned = alignment(&chart.poses, &walked.poses);
    if map.is_some() {
        learning.describe(&chart, &walked.poses, &aligned);
    }
    let forgets = method == Method::SlamByImage;
    let located = Located { lab, map: map.as_ref(), planner: (&planner, &fits), aligned, forgets };
    let driven = worlds.iter().map(|&world| located.drive(&ground.trials[world], bench));
    Ok((learning, driven.collect::<Result<_, _>>()?))
}

/// The map of a walk, and what localises on it.
fn charted(
    method: Method,
    lab: &Lab,
    walked: &Walked,
    frames: MatRef<'_, f32>,
    bench: &Bench<'_>,
) -> Result<(Chart, Option<PlaceMap>), ExperimentError> {
    let thumbnails: Vec<Vec<f32>> =
        (0..frames.ncols()).map(|j| thumbnail(frames.col(j).iter().copied(), &lab.scenario.vision)).collect();
    let thumbnails = Mat::from_fn(thumbnails[0].len(), thumbnails.len(), |i, j| thumbnails[j][i]);
    let noise = lab.scenario.robot.odometry_noise;
    let chart = match method {
        Method::DeadReckoning => Chart::reckoned(&walked.odometry),
        _ => Chart::new(thumbnails.as_ref(), &walked.odometry, noise, bench.scope.par)?,
    };
    bench.say(&format!("{} closures of {} keyframes", chart.closures.len(), chart.poses.len()));
    let places: Vec<_> = chart.poses.iter().map(|pose| planned::place(lab, pose)).collect();
    let map = PlaceMap::placed(thumbnails, &places, MotionNoise::ROBOT, lab.scenario.robot.forward)?;
    Ok((chart, Some(map.ok_or(ValueError::Empty)?)))
}

impl Learning {
    /// How right a map is: errors, wrong closures, some of its keyframes.
    fn describe(&mut self, chart: &Chart, poses: &[Pose], aligned: &Pose) {
        let pairs = || chart.poses.iter().map(|pose| aligned.then(pose)).zip(poses.iter().copied());
        self.error = Some(rms(pairs()));
        let is_wrong = |&&(from, to): &&Closure| {
            let (distance, angle) = rms(std::iter::once((poses[from], poses[to])));
            distance > WRONG.0 || angle > WRONG.1
        };
        self.closures = Some((chart.closures.len(), chart.closures.iter().filter(is_wrong).count()));
        let every = poses.len().div_ceil(DRAWN);
        let place = |(found, at): (Pose, Pose)| [at.position.x, at.position.y, found.position.x, found.position.y];
        self.places = pairs().step_by(every).map(place).collect();
    }
}

/// A planner, and what tells where the robot is: a map, or the truth.
struct Located<'a> {
    lab: &'a Lab,
    map: Option<&'a PlaceMap>,
    planner: (&'a Planner<'a>, &'a [Fit]),
    /// Where the map lies in the room.
    aligned: Pose,
    /// Whether it knows nothing of what was before an image.
    forgets: bool,
}

impl Located<'_> {
    fn drive(&self, trials: &Trials<'_>, bench: &Bench<'_>) -> Result<Driven, ExperimentError> {
        let (astray, unit) = (Mutex::new(Vec::new()), self.lab.scenario.robot.forward);
        let beliefs: Vec<Mutex<Belief>> = trials.reference[0].iter().map(|_| Mutex::default()).collect();
        let decide = |situation: &Situation<'_>, task: usize| {
            let (planner, fits) = self.planner;
            let place = match (self.map, situation.seen) {
                (Some(map), Some(seen)) => {
                    let mut belief = beliefs[situation.trial].lock().expect("no trial panics");
                    let step = situation.step.filter(|_| !self.forgets);
                    if step.is_none() {
                        *belief = Belief::default();
                    }
                    let seen = thumbnail(seen.values(), &self.lab.scenario.vision);
                    map.follow(&mut belief, step, &seen, &[]).expect("images are as large as those of the map");
                    let place = belief.modes(1, 1.0).first().map_or_else(Default::default, |mode| mode.0);
                    let found = self.aligned.then(&Pose::new([unit * place.x, unit * place.y].into(), place.heading));
                    let off = (found.position - situation.pose.position).norm();
                    astray.lock().expect("no trial panics").push(off);
                    place
                }
                _ => planned::place(self.lab, situation.pose),
            };
            planned::values(self.lab, (planner, &fits[task]), place)
        };
        let driven = drive(trials, self.map.is_some(), &decide, bench)?;
        let mut astray = astray.into_inner().expect("no trial panics");
        astray.sort_by(f64::total_cmp);
        Ok(Driven { astray: astray.get(astray.len() / 2).copied(), ..driven })
    }
}

/// Trials by what actions are worth, with and without reflexes.
fn drive(
    trials: &Trials<'_>,
    camera: bool,
    decide: &(dyn Fn(&Situation<'_>, usize) -> Vec<f64> + Sync),
    bench: &Bench<'_>,
) -> Result<Driven, ExperimentError> {
    let (nanoseconds, decisions) = (AtomicU64::new(0), AtomicU64::new(0));
    let qualities = |reflexes: Reflexes| {
        let of_task = |task: usize| {
            bench.go_on()?;
            let choose = |situation: &Situation<'_>| {
                let begin = Instant::now();
                let values = decide(situation, task);
                nanoseconds.fetch_add(begin.elapsed().as_nanos() as u64, Ordering::Relaxed);
                decisions.fetch_add(1, Ordering::Relaxed);
                reflexes.best(&values, situation.recent).0
            };
            Ok(trials.quality(task, &trials.evaluator.trips(task, camera, &choose)))
        };
        (0..trials.lab.scenario.tasks.len()).map(of_task).collect::<Result<Vec<Quality>, ExperimentError>>()
    };
    let reflexes = Reflexes::new(&trials.lab.scenario);
    let (with_reflexes, without) = (qualities(reflexes)?, qualities(reflexes.off())?);
    let milliseconds = 1e-6 * nanoseconds.into_inner() as f64 / decisions.into_inner().max(1) as f64;
    Ok(Driven { with_reflexes, without, astray: None, milliseconds })
}

fn maps(found: &[Vec<Outcome>]) -> Table {
    let mut table = Table::new("Where keyframes lie, and what learning takes");
    for ((_, method), outcomes) in Method::ALL.into_iter().zip(found) {
        for (half, walk) in ["before the change", "all"].into_iter().enumerate() {
            let band = |of: fn(&Learning) -> Option<f64>, digits| {
                Cell::band(Band::of(outcomes.iter().filter_map(|outcome| of(&outcome.learned[half]))), digits)
            };
            let row = [
                ("method", Cell::text(method)),
                ("walk", Cell::text(walk)),
                ("position, m", band(|learning| Some(learning.error?.0), 3)),
                ("heading, °", band(|learning| Some(learning.error?.1), 1)),
                ("closures", band(|learning| Some(learning.closures?.0 as f64), 0)),
                ("wrong closures", band(|learning| Some(learning.closures?.1 as f64), 0)),
                ("seconds to learn", band(|learning| Some(learning.seconds), 1)),
            ];
            table.push(row, "not in the thesis");
        }
    }
    table
}

fn mean(qualities: &[Quality], of: fn(&Quality) -> f64) -> f64 {
    qualities.iter().map(of).sum::<f64>() / qualities.len().max(1) as f64
}

fn ways(found: &[Vec<Outcome>]) -> Table {
    let mut table = Table::new("How policies drive");
    for ((_, method), outcomes) in Method::ALL.into_iter().zip(found) {
        for (phase, name) in PHASES.into_iter().enumerate() {
            let band = |of: fn(&Driven) -> Option<f64>| {
                Cell::band(Band::of(outcomes.iter().filter_map(|outcome| of(&outcome.driven[phase]))), 3)
            };
            let row = [
                ("method", Cell::text(method)),
                ("world", Cell::text(name)),
                ("success", band(|driven| Some(mean(&driven.with_reflexes, |q| q.success)))),
                ("quality", band(|driven| Some(mean(&driven.with_reflexes, |q| q.quality)))),
                ("success without reflexes", band(|driven| Some(mean(&driven.without, |q| q.success)))),
                ("quality without reflexes", band(|driven| Some(mean(&driven.without, |q| q.quality)))),
                ("median error of the place, m", band(|driven| driven.astray)),
                ("ms a decision", band(|driven| Some(driven.milliseconds))),
            ];
            table.push(row, "not in the thesis");
        }
    }
    table
}

/// What a method is given beside images, actions and rewards.
fn needs() -> Table {
    let mut table = Table::new("What each needs");
    for (what, slam, adagio) in [
        ("odometry and its noise", "yes", "no"),
        ("what each action does to the pose, in metres and degrees", "yes", "no"),
        ("how inexactly actions are executed", "yes", "no"),
        ("that the floor is a plane and a pose has three numbers", "yes", "no"),
        ("memory of the way while it drives", "a belief of 500 poses", "none: each image stands alone"),
        ("whether a wall stopped an action", "yes", "yes"),
        ("how much moves weigh against turns", "no", "one number, here by the walk's true speeds"),
        ("can say where it is in metres", "yes", "no; only by regression on known poses"),
    ] {
        let row = [("what", what), ("SLAM and planner", slam), ("slow features, local values", adagio)];
        table.push(row.map(|(column, text)| (column, Cell::text(text))), "not in the thesis");
    }
    table
}

fn plots(lab: &Lab, found: &[Vec<Outcome>]) -> Result<Vec<(String, String)>, ExperimentError> {
    let success = |(number, (_, method)): (usize, (Method, &str))| {
        let of = |phase: usize| {
            let outcomes = found[number].iter();
            let quality = outcomes.map(|outcome| mean(&outcome.driven[phase].with_reflexes, |q| q.quality));
            ((phase + 1) as f64, Band::of(quality))
        };
        Line::new(method, number, (0..PHASES.len()).map(of))
    };
    let lines: Vec<Line> = Method::ALL.into_iter().enumerate().map(success).collect();
    let x = Axis::new("1: as learned, 2: wall papered anew, 3: learned on there");
    let y = Axis::new("convergence quality C").within(0.0, 1.0);
    let quality = lines_chart("quality.svg", "Quality before and after a wall is papered anew", (&x, &y), &lines)?;
    let walls = lab.scenario.world.walls.iter().flat_map(plan_segments);
    let outline = walls.map(|(a, b)| Mark::Line(vec![a.into(), b.into()], INK.into(), 2)).collect();
    let (low, high) = lab.world.plan.walls_box();
    let marks = found[0].first().into_iter().flat_map(|outcome| &outcome.learned[0].places).flat_map(
        |&[x, y, found_x, found_y]| {
            let error = Mark::Line(vec![[x, y], [found_x, found_y]], SERIES[4].into(), 1);
            [error, Mark::Dot([found_x, found_y], 2, SERIES[0].into())]
        },
    );
    let map = Panels {
        outline,
        axes: true,
        key: vec![(SERIES[0], "keyframe on the map".into()), (SERIES[4], "to where it was in truth".into())],
        ..Panels::new("The map of SLAM in the true room", (low.into(), high.into()), vec![Panel::of(marks.collect())])
    };
    Ok(vec![("map.svg".into(), map.svg()?), quality])
}
