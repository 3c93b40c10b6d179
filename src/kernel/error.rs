//! What the kernel module refuses.

use thiserror::Error;

/// A kernel with invalid parameters, or one applied to observations that do not fit.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum KernelError {
    /// The width must be positive, and its square a positive number.
    #[error("kernel width sigma = {0} is not allowed: it must be > 0 and finite (in 1e-150 to 1e150)")]
    Width(f64),
    /// A radial kernel is positive definite for exponents in (0, 2] only.
    #[error("kernel exponent = {0} is not allowed: it must be in (0, 2], else the kernel is not positive definite")]
    Exponent(f64),
    /// The degree of a polynomial kernel.
    #[error("kernel degree = {0} is not allowed: it must be in 1 to 2147483647")]
    Degree(u32),
    /// A polynomial kernel is positive definite for every degree if its offset is not negative.
    #[error("kernel offset = {0} is not allowed: it must be ≥ 0 and finite, else the kernel is not positive definite")]
    Offset(f64),
    /// Matrices that do not fit each other.
    #[error("{what} has {found}, but {expected} is needed")]
    Shape {
        /// What does not fit.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size that fits.
        expected: usize,
    },
    /// Observations that kernel values cannot be formed of.
    #[error("{what} {index} holds a value that is not finite, or one too large to be squared")]
    NotFinite {
        /// Which kind of observation.
        what: &'static str,
        /// Its column.
        index: usize,
    },
    /// Kernel values too large for `f64`.
    #[error("the kernel values of these observations are too large for f64: scale the observations down")]
    Overflow,
    /// A suggestion of σ needs at least two different observations.
    #[error(
        "no width can be suggested from {0} observations with median distance {1}: at least two different ones are needed"
    )]
    NoSpread(usize, f64),
    /// Principal components need variance, hence two samples.
    #[error("kernel principal components need at least 2 {what}: there are {found}")]
    TooFew {
        /// Samples or support vectors.
        what: &'static str,
        /// How many there are.
        found: usize,
    },
    /// More components than there are directions with variance, or none.
    #[error(
        "{asked} components are asked for, but the samples span {rank} directions only: {}",
        if *rank == 0 { "none can be had".to_owned() } else { format!("allowed are 1 to {rank}") }
    )]
    Components {
        /// Components asked for.
        asked: usize,
        /// Directions in which the samples vary.
        rank: usize,
    },
    /// The eigenvalue iteration did not converge.
    #[error("the eigenvalues of a {0} × {0} matrix did not converge")]
    Eigenvalues(usize),
}
