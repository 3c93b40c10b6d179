//! The tasks as they are at a moment: goals move, by the scenario or by hand, or are shown, and so is what is to be avoided.

use std::sync::Arc;

use nalgebra::Point2;

use super::messages::{Marked, TaskOutcomes, TaskTransition};
use super::saved::wrong;
use crate::scenario::{Avoid, ChangeKind, Plan, Scenario, Task, in_goal};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::source::{GoalMove, Mark, MarkKind};
use crate::value::{MapStep, Transition, Window};
use crate::vision::Observation;

/// How an action ended.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionEnd {
    /// Where; not a number where nobody knows.
    pub place: Point2<f64>,
    /// Whether a wall stopped the robot.
    pub blocked: bool,
    /// What odometry says that the action did.
    pub step: Option<MapStep>,
    /// Rewards from outside, see [`Frame::rewards`](crate::source::Frame::rewards).
    pub rewards: Vec<f64>,
}

/// The tasks of a run, with their goals where they are now.
#[derive(Clone)]
pub struct Tasks {
    plan: Arc<Plan>,
    tasks: Vec<Task>,
    /// What is to be avoided; its numbers go on from those of tasks.
    avoids: Vec<Avoid>,
    /// Length of a move, metres.
    forward: f64,
    /// What the scenario moves from which frame on, in order; the first `done` of them are where they shall be.
    script: Vec<(u64, GoalMove)>,
    done: usize,
    /// What was marked, in its order.
    pub marks: Vec<Marked>,
}

impl Tasks {
    /// The tasks of a scenario as they are at first.
    pub fn new(scenario: &Scenario, plan: Arc<Plan>) -> Self {
        Tasks {
            plan,
            tasks: scenario.tasks.clone(),
            avoids: scenario.avoids.clone(),
            forward: scenario.robot.forward,
            script: script(scenario),
            done: 0,
            marks: Vec::new(),
        }
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
            let task = self.tasks.get_mut(goal.task).filter(|task| task.needs_pose());
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
        let is_goal = |number: usize| number < self.tasks.len();
        let here = |goal: bool| wished.iter().any(|mark| mark.kind == MarkKind::Here && is_goal(mark.task) == goal);
        let contradicts = here(true) && here(false);
        for &mark in wished {
            let of_task = |marked: &&Marked| marked.task == mark.task;
            let seen = |marked: &Marked| marked.observation.pixels == observation.pixels;
            let fault = match mark.kind {
                MarkKind::Forget => None,
                MarkKind::Here if contradicts => Some("is marked as a goal and as to be avoided"),
                MarkKind::Here if is_even(&observation.pixels) => Some("shows nothing: the camera sees one even grey"),
                MarkKind::Here
                    if self.marks.iter().any(|other| is_goal(other.task) != is_goal(mark.task) && seen(other)) =>
                {
                    Some(
                        "is a picture that was marked with the other sign: goals and what is to be avoided exclude each other",
                    )
                }
                MarkKind::Here => {
                    let again = self.marks.iter().rev().find(of_task).is_some_and(seen);
                    again.then_some("is the picture that was marked before: the camera may be frozen")
                }
            };
            if let Some(fault) = fault {
                let name = match self.tasks.get(mark.task) {
                    Some(task) => &task.name,
                    None => &self.avoids[mark.task - self.tasks.len()].name,
                };
                refused.push(format!("frame {} does not count as a mark of {name:?}: it {fault}", observation.frame));
                continue;
            }
            match mark.kind {
                MarkKind::Here => {
                    let place = (place.x.is_finite() && place.y.is_finite()).then_some([place.x, place.y]);
                    self.marks.push(Marked { task: mark.task, observation: observation.clone(), place });
                }
                MarkKind::Forget => self.marks.retain(|marked| marked.task != mark.task),
            }
            taken.push(mark);
        }
        for mark in &taken {
            let place = self.shown_place(mark.task);
            match mark.task.checked_sub(self.tasks.len()) {
                None => self.tasks[mark.task].goal = place,
                Some(avoid) => self.avoids[avoid].at = place,
            }
        }
        (taken, refused)
    }

    /// What is marked, in place of what was; goals that are shown are where it was.
    pub fn set_marks(&mut self, marks: Vec<Marked>) {
        self.marks = marks;
        for number in 0..self.tasks.len() + self.avoids.len() {
            let place = self.shown_place(number);
            match number.checked_sub(self.tasks.len()) {
                None if self.tasks[number].is_shown() => self.tasks[number].goal = place,
                Some(avoid) if self.avoids[avoid].within.is_some() => self.avoids[avoid].at = place,
                _ => {}
            }
        }
    }

    /// The mean of the places that were marked as a task's, if all are known.
    fn shown_place(&self, task: usize) -> Option<[f64; 2]> {
        let places = self.marks.iter().filter(|marked| marked.task == task).map(|marked| marked.place);
        let places = places.collect::<Option<Vec<[f64; 2]>>>().filter(|places| !places.is_empty())?;
        let mean = |i: usize| places.iter().map(|place| place[i]).sum::<f64>() / places.len() as f64;
        Some([mean(0), mean(1)])
    }

    /// The transitions of a window, judged by the tasks as they are now.
    pub fn judged(&self, window: &Window<Arc<Observation>, ActionEnd>) -> Vec<TaskTransition> {
        let judged = |t: Transition<Arc<Observation>, ActionEnd>| {
            let Transition { from, action, allowed, result, to, cell } = t;
            Transition { from, action, allowed, result: self.outcomes_of(&result), to, cell }
        };
        window.snapshot().into_iter().map(judged).collect()
    }

    /// What an action that ended so is worth to the tasks as they are now. What it is worth to tasks whose goals are shown follows from features, when policies are fitted: until then it is not a number.
    pub fn outcomes_of(&self, end: &ActionEnd) -> TaskOutcomes {
        let ActionEnd { place, blocked, step, rewards } = end;
        let from_outside =
            |number: usize| rewards.get(number).copied().filter(|reward| reward.is_finite()).unwrap_or(0.0);
        let outcome = |(number, task): (usize, &Task)| match &task.topic {
            _ if task.is_shown() => (f64::NAN, false),
            Some(_) => (from_outside(number), from_outside(number) > 0.0),
            None => (self.plan.reward(task, *place), in_goal(task, *place)),
        };
        let (rewards, in_goal) = self.tasks.iter().enumerate().map(outcome).unzip();
        let by_pose = self.avoids.iter().filter(|avoid| avoid.within.is_none());
        let avoided = by_pose.filter_map(|avoid| Some(avoid.reward_at(self.depth(*place, avoid.at?, avoid.radius))));
        TaskOutcomes { rewards, in_goal, avoided: avoided.sum(), blocked: *blocked, step: *step }
    }

    /// How deep in an area a place lies: 1 at its centre, 0 where it ends and farther away. It ends a little beyond the radius: where
    /// no straight move between two places outside of it can cross the circle.
    fn depth(&self, place: Point2<f64>, centre: [f64; 2], radius: f64) -> f64 {
        let depth = 1.0 - (place - Point2::from(centre)).norm() / radius.hypot(self.forward / 2.0);
        // Not a number where nobody knows the place.
        if depth > 0.0 { depth } else { 0.0 }
    }

    /// Centres of goal areas and of what is to be avoided, by number; of what is shown, as far as the pose was known when it was
    /// marked.
    pub fn centres(&self) -> Vec<Option<[f64; 2]>> {
        self.tasks.iter().map(|task| task.goal).chain(self.avoids.iter().map(|avoid| avoid.at)).collect()
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
        let centres = self.centres();
        let mut goals: Vec<[u64; 2]> =
            centres.iter().map(|centre| centre.unwrap_or([f64::NAN; 2]).map(f64::to_bits)).collect();
        snapshot.value("goals", &mut goals)?;
        snapshot.value("done", &mut self.done)?;
        if goals.len() != centres.len() || self.done > self.script.len() {
            return Err(wrong("goals", "they are those of other tasks"));
        }
        let places = self.tasks.iter_mut().map(|task| &mut task.goal);
        for (place, bits) in places.chain(self.avoids.iter_mut().map(|avoid| &mut avoid.at)).zip(goals) {
            *place = Some(bits.map(f64::from_bits)).filter(|place| !place[0].is_nan());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn marks_that_mean_nothing_or_contradict_each_other_are_refused() {
        let text = include_str!("../../../scenarios/avoid.toml");
        let scenario = Scenario::parse(text, std::path::Path::new("avoid.toml"), &[]).unwrap();
        let mut tasks = Tasks::new(&scenario, Arc::new(Plan::new(&scenario).unwrap()));
        let (west, stain) = (1, 2);
        let here = |task| Mark { task, kind: MarkKind::Here };
        let mut frame = 0;
        let mut mark = |wished: &[Mark], pixel: u8, place: [f64; 2]| {
            frame += 1;
            let observation = Arc::new(Observation { frame, pixels: vec![10, pixel, 200] });
            let (taken, refused) = tasks.mark(wished, &observation, Point2::from(place));
            (taken.len(), refused.join("; "), tasks.centres())
        };
        assert_eq!(mark(&[here(west)], 1, [0.4, 0.8]).0, 1);
        let frozen = mark(&[here(west)], 1, [0.4, 0.8]);
        assert!(frozen.0 == 0 && frozen.1.contains("the camera may be frozen"), "{}", frozen.1);
        let both = mark(&[here(west), here(stain)], 2, [0.4, 1.0]);
        assert!(both.0 == 0 && both.1.contains("as a goal and as to be avoided"), "{}", both.1);
        let other = mark(&[here(stain)], 1, [0.4, 0.8]);
        assert!(other.0 == 0 && other.1.contains("marked with the other sign"), "{}", other.1);
        assert_eq!(mark(&[here(west)], 3, [0.4, 1.0]).2[west], Some([0.4, 0.9]));
        assert_eq!(mark(&[here(stain)], 4, [1.5, 0.6]).2[stain], Some([1.5, 0.6]));
        // Forgotten and marked again with the same frame: it has moved.
        let moved = mark(&[Mark { task: west, kind: MarkKind::Forget }, here(west)], 5, [0.6, 1.2]);
        assert_eq!((moved.0, moved.2[west]), (2, Some([0.6, 1.2])));
        let dark = Arc::new(Observation { frame: 99, pixels: vec![3, 5, 4] });
        let (taken, refused) = tasks.mark(&[here(west)], &dark, Point2::new(0.4, 0.8));
        assert!(taken.is_empty() && refused[0].contains("one even grey"), "{refused:?}");
    }

    #[test]
    fn no_straight_move_crosses_an_area_unseen() {
        let text = "[[task]]\n[[task]]\navoid = [1.0, 1.0]\nradius = 0.2\nreward = -8.0\n[[world.room]]\ncorners = [[0.0, 0.0], [3.0, 2.0]]\n";
        let scenario = Scenario::parse(text, std::path::Path::new("area.toml"), &[]).unwrap();
        let tasks = Tasks::new(&scenario, Arc::new(Plan::new(&scenario).unwrap()));
        let avoided = |x: f64, y: f64| {
            tasks
                .outcomes_of(&ActionEnd { place: Point2::new(x, y), blocked: false, step: None, rewards: Vec::new() })
                .avoided
        };
        assert_eq!(avoided(1.0, 1.0), -8.0);
        assert!(avoided(1.15, 1.199) < 0.0 && avoided(1.15, 1.201) == 0.0, "half a move beside the circle's edge");
        assert_eq!(avoided(f64::NAN, f64::NAN), 0.0);
    }
}
