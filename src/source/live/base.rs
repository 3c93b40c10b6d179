//! The seam between the agent and a robot that drives by velocities: readings come in, velocities go out.

use std::sync::Arc;
use std::time::Duration;

use crate::robot::{Pose, Velocity};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::source::Mark;
use crate::vision::Image;

/// A robot, or a simulated body: sensors that come as they come, and velocities.
pub trait Base: Send {
    /// Time on a clock that never jumps: the machine's steady clock for a robot, simulated time in a simulation.
    fn now(&self) -> Duration;

    /// Take what comes in until a time, in the order in which it comes. Returns when that time has come.
    fn receive(&mut self, until: Duration, take: &mut dyn FnMut(Received));

    /// Drive like this until the next command.
    fn command(&mut self, velocity: Velocity);

    /// Save or restore where it is, see [`Persist`](crate::snapshot::Persist).
    ///
    /// # Errors
    /// A robot cannot be saved.
    fn persist(&mut self, _snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        Err(SnapshotError::Unable("a robot"))
    }
}

/// One reading, and when it came.
#[derive(Debug, Clone)]
pub struct Received {
    /// When it came in, on [`Base::now`]'s clock.
    pub at: Duration,
    /// When it was sensed, by the robot's clock, nanoseconds since 1970; for messages without a stamp when it came in.
    pub stamp_ns: u64,
    /// What came.
    pub reading: Reading,
}

/// What a robot's sensors, and the people beside it, say.
#[derive(Debug, Clone)]
pub enum Reading {
    /// A camera image.
    Image(Image),
    /// Where the robot is by its odometry, and how fast it goes.
    Odometry {
        /// Its pose.
        pose: Pose,
        /// Its velocity.
        velocity: Velocity,
    },
    /// Distances to obstacles.
    Scan(Arc<Scan>),
    /// Whether a bumper is pressed.
    Bumper(bool),
    /// Whether the emergency stop is pressed.
    EmergencyStop(bool),
    /// Whether the robot is locked: a dead man's switch that is let go.
    Lock(bool),
    /// A person drives.
    Teleop(Velocity),
    /// Charge of the battery, as a share.
    Battery(f64),
    /// Where the robot is by something that measures it from outside.
    Pose(Pose),
    /// A reward from the robot's own software.
    Reward {
        /// Number of the task.
        task: usize,
        /// Its value.
        reward: f64,
    },
    /// Somebody marks what the camera sees.
    Mark(Mark),
}

/// Distances from the robot's centre, counter-clockwise.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Angle of the first one from straight ahead, radians.
    pub first: f64,
    /// Angle between two of them, radians.
    pub step: f64,
    /// Metres; infinite where there is nothing within range, not a number where nothing was measured.
    pub ranges: Vec<f32>,
}
