//! Least squares and ridge regression.

use faer::linalg::solvers::Solve;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, MatRef, Par, Side};

use super::error::RegressionError;
use super::function::{Bias, Linear};
use super::sums::Sums;

/// The function of the least training error, and among several of them the one with the smallest weights.
///
/// Inputs that depend on each other linearly are no error: `C` is inverted on the directions in which the samples vary
/// (pseudo-inverse by its eigenvectors), whose number is [`Linear::parameters`].
///
/// # Errors
/// No samples; sums too large for `f64`.
///
/// # Reference
/// Thesis §2.1.5, algorithm 1 (which inverts `C` and so needs full rank).
pub fn least_squares(sums: &Sums, bias: Bias) -> Result<Linear, RegressionError> {
    ridge(sums, 0.0, bias)
}

/// Ridge regression: the function that minimises `Σ‖y(x) − t‖² + λ‖W‖²`. With λ = 0 it is [`least_squares`].
///
/// `W = (C + λI)⁻¹B` and, with a free bias, `b = t̄ − Wᵀx̄`, where `C` and `B` are then sums about the means. (The
/// thesis appends a constant 1 to the inputs instead, which gives the same for λ = 0; for λ > 0 it would penalise the
/// bias too, so that adding a constant to all targets would change the shape of the solution. Here the bias is free of
/// the penalty, as is usual in the field.)
///
/// # Units
/// λ counts in squared inputs summed over all samples: for the same effect on twice as many samples it must be twice as
/// large.
///
/// # Errors
/// λ negative or not finite; no samples; sums too large for `f64`.
///
/// # Reference
/// Thesis §2.1.5, algorithm 2.
pub fn ridge(sums: &Sums, lambda: f64, bias: Bias) -> Result<Linear, RegressionError> {
    check_lambda(lambda)?;
    let normal = sums.normal(bias)?;
    let Solution { weights, parameters } = solve(normal.c.as_ref(), normal.b.as_ref(), lambda, normal.floor)?;
    let bias = match bias {
        Bias::Free => sums.free_bias(weights.as_ref()),
        Bias::None => vec![0.0; sums.targets()],
    };
    if bias.iter().any(|value| !value.is_finite()) {
        return Err(RegressionError::Overflow("the bias"));
    }
    Ok(Linear { weights, bias, parameters })
}

pub(super) fn check_lambda(lambda: f64) -> Result<(), RegressionError> {
    if lambda >= 0.0 && lambda.is_finite() { Ok(()) } else { Err(RegressionError::Lambda(lambda)) }
}

pub(super) struct Solution {
    pub weights: Mat<f64>,
    pub parameters: f64,
}

/// `(C + λI)⁻¹B` and `trace((C + λI)⁻¹C)` for a positive semidefinite `C`.
///
/// By Cholesky where λ stands above the rounding of `C`. Below that it cannot tell a direction without variance from
/// one with a little, so the eigenvectors decide: eigenvalues at the level of rounding, or below `floor`, take no part.
pub(super) fn solve(
    c: MatRef<'_, f64>,
    b: MatRef<'_, f64>,
    lambda: f64,
    floor: f64,
) -> Result<Solution, RegressionError> {
    let p = c.nrows();
    if p == 0 {
        return Ok(Solution { weights: Mat::zeros(0, b.ncols()), parameters: 0.0 });
    }
    let trace: f64 = (0..p).map(|i| c[(i, i)]).sum();
    // Rounding moves the eigenvalues of a p × p matrix by a few p·2⁻⁵³ of its norm.
    let rounding = (4.0 * p as f64 * f64::EPSILON * trace).max(floor);
    let by_cholesky = (lambda > rounding).then(|| {
        let regularised = Mat::from_fn(p, p, |i, j| c[(i, j)] + if i == j { lambda } else { 0.0 });
        regularised.llt(Side::Lower)
    });
    let (weights, parameters) = match by_cholesky {
        Some(Ok(cholesky)) => {
            let mut inverse = Mat::<f64>::identity(p, p);
            solve_lower_triangular_in_place(cholesky.L(), inverse.as_mut(), Par::Seq);
            // trace((C + λI)⁻¹C) = p − λ·trace((C + λI)⁻¹), and trace((RRᵀ)⁻¹) = ‖R⁻¹‖².
            let parameters = p as f64 - lambda * inverse.squared_norm_l2();
            (cholesky.solve(b), parameters.max(0.0))
        }
        _ => by_eigenvectors(c, b, lambda, rounding)?,
    };
    if weights.is_all_finite() && parameters.is_finite() {
        Ok(Solution { weights, parameters })
    } else {
        Err(RegressionError::Overflow("the weights"))
    }
}

fn by_eigenvectors(
    c: MatRef<'_, f64>,
    b: MatRef<'_, f64>,
    lambda: f64,
    floor: f64,
) -> Result<(Mat<f64>, f64), RegressionError> {
    let p = c.nrows();
    let eigen = c.self_adjoint_eigen(Side::Lower).map_err(|_| RegressionError::Eigenvalues(p))?;
    let values = eigen.S();
    let first = (0..p).find(|&i| values[i] > floor).unwrap_or(p);
    let u = eigen.U().subcols(first, p - first);
    let mut coordinates = u.transpose() * b;
    let mut parameters = 0.0;
    for i in 0..coordinates.nrows() {
        let value = values[first + i];
        parameters += value / (value + lambda);
        coordinates.row_mut(i).iter_mut().for_each(|entry| *entry /= value + lambda);
    }
    Ok((u * coordinates, parameters))
}
