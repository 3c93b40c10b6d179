//! `pose-lspi`: policy iteration over optimal responses of the true pose (thesis §5.3.3, figure *pi_overfitting*).
//!
//! The thesis's question is in which range of feature numbers LSPI works at all, and how much that depends on the first
//! policy and the number of transitions. Features are the constant and the `d − 1` slowest optimal responses at the true pose;
//! the goal is the centre of the lab. The thesis's LSPI has neither ridge nor mixing, and its robot no reflexes; ours,
//! with all three, is the third variant.

mod results;

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;

use faer::{Mat, Par};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::results::Findings;
use super::lab::{CENTRE, Data, FRAMES, Lab, TRANSITIONS, Transition, Walked, points};
use super::quality::{Quality, Trials};
use super::trained::{Iteration, with_one, worths};
use super::{Bench, Experiment, ExperimentError, Once, Results, Sizes};
use crate::policy::Reflexes;
use crate::robot::Pose;
use crate::slow::theory::OptimalResponses;
use crate::value::{Fit, Lspi, LspiOptions, Outcomes, Samples, Start};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "pose-lspi",
    line: "LSPI over trigonometric features of the true pose, by their number (figure pi_overfitting)",
    lasts: Sizes { full: "a quarter of an hour", quick: "4 min", smoke: "seconds" },
    run,
};

/// Numbers of features `d`.
const FEATURES: Sizes<&[usize]> = Sizes {
    full: &[10, 20, 30, 40, 50, 70, 100, 150, 200, 300, 500],
    quick: &[10, 20, 30, 40, 50, 70, 100, 150, 200],
    smoke: &[10, 20],
};
/// Actions of the walk, and transitions taken from it; the smaller set is half of them.
const WALK: Sizes<(usize, usize)> =
    Sizes { full: (FRAMES, TRANSITIONS), quick: (FRAMES, TRANSITIONS), smoke: (600, 400) };
/// Random starts of the trials, and random first policies.
const TRIALS: Sizes<(usize, usize)> = Sizes { full: (1000, 10), quick: (200, 10), smoke: (10, 2) };

/// The thesis does not say how often it iterated. Plain LSPI has settled, or begun to run in circles, long before this.
const MOST_ITERATIONS: usize = 20;

/// Feature numbers between which the thesis's policies need less than a step more than the reference policy, with all
/// transitions and with half of them (§5.3.3, conclusion 1).
const REGIME: [(usize, usize); 2] = [(20, 70), (20, 40)];

/// What may decide whether policies over 20 to 70 functions work: the size of the goal, and the order of the functions. Settings that are not
/// the lab's; by how much moves weigh less than elsewhere here: more than 1, and functions of the place come sooner; and whether more
/// functions than 70 are tried, too.
const CONDITIONS: [(&str, &[&str], f64, bool); 6] = [
    ("as everywhere here: goal of radius 0.2 m", &[], 1.0, true),
    ("goal of radius 0.3 m", &["task.0.radius=0.3"], 1.0, false),
    ("goal of radius 0.45 m, as the thesis's other one", &["task.0.radius=0.45"], 1.0, true),
    ("functions of the place sooner", &[], 4.0, false),
    ("functions of the heading sooner", &[], 0.25, false),
    ("functions of the place sooner, and a goal of radius 0.45 m", &["task.0.radius=0.45"], 4.0, true),
];

/// Which transitions policies are learned from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
enum Kind {
    /// Those that the thesis took out of its video: no move that a wall stopped, and turns both ways.
    Thesis,
    /// All kinds, as they come in the walk.
    Blocked,
}

impl Kind {
    const ALL: [Kind; 2] = [Kind::Thesis, Kind::Blocked];

    fn name(self) -> &'static str {
        ["as in the thesis", "with blocked moves"][self as usize]
    }
}

#[derive(Serialize)]
struct Settings {
    data: Data,
    kind: Kind,
    task: &'static str,
    lighter_moves: f64,
    features: usize,
    transitions: usize,
    starts: usize,
    trials: usize,
    most_iterations: usize,
}

/// What came of a setting.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Outcome {
    /// From random first policies.
    pub drawn: Vec<Fitted>,
    /// From all actions alike.
    pub uniform: Fitted,
    /// With ridge, mixing and reflexes.
    pub ours: Fitted,
}

/// A policy, and how it was found.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Fitted {
    /// Policy evaluations.
    pub iterations: usize,
    /// Whether policy iteration settled.
    pub converged: bool,
    /// What its trips came to.
    pub quality: Quality,
}

/// What all settings of a seed share.
struct Prepared<'a> {
    lab: &'a Lab,
    walked: Walked,
    /// Of each kind.
    transitions: [Vec<Transition>; 2],
    trials: Trials<'a>,
}

fn prepare(lab: &Lab, (frames, transitions): (usize, usize), starts: usize) -> Prepared<'_> {
    let walked = lab.walk(frames);
    let transitions = [walked.as_in_the_thesis(transitions), walked.spread(transitions)];
    Prepared { lab, walked, transitions, trials: Trials::new(lab, starts) }
}

impl Prepared<'_> {
    fn outcome(&self, settings: &Settings, bench: &Bench<'_>) -> Result<Outcome, ExperimentError> {
        let (d, n) = (settings.features, settings.transitions);
        let lab = self.lab;
        // The first half of the transitions in time, as in the thesis.
        let used = &self.transitions[settings.kind as usize];
        let used = &used[..n.min(used.len())];
        let n = used.len();
        let weight = lab.thesis_weight(&self.walked.steps()) / settings.lighter_moves;
        let theory = lab.optimal_responses(&self.walked.steps(), weight, d - 1)?;
        let features = |frame: fn(&Transition) -> usize| -> Result<Mat<f64>, ExperimentError> {
            let poses: Vec<Pose> = used.iter().map(|t| self.walked.poses[frame(t)]).collect();
            Ok(with_one(&theory.evaluate(points(&poses).as_ref())?))
        };
        let (phi, next) = (features(|t| t.from)?, features(|t| t.to)?);
        let (phi, next) = (phi.as_ref(), next.as_ref());
        let actions: Vec<usize> = used.iter().map(|t| t.action.index()).collect();
        let weights = vec![1.0; n];
        let problem = Lspi::new(Samples { phi, actions: &actions, weights: &weights }, 3, Par::Seq)?;
        let rewards = lab.rewards(CENTRE.0, &self.walked.poses, used);
        let value = &lab.scenario.value;
        let plain =
            LspiOptions { gamma: value.gamma, max_iterations: settings.most_iterations, ..LspiOptions::plain() };
        let fit =
            |start| problem.fit(&Outcomes { next, rewards: &rewards, allowed: None }, &LspiOptions { start, ..plain });
        let stop = bench.stop();
        let drawn: Vec<Option<Fit>> = (1..=settings.trials as u64)
            .into_par_iter()
            .map(|trial| if stop.load(Ordering::Relaxed) { Ok(None) } else { fit(Start::Drawn(trial)).map(Some) })
            .collect::<Result<_, _>>()?;
        bench.go_on()?;
        let uniform = fit(Start::Uniform)?;
        let reflexes = Reflexes::new(&lab.scenario);
        let allowed: Vec<u32> = used.iter().map(|t| reflexes.allowed(t.recent)).collect();
        let outcomes = Outcomes { next, rewards: &rewards, allowed: Some(&allowed) };
        let ours = problem.fit(&outcomes, &Iteration::Ours.options(lab))?;
        let judged = |fit: &Fit, reflexes| Fitted {
            iterations: fit.iterations,
            converged: fit.converged,
            quality: self.quality(fit, &theory, reflexes),
        };
        Ok(Outcome {
            drawn: drawn.iter().flatten().map(|fit| judged(fit, reflexes.off())).collect(),
            uniform: judged(&uniform, reflexes.off()),
            ours: judged(&ours, reflexes),
        })
    }

    fn quality(&self, fit: &Fit, theory: &OptimalResponses, reflexes: Reflexes) -> Quality {
        let trips = self.trials.evaluator.trips(CENTRE.0, false, &|situation| {
            let waves = theory.evaluate(points(&[*situation.pose]).as_ref()).expect("the robot is near the room");
            reflexes.best(&worths(&fit.weights, &waves), situation.recent).0
        });
        self.trials.quality(CENTRE.0, &trips)
    }
}

/// The three variants of a setting, over all seeds.
type Variants = [Vec<Fitted>; 3];

/// Their names.
const VARIANTS: [&str; 3] = ["drawn actions", "all actions alike", "ours: ridge, mixing, reflexes"];

/// Everything that was found: by kind of transitions, training set (0: all transitions, 1: half of them) and number of features.
type Found = BTreeMap<(Kind, usize, usize), Variants>;

fn run(bench: &Bench<'_>) -> Result<Results, ExperimentError> {
    let scope = bench.scope;
    let features = scope.pick(FEATURES);
    let (frames, transitions) = scope.pick(WALK);
    let (starts, trials) = scope.pick(TRIALS);
    let sets = [transitions, transitions / 2];
    let regime: Vec<usize> = features.iter().copied().filter(|d| (REGIME[0].0..=REGIME[0].1).contains(d)).collect();
    let parts = |number: usize, more: bool| -> Vec<(Kind, usize, usize)> {
        if number == 0 {
            return each(features).collect();
        }
        let most = if more { usize::MAX } else { REGIME[0].1 };
        let some = features.iter().filter(|d| (REGIME[0].0..=most).contains(*d));
        some.map(|&d| (Kind::Thesis, 0, d)).collect()
    };
    let planned = CONDITIONS.iter().enumerate().map(|(number, (.., more))| parts(number, *more).len());
    bench.plan(scope.seeds.len() * planned.sum::<usize>());
    let mut found = [(); CONDITIONS.len()].map(|()| Found::new());
    for &seed in scope.seeds.iter() {
        for ((number, (what, keys, lighter_moves, more)), found) in CONDITIONS.into_iter().enumerate().zip(&mut found) {
            let lab = Lab::new(seed, keys)?;
            let data = Data::new(&lab, frames);
            let shared = Once::default();
            for (kind, set, d) in parts(number, more) {
                bench.go_on()?;
                let settings = Settings {
                    data: data.clone(),
                    kind,
                    task: CENTRE.1,
                    lighter_moves,
                    features: d,
                    transitions: sets[set],
                    starts,
                    trials,
                    most_iterations: MOST_ITERATIONS,
                };
                let label = format!("{d} features, {} transitions {}, {what}, seed {seed}", sets[set], kind.name());
                let outcome: Outcome = bench.result(&label, &settings, || {
                    let make = || Ok::<_, ExperimentError>(prepare(&lab, (frames, transitions), starts));
                    shared.get(make)?.outcome(&settings, bench)
                })?;
                let variants = found.entry((kind, set, d)).or_default();
                variants[0].extend(outcome.drawn);
                variants[1].push(outcome.uniform);
                variants[2].push(outcome.ours);
            }
        }
    }
    let lab = Lab::new(scope.seeds[0], &[])?;
    let (gamma, weight) = (lab.scenario.value.gamma, lab.thesis_weight(&lab.walk(frames).steps()));
    let [shown, others @ ..] = found.map(|found| Findings { found, sets, gamma });
    Ok(Results {
        tables: vec![
            shown.regimes(),
            shown.table(Kind::Thesis),
            shown.table(Kind::Blocked),
            results::conditions(&shown, &others, &regime),
        ],
        notes: vec![
            format!(
                "Goal {}, γ = {gamma}, {starts} random starts; {trials} random first policies for each number of features; \
                 plain LSPI has at most {MOST_ITERATIONS} evaluations.",
                CENTRE.1
            ),
            "More than the reference: log_γ of the mean of γ^(steps − steps of the reference policy), as in the thesis; \
             it can be negative, since the reference policy is not the best one. Quality: against the optimal number of steps."
                .into(),
            format!(
                "Transitions as in the thesis: moves that no wall stopped, and turns both ways. With blocked moves: all kinds, as they \
                 come in the walk. Responses are taken in the order of their slowness, where moves weigh {weight:.2} times what turns \
                 do: φ200 and φ001 are then equally slow, as they were in the thesis, since they mixed; this walk turns more."
            ),
            "The thesis had 5838 transitions in its smaller set, a little more than half; it prints a curve, of which only what \
             its text says stands here."
                .into(),
        ],
        plots: shown.plots()?,
    })
}

/// All kinds of transitions, training sets and numbers of features.
fn each(features: &[usize]) -> impl Iterator<Item = (Kind, usize, usize)> {
    Kind::ALL
        .into_iter()
        .flat_map(move |kind| (0..2).flat_map(move |set| features.iter().map(move |&d| (kind, set, d))))
}
