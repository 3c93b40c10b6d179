//! Small worlds with known answers, to try the algorithms of [`value`](super) on.
//!
//! | world | what it is | source |
//! |---|---|---|
//! | [`chain_walk`] | states in a row, two actions that sometimes fail | Lagoudakis & Parr 2003, §9.1 |
//! | [`koller_parr`] | the chain of four states in which on-policy weights swing for ever | Koller & Parr 2000 |
//! | [`boyan`] | 13 states in a row, 4 features that hold the value exactly | Boyan 1999 |
//! | [`pendulum`] | a pole on a cart, continuous | Lagoudakis & Parr 2003, §9.2 |
//! | [`rooms`] | a map with walls, doors and goals, as text | |
//! | [`sixteen`] | 16 × 16 places around a goal | thesis §3.1.1, figures 3.1 and 3.2 |
//! | [`walk`] | a random walk between walls, or in a circle | theory of slow features, thesis §4.1.2 |
//!
//! [`bases`] has features that go with them.

pub mod bases;
pub mod boyan;
pub mod chain_walk;
pub mod koller_parr;
pub mod pendulum;
pub mod rooms;
pub mod sixteen;
pub mod walk;
