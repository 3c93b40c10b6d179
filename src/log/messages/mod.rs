//! The messages of a log: Rust types beside the ROS 2 definitions that are stored in the file.
//!
//! A type's fields stand in the order of its definition, since CDR stores them in that order and
//! without names. [`standard`] holds the messages that ROS 2 has, [`own`] those of `adagio_msgs`,
//! [`foreign`] more of ROS 2 that only other programs record.

pub mod foreign;
mod octets;
pub mod own;
pub mod standard;

pub use own::{
    Decision, DictionaryGrowth, Evaluation, FrameTaken, GoalMoved, Health, ModelRequest, ModelUpdate, PolicyUpdate,
    RunEnd, Transition,
};
pub use standard::{
    Header, Image, LaserScan, Log, Odometry, Point, Pose, PoseStamped, PoseWithCovariance, Quaternion, Time, Twist,
    TwistStamped, TwistWithCovariance, Vector3,
};

use serde::{Serialize, de::DeserializeOwned};

/// A message type that a log can hold.
pub trait Message: Serialize + DeserializeOwned {
    /// Name of the type, for example `sensor_msgs/msg/Image`.
    const TYPE: &'static str;
    /// The type's definition and those of all types inside it, as a ROS 2 tool expects them.
    const DEFINITION: &'static str;
}

/// The line before each definition of an inner type: 80 equals signs.
macro_rules! separator {
    () => {
        "================================================================================\n"
    };
}

/// The definitions of `std_msgs/Header` and what it holds, for the end of a definition.
macro_rules! header_definition {
    () => {
        concat!(
            separator!(),
            "MSG: std_msgs/Header\n",
            "builtin_interfaces/Time stamp\n",
            "string frame_id\n",
            time_definition!(),
        )
    };
}

/// The definition of `builtin_interfaces/Time`.
macro_rules! time_definition {
    () => {
        concat!(separator!(), "MSG: builtin_interfaces/Time\n", "int32 sec\n", "uint32 nanosec\n",)
    };
}

use {header_definition, separator, time_definition};
