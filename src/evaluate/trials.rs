//! Trials: from random starts to a goal, many side by side.

use std::sync::{Arc, Mutex, OnceLock};

use faer::{Mat, Par};
use nalgebra::Point2;
use rand::RngExt;
use rayon::prelude::*;

use super::{Arrival, Avoided, Circle, TaskResult, WithoutReflexes, draw_pose, wilson_low};
use crate::evaluate::{OptimalSteps, reference_action};
use crate::lock::lock;
use crate::policy::{Learned, Recent, Reflexes, columns, step_between, step_of};
use crate::random::{fix_parallelism, stream};
use crate::robot::{Action, ActionSet, ActionValues, Pose};
use crate::scenario::{Avoid, ChangeKind, Scenario, Show, Task, in_goal};
use crate::value::MapStep;
use crate::value::place::Belief;
use crate::vision::{Observation, Observer, observe};
use crate::world::{Mover, Sensor, World};

/// Trials begin this many frames later at most, as far as distractors go: each finds them somewhere else.
const LATEST: u64 = 100_000;

/// A robot's way in a trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Trip {
    /// Its poses, the start first: one more than steps.
    pub poses: Vec<Pose>,
    /// Whether it arrived.
    pub arrived: bool,
    /// Distance from the shown place where the agent said that it had arrived, metres, if it did.
    pub declared_at: Option<f64>,
    /// The optimal number of steps from its start; `None` where there is no way within the limit.
    pub optimal: Option<usize>,
}

impl Trip {
    /// Actions on the way.
    pub fn steps(&self) -> usize {
        self.poses.len().saturating_sub(1)
    }

    /// Steps beyond the optimal ones; `None` if it did not arrive.
    pub fn extra(&self) -> Option<usize> {
        self.arrived.then(|| self.steps().saturating_sub(self.optimal.unwrap_or(0)))
    }
}

/// What a policy may know in a trial.
pub struct Situation<'a> {
    /// Number of the trial, in the order of the starts.
    pub trial: usize,
    /// The true pose.
    pub pose: &'a Pose,
    /// What the camera sees; none in trials without a camera.
    pub seen: Option<&'a Observation>,
    /// What the robot did last.
    pub recent: Recent,
    /// The step that led here; none at the start.
    pub step: Option<MapStep>,
}

/// A robot on its way.
struct Trial {
    number: usize,
    robot: Mover,
    sensor: Sensor,
    observer: Observer,
    seen: Observation,
    /// Frames by which distractors are ahead of those of the run.
    later: u64,
    recent: Recent,
    step: Option<MapStep>,
    memory: Memory,
    actions: Vec<Action>,
    poses: Vec<Pose>,
    /// Whether it is over.
    ended: bool,
    arrived: bool,
    declared_at: Option<f64>,
    /// Actions that led into what is to be avoided.
    entries: usize,
}

/// What a policy remembers in a trial.
#[derive(Default)]
struct Memory {
    /// Where it believes the robot to be.
    belief: Option<Belief>,
    /// Actions until the goal that it expected at the start.
    expected: Option<f64>,
}

/// A task with its goal at a place, fixed starts outside of it, and what they come to at best.
struct TrialTask {
    task: Task,
    avoid: Vec<Circle>,
    starts: Vec<Pose>,
    optimal: Vec<Option<usize>>,
    /// Success of the reference policy.
    reference: f64,
}

/// Fixed starts of all tasks, with their optimal steps.
pub struct Evaluator {
    scenario: Arc<Scenario>,
    world: Arc<World>,
    seed: u64,
    count: usize,
    /// The tasks as they are at first.
    courses: Vec<Arc<TrialTask>>,
    /// Those that were met with their goals elsewhere.
    moved: Mutex<Vec<Arc<TrialTask>>>,
    /// What a camera without noise sees at all starts, in the world as it looks at first.
    seen: OnceLock<Vec<Observation>>,
}

impl Evaluator {
    /// Draw `starts` starts per task, outside its goal, and search their optimal steps.
    pub fn new(scenario: Arc<Scenario>, world: Arc<World>, starts: usize, seed: u64) -> Self {
        fix_parallelism();
        let (count, courses, moved, seen) = (starts, Vec::new(), Mutex::default(), OnceLock::new());
        let mut evaluator = Evaluator { scenario, world, seed, count, courses, moved, seen };
        let avoid = evaluator.avoided(evaluator.scenario.avoids.iter().map(|avoid| avoid.at));
        let tasks = evaluator.scenario.tasks.iter();
        evaluator.courses = tasks.map(|task| evaluator.plan(task.clone(), avoid.clone())).collect();
        evaluator
    }

    /// What is to be avoided, as far as it is known where that is.
    fn avoided(&self, places: impl Iterator<Item = Option<[f64; 2]>>) -> Vec<Circle> {
        let area = |(place, avoid): (Option<[f64; 2]>, &Avoid)| {
            Some(Circle { centre: Point2::from(place?), radius: avoid.radius })
        };
        places.zip(&self.scenario.avoids).filter_map(area).collect()
    }

    /// Draw the starts of a task and see what they come to.
    fn plan(&self, task: Task, avoid: Vec<Circle>) -> Arc<TrialTask> {
        let plan = &self.world.plan;
        let cells: Vec<Point2<f64>> = plan.reachable_cells().collect();
        let mut rng = stream(self.seed, &format!("evaluate: starts of {}", task.name));
        let starts: Vec<Pose> =
            (0..self.count).map(|_| draw_pose(plan, &cells, &mut rng, |position| in_goal(&task, position))).collect();
        let (arena, robot, most) = (&self.world.arena, &self.scenario.robot, self.scenario.evaluate.max_steps);
        let search = OptimalSteps::new(arena, robot, &task, &avoid, most);
        let optimal = starts.par_iter().map(|&pose| search.from(pose)).collect();
        let mut course = TrialTask { task, avoid, starts, optimal, reference: 0.0 };
        course.reference = self.reference_success(&course);
        Arc::new(course)
    }

    /// The tasks as they are right behind the last frame that a model knows. A goal that lies where nobody can start outside of it stays where it was at first.
    fn courses(&self, learned: &Learned) -> Vec<Arc<TrialTask>> {
        let scenario = &self.scenario;
        let goals = scenario.tasks.iter().map(|task| task.goal).chain(scenario.avoids.iter().map(|avoid| avoid.at));
        let mut goals: Vec<Option<[f64; 2]>> = goals.collect();
        if learned.goals.len() == goals.len() {
            goals.clone_from(&learned.goals);
        }
        // Where the robot has no pose, the simulation knows where it was carried.
        let per_action = scenario.robot.frames_per_action as u64;
        let ends = |show: &Show| *show.actions().end() as u64 * per_action;
        for (goal, name) in goals.iter_mut().zip(scenario.names()).filter(|(goal, _)| goal.is_none()) {
            let mut shown = scenario.shows.iter().filter(|show| show.task == name && ends(show) <= learned.asked_at);
            *goal = shown.next_back().map(|show| show.at);
        }
        for change in &self.scenario.changes {
            // During the action before which it moves, the model may not know it yet: see [`Change`](crate::scenario::Change).
            if let ChangeKind::Goal { task, goal } = change.what
                && (0..per_action)
                    .contains(&(learned.asked_at + 1).wrapping_sub(change.first_frame(&self.scenario.robot)))
            {
                goals[task] = Some(goal);
            }
        }
        let avoid = self.avoided(goals.split_off(scenario.tasks.len()).into_iter());
        let at = |(course, goal): (&Arc<TrialTask>, Option<[f64; 2]>)| {
            let plan = &self.world.plan;
            let Some(place) = goal else { return course.clone() };
            let (centre, radius) = (Point2::from(place), course.task.radius);
            let as_at_first = goal == course.task.goal && avoid == course.avoid;
            if as_at_first || !plan.reaches_circle(centre, radius) || !plan.leaves_circle(centre, radius) {
                return course.clone();
            }
            let mut moved = lock(&self.moved);
            let known = |known: &&Arc<TrialTask>| {
                known.task.name == course.task.name && known.task.goal == goal && known.avoid == avoid
            };
            if let Some(known) = moved.iter().find(known) {
                return known.clone();
            }
            let new = self.plan(Task { goal, ..course.task.clone() }, avoid.clone());
            moved.push(new.clone());
            new
        };
        self.courses.iter().zip(goals).map(at).collect()
    }

    /// Results of all tasks, in the world as it looks, and with the goals where they are, right behind the last frame that the
    /// model knows; `without_reflexes`: also run the trials of the policy alone.
    pub fn evaluate(&self, learned: &Learned, without_reflexes: bool) -> Vec<TaskResult> {
        self.evaluate_and_show(learned, without_reflexes).into_iter().map(|(result, _)| result).collect()
    }

    /// Results of all tasks with the ways of their trials (those with reflexes), in the order of the starts.
    pub fn evaluate_and_show(&self, learned: &Learned, without_reflexes: bool) -> Vec<(TaskResult, Vec<Trip>)> {
        let reflexes = Reflexes::new(&self.scenario);
        let courses = self.courses(learned);
        let heedless = learned.without_avoiding().filter(|_| without_reflexes);
        let tried = courses.iter().enumerate().map(|(task, course)| {
            let trials = self.run(learned, task, course, reflexes);
            let unaided =
                without_reflexes.then(|| self.reached(course, &self.run(learned, task, course, reflexes.off())));
            let result = self.result(course, &trials, unaided);
            let arrival = course.task.is_shown().then(|| self.arrival(course, &trials));
            let expected_steps = mean(arrived(&trials).filter_map(|trial| trial.memory.expected));
            let entries = |trials: &[Trial]| trials.iter().map(|trial| trial.entries).sum();
            let avoided = (!course.avoid.is_empty()).then(|| Avoided {
                entries: entries(&trials),
                entries_without: heedless.as_ref().map(|heedless| entries(&self.run(heedless, task, course, reflexes))),
                detour: course.detour(&trials),
            });
            (TaskResult { arrival, avoided, expected_steps, ..result }, course.ways(trials))
        });
        tried.collect()
    }

    /// The slowest features of a model, at most `most` of them, at all starts, features × starts: what
    /// [`overlap`](super::overlap) compares from model to model. They are at most a quarter of the starts, since any features that
    /// are as many as these span all there is.
    pub fn features(&self, learned: &Learned, most: usize) -> Mat<f64> {
        let seen = self.seen.get_or_init(|| {
            let look = |pose: &Pose| observe(&self.world.appearance.camera(0).render(pose), &self.scenario.vision, 0);
            self.courses.par_iter().flat_map(|course| &course.starts).map(look).collect()
        });
        let phi = learned.features(columns(seen.iter()).as_ref(), Par::Seq);
        // The first one is constant.
        phi.subrows(1, most.min(phi.ncols() / 4).min(phi.nrows().saturating_sub(1))).to_owned()
    }

    /// What trials reach, with reflexes or without.
    fn reached(&self, course: &TrialTask, trials: &[Trial]) -> WithoutReflexes {
        let actions: usize = trials.iter().map(|trial| trial.actions.len()).sum();
        let dithers = trials.iter().map(|trial| dithers(&trial.actions, &self.scenario.robot.actions)).sum::<usize>();
        WithoutReflexes {
            success: share(arrived(trials).count(), trials.len()),
            mean_steps: mean(trials.iter().filter_map(Trial::steps).map(|steps| steps as f64)),
            convergence_quality: self.quality(course, trials),
            dithers_per_1000: 1000.0 * dithers as f64 / actions.max(1) as f64,
        }
    }

    fn result(&self, course: &TrialTask, trials: &[Trial], without_reflexes: Option<WithoutReflexes>) -> TaskResult {
        let (optimal, n) = (&course.optimal, trials.len());
        let extra = |(trial, best): (&Trial, &Option<usize>)| Some(trial.steps()? as f64 - (*best)? as f64);
        let reached = self.reached(course, trials);
        TaskResult {
            name: course.task.name.clone(),
            starts: n,
            success: reached.success,
            success_wilson_low: wilson_low(arrived(trials).count(), n),
            mean_steps: reached.mean_steps,
            expected_steps: None,
            optimal_mean_steps: mean(optimal.iter().flatten().map(|&best| best as f64)).unwrap_or(f64::NAN),
            extra_steps: mean(trials.iter().zip(optimal).filter_map(extra)),
            convergence_quality: reached.convergence_quality,
            reference_success: course.reference,
            dithers_per_1000: reached.dithers_per_1000,
            without_reflexes,
            arrival: None,
            avoided: None,
        }
    }

    fn arrival(&self, course: &TrialTask, trials: &[Trial]) -> Arrival {
        let mut distances: Vec<f64> = trials.iter().filter_map(|trial| trial.declared_at).collect();
        distances.sort_by(f64::total_cmp);
        let quantile =
            |share: f64| distances.get(((distances.len() as f64 * share) as usize).min(distances.len().max(1) - 1));
        let (declared, right) = (distances.len(), arrived(trials).count());
        Arrival {
            declared,
            true_rate: share(right, trials.len()),
            false_rate: share(declared - right, declared),
            distance_p50_m: quantile(0.5).copied(),
            distance_p99_m: quantile(0.99).copied(),
            quality: self.quality(course, trials),
        }
    }

    /// The thesis's convergence quality (definition *conv_qual*), against the optimal number of steps.
    fn quality(&self, course: &TrialTask, trials: &[Trial]) -> f64 {
        let gamma = self.scenario.value.gamma;
        let ratios = trials.iter().zip(&course.optimal).map(|(trial, best)| match (trial.steps(), best) {
            // Noise can make a trial shorter than the noise-free optimum: that counts as optimal.
            (Some(steps), Some(best)) => gamma.powi(steps.saturating_sub(*best) as i32),
            // It arrived from where the search found no way within the limit.
            (Some(_), None) => 1.0,
            (None, _) => 0.0,
        });
        ratios.sum::<f64>() / trials.len().max(1) as f64
    }

    fn run(&self, learned: &Learned, task: usize, course: &TrialTask, reflexes: Reflexes) -> Vec<Trial> {
        // Of a goal that is still to be shown, nobody knows where it is.
        if course.task.goal.is_none() {
            return Vec::new();
        }
        // Who goes on was told that it is not there.
        let in_goal: Vec<Option<bool>> = (0..=task).map(|of| (of == task).then_some(false)).collect();
        let gamma = self.scenario.value.gamma;
        let greedy = |situation: &Situation<'_>, memory: &mut Memory| {
            // These trials have a camera.
            let Memory { belief, expected } = memory;
            let state = situation.seen.map(|seen| learned.state_on_way(seen, belief, situation.step, &in_goal));
            if state.as_ref().is_some_and(|state| state.is_there(task)) {
                return None;
            }
            if situation.step.is_none() {
                *expected = state.as_ref().and_then(|state| state.expected_actions(task, gamma));
            }
            let values = state.map_or(ActionValues::new([]), |state| state.q_values(task));
            Some(reflexes.best(&values, situation.recent).0)
        };
        self.drive(course, Some(learned.asked_at + 1), &greedy)
    }

    /// The ways that a policy takes from all starts of a task, with the same noise as every other policy, in the world as it
    /// looks at first.
    ///
    /// Without a `camera`, which takes most of the time, the policy is shown the pose alone.
    pub fn trips(&self, task: usize, camera: bool, choose: &(dyn Fn(&Situation<'_>) -> Action + Sync)) -> Vec<Trip> {
        let course = &self.courses[task];
        course.ways(self.drive(course, camera.then_some(0), &|situation, _| Some(choose(situation))))
    }

    /// All trials of a task, one step of all of them at a time: seen and judged side by side, then driven. `frame` says how the
    /// world looks; without it there is no camera. Who chooses nothing says that it has arrived.
    fn drive(
        &self,
        course: &TrialTask,
        frame: Option<u64>,
        choose: &(dyn Fn(&Situation<'_>, &mut Memory) -> Option<Action> + Sync),
    ) -> Vec<Trial> {
        let mut trials = self.begin(course);
        for _ in 0..self.scenario.evaluate.max_steps {
            let mut active: Vec<&mut Trial> = trials.iter_mut().filter(|trial| !trial.ended).collect();
            if active.is_empty() {
                break;
            }
            let judge = |trial: &mut Trial, sees: bool| {
                let (seen, recent, step) = (sees.then_some(&trial.seen), trial.recent, trial.step);
                choose(
                    &Situation { trial: trial.number, pose: &trial.robot.pose(), seen, recent, step },
                    &mut trial.memory,
                )
            };
            let actions: Vec<Option<Action>> = match frame {
                Some(frame) => {
                    let place = |trial: &&mut Trial| trial.robot.eye(self.later(trial));
                    self.world.appearance.see_all(frame, &mut active, place, |trial, image| {
                        trial.sensor.expose(image, self.world.appearance.light(frame));
                        trial.observer.observe(image, &self.scenario.vision, &mut trial.seen.pixels);
                        judge(trial, true)
                    })
                }
                None => active.par_iter_mut().map(|trial| judge(trial, false)).collect(),
            };
            active.par_iter_mut().zip(actions).for_each(|(trial, action)| match action {
                Some(action) => self.act(trial, action, &course.task, &course.avoid),
                None => trial.declare(&course.task),
            });
        }
        trials
    }

    fn reference_success(&self, course: &TrialTask) -> f64 {
        let Some(goal) = course.task.goal.map(Point2::from) else { return 0.0 };
        // It drives by the true pose, and knows when it is there.
        let by_pose = Task { within: None, ..course.task.clone() };
        let mut trials = self.begin(course);
        for trial in &mut trials {
            while !trial.ended && trial.actions.len() < self.scenario.evaluate.max_steps {
                let action = reference_action(&trial.robot.pose(), goal);
                self.act(trial, action, &by_pose, &[]);
            }
        }
        share(arrived(&trials).count(), trials.len())
    }

    /// Robots at the starts, each with noise of its own, the same for every policy.
    fn begin(&self, course: &TrialTask) -> Vec<Trial> {
        let name = &course.task.name;
        let begin = |(index, &pose): (usize, &Pose)| {
            let noise = |what: &str| stream(self.seed, &format!("evaluate: {what} of {name}, trial {index}"));
            let robot = Mover::new(&self.scenario, &self.world, pose, noise);
            // A trial looks once per action.
            let seconds = self.scenario.robot.action_seconds;
            let sensor = Sensor::new(&self.scenario, seconds, noise("camera"));
            Trial {
                number: index,
                robot,
                sensor,
                observer: Observer::default(),
                seen: Observation { frame: index as u64, pixels: Vec::new() },
                later: noise("distractors").random_range(0..LATEST),
                recent: Recent::default(),
                step: None,
                memory: Memory::default(),
                actions: Vec::new(),
                poses: vec![pose],
                ended: false,
                arrived: false,
                declared_at: None,
                entries: 0,
            }
        };
        course.starts.iter().enumerate().map(begin).collect()
    }

    /// Frames by which distractors are ahead of the run's in a trial.
    fn later(&self, trial: &Trial) -> u64 {
        trial.later + (trial.actions.len() * self.scenario.robot.frames_per_action) as u64
    }

    fn act(&self, trial: &mut Trial, action: Action, task: &Task, avoid: &[Circle]) {
        let (from, counted) = (trial.robot.pose().position, trial.robot.odometry());
        let blocked = trial.robot.act(action, &self.scenario, &self.world);
        let pose = trial.robot.pose();
        // Who begins at its edge may have to cross it in order to get away.
        let margin = self.scenario.robot.forward / 2.0;
        let begins_outside = |area: &&Circle| (trial.poses[0].position - area.centre).norm() >= area.radius + margin;
        let entered = |area: &&Circle| area.is_entered(from, pose.position);
        trial.entries += avoid.iter().filter(begins_outside).filter(entered).count();
        trial.actions.push(action);
        trial.poses.push(pose);
        trial.recent = trial.recent.then(action, blocked, &self.scenario.robot.actions);
        trial.step = Some(match self.scenario.value.odometry {
            true => step_between(&counted, &trial.robot.odometry()),
            false => step_of(&self.scenario.robot.actions, action, blocked),
        });
        // Where the goal was shown, the agent has to say that it is there.
        trial.arrived = !task.is_shown() && in_goal(task, pose.position);
        trial.ended = trial.arrived;
    }
}

impl Trial {
    /// Its actions; `None` if it did not arrive.
    fn steps(&self) -> Option<usize> {
        self.arrived.then_some(self.actions.len())
    }

    /// The agent says that this is the goal.
    fn declare(&mut self, task: &Task) {
        let position = self.robot.pose().position;
        self.ended = true;
        self.arrived = in_goal(task, position);
        self.declared_at = task.goal.map(|goal| (position - Point2::from(goal)).norm());
    }
}

fn arrived(trials: &[Trial]) -> impl Iterator<Item = &Trial> {
    trials.iter().filter(|trial| trial.arrived)
}

/// A share of `n`, 0 of nothing.
fn share(count: usize, n: usize) -> f64 {
    count as f64 / n.max(1) as f64
}

impl TrialTask {
    /// Steps over those of the shortest way around what is to be avoided, mean over the trials that arrived.
    fn detour(&self, trials: &[Trial]) -> Option<f64> {
        let ratio = |(trial, best): (&Trial, &Option<usize>)| Some(trial.steps()? as f64 / (*best)?.max(1) as f64);
        mean(trials.iter().zip(&self.optimal).filter_map(ratio))
    }

    fn ways(&self, trials: Vec<Trial>) -> Vec<Trip> {
        let way = |(trial, &optimal): (Trial, &Option<usize>)| {
            let Trial { poses, arrived, declared_at, .. } = trial;
            Trip { poses, arrived, declared_at, optimal }
        };
        trials.into_iter().zip(&self.optimal).map(way).collect()
    }
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Number of places where a sequence of actions goes left–right–left–right or the reverse.
fn dithers(actions: &[Action], set: &ActionSet) -> usize {
    let turns = |four: &[Action]| four.windows(2).all(|pair| set.inverse(pair[0]) == Some(pair[1]));
    actions.windows(4).filter(|four| turns(four)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dithers_are_four_alternating_turns() {
        let [f, l, r] = Action::DRIVE;
        let set = ActionSet::differential_drive(0.3, 0.8);
        assert_eq!(dithers(&[l, r, l, r], &set), 1);
        assert_eq!(dithers(&[r, l, r, l, r, f], &set), 2);
        assert_eq!(dithers(&[l, r, l, f, r, l, l, r], &set), 0);
        assert_eq!(dithers(&[f, f, f, f], &set), 0);
    }
}
