//! What actions are worth: least-squares temporal differences and policy iteration over given features.
//!
//! Symbols (DESIGN §2): features `φ(x)` (`f` of them, the constant one included), `A` actions, `N` transitions
//! `(x, a, r, x′)` as columns of `Φ` and `Φ′` (`f × N`), weights `ω` of the transitions, discount `γ`. Feature matrices of
//! state–action pairs are block-structured: one block of `f` weights per action; the zeros are never built.
//!
//! | question | answer |
//! |---|---|
//! | what are states worth under the policy that was followed? | [`lstd`]; over trajectories [`LstdLambda`] |
//! | what are actions worth under a given policy (LSQ)? | [`Lspi::evaluate`] |
//! | which policy is best? | [`Lspi::fit`] |
//! | what does learning on one's own path do? | [`Sarsa`], a counter-example |
//! | which transitions to keep, and how to weigh them? | [`Window`], [`balance`] |
//! | what is the exact answer? | [`FiniteMdp`] and [`exact`], with [`worlds`] to try things on |
//!
//! ```
//! use adagio::random::stream;
//! use adagio::value::worlds::{bases, chain_walk};
//! use adagio::value::{LspiOptions, exact};
//!
//! // 20 states in a row, reward at both ends; 5000 random steps; a polynomial of degree 4 for each action.
//! let process = chain_walk::twenty()?;
//! let steps = process.uniform_steps(5000, &mut stream(1, "steps"));
//! let basis = bases::powers(20, 4);
//! let fit = process.in_features(&steps, basis.as_ref())?.fit(&LspiOptions::default())?;
//!
//! let learned = fit.policy(basis.as_ref())?.chosen();
//! let optimal = exact::policy_iteration(&process)?.policy.chosen();
//! let different = learned.iter().zip(&optimal).filter(|(a, b)| a != b).count();
//! assert!(different <= 1, "{different} of 20");
//! # Ok::<(), adagio::value::ValueError>(())
//! ```

mod batch;
mod blocks;
mod error;
pub mod exact;
mod finite;
mod lspi;
mod lstd;
mod norm;
mod policy;
mod representation;
mod sarsa;
mod smoothing;
mod soft;
mod traces;
mod window;
pub mod worlds;

pub use batch::Batch;
pub use blocks::{Outcomes, Samples};
pub use error::ValueError;
pub use finite::{FiniteMdp, Step, Successor, basis};
pub use lspi::{Fit, Lspi, Options as LspiOptions, Start, greedy};
pub use lstd::{lstd, solve_or_pseudo_inverse};
pub use norm::closeness_weights;
pub use policy::Policy;
pub use representation::{MOST_FEATURES, RepresentationError, Tabular, Trigonometric};
pub use sarsa::{Sarsa, SarsaOptions};
pub use smoothing::Smoothing;
pub use soft::maximiser_probabilities;
pub use traces::LstdLambda;
pub use window::{Transition, Window, balance};
