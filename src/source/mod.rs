//! Where frames come from.

pub mod imported;
pub mod live;
pub mod program;
mod recorded;
mod segments;

pub use imported::{ImportReport, Imported};
pub use recorded::{Recorded, Resumed};
pub use segments::{Rule, Segment, Segmenter, Step};

use crate::log::messages as msg;
use crate::policy::Goto;
use crate::robot::{Action, Pose};
use crate::scenario::{FORGET, Scenario};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::vision::Image;

/// One camera frame with what else was sensed at that moment.
#[derive(Debug, Clone)]
pub struct Frame {
    /// Number of the frame, from 0, without gaps unless the source drops frames.
    pub number: u64,
    /// Time, nanoseconds since 1970.
    pub stamp_ns: u64,
    /// What the camera saw.
    pub view: View,
    /// The true pose, where something measures it (in the simulator a ceiling camera): for goals given by coordinates, evaluation
    /// and plots, never for features.
    pub truth: Option<Pose>,
    /// Pose by odometry, where something measures it; the heading in single precision, which the quaternion of a log gives back to the
    /// bit.
    pub odometry: Option<Pose>,
    /// Distances of the ring of sonars from the robot's centre, metres, the first straight ahead, counter-clockwise; in the
    /// precision of the log, so that a replay hears the same.
    pub sonar: Vec<f32>,
    /// The action during which this frame was taken; `None` for the first frame, and for the first after an interruption of
    /// another program's log: what was before it has nothing to do with it.
    pub action: Option<Action>,
    /// Set on the last frame of an action, and on frames before which there was none.
    pub boundary: Option<Boundary>,
    /// Goals that somebody moved before this frame; only the last frame of an action has any, since goals move between actions.
    pub moved: Vec<GoalMove>,
    /// What somebody marked with this frame.
    pub marks: Vec<Mark>,
    /// Where somebody sends the robot from here; only the last frame of an action has it.
    pub goto: Option<Goto>,
    /// Rewards from outside for the action that ends with this frame, by task, not a number where nothing was published; empty
    /// without such tasks, and where no action ends.
    pub rewards: Vec<f64>,
}

/// A pose in the precision that a log keeps, so that a replay learns from the same: there headings are quaternions, which are exact to
/// the last bits of a double, but not in them.
pub(crate) fn of_log(pose: Pose) -> Pose {
    // The largest one that stays below π.
    const MOST: f32 = std::f32::consts::PI.next_down();
    Pose { heading: f64::from((pose.heading as f32).clamp(-MOST, MOST)), ..pose }
}

/// Where a message says that something is, in the plane.
pub(crate) fn planar(pose: &msg::Pose) -> Pose {
    Pose::new([pose.position.x, pose.position.y].into(), pose.heading())
}

/// Give frames until one is a boundary; whether that came, and all of them were taken.
fn give_until_boundary(mut next: impl FnMut() -> Option<Frame>, give: &mut dyn FnMut(Frame) -> bool) -> bool {
    while let Some(frame) = next() {
        let ends = frame.boundary.is_some();
        if !give(frame) {
            return false;
        }
        if ends {
            return true;
        }
    }
    false
}

/// Somebody says what a task's goal is, or what is to be avoided, while the robot is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Mark {
    /// Number of the task, from 0, see [`Scenario::names`].
    pub task: usize,
    /// What is said.
    pub kind: MarkKind,
}

/// A mark as text, as messages hold it: the task's name, for what is forgotten with that word before it.
pub fn mark_text(task: &str, kind: MarkKind) -> String {
    match kind {
        MarkKind::Here => task.to_owned(),
        MarkKind::Forget => format!("{FORGET}{task}"),
    }
}

/// A mark from its text, with the number of its task.
///
/// # Errors
/// There is no such task, or it is not shown; the text names those that are.
pub fn parse_mark(text: &str, scenario: &Scenario) -> Result<Mark, String> {
    let shown = |name: &str| scenario.names().position(|of| of == name).filter(|&number| scenario.is_shown(number));
    if let Some(task) = shown(text) {
        return Ok(Mark { task, kind: MarkKind::Here });
    }
    match text.strip_prefix(FORGET).and_then(shown) {
        Some(task) => Ok(Mark { task, kind: MarkKind::Forget }),
        None => {
            let names = scenario.names().enumerate().filter(|&(number, _)| scenario.is_shown(number)).map(|of| of.1);
            Err(format!(
                "{text:?} marks nothing: it must be the name of a task that is shown ({}), or \"forget\" and such a name",
                names.collect::<Vec<_>>().join(", ")
            ))
        }
    }
}

/// Where somebody sends the robot, from text as messages hold it: a task's name; nothing for wherever the schedule has it go.
///
/// # Errors
/// There is no such task; the text names those that are.
pub fn parse_goto(text: &str, scenario: &Scenario) -> Result<Goto, String> {
    if text.is_empty() {
        return Ok(Goto::Schedule);
    }
    scenario.tasks.iter().position(|task| task.name == text).map(Goto::Task).ok_or_else(|| {
        let names: Vec<&str> = scenario.tasks.iter().map(|task| task.name.as_str()).collect();
        format!("there is no task {text:?}: there are {}", names.join(", "))
    })
}

/// What a mark says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum MarkKind {
    /// It is here.
    Here,
    /// Nothing that was marked so far counts any more.
    Forget,
}

/// The goal of a task is somewhere else from now on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalMove {
    /// Number of the task, from 0.
    pub task: usize,
    /// The centre of its goal area, metres.
    pub goal: [f64; 2],
}

/// What the camera saw, before or after vision.
#[derive(Debug, Clone, PartialEq)]
pub enum View {
    /// A camera image.
    Image(Image),
    /// An observation that vision has made already, as a log holds it: [`Observation::pixels`](crate::vision::Observation).
    Observation(Vec<u8>),
}

impl View {
    /// The camera image, if vision has not seen it yet.
    pub fn image(&self) -> Option<&Image> {
        match self {
            View::Image(image) => Some(image),
            View::Observation(_) => None,
        }
    }
}

/// What an action came to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Boundary {
    /// Whether a wall stopped the robot.
    pub blocked: bool,
}

/// Takes what happens beside frames.
pub type Journal = Box<dyn Fn(live::Event) + Send>;

/// A robot, simulated, real or recorded, that executes actions and gives frames.
pub trait Source {
    /// The frame before the first action; none if there is not even one.
    fn first(&mut self) -> Option<Frame>;

    /// Execute an action and give its frames in order; the last one is a boundary. Stops early if `give` says so. Returns
    /// whether it can go on: a recording ends. When it returns, a robot stands still until the next call, however long that
    /// takes: the run may be paused.
    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool;

    /// Save or restore where it is, between two actions, see [`Persist`](crate::snapshot::Persist).
    ///
    /// # Errors
    /// A source that cannot be saved; parts that are missing or do not fit.
    fn persist(&mut self, _snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        Err(SnapshotError::Unable("this source of frames"))
    }

    /// Tell what happens beside frames, as it happens, until there is no journal any more.
    fn keep_journal(&mut self, _journal: Option<Journal>) {}

    /// What came of another program's log so far, if that is where the frames are from.
    fn imported(&self) -> Option<ImportReport> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn odometry_is_what_a_log_gives_back_to_the_bit() {
        for heading in [0.0, 1.0, -2.3, 0.1 + 0.2, std::f64::consts::PI, -std::f64::consts::PI + 1e-12] {
            let pose = of_log(Pose::new([0.1, -7.3].into(), heading));
            assert!((pose.heading - heading).abs() < 1e-6);
            let logged = msg::Pose::planar(pose.position.x, pose.position.y, pose.heading);
            assert_eq!(of_log(Pose::new(pose.position, logged.heading())), pose);
        }
    }
}
