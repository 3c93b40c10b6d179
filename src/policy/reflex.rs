//! Two reflexes between policy and wheels.
//!
//! A policy that sees the camera alone cannot know that it was just blocked, nor that it came from the other side: it can
//! push against a wall for ever, or turn left and right for ever. The reflexes forbid just these two.

use crate::scenario;
use crate::world::Action;

/// Which reflexes are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reflexes {
    /// An action that was just blocked is not repeated.
    pub no_repeat_blocked: bool,
    /// A turn is not undone by the opposite turn, not even after an action that was blocked.
    pub no_undo_turn: bool,
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
    /// No reflexes: the policy alone.
    pub const OFF: Reflexes = Reflexes { no_repeat_blocked: false, no_undo_turn: false };

    /// The reflexes of a scenario.
    pub fn new(settings: &scenario::Policy) -> Self {
        Reflexes { no_repeat_blocked: settings.no_repeat_blocked, no_undo_turn: settings.no_undo_turn }
    }

    /// Whether an action may follow what the robot did last. One always may.
    pub fn allow(&self, action: Action, recent: Recent) -> bool {
        let repeats = self.no_repeat_blocked && recent.blocked == Some(action);
        let undoes = self.no_undo_turn && recent.action.is_some() && action.opposite() == recent.action;
        !repeats && !undoes
    }

    /// The actions that may follow, as bits by their [numbers](Action::index).
    pub fn allowed(&self, recent: Recent) -> u32 {
        let allowed = Action::ALL.into_iter().filter(|&action| self.allow(action, recent));
        allowed.fold(0, |bits, action| bits | 1 << action.index())
    }

    /// The allowed action of the largest value, and whether that is not the largest of all.
    pub fn best(&self, values: [f64; 3], recent: Recent) -> (Action, bool) {
        let best_of = |allowed: &dyn Fn(Action) -> bool| {
            let mut best = None;
            for action in Action::ALL.into_iter().filter(|&action| allowed(action)) {
                let value = values[action.index()];
                if best.is_none_or(|(_, highest)| value > highest) {
                    best = Some((action, value));
                }
            }
            best.map_or(Action::Forward, |(action, _)| action)
        };
        let wish = best_of(&|_| true);
        let choice = best_of(&|action| self.allow(action, recent));
        (choice, choice != wish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Action::*;

    const ON: Reflexes = Reflexes { no_repeat_blocked: true, no_undo_turn: true };

    #[test]
    fn a_blocked_action_is_not_repeated() {
        let recent = Recent::default().then(Forward, true);
        assert_eq!(ON.best([3.0, 1.0, 2.0], recent), (TurnRight, true));
        assert_eq!(Reflexes::OFF.best([3.0, 1.0, 2.0], recent), (Forward, false));
        assert_eq!(ON.best([3.0, 1.0, 2.0], Recent::default().then(Forward, false)), (Forward, false));
    }

    #[test]
    fn what_was_blocked_does_not_make_a_turn_forgotten() {
        // Turn left, push against a wall: neither push again nor turn back.
        let recent = Recent::default().then(TurnLeft, false).then(Forward, true);
        assert_eq!(ON.best([3.0, 1.0, 2.0], recent), (TurnLeft, true));
        assert_eq!(ON.allowed(recent), 1 << TurnLeft.index());
        assert_eq!(ON.allowed(recent.then(TurnLeft, false)), 1 << Forward.index() | 1 << TurnLeft.index());
        // One action is left whatever came before.
        let all = || Action::ALL.into_iter().flat_map(|action| [(action, false), (action, true)]);
        for (first, second, third) in all().flat_map(|a| all().flat_map(move |b| all().map(move |c| (a, b, c)))) {
            let recent = [first, second, third].iter().fold(Recent::default(), |r, &(a, blocked)| r.then(a, blocked));
            assert_ne!(ON.allowed(recent), 0, "{recent:?}");
        }
    }

    #[test]
    fn a_turn_is_not_undone() {
        let recent = Recent::default().then(TurnLeft, false);
        assert_eq!(ON.best([1.0, 2.0, 3.0], recent), (TurnLeft, true));
        assert_eq!(ON.best([2.5, 2.0, 3.0], recent), (Forward, true));
        assert_eq!(ON.best([1.0, 2.0, 3.0], Recent::default()), (TurnRight, false));
    }
}
