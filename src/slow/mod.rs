//! Slow features: functions of the observation that vary as slowly as possible while it streams by.
//!
//! Symbols (DESIGN §2): Newton coordinates `v`, centred covariance `C` of `v`, weighted mean `Ḋ` of `v̇v̇ᵀ` with
//! `v̇ = (v_t − v_{t−1})/Δt`, regulariser `λ`, weights `W` (`m × k`), slowness `Δ = wᵀḊw` (in 1/s² when Δt is in seconds).
//!
//! | you have | use |
//! |---|---|
//! | a signal in memory | [`LinearSfa`]; how its frames follow each other: [`Link`] |
//! | a signal that comes in blocks | [`LinearStream`] |
//! | a signal whose slow source is a nonlinear function of it | [`Pipeline`] (monomials), [`KernelSfa`] (kernels) |
//! | images, or signals with too many values for one expansion | [`Network`], a hierarchy of small pipelines |
//! | a camera stream without end | [`SlowStream`], [`solve()`](solve()), [`SlowModel`] |
//!
//! All of them come down to one problem: [`Moments`] hold the sums, [`solve()`](solve()) turns them into [`SlowFeatures`].
//! [`SlowStream`] takes frames in blocks and grows the dictionary and the moments with them, and [`SlowModel`] is the form of
//! its features for use on new observations.
//!
//! [`theory`] says what the features must look like when the true state is known, [`coherence`] has the other objectives of
//! the same principle, and [`ica`] turns slow features into localised ones (place cells).

pub mod coherence;
mod expansion;
mod hierarchy;
pub mod ica;
mod kernel;
mod linear;
mod links;
mod model;
mod moments;
mod reveal;
mod solve;
mod stream;
pub mod theory;

pub use expansion::{Expansion, Keep, MOST_MONOMIALS, Pca, Pipeline, Stage, Step};
pub use hierarchy::{Layer, Network, Node, Shape, TrainedLayer};
pub use kernel::KernelSfa;
pub use linear::{LinearSfa, LinearStream};
pub use links::Link;
pub use model::SlowModel;
pub use moments::Moments;
pub use solve::{SlowError, SlowFeatures, solve};
pub use stream::{Options as StreamOptions, SlowStream};
