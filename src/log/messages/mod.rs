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
    Decision, DictionaryGrowth, Evaluation, FrameTaken, GoalMoved, Health, ModelRequest, ModelUpdate, PlaceBelief,
    PolicyUpdate, Prospect, PursuitEnded, RewardGiven, RobotInput, RobotState, RunEnd, Transition,
};
pub use standard::{
    Header, Image, LaserScan, Log, Odometry, Point, Pose, PoseStamped, PoseWithCovariance, Quaternion, Text, Time,
    Twist, TwistStamped, TwistWithCovariance, Vector3,
};

use serde::{Serialize, de::DeserializeOwned};

/// A message type that a log can hold.
pub trait Message: Serialize + DeserializeOwned {
    /// Name of the type, for example `sensor_msgs/msg/Image`.
    const TYPE: &'static str;
    /// The type's definition and those of all types inside it, as a ROS 2 tool expects them: one text, in parts.
    const DEFINITION: &'static [&'static str];
}

/// Declares types of a ROS 2 package, each as a struct and as the definition that follows from its fields. Constants stand in
/// square brackets; what follows `in` are all types inside of a message, in the order of its definition.
macro_rules! messages {
    ($($(#[$doc:meta])* $package:ident / $ros:ident $name:ident
        $([$($(#[$constant_doc:meta])* $constant:ident: $of:tt = $value:literal),+ $(,)?])?
        { $($(#[$field_doc:meta])* $field:ident: $kind:ident $(<$item:ident>)?,)* }
        $(in $($inner:ident)*)?
    ;)+) => {$(
        $(#[$doc])*
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[allow(missing_docs)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $kind $(<$item>)?,)*
        }

        $(#[allow(missing_docs)]
        impl $name {
            $($(#[$constant_doc])* pub const $constant: u8 = $value;)+
        })?

        impl $name {
            /// The definition without those of the types inside.
            #[allow(dead_code)]
            pub(super) const FIELDS: &'static str = concat!(
                $($($of, " ", stringify!($constant), "=", $value, "\n",)+)?
                $(crate::log::messages::ros_type!($kind $($item)?), " ", stringify!($field), "\n",)*
            );

            /// What stands before [`Self::FIELDS`] where this type is inside of another one.
            #[allow(dead_code)]
            pub(super) const HEAD: &'static str = concat!(
                "================================================================================\n",
                "MSG: ", stringify!($package), "/", stringify!($ros), "\n",
            );
        }

        $(impl crate::log::Message for $name {
            const TYPE: &'static str = concat!(stringify!($package), "/msg/", stringify!($ros));
            const DEFINITION: &'static [&'static str] = &[$name::FIELDS, $($inner::HEAD, $inner::FIELDS),*];
        })?
    )+};
}

/// What ROS 2 calls the type of a field.
macro_rules! ros_type {
    (bool) => {
        "bool"
    };
    (i8) => {
        "int8"
    };
    (i16) => {
        "int16"
    };
    (i32) => {
        "int32"
    };
    (i64) => {
        "int64"
    };
    (u8) => {
        "uint8"
    };
    (u16) => {
        "uint16"
    };
    (u32) => {
        "uint32"
    };
    (u64) => {
        "uint64"
    };
    (f32) => {
        "float32"
    };
    (f64) => {
        "float64"
    };
    (String) => {
        "string"
    };
    (Time) => {
        "builtin_interfaces/Time"
    };
    (Header) => {
        "std_msgs/Header"
    };
    (Covariance) => {
        "float64[36]"
    };
    (TransformStamped) => {
        "geometry_msgs/TransformStamped"
    };
    (Vec $item:ident) => {
        concat!(crate::log::messages::ros_type!($item), "[]")
    };
    ($geometry:ident) => {
        concat!("geometry_msgs/", stringify!($geometry))
    };
}

use {messages, ros_type};
