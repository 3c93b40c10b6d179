//! Kernel functions, and kernel values for whole blocks of observations.
//!
//! Symbols: `d` values per observation, observations are the *columns* of a `d × n` matrix, `k(x, x′)` is the kernel.
//! The product `SᵀX` runs in the type of the observations (`f32` or `f64`), everything after it in `f64`.
//!
//! Observations that are whole numbers (camera pixels with a constant subtracted) give *exact* `f32` products as long as
//! `‖x‖² < 2²⁴` for each of them: by Cauchy–Schwarz no partial sum can then leave the range in which `f32` counts
//! whole numbers without rounding. The kernel values are the same bits in any order of summation, hence on any number of
//! threads and for one observation or a block.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The number type of observations: `f32` or `f64`.
pub trait Scalar: faer::traits::ComplexField + Copy + Into<f64> + Send + Sync + 'static {}

impl Scalar for f32 {}
impl Scalar for f64 {}

/// A kernel with invalid parameters, or one applied to matrices that do not fit.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum KernelError {
    /// The width must be positive and finite.
    #[error("kernel width sigma = {0} is not allowed: it must be > 0 and finite")]
    Width(f64),
    /// A radial kernel is positive definite for exponents in (0, 2] only.
    #[error("kernel exponent = {0} is not allowed: it must be in (0, 2], else the kernel is not positive definite")]
    Exponent(f64),
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
    /// A suggestion of σ needs at least two different observations.
    #[error(
        "no width can be suggested from {0} observations with median distance {1}: at least two different ones are needed"
    )]
    NoSpread(usize, f64),
}

/// A radial basis function kernel, `k(x, x′) = exp(−(‖x − x′‖ / (√2 σ))^p)`; `k(x, x) = 1`.
///
/// Construct it with [`Kernel::gaussian`], [`Kernel::laplacian`] or [`Kernel::radial`], which refuse invalid parameters.
///
/// # Reference
/// Thesis §2.2.3 (kernels). With `p = 2` it is `exp(−‖x − x′‖²/(2σ²))`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Kernel {
    sigma: f64,
    exponent: f64,
}

impl Kernel {
    /// A radial kernel of width `sigma` (in the units of the observations) and exponent `p`.
    ///
    /// # Errors
    /// `sigma` not positive or not finite; `exponent` outside (0, 2].
    pub fn radial(sigma: f64, exponent: f64) -> Result<Self, KernelError> {
        if !(sigma > 0.0 && sigma.is_finite()) {
            return Err(KernelError::Width(sigma));
        }
        if !(exponent > 0.0 && exponent <= 2.0) {
            return Err(KernelError::Exponent(exponent));
        }
        Ok(Kernel { sigma, exponent })
    }

    /// The Gaussian kernel `exp(−‖x − x′‖²/(2σ²))`.
    ///
    /// # Errors
    /// `sigma` not positive or not finite.
    pub fn gaussian(sigma: f64) -> Result<Self, KernelError> {
        Self::radial(sigma, 2.0)
    }

    /// The Laplacian kernel `exp(−‖x − x′‖/(√2 σ))`.
    ///
    /// # Errors
    /// `sigma` not positive or not finite.
    pub fn laplacian(sigma: f64) -> Result<Self, KernelError> {
        Self::radial(sigma, 1.0)
    }

    /// The width σ, in the units of the observations.
    pub fn sigma(&self) -> f64 {
        self.sigma
    }

    /// The exponent `p`: 2 for the Gaussian, 1 for the Laplacian kernel.
    pub fn exponent(&self) -> f64 {
        self.exponent
    }

    /// The kernel value at a squared distance; rounding below zero counts as zero.
    pub fn at_squared_distance(&self, squared: f64) -> f64 {
        let scaled = squared.max(0.0) / (2.0 * self.sigma * self.sigma);
        if self.exponent == 2.0 {
            (-scaled).exp()
        } else if self.exponent == 1.0 {
            (-scaled.sqrt()).exp()
        } else {
            (-scaled.powf(0.5 * self.exponent)).exp()
        }
    }

    /// `k(x, x)` of an observation, from its squared norm.
    pub fn diagonal(&self, _squared_norm: f64) -> f64 {
        1.0
    }

    /// Kernel values between two sets of observations.
    ///
    /// # Shapes
    /// `s: d × m` with `s_norms: m`, `x: d × n` with `x_norms: n` ([`squared_norms`]); the result is `m × n`.
    ///
    /// # Errors
    /// Shapes that do not fit each other.
    pub fn matrix<T: Scalar>(
        &self,
        s: MatRef<'_, T>,
        s_norms: &[f64],
        x: MatRef<'_, T>,
        x_norms: &[f64],
        par: Par,
    ) -> Result<Mat<f64>, KernelError> {
        let sizes = [
            ("the length of an observation", x.nrows(), s.nrows()),
            ("the list of norms on the left", s_norms.len(), s.ncols()),
            ("the list of norms on the right", x_norms.len(), x.ncols()),
        ];
        for (what, found, expected) in sizes {
            if found != expected {
                return Err(KernelError::Shape { what, found, expected });
            }
        }
        let mut products = Mat::<T>::zeros(s.ncols(), x.ncols());
        matmul(products.as_mut(), Accum::Replace, s.transpose(), x, T::one_impl(), par);
        Ok(Mat::from_fn(s.ncols(), x.ncols(), |i, j| {
            let product: f64 = products[(i, j)].into();
            self.at_squared_distance(s_norms[i] + x_norms[j] - 2.0 * product)
        }))
    }
}

/// Squared Euclidean norms of the columns of `x`, summed in `f64`.
pub fn squared_norms<T: Scalar>(x: MatRef<'_, T>) -> Vec<f64> {
    (0..x.ncols())
        .map(|j| {
            (0..x.nrows())
                .map(|i| -> f64 {
                    let value: f64 = x[(i, j)].into();
                    value * value
                })
                .sum()
        })
        .collect()
}

/// The median Euclidean distance between the observations in the columns of `x`, over all pairs.
///
/// The usual starting point for σ: with the width far below it, every observation is its own support vector; far above
/// it, they all look the same.
///
/// # Errors
/// Fewer than two observations, or all of them equal.
pub fn median_distance<T: Scalar>(x: MatRef<'_, T>) -> Result<f64, KernelError> {
    let norms = squared_norms(x);
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
    fn kernels_have_the_values_of_their_formulas() {
        let squared = 8.0;
        let gaussian = Kernel::gaussian(2.0).unwrap();
        let laplacian = Kernel::laplacian(2.0).unwrap();
        let between = Kernel::radial(2.0, 1.5).unwrap();
        assert!((gaussian.at_squared_distance(squared) - (-1.0f64).exp()).abs() < 1e-15);
        assert!((laplacian.at_squared_distance(squared) - (-1.0f64).exp()).abs() < 1e-15);
        assert!((between.at_squared_distance(2.0) - (-(0.25f64.powf(0.75))).exp()).abs() < 1e-15);
        assert!((laplacian.at_squared_distance(2.0) - (-0.5f64).exp()).abs() < 1e-15);
    }

    #[test]
    fn invalid_parameters_are_refused() {
        assert_eq!(Kernel::gaussian(0.0), Err(KernelError::Width(0.0)));
        assert!(Kernel::gaussian(f64::NAN).is_err());
        assert_eq!(Kernel::radial(1.0, 2.5), Err(KernelError::Exponent(2.5)));
        assert!(Kernel::radial(1.0, 0.0).is_err());
    }

    #[test]
    fn whole_numbers_in_f32_give_the_kernel_values_of_f64() {
        let pixel = |i: usize, j: usize| ((i * 37 + j * 101 + i * j) % 181) as f32 - 90.0;
        let s = Mat::<f32>::from_fn(1536, 7, pixel);
        let x = Mat::<f32>::from_fn(1536, 5, |i, j| pixel(i + 11, j + 3));
        let s64 = Mat::<f64>::from_fn(1536, 7, |i, j| f64::from(s[(i, j)]));
        let x64 = Mat::<f64>::from_fn(1536, 5, |i, j| f64::from(x[(i, j)]));
        let kernel = Kernel::gaussian(2000.0).unwrap();
        let (ns, nx) = (squared_norms(s.as_ref()), squared_norms(x.as_ref()));
        let single = kernel.matrix(s.as_ref(), &ns, x.as_ref(), &nx, Par::Seq).unwrap();
        let double = kernel.matrix(s64.as_ref(), &ns, x64.as_ref(), &nx, Par::Seq).unwrap();
        for j in 0..5 {
            for i in 0..7 {
                assert_eq!(single[(i, j)], double[(i, j)], "exact at ({i}, {j})");
            }
        }
    }

    #[test]
    fn median_distance_of_a_line_of_points() {
        // Distances between 0, 1, 3: they are 1, 2, 3.
        let x = Mat::<f64>::from_fn(1, 3, |_, j| [0.0, 1.0, 3.0][j]);
        assert_eq!(median_distance(x.as_ref()).unwrap(), 2.0);
        let same = Mat::<f64>::from_fn(1, 3, |_, _| 4.0);
        assert!(median_distance(same.as_ref()).is_err());
    }
}
