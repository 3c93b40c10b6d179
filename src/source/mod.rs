//! Where frames come from.

mod simulated;

pub use simulated::Simulated;

use crate::world::{Action, Image, Pose};

/// One camera frame with what else was sensed at that moment.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Number of the frame, from 0, without gaps unless the source drops frames.
    pub number: u64,
    /// Time, nanoseconds since 1970.
    pub stamp_ns: u64,
    /// Camera image.
    pub image: Image,
    /// True pose as the ceiling camera sees it: for rewards, evaluation and plots, never for features.
    pub pose: Pose,
    /// Pose by odometry.
    pub odometry: Pose,
    /// Distances of the ring of sonars from the robot's centre, metres, the first straight ahead, counter-clockwise.
    pub sonar: Vec<f64>,
    /// The action during which this frame was taken; `None` for the first frame.
    pub action: Option<Action>,
    /// Set on the last frame of an action, and on the first frame of all.
    pub boundary: Option<Boundary>,
}

/// What an action came to.
#[derive(Debug, Clone, PartialEq)]
pub struct Boundary {
    /// Whether a wall stopped the robot.
    pub blocked: bool,
    /// Reward of each task.
    pub rewards: Vec<f64>,
    /// Whether the robot is in each task's goal area.
    pub in_goal: Vec<bool>,
}

/// A robot, simulated or real, that executes actions and gives frames.
pub trait Source {
    /// The frame before the first action.
    fn first(&mut self) -> Frame;

    /// Execute an action and give its frames in order; the last one is a boundary. Stops early if `give` says so.
    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool);
}
