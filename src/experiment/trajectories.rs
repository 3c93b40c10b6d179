//! `trajectories`: single ways to both goals (thesis §5.3.4, figure *robotest*).
//!
//! The thesis let its real robot drive 20 test trajectories with 128 slow features; about 80 % arrived. Here the simulated
//! robot drives from 20 random starts to each goal.

use serde::{Deserialize, Serialize};

use super::lab::{FRAMES, Lab, TRANSITIONS};
use super::maps::{Way, rooms};
use super::trained::{Iteration, Sampled, Trained, Training, train, trips};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::evaluate::wilson_low;
use crate::report::draw::{Axis, Chart, DrawError, Line, SERIES, Stroke};
use crate::robot::Pose;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "trajectories",
    line: "single trajectories to both goals, with 128 slow features (figure robotest)",
    lasts: Sizes { full: "6 min", quick: "3 min", smoke: "seconds" },
    run,
};

/// Actions of the walk, transitions out of it, support vectors (the thesis had 7973).
const TRAINING: Sizes<(usize, usize, usize)> =
    Sizes { full: (FRAMES - 1, TRANSITIONS, 8000), quick: (12_000, 6000, 1000), smoke: (600, 400, 60) };
/// Features, the constant included (thesis §5.3.4).
const FEATURES: Sizes<usize> = Sizes { full: 128, quick: 128, smoke: 20 };
/// Trajectories for each goal.
const STARTS: Sizes<usize> = Sizes { full: 20, quick: 20, smoke: 4 };
/// Of how many trajectories how many arrived in the thesis: "about 80 %".
const ARRIVED: (usize, usize) = (16, 20);

/// What may decide how many arrive with the thesis's iteration: the number of features and of transitions, as far as the walk has them; blocked
/// moves among these; and the number of support vectors.
const CONDITIONS: [Condition; 6] = [
    Condition { what: "as above", ..Condition::PLAIN },
    Condition { what: "half as many features", features: 0.5, ..Condition::PLAIN },
    Condition { what: "up to three times as many transitions", transitions: 3, ..Condition::PLAIN },
    Condition { what: "these, and twice as many features", features: 2.0, transitions: 3, ..Condition::PLAIN },
    Condition { what: "blocked moves among the transitions", blocked: true, ..Condition::PLAIN },
    Condition { what: "an eighth of the support vectors", fewer_vectors: 8, ..Condition::PLAIN },
];
/// Starts for each goal under each condition.
const CONDITION_STARTS: Sizes<usize> = Sizes { full: 100, quick: 100, smoke: 4 };

/// What is another than above.
struct Condition {
    what: &'static str,
    features: f64,
    transitions: usize,
    blocked: bool,
    fewer_vectors: usize,
}

impl Condition {
    const PLAIN: Condition = Condition { what: "", features: 1.0, transitions: 1, blocked: false, fewer_vectors: 1 };
}

#[derive(Serialize)]
struct Varied {
    training: Training,
    features: usize,
    transitions: usize,
    blocked: bool,
    starts: usize,
}

/// What came of a goal under a condition.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Arrived {
    /// Whether policy iteration settled.
    pub converged: bool,
    /// Share of the starts from which it arrived.
    pub share: f64,
}

#[derive(Serialize)]
struct Settings {
    training: Training,
    features: usize,
    transitions: usize,
    starts: usize,
    task: String,
    iteration: Iteration,
}

/// A trajectory: coordinates are metres and radians.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Trajectory {
    /// x, y and heading, the start first.
    pub poses: Vec<[f64; 3]>,
    /// Whether it arrived.
    pub arrived: bool,
    /// The optimal number of steps.
    pub optimal: Option<usize>,
}

impl Trajectory {
    fn steps(&self) -> Option<usize> {
        self.arrived.then(|| self.poses.len() - 1)
    }
}

/// The trajectories of one goal and iteration, for one seed.
struct Driven {
    seed: u64,
    task: usize,
    iteration: Iteration,
    trajectories: Vec<Trajectory>,
}

/// What the thesis's iteration comes to under a condition, for each goal.
fn varied(trained: &Trained<'_>, settings: &Varied, bench: &Bench<'_>) -> Result<Vec<Arrived>, ExperimentError> {
    let lab = trained.lab;
    // Of all kinds, or as in the thesis.
    let kind = if settings.blocked { Iteration::Alone } else { Iteration::Thesis };
    let sampled = Sampled::new(trained, settings.transitions, kind, bench)?;
    let evaluator = lab.evaluator(settings.starts);
    let of_goal = |task: usize| {
        bench.go_on()?;
        let fit = sampled.fit(settings.features, task, Iteration::Thesis)?;
        let trips = trips(&trained.model, &fit, (&evaluator, task), Iteration::Thesis.reflexes(lab))?;
        let share = trips.iter().filter(|trip| trip.arrived).count() as f64 / trips.len() as f64;
        Ok(Arrived { converged: fit.converged, share })
    };
    (0..lab.scenario.tasks.len()).map(of_goal).collect()
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let ((actions, transitions, vectors), features) = (scope.pick(TRAINING), scope.pick(FEATURES));
    let (vectors, starts) = (scope.vectors_or(vectors), scope.pick(STARTS));
    let mut driven = Vec::new();
    let first = Lab::new(scope.seeds[0], &[])?;
    bench.plan(scope.seeds.len() * (first.scenario.tasks.len() * Iteration::BOTH.len() + CONDITIONS.len()));
    let mut under = [(); CONDITIONS.len()].map(|()| Vec::new());
    for &seed in scope.seeds.iter() {
        let lab = Lab::new(seed, &[])?;
        // Conditions have up to twice as many features, the first of them the same.
        let training = Training::new(&lab, actions, vectors, 2 * features - 1);
        let (trained, evaluator) = (Once::<Trained<'_>>::default(), Once::default());
        let sampled: [Once<Sampled<'_>>; 3] = Default::default();
        for (task, goal) in lab.scenario.tasks.iter().enumerate() {
            for iteration in Iteration::BOTH {
                let (training, task_name) = (training.clone(), goal.name.clone());
                let settings = Settings { training, features, transitions, starts, task: task_name, iteration };
                let label = format!("{}, {}, seed {seed}", goal.name, iteration.name());
                let trajectories: Vec<Trajectory> = bench.result(&label, &settings, || {
                    let trained = trained.get(|| train(&lab, &settings.training, bench))?;
                    let make = || Sampled::new(trained, transitions, iteration, bench);
                    let sampled = sampled[iteration as usize].get(make)?;
                    let evaluator = evaluator.get(|| Ok::<_, ExperimentError>(lab.evaluator(starts)))?;
                    let fit = sampled.fit(features, task, iteration)?;
                    let trips = trips(&trained.model, &fit, (evaluator, task), iteration.reflexes(&lab))?;
                    let rounded = |value: f64| (1e4 * value).round() / 1e4;
                    let numbers = |pose: &Pose| [pose.position.x, pose.position.y, pose.heading].map(rounded);
                    Ok(trips
                        .into_iter()
                        .map(|trip| Trajectory {
                            poses: trip.poses.iter().map(numbers).collect(),
                            arrived: trip.arrived,
                            optimal: trip.optimal,
                        })
                        .collect())
                })?;
                driven.push(Driven { seed, task, iteration, trajectories });
            }
        }
        for (condition, found) in CONDITIONS.iter().zip(&mut under) {
            let few = condition.fewer_vectors > 1;
            let vectors = (vectors / condition.fewer_vectors).max(20);
            let settings = Varied {
                training: Training::new(&lab, actions, vectors, 2 * features - 1),
                features: (condition.features * features as f64) as usize,
                transitions: transitions * condition.transitions,
                blocked: condition.blocked,
                starts: scope.pick(CONDITION_STARTS),
            };
            found.push(bench.result(&format!("{}, seed {seed}", condition.what), &settings, || {
                if few {
                    return varied(&train(&lab, &settings.training, bench)?, &settings, bench);
                }
                varied(trained.get(|| train(&lab, &settings.training, bench))?, &settings, bench)
            })?);
        }
    }
    Ok(Results {
        tables: vec![summary(&first, &driven), conditions(&first, &under), single(&first, &driven, scope.seeds[0])],
        notes: vec![
            format!(
                "{starts} random starts for each goal, {features} features, {transitions} transitions, about {vectors} support \
                 vectors; a trajectory is given up after {} steps.",
                first.scenario.evaluate.max_steps
            ),
            "Intervals: 95 %, Wilson's, over all trajectories. The thesis's 20 trajectories were driven by a real robot, with people, reflections and other light in the images: \
             that other shares of ours arrive says little about the method."
                .into(),
        ],
        plots: plots(&first, &driven, scope.seeds[0])?,
    })
}

/// The 95 % Wilson interval of a share.
fn interval((arrived, all): (usize, usize)) -> (f64, f64) {
    (wilson_low(arrived, all), 1.0 - wilson_low(all - arrived, all))
}

fn summary(lab: &Lab, driven: &[Driven]) -> Table {
    let robot = interval(ARRIVED);
    let thesis = format!("{} of {} (robot): {:.2} to {:.2}", ARRIVED.0, ARRIVED.1, robot.0, robot.1);
    let mut table = Table::new("Trajectories that arrived");
    for (task, goal) in lab.scenario.tasks.iter().enumerate() {
        for iteration in Iteration::BOTH {
            let of = driven.iter().filter(|driven| (driven.task, driven.iteration) == (task, iteration));
            let (mut share, mut steps, mut optimal, mut longest) = (vec![], vec![], vec![], 0);
            let mut all = (0, 0);
            for driven in of {
                let arrived: Vec<usize> = driven.trajectories.iter().filter_map(Trajectory::steps).collect();
                share.push(arrived.len() as f64 / driven.trajectories.len() as f64);
                all = (all.0 + arrived.len(), all.1 + driven.trajectories.len());
                longest = arrived.iter().copied().chain([longest]).max().unwrap_or(0);
                let best: Vec<usize> = driven.trajectories.iter().filter_map(|trajectory| trajectory.optimal).collect();
                let mean = |values: &[usize]| {
                    (!values.is_empty()).then(|| values.iter().sum::<usize>() as f64 / values.len() as f64)
                };
                steps.extend(mean(&arrived));
                optimal.extend(mean(&best));
            }
            let ours = interval(all);
            let says = match iteration {
                Iteration::Ours => "not in the thesis",
                _ if ours.0 > robot.1 => "differs: more arrive than of the real robot's",
                _ if ours.1 < robot.0 => "differs: fewer arrive",
                _ => "agrees: the intervals overlap",
            };
            let row = [
                ("goal", Cell::text(&goal.name)),
                ("iteration", Cell::text(iteration.name())),
                ("arrived", Cell::band(Band::of(&share), 2)),
                ("interval", Cell::text(format!("{:.2} to {:.2}", ours.0, ours.1))),
                ("steps", Cell::band(Band::of(&steps), 1)),
                ("optimal", Cell::band(Band::of(&optimal), 1)),
                ("longest", Cell::count(longest)),
                ("thesis: arrived", Cell::text(&thesis)),
            ];
            table.push(row, says);
        }
    }
    table
}

/// How many arrive with the thesis's iteration under each condition.
fn conditions(lab: &Lab, under: &[Vec<Vec<Arrived>>]) -> Table {
    let mut table = Table::new("What decides how many arrive with the thesis's LSPI");
    let robot = ARRIVED.0 as f64 / ARRIVED.1 as f64;
    for (condition, seeds) in CONDITIONS.iter().zip(under) {
        let mut row = vec![("condition".into(), Cell::text(condition.what))];
        let mut fewer = 0;
        for (task, goal) in lab.scenario.tasks.iter().enumerate() {
            let arrived = Band::of(seeds.iter().map(|of| of[task].share));
            fewer += usize::from(arrived.is_some_and(|band| band.mean < robot));
            let settled = seeds.iter().filter(|of| of[task].converged).count() as f64 / seeds.len() as f64;
            row.push((format!("{}: arrived", goal.name), Cell::band(arrived, 2)));
            row.push((format!("{}: settled", goal.name), Cell::Number(settled, 2)));
        }
        let says = match fewer {
            0 => "agrees: as many as the robot's, or more".to_owned(),
            some => format!("differs: fewer than the robot's to {some} of {}", lab.scenario.tasks.len()),
        };
        table.push(row, says);
    }
    table
}

fn single(lab: &Lab, driven: &[Driven], seed: u64) -> Table {
    let mut table = Table::new(format!("Steps of each trajectory, seed {seed}"));
    for (task, goal) in lab.scenario.tasks.iter().enumerate() {
        let of = |iteration: Iteration| {
            driven.iter().find(|driven| (driven.seed, driven.task, driven.iteration) == (seed, task, iteration))
        };
        let (Some(thesis), Some(ours)) = (of(Iteration::Thesis), of(Iteration::Ours)) else { continue };
        for (plain, ours) in thesis.trajectories.iter().zip(&ours.trajectories) {
            let Some([x, y, heading]) = plain.poses.first() else { continue };
            let steps = |trajectory: &Trajectory| trajectory.steps().map_or(Cell::text("not arrived"), Cell::count);
            let row = [
                ("goal", Cell::text(&goal.name)),
                ("start x, m", Cell::Number(*x, 2)),
                ("start y, m", Cell::Number(*y, 2)),
                ("heading, °", Cell::Number(heading.to_degrees(), 0)),
                ("optimal", plain.optimal.map_or(Cell::Empty, Cell::count)),
                ("the thesis's LSPI", steps(plain)),
                ("ours", steps(ours)),
            ];
            table.push(row, "no counterpart");
        }
    }
    table
}

fn plots(lab: &Lab, driven: &[Driven], seed: u64) -> Result<Vec<(String, String)>, DrawError> {
    let plot = |iteration: Iteration| {
        let of = driven.iter().filter(|driven| driven.seed == seed && driven.iteration == iteration);
        let sketches = of.map(|driven| {
            let pose = |&[x, y, heading]: &[f64; 3]| Pose::new([x, y].into(), heading);
            let way = |of: &Trajectory| Way { poses: of.poses.iter().map(pose).collect(), steps: of.steps() };
            let ways: Vec<Way> = driven.trajectories.iter().map(way).collect();
            let arrived = ways.iter().filter(|way| way.steps.is_some()).count();
            let task = lab.task(driven.task);
            (task, format!("{}: {arrived} of {} arrive", task.name, ways.len()), ways)
        });
        rooms(&format!("Trajectories, {}", iteration.name()), lab, &sketches.collect::<Vec<_>>())
    };
    let name = |iteration| if iteration == Iteration::Thesis { "thesis.svg" } else { "ours.svg" };
    let ways = Iteration::BOTH.into_iter().map(|iteration| (name(iteration).to_owned(), plot(iteration)));
    let arrived = arrived_within(driven, lab.scenario.evaluate.max_steps)?;
    Ok(ways.chain([("arrived.svg".to_owned(), arrived)]).collect())
}

/// How many of all trajectories have arrived after so many steps, and of the robot's 20 in the end.
fn arrived_within(driven: &[Driven], most: usize) -> Result<String, DrawError> {
    let ours = Iteration::BOTH.into_iter().enumerate().map(|(number, iteration)| {
        let of = || driven.iter().filter(|driven| driven.iteration == iteration).flat_map(|of| &of.trajectories);
        let within =
            |steps: usize| (of().filter_map(Trajectory::steps).filter(|&took| took <= steps).count(), of().count());
        let shares = (0..=most).map(within).collect::<Vec<_>>();
        (iteration.name().to_owned(), SERIES[number], Stroke::Line, shares)
    });
    let robot = ("the thesis's robot, in the end".to_owned(), SERIES[2], Stroke::Dashed, vec![ARRIVED; most + 1]);
    let line = |(name, colour, stroke, shares): (String, _, _, Vec<(usize, usize)>)| {
        let points = shares.iter().zip(0..).map(|(of, steps)| (f64::from(steps), of.0 as f64 / of.1 as f64)).collect();
        let band =
            shares.iter().zip(0..).map(|(&of, steps)| (f64::from(steps), interval(of).0, interval(of).1)).collect();
        Line::new(&name, colour, points).drawn(stroke).with_band(band)
    };
    let share = Axis::new("share, with 95 % interval").within(0.0, 1.02);
    let lines = ours.chain([robot]).map(line).collect();
    Chart::new("Trajectories that have arrived within so many steps", Axis::new("steps"), share, lines).svg()
}
