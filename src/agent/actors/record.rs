//! The record actor, which owns the log, and the messages that each event becomes in it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use faer::Mat;

use super::messages::{Decision, Growth, Percept, Update};
use crate::agent::runtime::queue::{Closed, Inbox, Outbox};
use crate::agent::runtime::status::StatusValues;
use crate::evaluate::TaskResult;
use crate::log::messages as msg;
use crate::log::{LogError, Message, RunLog, RunTotals, Topic, topics};
use crate::policy::{Behaviour, Goto, Learned, Prospect, PursuitEnd};
use crate::robot::{Action, ActionSet, Pose, Velocity};
use crate::scenario::Scenario;
use crate::source::live::{Event, Reading, Received};
use crate::source::{Frame, GoalMove, Mark, mark_text};
use crate::value::place::Pose as PlacePose;
use crate::vision::Observation;

/// One write, to be done by the thread that owns the file.
pub type Write = Box<dyn FnOnce(&mut RunLog) -> Result<(), LogError> + Send>;

/// Where actors put what is to be logged.
#[derive(Clone)]
pub struct Recorder {
    outbox: Outbox<Write>,
    scenario: Arc<Scenario>,
    actions: ActionSet,
}

/// Level of a diagnostic.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    Info,
    Warn,
    Error,
}

/// The log actor: do all writes in their order, flush on time, and close the file at the end. With `by_stamps` that time is
/// told by the stamps of the messages, so many times faster than they say.
pub fn write_log(
    inbox: &Inbox<Write>,
    mut log: RunLog,
    flush: Duration,
    by_stamps: Option<f64>,
) -> Result<RunTotals, LogError> {
    let begin = Instant::now();
    let mut first_stamp = None;
    let mut busy = Duration::ZERO;
    loop {
        let taken = inbox.take_within(flush / 4);
        let woken = Instant::now();
        match taken {
            Ok(Some(write)) => write(&mut log)?,
            Ok(None) => {}
            Err(Closed) => {
                let mut totals = log.finish()?;
                totals.busy = busy + woken.elapsed();
                return Ok(totals);
            }
        }
        log.tick(match by_stamps {
            None => woken,
            Some(speed) => {
                if first_stamp.is_none() && log.stamp_ns() > 0 {
                    first_stamp = Some(log.stamp_ns());
                }
                let passed = log.stamp_ns().saturating_sub(first_stamp.unwrap_or_default());
                begin + Duration::from_nanos(passed).div_f64(speed)
            }
        })?;
        busy += woken.elapsed();
    }
}

impl Recorder {
    pub fn new(outbox: Outbox<Write>, scenario: Arc<Scenario>) -> Self {
        Recorder { actions: scenario.robot.actions.clone(), outbox, scenario }
    }

    fn write<M: Message + Send + 'static>(
        &self,
        topic: Topic<M>,
        sequence: u64,
        stamp_ns: u64,
        message: M,
    ) -> Result<(), Closed> {
        // Sequence numbers of the format have 32 bits; they wrap, frame numbers inside of messages do not.
        let sequence = sequence as u32;
        self.outbox.put(Box::new(move |log| log.write(topic, sequence, stamp_ns, &message)))
    }

    /// Wait until everything that was put in before has been handed to the operating system.
    pub fn flush(&self) -> Result<(), Closed> {
        let (done, wait) = self.outbox.reply();
        self.outbox.put(Box::new(move |log| {
            log.flush()?;
            // Whoever waits may have ended.
            let _ = done.put(());
            Ok(())
        }))?;
        wait.take()
    }

    /// What was sensed with a frame, and the observation that was made of it.
    pub fn frame(&self, frame: &Frame) -> Result<(), Closed> {
        let (number, stamp) = (frame.number, frame.stamp_ns);
        let header = |frame_id: &str| msg::Header::new(stamp, frame_id);
        if let Some(truth) = &frame.truth {
            let pose = msg::PoseStamped { header: header("map"), pose: planar(truth) };
            self.write(topics::POSE, number, stamp, pose)?;
        }
        if let Some(odometry) = &frame.odometry {
            let odometry = msg::Odometry {
                header: header("odom"),
                child_frame_id: "base_link".into(),
                pose: msg::PoseWithCovariance { pose: planar(odometry), ..Default::default() },
                ..Default::default()
            };
            self.write(topics::ODOMETRY, number, stamp, odometry)?;
        }
        let reach = self.scenario.robot.sonar_range as f32;
        let increment = std::f32::consts::TAU / frame.sonar.len().max(1) as f32;
        let sonar = msg::LaserScan {
            header: header("base_link"),
            angle_min: 0.0,
            angle_max: std::f32::consts::TAU - increment,
            angle_increment: increment,
            range_max: reach,
            // REP 117: nothing within range is +∞.
            ranges: frame.sonar.iter().map(|&range| if range < reach { range } else { f32::INFINITY }).collect(),
            ..Default::default()
        };
        self.write(topics::SONAR, number, stamp, sonar)?;
        for (task, &reward) in self.scenario.tasks.iter().zip(&frame.rewards).filter(|(task, _)| task.topic.is_some()) {
            let task = task.name.clone();
            let given = msg::RewardGiven { header: header("base_link"), frame: number, task, reward };
            self.write(topics::REWARD, number, stamp, given)?;
        }
        let taken = msg::FrameTaken {
            header: header("camera"),
            frame: number,
            action: frame.action.map_or(msg::FrameTaken::NO_ACTION, |action| action.index() as u8),
            boundary: frame.boundary.is_some(),
            blocked: frame.boundary.as_ref().is_some_and(|boundary| boundary.blocked),
        };
        self.write(topics::FRAME, number, stamp, taken)
    }

    /// What a robot that takes velocities said, was told, and is doing.
    pub fn robot(&self, event: Event) -> Result<(), Closed> {
        let header = |stamp_ns: u64, frame: &str| msg::Header::new(stamp_ns, frame);
        match event {
            Event::Heard(Received { stamp_ns, reading, .. }) => self.heard(stamp_ns, reading),
            Event::Commanded { stamp_ns, velocity } => {
                let message = msg::TwistStamped { header: header(stamp_ns, "base_link"), twist: twist(velocity) };
                self.write(topics::ROBOT_COMMAND, 0, stamp_ns, message)
            }
            Event::Changed { stamp_ns, state, causes } => {
                let (state, causes) = (state.name().to_owned(), causes.to_string());
                let message = msg::RobotState { header: header(stamp_ns, "base_link"), state, causes };
                self.write(topics::ROBOT_STATE, 0, stamp_ns, message)
            }
            Event::Note { stamp_ns, text } => self.diagnostic(Level::Warn, stamp_ns, text),
        }
    }

    fn heard(&self, stamp_ns: u64, reading: Reading) -> Result<(), Closed> {
        let header = |frame: &str| msg::Header::new(stamp_ns, frame);
        let (name, values) = match reading {
            // Marks are logged with their frames, and images as observations.
            Reading::Image(_) | Reading::Mark(_) | Reading::Note(_) => return Ok(()),
            Reading::Odometry { pose, velocity } => {
                let odometry = msg::Odometry {
                    header: header("odom"),
                    child_frame_id: "base_link".into(),
                    pose: msg::PoseWithCovariance { pose: planar(&pose), ..Default::default() },
                    twist: msg::TwistWithCovariance { twist: twist(velocity), ..Default::default() },
                };
                return self.write(topics::ROBOT_ODOMETRY, 0, stamp_ns, odometry);
            }
            Reading::Scan(scan) => {
                let (first, step) = (scan.first as f32, scan.step as f32);
                let scan = msg::LaserScan {
                    header: header("base_link"),
                    angle_min: first,
                    angle_max: first + step * scan.ranges.len().saturating_sub(1) as f32,
                    angle_increment: step,
                    range_max: f32::MAX,
                    ranges: scan.ranges.clone(),
                    ..Default::default()
                };
                return self.write(topics::ROBOT_SCAN, 0, stamp_ns, scan);
            }
            Reading::Bumper(pressed) => ("bumper", vec![f64::from(u8::from(pressed))]),
            Reading::EmergencyStop(pressed) => ("emergency_stop", vec![f64::from(u8::from(pressed))]),
            Reading::Lock(locked) => ("lock", vec![f64::from(u8::from(locked))]),
            Reading::Teleop(Velocity { linear, angular }) => ("teleop", vec![linear, angular]),
            Reading::Battery(charge) => ("battery", vec![charge]),
            Reading::Pose(pose) => ("pose", vec![pose.position.x, pose.position.y, pose.heading]),
            Reading::Reward { task, reward } => ("reward", vec![task as f64, reward]),
        };
        let message = msg::RobotInput { header: header("base_link"), name: name.to_owned(), values };
        self.write(topics::ROBOT_INPUT, 0, stamp_ns, message)
    }

    /// Tasks that moved with a frame.
    pub fn goals(&self, moved: &[GoalMove], frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        for &GoalMove { task, goal: [x, y] } in moved {
            let task = self.scenario.tasks[task].name.clone();
            let header = msg::Header::new(stamp_ns, "map");
            self.write(topics::GOAL, frame, stamp_ns, msg::GoalMoved { header, frame, task, x, y })?;
        }
        Ok(())
    }

    /// What was marked with a frame, as robots say it: the task's name, on its own the goal.
    pub fn marks(&self, marks: &[Mark], frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        for mark in marks {
            let data = mark_text(self.scenario.names().nth(mark.task).unwrap_or_default(), mark.kind);
            self.write(topics::MARK, frame, stamp_ns, msg::Text { data })?;
        }
        Ok(())
    }

    /// Where somebody sends the robot with a frame, as they say it.
    pub fn goto(&self, goto: Option<Goto>, frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        let Some(goto) = goto else { return Ok(()) };
        let data = match goto {
            Goto::Task(task) => self.scenario.tasks[task].name.clone(),
            Goto::Schedule => String::new(),
        };
        self.write(topics::GOTO, frame, stamp_ns, msg::Text { data })
    }

    /// A pursuit that is over.
    pub fn pursuit(&self, end: PursuitEnd, frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        let header = msg::Header::new(stamp_ns, "base_link");
        let PursuitEnd { task, arrived, actions, .. } = end;
        let task = self.scenario.tasks[task].name.clone();
        let message = msg::PursuitEnded { header, frame, task, arrived, actions: actions as u32 };
        self.write(topics::PURSUIT, frame, stamp_ns, message)
    }

    /// The observation that is learned from.
    pub fn observation(&self, observation: &Observation, stamp_ns: u64) -> Result<(), Closed> {
        let vision = &self.scenario.vision;
        let image = msg::Image {
            header: msg::Header::new(stamp_ns, "camera"),
            height: vision.height as u32,
            width: vision.width as u32,
            encoding: "rgb8".into(),
            is_bigendian: 0,
            step: 3 * vision.width as u32,
            data: observation.pixels.clone(),
        };
        self.write(topics::OBSERVATION, observation.frame, stamp_ns, image)
    }

    /// What an action came to.
    pub fn transition(&self, from_frame: u64, action: Action, percept: &Percept) -> Result<(), Closed> {
        let message = msg::Transition {
            header: msg::Header::new(percept.stamp_ns, "base_link"),
            from_frame,
            to_frame: percept.observation.frame,
            action: action.index() as u8,
            blocked: percept.outcomes.blocked,
            tasks: self.scenario.tasks.iter().map(|task| task.name.clone()).collect(),
            rewards: percept.outcomes.rewards.iter().map(|reward| reward + percept.outcomes.avoided).collect(),
        };
        self.write(topics::TRANSITION, percept.observation.frame, percept.stamp_ns, message)
    }

    /// A decision, and the command that follows from it.
    pub fn decision(&self, decision: &Decision, frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        let motion = self.actions.motion(decision.action);
        let seconds = self.scenario.robot.action_seconds;
        let (linear, angular) = (motion.distance / seconds, motion.angle / seconds);
        let command = msg::TwistStamped {
            header: msg::Header::new(stamp_ns, "base_link"),
            twist: twist(Velocity { linear, angular }),
        };
        self.write(topics::COMMAND, frame, stamp_ns, command)?;
        let (behaviour, task) = match decision.leg {
            Behaviour::Explore => (msg::Decision::EXPLORE, String::new()),
            Behaviour::Pursue(task) => (msg::Decision::PURSUE, self.scenario.tasks[task].name.clone()),
        };
        let message = msg::Decision {
            header: msg::Header::new(stamp_ns, "base_link"),
            frame,
            action_index: decision.number as u64,
            action: decision.action.index() as u8,
            behaviour,
            task,
            epoch: decision.epoch,
            q_values: decision.q_values.map_or(Vec::new(), |values| values.to_vec()),
            reflex: decision.reflex,
        };
        let task = message.task.clone();
        self.write(topics::DECISION, frame, stamp_ns, message)?;
        if let Some(Prospect { done, actions, arrival }) = decision.prospect {
            let header = msg::Header::new(stamp_ns, "base_link");
            let message = msg::Prospect { header, frame, task, done: done as u32, actions, arrival };
            self.write(topics::PROSPECT, frame, stamp_ns, message)?;
        }
        if decision.places.is_empty() {
            return Ok(());
        }
        let of = |part: fn(&(PlacePose, f64)) -> f64| decision.places.iter().map(part).collect();
        let places = msg::PlaceBelief {
            // The frame of a map that the robot has made is no frame of others.
            header: msg::Header::new(stamp_ns, ""),
            frame,
            probabilities: of(|place| place.1),
            x: of(|place| place.0.x),
            y: of(|place| place.0.y),
            headings: of(|place| place.0.heading),
        };
        self.write(topics::PLACES, frame, stamp_ns, places)
    }

    /// What a block of frames did to the dictionary.
    pub fn growth(&self, growth: Growth) -> Result<(), Closed> {
        let message = msg::DictionaryGrowth {
            header: msg::Header::new(growth.stamp_ns, ""),
            first_frame: growth.first_frame,
            last_frame: growth.last_frame,
            accepted: growth.accepted,
            quarantined: growth.quarantined,
            size: growth.size as u32,
            sigma: growth.sigma,
            nu: growth.nu.unwrap_or(f64::NAN),
            at_budget: growth.at_budget,
        };
        self.write(topics::DICTIONARY, growth.last_frame, growth.stamp_ns, message)
    }

    /// The last frame.
    pub fn end(&self, frame: u64, stamp_ns: u64) -> Result<(), Closed> {
        let message = msg::RunEnd { header: msg::Header::new(stamp_ns, ""), frame };
        self.write(topics::END, frame, stamp_ns, message)
    }

    /// A request for a model at a frame, which makes it `frames` frames, with so many transitions.
    pub fn request(&self, asked_at: u64, stamp_ns: u64, frames: u64, transitions: usize) -> Result<(), Closed> {
        let header = msg::Header::new(stamp_ns, "");
        let message = msg::ModelRequest { header, frame: asked_at, frames, transitions: transitions as u32 };
        self.write(topics::REQUEST, asked_at, stamp_ns, message)
    }

    /// A model and its policies, at the frame from which they act.
    pub fn update(&self, update: &Update, learned: &Learned, effective_at: u64, stamp_ns: u64) -> Result<(), Closed> {
        let header = msg::Header::new(stamp_ns, "");
        let model = msg::ModelUpdate {
            header: header.clone(),
            epoch: learned.epoch,
            asked_at_frame: update.asked_at,
            effective_at_frame: effective_at,
            frames: learned.frames,
            support_vectors: learned.model.members.ncols() as u32,
            regulariser: self.scenario.slow.lambda,
            slowness: learned.model.slowness.clone(),
            digest: learned.model_digest(),
        };
        self.write(topics::MODEL, effective_at, stamp_ns, model)?;
        let none = Mat::new();
        for (task, (weights, fit)) in learned.weights.iter().zip(&update.fits).enumerate() {
            // What transitions are worth is in the checkpoint: they are as many as the window holds.
            let weights = if learned.instances.is_some() { &none } else { weights };
            let policy = msg::PolicyUpdate {
                header: header.clone(),
                epoch: learned.epoch,
                effective_at_frame: effective_at,
                task: self.scenario.tasks[task].name.clone(),
                gamma: self.scenario.value.gamma,
                transitions: update.transitions as u32,
                iterations: fit.iterations as u32,
                converged: fit.converged,
                actions: weights.ncols() as u32,
                features: weights.nrows() as u32,
                weights: (0..weights.ncols())
                    .flat_map(|a| weights.col(a).iter().copied().collect::<Vec<_>>())
                    .collect(),
                digest: learned.policy_digest(task),
            };
            self.write(topics::POLICY, effective_at, stamp_ns, policy)?;
        }
        Ok(())
    }

    /// Results of an evaluation beside the run.
    pub fn evaluation(&self, results: &[TaskResult], learned: &Learned, stamp_ns: u64) -> Result<(), Closed> {
        for result in results {
            let message = msg::Evaluation {
                header: msg::Header::new(stamp_ns, ""),
                epoch: learned.epoch,
                frame: learned.asked_at,
                task: result.name.clone(),
                starts: result.starts as u32,
                success: result.success,
                success_wilson_low: result.success_wilson_low,
                mean_steps: result.mean_steps.unwrap_or(f64::NAN),
                optimal_mean_steps: result.optimal_mean_steps,
                convergence_quality: result.convergence_quality,
            };
            self.write(topics::EVALUATION, learned.asked_at, stamp_ns, message)?;
        }
        Ok(())
    }

    /// How the run is doing.
    pub fn health(&self, status: &StatusValues, frames_per_second: f64, rss_bytes: u64) -> Result<(), Closed> {
        let message = msg::Health {
            header: msg::Header::new(status.stamp_ns, ""),
            frames: status.frames,
            dropped_frames: status.dropped,
            quarantined_frames: status.quarantined,
            frames_per_second,
            support_vectors: status.support_vectors as u32,
            epoch: status.epoch,
            queues: status.queues.iter().map(|queue| queue.0.to_owned()).collect(),
            queue_depths: status.queues.iter().map(|queue| queue.1 as u32).collect(),
            queue_capacities: status.queues.iter().map(|queue| queue.2 as u32).collect(),
            act_p99_ms: status.act_p99_ms,
            frame_p99_ms: status.frame_p99_ms,
            rss_bytes,
        };
        self.write(topics::HEALTH, status.frames, status.stamp_ns, message)
    }

    /// A line of diagnostics.
    pub fn diagnostic(&self, level: Level, stamp_ns: u64, text: String) -> Result<(), Closed> {
        let level = match level {
            Level::Info => msg::Log::INFO,
            Level::Warn => msg::Log::WARN,
            Level::Error => msg::Log::ERROR,
        };
        let message =
            msg::Log { stamp: msg::Time::new(stamp_ns), level, name: "adagio".into(), msg: text, ..Default::default() };
        self.write(topics::DIAGNOSTICS, 0, stamp_ns, message)
    }

    /// A file kept in the log.
    pub fn attach(&self, name: &'static str, bytes: Vec<u8>, stamp_ns: u64) -> Result<(), Closed> {
        self.outbox.put(Box::new(move |log| log.attach(name, "application/octet-stream", &bytes, stamp_ns)))
    }
}

fn twist(velocity: Velocity) -> msg::Twist {
    msg::Twist {
        linear: msg::Vector3 { x: velocity.linear, y: 0.0, z: 0.0 },
        angular: msg::Vector3 { x: 0.0, y: 0.0, z: velocity.angular },
    }
}

fn planar(pose: &Pose) -> msg::Pose {
    msg::Pose::planar(pose.position.x, pose.position.y, pose.heading)
}
