//! A simulated robot as the source of frames.

use std::sync::Arc;

use nalgebra::Point2;

use super::{Robot, Sensor, World};
use crate::random::stream;
use crate::robot::{Action, Pose};
use crate::scenario::Scenario;
use crate::snapshot::{Snapshot, SnapshotError};
use crate::source::{Boundary, Frame, Source, View};
use crate::vision::Image;

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
    /// The newest picture, where the camera is about to freeze.
    picture: Option<Image>,
}

impl Simulated {
    /// The robot at its start pose.
    pub fn new(scenario: Arc<Scenario>, world: Arc<World>) -> Self {
        let start = Pose::new(Point2::from(scenario.robot.start), scenario.robot.start_heading_deg.to_radians());
        let robot = Robot::new(&scenario.robot, start, stream(scenario.seed, "motion"));
        let sensor = Sensor::new(&scenario, scenario.robot.frame_seconds(), stream(scenario.seed, "camera"));
        Simulated { scenario, world, robot, sensor, number: 0, picture: None }
    }

    fn frame(&mut self, action: Option<Action>, boundary: Option<Boundary>) -> Frame {
        let number = self.number;
        self.number += 1;
        let image = self.picture(number);
        let seconds = number as f64 * self.scenario.robot.frame_seconds();
        Frame {
            number,
            stamp_ns: EPOCH_NS + (seconds * 1e9).round() as u64,
            view: View::Image(image),
            truth: Some(self.robot.pose),
            odometry: self.robot.odometry,
            sonar: self.robot.sonar(&self.world.arena),
            action,
            boundary,
            moved: Vec::new(),
        }
    }

    fn picture(&mut self, number: u64) -> Image {
        let appearance = &self.world.appearance;
        let mut image = appearance.render(&self.robot.pose, number);
        // A camera that is frozen goes on exposing, so that what comes afterwards is what it would have been.
        self.sensor.expose(&mut image, appearance.light(number));
        if appearance.is_frozen(number)
            && let Some(picture) = &self.picture
        {
            image = picture.clone();
        }
        self.picture = appearance.is_frozen(number + 1).then(|| image.clone());
        image
    }
}

impl Source for Simulated {
    fn first(&mut self) -> Option<Frame> {
        Some(self.frame(None, Some(Boundary { blocked: false })))
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        let motion = self.robot.draw(action);
        let frames = self.scenario.robot.frames_per_action;
        let mut blocked = false;
        for index in 1..=frames {
            blocked |= self.robot.drive(motion, &self.world.arena);
            let boundary = (index == frames).then_some(Boundary { blocked });
            let lost = boundary.is_none() && self.world.appearance.is_lost(self.number);
            let frame = self.frame(Some(action), boundary);
            // It was taken, as without the loss, and never arrives.
            if !lost && !give(frame) {
                break;
            }
        }
        true
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("robot", &mut self.robot)?;
        snapshot.inner("sensor", &mut self.sensor)?;
        snapshot.value("number", &mut self.number)?;
        if self.world.appearance.is_frozen(self.number) {
            let mut picture = self.picture.take().unwrap_or_default();
            snapshot.value("width", &mut picture.width)?;
            snapshot.value("height", &mut picture.height)?;
            snapshot.value("cropped", &mut picture.cropped)?;
            snapshot.numbers("picture", &mut picture.rgb)?;
            self.picture = Some(picture);
        }
        Ok(())
    }
}
