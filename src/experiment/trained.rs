//! Features and policies of the thesis's batch pipeline: a video, support vectors, slow features, LSPI.

use std::sync::Arc;

use faer::{Mat, MatRef, Par};
use serde::{Deserialize, Serialize};

use super::lab::{Data, Lab, Transition, Walked};
use super::pipeline::{LAMBDA, NU, Widths, slow_features};
use super::quality::driven;
use super::{Bench, ExperimentError};
use crate::evaluate::{Evaluator, Trip};
use crate::policy::{Learned, Reflexes};
use crate::robot::Pose;
use crate::slow::{Link, SlowModel};
use crate::value::{Fit, Lspi, LspiOptions, Outcomes, Samples};

/// What slow features are made of.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Training {
    /// World and walk.
    pub data: Data,
    /// Support vectors that are aimed at.
    pub vectors: usize,
    /// Slow features.
    pub features: usize,
    /// Moves weigh so much more than turns that two half waves along x are as slow as one turn of the heading.
    weighted_as_in_the_thesis: bool,
    nu: f64,
    lambda: f64,
}

impl Training {
    /// Features of a walk of some actions through a lab.
    pub fn new(lab: &Lab, actions: usize, vectors: usize, features: usize) -> Self {
        Training {
            data: Data::new(lab, actions),
            vectors,
            features,
            weighted_as_in_the_thesis: true,
            nu: NU,
            lambda: LAMBDA,
        }
    }
}

/// A lab with slow features of its video.
pub struct Trained<'a> {
    /// The lab.
    pub lab: &'a Lab,
    /// The way of the video.
    pub walked: Arc<Walked>,
    /// The video, `d × n`.
    pub frames: Arc<Mat<f32>>,
    /// Its slow features.
    pub model: SlowModel<f32>,
}

/// Make the video and its slow features.
///
/// # Errors
/// No kernel width gives that many support vectors; [`ExperimentError::Stopped`].
pub fn train<'a>(lab: &'a Lab, training: &Training, bench: &Bench<'_>) -> Result<Trained<'a>, ExperimentError> {
    let walked = lab.walk(training.data.actions);
    let links = lab.links(&walked, lab.thesis_weight(&walked.steps()));
    let (frames, model) = seen(lab, &walked.poses, &links, (training.vectors, training.features), bench)?;
    Ok(Trained { lab, walked: Arc::new(walked), frames: Arc::new(frames), model })
}

/// What the camera sees at some poses, and slow features of it: about so many support vectors, so many features.
pub fn seen(
    lab: &Lab,
    poses: &[Pose],
    links: &[Option<Link>],
    (vectors, features): (usize, usize),
    bench: &Bench<'_>,
) -> Result<(Mat<f32>, SlowModel<f32>), ExperimentError> {
    let frames = lab.video(poses, bench)?;
    bench.say(&format!("rendered {} frames", frames.ncols()));
    let model = learned(frames.as_ref(), links, (vectors, features), bench)?;
    Ok((frames, model))
}

/// Slow features of frames, `d × n`: about so many support vectors, so many features.
pub fn learned(
    frames: MatRef<'_, f32>,
    links: &[Option<Link>],
    (vectors, features): (usize, usize),
    bench: &Bench<'_>,
) -> Result<SlowModel<f32>, ExperimentError> {
    let dictionary = Widths::default().select(frames, vectors, bench)?;
    Ok(slow_features(&dictionary, frames, links, features, bench)?.1)
}

/// Features of many frames, `f × n`, the constant one first; a block at a time.
pub fn apply(model: &SlowModel<f32>, x: MatRef<'_, f32>, bench: &Bench<'_>) -> Result<Mat<f64>, ExperimentError> {
    const AT_ONCE: usize = 1024;
    let mut phi = Mat::zeros(model.features(), x.ncols());
    for start in (0..x.ncols()).step_by(AT_ONCE) {
        bench.go_on()?;
        let count = AT_ONCE.min(x.ncols() - start);
        let found = model.apply(x.subcols(start, count), bench.scope.par)?;
        phi.as_mut().subcols_mut(start, count).copy_from(&found);
    }
    Ok(phi)
}

/// Features with the constant one before them.
pub fn with_one(features: &Mat<f64>) -> Mat<f64> {
    Mat::from_fn(features.nrows() + 1, features.ncols(), |i, j| if i == 0 { 1.0 } else { features[(i - 1, j)] })
}

/// What each action is worth by features that lack the constant one.
pub fn worths(weights: &Mat<f64>, features: &Mat<f64>) -> [f64; 3] {
    [0, 1, 2].map(|a| {
        let weights = weights.col(a);
        weights[0] + (1..weights.nrows()).map(|i| weights[i] * features[(i - 1, 0)]).sum::<f64>()
    })
}

impl Trained<'_> {
    /// Features at some frames: `f × n`, the constant one first.
    pub fn features_at(&self, frames: &[usize], bench: &Bench<'_>) -> Result<Mat<f64>, ExperimentError> {
        let x = Mat::from_fn(self.frames.nrows(), frames.len(), |i, j| self.frames[(i, frames[j])]);
        apply(&self.model, x.as_ref(), bench)
    }
}

/// How policy iteration is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Iteration {
    /// As in the thesis, from all actions alike: no ridge, no mixing, no reflexes, and transitions without blocked moves.
    Thesis,
    /// As the next one, but without reflexes, in the iteration and while driving.
    Alone,
    /// As the agent does it: ridge, mixing and reflexes of the scenario, and blocked moves among the transitions.
    Ours,
}

impl Iteration {
    /// The thesis's and the agent's.
    pub const BOTH: [Iteration; 2] = [Iteration::Thesis, Iteration::Ours];
    /// All of them.
    pub const ALL: [Iteration; 3] = [Iteration::Thesis, Iteration::Alone, Iteration::Ours];

    /// In words.
    pub fn name(self) -> &'static str {
        ["the thesis's LSPI", "ours without reflexes", "ours: ridge, mixing, reflexes"][self as usize]
    }

    /// Reflexes that go with it.
    pub fn reflexes(self, lab: &Lab) -> Reflexes {
        let reflexes = Reflexes::new(&lab.scenario);
        if self == Iteration::Ours { reflexes } else { reflexes.off() }
    }

    /// Its options.
    pub fn options(self, lab: &Lab) -> LspiOptions {
        let value = &lab.scenario.value;
        let plain = LspiOptions { gamma: value.gamma, max_iterations: value.max_iterations, ..LspiOptions::plain() };
        if self == Iteration::Thesis {
            return plain;
        }
        LspiOptions { ridge: value.ridge, mixing: value.mixing, tolerance: value.tolerance, ..plain }
    }
}

/// Some transitions of a walk in features, ready for policy iteration.
pub struct Sampled<'a> {
    lab: &'a Lab,
    walked: &'a Walked,
    transitions: Vec<Transition>,
    phi: Mat<f64>,
    next: Mat<f64>,
}

impl<'a> Sampled<'a> {
    /// About `count` transitions of the walk of a trained lab: for the thesis's iteration those that it took, for ours all
    /// kinds, since the agent learns from blocked moves, too.
    pub fn new(
        trained: &'a Trained<'a>,
        count: usize,
        iteration: Iteration,
        bench: &Bench<'_>,
    ) -> Result<Self, ExperimentError> {
        let transitions = match iteration {
            Iteration::Thesis => trained.walked.as_in_the_thesis(count),
            _ => trained.walked.spread(count),
        };
        let at = |frame: fn(&Transition) -> usize| transitions.iter().map(frame).collect::<Vec<usize>>();
        let phi = trained.features_at(&at(|t| t.from), bench)?;
        let next = trained.features_at(&at(|t| t.to), bench)?;
        Ok(Sampled { lab: trained.lab, walked: &trained.walked, transitions, phi, next })
    }

    /// All transitions of a walk, by the features of its frames: `f × n`, the constant one first.
    pub fn whole(lab: &'a Lab, walked: &'a Walked, frames: &Mat<f64>) -> Self {
        let n = frames.ncols() - 1;
        let (phi, next) = (frames.subcols(0, n).to_owned(), frames.subcols(1, n).to_owned());
        Sampled { lab, walked, transitions: walked.spread(n), phi, next }
    }

    /// A policy for a task over the first `d` features.
    pub fn fit(&self, d: usize, task: usize, iteration: Iteration) -> Result<Fit, ExperimentError> {
        let n = self.transitions.len();
        let d = d.min(self.phi.nrows());
        let actions: Vec<usize> = self.transitions.iter().map(|t| t.action.index()).collect();
        let weights = vec![1.0; n];
        let samples = Samples { phi: self.phi.get(..d, ..n), actions: &actions, weights: &weights };
        let rewards = self.lab.rewards(task, &self.walked.poses, &self.transitions);
        let reflexes = iteration.reflexes(self.lab);
        let allowed: Vec<u32> = self.transitions.iter().map(|t| reflexes.allowed(t.recent)).collect();
        let outcomes = Outcomes { next: self.next.get(..d, ..n), rewards: &rewards, allowed: Some(&allowed) };
        Ok(Lspi::new(samples, 3, Par::Seq)?.fit(&outcomes, &iteration.options(self.lab))?)
    }
}

/// Trips of a policy over the first features of a model.
pub fn trips(
    model: &SlowModel<f32>,
    fit: &Fit,
    (evaluator, task): (&Evaluator, usize),
    reflexes: Reflexes,
) -> Result<Vec<Trip>, ExperimentError> {
    // The features that were left out have no weight.
    let weights =
        Mat::from_fn(model.features(), 3, |i, a| if i < fit.weights.nrows() { fit.weights[(i, a)] } else { 0.0 });
    Ok(driven(evaluator, task, &Learned::new(1, 0, 0, model.clone(), vec![weights])?, 0, reflexes))
}
