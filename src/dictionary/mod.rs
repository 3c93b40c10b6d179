//! Which observations to keep as support vectors.
//!
//! Symbols (DESIGN §2): support vectors `s₁ … s_m` in the order in which they were accepted, kernel matrix `K = LLᵀ`
//! (Cholesky), kernel row `k(x)`, **Newton coordinates** `v(x) = L⁻¹k(x)`, residual `ε(x) = k(x, x) − ‖v(x)‖²`: the squared
//! distance of `x` from the span of the support vectors in feature space.
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
//! ([`WhenFull`]). [`width_for_size`] finds the kernel width at which ALD keeps a given number.
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
pub use feature_ald::{FeatureAld, FeatureMap, FeatureParameters};
pub use greedy::GreedyResidual;
pub use newton::{Block, Dictionary, Thinning};
pub use reservoir::Reservoir;
pub use selection::Selection;
pub use width::{WidthForSize, width_for_size};
