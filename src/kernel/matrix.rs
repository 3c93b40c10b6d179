//! Kernel values for whole blocks of observations.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};
use pulp::{Arch, NullaryFnOnce};

use super::error::KernelError;
use super::function::{Form, Kernel, gaussian, laplacian, normalised_polynomial, polynomial, radial};
use super::products::{join, near_half};
#[cfg(feature = "snapshot")]
use crate::snapshot::Element;

/// Without snapshots nothing is asked of a number for them.
#[cfg(not(feature = "snapshot"))]
mod element {
    pub trait Element: Copy {}
    impl<T: Copy> Element for T {}
}
#[cfg(not(feature = "snapshot"))]
use element::Element;

/// The number type of observations: `f32` or `f64`.
pub trait Scalar: faer::traits::ComplexField + Element + Default + Into<f64> + Send + Sync + 'static {
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
    /// `f64`); everything after it is in `f64`, each value as [`Kernel::value`] has it, bit for bit.
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
        refuse_other_sizes(sizes)?;
        let mut values = Mat::zeros(s.ncols(), x.ncols());
        fill(self, Side { x: s, norms: s_norms }, Side { x, norms: x_norms }, values.as_mut(), par);
        Ok(values)
    }

    /// Kernel values of products `SᵀX` that were computed elsewhere: those of [`Kernel::matrix`], bit for bit, if the products are.
    ///
    /// # Shapes
    /// `products: m × n`, `s_norms: m`, `x_norms: n`; the result is `m × n`.
    ///
    /// # Errors
    /// Shapes that do not fit each other.
    ///
    /// # Panics
    /// If a column of `products` does not lie in one piece.
    pub fn matrix_of_products<T: Scalar>(
        &self,
        products: MatRef<'_, T>,
        s_norms: &[f64],
        x_norms: &[f64],
        par: Par,
    ) -> Result<Mat<f64>, KernelError> {
        let sizes = [
            ("the list of norms on the left", s_norms.len(), products.nrows()),
            ("the list of norms on the right", x_norms.len(), products.ncols()),
        ];
        refuse_other_sizes(sizes)?;
        let mut values = Mat::zeros(products.nrows(), products.ncols());
        Tile { kernel: self, products, left: s_norms, right: x_norms, values: values.as_mut() }.compute(par);
        Ok(values)
    }

    /// Kernel values from products, one column after the other.
    #[inline(always)]
    fn values<T: Scalar>(&self, products: MatRef<'_, T>, left: &[f64], right: &[f64], values: MatMut<'_, f64>) {
        match self.form() {
            Form::Linear => each(products, left, right, values, |product, _, _| product),
            Form::Polynomial { degree, offset } => {
                each(products, left, right, values, |product, _, _| polynomial(product, degree, offset));
            }
            Form::NormalisedPolynomial { degree } => {
                each(products, left, right, values, |product, l, r| normalised_polynomial(product, l, r, degree));
            }
            Form::Radial { sigma, exponent } => {
                let scale = 2.0 * sigma * sigma;
                if exponent == 2.0 {
                    each(products, left, right, values, |product, l, r| gaussian(product, l, r, scale));
                } else if exponent == 1.0 {
                    each(products, left, right, values, |product, l, r| laplacian(product, l, r, scale));
                } else {
                    let half = 0.5 * exponent;
                    each(products, left, right, values, |product, l, r| radial(product, l, r, scale, half));
                }
            }
        }
    }
}

/// Sizes with their names: found, expected.
fn refuse_other_sizes(sizes: impl IntoIterator<Item = (&'static str, usize, usize)>) -> Result<(), KernelError> {
    match sizes.into_iter().find(|(_, found, expected)| found != expected) {
        Some((what, found, expected)) => Err(KernelError::Shape { what, found, expected }),
        None => Ok(()),
    }
}

/// Observations with their squared norms.
#[derive(Clone, Copy)]
struct Side<'a, T: Scalar> {
    x: MatRef<'a, T>,
    norms: &'a [f64],
}

impl<'a, T: Scalar> Side<'a, T> {
    fn split(self, at: usize) -> (Side<'a, T>, Side<'a, T>) {
        let ((x, y), (left, right)) = (self.x.split_at_col(at), self.norms.split_at(at));
        (Side { x, norms: left }, Side { x: y, norms: right })
    }
}

/// Kernel values are computed in tiles of at most this many rows and columns: the products of a tile stay in the cache,
/// and there is never a second matrix of the size of the result. Tiles do not depend on the number of threads.
const TILE: usize = 512;

fn fill<T: Scalar>(kernel: &Kernel, s: Side<'_, T>, x: Side<'_, T>, values: MatMut<'_, f64>, par: Par) {
    let (m, n) = (values.nrows(), values.ncols());
    if m.max(n) <= TILE {
        let mut products = Mat::<T>::zeros(m, n);
        matmul(products.as_mut(), Accum::Replace, s.x.transpose(), x.x, T::one_impl(), Par::Seq);
        return Arch::new().dispatch(Tile {
            kernel,
            products: products.as_ref(),
            left: s.norms,
            right: x.norms,
            values,
        });
    }
    if m >= n {
        let half = near_half(m);
        let ((above, below), (top, bottom)) = (values.split_at_row_mut(half), s.split(half));
        join(par, |par| fill(kernel, top, x, above, par), |par| fill(kernel, bottom, x, below, par));
    } else {
        let half = near_half(n);
        let ((before, after), (first, last)) = (values.split_at_col_mut(half), x.split(half));
        join(par, |par| fill(kernel, s, first, before, par), |par| fill(kernel, s, last, after, par));
    }
}

/// What runs on vectors: the widest that the machine has.
struct Tile<'a, T: Scalar> {
    kernel: &'a Kernel,
    products: MatRef<'a, T>,
    left: &'a [f64],
    right: &'a [f64],
    values: MatMut<'a, f64>,
}

impl<T: Scalar> Tile<'_, T> {
    /// On several threads: each entry is computed alone, so that where it is cut does not matter.
    fn compute(self, par: Par) {
        let n = self.right.len();
        if n <= TILE / 8 {
            return Arch::new().dispatch(self);
        }
        let half = near_half(n);
        let (before, after) = self.products.split_at_col(half);
        let (first, last) = self.right.split_at(half);
        let (of_first, of_last) = self.values.split_at_col_mut(half);
        let Tile { kernel, left, .. } = self;
        join(
            par,
            |par| Tile { kernel, products: before, left, right: first, values: of_first }.compute(par),
            |par| Tile { kernel, products: after, left, right: last, values: of_last }.compute(par),
        );
    }
}

impl<T: Scalar> NullaryFnOnce for Tile<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.kernel.values(self.products, self.left, self.right, self.values);
    }
}

#[inline(always)]
fn each<T: Scalar>(
    products: MatRef<'_, T>,
    left: &[f64],
    right: &[f64],
    mut values: MatMut<'_, f64>,
    value: impl Fn(f64, f64, f64) -> f64,
) {
    for (j, &right) in right.iter().enumerate() {
        let (values, products) =
            (values.as_mut().col_mut(j).try_as_col_major_mut(), products.col(j).try_as_col_major());
        let (Some(column), Some(products)) = (values, products) else {
            panic!("columns of kernel values and products lie in one piece each")
        };
        for ((value_of, &product), &left) in column.as_slice_mut().iter_mut().zip(products.as_slice()).zip(left) {
            *value_of = value(product.into(), left, right);
        }
    }
}

/// Squared Euclidean norms of the columns of `x`, summed in `f64`.
pub fn squared_norms<T: Scalar>(x: MatRef<'_, T>) -> Vec<f64> {
    let square = |&value: &T| -> f64 {
        let value: f64 = value.into();
        value * value
    };
    x.col_iter()
        .map(|column| match column.try_as_col_major() {
            Some(column) => column.as_slice().iter().map(square).sum(),
            None => column.iter().map(square).sum(),
        })
        .collect()
}

/// Whether an observation of this squared norm has only finite values, and finite products with others like it.
pub(crate) fn is_usable_norm<T: Scalar>(norm: f64) -> bool {
    (0.0..=T::LARGEST / 4.0).contains(&norm)
}

/// [`squared_norms`], if all of them are numbers of the type of the observations, and so all products of two
/// observations; `what` names the observations in the error.
pub(crate) fn finite_norms<T: Scalar>(what: &'static str, x: MatRef<'_, T>) -> Result<Vec<f64>, KernelError> {
    let norms = squared_norms(x);
    match norms.iter().position(|&norm| !is_usable_norm::<T>(norm)) {
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
        // The radial values are those of the plain formula on exact squared distances, but for the last place of exp.
        let laplacian = Kernel::laplacian(2000.0).unwrap();
        let k = laplacian.matrix(s.as_ref(), &ns, x.as_ref(), &nx, Par::Seq).unwrap();
        let squared: i64 = (0..1536).map(|r| (s[(r, 3)] as i64 - x[(r, 2)] as i64).pow(2)).sum();
        let exact = (-(squared as f64 / (2.0 * 2000.0 * 2000.0)).sqrt()).exp();
        assert!((k[(3, 2)] - exact).abs() <= f64::EPSILON * exact);
        assert_eq!(k[(3, 2)], laplacian.value(0.5 * (ns[3] + nx[2] - squared as f64), ns[3], nx[2]));

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
