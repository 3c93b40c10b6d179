//! From moments to slow features.
//!
//! Here is the way in: checks, the choice of a solver, the order of the features and their alignment with earlier ones. The
//! solvers are in `lanczos`, `dense` and `reveal`.

use faer::linalg::matmul::matmul;
use faer::{Accum, ColRef, Mat, MatRef, Par, Scale};

use super::dense;
use super::error::SlowError;
use super::lanczos::{self, Found};
use super::moments::Moments;
use super::reveal::{Directions, all_vary, are_resolved, no_variance};
use super::symmetric::{Factor, PANEL, cholesky, is_finite, rows_times, times};

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
    /// How they were found.
    pub solver: Solver,
}

impl SlowFeatures {
    /// Coordinates that say nothing new: `m` minus the number of independent directions with variance, whatever λ and the
    /// number of features. A solver that looks for some of the features only does not know it.
    pub fn rank_deficit(&self) -> Option<usize> {
        match self.solver {
            Solver::Dense { rank_deficit } => Some(rank_deficit),
            Solver::Lanczos { .. } => None,
        }
    }
}

/// How slow features were found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solver {
    /// By a decomposition of whole matrices.
    Dense {
        /// `m` minus the number of independent directions with variance.
        rank_deficit: usize,
    },
    /// By block Lanczos iteration.
    Lanczos {
        /// Vectors that the operator was applied to, each as costly as two products of a matrix and a vector.
        applied: usize,
        /// Largest relative residual `‖Mu − μu‖/μ` of the eigenvalues: an upper bound of their relative error.
        residual: f64,
    },
}

/// Which solver to use.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Method {
    /// Block Lanczos iteration, to a tolerance of [`TOLERANCE`], where it is faster: for few features of many coordinates.
    #[default]
    Automatic,
    /// All eigenvalues: the reference, with time of the order of m³ whatever the number of features.
    Dense,
    /// Block Lanczos iteration for the features that are asked for, with time of the order of m³/3 and then m² a feature.
    ///
    /// Where it cannot do it, [`Method::Dense`] does: with more features than a sixth of the coordinates or fewer than 432 coordinates, with λ = 0,
    /// with features within the rounding of the moments, as where coordinates depend on each other, or without convergence.
    Lanczos {
        /// Largest relative residual `‖Mu − μu‖/μ`, in (0, 1). It bounds the relative error of every eigenvalue μ. The error
        /// usually is of the order of the residual's square, while that of the features is of the order of
        /// `residual·μ/gap`, where `gap` is the distance to the next eigenvalue that was not asked for.
        tolerance: f64,
    },
}

/// The tolerance of [`Method::Automatic`].
pub const TOLERANCE: f64 = 1e-6;

/// How to solve.
#[derive(Debug, Clone, Copy)]
pub struct SolveOptions {
    /// Which solver to use: by default the one that is faster.
    pub method: Method,
    /// Threads for products, triangular solves and the Cholesky factor: by default one. The bits are the same for any number (see the numerics of [`slow`](super)).
    pub par: Par,
}

impl Default for SolveOptions {
    fn default() -> Self {
        SolveOptions { method: Method::Automatic, par: Par::Seq }
    }
}

impl Method {
    /// The tolerance of the iteration, if this is one for `k` features of `m` coordinates.
    fn tolerance(self, m: usize, k: usize) -> Option<f64> {
        match self {
            Method::Automatic => lanczos::fits(m, k).then_some(TOLERANCE),
            Method::Dense => None,
            Method::Lanczos { tolerance } => lanczos::fits(m, k).then_some(tolerance),
        }
    }
}

/// Features count as equally slow, and may be rotated among each other, when their slowness differs by less than this share.
const EQUAL_SLOWNESS: f64 = 1e-3;

/// The `features` slowest features: unit variance and no correlation on the training frames, slowest first.
///
/// Minimise `wᵀ(Ḋ + λI)w` subject to `wᵀCw = 1` and `w_iᵀCw_j = 0`. There are two ways to the same answer:
///
/// - **Regular** (λ > 0, `Ḋ + λI` well conditioned): with `RRᵀ = Ḋ + λI` the slowest features are the largest eigenvalues μ
///   of `M = R⁻¹CR⁻ᵀ`: `w = R⁻ᵀu/√μ`. The few largest are found by
///   block Lanczos iteration, all of them by a dense decomposition ([`Method`]).
/// - **Rank-revealing** (λ = 0, no usable factor, or directions without variance among what is found): redundant coordinates
///   have directions with neither variance nor derivative. In `M` they are rounding divided by λ. They are found in `B = C + sḊ` and dropped, and their number is reported. The thesis's
///   listing removes the *zero eigenvalues of the covariance* instead; with any threshold above zero that also loses a truly
///   slow direction of little variance, the very thing that is looked for. In `B`, scaled to a unit diagonal, such a
///   direction stays.
///
/// In the Newton basis `‖w‖` is the norm of the feature in the kernel's Hilbert space, so the regulariser of regularised
/// sparse kernel SFA is this plain `λI`.
///
/// Moments hold squares, so what has less than about 10⁻⁶ of the others' amplitude is lost in their rounding, and the
/// constraints hold to about 2⁻⁵³ times the ratio of the variances. [`LinearSfa`](super::LinearSfa) has the signal itself at
/// hand and makes them good to full precision. A direction counts as one with variance only where this is more than rounding
/// can have made of nothing, so more features than there are such directions are refused, whatever λ.
///
/// Where coordinates depend on each other, many weights say the same. They are those of smallest norm, unless their outputs
/// would be small differences of large coordinates: then those that lose the least to rounding.
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
    solve_with(moments, features, lambda, previous, &SolveOptions::default())
}

/// As [`solve()`], with a choice of the solver and of the number of threads.
///
/// The memory that it takes beside the moments is in [`solve_bytes`].
///
/// # Errors
/// Those of [`solve()`], and a tolerance that is not in (0, 1).
///
/// # Example
/// ```
/// use adagio::slow::{Link, Method, Moments, SolveOptions, Solver, solve_with};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// // 600 channels: cosines of a slow phase and of its multiples, in some noise.
/// let phase = |t: usize| 0.002 * t as f64;
/// let noise = |i: usize, t: usize| ((i * 7919 + t * t * 104_729) % 1009) as f64 / 1009.0;
/// let v = Mat::from_fn(600, 1500, |i, t| ((1 + i % 7) as f64 * phase(t)).cos() + 0.1 * noise(i, t));
/// let mut moments = Moments::new(Par::Seq);
/// moments.widen(600)?;
/// moments.add_series(v.as_ref(), &Link::regular(1500, 1.0)?, None)?;
///
/// let iterate = SolveOptions { method: Method::Lanczos { tolerance: 1e-8 }, ..Default::default() };
/// let features = solve_with(&moments, 4, 1e-4, None, &iterate)?;
/// assert!(matches!(features.solver, Solver::Lanczos { residual, .. } if residual < 1e-8));
/// // The reference agrees.
/// let whole = SolveOptions { method: Method::Dense, ..Default::default() };
/// let reference = solve_with(&moments, 4, 1e-4, None, &whole)?;
/// for (found, known) in features.slowness.iter().zip(&reference.slowness) {
///     assert!((found / known - 1.0).abs() < 1e-6);
/// }
/// # Ok(())
/// # }
/// ```
pub fn solve_with(
    moments: &Moments,
    features: usize,
    lambda: f64,
    previous: Option<&SlowFeatures>,
    options: &SolveOptions,
) -> Result<SlowFeatures, SlowError> {
    SlowError::unless_lambda(lambda)?;
    if let Method::Lanczos { tolerance } = options.method
        && !(tolerance > 0.0 && tolerance < 1.0)
    {
        return Err(SlowError::Tolerance(tolerance));
    }
    if !(moments.frames() >= 2.0 && moments.links() > 0.0) {
        return Err(SlowError::TooFewFrames { frames: moments.frames(), links: moments.links() });
    }
    let forms = Forms::new(moments, options.par);
    if !(is_finite(moments.square.as_ref()) && forms.mean.as_ref().col(0).iter().all(|mean| (mean * mean).is_finite()))
    {
        return Err(SlowError::NotFinite("the covariance of the coordinates is"));
    }
    if !is_finite(moments.derivative.as_ref()) {
        return Err(SlowError::NotFinite("the covariance of the derivatives is"));
    }
    if forms.variances().iter().zip(no_variance(moments)).all(|(variance, nothing)| *variance <= nothing) {
        return Err(SlowError::Features { asked: features, rank: 0 });
    }
    let (mut weights, solver) = forms.slowest(features, lambda, options.method)?;

    let mut driven = forms.rate_times(weights.as_ref());
    let mut slowness = slownesses(weights.as_ref(), driven.as_ref());
    sort(&mut slowness, [&mut weights, &mut driven]);
    if let Some(previous) = previous {
        let mut old = previous.weights.clone();
        old.resize_with(moments.size(), previous.weights.ncols().min(features), |_, _| 0.0);
        let target = forms.covariance_times(old.as_ref());
        align([&mut weights, &mut driven], &slowness, target.as_ref());
        slowness = slownesses(weights.as_ref(), driven.as_ref());
        sort(&mut slowness, [&mut weights, &mut driven]);
    }
    Ok(SlowFeatures { weights, mean: forms.mean, slowness, lambda, solver })
}

/// The most memory that [`solve_with`] takes beside the moments, in bytes, for `k` features of `m` coordinates with λ > 0.
///
/// - By Lanczos iteration with a basis of at most `l` vectors: `8 (2m² + m(l + 2k + 8b + 256) + 5l²)`. That is two matrices, the inverse
///   corners of a factor, and a basis of `4k` vectors at most, for small `k` of eight blocks more than `k`; a block has `b = 32`.
/// - Dense: `8 · 6m²`. With λ = 0, no usable factor, or dependent coordinates, `8 · 13m²`.
///
/// What the iteration cannot find is looked for in the dense way ([`Method::Lanczos`]), with more memory.
pub fn solve_bytes(m: usize, k: usize, method: Method) -> u64 {
    let wide = |size: usize| (size as u128).min(1 << 40);
    let values = match method.tolerance(m, k) {
        None => 6 * wide(m) * wide(m),
        Some(_) => {
            let [m, k, basis] = [m, k, lanczos::basis_limit(k, lanczos::BLOCK)].map(wide);
            2 * m * m + m * (basis + 2 * k + wide(8 * lanczos::BLOCK + PANEL)) + 5 * basis * basis
        }
    };
    u64::try_from(values * size_of::<f64>() as u128).unwrap_or(u64::MAX)
}

/// The matrices of the problem as products with them: they are not built.
struct Forms<'a> {
    moments: &'a Moments,
    /// `v̄`.
    mean: Mat<f64>,
    par: Par,
}

impl<'a> Forms<'a> {
    fn new(moments: &'a Moments, par: Par) -> Self {
        Forms { moments, mean: moments.mean(), par }
    }

    /// `C·X`.
    fn covariance_times(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        let mut product = times(self.moments.square.as_ref(), x, 1.0 / self.moments.frames(), self.par);
        let along = self.mean.transpose() * x;
        matmul(product.as_mut(), Accum::Add, self.mean.as_ref(), along.as_ref(), -1.0, self.par);
        product
    }

    /// `Ḋ·X`.
    fn rate_times(&self, x: MatRef<'_, f64>) -> Mat<f64> {
        times(self.moments.derivative.as_ref(), x, 1.0 / self.moments.links(), self.par)
    }

    /// Diagonal of `C`.
    fn variances(&self) -> Vec<f64> {
        let squares = self.moments.mean_squares();
        squares.iter().enumerate().map(|(i, square)| square - self.mean[(i, 0)] * self.mean[(i, 0)]).collect()
    }

    /// Weights of the slowest features, in any order, and how they were found.
    fn slowest(&self, features: usize, lambda: f64, method: Method) -> Result<(Mat<f64>, Solver), SlowError> {
        let (m, moments) = (self.moments.size(), self.moments);
        let r = self.usable_factor(lambda).map(|r| Factor::new(r, self.par));
        if let (Some(r), Some(tolerance)) = (&r, method.tolerance(m, features))
            && let Some(Found { values, mut vectors, applied, residual }) = self.iterate(r, features, tolerance)?
        {
            dense::to_weights(&mut vectors, &values, r.lower(), self.par);
            if are_resolved(vectors.as_ref(), moments) {
                return Ok((vectors, Solver::Lanczos { applied, residual }));
            }
        }
        // All directions, where it is not plain that there are as many as coordinates.
        let directions = if r.is_some() && all_vary(moments, self.par) { None } else { Some(Directions::of(moments)?) };
        let rank = directions.as_ref().map_or(m, Directions::rank);
        if features == 0 || features > rank {
            return Err(SlowError::Features { asked: features, rank });
        }
        let solver = Solver::Dense { rank_deficit: m - rank };
        if let Some(r) = r
            && let Some(weights) = dense::slowest(moments.covariance(), r.lower(), features, self.par)?
            && (directions.is_none() || are_resolved(weights.as_ref(), moments))
        {
            return Ok((weights, solver));
        }
        let directions = directions.map_or_else(|| Directions::of(moments), Ok)?;
        Ok((directions.slowest(moments, features, lambda)?, solver))
    }

    /// The largest eigenvalues of `M = R⁻¹CR⁻ᵀ`.
    fn iterate(&self, r: &Factor, features: usize, tolerance: f64) -> Result<Option<Found>, SlowError> {
        let covariance = self.moments.covariance();
        let operator = |x: Mat<f64>| {
            let mut rows = x.transpose().to_owned();
            r.solve_transposed(rows.as_mut());
            let mut rows = rows_times(rows.as_ref(), covariance.as_ref(), self.par);
            r.solve(rows.as_mut());
            rows.transpose().to_owned()
        };
        lanczos::largest(&operator, self.moments.size(), features, tolerance, self.par)
    }

    /// The Cholesky factor `R` of `Ḋ + λI`, unless λ = 0 or its pivots are within the rounding of the sums. Only its lower
    /// triangle has a meaning.
    fn usable_factor(&self, lambda: f64) -> Option<Mat<f64>> {
        let m = self.moments.size();
        if lambda == 0.0 || m == 0 {
            return None;
        }
        let mut r = &self.moments.derivative * Scale(1.0 / self.moments.links());
        (0..m).for_each(|i| r[(i, i)] += lambda);
        let largest = (0..m).map(|i| r[(i, i)]).fold(0.0, f64::max);
        let regular = cholesky(r.as_mut(), self.par);
        let smallest = (0..m).map(|i| r[(i, i)] * r[(i, i)]).fold(f64::INFINITY, f64::min);
        (regular && smallest > m as f64 * f64::EPSILON * largest).then_some(r)
    }
}

/// Slownesses `wᵀḊw` from `W` and `ḊW`. What does not move is 0 up to rounding: never less.
fn slownesses(weights: MatRef<'_, f64>, driven: MatRef<'_, f64>) -> Vec<f64> {
    let product = |(w, d): (ColRef<'_, f64>, ColRef<'_, f64>)| w.iter().zip(d.iter()).map(|(w, d)| w * d).sum::<f64>();
    let not_below_zero = |slowness: f64| if slowness < 0.0 { 0.0 } else { slowness };
    weights.col_iter().zip(driven.col_iter()).map(product).map(not_below_zero).collect()
}

/// λ moves single features out of the order of their own Δ: put columns in ascending order of slowness.
pub(super) fn sort<const N: usize>(slowness: &mut [f64], matrices: [&mut Mat<f64>; N]) {
    if slowness.is_sorted() {
        return;
    }
    let mut order: Vec<usize> = (0..slowness.len()).collect();
    order.sort_by(|&a, &b| slowness[a].total_cmp(&slowness[b]));
    for matrix in matrices {
        let mut sorted = Mat::zeros(matrix.nrows(), matrix.ncols());
        for (column, &from) in order.iter().enumerate() {
            sorted.col_mut(column).copy_from(matrix.col(from));
        }
        *matrix = sorted;
    }
    slowness.sort_by(f64::total_cmp);
}

/// Rotate groups of equally slow features, and flip the rest, towards an earlier solution.
///
/// `target = C·W_old`, so that `Wᵀ·target` are correlations between new and old features. Each group takes the orthogonal
/// matrix that brings it closest to the old features at its places (Procrustes); for a group of one that is its sign. The
/// first of the matrices are the weights `W`, the second is turned as they are.
fn align(matrices: [&mut Mat<f64>; 2], slowness: &[f64], target: MatRef<'_, f64>) {
    let k = matrices[0].ncols().min(target.ncols());
    let mut start = 0;
    let [weights, driven] = matrices;
    while start < k {
        let mut end = start + 1;
        while end < k && slowness[end] - slowness[start] < EQUAL_SLOWNESS * slowness[start] {
            end += 1;
        }
        let size = end - start;
        let correlation = weights.as_ref().subcols(start, size).transpose() * target.subcols(start, size);
        let turn = |turn: MatRef<'_, f64>, weights: &mut Mat<f64>, driven: &mut Mat<f64>| {
            for matrix in [weights, driven] {
                let turned = matrix.as_ref().subcols(start, size) * turn;
                matrix.as_mut().subcols_mut(start, size).copy_from(&turned);
            }
        };
        if size == 1 {
            if correlation[(0, 0)] < 0.0 {
                turn(Mat::from_fn(1, 1, |_, _| -1.0).as_ref(), weights, driven);
            }
        } else if let Ok(svd) = correlation.svd() {
            turn((svd.U() * svd.V().transpose()).as_ref(), weights, driven);
        }
        start = end;
    }
}
