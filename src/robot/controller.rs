//! Actions out of velocities: a closed loop on odometry.
//!
//! An action turns, then drives straight ahead, each along a trapezoid of velocity: as fast as the limits allow, and never faster
//! than lets it stop at the end. It is over when odometry has been at the end and still for a while. It is *blocked* when
//! odometry does not advance although it should, when a bumper is pressed, or when a scan is too near (which
//! [`Safety`](super::Safety) tells).

use std::time::Duration;

use super::{Limits, Motion, Pose, Velocity, wrap};

/// Braking uses this share of the allowed acceleration, so that a robot that answers late still stops in time.
const BRAKING: f64 = 0.6;

/// Near its end a motion closes this share of what is left each second: odometry is a tenth of a second old or more.
const CLOSING_RATE: f64 = 4.0;

/// A heading that is wrong by a radian is corrected so fast while the robot drives ahead, radians a second.
const HEADING_RATE: f64 = 2.0;

/// A robot that goes less than this share of what it is told is stuck.
const STUCK: f64 = 0.25;

/// How actions are done.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionSettings {
    /// The most that is commanded.
    pub limits: Limits,
    /// How near to its end a way ahead is done, metres.
    pub tolerance: f64,
    /// How near to its end a turn is done, radians.
    pub turn_tolerance: f64,
    /// How long it must be there and still.
    pub settle: Duration,
    /// After this time an action ends wherever it is.
    pub timeout: Duration,
    /// A robot that does not advance for so long is blocked.
    pub stuck: Duration,
    /// Slower than this is still: metres a second, radians a second.
    pub still: Velocity,
}

/// How an action ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MotionEnd {
    /// Where it was to end.
    Done,
    /// Something was in the way.
    Blocked,
    /// It took too long.
    TimedOut,
}

/// What odometry says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Odometry {
    /// Where the robot is.
    pub pose: Pose,
    /// How fast it goes.
    pub velocity: Velocity,
}

/// One action on its way.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Controller {
    motion: Motion,
    /// When it began to move, which is when odometry was first heard.
    begun: Option<Duration>,
    last: Option<(Duration, Pose)>,
    /// What was done of it so far: metres along the way, radians.
    ahead: f64,
    turned: f64,
    /// Whether its turn is over.
    driving: bool,
    /// Since when it has been at its end and still.
    still_since: Option<Duration>,
    /// When it was last seen whether it advances, and how much was missing then.
    stuck_since: Option<(Duration, f64)>,
    /// Why it is to end as soon as the robot is still.
    ending: Option<MotionEnd>,
    ended: Option<MotionEnd>,
    /// What it wants now.
    wanted: Velocity,
}

impl Controller {
    /// An action that has not begun.
    pub fn new(motion: Motion) -> Self {
        Controller { motion, ..Controller::default() }
    }

    /// How it ended, once it did.
    pub fn ended(&self) -> Option<MotionEnd> {
        self.ended
    }

    /// How much of it is done, as a share.
    pub fn share(&self) -> f64 {
        match self.motion.distance == 0.0 {
            true => self.turned / self.motion.angle,
            false => self.ahead / self.motion.distance,
        }
    }

    /// Whether it is driving ahead, or wants to.
    pub fn advances(&self) -> bool {
        self.motion.distance != 0.0
    }

    /// Something is in the way: it ends as soon as the robot is still.
    pub fn obstruct(&mut self) {
        self.ending.get_or_insert(MotionEnd::Blocked);
    }

    /// The robot is kept from moving by something else than the world: that time does not count.
    pub fn wait(&mut self, seconds: Duration) {
        self.begun = self.begun.map(|begun| begun + seconds);
        self.stuck_since = None;
        self.still_since = None;
        self.wanted = Velocity::ZERO;
    }

    /// The velocity that is wanted after new odometry, at a time.
    pub fn step(&mut self, settings: &MotionSettings, now: Duration, odometry: &Odometry) -> Velocity {
        if self.ended.is_some() {
            return Velocity::ZERO;
        }
        let begun = *self.begun.get_or_insert(now);
        if let Some((_, before)) = self.last.replace((now, odometry.pose)) {
            let turned = wrap(odometry.pose.heading - before.heading);
            let between = Pose::new(before.position, before.heading + turned / 2.0);
            self.turned += turned;
            self.ahead += (odometry.pose.position - before.position).dot(&between.direction());
        }
        if self.ending.is_none() && now.saturating_sub(begun) >= settings.timeout {
            self.ending = Some(MotionEnd::TimedOut);
        }
        let turns_left = self.motion.angle - self.turned;
        // A turn is not resumed once the robot drives ahead: that corrects its course.
        if !self.driving && self.motion.distance != 0.0 && turns_left.abs() <= settings.turn_tolerance {
            (self.driving, self.ahead, self.stuck_since) = (true, 0.0, None);
        }
        let turning = !self.driving;
        let left = self.motion.distance - self.ahead;
        let there = match self.motion.distance == 0.0 {
            true => turns_left.abs() <= settings.turn_tolerance,
            false => self.driving && left.abs() <= settings.tolerance,
        };
        let slow = odometry.velocity.linear.abs() <= settings.still.linear
            && odometry.velocity.angular.abs() <= settings.still.angular;
        self.wanted = match (self.ending, turning) {
            (Some(_), _) => Velocity::ZERO,
            _ if there => Velocity::ZERO,
            (None, true) => Velocity {
                linear: 0.0,
                angular: approach(turns_left, settings.limits.turn_speed, settings.limits.turn_acceleration),
            },
            (None, false) => {
                let linear = approach(left, settings.limits.speed, settings.limits.acceleration);
                Velocity { linear, angular: HEADING_RATE * turns_left }
            }
        };
        let (missing, speed) = match turning {
            true => (turns_left.abs(), self.wanted.angular.abs()),
            false => (left.abs(), self.wanted.linear.abs()),
        };
        if self.ending.is_none() && !there && self.is_stuck(settings, now, missing, speed) {
            self.ending = Some(MotionEnd::Blocked);
            self.wanted = Velocity::ZERO;
        }
        if (there || self.ending.is_some()) && slow {
            let since = *self.still_since.get_or_insert(now);
            if now.saturating_sub(since) >= settings.settle {
                self.ended = Some(self.ending.unwrap_or(MotionEnd::Done));
            }
        } else {
            self.still_since = None;
        }
        // A robot that never gets still is not waited for.
        if self.ending.is_some() && now.saturating_sub(begun) >= 2 * settings.timeout {
            self.ended = self.ending;
        }
        self.wanted
    }

    /// Whether what is missing has become less by too little for long enough, at a speed that is wanted.
    fn is_stuck(&mut self, settings: &MotionSettings, now: Duration, missing: f64, speed: f64) -> bool {
        let (since, missing_then) = *self.stuck_since.get_or_insert((now, missing));
        let waited = now.saturating_sub(since);
        if waited < settings.stuck {
            return false;
        }
        self.stuck_since = Some((now, missing));
        // What is wanted now is less than what was before, near the end.
        missing_then - missing < STUCK * speed * waited.as_secs_f64()
    }
}

/// The speed at which what is left is approached.
fn approach(left: f64, most: f64, acceleration: f64) -> f64 {
    let stops_in_time = (2.0 * BRAKING * acceleration * left.abs()).sqrt();
    left.signum() * stops_in_time.min(CLOSING_RATE * left.abs()).min(most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;
    use std::collections::VecDeque;

    const PERIOD: Duration = Duration::from_millis(50);

    fn settings() -> MotionSettings {
        MotionSettings {
            limits: Limits { speed: 0.4, turn_speed: 1.4, acceleration: 0.8, turn_acceleration: 2.8 },
            tolerance: 0.01,
            turn_tolerance: 0.017,
            settle: Duration::from_millis(100),
            timeout: Duration::from_secs(6),
            stuck: Duration::from_millis(600),
            still: Velocity { linear: 0.02, angular: 0.035 },
        }
    }

    /// A robot that heeds commands late, and stops at a wall in front of it.
    struct Late {
        commands: VecDeque<Velocity>,
        odometry: Odometry,
        wall: f64,
    }

    impl Late {
        fn new(delay: usize, wall: f64) -> Self {
            let odometry = Odometry { pose: Pose::new(Point2::origin(), 0.3), velocity: Velocity::ZERO };
            Late { commands: vec![Velocity::ZERO; delay].into(), odometry, wall }
        }

        fn go(&mut self, command: Velocity) {
            self.commands.push_back(command);
            let mut velocity = self.commands.pop_front().unwrap();
            let seconds = PERIOD.as_secs_f64();
            let Pose { position, heading } = self.odometry.pose;
            let direction = Pose::new(position, heading + velocity.angular * seconds / 2.0).direction();
            if (position + direction * velocity.linear * seconds).x > self.wall {
                velocity.linear = 0.0;
            }
            let pose =
                Pose::new(position + direction * velocity.linear * seconds, heading + velocity.angular * seconds);
            self.odometry = Odometry { pose, velocity };
        }
    }

    /// Does a motion with a robot: how it ended, how long it took, and where the robot is.
    fn act(motion: Motion, mut robot: Late) -> (MotionEnd, f64, Pose) {
        let (settings, mut controller) = (settings(), Controller::new(motion));
        let mut command = Velocity::ZERO;
        for step in 0..1000 {
            let wanted = controller.step(&settings, PERIOD * step, &robot.odometry);
            if let Some(end) = controller.ended() {
                assert_eq!(wanted, Velocity::ZERO);
                return (end, PERIOD.as_secs_f64() * f64::from(step), robot.odometry.pose);
            }
            command = settings.limits.apply(command, wanted, PERIOD.as_secs_f64());
            robot.go(command);
        }
        panic!("{motion:?} never ends")
    }

    #[test]
    fn actions_end_where_they_should_although_commands_are_heeded_late() {
        for delay in [0, 1, 2] {
            for (distance, angle) in [(0.3, 0.0), (0.0, 0.785), (0.0, -0.785), (1.2, 0.0), (0.05, 0.0), (0.3, 0.5)] {
                let (end, seconds, pose) = act(Motion { distance, angle }, Late::new(delay, f64::INFINITY));
                let there = Pose::new(Point2::origin(), 0.3 + angle);
                let miss = (pose.position - there.direction() * distance).coords.norm();
                assert_eq!(end, MotionEnd::Done);
                let places = format!("{distance} m, {angle}, {delay} late: {miss} m off, {seconds} s");
                assert!(miss < 0.02 && wrap(pose.heading - 0.3 - angle).abs() < 0.03 && seconds < 5.0, "{places}");
            }
        }
        let (_, seconds, _) = act(Motion { distance: 0.3, angle: 0.0 }, Late::new(1, f64::INFINITY));
        assert!(seconds < 2.5, "{seconds} s for 0.3 m");
    }

    #[test]
    fn what_does_not_advance_is_blocked_and_what_takes_too_long_ends() {
        for wall in [0.0, 0.1, 0.2] {
            let (end, seconds, pose) = act(Motion { distance: 0.3, angle: 0.0 }, Late::new(1, wall));
            assert!(
                end == MotionEnd::Blocked && seconds < 3.0 && pose.position.x <= wall,
                "{wall} m: {end:?} {seconds}"
            );
        }
        let (end, seconds, _) = act(Motion { distance: 9.0, angle: 0.0 }, Late::new(1, f64::INFINITY));
        assert!(end == MotionEnd::TimedOut && (6.0..7.0).contains(&seconds), "{end:?} {seconds}");
        let mut controller = Controller::new(Motion { distance: 0.3, angle: 0.0 });
        controller.obstruct();
        let still = Late::new(0, 1.0).odometry;
        for step in 0..4 {
            assert_eq!(controller.step(&settings(), PERIOD * step, &still), Velocity::ZERO);
        }
        assert_eq!(controller.ended(), Some(MotionEnd::Blocked));
        assert_eq!(controller.share(), 0.0);
    }

    #[test]
    fn time_in_which_it_may_not_move_does_not_count() {
        let (settings, mut robot) = (settings(), Late::new(0, 9.0));
        let mut controller = Controller::new(Motion { distance: 0.3, angle: 0.0 });
        for step in 0..1000 {
            let wanted = controller.step(&settings, PERIOD * step, &robot.odometry);
            if step < 500 {
                controller.wait(PERIOD);
                robot.go(Velocity::ZERO);
            } else {
                robot.go(wanted);
            }
        }
        assert_eq!(controller.ended(), Some(MotionEnd::Done));
    }
}
