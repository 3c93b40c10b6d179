//! Frames from the log of another program: a ROS 2 bag with camera, pose and, if there are any, commands or actions.
//!
//! ```text
//!  survey ──roles──▶ senses ──image, pose, command──▶ cutting ──segments──▶ frames
//!  which topic         what was sensed                  actions                as any other source
//!  is what             with each image                  (source::segments)     gives them
//! ```
//!
//! - The pose of an image is interpolated between the poses before and after it. Images without both are left out.
//! - Frames during which the robot did nothing that is an action are left out, too. The last one before an action is
//!   given without an action, as the first frame of all is: nothing is learned over the break, and the action begins at it.
//! - So it is after a gap, which is a break between images that is longer than `topics.gap_intervals` usual intervals, and
//!   where the pose or odometry jumps.
//! - Vision makes observations of the images right here, so that what waits for the end of its action is small.

mod actions;
pub mod picture;
mod senses;
mod topics;

pub use picture::{MOST_PIXELS, PictureError, compressed, crop, raw};
pub use senses::{ROBOT_FRAMES, pose_of};
pub use topics::{ImportError, LogContents, Roles, Seen, stamp_ns};

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Serialize;

use self::actions::RecordedActions;
use self::senses::{Sensed, Senses};
use super::{Boundary, Frame, Rule, Segment, Segmenter, Source, Step, View, give_until_boundary, of_log};
use crate::log::FilesReader;
use crate::robot::{Action, Pose};
use crate::scenario::Scenario;

/// Most frames that an action of a scenario may have.
const MOST_FRAMES_PER_ACTION: f64 = 100.0;

/// What came of another program's log.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct ImportReport {
    /// Images that were looked at.
    pub images: u64,
    /// Frames that were made of them.
    pub frames: u64,
    /// Actions found, by their numbers.
    pub actions: Vec<u64>,
    /// Their names.
    pub action_names: Vec<String>,
    /// Actions that were blocked.
    pub blocked: u64,
    /// Images left out because the robot did nothing then that is an action.
    pub without_action: u64,
    /// Breaks between images.
    pub gaps: u64,
    /// Times that the pose or odometry jumped; a break, too.
    pub jumps: u64,
    /// Images left out because they could not be read; and why the first of them.
    pub unusable_images: u64,
    /// Why the first of these could not be read.
    pub first_unusable: Option<String>,
    /// Images left out because they are not later than the one before.
    pub out_of_order: u64,
    /// Images left out because there is no pose before and after them.
    pub without_pose: u64,
    /// Marks of what is not to be shown; and what is said of the first of them.
    pub unknown_marks: u64,
    /// What is said of the first of these.
    pub first_unknown_mark: Option<String>,
    /// Other messages that could not be read, and damaged records.
    pub damaged: u64,
}

/// How the frames come to their actions.
enum Segmentation {
    Motion(Box<Segmenter>),
    RecordedActions(RecordedActions),
}

impl Segmentation {
    fn interrupt(&mut self) {
        match self {
            Segmentation::Motion(cutter) => cutter.interrupt(),
            Segmentation::RecordedActions(commanded) => commanded.interrupt(),
        }
    }

    fn finished(&mut self) -> Option<Segment> {
        match self {
            Segmentation::Motion(cutter) => cutter.finished(),
            Segmentation::RecordedActions(commanded) => commanded.finished(),
        }
    }
}

/// Another program's log as the source of frames. Commands change nothing.
pub struct Imported {
    scenario: Arc<Scenario>,
    rule: Rule,
    gap_ns: u64,
    senses: Senses,
    cutting: Segmentation,
    /// Images that belong to no segment yet, and before them the last one of the segment before.
    held: VecDeque<Sensed>,
    /// Whether that last one was given as the end of an action.
    given: bool,
    ready: VecDeque<Frame>,
    ended: bool,
    sensed: u64,
}

/// How many images an action of the scenario's duration has, by the usual time between them.
///
/// # Errors
/// Less than one, or more than a scenario may have.
pub fn frames_per_action(survey: &LogContents, roles: &Roles, scenario: &Scenario) -> Result<usize, ImportError> {
    let Some(interval) = usual_interval_ns(survey, roles, scenario) else {
        let reason = format!("{} holds no two images with different stamps", survey.path.display());
        return Err(ImportError::Rate(reason));
    };
    let (seconds, every) = (scenario.robot.action_seconds, scenario.topics.every);
    let frames = (seconds * 1e9 / interval).round();
    if (1.0..=MOST_FRAMES_PER_ACTION).contains(&frames) {
        return Ok(frames as usize);
    }
    Err(ImportError::Rate(format!(
        "images come every {:.4} s, which is {:.2} in an action of robot.action_seconds = {seconds} s: there must be 1 to \
         {MOST_FRAMES_PER_ACTION}; change that to the time that the robot takes for an action, or topics.every = {every}",
        interval / 1e9,
        seconds * 1e9 / interval
    )))
}

/// Usual time between the images that are used, nanoseconds.
fn usual_interval_ns(survey: &LogContents, roles: &Roles, scenario: &Scenario) -> Option<f64> {
    let interval = survey.topics.get(&roles.camera)?.interval_ns()?;
    Some(interval as f64 * scenario.topics.every as f64)
}

impl Imported {
    /// The frames of a log that was surveyed, up to the first one: whether there is any is known then.
    ///
    /// # Errors
    /// [`ImportError::Nothing`], [`ImportError::Rate`].
    pub fn open(scenario: Arc<Scenario>, survey: &LogContents, roles: &Roles) -> Result<Self, ImportError> {
        let usual = usual_interval_ns(survey, roles, &scenario);
        let usual = usual.ok_or_else(|| ImportError::Rate("there are no two images".into()))?;
        let rule = Rule::of(&scenario.robot);
        let cutting = match &roles.action {
            Some(_) => {
                Segmentation::RecordedActions(RecordedActions::new(scenario.robot.actions.clone(), rule.forward))
            }
            None => Segmentation::Motion(Box::default()),
        };
        let mut imported = Imported {
            rule,
            gap_ns: (scenario.topics.gap_intervals * usual) as u64,
            senses: Senses::new(scenario.clone(), roles.clone(), FilesReader::new(survey.files.clone())),
            scenario,
            cutting,
            held: VecDeque::new(),
            given: false,
            ready: VecDeque::new(),
            ended: false,
            sensed: 0,
        };
        imported.fill();
        if imported.ready.is_empty() {
            let reason = imported.why_nothing(survey, roles);
            let images = imported.senses.report.images;
            return Err(ImportError::Nothing { path: survey.path.clone(), images, reason });
        }
        Ok(imported)
    }

    /// What came of the log so far.
    pub fn report(&self) -> ImportReport {
        let report = self.senses.report.clone();
        let without_action = self.sensed + u64::from(self.given) - report.frames - self.held.len() as u64;
        ImportReport { without_action, ..report }
    }

    /// What most images lack, when no frame came of any.
    fn why_nothing(&self, survey: &LogContents, roles: &Roles) -> String {
        let report = &self.senses.report;
        if self.sensed > 0 {
            let robot = &self.scenario.robot;
            return match roles.action {
                Some(_) => format!("no action of {:?} lies among them", roles.action.as_deref().unwrap_or_default()),
                None => format!(
                    "the robot stands still in all of them, or does less than half an action; an action is robot.forward = {} m \
                     or robot.turn_deg = {}° in about robot.action_seconds = {} s, and less than a tenth of it in that time \
                     is standing still",
                    robot.forward, robot.turn_deg, robot.action_seconds
                ),
            };
        }
        if let Some(reason) = report.first_unusable.as_ref().filter(|_| report.unusable_images >= report.without_pose) {
            return reason.clone();
        }
        let times = |topic: &str| {
            let (first, last) = survey.topics.get(topic).map_or((0, 0), |seen| seen.stamps_ns);
            format!("{topic} from {:.3} to {:.3} s", first as f64 / 1e9, last as f64 / 1e9)
        };
        format!(
            "none lies between two poses that are at most robot.action_seconds = {} s apart: there is {}, and {}; do their \
             clocks differ (topics.stamps = \"log\" takes the log's)?",
            self.scenario.robot.action_seconds,
            times(&roles.camera),
            times(roles.pose.as_deref().unwrap_or_default())
        )
    }

    fn fill(&mut self) {
        while self.ready.is_empty() && !self.ended {
            match self.senses.next() {
                Some(sensed) => self.take(sensed),
                None => {
                    self.interrupt();
                    self.ended = true;
                }
            }
        }
    }

    fn take(&mut self, sensed: Sensed) {
        self.sensed += 1;
        if let Some(last) = self.held.back() {
            let interval = sensed.stamp_ns.saturating_sub(last.stamp_ns);
            let (is_gap, seconds) = (interval > self.gap_ns, interval as f64 / 1e9);
            let poses = last.pose.zip(sensed.pose);
            let jumps = |poses: Option<(Pose, Pose)>| {
                poses.is_some_and(|(before, now)| self.rule.is_jump(&before, &now, seconds))
            };
            if is_gap || jumps(poses) || jumps(last.odometry.zip(sensed.odometry)) {
                self.interrupt();
                self.senses.report.gaps += u64::from(is_gap);
                self.senses.report.jumps += u64::from(!is_gap);
            } else {
                let step = match poses {
                    Some((before, now)) => self.rule.step(&before, &now, seconds, sensed.commanded),
                    None => self.rule.unmeasured(seconds),
                };
                self.cut(step, sensed.stamp_ns);
            }
        }
        self.held.push_back(sensed);
        self.give_finished();
    }

    /// What comes next has nothing to do with what was.
    fn interrupt(&mut self) {
        self.cutting.interrupt();
        self.give_finished();
        self.leave_out(self.held.len());
        self.given = false;
    }

    /// The first images that are held show nothing that is an action: only those that were marked are given.
    fn leave_out(&mut self, images: usize) {
        for index in usize::from(self.given)..images {
            if self.held.get(index).is_some_and(|sensed| !sensed.marks.is_empty()) {
                self.give(index, None, Some(false));
            }
        }
        self.held.drain(..images);
    }

    fn cut(&mut self, step: Step, stamp_ns: u64) {
        match &mut self.cutting {
            Segmentation::Motion(cutter) => cutter.push(step),
            Segmentation::RecordedActions(commanded) => {
                // The image that shows how an action began is the last one of the action before.
                while let Some((_, action)) = self.senses.action_before(stamp_ns) {
                    commanded.begin(action);
                }
                commanded.push(step);
            }
        }
    }

    /// Make frames of the segments that are finished.
    fn give_finished(&mut self) {
        while let Some(segment) = self.cutting.finished() {
            let Some(action) = segment.action else {
                self.leave_out(segment.frames);
                self.given = false;
                continue;
            };
            self.senses.report.actions[action.index()] += 1;
            self.senses.report.blocked += u64::from(segment.blocked);
            if !self.given {
                self.give(0, None, Some(false));
            }
            for index in 1..=segment.frames {
                self.give(index, Some(action), (index == segment.frames).then_some(segment.blocked));
            }
            self.held.drain(..segment.frames);
            self.given = true;
        }
    }

    /// Make a frame of an image that is held; `ends`: it is at the end of an action, which was blocked or not.
    fn give(&mut self, index: usize, action: Option<Action>, ends: Option<bool>) {
        let Some(sensed) = self.held.get_mut(index) else { return };
        self.ready.push_back(Frame {
            number: self.senses.report.frames,
            stamp_ns: sensed.stamp_ns,
            // It is given once: only its pose is needed again.
            view: View::Observation(std::mem::take(&mut sensed.pixels)),
            truth: sensed.pose.filter(|_| self.scenario.robot.pose_known),
            odometry: sensed.odometry.map(of_log),
            sonar: std::mem::take(&mut sensed.sonar),
            action,
            boundary: ends.map(|blocked| Boundary { blocked }),
            moved: Vec::new(),
            marks: std::mem::take(&mut sensed.marks),
            goto: None,
            rewards: if ends.is_some() { std::mem::take(&mut sensed.rewards) } else { Vec::new() },
        });
        self.senses.report.frames += 1;
    }

    fn next_frame(&mut self) -> Option<Frame> {
        self.fill();
        self.ready.pop_front()
    }
}

impl Source for Imported {
    fn first(&mut self) -> Option<Frame> {
        self.next_frame()
    }

    fn execute(&mut self, _: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        if !give_until_boundary(|| self.next_frame(), give) {
            return false;
        }
        self.fill();
        !self.ready.is_empty()
    }

    fn imported(&self) -> Option<ImportReport> {
        Some(self.report())
    }
}
