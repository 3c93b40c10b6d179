//! `selection`: which frames to keep as support vectors (thesis §2.2.6 and outlook).
//!
//! The thesis chose by ALD over images. Its author later found a set that is uniform in the space of images worse than one
//! that is uniform in the space of states (Böhmer et al., JMLR 2013, §5.5). Four rules choose equally many frames of one video,
//! and work with one kernel width: that at which ALD chooses so many.

use std::collections::BTreeMap;
use std::sync::Arc;

use faer::{Mat, MatRef};
use serde::{Deserialize, Serialize};

use super::lab::{FRAMES, Lab, TRANSITIONS, Walked};
use super::pipeline::{NU, Widths, slow_features};
use super::plot::{Line, chart};
use super::quality::{Quality, Trials};
use super::trained::{Iteration, Sampled, Trained, Training, trips};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::dictionary::{
    Dictionary, FeatureAld, FeatureParameters, GreedyResidual, Parameters, Reservoir, Selection, WhenFull,
};
use crate::evaluate::decode_pose;
use crate::kernel::Kernel;
use crate::policy::Learned;
use crate::report::draw::Axis;
use crate::slow::SlowModel;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "selection",
    line: "choice of support vectors: ALD, random, MP-MAH, ALD over slow features",
    lasts: Sizes { full: "8 min", quick: "6 min", smoke: "seconds" },
    run,
};

/// Actions of the walk, transitions out of it.
const WALK: Sizes<(usize, usize)> = Sizes { full: (FRAMES - 1, TRANSITIONS), quick: (12_000, 6000), smoke: (600, 400) };
/// Numbers of support vectors.
const VECTORS: Sizes<&[usize]> = Sizes { full: &[250, 500, 1000, 2000], quick: &[250, 500], smoke: &[50] };
/// Slow features, the constant included, and random starts for each goal.
const FEATURES: Sizes<(usize, usize)> = Sizes { full: (128, 200), quick: (128, 200), smoke: (20, 10) };
/// Slow features in whose space the fourth rule judges: about those that are neither noise nor mixtures of many.
const JUDGING: usize = 16;
/// Features over which slowness is averaged.
const MEAN: usize = 10;
/// Frames that are judged together.
const BLOCK: usize = 256;

/// The rules.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Rule {
    Ald,
    Random,
    MpMah,
    FeatureAld,
}

impl Rule {
    const ALL: [Rule; 4] = [Rule::Ald, Rule::Random, Rule::MpMah, Rule::FeatureAld];

    fn name(self) -> &'static str {
        ["ALD", "random", "MP-MAH", "ALD over slow features"][self as usize]
    }
}

#[derive(Serialize)]
struct Settings {
    training: Training,
    rule: Rule,
    transitions: usize,
    starts: usize,
    judging: usize,
}

/// What came of a setting.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Support vectors.
    pub support_vectors: usize,
    /// Kernel width, grey levels.
    pub sigma: f64,
    /// Mean residual ε of all frames: what the support vectors do not span.
    pub residual: f64,
    /// Mean slowness of the first features on the training frames, 1/s².
    pub slowness: f64,
    /// Root mean square error of the position that is read off the features linearly, metres.
    pub position_error_m: f64,
    /// The same of the heading, degrees.
    pub heading_error_deg: f64,
    /// Policies by our iteration, one for each task.
    pub policies: Vec<Quality>,
}

/// What the settings of one seed share.
struct Prepared<'a> {
    lab: &'a Lab,
    walked: Arc<Walked>,
    frames: Arc<Mat<f32>>,
    /// By number of support vectors: ALD's choice, and its features.
    ald: BTreeMap<usize, (Dictionary<f32>, SlowModel<f32>)>,
    trials: Trials<'a>,
}

fn prepare<'a>(
    lab: &'a Lab,
    training: &Training,
    numbers: &[usize],
    starts: usize,
    bench: &Bench<'_>,
) -> Result<Prepared<'a>, ExperimentError> {
    let walked = lab.walk(training.data.actions);
    let frames = lab.video(&walked.poses, bench)?;
    let links = lab.links(&walked, lab.thesis_weight(&walked.steps()));
    let mut widths = Widths::default();
    let mut ald = BTreeMap::new();
    for &number in numbers {
        let dictionary = widths.select(frames.as_ref(), number, bench)?;
        let (_, model) = slow_features(&dictionary, frames.as_ref(), &links, training.features, bench)?;
        ald.insert(number, (dictionary, model));
    }
    Ok(Prepared { lab, walked: Arc::new(walked), frames: Arc::new(frames), ald, trials: Trials::new(lab, starts) })
}

/// Let a rule choose as many frames as ALD did.
fn choose(
    rule: Rule,
    (ald, model): &(Dictionary<f32>, SlowModel<f32>),
    frames: MatRef<'_, f32>,
    seed: u64,
    bench: &Bench<'_>,
) -> Result<Dictionary<f32>, ExperimentError> {
    let (kernel, budget, par) = (ald.kernel(), ald.len(), bench.scope.par);
    let mut selection: Box<dyn Selection<f32>> = match rule {
        Rule::Ald => return Ok(ald.clone()),
        Rule::Random => Box::new(Reservoir::new(kernel, budget, seed, par)?),
        Rule::MpMah => {
            let mut greedy = GreedyResidual::new(kernel, 1e-9, budget, par)?;
            greedy.observe(frames)?;
            return Ok(greedy.dictionary().clone());
        }
        Rule::FeatureAld => {
            let judging = first_features(model, JUDGING)?;
            let phi = judging.apply(frames, par)?;
            // The width, over features, at which as many are chosen.
            let over = Widths::default().select(phi.as_ref(), budget, bench)?;
            let features = FeatureParameters { kernel: over.kernel(), nu: NU };
            // Frames are chosen by their features; their own kernel only refuses what would leave its factor singular.
            let observations = Parameters { kernel, nu: 1e-9, budget, when_full: WhenFull::Stop, par };
            let mut selection = FeatureAld::new(observations, features)?;
            selection.adopt(judging.feature_map())?;
            Box::new(selection)
        }
    };
    for start in (0..frames.ncols()).step_by(BLOCK) {
        bench.go_on()?;
        selection.observe(frames.subcols(start, BLOCK.min(frames.ncols() - start)))?;
        if selection.is_over_budget() {
            selection.thin()?;
        }
    }
    Ok(selection.dictionary().clone())
}

/// A model with its first features only.
fn first_features(model: &SlowModel<f32>, count: usize) -> Result<SlowModel<f32>, ExperimentError> {
    let count = count.min(model.slowness.len());
    Ok(SlowModel::from_parts(
        model.kernel,
        model.members.as_ref().clone(),
        model.projection.subcols(0, count).to_owned(),
        model.offset[..count].to_vec(),
        model.slowness[..count].to_vec(),
    )?)
}

fn compute(prepared: &Prepared<'_>, settings: &Settings, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
    let Prepared { lab, walked, .. } = prepared;
    let frames = prepared.frames.as_ref().as_ref();
    let seed = lab.scenario.seed;
    // All numbers that are asked for were prepared.
    let ald = &prepared.ald[&settings.training.vectors];
    let dictionary = choose(settings.rule, ald, frames, seed, bench)?;
    let links = lab.links(walked, lab.thesis_weight(&walked.steps()));
    let (features, model) = slow_features(&dictionary, frames, &links, settings.training.features, bench)?;
    let mut residual = 0.0;
    for start in (0..frames.ncols()).step_by(BLOCK) {
        let v = dictionary.coordinates(frames.subcols(start, BLOCK.min(frames.ncols() - start)))?;
        residual += v.col_iter().map(|column| (1.0 - column.squared_norm_l2()).max(0.0)).sum::<f64>();
    }
    let trained = Trained { lab, walked: walked.clone(), frames: prepared.frames.clone(), model };
    let sampled = Sampled::new(&trained, settings.transitions, Iteration::Ours, bench)?;
    let mut policies = Vec::new();
    for task in 0..lab.scenario.tasks.len() {
        bench.go_on()?;
        let fit = sampled.fit(settings.training.features + 1, task, Iteration::Ours)?;
        let reflexes = Iteration::Ours.reflexes(lab);
        let trips = trips(&trained.model, &fit, (&prepared.trials.evaluator, task), reflexes)?;
        policies.push(prepared.trials.quality(task, &trips));
    }
    let weights = vec![Mat::zeros(trained.model.features(), 3)];
    let learned = Learned::new(1, 0, 0, trained.model.clone(), weights)?;
    let pose = decode_pose(&lab.scenario, &lab.world, &learned, seed)?.linear;
    let count = MEAN.min(features.slowness.len());
    Ok(Outcome {
        support_vectors: dictionary.len(),
        sigma: Kernel::sigma(&dictionary.kernel()).unwrap_or(0.0),
        residual: residual / frames.ncols() as f64,
        slowness: features.slowness[..count].iter().sum::<f64>() / count as f64,
        position_error_m: pose.position_rmse_m,
        heading_error_deg: pose.heading_rmse_deg,
        policies,
    })
}

/// By number of support vectors and rule, one outcome for each seed.
type Found = BTreeMap<(usize, Rule), Vec<Outcome>>;

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let (actions, transitions) = scope.pick(WALK);
    let numbers = scope.vectors_up_to(scope.pick(VECTORS));
    let (features, starts) = scope.pick(FEATURES);
    bench.plan(scope.seeds.len() * numbers.len() * Rule::ALL.len());
    let mut found = Found::new();
    let tasks: Vec<String> =
        Lab::new(scope.seeds[0], &[])?.scenario.tasks.iter().map(|task| task.name.clone()).collect();
    for &seed in scope.seeds.iter() {
        let lab = Lab::new(seed, &[])?;
        let prepared = Once::default();
        for &vectors in &numbers {
            for rule in Rule::ALL {
                let training = Training::new(&lab, actions, vectors, features - 1);
                let settings = Settings { training, rule, transitions, starts, judging: JUDGING };
                let outcome = bench.result(&format!("{vectors} by {}, seed {seed}", rule.name()), &settings, || {
                    let prepared = prepared.get(|| prepare(&lab, &settings.training, &numbers, starts, bench))?;
                    compute(prepared, &settings, bench)
                })?;
                found.entry((vectors, rule)).or_default().push(outcome);
            }
        }
    }
    Ok(Results {
        tables: vec![table(&found, &tasks)],
        notes: vec![
            format!(
                "{} frames; all rules have the kernel width at which ALD with ν = {NU} keeps that many; {} features, {transitions} \
                 transitions, {starts} random starts for each goal, iteration with ridge, mixing and reflexes. Residual: mean share \
                 of a frame that the support vectors do not span. Slowness: mean of the first {MEAN}.",
                actions + 1,
                features
            ),
            format!(
                "ALD over slow features judges by the {JUDGING} slowest features of ALD's own choice; MP-MAH takes the largest \
                 residual first, with all frames at hand."
            ),
            "The thesis chose by ALD and compares it with nothing.".into(),
        ],
        plots: plots(&found, &tasks)?,
    })
}

fn band(outcomes: &[Outcome], of: impl Fn(&Outcome) -> Option<f64>) -> Option<Band> {
    Band::of(outcomes.iter().filter_map(of))
}

fn table(found: &Found, tasks: &[String]) -> Table {
    let mut table = Table::new("Rules of choice at equal numbers of support vectors");
    for ((_, rule), outcomes) in found {
        let cell = |name: &str, digits: usize, of: &dyn Fn(&Outcome) -> Option<f64>| {
            (name.to_owned(), Cell::band(band(outcomes, of), digits))
        };
        let mut row = vec![
            cell("support vectors", 0, &|outcome| Some(outcome.support_vectors as f64)),
            ("rule".into(), Cell::text(rule.name())),
            cell("residual", 4, &|outcome| Some(outcome.residual)),
            cell("slowness, 1/s²", 4, &|outcome| Some(outcome.slowness)),
            cell("position error, m", 3, &|outcome| Some(outcome.position_error_m)),
            cell("heading error, °", 1, &|outcome| Some(outcome.heading_error_deg)),
        ];
        for (task, name) in tasks.iter().enumerate() {
            row.push(cell(&format!("{name}: success"), 3, &|outcome| Some(outcome.policies.get(task)?.success)));
            row.push(cell(&format!("{name}: quality"), 3, &|outcome| Some(outcome.policies.get(task)?.quality)));
        }
        let says = if *rule == Rule::Ald { "the thesis's rule; it prints no number" } else { "not in the thesis" };
        table.push(row, says);
    }
    table
}

fn plots(found: &Found, tasks: &[String]) -> Result<Vec<(String, String)>, ExperimentError> {
    let lines = |of: &dyn Fn(&Outcome) -> Option<f64>| -> Vec<Line> {
        let line = |(colour, rule): (usize, Rule)| {
            let points = found.iter().filter(|((_, r), _)| *r == rule);
            Line::new(rule.name(), colour, points.map(|(&(vectors, _), outcomes)| (vectors as f64, band(outcomes, of))))
        };
        Rule::ALL.into_iter().enumerate().map(line).collect()
    };
    let x = Axis::log("support vectors");
    let mut plots = vec![
        chart(
            "position.svg",
            "Error of the position that is read off the features",
            (&x, &Axis::new("root mean square, m")),
            &lines(&|outcome| Some(outcome.position_error_m)),
        )?,
        chart(
            "slowness.svg",
            "Mean slowness of the first features",
            (&x, &Axis::new("slowness Δ, 1/s²")),
            &lines(&|outcome| Some(outcome.slowness)),
        )?,
    ];
    for (number, task) in tasks.iter().enumerate() {
        plots.push(chart(
            &format!("quality-{}.svg", number + 1),
            &format!("Convergence quality, {task}"),
            (&x, &Axis::new("quality C against the optimum").within(0.0, 1.0)),
            &lines(&|outcome| Some(outcome.policies.get(number)?.quality)),
        )?);
    }
    Ok(plots)
}
