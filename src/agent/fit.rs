//! The actor that fits policies on new features, for all tasks from the same window of transitions.
//!
//! Policy iteration knows the reflexes: what may follow an action is all that it counts on. Without that, the greedy policy
//! turns a little too far, because it believes that it may turn back, and the reflexes then send it round the whole circle.

use std::collections::BTreeMap;
use std::sync::Arc;

use faer::{Mat, Par};

use super::messages::{FitRequest, Update};
use crate::policy::{Learned, Recent, Reflexes, columns};
use crate::scenario::Scenario;
use crate::slow::{SlowError, SlowModel};
use crate::value::{Fit, Lspi, LspiOptions, Outcomes, Samples, Transition, ValueError, balance};
use crate::vision::Observation;
use crate::world::Action;

/// Observations that are projected in one product, so that memory stays bounded.
const PROJECT_AT_ONCE: usize = 2048;

/// Least-squares policy iteration over the window.
pub struct FitPolicies {
    scenario: Arc<Scenario>,
    reflexes: Reflexes,
    epoch: u32,
}

impl FitPolicies {
    /// A fitter for the tasks of a scenario.
    pub fn new(scenario: Arc<Scenario>) -> Self {
        FitPolicies { reflexes: Reflexes::new(&scenario.policy), scenario, epoch: 0 }
    }

    /// Policies for a new model. Nothing of an older model is used: the whole window is projected again.
    pub fn step(&mut self, request: FitRequest) -> Update {
        let transitions = request.window.len();
        let fitted = request.model.and_then(|model| {
            let projected = Projection::new(&model, &request.window).map_err(|error| error.to_string())?;
            let fits = self.fit(&projected, &request.window).map_err(|error| error.to_string())?;
            Ok((model, fits))
        });
        let (learned, fits) = match fitted {
            Err(reason) => (Err(reason), Vec::new()),
            Ok((model, fits)) => {
                self.epoch += 1;
                let weights = fits.iter().map(|fit| fit.weights.clone()).collect();
                let (epoch, asked_at, frames) = (self.epoch, request.asked_at, request.frames);
                (Ok(Arc::new(Learned { epoch, asked_at, frames, model, weights })), fits)
            }
        };
        Update { asked_at: request.asked_at, learned, fits, transitions }
    }

    fn fit(&self, projected: &Projection, window: &[Transition<Arc<Observation>>]) -> Result<Vec<Fit>, ValueError> {
        let settings = &self.scenario.value;
        let from: Vec<usize> = window.iter().map(|t| projected.place[&t.from.frame]).collect();
        let to: Vec<usize> = window.iter().map(|t| projected.place[&t.to.frame]).collect();
        let column =
            |places: &[usize]| Mat::from_fn(projected.phi.nrows(), places.len(), |i, j| projected.phi[(i, places[j])]);
        let (phi, next) = (column(&from), column(&to));
        let actions: Vec<usize> = window.iter().map(|t| t.action).collect();
        let groups: Vec<(usize, usize)> =
            from.iter().zip(&actions).map(|(&place, &action)| (projected.cell[place], action)).collect();
        let weights = balance(&groups, settings.balance)?;
        let samples = Samples { phi: phi.as_ref(), actions: &actions, weights: &weights };
        let problem = Lspi::new(samples, Action::ALL.len(), Par::Seq)?;
        let options = LspiOptions {
            gamma: settings.gamma,
            ridge: settings.ridge,
            mixing: settings.mixing,
            max_iterations: settings.max_iterations,
            tolerance: settings.tolerance,
            ..LspiOptions::default()
        };
        let allowed: Vec<u32> = window.iter().map(|t| self.allowed_after(t)).collect();
        let tasks = self.scenario.tasks.iter().enumerate();
        tasks
            .map(|(number, task)| {
                let rewards: Vec<f64> = window.iter().map(|t| t.rewards[number]).collect();
                let outcomes = Outcomes { next: next.as_ref(), rewards: &rewards, allowed: Some(&allowed) };
                if !task.absorbing {
                    return problem.fit(&outcomes, &options);
                }
                let until_goal = Mat::from_fn(next.nrows(), next.ncols(), |i, j| {
                    if window[j].reached[number] { 0.0 } else { next[(i, j)] }
                });
                problem.fit(&Outcomes { next: until_goal.as_ref(), ..outcomes }, &options)
            })
            .collect()
    }

    /// The actions that the reflexes let follow a transition, as bits.
    fn allowed_after(&self, transition: &Transition<Arc<Observation>>) -> u32 {
        let recent = Recent { action: Some(Action::ALL[transition.action]), blocked: transition.blocked };
        Action::ALL
            .into_iter()
            .filter(|&action| self.reflexes.allow(action, recent))
            .fold(0, |bits, action| bits | 1 << action.index())
    }
}

/// The window's observations in features, each once although two transitions share it.
struct Projection {
    /// Column of a frame.
    place: BTreeMap<u64, usize>,
    /// `f × n`.
    phi: Mat<f64>,
    /// Nearest support vector of each observation.
    cell: Vec<usize>,
}

impl Projection {
    fn new(model: &SlowModel<f32>, window: &[Transition<Arc<Observation>>]) -> Result<Self, SlowError> {
        let unique: BTreeMap<u64, &Arc<Observation>> =
            window.iter().flat_map(|t| [&t.from, &t.to]).map(|seen| (seen.frame, seen)).collect();
        let place = unique.keys().enumerate().map(|(column, &frame)| (frame, column)).collect();
        let seen: Vec<&Observation> = unique.values().map(|seen| seen.as_ref()).collect();
        let mut phi = Mat::zeros(model.features(), seen.len());
        let mut cell = Vec::with_capacity(seen.len());
        for (index, part) in seen.chunks(PROJECT_AT_ONCE).enumerate() {
            let rows = model.kernel_rows(columns(part.iter().copied()).as_ref(), Par::Seq)?;
            let features = model.apply_to_rows(rows.as_ref(), Par::Seq)?;
            phi.as_mut().subcols_mut(index * PROJECT_AT_ONCE, part.len()).copy_from(&features);
            cell.extend((0..part.len()).map(|j| {
                let largest =
                    |best: (usize, f64), i: usize| if rows[(i, j)] > best.1 { (i, rows[(i, j)]) } else { best };
                (0..rows.nrows()).fold((0, f64::NEG_INFINITY), largest).0
            }));
        }
        Ok(Projection { place, phi, cell })
    }
}
