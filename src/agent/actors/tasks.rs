//! The tasks as they are at a moment: goals move, by the scenario or by hand.

use std::sync::Arc;

use nalgebra::Point2;

use super::messages::TaskOutcomes;
use super::saved::wrong;
use crate::scenario::{ChangeKind, Plan, Scenario, Task, in_goal};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::source::GoalMove;

/// The tasks of a run, with their goals where they are now.
pub struct Tasks {
    plan: Arc<Plan>,
    tasks: Vec<Task>,
    /// What the scenario moves from which frame on, in order; the first `done` of them are where they shall be.
    script: Vec<(u64, GoalMove)>,
    done: usize,
}

impl Tasks {
    /// The tasks of a scenario as they are at first.
    pub fn new(scenario: &Scenario, plan: Arc<Plan>) -> Self {
        Tasks { plan, tasks: scenario.tasks.clone(), script: script(scenario), done: 0 }
    }

    /// Move goals as the scenario has it up to a frame, and then as somebody wished. Returns what did move.
    pub fn follow(&mut self, frame: u64, wished: &[GoalMove]) -> Vec<GoalMove> {
        let due = self.script[self.done..].iter().take_while(|(first, _)| *first <= frame).count();
        let scripted = self.script[self.done..self.done + due].iter().map(|(_, moved)| *moved);
        let all: Vec<GoalMove> = scripted.chain(wished.iter().copied()).collect();
        self.done += due;
        let mut moved = Vec::new();
        for goal in all {
            // A recording has what its scenario moved, too: that is done by then. A damaged one may have anything.
            let finite = goal.goal.iter().all(|value| value.is_finite());
            let task = self.tasks.get_mut(goal.task).filter(|task| finite && task.goal != goal.goal);
            if let Some(task) = task {
                task.goal = goal.goal;
                moved.push(goal);
            }
        }
        moved
    }

    /// What an action that ended at a place, as the ceiling camera sees it, is worth to the tasks as they are now.
    pub fn outcomes_at(&self, place: Point2<f64>) -> TaskOutcomes {
        TaskOutcomes {
            rewards: self.tasks.iter().map(|task| self.plan.reward(task, place)).collect(),
            in_goal: self.tasks.iter().map(|task| in_goal(task, place)).collect(),
        }
    }

    /// Centres of the goal areas, by task.
    pub fn centres(&self) -> Vec<[f64; 2]> {
        self.tasks.iter().map(|task| task.goal).collect()
    }
}

/// The goals that a scenario moves, each with the first frame that is outcomes by it.
fn script(scenario: &Scenario) -> Vec<(u64, GoalMove)> {
    let moves = scenario.changes.iter().filter_map(|change| match change.what {
        ChangeKind::Goal { task, goal } => Some((change.first_frame(&scenario.robot), GoalMove { task, goal })),
        _ => None,
    });
    let mut script: Vec<_> = moves.collect();
    script.sort_by_key(|(first, _)| *first);
    script
}

impl Persist for Tasks {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let mut goals: Vec<[u64; 2]> = self.tasks.iter().map(|task| task.goal.map(f64::to_bits)).collect();
        snapshot.value("goals", &mut goals)?;
        snapshot.value("done", &mut self.done)?;
        if goals.len() != self.tasks.len() || self.done > self.script.len() {
            return Err(wrong("goals", "they are those of other tasks"));
        }
        for (task, goal) in self.tasks.iter_mut().zip(goals) {
            task.goal = goal.map(f64::from_bits);
        }
        Ok(())
    }
}
