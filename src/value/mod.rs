//! What actions are worth: from the transitions nearby, or linear in given features by least-squares temporal differences and
//! policy iteration.
//!
//! # The problem
//! An agent in state `x` takes action `a`, receives reward `r` and finds itself in `x′`. A policy `π(a | x)` is worth the
//! discounted sum of the rewards that follow: the value `V(x) = E[r + γV(x′)]` of a state, and the Q-value
//! `Q(x, a) = E[r + γΣ_b π(b | x′) Q(x′, b)]` of an action. Acting on the largest Q-value makes a policy better;
//! doing so again and again is policy iteration. Here values are linear in features, `V(x) = wᵀφ(x)` and
//! `Q(x, a) = w_aᵀφ(x)`, and are found from transitions by solving linear equations.
//!
//! # Symbols
//! Features `φ(x)` (`f` of them, the constant one included), `S` states where they can be counted, `A` actions, `N` transitions
//! `(x, a, r, x′)` as columns of `Φ` and `Φ′` (`f × N`), weights `ω` of the transitions, discount `γ`. Where an episode
//! ends, the column of `Φ′` is zero. Feature matrices of state–action pairs are block-structured: one block of `f`
//! weights per action; the zeros are never built.
//!
//! # Which tool for what
//! | question | answer |
//! |---|---|
//! | how to describe a state by numbers? | [`Tabular`], [`Trigonometric`], [`worlds::bases`], or slow features ([`crate::slow`]) |
//! | how to collect transitions? | [`Batch`], or [`LocalBatch`] for local values, one by one; [`Samples`] and [`Outcomes`] for matrices that exist already |
//! | what are states worth under the policy that was followed? | [`lstd`]; over trajectories [`LstdLambda`] |
//! | what are actions worth under a given policy (LSQ)? | [`Lspi::evaluate`] |
//! | which policy is best, where values are linear in the features? | [`Lspi::fit`], or [`Batch::fit`] |
//! | which policy is best, where features only say what is near? | [`LocalBatch::fit`], see [`local`]; [`Local::fit`] over [`Instances`] for matrices and several tasks |
//! | does the policy arrive? | [`FiniteMdp::arrival`], [`Local::arrival`]: [`Fit::converged`] does not say it |
//! | where do states lie on the floor? | [`MetricMap`], from features and what actions do |
//! | where is the robot, where places look alike? | [`place::PlaceMap`] and [`place::Belief`], from features, what actions do, and the way |
//! | what if it does not settle? | [`LspiOptions::mixing`], with a table of what helps at [`Lspi::fit`]; weights by [`balance`] |
//! | what does learning on one's own path do? | [`Sarsa`], a counter-example |
//! | what can be learned with no memory of the past at all? | [`StreamQ`], to compare with |
//! | where to explore? | [`rare_places`]: states where few others lie, in any coordinates |
//! | which transitions to keep, and how to weigh them? | [`Window`], [`balance`] |
//! | what is the exact answer? | [`FiniteMdp`] and [`exact`], with [`worlds`] to try things on |
//! | what of the thesis's outlook? | soft actions ([`maximiser_probabilities`]), the policy-dependent norm ([`closeness_weights`]), [`Smoothing`] |
//!
//! A [`Policy`] here is a table over numbered states; a [`Fit`] of linear values is greedy wherever there are features, one of
//! local values wherever [`Instances`] are.
//!
//! # Numerics
//! All in `f64`, but for the points of local values ([`local`]). Products of [`Lspi`] have the same bits for any [`faer::Par`],
//! and local values, [`rare_places`], soft actions ([`maximiser_probabilities`]) and everything that is told sample by sample ([`Sarsa`], [`StreamQ`],
//! [`LstdLambda`], [`Smoothing`]) for any number of threads. LU and singular values, with which [`lstd`], [`LstdLambda`], [`Lspi`] and
//! [`solve_or_pseudo_inverse`] solve their equations, the products of [`lstd`], [`Fit::action_values`] and [`exact`], and the
//! eigenvalues for soft actions follow faer's global setting, and may differ in their last bits with it: who compares bits calls
//! [`crate::random::fix_parallelism`] first.
//!
//! # Reference
//! Thesis chapter 3; Bradtke & Barto 1996 (LSTD); Boyan 1999 (LSTD(λ)); Lagoudakis & Parr 2003 (LSPI);
//! Ormoneit & Sen 2002 (kernel-based reinforcement learning).
//!
//! # Example
//! ```
//! use adagio::random::stream;
//! use adagio::value::worlds::{bases, chain_walk};
//! use adagio::value::{LspiOptions, exact};
//!
//! // 20 states in a row, reward at both ends; 5000 random steps; a polynomial of degree 4 for each action.
//! let process = chain_walk::twenty()?;
//! let steps = process.uniform_steps(5000, &mut stream(1, "steps"));
//! let basis = bases::powers(20, 4)?;
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
mod cross;
mod error;
pub mod exact;
mod finite;
pub mod local;
mod local_batch;
mod lspi;
mod lstd;
mod metric_map;
mod nearest;
mod norm;
pub mod place;
mod policy;
mod rare;
mod representation;
mod sarsa;
mod smoothing;
mod soft;
mod stream_q;
mod traces;
mod window;
pub mod worlds;

pub use batch::Batch;
pub use blocks::{Outcomes, Samples};
pub use error::ValueError;
pub use finite::{FiniteMdp, Step, Successor};
#[doc(inline)]
pub use local::{Instances, Local, LocalOptions, LocalOutcomes};
pub use local_batch::{LocalBatch, LocalValues};
pub use lspi::{Fit, Lspi, Options as LspiOptions, Start};
pub use lstd::{lstd, solve_or_pseudo_inverse};
pub use metric_map::{MetricMap, Step as MapStep};
pub use norm::closeness_weights;
pub use policy::{Policy, greedy};
pub use rare::rare_places;
pub use representation::{MOST_FEATURES, RepresentationError, Tabular, Trigonometric};
pub use sarsa::{Sarsa, SarsaOptions};
pub use smoothing::Smoothing;
pub use soft::maximiser_probabilities;
pub use stream_q::{StreamQ, StreamQOptions};
pub use traces::LstdLambda;
pub use window::{InWindow, Transition, Window, balance};
