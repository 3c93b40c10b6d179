//! A wheeled robot that executes its actions with noise, over several frames.

use nalgebra::{Point2, Vector2};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::arena::{Arena, Segment, sweep};
use crate::robot::{Action, ActionSet, Motion, Pose};
use crate::scenario;
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// The motion that was drawn for one frame of an action, before walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameMotion {
    /// Metres straight ahead.
    pub length: f64,
    /// Radians counter-clockwise.
    pub angle: f64,
}

/// One robot: where it is, and where its odometry believes it to be.
#[derive(Debug, Clone)]
pub struct Robot {
    /// The true pose.
    pub pose: Pose,
    /// Pose by odometry, which starts at the true one and drifts.
    pub odometry: Pose,
    settings: scenario::Robot,
    actions: ActionSet,
    noise: ChaCha8Rng,
}

impl Robot {
    /// A robot at a pose; `noise` draws its execution, odometry and sonar errors.
    pub fn new(settings: &scenario::Robot, pose: Pose, noise: ChaCha8Rng) -> Self {
        Robot { pose, odometry: pose, settings: settings.clone(), actions: settings.actions.clone(), noise }
    }

    /// Draw how an action will be executed: the motion of each of its frames.
    pub fn draw(&mut self, action: Action) -> FrameMotion {
        let frames = self.settings.frames_per_action as f64;
        let Motion { distance, angle } = self.actions.motion(action);
        if distance != 0.0 {
            let length = distance * (1.0 + self.settings.forward_noise * self.normal());
            let drift = self.settings.drift_deg.to_radians() * self.normal();
            return FrameMotion { length: length.max(0.0) / frames, angle: drift / frames };
        }
        let executed = angle.abs() * (1.0 + self.settings.turn_noise * self.normal());
        FrameMotion { length: 0.0, angle: angle.signum() * executed.max(0.0) / frames }
    }

    /// Drive for one frame; whether a wall stopped it.
    pub fn drive(&mut self, motion: FrameMotion, arena: &Arena) -> bool {
        let (moved, blocked) = drive(self.pose, motion, arena.walls(), self.settings.radius);
        let length = (moved.position - self.pose.position).norm();
        self.pose = moved;
        let share = self.settings.odometry_noise;
        let (length, angle) = (length * (1.0 + share * self.normal()), motion.angle * (1.0 + share * self.normal()));
        let heading = self.odometry.heading + angle;
        let position = self.odometry.position + Pose::new(Point2::origin(), heading).direction() * length;
        self.odometry = Pose::new(position, heading);
        blocked
    }

    /// Distances that the ring of sonars measures from the robot's centre, metres, the first one straight ahead, counter-clockwise.
    pub fn sonar(&mut self, arena: &Arena) -> Vec<f32> {
        let (count, range) = (self.settings.sonars, self.settings.sonar_range);
        (0..count)
            .map(|i| {
                let angle = self.pose.heading + std::f64::consts::TAU * i as f64 / count as f64;
                let distance = arena.range(self.pose.position, Vector2::new(angle.cos(), angle.sin()), range);
                (distance + self.settings.sonar_noise * self.normal()).clamp(0.0, range) as f32
            })
            .collect()
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.noise)
    }
}

impl Persist for Robot {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        for (name, pose) in [("pose", &mut self.pose), ("odometry", &mut self.odometry)] {
            let mut numbers = vec![pose.position.x, pose.position.y, pose.heading];
            snapshot.numbers(name, &mut numbers)?;
            let [x, y, heading] = numbers[..] else { return snapshot.check(name, false, "not three numbers") };
            // Not by `Pose::new`: the heading is in its range already, and every bit counts.
            *pose = Pose { position: Point2::new(x, y), heading };
        }
        snapshot.random("noise", &mut self.noise)
    }
}

/// Turn, then drive ahead until a wall stops it: the new pose, and whether one did.
pub(crate) fn drive(pose: Pose, motion: FrameMotion, walls: &[Segment], radius: f64) -> (Pose, bool) {
    let turned = Pose::new(pose.position, pose.heading + motion.angle);
    let (free, blocked) = sweep(walls, pose.position, turned.direction() * motion.length, radius);
    (Pose { position: pose.position + free, ..turned }, blocked)
}
