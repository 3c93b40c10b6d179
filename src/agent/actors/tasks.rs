//! The tasks as they are at a moment: goals move, by the scenario or by hand, or are shown.

use std::sync::Arc;

use nalgebra::Point2;

use super::messages::{Marked, TaskOutcomes};
use super::saved::wrong;
use crate::scenario::{ChangeKind, Plan, Scenario, Task, in_goal};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::source::{GoalMove, Mark, MarkKind};
use crate::vision::Observation;

/// How an action ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ActionEnd {
    /// Where; not a number where nobody knows.
    pub place: Point2<f64>,
    /// Whether a wall stopped the robot.
    pub blocked: bool,
}

/// The tasks of a run, with their goals where they are now.
pub struct Tasks {
    plan: Arc<Plan>,
    tasks: Vec<Task>,
    /// What the scenario moves from which frame on, in order; the first `done` of them are where they shall be.
    script: Vec<(u64, GoalMove)>,
    done: usize,
    /// What was marked, in its order.
    pub marks: Vec<Marked>,
}

impl Tasks {
    /// The tasks of a scenario as they are at first.
    pub fn new(scenario: &Scenario, plan: Arc<Plan>) -> Self {
        Tasks { plan, tasks: scenario.tasks.clone(), script: script(scenario), done: 0, marks: Vec::new() }
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
            let task = self.tasks.get_mut(goal.task).filter(|task| !task.is_shown());
            if let Some(task) = task.filter(|task| finite && task.goal != Some(goal.goal)) {
                task.goal = Some(goal.goal);
                moved.push(goal);
            }
        }
        moved
    }

    /// Take note of what was marked with an observation. Returns what counts of it, and why the rest does not.
    pub fn mark(
        &mut self,
        wished: &[Mark],
        observation: &Arc<Observation>,
        place: Point2<f64>,
    ) -> (Vec<Mark>, Vec<String>) {
        let (mut taken, mut refused) = (Vec::new(), Vec::new());
        for &mark in wished {
            let Some(task) = self.tasks.get(mark.task).filter(|task| task.is_shown()) else { continue };
            let of_task = |marked: &&Marked| marked.task == mark.task;
            let fault = match mark.kind {
                MarkKind::Forget => None,
                MarkKind::Goal if is_even(&observation.pixels) => Some("shows nothing: the camera sees one even grey"),
                MarkKind::Goal => {
                    let seen = |marked: &Marked| marked.observation.pixels == observation.pixels;
                    let again = self.marks.iter().rev().find(of_task).is_some_and(seen);
                    again.then_some("is the picture that was marked before: the camera may be frozen")
                }
            };
            if let Some(fault) = fault {
                refused.push(format!(
                    "frame {} does not count as the goal of {:?}: it {fault}",
                    observation.frame, task.name
                ));
                continue;
            }
            match mark.kind {
                MarkKind::Goal => {
                    let place = (place.x.is_finite() && place.y.is_finite()).then_some([place.x, place.y]);
                    self.marks.push(Marked { task: mark.task, observation: observation.clone(), place });
                }
                MarkKind::Forget => self.marks.retain(|marked| marked.task != mark.task),
            }
            taken.push(mark);
        }
        for task in 0..self.tasks.len() {
            if taken.iter().any(|mark| mark.task == task) {
                self.tasks[task].goal = self.shown_place(task);
            }
        }
        (taken, refused)
    }

    /// The mean of the places that were marked as a task's goal, if all are known.
    fn shown_place(&self, task: usize) -> Option<[f64; 2]> {
        let places = self.marks.iter().filter(|marked| marked.task == task).map(|marked| marked.place);
        let places = places.collect::<Option<Vec<[f64; 2]>>>().filter(|places| !places.is_empty())?;
        let mean = |i: usize| places.iter().map(|place| place[i]).sum::<f64>() / places.len() as f64;
        Some([mean(0), mean(1)])
    }

    /// What an action that ended so is worth to the tasks as they are now. What it is worth to tasks whose goals are shown follows from features, when policies are fitted: until then it is not a number.
    pub fn outcomes_of(&self, end: ActionEnd) -> TaskOutcomes {
        let ActionEnd { place, blocked } = end;
        let reward = |task: &Task| if task.is_shown() { f64::NAN } else { self.plan.reward(task, place) };
        TaskOutcomes {
            rewards: self.tasks.iter().map(reward).collect(),
            in_goal: self.tasks.iter().map(|task| !task.is_shown() && in_goal(task, place)).collect(),
            blocked,
        }
    }

    /// Centres of the goal areas, by task; of goals that are shown, as far as the pose was known when they were marked.
    pub fn centres(&self) -> Vec<Option<[f64; 2]>> {
        self.tasks.iter().map(|task| task.goal).collect()
    }
}

/// Whether all pixels are the same, within the noise of a camera: a lens cap, darkness.
fn is_even(pixels: &[u8]) -> bool {
    const NOISE: u8 = 8;
    let (least, most) = (pixels.iter().min(), pixels.iter().max());
    least.zip(most).is_none_or(|(least, most)| most - least <= NOISE)
}

/// The goals that a scenario moves, each with the first frame that is judged by it.
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
        // NaN is a place that nobody knows.
        let mut goals: Vec<[u64; 2]> =
            self.tasks.iter().map(|task| task.goal.unwrap_or([f64::NAN; 2]).map(f64::to_bits)).collect();
        snapshot.value("goals", &mut goals)?;
        snapshot.value("done", &mut self.done)?;
        if goals.len() != self.tasks.len() || self.done > self.script.len() {
            return Err(wrong("goals", "they are those of other tasks"));
        }
        for (task, goal) in self.tasks.iter_mut().zip(goals) {
            task.goal = Some(goal.map(f64::from_bits)).filter(|goal| !goal[0].is_nan());
        }
        Ok(())
    }
}
