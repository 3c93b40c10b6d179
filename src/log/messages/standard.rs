//! Messages that ROS 2 defines, with the fields and types of its own packages.

use serde::{Deserialize, Serialize};

use super::messages;

const NANOSECONDS: u64 = 1_000_000_000;

/// A covariance of (x, y, z, rotations about x, y, z), row by row.
///
/// Six rows of six and not 36 numbers: serde has no arrays above 32, and CDR stores both alike.
pub type Covariance = [[f64; 6]; 6];

messages! {
    /// `builtin_interfaces/msg/Time`: seconds and nanoseconds since the epoch of the log's clock.
    builtin_interfaces / Time Time {
        /// Whole seconds.
        sec: i32,
        /// Nanoseconds of the second, below 10⁹.
        nanosec: u32,
    };

    /// `std_msgs/msg/Header`: when and in which coordinate frame.
    std_msgs / Header Header {
        /// When the data was taken.
        stamp: Time,
        /// Name of the coordinate frame.
        frame_id: String,
    };

    /// `std_msgs/msg/String`: a text.
    std_msgs / String Text {
        /// The text.
        data: String,
    } in;

    /// `sensor_msgs/msg/Image`: pixels, row by row.
    sensor_msgs / Image Image {
        /// When and from which camera.
        header: Header,
        /// Rows.
        height: u32,
        /// Columns.
        width: u32,
        /// What a pixel is, for example `rgb8`.
        encoding: String,
        /// 1 if numbers of more than one byte have the high byte first.
        is_bigendian: u8,
        /// Bytes per row.
        step: u32,
        /// The pixels, `step` × `height` bytes.
        #[serde(with = "super::octets")]
        data: Vec<u8>,
    } in Header Time;

    /// `sensor_msgs/msg/LaserScan`: distances on a circle; here the sonar.
    sensor_msgs / LaserScan LaserScan {
        /// When and from which sensor.
        header: Header,
        /// Angle of the first ray, rad, counter-clockwise from straight ahead.
        angle_min: f32,
        /// Angle of the last ray, rad.
        angle_max: f32,
        /// Angle between rays, rad.
        angle_increment: f32,
        /// Time between rays, s.
        time_increment: f32,
        /// Time between scans, s.
        scan_time: f32,
        /// Smallest distance that can be measured, m.
        range_min: f32,
        /// Largest distance that can be measured, m.
        range_max: f32,
        /// Distances, m; infinite without an echo.
        ranges: Vec<f32>,
        /// Strengths of the echoes, or empty.
        intensities: Vec<f32>,
    } in Header Time;

    /// `geometry_msgs/msg/Point`, m.
    geometry_msgs / Point Point {
        x: f64,
        y: f64,
        z: f64,
    };

    /// `geometry_msgs/msg/Quaternion`: a rotation; of length 1 to be valid.
    geometry_msgs / Quaternion Quaternion {
        x: f64,
        y: f64,
        z: f64,
        w: f64,
    };

    /// `geometry_msgs/msg/Vector3`.
    geometry_msgs / Vector3 Vector3 {
        x: f64,
        y: f64,
        z: f64,
    };

    /// `geometry_msgs/msg/Pose`: where and which way.
    geometry_msgs / Pose Pose {
        /// Where, m.
        position: Point,
        /// Which way.
        orientation: Quaternion,
    };

    /// `geometry_msgs/msg/Twist`: velocity.
    geometry_msgs / Twist Twist {
        /// m/s.
        linear: Vector3,
        /// rad/s.
        angular: Vector3,
    } in Vector3;

    /// `geometry_msgs/msg/PoseWithCovariance`.
    geometry_msgs / PoseWithCovariance PoseWithCovariance {
        pose: Pose,
        covariance: Covariance,
    };

    /// `geometry_msgs/msg/TwistWithCovariance`.
    geometry_msgs / TwistWithCovariance TwistWithCovariance {
        twist: Twist,
        covariance: Covariance,
    };

    /// `nav_msgs/msg/Odometry`: pose and velocity by the robot's own estimate.
    nav_msgs / Odometry Odometry {
        /// When, and the frame of the pose.
        header: Header,
        /// The frame of the velocity.
        child_frame_id: String,
        /// Estimated pose.
        pose: PoseWithCovariance,
        /// Estimated velocity.
        twist: TwistWithCovariance,
    } in Header Time PoseWithCovariance Pose Point Quaternion TwistWithCovariance Twist Vector3;

    /// `geometry_msgs/msg/PoseStamped`: a pose at a time.
    geometry_msgs / PoseStamped PoseStamped {
        header: Header,
        pose: Pose,
    } in Header Time Pose Point Quaternion;

    /// `geometry_msgs/msg/TwistStamped`: a velocity, here the command, at a time.
    geometry_msgs / TwistStamped TwistStamped {
        header: Header,
        twist: Twist,
    } in Header Time Twist Vector3;

    /// `rcl_interfaces/msg/Log`: a line of diagnostics.
    rcl_interfaces / Log Log [
        DEBUG: "byte" = 10,
        INFO: "byte" = 20,
        WARN: "byte" = 30,
        ERROR: "byte" = 40,
        FATAL: "byte" = 50,
    ] {
        /// When.
        stamp: Time,
        /// How serious: one of the constants.
        level: u8,
        /// Who says it.
        name: String,
        /// What is said.
        msg: String,
        /// Source file, or empty.
        file: String,
        /// Function, or empty.
        function: String,
        /// Line of the source file, or 0.
        line: u32,
    } in Time;
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
