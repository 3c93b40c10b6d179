//! Kernel ridge regression: over all samples, and over the support vectors of a dictionary.
//!
//! # Reference
//! Thesis §2.2.2, algorithm 3; the representer theorem, §2.2.1.

use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Mat, MatRef, Par};

use super::error::{RegressionError, check_finite};
use super::function::{Linear, add_bias};
use super::linear::{check_lambda, solve};
use crate::dictionary::Dictionary;
use crate::kernel::{Kernel, KernelError, Scalar, finite_norms};

/// A function of the kernel's space, `y(x) = Aᵀk(x) + b`.
///
/// Replacing scalar products by a kernel, ridge regression becomes `A = (K + λI)⁻¹Tᵀ` and `y(x) = Aᵀk(x)`, with one
/// coefficient per sample and target (dual form). Over `m` support vectors the same problem is ridge regression on
/// their Newton coordinates `v(x)` (primal form), whose cost grows with `m` and only linearly with the number of
/// samples.
#[derive(Debug, Clone)]
pub struct KernelModel<T: Scalar> {
    kernel: Kernel,
    /// Support vectors, `d × m`.
    members: Mat<T>,
    norms: Vec<f64>,
    /// `A`, `m × q`.
    coefficients: Mat<f64>,
    /// `b`, `q`.
    bias: Vec<f64>,
}

impl<T: Scalar> KernelModel<T> {
    /// The function whose weights in the Newton coordinates of a dictionary are `function`: `A = L⁻ᵀW`.
    ///
    /// With weights from [`ridge`](super::ridge) this is kernel ridge regression over the support vectors; it takes all
    /// samples into account.
    ///
    /// # Errors
    /// Weights for another number of coordinates than the dictionary has support vectors.
    ///
    /// # Example
    /// ```
    /// use adagio::dictionary::Dictionary;
    /// use adagio::kernel::Kernel;
    /// use adagio::regression::{Bias, KernelModel, Sums, ridge};
    /// use faer::{Mat, Par};
    ///
    /// # fn main() -> Result<(), Box<dyn std::error::Error>> {
    /// let x = Mat::<f64>::from_fn(1, 200, |_, j| 0.05 * j as f64);
    /// let t = Mat::<f64>::from_fn(1, 200, |_, j| x[(0, j)].sin());
    /// let kernel = Kernel::gaussian(1.0)?;
    /// let mut dictionary = Dictionary::new(kernel, 100, Par::Seq);
    /// dictionary.grow(x.as_ref(), |_, residual| residual > 1e-3)?;
    ///
    /// let v = dictionary.coordinates(x.as_ref())?;
    /// let mut sums = Sums::new(dictionary.len(), 1)?;
    /// sums.add(v.as_ref(), t.as_ref(), Par::Seq)?;
    /// let model = KernelModel::over(&dictionary, &ridge(&sums, 1e-6, Bias::None)?)?;
    ///
    /// let y = model.predict(Mat::from_fn(1, 1, |_, _| 2.02).as_ref(), Par::Seq)?;
    /// assert!(dictionary.len() < 30);
    /// assert!((y[(0, 0)] - 2.02f64.sin()).abs() < 1e-3);
    /// # Ok(())
    /// # }
    /// ```
    pub fn over(dictionary: &Dictionary<T>, function: &Linear) -> Result<Self, RegressionError> {
        RegressionError::unless_fits("the number of weights", function.weights.nrows(), dictionary.len())?;
        RegressionError::unless_fits("the length of the bias", function.bias.len(), function.weights.ncols())?;
        let mut coefficients = function.weights.clone();
        solve_upper_triangular_in_place(dictionary.factor().transpose(), coefficients.as_mut(), Par::Seq);
        Ok(KernelModel {
            kernel: dictionary.kernel(),
            members: dictionary.members().to_owned(),
            norms: dictionary.norms().to_vec(),
            coefficients,
            bias: function.bias.clone(),
        })
    }

    /// Predictions: `x: d × n` gives `q × n`.
    ///
    /// # Errors
    /// Observations of another length than the support vectors, or that are not finite.
    pub fn predict(&self, x: MatRef<'_, T>, par: Par) -> Result<Mat<f64>, RegressionError> {
        let norms = finite_norms("observation", x)?;
        let mut y = if self.norms.is_empty() {
            Mat::zeros(self.bias.len(), x.ncols())
        } else {
            self.coefficients.transpose() * self.kernel.matrix(self.members.as_ref(), &self.norms, x, &norms, par)?
        };
        add_bias(&mut y, &self.bias)?;
        Ok(y)
    }

    /// The kernel.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// The support vectors, `d × m`.
    pub fn members(&self) -> MatRef<'_, T> {
        self.members.as_ref()
    }

    /// The coefficients `A`, `m × q`.
    pub fn coefficients(&self) -> MatRef<'_, f64> {
        self.coefficients.as_ref()
    }

    /// The bias `b`, `q`; zeros if it was fitted without one.
    pub fn bias(&self) -> &[f64] {
        &self.bias
    }
}

/// Kernel ridge regression with every sample as support vector, without a bias: `A = (K + λI)⁻¹Tᵀ`.
///
/// With λ = 0 the function goes through all targets as far as the kernel can tell the samples apart. `O(n²)` memory,
/// `O(n³)` time.
///
/// # Shapes
/// `x: d × n`, `t: q × n`.
///
/// # Errors
/// Shapes that do not fit, no samples, values that are not finite, λ negative or not finite.
///
/// # Reference
/// Thesis §2.2.2, algorithm 3.
///
/// # Example
/// ```
/// use adagio::kernel::Kernel;
/// use adagio::regression::kernel_ridge;
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::regression::RegressionError> {
/// // Exclusive or, which no linear function solves, is solved by products of two inputs (thesis §2.2).
/// let x = Mat::<f64>::from_fn(2, 4, |i, j| ((j >> i) & 1) as f64);
/// let t = Mat::<f64>::from_fn(1, 4, |_, j| [0.0, 1.0, 1.0, 0.0][j]);
/// let model = kernel_ridge(Kernel::polynomial(2, 1.0)?, x.as_ref(), t.as_ref(), 1e-9, Par::Seq)?;
/// let y = model.predict(x.as_ref(), Par::Seq)?;
/// assert!((0..4).all(|j| (y[(0, j)] - t[(0, j)]).abs() < 1e-6));
/// # Ok(())
/// # }
/// ```
pub fn kernel_ridge<T: Scalar>(
    kernel: Kernel,
    x: MatRef<'_, T>,
    t: MatRef<'_, f64>,
    lambda: f64,
    par: Par,
) -> Result<KernelModel<T>, RegressionError> {
    check_lambda(lambda)?;
    RegressionError::unless_fits("the number of targets", t.ncols(), x.ncols())?;
    if x.ncols() == 0 {
        return Err(RegressionError::NoSamples);
    }
    check_finite("target", t)?;
    let norms = finite_norms("input", x)?;
    let k = kernel.matrix(x, &norms, x, &norms, par)?;
    if !k.is_all_finite() {
        return Err(KernelError::Overflow.into());
    }
    let coefficients = solve(k.as_ref(), t.transpose(), lambda, 0.0)?.weights;
    Ok(KernelModel { kernel, members: x.to_owned(), norms, coefficients, bias: vec![0.0; t.nrows()] })
}
