//! `[ros2]`: a robot on a ROS 2 network.

use crate::scenario::keys::{Section, within};

/// Which type of message a base takes velocities as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandType {
    /// That of whoever listens.
    Auto,
    /// `geometry_msgs/msg/Twist`
    Twist,
    /// `geometry_msgs/msg/TwistStamped`
    TwistStamped,
}

/// `[ros2]`: a robot on a ROS 2 network. Names without a slash in front are in the namespace.
#[derive(Debug, Clone, PartialEq)]
pub struct Ros2 {
    /// Name of our node.
    pub node: String,
    /// Namespace of the node and of names without a slash in front.
    pub namespace: String,
    /// The DDS domain; `None`: that of `ROS_DOMAIN_ID`, or 0.
    pub domain: Option<u16>,
    /// Whether the robot's time goes as a simulator's `/clock` does.
    pub use_sim_time: bool,
    /// Camera images.
    pub camera: String,
    /// Odometry.
    pub odometry: String,
    /// Scans; empty: none.
    pub scan: String,
    /// A bumper; empty: none.
    pub bumper: String,
    /// An emergency stop; empty: none.
    pub emergency_stop: String,
    /// A lock; empty: none.
    pub lock: String,
    /// Velocities of a person; empty: none.
    pub teleop: String,
    /// The battery; empty: none.
    pub battery: String,
    /// The true pose, where something measures it; empty: none.
    pub pose: String,
    /// Velocities.
    pub command: String,
    /// As which type of message.
    pub command_type: CommandType,
    /// How long to wait for the robot at the start, seconds.
    pub wait_seconds: f64,
}

impl Ros2 {
    /// A topic's whole name.
    pub fn topic(&self, name: &str) -> String {
        match (name.starts_with('/'), self.namespace.trim_matches('/')) {
            (true, _) => name.to_owned(),
            (false, "") => format!("/{name}"),
            (false, namespace) => format!("/{namespace}/{name}"),
        }
    }

    /// Its topics as they stand in the scenario, by key; empty: none.
    pub fn topics(&self) -> [(&'static str, &str); 10] {
        [
            ("camera", &self.camera),
            ("odometry", &self.odometry),
            ("scan", &self.scan),
            ("bumper", &self.bumper),
            ("emergency_stop", &self.emergency_stop),
            ("lock", &self.lock),
            ("teleop", &self.teleop),
            ("battery", &self.battery),
            ("pose", &self.pose),
            ("command", &self.command),
        ]
    }

    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Ros2 {
            node: s.text("node", "adagio", "name of our node"),
            namespace: s.text("namespace", "", "of the node, and of topics without a slash in front"),
            domain: s
                .number_or_auto("domain", "", within(0.0, 232.0), "DDS domain; auto: ROS_DOMAIN_ID, or 0")
                .map(|domain| domain as u16),
            use_sim_time: s.flag(
                "use_sim_time",
                false,
                "whether the robot's time goes as fast as a simulator's /clock; bounds of time are in its time then",
            ),
            camera: s.text("camera", "camera/image_raw", "sensor_msgs Image or CompressedImage"),
            odometry: s.text("odometry", "odom", "nav_msgs Odometry"),
            scan: s.text("scan", "", "sensor_msgs LaserScan; \"\": none"),
            bumper: s.text("bumper", "", "std_msgs Bool; \"\": none"),
            emergency_stop: s.text("emergency_stop", "", "std_msgs Bool, true: pressed; \"\": none"),
            lock: s.text("lock", "", "std_msgs Bool, true: locked; \"\": none"),
            teleop: s.text("teleop", "", "Twist or TwistStamped of a person, who wins; \"\": none"),
            battery: s.text("battery", "", "sensor_msgs BatteryState; \"\": none"),
            pose: s.text(
                "pose",
                "",
                "PoseStamped, PoseWithCovarianceStamped, Odometry or TFMessage: the true pose, for goals by coordinates and plots; \"\": none",
            ),
            command: s.text("command", "cmd_vel", "velocities for the base"),
            command_type: s.choice(
                "command_type",
                &[
                    ("auto", CommandType::Auto),
                    ("twist", CommandType::Twist),
                    ("twist_stamped", CommandType::TwistStamped),
                ],
                "geometry_msgs Twist or TwistStamped; auto: that of whoever listens"),
            wait_seconds: s.number(
                "wait_seconds",
                10.0,
                "s",
                within(0.5, 3600.0),
                "how long to wait for the robot at the start",
            ),
        }
    }
}
