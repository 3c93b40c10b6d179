//! Slow features: functions of the observation that vary as slowly as possible while it streams by.
//!
//! Symbols (DESIGN §2): Newton coordinates `v`, centred covariance `C` of `v`, weighted mean `Ḋ` of `v̇v̇ᵀ` with
//! `v̇ = (v_t − v_{t−1})/Δt`, regulariser `λ`, weights `W` (`m × k`), slowness `Δ = wᵀḊw` (in 1/s² when Δt is in seconds).
//!
//! [`SlowStream`] takes frames in blocks and grows the dictionary and the [`Moments`] with them; [`solve`] turns the moments
//! into [`SlowFeatures`], and [`SlowModel`] is their form for use on new observations.

mod model;
mod moments;
mod solve;
mod stream;

pub use model::SlowModel;
pub use moments::{Link, Moments};
pub use solve::{SlowError, SlowFeatures, solve};
pub use stream::{Options as StreamOptions, SlowStream};
