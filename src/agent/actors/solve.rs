//! The solve actor: turns moments into slow features.

use faer::{Mat, Par};

use super::messages::{FitRequest, Item, SolveRequest};
use super::saved::slow_model;
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::queue::{Inbox, Outbox};
use crate::dictionary::Dictionary;
use crate::scenario;
use crate::slow::{Moments, SlowError, SlowFeatures, SlowModel, SolveOptions, Solver, solve_with};
use crate::snapshot::{Persist, Snapshot, SnapshotError};

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
        let SolveRequest { asked_at, frames, sums, window, goals, marks, .. } = request;
        let model = match &sums {
            Some((dictionary, moments)) => self.solve(dictionary, moments).map_err(|error| error.to_string()),
            None => {
                let last = self.previous.as_ref().map(|solved| solved.model.clone());
                last.ok_or_else(|| "there are no features yet to fit policies on".to_owned())
            }
        };
        FitRequest { asked_at, frames, model, window, goals, marks }
    }

    /// Slow features over a dictionary. Where there are fewer directions than features asked for, as at the start of a run,
    /// there are fewer features.
    fn solve(&mut self, dictionary: &Dictionary<f32>, moments: &Moments) -> Result<SlowModel<f32>, SlowError> {
        let features = self.settings.features.min(moments.size());
        let previous = self.previous.as_ref().and_then(|solved| solved.over(dictionary));
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
    /// The features over a dictionary that may have grown, and lost support vectors, since; none over one that began anew with another kernel.
    fn over(&self, dictionary: &Dictionary<f32>) -> Option<SlowFeatures> {
        if dictionary.kernel() != self.model.kernel {
            return None;
        }
        let mut features = self.features.clone();
        if !dictionary.serials().starts_with(&self.serials) {
            features.weights = self.model.weights_over(dictionary).ok()?;
        }
        Some(features)
    }
}

impl Persist for Solve {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let room = |rows: usize, columns: usize| (rows, columns);
        let of = self.previous.as_ref();
        let mut serials = of.map(|of| of.serials.clone());
        snapshot.value("serials", &mut serials)?;
        let Some(serials) = serials else { return Ok(()) };
        let mut weights = of.map_or(Mat::new(), |of| of.features.weights.clone());
        let mut mean = of.map_or(Mat::new(), |of| of.features.mean.clone());
        let mut slowness = of.map_or(Vec::new(), |of| of.features.slowness.clone());
        let mut lambda = of.map_or(0.0, |of| of.features.lambda);
        let mut model = of.map(|of| of.model.clone());
        snapshot.matrix("weights", &mut weights, room)?;
        snapshot.matrix("mean", &mut mean, room)?;
        snapshot.numbers("slowness", &mut slowness)?;
        snapshot.number("lambda", &mut lambda)?;
        slow_model(snapshot, "model", &mut model)?;
        if snapshot.is_restoring() {
            let fits = weights.nrows() == serials.len() && mean.nrows() == serials.len();
            snapshot.check("weights", fits, "another number of rows than of support vectors")?;
            let Some(model) = model else { return snapshot.check("model", false, "there is none") };
            // How the earlier solution was found is of no use to the next one.
            let solver = Solver::Lanczos { applied: 0, residual: 0.0 };
            let features = SlowFeatures { weights, mean, slowness, lambda, solver };
            self.previous = Some(Solved { features, model, serials });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dictionary::{Ald, Parameters, WhenFull};
    use crate::kernel::Kernel;
    use crate::random::stream;
    use crate::scenario::Scenario;
    use crate::slow::{Link, SlowStream, StreamOptions};
    use rand::RngExt;

    /// With the settings of the lab.
    fn solver() -> Solve {
        let text = include_str!("../../../scenarios/lab.toml");
        let scenario = Scenario::parse(text, std::path::Path::new("lab.toml"), &[]).unwrap();
        Solve::new(&scenario.slow, Par::Seq)
    }

    /// What is made of a run that sees the given views, one a frame.
    fn solved(views: &[usize], seed: u64) -> (Result<SlowModel<f32>, String>, Mat<f32>) {
        let (request, x) = request(views, seed, 2.0);
        (solver().step(request).model, x)
    }

    fn request(views: &[usize], seed: u64, sigma: f64) -> (SolveRequest, Mat<f32>) {
        let mut pixels = stream(seed, "views");
        let pictures = Mat::from_fn(30, 100, |_, _| pixels.random_range(0.0..1.0f32));
        let x = Mat::from_fn(30, views.len(), |i, t| pictures[(i, views[t])]);
        let kernel = Kernel::gaussian(sigma).unwrap();
        let parameters = Parameters { kernel, nu: 1e-3, budget: 300, when_full: WhenFull::Stop, par: Par::Seq };
        let mut frames = SlowStream::new(Ald::<f32>::new(parameters).unwrap(), StreamOptions::default()).unwrap();
        frames.push(x.as_ref(), &Link::regular(views.len(), 0.1).unwrap()).unwrap();
        let moments = frames.settled_moments().unwrap().clone();
        let sums = Some((frames.dictionary().clone(), moments));
        let request = SolveRequest {
            asked_at: 0,
            stamp_ns: 0,
            frames: 0,
            sums,
            window: Vec::new(),
            goals: Vec::new(),
            marks: Vec::new(),
        };
        (request, x)
    }

    /// Numbers of support vectors begin at 0 again then, so that those of the model before are others with the same numbers.
    #[test]
    fn nothing_is_aligned_with_a_model_of_another_kernel() {
        let views: Vec<usize> = (0..600).map(|t| (t * t + t / 7) % 60).collect();
        let mut solve = solver();
        let before = solve.step(request(&views, 1, 2.0).0).model.unwrap();
        let begun_anew = solve.step(request(&views, 1, 3.0).0).model.unwrap();
        let fresh = solver().step(request(&views, 1, 3.0).0).model.unwrap();
        assert_ne!(before.projection, fresh.projection);
        assert_eq!(begun_anew.projection, fresh.projection);
    }

    /// `n` views differ in `n − 1` directions from their mean, while the dictionary has `n` support vectors: a short run, a
    /// camera that is stuck, a lamp that flickers in a dark room.
    #[test]
    fn a_model_has_as_many_features_as_there_are_directions() {
        for seed in 0..20 {
            for (different, frames) in [(2, 2), (2, 300), (3, 200), (7, 90), (20, 21), (50, 50), (50, 500)] {
                let views: Vec<usize> = (0..frames).map(|t| t % different).collect();
                let (model, x) = solved(&views, seed);
                let model = model.unwrap();
                assert_eq!(model.slowness.len(), different - 1, "{different} views, {frames} frames, seed {seed}");
                assert!(model.slowness.iter().all(|slowness| (0.0..1e6).contains(slowness)));
                let phi = model.apply(x.as_ref(), Par::Seq).unwrap();
                let products = &phi * phi.transpose() * faer::Scale(1.0 / frames as f64);
                let error = (products - Mat::<f64>::identity(different, different)).norm_max();
                assert!(error < 1e-4, "{different} views, {frames} frames, seed {seed}: off by {error}");
            }
            let (model, _) = solved(&[5; 100], seed);
            assert!(model.unwrap_err().contains("span 0 directions"), "a camera that is frozen");
        }
    }
}
