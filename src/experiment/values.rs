//! `values`: local values beside linear ones, from the same transitions, for goals of different places and sizes.
//!
//! What limits a policy can be the values or the features that they are made of: so the same is done with the true pose in place
//! of slow features. Rewards near walls keep a robot off them and cost steps: so the best values are also tried without.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::lab::Lab;
use super::local::{self, METRES_PER_RADIAN};
use super::plot::{Line, chart};
use super::quality::{Quality, Trials, driven};
use super::trained::{Iteration, Sampled, Trained, Training, train, trips};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::report::draw::Axis;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "values",
    line: "local values against linear ones, over slow features and over the true pose, for five goals",
    lasts: Sizes { full: "7 min", quick: "5 min", smoke: "seconds" },
    run,
};

/// Actions of the walk; support vectors.
const TRAINING: Sizes<(usize, usize)> = Sizes { full: (15_000, 2000), quick: (8000, 1000), smoke: (600, 60) };
/// Transitions, spread over the walk.
const TRANSITIONS: Sizes<&[usize]> =
    Sizes { full: &[1000, 2000, 5000, 15_000], quick: &[1000, 2000, 8000], smoke: &[200, 600] };
/// Slow features.
const FEATURES: Sizes<usize> = Sizes { full: 200, quick: 200, smoke: 20 };
/// Random starts for each goal.
const STARTS: Sizes<usize> = Sizes { full: 400, quick: 200, smoke: 10 };
/// A ridge that leaves no slopes: means.
const NO_SLOPES: f64 = 1e9;

/// Which values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Values {
    /// Linear in all slow features, by policy iteration as the agent does it.
    Linear,
    /// Means of the neighbours in the metric of the slowest features.
    Means,
    /// Regressions on them: the default.
    Local,
    /// Regressions on neighbours in the true pose.
    Pose,
    /// The default without rewards near walls.
    NoWalls,
    /// The default with rewards near walls in full, however little follows.
    Unbounded,
}

impl Values {
    /// All of them in the order of their declaration, with their names.
    const ALL: [(Values, &str); 6] = [
        (Values::Linear, "linear in slow features"),
        (Values::Means, "means of neighbours"),
        (Values::Local, "regressions on neighbours (default)"),
        (Values::Pose, "the same in the true pose"),
        (Values::NoWalls, "the default, walls not to be avoided"),
        (Values::Unbounded, "the default, penalties in full"),
    ];
}

#[derive(Serialize)]
struct Settings {
    training: Training,
    starts: usize,
    transitions: usize,
    values: Values,
    options: (usize, f64, usize),
    metres_per_radian: f64,
}

/// By values and number of transitions, for each seed and task.
type Found = BTreeMap<(Values, usize), Vec<Vec<Quality>>>;

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let ((actions, vectors), features, starts) = (scope.pick(TRAINING), scope.pick(FEATURES), scope.pick(STARTS));
    let vectors = scope.vectors_or(vectors);
    let counts = scope.pick(TRANSITIONS);
    bench.plan(scope.seeds.len() * Values::ALL.len() * counts.len());
    let (mut found, mut goals) = (Found::new(), Vec::new());
    for &seed in scope.seeds.iter() {
        let lab = Lab::goals(seed, &[])?;
        goals = lab.scenario.tasks.iter().map(|task| task.name.clone()).collect();
        let settings = &lab.scenario.value;
        let training = Training::new(&lab, actions, vectors, features);
        let (trained, trials) = (Once::<Trained<'_>>::default(), Once::<Trials<'_>>::default());
        for ((values, name), &count) in Values::ALL.iter().flat_map(|&of| counts.iter().map(move |count| (of, count))) {
            let of_values = Settings {
                training: training.clone(),
                starts,
                transitions: count,
                values,
                options: (settings.neighbours, settings.local_ridge, settings.metric_features),
                metres_per_radian: METRES_PER_RADIAN,
            };
            let qualities: Vec<Quality> =
                bench.result(&format!("{name}, {count} transitions, seed {seed}"), &of_values, || {
                    let trained = trained.get(|| train(&lab, &training, bench))?;
                    let trials = trials.get(|| Ok::<_, ExperimentError>(Trials::new(&lab, starts)))?;
                    tried(trained, trials, (values, count), bench)
                })?;
            found.entry((values, count)).or_default().push(qualities);
        }
    }
    Ok(Results {
        tables: vec![table(&found, &goals)],
        notes: vec![format!(
            "Success of {starts} random starts for each goal of scenarios/goals.toml, and convergence quality against the optimal number \
             of steps, with the thesis's reward near walls (-1 within 0.5 m); transitions are spread over a random walk of {actions} \
             actions, {vectors} support vectors were aimed at."
        )],
        plots: vec![plot(&found)?],
    })
}

/// What the policies of all tasks come to.
fn tried(
    trained: &Trained<'_>,
    trials: &Trials<'_>,
    (values, count): (Values, usize),
    bench: &Bench<'_>,
) -> Result<Vec<Quality>, ExperimentError> {
    let lab = trained.lab;
    let reflexes = Iteration::Ours.reflexes(lab);
    let tasks = 0..lab.scenario.tasks.len();
    if values == Values::Linear {
        let sampled = Sampled::new(trained, count, Iteration::Ours, bench)?;
        let of_task = |task: usize| {
            let fit = sampled.fit(trained.model.features(), task, Iteration::Ours)?;
            Ok(trials.quality(task, &trips(&trained.model, &fit, (&trials.evaluator, task), reflexes)?))
        };
        return tasks.map(of_task).collect();
    }
    let settings = &lab.scenario.value;
    let transitions = trained.walked.spread(count);
    if values == Values::Pose {
        let policies = local::of_pose(lab, &trained.walked, transitions)?;
        return Ok(tasks.map(|task| trials.quality(task, &policies.trips(&trials.evaluator, task))).collect());
    }
    let rule = local::Rule {
        ridge: if values == Values::Means { NO_SLOPES } else { settings.local_ridge },
        walls: values != Values::NoWalls,
        bounded: values != Values::Unbounded,
    };
    let learned = local::of_features(trained, transitions, rule, bench)?;
    let trips = |task: usize| driven(&trials.evaluator, task, &learned, task, reflexes);
    Ok(tasks.map(|task| trials.quality(task, &trips(task))).collect())
}

fn table(found: &Found, goals: &[String]) -> Table {
    let mut table = Table::new("Values from the same transitions");
    for (&(values, count), by_seed) in found {
        for (task, goal) in goals.iter().enumerate() {
            let band = |of: fn(&Quality) -> Option<f64>, digits| {
                Cell::band(Band::of(by_seed.iter().filter_map(|qualities| of(&qualities[task]))), digits)
            };
            let row = [
                ("values", Cell::text(Values::ALL[values as usize].1)),
                ("transitions", Cell::count(count)),
                ("goal", Cell::text(goal)),
                ("success", band(|quality| Some(quality.success), 3)),
                ("steps", band(|quality| quality.steps, 2)),
                ("extra", band(|quality| quality.extra, 2)),
                ("quality", band(|quality| Some(quality.quality), 3)),
            ];
            table.push(row, "not in the thesis");
        }
    }
    table
}

/// Quality by the number of transitions, mean over the goals.
fn plot(found: &Found) -> Result<(String, String), ExperimentError> {
    let mean = |qualities: &Vec<Quality>| {
        qualities.iter().map(|quality| quality.quality).sum::<f64>() / qualities.len().max(1) as f64
    };
    let line = |(colour, (values, name)): (usize, (Values, &str))| {
        let points = found.iter().filter(|((of, _), _)| *of == values);
        let band = |by_seed: &Vec<Vec<Quality>>| Band::of(by_seed.iter().map(mean));
        Line::new(name, colour, points.map(|((_, count), by_seed)| (*count as f64, band(by_seed))))
    };
    let lines: Vec<Line> = Values::ALL.into_iter().enumerate().map(line).collect();
    let axes = (&Axis::log("transitions"), &Axis::new("convergence quality C").within(0.0, 1.0));
    Ok(chart("quality.svg", "Convergence quality by the number of transitions, mean over five goals", axes, &lines)?)
}
