//! What a robot is: the actions that it can do, how they move it and which of them undo which, and where it is.
//!
//! Nothing here knows where frames come from, nor that there is a simulator.

mod actions;
mod clock;
mod controller;
mod pose;
mod safety;
mod velocity;

pub use actions::{Action, ActionSet, ActionSpec, ActionValues, MOST_ACTIONS, Motion};
pub use clock::{RobotClock, Stamps};
pub use controller::{Controller, MotionEnd, MotionSettings, Odometry};
pub use pose::{Pose, wrap};
pub use safety::{Cause, Causes, DriveState, Safety, SafetySettings};
pub use velocity::{Limits, Velocity};
