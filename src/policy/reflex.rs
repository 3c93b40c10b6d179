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
    /// A turn is not undone by the opposite turn.
    pub no_undo_turn: bool,
}

/// What the robot did last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Recent {
    /// The last action, if any.
    pub action: Option<Action>,
    /// Whether a wall stopped it.
    pub blocked: bool,
}

impl Reflexes {
    /// No reflexes: the policy alone.
    pub const OFF: Reflexes = Reflexes { no_repeat_blocked: false, no_undo_turn: false };

    /// The reflexes of a scenario.
    pub fn new(settings: &scenario::Policy) -> Self {
        Reflexes { no_repeat_blocked: settings.no_repeat_blocked, no_undo_turn: settings.no_undo_turn }
    }

    /// Whether an action may follow what the robot did last. A turn is never
    /// blocked in simulation, so one action is forbidden at most; after a blocked turn only *forward* is left.
    pub fn allow(&self, action: Action, recent: Recent) -> bool {
        let repeats = self.no_repeat_blocked && recent.blocked && recent.action == Some(action);
        let undoes = self.no_undo_turn && recent.action.is_some() && action.opposite() == recent.action;
        !repeats && !undoes
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
        let recent = Recent { action: Some(Forward), blocked: true };
        assert_eq!(ON.best([3.0, 1.0, 2.0], recent), (TurnRight, true));
        assert_eq!(Reflexes::OFF.best([3.0, 1.0, 2.0], recent), (Forward, false));
        assert_eq!(ON.best([3.0, 1.0, 2.0], Recent { blocked: false, ..recent }), (Forward, false));
    }

    #[test]
    fn a_turn_is_not_undone() {
        let recent = Recent { action: Some(TurnLeft), blocked: false };
        assert_eq!(ON.best([1.0, 2.0, 3.0], recent), (TurnLeft, true));
        assert_eq!(ON.best([2.5, 2.0, 3.0], recent), (Forward, true));
        assert_eq!(ON.best([1.0, 2.0, 3.0], Recent::default()), (TurnRight, false));
    }
}
