//! `[policy]`, `[[task]]`, `[evaluate]`: how the robot drives, where to, and how that is judged.

use crate::scenario::keys::{Range, Section};

/// `[policy]`
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    /// Actions of pure exploration at the start.
    pub explore_actions: usize,
    /// Share of pursuits among legs when the run ends; it rises linearly from 0.
    pub pursue_share: f64,
    /// Length of a leg of exploration, actions.
    pub explore_length: usize,
    /// A pursuit gives up after this many actions.
    pub pursue_timeout: usize,
    /// Probability of *forward* in the random walk.
    pub forward_probability: f64,
    /// Sonar reflex of the random walk: no *forward* with less clearance ahead, metres.
    pub sonar_stop: f64,
    /// Share of times that the sonar reflex is heeded.
    pub sonar_heed: f64,
    /// Reflex: an action that was just blocked is not repeated.
    pub no_repeat_blocked: bool,
    /// Reflex: a turn is not undone by the opposite turn, not even after a blocked action.
    pub no_undo_turn: bool,
}

/// `[evaluate]`
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluate {
    /// Random starts per task.
    pub starts: usize,
    /// A trial fails after this many actions.
    pub max_steps: usize,
    /// Every how many models is evaluated during the run; 0: only the last.
    pub every: usize,
    /// Poses from which the decoding of position and heading is learned.
    pub decode_train: usize,
    /// Poses on which it is tested.
    pub decode_test: usize,
}

/// What happens when a goal is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Then {
    /// The schedule decides what the next leg is.
    Schedule,
    /// A leg of exploration follows.
    Explore,
    /// The next task is pursued.
    NextTask,
}

/// `[[task]]`
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// Name, unique.
    pub name: String,
    /// Centre of the goal area, metres.
    pub goal: [f64; 2],
    /// Radius of the goal area, metres.
    pub radius: f64,
    /// Reward for an action that ends in the goal area.
    pub reward: f64,
    /// Reward for an action that ends near a wall, outside the goal area.
    pub wall_reward: f64,
    /// Near a wall is closer than this, robot centre to wall, metres.
    pub wall_distance: f64,
    /// Whether values count the goal as the end of an episode.
    pub absorbing: bool,
    /// What comes after the goal was reached.
    pub then: Then,
}

impl Policy {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Policy {
            explore_actions: s.count(
                "explore_actions",
                6000,
                "actions",
                0,
                1_000_000_000,
                "pure exploration at the start",
            ),
            pursue_share: s.number(
                "pursue_share",
                0.5,
                "",
                Range::within(0.0, 1.0),
                "share of pursuits at the end of the run",
            ),
            explore_length: s.count("explore_length", 40, "actions", 1, 1_000_000, "length of a period of exploration"),
            pursue_timeout: s.count("pursue_timeout", 40, "actions", 1, 1_000_000, "a pursuit is given up after"),
            forward_probability: s.number(
                "forward_probability",
                0.5,
                "",
                Range::within(0.01, 0.99),
                "random walk: probability of forward",
            ),
            sonar_stop: s.number(
                "sonar_stop",
                0.10,
                "m",
                Range::within(0.0, 10.0),
                "random walk: no forward with less clearance ahead",
            ),
            sonar_heed: s.number(
                "sonar_heed",
                0.5,
                "share",
                Range::within(0.0, 1.0),
                "times that the sonar reflex is heeded; contacts must be learned too",
            ),
            no_repeat_blocked: s.flag(
                "no_repeat_blocked",
                true,
                "reflex: an action that was just blocked is not repeated",
            ),
            no_undo_turn: s.flag(
                "no_undo_turn",
                true,
                "reflex: a turn is not undone by the opposite turn, not even after a blocked action",
            ),
        }
    }
}

impl Evaluate {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Evaluate {
            starts: s.count("starts", 200, "", 1, 1_000_000, "random starts per task"),
            max_steps: s.count("max_steps", 100, "actions", 1, 1_000_000, "a trial fails after"),
            every: s.count("every", 1, "models", 0, 1_000_000, "evaluate during the run; 0: only the last"),
            decode_train: s.count("decode_train", 2000, "poses", 2, 1_000_000, "decoding of the pose is learned from"),
            decode_test: s.count("decode_test", 1000, "poses", 1, 1_000_000, "and tested on"),
        }
    }
}

impl Task {
    pub(super) fn read(s: &mut Section<'_, '_>, index: usize) -> Self {
        Task {
            name: s.text("name", &format!("task {}", index + 1), "unique name"),
            goal: s.point("goal", [1.5, 0.9], "centre of the goal area"),
            radius: s.number("radius", 0.2, "m", Range::above(0.0, 1000.0), "radius of the goal area"),
            reward: s.number("reward", 1.0, "", Range::above(0.0, 1e6), "for an action that ends in the goal area"),
            wall_reward: s.number(
                "wall_reward",
                -0.3,
                "",
                Range::within(-1e6, 0.0),
                "for an action that ends near a wall, outside the goal area",
            ),
            wall_distance: s.number(
                "wall_distance",
                0.3,
                "m",
                Range::within(0.0, 1000.0),
                "robot centre to wall that counts as near",
            ),
            absorbing: s.flag("absorbing", false, "whether values count the goal as the end of an episode"),
            then: s.choice(
                "then",
                0,
                &[("schedule", Then::Schedule), ("explore", Then::Explore), ("next_task", Then::NextTask)],
                "what follows when the goal is reached",
            ),
        }
    }
}
