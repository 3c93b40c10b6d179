//! The fit actor: policies on new features, for all tasks from the same window of transitions.
//!
//! Values know the reflexes: what may follow an action is all that they count on. Without that, the greedy policy
//! turns a little too far, because it believes that it may turn back, and the reflexes then send it round the whole circle.

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::sync::Arc;

use faer::{Mat, Par};
use rayon::prelude::*;

use super::doubts::doubts;
use super::kernel_rows::KernelRows;
use super::learn::SERIES;
use super::messages::{FitRequest, Item, Marked, TaskOutcomes, TaskTransition, Update};
use super::record::{Level, Recorder};
use crate::agent::runtime::clock::Clock;
use crate::agent::runtime::queue::{Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::gpu::Choice;
use crate::policy::{FloorMap, GoalRegion, Learned, Recent, Reflexes, columns, points, step_of};
use crate::random::stream;
use crate::robot::{Action, ActionSet};
use crate::scenario::{Body, Method, Scenario, Task};
use crate::slow::{SlowError, SlowModel};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::value::place::{GoalPlaces, MotionNoise, PlaceMap, PlaceMetric, Pose};
use crate::value::{
    Fit, Instances, Local, LocalOptions, LocalOutcomes, Lspi, LspiOptions, MapStep, MetricMap, Outcomes, Samples,
    ValueError, balance, greedy, rare_places,
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
    /// Where the observations of the window lie, by frame, as the model before had it; none where places are not told.
    poses: BTreeMap<u64, Pose>,
    /// The last frame of each robot that was known when a map of places was looked for from nothing; see [`SERIES`].
    searched: BTreeMap<u64, u64>,
    /// What people were told with the model before.
    told: Vec<String>,
}

/// What came of each transition, for one task; see [`LocalOutcomes`].
struct CameTo {
    rewards: Vec<f64>,
    ended: Vec<bool>,
    bounded: Vec<bool>,
}

impl CameTo {
    fn outcomes<'o>(&'o self, allowed: &'o [u32]) -> LocalOutcomes<'o> {
        LocalOutcomes { rewards: &self.rewards, allowed, ended: &self.ended, bounded: &self.bounded }
    }
}

/// The fits of all tasks; and weights that were fitted as if nothing was to be avoided, where something is.
type Fits = (Vec<Fit>, Vec<Mat<f64>>);

/// Rarely visited places of each model.
pub const RARE: usize = 8;

impl FitPolicies {
    /// A fitter for the tasks of a scenario; its results do not depend on `par`.
    pub fn new(scenario: Arc<Scenario>, par: Par) -> Self {
        let (rows, poses) = (KernelRows::new(scenario.agent.compute), BTreeMap::new());
        FitPolicies { rows, scenario, par, epoch: 0, poses, searched: BTreeMap::new(), told: Vec::new() }
    }

    /// Who computes the kernel values of the window, as far as there was a choice.
    pub fn kernel_values_by(&self) -> Option<Choice> {
        self.rows.choice()
    }

    /// Policies for a new model. Nothing of an older model is used but where observations were: the whole window is projected again.
    pub fn step(&mut self, request: FitRequest) -> Update {
        let transitions = request.window.len();
        let fitted = request.model.and_then(|model| {
            let (undone, imagined);
            let is_linear = self.scenario.value.method == Method::Lspi;
            // Linear values and maps of what is shown are functions of all features, local values of the slowest ones.
            let all = is_linear || self.scenario.shows_any();
            let features = if all { model.features() } else { self.scenario.value.metric_features };
            let projected = Projection::new(&model, (features, is_linear), &request.window, &mut self.rows, self.par);
            let projected = projected.map_err(|error| error.to_string())?;
            let tried = match self.scenario.value.method {
                Method::Lspi => None,
                Method::Local => {
                    let points = points(&model, projected.phi.as_ref(), self.scenario.value.metric_features);
                    let map = self.places(&points, &projected, &request.window).map_err(|error| error.to_string())?;
                    undone = undo_all(&self.scenario, &request.window);
                    imagined = map.as_ref().map_or(Vec::new(), |map| {
                        imagine_all(&self.scenario, &projected, map, (&request.window, &undone))
                    });
                    let told = [&request.window, &undone].into_iter().flatten().map(|t| (t, None));
                    let told = told.chain(imagined.iter().map(|(t, pose)| (t, Some(*pose)))).collect();
                    let tried = Tried::new(&self.scenario, (points, map), &projected, &request.window, told);
                    Some(tried.map_err(|error| error.to_string())?)
                }
            };
            let seen = Seen { model: &model, projected: &projected, window: &request.window, tried: tried.as_ref() };
            let mut shown = Shown::new(&self.scenario, &seen, &request.marks, self.par)?;
            let mut notes = std::mem::take(&mut shown.notes);
            let (epoch, asked_at, frames) = (self.epoch + 1, request.asked_at, request.frames);
            let weights_of = |fits: &[Fit]| fits.iter().map(|fit| fit.weights.clone()).collect();
            let (learned, fits) = match tried {
                None => {
                    let fits = self.fit(&projected, &request.window, &shown).map_err(|error| error.to_string())?;
                    (Learned::new(epoch, asked_at, frames, model, weights_of(&fits.0)), fits)
                }
                Some(tried) => {
                    let (fits, rare) =
                        self.fit_locally(&projected, &tried, &shown).map_err(|error| error.to_string())?;
                    let (weights, places, goals) = (weights_of(&fits.0), tried.places, tried.goals);
                    let learned = Learned::local(epoch, asked_at, frames, model, tried.instances, weights, places);
                    (learned.map(|learned| learned.with_goal_places(goals).with_rare(rare)), fits)
                }
            };
            let (fits, heedless) = fits;
            let is_local = self.scenario.value.method == Method::Local;
            let worths = fits.iter().filter(|_| is_local).map(|fit| &fit.weights);
            notes.extend(doubts(&self.scenario, &request.window, worths));
            let learned = learned.and_then(|learned| {
                learned.with_heedless(heedless).for_goals(request.goals).with_regions(shown.map, shown.regions)
            });
            Ok((Arc::new(learned.map_err(|error| error.to_string())?), fits, notes))
        });
        let (learned, fits, mut notes) = match fitted {
            Err(reason) => (Err(reason), Vec::new(), self.told.clone()),
            Ok((learned, fits, notes)) => {
                self.epoch = learned.epoch;
                (Ok(learned), fits, notes)
            }
        };
        let told = std::mem::replace(&mut self.told, notes.clone());
        notes.retain(|note| !told.contains(note));
        Update { asked_at: request.asked_at, learned, fits, transitions, notes }
    }

    /// Where observations lie, from where they lay by the model before; `None`, and as it was, where places are not told or most have none.
    /// To look for another map takes long, and pays where much is new: half of all observations.
    fn places(
        &mut self,
        points: &Mat<f32>,
        projected: &Projection,
        window: &[TaskTransition],
    ) -> Result<Option<PlaceMap>, ValueError> {
        if !self.scenario.value.places {
            return Ok(None);
        }
        let (robot, place) = (&self.scenario.robot, &projected.place);
        let before: Vec<Option<Pose>> = place.keys().map(|frame| self.poses.get(frame).copied()).collect();
        // Where the robot counts what it does, that is far more exact than what it was told to do.
        let (noise, steps) = if window.iter().all(|t| t.result.step.is_some()) {
            (MotionNoise::measured(robot.odometry_noise), projected.steps(window, |t| t.result.step))
        } else {
            let noise = if robot.body == Body::Program { MotionNoise::PLAYER } else { MotionNoise::ROBOT };
            (noise, projected.steps(window, told(&robot.actions)))
        };
        let points = points.clone();
        let series = |frame: u64| frame / SERIES;
        let new = place.keys().filter(|&&frame| {
            let first = series(frame) * SERIES;
            frame > self.searched.get(&series(frame)).copied().unwrap_or(first)
        });
        let map = if 2 * new.count() >= place.len() {
            self.searched = place.keys().map(|&frame| (series(frame), frame)).collect();
            PlaceMap::new(points, &steps, &before, noise)?
        } else {
            PlaceMap::go_on(points, &steps, &before, noise)?
        };
        let is_told = |map: &PlaceMap| 2 * map.poses().iter().flatten().count() > map.poses().len();
        let map = map.filter(is_told);
        if let Some(map) = &map {
            let placed = place.keys().zip(map.poses());
            self.poses = placed.filter_map(|(&frame, pose)| Some((frame, (*pose)?))).collect();
        }
        Ok(map)
    }

    /// Local values: what each transition is worth, for all tasks and on the way to rarely visited places.
    fn fit_locally(
        &self,
        projected: &Projection,
        tried: &Tried<'_>,
        shown: &Shown,
    ) -> Result<(Fits, Vec<Mat<f64>>), ValueError> {
        let settings = &self.scenario.value;
        let sorted = &tried.sorted;
        let local = Local::new(&tried.instances, tried.to.as_ref())?;
        let allowed: Vec<u32> = sorted.iter().map(|t| t.allowed).collect();
        let avoided: Vec<f64> = sorted.iter().map(|t| shown.avoided(projected, t)).collect();
        let unavoided: Vec<bool> = avoided.iter().map(|&avoided| avoided == 0.0).collect();
        let came_to = |(number, task): (usize, &Task), heeds: bool| {
            let outcomes = sorted.iter().map(|t| shown.outcome(projected, t, number, task, heeds));
            let (rewards, there): (Vec<f64>, Vec<bool>) = outcomes.unzip();
            let ended = there.into_iter().map(|there| task.absorbing && there).collect();
            // What is to be avoided is avoided at any cost.
            let bounded = unavoided.iter().map(|&unavoided| !heeds || unavoided).collect();
            CameTo { rewards, ended, bounded }
        };
        let tasks = self.scenario.tasks.iter().enumerate();
        let mut all: Vec<CameTo> = tasks.map(|task| came_to(task, true)).collect();
        all.extend(self.heedless().map(|task| came_to(task, false)));
        let rare = if self.scenario.policy.directed_share > 0.0 { RARE } else { 0 };
        // What is seen differs more from place to place in some rooms than in others: a map that odometry has laid out tells better
        // alone. Other maps are bent, and with one of them alone fewer robots arrived (docs/tried.md).
        let measured = MotionNoise::measured(self.scenario.robot.odometry_noise);
        let exact = tried.places.filter(|metric| metric.noise == measured);
        let (looks, power) = exact.map_or((0, 2), |_| (PlaceMetric::features(tried.to.nrows()), 4));
        let mut rng = stream(self.scenario.seed, &format!("rare {}", self.epoch));
        let rare = rare_places(tried.to.get(looks.., ..), power, rare, &mut rng)?;
        let without_avoided =
            |place: Vec<usize>| place.into_iter().filter(|&number| unavoided[number]).collect::<Vec<_>>();
        let on_the_way = |place: Vec<usize>| {
            let (mut rewards, mut ended) = (avoided.clone(), vec![false; sorted.len()]);
            place.into_iter().for_each(|number| (rewards[number], ended[number]) = (1.0, true));
            CameTo { rewards, ended, bounded: unavoided.clone() }
        };
        all.extend(rare.into_iter().map(without_avoided).filter(|place| !place.is_empty()).map(on_the_way));
        let outcomes: Vec<LocalOutcomes<'_>> = all.iter().map(|of| of.outcomes(&allowed)).collect();
        let mut fits = local.fit_all(&outcomes, settings.gamma)?;
        let mut weights = |from: usize| fits.drain(from..).map(|fit| fit.weights).collect::<Vec<Mat<f64>>>();
        let heedless = self.heedless().count();
        let rare = weights(self.scenario.tasks.len() + heedless);
        let heedless = weights(self.scenario.tasks.len());
        Ok(((fits, heedless), rare))
    }

    /// The tasks whose values are fitted a second time, as if nothing was to be avoided: all where something is.
    fn heedless(&self) -> impl Iterator<Item = (usize, &Task)> {
        self.scenario.tasks.iter().enumerate().filter(|_| !self.scenario.avoids.is_empty())
    }

    /// Linear values, by least-squares policy iteration.
    fn fit(&self, projected: &Projection, window: &[TaskTransition], shown: &Shown) -> Result<Fits, ValueError> {
        let settings = &self.scenario.value;
        let from: Vec<usize> = window.iter().map(|t| projected.place[&t.from.frame]).collect();
        let to: Vec<usize> = window.iter().map(|t| projected.place[&t.to.frame]).collect();
        let (phi, next) = (projected.features_at(&from), projected.features_at(&to));
        let actions: Vec<usize> = window.iter().map(|t| t.action).collect();
        let groups: Vec<(usize, usize)> =
            from.iter().zip(&actions).map(|(&place, &action)| (projected.cell[place], action)).collect();
        let weights = balance(&groups, settings.balance)?;
        let samples = Samples { phi: phi.as_ref(), actions: &actions, weights: &weights };
        let problem = Lspi::new(samples, self.scenario.robot.actions.len(), self.par)?;
        let options = LspiOptions {
            gamma: settings.gamma,
            ridge: settings.ridge,
            mixing: settings.mixing,
            max_iterations: settings.max_iterations,
            tolerance: settings.tolerance,
            ..LspiOptions::plain()
        };
        let allowed: Vec<u32> = window.iter().map(|t| t.allowed).collect();
        let fit = |(number, task): (usize, &Task), heeds: bool| {
            let outcome = |t: &TaskTransition| shown.outcome(projected, t, number, task, heeds);
            let came_to: Vec<(f64, bool)> = window.iter().map(outcome).collect();
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
        let fit = |task: (usize, &Task), heeds: bool| {
            fit(task, heeds).map(|mut fit| {
                fit.untried.iter().for_each(|&action| fit.weights[(0, action)] = f64::NEG_INFINITY);
                fit
            })
        };
        let fits: Vec<Result<Fit, ValueError>> = match self.par {
            Par::Seq => tasks.iter().enumerate().map(|task| fit(task, true)).collect(),
            _ => tasks.par_iter().enumerate().map(|task| fit(task, true)).collect(),
        };
        let heedless: Result<Vec<Mat<f64>>, ValueError> =
            self.heedless().map(|task| Ok(fit(task, false)?.weights)).collect();
        Ok((fits.into_iter().collect::<Result<_, _>>()?, heedless?))
    }
}

impl Persist for FitPolicies {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.value("epoch", &mut self.epoch)?;
        let bits = |(&frame, pose): (&u64, &Pose)| (frame, [pose.x, pose.y, pose.heading].map(f64::to_bits));
        let mut poses: Vec<(u64, [u64; 3])> = self.poses.iter().map(bits).collect();
        snapshot.value("poses", &mut poses)?;
        let pose = |(frame, bits): (u64, [u64; 3])| {
            let [x, y, heading] = bits.map(f64::from_bits);
            (frame, Pose { x, y, heading })
        };
        self.poses = poses.into_iter().map(pose).collect();
        snapshot.value("searched", &mut self.searched)?;
        snapshot.value("told", &mut self.told)
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

/// Where actions were tried, those of the first action first.
struct Tried<'a> {
    sorted: Vec<&'a TaskTransition>,
    instances: Arc<Instances>,
    /// Where they led, `p × N`.
    to: Mat<f32>,
    /// What the coordinates are, if they tell places as well.
    places: Option<PlaceMetric>,
    /// Then, where goals were found, by task.
    goals: Vec<GoalPlaces>,
}

impl<'a> Tried<'a> {
    /// `points`: observations in coordinates of features, `p × n`, and where they lie, if places are told. `told`: what counts, and where it led
    /// to exactly, if that is not where the observation lies.
    fn new(
        scenario: &Scenario,
        (mut points, map): (Mat<f32>, Option<PlaceMap>),
        projected: &Projection,
        window: &[TaskTransition],
        mut told: Vec<(&'a TaskTransition, Option<Pose>)>,
    ) -> Result<Self, ValueError> {
        told.sort_by_key(|(t, _)| t.action);
        let (actions, seen) = (&scenario.robot.actions, points.clone());
        let (mut places, mut goals) = (None, Vec::new());
        if let Some(map) = map {
            let pose = |frame: u64| map.poses()[projected.place[&frame]];
            told.retain(|(t, _)| [&t.from, &t.to].iter().all(|seen| pose(seen.frame).is_some()));
            let metric = map.metric();
            let of = |j: usize| metric.point(&column(&points, j), map.poses()[j].unwrap_or_default());
            let of: Vec<Vec<f32>> = (0..points.ncols()).map(of).collect();
            points = Mat::from_fn(of[0].len(), of.len(), |i, j| of[j][i]);
            places = Some(metric);
            // Where goals are shown, what the camera sees decides whether this is one.
            let came_to = |task: usize| {
                let told = window.iter().filter(|_| !scenario.tasks[task].is_shown());
                told.filter_map(|t| Some((pose(t.to.frame)?, t.result.in_goal[task]))).collect::<Vec<_>>()
            };
            goals = (0..scenario.tasks.len()).map(|task| GoalPlaces::new(came_to(task).into_iter())).collect();
        }
        let (sorted, exactly): (Vec<&TaskTransition>, Vec<Option<Pose>>) = told.into_iter().unzip();
        let counts = actions.iter().map(|a| sorted.iter().filter(|t| t.action == a.index()).count()).collect();
        let at = |place: &dyn Fn(&TaskTransition) -> u64| {
            let places: Vec<usize> = sorted.iter().map(|t| projected.place[&place(t)]).collect();
            Mat::from_fn(points.nrows(), places.len(), |i, j| points[(i, places[j])])
        };
        let instances = Arc::new(Instances::new(at(&|t| t.from.frame), counts, local_options(scenario))?);
        let mut to = at(&|t| t.to.frame);
        for (j, pose) in exactly.into_iter().enumerate() {
            let Some((metric, pose)) = places.zip(pose) else { continue };
            let point = metric.point(&column(&seen, projected.place[&sorted[j].to.frame]), pose);
            to.col_mut(j).iter_mut().zip(point).for_each(|(to, at)| *to = at);
        }
        Ok(Tried { sorted, instances, to, places, goals })
    }
}

/// What the action of a transition was told to do.
fn told(actions: &ActionSet) -> impl Fn(&TaskTransition) -> Option<MapStep> {
    |t| actions.get(t.action).map(|action| step_of(actions, action, t.result.blocked))
}

/// What would have followed if an action had been undone by its inverse: the robot would be where it came from, and that is what the
/// transition before had come to. Nothing is known where a program has rewarded that, as it may have rewarded the action and not the
/// place, nor where the picture has not changed: something may have stopped the robot without a word. Cells are of the state behind, as
/// linear values alone ask for them, and they know no such transitions.
fn undo_all(scenario: &Scenario, window: &[TaskTransition]) -> Vec<TaskTransition> {
    let (actions, reflexes) = (&scenario.robot.actions, Reflexes::new(scenario));
    let undo = |pair: &[TaskTransition]| {
        let [before, t] = pair else { return None };
        let follows = before.to.frame == t.from.frame && !t.result.blocked && t.from.pixels != t.to.pixels;
        let inverse = actions.iter().nth(t.action).and_then(|action| actions.inverse(action));
        let inverse = inverse.filter(|_| follows && !is_rewarded(scenario, before))?;
        let (from, to, cell) = (t.to.clone(), t.from.clone(), t.cell);
        let allowed = reflexes.allowed(Recent::default().then(inverse, false, actions));
        let result = TaskOutcomes { blocked: false, ..before.result.clone() };
        Some(TaskTransition { from, action: inverse.index(), allowed, result, to, cell })
    };
    window.windows(2).filter_map(undo).collect()
}

/// What turns would have led to that were not made, and where to exactly: the robot stays where it is, so what that comes to is what the
/// transition before had come to, and on a map it is known what is seen there. Not after a reward from a program. `told`: what was done, and
/// undone.
fn imagine_all(
    scenario: &Scenario,
    projected: &Projection,
    map: &PlaceMap,
    (window, undone): (&[TaskTransition], &[TaskTransition]),
) -> Vec<(TaskTransition, Pose)> {
    let (actions, reflexes) = (&scenario.robot.actions, Reflexes::new(scenario));
    let turns: Vec<Action> =
        actions.iter().filter(|&action| !actions.advances(action) && actions.motion(action).angle != 0.0).collect();
    let told: BTreeSet<(u64, usize)> = window.iter().chain(undone).map(|t| (t.from.frame, t.action)).collect();
    let seen: Vec<&Arc<Observation>> = projected.seen(window);
    let imagine = |(t, action): (&TaskTransition, Action)| {
        let from = &t.to;
        if told.contains(&(from.frame, action.index())) || is_rewarded(scenario, t) {
            return None;
        }
        let (pose, like) = map.behind_turn(projected.place[&from.frame], actions.motion(action).angle)?;
        let result = TaskOutcomes { blocked: false, ..t.result.clone() };
        let allowed = reflexes.allowed(Recent::default().then(action, false, actions));
        let (from, to, cell) = (from.clone(), seen[like].clone(), t.cell);
        Some((TaskTransition { from, action: action.index(), allowed, result, to, cell }, pose))
    };
    window.iter().flat_map(|t| turns.iter().map(move |&action| (t, action))).filter_map(imagine).collect()
}

/// Whether a program gave a reward for a transition.
fn is_rewarded(scenario: &Scenario, t: &TaskTransition) -> bool {
    let rewards = scenario.tasks.iter().zip(&t.result.rewards);
    rewards.into_iter().any(|(task, &reward)| task.topic.is_some() && reward != 0.0)
}

fn column(matrix: &Mat<f32>, j: usize) -> Vec<f32> {
    matrix.col(j).iter().copied().collect()
}

fn local_options(scenario: &Scenario) -> LocalOptions {
    LocalOptions { neighbours: scenario.value.neighbours, ridge: scenario.value.local_ridge }
}

/// What the window holds, by a model.
struct Seen<'a> {
    model: &'a SlowModel<f32>,
    projected: &'a Projection,
    window: &'a [TaskTransition],
    /// Of local values.
    tried: Option<&'a Tried<'a>>,
}

/// What counts as being at the places that were shown.
struct Shown {
    map: Option<FloorMap>,
    /// By the number of the task, or of what is to be avoided; `None` where none was shown. Empty where nothing is shown.
    regions: Vec<Option<GoalRegion>>,
    /// The same, how deep inside each observation of the window lies; 0 is outside.
    depth: Vec<Vec<f64>>,
    /// By observation of the window, the reward of what was shown to be avoided.
    avoided: Vec<f64>,
    /// What a person should know.
    notes: Vec<String>,
}

impl Shown {
    fn new(scenario: &Scenario, seen: &Seen<'_>, marks: &[Marked], par: Par) -> Result<Self, String> {
        let &Seen { model, projected, window, tried } = seen;
        let (map, regions, depth) = (None, Vec::new(), Vec::new());
        let mut shown = Shown { map, regions, depth, avoided: vec![0.0; projected.phi.ncols()], notes: Vec::new() };
        if !scenario.shows_any() {
            return Ok(shown);
        }
        let text = |error: ValueError| error.to_string();
        let all = points(model, projected.phi.as_ref(), scenario.value.metric_features);
        let known = match marks.is_empty() {
            true => None,
            false => {
                let steps = projected.steps(window, told(&scenario.robot.actions));
                let map = MetricMap::new(projected.phi.as_ref(), all.as_ref(), &steps, local_options(scenario));
                map.map_err(text)?
            }
        };
        // What a map misses must not let the robot arrive too early, nor come too near.
        let missed = known.as_ref().map_or(0.0, |known| known.error().powi(2));
        let surely = |number: usize, within: f64| match number < scenario.tasks.len() {
            true => (within * within - missed).max(within * within / 2.0).sqrt(),
            false => (within * within + missed).sqrt(),
        };
        // In lengths of a move.
        let places = known
            .map(|known| Mat::from_fn(2, all.ncols(), |axis, j| known.positions()[j][axis] / scenario.robot.forward));
        if let Some(places) = &places {
            let map = match tried.filter(|tried| tried.places.is_none()) {
                Some(tried) => {
                    let of: Vec<usize> = tried.sorted.iter().map(|t| projected.place[&t.from.frame]).collect();
                    let places = Mat::from_fn(2, of.len(), |axis, j| places[(axis, of[j])]);
                    FloorMap::new(tried.instances.clone(), places.as_ref())
                }
                None => Instances::new(all.clone(), vec![all.ncols()], local_options(scenario))
                    .and_then(|states| FloorMap::new(Arc::new(states), places.as_ref())),
            };
            shown.map = Some(map.map_err(text)?);
        }
        let at = |of: &dyn Fn(&TaskTransition) -> u64| {
            let places: Vec<usize> = window.iter().map(|t| projected.place[&of(t)]).collect();
            Mat::from_fn(all.nrows(), places.len(), |i, j| all[(i, places[j])])
        };
        let changes = [at(&|t| t.from.frame), at(&|t| t.to.frame)];
        let within = scenario.tasks.iter().map(|task| task.within);
        let within = within.chain(scenario.avoids.iter().map(|avoid| avoid.within));
        for ((number, within), name) in within.enumerate().zip(scenario.names()) {
            let of_task: Vec<&Observation> =
                marks.iter().filter(|mark| mark.task == number).map(|mark| mark.observation.as_ref()).collect();
            if within.is_some() && of_task.is_empty() {
                let until = if number < scenario.tasks.len() { "pursued" } else { "avoided" };
                shown.notes.push(format!("{name:?} was not shown yet: it is not {until} until something marks it"));
            } else if within.is_some() && places.is_none() {
                shown.notes.push(format!(
                    "{name:?} was shown, and the robot has moved and turned too little to know how near that is: it explores on"
                ));
            }
            let region = match (within.filter(|_| !of_task.is_empty()), &shown.map) {
                (Some(within), Some(map)) => {
                    let x = columns(of_task.into_iter());
                    let phi = model.apply(x.as_ref(), par).map_err(|error| error.to_string())?;
                    let marks = points(model, phi.as_ref(), scenario.value.metric_features);
                    let changes = changes.each_ref().map(Mat::as_ref);
                    Some(GoalRegion::new(map, marks, surely(number, within), changes).map_err(text)?)
                }
                _ => None,
            };
            let depth = region.as_ref().zip(places.as_ref()).map(|(region, places)| {
                (0..all.ncols()).map(|j| region.depth(all.col(j), [places[(0, j)], places[(1, j)]])).collect()
            });
            shown.depth.push(depth.unwrap_or_default());
            shown.regions.push(region);
        }
        shown.avoid(scenario);
        Ok(shown)
    }

    /// Count what is to be avoided, and note where a goal lies in it.
    fn avoid(&mut self, scenario: &Scenario) {
        let (goals, avoided) = self.regions.split_at(scenario.tasks.len());
        for (place, (avoid, region)) in scenario.avoids.iter().zip(avoided).enumerate() {
            let depth = &self.depth[goals.len() + place];
            self.avoided.iter_mut().zip(depth).for_each(|(sum, &depth)| *sum += avoid.reward_at(depth));
            for (goal, task) in goals.iter().zip(&scenario.tasks) {
                let (Some(goal), Some(region)) = (goal, region) else { continue };
                let inside = (0..goal.marks().ncols())
                    .filter(|&k| region.holds(goal.marks().col(k), [goal.marked()[(0, k)], goal.marked()[(1, k)]]));
                let inside = inside.count();
                if 2 * inside > goal.marks().ncols() {
                    let (goal, avoided) = (&task.name, &avoid.name);
                    self.notes
                        .push(format!("{goal:?} was shown where {avoided:?} is to be avoided: forget one of them"));
                }
            }
        }
    }

    /// The reward of a transition for a task, and whether it ended in the goal. `heeds`: what is to be avoided counts.
    fn outcome(
        &self,
        projected: &Projection,
        t: &TaskTransition,
        number: usize,
        task: &Task,
        heeds: bool,
    ) -> (f64, bool) {
        let to = projected.place[&t.to.frame];
        let there = || self.depth.get(number).and_then(|depth| depth.get(to)).is_some_and(|&depth| depth > 0.0);
        let (reward, there) = match task.is_shown() {
            false => (t.result.rewards[number], t.result.in_goal[number]),
            true if there() => (task.reward, true),
            true => (0.0, false),
        };
        (if heeds { reward + self.avoided(projected, t) } else { reward }, there)
    }

    /// The reward of a transition for being where it is to be avoided: 0 elsewhere.
    fn avoided(&self, projected: &Projection, t: &TaskTransition) -> f64 {
        t.result.avoided + self.avoided[projected.place[&t.to.frame]]
    }
}

/// The window's observations in features, each once although two transitions share it.
struct Projection {
    /// Column of a frame.
    place: BTreeMap<u64, usize>,
    /// `f × n`.
    phi: Mat<f64>,
    /// Nearest support vector of each observation, where linear values ask for it.
    cell: Vec<usize>,
}

impl Projection {
    /// In the constant and so many of the slowest features, and with the cells if these are asked for.
    fn new(
        model: &SlowModel<f32>,
        (features, cells): (usize, bool),
        window: &[TaskTransition],
        rows: &mut KernelRows,
        par: Par,
    ) -> Result<Self, SlowError> {
        let unique: BTreeMap<u64, &Arc<Observation>> =
            window.iter().flat_map(|t| [&t.from, &t.to]).map(|seen| (seen.frame, seen)).collect();
        let place = unique.keys().enumerate().map(|(column, &frame)| (frame, column)).collect();
        let seen: Vec<&Observation> = unique.values().map(|seen| seen.as_ref()).collect();
        let mut phi = Mat::zeros(1 + features.min(model.features() - 1), seen.len());
        let mut cell = Vec::new();
        let mut done = 0;
        rows.each(model, seen.chunks(PROJECT_AT_ONCE), par, |rows| {
            let slowest = model.slowest_of_rows(rows.as_ref(), features, par)?;
            phi.as_mut().subcols_mut(done, rows.ncols()).copy_from(&slowest);
            done += rows.ncols();
            // The nearest support vector is the one with the largest kernel value.
            cell.extend(rows.col_iter().filter(|_| cells).map(|row| greedy(row.iter().copied())));
            Ok(())
        })?;
        Ok(Projection { place, phi, cell })
    }

    /// The observations, in the order of their columns.
    fn seen<'w>(&self, window: &'w [TaskTransition]) -> Vec<&'w Arc<Observation>> {
        let seen: BTreeMap<u64, &Arc<Observation>> =
            window.iter().flat_map(|t| [&t.from, &t.to]).map(|seen| (seen.frame, seen)).collect();
        seen.into_values().collect()
    }

    /// What the robot did from each observation to the next one, from what a transition says of that.
    fn steps(
        &self,
        window: &[TaskTransition],
        step: impl Fn(&TaskTransition) -> Option<MapStep>,
    ) -> Vec<Option<MapStep>> {
        let mut steps = vec![None; self.phi.ncols().saturating_sub(1)];
        for t in window {
            let (from, to) = (self.place[&t.from.frame], self.place[&t.to.frame]);
            if to == from + 1 {
                steps[from] = step(t);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_action_that_has_an_inverse_tells_two_transitions() {
        let scenario = Scenario::parse(include_str!("../../../scenarios/lab.toml"), "lab.toml".as_ref(), &[]).unwrap();
        let seen = |frame: u64| Arc::new(Observation { frame, pixels: vec![frame.min(9) as u8] });
        let transition = |from: u64, to: u64, action: usize, blocked: bool| {
            let rewards = vec![to as f64, 0.0];
            let result =
                TaskOutcomes { rewards, in_goal: vec![to == 2, false], avoided: -(to as f64), blocked, step: None };
            TaskTransition { from: seen(from), action, allowed: 7, result, to: seen(to), cell: from as usize }
        };
        // Forward, left, right: a move is not undone, nor a turn whose beginning nobody knows, nor one that was blocked, nor one that
        // changes nothing in the picture.
        let window = [
            transition(0, 1, 1, false),
            transition(1, 2, 0, false),
            transition(2, 3, 1, false),
            transition(3, 4, 2, true),
            transition(5, 6, 2, false),
            transition(6, 7, 2, false),
            transition(7, 8, 0, true),
            transition(8, 9, 1, false),
            transition(9, 10, 1, false),
        ];
        let undone = undo_all(&scenario, &window);
        let told: Vec<_> = undone.iter().map(|t| (t.from.frame, t.action, t.to.frame)).collect();
        assert_eq!(told, [(3, 2, 2), (7, 1, 6), (9, 2, 8)]);
        // Where it comes to is what the action before had come to; it must not be undone in turn.
        assert_eq!((undone[0].result.rewards[0], undone[0].result.in_goal[0]), (2.0, true));
        assert!(!undone[1].result.in_goal[0] && undone[1].result.avoided == -6.0);
        // The move before the last of them was blocked, the turn is not.
        assert!(undone.iter().all(|t| !t.result.blocked));
        assert_eq!(undone.iter().map(|t| t.allowed).collect::<Vec<_>>(), [0b101, 0b011, 0b101]);
        // Where a program gives the reward, it may have been for the action before.
        let text = format!(
            "{}\n[[task]]\nname = \"dock\"\nreward = \"topic\"\ntopic = \"/dock\"\n",
            include_str!("../../../scenarios/lab.toml")
        );
        let scenario = Scenario::parse(&text, "lab.toml".as_ref(), &[]).unwrap();
        let rewarded = |at: u64| {
            let mut window = window.clone();
            window.iter_mut().for_each(|t| t.result.rewards = vec![0.0, 0.0, if t.to.frame == at { 0.5 } else { 0.0 }]);
            undo_all(&scenario, &window).iter().map(|t| t.to.frame).collect::<Vec<u64>>()
        };
        assert_eq!((rewarded(1), rewarded(6)), (vec![2, 6, 8], vec![2, 8]));
    }

    #[test]
    fn turns_that_were_not_made_are_known_from_the_map() {
        let scenario = Scenario::parse(include_str!("../../../scenarios/lab.toml"), "lab.toml".as_ref(), &[]).unwrap();
        let seen = |frame: u64| Arc::new(Observation { frame, pixels: vec![frame as u8] });
        let transition = |from: u64, action: usize| {
            let rewards = vec![from as f64, 0.0];
            let result = TaskOutcomes { rewards, in_goal: vec![false; 2], avoided: 0.0, blocked: false, step: None };
            TaskTransition { from: seen(from), action, allowed: 7, result, to: seen(from + 1), cell: 0 }
        };
        // Two turns to the left and a move.
        let window = [transition(0, 1), transition(1, 1), transition(2, 0)];
        let undone = undo_all(&scenario, &window);
        assert_eq!(undone.iter().map(|t| (t.from.frame, t.action)).collect::<Vec<_>>(), [(2, 2)]);
        let metric = PlaceMetric { noise: MotionNoise::ROBOT, unit: 0.3, width: 1.0 };
        let turn = std::f64::consts::FRAC_PI_4;
        let lies = [(0.0, 0.0), (0.0, turn), (0.0, 2.0 * turn), (1.0, 2.0 * turn)];
        let lies = lies.map(|(y, heading)| Pose { x: 0.0, y, heading });
        let of = |j: usize| metric.point(&[j as f32], lies[j]);
        let map = PlaceMap::of_points(Mat::from_fn(5, 4, |i, j| of(j)[i]).as_ref(), metric).unwrap();
        let place = (0..4).map(|frame| (frame, frame as usize)).collect();
        let projected = Projection { place, phi: Mat::new(), cell: Vec::new() };
        let imagined = imagine_all(&scenario, &projected, &map, (&window, &undone));
        // Back from the first turn: the left one was made, and elsewhere nobody has looked beside.
        let told: Vec<_> = imagined.iter().map(|(t, _)| (t.from.frame, t.action, t.to.frame)).collect();
        assert_eq!(told, [(1, 2, 0)]);
        assert_eq!((imagined[0].0.result.rewards[0], imagined[0].0.allowed), (0.0, 0b101));
        assert!((imagined[0].1.heading.abs() < 1e-6) && imagined[0].1.y == 0.0);
    }
}
