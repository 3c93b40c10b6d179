//! Which observations to keep as support vectors.
//!
//! Symbols (DESIGN §2): support vectors `s₁ … s_m` in the order in which they were accepted, kernel matrix `K = LLᵀ`
//! (Cholesky), kernel row `k(x)`, **Newton coordinates** `v(x) = L⁻¹k(x)`, residual `ε(x) = k(x, x) − ‖v(x)‖²`.

mod ald;

pub use ald::{Block, Dictionary, DictionaryError, Parameters};
