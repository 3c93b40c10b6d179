//! The rank-revealing way from moments to slow features, for coordinates of which some say the same.
//!
//! 1. Coordinates are scaled to a unit diagonal of `B = C + sḊ`, with `s = tr C / tr Ḋ` (then both parts weigh the same
//!    whatever the units of time). A coordinate that is constant up to the rounding of its own sum is left out.
//! 2. `B = VΛVᵀ`; directions with `Λ ≈ 0` have neither variance nor derivative and are dropped. `P = VΛ^{−1/2}` of the
//!    rest makes `PᵀBP = I`, and its part along the dropped directions is taken off: the weights have the smallest norm.
//! 3. `PᵀCP` then has its eigenvalues `c` in [0, 1], and a direction's slowness is `(1 − c)/(c·s)`: slowest first is largest
//!    `c` first. `c = 1` is a direction that varies but has no derivative, which gaps and restarts can make: it is legal, with
//!    slowness 0. With λ the second step's identity becomes `I + sλPᵀP`, which is well conditioned.
//! 4. The chosen directions are made uncorrelated once more, and turned within their span to ascending slowness: `1 − c`
//!    alone would know slow ones apart only to 2⁻⁵³.

use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, MatRef, Par, Side};

use super::dense::RANK_TOLERANCE;
use super::error::SlowError;
use super::moments::Moments;
use super::symmetric::ascending;

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

/// Weights of the `features` slowest directions, scaled to unit variance, and the number of directions with variance.
pub(super) fn revealed(
    covariance: &Mat<f64>,
    rate: &Mat<f64>,
    moments: &Moments,
    features: usize,
    lambda: f64,
) -> Result<(Mat<f64>, usize), SlowError> {
    let m = covariance.nrows();
    let trace = |a: &Mat<f64>| (0..a.nrows()).map(|i| a[(i, i)]).sum::<f64>();
    let s = match trace(covariance) / trace(rate) {
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
    // Large means leave less of the variance: what is rounding of the squares there must not count as a direction.
    let squares = moments.mean_squares();
    let noise = alive.iter().map(|&i| ROUNDING * squares[i] / b(i, i)).fold(RANK_TOLERANCE, f64::max);
    let (values, vectors) = descending(&scaled(&b))?;
    let rank = values.iter().take_while(|&&value| value > noise * values[0]).count();
    let p = Mat::from_fn(alive.len(), rank, |i, j| vectors[(i, j)] / values[j].sqrt());

    // I + sλPᵀP = RRᵀ: without λ that is the identity.
    let back = smallest(Mat::from_fn(alive.len(), rank, |i, j| unit[i] * p[(i, j)]), {
        Mat::from_fn(alive.len(), alive.len() - rank, |i, j| unit[i] * vectors[(i, rank + j)])
    });
    let mut inner = back.transpose() * &back * faer::Scale(s * lambda);
    (0..rank).for_each(|i| inner[(i, i)] += 1.0);
    let r = inner.llt(Side::Lower).map_err(|_| SlowError::NotFinite("the regularised problem is"))?.L().to_owned();
    let mut half = p.transpose() * scaled(&|i, j| covariance[(i, j)]) * &p;
    solve_lower_triangular_in_place(r.as_ref(), half.as_mut(), Par::Seq);
    let mut whole = half.transpose().to_owned();
    solve_lower_triangular_in_place(r.as_ref(), whole.as_mut(), Par::Seq);
    let (c, turned) = descending(&whole)?;
    let varying = c.iter().take_while(|&&value| value > noise * c[0]).count();
    if features == 0 || features > varying {
        return Err(SlowError::Features { asked: features, rank: varying });
    }
    let mut inside = Mat::from_fn(rank, features, |i, j| turned[(i, j)] / c[j].sqrt());
    solve_upper_triangular_in_place(r.transpose(), inside.as_mut(), Par::Seq);
    let chosen = back * inside;
    let mut weights = Mat::zeros(m, features);
    for (row, &i) in alive.iter().enumerate() {
        weights.row_mut(i).copy_from(chosen.row(row));
    }
    let covariances = weights.transpose() * (covariance * &weights);
    let mut weights = decorrelated(weights, covariances.as_ref())?;
    if lambda == 0.0 {
        let slow = weights.transpose() * (rate * &weights);
        let (_, turn) = descending(&slow)?;
        weights = weights * turn.reverse_cols();
    }
    Ok((weights, varying))
}

/// Weights without their part in the `dropped` directions.
///
/// Frames like those of the training do not know the difference; of all weights that say the same, those of smallest norm
/// say the least about other frames, and λ would choose them.
fn smallest(weights: Mat<f64>, dropped: Mat<f64>) -> Mat<f64> {
    if dropped.ncols() == 0 {
        return weights;
    }
    let q = dropped.qr().compute_thin_Q();
    let inside = q.transpose() * &weights;
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
