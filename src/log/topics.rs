//! The table of topics: what a log holds, under which name and as which message.
//!
//! A [`Topic`] carries its message type, so that a message of another type on it does not compile.

use std::marker::PhantomData;

use super::messages::{
    Decision, DictionaryGrowth, Evaluation, FrameTaken, GoalMoved, Health, Image, LaserScan, Log, ModelRequest,
    ModelUpdate, Odometry, PlaceBelief, PolicyUpdate, PoseStamped, Prospect, PursuitEnded, RewardGiven, RobotInput,
    RobotState, RunEnd, Text, Transition, TwistStamped,
};
use super::{Message, cdr};

/// A topic whose messages are of type `M`.
pub struct Topic<M> {
    name: &'static str,
    // `fn() -> M` and not `M`: a topic holds no message, so it can be sent and copied whatever M is.
    message: PhantomData<fn() -> M>,
}

impl<M: Message> Topic<M> {
    /// A topic of this name. A log accepts those of [`ALL`] only.
    pub const fn new(name: &'static str) -> Self {
        Self { name, message: PhantomData }
    }

    /// The name, which starts with a slash.
    pub const fn name(&self) -> &'static str {
        self.name
    }

    const fn info(&self) -> TopicInfo {
        TopicInfo { name: self.name, message: M::TYPE, definition: M::DEFINITION }
    }
}

// By hand: derived ones would ask for the same of `M`.
impl<M> Clone for Topic<M> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<M> Copy for Topic<M> {}

/// Whether a topic has what a robot's link says, as it comes, and not what follows from frames.
pub fn is_of_robot(topic: &str) -> bool {
    topic.starts_with("/robot/")
}

/// A topic without its type, as a row of [`ALL`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TopicInfo {
    /// The name, which starts with a slash.
    pub name: &'static str,
    /// The message type ([`Message::TYPE`]).
    pub message: &'static str,
    /// Its definition ([`Message::DEFINITION`]), in parts.
    pub definition: &'static [&'static str],
}

/// Declares each topic as a constant and [`ALL`] as their list, so that none can be left out.
macro_rules! topics {
    ($($(#[$doc:meta])* $constant:ident: $message:ident = $name:literal;)+) => {
        $($(#[$doc])* pub const $constant: Topic<$message> = Topic::new($name);)+

        /// A message of a topic as JSON; none if the topic is not known or the bytes are no such message.
        pub fn to_json(topic: &str, body: &[u8]) -> Option<serde_json::Value> {
            $(if topic == $constant.name() {
                return serde_json::to_value(cdr::decode::<$message>(body).ok()?).ok();
            })+
            None
        }

        /// Every topic of a log; each log has a channel for each, also while it is silent.
        pub const ALL: &[TopicInfo] = &[$($constant.info()),+];
    };
}

topics! {
    /// What the agent sees; the sequence number is the frame's.
    OBSERVATION: Image = "/camera/observation";
    /// Where the robot is in truth (simulation) or by an outside measurement.
    POSE: PoseStamped = "/pose";
    /// Where the robot thinks that it is.
    ODOMETRY: Odometry = "/odom";
    /// Distances to obstacles.
    SONAR: LaserScan = "/sonar";
    /// Velocity that was commanded.
    COMMAND: TwistStamped = "/cmd_vel";
    /// Frames taken from the source.
    FRAME: FrameTaken = "/adagio/frame";
    /// Goals that were moved.
    GOAL: GoalMoved = "/adagio/goal";
    /// What somebody marks as the place of a task: its name; `forget` and its name.
    MARK: Text = "/adagio/mark";
    /// Where somebody sends the robot: the name of a task; nothing for wherever the schedule has it go.
    GOTO: Text = "/adagio/goto";
    /// Rewards from the robot's own software.
    REWARD: RewardGiven = "/adagio/reward";
    /// What a robot that takes velocities is doing, and why it may not move.
    ROBOT_STATE: RobotState = "/robot/state";
    /// Velocities that a robot was sent.
    ROBOT_COMMAND: TwistStamped = "/robot/cmd_vel";
    /// Odometry of a robot, as it came.
    ROBOT_ODOMETRY: Odometry = "/robot/odom";
    /// Scans of a robot, as they came.
    ROBOT_SCAN: LaserScan = "/robot/scan";
    /// What else a robot said, as it came.
    ROBOT_INPUT: RobotInput = "/robot/input";
    /// Pursuits that are over.
    PURSUIT: PursuitEnded = "/adagio/pursuit";
    /// Actions chosen.
    DECISION: Decision = "/adagio/decision";
    /// What is expected of pursuits.
    PROSPECT: Prospect = "/adagio/prospect";
    /// Where the robot may be, as far as places are told.
    PLACES: PlaceBelief = "/adagio/places";
    /// Actions completed.
    TRANSITION: Transition = "/adagio/transition";
    /// Growth of the dictionary.
    DICTIONARY: DictionaryGrowth = "/adagio/dictionary";
    /// Models asked for.
    REQUEST: ModelRequest = "/adagio/request";
    /// New feature models.
    MODEL: ModelUpdate = "/adagio/model";
    /// New policies.
    POLICY: PolicyUpdate = "/adagio/policy";
    /// The last frame of a run, or of a part of it.
    END: RunEnd = "/adagio/end";
    /// Policies tried out.
    EVALUATION: Evaluation = "/adagio/evaluation";
    /// The program's own state.
    HEALTH: Health = "/adagio/health";
    /// Diagnostics as text.
    DIAGNOSTICS: Log = "/rosout";
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_unique_and_absolute() {
        let names: std::collections::BTreeSet<_> = ALL.iter().map(|topic| topic.name).collect();
        assert_eq!(names.len(), ALL.len());
        assert!(names.iter().all(|name| name.starts_with('/')));
    }
}
