//! Who publishes and who listens, and our own node among them.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use ros2_client::action::{ActionServer, ActionServerQosPolicies};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::ros2::LogLevel;
use ros2_client::ros2::policy::Reliability;
use ros2_client::{
    ActionTypeName, Context, ContextOptions, Message, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher,
    QosProfile, Server, ServiceMapping, ServiceTypeName,
};
use serde::Serialize;
use thiserror::Error;

use super::listen::{Ear, ear};
use crate::log::messages::{self as msg, foreign};
use crate::log::{self, Message as _};
use crate::scenario::Ros2;

/// Why there is no robot.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum LinkError {
    /// The network or a name in it.
    #[error("ROS 2, domain {domain}: {cause}")]
    Network {
        /// The DDS domain.
        domain: u16,
        /// What the middleware says.
        cause: String,
    },
    /// Nobody publishes a topic.
    #[error("ros2.{key} = {topic:?}: nobody publishes it on domain {domain} ({waited:.0} s); there {}", list(seen))]
    Silent {
        /// The scenario's key.
        key: &'static str,
        /// The topic.
        topic: String,
        /// The DDS domain.
        domain: u16,
        /// How long we listened, seconds.
        waited: f64,
        /// What is published, with types.
        seen: Vec<String>,
    },
    /// A topic of another type.
    #[error("ros2.{key} = {topic:?} is published as {found}: it must be {wanted}")]
    Type {
        /// The scenario's key.
        key: &'static str,
        /// The topic.
        topic: String,
        /// Its types.
        found: String,
        /// What it may be.
        wanted: String,
    },
    /// Nobody listens to velocities.
    #[error("ros2.command = {topic:?}: nobody listens to it on domain {domain} ({waited:.0} s); there {}", list(seen))]
    Deaf {
        /// The topic.
        topic: String,
        /// The DDS domain.
        domain: u16,
        /// How long we waited, seconds.
        waited: f64,
        /// What is listened to, with types.
        seen: Vec<String>,
    },
    /// Some listen to one type of velocity, some to the other.
    #[error("ros2.command = {0:?} is listened to as Twist and as TwistStamped: set ros2.command_type to the base's")]
    BothTypes(String),
    /// Images that cannot be used.
    #[error("ros2.camera = {topic:?}: {reason}")]
    Camera {
        /// The topic.
        topic: String,
        /// Why.
        reason: String,
    },
}

fn list(seen: &[String]) -> String {
    if seen.is_empty() { "is nothing".to_owned() } else { format!("is: {}", seen.join(", ")) }
}

/// One end of a topic.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct End {
    /// The topic.
    pub topic: String,
    /// Its type, as in `sensor_msgs/msg/Image`.
    pub kind: String,
    /// Whether messages may be lost; `None` where that was not said.
    pub best_effort: Option<bool>,
}

/// Our membership of a network.
#[derive(Clone)]
pub struct Domain {
    settings: Ros2,
    context: Context,
}

impl Domain {
    /// Join the network of a scenario.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn join(settings: &Ros2) -> Result<Self, LinkError> {
        let from_environment = || std::env::var("ROS_DOMAIN_ID").ok().and_then(|id| id.trim().parse().ok());
        let domain = settings.domain.or_else(from_environment).unwrap_or(0);
        let context = Context::with_options(ContextOptions::new().domain_id(domain));
        let context = context.map_err(|error| LinkError::Network { domain, cause: error.to_string() })?;
        Ok(Domain { settings: settings.clone(), context })
    }

    /// Why something failed that has to do with it.
    pub fn failed(&self, cause: &dyn std::fmt::Display) -> LinkError {
        LinkError::Network { domain: self.context.domain_id(), cause: cause.to_string() }
    }

    /// Put a node of ours on it; its name has an ending.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn node(&self, ending: &str) -> Result<Graph, LinkError> {
        let namespace = self.settings.topic("").trim_end_matches('/').to_owned();
        let namespace = if namespace.is_empty() { "/".to_owned() } else { namespace };
        let name = NodeName::new(&namespace, &format!("{}{ending}", self.settings.node));
        let name = name.map_err(|error| self.failed(&format!("ros2.node or ros2.namespace: {error:?}")))?;
        let options = NodeOptions::new().enable_rosout(true).start_parameter_services(false);
        let node = self.context.new_node(name, options).map_err(|error| self.failed(&error))?;
        Ok(Graph { network: self.clone(), node })
    }
}

/// The network, with a node of ours in it.
pub struct Graph {
    network: Domain,
    node: Node,
}

impl Graph {
    /// A line for those who read the network's diagnostics.
    pub fn say(&self, warns: bool, text: &str) {
        let level = if warns { LogLevel::Warn } else { LogLevel::Info };
        ros2_client::rosout!(self.node, level, "{text}");
    }

    /// The DDS domain.
    pub fn domain(&self) -> u16 {
        self.network.context.domain_id()
    }

    /// Everything that others publish.
    pub fn published(&self) -> Vec<End> {
        let writers = self.network.context.domain_participant().discovered_writers();
        sorted(writers.iter().filter_map(|writer| {
            let data = &writer.publication_topic_data;
            let best_effort = data.reliability.map(|of| matches!(of, Reliability::BestEffort));
            end(&data.topic_name, &data.type_name, best_effort)
        }))
    }

    /// Everything that others listen to.
    pub fn listened_to(&self) -> Vec<End> {
        let readers = self.network.context.domain_participant().discovered_readers();
        sorted(readers.iter().filter_map(|reader| {
            let data = &reader.subscription_topic_data;
            end(data.topic_name(), data.type_name(), None)
        }))
    }

    /// As which of the types of a key a topic is published, if somebody does already.
    ///
    /// # Errors
    /// [`LinkError::Type`]: the network hands on messages whatever their type is, and those of another one would be misread.
    pub fn kind_of(&self, key: &'static str, topic: &str) -> Result<Option<String>, LinkError> {
        let (published, kinds) = (self.published(), kinds(key));
        let mut found = published.iter().filter(|end| end.topic == topic).map(|end| &end.kind);
        match found.clone().find(|kind| !kinds.contains(&kind.as_str())) {
            Some(other) => {
                let (found, wanted) = (other.clone(), kinds.join(" or "));
                Err(LinkError::Type { key, topic: topic.to_owned(), found, wanted })
            }
            None => Ok(found.next().cloned()),
        }
    }

    /// Wait until somebody publishes a topic as one of the types of its key: which.
    ///
    /// # Errors
    /// [`LinkError::Silent`], [`LinkError::Type`].
    pub fn wait_for(&self, key: &'static str, topic: &str, until: Instant) -> Result<String, LinkError> {
        loop {
            if let Some(kind) = self.kind_of(key, topic)? {
                return Ok(kind);
            }
            if Instant::now() >= until {
                let (domain, waited, seen) =
                    (self.domain(), self.network.settings.wait_seconds, texts(&self.published()));
                return Err(LinkError::Silent { key, topic: topic.to_owned(), domain, waited, seen });
            }
            std::thread::sleep(LOOK_INTERVAL);
        }
    }

    /// Listen to a topic: do something with each message; those that cannot be decoded are counted as `broken`.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn hear<M: log::Message + Send + 'static>(
        &mut self,
        topic: &str,
        qos: QosProfile,
        take: impl FnMut(M) + Send + 'static,
        broken: impl FnMut(String) + Send + 'static,
    ) -> Result<Ear, LinkError> {
        let (name, kind) = (self.name_of(topic)?, message_type(M::TYPE));
        let handle = self.node.create_topic(&name, kind, &qos).map_err(|error| self.failed(&error))?;
        let subscription = self.node.create_subscription(&handle, Some(qos)).map_err(|error| self.failed(&error))?;
        Ok(ear(subscription, take, broken))
    }

    /// Serve an action; a topic's namespace and name are its.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn serve<G, R, F>(&mut self, topic: &str, kind: &ActionTypeName) -> Result<ActionServer<G, R, F>, LinkError>
    where
        G: Message + Clone + 'static,
        R: Message + Clone + 'static,
        F: Message + 'static,
    {
        let (name, qos) = (self.name_of(topic)?, service_qos());
        let qos = ActionServerQosPolicies {
            goal_service: qos.clone(),
            result_service: qos.clone(),
            cancel_service: qos.clone(),
            feedback_publisher: qos.clone(),
            status_publisher: qos.durability(Durability::TransientLocal),
        };
        let server = self.node.create_action_server(ServiceMapping::Enhanced, &name, kind, qos);
        server.map_err(|error| self.failed(&error))
    }

    /// Serve a service.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn answer<Q, A>(&mut self, service: &str, kind: &ServiceTypeName) -> Result<Server<Q, A>, LinkError>
    where
        Q: Message + Clone + 'static,
        A: Message + 'static,
    {
        let name = self.name_of(service)?;
        let server = self.node.create_server(ServiceMapping::Enhanced, &name, kind, service_qos(), service_qos());
        server.map_err(|error| self.failed(&error))
    }

    fn name_of(&self, name: &str) -> Result<Name, LinkError> {
        Name::parse(name).map_err(|error| self.failed(&format!("{name:?} is no name: {error:?}")))
    }

    /// Why something failed that has to do with it.
    pub fn failed(&self, cause: &dyn std::fmt::Display) -> LinkError {
        self.network.failed(cause)
    }

    /// Publish on a topic, reliably, the newest message alone.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn publish<M: Serialize>(&mut self, topic: &str, kind: &str) -> Result<Publisher<M>, LinkError> {
        // Nobody waits for a listener that does not answer.
        let qos = QosProfile::publisher_default()
            .reliability_reliable(WhenFull::Fail)
            .history(History::KeepLast { depth: 1 });
        let (name, kind) = (self.name_of(topic)?, message_type(kind));
        let handle = self.node.create_topic(&name, kind, &qos).map_err(|error| self.failed(&error))?;
        self.node.create_publisher(&handle, Some(qos)).map_err(|error| self.failed(&error))
    }
}

/// Types of messages that a topic may have, by its key in the scenario.
pub fn kinds(key: &str) -> &'static [&'static str] {
    match key {
        "camera" => &[msg::Image::TYPE, foreign::CompressedImage::TYPE],
        "odometry" => &[msg::Odometry::TYPE],
        "scan" => &[msg::LaserScan::TYPE],
        "bumper" | "emergency_stop" | "lock" => &[foreign::Bool::TYPE],
        "teleop" => &[msg::Twist::TYPE, msg::TwistStamped::TYPE],
        "battery" => &[foreign::BatteryState::TYPE],
        "pose" => &[
            msg::PoseStamped::TYPE,
            foreign::PoseWithCovarianceStamped::TYPE,
            msg::Odometry::TYPE,
            foreign::TfMessage::TYPE,
        ],
        "reward" => &[foreign::Bool::TYPE, foreign::Float32::TYPE, foreign::Float64::TYPE],
        "use_sim_time" => &[foreign::Clock::TYPE],
        _ => &[],
    }
}

/// How often the network is looked at while something is waited for.
pub const LOOK_INTERVAL: Duration = Duration::from_millis(50);

/// Sensors: what is lost is lost, and the newest five are kept (REP 2003).
pub fn sensor_qos() -> QosProfile {
    QosProfile::subscription_default().reliability_best_effort().history(History::KeepLast { depth: 5 })
}

/// Words and switches, of which none may be lost.
pub fn reliable_qos() -> QosProfile {
    QosProfile::subscription_default().reliability_reliable(WhenFull::DEFAULT).history(History::KeepLast { depth: 10 })
}

/// As ROS's own servers have it: what was asked or told before a client came is not for it.
fn service_qos() -> QosProfile {
    QosProfile::publisher_default().durability(Durability::Volatile).history(History::KeepLast { depth: 10 })
}

/// Topics with their types, for people.
pub fn texts(ends: &[End]) -> Vec<String> {
    let mut kinds: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for end in ends {
        let known = kinds.entry(&end.topic).or_default();
        if !known.contains(&end.kind.as_str()) {
            known.push(&end.kind);
        }
    }
    kinds.into_iter().map(|(topic, kinds)| format!("{topic} ({})", kinds.join(", "))).collect()
}

/// A type of messages, as in `sensor_msgs/msg/Image`.
fn message_type(kind: &str) -> MessageTypeName {
    let (package, of) = kind.split_once("/msg/").expect("the types of messages are ours");
    MessageTypeName::new(package, of)
}

/// From DDS's names: topics are `rt/…`, types `package::msg::dds_::Type_`; everything else is a service's.
fn end(topic: &str, kind: &str, best_effort: Option<bool>) -> Option<End> {
    let topic = topic.strip_prefix("rt")?.to_owned();
    let (package, of) = kind.split_once("::msg::dds_::")?;
    Some(End { topic, kind: format!("{package}/msg/{}", of.trim_end_matches('_')), best_effort })
}

fn sorted(ends: impl Iterator<Item = End>) -> Vec<End> {
    let mut ends: Vec<End> = ends.collect();
    ends.sort();
    ends
}
