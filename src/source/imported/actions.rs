//! Actions that were recorded as such: each lasts from its message to the next one.

use std::collections::VecDeque;

use crate::robot::{Action, ActionSet};
use crate::source::{Segment, Step};

/// A recorded action lasts no longer than this many usual durations; later frames belong to none.
const LONGEST: f64 = 2.0;

/// Less than this share of an action ahead is being blocked; an action that was cut off after less of its duration is none.
const HALF: f64 = 0.5;

/// Frames by the recorded actions.
#[derive(Debug)]
pub struct RecordedActions {
    actions: ActionSet,
    /// What a step counts as one ahead, metres.
    forward: f64,
    action: Option<Action>,
    /// Since it began, in durations of an action.
    duration: f64,
    frames: usize,
    ahead: f64,
    finished: VecDeque<Segment>,
}

impl RecordedActions {
    /// Of a robot that can do these; `forward`: what its steps count as one ahead, metres.
    pub fn new(actions: ActionSet, forward: f64) -> Self {
        let finished = VecDeque::new();
        RecordedActions { actions, forward, action: None, duration: 0.0, frames: 0, ahead: 0.0, finished }
    }

    /// An action begins, or one ends that no other follows.
    pub fn begin(&mut self, action: Option<Action>) {
        self.close();
        (self.action, self.duration) = (action, 0.0);
    }

    /// One more frame, after the actions that began before it.
    pub fn push(&mut self, step: Step) {
        if self.duration + step.duration > LONGEST {
            self.begin(None);
        }
        self.duration += step.duration;
        self.frames += 1;
        self.ahead += step.ahead;
    }

    /// Frames are missing here, or the recording has ended.
    pub fn interrupt(&mut self) {
        if self.duration < HALF {
            self.action = None;
        }
        self.begin(None);
    }

    /// The next segment that is finished.
    pub fn finished(&mut self) -> Option<Segment> {
        self.finished.pop_front()
    }

    fn close(&mut self) {
        if self.frames > 0 {
            // What nobody measured was not blocked, nor was an action whose length nobody knows.
            let advances = self.action.filter(|&action| self.actions.advances(action));
            let is_short = |action| self.ahead * self.forward / self.actions.motion(action).distance < HALF;
            let blocked = advances.is_some_and(is_short);
            self.finished.push_back(Segment { frames: self.frames, action: self.action, blocked });
        }
        (self.frames, self.ahead) = (0, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{ActionSpec, Motion};

    fn steps(commanded: &mut RecordedActions, frames: usize, ahead: f64) {
        for _ in 0..frames {
            commanded.push(Step { ahead, duration: 0.2, ..Step::default() });
        }
    }

    #[test]
    fn each_action_lasts_to_the_next_but_not_for_ever() {
        let mut commanded = RecordedActions::new(ActionSet::differential_drive(0.3, 0.8), 0.3);
        steps(&mut commanded, 3, 0.0);
        commanded.begin(Some(Action::FORWARD));
        steps(&mut commanded, 5, 0.2);
        commanded.begin(Some(Action::FORWARD));
        steps(&mut commanded, 5, 0.05);
        commanded.begin(Some(Action::TURN_LEFT));
        steps(&mut commanded, 14, 0.0);
        commanded.begin(Some(Action::TURN_RIGHT));
        steps(&mut commanded, 2, 0.0);
        commanded.interrupt();
        let found: Vec<_> = std::iter::from_fn(|| commanded.finished())
            .map(|s| (s.frames, s.action.map(Action::index), s.blocked))
            .collect();
        // The last one was cut off after 0.4 of its duration.
        let expected = [
            (3, None, false),
            (5, Some(0), false),
            (5, Some(0), true),
            (10, Some(1), false),
            (4, None, false),
            (2, None, false),
        ];
        assert_eq!(found, expected);
    }

    /// Turns come first here, a move is twice as long as a step counts, and one goes back.
    #[test]
    fn an_action_is_blocked_by_its_own_length() {
        let spec = |name: &str, distance: f64, angle: f64| ActionSpec {
            name: name.into(),
            motion: Motion { distance, angle },
            inverse: None,
        };
        let actions = vec![spec("left", 0.0, 0.8), spec("ahead", 0.6, 0.0), spec("back", -0.3, 0.0)];
        let actions = ActionSet::new(actions);
        let mut commanded = RecordedActions::new(actions.clone(), 0.3);
        for (number, ahead) in [(0, 0.0), (1, 0.3), (1, 0.18), (2, -0.12), (2, -0.08)] {
            commanded.begin(actions.get(number));
            steps(&mut commanded, 5, ahead);
        }
        commanded.interrupt();
        let blocked: Vec<bool> = std::iter::from_fn(|| commanded.finished()).map(|s| s.blocked).collect();
        assert_eq!(blocked, [false, false, true, false, true]);
    }
}
