//! What actions are worth: least-squares temporal differences and policy iteration over given features.
//!
//! Symbols (DESIGN §2): features `φ(x)` (`f` of them, the constant one included), `A` actions, `N` transitions
//! `(x, a, r, x′)` as columns of `Φ` and `Φ′` (`f × N`), weights `ω` of the transitions, discount `γ`. Feature matrices of
//! state–action pairs are block-structured: one block of `f` weights per action; the zeros are never built.

mod lspi;
mod lstd;
mod window;

pub use lspi::{Fit, Lspi, Options as LspiOptions, Outcomes, Samples, greedy};
pub use lstd::{lstd, solve_or_pseudo_inverse};
pub use window::{Transition, Window, balance};

use thiserror::Error;

/// Why values could not be estimated.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ValueError {
    /// Lists of different lengths.
    #[error("{what} has {found} entries, but there are {expected} transitions")]
    Length {
        /// Which list.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The number of transitions.
        expected: usize,
    },
    /// Nothing to learn from.
    #[error("there are no transitions to learn from")]
    Empty,
    /// An action number out of range.
    #[error("transition {index} has action {action}, but there are {actions} actions (0 to {})", actions - 1)]
    Action {
        /// Which transition.
        index: usize,
        /// Its action.
        action: usize,
        /// Number of actions.
        actions: usize,
    },
    /// A sample after which no action may follow.
    #[error("no action may follow sample {index}: at least one of {actions} must be allowed")]
    NothingAllowed {
        /// Which sample.
        index: usize,
        /// Number of actions.
        actions: usize,
    },
    /// The discount factor must leave the sum of rewards finite.
    #[error("gamma = {0} is not allowed: it must be in [0, 1)")]
    Gamma(f64),
    /// The ridge must not be negative.
    #[error("ridge = {0} is not allowed: it must be ≥ 0 and finite")]
    Ridge(f64),
    /// The mixing rate of policies.
    #[error("mixing = {0} is not allowed: it must be in (0, 1]")]
    Mixing(f64),
    /// The result is not finite.
    #[error("the values of {0} weights are not finite: features or rewards hold values that are not numbers")]
    NotFinite(usize),
}
