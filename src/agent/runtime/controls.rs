//! What a person who watches a run asks of it: to pause, to go somewhere, to move a goal, and that it is at a place that
//! is to be shown.
//!
//! The run looks at this once per action, and waits for nobody but while it is paused. That a run is to end is said by
//! [`RunOptions::stop`](crate::agent::RunOptions::stop), as for the first Ctrl-C; it ends a pause, too.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use thiserror::Error;

use crate::lock::lock;
use crate::policy::Goto;
use crate::robot::Action;
use crate::source::live::Switches;
use crate::source::{GoalMove, Mark, MarkKind};

/// Moves of goals that may wait: a person makes one at a time.
const MOST_MOVES: usize = 16;

/// Time between looks at whether a run that is paused is to end: nobody wakes it for that.
const LOOK_INTERVAL: Duration = Duration::from_millis(20);

/// Frames are marked for so long after a button was last said to be held: whoever holds it may be gone.
const HELD: Duration = Duration::from_millis(1500);

/// More moves of goals wait than the run keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("{MOST_MOVES} moves of goals wait already: try again when the run has taken them")]
pub struct TooMany;

/// How somebody marks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Marking {
    /// Each frame from now on; to be said again at least once a second.
    Hold,
    /// No more frames.
    Release,
    /// Each frame of so many turns to the left, which the robot does in place of what it decides.
    Turn(usize),
    /// What was marked so far does not count any more.
    Forget,
}

/// What is asked of a run, shared between it and whoever asks.
#[derive(Debug, Default)]
pub struct Controls {
    /// What a robot shares: that a pause is wanted is looked at once per action, without a lock.
    switches: Switches,
    /// Number of the task to whose goal a robot drives whose battery is low.
    dock: Option<usize>,
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
    goto: Option<Goto>,
    /// How often the robot has arrived where somebody had sent it, and whether it waits there.
    arrivals: u64,
    waits_there: bool,
    /// What is being marked, and until when.
    held: Option<(usize, Instant)>,
    /// What is to be marked by turns, and how many.
    wanted_turns: Option<(usize, usize)>,
    /// What is being marked by turns, and how many are left after this one.
    turning: Option<(usize, usize)>,
    /// What is to be forgotten.
    forgotten: Vec<usize>,
}

impl Controls {
    /// Controls that share these switches with a robot, which drives to the goal of the task `dock` when its battery is low.
    pub fn sharing(switches: Switches, dock: Option<usize>) -> Self {
        Controls { switches, dock, ..Controls::default() }
    }

    /// Let a robot go on that is held after a stop.
    pub fn release(&self) {
        self.switches.go_on.store(true, Ordering::Release);
    }

    /// Let the run stand still from its next decision on, or go on.
    pub fn pause(&self, paused: bool) {
        self.switches.paused.store(paused, Ordering::Release);
        let _held = self.lock();
        self.changed.notify_all();
    }

    /// Whether a pause is wanted. The action that is under way is finished first.
    pub fn is_paused(&self) -> bool {
        self.switches.paused.load(Ordering::Acquire)
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

    /// Send the robot somewhere; the last one counts. Whoever asks has checked that the task exists. Once it is there, the run
    /// is paused.
    pub fn send(&self, goto: Goto) {
        let mut state = self.lock();
        state.goto = Some(goto);
        if std::mem::take(&mut state.waits_there) {
            drop(state);
            self.pause(false);
        }
    }

    /// How often the robot has arrived where somebody had sent it.
    pub fn arrivals(&self) -> u64 {
        self.lock().arrivals
    }

    /// For the run: the robot is where somebody has sent it, and waits there.
    pub(in crate::agent) fn arrive(&self) {
        {
            let state = &mut self.lock();
            (state.arrivals, state.waits_there) = (state.arrivals + 1, true);
        }
        self.pause(true);
    }

    /// Take where the robot is to go, for the run.
    pub(in crate::agent) fn take_goto(&self) -> Option<Goto> {
        let low = self.switches.battery_low.swap(false, Ordering::Relaxed);
        self.dock.filter(|_| low).map(Goto::Task).or_else(|| self.lock().goto.take())
    }

    /// Mark the place of a number, see [`Scenario::names`](crate::scenario::Scenario::names). Whoever asks has checked that it is
    /// shown.
    pub fn mark(&self, task: usize, how: Marking) {
        let state = &mut self.lock();
        match how {
            Marking::Hold => state.held = Some((task, Instant::now() + HELD)),
            Marking::Release => state.held = None,
            Marking::Turn(turns) => state.wanted_turns = Some((task, turns)),
            Marking::Forget if state.forgotten.contains(&task) => {}
            Marking::Forget => state.forgotten.push(task),
        }
    }

    /// What is being marked by hand now, or by turns.
    pub fn marking(&self) -> Option<usize> {
        let state = self.lock();
        let held = state.held.filter(|(_, until)| Instant::now() < *until).map(|(task, _)| task);
        held.or(state.turning.or(state.wanted_turns).map(|(task, _)| task))
    }

    /// What a frame is marked as; `ends`: it is the last one of an action.
    pub(in crate::agent) fn take_marks(&self, ends: bool) -> Vec<Mark> {
        let state = &mut self.lock();
        let mut marks: Vec<Mark> = Vec::new();
        if ends {
            marks.extend(state.forgotten.drain(..).map(|task| Mark { task, kind: MarkKind::Forget }));
        }
        if state.held.is_some_and(|(_, until)| Instant::now() >= until) {
            state.held = None;
        }
        let here = state.held.map(|(task, _)| task).into_iter().chain(state.turning.map(|(task, _)| task));
        marks.extend(here.map(|task| Mark { task, kind: MarkKind::Here }));
        marks
    }

    /// What the robot does in place of an action: turns, where somebody marks by them.
    pub(in crate::agent) fn instead_of(&self, action: Action) -> Action {
        let state = &mut self.lock();
        let turning = state.turning.filter(|(_, left)| *left > 0).or_else(|| state.wanted_turns.take());
        state.turning = turning.map(|(task, left)| (task, left.saturating_sub(1)));
        if state.turning.is_some() { Action::TURN_LEFT } else { action }
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
        (state.since, state.waits_there) = (None, false);
        state.over += paused;
        paused
    }

    /// Whoever asks and panics must not take the run down.
    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
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
