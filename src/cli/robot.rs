//! The robot that a scenario names.

use std::sync::Arc;

use crate::scenario::Scenario;
use crate::source::Source;
use crate::source::live::Live;
use crate::world::{DynamicBase, Simulated, World};

/// The robot of a scenario, at its start where it is simulated.
pub fn open(scenario: &Arc<Scenario>, world: &Arc<World>) -> Box<dyn Source + Send> {
    let (Some(motion), Some(body)) = (&scenario.motion, &scenario.body) else {
        return Box::new(Simulated::new(scenario.clone(), world.clone()));
    };
    let base = DynamicBase::new(scenario.clone(), world.clone(), body.clone());
    Box::new(Live::new(scenario.clone(), motion.clone(), base.equipment(), base, 0))
}
