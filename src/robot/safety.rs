//! What stands between the agent and the wheels: a state machine whose resting state is zero velocity.
//!
//! It knows no clock but the times that it is told, and those must be of a steady clock. It is told what the sensors say, and asked
//! at each control step which velocity may be commanded. The table of its states:
//!
//! | state | velocity | until |
//! |---|---|---|
//! | standing | zero | an action is ordered, or a person drives |
//! | driving | what the action wants, within the limits | the action is over, or there is a cause to stop |
//! | driven | what the person wants, within the limits | the person's topic is silent, or there is a cause to stop |
//! | stopped | zero | there is no cause any more, and the robot is still |
//! | held | zero | a person lets it go on, and there is no cause |
//! | ended | zero | never |
//!
//! A stop is zero at once: how fast the robot brakes is the base's to say. All other changes of the velocity are within the limits.

use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::{Limits, Odometry, Velocity};
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// What is being done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DriveState {
    /// Nothing is to be done.
    #[default]
    Standing,
    /// An action of the agent.
    Driving,
    /// What a person wants.
    Driven,
    /// It waits until there is no cause any more.
    Stopped,
    /// It waits until a person lets it go on.
    Held,
    /// The run is over.
    Ended,
}

impl DriveState {
    /// As texts have it.
    pub fn name(self) -> &'static str {
        match self {
            DriveState::Standing => "standing",
            DriveState::Driving => "driving",
            DriveState::Driven => "driven by a person",
            DriveState::Stopped => "stopped",
            DriveState::Held => "held",
            DriveState::Ended => "ended",
        }
    }
}

/// Why the robot may not move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u16)]
pub enum Cause {
    /// No camera image is fresh.
    Camera = 1,
    /// The robot moved, and the camera's pixels did not change.
    Frozen = 1 << 1,
    /// No odometry is fresh.
    Odometry = 1 << 2,
    /// No scan is fresh.
    Scan = 1 << 3,
    /// The emergency stop is pressed.
    EmergencyStop = 1 << 4,
    /// The topic of the emergency stop is silent.
    EmergencyStopSilent = 1 << 5,
    /// The robot is locked, or the topic of the lock is silent.
    Lock = 1 << 6,
    /// Something is nearer than the stopping distance in the direction of motion.
    Near = 1 << 7,
    /// The run is paused.
    Paused = 1 << 8,
    /// The battery is low.
    Battery = 1 << 9,
    /// The run is over.
    Ended = 1 << 10,
}

impl Cause {
    /// All of them, as texts have them.
    const NAMES: [(Cause, &str); 11] = [
        (Cause::Camera, "no fresh camera image"),
        (Cause::Frozen, "the camera is frozen"),
        (Cause::Odometry, "no fresh odometry"),
        (Cause::Scan, "no fresh scan"),
        (Cause::EmergencyStop, "the emergency stop is pressed"),
        (Cause::EmergencyStopSilent, "the emergency stop is silent"),
        (Cause::Lock, "locked"),
        (Cause::Near, "something is too near"),
        (Cause::Paused, "the run is paused"),
        (Cause::Battery, "the battery is low"),
        (Cause::Ended, "the run is over"),
    ];
}

/// Some causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct Causes(u16);

impl Causes {
    /// No cause.
    pub const NONE: Causes = Causes(0);

    /// With one more.
    pub fn with(self, cause: Cause) -> Self {
        Causes(self.0 | cause as u16)
    }

    /// Whether a cause is among them.
    pub fn has(self, cause: Cause) -> bool {
        self.0 & cause as u16 != 0
    }

    /// Whether there is none.
    pub fn is_none(self) -> bool {
        self.0 == 0
    }

    fn set(&mut self, cause: Cause, holds: bool) {
        if holds {
            self.0 |= cause as u16;
        }
    }
}

impl fmt::Display for Causes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = Cause::NAMES.into_iter().filter(|of| self.has(of.0)).map(|of| of.1).collect();
        f.write_str(&names.join(", "))
    }
}

/// When the robot may move; by default never.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SafetySettings {
    /// The most that is commanded.
    pub limits: Limits,
    /// Age at which a camera image, odometry or a scan is stale.
    pub fresh: Duration,
    /// Whether there are scans.
    pub scan: bool,
    /// Whether there is an emergency stop, and how long its topic may be silent.
    pub emergency_stop: Option<Duration>,
    /// Whether there is a lock, and how long its topic may be silent.
    pub lock: Option<Duration>,
    /// A person's topic that is silent for so long: nobody drives any more.
    pub teleop: Duration,
    /// Whether a person must let the robot go on after each stop.
    pub hold: bool,
    /// What must be left between the robot and what is ahead when it has stopped, metres.
    pub margin: f64,
    /// How long the robot goes on before a command to stop is heeded.
    pub reaction: Duration,
    /// Slower than this is still: metres a second, radians a second.
    pub still: Velocity,
    /// Charge below which the battery is low, as a share; 0: never.
    pub battery: f64,
    /// Charge below which the robot stands, as a share; 0: never.
    pub battery_empty: f64,
}

/// The camera counts as frozen after so much motion without a change of its pixels: metres, radians.
const FROZEN_AFTER: [f64; 2] = [0.08, 0.15];

/// A camera that was frozen, and does not change while the robot stands, is tried again after this time.
const TRY_AGAIN: Duration = Duration::from_secs(3);

/// A robot that comes near to something slows down so as to need this share of the way that it has.
const WELL_BEFORE: f64 = 0.7;

/// A silent topic, or one that was never heard.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Heard(Option<Duration>);

impl Heard {
    fn is_within(self, now: Duration, bound: Duration) -> bool {
        self.0.is_some_and(|at| now.saturating_sub(at) <= bound)
    }
}

impl Persist for Safety {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let [moved, turned] = self.unchanged;
        let velocities = [self.person, self.velocity, self.command].map(|of| [of.linear, of.angular]);
        let mut numbers = vec![self.ahead, self.behind, moved, turned];
        numbers.extend(velocities.as_flattened());
        snapshot.numbers("numbers", &mut numbers)?;
        let [ahead, behind, moved, turned, a, b, c, d, e, f] = numbers[..] else {
            return snapshot.check("numbers", false, "not ten numbers");
        };
        (self.ahead, self.behind, self.unchanged) = (ahead, behind, [moved, turned]);
        let velocity = |linear, angular| Velocity { linear, angular };
        (self.person, self.velocity, self.command) = (velocity(a, b), velocity(c, d), velocity(e, f));
        snapshot.value("camera", &mut self.camera.0)?;
        snapshot.value("odometry", &mut self.odometry.0)?;
        snapshot.value("scan", &mut self.scan.0)?;
        snapshot.value("emergency_stop", &mut self.emergency_stop.0)?;
        snapshot.value("lock", &mut self.lock.0)?;
        snapshot.value("teleop", &mut self.teleop.0)?;
        snapshot.value("frozen_since", &mut self.frozen_since)?;
        snapshot.value("commanded", &mut self.commanded)?;
        let mut flags = [self.pressed, self.locked, self.battery_low, self.battery_empty, self.released];
        snapshot.value("flags", &mut flags)?;
        [self.pressed, self.locked, self.battery_low, self.battery_empty, self.released] = flags;
        snapshot.value("state", &mut self.state)?;
        snapshot.value("causes", &mut self.causes.0)
    }
}

/// What the sensors said last, and what is to be done.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Safety {
    settings: SafetySettings,
    state: DriveState,
    causes: Causes,
    camera: Heard,
    odometry: Heard,
    scan: Heard,
    emergency_stop: Heard,
    pressed: bool,
    lock: Heard,
    locked: bool,
    teleop: Heard,
    person: Velocity,
    velocity: Velocity,
    ahead: f64,
    behind: f64,
    /// Motion since the camera's pixels last changed: metres, radians.
    unchanged: [f64; 2],
    frozen_since: Option<Duration>,
    battery_low: bool,
    battery_empty: bool,
    paused: bool,
    ended: bool,
    /// A person has said that it may go on.
    released: bool,
    /// What was commanded last, and when.
    command: Velocity,
    commanded: Option<Duration>,
}

impl Safety {
    /// A robot that stands, and of which nothing was heard.
    pub fn new(settings: SafetySettings) -> Self {
        Safety { settings, ahead: f64::INFINITY, behind: f64::INFINITY, ..Safety::default() }
    }

    /// A camera image was taken at a time; whether its pixels are others than those of the one before.
    pub fn see(&mut self, taken: Duration, changed: bool) {
        self.camera = Heard(self.camera.0.max(Some(taken)));
        if changed {
            (self.unchanged, self.frozen_since) = ([0.0; 2], None);
        }
    }

    /// Odometry was measured at a time.
    pub fn hear_odometry(&mut self, measured: Duration, odometry: &Odometry) {
        if let Some(before) = self.odometry.0 {
            let seconds = measured.saturating_sub(before).as_secs_f64();
            self.unchanged[0] += odometry.velocity.linear.abs() * seconds;
            self.unchanged[1] += odometry.velocity.angular.abs() * seconds;
        }
        self.odometry = Heard(self.odometry.0.max(Some(measured)));
        self.velocity = odometry.velocity;
    }

    /// A scan was taken at a time: what is free in front of the robot and behind it, metres from its rim.
    pub fn hear_scan(&mut self, taken: Duration, ahead: f64, behind: f64) {
        self.scan = Heard(self.scan.0.max(Some(taken)));
        (self.ahead, self.behind) = (ahead, behind);
    }

    /// The robot's clock has gone ahead of ours, or has fallen behind, by so many seconds. Where that is more than what may be
    /// stale, nothing that was sensed counts as fresh: it must come in again.
    pub fn doubt_times(&mut self, seconds: f64) {
        if seconds.abs() > self.settings.fresh.as_secs_f64() {
            (self.camera, self.odometry, self.scan) = (Heard(None), Heard(None), Heard(None));
        }
    }

    /// The emergency stop says whether it is pressed.
    pub fn hear_emergency_stop(&mut self, at: Duration, pressed: bool) {
        (self.emergency_stop, self.pressed) = (Heard(Some(at)), pressed);
    }

    /// The lock says whether it locks.
    pub fn hear_lock(&mut self, at: Duration, locked: bool) {
        (self.lock, self.locked) = (Heard(Some(at)), locked);
    }

    /// A person drives.
    pub fn hear_person(&mut self, at: Duration, wanted: Velocity) {
        // What is no number is nobody's wish.
        if wanted.is_finite() {
            (self.teleop, self.person) = (Heard(Some(at)), wanted);
        }
    }

    /// The battery's charge, as a share. Whether it has become low with that.
    pub fn hear_battery(&mut self, charge: f64) -> bool {
        let was = std::mem::replace(&mut self.battery_low, charge < self.settings.battery);
        self.battery_empty = charge < self.settings.battery_empty;
        self.battery_low && !was
    }

    /// The run is paused, or goes on.
    pub fn pause(&mut self, paused: bool) {
        self.paused = paused;
    }

    /// A person lets the robot go on.
    pub fn release(&mut self) {
        self.released = true;
    }

    /// The run is over, whatever comes.
    pub fn end(&mut self) {
        self.ended = true;
    }

    /// What is being done.
    pub fn state(&self) -> DriveState {
        self.state
    }

    /// Why the robot may not move.
    pub fn causes(&self) -> Causes {
        self.causes
    }

    /// Whether the robot is still, by what was heard last.
    pub fn is_still(&self) -> bool {
        let still = self.settings.still;
        self.velocity.linear.abs() <= still.linear && self.velocity.angular.abs() <= still.angular
    }

    /// Whether odometry and camera are fresh at a time.
    pub fn is_fresh(&self, now: Duration) -> bool {
        let fresh = self.settings.fresh;
        self.camera.is_within(now, fresh) && self.odometry.is_within(now, fresh)
    }

    /// A wanted velocity, as slow as it must be to stop before what is ahead.
    pub fn slow_down(&self, wanted: Velocity) -> Velocity {
        let settings = &self.settings;
        let free = match wanted.linear >= 0.0 {
            true => self.ahead,
            false => self.behind,
        };
        let left = WELL_BEFORE * (free - settings.margin);
        if !settings.scan || !left.is_finite() {
            return wanted;
        }
        // v t + v² / 2a = left.
        let (braking, reaction) = (settings.limits.acceleration, settings.reaction.as_secs_f64());
        let most = braking * ((reaction * reaction + 2.0 * left.max(0.0) / braking).sqrt() - reaction);
        Velocity { linear: wanted.linear.clamp(-most, most), ..wanted }
    }

    /// The velocity that may be commanded at a time, where the agent wants some; nothing wanted is no action.
    pub fn step(&mut self, now: Duration, wanted: Option<Velocity>) -> Velocity {
        let driven = self.teleop.is_within(now, self.settings.teleop);
        let wish = if driven { Some(self.person) } else { wanted };
        // Longer than a command holds is not driving on: it begins anew, from what the robot does.
        let since = self.commanded.replace(now).map_or(Duration::ZERO, |at| now.saturating_sub(at));
        let seconds = since.min(self.settings.fresh).as_secs_f64();
        let within = wish.map_or(Velocity::ZERO, |wish| self.settings.limits.apply(self.command, wish, seconds));
        self.causes = self.causes_at(now, within);
        self.state = self.next(driven, wanted.is_some());
        let moves = matches!(self.state, DriveState::Driving | DriveState::Driven);
        self.command = if moves { within } else { Velocity::ZERO };
        self.command
    }

    fn next(&mut self, driven: bool, ordered: bool) -> DriveState {
        let released = std::mem::take(&mut self.released);
        if self.ended {
            return DriveState::Ended;
        }
        // What is too near ends an action; a person may turn away from it.
        let stops = !Causes(self.causes.0 & !(Cause::Near as u16)).is_none();
        let at_work = match (driven, ordered) {
            (true, _) => DriveState::Driven,
            (false, true) => DriveState::Driving,
            (false, false) => DriveState::Standing,
        };
        let moved = matches!(self.state, DriveState::Driving | DriveState::Driven);
        let only_paused = self.causes == Causes::NONE.with(Cause::Paused);
        match self.state {
            DriveState::Held if stops || !released => DriveState::Held,
            // A pause is a person's, who ends it.
            _ if stops && moved && self.settings.hold && !only_paused => DriveState::Held,
            _ if stops => DriveState::Stopped,
            // It may still roll.
            DriveState::Stopped if !self.is_still() => DriveState::Stopped,
            _ if self.causes.has(Cause::Near) => DriveState::Stopped,
            _ => at_work,
        }
    }

    fn causes_at(&mut self, now: Duration, wanted: Velocity) -> Causes {
        let settings = &self.settings;
        let mut causes = Causes::NONE;
        causes.set(Cause::Camera, !self.camera.is_within(now, settings.fresh));
        causes.set(Cause::Odometry, !self.odometry.is_within(now, settings.fresh));
        causes.set(Cause::Scan, settings.scan && !self.scan.is_within(now, settings.fresh));
        if let Some(bound) = settings.emergency_stop {
            causes.set(Cause::EmergencyStop, self.pressed);
            causes.set(Cause::EmergencyStopSilent, !self.emergency_stop.is_within(now, bound));
        }
        if let Some(bound) = settings.lock {
            causes.set(Cause::Lock, self.locked || !self.lock.is_within(now, bound));
        }
        let moved = self.unchanged.iter().zip(FROZEN_AFTER).any(|(moved, most)| *moved > most);
        if moved && self.frozen_since.is_none() {
            self.frozen_since = Some(now);
        }
        if self.frozen_since.is_some_and(|since| now.saturating_sub(since) >= TRY_AGAIN) {
            // A picture without noise does not change while the robot stands.
            (self.unchanged, self.frozen_since) = ([0.0; 2], None);
        }
        causes.set(Cause::Frozen, self.frozen_since.is_some());
        causes.set(Cause::Paused, self.paused);
        causes.set(Cause::Battery, self.battery_empty);
        causes.set(Cause::Ended, self.ended);
        causes.set(Cause::Near, self.is_near(wanted));
        causes
    }

    /// Whether something is nearer than the way to a stop, in the direction of a velocity.
    fn is_near(&self, wanted: Velocity) -> bool {
        let settings = &self.settings;
        let free = match wanted.linear {
            ahead if ahead > 0.0 => self.ahead,
            back if back < 0.0 => self.behind,
            _ => return false,
        };
        let speed = wanted.linear.abs().max(self.velocity.linear.abs());
        let braking = speed * speed / (2.0 * settings.limits.acceleration);
        settings.scan && free < speed * settings.reaction.as_secs_f64() + braking + settings.margin
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;
    use crate::robot::Pose;
    use nalgebra::Point2;
    use rand::RngExt;

    const LIMITS: Limits = Limits { speed: 0.5, turn_speed: 1.5, acceleration: 1.0, turn_acceleration: 3.0 };

    fn settings(hold: bool) -> SafetySettings {
        SafetySettings {
            limits: LIMITS,
            fresh: ms(250),
            scan: true,
            emergency_stop: Some(ms(1000)),
            lock: Some(ms(500)),
            teleop: ms(800),
            hold,
            margin: 0.05,
            reaction: ms(150),
            still: Velocity { linear: 0.02, angular: 0.03 },
            battery: 0.4,
            battery_empty: 0.2,
        }
    }

    fn ms(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    fn moving(linear: f64) -> Odometry {
        let velocity = Velocity { linear, angular: 0.0 };
        Odometry { pose: Pose::new(Point2::origin(), 0.0), velocity }
    }

    /// What was told, in the plainest form: the rules are checked against this and not against the machine's own memory.
    #[derive(Default, Clone, Copy)]
    struct Told {
        camera: Option<Duration>,
        odometry: Option<Duration>,
        scan: Option<(Duration, f64, f64)>,
        emergency_stop: Option<(Duration, bool)>,
        lock: Option<(Duration, bool)>,
        person: Option<(Duration, Velocity)>,
        battery: Option<f64>,
        paused: bool,
        ended: bool,
    }

    impl Told {
        fn must_stand(&self, now: Duration) -> bool {
            let old = |at: Duration, bound: u64| now - at > ms(bound);
            self.camera.is_none_or(|at| old(at, 250))
                || self.odometry.is_none_or(|at| old(at, 250))
                || self.scan.is_none_or(|(at, ..)| old(at, 250))
                || self.emergency_stop.is_none_or(|(at, pressed)| pressed || old(at, 1000))
                || self.lock.is_none_or(|(at, locked)| locked || old(at, 500))
                || self.battery.is_some_and(|charge| charge < 0.2)
                || self.paused
                || self.ended
        }
    }

    /// Random events; after each step all that must always hold is checked. Returns how often the robot moved, and in which
    /// states it was.
    fn random_events(seed: u64, events: usize, hold: bool) -> (usize, Vec<DriveState>) {
        let mut rng = stream(seed, "events");
        let (mut safety, mut told, mut now) = (Safety::new(settings(hold)), Told::default(), Duration::ZERO);
        let (mut last, mut last_step, mut held) = (Velocity::ZERO, None::<Duration>, false);
        let (mut moved, mut states) = (0, Vec::new());
        // Troubles come seldom, else nothing ever moves.
        let mut trouble = 0_usize;
        for event in 0..events {
            now += Duration::from_micros(rng.random_range(0..20_000));
            if trouble == 0 && rng.random_range(0..400) == 0 {
                trouble = rng.random_range(1..60);
            }
            trouble = trouble.saturating_sub(1);
            let bad = trouble > 0 && rng.random_range(0..3) == 0;
            let late = Duration::from_millis(if bad { rng.random_range(0..600) } else { 0 });
            let at = now.saturating_sub(late);
            if trouble == 0 || rng.random_range(0..4) == 0 {
                safety.see(at, !bad);
                told.camera = told.camera.max(Some(at));
                let speed = rng.random_range(-0.1..0.5);
                safety.hear_odometry(at, &moving(speed));
                told.odometry = told.odometry.max(Some(at));
                let near = if bad { rng.random_range(0.0..0.6) } else { 3.0 };
                safety.hear_scan(at, near, near);
                told.scan = Some((told.scan.map_or(at, |(before, ..)| before.max(at)), near, speed));
                safety.hear_emergency_stop(at, bad);
                told.emergency_stop = Some((at, bad));
                safety.hear_lock(at, bad);
                told.lock = Some((at, bad));
            }
            let wild = |rng: &mut rand_chacha::ChaCha8Rng| match rng.random_range(0..20) {
                0 => f64::NAN,
                1 => f64::INFINITY,
                _ => rng.random_range(-2.0..2.0),
            };
            match rng.random_range(0..3000) {
                0..200 => {
                    let wanted = Velocity { linear: wild(&mut rng), angular: wild(&mut rng) };
                    safety.hear_person(now, wanted);
                    if wanted.is_finite() {
                        told.person = Some((now, wanted));
                    }
                }
                200 => {
                    told.paused = true;
                    safety.pause(true);
                }
                201..260 => {
                    told.paused = false;
                    safety.pause(false);
                }
                260..300 => {
                    safety.release();
                    held = false;
                }
                300 => {
                    let charge = rng.random_range(0.0..1.0);
                    told.battery = Some(charge);
                    safety.hear_battery(charge);
                }
                301..330 => {
                    told.battery = Some(1.0);
                    safety.hear_battery(1.0);
                }
                331..341 => {
                    safety.doubt_times(if event % 2 == 0 { 9.0 } else { -9.0 });
                    (told.camera, told.odometry, told.scan) = (None, None, None);
                }
                330 if event > events * 9 / 10 => {
                    told.ended = true;
                    safety.end();
                }
                _ => {}
            }
            let wanted =
                (rng.random_range(0..5) > 0).then(|| Velocity { linear: wild(&mut rng), angular: wild(&mut rng) });
            let before = safety.state();
            let velocity = safety.step(now, wanted);
            let state = safety.state();
            let place = format!("seed {seed}, event {event}: {velocity:?} in {state:?}, {:?}", safety.causes());
            assert!(velocity.is_finite(), "{place}");
            if told.must_stand(now) {
                assert!(velocity.is_zero(), "{place}");
            }
            let person = told.person.is_some_and(|(at, _)| now - at <= ms(800));
            if !velocity.is_zero() {
                moved += 1;
                assert!(wanted.is_some() || person, "{place}: nobody wants it");
                assert!(matches!(state, DriveState::Driving | DriveState::Driven), "{place}");
                assert_eq!(state == DriveState::Driven, person, "{place}: a person wins");
                // Within the limits, and their changes too; a stop alone is at once.
                assert!(
                    velocity.linear.abs() <= LIMITS.speed && velocity.angular.abs() <= LIMITS.turn_speed,
                    "{place}"
                );
                let seconds = last_step.map_or(0.0, |at: Duration| (now - at).as_secs_f64());
                let change = (velocity.linear - last.linear).abs();
                assert!(change <= LIMITS.acceleration * seconds + 1e-12, "{place}");
                let change = (velocity.angular - last.angular).abs();
                assert!(change <= LIMITS.turn_acceleration * seconds + 1e-12, "{place}");
                let (_, near, speed) = told.scan.unwrap();
                let way = velocity.linear.abs().max(speed.abs());
                let stopping = way * 0.15 + way * way / (2.0 * LIMITS.acceleration) + 0.05;
                assert!(velocity.linear == 0.0 || near >= stopping - 1e-12, "{place}: {near} m are free");
            }
            // A state with a cause has one, and standing has none.
            assert_eq!(state == DriveState::Ended, told.ended, "{place}");
            assert!(state != DriveState::Standing || !told.must_stand(now), "{place}");
            if hold && held && state != DriveState::Ended {
                assert!(state == DriveState::Held, "{place}: nobody let it go on");
            }
            held |= state == DriveState::Held;
            if before == DriveState::Held && state != DriveState::Held {
                held = false;
            }
            if states.last() != Some(&state) {
                states.push(state);
            }
            (last, last_step) = (velocity, Some(now));
        }
        (moved, states)
    }

    #[test]
    fn whatever_happens_the_robot_moves_only_when_it_may() {
        for (seed, hold) in [(1, false), (2, true)] {
            let (moved, states) = random_events(seed, 1_000_000, hold);
            assert!(moved > 100_000, "it moved in {moved} steps");
            for state in [DriveState::Standing, DriveState::Driving, DriveState::Driven, DriveState::Stopped] {
                assert!(states.contains(&state), "{state:?} never was");
            }
            assert_eq!(states.contains(&DriveState::Held), hold);
            assert_eq!(states.last(), Some(&DriveState::Ended));
        }
    }

    /// All is well at a time.
    fn well(safety: &mut Safety, now: Duration, changed: bool, speed: f64) {
        safety.see(now, changed);
        safety.hear_odometry(now, &moving(speed));
        safety.hear_scan(now, 9.0, 9.0);
        safety.hear_emergency_stop(now, false);
        safety.hear_lock(now, false);
    }

    const AHEAD: Option<Velocity> = Some(Velocity { linear: 0.5, angular: 0.0 });

    #[test]
    fn a_camera_that_is_frozen_stops_the_robot_and_is_tried_again() {
        let mut safety = Safety::new(settings(false));
        let (mut stopped, mut again, mut way) = (None, None, 0.0);
        for step in 0..200 {
            let now = ms(50 * step);
            let velocity = safety.step(now, AHEAD);
            way += velocity.linear * 0.05;
            well(&mut safety, now, step < 40, velocity.linear);
            if step > 40 && velocity.is_zero() && stopped.is_none() {
                stopped = Some((step, std::mem::take(&mut way)));
                assert!(safety.causes().has(Cause::Frozen));
            }
            if stopped.is_some() && !velocity.is_zero() && again.is_none() {
                again = Some(step);
            }
        }
        let (step, _) = stopped.unwrap();
        assert!(step < 40 + 8, "it drove on for {} steps", step - 40);
        assert!((step + 60..step + 64).contains(&again.unwrap()), "{again:?}");
    }

    #[test]
    fn a_stop_is_at_once_and_going_on_waits_until_the_robot_is_still() {
        let mut safety = Safety::new(settings(false));
        for step in 0..20 {
            well(&mut safety, ms(50 * step), true, 0.4);
            safety.step(ms(50 * step), AHEAD);
        }
        assert_eq!(safety.state(), DriveState::Driving);
        safety.hear_emergency_stop(ms(960), true);
        assert_eq!((safety.step(ms(960), AHEAD), safety.state()), (Velocity::ZERO, DriveState::Stopped));
        assert_eq!(safety.causes().to_string(), "the emergency stop is pressed");
        well(&mut safety, ms(1000), true, 0.2);
        assert_eq!((safety.step(ms(1000), AHEAD), safety.state()), (Velocity::ZERO, DriveState::Stopped));
        well(&mut safety, ms(1050), true, 0.0);
        safety.step(ms(1050), AHEAD);
        assert_eq!(safety.state(), DriveState::Driving);
    }
}
