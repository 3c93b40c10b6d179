//! The seam between the agent and a robot that drives by velocities: readings come in, velocities go out.

use std::sync::Arc;
use std::time::Duration;

use crate::log::messages::LaserScan;
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

    /// Save or restore where it is, see [`Persist`](crate::snapshot::Persist). Whether time goes on where it was, as in a
    /// simulation: a robot is where it is.
    ///
    /// # Errors
    /// Parts that are missing or do not fit.
    fn persist(&mut self, _snapshot: &mut Snapshot) -> Result<bool, SnapshotError> {
        Ok(false)
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
    /// A word about the robot, to be logged: something came that cannot be used, for example.
    Note(String),
}

/// Distances from the robot's centre, counter-clockwise.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Angle of the first one from straight ahead, radians.
    pub first: f64,
    /// Angle between two of them, radians.
    pub step: f64,
    /// Metres; what is no number, or infinite, is no echo.
    pub ranges: Vec<f32>,
}

impl Scan {
    /// The scan of a message; what is outside of its range is no echo.
    pub fn of(message: &LaserScan) -> Self {
        let known = |&range: &f32| {
            let within = range >= message.range_min && range <= message.range_max;
            if within { range } else { f32::INFINITY }
        };
        let ranges = message.ranges.iter().map(known).collect();
        Scan { first: f64::from(message.angle_min), step: f64::from(message.angle_increment), ranges }
    }

    /// The scan as a ring of sonars: each hears the nearest echo of its sector, and nothing where there is no ray.
    pub fn ring(&self, sonars: usize, reach: f32) -> Vec<f32> {
        let mut ring = vec![reach; sonars];
        let sector = std::f64::consts::TAU / sonars as f64;
        for (angle, range) in self.echoes() {
            let index = (angle.rem_euclid(std::f64::consts::TAU) / sector).round() as usize % sonars;
            ring[index] = ring[index].min(range);
        }
        ring
    }

    /// How far a disc with the robot's radius goes in a direction before it meets an echo, metres; infinite where there is none.
    pub fn clearance(&self, direction: f64, radius: f64) -> f64 {
        let way = |(angle, range): (f64, f32)| {
            let (aside, along) = (angle - direction).sin_cos();
            let (aside, along) = (f64::from(range) * aside, f64::from(range) * along);
            let touches = along > 0.0 && aside.abs() < radius;
            touches.then(|| along - (radius * radius - aside * aside).sqrt())
        };
        self.echoes().filter_map(way).fold(f64::INFINITY, f64::min)
    }

    /// Angle and distance of each echo.
    fn echoes(&self) -> impl Iterator<Item = (f64, f32)> {
        let angle = |i: usize| self.first + i as f64 * self.step;
        let echoes = self.ranges.iter().enumerate().filter(|(_, range)| range.is_finite());
        echoes.map(move |(i, &range)| (angle(i), range)).filter(|(angle, _)| angle.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_disc_goes_as_far_as_echoes_let_it() {
        let quarter = std::f64::consts::FRAC_PI_2;
        let (none, unknown) = (f32::INFINITY, f32::NAN);
        let scan = |ranges: Vec<f32>| Scan { first: -quarter, step: quarter, ranges };
        let near = scan(vec![0.3, 1.0, none]);
        assert!((near.clearance(0.0, 0.25) - 0.75).abs() < 1e-6, "{}", near.clearance(0.0, 0.25));
        assert!((near.clearance(-quarter, 0.25) - 0.05).abs() < 1e-6);
        assert_eq!(near.clearance(2.0 * quarter, 0.25), f64::INFINITY);
        assert_eq!(scan(vec![none, unknown, unknown]).clearance(0.0, 0.25), f64::INFINITY);
        // Something that the disc's rim will meet beside its centre.
        let aside = Scan { first: (0.2_f64).atan2(0.5), step: 1.0, ranges: vec![0.5_f64.hypot(0.2) as f32] };
        assert!((aside.clearance(0.0, 0.25) - 0.35).abs() < 1e-6);
        assert_eq!(aside.clearance(0.0, 0.19), f64::INFINITY);
        assert_eq!(near.ring(4, 5.0), [1.0, 5.0, 5.0, 0.3]);
    }
}
