//! The robot that a scenario names.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::Ending;
use crate::scenario::Scenario;
use crate::source::Source;
use crate::source::live::{Live, Switches};
use crate::world::{DynamicBase, Simulated, World};

/// A robot, and what people ask of it.
pub struct Robot {
    /// Its frames.
    pub source: Box<dyn Source + Send>,
    /// What people ask of it.
    pub switches: Switches,
    /// Whether it is one: no trial can be made with it, and it is not where a log says it was.
    pub is_real: bool,
}

/// The robot of a scenario, at its start where it is simulated; `stop` ends the run. Frames of a real one are counted from `next`.
pub fn open(scenario: &Arc<Scenario>, world: &Arc<World>, stop: &Arc<AtomicBool>, next: u64) -> Result<Robot, Ending> {
    let switches = Switches { stop: stop.clone(), ..Switches::default() };
    let (source, is_real): (Box<dyn Source + Send>, bool) = match (&scenario.motion, &scenario.body) {
        (None, _) => (Box::new(Simulated::new(scenario.clone(), world.clone())), false),
        (Some(motion), Some(body)) => {
            let base = DynamicBase::new(scenario.clone(), world.clone(), body.clone());
            // Without switches: in simulated time an action is finished as with the disc, and a run that goes on repeats it.
            (Box::new(Live::new(scenario.clone(), motion.clone(), base.equipment(), base, 0)), false)
        }
        (Some(_), None) => (on_ros2(scenario, &switches, next)?, true),
    };
    Ok(Robot { source, switches, is_real })
}

#[cfg(feature = "ros2")]
fn on_ros2(scenario: &Arc<Scenario>, switches: &Switches, next: u64) -> Result<Box<dyn Source + Send>, Ending> {
    use crate::ros2::{Link, LinkError};
    use crate::source::live::Threaded;

    let motion = scenario.motion.clone().ok_or_else(|| Ending::Usage("robot.body = \"ros2\" has [motion]".into()))?;
    let link = Link::open(scenario).map_err(|error| match error {
        LinkError::Network { .. } => Ending::Failed(error.to_string()),
        _ => Ending::Usage(format!("{error}; adagio doctor ros2 SCENARIO says more")),
    })?;
    link.warnings.iter().for_each(|warning| eprintln!("warning: {warning}"));
    let equipment = link.equipment();
    let live = Live::new(scenario.clone(), motion, equipment, link, next).with_switches(switches.clone());
    Ok(Box::new(Threaded::start(live).map_err(|error| Ending::Failed(error.to_string()))?))
}

#[cfg(not(feature = "ros2"))]
fn on_ros2(_: &Arc<Scenario>, _: &Switches, _: u64) -> Result<Box<dyn Source + Send>, Ending> {
    Err(Ending::Usage("robot.body = \"ros2\": this program was built without it; build it with --features ros2".into()))
}
