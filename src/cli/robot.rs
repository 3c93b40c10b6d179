//! The robot that a scenario names.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use super::Ending;
#[cfg(not(feature = "ros2"))]
use crate::live::serve::ServedRun;
use crate::scenario::{Body, Scenario};
use crate::source::Source;
use crate::source::live::{Live, Switches};
use crate::world::{DynamicBase, Simulated, World};

#[cfg(feature = "ros2")]
pub use crate::live::ros2::beside;
#[cfg(feature = "ros2")]
pub use crate::ros2::Voice;

/// What a run says to a network that this program was built without.
#[cfg(not(feature = "ros2"))]
pub enum Voice {}

/// Nobody can have such a voice.
#[cfg(not(feature = "ros2"))]
pub fn beside<R>(voice: Voice, _: &ServedRun<'_>, _: impl FnOnce() -> R) -> R {
    match voice {}
}

/// A robot, and what people ask of it.
pub struct Robot {
    /// Its frames.
    pub source: Box<dyn Source + Send>,
    /// What people ask of it.
    pub switches: Switches,
    /// What the run says to its network.
    pub voice: Option<Voice>,
    /// Whether it is one: no trial can be made with it, and it is not where a log says it was.
    pub is_real: bool,
}

/// The robot of a scenario, at its start where it is simulated; `stop` ends the run. Frames of a real one come
/// behind `last`, the number and the stamp of one that is recorded.
pub fn open(
    scenario: &Arc<Scenario>,
    world: &Arc<World>,
    stop: &Arc<AtomicBool>,
    last: Option<(u64, u64)>,
) -> Result<Robot, Ending> {
    let switches = Switches { stop: stop.clone(), ..Switches::default() };
    let (source, voice): (Box<dyn Source + Send>, _) = match (&scenario.motion, &scenario.body) {
        (None, _) if scenario.robot.body == Body::Program => {
            let text = "robot.body = \"program\": another program drives this robot and calls the agent; see adagio.Agent in python/README.md";
            return Err(Ending::Usage(text.into()));
        }
        (None, _) => (Box::new(Simulated::new(scenario.clone(), world.clone())), None),
        (Some(motion), Some(body)) => {
            let base = DynamicBase::new(scenario.clone(), world.clone(), body.clone());
            // Without switches: in simulated time an action is finished as with the disc, and a run that goes on repeats it.
            (Box::new(Live::new(scenario.clone(), motion.clone(), base.equipment(), base, None)), None)
        }
        (Some(_), None) => on_ros2(scenario, &switches, last).map(|(source, voice)| (source, Some(voice)))?,
    };
    Ok(Robot { source, switches, is_real: voice.is_some(), voice })
}

/// A robot's frames, and what the run says to its network.
type Linked = (Box<dyn Source + Send>, Voice);

#[cfg(feature = "ros2")]
fn on_ros2(scenario: &Arc<Scenario>, switches: &Switches, last: Option<(u64, u64)>) -> Result<Linked, Ending> {
    use crate::ros2::{Link, LinkError};
    use crate::source::live::Threaded;

    let motion = scenario.motion.clone().ok_or_else(|| Ending::Usage("robot.body = \"ros2\" has [motion]".into()))?;
    let failed = |error: LinkError| match error {
        LinkError::Network { .. } => Ending::Failed(error.to_string()),
        _ => Ending::Usage(format!("{error}; adagio doctor ros2 SCENARIO says more")),
    };
    let (link, voice) = Link::open(scenario).map_err(failed)?;
    link.warnings.iter().for_each(|warning| eprintln!("warning: {warning}"));
    let equipment = link.equipment();
    let live = Live::new(scenario.clone(), motion, equipment, link, last).with_switches(switches.clone());
    let source = Threaded::start(live).map_err(|error| Ending::Failed(error.to_string()))?;
    Ok((Box::new(source), voice))
}

#[cfg(not(feature = "ros2"))]
fn on_ros2(_: &Arc<Scenario>, _: &Switches, _: Option<(u64, u64)>) -> Result<Linked, Ending> {
    Err(Ending::Usage("robot.body = \"ros2\": this program was built without it; build it with --features ros2".into()))
}
