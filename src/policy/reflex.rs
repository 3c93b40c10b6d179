//! Two reflexes between policy and wheels.
//!
//! A policy that sees the camera alone cannot know that it was just blocked, nor that it came from the other side: it can
//! push against a wall for ever, or turn left and right for ever. The reflexes forbid just these two.

use crate::robot::{Action, ActionSet, MOST_ACTIONS};
use crate::scenario::Scenario;

/// Which reflexes are on, for the actions of a robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reflexes {
    /// An action that was just blocked is not repeated.
    pub no_repeat_blocked: bool,
    /// An action is not undone by its inverse, such as a turn by the opposite turn, not even after an action that was blocked.
    pub no_undo: bool,
    /// How many actions there are, and the inverse of each.
    count: usize,
    inverses: [Option<Action>; MOST_ACTIONS],
}

/// What the robot did last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Recent {
    /// The last action that went its way.
    pub action: Option<Action>,
    /// The action that a wall stopped since then.
    pub blocked: Option<Action>,
}

impl Recent {
    /// One action later. An action that was blocked leaves the robot where it was, or nearly so: the one before still counts.
    /// Otherwise a robot at a wall could turn left and right for ever, with a push against the wall in between.
    pub fn then(self, action: Action, blocked: bool) -> Recent {
        if blocked { Recent { blocked: Some(action), ..self } } else { Recent { action: Some(action), blocked: None } }
    }
}

impl Reflexes {
    /// The reflexes of a scenario.
    pub fn new(scenario: &Scenario) -> Self {
        let (no_repeat_blocked, no_undo) = (scenario.policy.no_repeat_blocked, scenario.policy.no_undo_turn);
        Reflexes { no_repeat_blocked, no_undo, ..Reflexes::all(&scenario.robot.actions) }
    }

    /// Both reflexes, for the actions of a robot.
    pub fn all(actions: &ActionSet) -> Self {
        let mut inverses = [None; MOST_ACTIONS];
        actions.iter().for_each(|action| inverses[action.index()] = actions.inverse(action));
        Reflexes { no_repeat_blocked: true, no_undo: true, count: actions.len(), inverses }
    }

    /// No reflexes for the same actions: the policy alone.
    pub fn off(self) -> Self {
        Reflexes { no_repeat_blocked: false, no_undo: false, ..self }
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
        let best_of = |allowed: &dyn Fn(Action) -> bool| {
            let mut best = None;
            for (action, &value) in Action::first(self.count).zip(values).filter(|&(action, _)| allowed(action)) {
                if best.is_none_or(|(_, highest)| value > highest) {
                    best = Some((action, value));
                }
            }
            best.map_or(Action::FORWARD, |(action, _)| action)
        };
        let wish = best_of(&|_| true);
        let choice = best_of(&|action| self.allow(action, recent));
        (choice, choice != wish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{ActionSpec, Motion};

    fn on() -> Reflexes {
        Reflexes::all(&ActionSet::differential_drive(0.3, 0.8))
    }

    #[test]
    fn a_blocked_action_is_not_repeated() {
        let recent = Recent::default().then(Action::FORWARD, true);
        assert_eq!(on().best(&[3.0, 1.0, 2.0], recent), (Action::TURN_RIGHT, true));
        assert_eq!(on().off().best(&[3.0, 1.0, 2.0], recent), (Action::FORWARD, false));
        assert_eq!(
            on().best(&[3.0, 1.0, 2.0], Recent::default().then(Action::FORWARD, false)),
            (Action::FORWARD, false)
        );
    }

    #[test]
    fn what_was_blocked_does_not_make_a_turn_forgotten() {
        // Turn left, push against a wall: neither push again nor turn back.
        let recent = Recent::default().then(Action::TURN_LEFT, false).then(Action::FORWARD, true);
        assert_eq!(on().best(&[3.0, 1.0, 2.0], recent), (Action::TURN_LEFT, true));
        assert_eq!(on().allowed(recent), 1 << Action::TURN_LEFT.index());
        assert_eq!(
            on().allowed(recent.then(Action::TURN_LEFT, false)),
            1 << Action::FORWARD.index() | 1 << Action::TURN_LEFT.index()
        );
        // One action is left whatever came before.
        let all = || Action::first(3).flat_map(|action| [(action, false), (action, true)]);
        for (first, second, third) in all().flat_map(|a| all().flat_map(move |b| all().map(move |c| (a, b, c)))) {
            let recent = [first, second, third].iter().fold(Recent::default(), |r, &(a, blocked)| r.then(a, blocked));
            assert_ne!(on().allowed(recent), 0, "{recent:?}");
        }
    }

    #[test]
    fn a_turn_is_not_undone() {
        let recent = Recent::default().then(Action::TURN_LEFT, false);
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
        assert_eq!(reflexes.best(&values, Recent::default().then(ahead, false)), (wait, true));
        assert_eq!(reflexes.allowed(Recent::default().then(ahead, false)), 0b10111);
        assert_eq!(reflexes.allowed(Recent::default().then(wait, false)), 0b11111);
    }
}
