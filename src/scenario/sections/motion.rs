//! `[motion]`, `[safety]`: how a robot that takes velocities drives, and when it may.

use std::time::Duration;

use crate::robot::{Limits, MotionSettings, SafetySettings, Velocity};
use crate::scenario::keys::{Reader, Section, above, within};

/// `[motion]`: actions out of velocities.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Velocities a second.
    pub control_hz: f64,
    /// How actions are done.
    pub settings: MotionSettings,
    /// When the robot may move.
    pub safety: Safety,
}

/// `[safety]`: when the robot may move.
#[derive(Debug, Clone, PartialEq)]
pub struct Safety {
    /// Age at which what was sensed is stale, seconds.
    pub fresh_seconds: f64,
    /// How long the topic of the emergency stop may be silent, seconds.
    pub emergency_stop_seconds: f64,
    /// How long the topic of the lock may be silent, seconds.
    pub lock_seconds: f64,
    /// Silence after which a person does not drive any more, seconds.
    pub teleop_seconds: f64,
    /// Whether a person must let the robot go on after each stop.
    pub hold: bool,
    /// Whether a scan that is near stops the robot.
    pub scan: bool,
    /// What is left between the robot and what a scan sees when it has stopped, metres.
    pub margin: f64,
    /// How long the robot goes on before a command to stop is heeded, seconds.
    pub reaction_seconds: f64,
    /// Charge below which the battery is low, as a share.
    pub battery: f64,
    /// Name of the task to whose goal the robot drives then; `None`: it stands.
    pub battery_task: Option<String>,
}

/// What a robot has beside camera and odometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Equipment {
    /// Scans.
    pub scan: bool,
    /// An emergency stop.
    pub emergency_stop: bool,
    /// A lock.
    pub lock: bool,
}

impl Safety {
    fn read(s: &mut Section<'_, '_>) -> Self {
        let silence = within(0.05, 60.0);
        Safety {
            fresh_seconds: s.number(
                "fresh_seconds",
                0.25,
                "s",
                silence,
                "camera, odometry or scan older than this: it stops",
            ),
            emergency_stop_seconds: s.number(
                "emergency_stop_seconds",
                1.0,
                "s",
                silence,
                "an emergency stop whose topic is silent for longer counts as pressed",
            ),
            lock_seconds: s.number("lock_seconds", 0.5, "s", silence, "a lock whose topic is silent for longer locks"),
            teleop_seconds: s.number(
                "teleop_seconds",
                1.0,
                "s",
                silence,
                "a person whose topic is silent for longer does not drive any more",
            ),
            hold: s.choice(
                "after_stop",
                &[("go on", false), ("hold", true)],
                "when nothing stops it any more it goes on by itself, or a person must let it"),
            scan: s.flag("scan", true, "whether it stops at what a scan sees ahead of it"),
            margin: s.number(
                "margin",
                0.05,
                "m",
                within(0.0, 5.0),
                "what is left between the robot and what a scan sees ahead of it when it has stopped",
            ),
            reaction_seconds: s.number(
                "reaction_seconds",
                0.15,
                "s",
                within(0.0, 5.0),
                "it goes on for so long before a command to stop is heeded",
            ),
            battery: s.number(
                "battery",
                0.0,
                "share",
                within(0.0, 1.0),
                "charge below which its battery is low; 0: never",
            ),
            battery_task: Some(s.text(
                "battery_task",
                "",
                "a task: when the battery is low it drives to its goal and waits there, and at half of that charge it stands where it \
                 is; \"\": it stands at once",
            ))
            .filter(|task| !task.is_empty()),
        }
    }
}

impl Motion {
    /// When a robot may move.
    pub fn safety_of(&self, equipment: Equipment) -> SafetySettings {
        let (safety, seconds) = (&self.safety, Duration::from_secs_f64);
        SafetySettings {
            limits: self.settings.limits,
            fresh: seconds(safety.fresh_seconds),
            scan: equipment.scan && safety.scan,
            emergency_stop: equipment.emergency_stop.then(|| seconds(safety.emergency_stop_seconds)),
            lock: equipment.lock.then(|| seconds(safety.lock_seconds)),
            teleop: seconds(safety.teleop_seconds),
            hold: safety.hold,
            margin: safety.margin,
            reaction: seconds(safety.reaction_seconds),
            still: self.settings.still,
            battery: safety.battery,
            battery_empty: if safety.battery_task.is_some() { safety.battery / 2.0 } else { safety.battery },
        }
    }

    /// Time between velocities.
    pub fn period(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.control_hz)
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Self {
        let (control_hz, settings) = reader.section("motion", "actions out of velocities", Motion::read_actions);
        let safety = reader.section("safety", "when the robot may move", Safety::read);
        Motion { control_hz, settings, safety }
    }

    fn read_actions(s: &mut Section<'_, '_>) -> (f64, MotionSettings) {
        let (fast, quick) = (within(0.01, 10.0), within(1.0, 3600.0));
        let seconds = within(0.0, 60.0);
        let control_hz = s.number("control_hz", 20.0, "Hz", within(10.0, 200.0), "velocities a second");
        let limits = Limits {
            speed: s.number("speed", 0.4, "m/s", fast, "most that is commanded"),
            turn_speed: s.number("turn_speed_deg", 80.0, "degrees/s", quick, "most that is commanded").to_radians(),
            acceleration: s.number("acceleration", 0.8, "m/s²", fast, "most by which that changes"),
            turn_acceleration: s
                .number("turn_acceleration_deg", 160.0, "degrees/s²", quick, "most by which that changes")
                .to_radians(),
        };
        let settings = MotionSettings {
            limits,
            tolerance: s.number("tolerance", 0.01, "m", above(0.0, 1.0), "an action may end so far from its end"),
            turn_tolerance: s
                .number("turn_tolerance_deg", 1.0, "degrees", above(0.0, 45.0), "and so far from its angle")
                .to_radians(),
            settle: Duration::from_secs_f64(s.number(
                "settle_seconds",
                0.1,
                "s",
                seconds,
                "it must be there and still for so long",
            )),
            timeout: Duration::from_secs_f64(s.number(
                "timeout_seconds",
                6.0,
                "s",
                within(0.1, 600.0),
                "an action that takes longer ends where it is",
            )),
            stuck: Duration::from_secs_f64(s.number(
                "stuck_seconds",
                0.6,
                "s",
                within(0.1, 60.0),
                "a robot that does not advance for so long is blocked",
            )),
            still: Velocity {
                linear: s.number("still", 0.02, "m/s", above(0.0, 1.0), "slower than this is still"),
                angular: s
                    .number("still_deg", 2.0, "degrees/s", above(0.0, 45.0), "slower than this is still")
                    .to_radians(),
            },
        };
        (control_hz, settings)
    }
}
