//! Least-squares temporal differences: the value of states under the policy that made the transitions.

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef};

use super::ValueError;
use super::error::{discount_or_one, finite_list, finite_matrix, ridge as check_ridge, sample_weights};

/// Value weights `w` with `V(x) = wᵀφ(x)`: the solution of `ΦΩ(Φ − γΦ′)ᵀ w = ΦΩr`, with `ridge` on the diagonal.
///
/// With features `Φ`, features after the step `Φ′`, weights `Ω = diag ω` and rewards `r`, the value `V(x) = wᵀφ(x)` is the
/// fixed point of a Bellman step followed by a projection on the features: `ΦΩ(Φ − γΦ′)ᵀ w = ΦΩr`.
///
/// The thesis (§3.2.1) derives it from a cost with the factor 1/n, where the square of a mean has 1/n²; the minimum is the
/// same. Its sum is over single transitions; sums over whole episodes are in [`LstdLambda`](super::LstdLambda).
///
/// A transition into a terminal state has a zero column in `next`. Where the matrix is singular (no ridge, and features
/// that were never seen apart), the solution of smallest norm is returned.
///
/// # Shapes
/// `phi`, `next`: `f × N`; `rewards`, `weights`: `N`. The result has `f` entries.
///
/// # Errors
/// Lists of different lengths, no transitions or features, γ outside [0, 1], a negative ridge or weight, values that are
/// not finite. γ = 1 is allowed here, for chains that end.
///
/// # Reference
/// Bradtke & Barto 1996; thesis §3.2.1, algorithm 5.
///
/// ```
/// use adagio::value::lstd;
/// use faer::mat;
///
/// // Two states in turn, 1 paid on leaving the first: V(0) = 1 + γ V(1), V(1) = γ V(0).
/// let phi = mat![[1.0, 0.0], [0.0, 1.0]];
/// let next = mat![[0.0, 1.0], [1.0, 0.0]];
/// let w = lstd(phi.as_ref(), next.as_ref(), &[1.0, 0.0], &[1.0, 1.0], 0.5, 0.0)?;
/// assert!((w[0] - 4.0 / 3.0).abs() < 1e-12 && (w[1] - 2.0 / 3.0).abs() < 1e-12);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
pub fn lstd(
    phi: MatRef<'_, f64>,
    next: MatRef<'_, f64>,
    rewards: &[f64],
    weights: &[f64],
    gamma: f64,
    ridge: f64,
) -> Result<Vec<f64>, ValueError> {
    let n = phi.ncols();
    if n == 0 {
        return Err(ValueError::Empty);
    }
    if phi.nrows() == 0 {
        return Err(ValueError::Features { what: "phi", found: 0, expected: 1 });
    }
    if next.nrows() != phi.nrows() {
        return Err(ValueError::Features { what: "next", found: next.nrows(), expected: phi.nrows() });
    }
    for (what, found) in [("next", next.ncols()), ("rewards", rewards.len()), ("weights", weights.len())] {
        if found != n {
            return Err(ValueError::Length { what, found, expected: n });
        }
    }
    discount_or_one(gamma)?;
    check_ridge(ridge)?;
    sample_weights(weights)?;
    finite_list("rewards", rewards)?;
    finite_matrix("phi", phi)?;
    finite_matrix("next", next)?;
    let f = phi.nrows();
    let weighted = Mat::from_fn(f, n, |i, j| phi[(i, j)] * weights[j]);
    let difference = Mat::from_fn(f, n, |i, j| phi[(i, j)] - gamma * next[(i, j)]);
    let mut a = &weighted * difference.transpose();
    for i in 0..f {
        a[(i, i)] += ridge;
    }
    let b = &weighted * Mat::from_fn(n, 1, |i, _| rewards[i]);
    let w = solve_or_pseudo_inverse(a.as_ref(), b.as_ref())?;
    Ok((0..f).map(|i| w[(i, 0)]).collect())
}

/// Pivots below this share of the largest one count as zero.
const SINGULAR: f64 = 1e-12;

/// Solve `a·w = b`; where `a` is singular to working precision, the least-squares solution of smallest norm.
///
/// Singular means that a pivot of its LU factors is below 1e-12 of the largest one; directions whose singular value is below
/// that share then take no part. So features should be of about the same size: beside one of size 1, a feature
/// of size 1e-7 (whose square is 1e-14) counts as never seen.
///
/// ```
/// use adagio::value::solve_or_pseudo_inverse;
/// use faer::mat;
///
/// // x + y = 2, twice: of all solutions the smallest one.
/// let w = solve_or_pseudo_inverse(mat![[1.0, 1.0], [1.0, 1.0]].as_ref(), mat![[2.0], [2.0]].as_ref())?;
/// assert!((w[(0, 0)] - 1.0).abs() < 1e-12 && (w[(1, 0)] - 1.0).abs() < 1e-12);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Shapes
/// `a: f × f`, `b: f × r`.
///
/// # Errors
/// Coefficients that are not square or do not fit to `b`, values that are not finite.
pub fn solve_or_pseudo_inverse(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Result<Mat<f64>, ValueError> {
    let f = a.nrows();
    if f == 0 || a.ncols() != f || b.nrows() != f {
        return Err(ValueError::System { rows: f, columns: a.ncols(), right: b.nrows() });
    }
    if !a.is_all_finite() || !b.is_all_finite() {
        return Err(ValueError::NotFinite(f));
    }
    let lu = a.partial_piv_lu();
    let pivots = (0..f).map(|i| lu.U()[(i, i)].abs());
    let (low, high) = pivots.fold((f64::INFINITY, 0.0f64), |(low, high), p| (low.min(p), high.max(p)));
    let solution = if low > SINGULAR * high {
        lu.solve(b)
    } else {
        let svd = a.svd().map_err(|_| ValueError::NotFinite(f))?;
        let largest = svd.S()[0];
        let mut coefficients = svd.U().transpose() * b;
        for j in 0..coefficients.ncols() {
            for i in 0..f {
                let s = svd.S()[i];
                coefficients[(i, j)] = if s > SINGULAR * largest { coefficients[(i, j)] / s } else { 0.0 };
            }
        }
        svd.V() * coefficients
    };
    if solution.is_all_finite() { Ok(solution) } else { Err(ValueError::NotFinite(f)) }
}
