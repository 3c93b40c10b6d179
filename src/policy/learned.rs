//! What was learned: slow features and, for each task, the worth of each action.

use std::cell::OnceCell;
use std::ops::Range;
use std::sync::Arc;

use faer::{Mat, MatRef, Par};
use sha2::{Digest, Sha256};

use super::metric;
use super::pixel_values::{PixelPoints, PixelValues, PolicyError};
use super::region::GoalRegion;
use crate::robot::{ActionValues, MOST_ACTIONS};
use crate::scenario::hex;
use crate::slow::SlowModel;
use crate::value::Instances;
use crate::vision::Observation;

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
    /// Of local values: where actions were tried, in coordinates of the slowest features (`N` transitions).
    pub instances: Option<Arc<Instances>>,
    /// Centres of the goal areas that the weights were fitted for, by task, where they are known; none: those of the scenario.
    pub goals: Vec<Option<[f64; 2]>>,
    /// What counts as being at the goal, by task; `None` where no marks say it. None at all without such a task.
    pub regions: Vec<Option<GoalRegion>>,
    /// The same Q-values, straight from pixels.
    values: Values,
    /// Where values are linear: points of observations in the regions' coordinates.
    region_points: Option<PixelPoints>,
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
    /// The point in coordinates of the slowest features, `p × 1`.
    point: OnceCell<Mat<f32>>,
}

impl State<'_> {
    /// Q-values for one task.
    ///
    /// # Panics
    /// As [`Learned::q_values`].
    pub fn q_values(&self, task: usize) -> ActionValues {
        match &self.learned.values {
            Values::Linear(values) => values.of(self.observation, task),
            Values::Local(points) => self.learned.local_values_at(self.point(points), task..task + 1)[0],
        }
    }

    /// Whether this is the goal of a task that was shown; never without marks.
    ///
    /// # Panics
    /// As [`Learned::q_values`].
    pub fn is_there(&self, task: usize) -> bool {
        let Some(Some(region)) = self.learned.regions.get(task) else { return false };
        let points = match &self.learned.values {
            Values::Linear(_) => self.learned.region_points.as_ref(),
            Values::Local(points) => Some(points),
        };
        points.is_some_and(|points| region.holds(self.point(points))[0])
    }

    fn point(&self, points: &PixelPoints) -> MatRef<'_, f32> {
        self.point.get_or_init(|| as_point(points, self.observation)).as_ref()
    }
}

fn as_point(points: &PixelPoints, observation: &Observation) -> Mat<f32> {
    let point = points.of(observation);
    Mat::from_fn(point.len(), 1, |i, _| point[i] as f32)
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
        let (goals, regions, region_points) = (Vec::new(), Vec::new(), None);
        Ok(Learned { epoch, asked_at, frames, model, weights, instances: None, goals, regions, values, region_points })
    }

    /// Features with local values: where actions were tried, as [`points`](super::points) of the model, and what each
    /// transition is worth for each task, `N × 1`.
    ///
    /// # Errors
    /// Support vectors that are no observations, transitions of other actions or in more coordinates than there are features,
    /// worths of another number of transitions.
    pub fn local(
        epoch: u32,
        asked_at: u64,
        frames: u64,
        model: SlowModel<f32>,
        instances: Arc<Instances>,
        worth: Vec<Mat<f64>>,
    ) -> Result<Self, PolicyError> {
        if !(1..=MOST_ACTIONS).contains(&instances.counts().len()) {
            return Err(PolicyError::Instances { actions: instances.counts().len() });
        }
        let found = instances.points().nrows();
        if found > model.slowness.len() {
            return Err(PolicyError::Coordinates { found, features: model.slowness.len() });
        }
        for (task, of_task) in worth.iter().enumerate() {
            if of_task.nrows() != instances.len() || of_task.ncols() != 1 {
                let found = of_task.nrows() * of_task.ncols();
                return Err(PolicyError::Worth { task, found, expected: instances.len() });
            }
        }
        let values = Values::Local(PixelPoints::new(&model, metric::weights(&model, found).as_ref())?);
        Ok(Learned {
            epoch,
            asked_at,
            frames,
            model,
            weights: worth,
            instances: Some(instances),
            goals: Vec::new(),
            regions: Vec::new(),
            values,
            region_points: None,
        })
    }

    /// The same, fitted for goals with these centres, by task.
    pub fn for_goals(self, goals: Vec<Option<[f64; 2]>>) -> Self {
        Learned { goals, ..self }
    }

    /// The same, with what counts as being at each task's goal.
    ///
    /// # Errors
    /// Regions in more coordinates than there are features, or in others than local values have.
    pub fn with_regions(self, regions: Vec<Option<GoalRegion>>) -> Result<Self, PolicyError> {
        let mut region_points = None;
        for found in regions.iter().flatten().map(|region| region.marks().nrows()) {
            let of_values = self.instances.as_ref().map(|instances| instances.points().nrows());
            if found > self.model.slowness.len() || of_values.is_some_and(|of_values| of_values != found) {
                return Err(PolicyError::Coordinates {
                    found,
                    features: of_values.unwrap_or(self.model.slowness.len()),
                });
            }
            if of_values.is_none() && region_points.is_none() {
                region_points = Some(PixelPoints::new(&self.model, metric::weights(&self.model, found).as_ref())?);
            }
        }
        Ok(Learned { regions, region_points, ..self })
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
        State { learned: self, observation, point: OnceCell::new() }
    }

    /// Q-values of an observation for every task: the same as [`Learned::q_values`] of each, at the cost of one where values are
    /// local.
    ///
    /// # Panics
    /// If the observation is not of the size that the scenario sets, see [`Learned::features`].
    pub fn q_values_of_all_tasks(&self, observation: &Observation) -> Vec<ActionValues> {
        match &self.values {
            Values::Linear(values) => (0..self.weights.len()).map(|task| values.of(observation, task)).collect(),
            Values::Local(points) => {
                self.local_values_at(as_point(points, observation).as_ref(), 0..self.weights.len())
            }
        }
    }

    /// Local values of some tasks for what the camera sees.
    fn local_values_at(&self, point: MatRef<'_, f32>, tasks: Range<usize>) -> Vec<ActionValues> {
        self.local_values(point, tasks).iter().map(|q| ActionValues::new(q.col(0).iter().copied())).collect()
    }

    /// Whether there is a goal to pursue: one that is `shown` needs marks.
    pub fn has_goal(&self, task: usize, shown: bool) -> bool {
        !shown || self.regions.get(task).is_some_and(Option::is_some)
    }

    /// Whether observations are at the goal of a task that was shown, by their features, `f × n`.
    pub fn are_there(&self, phi: MatRef<'_, f64>, task: usize) -> Vec<bool> {
        match self.regions.get(task) {
            Some(Some(region)) => region.holds(metric::points(&self.model, phi, region.marks().nrows()).as_ref()),
            _ => vec![false; phi.ncols()],
        }
    }

    /// Q-values of observations for all tasks from their features: `phi: f × n` gives `actions × n` for each.
    ///
    /// # Panics
    /// If these are not features of the model.
    pub fn q_values_of(&self, phi: MatRef<'_, f64>) -> Vec<Mat<f64>> {
        match &self.instances {
            None => self.weights.iter().map(|weights| weights.transpose() * phi).collect(),
            Some(instances) => {
                let points = metric::points(&self.model, phi, instances.points().nrows());
                self.local_values(points.as_ref(), 0..self.weights.len())
            }
        }
    }

    /// Local values of some tasks at points; zeros where a point is not finite, since nothing is near it.
    fn local_values(&self, points: MatRef<'_, f32>, tasks: Range<usize>) -> Vec<Mat<f64>> {
        // The column of a matrix of our own lies in one piece.
        let worths: Vec<&[f64]> = self.weights[tasks]
            .iter()
            .filter_map(|worth| Some(worth.as_ref().col(0).try_as_col_major()?.as_slice()))
            .collect();
        let values = self.instances.as_ref().map(|instances| instances.action_values(&worths, points));
        values.and_then(Result::ok).unwrap_or_else(|| vec![Mat::zeros(self.actions(), points.ncols()); worths.len()])
    }

    /// A hash over dictionary, features and policy weights, bit by bit.
    pub fn digest(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(self.model_digest_input());
        hash.update(self.instances_digest_input());
        for weights in &self.weights {
            hash.update(bytes_of(weights.as_ref()));
        }
        for region in self.regions.iter().flatten() {
            hash.update(region.within().to_le_bytes());
            hash.update(bytes_of_points(region.marks()));
            hash.update(bytes_of_points(region.states()));
            hash.update(bytes_of(region.places().as_ref()));
        }
        hex(&hash.finalize())
    }

    /// A hash over dictionary and features alone.
    pub fn model_digest(&self) -> String {
        hex(&Sha256::digest(self.model_digest_input()))
    }

    /// A hash over one task's weights, and over where actions were tried.
    pub fn policy_digest(&self, task: usize) -> String {
        let hash = Sha256::new().chain_update(self.instances_digest_input());
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
