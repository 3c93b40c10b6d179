//! Frames from the log of an earlier run.

use std::collections::VecDeque;
use std::sync::Arc;

use super::{
    Boundary, Frame, GoalMove, Journal, Mark, Source, View, give_until_boundary, of_log, parse_goto, parse_mark, planar,
};
use crate::log::files::FilesReader;
use crate::log::messages::{FrameTaken, GoalMoved, Image, LaserScan, Odometry, PoseStamped, RewardGiven, Text};
use crate::log::{LogError, Record, topics};
use crate::policy::Goto;
use crate::robot::{Action, Pose};
use crate::scenario::{Body, Scenario};
use crate::snapshot::{Snapshot, SnapshotError};

/// What was sensed with a frame, as far as it was read.
#[derive(Default)]
struct Sensed {
    pose: Option<Pose>,
    odometry: Option<Pose>,
    sonar: Option<Vec<f32>>,
    taken: Option<FrameTaken>,
    moved: Vec<GoalMove>,
    marks: Vec<Mark>,
    goto: Option<Goto>,
    rewards: Vec<f64>,
}

/// A recorded run as the source of frames. Commands change nothing: the robot did what it did.
///
/// Goals that were moved in the recording are moved again, where the scenario has a task of that name.
pub struct Recorded {
    scenario: Arc<Scenario>,
    records: FilesReader,
    /// Sequence number of the frame that is being put together.
    sequence: u32,
    parts: Sensed,
    ahead: VecDeque<Frame>,
    /// Frames that lack a part, and records that could not be read.
    damaged: u64,
    /// Frames up to this one are left out.
    skip_to: Option<u64>,
}

impl Recorded {
    /// The frames of a run's log files; tasks are the scenario's.
    pub fn new(scenario: Arc<Scenario>, records: FilesReader) -> Self {
        let (parts, ahead) = (Sensed::default(), VecDeque::new());
        Recorded { scenario, records, sequence: 0, parts, ahead, damaged: 0, skip_to: None }
    }

    /// Frames that could not be put together, and records that could not be read, so far.
    pub fn damaged(&self) -> u64 {
        self.damaged
    }

    /// Leave out all frames up to this one.
    pub fn skip_to(&mut self, frame: u64) {
        self.skip_to = Some(frame);
    }

    /// The next frame.
    pub fn take(&mut self) -> Option<Frame> {
        self.fill();
        self.ahead.pop_front()
    }

    fn fill(&mut self) {
        while self.ahead.is_empty() {
            match self.records.next() {
                None => return,
                Some(Ok(record)) => {
                    if self.read(&record).is_err() {
                        self.damaged += 1;
                    }
                }
                Some(Err(_)) => self.damaged += 1,
            }
        }
    }

    /// Take note of a record. The observation is the last part of a frame that is logged.
    fn read(&mut self, record: &Record) -> Result<(), LogError> {
        let Record::Message { topic, sequence, log_time_ns, .. } = record else { return Ok(()) };
        let is = |name: &str| **topic == *name;
        let part_of_frame = [
            topics::POSE.name(),
            topics::ODOMETRY.name(),
            topics::SONAR.name(),
            topics::FRAME.name(),
            topics::GOAL.name(),
            topics::MARK.name(),
            topics::GOTO.name(),
            topics::REWARD.name(),
            topics::OBSERVATION.name(),
        ];
        if !part_of_frame.contains(&&**topic) {
            return Ok(());
        }
        if *sequence != self.sequence {
            (self.sequence, self.parts) = (*sequence, Sensed::default());
        }
        if is(topics::POSE.name()) {
            self.parts.pose = Some(planar(&record.decode::<PoseStamped>()?.pose));
        } else if is(topics::ODOMETRY.name()) {
            self.parts.odometry = Some(planar(&record.decode::<Odometry>()?.pose.pose));
        } else if is(topics::SONAR.name()) {
            let scan = record.decode::<LaserScan>()?;
            // Nothing within range is +∞ in the log.
            self.parts.sonar = Some(scan.ranges.iter().map(|&range| range.min(scan.range_max)).collect());
        } else if is(topics::FRAME.name()) {
            self.parts.taken = Some(record.decode()?);
        } else if is(topics::GOAL.name()) {
            let moved: GoalMoved = record.decode()?;
            let task = self.scenario.tasks.iter().position(|task| task.name == moved.task);
            self.parts.moved.extend(task.map(|task| GoalMove { task, goal: [moved.x, moved.y] }));
        } else if is(topics::MARK.name()) {
            self.parts.marks.extend(parse_mark(&record.decode::<Text>()?.data, &self.scenario).ok());
        } else if is(topics::GOTO.name()) {
            self.parts.goto = parse_goto(&record.decode::<Text>()?.data, &self.scenario).ok();
        } else if is(topics::REWARD.name()) {
            let given: RewardGiven = record.decode()?;
            self.parts.rewards.resize(self.scenario.tasks.len(), f64::NAN);
            if let Some(task) = self.scenario.tasks.iter().position(|task| task.name == given.task) {
                self.parts.rewards[task] = given.reward;
            }
        } else {
            let image = record.decode::<Image>()?;
            let parts = std::mem::take(&mut self.parts);
            if parts.taken.as_ref().is_some_and(|taken| self.skip_to.is_some_and(|last| taken.frame <= last)) {
                return Ok(());
            }
            match self.frame(parts, image, *log_time_ns) {
                Some(frame) => self.ahead.push_back(frame),
                None => self.damaged += 1,
            }
        }
        Ok(())
    }

    fn frame(&self, parts: Sensed, image: Image, stamp_ns: u64) -> Option<Frame> {
        // The pose is not there where nobody knows it.
        let Sensed { pose: truth, odometry, sonar, taken, moved, marks, goto, rewards } = parts;
        // A program gives none; logs from before that was so have the true pose in its place.
        let odometry = odometry.filter(|_| self.scenario.robot.body != Body::Program);
        let (odometry, sonar, taken) = (odometry.map(of_log), sonar?, taken?);
        let vision = &self.scenario.vision;
        if image.data.len() != vision.values() {
            return None;
        }
        let action = match taken.action {
            FrameTaken::NO_ACTION => None,
            number => Some(self.scenario.robot.actions.get(usize::from(number))?),
        };
        Some(Frame {
            number: taken.frame,
            stamp_ns,
            view: View::Observation(image.data),
            truth,
            odometry,
            sonar,
            action,
            boundary: taken.boundary.then_some(Boundary { blocked: taken.blocked }),
            moved,
            marks,
            goto,
            rewards,
        })
    }
}

impl Source for Recorded {
    fn first(&mut self) -> Option<Frame> {
        self.take()
    }

    fn execute(&mut self, _: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        if !give_until_boundary(|| self.take(), give) {
            return false;
        }
        self.fill();
        !self.ahead.is_empty()
    }
}

/// A run that goes on: the frames of its log first, then those of the robot.
pub struct Resumed {
    recorded: Recorded,
    live: Box<dyn Source + Send>,
    /// Whether the robot does what the recorded one did, while those frames are given.
    repeats: bool,
}

impl Resumed {
    /// The recorded frames, then those of `live`, a simulated robot at its start: it repeats what the recorded one did.
    pub fn repeating(recorded: Recorded, live: Box<dyn Source + Send>) -> Self {
        Resumed { recorded, live, repeats: true }
    }

    /// The recorded frames, then those of `live`, a robot that is where it is.
    pub fn beside(recorded: Recorded, live: Box<dyn Source + Send>) -> Self {
        Resumed { recorded, live, repeats: false }
    }
}

impl Source for Resumed {
    fn first(&mut self) -> Option<Frame> {
        if !self.repeats {
            return self.recorded.take().or_else(|| self.live.first());
        }
        let first = self.live.first();
        self.recorded.take().or(first)
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        let (mut last, mut action) = (None, action);
        while let Some(frame) = self.recorded.take() {
            last = Some(frame.number);
            // Somebody may have made the robot do something else than was decided.
            action = frame.action.unwrap_or(action);
            let ends = frame.boundary.is_some();
            if !give(frame) {
                return true;
            }
            if ends {
                return !self.repeats || self.live.execute(action, &mut |_| true);
            }
        }
        // The log may end in the middle of an action: the rest of its frames come from a robot that repeats it. Another one says
        // where it is, and that belongs to no action.
        let repeats = self.repeats;
        self.live.execute(action, &mut |frame| repeats && last.is_some_and(|last| frame.number <= last) || give(frame))
    }

    fn keep_journal(&mut self, journal: Option<Journal>) {
        self.live.keep_journal(journal);
    }

    fn persist(&mut self, parts: &mut Snapshot) -> Result<(), SnapshotError> {
        self.live.persist(parts)
    }
}
