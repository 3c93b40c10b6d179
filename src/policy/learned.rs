//! What was learned: slow features and, for each task, the worth of each action.

use std::cell::OnceCell;
use std::sync::Arc;

use faer::{ColRef, Mat, MatRef, Par};
use sha2::{Digest, Sha256};

use super::metric;
use super::pixel_values::{PixelPoints, PixelValues, PolicyError};
use super::region::{FloorMap, GoalRegion};
use crate::robot::{self, Action, ActionSet, ActionValues, MOST_ACTIONS};
use crate::scenario::hex;
use crate::slow::SlowModel;
use crate::value::place::{Belief, GoalPlaces, PlaceMap, PlaceMetric, Pose};
use crate::value::{Instances, MapStep};
use crate::vision::Observation;

/// Poses whose values are averaged: so many at most, until they make up this share of a belief.
pub const MOST_PLACES: usize = 8;
const MOST: f64 = 0.95;

/// Features of one epoch, and the policies that were fitted on them.
#[derive(Debug, Clone)]
pub struct Learned {
    /// Number of the model, from 1. Weights of one epoch are never used with features of another.
    pub epoch: u32,
    /// Frame at which the model was asked for; it knows the frames up to it.
    pub asked_at: u64,
    /// Frames that the model was made of.
    pub frames: u64,
    /// Slow features.
    pub model: SlowModel<f32>,
    /// What the values of each task are made of. Where they are linear in the features: weights, `f × A`,
    /// `Q(x, a) = φ(x)ᵀ w_a`. Where they are local: what each transition is worth, `N × 1`.
    pub weights: Vec<Mat<f64>>,
    /// Weights that were fitted as if nothing was to be avoided, for comparison; none where nothing is.
    pub heedless: Vec<Mat<f64>>,
    /// Of local values: what each transition is worth on the way to places that were rarely visited, `N × 1` each, for exploration. No part
    /// of checkpoints, digests and trials.
    pub rare: Vec<Mat<f64>>,
    /// Of local values: where actions were tried, in coordinates of the slowest features (`N` transitions).
    pub instances: Option<Arc<Instances>>,
    /// Centres of the goal areas that the weights were fitted for, by task, and behind them of what is to be avoided, where they
    /// are known; none: those of the scenario.
    pub goals: Vec<Option<[f64; 2]>>,
    /// Where states lie on the floor; known where something is shown.
    pub map: Option<FloorMap>,
    /// Where the states of local values lie, by the ways that led there; where a scenario wants it.
    pub places: Option<PlaceMap>,
    /// What counts as being there, in the same order; `None` where no marks say it. None at all where nothing is shown.
    pub regions: Vec<Option<GoalRegion>>,
    /// Of local values: what a transition into the goal is worth at most, by task.
    at_goal: Vec<f64>,
    /// The same Q-values, straight from pixels.
    values: Values,
    /// Where values are linear: points of observations in the map's coordinates.
    map_points: Option<PixelPoints>,
}

/// Q-values straight from pixels.
#[derive(Debug, Clone)]
enum Values {
    Linear(PixelValues),
    Local(PixelPoints),
}

/// What a model makes of one observation.
#[derive(Debug)]
pub struct State<'a> {
    learned: &'a Learned,
    observation: &'a Observation,
    /// Where the robot may be; without it the observation alone tells that.
    belief: Option<&'a Belief>,
    /// The point in coordinates of the slowest features, `p × 1`.
    point: OnceCell<Mat<f32>>,
    /// Where the robot may be, by the belief, or without one by the observation alone; none where places are not told.
    modes: OnceCell<Vec<(Pose, f64)>>,
    /// Local values of all tasks, and the place on the map, found with the same neighbours.
    local: OnceCell<(Vec<ActionValues>, Option<[f64; 2]>)>,
}

impl State<'_> {
    /// Q-values for one task.
    ///
    /// # Panics
    /// As [`Learned::q_values`].
    pub fn q_values(&self, task: usize) -> ActionValues {
        match &self.learned.values {
            Values::Linear(values) => values.of(self.observation, task),
            Values::Local(points) => self.local(points).0[task],
        }
    }

    /// How many actions the goal of a task is away, the one that arrives included: `1 + log_γ(V / V₁)` for the worth `V` of the best action,
    /// the worth `V₁` of one that arrives, and a discount `gamma`. A penalty on the way counts as a longer one. `None` where values are not local, or no
    /// action is worth more than nothing.
    ///
    /// # Panics
    /// As [`Learned::q_values`].
    pub fn expected_actions(&self, task: usize, gamma: f64) -> Option<f64> {
        let at_goal = *self.learned.at_goal.get(task)?;
        let worth = self.q_values(task).iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let actions = 1.0 + (worth / at_goal).min(1.0).ln() / gamma.ln();
        (worth > 0.0 && at_goal > 0.0 && actions.is_finite()).then_some(actions)
    }

    /// Whether this is the goal of a task that was shown, or what was shown to be avoided; never without marks.
    ///
    /// # Panics
    /// As [`Learned::q_values`].
    pub fn is_there(&self, task: usize) -> bool {
        let Some(Some(region)) = self.learned.regions.get(task) else { return false };
        self.placed().is_some_and(|(point, place)| region.holds(point.col(0), place))
    }

    /// Where it is on the map, in lengths of a move, where there is one.
    ///
    /// # Panics
    /// As [`Learned::q_values`].
    pub fn place(&self) -> Option<[f64; 2]> {
        self.placed().map(|placed| placed.1)
    }

    /// Where the robot may be, and how probable that is, the most probable place first: a few that make up most of a belief. Empty
    /// where places are not told.
    pub fn places(&self) -> &[(Pose, f64)] {
        self.modes.get_or_init(|| match (&self.learned.places, &self.learned.values, self.belief) {
            (Some(_), _, Some(belief)) => belief.modes(MOST_PLACES, MOST),
            (Some(map), Values::Local(points), None) => anywhere(map, self.point(points).col(0)),
            _ => Vec::new(),
        })
    }

    /// The point in coordinates of features, and its place on the map.
    fn placed(&self) -> Option<(MatRef<'_, f32>, [f64; 2])> {
        let map = self.learned.map.as_ref()?;
        let points = match (&self.learned.values, &self.learned.map_points) {
            (Values::Local(points), _) if self.learned.map_of_values().is_some() => {
                return Some((self.point(points), self.local(points).1?));
            }
            (Values::Local(points), _) | (Values::Linear(_), Some(points)) => points,
            (Values::Linear(_), None) => return None,
        };
        let place = map.places_of(self.point(points)).ok()?;
        Some((self.point(points), [place[(0, 0)], place[(1, 0)]]))
    }

    fn local(&self, points: &PixelPoints) -> &(Vec<ActionValues>, Option<[f64; 2]>) {
        self.local.get_or_init(|| {
            let (values, places) = match &self.learned.places {
                Some(map) => (
                    self.learned.values_by_places(map, self.point(points).col(0), self.places(), &self.learned.weights),
                    None,
                ),
                None => self.learned.local_values(self.point(points), &self.learned.weights),
            };
            let of_actions = |q: &Mat<f64>| ActionValues::new(q.col(0).iter().copied());
            (values.iter().map(of_actions).collect(), places.map(|places| places[0]))
        })
    }

    /// How many rarely visited places it has values for.
    pub fn rare_places(&self) -> usize {
        self.learned.rare.len()
    }

    /// Values of actions on the way to a rarely visited place, by its number; `None` where there is none.
    ///
    /// # Panics
    /// As [`Learned::q_values`].
    pub fn rare_values(&self, number: usize) -> Option<ActionValues> {
        let worth = self.learned.rare.get(number..=number)?;
        let Values::Local(points) = &self.learned.values else { return None };
        let values = match &self.learned.places {
            Some(map) => self.learned.values_by_places(map, self.point(points).col(0), self.places(), worth),
            None => self.learned.local_values(self.point(points), worth).0,
        };
        values.first().map(|values| ActionValues::new(values.col(0).iter().copied()))
    }

    fn point(&self, points: &PixelPoints) -> MatRef<'_, f32> {
        self.point.get_or_init(|| as_point(points, self.observation)).as_ref()
    }
}

/// Where a robot may be that knows nothing but what it sees.
fn anywhere(map: &PlaceMap, seen: ColRef<'_, f32>) -> Vec<(Pose, f64)> {
    let (seen, mut belief): (Vec<f32>, _) = (seen.iter().copied().collect(), Belief::default());
    map.follow(&mut belief, None, &seen, &[]).map_or(Vec::new(), |()| belief.modes(MOST_PLACES, MOST))
}

fn as_point(points: &PixelPoints, observation: &Observation) -> Mat<f32> {
    let point = points.of(observation);
    Mat::from_fn(point.len(), 1, |i, _| point[i] as f32)
}

/// What an action was told to do to the pose; how far is not known where something has stopped it.
pub fn step_of(actions: &ActionSet, action: Action, blocked: bool) -> MapStep {
    let motion = actions.motion(action);
    MapStep { turn: motion.angle, distance: (!blocked).then_some(motion.distance) }
}

/// What an action did to the pose, by odometry before and behind it: how far along the direction half-way between both headings.
pub fn step_between(from: &robot::Pose, to: &robot::Pose) -> MapStep {
    let moved = to.seen_from(from);
    let (sin, cos) = (0.5 * moved.heading).sin_cos();
    MapStep { turn: moved.heading, distance: Some(moved.position.x * cos + moved.position.y * sin) }
}

/// Observations as the columns of a matrix, `d × n`, in the whole numbers that kernels are exact on.
pub fn columns<'a>(observations: impl ExactSizeIterator<Item = &'a Observation>) -> Mat<f32> {
    let n = observations.len();
    let mut x = Mat::new();
    for (j, observation) in observations.enumerate() {
        if j == 0 {
            x = Mat::zeros(observation.pixels.len(), n);
        }
        // The columns of a matrix of our own lie one after another.
        if let Some(column) = x.col_mut(j).try_as_col_major_mut() {
            for (entry, value) in column.as_slice_mut().iter_mut().zip(observation.values()) {
                *entry = value;
            }
        }
    }
    x
}

impl Learned {
    /// Features with linear values: the weights of each task, `f × A` for `A` actions.
    ///
    /// # Errors
    /// Support vectors that are no observations, weights that do not fit the features, or are of other actions.
    pub fn new(
        epoch: u32,
        asked_at: u64,
        frames: u64,
        model: SlowModel<f32>,
        weights: Vec<Mat<f64>>,
    ) -> Result<Self, PolicyError> {
        let values = Values::Linear(PixelValues::new(&model, &weights)?);
        Ok(Learned::bare((epoch, asked_at, frames), model, weights, values))
    }

    /// With nothing but values.
    fn bare(
        (epoch, asked_at, frames): (u32, u64, u64),
        model: SlowModel<f32>,
        weights: Vec<Mat<f64>>,
        values: Values,
    ) -> Self {
        Learned {
            epoch,
            asked_at,
            frames,
            model,
            weights,
            heedless: Vec::new(),
            rare: Vec::new(),
            instances: None,
            goals: Vec::new(),
            map: None,
            places: None,
            regions: Vec::new(),
            at_goal: Vec::new(),
            values,
            map_points: None,
        }
    }

    /// Features with local values where there are instances, as [`local`](Self::local), else with linear ones, as [`new`](Self::new).
    ///
    /// # Errors
    /// As of these.
    pub(crate) fn of(
        (epoch, asked_at, frames): (u32, u64, u64),
        model: SlowModel<f32>,
        weights: Vec<Mat<f64>>,
        instances: Option<Arc<Instances>>,
        places: Option<PlaceMetric>,
    ) -> Result<Self, PolicyError> {
        match instances {
            None => Learned::new(epoch, asked_at, frames, model, weights),
            Some(instances) => Learned::local(epoch, asked_at, frames, model, instances, weights, places),
        }
    }

    /// Features with local values: where actions were tried, as [`points`](super::points) of the model, and what each
    /// transition is worth for each task, `N × 1`. With `places` they are points of that metric.
    ///
    /// # Errors
    /// Support vectors that are no observations, transitions of other actions or in more coordinates than there are features,
    /// worths of another number of transitions, a metric that is none.
    pub fn local(
        epoch: u32,
        asked_at: u64,
        frames: u64,
        model: SlowModel<f32>,
        instances: Arc<Instances>,
        worth: Vec<Mat<f64>>,
        places: Option<PlaceMetric>,
    ) -> Result<Self, PolicyError> {
        if !(1..=MOST_ACTIONS).contains(&instances.counts().len()) {
            return Err(PolicyError::Instances { actions: instances.counts().len() });
        }
        let places = places.map(|metric| PlaceMap::of_points(instances.points(), metric)).transpose()?;
        let found = places.as_ref().map_or(instances.points().nrows(), |map| map.points().nrows());
        if found > model.slowness.len() {
            return Err(PolicyError::Coordinates { found, features: model.slowness.len() });
        }
        for (task, of_task) in worth.iter().enumerate() {
            if of_task.nrows() != instances.len() || of_task.ncols() != 1 {
                let found = of_task.nrows() * of_task.ncols();
                return Err(PolicyError::Worth { task, found, expected: instances.len() });
            }
        }
        let most = |of_task: &Mat<f64>| of_task.col(0).iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let at_goal = worth.iter().map(most).collect();
        let values = Values::Local(PixelPoints::new(&model, metric::weights(&model, found).as_ref())?);
        let bare = Learned::bare((epoch, asked_at, frames), model, worth, values);
        Ok(Learned { instances: Some(instances), places, at_goal, ..bare })
    }

    /// The same, fitted for goals with these centres, by task.
    pub fn for_goals(self, goals: Vec<Option<[f64; 2]>>) -> Self {
        Learned { goals, ..self }
    }

    /// The same, where goals were found at these places of its map, by task.
    pub fn with_goal_places(self, goals: Vec<GoalPlaces>) -> Self {
        Learned { places: self.places.map(|map| map.with_goals(goals)), ..self }
    }

    /// The same, with what transitions are worth on the way to rarely visited places.
    pub fn with_rare(self, rare: Vec<Mat<f64>>) -> Self {
        Learned { rare, ..self }
    }

    /// The same, with weights that were fitted as if nothing was to be avoided.
    pub fn with_heedless(self, heedless: Vec<Mat<f64>>) -> Self {
        Learned { heedless, ..self }
    }

    /// The same, with a map of the floor, and what counts as being at each place that was shown. The map of local values is of the
    /// states where actions were tried.
    ///
    /// # Errors
    /// A map of other states than local values have, a map or regions in other coordinates than the features give.
    pub fn with_regions(self, map: Option<FloorMap>, regions: Vec<Option<GoalRegion>>) -> Result<Self, PolicyError> {
        let Some(of_map) = map.as_ref().map(|map| map.instances().clone()) else {
            return Ok(Learned { map, regions, map_points: None, ..self });
        };
        let coordinates = of_map.points().nrows();
        let others =
            regions.iter().flatten().map(|region| region.marks().nrows()).filter(|&found| found != coordinates);
        if let Some(found) = others.chain((coordinates > self.model.slowness.len()).then_some(coordinates)).next() {
            return Err(PolicyError::Coordinates { found, features: coordinates.min(self.model.slowness.len()) });
        }
        let map_points = match &self.instances {
            Some(instances) if Arc::ptr_eq(instances, &of_map) || self.places.is_some() => None,
            Some(instances) => {
                return Err(PolicyError::Worth { task: 0, found: of_map.len(), expected: instances.len() });
            }
            None => Some(PixelPoints::new(&self.model, metric::weights(&self.model, coordinates).as_ref())?),
        };
        Ok(Learned { map, regions, map_points, ..self })
    }

    /// The same with values that were fitted as if nothing was to be avoided, where there are such.
    pub fn without_avoiding(&self) -> Option<Self> {
        let weights = Some(self.heedless.clone()).filter(|weights| !weights.is_empty())?;
        let (model, places) = (self.model.clone(), self.places.as_ref().map(PlaceMap::metric));
        let heedless =
            Learned::of((self.epoch, self.asked_at, self.frames), model, weights, self.instances.clone(), places);
        let goal_places = self.places.as_ref().map_or(Vec::new(), |map| map.goals().to_vec());
        let heedless = heedless.ok()?.for_goals(self.goals.clone()).with_goal_places(goal_places);
        heedless.with_regions(self.map.clone(), self.regions.clone()).ok()
    }

    /// How many actions it has values for.
    pub fn actions(&self) -> usize {
        match &self.instances {
            Some(instances) => instances.counts().len(),
            None => self.weights.first().map_or(0, Mat::ncols),
        }
    }

    /// Width of the kernel, grey levels. A scenario's kernels are radial.
    pub fn sigma(&self) -> f64 {
        self.model.kernel.sigma().unwrap_or(f64::NAN)
    }

    /// Exponent of the kernel.
    pub fn exponent(&self) -> f64 {
        self.model.kernel.exponent().unwrap_or(f64::NAN)
    }

    /// Features of observations: `x: d × n` gives `f × n`.
    ///
    /// # Panics
    /// If the observations are not of the size that the scenario sets: the model was learned from such, or checked
    /// against the scenario when it was read.
    pub fn features(&self, x: MatRef<'_, f32>, par: Par) -> Mat<f64> {
        self.model.apply(x, par).expect("observations and support vectors have the size that the scenario sets")
    }

    /// Q-values of an observation for one task, for driving and trials alike. No memory is allocated where they are linear.
    ///
    /// # Panics
    /// If the observation is not of the size that the scenario sets, see [`Learned::features`], or if there is no such task.
    pub fn q_values(&self, observation: &Observation, task: usize) -> ActionValues {
        self.state(observation).q_values(task)
    }

    /// What the model makes of an observation, computed when it is asked for and once.
    pub fn state<'a>(&'a self, observation: &'a Observation) -> State<'a> {
        State {
            learned: self,
            observation,
            belief: None,
            point: OnceCell::new(),
            modes: OnceCell::new(),
            local: OnceCell::new(),
        }
    }

    /// The same on a way: `belief` is where the robot may be, `None` at its beginning and where nothing tells places; it goes on by
    /// the step that led here, `None` where nothing is known of it, by what is seen, and by whether it is in the goals, see
    /// [`PlaceMap::follow`].
    pub fn state_on_way<'a>(
        &'a self,
        observation: &'a Observation,
        belief: &'a mut Option<Belief>,
        step: Option<MapStep>,
        in_goal: &[Option<bool>],
    ) -> State<'a> {
        let mut state = self.state(observation);
        if let (Some(map), Values::Local(points)) = (&self.places, &self.values) {
            let mut on = belief.take().unwrap_or_default();
            let seen: Vec<f32> = state.point(points).col(0).iter().copied().collect();
            // Of an observation that has no finite features, nothing is known.
            *belief = map.follow(&mut on, step, &seen, in_goal).is_ok().then_some(on);
            state.belief = belief.as_ref();
        }
        state
    }

    /// Whether there is a goal to pursue: one that is `shown` needs marks, and local values know no way to one that their
    /// window has not met.
    pub fn has_goal(&self, task: usize, shown: bool) -> bool {
        let is_worth = |worth: &Mat<f64>| worth.col_iter().any(|column| column.iter().any(|&worth| worth > 0.0));
        (!shown || self.regions.get(task).is_some_and(Option::is_some))
            && (self.instances.is_none() || self.weights.get(task).is_some_and(is_worth))
    }

    /// Whether observations are at the goal of a task that was shown, by their features, `f × n`.
    pub fn are_there(&self, phi: MatRef<'_, f64>, task: usize) -> Vec<bool> {
        let (Some(Some(region)), Some(map)) = (self.regions.get(task), &self.map) else {
            return vec![false; phi.ncols()];
        };
        let points = metric::points(&self.model, phi, region.marks().nrows());
        let Ok(places) = map.places_of(points.as_ref()) else { return vec![false; phi.ncols()] };
        (0..phi.ncols()).map(|j| region.holds(points.col(j), [places[(0, j)], places[(1, j)]])).collect()
    }

    /// Q-values of observations for all tasks from their features: `phi: f × n` gives `actions × n` for each.
    ///
    /// # Panics
    /// If these are not features of the model.
    pub fn q_values_of(&self, phi: MatRef<'_, f64>) -> Vec<Mat<f64>> {
        match &self.instances {
            None => self.weights.iter().map(|weights| weights.transpose() * phi).collect(),
            Some(instances) => {
                let p = self.places.as_ref().map_or(instances.points().nrows(), |map| map.points().nrows());
                let points = metric::points(&self.model, phi, p);
                let Some(map) = &self.places else {
                    return self.local_values(points.as_ref(), &self.weights).0;
                };
                let mut values = vec![Mat::zeros(self.actions(), points.ncols()); self.weights.len()];
                for j in 0..points.ncols() {
                    let of = self.values_by_places(map, points.col(j), &anywhere(map, points.col(j)), &self.weights);
                    values.iter_mut().zip(of).for_each(|(values, of)| values.col_mut(j).copy_from(of.col(0)));
                }
                values
            }
        }
    }

    /// The map of the floor, where it is one of the states of local values.
    fn map_of_values(&self) -> Option<&FloorMap> {
        let instances = self.instances.as_ref()?;
        self.map.as_ref().filter(|map| Arc::ptr_eq(instances, map.instances()))
    }

    /// Local values of all tasks, `actions × 1` each, where the robot may be, by how probable that is (Littman, Cassandra & Kaelbling
    /// 1995).
    fn values_by_places(
        &self,
        map: &PlaceMap,
        seen: ColRef<'_, f32>,
        modes: &[(Pose, f64)],
        worths: &[Mat<f64>],
    ) -> Vec<Mat<f64>> {
        let seen: Vec<f32> = seen.iter().copied().collect();
        let at: Vec<Vec<f32>> = modes.iter().map(|&(pose, _)| map.metric().point(&seen, pose)).collect();
        let at = Mat::from_fn(at.first().map_or(0, Vec::len), at.len(), |i, j| at[j][i]);
        let sum = modes.iter().map(|of| of.1).sum::<f64>();
        let shares = Mat::from_fn(modes.len(), 1, |j, _| modes[j].1 / sum);
        if modes.is_empty() {
            return vec![Mat::zeros(self.actions(), 1); worths.len()];
        }
        self.local_values(at.as_ref(), worths).0.iter().map(|values| values * &shares).collect()
    }

    /// Local values of some tasks at points, and their places where there is a map; zeros and no places where a point is not finite,
    /// since nothing is near it.
    fn local_values(&self, points: MatRef<'_, f32>, worths: &[Mat<f64>]) -> (Vec<Mat<f64>>, Option<Vec<[f64; 2]>>) {
        // The column of a matrix of our own lies in one piece.
        let tasks = worths.len();
        let worths = worths.iter().filter_map(|worth| Some(worth.as_ref().col(0).try_as_col_major()?.as_slice()));
        let map = self.map_of_values();
        let coordinates = map.iter().flat_map(|map| map.coordinates());
        let worths: Vec<&[f64]> = worths.chain(coordinates).collect();
        let values = self.instances.as_ref().and_then(|instances| instances.action_values(&worths, points).ok());
        let Some(mut values) = values else {
            return (vec![Mat::zeros(self.actions(), points.ncols()); tasks], None);
        };
        let found = values.split_off(tasks);
        let places = |map: &FloorMap| (0..points.ncols()).map(|j| map.place(&found, j)).collect();
        (values, map.map(places))
    }

    /// A hash over dictionary, features and policy weights, bit by bit.
    pub fn digest(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(self.model_digest_input());
        hash.update(self.instances_digest_input());
        hash.update(self.places_digest_input());
        for weights in self.weights.iter().chain(&self.heedless) {
            hash.update(bytes_of(weights.as_ref()));
        }
        if let Some(map) = &self.map {
            hash.update(bytes_of_points(map.instances().points()));
            hash.update(bytes_of(map.places().as_ref()));
        }
        for region in self.regions.iter().flatten() {
            hash.update(region.within().to_le_bytes());
            hash.update(region.unlike().to_le_bytes());
            hash.update(bytes_of_points(region.marks()));
            hash.update(bytes_of(region.marked()));
        }
        hex(&hash.finalize())
    }

    /// A hash over dictionary and features alone.
    pub fn model_digest(&self) -> String {
        hex(&Sha256::digest(self.model_digest_input()))
    }

    /// A hash over one task's weights, and over where actions were tried.
    pub fn policy_digest(&self, task: usize) -> String {
        let hash = Sha256::new().chain_update(self.instances_digest_input()).chain_update(self.places_digest_input());
        hex(&hash.chain_update(bytes_of(self.weights[task].as_ref())).finalize())
    }

    fn instances_digest_input(&self) -> Vec<u8> {
        let Some(instances) = &self.instances else { return Vec::new() };
        let options = instances.options();
        let mut bytes = Vec::new();
        bytes.extend((options.neighbours as u64).to_le_bytes());
        bytes.extend(options.ridge.to_le_bytes());
        bytes.extend(instances.counts().iter().flat_map(|&count| (count as u64).to_le_bytes()));
        bytes.extend(bytes_of_points(instances.points()));
        bytes
    }

    fn places_digest_input(&self) -> Vec<u8> {
        let bits = self.places.iter().flat_map(|map| map.metric().to_bits());
        let goals = self.places.iter().flat_map(PlaceMap::goals).flat_map(|goal| bytes_of(goal.to_matrix().as_ref()));
        bits.flat_map(u64::to_le_bytes).chain(goals).collect()
    }

    fn model_digest_input(&self) -> Vec<u8> {
        let model = &self.model;
        let mut bytes = Vec::new();
        bytes.extend(self.sigma().to_le_bytes());
        bytes.extend(self.exponent().to_le_bytes());
        for j in 0..model.members.ncols() {
            bytes.extend(model.members.col(j).iter().flat_map(|value| value.to_le_bytes()));
        }
        bytes.extend(bytes_of(model.projection.as_ref()));
        bytes.extend(model.offset.iter().flat_map(|value| value.to_le_bytes()));
        bytes
    }
}

/// Points column by column.
fn bytes_of_points(points: MatRef<'_, f32>) -> Vec<u8> {
    points.col_iter().flat_map(|point| point.iter().copied().collect::<Vec<f32>>()).flat_map(f32::to_le_bytes).collect()
}

fn bytes_of(matrix: MatRef<'_, f64>) -> Vec<u8> {
    (0..matrix.ncols()).flat_map(|j| matrix.col(j).iter().flat_map(|value| value.to_le_bytes())).collect()
}
