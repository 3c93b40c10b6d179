//! A robot in simulated time that has faults, and what the loop of control makes of it.

use std::collections::VecDeque;
use std::sync::Mutex;

use nalgebra::Point2;

use super::*;
use crate::robot::{Pose, Velocity};
use crate::scenario::Scenario;
use crate::vision::Image;

const STAMPS_FROM: u64 = 1_800_000_000_000_000_000;

/// What is wrong while a time lasts, seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    NoCamera,
    Frozen,
    CameraLate,
    NoOdometry,
    NoNumbers,
    Twice,
    OutOfOrder,
    ClockSet(i64),
    Pressed,
}

/// A disc without mass that heeds a command after 50 ms. Images come at 10 Hz and 60 ms late, odometry at 50 Hz.
struct Disc {
    now: Duration,
    pose: Pose,
    /// Where its odometry begins.
    odometry_from: Pose,
    commands: VecDeque<(Duration, Velocity)>,
    velocity: Velocity,
    waiting: Vec<Received>,
    faults: Vec<(Fault, f64, f64)>,
    /// Somebody moves it, or its odometry begins anew, at a time.
    carried: Option<(f64, bool)>,
    sent: Arc<Mutex<Vec<(f64, Velocity)>>>,
}

impl Disc {
    fn new() -> Self {
        let origin = Pose::new(Point2::origin(), 0.0);
        Disc {
            now: Duration::from_secs(100),
            pose: origin,
            odometry_from: origin,
            commands: VecDeque::new(),
            velocity: Velocity::ZERO,
            waiting: Vec::new(),
            faults: Vec::new(),
            carried: None,
            sent: Arc::default(),
        }
    }

    fn has(&self, fault: Fault) -> bool {
        let now = self.now.as_secs_f64() - 100.0;
        self.faults.iter().any(|&(of, from, to)| of == fault && (from..to).contains(&now))
    }

    fn sense(&mut self, reading: Reading, late: u64) {
        let set = self.faults.iter().find_map(|&(fault, from, _)| match fault {
            Fault::ClockSet(ms) if self.now.as_secs_f64() - 100.0 >= from => Some(ms * 1_000_000),
            _ => None,
        });
        let stamp_ns = (STAMPS_FROM + self.now.as_nanos() as u64).wrapping_add_signed(set.unwrap_or(0));
        let at = self.now + Duration::from_millis(late);
        self.waiting.push(Received { at, stamp_ns, reading });
    }

    /// Five milliseconds pass.
    fn pass(&mut self) {
        let seconds = 0.005;
        self.now += Duration::from_millis(5);
        while self.commands.front().is_some_and(|&(at, _)| at <= self.now) {
            self.velocity = self.commands.pop_front().unwrap().1;
        }
        let heading = self.pose.heading + self.velocity.angular * seconds;
        let direction = Pose::new(self.pose.position, heading).direction();
        self.pose = Pose::new(self.pose.position + direction * self.velocity.linear * seconds, heading);
        let milliseconds = self.now.as_millis();
        if let Some((at, by_hand)) = self.carried.filter(|&(at, _)| self.now.as_secs_f64() - 100.0 >= at) {
            let _ = at;
            match by_hand {
                true => self.pose = Pose::new(self.pose.position + nalgebra::Vector2::new(0.1, 0.1), 1.0),
                false => self.odometry_from.position.x += 3.0,
            }
            self.carried = None;
        }
        if milliseconds.is_multiple_of(20) && !self.has(Fault::NoOdometry) {
            let from = self.odometry_from.position;
            let mut pose = Pose::new(self.pose.position - from.coords, self.pose.heading);
            if self.has(Fault::NoNumbers) {
                pose.position.x = f64::NAN;
            }
            self.sense(Reading::Odometry { pose, velocity: self.velocity }, 10);
        }
        if milliseconds.is_multiple_of(100) && !self.has(Fault::NoCamera) {
            let value = if self.has(Fault::Frozen) { 0 } else { (milliseconds / 100) as u8 };
            let image = Image { width: 2, height: 1, cropped: false, rgb: vec![value; 6] };
            let late = if self.has(Fault::CameraLate) { 700 } else { 60 };
            self.sense(Reading::Pose(self.pose), late);
            self.sense(Reading::Image(image.clone()), late);
            if self.has(Fault::Twice) {
                self.sense(Reading::Image(image), late + 1);
            }
        }
        if self.has(Fault::OutOfOrder) && milliseconds.is_multiple_of(100) {
            let image = Image { width: 2, height: 1, cropped: false, rgb: vec![1; 6] };
            let (at, stamp_ns) = (self.now, STAMPS_FROM + self.now.as_nanos() as u64 - 300_000_000);
            self.waiting.push(Received { at, stamp_ns, reading: Reading::Image(image) });
        }
        if milliseconds.is_multiple_of(100) {
            let pressed = self.has(Fault::Pressed);
            self.sense(Reading::EmergencyStop(pressed), 5);
        }
    }
}

impl Base for Disc {
    fn now(&self) -> Duration {
        self.now
    }

    fn receive(&mut self, until: Duration, take: &mut dyn FnMut(Received)) {
        while self.now < until {
            self.pass();
            self.waiting.sort_by_key(|received| received.at);
            let due = self.waiting.partition_point(|received| received.at <= self.now);
            self.waiting.drain(..due).for_each(&mut *take);
        }
    }

    fn command(&mut self, velocity: Velocity) {
        self.commands.push_back((self.now + Duration::from_millis(50), velocity));
        self.sent.lock().unwrap().push((self.now.as_secs_f64() - 100.0, velocity));
    }
}

const EQUIPMENT: Equipment = Equipment { scan: false, emergency_stop: true, lock: false };

fn live<B: Base>(base: B, last: Option<(u64, u64)>) -> Live<B> {
    let text = include_str!("../../../scenarios/lab.toml");
    let set = ["robot.body=dynamic".to_owned()];
    let scenario = Arc::new(Scenario::parse(text, "lab.toml".as_ref(), &set).unwrap());
    let motion = scenario.motion.clone().unwrap();
    Live::new(scenario, motion, EQUIPMENT, base, last)
}

const ACTIONS: [Action; 4] = [Action::FORWARD, Action::TURN_LEFT, Action::FORWARD, Action::TURN_RIGHT];

/// Executes so many actions: all frames.
fn drive(live: &mut Live<Disc>, actions: usize) -> Vec<Frame> {
    let mut frames = vec![live.first().unwrap()];
    for number in 0..actions {
        let more = live.execute(ACTIONS[number % 4], &mut |frame| {
            frames.push(frame);
            true
        });
        assert!(more);
    }
    frames
}

/// What came of the actions: for each boundary the action, and where the robot was in truth.
fn boundaries(frames: &[Frame]) -> Vec<(Option<Action>, Pose)> {
    let ends = frames.iter().filter(|frame| frame.boundary.is_some());
    ends.map(|frame| (frame.action, frame.truth.unwrap())).collect()
}

/// The robot drives some actions with a fault: that it stands within `bound` seconds of its beginning until its end, and moves again
/// later; the frames.
fn with_fault(fault: Fault, stops: Option<f64>) -> Vec<Frame> {
    let (from, to) = (3.0, 5.0);
    let mut disc = Disc::new();
    disc.faults.push((fault, from, to));
    let sent = disc.sent.clone();
    let mut live = live(disc, None);
    let frames = drive(&mut live, 12);
    let sent = sent.lock().unwrap();
    let moves_in = |from: f64, to: f64| {
        sent.iter().filter(|(at, velocity)| (from..to).contains(at) && !velocity.is_zero()).count()
    };
    match stops {
        Some(bound) => assert_eq!(moves_in(from + bound, to), 0, "{fault:?}"),
        None => assert!(moves_in(from + 0.3, to) > 10, "{fault:?}"),
    }
    assert!(moves_in(0.0, from) > 10 && moves_in(to, to + 12.0) > 10, "{fault:?}");
    // Whatever happened, each action led where it should.
    for pair in boundaries(&frames).windows(2) {
        let ((_, before), (action, after)) = (pair[0], pair[1]);
        let ahead = (after.position - before.position).norm();
        let turned = crate::robot::wrap(after.heading - before.heading);
        let (wanted_ahead, wanted_turn) = match action.unwrap().index() {
            0 => (0.3, 0.0),
            1 => (0.0, std::f64::consts::FRAC_PI_4),
            _ => (0.0, -std::f64::consts::FRAC_PI_4),
        };
        assert!(
            (ahead - wanted_ahead).abs() < 0.03 && (turned - wanted_turn).abs() < 0.05,
            "{fault:?} {ahead} {turned}"
        );
    }
    frames
}

#[test]
fn frames_come_at_their_interval_and_each_action_ends_with_one_of_a_robot_that_stands() {
    let mut live = live(Disc::new(), None);
    let frames = drive(&mut live, 40);
    assert_eq!(frames[0].action, None);
    assert!(frames.iter().zip(0..).all(|(frame, number)| frame.number == number));
    for pair in frames.windows(2) {
        let (before, after) = (&pair[0], &pair[1]);
        let seconds = (after.stamp_ns - before.stamp_ns) as f64 / 1e9;
        assert!(seconds >= 0.0999 && (seconds >= 0.19 || after.boundary.is_some()), "{seconds}");
        if before.boundary.is_none() {
            assert_eq!(before.action, after.action);
        }
    }
    let ends: Vec<_> = boundaries(&frames);
    assert_eq!(ends.len(), 41);
    for (end, action) in ends[1..].iter().zip(ACTIONS.iter().cycle()) {
        assert_eq!(end.0, Some(*action));
    }
    // One after the other they lead where all of them do.
    let driven = frames.last().unwrap().odometry.unwrap();
    let mut wanted = Pose::new(Point2::origin(), 0.0);
    for action in ACTIONS.iter().cycle().take(40) {
        let turn = [0.0, std::f64::consts::FRAC_PI_4, -std::f64::consts::FRAC_PI_4][action.index()];
        let way = if *action == Action::FORWARD { 0.3 } else { 0.0 };
        wanted = Pose::new(wanted.position, wanted.heading + turn);
        wanted.position += wanted.direction() * way;
    }
    assert!((driven.position - wanted.position).norm() < 0.3, "{driven:?} {wanted:?}");
    let poses = frames.iter().all(|frame| {
        let truth = frame.truth.unwrap();
        (truth.position - frame.odometry.unwrap().position).norm() < 0.02
    });
    assert!(poses, "poses are those of the images");
}

#[test]
fn faults_stop_the_robot_in_time_and_it_goes_on() {
    // Stale after 250 ms, and seen at the next step of control.
    for fault in [Fault::NoCamera, Fault::CameraLate] {
        with_fault(fault, Some(0.36));
    }
    for fault in [Fault::NoOdometry, Fault::NoNumbers] {
        with_fault(fault, Some(0.33));
    }
    with_fault(Fault::Pressed, Some(0.16));
    with_fault(Fault::Frozen, Some(1.0));
    with_fault(Fault::Twice, None);
    with_fault(Fault::OutOfOrder, None);
}

#[test]
fn a_clock_that_is_set_stops_nothing_for_long() {
    for ms in [7000, -7000, 50] {
        let mut disc = Disc::new();
        disc.faults.push((Fault::ClockSet(ms), 3.0, f64::INFINITY));
        let notes: Arc<Mutex<Vec<String>>> = Arc::default();
        let told = notes.clone();
        let mut live = live(disc, None);
        live.keep_journal(Some(Box::new(move |event| {
            if let Event::Note { text, .. } = event {
                told.lock().unwrap().push(text);
            }
        })));
        let frames = drive(&mut live, 12);
        assert!(frames.windows(2).all(|pair| pair[0].stamp_ns < pair[1].stamp_ns), "stamps never go back");
        let told = notes.lock().unwrap().iter().any(|text| text.contains("clock"));
        assert_eq!(told, ms.abs() > 100, "{ms}: {:?}", notes.lock().unwrap());
        assert!(live.base.now() < Duration::from_secs(100 + 45), "{ms}: {:?}", live.base.now());
    }
}

#[test]
fn frames_come_behind_those_that_are_recorded_whatever_the_clock_says() {
    // The recording ends a minute ahead of what the robot's clock says now.
    let newest = STAMPS_FROM + 160_000_000_000;
    let mut live = live(Disc::new(), Some((41, newest)));
    let frames = drive(&mut live, 4);
    assert_eq!((frames[0].number, frames[0].stamp_ns), (42, newest + 1));
    for pair in frames.windows(2) {
        let seconds = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 / 1e9;
        assert!((0.09..1.0).contains(&seconds), "they are as far apart as they were taken: {seconds}");
    }
}

#[test]
fn what_was_not_driven_belongs_to_no_action() {
    for by_hand in [true, false] {
        let mut live = live(Disc::new(), None);
        let mut frames = drive(&mut live, 3);
        // Right after an action, or in the middle of one.
        let from = live.base.now().as_secs_f64() - 100.0;
        live.base.carried = Some((if by_hand { from } else { from + 0.5 }, by_hand));
        if by_hand {
            live.cycle();
            live.cycle();
        }
        let mut given = Vec::new();
        assert!(live.execute(Action::FORWARD, &mut |frame| {
            given.push(frame);
            true
        }));
        let last = given.last().unwrap();
        assert_eq!((last.action, last.boundary.is_some()), (None, true), "{by_hand}");
        frames.extend(given);
        live.execute(Action::FORWARD, &mut |frame| {
            frames.push(frame);
            true
        });
        assert_eq!(frames.last().unwrap().action, Some(Action::FORWARD));
    }
}

#[test]
fn a_run_that_is_to_end_stops_in_the_middle_of_an_action() {
    let disc = Disc::new();
    let sent = disc.sent.clone();
    let switches = Switches::default();
    let mut live = live(disc, None).with_switches(switches.clone());
    drive(&mut live, 2);
    let mut frames = 0;
    let more = live.execute(Action::FORWARD, &mut |_| {
        frames += 1;
        switches.stop.store(true, Ordering::Relaxed);
        true
    });
    assert!(!more && frames == 1);
    assert_eq!(sent.lock().unwrap().last().unwrap().1, Velocity::ZERO);
}

/// The same disc in real time.
struct InRealTime {
    disc: Disc,
    begun: std::time::Instant,
}

impl Base for InRealTime {
    fn now(&self) -> Duration {
        self.begun.elapsed() + Duration::from_secs(100)
    }

    fn receive(&mut self, until: Duration, take: &mut dyn FnMut(Received)) {
        std::thread::sleep(until.saturating_sub(self.now()));
        let now = self.now();
        self.disc.receive(now, take);
    }

    fn command(&mut self, velocity: Velocity) {
        self.disc.command(velocity);
    }
}

#[test]
fn on_a_thread_of_its_own_it_stands_while_nobody_asks_for_anything_and_at_the_end() {
    let disc = Disc::new();
    let sent = disc.sent.clone();
    let mut robot = Threaded::start(live(InRealTime { disc, begun: std::time::Instant::now() }, Some((6, 0)))).unwrap();
    assert_eq!(robot.first().map(|frame| (frame.number, frame.action)), Some((7, None)));
    let mut frames = Vec::new();
    let mut forward = |robot: &mut Threaded| {
        robot.execute(Action::FORWARD, &mut |frame| {
            frames.push((frame.action, frame.boundary.is_some()));
            true
        })
    };
    assert!(forward(&mut robot));
    let (count, moved) = {
        let sent = sent.lock().unwrap();
        (sent.len(), sent.iter().any(|(_, velocity)| !velocity.is_zero()))
    };
    assert!(moved && sent.lock().unwrap().last().unwrap().1.is_zero());
    // The actors hang: velocities go on, and all of them are zero.
    std::thread::sleep(Duration::from_millis(500));
    {
        let sent = sent.lock().unwrap();
        assert!(sent.len() >= count + 5 && sent[count..].iter().all(|(_, velocity)| velocity.is_zero()));
    }
    // Its count of frames is saved, and goes on; where it is, is seen anew.
    let mut saved = Snapshot::new();
    robot.persist(&mut saved).unwrap();
    let number = saved.texts["drive.number"].clone();
    assert!(forward(&mut robot) && forward(&mut robot));
    drop(robot);
    assert_eq!(frames.iter().filter(|frame| **frame == (Some(Action::FORWARD), true)).count(), 3);
    assert!(number.parse::<usize>().unwrap() < 7 + 1 + frames.len());
    assert!(sent.lock().unwrap().iter().rev().take(10).all(|(_, velocity)| velocity.is_zero()));
}

#[test]
fn an_order_that_a_frame_has_overtaken_is_void() {
    let disc = Disc::new();
    let sent = disc.sent.clone();
    let mut robot = Threaded::start(live(InRealTime { disc, begun: std::time::Instant::now() }, None)).unwrap();
    // Its first frame is there, and whoever orders has not seen it.
    std::thread::sleep(Duration::from_millis(500));
    let mut given = Vec::new();
    assert!(robot.execute(Action::FORWARD, &mut |frame| {
        given.push(frame.action);
        true
    }));
    assert_eq!(given, [None]);
    std::thread::sleep(Duration::from_millis(300));
    assert!(sent.lock().unwrap().iter().all(|(_, velocity)| velocity.is_zero()));
}
