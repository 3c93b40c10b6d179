//! What drives a robot: velocities, within limits.

/// Velocities of a robot that drives ahead and turns.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Velocity {
    /// Metres a second straight ahead; negative: back.
    pub linear: f64,
    /// Radians a second counter-clockwise.
    pub angular: f64,
}

impl Velocity {
    /// Standing still.
    pub const ZERO: Velocity = Velocity { linear: 0.0, angular: 0.0 };

    /// Whether it is standing still, exactly.
    pub fn is_zero(self) -> bool {
        self == Velocity::ZERO
    }

    /// Whether both are numbers.
    pub fn is_finite(self) -> bool {
        self.linear.is_finite() && self.angular.is_finite()
    }
}

/// The most that a robot is asked for.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Limits {
    /// Metres a second.
    pub speed: f64,
    /// Radians a second.
    pub turn_speed: f64,
    /// Metres a second, per second.
    pub acceleration: f64,
    /// Radians a second, per second.
    pub turn_acceleration: f64,
}

impl Limits {
    /// A wanted velocity within the limits, after so many seconds at the one `before`. What is not a number is standing still.
    pub fn apply(&self, before: Velocity, wanted: Velocity, seconds: f64) -> Velocity {
        let within = |before: f64, wanted: f64, most: f64, change: f64| {
            let wanted = if wanted.is_finite() { wanted.clamp(-most, most) } else { 0.0 };
            let step = change * seconds.max(0.0);
            wanted.clamp(before - step, before + step).clamp(-most, most)
        };
        Velocity {
            linear: within(before.linear, wanted.linear, self.speed, self.acceleration),
            angular: within(before.angular, wanted.angular, self.turn_speed, self.turn_acceleration),
        }
    }
}
