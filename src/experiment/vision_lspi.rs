//! `vision-lspi`: policy iteration over slow features of the camera's images (thesis §5.3.4, figure *pi_nf_sim*).
//!
//! The same as `pose-lspi` with the whole training set and the goal in the centre, but the features are the constant and the
//! `d − 1` slowest of kernel SFA on the video of the same walk. First policy: all actions alike.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::lab::{CENTRE, FRAMES, Lab, TRANSITIONS};
use super::plot::{Line, chart};
use super::quality::{Quality, Trials};
use super::trained::{Iteration, Sampled, Trained, Training, train, trips};
use super::{Band, Bench, Cell, Experiment, ExperimentError, Once, Results, Sizes, Table};
use crate::report::draw::Axis;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "vision-lspi",
    line: "LSPI over slow features of the camera's images, by their number (figure pi_nf_sim)",
    lasts: Sizes { full: "a quarter of an hour", quick: "3 min", smoke: "seconds" },
    run,
};

/// Actions of the walk, transitions out of it, support vectors (the thesis had 8064).
const TRAINING: Sizes<(usize, usize, usize)> =
    Sizes { full: (FRAMES - 1, TRANSITIONS, 8000), quick: (12_000, 6000, 1000), smoke: (600, 400, 60) };
/// Numbers of features `d`.
const FEATURES: Sizes<&[usize]> =
    Sizes { full: &[10, 20, 40, 80, 128, 200, 300, 400, 500], quick: &[10, 20, 40, 80, 128, 200], smoke: &[10, 20] };
/// Random starts (the thesis had 200).
const STARTS: Sizes<usize> = Sizes { full: 200, quick: 200, smoke: 10 };
/// From so many features on, the thesis's policies work (§5.3.4), with these steps more than the reference policy.
const REGIME: usize = 80;
const MORE: (f64, f64) = (2.0, 3.0);
/// The thesis tells whole steps, read off a curve: half of one is no difference.
const ROUNDED: f64 = 0.5;

/// The camera as it is, and without its noise and drift, of which the thesis tells nothing for its simulator.
const CAMERAS: [&[&str]; 2] = [&[], &["camera.pixel_noise=0", "camera.exposure_drift=0"]];
/// What may decide whether many features work: the camera, and how many times as many transitions, as far as the walk has them.
const CONDITIONS: [(&str, &[&str], usize); 3] = [
    ("as everywhere here", CAMERAS[0], 1),
    ("up to three times as many transitions", CAMERAS[0], 3),
    ("without noise and drift of the camera", CAMERAS[1], 1),
];
/// How many of the largest numbers of features the conditions are compared at.
const MANY: usize = 3;

#[derive(Serialize)]
struct Settings {
    training: Training,
    transitions: usize,
    task: &'static str,
    starts: usize,
    features: usize,
}

/// What came of a setting.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// Support vectors.
    pub support_vectors: usize,
    /// Policies: the thesis's iteration, then ours.
    pub policies: Vec<Policy>,
}

/// A policy, and how it was found.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Policy {
    /// Whether policy iteration settled.
    pub converged: bool,
    /// What its trips came to.
    pub quality: Quality,
}

/// By number of features and iteration, one policy for each seed.
type Found = BTreeMap<(usize, Iteration), Vec<Policy>>;

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let ((actions, transitions, vectors), features) = (scope.pick(TRAINING), scope.pick(FEATURES));
    let (vectors, starts) = (scope.vectors_or(vectors), scope.pick(STARTS));
    // The first condition has them all.
    let many = &features[features.len().saturating_sub(MANY)..];
    bench.plan(scope.seeds.len() * (features.len() + (CONDITIONS.len() - 1) * many.len()));
    let most = features.iter().copied().max().unwrap_or(2);
    let (mut found, mut sizes) = ([(); CONDITIONS.len()].map(|()| Found::new()), Vec::new());
    let (mut gamma, (task, name)) = (0.0, CENTRE);
    for (&seed, sets) in scope.seeds.iter().flat_map(|seed| CAMERAS.map(|sets| (seed, sets))) {
        let lab = Lab::new(seed, sets)?;
        gamma = lab.scenario.value.gamma;
        let training = Training::new(&lab, actions, vectors, most - 1);
        let (trained, trials) = (Once::<Trained<'_>>::default(), Once::<Trials<'_>>::default());
        let of_camera = CONDITIONS.iter().zip(&mut found).enumerate().filter(|(_, ((_, of, _), _))| *of == sets);
        for (number, ((what, _, times), found)) in of_camera {
            let sampled: [Once<Sampled<'_>>; 3] = Default::default();
            let transitions = transitions * times;
            for &d in if number == 0 { features } else { many } {
                let settings = Settings { training: training.clone(), transitions, task: name, starts, features: d };
                let label = format!("{d} features, {what}, seed {seed}");
                let outcome: Outcome = bench.result(&label, &settings, || {
                    let trained = trained.get(|| train(&lab, &training, bench))?;
                    let trials = trials.get(|| Ok::<_, ExperimentError>(Trials::new(&lab, starts)))?;
                    let policy = |iteration: Iteration| {
                        bench.go_on()?;
                        let make = || Sampled::new(trained, transitions, iteration, bench);
                        let fit = sampled[iteration as usize].get(make)?.fit(d, task, iteration)?;
                        let trips = trips(&trained.model, &fit, (&trials.evaluator, task), iteration.reflexes(&lab))?;
                        let quality = trials.quality(task, &trips);
                        Ok::<_, ExperimentError>(Policy { converged: fit.converged, quality })
                    };
                    let policies: Result<Vec<Policy>, _> = Iteration::BOTH.into_iter().map(policy).collect();
                    Ok(Outcome { support_vectors: trained.model.members.ncols(), policies: policies? })
                })?;
                for (iteration, policy) in Iteration::BOTH.into_iter().zip(outcome.policies) {
                    found.entry((d, iteration)).or_default().push(policy);
                }
                if number == 0 {
                    sizes.push(outcome.support_vectors as f64);
                }
            }
        }
    }
    let sizes = Band::of(&sizes).map_or(0.0, |band| band.mean);
    Ok(Results {
        tables: vec![table(&found[0], gamma), conditions(&found, many, gamma)],
        notes: vec![
            format!(
                "Goal {name}, γ = {gamma}, {starts} random starts, {transitions} transitions out of a walk of {actions} actions, \
                 {sizes:.0} support vectors (thesis: 8064 and 11 656 transitions out of 35 128 frames)."
            ),
            "More than the reference: log_γ of the mean of γ^(steps − steps of the reference policy), as in the thesis. Quality: \
             against the optimal number of steps."
                .into(),
        ],
        plots: plots(&found[0])?,
    })
}

fn band(policies: &[Policy], of: impl Fn(&Quality) -> Option<f64>) -> Option<Band> {
    Band::of(policies.iter().filter_map(|policy| of(&policy.quality)))
}

/// Share of the iterations that settled.
fn settled(policies: &[Policy]) -> f64 {
    policies.iter().filter(|policy| policy.converged).count() as f64 / policies.len() as f64
}

/// Steps more than the reference policy, as the thesis counts them; `None`: no start arrives.
fn more(policies: &[Policy], gamma: f64) -> Option<f64> {
    let mean = band(policies, |quality| Some(quality.to_reference)).map_or(0.0, |band| band.mean);
    (mean > 0.0).then(|| mean.ln() / gamma.ln())
}

fn table(found: &Found, gamma: f64) -> Table {
    let mut table = Table::new("Policies over slow features, by their number");
    for (&(d, iteration), policies) in found {
        let more = more(policies, gamma);
        let works = d >= REGIME && iteration == Iteration::Thesis;
        let row = [
            ("features", Cell::count(d)),
            ("iteration", Cell::text(iteration.name())),
            ("settled", Cell::Number(settled(policies), 2)),
            ("success", Cell::band(band(policies, |quality| Some(quality.success)), 3)),
            ("steps", Cell::band(band(policies, |quality| quality.steps), 2)),
            ("extra", Cell::band(band(policies, |quality| quality.extra), 2)),
            ("quality", Cell::band(band(policies, |quality| Some(quality.quality)), 3)),
            ("more than the reference", Cell::maybe(more, 2)),
            ("thesis: more than the reference", if works { Cell::text("2 to 3") } else { Cell::Empty }),
        ];
        table.push(row, says(d, iteration, more));
    }
    table
}

/// What many features come to under each condition.
fn conditions(found: &[Found], many: &[usize], gamma: f64) -> Table {
    let mut table = Table::new("What decides whether many features work");
    for (found, (what, ..)) in found.iter().zip(CONDITIONS) {
        for iteration in Iteration::BOTH {
            let mut row =
                vec![("condition".into(), Cell::text(what)), ("iteration".into(), Cell::text(iteration.name()))];
            let mut work = 0;
            for (d, policies) in many.iter().filter_map(|&d| Some((d, found.get(&(d, iteration))?))) {
                let more = more(policies, gamma);
                row.push((format!("{d} features: settled"), Cell::Number(settled(policies), 2)));
                row.push((format!("{d}: more than the reference"), Cell::maybe(more, 2)));
                work += usize::from(more.is_some_and(|more| more <= MORE.1 + ROUNDED));
            }
            let says = match iteration {
                Iteration::Thesis if work == many.len() => "agrees: they all work".into(),
                Iteration::Thesis => format!("differs: {work} of {} work", many.len()),
                _ => "not in the thesis".into(),
            };
            table.push(row, says);
        }
    }
    table
}

fn says(d: usize, iteration: Iteration, more: Option<f64>) -> String {
    if iteration == Iteration::Ours {
        return "not in the thesis".into();
    }
    match (d >= REGIME, more) {
        (true, Some(more)) if more < MORE.0 - ROUNDED => format!("differs: better by {:.1} steps", MORE.0 - more),
        (true, Some(more)) if more <= MORE.1 + ROUNDED => "agrees, to half a step".into(),
        (true, Some(more)) => format!("differs: worse by {:.1} steps", more - MORE.1),
        (true, None) => "differs: no start arrives".into(),
        (false, Some(more)) if more <= MORE.1 => "differs: works with fewer features than in the thesis".into(),
        (false, _) => "agrees: too few features".into(),
    }
}

fn plots(found: &Found) -> Result<Vec<(String, String)>, ExperimentError> {
    let lines = |of: &dyn Fn(&Quality) -> Option<f64>| {
        let line = |(colour, iteration): (usize, Iteration)| {
            let points = found.iter().filter(|((_, i), _)| *i == iteration);
            Line::new(iteration.name(), colour, points.map(|(&(d, _), policies)| (d as f64, band(policies, of))))
        };
        Iteration::BOTH.into_iter().enumerate().map(line).collect::<Vec<_>>()
    };
    let x = Axis::log("features d");
    let quality = chart(
        "quality.svg",
        "Convergence quality against the optimum, by number of slow features",
        (&x, &Axis::new("convergence quality C").within(0.0, 1.0)),
        &lines(&|quality| Some(quality.quality)),
    )?;
    let more = chart(
        "steps.svg",
        "Steps more than the reference policy, by number of slow features",
        (&x, &Axis::new("log_γ C against the reference").within(-1.5, 8.0)),
        &lines(&|quality| quality.more_than_reference),
    )?;
    Ok(vec![quality, more])
}
