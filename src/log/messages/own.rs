//! Messages of the package `adagio_msgs`: what the agent learned, decided and measured.
//!
//! Frames are counted from 0 in the order in which the source delivered them; a frame that was
//! dropped has a number too. A policy names the epoch of the feature model that it was fitted on.

use serde::{Deserialize, Serialize};

use super::{Header, Message, header_definition, separator, time_definition};

/// The agent chose an action.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// When.
    pub header: Header,
    /// The frame that was decided on.
    pub frame: u64,
    /// Number of the action, from 0.
    pub action_index: u64,
    /// What to do: one of the constants.
    pub action: u8,
    /// Why: one of the constants.
    pub behaviour: u8,
    /// The task that is pursued, or empty.
    pub task: String,
    /// Epoch of the model and policy in use; 0 before the first.
    pub epoch: u32,
    /// Value of each action under the policy, or empty.
    pub q_values: Vec<f64>,
    /// A reflex replaced what the behaviour wished.
    pub reflex: bool,
}

impl Decision {
    /// [`Decision::action`]: drive forward.
    pub const FORWARD: u8 = 0;
    /// [`Decision::action`]: turn left.
    pub const TURN_LEFT: u8 = 1;
    /// [`Decision::action`]: turn right.
    pub const TURN_RIGHT: u8 = 2;
    /// [`Decision::behaviour`]: explore.
    pub const EXPLORE: u8 = 0;
    /// [`Decision::behaviour`]: pursue a task with the newest policy.
    pub const PURSUE: u8 = 1;
}

/// A frame was taken from the source: what a replay has to know of it beside the observation.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrameTaken {
    /// When the frame was taken by the camera.
    pub header: Header,
    /// Number of the frame.
    pub frame: u64,
    /// The action during which it was taken: a constant of [`Decision`], or [`FrameTaken::NO_ACTION`].
    pub action: u8,
    /// It is the last frame of its action, or the first of all.
    pub boundary: bool,
    /// An obstacle stopped the robot during the action; known at its boundary.
    pub blocked: bool,
}

impl FrameTaken {
    /// [`FrameTaken::action`]: none, before the first one.
    pub const NO_ACTION: u8 = 255;
}

/// The goal of a task was moved: actions that end with this frame or later are judged by it, and policies that are fitted
/// later are for it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GoalMoved {
    /// When.
    pub header: Header,
    /// The frame.
    pub frame: u64,
    /// Name of the task.
    pub task: String,
    /// The new centre of the goal area, metres.
    pub x: f64,
    /// The same, metres.
    pub y: f64,
}

/// No more frames come: what is logged after this finishes the run. A run that goes on later does not hold to it: its last
/// block of frames was cut short, and its last model was asked for early.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunEnd {
    /// When.
    pub header: Header,
    /// The last frame.
    pub frame: u64,
}

/// A model was asked for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelRequest {
    /// When.
    pub header: Header,
    /// The newest frame that it is learned from.
    pub frame: u64,
    /// Frames that it is learned from.
    pub frames: u64,
    /// Transitions that its policies are fitted on.
    pub transitions: u32,
}

/// An action was completed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transition {
    /// When it ended.
    pub header: Header,
    /// The frame before the action.
    pub from_frame: u64,
    /// The frame after it.
    pub to_frame: u64,
    /// What was done: a constant of [`Decision`].
    pub action: u8,
    /// An obstacle stopped the robot.
    pub blocked: bool,
    /// The names of the tasks.
    pub tasks: Vec<String>,
    /// The reward of each task.
    pub rewards: Vec<f64>,
}

/// A block of frames went through the dictionary.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DictionaryGrowth {
    /// When.
    pub header: Header,
    /// First frame of the block.
    pub first_frame: u64,
    /// Last frame of the block.
    pub last_frame: u64,
    /// The frames that became support vectors.
    pub accepted: Vec<u64>,
    /// The frames that were left out, because their values, or those of the kernel on them, are not finite.
    pub quarantined: Vec<u64>,
    /// Support vectors after the block.
    pub size: u32,
    /// Width of the kernel.
    pub sigma: f64,
    /// Threshold of acceptance; NaN for a random selection.
    pub nu: f64,
    /// The budget is used up; nothing more is accepted.
    pub at_budget: bool,
}

/// A new model of slow features.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelUpdate {
    /// When.
    pub header: Header,
    /// Number of the model, from 1.
    pub epoch: u32,
    /// The frame at which it was asked for.
    pub asked_at_frame: u64,
    /// The first frame that it is used on.
    pub effective_at_frame: u64,
    /// Frames that it was learned from.
    pub frames: u64,
    /// Support vectors that it is made of.
    pub support_vectors: u32,
    /// λ of the slow features; not named `lambda`, which Python does not allow as a field.
    pub regulariser: f64,
    /// Slowness of each feature, slowest first.
    pub slowness: Vec<f64>,
    /// Hash of its numbers, hexadecimal.
    pub digest: String,
}

/// A new policy of one task.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PolicyUpdate {
    /// When.
    pub header: Header,
    /// Epoch of the model whose features it uses.
    pub epoch: u32,
    /// The first frame that it is used on.
    pub effective_at_frame: u64,
    /// The task.
    pub task: String,
    /// Discount per action.
    pub gamma: f64,
    /// Transitions that it was fitted on.
    pub transitions: u32,
    /// Policy iterations.
    pub iterations: u32,
    /// The iterations reached a fixed policy.
    pub converged: bool,
    /// Rows of the weights.
    pub actions: u32,
    /// Columns of the weights.
    pub features: u32,
    /// Weights, `actions` × `features`, row by row.
    pub weights: Vec<f64>,
    /// Hash of its numbers, hexadecimal.
    pub digest: String,
}

/// A policy was tried out.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Evaluation {
    /// When.
    pub header: Header,
    /// Epoch of the policy.
    pub epoch: u32,
    /// The newest frame that it had learned from.
    pub frame: u64,
    /// The task.
    pub task: String,
    /// Trials.
    pub starts: u32,
    /// Fraction of trials that arrived.
    pub success: f64,
    /// Lower bound of that fraction (Wilson, 95 %).
    pub success_wilson_low: f64,
    /// Actions per arrival.
    pub mean_steps: f64,
    /// Fewest actions possible, mean over the trials.
    pub optimal_mean_steps: f64,
    /// Convergence quality, 0 to 1.
    pub convergence_quality: f64,
}

/// How the program itself is doing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// When.
    pub header: Header,
    /// Frames so far, those dropped included.
    pub frames: u64,
    /// Frames dropped so far.
    pub dropped_frames: u64,
    /// Frames left out of learning so far, because their values are not finite.
    pub quarantined_frames: u64,
    /// Frames per second since the last such message.
    pub frames_per_second: f64,
    /// Support vectors.
    pub support_vectors: u32,
    /// Epoch of the model in use.
    pub epoch: u32,
    /// Names of the queues.
    pub queues: Vec<String>,
    /// Entries that wait in each queue.
    pub queue_depths: Vec<u32>,
    /// Most entries that each queue holds.
    pub queue_capacities: Vec<u32>,
    /// Time from frame to action, 99th percentile, ms.
    pub act_p99_ms: f64,
    /// Time of a frame through all actors, 99th percentile, ms.
    pub frame_p99_ms: f64,
    /// Memory in use, bytes.
    pub rss_bytes: u64,
}

/// Implements [`Message`] for a type of `adagio_msgs` whose only inner type is the header.
macro_rules! own_message {
    ($type:ident, $($line:literal),+ $(,)?) => {
        impl Message for $type {
            const TYPE: &'static str = concat!("adagio_msgs/msg/", stringify!($type));
            const DEFINITION: &'static str = concat!(
                $($line, "\n",)+
                header_definition!(),
            );
        }
    };
}

own_message!(
    Decision,
    "uint8 FORWARD=0",
    "uint8 TURN_LEFT=1",
    "uint8 TURN_RIGHT=2",
    "uint8 EXPLORE=0",
    "uint8 PURSUE=1",
    "std_msgs/Header header",
    "uint64 frame",
    "uint64 action_index",
    "uint8 action",
    "uint8 behaviour",
    "string task",
    "uint32 epoch",
    "float64[] q_values",
    "bool reflex",
);

own_message!(
    FrameTaken,
    "uint8 NO_ACTION=255",
    "std_msgs/Header header",
    "uint64 frame",
    "uint8 action",
    "bool boundary",
    "bool blocked",
);

own_message!(GoalMoved, "std_msgs/Header header", "uint64 frame", "string task", "float64 x", "float64 y",);

own_message!(RunEnd, "std_msgs/Header header", "uint64 frame",);

own_message!(ModelRequest, "std_msgs/Header header", "uint64 frame", "uint64 frames", "uint32 transitions",);

own_message!(
    Transition,
    "std_msgs/Header header",
    "uint64 from_frame",
    "uint64 to_frame",
    "uint8 action",
    "bool blocked",
    "string[] tasks",
    "float64[] rewards",
);

own_message!(
    DictionaryGrowth,
    "std_msgs/Header header",
    "uint64 first_frame",
    "uint64 last_frame",
    "uint64[] accepted",
    "uint64[] quarantined",
    "uint32 size",
    "float64 sigma",
    "float64 nu",
    "bool at_budget",
);

own_message!(
    ModelUpdate,
    "std_msgs/Header header",
    "uint32 epoch",
    "uint64 asked_at_frame",
    "uint64 effective_at_frame",
    "uint64 frames",
    "uint32 support_vectors",
    "float64 regulariser",
    "float64[] slowness",
    "string digest",
);

own_message!(
    PolicyUpdate,
    "std_msgs/Header header",
    "uint32 epoch",
    "uint64 effective_at_frame",
    "string task",
    "float64 gamma",
    "uint32 transitions",
    "uint32 iterations",
    "bool converged",
    "uint32 actions",
    "uint32 features",
    "float64[] weights",
    "string digest",
);

own_message!(
    Evaluation,
    "std_msgs/Header header",
    "uint32 epoch",
    "uint64 frame",
    "string task",
    "uint32 starts",
    "float64 success",
    "float64 success_wilson_low",
    "float64 mean_steps",
    "float64 optimal_mean_steps",
    "float64 convergence_quality",
);

own_message!(
    Health,
    "std_msgs/Header header",
    "uint64 frames",
    "uint64 dropped_frames",
    "uint64 quarantined_frames",
    "float64 frames_per_second",
    "uint32 support_vectors",
    "uint32 epoch",
    "string[] queues",
    "uint32[] queue_depths",
    "uint32[] queue_capacities",
    "float64 act_p99_ms",
    "float64 frame_p99_ms",
    "uint64 rss_bytes",
);
