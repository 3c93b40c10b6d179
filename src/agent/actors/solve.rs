//! The solve actor: turns moments into slow features.

use faer::{Mat, Par};

use super::messages::{FitRequest, Item, SolveRequest};
use super::saved::slow_model;
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::queue::{Inbox, Outbox};
use crate::dictionary::Dictionary;
use crate::parts::{Parts, PartsError, Persist};
use crate::scenario;
use crate::slow::{Moments, SlowError, SlowFeatures, SlowModel, SolveOptions, Solver, solve_with};

/// The solver; it keeps its last solution to align the next one with.
pub struct Solve {
    settings: scenario::Slow,
    options: SolveOptions,
    previous: Option<Solved>,
}

/// A solution, in both of its forms, and the support vectors it stands on.
struct Solved {
    features: SlowFeatures,
    model: SlowModel<f32>,
    serials: Vec<usize>,
}

impl Solve {
    /// A solver for the settings of a scenario. `par`: threads for its products.
    pub fn new(settings: &scenario::Slow, par: Par) -> Self {
        let options = SolveOptions { par, ..SolveOptions::default() };
        Solve { settings: settings.clone(), options, previous: None }
    }

    /// Its loop, until there are no more requests: how long solving took.
    pub fn run(mut self, requests: &Inbox<Item<SolveRequest>>, solved: &Outbox<Item<FitRequest>>) -> Clock {
        let mut clock = Clock::new();
        while let Ok(item) = requests.take() {
            let done = match item {
                Item::Work(request) => Item::Work(clock.time(|| self.step(request))),
                Item::Save(marker) => match marker.with("solve", &mut self) {
                    Some(marker) => Item::Save(marker),
                    None => continue,
                },
            };
            if solved.put(done).is_err() {
                break;
            }
        }
        clock
    }

    /// Slow features for a request, or the last ones again if it brings nothing to make new ones of.
    pub fn step(&mut self, request: SolveRequest) -> FitRequest {
        let SolveRequest { asked_at, frames, sums, window, goals, .. } = request;
        let model = match &sums {
            Some((dictionary, moments)) => self.solve(dictionary, moments).map_err(|error| error.to_string()),
            None => {
                let last = self.previous.as_ref().map(|solved| solved.model.clone());
                last.ok_or_else(|| "there are no features yet to fit policies on".to_owned())
            }
        };
        FitRequest { asked_at, frames, model, window, goals }
    }

    /// Slow features over a dictionary. Where there are fewer directions than features asked for, as at the start of a run,
    /// there are fewer features.
    fn solve(&mut self, dictionary: &Dictionary<f32>, moments: &Moments) -> Result<SlowModel<f32>, SlowError> {
        let features = self.settings.features.min(moments.size());
        let previous = self.previous.as_ref().and_then(|solved| solved.over(dictionary).ok());
        let solve = |k| solve_with(moments, k, self.settings.lambda, previous.as_ref(), &self.options);
        let features = match solve(features) {
            Err(SlowError::Features { rank, .. }) if rank > 0 => solve(rank),
            other => other,
        }?;
        let model = SlowModel::new(dictionary, &features)?;
        let serials = dictionary.serials().to_vec();
        self.previous = Some(Solved { features, model: model.clone(), serials });
        Ok(model)
    }
}

impl Solved {
    /// The features over a dictionary that may have grown, and lost support vectors, since.
    fn over(&self, dictionary: &Dictionary<f32>) -> Result<SlowFeatures, SlowError> {
        let mut features = self.features.clone();
        if !dictionary.serials().starts_with(&self.serials) {
            features.weights = self.model.weights_over(dictionary)?;
        }
        Ok(features)
    }
}

impl Persist for Solve {
    fn persist(&mut self, parts: &mut Parts) -> Result<(), PartsError> {
        let room = |rows: usize, columns: usize| (rows, columns);
        let of = self.previous.as_ref();
        let mut serials = of.map(|of| of.serials.clone());
        parts.value("serials", &mut serials)?;
        let Some(serials) = serials else { return Ok(()) };
        let mut weights = of.map_or(Mat::new(), |of| of.features.weights.clone());
        let mut mean = of.map_or(Mat::new(), |of| of.features.mean.clone());
        let mut slowness = of.map_or(Vec::new(), |of| of.features.slowness.clone());
        let mut lambda = of.map_or(0.0, |of| of.features.lambda);
        let mut model = of.map(|of| of.model.clone());
        parts.matrix("weights", &mut weights, room)?;
        parts.matrix("mean", &mut mean, room)?;
        parts.numbers("slowness", &mut slowness)?;
        parts.number("lambda", &mut lambda)?;
        slow_model(parts, "model", &mut model)?;
        if parts.is_restoring() {
            let fits = weights.nrows() == serials.len() && mean.nrows() == serials.len();
            parts.check("weights", fits, "another number of rows than of support vectors")?;
            let Some(model) = model else { return parts.check("model", false, "there is none") };
            // How the earlier solution was found is of no use to the next one.
            let solver = Solver::Lanczos { applied: 0, residual: 0.0 };
            let features = SlowFeatures { weights, mean, slowness, lambda, solver };
            self.previous = Some(Solved { features, model, serials });
        }
        Ok(())
    }
}
