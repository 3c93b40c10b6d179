//! `[policy]`, `[[task]]`, `[evaluate]`: how the robot drives, where to, and how that is judged.

use crate::scenario::keys::{Section, above, within};

/// `[policy]`
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    /// Share of the run's actions that are pure exploration, at its start.
    pub explore_share: f64,
    /// Share of pursuits among legs when the run ends; it rises linearly from 0.
    pub pursue_share: f64,
    /// Length of a leg of exploration, actions.
    pub explore_length: usize,
    /// Share of the legs of exploration that first go to a rarely visited place.
    pub directed_share: f64,
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
    /// Reflex: from the second full turn in one place on, turns count less and less.
    pub no_spin: bool,
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

/// `[[task]]` with `avoid`: a place to keep away from, whatever the robot pursues.
#[derive(Debug, Clone, PartialEq)]
pub struct Avoid {
    /// Name, unique among all tasks.
    pub name: String,
    /// Its centre, metres. `None`: marks say where it is.
    pub at: Option<[f64; 2]>,
    /// Its radius, metres. Of a place that is shown: what evaluation counts as an entry.
    pub radius: f64,
    /// Of a place that is shown: nearer than this to one of its marks is there, actions.
    pub within: Option<f64>,
    /// Reward for an action that ends in its midst, for all tasks; negative.
    pub reward: f64,
}

/// What a `[[task]]` is.
pub(super) enum Entry {
    Pursue(Task),
    KeepAway(Avoid),
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

/// The same of a place to keep away from: half a move and a little more than its radius, so that no action crosses the area.
const AVOID_WITHIN: f64 = 1.6;

/// `[[show]]`: somebody carries the robot to a place, turns it round once and carries it back, in the simulator.
#[derive(Debug, Clone, PartialEq)]
pub struct Show {
    /// It begins in place of this action, counted from 0.
    pub action: usize,
    /// Name of the task whose goal is shown, or of the place to keep away from.
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

    /// Whether the true pose says what the goal is.
    pub fn needs_pose(&self) -> bool {
        !self.is_shown() && self.topic.is_none()
    }
}

impl Show {
    /// Actions that it takes the place of.
    pub fn actions(&self) -> std::ops::RangeInclusive<usize> {
        self.action..=self.action + self.headings
    }

    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Show {
            action: s.count("action", 3000, "", 0..=1_000_000_000, "it begins in place of this action, counted from 0"),
            task: s.text("task", "", "name of the task whose place is shown"),
            at: s.point("at", [1.5, 0.9], "the place to which the robot is carried"),
            headings: s.count("headings", 8, "", 1..=1000, "headings of one turn on the spot; each lasts an action"),
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
    /// Of rewards from outside: the topic on which the robot's own software publishes them. The goal area is then a pad on the
    /// floor of the simulation, which publishes 1 while the robot stands on it.
    pub topic: Option<String>,
    /// Reward for an action that ends near a wall, outside the goal area, in units of [`Task::reward`]; 0 where no pose says
    /// what the goal is.
    pub wall_reward: f64,
    /// Near a wall is closer than this, robot centre to wall, metres.
    pub wall_distance: f64,
    /// Whether values count the goal as the end of an episode.
    pub absorbing: bool,
    /// What comes after the goal was reached.
    pub then: Then,
}

impl Policy {
    /// `actions`: of the run.
    pub(super) fn read(s: &mut Section<'_, '_>, actions: usize) -> Self {
        Policy {
            explore_share: s.share_of(
                "explore_share",
                actions,
                "explore_actions",
                0.4,
                "share of the run's actions that are pure exploration, at its start",
            ),
            pursue_share: s.number(
                "pursue_share",
                0.5,
                "",
                within(0.0, 1.0),
                "share of pursuits at the end of the run",
            ),
            explore_length: s.count(
                "explore_length",
                40,
                "actions",
                1..=1_000_000,
                "length of a period of exploration",
            ),
            directed_share: s.number(
                "directed_share",
                0.5,
                "",
                within(0.0, 1.0),
                "local: share of the periods of exploration that begin with a way to a rarely visited place",
            ),
            pursue_timeout: s.count("pursue_timeout", 40, "actions", 1..=1_000_000, "a pursuit is given up after"),
            forward_probability: s.number(
                "forward_probability",
                0.5,
                "",
                within(0.01, 0.99),
                "random walk: probability of forward",
            ),
            sonar_stop: s.number(
                "sonar_stop",
                0.10,
                "m",
                within(0.0, 10.0),
                "random walk: no forward with less clearance ahead",
            ),
            sonar_heed: s.number(
                "sonar_heed",
                0.5,
                "share",
                within(0.0, 1.0),
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
            no_spin: s.flag(
                "no_spin",
                true,
                "reflex: from the second full turn in one place on, turns count less and less",
            ),
        }
    }
}

impl Evaluate {
    pub(super) fn read(s: &mut Section<'_, '_>) -> Self {
        Evaluate {
            starts: s.count("starts", 200, "", 1..=1_000_000, "random starts per task"),
            max_steps: s.count("max_steps", 100, "actions", 1..=1_000_000, "a trial fails after"),
            every: s.count("every", 1, "models", 0..=1_000_000, "evaluate during the run; 0: only the last"),
            decode_train: s.count("decode_train", 2000, "poses", 2..=1_000_000, "decoding of the pose is learned from"),
            decode_test: s.count("decode_test", 1000, "poses", 1..=1_000_000, "and tested on"),
        }
    }
}

impl Entry {
    pub(super) fn read(s: &mut Section<'_, '_>, index: usize) -> Self {
        let name = s.text("name", &format!("task {}", index + 1), "unique name");
        match s.has("avoid") {
            true => Entry::KeepAway(Avoid::read(s, name)),
            false => Entry::Pursue(Task::read(s, name)),
        }
    }
}

impl Avoid {
    fn read(s: &mut Section<'_, '_>, name: String) -> Self {
        let at = s.point_or("avoid", None, "shown", "centre of an area to keep away from, or marks say where it is");
        let radius_meaning = match at {
            Some(_) => "radius of the area",
            None => "nearer to the shown place than this is an entry, for evaluation",
        };
        Avoid {
            name,
            at,
            radius: s.number("radius", SHOWN_RADIUS, "m", above(0.0, 1000.0), radius_meaning),
            within: at.is_none().then(|| {
                let meaning = "values keep the robot farther than this from the marks";
                s.number("within", AVOID_WITHIN, "actions", above(0.0, 100.0), meaning)
            }),
            reward: s.number(
                "reward",
                -20.0,
                "",
                within(-1e6, -1e-6),
                "for an action that ends in its midst, whatever is pursued; towards its edge it falls as a square",
            ),
        }
    }

    /// Reward for an action that ends so deep in it, from 0 at its edge to 1 in its midst: who stands at the edge is to turn away, and
    /// not to cross it because each step there costs the same.
    pub fn reward_at(&self, depth: f64) -> f64 {
        self.reward * depth * depth
    }

    /// Whether marks say where it is.
    pub fn is_shown(&self) -> bool {
        self.at.is_none()
    }
}

impl Task {
    fn read(s: &mut Section<'_, '_>, name: String) -> Self {
        let any = above(0.0, 1e6);
        let reward = "for an action that ends in the goal area, or a topic gives it";
        let reward = s.number_or("reward", Some(1.0), "topic", "", any, reward);
        let topic = match reward {
            Some(_) => None,
            None => {
                Some(s.text("topic", "/reward", "std_msgs number or Bool: the reward; above 0 is being at the goal"))
            }
        };
        let goal = match &topic {
            None => {
                let meaning = "centre of the goal area, or marks say what the goal is";
                s.point_or("goal", Some([1.5, 0.9]), "shown", meaning)
            }
            Some(_) => {
                let meaning = "centre of a pad on the simulation's floor, on which the robot gets the reward 1";
                s.point_or("goal", None, "none", meaning)
            }
        };
        let shown = goal.is_none() && topic.is_none();
        let (radius, meaning) = match shown {
            false => (0.2, "radius of the goal area"),
            true => (SHOWN_RADIUS, "farther from the shown place than this is no true arrival, for evaluation"),
        };
        let near = shown.then(|| {
            let meaning = "nearer than this to one of the marks is at the goal";
            s.number("within", WITHIN, "actions", above(0.0, 100.0), meaning)
        });
        let radius = s.number("radius", radius, "m", above(0.0, 1000.0), meaning);
        let (mut wall_reward, mut wall_distance) = (0.0, 0.0);
        if topic.is_none() && !shown {
            let meaning = "in units of reward, for an action that ends near a wall, outside the goal area";
            wall_reward = s.number("wall_reward", -0.3, "", within(-1e6, 0.0), meaning);
            let meaning = "robot centre to wall that counts as near";
            wall_distance = s.number("wall_distance", 0.3, "m", within(0.0, 1000.0), meaning);
        }
        Task {
            name,
            goal,
            radius,
            within: near,
            reward: reward.unwrap_or(1.0),
            topic,
            wall_reward,
            wall_distance,
            absorbing: s.flag("absorbing", false, "whether values count the goal as the end of an episode"),
            then: s.choice(
                "then",
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
