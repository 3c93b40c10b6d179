//! The rank-revealing way from moments to slow features, for coordinates of which some say the same; and whether some do.
//!
//! 1. Coordinates are scaled to a unit diagonal of `B = C + sḊ`, with `s = tr C / tr Ḋ` (then both parts weigh the same
//!    whatever the units of time). A coordinate that is constant up to the rounding of its own sum is left out.
//! 2. `B = VΛVᵀ`; directions with `Λ ≈ 0` have neither variance nor derivative and are dropped. `P = VΛ^{−1/2}` of the
//!    rest makes `PᵀBP = I`, and its part along the dropped directions is taken off: the weights have the smallest norm.
//! 3. `PᵀCP` then has its eigenvalues `c` in [0, 1], and a direction's slowness is `(1 − c)/(c·s)`: slowest first is largest
//!    `c` first. `c = 1` is a direction that varies but has no derivative, which gaps and restarts can make: it is legal, with
//!    slowness 0. A `c` within what rounding of the moments makes of it is a direction without variance. With λ the second
//!    step's identity becomes `I + sλPᵀP`; what is a direction does not depend on it.
//! 4. The chosen directions are made uncorrelated once more, and turned within their span to ascending slowness: `1 − c`
//!    alone would know slow ones apart only to 2⁻⁵³.

use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{ColRef, Mat, MatRef, Par, Side};

use super::error::SlowError;
use super::moments::Moments;
use super::symmetric::{ascending, cholesky};

/// Eigenvalues of `B` below this share of the largest one are rounding of the eigenvalues themselves.
const RANK_TOLERANCE: f64 = 1e-13;

/// A sum of `n` rounded squares that vary is wrong by a small multiple of 2⁻⁵³ of itself; measured sums stay far below this
/// multiple.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// The same for `n` equal squares. They are all rounded to the same side: sums of 0.1 are wrong by up to `0.085 n·2⁻⁵²`
/// of themselves.
const ROUNDING_OF_EQUALS: f64 = 0.25 * f64::EPSILON;

/// What rounding may make of the variance of a coordinate that does not vary.
pub(super) fn no_variance(moments: &Moments) -> Vec<f64> {
    let share = ROUNDING.max(ROUNDING_OF_EQUALS * moments.frames());
    moments.mean_squares().iter().map(|square| share * square).collect()
}

/// The most of a feature's variance that may be rounding, in the regular way.
///
/// In `M` a direction without variance has an eigenvalue `|μ| ≈ 2⁻⁵³q²/λ` instead of zero, which no threshold on μ tells from
/// a fast or weak one. [`rounding`] does: it is about 1 of such a direction, and below 10⁻¹⁰ of the slow features of a kernel.
/// Between the two, such directions were in the way of the decomposition.
const MOST_ROUNDING: f64 = 1e-9;

/// The most that it may be, summed over all directions, so that none of them counts as one without variance.
const MOST_ROUNDING_OF_ALL: f64 = 1e-3;

/// The most that it may be for weights of smallest norm: beyond it, outputs of large channels that cancel lose digits.
const MOST_ROUNDING_OF_SMALLEST: f64 = 1e-7;

/// How far covariances of outputs may be off for weights of smallest norm: beyond it, directions that were dropped are not
/// known well enough in coordinates of very different scales to be subtracted.
const MOST_OFF: f64 = 1e-3;

/// What rounding of the moments may make of the variance `wᵀCw` of each output, `Σ q²w²` times the rounding of a sum.
fn rounding(weights: MatRef<'_, f64>, mean_squares: &[f64]) -> Vec<f64> {
    let squares = |column: ColRef<'_, f64>| -> f64 {
        column.iter().zip(mean_squares).map(|(weight, square)| weight * weight * square).sum()
    };
    weights.col_iter().map(|column| ROUNDING * squares(column)).collect()
}

/// Whether outputs of unit variance have that variance from the frames, not from rounding of the moments.
pub(super) fn are_resolved(weights: MatRef<'_, f64>, moments: &Moments) -> bool {
    rounding(weights, &moments.mean_squares()).iter().all(|share| *share <= MOST_ROUNDING)
}

/// Whether all directions have variance, and more than rounding could make.
///
/// With `C = LLᵀ` the rows of `L⁻¹` are weights of uncorrelated outputs of unit variance. The sum of their [`rounding`] is the
/// same for all such sets of weights, so that it bounds that of any output.
pub(super) fn all_vary(moments: &Moments, par: Par) -> bool {
    let (m, mean, squares) = (moments.size(), moments.mean(), moments.mean_squares());
    let root: Vec<f64> = squares.iter().map(|square| square.sqrt()).collect();
    let entry = |i: usize, j: usize| moments.square[(i, j)] / moments.frames - mean[(i, 0)] * mean[(j, 0)];
    let mut l = Mat::from_fn(m, m, |i, j| if i >= j { entry(i, j) / (root[i] * root[j]) } else { 0.0 });
    if !cholesky(l.as_mut(), par) {
        return false;
    }
    let mut inverse = Mat::<f64>::identity(m, m);
    solve_lower_triangular_in_place(l.as_ref(), inverse.as_mut(), par);
    ROUNDING * inverse.squared_norm_l2() <= MOST_ROUNDING_OF_ALL
}

/// The directions of coordinates that depend on each other; they have nothing to do with λ.
pub(super) struct Directions {
    /// `s = tr C / tr Ḋ`.
    s: f64,
    /// Coordinates that are not constant.
    alive: Vec<usize>,
    /// Their mean squares.
    squares: Vec<f64>,
    /// `P`, over the coordinates in their own units.
    p: Mat<f64>,
    /// Directions that were dropped.
    dropped: Mat<f64>,
    /// Eigenvalues `c` of `PᵀCP`, and their vectors.
    c: Vec<f64>,
    turned: Mat<f64>,
    /// Which of these have variance.
    varying: Vec<usize>,
}

impl Directions {
    pub fn of(moments: &Moments) -> Result<Directions, SlowError> {
        let (covariance, rate) = (moments.covariance(), moments.rate());
        let m = covariance.nrows();
        let trace = |a: &Mat<f64>| (0..a.nrows()).map(|i| a[(i, i)]).sum::<f64>();
        let s = match trace(&covariance) / trace(&rate) {
            s if s > 0.0 && s.is_finite() => s,
            _ => 1.0,
        };
        let b = |i: usize, j: usize| covariance[(i, j)] + s * rate[(i, j)];
        let nothing = no_variance(moments);
        let alive: Vec<usize> = (0..m).filter(|&i| b(i, i) > nothing[i]).collect();
        let unit: Vec<f64> = alive.iter().map(|&i| 1.0 / b(i, i).sqrt()).collect();
        let scaled = |a: &dyn Fn(usize, usize) -> f64| {
            Mat::from_fn(alive.len(), alive.len(), |i, j| unit[i] * unit[j] * a(alive[i], alive[j]))
        };
        let (values, vectors) = descending(&scaled(&b))?;
        // Large means leave less of the variance: what is rounding of the squares there must not count as a direction.
        let mean_squares = moments.mean_squares();
        let squares: Vec<f64> = alive.iter().map(|&i| mean_squares[i]).collect();
        let in_units: Vec<f64> = squares.iter().zip(&unit).map(|(square, unit)| square * unit * unit).collect();
        let noise = rounding(vectors.as_ref(), &in_units);
        let is_direction = |&j: &usize| values[j] > noise[j].max(RANK_TOLERANCE * values[0]);
        let (inside, outside): (Vec<usize>, Vec<usize>) = (0..alive.len()).partition(is_direction);
        let rank = inside.len();
        let p = Mat::from_fn(alive.len(), rank, |i, j| vectors[(i, inside[j])] / values[inside[j]].sqrt());
        let within = p.transpose() * scaled(&|i, j| covariance[(i, j)]) * &p;
        let (c, turned) = descending(&within.transpose().to_owned())?;
        let p = Mat::from_fn(alive.len(), rank, |i, j| unit[i] * p[(i, j)]);
        let dropped = Mat::from_fn(alive.len(), outside.len(), |i, j| unit[i] * vectors[(i, outside[j])]);
        let noise = rounding((&p * &turned).as_ref(), &squares);
        let varying = (0..rank).filter(|&j| c[j] > noise[j]).collect();
        Ok(Directions { s, alive, squares, p, dropped, c, turned, varying })
    }

    /// How many have variance.
    pub fn rank(&self) -> usize {
        self.varying.len()
    }

    /// Weights of the `features` slowest of those with variance, scaled to unit variance.
    pub fn slowest(&self, moments: &Moments, features: usize, lambda: f64) -> Result<Mat<f64>, SlowError> {
        let (covariance, rate) = (moments.covariance(), moments.rate());
        let c: Vec<f64> = self.varying.iter().map(|&j| self.c[j]).collect();
        let basis = Mat::from_fn(self.turned.nrows(), c.len(), |i, j| self.turned[(i, self.varying[j])]);
        let back = smallest(&self.p, &self.dropped);
        let slowest = if lambda == 0.0 {
            Mat::from_fn(basis.nrows(), features, |i, j| basis[(i, j)] / c[j].sqrt())
        } else {
            let inside = regularised(&(&back * &basis), &c, self.s * lambda, features)?;
            basis * inside
        };
        let with_covariances = |chosen: Mat<f64>| {
            let mut weights = Mat::zeros(moments.size(), features);
            for (row, &i) in self.alive.iter().enumerate() {
                weights.row_mut(i).copy_from(chosen.row(row));
            }
            let covariances = weights.transpose() * (&covariance * &weights);
            (weights, covariances)
        };
        let chosen = back * &slowest;
        let lost = rounding(chosen.as_ref(), &self.squares);
        let (mut weights, mut covariances) = with_covariances(chosen);
        let off = (&covariances - Mat::<f64>::identity(features, features)).norm_max();
        if !(off <= MOST_OFF && lost.iter().all(|share| *share <= MOST_ROUNDING_OF_SMALLEST)) {
            (weights, covariances) = with_covariances(&self.p * slowest);
        }
        let mut weights = decorrelated(weights, covariances.as_ref())?;
        if lambda == 0.0 {
            let slow = weights.transpose() * (rate * &weights);
            let (_, turn) = descending(&slow)?;
            weights = weights * turn.reverse_cols();
        }
        Ok(weights)
    }
}

/// The directions with the largest `yᵀdiag(c)y / yᵀ(I + sλPᵀP)y`, scaled to `yᵀdiag(c)y = 1`.
///
/// `P = USVᵀ` makes the second matrix `V(I + sλS²)Vᵀ = VD⁻²Vᵀ`. The left singular vectors `Z` of `diag(√c)VD` are orthonormal
/// whatever the norms, so that `diag(1/√c)Z` is too in terms of `c`. Products of matrices with their transposes would lose
/// norms that are 10⁸ times smaller than others.
fn regularised(p: &Mat<f64>, c: &[f64], lambda: f64, features: usize) -> Result<Mat<f64>, SlowError> {
    let failed = |_| SlowError::Eigenvalues(c.len());
    let svd = p.thin_svd().map_err(failed)?;
    let norms = svd.S().column_vector();
    let root: Vec<f64> = norms.iter().map(|norm| 1.0 / (1.0 + lambda * norm * norm).sqrt()).collect();
    let scaled = Mat::from_fn(c.len(), c.len(), |i, j| c[i].sqrt() * svd.V()[(i, j)] * root[j]).thin_svd();
    let z = scaled.map_err(failed)?;
    Ok(Mat::from_fn(c.len(), features, |i, j| z.U()[(i, j)] / c[i].sqrt()))
}

/// Weights without their part in the `dropped` directions.
///
/// Frames like those of the training do not know the difference; of all weights that say the same, those of smallest norm
/// say the least about other frames, and λ would choose them.
fn smallest(weights: &Mat<f64>, dropped: &Mat<f64>) -> Mat<f64> {
    if dropped.ncols() == 0 {
        return weights.clone();
    }
    let q = dropped.qr().compute_thin_Q();
    let inside = q.transpose() * weights;
    weights - q * inside
}

/// `W·T⁻ᵀ` with `TTᵀ` the outputs' own covariances, so that these become the identity; for `W` that is nearly there.
pub(super) fn decorrelated(weights: Mat<f64>, covariances: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
    let t = covariances.llt(Side::Lower).map_err(|_| SlowError::NotFinite("the covariance of the outputs is"))?;
    let mut rows = weights.transpose().to_owned();
    solve_lower_triangular_in_place(t.L(), rows.as_mut(), Par::Seq);
    Ok(rows.transpose().to_owned())
}

/// Eigenvalues of a symmetric matrix in descending order, with their vectors.
pub(super) fn descending(a: &Mat<f64>) -> Result<(Vec<f64>, Mat<f64>), SlowError> {
    let (mut values, vectors) = ascending(a.as_ref())?;
    values.reverse();
    Ok((values, vectors.as_ref().reverse_cols().to_owned()))
}
