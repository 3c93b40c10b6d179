//! Messages of the package `adagio_msgs`: what the agent learned, decided and measured.
//!
//! Frames are counted from 0 in the order in which the source delivered them; a frame that was
//! dropped has a number too. A policy names the epoch of the feature model that it was fitted on.

use serde::{Deserialize, Serialize};

use super::{Header, Time, messages};

messages! {
    /// The agent chose an action.
    adagio_msgs / Decision Decision [
        /// [`Decision::action`]: drive forward.
        FORWARD: "uint8" = 0,
        /// [`Decision::action`]: turn left.
        TURN_LEFT: "uint8" = 1,
        /// [`Decision::action`]: turn right.
        TURN_RIGHT: "uint8" = 2,
        /// [`Decision::behaviour`]: explore.
        EXPLORE: "uint8" = 0,
        /// [`Decision::behaviour`]: pursue a task with the newest policy.
        PURSUE: "uint8" = 1,
    ] {
        /// When.
        header: Header,
        /// The frame that was decided on.
        frame: u64,
        /// Number of the action, from 0.
        action_index: u64,
        /// What to do: one of the constants.
        action: u8,
        /// Why: one of the constants.
        behaviour: u8,
        /// The task that is pursued, or empty.
        task: String,
        /// Epoch of the model and policy in use; 0 before the first.
        epoch: u32,
        /// Value of each action under the policy, or empty.
        q_values: Vec<f64>,
        /// A reflex replaced what the behaviour wished.
        reflex: bool,
    } in Header Time;

    /// What is expected of a pursuit.
    adagio_msgs / Prospect Prospect {
        /// When.
        header: Header,
        /// The frame that was decided on.
        frame: u64,
        /// The task that is pursued.
        task: String,
        /// Actions of the pursuit so far: 0 when it begins.
        done: u32,
        /// Actions until the goal that are expected from here.
        actions: f64,
        /// Probability of arriving before it is given up, by how earlier pursuits went.
        arrival: f64,
    } in Header Time;

    /// Where the robot may be on the map that it has made, the most probable place first.
    adagio_msgs / PlaceBelief PlaceBelief {
        /// When.
        header: Header,
        /// The frame that was decided on.
        frame: u64,
        /// How probable each place is; in all at most 1.
        probabilities: Vec<f64>,
        /// Of each place, along the map's first axis, lengths of a move.
        x: Vec<f64>,
        /// Of each place, along the second axis.
        y: Vec<f64>,
        /// Of each place, the heading, radians from the first axis to the second.
        headings: Vec<f64>,
    } in Header Time;

    /// A frame was taken from the source: what a replay has to know of it beside the observation.
    adagio_msgs / FrameTaken FrameTaken [
        /// [`FrameTaken::action`]: none, before the first one.
        NO_ACTION: "uint8" = 255,
    ] {
        /// When the frame was taken by the camera.
        header: Header,
        /// Number of the frame.
        frame: u64,
        /// The action during which it was taken: a constant of [`Decision`], or [`FrameTaken::NO_ACTION`].
        action: u8,
        /// It is the last frame of its action, or the first of all.
        boundary: bool,
        /// An obstacle stopped the robot during the action; known at its boundary.
        blocked: bool,
    } in Header Time;

    /// The goal of a task was moved: actions that end with this frame or later are judged by it, and policies that are fitted
    /// later are for it.
    adagio_msgs / GoalMoved GoalMoved {
        /// When.
        header: Header,
        /// The frame.
        frame: u64,
        /// Name of the task.
        task: String,
        /// The new centre of the goal area, metres.
        x: f64,
        /// The same, metres.
        y: f64,
    } in Header Time;

    /// What a robot that takes velocities is doing changed.
    adagio_msgs / RobotState RobotState {
        /// When.
        header: Header,
        /// What it is doing: standing, driving, driven by a person, stopped, held, ended.
        state: String,
        /// Why it may not move, or empty.
        causes: String,
    } in Header Time;

    /// A robot, or somebody beside it, said something that is neither image, odometry nor scan.
    adagio_msgs / RobotInput RobotInput {
        /// When.
        header: Header,
        /// What: bumper, emergency_stop, lock, teleop, battery, pose, reward.
        name: String,
        /// Its numbers.
        values: Vec<f64>,
    } in Header Time;

    /// The robot's own software said what an action was worth to a task.
    adagio_msgs / RewardGiven RewardGiven {
        /// When the action ended.
        header: Header,
        /// Its last frame.
        frame: u64,
        /// Name of the task.
        task: String,
        /// The number.
        reward: f64,
    } in Header Time;

    /// A pursuit is over: the robot arrived, or it was given up.
    adagio_msgs / PursuitEnded PursuitEnded {
        /// When.
        header: Header,
        /// The frame at which that was decided.
        frame: u64,
        /// Name of the task.
        task: String,
        /// The agent says that it is at the goal; otherwise it gave up.
        arrived: bool,
        /// Actions that it took.
        actions: u32,
    } in Header Time;

    /// No more frames come: what is logged after this finishes the run. A run that goes on later does not hold to it: its last
    /// block of frames was cut short, and its last model was asked for early.
    adagio_msgs / RunEnd RunEnd {
        /// When.
        header: Header,
        /// The last frame.
        frame: u64,
    } in Header Time;

    /// A model was asked for.
    adagio_msgs / ModelRequest ModelRequest {
        /// When.
        header: Header,
        /// The newest frame that it is learned from.
        frame: u64,
        /// Frames that it is learned from.
        frames: u64,
        /// Transitions that its policies are fitted on.
        transitions: u32,
    } in Header Time;

    /// An action was completed.
    adagio_msgs / Transition Transition {
        /// When it ended.
        header: Header,
        /// The frame before the action.
        from_frame: u64,
        /// The frame after it.
        to_frame: u64,
        /// What was done: a constant of [`Decision`].
        action: u8,
        /// An obstacle stopped the robot.
        blocked: bool,
        /// The names of the tasks.
        tasks: Vec<String>,
        /// The reward of each task; not a number where the goal is shown, since features tell it when policies are fitted.
        rewards: Vec<f64>,
    } in Header Time;

    /// A block of frames went through the dictionary; where it begins at the first frame again, through one that began anew.
    adagio_msgs / DictionaryGrowth DictionaryGrowth {
        /// When.
        header: Header,
        /// First frame of the block.
        first_frame: u64,
        /// Last frame of the block.
        last_frame: u64,
        /// The frames that became support vectors.
        accepted: Vec<u64>,
        /// The frames that were left out, because their values, or those of the kernel on them, are not finite.
        quarantined: Vec<u64>,
        /// Support vectors after the block.
        size: u32,
        /// Width of the kernel.
        sigma: f64,
        /// Threshold of acceptance; NaN for a random selection.
        nu: f64,
        /// The budget is used up; nothing more is accepted.
        at_budget: bool,
    } in Header Time;

    /// A new model of slow features.
    adagio_msgs / ModelUpdate ModelUpdate {
        /// When.
        header: Header,
        /// Number of the model, from 1.
        epoch: u32,
        /// The frame at which it was asked for.
        asked_at_frame: u64,
        /// The first frame that it is used on.
        effective_at_frame: u64,
        /// Frames that it was learned from.
        frames: u64,
        /// Support vectors that it is made of.
        support_vectors: u32,
        /// λ of the slow features; not named `lambda`, which Python does not allow as a field.
        regulariser: f64,
        /// Slowness of each feature, slowest first.
        slowness: Vec<f64>,
        /// Hash of its numbers, hexadecimal.
        digest: String,
    } in Header Time;

    /// A new policy of one task.
    adagio_msgs / PolicyUpdate PolicyUpdate {
        /// When.
        header: Header,
        /// Epoch of the model whose features it uses.
        epoch: u32,
        /// The first frame that it is used on.
        effective_at_frame: u64,
        /// The task.
        task: String,
        /// Discount per action.
        gamma: f64,
        /// Transitions that it was fitted on.
        transitions: u32,
        /// Policy iterations.
        iterations: u32,
        /// The iterations reached a fixed policy.
        converged: bool,
        /// Rows of the weights.
        actions: u32,
        /// Columns of the weights.
        features: u32,
        /// Weights, `actions` × `features`, row by row.
        weights: Vec<f64>,
        /// Hash of its numbers, hexadecimal.
        digest: String,
    } in Header Time;

    /// A policy was tried out.
    adagio_msgs / Evaluation Evaluation {
        /// When.
        header: Header,
        /// Epoch of the policy.
        epoch: u32,
        /// The newest frame that it had learned from.
        frame: u64,
        /// The task.
        task: String,
        /// Trials.
        starts: u32,
        /// Fraction of trials that arrived.
        success: f64,
        /// Lower bound of that fraction (Wilson, 95 %).
        success_wilson_low: f64,
        /// Actions per arrival.
        mean_steps: f64,
        /// Fewest actions possible, mean over the trials.
        optimal_mean_steps: f64,
        /// Convergence quality, 0 to 1.
        convergence_quality: f64,
    } in Header Time;

    /// How the program itself is doing.
    adagio_msgs / Health Health {
        /// When.
        header: Header,
        /// Frames so far, those dropped included.
        frames: u64,
        /// Frames dropped so far.
        dropped_frames: u64,
        /// Frames left out of learning so far, because their values are not finite.
        quarantined_frames: u64,
        /// Frames per second since the last such message.
        frames_per_second: f64,
        /// Support vectors.
        support_vectors: u32,
        /// Epoch of the model in use.
        epoch: u32,
        /// Names of the queues.
        queues: Vec<String>,
        /// Entries that wait in each queue.
        queue_depths: Vec<u32>,
        /// Most entries that each queue holds.
        queue_capacities: Vec<u32>,
        /// Time from frame to action, 99th percentile, ms.
        act_p99_ms: f64,
        /// Time of learning from a frame, 99th percentile, ms.
        frame_p99_ms: f64,
        /// Memory in use, bytes.
        rss_bytes: u64,
    } in Header Time;
}
