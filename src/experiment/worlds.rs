//! `worlds`: the agent with its default settings in every world there is, beside what it is to be compared with.
//!
//! Each seed draws new textures for all walls and the floor, so that nothing can be tuned to a texture. All are tried from the same starts
//! with the camera (policies of the true pose with that). The agent is run as `adagio run` does it, but for a camera that renders
//! only what vision needs; the batch pipeline and the policies of the true pose learn from a random walk of as many actions;
//! Stream-Q(λ) acts on its own values.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::driven::{SMALL, curve, drive};
use super::field::{Field, Point, StreamQRun};
use super::lab::{Data, Lab, WORLDS};
use super::plot::{Line, chart};
use super::quality::{Quality, Trials};
use super::trained::with_one;
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::report::draw::Axis;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "worlds",
    line: "the agent in every world, with local and linear values, beside batch pipeline, true pose, Stream-Q(λ), random, reference",
    lasts: Sizes { full: "hours", quick: "a quarter of an hour", smoke: "seconds" },
    run,
};

/// Which worlds, by their place in [`WORLDS`]; for how much of their scenarios' actions they are driven in.
const WHICH: Sizes<(&[usize], usize)> =
    Sizes { full: (&[0, 1, 2, 3, 4, 5, 6, 7, 8, 9], 1), quick: (&[0, 1, 2], 1), smoke: (&[0, 5], 60) };
/// Random starts for each goal; for each moment of the agent's curve.
const STARTS: Sizes<(usize, usize)> = Sizes { full: (400, 100), quick: (200, 100), smoke: (10, 4) };
/// One support vector of the batch pipeline for so many frames (the thesis had 4.4).
const FRAMES_PER_VECTOR: usize = 4;
/// Success that a curve is to reach.
const GOOD: f64 = 0.95;

/// What drives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Method {
    Agent,
    AgentLinear,
    Batch,
    PoseLocal,
    PosePlanned,
    PoseLinear,
    Replanned,
    ToldApart,
    QOnPixels,
    Random,
    Reference,
    Optimal,
}

impl Method {
    /// All of them in the order of their declaration, with their names.
    const ALL: [(Method, &str); 12] = [
        (Method::Agent, "the agent (local values)"),
        (Method::AgentLinear, "the agent, linear values"),
        (Method::Batch, "the thesis's batch pipeline"),
        (Method::PoseLocal, "true pose, local values"),
        (Method::PosePlanned, "true pose, planned on a lattice"),
        (Method::PoseLinear, "true pose, our LSPI"),
        (Method::Replanned, "true pose, shortest way"),
        (Method::ToldApart, "the same, but for rooms that look alike"),
        (Method::QOnPixels, "Stream-Q(λ) on pixels"),
        (Method::Random, "random actions"),
        (Method::Reference, "reference policy"),
        (Method::Optimal, "optimum"),
    ];

    fn name(self) -> &'static str {
        Self::ALL[self as usize].1
    }
}

/// What decides on a result.
#[derive(Debug, Clone, Serialize)]
struct Settings {
    data: Data,
    actions: usize,
    method: Method,
    starts: (usize, usize),
    small: bool,
    /// Keys of the scenario that are set.
    sets: Vec<String>,
}

/// What a method comes to in a world.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Tried {
    /// Of each task.
    qualities: Vec<Quality>,
    /// Of the agent: success and quality over its actions, means over tasks.
    curve: Vec<Point>,
    /// Of the agent and the batch pipeline.
    support_vectors: Option<usize>,
    /// That were learned from.
    actions: usize,
}

impl Tried {
    fn of(qualities: Vec<Quality>, actions: usize) -> Self {
        Tried { qualities, curve: Vec::new(), support_vectors: None, actions }
    }

    fn mean(&self, of: impl Fn(&Quality) -> Option<f64>) -> Option<f64> {
        let values: Vec<f64> = self.qualities.iter().filter_map(of).collect();
        (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
    }

    /// Actions at the first moment from which on the curve stays good.
    fn good_from(&self) -> Option<f64> {
        let bad = self.curve.iter().rposition(|point| point.success < GOOD).map_or(0, |last| last + 1);
        self.curve.get(bad).map(|point| point.actions as f64)
    }
}

/// By world and method, for each seed.
type Found = BTreeMap<(usize, Method), Vec<Tried>>;

/// The names of the worlds.
pub fn names() -> impl Iterator<Item = &'static str> {
    WORLDS.into_iter().map(|world| world.0)
}

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let (which, share) = scope.pick(WHICH);
    let only = names().position(|name| scope.world.as_deref() == Some(name));
    let which = only.as_ref().map_or(which, std::slice::from_ref);
    let starts = scope.pick(STARTS);
    bench.plan(scope.seeds.len() * which.len() * Method::ALL.len());
    let mut found = Found::new();
    for &place in which {
        let (name, _) = WORLDS[place];
        for &seed in scope.seeds.iter() {
            let mut sets = vec![format!("world.texture_seed={seed}")];
            let planned = Lab::world(place, seed, &sets)?;
            let actions = planned.scenario.actions as usize / share;
            sets.push(format!("actions={actions}"));
            if let Some(vectors) = scope.vectors {
                let features = planned.scenario.slow.features.min(vectors);
                sets.extend([format!("dictionary.budget={vectors}"), format!("slow.features={features}")]);
            }
            let lab = Lab::world(place, seed, &sets)?;
            let shared = Once::default();
            for (method, what) in Method::ALL {
                let small = share > 1;
                let (data, sets) = (Data::new(&lab, actions), sets.clone());
                let settings = Settings { data, actions, method, starts, small, sets };
                let tried: Tried =
                    bench.result(&format!("{name}, {what}, seed {seed}"), &settings, || match method {
                        Method::Agent | Method::AgentLinear => of_agent(&settings, (place, seed), bench),
                        _ => of_field(shared.get(|| Field::new(&lab, actions, starts.0, bench))?, method, actions),
                    })?;
                found.entry((place, method)).or_default().push(tried);
            }
        }
    }
    Ok(Results {
        tables: vec![table(&found)],
        notes: vec![
            format!(
                "Means over each world's goals, {} random starts each; least: the goal with the fewest. Good from: actions from which \
                 on at least {:.0} % of {} starts for each goal arrive.",
                starts.0,
                100.0 * GOOD,
                starts.1
            ),
            format!(
                "Each seed has patterns of its own on walls and floor (world.texture_seed); the camera renders what vision needs \
                 (camera.detail). Batch pipeline and true pose learn from a random \
                 walk of as many actions as the agent drives, with the scenario's number of features; the batch pipeline has one \
                 support vector for {FRAMES_PER_VECTOR} of its frames, at most the scenario's budget. Stream-Q(λ) begins at a \
                 random pose after each goal or episode, which helps it. The reference policy turns to the goal and drives: walls \
                 stop it."
            ),
        ],
        plots: plots(&found)?,
    })
}

/// A run of the agent: how good its last policies are, and its curve.
fn of_agent(settings: &Settings, (place, seed): (usize, u64), bench: &Bench<'_>) -> Result<Tried, ExperimentError> {
    let mut sets = settings.sets.clone();
    if settings.method == Method::AgentLinear {
        sets.push("value.method=lspi".into());
    }
    if settings.small {
        sets.extend(SMALL.map(str::to_owned));
    }
    let lab = Lab::driven(place, seed, &sets)?;
    let outcome = drive(&lab, &lab.evaluator(settings.starts.1), bench)?;
    let Some(learned) = outcome.learned else {
        return Err(ExperimentError::Run(outcome.without_model.unwrap_or_else(|| "no model was learned".into())));
    };
    let trials = Trials::new(&lab, settings.starts.0);
    let trips = trials.evaluator.evaluate_and_show(&learned, false).into_iter().map(|(_, trips)| trips);
    let qualities = trips.enumerate().map(|(task, trips)| trials.quality(task, &trips)).collect();
    let support_vectors = Some(outcome.support_vectors);
    Ok(Tried { qualities, curve: curve(outcome.curve), support_vectors, actions: settings.actions })
}

/// What does not need the agent.
fn of_field(field: &Field<'_>, method: Method, actions: usize) -> Result<Tried, ExperimentError> {
    let scenario = &field.lab.scenario;
    let features = scenario.slow.features.min(actions / FRAMES_PER_VECTOR);
    let qualities = match method {
        Method::Batch => {
            let vectors = (actions / FRAMES_PER_VECTOR).min(scenario.dictionary.budget);
            let (qualities, vectors) = field.batch(actions, features, vectors)?;
            return Ok(Tried { support_vectors: Some(vectors), ..Tried::of(qualities, actions) });
        }
        Method::PoseLocal => field.true_pose_locally()?,
        Method::PosePlanned => field.planned()?,
        Method::PoseLinear => field.true_pose(actions, features)?,
        Method::Replanned => field.replanned()?,
        Method::ToldApart => field.told_apart()?,
        Method::QOnPixels => {
            let episode = scenario.evaluate.max_steps;
            let run = StreamQRun { actions: &[actions], episode, features: field.video.nrows() + 1 };
            let mut moments = field.stream_q(&run, |x| with_one(&x))?;
            moments.pop().unwrap_or_default()
        }
        Method::Random => field.random()?,
        Method::Reference => field.qualities(|task| Ok(field.trials.reference[task].clone()))?,
        // The agent is not of the field.
        Method::Agent | Method::AgentLinear | Method::Optimal => field.optimum()?,
    };
    Ok(Tried::of(qualities, actions))
}

fn table(found: &Found) -> Table {
    let mut table = Table::new("The agent in every world");
    for (&(place, method), seeds) in found {
        let band =
            |of: &dyn Fn(&Tried) -> Option<f64>, digits| Cell::band(Band::of(seeds.iter().filter_map(of)), digits);
        let least = |tried: &Tried| tried.qualities.iter().map(|q| q.success).min_by(f64::total_cmp);
        let learns = !matches!(method, Method::Random | Method::Reference | Method::Optimal);
        let actions = seeds.first().filter(|_| learns).map_or(Cell::Empty, |tried| Cell::count(tried.actions));
        let row = [
            ("world", Cell::text(WORLDS[place].0)),
            ("method", Cell::text(method.name())),
            ("actions", actions),
            ("support vectors", band(&|tried| tried.support_vectors.map(|vectors| vectors as f64), 0)),
            ("success", band(&|tried| tried.mean(|q| Some(q.success)), 3)),
            ("least", band(&least, 3)),
            ("steps", band(&|tried| tried.mean(|q| q.steps), 2)),
            ("extra", band(&|tried| tried.mean(|q| q.extra), 2)),
            ("quality", band(&|tried| tried.mean(|q| Some(q.quality)), 3)),
            ("good from", band(&Tried::good_from, 0)),
        ];
        table.push(row, if place == 0 && method == Method::Batch { "80 % on the robot" } else { "not in the thesis" });
    }
    table
}

/// How fast the agent learns in each world.
fn plots(found: &Found) -> Result<Vec<(String, String)>, ExperimentError> {
    let of_agent = || found.iter().filter(|((_, method), _)| *method == Method::Agent);
    let lines = |of: fn(&Point) -> f64| -> Vec<Line> {
        let line = |(&(place, _), seeds): (&(usize, Method), &Vec<Tried>)| {
            // Runs of a world are looked at after about the same numbers of actions: moments are those that all have.
            let moments = seeds.iter().map(|tried| tried.curve.len()).min().unwrap_or(0);
            let at = |i: usize| {
                let values: Vec<f64> = seeds.iter().map(|tried| of(&tried.curve[i])).collect();
                (seeds[0].curve[i].actions as f64, Band::of(&values))
            };
            Line::new(WORLDS[place].0, place, (0..moments).map(at))
        };
        of_agent().map(line).collect()
    };
    let x = Axis::log("actions");
    let y = |name: &str| Axis::new(name).within(0.0, 1.0);
    let (success, quality) = (y("share of starts that arrive"), y("convergence quality C"));
    Ok(vec![
        chart("success.svg", "The agent's success by actions", (&x, &success), &lines(|p| p.success))?,
        chart("quality.svg", "The agent's quality by actions", (&x, &quality), &lines(|p| p.quality))?,
    ])
}
