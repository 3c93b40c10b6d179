//! The actor that turns moments into slow features.

use super::messages::{FitRequest, SolveRequest};
use crate::scenario;
use crate::slow::{SlowError, SlowFeatures, SlowModel, solve};

/// The solver; it keeps its last solution to align the next one with.
pub struct Solve {
    settings: scenario::Slow,
    previous: Option<SlowFeatures>,
}

impl Solve {
    /// A solver for the settings of a scenario.
    pub fn new(settings: &scenario::Slow) -> Self {
        Solve { settings: settings.clone(), previous: None }
    }

    /// Slow features over the request's dictionary. Where there are fewer directions than features asked for, as at the start
    /// of a run, there are fewer features.
    pub fn step(&mut self, request: SolveRequest) -> FitRequest {
        let features = self.settings.features.min(request.moments.size());
        // Features that cannot follow the dictionary give nothing to align with.
        self.previous = self.previous.take().and_then(|mut previous| {
            request.thinnings.iter().all(|thinning| previous.follow(thinning).is_ok()).then_some(previous)
        });
        let solved = match self.solve(&request, features) {
            Err(SlowError::Features { rank, .. }) if rank > 0 => self.solve(&request, rank),
            other => other,
        };
        let model = solved.and_then(|features| {
            let model = SlowModel::new(&request.dictionary, &features)?;
            self.previous = Some(features);
            Ok(model)
        });
        let model = model.map_err(|error| error.to_string());
        FitRequest { asked_at: request.asked_at, frames: request.frames, model, window: request.window }
    }

    fn solve(&self, request: &SolveRequest, features: usize) -> Result<SlowFeatures, SlowError> {
        solve(&request.moments, features, self.settings.lambda, self.previous.as_ref())
    }
}
