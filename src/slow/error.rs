//! What can be wrong with a signal, its moments, or what is asked of them.

use faer::MatRef;
use thiserror::Error;

use crate::dictionary::DictionaryError;
use crate::kernel::{Kernel, KernelError};

/// Why slow features could not be solved.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum SlowError {
    /// Too little was seen.
    #[error("slow features need at least 2 frames and 1 derivative: there are {frames} and a weight of {links}")]
    TooFewFrames {
        /// Frames in the moments.
        frames: f64,
        /// Sum of the weights of the derivatives.
        links: f64,
    },
    /// More features than there are directions with variance, or none.
    #[error(
        "{asked} features are asked for, but the observations span {rank} directions only: allowed are 1 to {rank}"
    )]
    Features {
        /// Features asked for.
        asked: usize,
        /// Directions in which the observations vary.
        rank: usize,
    },
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
    /// A model and a dictionary of different kernels.
    #[error("the model has the kernel {model}, the dictionary {dictionary}: they must be the same")]
    OtherKernel {
        /// Kernel of the model.
        model: Kernel,
        /// Kernel of the dictionary.
        dictionary: Kernel,
    },
    /// What the kernel refuses.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// What the dictionary refuses.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// λ must not be negative.
    #[error("lambda = {0} is not allowed: it must be ≥ 0 and finite")]
    Lambda(f64),
    /// The tolerance of an iteration.
    #[error("a tolerance of {0} is not allowed: it must be in (0, 1)")]
    Tolerance(f64),
    /// The sum of the weights of some derivatives.
    #[error("a weight of {0} is not allowed: it must be ≥ 0 and finite")]
    Weight(f64),
    /// A factor by which sums fade.
    #[error("a factor of {0} for fading is not allowed: it must be in [0, 1]")]
    Fade(f64),
    /// The time constant of a stream that forgets.
    #[error("a memory of {0} frames is not allowed: it must be > 0")]
    Memory(f64),
    /// More than can be held.
    #[error("{asked} {what} are asked for: allowed are at most {most}")]
    TooMany {
        /// What is asked for.
        what: &'static str,
        /// How many.
        asked: usize,
        /// The most that can be had.
        most: usize,
    },
    /// A time between frames, or a weight, that cannot be.
    #[error("frame {at} has a link with dt = {dt} and weight {weight}: dt must be > 0, the weight ≥ 0, both finite")]
    Link {
        /// Index of the frame.
        at: usize,
        /// Its time since the frame before it.
        dt: f64,
        /// Its weight.
        weight: f64,
    },
    /// A first link that leads nowhere.
    #[error("the first frame has a link, but no frame stands before it: give that frame, or None as its link")]
    NoPredecessor,
    /// The longest gap between linked frames.
    #[error("a longest gap of {0} is not allowed: it must be > 0")]
    Gap(f64),
    /// Lags must be given, and at least 1.
    #[error("lag {lag} is not allowed for {frames} frames: it must be 1 to {}", frames.saturating_sub(1))]
    Lag {
        /// The lag, in frames.
        lag: usize,
        /// Number of frames.
        frames: usize,
    },
    /// Sums never shrink.
    #[error("coordinate {asked} is out of the range of the sums, which have {size}")]
    Narrower {
        /// Coordinates there are.
        size: usize,
        /// Coordinates asked for.
        asked: usize,
    },
    /// A value that is not a number, or so large that its square is not.
    #[error("{0} not finite, or too large to be squared")]
    NotFinite(&'static str),
    /// A kernel matrix that is none.
    #[error("this is no kernel matrix: {0}")]
    Gram(String),
    /// The radius of a sphere.
    #[error("a radius of {0} is not allowed: it must be > 0 and finite")]
    Radius(f64),
    /// A share of the variance.
    #[error("a share {0} of the variance is not allowed: it must be in (0, 1]")]
    VarianceShare(f64),
    /// A limit for clipping.
    #[error("outputs cannot be clipped at ±{0}: the limit must be > 0 and finite")]
    Clip(f64),
    /// An expansion that no solver can hold.
    #[error("the expansion of {inputs} values has more than {most} monomials: reduce the number of values first")]
    Expansion {
        /// Values that are expanded.
        inputs: usize,
        /// Largest number of monomials that is allowed.
        most: usize,
    },
    /// A layer whose receptive fields do not cover its input.
    #[error(
        "fields of {field} with a stride of {stride} do not tile a {axis} of {size}: field ≤ {axis}, stride ≥ 1, and ({axis} − field) a multiple of the stride are needed"
    )]
    Tiling {
        /// "width" or "height".
        axis: &'static str,
        /// Width or height of the input.
        size: usize,
        /// Width or height of a field.
        field: usize,
        /// Distance of neighbouring fields.
        stride: usize,
    },
    /// A list that must not be empty.
    #[error("{0} empty: at least one is needed")]
    Empty(&'static str),
    /// A fault in one part of something larger.
    #[error("{place}: {cause}")]
    At {
        /// Which part.
        place: String,
        /// What is wrong there.
        cause: Box<SlowError>,
    },
    /// A class whose samples do not span their space.
    #[error(
        "the covariance of class {0} is singular: it has too few samples, or features that depend on each other; give a floor > 0"
    )]
    Singular(usize),
    /// The eigenvalue iteration did not converge; this points to values that are not finite.
    #[error("the eigenvalues of a {0} × {0} matrix did not converge: its values are not finite")]
    Eigenvalues(usize),
}

impl SlowError {
    /// Refuse what has another size than needed.
    pub(super) fn unless_fits(what: &'static str, found: usize, expected: usize) -> Result<(), SlowError> {
        if found == expected { Ok(()) } else { Err(SlowError::Shape { what, found, expected }) }
    }

    /// The same fault, with the place where it happened.
    pub(super) fn at(self, place: impl Into<String>) -> SlowError {
        SlowError::At { place: place.into(), cause: Box::new(self) }
    }

    /// Refuse a λ that is negative or not finite.
    pub(super) fn unless_lambda(lambda: f64) -> Result<(), SlowError> {
        if lambda >= 0.0 && lambda.is_finite() { Ok(()) } else { Err(SlowError::Lambda(lambda)) }
    }

    /// Refuse values that are not finite.
    pub(super) fn unless_finite(what: &'static str, x: MatRef<'_, f64>) -> Result<(), SlowError> {
        if x.col_iter().all(|column| column.iter().all(|value| value.is_finite())) {
            Ok(())
        } else {
            Err(SlowError::NotFinite(what))
        }
    }
}
