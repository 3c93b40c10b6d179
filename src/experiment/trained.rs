//! Features and policies of the thesis's batch pipeline: a video, support vectors, slow features, LSPI.

use std::sync::Arc;

use faer::{Mat, Par};
use serde::{Deserialize, Serialize};

use super::lab::{Data, Lab, Transition, Walked};
use super::pipeline::{LAMBDA, NU, Widths, slow_features};
use super::quality::Quality;
use super::{Bench, ExperimentError};
use crate::evaluate::{Evaluator, Trip};
use crate::policy::{Learned, Reflexes};
use crate::slow::SlowModel;
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
    let frames = lab.video(&walked.poses, bench)?;
    bench.say(&format!("rendered {} frames", frames.ncols()));
    let dictionary = Widths::default().select(frames.as_ref(), training.vectors, bench)?;
    let links = lab.links(&walked, lab.thesis_weight(&walked));
    let (_, model) = slow_features(&dictionary, frames.as_ref(), &links, training.features, bench)?;
    Ok(Trained { lab, walked: Arc::new(walked), frames: Arc::new(frames), model })
}

/// Observations that are projected in one product.
const AT_ONCE: usize = 1024;

impl Trained<'_> {
    /// Features at some frames: `f × n`, the constant one first.
    ///
    /// # Errors
    /// [`ExperimentError::Stopped`].
    pub fn features_at(&self, frames: &[usize], bench: &Bench<'_>) -> Result<Mat<f64>, ExperimentError> {
        let mut phi = Mat::zeros(self.model.features(), frames.len());
        for (part, places) in frames.chunks(AT_ONCE).enumerate() {
            bench.go_on()?;
            let x = Mat::from_fn(self.frames.nrows(), places.len(), |i, j| self.frames[(i, places[j])]);
            let found = self.model.apply(x.as_ref(), bench.scope.par)?;
            phi.as_mut().subcols_mut(part * AT_ONCE, places.len()).copy_from(&found);
        }
        Ok(phi)
    }
}

/// How policy iteration is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Iteration {
    /// As in the thesis, from all actions alike: no ridge, no mixing, no reflexes, and transitions without blocked moves.
    Thesis,
    /// As the agent does it: ridge, mixing and reflexes of the scenario, and blocked moves among the transitions.
    Ours,
}

impl Iteration {
    /// Both.
    pub const ALL: [Iteration; 2] = [Iteration::Thesis, Iteration::Ours];

    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Iteration::Thesis => "the thesis's LSPI",
            Iteration::Ours => "ours: ridge, mixing, reflexes",
        }
    }

    /// Reflexes that go with it.
    pub fn reflexes(self, lab: &Lab) -> Reflexes {
        match self {
            Iteration::Thesis => Reflexes::new(&lab.scenario).off(),
            Iteration::Ours => Reflexes::new(&lab.scenario),
        }
    }

    fn options(self, lab: &Lab) -> LspiOptions {
        let value = &lab.scenario.value;
        let plain = LspiOptions { gamma: value.gamma, max_iterations: value.max_iterations, ..LspiOptions::plain() };
        match self {
            Iteration::Thesis => plain,
            Iteration::Ours => {
                LspiOptions { ridge: value.ridge, mixing: value.mixing, tolerance: value.tolerance, ..plain }
            }
        }
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
    ///
    /// # Errors
    /// [`ExperimentError::Stopped`].
    pub fn new(
        trained: &'a Trained<'a>,
        count: usize,
        iteration: Iteration,
        bench: &Bench<'_>,
    ) -> Result<Self, ExperimentError> {
        let transitions = match iteration {
            Iteration::Thesis => trained.walked.as_in_the_thesis(count),
            Iteration::Ours => trained.walked.spread(count),
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
    ///
    /// # Errors
    /// None for features that are finite.
    pub fn fit(&self, d: usize, task: usize, iteration: Iteration) -> Result<Fit, ExperimentError> {
        let n = self.transitions.len();
        let d = d.min(self.phi.nrows());
        let actions: Vec<usize> = self.transitions.iter().map(|t| t.action.index()).collect();
        let weights = vec![1.0; n];
        let samples = Samples { phi: self.phi.get(..d, ..n), actions: &actions, weights: &weights };
        let rewards = self.walked.rewards(self.lab, task, &self.transitions);
        let reflexes = iteration.reflexes(self.lab);
        let allowed: Vec<u32> = self.transitions.iter().map(|t| reflexes.allowed(t.recent)).collect();
        let outcomes = Outcomes { next: self.next.get(..d, ..n), rewards: &rewards, allowed: Some(&allowed) };
        Ok(Lspi::new(samples, 3, Par::Seq)?.fit(&outcomes, &iteration.options(self.lab))?)
    }
}

/// Trips of a policy over the first features of a model.
///
/// # Errors
/// Weights for more features than the model has.
pub fn trips(
    model: &SlowModel<f32>,
    fit: &Fit,
    (evaluator, task): (&Evaluator, usize),
    reflexes: Reflexes,
) -> Result<Vec<Trip>, ExperimentError> {
    // The features that were left out have no weight.
    let weights =
        Mat::from_fn(model.features(), 3, |i, a| if i < fit.weights.nrows() { fit.weights[(i, a)] } else { 0.0 });
    let learned = Learned::new(1, 0, 0, model.clone(), vec![weights])?;
    Ok(evaluator.trips(task, true, &|situation| {
        // These trips have a camera.
        let none = crate::robot::ActionValues::new([]);
        let values = situation.seen.map_or(none, |seen| learned.q_values(seen, 0));
        reflexes.best(&values, situation.recent).0
    }))
}

/// What a policy over the first features of a model comes to.
///
/// # Errors
/// Those of [`trips`].
pub fn quality(
    trained: &Trained<'_>,
    fit: &Fit,
    from: (&Evaluator, usize),
    reflexes: Reflexes,
    reference: &[Trip],
) -> Result<Quality, ExperimentError> {
    let trips = trips(&trained.model, fit, from, reflexes)?;
    Ok(Quality::of(&trips, reference, trained.lab.scenario.value.gamma))
}
