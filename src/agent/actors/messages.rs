//! The messages between the actors.

use std::sync::Arc;

use crate::agent::runtime::marker::Marker;
use crate::dictionary::Dictionary;
use crate::policy::{Behaviour, Goto, Learned, Prospect, PursuitEnd, Recent};
use crate::robot::{Action, ActionValues};
use crate::slow::{Moments, SlowModel};
use crate::value::place::Pose;
use crate::value::{Fit, MapStep, Transition};
use crate::vision::Observation;

/// What goes from actor to actor: its work, and between two actions now and then the state of the run.
pub enum Item<T> {
    /// Work.
    Work(T),
    /// The state of the run, to which the actor adds its own.
    Save(Box<Marker>),
}

/// What an action came to for the tasks.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskOutcomes {
    /// Reward of each task.
    pub rewards: Vec<f64>,
    /// Whether the robot is in each task's goal area.
    pub in_goal: Vec<bool>,
    /// Reward of the areas to be avoided that the action ended in, for each task; 0 in none. What is shown is not among them.
    pub avoided: f64,
    /// Whether a wall stopped the robot.
    pub blocked: bool,
    /// What odometry says that the action did.
    pub step: Option<MapStep>,
}

/// From perceive to act: what was seen at the end of an action.
#[derive(Debug, Clone)]
pub struct Percept {
    pub observation: Arc<Observation>,
    pub stamp_ns: u64,
    pub sonar: Vec<f32>,
    /// The action that ended; none before the first.
    pub action: Option<Action>,
    /// What the reflexes are to know of the actions so far.
    pub recent: Recent,
    pub outcomes: TaskOutcomes,
    /// Where somebody sends the robot.
    pub goto: Option<Goto>,
    /// Frames at which models were asked for since the percept before.
    pub asked: Vec<u64>,
}

/// A transition of the window, judged by where the goals are.
pub type TaskTransition = Transition<Arc<Observation>, TaskOutcomes>;

/// An observation that somebody marked as the goal of a task, or as to be avoided.
#[derive(Debug, Clone)]
pub struct Marked {
    /// Its number, see [`Scenario::names`](crate::scenario::Scenario::names).
    pub task: usize,
    pub observation: Arc<Observation>,
    /// Where it was seen, metres, where that is known: for plots and evaluation alone.
    pub place: Option<[f64; 2]>,
}

/// From learn to solve: everything that new policies are made of.
pub struct SolveRequest {
    pub asked_at: u64,
    /// Time of that frame.
    pub stamp_ns: u64,
    pub frames: u64,
    /// What new features are made of; without it the last ones stay, as where only a goal has moved.
    pub sums: Option<(Dictionary<f32>, Moments)>,
    pub window: Vec<TaskTransition>,
    /// Where the goals are, by task, as far as that is known.
    pub goals: Vec<Option<[f64; 2]>>,
    /// What was marked.
    pub marks: Vec<Marked>,
}

/// From solve to fit: slow features, or why there are none.
pub struct FitRequest {
    pub asked_at: u64,
    pub frames: u64,
    pub model: Result<SlowModel<f32>, String>,
    pub window: Vec<TaskTransition>,
    /// Where the goals are, by task, as far as that is known.
    pub goals: Vec<Option<[f64; 2]>>,
    /// What was marked.
    pub marks: Vec<Marked>,
}

/// From fit to act and evaluate: the answer to one request.
#[derive(Debug, Clone)]
pub struct Update {
    /// The frame at which it was asked for.
    pub asked_at: u64,
    /// What was learned, or why nothing was.
    pub learned: Result<Arc<Learned>, String>,
    /// How policy iteration went, by task.
    pub fits: Vec<Fit>,
    /// Transitions it was made of.
    pub transitions: usize,
    /// What a person should know of it, and was not told yet.
    pub notes: Vec<String>,
}

/// What was decided, and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Decision {
    /// Number of the action, from 0.
    pub number: usize,
    /// The action.
    pub action: Action,
    /// What it is for.
    pub leg: Behaviour,
    /// Epoch of the policy, 0 without one.
    pub epoch: u32,
    /// Where the robot may be, and how probable that is, the most probable place first; empty where places are not told.
    pub places: Vec<(Pose, f64)>,
    /// What is expected of the pursuit; where values tell it.
    pub prospect: Option<Prospect>,
    /// Q-values of the pursued task.
    pub q_values: Option<ActionValues>,
    /// Whether a reflex replaced the policy's wish.
    pub reflex: bool,
    /// The pursuit that was over before it.
    pub ended: Option<PursuitEnd>,
    /// The run is over instead of this action: the robot arrived, and the scenario wants no more.
    pub ends_run: bool,
}

/// What a block of frames did to the dictionary.
pub struct Growth {
    pub first_frame: u64,
    pub last_frame: u64,
    pub stamp_ns: u64,
    pub accepted: Vec<u64>,
    pub quarantined: Vec<u64>,
    pub size: usize,
    pub sigma: f64,
    pub nu: Option<f64>,
    pub at_budget: bool,
    /// The width of the kernel before, where it was too narrow, and all frames so far went through a dictionary that began anew.
    pub began_anew: Option<f64>,
}
