//! Q-values, and points in the metric of slow features, straight from an observation's pixels: what a decision costs while driving.

use faer::{Mat, MatRef};
use thiserror::Error;

use crate::kernel::Kernel;
use crate::robot::{ActionValues, MOST_ACTIONS};
use crate::slow::{SlowError, SlowModel};
use crate::value::ValueError;
use crate::vision::{Observation, ZERO};

/// Values whose products with a support vector are summed in 32 bits: each is below 128 · 255 in size.
const CHUNK: usize = 1 << 16;

/// Why a model cannot be acted on.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum PolicyError {
    /// A support vector that no observation can be.
    #[error("support vector {index} holds {value}: values of observations are whole numbers from -128 to 127")]
    NotAnObservation {
        /// Which support vector, from 0.
        index: usize,
        /// What it holds.
        value: f32,
    },
    /// Weights for other features, or for another number of actions.
    #[error(
        "the weights of task {task} are for {actions} actions; a robot has 1 to {MOST_ACTIONS}, the same for all tasks"
    )]
    Actions {
        /// Which task, from 0.
        task: usize,
        /// Columns of its weights.
        actions: usize,
    },
    /// Weights that do not fit the features.
    #[error(transparent)]
    Features(#[from] SlowError),
    /// Local values with another number of actions.
    #[error("{actions} actions were tried; a robot has 1 to {MOST_ACTIONS}")]
    Instances {
        /// Actions of the transitions.
        actions: usize,
    },
    /// What transitions are worth, for others than there are.
    #[error("task {task} tells the worth of {found} transitions, but there are {expected}")]
    Worth {
        /// Which task, from 0.
        task: usize,
        /// Transitions that it tells of.
        found: usize,
        /// Transitions that there are.
        expected: usize,
    },
    /// Places that are none.
    #[error(transparent)]
    Places(#[from] ValueError),
    /// Transitions in coordinates of another model.
    #[error("transitions have {found} coordinates, but there are {features} slow features")]
    Coordinates {
        /// Coordinates of the transitions.
        found: usize,
        /// Features of the model.
        features: usize,
    },
}

/// Support vectors as bytes, and their kernel values with an observation.
///
/// Observations are bytes, so support vectors are kept as bytes too: reading them is what takes the time, and this is a
/// quarter of the `f32` values. Products `sᵀx` of whole numbers are exact in any order, hence the same bits on any
/// machine, and the same as those of [`Kernel::matrix`] where these are exact.
#[derive(Debug, Clone)]
struct PixelRows {
    kernel: Kernel,
    /// Values of an observation `d`.
    length: usize,
    /// Support vectors one after another, `d` bytes each.
    members: Vec<i8>,
    /// For each support vector `128 Σ s` and `‖s‖²`.
    sums: Vec<(f64, f64)>,
}

impl PixelRows {
    fn new(model: &SlowModel<f32>) -> Result<Self, PolicyError> {
        let mut members = Vec::with_capacity(model.members.nrows() * model.members.ncols());
        let mut sums = Vec::with_capacity(model.members.ncols());
        for (index, member) in model.members.col_iter().enumerate() {
            let (mut sum, mut norm) = (0.0, 0.0);
            for &value in member.iter() {
                let byte = value as i8;
                if f32::from(byte) != value {
                    return Err(PolicyError::NotAnObservation { index, value });
                }
                members.push(byte);
                sum += f64::from(value);
                norm += f64::from(value) * f64::from(value);
            }
            sums.push((f64::from(ZERO) * sum, norm));
        }
        Ok(PixelRows { kernel: model.kernel, length: model.members.nrows(), members, sums })
    }

    /// The kernel values of an observation with all support vectors, one after another.
    fn of<'a>(&'a self, observation: &'a Observation) -> impl Iterator<Item = f64> + 'a {
        let pixels = observation.pixels.as_slice();
        assert_eq!(pixels.len(), self.length, "observations and support vectors have the size that the scenario sets");
        let norm: f64 = observation.values().map(|value| f64::from(value) * f64::from(value)).sum();
        let members = self.members.chunks_exact(self.length.max(1));
        members.zip(&self.sums).map(move |(member, &(sum, member_norm))| {
            // Σ s (p − 128) = Σ s p − 128 Σ s.
            self.kernel.value(product(member, pixels) - sum, member_norm, norm)
        })
    }
}

/// Q-values of all tasks as functions of kernel values, `Q(x, a) = b_aᵀk(x) + c_a`, over support vectors as bytes.
///
/// With features `φ(x) = [1, Aᵀk(x) − c]` and weights `w_a = [w₀, w]`, `Q(x, a) = w_aᵀφ(x)` is the same as
/// `(Aw)ᵀk(x) + (w₀ − cᵀw)`. `Aw` is made once for each model, so a decision needs one kernel value and three products for
/// each support vector, whatever the number of features, and no memory is allocated.
///
/// The memory taken is `m (d + 16 + 24 · tasks)` bytes for `m` support vectors of `d` values.
#[derive(Debug, Clone)]
pub struct PixelValues {
    rows: PixelRows,
    tasks: Vec<Task>,
}

/// One task's Q-values.
#[derive(Debug, Clone)]
struct Task {
    /// `b_a` at each support vector: the actions of the first one, then of the second, …
    coefficients: Vec<f64>,
    /// `c_a`.
    constant: ActionValues,
}

impl PixelValues {
    /// The Q-values of a model with the weights of each task, `f × actions`.
    ///
    /// # Errors
    /// Support vectors that are not whole numbers from −128 to 127, weights that do not fit the model's features, or of
    /// more than [`MOST_ACTIONS`] actions.
    pub fn new(model: &SlowModel<f32>, all: &[Mat<f64>]) -> Result<Self, PolicyError> {
        let rows = PixelRows::new(model)?;
        let task = |(task, weights): (usize, &Mat<f64>)| {
            let actions = all.first().map_or(0, Mat::ncols);
            if !(1..=MOST_ACTIONS).contains(&actions) || weights.ncols() != actions {
                return Err(PolicyError::Actions { task, actions: weights.ncols() });
            }
            let (b, c) = model.over_kernel_values(weights.as_ref())?;
            let coefficients = (0..b.nrows()).flat_map(|i| b.row(i).iter().copied().collect::<Vec<_>>()).collect();
            Ok(Task { coefficients, constant: ActionValues::new(c) })
        };
        let tasks: Result<Vec<Task>, PolicyError> = all.iter().enumerate().map(task).collect();
        Ok(PixelValues { rows, tasks: tasks? })
    }

    /// Q-values of an observation for one task.
    ///
    /// # Panics
    /// If there is no such task, or if the observation has another number of pixels than the support vectors.
    pub fn of(&self, observation: &Observation, task: usize) -> ActionValues {
        let task = &self.tasks[task];
        let mut q = task.constant;
        let coefficients = task.coefficients.chunks_exact(q.len().max(1));
        for (value, coefficients) in self.rows.of(observation).zip(coefficients) {
            for (q, coefficient) in q.iter_mut().zip(coefficients) {
                *q += coefficient * value;
            }
        }
        q
    }
}

/// Points of observations in the metric of the slowest features, over support vectors as bytes; as [`PixelValues`] with
/// coordinates in place of values.
///
/// The memory taken is `m (d + 16 + 8p)` bytes for `p` coordinates.
#[derive(Debug, Clone)]
pub struct PixelPoints {
    rows: PixelRows,
    /// `p` coefficients for each support vector.
    coefficients: Vec<f64>,
    constants: Vec<f64>,
}

impl PixelPoints {
    /// Linear functions of a model's features, `f × p`, of observations.
    ///
    /// # Errors
    /// Support vectors that are not whole numbers from −128 to 127, weights that do not fit the model's features.
    pub fn new(model: &SlowModel<f32>, weights: MatRef<'_, f64>) -> Result<Self, PolicyError> {
        let rows = PixelRows::new(model)?;
        let (b, constants) = model.over_kernel_values(weights)?;
        let coefficients = (0..b.nrows()).flat_map(|i| b.row(i).iter().copied().collect::<Vec<_>>()).collect();
        Ok(PixelPoints { rows, coefficients, constants })
    }

    /// The point of an observation.
    ///
    /// # Panics
    /// If the observation has another number of pixels than the support vectors.
    pub fn of(&self, observation: &Observation) -> Vec<f64> {
        let mut point = self.constants.clone();
        let coefficients = self.coefficients.chunks_exact(self.constants.len().max(1));
        for (value, coefficients) in self.rows.of(observation).zip(coefficients) {
            for (coordinate, coefficient) in point.iter_mut().zip(coefficients) {
                *coordinate += coefficient * value;
            }
        }
        point
    }
}

/// `Σ s p`, exact, with the widest instructions that this machine has.
fn product(member: &[i8], pixels: &[u8]) -> f64 {
    let arch = pulp::Arch::new();
    let parts = member.chunks(CHUNK).zip(pixels.chunks(CHUNK));
    parts
        .map(|(member, pixels)| {
            f64::from(arch.dispatch(
                #[inline(always)]
                || short_product(member, pixels),
            ))
        })
        .sum()
}

/// `Σ s p` over so few values that it stays within 32 bits. A loop that becomes vector instructions where it is inlined.
#[inline(always)]
fn short_product(member: &[i8], pixels: &[u8]) -> i32 {
    member.iter().zip(pixels).map(|(&s, &p)| i32::from(s) * i32::from(p)).sum()
}
