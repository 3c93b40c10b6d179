//! What a person who watches a run asks of it: to pause, and to move a goal.
//!
//! The run looks at this once per action, and waits for nobody but while it is paused. That a run is to end is said by
//! [`RunOptions::stop`](crate::agent::RunOptions::stop), as for the first Ctrl-C; it ends a pause, too.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::source::GoalMove;

/// Moves of goals that may wait: a person makes one at a time.
const MOST_MOVES: usize = 16;

/// Time between looks at whether a run that is paused is to end: nobody wakes it for that.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);

/// More moves of goals wait than the run keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("{MOST_MOVES} moves of goals wait already: try again when the run has taken them")]
pub struct TooMany;

/// What is asked of a run, shared between it and whoever asks.
#[derive(Debug, Default)]
pub struct Controls {
    /// Looked at once per action, without a lock.
    wanted: AtomicBool,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct State {
    /// Since when the run has stood still, while it does.
    since: Option<Instant>,
    /// Length of all pauses that are over.
    over: Duration,
    moves: VecDeque<GoalMove>,
}

impl Controls {
    /// Let the run stand still from its next decision on, or go on.
    pub fn pause(&self, paused: bool) {
        self.wanted.store(paused, Ordering::Release);
        let _held = self.lock();
        self.changed.notify_all();
    }

    /// Whether a pause is wanted. The action that is under way is finished first.
    pub fn is_paused(&self) -> bool {
        self.wanted.load(Ordering::Acquire)
    }

    /// Whether the run stands still now.
    pub fn stands_still(&self) -> bool {
        self.lock().since.is_some()
    }

    /// How long the run has stood still in all.
    pub fn paused_for(&self) -> Duration {
        let state = self.lock();
        state.over + state.since.map_or(Duration::ZERO, |since| since.elapsed())
    }

    /// Ask for a goal to be moved. Whoever asks has checked that the task and the place exist.
    ///
    /// # Errors
    /// [`TooMany`].
    pub fn move_goal(&self, wanted: GoalMove) -> Result<(), TooMany> {
        let moves = &mut self.lock().moves;
        if moves.len() >= MOST_MOVES {
            return Err(TooMany);
        }
        moves.push_back(wanted);
        Ok(())
    }

    /// Moves that the run has not taken yet, in the order in which they were asked for.
    pub fn waiting_moves(&self) -> Vec<GoalMove> {
        self.lock().moves.iter().copied().collect()
    }

    /// Take all moves that wait, for the run.
    pub(in crate::agent) fn take_moves(&self) -> Vec<GoalMove> {
        self.lock().moves.drain(..).collect()
    }

    /// For the run: stand still until no pause is wanted any more or the run is to end; how long that was.
    pub(in crate::agent) fn wait(&self, stop: &AtomicBool) -> Duration {
        let begin = Instant::now();
        let mut state = self.lock();
        state.since = Some(begin);
        while self.is_paused() && !stop.load(Ordering::Relaxed) {
            state = self.changed.wait_timeout(state, LOOK_INTERVAL).unwrap_or_else(PoisonError::into_inner).0;
        }
        let paused = begin.elapsed();
        state.since = None;
        state.over += paused;
        paused
    }

    /// Whoever asks and panics must not take the run down.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_lasts_until_it_is_taken_back_or_the_run_is_to_end() {
        let (controls, stop) = (Controls::default(), AtomicBool::new(false));
        controls.pause(true);
        std::thread::scope(|scope| {
            let run = scope.spawn(|| controls.wait(&stop));
            while !controls.stands_still() {
                std::thread::yield_now();
            }
            std::thread::sleep(Duration::from_millis(30));
            assert!(!run.is_finished() && controls.paused_for() >= Duration::from_millis(30));
            controls.pause(false);
            let paused = run.join().unwrap();
            assert_eq!(controls.paused_for(), paused);
        });
        controls.pause(true);
        stop.store(true, Ordering::Relaxed);
        controls.wait(&stop);
        assert!(!controls.stands_still() && controls.is_paused());
    }

    #[test]
    fn moves_are_taken_in_their_order_and_do_not_pile_up() {
        let controls = Controls::default();
        let wanted = |task| GoalMove { task, goal: [1.0, 0.5] };
        for task in 0..MOST_MOVES {
            controls.move_goal(wanted(task)).unwrap();
        }
        assert_eq!(controls.move_goal(wanted(0)), Err(TooMany));
        assert_eq!(controls.take_moves(), (0..MOST_MOVES).map(wanted).collect::<Vec<_>>());
        assert!(controls.waiting_moves().is_empty());
    }
}
