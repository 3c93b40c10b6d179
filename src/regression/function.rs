//! Linear and affine functions.

use faer::{Mat, MatRef};

use super::error::{RegressionError, check_finite};

/// Whether the function has a constant part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Bias {
    /// Affine, `y(x) = Wᵀx + b`; the bias `b` is not penalised.
    #[default]
    Free,
    /// Linear, `y(x) = Wᵀx`.
    None,
}

/// A fitted function `y(x) = Wᵀx + b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Linear {
    /// Weights `W`, `p × q`.
    pub weights: Mat<f64>,
    /// Bias `b`, `q`; zeros for [`Bias::None`].
    pub bias: Vec<f64>,
    /// Effective number of parameters per target, `trace((C + λI)⁻¹C)`, without the bias: the rank of `C` for λ = 0,
    /// fewer the larger λ is.
    pub parameters: f64,
}

impl Linear {
    /// Predictions: `x: p × n` gives `q × n`.
    ///
    /// # Errors
    /// Inputs of another length, or that are not finite; weights and a bias of different lengths; predictions too large for
    /// `f64`.
    pub fn predict(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, RegressionError> {
        RegressionError::unless_fits("the length of an input", x.nrows(), self.weights.nrows())?;
        RegressionError::unless_fits("the length of the bias", self.bias.len(), self.weights.ncols())?;
        check_finite("input", x)?;
        let mut y = self.weights.transpose() * x;
        add_bias(&mut y, &self.bias)?;
        Ok(y)
    }
}

/// Add a bias to each column, and see that the result is finite.
pub(super) fn add_bias(y: &mut Mat<f64>, bias: &[f64]) -> Result<(), RegressionError> {
    for j in 0..y.ncols() {
        y.col_mut(j).iter_mut().zip(bias).for_each(|(value, b)| *value += b);
    }
    if y.is_all_finite() { Ok(()) } else { Err(RegressionError::Overflow("a prediction")) }
}
