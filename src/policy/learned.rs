//! What was learned: slow features and, for each task, the worth of each action.

use faer::{Mat, MatRef, Par};
use sha2::{Digest, Sha256};

use super::pixel_values::{PixelValues, PolicyError};
use crate::scenario::hex;
use crate::slow::SlowModel;
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
    /// Q-weights of each task, `f × 3`: `Q(x, a) = φ(x)ᵀ w_a`.
    pub weights: Vec<Mat<f64>>,
    /// Centres of the goal areas that the weights were fitted for, by task; none: those of the scenario.
    pub goals: Vec<[f64; 2]>,
    /// The same Q-values, straight from pixels.
    values: PixelValues,
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
    /// Features with the weights of each task, `f × 3`.
    ///
    /// # Errors
    /// Support vectors that are no observations, weights that do not fit the features or the three actions.
    pub fn new(
        epoch: u32,
        asked_at: u64,
        frames: u64,
        model: SlowModel<f32>,
        weights: Vec<Mat<f64>>,
    ) -> Result<Self, PolicyError> {
        let values = PixelValues::new(&model, &weights)?;
        Ok(Learned { epoch, asked_at, frames, model, weights, goals: Vec::new(), values })
    }

    /// The same, fitted for goals with these centres, by task.
    pub fn for_goals(self, goals: Vec<[f64; 2]>) -> Self {
        Learned { goals, ..self }
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

    /// Q-values of an observation for one task, for driving and trials alike; no memory is allocated.
    ///
    /// # Panics
    /// If the observation is not of the size that the scenario sets, see [`Learned::features`].
    pub fn q_values(&self, observation: &Observation, task: usize) -> [f64; 3] {
        self.values.of(observation, task)
    }

    /// A hash over dictionary, features and policy weights, bit by bit.
    pub fn digest(&self) -> String {
        let mut hash = Sha256::new();
        hash.update(self.model_digest_input());
        for weights in &self.weights {
            hash.update(bytes_of(weights.as_ref()));
        }
        hex(&hash.finalize())
    }

    /// A hash over dictionary and features alone.
    pub fn model_digest(&self) -> String {
        hex(&Sha256::digest(self.model_digest_input()))
    }

    /// A hash over one task's weights.
    pub fn policy_digest(&self, task: usize) -> String {
        hex(&Sha256::digest(bytes_of(self.weights[task].as_ref())))
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

fn bytes_of(matrix: MatRef<'_, f64>) -> Vec<u8> {
    (0..matrix.ncols()).flat_map(|j| matrix.col(j).iter().flat_map(|value| value.to_le_bytes())).collect()
}
