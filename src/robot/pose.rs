//! Where a robot is on the floor.

use nalgebra::{Point2, UnitComplex, Vector2};

use crate::value::place;

/// Position and heading on the floor.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
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

    /// A pose within this one's frame, seen from outside of it.
    pub fn then(&self, inner: &Pose) -> Pose {
        let position = self.position + UnitComplex::new(self.heading) * inner.position.coords;
        Pose::new(position, self.heading + inner.heading)
    }

    /// This pose within another one's frame: what [`then`](Pose::then) leads back from.
    pub fn seen_from(&self, from: &Pose) -> Pose {
        let position = UnitComplex::new(-from.heading) * (self.position - from.position);
        Pose::new(position.into(), self.heading - from.heading)
    }

    /// Unit vector of the heading.
    pub fn direction(&self) -> Vector2<f64> {
        UnitComplex::new(self.heading) * Vector2::x()
    }
}

impl From<Pose> for place::Pose {
    fn from(pose: Pose) -> Self {
        place::Pose { x: pose.position.x, y: pose.position.y, heading: pose.heading }
    }
}

impl From<place::Pose> for Pose {
    fn from(pose: place::Pose) -> Self {
        Pose::new([pose.x, pose.y].into(), pose.heading)
    }
}

/// An angle brought into (−π, π].
pub fn wrap(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    let reduced = angle.rem_euclid(turn);
    if reduced > std::f64::consts::PI { reduced - turn } else { reduced }
}
