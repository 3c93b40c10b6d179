//! The actors of a run and the queues between them.
//!
//! ```text
//!  source ──frames──▶ perceive ──percepts──▶ act ──actions──▶ source
//!                        │                    ▲
//!                        └─moments──▶ solve ──▶ fit ──policies──┤
//!                                                              └──▶ assess (trials beside the run)
//!  all of them ──writes──▶ record (the log)
//! ```
//!
//! Each actor is a plain type with a step; threads, clocks and queues stand outside of it, in [`run`]. In lockstep a model
//! that was asked for at frame t takes effect at frame t + L exactly: the actor that acts waits for it there, and until
//! then goes on with the model it has. Nothing else waits for a solver, so results do not depend on the threads' timing.
//!
//! Between two actions the actor that acts can send the state of the run the same way: each actor adds its own ([`Keep`]), and
//! a run goes on from there as if it had not been interrupted.

mod act;
mod checkpoint;
mod clock;
mod controls;
mod crew;
mod decide;
mod fit;
mod forecast;
mod goals;
mod keep;
mod loops;
mod memory;
mod messages;
mod perceive;
mod queue;
mod record;
mod rows;
mod run;
mod schedule;
#[cfg(test)]
mod schedules;
mod solve;
mod status;
mod turns;

pub use checkpoint::{CHECKPOINT_NAME, CheckpointError, KeptState, STATE_NAME, read_checkpoint, read_state};
pub use clock::Timing;
pub use controls::{Controls, TooMany};
pub use decide::Keep;
pub use forecast::LogForecast;
pub use memory::{Memory, machine_memory};
pub use run::{CurvePoint, Outcome, RunError, RunOptions, run};
pub use schedule::Course;
pub use status::{Snapshot, Status, peak_resident_bytes, resident_bytes};
