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

mod act;
mod checkpoint;
mod clock;
mod crew;
mod fit;
mod loops;
mod memory;
mod messages;
mod perceive;
mod queue;
mod record;
mod run;
mod schedule;
mod solve;
mod status;

pub use checkpoint::{CHECKPOINT_NAME, CheckpointError, read_checkpoint};
pub use clock::Timing;
pub use memory::{Memory, machine_memory};
pub use run::{CurvePoint, Outcome, RunError, RunOptions, run};
pub use schedule::Course;
pub use status::{Snapshot, Status, peak_resident_bytes, resident_bytes};
