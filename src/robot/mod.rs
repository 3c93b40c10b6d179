//! What a robot is: the actions that it can do, how they move it and which of them undo which, and where it is.
//!
//! Nothing here knows where frames come from, nor that there is a simulator.

mod actions;
mod pose;
mod velocity;

pub use actions::{Action, ActionSet, ActionSpec, ActionValues, MOST_ACTIONS, Motion};
pub use pose::{Pose, wrap};
pub use velocity::{Limits, Velocity};
