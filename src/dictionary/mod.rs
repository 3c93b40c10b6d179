//! Which observations to keep as support vectors.
//!
//! With a kernel `k`, what can be learned from observations `x₁ … x_n` is `f(x) = Σᵢ αᵢ k(xᵢ, x)`: it costs a coefficient
//! and a kernel value per observation, and n × n matrices to find. But most observations are nearly combinations of others.
//! A dictionary keeps those that are not, the *support vectors*, and expresses all others by them.
//!
//! | symbol | size | meaning |
//! |---|---|---|
//! | `s₁ … s_m` | d each | support vectors, in the order in which they were accepted |
//! | `K = LLᵀ` | m × m | their kernel matrix and its Cholesky factor |
//! | `k(x)` | m | kernel row: kernel values of `x` with the support vectors |
//! | `v(x) = L⁻¹k(x)` | m | *Newton coordinates* of `x` |
//! | `ε(x) = k(x, x) − ‖v(x)‖²` | | residual: squared distance of `x` from the span of the support vectors in the kernel's feature space |
//!
//! Scalar products of Newton coordinates are kernel values, `v(x)ᵀv(x′) ≈ k(x, x′)`, up to the residuals, so any linear
//! method run on `v` is the kernel method. A function `f(x) = wᵀv(x)` has the norm `‖w‖` in the kernel's Hilbert space; and
//! coordinates that exist stay as they are when a support vector comes in.
//!
//! A [`Dictionary`] holds support vectors and their factor. A [`Selection`] owns one and decides what it takes:
//!
//! | selection | takes | stream? |
//! |---|---|---|
//! | [`Ald`] | what is not approximately linearly dependent, `ε(x) > ν` | yes |
//! | [`Reservoir`] | a uniformly random sample of all observations so far | yes |
//! | [`FeatureAld`] | what is not approximately dependent in the space of given features, such as slow ones | yes |
//! | [`GreedyResidual`] | again and again the observation with the largest residual (MP-MAH) | no: within one block |
//!
//! At its budget an [`Ald`] stops growing, raises ν and thins out, or replaces its least independent members
//! ([`WhenFull`]). Everything that was summed over coordinates follows a [`Thinning`] exactly. [`width_for_size`] finds the
//! kernel width at which ALD keeps a given number; [`width_for_share`] is a start where nothing else is known.
//!
//! # Numerics
//! Coordinates, residuals and the factor are `f64`. What a selection takes and the coordinates of observations have the same bits for
//! any [`faer::Par`]. When members leave ([`Dictionary::keep`], [`WhenFull::RaiseNu`], [`WhenFull::Replace`]), decompositions follow
//! faer's global setting ([`crate::random::fix_parallelism`]).
//!
//! # Erratum of the thesis
//! Algorithm 2 (§2.2.6) accepts an observation if `ε < ν`; its text, and Engel et al., accept it if `ε > ν`, as here.
//!
//! # Reference
//! Thesis §2.2.5, §2.2.6; Engel, Mannor & Meir, IEEE Trans. Signal Processing 52 (2004); Müller & Schaback, J. Approx.
//! Theory 161 (2009) (Newton basis).
//!
//! # Example
//! ```
//! use adagio::dictionary::{Ald, Parameters, Selection, WhenFull};
//! use adagio::kernel::Kernel;
//! use faer::{Mat, Par};
//!
//! # fn main() -> Result<(), adagio::dictionary::DictionaryError> {
//! let parameters =
//!     Parameters { kernel: Kernel::gaussian(0.5)?, nu: 0.01, budget: 100, when_full: WhenFull::Stop, par: Par::Seq };
//! let mut selection = Ald::new(parameters)?;
//! // 1000 points of a circle: a few of them span all others up to √ν.
//! let circle = Mat::from_fn(2, 1000, |i, t| if i == 0 { (t as f64).cos() } else { (t as f64).sin() });
//! let block = selection.observe(circle.as_ref())?;
//! assert_eq!(block.accepted.len(), selection.dictionary().len());
//! assert!(selection.dictionary().len() < 20);
//! let v = selection.dictionary().coordinates(circle.as_ref())?;
//! assert!((0..1000).all(|t| v.col(t).squared_norm_l2() >= 1.0 - 0.01 - 1e-12));
//! # Ok(())
//! # }
//! ```

mod ald;
mod error;
mod feature_ald;
mod greedy;
mod newton;
mod reservoir;
mod selection;
mod width;

pub use ald::{Ald, Parameters, WhenFull};
pub use error::DictionaryError;
pub use feature_ald::{FeatureAld, FeatureParameters};
pub use greedy::GreedyResidual;
pub(crate) use newton::capacity;
pub use newton::{Block, Dictionary, Thinning};
pub use reservoir::Reservoir;
pub use selection::{FeatureMap, Selection};
pub use width::{WidthForSize, wider_for_share, width_for_share, width_for_size};
