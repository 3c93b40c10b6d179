//! The simulated world: walls and a wheeled robot among them, sonar, ceiling camera, and what the robot's camera sees.
//!
//! A [`World`] holds what all robots have in common; a [`Robot`] in it is a pose and a noise generator. Any number of robots can
//! drive in the same world without noticing each other, which is how evaluation runs trials beside a live run.

mod arena;
mod batch;
mod body;
mod camera;
mod distractors;
mod image;
mod looks;
mod noise;
mod pyramids;
mod sensor;
mod texture;
#[cfg(feature = "gpu")]
mod views;
#[cfg(not(feature = "gpu"))]
#[path = "views/absent.rs"]
mod views;

pub use arena::Arena;
pub(crate) use body::drive;
pub use body::{Action, FrameMotion, Robot};
pub use camera::Camera;
pub use image::Image;
pub use looks::Looks;
pub use sensor::Sensor;

use nalgebra::{Point2, UnitComplex, Vector2};

use crate::scenario::{Plan, Scenario, Task};

/// Position and heading on the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Metres.
    pub position: Point2<f64>,
    /// Radians from the x-axis, counter-clockwise, in (−π, π].
    pub heading: f64,
}

impl Pose {
    /// A pose; the heading is brought into (−π, π].
    pub fn new(position: Point2<f64>, heading: f64) -> Self {
        Pose { position, heading: wrap(heading) }
    }

    /// Unit vector of the heading.
    pub fn direction(&self) -> Vector2<f64> {
        UnitComplex::new(self.heading) * Vector2::x()
    }
}

/// An angle brought into (−π, π].
pub fn wrap(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    let reduced = angle.rem_euclid(turn);
    if reduced > std::f64::consts::PI { reduced - turn } else { reduced }
}

/// A scenario's world. Places do not change; how they look may, at given frames.
#[derive(Debug)]
pub struct World {
    /// Floor plan: distances and reachable places.
    pub plan: Plan,
    /// Walls for contacts and sonar.
    pub arena: Arena,
    /// What the camera sees of it, frame by frame.
    pub looks: Looks,
}

impl World {
    /// The world of a checked scenario.
    ///
    /// # Errors
    /// A texture file that cannot be read any more.
    ///
    /// # Panics
    /// Never for a scenario from [`Scenario::load`], whose checks include the floor plan.
    pub fn new(scenario: &Scenario) -> Result<Self, ::image::ImageError> {
        let plan = Plan::new(scenario).expect("a checked scenario has a floor plan");
        Ok(World { plan, arena: Arena::new(&scenario.world.walls), looks: Looks::new(scenario)? })
    }

    /// Reward of a task for an action that ended at a place, as the ceiling camera sees it.
    pub fn reward(&self, task: &Task, position: Point2<f64>) -> f64 {
        if in_goal(task, position) {
            task.reward
        } else if self.plan.clearance(position) < task.wall_distance {
            task.wall_reward
        } else {
            0.0
        }
    }
}

/// Whether a place lies in the goal area of a task.
pub fn in_goal(task: &Task, position: Point2<f64>) -> bool {
    (position - Point2::from(task.goal)).norm() <= task.radius
}
