//! From moments to slow features.

use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, MatRef, Par, Side};
use thiserror::Error;

use super::moments::Moments;
use super::reveal::{no_variance, revealed};
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
    /// The eigenvalue iteration did not converge; this points to values that are not finite.
    #[error("the eigenvalues of a {0} × {0} matrix did not converge: its values are not finite")]
    Eigenvalues(usize),
}

/// The `k` slowest features of `m` Newton coordinates: `φ(x) = Wᵀ(v(x) − v̄)`.
#[derive(Debug, Clone)]
pub struct SlowFeatures {
    /// Weights `W`, `m × k`, one feature a column, slowest first.
    pub weights: Mat<f64>,
    /// Mean coordinates `v̄`, `m × 1`.
    pub mean: Mat<f64>,
    /// Slowness `Δ = wᵀḊw` of each feature on the training frames (without λ), ascending, `k`.
    pub slowness: Vec<f64>,
    /// Regulariser λ it was solved with.
    pub lambda: f64,
    /// Coordinates that say nothing new: `m` minus the number of independent directions with variance.
    pub rank_deficit: usize,
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
        let finite = (0..x.ncols()).all(|j| (0..x.nrows()).all(|i| x[(i, j)].is_finite()));
        if finite { Ok(()) } else { Err(SlowError::NotFinite(what)) }
    }
}

/// Eigenvalues below this share of the largest one are directions without variance: rounding of the sums is about
/// n·2⁻⁵³ of it.
pub(super) const RANK_TOLERANCE: f64 = 1e-13;

/// Features count as equally slow, and may be rotated among each other, when their slowness differs by less than this share.
const EQUAL_SLOWNESS: f64 = 1e-3;

/// The `features` slowest features: unit variance and no correlation on the training frames, slowest first.
///
/// Minimise `wᵀ(Ḋ + λI)w` subject to `wᵀCw = 1` and `w_iᵀCw_j = 0`. There are two ways to the same answer:
///
/// - **Regular** (λ > 0, `Ḋ + λI` well conditioned): with `RRᵀ = Ḋ + λI` the slowest features are the largest eigenvalues μ
///   of `M = R⁻¹CR⁻ᵀ`: `w = R⁻ᵀu/√μ`. This is the dense reference solver of the running agent.
/// - **Rank-revealing** (λ = 0, or no usable factor): redundant coordinates have directions with neither
///   variance nor derivative. They are found in `B = C + sḊ` and dropped, and their number is reported. The thesis's
///   listing removes the *zero eigenvalues of the covariance* instead; with any threshold above zero that also loses a truly
///   slow direction of little variance, the very thing that is looked for. In `B`, scaled to a unit diagonal, such a
///   direction stays.
///
/// In the Newton basis `‖w‖` is the norm of the feature in the kernel's Hilbert space, so the regulariser of regularised
/// sparse kernel SFA is this plain `λI`.
///
/// Moments hold squares, so what has less than about 10⁻⁶ of the others' amplitude is lost in their rounding, and the
/// constraints hold to about 2⁻⁵³ times the ratio of the variances. [`LinearSfa`](super::LinearSfa) has the signal itself at
/// hand and makes them good to full precision.
///
/// `previous` is an earlier solution over the first coordinates (they do not change when a dictionary grows): signs are
/// chosen to agree with it, and equally slow features are rotated towards it, so that features do not jump.
///
/// Exactly as slow as they can be, if λ = 0. With λ > 0 `Δ + λ‖w‖²` is what is minimal.
///
/// # Errors
/// λ negative or not finite; moments of fewer than 2 frames, without links, or that are not finite; no feature, or more than
/// the coordinates have directions with variance ([`SlowError::Features`] has their number).
///
/// # Example
/// ```
/// use adagio::slow::{Link, Moments, solve};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// // Two sines over whole periods, mixed.
/// let sine = |turns: usize, t: usize| (std::f64::consts::TAU * (turns * t) as f64 / 1000.0).sin();
/// let v = Mat::from_fn(2, 1000, |i, t| sine(3, t) + [1.0, -2.0][i] * sine(40, t));
/// let mut moments = Moments::new(Par::Seq);
/// moments.widen(2)?;
/// moments.add_series(v.as_ref(), &Link::regular(1000, 0.01)?, None)?;
///
/// let features = solve(&moments, 2, 0.0, None)?;
/// // The slowest is the sine of 3 turns in 10 s alone: (2·first + second)/3 of the mixtures.
/// assert!((features.weights[(0, 0)] / features.weights[(1, 0)] - 2.0).abs() < 1e-2);
/// let omega = std::f64::consts::TAU * 3.0 / 10.0;
/// assert!((features.slowness[0] / (omega * omega) - 1.0).abs() < 1e-2);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §4.3.1 (linear SFA) and §4.3.3; Böhmer et al., ECML 2011 (the regulariser). The thesis's listing of kernel SFA
/// centres with an operator of the wrong size and scales to variance 1/n; [`KernelSfa`](super::KernelSfa) lists its errata.
pub fn solve(
    moments: &Moments,
    features: usize,
    lambda: f64,
    previous: Option<&SlowFeatures>,
) -> Result<SlowFeatures, SlowError> {
    SlowError::unless_lambda(lambda)?;
    if !(moments.frames() >= 2.0 && moments.links() > 0.0) {
        return Err(SlowError::TooFewFrames { frames: moments.frames(), links: moments.links() });
    }
    let m = moments.size();
    let covariance = moments.covariance();
    let rate = moments.rate();
    SlowError::unless_finite("the covariance of the coordinates is", covariance.as_ref())?;
    SlowError::unless_finite("the covariance of the derivatives is", rate.as_ref())?;
    if no_variance(moments).iter().enumerate().all(|(i, nothing)| covariance[(i, i)] <= *nothing) {
        return Err(SlowError::Features { asked: features, rank: 0 });
    }
    let (mut weights, rank) = match usable_factor(&rate, lambda) {
        Some(r) => slowest(&covariance, r.as_ref(), features)?,
        None => revealed(&covariance, &rate, moments, features, lambda)?,
    };
    let mut slowness = diagonal_of(weights.as_ref(), rate.as_ref());
    sort_columns(&mut weights, &mut slowness);
    if let Some(previous) = previous {
        let mut old = previous.weights.clone();
        old.resize_with(m, previous.weights.ncols(), |_, _| 0.0);
        align(&mut weights, &slowness, (&covariance * &old).as_ref());
        slowness = diagonal_of(weights.as_ref(), rate.as_ref());
        sort_columns(&mut weights, &mut slowness);
    }
    Ok(SlowFeatures { weights, mean: moments.mean(), slowness, lambda, rank_deficit: m - rank })
}

/// The Cholesky factor `R` of `Ḋ + λI`, unless λ = 0 or its pivots are within the rounding of the sums.
fn usable_factor(rate: &Mat<f64>, lambda: f64) -> Option<Mat<f64>> {
    let m = rate.nrows();
    if lambda == 0.0 || m == 0 {
        return None;
    }
    let regularised = Mat::from_fn(m, m, |i, j| rate[(i, j)] + if i == j { lambda } else { 0.0 });
    let r = regularised.llt(Side::Lower).ok()?.L().to_owned();
    let largest = (0..m).map(|i| regularised[(i, i)]).fold(0.0, f64::max);
    let smallest = (0..m).map(|i| r[(i, i)] * r[(i, i)]).fold(f64::INFINITY, f64::min);
    (smallest > m as f64 * f64::EPSILON * largest).then_some(r)
}

/// The dense generalised eigenproblem: weights of the `features` largest μ, scaled to unit variance, and the number of
/// directions with variance.
fn slowest(covariance: &Mat<f64>, r: MatRef<'_, f64>, features: usize) -> Result<(Mat<f64>, usize), SlowError> {
    let m = covariance.nrows();
    // M = R⁻¹CR⁻ᵀ, by two triangular solves. faer's eigensolver gives other bits for other numbers of threads: one it is.
    let mut half = covariance.clone();
    solve_lower_triangular_in_place(r, half.as_mut(), Par::Seq);
    let mut whole = half.transpose().to_owned();
    solve_lower_triangular_in_place(r, whole.as_mut(), Par::Seq);
    let eigen = whole.self_adjoint_eigen(Side::Lower).map_err(|_| SlowError::Eigenvalues(m))?;
    let mu: Vec<f64> = (0..m).map(|i| eigen.S()[m - 1 - i]).collect();
    let rank = mu.iter().take_while(|&&value| value > RANK_TOLERANCE * mu[0]).count();
    if features == 0 || features > rank {
        return Err(SlowError::Features { asked: features, rank });
    }
    let mut weights = Mat::from_fn(m, features, |i, j| eigen.U()[(i, m - 1 - j)] / mu[j].sqrt());
    solve_upper_triangular_in_place(r.transpose(), weights.as_mut(), Par::Seq);
    Ok((weights, rank))
}

/// Diagonal of `WᵀAW`.
fn diagonal_of(weights: MatRef<'_, f64>, a: MatRef<'_, f64>) -> Vec<f64> {
    let product = a * weights;
    (0..weights.ncols()).map(|j| (0..weights.nrows()).map(|i| weights[(i, j)] * product[(i, j)]).sum()).collect()
}

/// λ moves single features out of the order of their own Δ: put the columns in ascending order of slowness.
pub(super) fn sort_columns(weights: &mut Mat<f64>, slowness: &mut [f64]) {
    let mut order: Vec<usize> = (0..slowness.len()).collect();
    order.sort_by(|&a, &b| slowness[a].total_cmp(&slowness[b]));
    *weights = Mat::from_fn(weights.nrows(), weights.ncols(), |i, j| weights[(i, order[j])]);
    slowness.sort_by(f64::total_cmp);
}

/// Rotate groups of equally slow features, and flip the rest, towards an earlier solution.
///
/// `target = C·W_old`, so that `Wᵀ·target` are correlations between new and old features. Each group takes the orthogonal
/// matrix that brings it closest to the old features at its places (Procrustes); for a group of one that is its sign.
fn align(weights: &mut Mat<f64>, slowness: &[f64], target: MatRef<'_, f64>) {
    let k = weights.ncols().min(target.ncols());
    let mut start = 0;
    while start < k {
        let mut end = start + 1;
        while end < k && slowness[end] - slowness[start] < EQUAL_SLOWNESS * slowness[start] {
            end += 1;
        }
        let group = weights.as_ref().subcols(start, end - start).to_owned();
        let correlation = group.transpose() * target.subcols(start, end - start);
        if end - start == 1 {
            if correlation[(0, 0)] < 0.0 {
                weights.col_mut(start).iter_mut().for_each(|w| *w = -*w);
            }
        } else if let Ok(svd) = correlation.svd() {
            let rotation = svd.U() * svd.V().transpose();
            let rotated = &group * rotation;
            weights.as_mut().subcols_mut(start, end - start).copy_from(&rotated);
        }
        start = end;
    }
}
