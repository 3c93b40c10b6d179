//! How the robot behaves: exploration, pursuit of a goal, and the reflexes between policy and wheels.

mod learned;
mod legs;
mod metric;
mod pixel_values;
mod reflex;
mod walk;

pub use learned::{Learned, columns};
pub use legs::{Behaviour, Leg, Tally};
pub use metric::points;
pub use pixel_values::{PixelPoints, PixelValues, PolicyError};
pub use reflex::{Recent, Reflexes};
pub use walk::{Walk, clearance_ahead};
