//! How near states are by what is seen and by where it is, and how inexactly robots move.

use std::f64::consts::FRAC_PI_3;
use std::ops::Range;

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::Pose;
use crate::value::error::parameter;
use crate::value::{MapStep, ValueError};

/// Lengths of a move that are as far as a width of likeness. With 6, transitions of other rooms that are alike count as much as those of
/// the robot's own, and it stays in the wrong one.
const LOOK: f64 = 1.5;
/// Lengths of a move that are as far as a turn by one radian.
const TURN: f64 = 2.0;
/// Coordinates of a pose in a point.
pub(super) const OF_POSE: usize = 4;
/// Share of a move that one which slides along a wall makes, and that one which a wall has stopped makes.
const SLID: Range<f64> = 0.2..1.2;
const STOPPED: Range<f64> = 0.0..1.0;
/// Share of the moves that a wall has stopped at once: the robot stood before it already.
const STANDS: f64 = 0.5;

/// No robot counts better than by this share of what it does.
const LEAST_SHARE: f64 = 0.01;
/// Where it goes straight on, its heading is wrong by so many radians for a whole of that.
const BENDS: f64 = 0.25;

/// How inexactly actions are executed, or is known what they did.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionNoise {
    /// Standard deviation of the length of a move, as a share of it, 0 to 1.
    pub length: f64,
    /// Standard deviation of the heading behind a step, radians, 0 to 1.
    pub heading: f64,
    /// The same of what a step turns it by, as a share of that, 0 to 1.
    pub turning: f64,
    /// Probability that a move slides along a wall, 0 to 1: it goes any part of its way, up to 60° aside. One that a wall has stopped
    /// may then have slid as well.
    pub slides: f64,
}

impl MotionNoise {
    /// A robot whose actions are closed-loop motions.
    pub const ROBOT: MotionNoise = MotionNoise { length: 0.06, heading: 0.025, turning: 0.0, slides: 0.0 };
    /// A robot that counts what it does, wrong by such a share of it; by one in a hundred at least, however exact it is said to be.
    pub fn measured(share: f64) -> MotionNoise {
        let share = share.clamp(LEAST_SHARE, 1.0);
        MotionNoise { length: share, heading: BENDS * share, turning: share, slides: 0.0 }
    }

    /// A player in a game: it turns exactly and slides along walls.
    pub const PLAYER: MotionNoise = MotionNoise { length: 0.12, heading: 0.0, turning: 0.0, slides: 0.4 };

    pub(super) fn check(self) -> Result<(), ValueError> {
        let MotionNoise { length, heading, turning, slides } = self;
        for (name, value) in [("length", length), ("heading", heading), ("turning", turning), ("slides", slides)] {
            parameter(name, value, (0.0..=1.0).contains(&value), "0 to 1")?;
        }
        Ok(())
    }

    /// Standard deviation of the heading behind a step, radians.
    pub(super) fn turned(self, step: MapStep) -> f64 {
        self.heading.hypot(self.turning * step.turn)
    }

    /// Where a step leads in the mean, from where it began, and the standard deviation of a move, in moves; `unit`: length of a move.
    pub(super) fn expected(self, step: MapStep, unit: f64) -> (Pose, f64) {
        // Mean and standard deviation of a share that is even in a range.
        let even = |of: Range<f64>| (0.5 * (of.start + of.end), (of.end - of.start) / 12f64.sqrt());
        let (stopped, slid) = (even(STOPPED), even(SLID));
        let mixed = |(share, (mean, deviation)): (f64, (f64, f64)), other: (f64, f64)| {
            let both = share * mean + (1.0 - share) * other.0;
            let square =
                share * (mean * mean + deviation * deviation) + (1.0 - share) * (other.0 * other.0 + other.1 * other.1);
            (both, (square - both * both).max(0.0).sqrt())
        };
        let (share, deviation) = match step.distance {
            Some(0.0) => (0.0, 0.0),
            Some(_) => mixed((self.slides, slid), (1.0, self.length)),
            None => mixed((STANDS, (0.0, 0.0)), stopped),
        };
        let way = share * step.distance.map_or(1.0, |distance| distance / unit);
        (Pose { x: way * step.turn.cos(), y: way * step.turn.sin(), heading: step.turn }, deviation)
    }

    /// Where a step may have led; `unit`: length of a move.
    pub(super) fn after(self, pose: Pose, step: MapStep, unit: f64, rng: &mut impl Rng) -> Pose {
        let [heading_off, longer] = [(); 2].map(|()| -> f64 { StandardNormal.sample(rng) });
        let heading = pose.heading + step.turn + self.turned(step) * heading_off;
        let (share, aside) = match step.distance {
            Some(0.0) => (0.0, 0.0),
            Some(_) if rng.random_range(0.0..1.0) < self.slides => {
                (rng.random_range(SLID), rng.random_range(-FRAC_PI_3..FRAC_PI_3))
            }
            Some(_) => (1.0 + self.length * longer, 0.0),
            None if rng.random_range(0.0..1.0) < STANDS => (0.0, 0.0),
            None if self.slides > 0.0 => (0.5 * rng.random_range(STOPPED), rng.random_range(-FRAC_PI_3..FRAC_PI_3)),
            None => (rng.random_range(STOPPED), 0.0),
        };
        let way = share * step.distance.map_or(1.0, |distance| distance / unit);
        let (sin, cos) = (heading + aside).sin_cos();
        Pose { x: pose.x + way * cos, y: pose.y + way * sin, heading }
    }
}

/// How near states are by what is seen and by where it is, and how the robot moves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlaceMetric {
    /// How inexactly.
    pub noise: MotionNoise,
    /// Length of a move, in the unit of the steps.
    pub unit: f64,
    /// Two states that are so far from each other look alike by e^(−½).
    pub width: f64,
}

impl PlaceMetric {
    /// Coordinates of features in points of so many.
    pub fn features(coordinates: usize) -> usize {
        coordinates.saturating_sub(OF_POSE)
    }

    /// A point, `p + 4` coordinates, for what is seen, `p`, at a pose: the nearer two of them, the nearer are the states in both.
    pub fn point(self, seen: &[f32], pose: Pose) -> Vec<f32> {
        let look = seen.iter().map(|&x| (LOOK * f64::from(x) / self.width) as f32);
        let (sin, cos) = pose.heading.sin_cos();
        look.chain([pose.x, pose.y, TURN * cos, TURN * sin].map(|x| x as f32)).collect()
    }

    /// Coordinate of a feature, of one in a point.
    pub(super) fn seen(self, coordinate: f32) -> f32 {
        (f64::from(coordinate) * self.width / LOOK) as f32
    }

    /// Everything of it, bit by bit.
    pub fn to_bits(self) -> [u64; 6] {
        let MotionNoise { length, heading, turning, slides } = self.noise;
        [length, heading, turning, slides, self.unit, self.width].map(f64::to_bits)
    }

    /// What these were the bits of; a map checks it.
    pub fn from_bits(bits: [u64; 6]) -> Self {
        let [length, heading, turning, slides, unit, width] = bits.map(f64::from_bits);
        PlaceMetric { noise: MotionNoise { length, heading, turning, slides }, unit, width }
    }
}
