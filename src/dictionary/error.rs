//! What dictionaries and selections refuse.

use thiserror::Error;

use crate::kernel::KernelError;

/// What a dictionary or a selection refuses.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum DictionaryError {
    /// ν must be positive: with ν = 0 rounding alone decides.
    #[error("nu = {0} is not allowed: it must be > 0 and finite, and below k(x, x) to select anything")]
    Nu(f64),
    /// A dictionary without room.
    #[error("a budget of 0 support vectors is not allowed: at least 1 is needed")]
    Budget,
    /// Observations of another length than the support vectors.
    #[error("an observation has {found} values, but the dictionary was begun with {expected}")]
    Dimension {
        /// Values per support vector.
        expected: usize,
        /// Values per observation given.
        found: usize,
    },
    /// Matrices that do not fit each other.
    #[error("{what} is {found}, but {expected} is needed")]
    Shape {
        /// What does not fit.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size that fits.
        expected: usize,
    },
    /// Support vectors that cannot be kept.
    #[error("{found} places to keep are given, but they must be ascending and within the {size} support vectors")]
    Keep {
        /// Places given.
        found: usize,
        /// Support vectors.
        size: usize,
    },
    /// Frames of a stream without one link each.
    #[error("there are {found} links for {expected} frames: one each is needed, None where a frame follows no other")]
    Links {
        /// Links given.
        found: usize,
        /// Frames given.
        expected: usize,
    },
    /// A selection that cannot fill the dictionary of a stream.
    #[error(
        "a stream needs a selection that streams (this one: {streaming}) and is empty (this one: {members} members)"
    )]
    NotForStreams {
        /// Whether it streams.
        streaming: bool,
        /// Support vectors it holds already.
        members: usize,
    },
    /// A target size that no width gives.
    #[error("{target} support vectors cannot be selected from {observations} observations: allowed are 1 to {largest}")]
    Target {
        /// Support vectors asked for.
        target: usize,
        /// Observations given.
        observations: usize,
        /// The most that can be had.
        largest: usize,
    },
    /// Features of observations could not be computed.
    #[error("features of the observations: {0}")]
    Features(String),
    /// What the kernel refuses.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// A value that is not a number, or too large for the kernel.
    #[error("observation {0} of the block holds a value that is not finite, or one whose kernel value is not")]
    NotFinite(usize),
}

/// ν as all selections allow it.
pub(super) fn check_nu(nu: f64) -> Result<f64, DictionaryError> {
    if nu > 0.0 && nu.is_finite() { Ok(nu) } else { Err(DictionaryError::Nu(nu)) }
}

/// A budget as all selections allow it.
pub(super) fn check_budget(budget: usize) -> Result<usize, DictionaryError> {
    if budget > 0 { Ok(budget) } else { Err(DictionaryError::Budget) }
}
