//! The actors of a run and the queues between them.
//!
//! ```text
//!  source ──frames──▶ perceive ──percepts──▶ act ──actions──▶ source
//!                        │                    ▲
//!                        └─seen──▶ learn ──moments──▶ solve ──▶ fit ──policies──┤
//!                                                                              └──▶ evaluate (trials beside the run)
//!  all of them ──writes──▶ record (the log)        snapshots of the run ──▶ save
//! ```
//!
//! Each actor is a plain type with a step; threads, clocks and queues stand outside of it, in [`run`]. In lockstep a model
//! that was asked for at frame t takes effect at frame t + L exactly: the actor that acts waits for it there, and until
//! then goes on with the model it has. Nothing else waits for a solver, so results do not depend on the threads' timing.
//!
//! In a [`Fleet`] learn, solve and fit are elsewhere: frames are handed over in batches, and models come back.
//!
//! Between two actions the act actor can send a snapshot of the run the same way: each actor adds its state
//! ([`SnapshotSettings`]), and a run goes on from there as if it had not been interrupted.
//!
//! `actors` has one file for each of them; `runtime` is what they run on, and knows none of them.

mod actors;
mod error;
#[cfg(test)]
mod interleavings;
mod memory;
mod run;
mod runtime;

pub use actors::evaluate::CurvePoint;
pub use actors::fleet::{Batch, Fleet};
pub use actors::messages::Update;
pub use error::{LearnError, RunError};
pub use memory::{Memory, machine_memory};
pub use run::{Outcome, RunOptions, run};
pub(crate) use runtime::checkpoint::read_state_head;
pub use runtime::checkpoint::{
    CHECKPOINT_NAME, CheckpointError, STATE_NAME, SavedState, checkpoint_bytes, read_checkpoint, read_state,
    state_bytes, write_checkpoint, write_state,
};
pub use runtime::clock::Timing;
pub use runtime::controls::{Controls, Marking, TooMany};
pub use runtime::marker::SnapshotSettings;
pub use runtime::status::{Status, StatusValues, peak_resident_bytes, resident_bytes};
pub use runtime::timing::RecordedEvents;

/// The steps of a run, for who learns from many recordings or robots at once.
pub(crate) mod steps {
    pub use super::actors::act::answer;
    pub use super::actors::fit::FitPolicies;
    pub use super::actors::learn::saved::{PlaceWindow, put_window, take_window};
    pub use super::actors::learn::{Learn, SERIES, Sample, Seen, Transitions};
    pub use super::actors::messages::{Marked, SolveRequest};
    pub use super::actors::perceive::Perceive;
    pub use super::actors::saved::{Observations, SavedMark};
    pub use super::actors::solve::Solve;
    #[cfg(test)]
    pub use super::actors::tasks::ActionEnd;
    pub use super::actors::tasks::Tasks;
    pub use super::runtime::threads::parallelism;
    pub use super::runtime::timing::ModelTiming;
}
