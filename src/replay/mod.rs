//! A recorded run once more, through the same actors.
//!
//! [`Recording`] reads what a run's log says beside its frames: its scenario, when models were asked for and when they came
//! into effect, and every message that follows from these. [`crate::source::Recorded`] gives the frames. With both,
//! [`crate::agent::run`] repeats the run bit for bit, and [`crate::log::Expected`] finds where it does not; with another
//! scenario it is an analysis of the same frames.

mod compare;
mod recording;
mod show;

pub use compare::{Comparison, Observations, compare};
pub use recording::{Recording, RecordingError};
pub use show::{ShownDifference, show};
