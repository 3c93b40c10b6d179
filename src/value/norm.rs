//! The policy-dependent norm: errors count more where the best actions are close in value.

use faer::MatRef;

use super::ValueError;
use super::error::{finite_matrix, parameter, sample_weights};

/// Weights `ω_i · κΔ̄/(κΔ̄ + Δ_i)`, scaled to the sum of `ω`: `Δ_i` is the gap between the two best values in column
/// `i` of `q`, `Δ̄` its weighted mean, κ the scale.
///
/// Least squares spreads its errors over all samples alike. A greedy policy only suffers from errors where the two best
/// actions are close; the thesis's outlook ("Policy dependent norm") suggests to put more weight there.
///
/// A sample whose gap is `κΔ̄` gets half the factor of one with no gap at all. For large κ nothing changes. With one
/// action, or if all gaps are zero, the weights stay as they are.
///
/// # Shapes
/// `q`: `A × N`; `weights`: `N`.
///
/// ```
/// use adagio::value::closeness_weights;
/// use faer::mat;
///
/// let q = mat![[1.0, 3.0], [1.0, 1.0]]; // gaps 0 and 2
/// let weights = closeness_weights(q.as_ref(), &[1.0, 1.0], 1.0)?;
/// assert!((weights[0] - 1.5).abs() < 1e-12 && (weights[1] - 0.5).abs() < 1e-12);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Errors
/// Lists of different lengths, values that are not finite, negative weights, κ ≤ 0.
pub fn closeness_weights(q: MatRef<'_, f64>, weights: &[f64], kappa: f64) -> Result<Vec<f64>, ValueError> {
    if weights.len() != q.ncols() {
        return Err(ValueError::Length { what: "weights", found: weights.len(), expected: q.ncols() });
    }
    parameter("closeness", kappa, kappa > 0.0 && kappa.is_finite(), "> 0 and finite")?;
    sample_weights(weights)?;
    finite_matrix("q", q)?;
    let gap = |i: usize| {
        let mut two = (f64::NEG_INFINITY, f64::NEG_INFINITY);
        for a in 0..q.nrows() {
            let value = q[(a, i)];
            two = if value > two.0 { (value, two.0) } else { (two.0, two.1.max(value)) };
        }
        two.0 - two.1
    };
    let gaps: Vec<f64> = (0..q.ncols()).map(gap).collect();
    let total: f64 = weights.iter().sum();
    let half = kappa * weights.iter().zip(&gaps).map(|(weight, gap)| weight * gap).sum::<f64>() / total;
    if !(q.nrows() > 1 && half > 0.0 && half.is_finite()) {
        return Ok(weights.to_vec());
    }
    let raw: Vec<f64> = weights.iter().zip(&gaps).map(|(weight, gap)| weight * half / (half + gap)).collect();
    let scale = total / raw.iter().sum::<f64>();
    if scale.is_finite() { Ok(raw.into_iter().map(|weight| weight * scale).collect()) } else { Ok(weights.to_vec()) }
}
