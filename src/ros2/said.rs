//! Messages of ROS 2 that we only publish, with the fields of its own packages.

use serde::Serialize;

use crate::log::messages::{Header, Point, Pose, Time, Vector3};

/// `diagnostic_msgs/msg/DiagnosticArray`: how a program is doing.
#[derive(Debug, Clone, Default, Serialize)]
pub struct DiagnosticArray {
    /// When.
    pub header: Header,
    /// Of what.
    pub status: Vec<DiagnosticStatus>,
}

impl DiagnosticArray {
    /// Its type.
    pub const TYPE: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
}

/// `diagnostic_msgs/msg/DiagnosticStatus`: how a part of it is doing.
#[derive(Debug, Clone, Default, Serialize)]
pub struct DiagnosticStatus {
    /// See the constants.
    pub level: u8,
    /// Which part.
    pub name: String,
    /// In words.
    pub message: String,
    /// Which robot.
    pub hardware_id: String,
    /// In numbers.
    pub values: Vec<KeyValue>,
}

impl DiagnosticStatus {
    /// All is well.
    pub const OK: u8 = 0;
    /// It stands, and somebody may have to do something about it.
    pub const WARN: u8 = 1;
}

/// `diagnostic_msgs/msg/KeyValue`
#[derive(Debug, Clone, Default, Serialize)]
pub struct KeyValue {
    /// What.
    pub key: String,
    /// How much.
    pub value: String,
}

/// `nav_msgs/msg/OccupancyGrid`: a map of the floor; here of what places are worth.
#[derive(Debug, Clone, Default, Serialize)]
pub struct OccupancyGrid {
    /// When, and in which frame.
    pub header: Header,
    /// Where its cells are.
    pub info: MapMetaData,
    /// From 0 to 100, row by row from the lowest corner; −1: not known.
    pub data: Vec<i8>,
}

impl OccupancyGrid {
    /// Its type.
    pub const TYPE: &'static str = "nav_msgs/msg/OccupancyGrid";
}

/// `nav_msgs/msg/MapMetaData`: where a map's cells are.
#[derive(Debug, Clone, Default, Serialize)]
pub struct MapMetaData {
    /// When it was made.
    pub map_load_time: Time,
    /// Side of a cell, metres.
    pub resolution: f32,
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// The lowest corner.
    pub origin: Pose,
}

/// `visualization_msgs/msg/MarkerArray`: things that are drawn.
#[derive(Debug, Clone, Default, Serialize)]
pub struct MarkerArray {
    /// Them.
    pub markers: Vec<Marker>,
}

impl MarkerArray {
    /// Its type.
    pub const TYPE: &'static str = "visualization_msgs/msg/MarkerArray";
}

/// `visualization_msgs/msg/Marker`: a thing that is drawn.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Marker {
    /// When, and in which frame.
    pub header: Header,
    /// What it is, with `id`: one that is drawn again replaces the one before.
    pub ns: String,
    /// See `ns`.
    pub id: i32,
    /// Its shape, see the constants.
    pub kind: i32,
    /// 0: draw it.
    pub action: i32,
    /// Where.
    pub pose: Pose,
    /// How large, metres.
    pub scale: Vector3,
    /// Its colour.
    pub color: Colour,
    /// 0: until it is drawn again.
    pub lifetime: Time,
    /// Whether it moves with its frame.
    pub frame_locked: bool,
    /// Corners of a line.
    pub points: Vec<Point>,
    /// Their colours.
    pub colors: Vec<Colour>,
    /// None: its file, header, format, data and coordinates.
    pub texture: (String, Header, String, Vec<u8>, Vec<[f32; 2]>),
    /// What is written.
    pub text: String,
    /// None: its resource, name and data, and whether it has materials of its own.
    pub mesh: (String, String, Vec<u8>, bool),
}

impl Marker {
    /// An arrow along its pose.
    pub const ARROW: i32 = 0;
    /// A disc.
    pub const CYLINDER: i32 = 3;
    /// A line through points.
    pub const LINE_STRIP: i32 = 4;
    /// A text.
    pub const TEXT: i32 = 9;
}

/// `std_msgs/msg/ColorRGBA`
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Colour {
    /// Red, from 0 to 1.
    pub r: f32,
    /// Green.
    pub g: f32,
    /// Blue.
    pub b: f32,
    /// 1: opaque.
    pub a: f32,
}

/// `rosbag2_interfaces/msg/MessagesLostEvent`: messages that were lost since the one before.
#[derive(Debug, Clone, Default, Serialize)]
pub struct MessagesLostEvent {
    /// Whose they were.
    pub node_name: String,
    /// Topics of which some were lost.
    pub messages_lost_statistics: Vec<MessagesLostEventTopicStat>,
}

impl MessagesLostEvent {
    /// Its type.
    pub const TYPE: &'static str = "rosbag2_interfaces/msg/MessagesLostEvent";
}

/// `rosbag2_interfaces/msg/MessagesLostEventTopicStat`: messages of a topic that were lost.
#[derive(Debug, Clone, Default, Serialize)]
pub struct MessagesLostEventTopicStat {
    /// The topic.
    pub topic_name: String,
    /// On the way to us.
    pub messages_lost_in_transport: u64,
    /// By us: not taken in time, or of no use.
    pub messages_lost_in_recorder: u64,
}
