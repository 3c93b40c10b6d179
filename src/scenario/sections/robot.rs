//! `[robot]`, `[camera]`, `[vision]`: what drives, and what it sees.

use crate::robot::ActionSet;
use crate::scenario::keys::{Section, above, within};

/// What the robot's actions move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Body {
    /// A disc in the simulation, which is where an action leads.
    Kinematic,
    /// A simulated body with a mass, which takes velocities.
    Dynamic,
    /// A robot on a ROS 2 network.
    Ros2,
    /// Whatever another program makes of actions: it calls the agent with each image.
    Program,
}

/// `[robot]`
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// What its actions move.
    pub body: Body,
    /// Whether frames come with the true pose.
    pub pose_known: bool,
    /// Radius, metres.
    pub radius: f64,
    /// Length of the action *forward*, metres.
    pub forward: f64,
    /// Angle of the actions *left* and *right*, degrees.
    pub turn_deg: f64,
    /// What it can do.
    pub actions: ActionSet,
    /// Duration of an action, seconds.
    pub action_seconds: f64,
    /// Frames per action.
    pub frames_per_action: usize,
    /// Standard deviation of the executed length, as a share.
    pub forward_noise: f64,
    /// Standard deviation of the executed angle, as a share.
    pub turn_noise: f64,
    /// Standard deviation of the heading's drift over one *forward*, degrees.
    pub drift_deg: f64,
    /// Standard deviation of the odometry's error per frame, as a share of the motion; of a real robot, that of an action's.
    pub odometry_noise: f64,
    /// Start position, metres.
    pub start: [f64; 2],
    /// Start heading, degrees from the x-axis, counter-clockwise.
    pub start_heading_deg: f64,
    /// Number of sonars in the ring, the first one straight ahead.
    pub sonars: usize,
    /// Range of the sonars, metres.
    pub sonar_range: f64,
    /// Standard deviation of a sonar reading, metres.
    pub sonar_noise: f64,
}

impl Robot {
    /// Time between frames, seconds.
    pub fn frame_seconds(&self) -> f64 {
        self.action_seconds / self.frames_per_action as f64
    }
}

/// How finely the simulated camera renders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// All pixels of the camera.
    Full,
    /// What vision needs and no more: [`VISION_SAMPLES`] × [`VISION_SAMPLES`] samples for each pixel of an observation,
    /// none for the lines that vision cuts away. Field of view, exposure and the noise of observations are those of
    /// the full image.
    Vision,
}

/// Samples for each pixel of an observation, along each axis, with [`Detail::Vision`].
pub const VISION_SAMPLES: usize = 4;

/// `[camera]`
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// How finely images are rendered.
    pub detail: Detail,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Horizontal field of view, degrees.
    pub field_of_view_deg: f64,
    /// Height of the lens above the floor, metres.
    pub mount_height: f64,
    /// Standard deviation of pixel noise, grey levels.
    pub pixel_noise: f64,
    /// Standard deviation of the slow exposure drift, as a share.
    pub exposure_drift: f64,
    /// Time constant of the exposure drift, seconds.
    pub exposure_seconds: f64,
}

/// `[vision]`
#[derive(Debug, Clone, PartialEq)]
pub struct Vision {
    /// Upper image lines that are cut away, pixels; of an image that is not as high as the camera's, as large a share.
    pub cut_rows: usize,
    /// Width of an observation, pixels.
    pub width: usize,
    /// Height of an observation, pixels.
    pub height: usize,
    /// Mean grey level that every observation is corrected to; `None`: no correction.
    pub brightness: Option<f64>,
}

impl Robot {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        let share = within(0.0, 0.5);
        let body = s.choice(
            "body",
            &[
                ("kinematic", Body::Kinematic),
                ("dynamic", Body::Dynamic),
                ("ros2", Body::Ros2),
                ("program", Body::Program),
            ],
            "a simulated disc that is where an action leads, a simulated body with a mass that takes velocities, a robot, \
             another program");
        let called = body == Body::Program;
        Robot {
            body,
            pose_known: s.choice_from(
                "pose",
                usize::from(called),
                &[("known", true), ("none", false)],
                "whether something measures where the robot is: for goals by coordinates, evaluation and plots",
            ),
            radius: s.number("radius", 0.25, "m", above(0.0, 10.0), "Pioneer 3-DX: 0.25"),
            forward: s.number("forward", 0.30, "m", above(0.0, 10.0), "length of the action forward"),
            turn_deg: s.number("turn_deg", 45.0, "degrees", above(0.0, 180.0), "angle of a turn"),
            actions: ActionSet::differential_drive(0.3, 0.8), // until [[action]] is read
            action_seconds: s.number("action_seconds", 1.0, "s", above(0.0, 60.0), "duration of an action"),
            frames_per_action: s.count(
                "frames_per_action",
                if called { 1 } else { 5 },
                "frames",
                1..=100,
                "camera frames per action",
            ),
            forward_noise: s.number("forward_noise", 0.05, "share", share, "standard deviation of the executed length"),
            turn_noise: s.number("turn_noise", 0.05, "share", share, "standard deviation of the executed angle"),
            drift_deg: s.number("drift_deg", 1.0, "degrees", within(0.0, 45.0), "heading noise of one forward"),
            odometry_noise: s.number(
                "odometry_noise",
                0.02,
                "share",
                share,
                "error of the odometry per frame, which maps of places count on",
            ),
            start: s.point("start", [1.5, 0.9], "position at the start"),
            start_heading_deg: s.number(
                "start_heading_deg",
                0.0,
                "degrees",
                within(-360.0, 360.0),
                "heading at the start, from the x-axis, counter-clockwise",
            ),
            sonars: s.count("sonars", 16, "", 1..=360, "sonars in the ring, the first one straight ahead"),
            sonar_range: s.number("sonar_range", 5.0, "m", above(0.0, 100.0), "longest distance measured"),
            sonar_noise: s.number("sonar_noise", 0.01, "m", within(0.0, 1.0), "standard deviation of a reading"),
        }
    }
}

impl Camera {
    /// Width and height of the images that are rendered, pixels.
    pub fn rendered(&self, vision: &Vision) -> (usize, usize) {
        match self.detail {
            Detail::Full => (self.width, self.height),
            Detail::Vision => (VISION_SAMPLES * vision.width, VISION_SAMPLES * vision.height),
        }
    }

    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Camera {
            detail: s.choice(
                "detail",
                &[("full", Detail::Full), ("vision", Detail::Vision)],
                "render all pixels, or only 4 × 4 samples for each pixel of an observation (several times faster)",
            ),
            width: s.count("width", 320, "px", 8..=4096, "image width"),
            height: s.count("height", 240, "px", 8..=4096, "image height"),
            field_of_view_deg: s.number(
                "field_of_view_deg",
                66.0,
                "degrees",
                within(10.0, 150.0),
                "horizontal field of view",
            ),
            mount_height: s.number("mount_height", 0.5, "m", above(0.0, 50.0), "lens above the floor"),
            pixel_noise: s.number("pixel_noise", 2.0, "grey levels", within(0.0, 64.0), "noise of a pixel"),
            exposure_drift: s.number("exposure_drift", 0.05, "share", within(0.0, 0.5), "slow drift of the gain"),
            exposure_seconds: s.number("exposure_seconds", 60.0, "s", above(0.0, 1e6), "time constant of the drift"),
        }
    }
}

impl Vision {
    /// Values of an observation: three to a pixel.
    pub fn values(&self) -> usize {
        3 * self.width * self.height
    }

    pub(super) fn read(s: &mut Section<'_, '_>, body: Body) -> Self {
        let cut_rows = s.count(
            "cut_rows",
            // What another program shows may have its best above.
            if body == Body::Program { 0 } else { 80 },
            "px",
            0..=4095,
            "upper lines that are cut away; of images that are not camera.height high, as large a share",
        );
        let width = s.count("width", 32, "px", 1..=1024, "width of an observation");
        let height = s.count("height", 16, "px", 1..=1024, "height of an observation");
        let brightness = s.number(
            "brightness",
            128.0,
            "grey levels",
            within(0.0, 255.0),
            "mean that observations are corrected to; 0: no correction",
        );
        Vision { cut_rows, width, height, brightness: (brightness > 0.0).then_some(brightness) }
    }
}
