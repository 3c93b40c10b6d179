//! A simulated robot as the source of frames.

use std::sync::Arc;

use nalgebra::Point2;

use super::{Boundary, Frame, Source, View, boundary};
use crate::parts::{Parts, PartsError};
use crate::random::stream;
use crate::scenario::Scenario;
use crate::world::{Action, Pose, Robot, Sensor, World};

/// Simulated time begins on 2000-01-01 00:00 UTC, so that the log of a seed is the same whenever it is run, and viewers that
/// want plausible dates are content.
pub const EPOCH_NS: u64 = 946_684_800_000_000_000;

/// The robot of a scenario in its world.
pub struct Simulated {
    scenario: Arc<Scenario>,
    world: Arc<World>,
    robot: Robot,
    sensor: Sensor,
    number: u64,
}

impl Simulated {
    /// The robot at its start pose.
    pub fn new(scenario: Arc<Scenario>, world: Arc<World>) -> Self {
        let start = Pose::new(Point2::from(scenario.robot.start), scenario.robot.start_heading_deg.to_radians());
        let robot = Robot::new(&scenario.robot, start, stream(scenario.seed, "motion"));
        let sensor = Sensor::new(&scenario, scenario.robot.frame_seconds(), stream(scenario.seed, "camera"));
        Simulated { scenario, world, robot, sensor, number: 0 }
    }

    fn frame(&mut self, action: Option<Action>, boundary: Option<Boundary>) -> Frame {
        let mut image = self.world.camera.render(&self.robot.pose);
        self.sensor.expose(&mut image);
        let number = self.number;
        self.number += 1;
        let seconds = number as f64 * self.scenario.robot.frame_seconds();
        Frame {
            number,
            stamp_ns: EPOCH_NS + (seconds * 1e9).round() as u64,
            view: View::Image(image),
            pose: self.robot.pose,
            odometry: self.robot.odometry,
            sonar: self.robot.sonar(&self.world.arena),
            action,
            boundary,
        }
    }

    fn boundary(&self, blocked: bool) -> Boundary {
        boundary(&self.world, &self.scenario.tasks, self.robot.pose.position, blocked)
    }
}

impl Source for Simulated {
    fn first(&mut self) -> Option<Frame> {
        let boundary = self.boundary(false);
        Some(self.frame(None, Some(boundary)))
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        let motion = self.robot.draw(action);
        let frames = self.scenario.robot.frames_per_action;
        let mut blocked = false;
        for index in 1..=frames {
            blocked |= self.robot.drive(motion, &self.world.arena);
            let boundary = (index == frames).then(|| self.boundary(blocked));
            if !give(self.frame(Some(action), boundary)) {
                break;
            }
        }
        true
    }

    fn persist(&mut self, parts: &mut Parts) -> Result<(), PartsError> {
        parts.inner("robot", &mut self.robot)?;
        parts.inner("sensor", &mut self.sensor)?;
        parts.value("number", &mut self.number)
    }
}
