//! Regression: functions that predict targets from observations, linear and with kernels, in one go or as samples
//! stream by.
//!
//! # The problem
//! Samples `(x, t)` with `t = f(x) + noise`; find a function `y` close to `f`. Least squares minimises the training
//! error `Σ ‖y(x) − t‖²`; *ridge regression* adds the penalty `λ‖W‖²`, so that of functions which explain the samples
//! about equally well, the simpler one wins.
//!
//! | function class | fitted by | cost |
//! |---|---|---|
//! | linear and affine, `y(x) = Wᵀx + b` | [`Sums`], then [`least_squares`] or [`ridge`] | `O(p²)` a sample, `O(p³)` a solution |
//! | kernel, over all samples, `y(x) = Aᵀk(x)` | [`kernel_ridge`] | `O(n³)`: the reference for small n |
//! | kernel, over a dictionary's support vectors | [`Sums`] of Newton coordinates, then [`KernelModel::over`] | `O(m²)` a sample, `O(m³)` a solution |
//! | the same, up to date after every sample | [`KernelRls`] | `O(m²)` a sample |
//!
//! How good it is on samples that were not seen, and which λ, σ and number of support vectors to take:
//! [`cross_validate`], [`select_ridge`] and [`select_kernel_ridge`].
//!
//! # Symbols
//! Inputs `X` (`p × n`) and targets `T` (`q × n`) hold one sample a *column*. `C = Σxxᵀ` (`p × p`), `B = Σxtᵀ`
//! (`p × q`), weights `W` (`p × q`), bias `b` (`q`), regulariser λ; `K` the kernel matrix, `A` (`m × q`) coefficients
//! over `m` support vectors, `v = L⁻¹k(x)` Newton coordinates of a dictionary with `K = LLᵀ`.
//!
//! Why ridge regression on `v` *is* kernel ridge regression over the support vectors: `y(x) = wᵀv(x)` is the function
//! with coefficients `a = L⁻ᵀw`, whose norm in the kernel's Hilbert space is `aᵀKa = ‖w‖²`. So the penalty is the plain
//! `λ‖w‖²`, and the same running sums serve.
//!
//! # Numerics
//! All in `f64`, but for observations of kernels. The products of [`Sums`] follow the `par` that they are given; Cholesky factors,
//! eigenvalues and predictions follow faer's global setting. Last bits may differ with either: who compares bits calls
//! [`crate::random::fix_parallelism`] first, and gives one `par`.
//!
//! # Reference
//! Thesis §2.1 (regression), §2.1.4 (validation), §2.1.5 (algorithms 1 and 2), §2.2.2 (kernel ridge regression,
//! algorithm 3); Hastie, Tibshirani & Friedman, *The Elements of Statistical Learning*, 2009, ch. 3 and 7; Engel,
//! Mannor & Meir 2004.
//!
//! # Example
//! ```
//! use adagio::regression::{Bias, Sums, ridge};
//! use faer::{Mat, Par};
//!
//! # fn main() -> Result<(), adagio::regression::RegressionError> {
//! // t = 2x − 1, seen in two blocks.
//! let mut sums = Sums::new(1, 1)?;
//! for block in [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]] {
//!     let x = Mat::from_fn(1, 3, |_, j| block[j]);
//!     let t = Mat::from_fn(1, 3, |_, j| 2.0 * block[j] - 1.0);
//!     sums.add(x.as_ref(), t.as_ref(), Par::Seq)?;
//! }
//! let line = ridge(&sums, 0.0, Bias::Free)?;
//! assert!((line.weights[(0, 0)] - 2.0).abs() < 1e-12 && (line.bias[0] + 1.0).abs() < 1e-12);
//!
//! // A penalty flattens it: the slope becomes 2·S/(S + λ) with S = Σ(x − x̄)² = 17.5.
//! let flat = ridge(&sums, 17.5, Bias::Free)?;
//! assert!((flat.weights[(0, 0)] - 1.0).abs() < 1e-12);
//! // The sums alone give the training error.
//! assert!(sums.mean_squared_error(&line)? < 1e-12 && sums.mean_squared_error(&flat)? > 1.0);
//! # Ok(())
//! # }
//! ```

mod error;
mod function;
mod kernel;
mod linear;
mod recursive;
mod select;
mod sums;
mod validate;

pub use error::RegressionError;
pub use function::{Bias, Linear};
pub use kernel::{KernelModel, kernel_ridge};
pub use linear::{least_squares, ridge};
pub use recursive::KernelRls;
pub use select::{Candidate, KernelGrid, KernelSettings, ModelSelection, select_kernel_ridge, select_ridge};
pub use sums::Sums;
pub use validate::{Errors, Folds, Score, cross_validate, hold_out};
