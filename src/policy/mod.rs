//! How the robot behaves: exploration, pursuit of a goal, and the reflexes between policy and wheels.

mod behaviour;
mod directed;
mod learned;
mod metric;
mod pilot;
mod pixel_values;
mod prospect;
mod reflex;
mod region;
mod walk;

pub use behaviour::{Behaviour, BehaviourSchedule, Goto, PursuitEnd, Tally};
pub use directed::Directed;
pub use learned::{Learned, MOST_PLACES, State, columns, step_between, step_of};
pub use metric::points;
pub use pilot::Pilot;
pub use pixel_values::{PixelPoints, PixelValues, PolicyError};
pub use prospect::{Prospect, Prospects};
pub use reflex::{Recent, Reflexes};
pub use region::{FloorMap, GoalRegion};
pub use walk::{Walk, clearance_ahead};
