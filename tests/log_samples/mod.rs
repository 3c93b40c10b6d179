//! Messages of every type for the tests of the log, with values that differ from each other.

// Each test that shares this file uses a part of it.
#![allow(dead_code)]

use std::io::Write;

use adagio::log::{
    LogError, LogWriter, Message, Topic, cdr,
    messages::{
        Decision, DictionaryGrowth, Evaluation, FrameTaken, GoalMoved, Header, Health, Image, LaserScan, Log,
        ModelRequest, ModelUpdate, Odometry, PlaceBelief, PolicyUpdate, Pose, PoseStamped, PoseWithCovariance,
        Prospect, PursuitEnded, RewardGiven, RobotInput, RobotState, RunEnd, Text, Time, Transition, Twist,
        TwistStamped, TwistWithCovariance, Vector3,
    },
    topics,
};
use serde_json::Value;

/// A message as it was written.
pub struct Written {
    pub topic: &'static str,
    pub message_type: &'static str,
    pub sequence: u32,
    pub stamp_ns: u64,
    pub message: Value,
}

/// A stamp that the tools' time lines accept.
pub const START_NS: u64 = 1_790_000_000_000_000_000;

/// Writes `rounds` messages on every topic, `pause` after each round; returns those written, also
/// when writing fails.
pub fn write_samples<W: Write>(
    log: &mut LogWriter<W>,
    rounds: u32,
    written: &mut Vec<Written>,
    mut pause: impl FnMut(&mut LogWriter<W>, u32) -> Result<(), LogError>,
) -> Result<(), LogError> {
    for round in 0..rounds {
        let mut on = Round { log, round, written };
        let header = on.header();
        on.put(topics::OBSERVATION, image(header.clone(), round))?;
        on.put(topics::POSE, PoseStamped { header: header.clone(), pose: pose(round) })?;
        on.put(topics::ODOMETRY, odometry(header.clone(), round))?;
        on.put(topics::SONAR, scan(header.clone(), round))?;
        on.put(topics::COMMAND, TwistStamped { header: header.clone(), twist: twist(round) })?;
        on.put(topics::FRAME, frame(header.clone(), round))?;
        on.put(topics::GOAL, goal(header.clone(), round))?;
        on.put(topics::MARK, Text { data: format!("centre {round}") })?;
        on.put(topics::GOTO, Text { data: format!("corner {round}") })?;
        on.put(topics::REWARD, reward(header.clone(), round))?;
        on.put(topics::ROBOT_STATE, state(header.clone(), round))?;
        on.put(topics::ROBOT_COMMAND, TwistStamped { header: header.clone(), twist: twist(round) })?;
        on.put(topics::ROBOT_ODOMETRY, odometry(header.clone(), round))?;
        on.put(topics::ROBOT_SCAN, scan(header.clone(), round))?;
        on.put(topics::ROBOT_INPUT, input(header.clone(), round))?;
        on.put(topics::PURSUIT, pursuit(header.clone(), round))?;
        on.put(topics::DECISION, decision(header.clone(), round))?;
        on.put(topics::PROSPECT, prospect(header.clone(), round))?;
        on.put(topics::PLACES, places(header.clone(), round))?;
        on.put(topics::TRANSITION, transition(header.clone(), round))?;
        on.put(topics::DICTIONARY, growth(header.clone(), round))?;
        on.put(topics::REQUEST, request(header.clone(), round))?;
        on.put(topics::MODEL, model(header.clone(), round))?;
        on.put(topics::POLICY, policy(header.clone(), round))?;
        on.put(topics::END, RunEnd { header: header.clone(), frame: u64::from(round) << 40 })?;
        on.put(topics::EVALUATION, evaluation(header.clone(), round))?;
        on.put(topics::HEALTH, health(header.clone(), round))?;
        on.put(topics::DIAGNOSTICS, diagnostics(header, round))?;
        pause(log, round)?;
    }
    Ok(())
}

struct Round<'a, W: Write> {
    log: &'a mut LogWriter<W>,
    round: u32,
    written: &'a mut Vec<Written>,
}

impl<W: Write> Round<'_, W> {
    fn stamp_ns(&self) -> u64 {
        START_NS + u64::from(self.round) * 33_333_333
    }

    /// Frame names of different lengths put all that follows at different alignments.
    fn header(&self) -> Header {
        Header::new(self.stamp_ns(), &"camera_é"[..self.round as usize % 7])
    }

    fn put<M: Message>(&mut self, topic: Topic<M>, message: M) -> Result<(), LogError> {
        let stamp_ns = self.stamp_ns();
        self.log.write(topic, self.round, stamp_ns, &message)?;
        self.written.push(Written {
            topic: topic.name(),
            message_type: M::TYPE,
            sequence: self.round,
            stamp_ns,
            message: serde_json::to_value(&message).unwrap(),
        });
        Ok(())
    }
}

/// Numbers that need all their digits; none in every third round.
fn numbers(round: u32, count: u32) -> Vec<f64> {
    let count = if round.is_multiple_of(3) { 0 } else { count };
    (0..count).map(|i| f64::from(i * 7 + round).sin() * 1e3).collect()
}

fn names(round: u32) -> Vec<String> {
    (0..round % 4).map(|i| "aufgäbe"[..1 + i as usize].to_owned()).collect()
}

pub fn image(header: Header, round: u32) -> Image {
    let data = (0..32 * 16 * 3).map(|i: u32| (i * i / 7 + round * 31) as u8).collect();
    Image { header, height: 16, width: 32, encoding: "rgb8".into(), is_bigendian: 0, step: 96, data }
}

fn pose(round: u32) -> Pose {
    Pose::planar(f64::from(round) * 0.3, -1.5, f64::from(round) * 0.1 - 1.0)
}

fn twist(round: u32) -> Twist {
    Twist {
        linear: Vector3 { x: 0.3 / f64::from(round + 1), y: 0.0, z: -0.0 },
        angular: Vector3 { x: 0.0, y: 1e-300, z: f64::from(round) },
    }
}

fn odometry(header: Header, round: u32) -> Odometry {
    let mut covariance = [[0.0; 6]; 6];
    for (row, line) in covariance.iter_mut().enumerate() {
        for (column, value) in line.iter_mut().enumerate() {
            *value = (row * 10 + column) as f64 + f64::from(round) / 8.0;
        }
    }
    Odometry {
        header,
        child_frame_id: "base_link".into(),
        pose: PoseWithCovariance { pose: pose(round), covariance },
        twist: TwistWithCovariance { twist: twist(round), covariance },
    }
}

fn scan(header: Header, round: u32) -> LaserScan {
    LaserScan {
        header,
        angle_min: -1.5,
        angle_max: 1.5,
        angle_increment: 0.1,
        time_increment: 0.0,
        scan_time: 0.05,
        range_min: 0.02,
        range_max: 4.0,
        ranges: numbers(round, 5).into_iter().map(|x| x as f32).chain([f32::INFINITY]).collect(),
        intensities: Vec::new(),
    }
}

fn frame(header: Header, round: u32) -> FrameTaken {
    let action = if round == 0 { FrameTaken::NO_ACTION } else { (round % 3) as u8 };
    FrameTaken {
        header,
        frame: u64::from(round) + (1 << 33),
        action,
        boundary: round.is_multiple_of(5),
        blocked: round.is_multiple_of(10),
    }
}

fn goal(header: Header, round: u32) -> GoalMoved {
    let task = "corner"[..round as usize % 6].into();
    GoalMoved { header, frame: u64::from(round) << 33, task, x: 0.1 * f64::from(round), y: -2.5 }
}

fn reward(header: Header, round: u32) -> RewardGiven {
    let task = "charger"[..round as usize % 7].into();
    RewardGiven { header, frame: u64::from(round) << 32, task, reward: 0.5 - f64::from(round) }
}

fn state(header: Header, round: u32) -> RobotState {
    let causes = "no fresh camera image"[..round as usize % 9].into();
    RobotState { header, state: "standing"[..round as usize % 8].into(), causes }
}

fn input(header: Header, round: u32) -> RobotInput {
    RobotInput { header, name: "teleop"[..round as usize % 6].into(), values: numbers(round, round % 3) }
}

fn pursuit(header: Header, round: u32) -> PursuitEnded {
    let task = "corner"[..round as usize % 6].into();
    PursuitEnded { header, frame: u64::from(round) << 34, task, arrived: round.is_multiple_of(2), actions: round }
}

fn request(header: Header, round: u32) -> ModelRequest {
    ModelRequest { header, frame: u64::from(round) << 32, frames: 1 + u64::from(round), transitions: 20 * round }
}

fn decision(header: Header, round: u32) -> Decision {
    Decision {
        header,
        frame: u64::from(round) * 5 + (1 << 40),
        action_index: u64::from(round),
        action: Decision::TURN_RIGHT,
        behaviour: Decision::PURSUE,
        task: "corner"[..round as usize % 6].into(),
        epoch: round,
        q_values: numbers(round, 3),
        reflex: round % 2 == 1,
    }
}

fn places(header: Header, round: u32) -> PlaceBelief {
    let of = |first: u32| numbers(first + round, 2);
    PlaceBelief { header, frame: u64::from(round), probabilities: of(0), x: of(1), y: of(2), headings: of(3) }
}

fn prospect(header: Header, round: u32) -> Prospect {
    let (task, arrival) = (names(1).concat(), 1.0 / f64::from(round + 2));
    Prospect { header, frame: u64::from(round), task, done: round, actions: f64::from(round) + 0.1, arrival }
}

fn transition(header: Header, round: u32) -> Transition {
    Transition {
        header,
        from_frame: u64::from(round),
        to_frame: u64::MAX,
        action: (round % 3) as u8,
        blocked: round.is_multiple_of(2),
        tasks: names(round),
        rewards: numbers(round, 2),
    }
}

fn growth(header: Header, round: u32) -> DictionaryGrowth {
    DictionaryGrowth {
        header,
        first_frame: 256,
        last_frame: 511,
        accepted: (0..u64::from(round)).map(|i| 256 + i * i).collect(),
        quarantined: (0..u64::from(round % 2)).map(|i| 300 + i).collect(),
        size: 1526,
        sigma: 12.5,
        nu: 1e-4,
        at_budget: round == 1,
    }
}

fn model(header: Header, round: u32) -> ModelUpdate {
    ModelUpdate {
        header,
        epoch: round + 1,
        asked_at_frame: 1000,
        effective_at_frame: 1256,
        frames: 999,
        support_vectors: 400,
        regulariser: 1e-9,
        slowness: numbers(round + 1, 4),
        digest: "a65a292c".into(),
    }
}

fn policy(header: Header, round: u32) -> PolicyUpdate {
    PolicyUpdate {
        header,
        epoch: 3,
        effective_at_frame: 2048,
        task: "door".into(),
        gamma: 0.9,
        transitions: 3000,
        iterations: 12,
        converged: true,
        actions: 3,
        features: if round.is_multiple_of(3) { 0 } else { 9 },
        weights: numbers(round, 27),
        digest: "00".repeat(round as usize),
    }
}

fn evaluation(header: Header, round: u32) -> Evaluation {
    Evaluation {
        header,
        epoch: round,
        frame: 35_128,
        task: "door".into(),
        starts: 100,
        success: 0.97,
        success_wilson_low: 0.915,
        mean_steps: 6.25,
        optimal_mean_steps: 5.1,
        convergence_quality: f64::NAN,
    }
}

fn health(header: Header, round: u32) -> Health {
    Health {
        header,
        frames: 100_000,
        dropped_frames: 7,
        quarantined_frames: 3,
        frames_per_second: 1234.5,
        support_vectors: 4000,
        epoch: 9,
        queues: names(round),
        queue_depths: (0..round % 4).collect(),
        queue_capacities: vec![64; (round % 4) as usize],
        act_p99_ms: 3.5,
        frame_p99_ms: 0.25,
        rss_bytes: 1 << 33,
    }
}

fn diagnostics(header: Header, round: u32) -> Log {
    Log {
        stamp: Time::new(header.stamp_ns()),
        level: Log::WARN,
        name: "adagio.dictionary".into(),
        msg: format!("round {round}: ν = 10⁻⁴"),
        file: String::new(),
        function: "accept".into(),
        line: round * 100,
    }
}

/// Decodes bytes as every type; what matters is that each ends.
pub fn decode_all(bytes: &[u8]) {
    let _ = cdr::decode::<Image>(bytes);
    let _ = cdr::decode::<LaserScan>(bytes);
    let _ = cdr::decode::<Odometry>(bytes);
    let _ = cdr::decode::<PoseStamped>(bytes);
    let _ = cdr::decode::<TwistStamped>(bytes);
    let _ = cdr::decode::<Log>(bytes);
    let _ = cdr::decode::<Decision>(bytes);
    let _ = cdr::decode::<FrameTaken>(bytes);
    let _ = cdr::decode::<GoalMoved>(bytes);
    let _ = cdr::decode::<ModelRequest>(bytes);
    let _ = cdr::decode::<RunEnd>(bytes);
    let _ = cdr::decode::<Transition>(bytes);
    let _ = cdr::decode::<DictionaryGrowth>(bytes);
    let _ = cdr::decode::<ModelUpdate>(bytes);
    let _ = cdr::decode::<PolicyUpdate>(bytes);
    let _ = cdr::decode::<Evaluation>(bytes);
    let _ = cdr::decode::<Health>(bytes);
}
