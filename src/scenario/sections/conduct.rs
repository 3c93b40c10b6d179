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
    /// The run ends.
    Stop,
}

/// A true arrival at a goal that was shown: within this distance of the shown place, metres.
const SHOWN_RADIUS: f64 = 0.35;

/// Being within so many actions of a mark is being there.
const WITHIN: f64 = 0.8;

/// `[[show]]`: somebody carries the robot to a place, turns it round once and carries it back, in the simulator.
#[derive(Debug, Clone, PartialEq)]
pub struct Show {
    /// It begins in place of this action, counted from 0.
    pub action: usize,
    /// Name of the task whose goal is shown.
    pub task: String,
    /// The place, metres.
    pub at: [f64; 2],
    /// Headings of the turn: so many actions it takes, and one more for the way back.
    pub headings: usize,
}

impl Task {
    /// Whether marks say what the goal is.
    pub fn is_shown(&self) -> bool {
        self.within.is_some()
    }
}

impl Show {
    /// Actions that it takes the place of.
    pub fn actions(&self) -> std::ops::RangeInclusive<usize> {
        self.action..=self.action + self.headings
    }

    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Show {
            action: s.count("action", 3000, "", 0, 1_000_000_000, "it begins in place of this action, counted from 0"),
            task: s.text("task", "", "name of the task whose goal is shown"),
            at: s.point("at", [1.5, 0.9], "the place to which the robot is carried"),
            headings: s.count("headings", 8, "", 1, 1000, "headings of one turn on the spot; each lasts an action"),
        }
    }
}

/// `[[task]]`
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// Name, unique.
    pub name: String,
    /// Centre of the goal area, metres. `None` where it is not known: a goal that is shown is what somebody marks while the robot
    /// is there, by what the camera sees.
    pub goal: Option<[f64; 2]>,
    /// Radius of the goal area, metres. Of a goal that is shown: what evaluation counts as there.
    pub radius: f64,
    /// Of a goal that is shown: nearer than this to one of its marks is there, actions. `None`: the goal is an area.
    pub within: Option<f64>,
    /// Reward for an action that ends in the goal area.
    pub reward: f64,
    /// Reward for an action that ends near a wall, outside the goal area; 0 where the goal is shown, since walls need a pose.
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
        let name = s.text("name", &format!("task {}", index + 1), "unique name");
        let goal = s.point_or("goal", [1.5, 0.9], "shown", "centre of the goal area, or marks say what the goal is");
        let (radius, meaning) = match goal {
            Some(_) => (0.2, "radius of the goal area"),
            None => (SHOWN_RADIUS, "farther from the shown place than this is no true arrival, for evaluation"),
        };
        let within = match goal {
            Some(_) => None,
            None => Some(s.number(
                "within",
                WITHIN,
                "actions",
                Range::above(0.0, 100.0),
                "nearer than this to one of the marks is at the goal",
            )),
        };
        Task {
            name,
            goal,
            radius: s.number("radius", radius, "m", Range::above(0.0, 1000.0), meaning),
            within,
            reward: s.number("reward", 1.0, "", Range::above(0.0, 1e6), "for an action that ends in the goal area"),
            wall_reward: match goal {
                Some(_) => s.number(
                    "wall_reward",
                    -0.3,
                    "",
                    Range::within(-1e6, 0.0),
                    "for an action that ends near a wall, outside the goal area",
                ),
                None => 0.0,
            },
            wall_distance: match goal {
                Some(_) => s.number(
                    "wall_distance",
                    0.3,
                    "m",
                    Range::within(0.0, 1000.0),
                    "robot centre to wall that counts as near",
                ),
                None => 0.0,
            },
            absorbing: s.flag("absorbing", false, "whether values count the goal as the end of an episode"),
            then: s.choice(
                "then",
                0,
                &[
                    ("schedule", Then::Schedule),
                    ("explore", Then::Explore),
                    ("next_task", Then::NextTask),
                    ("stop", Then::Stop),
                ],
                "what follows when the goal is reached",
            ),
        }
    }
}
