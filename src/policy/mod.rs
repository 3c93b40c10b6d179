//! How the robot behaves: exploration, pursuit of a goal, and the reflexes between policy and wheels.
//!
//! Beside the learned policy there are two measuring rods that know the true pose: the thesis's reference policy, and
//! the optimal number of steps.

mod learned;
mod legs;
mod metric;
mod optimal;
mod pixel_values;
mod reference;
mod reflex;
mod walk;

pub use learned::{Learned, columns};
pub use legs::{Behaviour, Leg, Tally};
pub use metric::points;
pub use optimal::optimal_steps;
pub use pixel_values::{PixelPoints, PixelValues, PolicyError};
pub use reference::reference_action;
pub use reflex::{Recent, Reflexes};
pub use walk::{Walk, clearance_ahead};
