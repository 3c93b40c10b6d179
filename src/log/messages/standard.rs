//! Messages that ROS 2 defines, with the fields and types of its own packages.

use serde::{Deserialize, Serialize};

use super::{Message, header_definition, separator, time_definition};

const NANOSECONDS: u64 = 1_000_000_000;

/// `builtin_interfaces/msg/Time`: seconds and nanoseconds since the epoch of the log's clock.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds.
    pub sec: i32,
    /// Nanoseconds of the second, below 10⁹.
    pub nanosec: u32,
}

impl Time {
    /// A time from nanoseconds. Seconds above `i32::MAX` (the year 2038) stay at that value,
    /// since ROS 2 has 32 bits for them; the log's own stamps have 64.
    pub fn new(stamp_ns: u64) -> Self {
        Self {
            sec: i32::try_from(stamp_ns / NANOSECONDS).unwrap_or(i32::MAX),
            // A remainder below 10⁹ always fits.
            nanosec: (stamp_ns % NANOSECONDS) as u32,
        }
    }

    /// The time in nanoseconds; a time before the epoch counts as 0.
    pub fn stamp_ns(&self) -> u64 {
        u64::try_from(self.sec).map_or(0, |sec| sec * NANOSECONDS + u64::from(self.nanosec))
    }
}

/// `std_msgs/msg/Header`: when and in which coordinate frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// When the data was taken.
    pub stamp: Time,
    /// Name of the coordinate frame.
    pub frame_id: String,
}

impl Header {
    /// A header from nanoseconds (see [`Time::new`]) and the name of a coordinate frame.
    pub fn new(stamp_ns: u64, frame_id: &str) -> Self {
        Self { stamp: Time::new(stamp_ns), frame_id: frame_id.to_owned() }
    }

    /// The stamp in nanoseconds; a time before the epoch counts as 0.
    pub fn stamp_ns(&self) -> u64 {
        self.stamp.stamp_ns()
    }
}

/// `sensor_msgs/msg/Image`: pixels, row by row.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Image {
    /// When and from which camera.
    pub header: Header,
    /// Rows.
    pub height: u32,
    /// Columns.
    pub width: u32,
    /// What a pixel is, for example `rgb8`.
    pub encoding: String,
    /// 1 if numbers of more than one byte have the high byte first.
    pub is_bigendian: u8,
    /// Bytes per row.
    pub step: u32,
    /// The pixels, `step` × `height` bytes.
    #[serde(with = "super::octets")]
    pub data: Vec<u8>,
}

/// `sensor_msgs/msg/LaserScan`: distances on a circle; here the sonar.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LaserScan {
    /// When and from which sensor.
    pub header: Header,
    /// Angle of the first ray, rad, counter-clockwise from straight ahead.
    pub angle_min: f32,
    /// Angle of the last ray, rad.
    pub angle_max: f32,
    /// Angle between rays, rad.
    pub angle_increment: f32,
    /// Time between rays, s.
    pub time_increment: f32,
    /// Time between scans, s.
    pub scan_time: f32,
    /// Smallest distance that can be measured, m.
    pub range_min: f32,
    /// Largest distance that can be measured, m.
    pub range_max: f32,
    /// Distances, m; infinite without an echo.
    pub ranges: Vec<f32>,
    /// Strengths of the echoes, or empty.
    pub intensities: Vec<f32>,
}

/// `geometry_msgs/msg/Point`, m.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Point {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`: a rotation; of length 1 to be valid.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

/// `geometry_msgs/msg/Vector3`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/msg/Pose`: where and which way.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Where, m.
    pub position: Point,
    /// Which way.
    pub orientation: Quaternion,
}

impl Pose {
    /// The pose of a robot in the plane: position in m, heading in rad from the x axis.
    pub fn planar(x: f64, y: f64, heading: f64) -> Self {
        Self {
            position: Point { x, y, z: 0.0 },
            orientation: Quaternion { x: 0.0, y: 0.0, z: (heading / 2.0).sin(), w: (heading / 2.0).cos() },
        }
    }

    /// The heading of a pose in the plane, rad, in (−π, π].
    pub fn heading(&self) -> f64 {
        let q = &self.orientation;
        (2.0 * (q.w * q.z + q.x * q.y)).atan2(1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    }
}

/// `geometry_msgs/msg/Twist`: velocity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// m/s.
    pub linear: Vector3,
    /// rad/s.
    pub angular: Vector3,
}

/// A covariance of (x, y, z, rotations about x, y, z), row by row.
///
/// Six rows of six and not 36 numbers: serde has no arrays above 32, and CDR stores both alike.
pub type Covariance = [[f64; 6]; 6];

/// `geometry_msgs/msg/PoseWithCovariance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct PoseWithCovariance {
    pub pose: Pose,
    pub covariance: Covariance,
}

/// `geometry_msgs/msg/TwistWithCovariance`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct TwistWithCovariance {
    pub twist: Twist,
    pub covariance: Covariance,
}

/// `nav_msgs/msg/Odometry`: pose and velocity by the robot's own estimate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// When, and the frame of the pose.
    pub header: Header,
    /// The frame of the velocity.
    pub child_frame_id: String,
    /// Estimated pose.
    pub pose: PoseWithCovariance,
    /// Estimated velocity.
    pub twist: TwistWithCovariance,
}

/// `geometry_msgs/msg/PoseStamped`: a pose at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct PoseStamped {
    pub header: Header,
    pub pose: Pose,
}

/// `geometry_msgs/msg/TwistStamped`: a velocity, here the command, at a time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct TwistStamped {
    pub header: Header,
    pub twist: Twist,
}

/// `rcl_interfaces/msg/Log`: a line of diagnostics.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Log {
    /// When.
    pub stamp: Time,
    /// How serious: one of the constants.
    pub level: u8,
    /// Who says it.
    pub name: String,
    /// What is said.
    pub msg: String,
    /// Source file, or empty.
    pub file: String,
    /// Function, or empty.
    pub function: String,
    /// Line of the source file, or 0.
    pub line: u32,
}

#[allow(missing_docs)]
impl Log {
    pub const DEBUG: u8 = 10;
    pub const INFO: u8 = 20;
    pub const WARN: u8 = 30;
    pub const ERROR: u8 = 40;
    pub const FATAL: u8 = 50;
}

macro_rules! pose_definition {
    () => {
        concat!(
            separator!(),
            "MSG: geometry_msgs/Pose\n",
            "geometry_msgs/Point position\n",
            "geometry_msgs/Quaternion orientation\n",
            separator!(),
            "MSG: geometry_msgs/Point\n",
            "float64 x\nfloat64 y\nfloat64 z\n",
            separator!(),
            "MSG: geometry_msgs/Quaternion\n",
            "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        )
    };
}

macro_rules! twist_definition {
    () => {
        concat!(
            separator!(),
            "MSG: geometry_msgs/Twist\n",
            "geometry_msgs/Vector3 linear\n",
            "geometry_msgs/Vector3 angular\n",
            separator!(),
            "MSG: geometry_msgs/Vector3\n",
            "float64 x\nfloat64 y\nfloat64 z\n",
        )
    };
}

impl Message for Image {
    const TYPE: &'static str = "sensor_msgs/msg/Image";
    const DEFINITION: &'static str = concat!(
        "std_msgs/Header header\n",
        "uint32 height\nuint32 width\n",
        "string encoding\nuint8 is_bigendian\n",
        "uint32 step\nuint8[] data\n",
        header_definition!(),
    );
}

impl Message for LaserScan {
    const TYPE: &'static str = "sensor_msgs/msg/LaserScan";
    const DEFINITION: &'static str = concat!(
        "std_msgs/Header header\n",
        "float32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n",
        "float32 time_increment\nfloat32 scan_time\n",
        "float32 range_min\nfloat32 range_max\n",
        "float32[] ranges\nfloat32[] intensities\n",
        header_definition!(),
    );
}

impl Message for Odometry {
    const TYPE: &'static str = "nav_msgs/msg/Odometry";
    const DEFINITION: &'static str = concat!(
        "std_msgs/Header header\nstring child_frame_id\n",
        "geometry_msgs/PoseWithCovariance pose\n",
        "geometry_msgs/TwistWithCovariance twist\n",
        header_definition!(),
        separator!(),
        "MSG: geometry_msgs/PoseWithCovariance\n",
        "geometry_msgs/Pose pose\nfloat64[36] covariance\n",
        pose_definition!(),
        separator!(),
        "MSG: geometry_msgs/TwistWithCovariance\n",
        "geometry_msgs/Twist twist\nfloat64[36] covariance\n",
        twist_definition!(),
    );
}

impl Message for PoseStamped {
    const TYPE: &'static str = "geometry_msgs/msg/PoseStamped";
    const DEFINITION: &'static str =
        concat!("std_msgs/Header header\ngeometry_msgs/Pose pose\n", header_definition!(), pose_definition!(),);
}

impl Message for TwistStamped {
    const TYPE: &'static str = "geometry_msgs/msg/TwistStamped";
    const DEFINITION: &'static str =
        concat!("std_msgs/Header header\ngeometry_msgs/Twist twist\n", header_definition!(), twist_definition!(),);
}

impl Message for Log {
    const TYPE: &'static str = "rcl_interfaces/msg/Log";
    const DEFINITION: &'static str = concat!(
        "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n",
        "builtin_interfaces/Time stamp\n",
        "uint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n",
        time_definition!(),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_comes_back() {
        for stamp_ns in [0, 1, 999_999_999, 1_790_000_000_123_456_789] {
            assert_eq!(Header::new(stamp_ns, "map").stamp_ns(), stamp_ns);
        }
        assert_eq!(Time::new(u64::MAX).sec, i32::MAX);
        assert_eq!(Time { sec: -1, nanosec: 5 }.stamp_ns(), 0);
    }

    #[test]
    fn a_heading_comes_back() {
        for heading in [-3.0, -0.5, 0.0, 1.0, 3.1] {
            let pose = Pose::planar(1.0, 2.0, heading);
            assert!((pose.heading() - heading).abs() < 1e-12);
        }
    }
}
