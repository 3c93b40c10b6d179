//! Our ends of a robot's topics, as long as the network carries them.

use std::sync::Arc;
use std::time::Instant;

use ros2_client::Publisher;

use super::graph::{Domain, Graph, LOOK_INTERVAL, LinkError};
use super::listen::Threads;
use super::sensors::{Shared, clock, eye, odometry, switches};
use super::voice::Ends;
use crate::log::Message;
use crate::log::messages as msg;
use crate::robot::Velocity;
use crate::scenario::{CommandType, Scenario};

/// By whom velocities are published, as which type.
pub enum Commands {
    Twist(Publisher<msg::Twist>),
    Stamped(Publisher<msg::TwistStamped>),
}

impl Commands {
    /// Publish a velocity.
    pub fn say(&self, velocity: Velocity, stamp_ns: u64) {
        let twist = msg::Twist {
            linear: msg::Vector3 { x: velocity.linear, y: 0.0, z: 0.0 },
            angular: msg::Vector3 { x: 0.0, y: 0.0, z: velocity.angular },
        };
        // What is not sent now is too old to be sent later; the next one comes soon.
        match self {
            Commands::Twist(publisher) => drop(publisher.publish(twist)),
            Commands::Stamped(publisher) => {
                let header = msg::Header::new(stamp_ns, "base_link");
                drop(publisher.publish(msg::TwistStamped { header, twist }));
            }
        }
    }
}

/// The ends of those who share a network that was joined.
pub struct Join {
    /// The loop of control's.
    pub wire: Wire,
    /// The watchdog's.
    pub of_watchdog: Commands,
    /// The voice's.
    pub ends: Ends,
    /// What is worth a word to people.
    pub warnings: Vec<String>,
}

/// Velocities that go out, and the threads that listen to what comes in.
pub struct Wire {
    /// They listen, and end before anything else of it.
    _threads: Threads,
    /// Velocities.
    pub commands: Commands,
    /// Our node leaves the network last.
    graph: Graph,
}

impl Wire {
    /// Join the network, and find the topics of a scenario there.
    ///
    /// # Errors
    /// See [`LinkError`]: each names the key, the topic, and what is there.
    pub fn join(scenario: &Arc<Scenario>, shared: &Shared, until: Instant) -> Result<Join, LinkError> {
        let settings = scenario.ros2.clone().expect("a scenario with robot.body = \"ros2\" has [ros2]");
        let domain = Domain::join(&settings)?;
        let mut graph = domain.node("")?;
        let camera = settings.topic(&settings.camera);
        let kind = graph.wait_for("camera", &camera, until)?;
        let eye = eye(&mut graph, scenario, &camera, &kind, shared)?;
        let mut ears = vec![odometry(&mut graph, &settings.topic(&settings.odometry), shared, until)?];
        if settings.use_sim_time {
            ears.push(clock(&mut graph, shared, until)?);
        }
        let command = settings.topic(&settings.command);
        let stamped = is_stamped(&graph, settings.command_type, &command, settings.wait_seconds, until)?;
        ears.extend(switches(&mut graph, scenario, shared, stamped, until)?);
        let mut warnings = Vec::new();
        let others = graph.published().into_iter().filter(|end| end.topic == command).count();
        if others > 0 {
            warnings.push(format!("{others} others publish on {command}: whoever speaks last moves the robot"));
        }
        for topic in [&camera, &settings.topic(&settings.odometry)] {
            let publishers = graph.published().into_iter().filter(|end| end.topic == *topic).count();
            if publishers > 1 {
                warnings.push(format!("{publishers} publish {topic}: images or poses of two robots may be mixed"));
            }
        }
        let mut commands = || -> Result<Commands, LinkError> {
            Ok(match stamped {
                true => Commands::Stamped(graph.publish(&command, msg::TwistStamped::TYPE)?),
                false => Commands::Twist(graph.publish(&command, msg::Twist::TYPE)?),
            })
        };
        let (commands, of_watchdog) = (commands()?, commands()?);
        let ends = Ends::open(&domain, scenario, &shared.mind)?;
        let mut threads = Threads::default();
        let listening = threads.listen("images", vec![eye]).and_then(|()| threads.listen("sensors", ears));
        listening.map_err(|cause| domain.failed(&cause))?;
        Ok(Join { wire: Wire { _threads: threads, commands, graph }, of_watchdog, ends, warnings })
    }

    /// The DDS domain.
    pub fn domain(&self) -> u16 {
        self.graph.domain()
    }
}

/// Whether velocities have stamps, by who listens.
fn is_stamped(graph: &Graph, wanted: CommandType, topic: &str, waited: f64, until: Instant) -> Result<bool, LinkError> {
    loop {
        let ends = graph.listened_to();
        let heard_as = |kind: &str| ends.iter().any(|end| end.topic == topic && end.kind == kind);
        let (plain, stamped) = (heard_as(msg::Twist::TYPE), heard_as(msg::TwistStamped::TYPE));
        match (wanted, plain, stamped) {
            (CommandType::Auto, true, true) => return Err(LinkError::BothTypes(topic.to_owned())),
            (CommandType::Twist, ..) | (CommandType::Auto, true, false) => return Ok(false),
            (CommandType::TwistStamped, ..) | (CommandType::Auto, false, true) => return Ok(true),
            (CommandType::Auto, false, false) if Instant::now() >= until => {
                let (topic, domain, seen) = (topic.to_owned(), graph.domain(), super::graph::texts(&ends));
                return Err(LinkError::Deaf { topic, domain, waited, seen });
            }
            _ => std::thread::sleep(LOOK_INTERVAL),
        }
    }
}
