//! The simulated world: walls and a wheeled robot among them, sonar, ceiling camera, and what the robot's camera sees.
//!
//! A [`World`] holds what all robots have in common; a [`Robot`] in it is a pose and a noise generator. Any number of robots can
//! drive in the same world without noticing each other, which is how evaluation runs trials beside a live run.

mod appearance;
mod arena;
mod base;
mod batch;
mod body;
mod camera;
mod distractors;
mod dynamic;
mod eye;
mod mover;
mod noise;
mod pyramids;
mod sensor;
mod simulated;
mod texture;
#[cfg(feature = "gpu")]
mod views;
#[cfg(not(feature = "gpu"))]
#[path = "views/absent.rs"]
mod views;

pub use appearance::Appearance;
pub use arena::{Arena, Segment};
pub use base::DynamicBase;
pub(crate) use body::drive;
pub use body::{FrameMotion, Robot};
pub use camera::Camera;
pub use distractors::Present;
pub use dynamic::Dynamic;
pub use eye::Eye;
pub use mover::Mover;
pub use sensor::Sensor;
pub use simulated::Simulated;

use std::sync::{Arc, Mutex};

use crate::lock::lock;
use crate::scenario::{Plan, Scenario};

/// A scenario's world. Places do not change; how they look may, at given frames, and what can be pushed lies where the run's robot
/// has left it.
#[derive(Debug)]
pub struct World {
    /// Floor plan: distances and reachable places.
    pub plan: Arc<Plan>,
    /// Walls for contacts and sonar.
    pub arena: Arena,
    /// What the camera sees of it, frame by frame.
    pub appearance: Appearance,
    /// Where each thing that can be pushed lies, metres.
    movables: Mutex<Vec<[f64; 2]>>,
}

impl World {
    /// The world of a checked scenario.
    ///
    /// # Errors
    /// A texture file that cannot be read any more.
    ///
    /// # Panics
    /// Never for a scenario from [`Scenario::load`], whose checks include the floor plan.
    pub fn new(scenario: &Scenario) -> Result<Self, ::image::ImageError> {
        let plan = Arc::new(Plan::new(scenario).expect("a checked scenario has a floor plan"));
        let movables = Mutex::new(scenario.world.movables.iter().map(|thing| thing.at).collect());
        Ok(World { plan, arena: Arena::new(&scenario.world.walls), appearance: Appearance::new(scenario)?, movables })
    }

    /// Where each thing that can be pushed lies, metres: where trials find it.
    pub fn movables(&self) -> Vec<[f64; 2]> {
        lock(&self.movables).clone()
    }

    /// The things that can be pushed lie here now; places of another number of things are not taken.
    pub fn set_movables(&self, places: Vec<[f64; 2]>) {
        let mut movables = lock(&self.movables);
        if places.len() == movables.len() {
            *movables = places;
        }
    }
}
