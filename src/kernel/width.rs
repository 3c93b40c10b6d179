//! Where to start with the width σ of a radial kernel.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

use super::error::KernelError;
use super::matrix::{Scalar, finite_norms};

/// The median Euclidean distance between the observations in the columns of `x`, over all pairs.
///
/// The usual starting point for σ: with the width far below it, every observation is its own support vector; far above
/// it, they all look the same. It takes memory for `n²` products: a few hundred observations say enough.
///
/// # Errors
/// Fewer than two observations, a median distance of 0 (at least half of all pairs are equal), or values that are not
/// finite.
///
/// # Example
/// ```
/// use adagio::kernel::median_distance;
/// use faer::Mat;
///
/// // The distances between 0, 1 and 3 are 1, 2, 3.
/// let x = Mat::<f64>::from_fn(1, 3, |_, j| [0.0, 1.0, 3.0][j]);
/// assert_eq!(median_distance(x.as_ref()), Ok(2.0));
/// ```
pub fn median_distance<T: Scalar>(x: MatRef<'_, T>) -> Result<f64, KernelError> {
    let norms = finite_norms("observation", x)?;
    let n = x.ncols();
    let mut products = Mat::<T>::zeros(n, n);
    matmul(products.as_mut(), Accum::Replace, x.transpose(), x, T::one_impl(), Par::Seq);
    let mut squared: Vec<f64> = Vec::with_capacity(n * n.saturating_sub(1) / 2);
    for j in 0..n {
        for i in 0..j {
            let product: f64 = products[(i, j)].into();
            squared.push((norms[i] + norms[j] - 2.0 * product).max(0.0));
        }
    }
    if squared.is_empty() {
        return Err(KernelError::NoSpread(n, 0.0));
    }
    let middle = squared.len() / 2;
    let (_, median, _) = squared.select_nth_unstable_by(middle, f64::total_cmp);
    let median = median.sqrt();
    if median > 0.0 && median.is_finite() { Ok(median) } else { Err(KernelError::NoSpread(n, median)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_width_from_observations_without_spread() {
        let of = |values: &[f64]| median_distance(Mat::from_fn(1, values.len(), |_, j| values[j]).as_ref());
        assert_eq!(of(&[4.0, 4.0, 4.0]), Err(KernelError::NoSpread(3, 0.0)));
        assert_eq!(of(&[4.0]), Err(KernelError::NoSpread(1, 0.0)));
        assert_eq!(of(&[]), Err(KernelError::NoSpread(0, 0.0)));
        assert_eq!(of(&[1.0, f64::NAN, 2.0]), Err(KernelError::NotFinite { what: "observation", index: 1 }));
        assert_eq!(of(&[1.0, 2.0, f64::INFINITY]), Err(KernelError::NotFinite { what: "observation", index: 2 }));
    }
}
