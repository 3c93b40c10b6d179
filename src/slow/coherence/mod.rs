//! Other objectives of temporal coherence: the same principle as slow feature analysis, in another form.
//!
//! All of them look for maps `φ(x) = Wᵀx − c` of given inputs (raw, expanded, or the Newton coordinates of a kernel) that
//! change little from frame to frame and yet vary over time:
//!
//! | | objective | solved by | features are decorrelated |
//! |---|---|---|---|
//! | [`crate::slow::solve`] | min `⟨φ̇²⟩` with unit variance | eigenvalues | exactly |
//! | [`bray`] | max long-term / short-term variance | eigenvalues | in these variances |
//! | [`gradient`] | max `F`, a weighted sum of penalties | gradient ascent, batch or online | softly |
//! | [`network`] | that of `gradient`, layer upon layer | the same, online | softly |
//! | [`incremental`] | min `⟨φ̇²⟩` with unit variance | incremental principal and minor components | in the limit |
//!
//! Symbols: inputs `x` (`d` values), `n` frames, `k` features, weights `W` (`d × k`), offset `c` (`k`),
//! derivative `ẋ = (x_t − x_{t−1})/Δt`, where a frame has a [`Link`] to the one before it.
//!
//! # Reference
//! Thesis §4.1.1 (*other approaches*).

pub mod bray;
pub mod gradient;
pub mod incremental;
pub mod network;

use faer::{Mat, MatRef, Par};
use thiserror::Error;

use super::error::SlowError;
use super::links::{Link, check_links};
use super::moments::Moments;

/// Why there are no coherent features.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum CoherenceError {
    /// Lists or matrices that do not fit each other.
    #[error("{what} has {found}, but {expected} is needed")]
    Shape {
        /// What does not fit.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size that fits.
        expected: usize,
    },
    /// An input that is not a number.
    #[error("input {row} of frame {frame} is {value}: it must be finite")]
    NotFinite {
        /// Which input.
        row: usize,
        /// Which frame.
        frame: usize,
        /// Its value.
        value: f64,
    },
    /// A parameter out of range.
    #[error("{name} = {value} is not allowed: it must be {allowed}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// More features than inputs, or none.
    #[error("{asked} features of {most} inputs are asked for: allowed are 1 to {most}")]
    Features {
        /// Features asked for.
        asked: usize,
        /// Number of inputs.
        most: usize,
    },
    /// More weights than can be held.
    #[error("{features} features of {inputs} inputs have more than {MOST_WEIGHTS} weights: reduce the inputs first")]
    TooManyWeights {
        /// Features, or components that are made white.
        features: usize,
        /// Number of inputs.
        inputs: usize,
    },
    /// Too few frames that follow each other.
    #[error("at least 2 frames that follow each other are needed: there are {frames} frames with {links} links")]
    TooShort {
        /// Number of frames.
        frames: usize,
        /// Number of links.
        links: usize,
    },
    /// A feature that does not vary has no slowness.
    #[error("feature {feature} has variance {variance}: it must vary, and be finite")]
    NoVariance {
        /// Which feature.
        feature: usize,
        /// Its variance.
        variance: f64,
    },
    /// Numbers ran away.
    #[error(
        "the weights are no longer finite after {steps} steps: scale the inputs to variance 1, or lower the learning rate"
    )]
    Diverged {
        /// Steps taken.
        steps: usize,
    },
    /// What the eigenvalue solver refuses.
    #[error(transparent)]
    Slow(#[from] SlowError),
}

impl CoherenceError {
    fn unless_fits(what: &'static str, found: usize, expected: usize) -> Result<(), CoherenceError> {
        if found == expected { Ok(()) } else { Err(CoherenceError::Shape { what, found, expected }) }
    }

    fn unless(fits: bool, name: &'static str, value: f64, allowed: &'static str) -> Result<(), CoherenceError> {
        if fits { Ok(()) } else { Err(CoherenceError::Parameter { name, value, allowed }) }
    }
}

/// A linear map to features, `φ(x) = Wᵀx − c`.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearMap {
    /// Weights `W`, `d × k`, one feature a column.
    pub weights: Mat<f64>,
    /// Offset `c`, `k`.
    pub offset: Vec<f64>,
}

impl LinearMap {
    /// The map with weights `W` that gives features of mean 0 on inputs of the given mean (`d × 1`).
    fn centred(weights: Mat<f64>, mean: MatRef<'_, f64>) -> Self {
        let offset = weights.transpose() * mean;
        LinearMap { offset: (0..weights.ncols()).map(|i| offset[(i, 0)]).collect(), weights }
    }

    /// Features of inputs: `x: d × n` gives `k × n`.
    ///
    /// # Errors
    /// Inputs of another length than the weights, an offset of another length than the features.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, CoherenceError> {
        CoherenceError::unless_fits("the number of inputs", x.nrows(), self.weights.nrows())?;
        CoherenceError::unless_fits("the length of the offset", self.offset.len(), self.weights.ncols())?;
        let mut phi = self.weights.transpose() * x;
        for t in 0..phi.ncols() {
            for (i, offset) in self.offset.iter().enumerate() {
                phi[(i, t)] -= offset;
            }
        }
        Ok(phi)
    }
}

/// Refuse a frame with values that are not finite.
fn check_frame(frame: usize, x: impl IntoIterator<Item = f64>) -> Result<(), CoherenceError> {
    match x.into_iter().enumerate().find(|(_, value)| !value.is_finite()) {
        Some((row, value)) => Err(CoherenceError::NotFinite { row, frame, value }),
        None => Ok(()),
    }
}

/// Check a recorded series; its links, of which the first is none.
fn checked_series(x: MatRef<'_, f64>, links: &[Option<Link>]) -> Result<Vec<Option<Link>>, CoherenceError> {
    CoherenceError::unless_fits("the list of links", links.len(), x.ncols())?;
    let mut links = links.to_vec();
    if let Some(first) = links.first_mut() {
        *first = None;
    }
    check_links(&links)?;
    for frame in 0..x.ncols() {
        check_frame(frame, x.col(frame).iter().copied())?;
    }
    let linked = links.iter().flatten().filter(|link| link.weight > 0.0).count();
    if linked == 0 {
        return Err(CoherenceError::TooShort { frames: x.ncols(), links: linked });
    }
    Ok(links)
}

/// Mean, covariance and derivative power of a recorded series.
fn moments_of(x: MatRef<'_, f64>, links: &[Option<Link>]) -> Result<Moments, CoherenceError> {
    let links = checked_series(x, links)?;
    let mut moments = Moments::new(Par::Seq);
    moments.widen(x.nrows())?;
    moments.add_series(x, &links, None)?;
    Ok(moments)
}

/// The most weights that a stream follows: 2 GiB. Those who have more inputs begin with fewer of them.
const MOST_WEIGHTS: usize = 1 << 28;

/// Refuse `k` features of `d` inputs, unless `1 ≤ k ≤ d` and their weights can be held.
fn check_features(k: usize, d: usize) -> Result<(), CoherenceError> {
    match d.checked_mul(k) {
        _ if k == 0 || k > d => Err(CoherenceError::Features { asked: k, most: d }),
        Some(weights) if weights <= MOST_WEIGHTS => Ok(()),
        _ => Err(CoherenceError::TooManyWeights { features: k, inputs: d }),
    }
}

/// A random start: `d × k` standard normal numbers.
fn random_weights(d: usize, k: usize, rng: &mut impl rand::Rng) -> Mat<f64> {
    use rand_distr::{Distribution, StandardNormal};
    Mat::from_fn(d, k, |_, _| StandardNormal.sample(rng))
}

/// `Wᵀx` for one column.
fn project(weights: &Mat<f64>, x: &[f64]) -> Vec<f64> {
    weights.col_iter().map(|column| column.iter().zip(x).map(|(weight, value)| weight * value).sum()).collect()
}
