//! Which kernel, with which parameters.

use std::fmt;

#[cfg(feature = "snapshot")]
use serde::{Deserialize, Serialize};

use super::error::KernelError;
use super::exponential::exp_of_negative;

/// A positive definite kernel `k(x, x′)`.
///
/// All kernels here are functions of three numbers: the product `xᵀx′` and the squared norms `‖x‖²`, `‖x′‖²`. That is
/// what lets [`Kernel::matrix`](super::Kernel::matrix) run on one matrix product.
///
/// Made by one of its constructors, which refuse parameters for which it would not be positive definite.
///
/// # Reference
/// Thesis §2.2.3.
///
/// # Example
/// ```
/// use adagio::kernel::{Kernel, KernelError};
///
/// let kernel = Kernel::polynomial(2, 1.0)?;
/// // x = (1, 2), x′ = (3, −1): xᵀx′ = 1, ‖x‖² = 5, ‖x′‖² = 10.
/// assert_eq!(kernel.value(1.0, 5.0, 10.0), 4.0);
/// assert_eq!(kernel.diagonal(5.0), 36.0);
/// assert_eq!(kernel.to_string(), "polynomial (degree 2, offset 1)");
///
/// assert_eq!(Kernel::radial(1.0, 2.5), Err(KernelError::Exponent(2.5)));
/// # Ok::<(), KernelError>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "snapshot", derive(Serialize, Deserialize), serde(try_from = "Form", into = "Form"))]
pub struct Kernel {
    form: Form,
}

/// The formula of a [`Kernel`] with its parameters: to look at, to store, and to build one from (`Kernel::try_from`).
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "snapshot", derive(Serialize, Deserialize), serde(rename_all = "snake_case"))]
pub enum Form {
    /// `xᵀx′`.
    Linear,
    /// `(xᵀx′ + offset)^degree`.
    Polynomial {
        /// Degree `d` ≥ 1.
        degree: u32,
        /// Offset `c` ≥ 0.
        offset: f64,
    },
    /// `(xᵀx′ / (‖x‖ ‖x′‖))^degree`.
    NormalisedPolynomial {
        /// Degree `d` ≥ 1.
        degree: u32,
    },
    /// `exp(−(‖x − x′‖ / (√2 σ))^p)`.
    Radial {
        /// Width σ > 0, in the units of the observations.
        sigma: f64,
        /// Exponent `p` in (0, 2].
        exponent: f64,
    },
}

impl TryFrom<Form> for Kernel {
    type Error = KernelError;

    fn try_from(form: Form) -> Result<Self, KernelError> {
        match form {
            Form::Linear => {}
            Form::Polynomial { degree, offset } => {
                check_degree(degree)?;
                if !(offset >= 0.0 && offset.is_finite()) {
                    return Err(KernelError::Offset(offset));
                }
            }
            Form::NormalisedPolynomial { degree } => check_degree(degree)?,
            Form::Radial { sigma, exponent } => {
                if !SIGMA.contains(&sigma) {
                    return Err(KernelError::Width(sigma));
                }
                // Half of the smallest number is 0, and 0⁰ is not 0.
                if !(f64::MIN_POSITIVE..=2.0).contains(&exponent) {
                    return Err(KernelError::Exponent(exponent));
                }
            }
        }
        Ok(Kernel { form })
    }
}

impl From<Kernel> for Form {
    fn from(kernel: Kernel) -> Form {
        kernel.form
    }
}

impl Kernel {
    /// The linear kernel `xᵀx′`: with it, every kernel method is the linear method it came from.
    pub fn linear() -> Self {
        Kernel { form: Form::Linear }
    }

    /// The polynomial kernel `(xᵀx′ + c)^d` of degree `d` and offset `c`.
    ///
    /// With `c > 0` its feature space holds all monomials up to degree `d` – `(d+p choose d)` of them for observations
    /// of `p` values – and with `c = 0` those of degree `d` only. (The thesis counts `(d+p−1 choose d)` for "up to
    /// degree d", which is the number *of* degree d; its own example, 6 for p = d = 2, is right.)
    ///
    /// # Errors
    /// Degree 0 or above 2³¹ − 1; an offset that is negative or not finite.
    pub fn polynomial(degree: u32, offset: f64) -> Result<Self, KernelError> {
        Form::Polynomial { degree, offset }.try_into()
    }

    /// The normalised polynomial kernel `(xᵀx′ / (‖x‖ ‖x′‖))^d`: the cosine between the observations to the power of
    /// `d`.
    ///
    /// The zero vector has no direction. It is mapped to the origin of the feature space: `k(0, x) = 0` for every `x`,
    /// `k(0, 0) = 0` included. So the kernel stays positive definite, and a zero observation never becomes a support
    /// vector.
    ///
    /// # Errors
    /// Degree 0 or above 2³¹ − 1.
    pub fn normalised_polynomial(degree: u32) -> Result<Self, KernelError> {
        Form::NormalisedPolynomial { degree }.try_into()
    }

    /// The radial kernel `exp(−(‖x − x′‖ / (√2 σ))^p)` of width `sigma` and exponent `p`; `k(x, x) = 1`.
    ///
    /// # Units
    /// `sigma` is a distance between observations; [`median_distance`](super::median_distance) is where to start.
    ///
    /// # Errors
    /// `sigma` not positive or not finite; `exponent` outside (0, 2]. Above 2 the kernel is not positive definite
    /// (Schoenberg 1938).
    pub fn radial(sigma: f64, exponent: f64) -> Result<Self, KernelError> {
        Form::Radial { sigma, exponent }.try_into()
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

    /// The formula and its parameters.
    pub fn form(&self) -> Form {
        self.form
    }

    /// The width σ of a radial kernel, in the units of the observations.
    pub fn sigma(&self) -> Option<f64> {
        match self.form {
            Form::Radial { sigma, .. } => Some(sigma),
            _ => None,
        }
    }

    /// The exponent `p` of a radial kernel: 2 for the Gaussian, 1 for the Laplacian.
    pub fn exponent(&self) -> Option<f64> {
        match self.form {
            Form::Radial { exponent, .. } => Some(exponent),
            _ => None,
        }
    }

    /// The kernel value from the product `xᵀx′` and the squared norms `‖x‖²` and `‖x′‖²`.
    ///
    /// Rounding that makes a squared distance negative (for exponents below 2 also: not quite zero), or a cosine larger
    /// than 1, is cut off. Not a number in, not a number out; the only exception is a zero norm under the normalised
    /// polynomial kernel, which gives 0.
    #[inline]
    pub fn value(&self, product: f64, left_norm: f64, right_norm: f64) -> f64 {
        match self.form {
            Form::Linear => product,
            Form::Polynomial { degree, offset } => polynomial(product, degree, offset),
            Form::NormalisedPolynomial { degree } => normalised_polynomial(product, left_norm, right_norm, degree),
            Form::Radial { sigma, exponent: 2.0 } => gaussian(product, left_norm, right_norm, 2.0 * sigma * sigma),
            Form::Radial { sigma, exponent: 1.0 } => laplacian(product, left_norm, right_norm, 2.0 * sigma * sigma),
            Form::Radial { sigma, exponent } => {
                radial(product, left_norm, right_norm, 2.0 * sigma * sigma, 0.5 * exponent)
            }
        }
    }

    /// The kernel of an observation with itself, `k(x, x)`, from its squared norm `‖x‖²`: 1 for a radial kernel, whatever the
    /// observation.
    pub fn diagonal(&self, norm: f64) -> f64 {
        match self.form {
            Form::Linear => norm,
            Form::Polynomial { degree, offset } => (norm + offset).powi(degree as i32),
            Form::NormalisedPolynomial { .. } if norm.is_nan() => f64::NAN,
            Form::NormalisedPolynomial { .. } => f64::from(u8::from(norm > 0.0)),
            Form::Radial { .. } => 1.0,
        }
    }

    /// The name of the kernel's family, for reports; [`Display`](fmt::Display) adds the parameters.
    pub fn name(&self) -> &'static str {
        match self.form {
            Form::Linear => "linear",
            Form::Polynomial { .. } => "polynomial",
            Form::NormalisedPolynomial { .. } => "normalised polynomial",
            Form::Radial { exponent: 2.0, .. } => "gaussian",
            Form::Radial { exponent: 1.0, .. } => "laplacian",
            Form::Radial { .. } => "radial",
        }
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = self.name();
        match self.form {
            Form::Linear => write!(f, "{name}"),
            Form::Polynomial { degree, offset } => write!(f, "{name} (degree {degree}, offset {offset})"),
            Form::NormalisedPolynomial { degree } => write!(f, "{name} (degree {degree})"),
            Form::Radial { sigma, exponent } if exponent == 1.0 || exponent == 2.0 => {
                write!(f, "{name} (sigma {sigma})")
            }
            Form::Radial { sigma, exponent } => write!(f, "{name} (sigma {sigma}, exponent {exponent})"),
        }
    }
}

/// Widths whose square neither vanishes nor overflows.
const SIGMA: std::ops::RangeInclusive<f64> = 1e-150..=1e150;

/// `‖x‖² + ‖x′‖² − 2xᵀx′` of equal observations is not zero but a few roundings of its terms: this share of them at
/// most, for up to thousands of values per observation. (Whole numbers as in [`Kernel::matrix`](super::Kernel::matrix)
/// are exact, and far above it.)
const DISTANCE_ROUNDING: f64 = 16.0 * f64::EPSILON;

fn check_degree(degree: u32) -> Result<(), KernelError> {
    if degree == 0 || i32::try_from(degree).is_err() { Err(KernelError::Degree(degree)) } else { Ok(()) }
}

// The formulas, each a function of the product and the norms, without branches where vectors matter. `Kernel::value` and
// `Kernel::matrix` both come here, so one value and a block of them have the same bits.

#[inline(always)]
pub(super) fn polynomial(product: f64, degree: u32, offset: f64) -> f64 {
    (product + offset).powi(degree as i32)
}

#[inline(always)]
pub(super) fn normalised_polynomial(product: f64, left_norm: f64, right_norm: f64, degree: u32) -> f64 {
    if left_norm == 0.0 || right_norm == 0.0 {
        return 0.0;
    }
    let cosine = product / (left_norm.sqrt() * right_norm.sqrt());
    cosine.clamp(-1.0, 1.0).powi(degree as i32)
}

/// `scale` is 2σ².
#[inline(always)]
pub(super) fn gaussian(product: f64, left_norm: f64, right_norm: f64, scale: f64) -> f64 {
    let squared = left_norm + right_norm - 2.0 * product;
    // Not f64::max, which would make zero of a NaN, and so an unusable observation equal to every other.
    let squared = if squared < 0.0 { 0.0 } else { squared };
    exp_of_negative(-(squared / scale))
}

/// `scale` is 2σ².
#[inline(always)]
pub(super) fn laplacian(product: f64, left_norm: f64, right_norm: f64, scale: f64) -> f64 {
    exp_of_negative(-(squared_distance(product, left_norm, right_norm) / scale).sqrt())
}

/// `scale` is 2σ², `half` half of the exponent.
#[inline(always)]
pub(super) fn radial(product: f64, left_norm: f64, right_norm: f64, scale: f64, half: f64) -> f64 {
    exp_of_negative(-(squared_distance(product, left_norm, right_norm) / scale).powf(half))
}

/// For exponents below 2, where rounding of a zero distance is not small any more after the root: it counts as zero.
#[inline(always)]
fn squared_distance(product: f64, left_norm: f64, right_norm: f64) -> f64 {
    let (norms, squared) = (left_norm + right_norm, left_norm + right_norm - 2.0 * product);
    if squared < DISTANCE_ROUNDING * norms { 0.0 } else { squared }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radial_kernels_have_the_values_of_their_formulas() {
        let at = |kernel: Kernel, squared: f64| kernel.value(0.0, squared, 0.0);
        let gaussian = Kernel::gaussian(2.0).unwrap();
        let laplacian = Kernel::laplacian(2.0).unwrap();
        let between = Kernel::radial(2.0, 1.5).unwrap();
        assert!((at(gaussian, 8.0) - (-1.0f64).exp()).abs() < 1e-15);
        assert!((at(laplacian, 8.0) - (-1.0f64).exp()).abs() < 1e-15);
        assert!((at(between, 2.0) - (-(0.25f64.powf(0.75))).exp()).abs() < 1e-15);
        assert!((at(laplacian, 2.0) - (-0.5f64).exp()).abs() < 1e-15);
        // Rounding below zero counts as zero; what is not a number stays that.
        assert_eq!(gaussian.value(1.0 + 1e-15, 1.0, 1.0), 1.0);
        assert!(gaussian.value(f64::NAN, 1.0, 1.0).is_nan());
    }

    #[test]
    fn the_narrowest_and_the_widest_kernel_have_their_limits() {
        let narrow = Kernel::gaussian(1e-150).unwrap();
        assert_eq!(narrow.value(0.0, 1.0, 0.0), 0.0);
        assert_eq!(narrow.value(1.0, 1.0, 1.0), 1.0);
        let wide = Kernel::gaussian(1e150).unwrap();
        assert_eq!(wide.value(0.0, 1.0, 0.0), 1.0);
        // Beyond, σ² would be 0 and k(x, x) = exp(−0/0).
        assert_eq!(Kernel::gaussian(1e-200), Err(KernelError::Width(1e-200)));
    }

    #[test]
    fn invalid_parameters_are_refused_with_their_value_and_range() {
        assert_eq!(Kernel::gaussian(0.0), Err(KernelError::Width(0.0)));
        assert!(Kernel::gaussian(f64::NAN).is_err());
        assert_eq!(Kernel::radial(1.0, 2.5), Err(KernelError::Exponent(2.5)));
        assert!(Kernel::radial(1.0, 0.0).is_err());
        assert_eq!(Kernel::radial(1.0, 5e-324), Err(KernelError::Exponent(5e-324)));
        assert_eq!(Kernel::polynomial(0, 1.0), Err(KernelError::Degree(0)));
        assert_eq!(Kernel::polynomial(2, -0.5), Err(KernelError::Offset(-0.5)));
        assert!(Kernel::polynomial(2, f64::INFINITY).is_err());
        assert_eq!(Kernel::normalised_polynomial(u32::MAX), Err(KernelError::Degree(u32::MAX)));
        let text = Kernel::polynomial(2, -0.5).unwrap_err().to_string();
        assert!(text.contains("-0.5") && text.contains("≥ 0"), "{text}");
    }
}
