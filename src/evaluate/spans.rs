//! Angles between the spans of features.

use faer::MatRef;
use faer::linalg::solvers::SvdError;

/// Mean squared cosine of the principal angles between the spans of the rows of two matrices (over the smaller span), and the
/// largest angle, radians.
///
/// # Errors
/// Singular values that cannot be computed, as of rows that are not finite.
///
/// # Reference
/// Björck & Golub 1973.
pub fn overlap(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Result<(f64, f64), SvdError> {
    let basis = |rows: MatRef<'_, f64>| rows.transpose().to_owned().qr().compute_thin_Q();
    let product = basis(a).transpose() * basis(b);
    let cosines = product.singular_values()?;
    let mean = cosines.iter().map(|cosine| cosine.min(1.0).powi(2)).sum::<f64>() / cosines.len() as f64;
    let smallest = cosines.iter().copied().fold(1.0, f64::min);
    Ok((mean, smallest.clamp(0.0, 1.0).acos()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Mat;

    #[test]
    fn spans_are_compared_whatever_their_bases() {
        let e = |i: usize| Mat::from_fn(1, 5, |_, j| f64::from(u8::from(i == j)));
        let rows = |vectors: &[Mat<f64>]| Mat::from_fn(vectors.len(), 5, |i, j| vectors[i][(0, j)]);
        let a = rows(&[e(0), e(1)]);
        let turned = rows(&[&e(0) + &e(1), &e(0) - &e(1)]);
        let (same, angle) = overlap(a.as_ref(), turned.as_ref()).unwrap();
        assert!((same - 1.0).abs() < 1e-12 && angle < 1e-6);
        let half = rows(&[e(0), e(2)]);
        let (found, angle) = overlap(a.as_ref(), half.as_ref()).unwrap();
        assert!((found - 0.5).abs() < 1e-12 && (angle.to_degrees() - 90.0).abs() < 1e-6);
        let between = rows(&[&e(0) + &e(3)]);
        assert!((overlap(between.as_ref(), a.as_ref()).unwrap().0 - 0.5).abs() < 1e-12);
    }
}
