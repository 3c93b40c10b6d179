//! Where the robot is, by what it sees and how it moves: for worlds in which places look alike.
//!
//! One image does not tell two places that look alike from each other; the way to them does. A [`Belief`] is a cloud of poses, each with
//! a probability. An action moves all of them, each a little differently, as robots drive; an image multiplies each by how much more such
//! images were seen there than elsewhere. What was seen where is told by the states of the past, which a [`PlaceMap`] has placed
//! itself: no pose is ever measured.
//!
//! # How a map is found
//! The way is followed from its beginning, with a cloud of poses; what lies a few steps back is where most of them have come from, and
//! belongs to the map from then on. So the map grows behind the robot, and closes when it comes back. Further sweeps bring into line
//! what was placed while the map was small. A way that begins anywhere is looked for on the map.
//!
//! A wrong turn early on bends a map for good, and by chance. So there are several tries, and the one that stays is the one in which
//! what was seen was most expected. Later maps begin with the places of the one before ([`PlaceMap::go_on`]); when much
//! is new they have to beat new tries ([`PlaceMap::new`]).
//!
//! What stays is bent still. So it is straightened: pieces of the way are the nodes of a [`PoseGraph`], tied by their steps and by states
//! that look alike where they lie, and all ways are followed once more on what comes of that.
//!
//! # Doubt
//! A cloud of poses that has settled in the wrong one of two rooms would stay there. So a little of it is always anywhere where such
//! images were seen; and that no goal was found where one should be ([`GoalPlaces`]) makes it grow. Doubt has its price: of rooms that are
//! alike, robots believe now and then in the one whose map fits a little better.
//!
//! # Values
//! Where places are known, so is what actions do there: a [`Planner`] finds values on a lattice of poses, from fewer transitions than
//! [local values](crate::value::local) need. The agent does not use it: its poses are not exact enough yet (docs/tried.md).
//!
//! # Units
//! Positions are in lengths of a move, headings in radians, counter-clockwise. The map is right up to a rotation and a shift,
//! which nothing can tell.
//!
//! # Reference
//! Dellaert, Fox, Burgard & Thrun 1999 (Monte Carlo localization); Thrun, Fox, Burgard & Dellaert 2001 (some particles by what is seen);
//! Montemerlo, Thrun, Koller & Wegbreit 2002 (maps along particles); Lu & Milios 1997 (consistent pose estimation);
//! Littman, Cassandra & Kaelbling 1995 (acting on such a belief: values averaged by it).

mod belief;
mod goals;
mod graph;
mod lattice;
mod looks;
mod map;
mod metric;
mod placing;
mod planning;
mod relaxing;
mod states;
#[cfg(test)]
mod tests;
mod turns;

use std::f64::consts::{PI, TAU};

pub use belief::Belief;
pub use goals::GoalPlaces;
pub use graph::{Factor, GraphError, Optimum, PoseGraph};
pub use metric::{MotionNoise, PlaceMetric};
pub use planning::{PlaceOutcomes, PlaceStep, Planner};
pub use states::PlaceMap;

/// A place and a direction. Units: lengths of a move, radians counter-clockwise.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pose {
    /// Along the first axis.
    pub x: f64,
    /// Along the second axis.
    pub y: f64,
    /// From the first axis to the second.
    pub heading: f64,
}

impl Pose {
    /// A pose within this one's frame, seen from outside of it.
    pub fn then(&self, inner: &Pose) -> Pose {
        let (sin, cos) = self.heading.sin_cos();
        let (x, y) = (self.x + cos * inner.x - sin * inner.y, self.y + sin * inner.x + cos * inner.y);
        Pose { x, y, heading: self.heading + inner.heading }
    }

    /// This pose within another one's frame: what [`then`](Pose::then) leads back from. Its heading is from −π to π.
    pub fn seen_from(&self, from: &Pose) -> Pose {
        let (sin, cos) = from.heading.sin_cos();
        let (x, y) = (self.x - from.x, self.y - from.y);
        let heading = around(self.heading - from.heading + PI) - PI;
        Pose { x: cos * x + sin * y, y: cos * y - sin * x, heading }
    }
}

/// The smaller angle between two headings.
fn turned(a: f64, b: f64) -> f64 {
    let by = around(a - b);
    by.min(TAU - by)
}

/// An angle from 0 to a full turn. Most are already, or a turn away; a remainder is slow, and gives the same.
fn around(angle: f64) -> f64 {
    if (0.0..TAU).contains(&angle) {
        angle
    } else if -TAU < angle && angle < 0.0 {
        angle + TAU
    } else if (TAU..2.0 * TAU).contains(&angle) {
        angle - TAU
    } else {
        angle.rem_euclid(TAU)
    }
}

/// The nearest whole number, and of halves the one that is farther from 0: as `round`, which is a slow call on processors of all kinds.
fn nearest(number: f64) -> i64 {
    let whole = number as i64;
    // What is left is exact; numbers that are out of range have nothing left that counts.
    let rest = number - whole as f64;
    if rest.abs() >= 0.5 { whole.saturating_add(rest.signum() as i64) } else { whole }
}
