//! From readings to frames and velocities, step by step.
//!
//! [`Drive`] joins [`Controller`] and [`Safety`]: it is told everything that comes in, and asked at each control step which
//! velocity to command. It knows no clock, thread or network: the same code drives a simulated body and a robot.
//!
//! Frames are the images at the scenario's interval while an action goes on. An action ends with the first image that was taken
//! after the robot stood still; nothing more is taken until the next action. Where the robot was moved between two actions, or its
//! odometry has jumped, the next frame belongs to no action: what was before it has nothing to do with it.

use std::collections::VecDeque;
use std::hash::{DefaultHasher, Hasher};
use std::sync::Arc;
use std::time::Duration;

use nalgebra::Point2;

use super::base::{Reading, Received, Scan};
use crate::robot::{
    Action, ActionSet, Cause, Causes, Controller, DriveState, MotionEnd, Odometry, Pose, RobotClock, Safety, Stamps,
    Velocity, wrap,
};
use crate::scenario::{Equipment, Motion, Scenario};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::source::{Boundary, Frame, Mark, Rule, Segmenter, View, of_log};
use crate::vision::Image;

/// Poses that are kept for images that come in later than these, nanoseconds.
const KEPT_NS: u64 = 2_000_000_000;

/// Images are taken that come a little before their time, as a share of the interval.
const EARLY: f64 = 0.1;

/// A robot was moved between two actions if it is farther from where it stood: metres, radians.
const MOVED: [f64; 2] = [0.05, 0.1];

/// Images under a person's hand that may wait until it is known of which action they are.
const MOST_HELD: usize = 200;

/// Odometry that goes so many times as fast as the limits allow, and this far besides, has jumped: metres, radians.
const JUMP: (f64, [f64; 2]) = (3.0, [0.2, 0.5]);

/// What is to be logged as it happens.
#[derive(Debug, Clone)]
pub enum Event {
    /// What came in, as it came; images are not among them.
    Heard(Received),
    /// A velocity was commanded.
    Commanded {
        /// By the robot's clock, nanoseconds since 1970, as far as it is known.
        stamp_ns: u64,
        /// The velocity.
        velocity: Velocity,
    },
    /// What is being done has changed.
    Changed {
        /// By the robot's clock, nanoseconds since 1970, as far as it is known.
        stamp_ns: u64,
        /// What is being done now.
        state: DriveState,
        /// Why the robot may not move.
        causes: Causes,
    },
    /// Something worth a word.
    Note {
        /// By the robot's clock, nanoseconds since 1970, as far as it is known.
        stamp_ns: u64,
        /// The words.
        text: String,
    },
}

#[derive(Debug, Clone)]
enum Phase {
    /// It waits for an action.
    Idle,
    /// It stands or is to stand, and the next image says where.
    Look,
    /// An action is on its way.
    Doing { action: Action, controller: Controller },
    /// A person drives: what that is is told when it is done.
    Driven(Box<Hand>),
    /// An action is over; the first image that was taken since then ends it.
    Ending { action: Action, blocked: bool, from: Duration },
}

/// What was sensed when an image was taken.
#[derive(Debug, Clone)]
struct Seen {
    stamp_ns: u64,
    taken: Duration,
    image: Image,
    odometry: Pose,
    truth: Option<Pose>,
    sonar: Vec<f32>,
    marks: Vec<Mark>,
}

/// Motion under a person's hand, cut into actions as that of bags.
#[derive(Debug, Clone, Default)]
struct Hand {
    segmenter: Segmenter,
    /// Images that belong to no action yet, and before them the last one of the action before.
    held: VecDeque<Seen>,
    /// Whether that last one was given.
    given: bool,
}

/// Readings in, frames and velocities out.
pub struct Drive {
    scenario: Arc<Scenario>,
    motion: Motion,
    actions: ActionSet,
    interval: Duration,
    /// What an action is when a person drives.
    rule: Rule,
    safety: Safety,
    clock: RobotClock,
    phase: Phase,
    images: Stamps,
    odometries: Stamps,
    scans: Stamps,
    /// Odometry and true poses of the last seconds, by stamp.
    odometry: VecDeque<(u64, Odometry)>,
    poses: VecDeque<(u64, Pose)>,
    sonar: Vec<f32>,
    rewards: Vec<f64>,
    marks: Vec<Mark>,
    /// A number for the pixels of the newest image.
    pixels: Option<u64>,
    bumper: bool,
    /// The battery has become low, and nobody was told yet.
    battery_low: bool,
    /// When the newest odometry was measured, by our clock.
    measured: Duration,
    number: u64,
    /// Stamp of the newest frame, and when it was taken by our clock.
    taken_ns: Option<u64>,
    taken: Option<Duration>,
    /// Where odometry was when an action ended.
    stood: Option<Pose>,
    told: (DriveState, Causes),
    last_step: Option<Duration>,
    frames: VecDeque<Frame>,
    events: VecDeque<Event>,
}

impl Drive {
    /// A robot of which nothing was heard; its frames come behind `last`, the number and the stamp of one that is recorded.
    pub fn new(scenario: Arc<Scenario>, motion: Motion, equipment: Equipment, last: Option<(u64, u64)>) -> Self {
        let settings = motion.safety_of(equipment);
        let any_reward = scenario.tasks.iter().any(|task| task.topic.is_some());
        Drive {
            actions: scenario.robot.actions.clone(),
            interval: Duration::from_secs_f64(scenario.robot.frame_seconds()),
            rule: Rule::of(&scenario.robot),
            safety: Safety::new(settings),
            clock: RobotClock::default(),
            phase: Phase::Look,
            images: Stamps::default(),
            odometries: Stamps::default(),
            scans: Stamps::default(),
            odometry: VecDeque::new(),
            poses: VecDeque::new(),
            sonar: vec![scenario.robot.sonar_range as f32; scenario.robot.sonars],
            rewards: vec![f64::NAN; if any_reward { scenario.tasks.len() } else { 0 }],
            marks: Vec::new(),
            pixels: None,
            bumper: false,
            battery_low: false,
            measured: Duration::ZERO,
            number: last.map_or(0, |(number, _)| number + 1),
            taken_ns: last.map(|(_, stamp_ns)| stamp_ns),
            taken: None,
            stood: None,
            told: (DriveState::Standing, Causes::NONE),
            last_step: None,
            frames: VecDeque::new(),
            events: VecDeque::new(),
            motion,
            scenario,
        }
    }

    /// When the robot may move.
    pub fn safety(&mut self) -> &mut Safety {
        &mut self.safety
    }

    /// The next frame that is ready.
    pub fn frame(&mut self) -> Option<Frame> {
        self.frames.pop_front()
    }

    /// The next event that was not taken yet.
    pub fn event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Whether the battery has become low since this was last asked.
    pub fn take_battery_low(&mut self) -> bool {
        std::mem::take(&mut self.battery_low)
    }

    /// Do an action. Where the robot does something else, or was moved since the last frame, what it sees now comes first.
    pub fn order(&mut self, action: Action) {
        if !matches!(self.phase, Phase::Idle) {
            return;
        }
        let moved = match (self.stood, self.odometry.back()) {
            (Some(stood), Some((_, now))) => {
                let (way, angle) =
                    ((now.pose.position - stood.position).norm(), wrap(now.pose.heading - stood.heading));
                way > MOVED[0] || angle.abs() > MOVED[1]
            }
            _ => true,
        };
        self.phase = match moved {
            true => Phase::Look,
            false => Phase::Doing { action, controller: Controller::new(self.actions.motion(action)) },
        };
    }

    /// Something came in.
    pub fn hear(&mut self, received: Received) {
        let Received { at, stamp_ns, ref reading } = received;
        let logged = match reading {
            Reading::Image(_) | Reading::Note(_) => None,
            _ => Some(received.clone()),
        };
        match received.reading {
            Reading::Image(image) => self.see(at, stamp_ns, image),
            Reading::Odometry { pose, velocity } => self.hear_odometry(at, stamp_ns, Odometry { pose, velocity }),
            Reading::Scan(scan) => self.hear_scan(at, stamp_ns, &scan),
            Reading::Bumper(pressed) => self.bumper = pressed,
            Reading::EmergencyStop(pressed) => self.safety.hear_emergency_stop(at, pressed),
            Reading::Lock(locked) => self.safety.hear_lock(at, locked),
            Reading::Teleop(velocity) => self.safety.hear_person(at, velocity),
            Reading::Battery(charge) => {
                self.battery_low |= self.safety.hear_battery(charge);
            }
            Reading::Pose(pose) => keep(&mut self.poses, stamp_ns, pose),
            Reading::Reward { task, reward } => {
                if let Some(place) = self.rewards.get_mut(task) {
                    *place = reward;
                }
            }
            Reading::Mark(mark) => self.marks.push(mark),
            Reading::Note(text) => self.note(text),
        }
        self.events.extend(logged.map(Event::Heard));
    }

    /// The velocity to command at a time.
    pub fn step(&mut self, now: Duration) -> Velocity {
        let passed = self.last_step.replace(now).map_or(Duration::ZERO, |last| now.saturating_sub(last));
        if let Some(ahead) = self.clock.jump() {
            self.note(format!("the robot's clock has gone {ahead:+.3} s against ours"));
            self.safety.doubt_times(ahead);
        }
        let newest = self.odometry.back().map(|&(_, odometry)| odometry);
        let wanted = match (&mut self.phase, newest) {
            (Phase::Doing { controller, .. }, Some(odometry)) => {
                if self.bumper && controller.advances() {
                    controller.obstruct();
                }
                let wanted = controller.step(&self.motion.settings, now, &odometry);
                let slowed = self.safety.slow_down(wanted);
                let still = self.motion.settings.still.linear;
                if slowed.linear.abs() < still && wanted.linear.abs() >= still {
                    controller.obstruct();
                }
                Some(slowed)
            }
            _ => None,
        };
        let velocity = self.safety.step(now, wanted);
        let (state, causes) = (self.safety.state(), self.safety.causes());
        if let Phase::Doing { action, controller } = &mut self.phase {
            if causes.has(Cause::Near) && controller.advances() {
                controller.obstruct();
            } else if state != DriveState::Driving {
                controller.wait(passed);
            }
            if let Some(end) = controller.ended() {
                let blocked = end == MotionEnd::Blocked || end == MotionEnd::TimedOut && controller.share() < 0.5;
                let action = *action;
                if end == MotionEnd::TimedOut {
                    let text = format!("{} took too long: it ends where it is", self.actions.name(action));
                    self.note(text);
                }
                self.phase = Phase::Ending { action, blocked, from: self.measured };
            }
        }
        match &self.phase {
            Phase::Driven(_) if state != DriveState::Driven => self.let_go(),
            Phase::Driven(_) => {}
            _ if state == DriveState::Driven => self.phase = Phase::Driven(Box::default()),
            _ => {}
        }
        let stamp_ns = self.stamp();
        if (state, causes) != self.told {
            self.told = (state, causes);
            self.events.push_back(Event::Changed { stamp_ns, state, causes });
        }
        self.events.push_back(Event::Commanded { stamp_ns, velocity });
        velocity
    }

    /// The person does not drive any more.
    fn let_go(&mut self) {
        if let Phase::Driven(mut hand) = std::mem::replace(&mut self.phase, Phase::Look) {
            hand.segmenter.interrupt();
            self.give_driven(&mut hand);
        }
    }

    /// One more image under a person's hand.
    fn drive_on(&mut self, seen: Seen) {
        let Phase::Driven(mut hand) = std::mem::replace(&mut self.phase, Phase::Look) else { return };
        if let Some(last) = hand.held.back() {
            let seconds = seen.taken.saturating_sub(last.taken).as_secs_f64();
            hand.segmenter.push(self.rule.step(&last.odometry, &seen.odometry, seconds, 0.0));
        }
        hand.held.push_back(seen);
        if hand.held.len() > MOST_HELD {
            hand.segmenter.interrupt();
        }
        self.give_driven(&mut hand);
        self.phase = Phase::Driven(hand);
    }

    /// Make frames of the actions of a person that are done.
    fn give_driven(&mut self, hand: &mut Hand) {
        while let Some(segment) = hand.segmenter.finished() {
            let Some(action) = segment.action else {
                hand.held.drain(..segment.frames.min(hand.held.len()));
                hand.given = false;
                continue;
            };
            let ends = Boundary { blocked: segment.blocked };
            for index in 0..=segment.frames {
                let Some(seen) = hand.held.get_mut(index) else { break };
                match index {
                    0 if hand.given => {}
                    0 => {
                        let seen = seen.clone();
                        self.give(seen, None, Some(Boundary { blocked: false }));
                    }
                    _ => {
                        // It is given once: only its pose is needed again.
                        let image = std::mem::take(&mut seen.image);
                        let seen = Seen { image, ..seen.clone() };
                        self.give(seen, Some(action), (index == segment.frames).then_some(ends));
                    }
                }
            }
            hand.held.drain(..segment.frames.min(hand.held.len()));
            hand.given = true;
        }
    }

    fn note(&mut self, text: String) {
        // Among the frames, whose stamps may be ahead of the robot's clock.
        let stamp_ns = self.stamp().max(self.taken_ns.unwrap_or_default());
        self.events.push_back(Event::Note { stamp_ns, text });
    }

    /// The newest stamp.
    fn stamp(&self) -> u64 {
        self.odometries.last().max(self.images.last()).unwrap_or_default()
    }

    fn hear_odometry(&mut self, at: Duration, stamp_ns: u64, odometry: Odometry) {
        let Pose { position, heading } = odometry.pose;
        if ![position.x, position.y, heading].iter().all(|value| value.is_finite()) || !odometry.velocity.is_finite() {
            return;
        }
        let before = self.odometries.last();
        let Some(measured) = self.clock.sensed_at(&mut self.odometries, at, stamp_ns) else { return };
        self.measured = measured;
        self.safety.hear_odometry(measured, &odometry);
        if let (Some(before_ns), Some(&(_, before))) = (before, self.odometry.back()) {
            let seconds = stamp_ns.saturating_sub(before_ns) as f64 / 1e9;
            let limits = self.motion.settings.limits;
            let way = (position - before.pose.position).norm();
            let angle = wrap(heading - before.pose.heading).abs();
            let (times, besides) = JUMP;
            if way > times * limits.speed * seconds + besides[0]
                || angle > times * limits.turn_speed * seconds + besides[1]
            {
                self.note(format!("odometry has jumped by {way:.2} m and {:.0}°", angle.to_degrees()));
                // What was being done is not done any more, and nobody knows what came of it.
                self.phase = Phase::Look;
                self.odometry.clear();
            }
        }
        keep(&mut self.odometry, stamp_ns, odometry);
    }

    fn hear_scan(&mut self, at: Duration, stamp_ns: u64, scan: &Scan) {
        let Some(taken) = self.clock.sensed_at(&mut self.scans, at, stamp_ns) else { return };
        let robot = &self.scenario.robot;
        self.safety.hear_scan(
            taken,
            scan.clearance(0.0, robot.radius),
            scan.clearance(std::f64::consts::PI, robot.radius),
        );
        self.sonar = scan.ring(robot.sonars, robot.sonar_range as f32);
    }

    fn see(&mut self, at: Duration, stamp_ns: u64, image: Image) {
        let Some(taken) = self.clock.sensed_at(&mut self.images, at, stamp_ns) else { return };
        let mut hasher = DefaultHasher::new();
        hasher.write(&image.rgb);
        let pixels = Some(hasher.finish());
        let changed = std::mem::replace(&mut self.pixels, pixels) != pixels;
        self.safety.see(taken, changed);
        let interval = self.interval.mul_f64(1.0 - EARLY);
        let waited = self.taken.is_none_or(|before| taken.saturating_sub(before) >= interval);
        let (state, still) = (self.safety.state(), self.safety.is_still());
        let stands = still && state == DriveState::Standing;
        match self.phase {
            Phase::Doing { action, .. } if waited && state == DriveState::Driving => {
                self.take(stamp_ns, taken, image, Some(action), None);
            }
            Phase::Ending { action, blocked, from } if taken >= from => {
                self.take(stamp_ns, taken, image, Some(action), Some(Boundary { blocked }));
                self.phase = Phase::Idle;
            }
            Phase::Driven(_) if waited => {
                if let Some(seen) = self.seen(stamp_ns, taken, image) {
                    self.taken = Some(taken);
                    self.drive_on(seen);
                }
            }
            Phase::Look if stands && self.last_step.is_some_and(|now| self.safety.is_fresh(now)) => {
                self.take(stamp_ns, taken, image, None, Some(Boundary { blocked: false }));
                self.phase = Phase::Idle;
            }
            _ => {}
        }
    }

    /// An image with what was sensed nearest to it; nothing without odometry.
    fn seen(&mut self, stamp_ns: u64, taken: Duration, image: Image) -> Option<Seen> {
        let odometry = nearest(&self.odometry, stamp_ns)?.pose;
        let truth = nearest(&self.poses, stamp_ns).filter(|_| self.scenario.robot.pose_known);
        let (sonar, marks) = (self.sonar.clone(), std::mem::take(&mut self.marks));
        Some(Seen { stamp_ns, taken, image, odometry, truth, sonar, marks })
    }

    fn take(
        &mut self,
        stamp_ns: u64,
        taken: Duration,
        image: Image,
        action: Option<Action>,
        boundary: Option<Boundary>,
    ) {
        if let Some(seen) = self.seen(stamp_ns, taken, image) {
            self.give(seen, action, boundary);
        }
    }

    fn give(&mut self, seen: Seen, action: Option<Action>, boundary: Option<Boundary>) {
        let Seen { stamp_ns, taken, image, odometry, truth, sonar, marks } = seen;
        let ends = action.is_some() && boundary.is_some();
        // Stamps of frames never go back, whatever the robot's clock does: then they go on by ours.
        let passed = self.taken.map_or(Duration::ZERO, |before| taken.saturating_sub(before)).as_nanos() as u64;
        let stamp_ns = match self.taken_ns {
            Some(before) if stamp_ns <= before => before + passed.max(1),
            _ => stamp_ns,
        };
        self.frames.push_back(Frame {
            number: self.number,
            stamp_ns,
            view: View::Image(image),
            truth,
            odometry: Some(of_log(odometry)),
            sonar,
            action,
            boundary,
            moved: Vec::new(),
            marks,
            goto: None,
            rewards: if ends { self.rewards.clone() } else { Vec::new() },
        });
        if boundary.is_some() {
            self.stood = Some(odometry);
        }
        self.number += 1;
        (self.taken_ns, self.taken) = (Some(stamp_ns), Some(taken));
    }

    /// Save or restore it, between two actions. Where time does not go on where it was, only the count of frames is kept.
    pub fn persist(&mut self, snapshot: &mut Snapshot, time_goes_on: bool) -> Result<(), SnapshotError> {
        let (next, behind) = (self.number, self.taken_ns);
        snapshot.value("number", &mut self.number)?;
        snapshot.value("taken_ns", &mut self.taken_ns)?;
        if !time_goes_on {
            // Frames that were recorded after the state have their numbers and stamps already.
            (self.number, self.taken_ns) = (self.number.max(next), self.taken_ns.max(behind));
            return Ok(());
        }
        snapshot.inner("safety", &mut self.safety)?;
        snapshot.inner("clock", &mut self.clock)?;
        snapshot.value("images", &mut self.images)?;
        snapshot.value("odometries", &mut self.odometries)?;
        snapshot.value("scans", &mut self.scans)?;
        snapshot.value("pixels", &mut self.pixels)?;
        snapshot.value("bumper", &mut self.bumper)?;
        snapshot.value("last_step", &mut self.last_step)?;
        snapshot.value("taken", &mut self.taken)?;
        snapshot.value("measured", &mut self.measured)?;
        snapshot.numbers("sonar", &mut self.sonar)?;
        snapshot.numbers("rewards", &mut self.rewards)?;
        let mut stood: Vec<f64> = self.stood.iter().flat_map(|pose| numbers_of(*pose)).collect();
        snapshot.numbers("stood", &mut stood)?;
        self.stood = <[f64; 3]>::try_from(stood).ok().map(pose_of);
        let with_velocity = |odometry: Odometry| {
            let [x, y, heading] = numbers_of(odometry.pose);
            [x, y, heading, odometry.velocity.linear, odometry.velocity.angular]
        };
        kept(snapshot, "odometry", &mut self.odometry, with_velocity, |[x, y, heading, linear, angular]| Odometry {
            pose: pose_of([x, y, heading]),
            velocity: Velocity { linear, angular },
        })?;
        kept(snapshot, "poses", &mut self.poses, numbers_of, pose_of)?;
        if snapshot.is_restoring() {
            self.phase = Phase::Idle;
            self.told = (self.safety.state(), self.safety.causes());
        }
        Ok(())
    }
}

fn numbers_of(pose: Pose) -> [f64; 3] {
    [pose.position.x, pose.position.y, pose.heading]
}

/// Not by `Pose::new`: the heading is in its range already, and every bit counts.
fn pose_of([x, y, heading]: [f64; 3]) -> Pose {
    Pose { position: Point2::new(x, y), heading }
}

/// Save or restore what was sensed with stamps.
fn kept<T: Copy, const N: usize>(
    snapshot: &mut Snapshot,
    name: &str,
    kept: &mut VecDeque<(u64, T)>,
    numbers_of: impl Fn(T) -> [f64; N],
    value_of: impl Fn([f64; N]) -> T,
) -> Result<(), SnapshotError> {
    let mut stamps: Vec<u64> = kept.iter().map(|entry| entry.0).collect();
    let mut numbers: Vec<f64> = kept.iter().flat_map(|entry| numbers_of(entry.1)).collect();
    snapshot.scope(name, |snapshot| {
        snapshot.value("stamps", &mut stamps)?;
        snapshot.numbers("numbers", &mut numbers)?;
        let (values, rest) = numbers.as_chunks::<N>();
        snapshot.check("numbers", rest.is_empty() && values.len() == stamps.len(), "another number than of stamps")?;
        *kept = stamps.iter().copied().zip(values.iter().copied().map(value_of)).collect();
        Ok(())
    })
}

/// Keep what was sensed with a stamp, and forget what is too old.
fn keep<T>(kept: &mut VecDeque<(u64, T)>, stamp_ns: u64, value: T) {
    kept.retain(|&(stamp, _)| stamp < stamp_ns && stamp_ns - stamp <= KEPT_NS);
    kept.push_back((stamp_ns, value));
}

/// What was sensed nearest to a stamp.
fn nearest<T: Copy>(kept: &VecDeque<(u64, T)>, stamp_ns: u64) -> Option<T> {
    kept.iter().min_by_key(|&&(stamp, _)| stamp.abs_diff(stamp_ns)).map(|&(_, value)| value)
}
