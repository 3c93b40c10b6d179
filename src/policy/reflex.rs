//! Three reflexes between policy and wheels.
//!
//! A policy that sees the camera alone cannot know that it was just blocked, nor that it came from the other side, nor how long it has
//! been where it is: it can push against a wall for ever, turn left and right for ever, or turn about and push at a door post for
//! ever. The reflexes forbid the first two, and lose patience with the third.

use std::f64::consts::TAU;

use crate::robot::{Action, ActionSet, MOST_ACTIONS};
use crate::scenario::Scenario;

/// From the second full turn in one place on, what stays there is worth less by this share of its value with each action.
const IMPATIENCE: f64 = 0.05;

/// Which reflexes are on, for the actions of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reflexes {
    /// An action that was just blocked is not repeated.
    pub no_repeat_blocked: bool,
    /// An action is not undone by its inverse, such as a turn by the opposite turn, not even after an action that was blocked.
    pub no_undo: bool,
    /// Turns in one place count less and less from the second full one on.
    pub no_spin: bool,
    /// How many actions there are, and the inverse of each.
    count: usize,
    inverses: [Option<Action>; MOST_ACTIONS],
    /// Actions that leave the robot's place, as bits by their [numbers](Action::index).
    advances: u32,
    /// Actions of a full turn.
    full_turn: u32,
}

/// What the robot did last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Recent {
    /// The last action that went its way.
    pub action: Option<Action>,
    /// The action that a wall stopped since then.
    pub blocked: Option<Action>,
    /// Actions since the last one that led from its place.
    pub standing: u32,
}

impl Recent {
    /// One action later. An action that was blocked leaves the robot where it was, or nearly so: the one before still counts.
    /// Otherwise a robot at a wall could turn left and right for ever, with a push against the wall in between.
    pub fn then(self, action: Action, blocked: bool, actions: &ActionSet) -> Recent {
        let standing = if blocked || !actions.advances(action) { self.standing.saturating_add(1) } else { 0 };
        if blocked {
            Recent { blocked: Some(action), standing, ..self }
        } else {
            Recent { action: Some(action), blocked: None, standing }
        }
    }
}

impl Reflexes {
    /// The reflexes of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        let policy = &scenario.policy;
        let (no_repeat_blocked, no_undo, no_spin) = (policy.no_repeat_blocked, policy.no_undo_turn, policy.no_spin);
        Reflexes { no_repeat_blocked, no_undo, no_spin, ..Reflexes::all(&scenario.robot.actions) }
    }

    /// All reflexes, for the actions of a robot.
    pub fn all(actions: &ActionSet) -> Self {
        let mut inverses = [None; MOST_ACTIONS];
        actions.iter().for_each(|action| inverses[action.index()] = actions.inverse(action));
        let advancing = actions.iter().filter(|&action| actions.advances(action));
        let advances = advancing.fold(0, |bits, action| bits | 1 << action.index());
        let turns = actions.iter().map(|action| actions.motion(action).angle.abs()).filter(|&angle| angle > 0.0);
        // Where nothing turns or nothing moves, nothing spins.
        let smallest = turns.fold(f64::INFINITY, f64::min);
        let spins = advances != 0 && smallest.is_finite();
        let full_turn = if spins { (TAU / smallest).ceil() as u32 } else { u32::MAX };
        let count = actions.len();
        Reflexes { no_repeat_blocked: true, no_undo: true, no_spin: true, count, inverses, advances, full_turn }
    }

    /// No reflexes for the same actions: the policy alone.
    pub fn off(self) -> Self {
        Reflexes { no_repeat_blocked: false, no_undo: false, no_spin: false, ..self }
    }

    /// Whether an action may follow what the robot did last. One always may.
    pub fn allow(&self, action: Action, recent: Recent) -> bool {
        let repeats = self.no_repeat_blocked && recent.blocked == Some(action);
        let undoes = self.no_undo && recent.action.is_some() && self.inverses[action.index()] == recent.action;
        !repeats && !undoes
    }

    /// The actions that may follow, as bits by their [numbers](Action::index).
    pub fn allowed(&self, recent: Recent) -> u32 {
        let allowed = Action::first(self.count).filter(|&action| self.allow(action, recent));
        allowed.fold(0, |bits, action| bits | 1 << action.index())
    }

    /// The allowed action of the largest value, and whether that is not the largest of all. `values`: one for each action.
    pub fn best(&self, values: &[f64], recent: Recent) -> (Action, bool) {
        let weary = if self.no_spin { recent.standing.saturating_sub(self.full_turn) } else { 0 };
        let less = 1.0 - (1.0 - IMPATIENCE).powf(f64::from(weary));
        let stays = |action: Action| self.advances & 1 << action.index() == 0;
        let impatient = |action, value: f64| if stays(action) { value - less * value.abs() } else { value };
        let best_of = |allowed: &dyn Fn(Action) -> bool, worth: &dyn Fn(Action, f64) -> f64| {
            let mut best = None;
            for (action, &value) in Action::first(self.count).zip(values).filter(|&(action, _)| allowed(action)) {
                let value = worth(action, value);
                if best.is_none_or(|(_, highest)| value > highest) {
                    best = Some((action, value));
                }
            }
            best.map_or(Action::FORWARD, |(action, _)| action)
        };
        let wish = best_of(&|_| true, &|_, value| value);
        let choice = best_of(&|action| self.allow(action, recent), &impatient);
        (choice, choice != wish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{ActionSpec, Motion};

    fn drive() -> ActionSet {
        ActionSet::differential_drive(0.3, 0.8)
    }

    fn on() -> Reflexes {
        Reflexes::all(&drive())
    }

    #[test]
    fn a_blocked_action_is_not_repeated() {
        let recent = Recent::default().then(Action::FORWARD, true, &drive());
        assert_eq!(on().best(&[3.0, 1.0, 2.0], recent), (Action::TURN_RIGHT, true));
        assert_eq!(on().off().best(&[3.0, 1.0, 2.0], recent), (Action::FORWARD, false));
        assert_eq!(
            on().best(&[3.0, 1.0, 2.0], Recent::default().then(Action::FORWARD, false, &drive())),
            (Action::FORWARD, false)
        );
    }

    #[test]
    fn what_was_blocked_does_not_make_a_turn_forgotten() {
        // Turn left, push against a wall: neither push again nor turn back.
        let recent = Recent::default().then(Action::TURN_LEFT, false, &drive()).then(Action::FORWARD, true, &drive());
        assert_eq!(on().best(&[3.0, 1.0, 2.0], recent), (Action::TURN_LEFT, true));
        assert_eq!(on().allowed(recent), 1 << Action::TURN_LEFT.index());
        assert_eq!(
            on().allowed(recent.then(Action::TURN_LEFT, false, &drive())),
            1 << Action::FORWARD.index() | 1 << Action::TURN_LEFT.index()
        );
        // One action is left whatever came before.
        let all = || Action::first(3).flat_map(|action| [(action, false), (action, true)]);
        for (first, second, third) in all().flat_map(|a| all().flat_map(move |b| all().map(move |c| (a, b, c)))) {
            let recent =
                [first, second, third].iter().fold(Recent::default(), |r, &(a, blocked)| r.then(a, blocked, &drive()));
            assert_ne!(on().allowed(recent), 0, "{recent:?}");
        }
    }

    #[test]
    fn a_robot_that_turns_about_in_one_place_leaves_it() {
        let actions = ActionSet::differential_drive(0.3, 0.8);
        let turned =
            |times: usize| (0..times).fold(Recent::default(), |r, _| r.then(Action::TURN_LEFT, false, &actions));
        // Eight turns are a full one.
        let first = |reflexes: Reflexes, values: [f64; 3]| {
            (0..100).find(|&times| reflexes.best(&values, turned(times)) == (Action::FORWARD, true))
        };
        assert_eq!((first(on(), [1.99, 2.0, 0.0]), first(on(), [1.0, 2.0, 0.0])), (Some(9), Some(22)));
        assert_eq!(first(on(), [-2.0, -1.0, -3.0]), None);
        assert_eq!(first(on(), [-1.5, -1.0, -3.0]), Some(22));
        assert_eq!(
            (first(on().off(), [1.99, 2.0, 0.0]), turned(20).then(Action::FORWARD, false, &actions).standing),
            (None, 0)
        );
    }

    #[test]
    fn a_turn_is_not_undone() {
        let recent = Recent::default().then(Action::TURN_LEFT, false, &drive());
        assert_eq!(on().best(&[1.0, 2.0, 3.0], recent), (Action::TURN_LEFT, true));
        assert_eq!(on().best(&[2.5, 2.0, 3.0], recent), (Action::FORWARD, true));
        assert_eq!(on().best(&[1.0, 2.0, 3.0], Recent::default()), (Action::TURN_RIGHT, false));
    }

    #[test]
    fn robots_have_other_actions_than_three() {
        let spec = |name: &str, distance, angle, inverse| ActionSpec {
            name: name.into(),
            motion: Motion { distance, angle },
            inverse,
        };
        let actions = ActionSet::new(vec![
            spec("ahead", 0.2, 0.0, Some(3)),
            spec("left", 0.0, 0.5, Some(2)),
            spec("right", 0.0, -0.5, Some(1)),
            spec("back", -0.2, 0.0, Some(0)),
            spec("wait", 0.0, 0.0, None),
        ]);
        let reflexes = Reflexes::all(&actions);
        let [ahead, back, wait] = [0, 3, 4].map(|number| actions.get(number).unwrap());
        let values = [1.0, 0.0, 0.5, 2.0, 1.5];
        assert_eq!(reflexes.best(&values, Recent::default()), (back, false));
        // Back would undo ahead; to wait undoes nothing.
        assert_eq!(reflexes.best(&values, Recent::default().then(ahead, false, &actions)), (wait, true));
        assert_eq!(reflexes.allowed(Recent::default().then(ahead, false, &actions)), 0b10111);
        assert_eq!(reflexes.allowed(Recent::default().then(wait, false, &actions)), 0b11111);
    }
}
