//! `[topics]`: what another program's log calls its things.

use super::keys::{Section, within};

/// `[topics]`: which topic of another program's log is what. Our own logs need none of it.
#[derive(Debug, Clone, PartialEq)]
pub struct Topics {
    /// Camera images.
    pub camera: TopicChoice,
    /// Where the robot is.
    pub pose: TopicChoice,
    /// Where it is by its own counting.
    pub odometry: TopicChoice,
    /// The velocity that was commanded.
    pub command: TopicChoice,
    /// Actions, where they were recorded as such.
    pub action: TopicChoice,
    /// Distances to obstacles.
    pub sonar: TopicChoice,
    /// What somebody marks.
    pub mark: TopicChoice,
    /// Every how many images is used.
    pub every: usize,
    /// Which clock counts.
    pub stamps: Stamps,
    /// A break between images that is longer than this many usual intervals interrupts what is learned.
    pub gap_intervals: f64,
}

/// Which topic has a part.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum TopicChoice {
    /// The only one of a fitting type.
    Auto,
    /// None, even if there is one.
    None,
    /// This one.
    Named(String),
}

/// Which clock says when something was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stamps {
    /// That of the message's header; where there is none, or it is zero, that of the log.
    Header,
    /// When the message was logged.
    Log,
}

impl Topics {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Topics {
            camera: topic(
                s,
                "camera",
                "sensor_msgs Image (rgb8, bgr8, mono8, rgba8, bgra8) or CompressedImage (jpeg, png)",
            ),
            pose: topic(
                s,
                "pose",
                "nav_msgs Odometry, geometry_msgs PoseStamped or PoseWithCovarianceStamped, tf2_msgs TFMessage",
            ),
            odometry: topic(
                s,
                "odometry",
                "nav_msgs Odometry, geometry_msgs PoseStamped or PoseWithCovarianceStamped: the robot's own counting, whose steps maps \
                 of places count on; \"auto\" is another one than the pose's, where there are two",
            ),
            command: topic(
                s,
                "command",
                "geometry_msgs Twist or TwistStamped; where actions are cut from the motion, none is known as blocked without it",
            ),
            action: topic(
                s,
                "action",
                "adagio_msgs Decision, or by name std_msgs integers (0 forward, 1 left, 2 right; or [[action]] in their order) or \
                 String (\"forward\", \"left\", \"right\"; or their names): one message when an action begins; without it actions are \
                 cut from the motion",
            ),
            sonar: topic(s, "sonar", "sensor_msgs LaserScan"),
            mark: topic(s, "mark", "std_msgs String, the name of a task that is shown; \"auto\" is /adagio/mark"),
            every: s.count("every", 1, "images", 1..=1000, "each n-th image is used"),
            stamps: s.choice(
                "stamps",
                &[("header", Stamps::Header), ("log", Stamps::Log)],
                "which clock counts; a header without a stamp counts as logged",
            ),
            gap_intervals: s.number(
                "gap_intervals",
                2.5,
                "usual intervals between images",
                within(1.5, 1e6),
                "over a longer break nothing is learned",
            ),
        }
    }
}

fn topic(s: &mut Section<'_, '_>, key: &str, types: &str) -> TopicChoice {
    let doc = format!("a topic, \"auto\" (the only one of its type) or \"none\": {types}");
    match s.text(key, "auto", &doc).as_str() {
        "auto" => TopicChoice::Auto,
        "none" => TopicChoice::None,
        name => TopicChoice::Named(name.to_owned()),
    }
}
