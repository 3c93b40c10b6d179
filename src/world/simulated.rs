//! A simulated robot as the source of frames.

use std::sync::Arc;

use nalgebra::Point2;
use rand::RngExt;
use rand_distr::StandardNormal;

use super::{Robot, Sensor, World};
use crate::random::stream;
use crate::robot::{Action, Pose};
use crate::scenario::{Scenario, Show, Task, in_goal};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::source::{Boundary, Frame, Mark, MarkKind, Source, View, of_log};
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
    /// Where the robot stood before somebody carried it away to show it a goal.
    carried_from: Option<Pose>,
}

/// How exactly a person puts a robot down, standard deviations: metres, radians.
const BY_HAND: [f64; 2] = [0.02, 0.03];

impl Simulated {
    /// The robot at its start pose.
    pub fn new(scenario: Arc<Scenario>, world: Arc<World>) -> Self {
        let start = Pose::new(Point2::from(scenario.robot.start), scenario.robot.start_heading_deg.to_radians());
        let robot = Robot::new(&scenario.robot, start, stream(scenario.seed, "motion"));
        let sensor = Sensor::new(&scenario, scenario.robot.frame_seconds(), stream(scenario.seed, "camera"));
        Simulated { scenario, world, robot, sensor, number: 0, picture: None, carried_from: None }
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
            truth: self.scenario.robot.pose_known.then_some(self.robot.pose),
            odometry: Some(of_log(self.robot.odometry)),
            sonar: self.robot.sonar(&self.world.arena),
            action,
            boundary,
            moved: Vec::new(),
            marks: Vec::new(),
            goto: None,
            rewards: if action.is_some() && boundary.is_some() { self.pads() } else { Vec::new() },
        }
    }

    /// What pads on the floor publish, by task; nothing without any.
    fn pads(&self) -> Vec<f64> {
        let tasks = &self.scenario.tasks;
        let pad = |task: &Task| match task.topic {
            Some(_) => f64::from(u8::from(in_goal(task, self.robot.pose.position))),
            None => f64::NAN,
        };
        if tasks.iter().any(|task| task.topic.is_some()) { tasks.iter().map(pad).collect() } else { Vec::new() }
    }

    /// The show that takes the place of the next action, and how many actions of it are over.
    fn show(&self) -> Option<(&Show, usize)> {
        let action = (self.number as usize).saturating_sub(1) / self.scenario.robot.frames_per_action;
        let show = self.scenario.shows.iter().find(|show| show.actions().contains(&action))?;
        Some((show, action - show.action))
    }

    /// Somebody carries the robot to a place and turns it round there, and with the last action back: no action of its own.
    fn carry(&mut self, give: &mut dyn FnMut(Frame) -> bool) {
        let Some((show, done)) = self.show() else { return };
        let (show, frames) = (show.clone(), self.scenario.robot.frames_per_action);
        let from = *self.carried_from.get_or_insert(self.robot.pose);
        let task = self.scenario.names().position(|name| name == show.task);
        let mut by_hand = stream(self.scenario.seed, &format!("show at action {}", show.action));
        let mut error = |deviation: f64| deviation * by_hand.sample::<f64, _>(StandardNormal);
        let put_down = Point2::new(show.at[0] + error(BY_HAND[0]), show.at[1] + error(BY_HAND[0]));
        let first = error(std::f64::consts::TAU);
        for index in 0..frames {
            let turned = (done as f64 + index as f64 / frames as f64) / show.headings as f64;
            self.robot.pose = match done == show.headings {
                true => from,
                false => Pose::new(put_down, first + std::f64::consts::TAU * turned + error(BY_HAND[1])),
            };
            let boundary = (index + 1 == frames).then_some(Boundary { blocked: false });
            let mut frame = self.frame(None, boundary);
            if done < show.headings {
                frame.marks.extend(task.map(|task| Mark { task, kind: MarkKind::Here }));
            }
            if !give(frame) {
                break;
            }
        }
        if done == show.headings {
            self.carried_from = None;
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
        if self.show().is_some() {
            self.carry(give);
            return true;
        }
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
        if !self.scenario.shows.is_empty() {
            let bits = |pose: Pose| [pose.position.x, pose.position.y, pose.heading].map(f64::to_bits);
            let mut from = self.carried_from.map(bits);
            snapshot.value("carried_from", &mut from)?;
            let pose = |bits: [u64; 3]| {
                let [x, y, heading] = bits.map(f64::from_bits);
                Pose::new(Point2::new(x, y), heading)
            };
            self.carried_from = from.map(pose);
        }
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
