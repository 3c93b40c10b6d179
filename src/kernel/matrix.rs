//! Kernel values for whole blocks of observations.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

use super::error::KernelError;
use super::function::Kernel;

/// The number type of observations: `f32` or `f64`.
pub trait Scalar: faer::traits::ComplexField + Copy + Into<f64> + Send + Sync + 'static {
    /// The largest finite number of the type: products of observations must stay below it.
    const LARGEST: f64;
}

impl Scalar for f32 {
    const LARGEST: f64 = f32::MAX as f64;
}
impl Scalar for f64 {
    const LARGEST: f64 = f64::MAX;
}

impl Kernel {
    /// Kernel values between two sets of observations.
    ///
    /// `K = k(SᵀX, ‖s‖², ‖x‖²)`, entry by entry: one matrix product, which runs in the type of the observations (`f32` or
    /// `f64`); everything after it is in `f64`.
    ///
    /// Observations that are whole numbers (camera pixels with a constant subtracted) give *exact* `f32` products as long
    /// as `‖x‖² < 2²⁴` for each of them: by Cauchy–Schwarz no partial sum can then leave the range in which `f32` counts
    /// whole numbers without rounding. The kernel values are the same bits in any order of summation, hence on any number
    /// of threads and for one observation or a block.
    ///
    /// An observation with values that are not finite gives kernel values that are not finite, or 0 under a radial
    /// kernel (at an infinite distance); it never raises a panic, and never changes the values of the other
    /// observations.
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
            self.value(product, s_norms[i], x_norms[j])
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

/// [`squared_norms`], if all of them are numbers of the type of the observations, and so all products of two
/// observations; `what` names the observations in the error.
pub(crate) fn finite_norms<T: Scalar>(what: &'static str, x: MatRef<'_, T>) -> Result<Vec<f64>, KernelError> {
    let norms = squared_norms(x);
    match norms.iter().position(|&norm| !(0.0..=T::LARGEST / 4.0).contains(&norm)) {
        Some(index) => Err(KernelError::NotFinite { what, index }),
        None => Ok(norms),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_in_f32_give_the_kernel_values_of_f64() {
        let pixel = |i: usize, j: usize| ((i * 37 + j * 101 + i * j) % 181) as f32 - 90.0;
        let s = Mat::<f32>::from_fn(1536, 7, pixel);
        let x = Mat::<f32>::from_fn(1536, 5, |i, j| pixel(i + 11, j + 3));
        let s64 = Mat::<f64>::from_fn(1536, 7, |i, j| f64::from(s[(i, j)]));
        let x64 = Mat::<f64>::from_fn(1536, 5, |i, j| f64::from(x[(i, j)]));
        let kernels = [Kernel::gaussian(2000.0), Kernel::polynomial(3, 1.0), Kernel::normalised_polynomial(2)];
        let (ns, nx) = (squared_norms(s.as_ref()), squared_norms(x.as_ref()));
        assert!(ns.iter().chain(&nx).all(|&norm| norm < 16_777_216.0));
        // The radial values are those of the plain formula on exact squared distances, bit for bit.
        let laplacian = Kernel::laplacian(2000.0).unwrap();
        let k = laplacian.matrix(s.as_ref(), &ns, x.as_ref(), &nx, Par::Seq).unwrap();
        let squared: i64 = (0..1536).map(|r| (s[(r, 3)] as i64 - x[(r, 2)] as i64).pow(2)).sum();
        assert_eq!(k[(3, 2)], (-(squared as f64 / (2.0 * 2000.0 * 2000.0)).sqrt()).exp());

        for kernel in kernels.map(Result::unwrap) {
            let single = kernel.matrix(s.as_ref(), &ns, x.as_ref(), &nx, Par::Seq).unwrap();
            let double = kernel.matrix(s64.as_ref(), &ns, x64.as_ref(), &nx, Par::Seq).unwrap();
            for j in 0..5 {
                for i in 0..7 {
                    assert_eq!(single[(i, j)], double[(i, j)], "{kernel}: exact at ({i}, {j})");
                }
            }
        }
    }
}
