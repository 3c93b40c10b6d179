//! What the network asks of a run, and how far that is.

use std::sync::{Arc, Mutex};

use crate::lock::lock;

/// What the network asks of a run.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// To stand still between two actions, or to go on.
    Pause(bool),
    /// To let the robot go on that is held after a stop, and to go on after a pause.
    GoOn,
    /// To end.
    Stop,
    /// To drive to the goal of a task, or nothing for wherever the schedule has it go.
    Goto(String),
    /// To move a goal: that of a task by its number.
    MoveGoal(usize, [f64; 2]),
    /// To drive to a place.
    GoalPose([f64; 2]),
}

/// How far the robot has come with what was asked last.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum Progress {
    /// Nothing was asked, or nobody has looked at it yet.
    #[default]
    Waiting,
    /// It is on its way; where it is, if that is known: metres, radians.
    Going(Option<[f64; 3]>),
    /// It is there.
    Arrived,
    /// It cannot be done, and why.
    Refused(String),
}

/// What whoever drives tells whoever asked.
#[derive(Debug, Clone, Default)]
pub struct Errand(Arc<Mutex<Progress>>);

impl Errand {
    /// How far it is.
    pub fn now(&self) -> Progress {
        lock(&self.0).clone()
    }

    /// It is so far now.
    pub fn set(&self, progress: Progress) {
        *lock(&self.0) = progress;
    }
}
