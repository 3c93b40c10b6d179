//! The dense reference solver: all eigenvalues of `M = R⁻¹CR⁻ᵀ`.

use faer::linalg::triangular_solve::{solve_lower_triangular_in_place, solve_upper_triangular_in_place};
use faer::{Mat, MatRef, Par};

use super::error::SlowError;
use super::symmetric::ascending;
use crate::kernel::products::for_columns;

/// Eigenvalues below this share of the largest one have lost nine digits to the rounding of the decomposition.
const ROUNDING: f64 = 1e-9;

/// Weights of the `features` largest μ, of as many as there are coordinates, scaled to unit variance; none if one of these μ
/// is within the rounding.
pub(super) fn slowest(
    covariance: Mat<f64>,
    r: MatRef<'_, f64>,
    features: usize,
    par: Par,
) -> Result<Option<Mat<f64>>, SlowError> {
    let m = covariance.nrows();
    // Two triangular solves in the place of C; the second sees it by its rows.
    let mut whole = covariance;
    solve_lower_triangular_in_place(r, whole.as_mut(), par);
    solve_lower_triangular_in_place(r, whole.as_mut().transpose_mut(), par);
    let (mu, vectors) = ascending(whole.as_ref())?;
    if mu[m - features] <= ROUNDING * mu[m - 1] {
        return Ok(None);
    }
    let largest: Vec<f64> = mu.into_iter().rev().take(features).collect();
    let mut weights = vectors.subcols(m - features, features).reverse_cols().to_owned();
    to_weights(&mut weights, &largest, r, par);
    Ok(Some(weights))
}

/// Turn eigenvectors `u` of `M` into weights of unit variance, `w = R⁻ᵀu/√μ`.
pub(super) fn to_weights(vectors: &mut Mat<f64>, mu: &[f64], r: MatRef<'_, f64>, par: Par) {
    for (column, mu) in vectors.col_iter_mut().zip(mu) {
        column.iter_mut().for_each(|value| *value /= mu.sqrt());
    }
    let par = for_columns(par, vectors.ncols());
    solve_upper_triangular_in_place(r.transpose(), vectors.as_mut(), par);
}
