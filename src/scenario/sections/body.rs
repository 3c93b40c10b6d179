//! `[body]`, `[[world.movable]]`: a simulated robot with a mass, and things that it can push.

use crate::scenario::keys::{Section, above, within};

/// `[body]`: the simulated robot's mass, motors, wheels and sensors.
#[derive(Debug, Clone, PartialEq)]
pub struct BodySettings {
    /// Kilograms.
    pub mass: f64,
    /// Most force of both motors together, newtons.
    pub motor_force: f64,
    /// Friction of wheels on the floor.
    pub traction: f64,
    /// Metres a second by which a wheel that passes on all the force that the floor can take is faster than the floor.
    pub creep: f64,
    /// By how much the motors change the speed, m/s².
    pub acceleration: f64,
    /// By how much the motors change the turning speed, rad/s².
    pub turn_acceleration: f64,
    /// Standard deviation of the radius of each wheel, as a share.
    pub wheel_error: f64,
    /// Images a second.
    pub camera_hz: f64,
    /// From the exposure to the program, seconds.
    pub camera_latency: f64,
    /// Odometry messages a second.
    pub odometry_hz: f64,
    /// From the measurement to the program, seconds.
    pub odometry_latency: f64,
    /// Whether there is a bumper.
    pub bumper: bool,
}

/// `[[world.movable]]`: an upright cylinder that can be pushed.
#[derive(Debug, Clone, PartialEq)]
pub struct Movable {
    /// Where it stands at first, metres.
    pub at: [f64; 2],
    /// Metres.
    pub radius: f64,
    /// Metres.
    pub height: f64,
    /// Kilograms.
    pub mass: f64,
    /// Friction on the floor.
    pub friction: f64,
    /// Colour, degrees.
    pub hue: f64,
}

impl BodySettings {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        let (rate, late) = (within(1.0, 200.0), within(0.0, 2000.0));
        BodySettings {
            mass: s.number("mass", 9.0, "kg", within(0.1, 1000.0), "Pioneer 3-DX: 9"),
            motor_force: s.number("motor_force", 30.0, "N", within(0.1, 1e5), "most force of both motors"),
            traction: s.number("traction", 0.6, "", within(0.01, 5.0), "friction of wheels on the floor"),
            creep: s.number(
                "creep",
                0.02,
                "m/s",
                within(0.0, 1.0),
                "a wheel that takes all the force that the floor can give is faster than the floor by this",
            ),
            acceleration: s.number("acceleration", 1.5, "m/s²", above(0.0, 100.0), "of the motors"),
            turn_acceleration: s
                .number("turn_acceleration_deg", 300.0, "degrees/s²", above(0.0, 1e5), "of the motors")
                .to_radians(),
            wheel_error: s.number(
                "wheel_error",
                0.003,
                "share",
                within(0.0, 0.2),
                "standard deviation of each wheel's radius, which odometry does not know",
            ),
            camera_hz: s.number("camera_hz", 10.0, "Hz", rate, "images a second"),
            camera_latency: s.number("camera_latency_ms", 80.0, "ms", late, "from the exposure to the program") / 1e3,
            odometry_hz: s.number("odometry_hz", 50.0, "Hz", rate, "odometry messages a second"),
            odometry_latency: s.number("odometry_latency_ms", 20.0, "ms", late, "from the wheels to the program") / 1e3,
            bumper: s.flag("bumper", false, "whether it has a bumper; with one, it pushes nothing"),
        }
    }
}

impl Movable {
    pub(super) fn read(s: &mut Section<'_, '_>, index: usize) -> Self {
        Movable {
            at: s.point("at", [0.0, 0.0], "where it stands at first"),
            radius: s.number("radius", 0.15, "m", within(0.02, 10.0), "an upright cylinder"),
            height: s.number("height", 0.4, "m", within(0.01, 10.0), "height"),
            mass: s.number("mass", 1.0, "kg", within(0.01, 1000.0), "mass"),
            friction: s.number("friction", 0.4, "", within(0.0, 5.0), "on the floor"),
            hue: s.number("hue", (index as f64 * 137.0 + 60.0) % 360.0, "degrees", within(0.0, 360.0), "colour"),
        }
    }
}
