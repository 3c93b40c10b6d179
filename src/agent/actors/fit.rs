//! The fit actor: policies on new features, for all tasks from the same window of transitions.
//!
//! Values know the reflexes: what may follow an action is all that they count on. Without that, the greedy policy
//! turns a little too far, because it believes that it may turn back, and the reflexes then send it round the whole circle.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::Arc;

use faer::{Mat, Par};
use rayon::prelude::*;

use super::kernel_rows::KernelRows;
use super::messages::{FitRequest, Item, Marked, TaskTransition, Update};
use super::record::{Level, Recorder};
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::queue::{Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::gpu::Choice;
use crate::policy::{GoalRegion, Learned, columns, points};
use crate::robot::ActionSet;
use crate::scenario::{Method, Scenario, Task};
use crate::slow::{SlowError, SlowModel};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::value::{
    Fit, Instances, Local, LocalOptions, LocalOutcomes, Lspi, LspiOptions, MapStep, MetricMap, Outcomes, Samples,
    ValueError, balance, greedy,
};
use crate::vision::Observation;

/// Observations that are projected in one product: their products and kernel values take `12 · 512 · m` bytes, and what a device is at
/// twice as much again.
const PROJECT_AT_ONCE: usize = 512;

/// Values of all tasks from the window.
pub struct FitPolicies {
    scenario: Arc<Scenario>,
    par: Par,
    rows: KernelRows,
    epoch: u32,
}

impl FitPolicies {
    /// A fitter for the tasks of a scenario; its results do not depend on `par`.
    pub fn new(scenario: Arc<Scenario>, par: Par) -> Self {
        FitPolicies { rows: KernelRows::new(scenario.agent.compute), scenario, par, epoch: 0 }
    }

    /// Who computes the kernel values of the window, as far as there was a choice.
    pub fn kernel_values_by(&self) -> Option<Choice> {
        self.rows.choice()
    }

    /// Policies for a new model. Nothing of an older model is used: the whole window is projected again.
    pub fn step(&mut self, request: FitRequest) -> Update {
        let transitions = request.window.len();
        let fitted = request.model.and_then(|model| {
            let projected = Projection::new(&model, &request.window, &mut self.rows, self.par);
            let projected = projected.map_err(|error| error.to_string())?;
            let shown = Shown::new(&self.scenario, &model, &projected, &request.window, &request.marks, self.par)?;
            let (epoch, asked_at, frames) = (self.epoch + 1, request.asked_at, request.frames);
            let weights_of = |fits: &[Fit]| fits.iter().map(|fit| fit.weights.clone()).collect();
            let (learned, fits) = match self.scenario.value.method {
                Method::Lspi => {
                    let fits = self.fit(&projected, &request.window, &shown).map_err(|error| error.to_string())?;
                    (Learned::new(epoch, asked_at, frames, model, weights_of(&fits)), fits)
                }
                Method::Local => {
                    let found = self.fit_locally(&model, &projected, &request.window, &shown);
                    let (instances, fits) = found.map_err(|error| error.to_string())?;
                    (Learned::local(epoch, asked_at, frames, model, instances, weights_of(&fits)), fits)
                }
            };
            let learned = learned.and_then(|learned| learned.for_goals(request.goals).with_regions(shown.regions));
            Ok((Arc::new(learned.map_err(|error| error.to_string())?), fits))
        });
        let (learned, fits) = match fitted {
            Err(reason) => (Err(reason), Vec::new()),
            Ok((learned, fits)) => {
                self.epoch = learned.epoch;
                (Ok(learned), fits)
            }
        };
        Update { asked_at: request.asked_at, learned, fits, transitions }
    }

    /// Local values: where actions were tried, those of the first action first, and what each transition is worth.
    fn fit_locally(
        &self,
        model: &SlowModel<f32>,
        projected: &Projection,
        window: &[TaskTransition],
        shown: &Shown,
    ) -> Result<(Arc<Instances>, Vec<Fit>), ValueError> {
        let settings = &self.scenario.value;
        let mut sorted: Vec<&TaskTransition> = window.iter().collect();
        sorted.sort_by_key(|t| t.action);
        let actions = self.scenario.robot.actions();
        let counts = actions.iter().map(|a| sorted.iter().filter(|t| t.action == a.index()).count()).collect();
        let points = points(model, projected.phi.as_ref(), settings.metric_features);
        let at = |place: &dyn Fn(&TaskTransition) -> u64| {
            let places: Vec<usize> = sorted.iter().map(|t| projected.place[&place(t)]).collect();
            Mat::from_fn(points.nrows(), places.len(), |i, j| points[(i, places[j])])
        };
        let options = LocalOptions { neighbours: settings.neighbours, ridge: settings.local_ridge };
        let instances = Arc::new(Instances::new(at(&|t| t.from.frame), counts, options)?);
        let local = Local::new(&instances, at(&|t| t.to.frame).as_ref())?;
        let allowed: Vec<u32> = sorted.iter().map(|t| t.allowed).collect();
        let fit = |(number, task): (usize, &Task)| {
            let outcomes: Vec<(f64, bool)> = sorted.iter().map(|t| shown.outcome(projected, t, number, task)).collect();
            let rewards: Vec<f64> = outcomes.iter().map(|outcome| outcome.0).collect();
            let ended: Vec<bool> = outcomes.iter().map(|outcome| task.absorbing && outcome.1).collect();
            local.fit(&LocalOutcomes { rewards: &rewards, allowed: &allowed, ended: &ended }, settings.gamma)
        };
        let fits: Result<Vec<Fit>, ValueError> = self.scenario.tasks.iter().enumerate().map(fit).collect();
        fits.map(|fits| (instances.clone(), fits))
    }

    /// Linear values, by least-squares policy iteration.
    fn fit(&self, projected: &Projection, window: &[TaskTransition], shown: &Shown) -> Result<Vec<Fit>, ValueError> {
        let settings = &self.scenario.value;
        let from: Vec<usize> = window.iter().map(|t| projected.place[&t.from.frame]).collect();
        let to: Vec<usize> = window.iter().map(|t| projected.place[&t.to.frame]).collect();
        let (phi, next) = (projected.features_at(&from), projected.features_at(&to));
        let actions: Vec<usize> = window.iter().map(|t| t.action).collect();
        let groups: Vec<(usize, usize)> =
            from.iter().zip(&actions).map(|(&place, &action)| (projected.cell[place], action)).collect();
        let weights = balance(&groups, settings.balance)?;
        let samples = Samples { phi: phi.as_ref(), actions: &actions, weights: &weights };
        let problem = Lspi::new(samples, self.scenario.robot.actions().len(), self.par)?;
        let options = LspiOptions {
            gamma: settings.gamma,
            ridge: settings.ridge,
            mixing: settings.mixing,
            max_iterations: settings.max_iterations,
            tolerance: settings.tolerance,
            ..LspiOptions::plain()
        };
        let allowed: Vec<u32> = window.iter().map(|t| t.allowed).collect();
        let fit = |(number, task): (usize, &Task)| {
            let came_to: Vec<(f64, bool)> = window.iter().map(|t| shown.outcome(projected, t, number, task)).collect();
            let rewards: Vec<f64> = came_to.iter().map(|outcome| outcome.0).collect();
            let outcomes = Outcomes { next: next.as_ref(), rewards: &rewards, allowed: Some(&allowed) };
            if !task.absorbing {
                return problem.fit(&outcomes, &options);
            }
            let mut until_goal = next.clone();
            for (j, _) in came_to.iter().enumerate().filter(|(_, outcome)| outcome.1) {
                until_goal.col_mut(j).fill(0.0);
            }
            problem.fit(&Outcomes { next: until_goal.as_ref(), ..outcomes }, &options)
        };
        let tasks = &self.scenario.tasks;
        // The first feature is constant: Q-values of an action that was never tried are −∞, and no policy takes it.
        let fit = |task: (usize, &Task)| {
            fit(task).map(|mut fit| {
                fit.untried.iter().for_each(|&action| fit.weights[(0, action)] = f64::NEG_INFINITY);
                fit
            })
        };
        let fits: Vec<Result<Fit, ValueError>> = match self.par {
            Par::Seq => tasks.iter().enumerate().map(fit).collect(),
            _ => tasks.par_iter().enumerate().map(fit).collect(),
        };
        fits.into_iter().collect()
    }
}

impl Persist for FitPolicies {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.value("epoch", &mut self.epoch)
    }
}

/// What the fit actor is connected to.
pub struct FitLoop<'a> {
    pub requests: Inbox<Item<FitRequest>>,
    pub updates: Outbox<Update>,
    pub save: Outbox<Item<Infallible>>,
    pub record: Recorder,
    pub status: &'a Status,
    /// Whether a graphics processor that fails goes into the log.
    pub reports_device: bool,
}

impl FitLoop<'_> {
    /// Fit until there are no more requests: how long fitting took, and who computed the kernel values.
    pub fn run(self, mut fit: FitPolicies) -> (Clock, Option<Choice>) {
        let (mut clock, mut reports) = (Clock::new(), self.reports_device);
        while let Ok(item) = self.requests.take() {
            let sent = match item {
                Item::Work(request) => {
                    let update = clock.time(|| fit.step(request));
                    if let Some(failed) = fit.kernel_values_by().and_then(|by| by.failed).filter(|_| reports) {
                        reports = false;
                        let text = format!("kernel values: {failed}; the processor goes on");
                        let _ = self.record.diagnostic(Level::Warn, self.status.now().stamp_ns, text);
                    }
                    self.updates.put(update)
                }
                Item::Save(marker) => match marker.with("fit", &mut fit) {
                    Some(marker) => self.save.put(Item::Save(marker)),
                    None => continue,
                },
            };
            if sent.is_err() {
                break;
            }
        }
        (clock, fit.kernel_values_by())
    }
}

/// What counts as being at the goals that were shown.
struct Shown {
    /// By task; `None` where none was shown. Empty without tasks of this kind.
    regions: Vec<Option<GoalRegion>>,
    /// By task, whether each observation of the window lies there.
    there: Vec<Vec<bool>>,
}

/// Of states that are farther from all marks than this, the places are not kept, lengths of a move.
const KEPT: f64 = 5.0;

impl Shown {
    fn new(
        scenario: &Scenario,
        model: &SlowModel<f32>,
        projected: &Projection,
        window: &[TaskTransition],
        marks: &[Marked],
        par: Par,
    ) -> Result<Self, String> {
        let mut shown = Shown { regions: Vec::new(), there: Vec::new() };
        if !scenario.tasks.iter().any(Task::is_shown) {
            return Ok(shown);
        }
        let text = |error: ValueError| error.to_string();
        let options = LocalOptions { neighbours: scenario.value.neighbours, ridge: scenario.value.local_ridge };
        let all = points(model, projected.phi.as_ref(), scenario.value.metric_features);
        let unit = scenario.robot.forward;
        let map = match marks.is_empty() {
            true => None,
            false => {
                let steps = projected.steps(&scenario.robot.actions(), window);
                MetricMap::new(projected.phi.as_ref(), all.as_ref(), &steps, options).map_err(text)?
            }
        };
        let place = |map: &MetricMap, axis: usize, j: usize| map.positions()[j][axis] / unit;
        for (number, task) in scenario.tasks.iter().enumerate() {
            let of_task: Vec<&Observation> =
                marks.iter().filter(|mark| mark.task == number).map(|mark| mark.observation.as_ref()).collect();
            let region = match (task.within.filter(|_| !of_task.is_empty()), &map) {
                (Some(within), Some(map)) => {
                    let x = columns(of_task.into_iter());
                    let phi = model.apply(x.as_ref(), par).map_err(|error| error.to_string())?;
                    let marks = points(model, phi.as_ref(), scenario.value.metric_features);
                    let places = Mat::from_fn(2, all.ncols(), |axis, j| place(map, axis, j));
                    let region = GoalRegion::new(all.clone(), places.as_ref(), marks, within, options);
                    Some(region.and_then(|region| region.near(KEPT)).map_err(text)?)
                }
                _ => None,
            };
            shown.there.push(region.as_ref().map_or(Vec::new(), |region| region.holds(all.as_ref())));
            shown.regions.push(region);
        }
        Ok(shown)
    }

    /// The reward of a transition for a task, and whether it ended in the goal.
    fn outcome(&self, projected: &Projection, t: &TaskTransition, number: usize, task: &Task) -> (f64, bool) {
        if !task.is_shown() {
            return (t.result.rewards[number], t.result.in_goal[number]);
        }
        let there = self.there.get(number).and_then(|there| there.get(projected.place[&t.to.frame]));
        let there = there.copied().unwrap_or(false);
        (if there { task.reward } else { 0.0 }, there)
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
    fn new(
        model: &SlowModel<f32>,
        window: &[TaskTransition],
        rows: &mut KernelRows,
        par: Par,
    ) -> Result<Self, SlowError> {
        let unique: BTreeMap<u64, &Arc<Observation>> =
            window.iter().flat_map(|t| [&t.from, &t.to]).map(|seen| (seen.frame, seen)).collect();
        let place = unique.keys().enumerate().map(|(column, &frame)| (frame, column)).collect();
        let seen: Vec<&Observation> = unique.values().map(|seen| seen.as_ref()).collect();
        let mut phi = Mat::zeros(model.features(), seen.len());
        let mut cell = Vec::with_capacity(seen.len());
        let parts = seen.chunks(PROJECT_AT_ONCE).map(|part| columns(part.iter().copied()));
        let mut done = 0;
        rows.each(model, parts, par, |rows| {
            let features = model.apply_to_rows(rows.as_ref(), par)?;
            phi.as_mut().subcols_mut(done, rows.ncols()).copy_from(&features);
            done += rows.ncols();
            // The nearest support vector is the one with the largest kernel value.
            cell.extend(rows.col_iter().map(|row| greedy(row.iter().copied())));
            Ok(())
        })?;
        Ok(Projection { place, phi, cell })
    }

    /// What the robot did from each observation to the next one.
    fn steps(&self, actions: &ActionSet, window: &[TaskTransition]) -> Vec<Option<MapStep>> {
        let mut steps = vec![None; self.phi.ncols().saturating_sub(1)];
        for t in window {
            let (from, to) = (self.place[&t.from.frame], self.place[&t.to.frame]);
            if let (true, Some(action)) = (to == from + 1, actions.get(t.action)) {
                let motion = actions.motion(action);
                let distance = (!t.result.blocked).then_some(motion.distance);
                steps[from] = Some(MapStep { turn: motion.angle, distance });
            }
        }
        steps
    }

    /// Features of some observations, one a column.
    fn features_at(&self, places: &[usize]) -> Mat<f64> {
        let mut features = Mat::zeros(self.phi.nrows(), places.len());
        for (j, &place) in places.iter().enumerate() {
            features.col_mut(j).copy_from(self.phi.col(place));
        }
        features
    }
}
