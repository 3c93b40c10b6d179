//! Where the robot is, by what it sees and how it moves: for worlds in which places look alike.
//!
//! One image does not tell two places that look alike from each other; the way to them does. A [`Belief`] is a probability of every
//! pose on a grid. An action shifts it, blurred by what is not known of the motion; an image multiplies it by how much more
//! such images were seen at a pose than elsewhere. What was seen where is told by the states of the past, which a [`PlaceMap`] has
//! placed itself: no pose is ever measured.
//!
//! # How a map is found
//! The longest way is laid out by its motions, or its first piece. Each other piece is then looked for on the map of all the others: the
//! belief is carried along it forward and backward, and where it has settled, the piece is placed. The same again, some times over, brings
//! pieces into line that were placed while the map was small. What nothing on the map looks like stays without a place. A map goes on
//! from the places that another had found: then once is enough.
//!
//! Two rooms that are quite alike may be taken for one, above all where ways begin in either: with a single way in three of twelve
//! worlds of the tests, and in the one run with eight rooms behind the equal doors of a corridor.
//!
//! # Units
//! Positions are in lengths of a move, headings in radians, counter-clockwise. The map is right up to a rotation and a shift,
//! which nothing can tell. Its grid is a torus: a world must be smaller than `size` moves across.
//!
//! # Reference
//! Fox, Burgard & Thrun 1999 (Markov localization); Thrun, Burgard & Fox 1998 (maps by expectation maximization); Littman, Cassandra
//! & Kaelbling 1995 (acting on such a belief: values averaged by it).

mod belief;
mod grid;
mod map;

pub use belief::Belief;
pub use grid::Pose;
pub use map::{PlaceMap, PlaceMetric, PlaceOptions};
