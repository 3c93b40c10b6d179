//! Messages that only other programs' logs hold.

use serde::{Deserialize, Serialize};

use super::messages;
use super::standard::{Header, Point, Pose, PoseWithCovariance, Quaternion, Time, Vector3};

messages! {
    /// `sensor_msgs/msg/CompressedImage`: an image file.
    sensor_msgs / CompressedImage CompressedImage {
        /// When and from which camera.
        header: Header,
        /// What kind of file, for example `jpeg`; the file itself says so too.
        format: String,
        /// The file.
        #[serde(with = "super::octets")]
        data: Vec<u8>,
    } in Header Time;

    /// `geometry_msgs/msg/PoseWithCovarianceStamped`: a pose at a time.
    geometry_msgs / PoseWithCovarianceStamped PoseWithCovarianceStamped {
        header: Header,
        pose: PoseWithCovariance,
    } in Header Time PoseWithCovariance Pose Point Quaternion;

    /// `geometry_msgs/msg/Transform`.
    geometry_msgs / Transform Transform {
        translation: Vector3,
        rotation: Quaternion,
    };

    /// `geometry_msgs/msg/TransformStamped`: where a frame is in another one.
    geometry_msgs / TransformStamped TransformStamped {
        header: Header,
        child_frame_id: String,
        transform: Transform,
    };

    /// `tf2_msgs/msg/TFMessage`: where several frames are.
    tf2_msgs / TFMessage TfMessage {
        transforms: Vec<TransformStamped>,
    } in TransformStamped Header Time Transform Vector3 Quaternion;

    /// `std_msgs/msg/Empty`: the one byte is what a structure without members has on the wire.
    std_msgs / Empty Empty { structure_needs_at_least_one_member: u8, } in;
    /// `std_msgs/msg/Int8`.
    std_msgs / Int8 Int8 { data: i8, } in;
    /// `std_msgs/msg/Int16`.
    std_msgs / Int16 Int16 { data: i16, } in;
    /// `std_msgs/msg/Int32`.
    std_msgs / Int32 Int32 { data: i32, } in;
    /// `std_msgs/msg/Int64`.
    std_msgs / Int64 Int64 { data: i64, } in;
    /// `std_msgs/msg/UInt8`.
    std_msgs / UInt8 UInt8 { data: u8, } in;
    /// `std_msgs/msg/UInt16`.
    std_msgs / UInt16 UInt16 { data: u16, } in;
    /// `std_msgs/msg/UInt32`.
    std_msgs / UInt32 UInt32 { data: u32, } in;
    /// `std_msgs/msg/UInt64`.
    std_msgs / UInt64 UInt64 { data: u64, } in;
    /// `rosgraph_msgs/msg/Clock`: a simulator's time.
    rosgraph_msgs / Clock Clock { clock: Time, } in Time;
    /// `std_msgs/msg/Bool`.
    std_msgs / Bool Bool { data: bool, } in;
    /// `sensor_msgs/msg/BatteryState`, the first of its fields.
    sensor_msgs / BatteryState BatteryState {
        /// When.
        header: Header,
        /// V.
        voltage: f32,
        /// °C.
        temperature: f32,
        /// A.
        current: f32,
        /// Ah.
        charge: f32,
        /// Ah.
        capacity: f32,
        /// Ah.
        design_capacity: f32,
        /// As a share.
        percentage: f32,
    } in Header Time;
    /// `std_msgs/msg/Float32`.
    std_msgs / Float32 Float32 { data: f32, } in;
    /// `std_msgs/msg/Float64`.
    std_msgs / Float64 Float64 { data: f64, } in;
}

impl Transform {
    /// Where the child frame's origin is, and which way it looks.
    pub fn pose(&self) -> Pose {
        let Vector3 { x, y, z } = self.translation;
        Pose { position: Point { x, y, z }, orientation: self.rotation.clone() }
    }
}
