//! Kernel functions, kernel matrices for whole blocks of observations, and principal components in a kernel's space.
//!
//! # The kernel trick
//! An algorithm that sees its observations only through scalar products `xᵀx′` can be run on `ψ(x)`, a nonlinear
//! expansion of `x`, without ever computing `ψ`: it suffices to replace the products by a *kernel*
//! `k(x, x′) = ⟨ψ(x), ψ(x′)⟩`. Every function `k` whose matrices `K`, `Kᵢⱼ = k(xᵢ, xⱼ)`, have no negative eigenvalue is
//! such a scalar product (positive definite kernel). The functions that can be learned are then
//! `f(x) = Σᵢ αᵢ k(xᵢ, x)`.
//!
//! | constructor | `k(x, x′)` | valid for | `ψ` holds |
//! |---|---|---|---|
//! | [`Kernel::linear`] | `xᵀx′` | – | `x` itself |
//! | [`Kernel::polynomial`] | `(xᵀx′ + c)^d` | integer d ≥ 1, c ≥ 0 | all monomials up to degree d (c > 0) or of degree d (c = 0) |
//! | [`Kernel::normalised_polynomial`] | `(xᵀx′ / (‖x‖ ‖x′‖))^d` | integer d ≥ 1 | monomials of degree d of the direction of `x` |
//! | [`Kernel::radial`] | `exp(−(‖x − x′‖ / (√2 σ))^p)` | σ > 0, 0 < p ≤ 2 | infinitely many functions |
//! | [`Kernel::gaussian`] | the same with p = 2 | σ > 0 | |
//! | [`Kernel::laplacian`] | the same with p = 1 | σ > 0 | |
//!
//! Parameters outside these ranges are refused: for an exponent above 2, for example, kernel matrices have negative
//! eigenvalues, and everything built on Cholesky factors of them fails sooner or later.
//!
//! # The files
//! [`Kernel`] and its parameters; [`Kernel::matrix`] for blocks of observations, with what is exact about it;
//! [`median_distance`], from which σ is chosen; [`KernelPca`], the eigenvalue problem of the covariance in the kernel's
//! space, exactly or from a subset of support vectors ([`Approximation`]); [`KeptProducts`], for values that are asked for
//! again. Not public are the vectorised exponential and the
//! products that have the same bits on any number of threads.
//!
//! # Symbols
//! `d` values per observation; observations are the *columns* of a `d × n` matrix `X`; `m` support vectors `S`,
//! `d × m`; `k(x)` the kernel values of `x` with all support vectors, `m`; `K` a kernel matrix.
//!
//! # Numerics
//! Kernel values of [`Kernel::matrix`] have the same bits for any [`faer::Par`], alone or in a block. The products of [`KernelPca`]
//! follow the `par` that they are given, and its eigenvalues faer's global setting: its last bits may differ with either. Who
//! compares bits calls [`crate::random::fix_parallelism`] first, and gives one `par`.
//!
//! # Reference
//! Thesis §2.2.1 (kernel trick), §2.2.3 (kernels), §2.2.4 (covariance), §2.2.5 (approximation); Schölkopf & Smola,
//! *Learning with Kernels*, 2002.
//!
//! # Example
//! ```
//! use adagio::kernel::{Kernel, squared_norms};
//! use faer::{Mat, Par};
//!
//! # fn main() -> Result<(), adagio::kernel::KernelError> {
//! // Three observations of two values, one a column.
//! let x = Mat::<f64>::from_fn(2, 3, |i, j| [[0.0, 0.0], [3.0, 4.0], [0.0, 1.0]][j][i]);
//! let norms = squared_norms(x.as_ref());
//! let k = Kernel::gaussian(5.0)?.matrix(x.as_ref(), &norms, x.as_ref(), &norms, Par::Seq)?;
//! assert_eq!(k[(0, 0)], 1.0);
//! // ‖x₁ − x₂‖² = 25, and 2σ² = 50.
//! assert!((k[(0, 1)] - (-0.5f64).exp()).abs() < 1e-15);
//! # Ok(())
//! # }
//! ```

mod covariance;
mod error;
mod exponential;
mod function;
mod kept;
mod matrix;
pub(crate) mod products;
mod width;

pub use covariance::{Approximation, KernelPca, Scaling};
pub use error::KernelError;
pub use function::{Form, Kernel};
pub use kept::{EXACT, KeptProducts};
pub use matrix::{Scalar, squared_norms};
pub(crate) use matrix::{finite_norms, is_usable_norm};
pub use width::median_distance;
