//! What an export holds, table by table: which arrays, and what one message or frame adds to them.

use std::io;
use std::path::Path;

use faer::{Mat, Par};
use rayon::prelude::*;

use super::npz::{Array, ArrayEntry};
use crate::log::messages::{Decision, DictionaryGrowth, Evaluation, ModelUpdate, PlaceBelief, Prospect, Transition};
use crate::policy::{Learned, columns};
use crate::scenario::Scenario;
use crate::source::{Frame, MarkKind, View};
use crate::value::Instances;
use crate::vision::{Observation, ZERO};

/// What the arrays of a table are, by name.
pub type Meanings = &'static [(&'static str, &'static str)];

/// Declares a table: its arrays with their types, row shapes and meanings; and how they are created and finished. Where a row
/// is made of one message, also what of it goes into each array.
macro_rules! table {
    ($(#[$doc:meta])* $name:ident($($size:ident),*) of $message:ident: $of:ty $(, $with:ident: $with_type:ty)* {
        $($array:ident: $type:ty [$($length:expr),*] = $value:expr, $meaning:literal;)+
    }) => {
        table! { $(#[$doc])* $name($($size),*) { $($array: $type [$($length),*] = $meaning,)+ } }

        impl $name {
            pub fn add(&mut self, $message: &$of $(, $with: $with_type)*) -> io::Result<()> {
                $(self.$array.push(&$value)?;)+
                Ok(())
            }
        }
    };
    ($(#[$doc:meta])* $name:ident($($size:ident),*) { $($array:ident: $type:ty [$($length:expr),*] = $meaning:literal,)+ }) => {
        $(#[$doc])*
        pub struct $name { $($array: Array<$type>,)+ }

        impl $name {
            /// What each array is, by name.
            const MEANINGS: Meanings = &[$((stringify!($array), $meaning)),+];

            pub fn create(folder: &Path, $($size: usize),*) -> io::Result<Self> {
                Ok($name { $($array: Array::create(folder, stringify!($array), &[$($length),*])?,)+ })
            }

            /// What was written, and what it is.
            pub fn finish(self) -> io::Result<(Vec<ArrayEntry>, Meanings)> {
                Ok((vec![$(self.$array.finish()?),+], Self::MEANINGS))
            }
        }
    };
}

table! {
    /// One row for each frame.
    Frames(height, width, sonars, places) {
        frame: u64 [] = "number of the frame",
        stamp_ns: u64 [] = "when it was taken, nanoseconds",
        observation: u8 [height, width, 3] = "what is learned from, RGB",
        action: i8 [] = "number of the action during which it was taken, -1 none",
        boundary: bool [] = "it is the last frame of its action, or one before which there was none",
        blocked: bool [] = "at a boundary: an obstacle stopped the robot during the action",
        pose: f64 [3] = "x, y (m), heading (rad), by an outside measurement",
        odometry: f64 [3] = "x, y (m), heading (rad), by the robot's own estimate",
        sonar: f32 [sonars] = "distances (m), the first straight ahead, counter-clockwise",
        marked: bool [places] = "for each task, and behind them what is to be avoided: somebody marked it with this frame",
    }
}

table! {
    /// One row for each frame: what a model makes of its observation.
    Features(features, tasks, actions, places) {
        features: f64 [features] = "slow features by the model, the constant one first, then the slowest",
        q_values: f64 [tasks, actions] = "for each task the value of each action",
        place: f64 [2] = "x, y on the map that was learned, lengths of a move; not a number without a map",
        there: bool [places] = "for each task, and behind them what is to be avoided: the model says that it is there, as far as it was shown",
    }
}

table! {
    /// One row for each action that was completed.
    Transitions(tasks) of message: Transition, tasks: usize {
        from_frame: u64 [] = [message.from_frame], "the frame before the action";
        to_frame: u64 [] = [message.to_frame], "the frame after it";
        stamp_ns: u64 [] = [message.header.stamp_ns()], "when it ended, nanoseconds";
        action: u8 [] = [message.action], "number of the action";
        blocked: bool [] = [message.blocked], "an obstacle stopped the robot";
        rewards: f64 [tasks] = fixed(&message.rewards, tasks), "the reward of each task";
    }
}

table! {
    /// One row for each decision.
    Decisions(actions) of message: Decision, scenario: &Scenario {
        frame: u64 [] = [message.frame], "the frame that was decided on";
        stamp_ns: u64 [] = [message.header.stamp_ns()], "when, nanoseconds";
        action_index: u64 [] = [message.action_index], "how many decisions were before it";
        action: u8 [] = [message.action], "number of the action";
        behaviour: u8 [] = [message.behaviour], "0 explore, 1 pursue a task";
        task: i32 [] = [task_number(scenario, &message.task)], "number of the task that is pursued, -1 none";
        epoch: u32 [] = [message.epoch], "the model in use, 0 before the first";
        q_values: f64 [actions] = fixed(&message.q_values, scenario.robot.actions.len()), "value of each action for that task; not a number without one";
        reflex: bool [] = [message.reflex], "a reflex replaced what the behaviour wished";
    }
}

table! {
    /// One row for each decision of a pursuit of which something is expected.
    Prospects() of message: Prospect, scenario: &Scenario {
        frame: u64 [] = [message.frame], "the frame that was decided on";
        task: i32 [] = [task_number(scenario, &message.task)], "number of the task that is pursued";
        done: u32 [] = [message.done], "actions of the pursuit so far";
        actions: f64 [] = [message.actions], "actions until the goal that are expected";
        arrival: f64 [] = [message.arrival], "probability of arriving before it is given up";
    }
}

table! {
    /// One row for each decision where places are told: where the robot may be, the most probable place first.
    Places(most) of message: PlaceBelief, most: usize {
        frame: u64 [] = [message.frame], "the frame that was decided on";
        probability: f64 [most] = fixed(&message.probabilities, most), "how probable each place is; not a number beyond the last, as below";
        x: f64 [most] = fixed(&message.x, most), "of each place along the map's first axis, lengths of a move";
        y: f64 [most] = fixed(&message.y, most), "of each place along the second axis, lengths of a move";
        heading: f64 [most] = fixed(&message.headings, most), "of each place, radians from the first axis to the second";
    }
}

table! {
    /// One row for each model that was made during the run.
    Models(features) of message: ModelUpdate, features: usize {
        epoch: u32 [] = [message.epoch], "number of the model, from 1";
        asked_at_frame: u64 [] = [message.asked_at_frame], "the frame at which it was asked for";
        effective_at_frame: u64 [] = [message.effective_at_frame], "the first frame that it was used on";
        frames: u64 [] = [message.frames], "frames that it was learned from";
        support_vectors: u32 [] = [message.support_vectors], "support vectors that it is made of";
        regulariser: f64 [] = [message.regulariser], "lambda";
        slowness: f64 [features] = fixed(&message.slowness, features), "slowness of each feature (1/s^2), slowest first; not a number beyond the last";
    }
}

table! {
    /// One row for each block of frames that went through the dictionary.
    Growth() of message: DictionaryGrowth {
        first_frame: u64 [] = [message.first_frame], "first frame of the block";
        last_frame: u64 [] = [message.last_frame], "last frame of the block";
        accepted: u32 [] = [message.accepted.len() as u32], "frames of it that became support vectors";
        size: u32 [] = [message.size], "support vectors after the block";
        sigma: f64 [] = [message.sigma], "width of the kernel";
        nu: f64 [] = [message.nu], "threshold of acceptance; not a number for a random selection";
    }
}

table! {
    /// One row for each frame that became a support vector; with some selections it may have been replaced since. Where `sigma` changes in
    /// `growth`, the support vectors were chosen anew, and frames follow from the beginning again.
    Accepted() of frame: u64 {
        frame: u64 [] = [*frame], "number of the frame";
    }
}

table! {
    /// One row for each trial of a policy during the run.
    Evaluations() of message: Evaluation, scenario: &Scenario {
        epoch: u32 [] = [message.epoch], "epoch of the policy";
        frame: u64 [] = [message.frame], "the newest frame that it had learned from";
        task: i32 [] = [task_number(scenario, &message.task)], "number of the task";
        starts: u32 [] = [message.starts], "trials";
        success: f64 [] = [message.success], "share of trials that arrived";
        mean_steps: f64 [] = [message.mean_steps], "actions per arrival";
        convergence_quality: f64 [] = [message.convergence_quality], "convergence quality, 0 to 1";
    }
}

table! {
    /// The model itself, one row for each support vector.
    SupportVectors(height, width, features) {
        observation: u8 [height, width, 3] = "the support vector, RGB",
        projection: f64 [features] = "its part in each slow feature: features = projection' k(x) - offset",
    }
}

table! {
    /// One row for each slow feature of the model, without the constant one.
    Slow() of slowness: f64, offset: f64 {
        slowness: f64 [] = [*slowness], "slowness (1/s^2), slowest first";
        offset: f64 [] = [offset], "what is subtracted: features = projection' k(x) - offset";
    }
}

table! {
    /// One row for each task: Q(x, a) = weights[task, a] . features(x).
    Policies(actions, features) of weights: Mat<f64> {
        weights: f64 [actions, features] = entries(weights), "weights of each action; that of the constant feature first";
    }
}

table! {
    /// One row for each transition, where values are local: worth[task] of those nearby tells Q(x, a).
    LocalValues(coordinates, tasks) {
        instances: f32 [coordinates] = "the state before the transition, in coordinates: slow features by the root of their slowness; with places also the pose, see about.json",
        instance_action: u8 [] = "number of the action",
        worth: f64 [tasks] = "what the transition is worth for each task",
    }
}

/// A row of a fixed length: what is too long is cut, what is missing is not a number.
fn fixed(values: &[f64], length: usize) -> Vec<f64> {
    values.iter().copied().chain(std::iter::repeat(f64::NAN)).take(length).collect()
}

impl Frames {
    /// Add a frame; its pixels are those of an observation.
    pub fn add(&mut self, frame: &Frame, pixels: &[u8], sonars: usize, places: usize) -> io::Result<()> {
        let planar = |pose: &crate::robot::Pose| [pose.position.x, pose.position.y, pose.heading];
        let sonar: Vec<f32> = frame.sonar.iter().copied().chain(std::iter::repeat(f32::NAN)).take(sonars).collect();
        self.frame.push(&[frame.number])?;
        self.stamp_ns.push(&[frame.stamp_ns])?;
        self.observation.push(pixels)?;
        self.action.push(&[frame.action.map_or(-1, |action| action.index() as i8)])?;
        self.boundary.push(&[frame.boundary.is_some()])?;
        self.blocked.push(&[frame.boundary.as_ref().is_some_and(|boundary| boundary.blocked)])?;
        self.pose.push(&frame.truth.as_ref().map_or([f64::NAN; 3], planar))?;
        self.odometry.push(&frame.odometry.as_ref().map_or([f64::NAN; 3], planar))?;
        let here = |task: usize| frame.marks.iter().any(|mark| mark.task == task && mark.kind == MarkKind::Here);
        self.sonar.push(&sonar)?;
        self.marked.push(&(0..places).map(here).collect::<Vec<bool>>())
    }
}

/// The pixels of a recorded frame.
pub fn pixels(frame: &mut Frame) -> Vec<u8> {
    match &mut frame.view {
        View::Observation(pixels) => std::mem::take(pixels),
        View::Image(image) => std::mem::take(&mut image.rgb),
    }
}

impl Features {
    /// Add what a model makes of observations.
    pub fn add(&mut self, learned: &Learned, observations: &[Observation], places: usize) -> io::Result<()> {
        let x = columns(observations.iter());
        let features = learned.features(x.as_ref(), Par::Seq);
        let look = |seen: &Observation| {
            let state = learned.state(seen);
            let values = (0..learned.weights.len()).flat_map(|task| state.q_values(task).to_vec());
            let there = (0..places).map(|place| state.is_there(place));
            (values.collect::<Vec<f64>>(), state.place().unwrap_or([f64::NAN; 2]), there.collect::<Vec<bool>>())
        };
        let looks: Vec<_> = observations.par_iter().map(look).collect();
        for (j, (values, place, there)) in looks.iter().enumerate() {
            self.features.push(&features.col(j).iter().copied().collect::<Vec<f64>>())?;
            self.q_values.push(values)?;
            self.place.push(place)?;
            self.there.push(there)?;
        }
        Ok(())
    }
}

/// All entries, column by column.
fn entries(matrix: &Mat<f64>) -> Vec<f64> {
    matrix.col_iter().flat_map(|column| column.iter().copied()).collect()
}

/// Number of a task, −1 for none.
fn task_number(scenario: &Scenario, name: &str) -> i32 {
    let found = scenario.tasks.iter().position(|task| task.name == name);
    found.map_or(-1, |number| number as i32)
}

impl SupportVectors {
    pub fn add(&mut self, learned: &Learned) -> io::Result<()> {
        let model = &learned.model;
        for j in 0..model.members.ncols() {
            // Members are observations about zero: whole numbers that fit.
            let pixels = model.members.col(j).iter().map(|&value| (value + f32::from(ZERO)) as u8);
            self.observation.push(&pixels.collect::<Vec<u8>>())?;
            self.projection.push(&model.projection.row(j).iter().copied().collect::<Vec<f64>>())?;
        }
        Ok(())
    }
}

impl LocalValues {
    pub fn add(&mut self, learned: &Learned, instances: &Instances) -> io::Result<()> {
        let actions =
            instances.counts().iter().enumerate().flat_map(|(action, &count)| std::iter::repeat_n(action, count));
        for (i, (point, action)) in instances.points().col_iter().zip(actions).enumerate() {
            self.instances.push(&point.iter().copied().collect::<Vec<f32>>())?;
            self.instance_action.push(&[action as u8])?;
            self.worth.push(&learned.weights.iter().map(|worth| worth[(i, 0)]).collect::<Vec<f64>>())?;
        }
        Ok(())
    }
}
