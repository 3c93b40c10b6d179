//! Messages that only other programs' logs hold.

use serde::{Deserialize, Serialize};

use super::standard::{Header, Pose, PoseWithCovariance, Quaternion, Twist, Vector3};
use super::{Message, header_definition, separator, time_definition};

/// `sensor_msgs/msg/CompressedImage`: an image file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CompressedImage {
    /// When and from which camera.
    pub header: Header,
    /// What kind of file, for example `jpeg`; the file itself says so too.
    pub format: String,
    /// The file.
    #[serde(with = "super::octets")]
    pub data: Vec<u8>,
}

/// `geometry_msgs/msg/PoseWithCovarianceStamped`: a pose at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct PoseWithCovarianceStamped {
    pub header: Header,
    pub pose: PoseWithCovariance,
}

/// `geometry_msgs/msg/Transform`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Transform {
    pub translation: Vector3,
    pub rotation: Quaternion,
}

impl Transform {
    /// Where the child frame's origin is, and which way it looks.
    pub fn pose(&self) -> Pose {
        let Vector3 { x, y, z } = self.translation;
        Pose { position: super::Point { x, y, z }, orientation: self.rotation.clone() }
    }
}

/// `geometry_msgs/msg/TransformStamped`: where a frame is in another one.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct TransformStamped {
    pub header: Header,
    pub child_frame_id: String,
    pub transform: Transform,
}

/// `tf2_msgs/msg/TFMessage`: where several frames are.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct TfMessage {
    pub transforms: Vec<TransformStamped>,
}

macro_rules! vector_definition {
    () => {
        concat!(separator!(), "MSG: geometry_msgs/Vector3\n", "float64 x\nfloat64 y\nfloat64 z\n")
    };
}

macro_rules! quaternion_definition {
    () => {
        concat!(separator!(), "MSG: geometry_msgs/Quaternion\n", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n")
    };
}

impl Message for CompressedImage {
    const TYPE: &'static str = "sensor_msgs/msg/CompressedImage";
    const DEFINITION: &'static str =
        concat!("std_msgs/Header header\n", "string format\n", "uint8[] data\n", header_definition!(),);
}

impl Message for Twist {
    const TYPE: &'static str = "geometry_msgs/msg/Twist";
    const DEFINITION: &'static str =
        concat!("geometry_msgs/Vector3 linear\n", "geometry_msgs/Vector3 angular\n", vector_definition!(),);
}

impl Message for PoseWithCovarianceStamped {
    const TYPE: &'static str = "geometry_msgs/msg/PoseWithCovarianceStamped";
    const DEFINITION: &'static str = concat!(
        "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose\n",
        header_definition!(),
        separator!(),
        "MSG: geometry_msgs/PoseWithCovariance\n",
        "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
        separator!(),
        "MSG: geometry_msgs/Pose\n",
        "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
        separator!(),
        "MSG: geometry_msgs/Point\n",
        "float64 x\nfloat64 y\nfloat64 z\n",
        quaternion_definition!(),
    );
}

impl Message for TfMessage {
    const TYPE: &'static str = "tf2_msgs/msg/TFMessage";
    const DEFINITION: &'static str = concat!(
        "geometry_msgs/TransformStamped[] transforms\n",
        separator!(),
        "MSG: geometry_msgs/TransformStamped\n",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n",
        header_definition!(),
        separator!(),
        "MSG: geometry_msgs/Transform\n",
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n",
        vector_definition!(),
        quaternion_definition!(),
    );
}

/// Types of `std_msgs` that hold one value.
macro_rules! one_value {
    ($($(#[$doc:meta])* $type:ident: $value:ty = $name:literal, $definition:literal;)+) => {
        $(
            $(#[$doc])*
            #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
            #[allow(missing_docs)]
            pub struct $type {
                pub data: $value,
            }

            impl Message for $type {
                const TYPE: &'static str = concat!("std_msgs/msg/", $name);
                const DEFINITION: &'static str = concat!($definition, " data\n");
            }
        )+
    };
}

one_value! {
    /// `std_msgs/msg/Int8`.
    Int8: i8 = "Int8", "int8";
    /// `std_msgs/msg/Int16`.
    Int16: i16 = "Int16", "int16";
    /// `std_msgs/msg/Int32`.
    Int32: i32 = "Int32", "int32";
    /// `std_msgs/msg/Int64`.
    Int64: i64 = "Int64", "int64";
    /// `std_msgs/msg/UInt8`.
    UInt8: u8 = "UInt8", "uint8";
    /// `std_msgs/msg/UInt16`.
    UInt16: u16 = "UInt16", "uint16";
    /// `std_msgs/msg/UInt32`.
    UInt32: u32 = "UInt32", "uint32";
    /// `std_msgs/msg/UInt64`.
    UInt64: u64 = "UInt64", "uint64";
    /// `std_msgs/msg/String`.
    Text: String = "String", "string";
}
