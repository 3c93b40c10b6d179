//! What the experiments learn from: a robot's random walk through the lab, and transitions out of it.

use std::path::Path;
use std::sync::Arc;

use faer::Mat;
use nalgebra::Point2;
use serde::Serialize;

use super::{Bench, ExperimentError};
use crate::evaluate::Evaluator;
use crate::policy::{Recent, Reflexes, Walk};
use crate::random::stream;
use crate::robot::{Action, ActionSet, Pose, wrap};
use crate::scenario::{ChangeKind, Renderer, Scenario, Task};
use crate::slow::Link;
use crate::slow::theory::{Axis, OptimalResponses, TheoryError, plane_motion};
use crate::vision::{Image, Observer, ZERO};
use crate::world::{Robot, Sensor, World};

/// The scenario of the lab, as it is in the repository.
const LAB: &str = include_str!("../../scenarios/lab.toml");
/// The same with five goals.
const GOALS: &str = include_str!("../../scenarios/goals.toml");
/// That of the two rooms.
const TWO_ROOMS: &str = include_str!("../../scenarios/two_rooms.toml");

/// All worlds but the one for tests, by name, as they are in the repository: the small ones first.
pub const WORLDS: [(&str, &str); 10] = [
    ("lab", LAB),
    ("l_shape", include_str!("../../scenarios/l_shape.toml")),
    ("pillars", include_str!("../../scenarios/pillars.toml")),
    ("wall_gap", include_str!("../../scenarios/wall_gap.toml")),
    ("four_rooms", include_str!("../../scenarios/four_rooms.toml")),
    ("two_rooms", TWO_ROOMS),
    ("plain", include_str!("../../scenarios/plain.toml")),
    ("doors", include_str!("../../scenarios/doors.toml")),
    ("apartment", include_str!("../../scenarios/apartment.toml")),
    ("office", include_str!("../../scenarios/office.toml")),
];

/// What the thesis gave its robot near walls (§5.3): −1 within 0.5 m.
fn thesis_rewards(tasks: usize) -> Vec<String> {
    let of_task = |task| [format!("task.{task}.wall_reward=-1"), format!("task.{task}.wall_distance=0.5")];
    (0..tasks).flat_map(of_task).collect()
}

/// Frames of the thesis's video, at about one a second (§5.2).
pub const FRAMES: usize = 35_128;
/// Transitions of the thesis's training set (§5.3).
pub const TRANSITIONS: usize = 11_656;
/// Those of them that are moves; the others are 3091 turns and their mirror images.
const MOVES: usize = 5474;
/// Frames after which a rendering asks whether it is to go on.
const PATIENCE: usize = 500;

/// The lab's task in the centre: its number and its name.
pub const CENTRE: (usize, &str) = (0, "centre");

/// The lab, and a seed.
pub struct Lab {
    /// The scenario, with one frame per action: the thesis's video had about one frame a second.
    pub scenario: Arc<Scenario>,
    /// Its world.
    pub world: Arc<World>,
}

impl Lab {
    /// The lab with the thesis's rewards and some keys changed.
    ///
    /// # Errors
    /// Keys that the scenario does not have, or values that it does not allow.
    pub fn new(seed: u64, sets: &[&str]) -> Result<Self, ExperimentError> {
        Lab::of(LAB, "lab.toml", seed, thesis_rewards(2), sets)
    }

    /// The lab with five goals and the thesis's rewards, with some keys changed.
    pub fn goals(seed: u64, sets: &[&str]) -> Result<Self, ExperimentError> {
        Lab::of(GOALS, "goals.toml", seed, thesis_rewards(5), sets)
    }

    /// The thesis's two-room environment, with some keys changed.
    pub fn two_rooms(seed: u64, sets: &[&str]) -> Result<Self, ExperimentError> {
        Lab::of(TWO_ROOMS, "two_rooms.toml", seed, Vec::new(), sets)
    }

    /// One of [`WORLDS`] by its place there, with its own rewards, with some keys changed.
    pub fn world(place: usize, seed: u64, sets: &[String]) -> Result<Self, ExperimentError> {
        let (name, text) = WORLDS[place];
        let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
        Lab::of(text, &format!("{name}.toml"), seed, Vec::new(), &sets)
    }

    /// The same as the agent drives in it, with the scenario's frames for each action.
    pub fn driven(place: usize, seed: u64, sets: &[String]) -> Result<Self, ExperimentError> {
        let (name, text) = WORLDS[place];
        let fixed = [format!("seed={seed}"), "camera.detail=vision".into()];
        Lab::parse(text, &format!("{name}.toml"), &[&fixed, sets].concat())
    }

    /// [`world`](Lab::world) behind the day on which one of its walls was papered anew; each seed has a paper of its own.
    pub fn repapered(place: usize, seed: u64, wall: usize, sets: &[String]) -> Result<Self, ExperimentError> {
        let mut scenario = Scenario::clone(&Lab::world(place, seed, sets)?.scenario);
        let (name, text) = WORLDS[place];
        let text = format!("{text}\n[[change]]\nkind = \"wall\"\nwall = {wall}\n");
        let changing = Scenario::parse(&text, Path::new(name), &[])?;
        for change in changing.changes {
            if let ChangeKind::Texture { wall, mut texture } = change.what {
                texture.seed += seed << u32::BITS;
                scenario.world.walls[wall].texture = texture;
            }
        }
        let world = Arc::new(World::new(&scenario)?);
        Ok(Lab { scenario: Arc::new(scenario), world })
    }

    fn of(text: &str, name: &str, seed: u64, rewards: Vec<String>, sets: &[&str]) -> Result<Self, ExperimentError> {
        let fixed = [format!("seed={seed}"), "robot.frames_per_action=1".into(), "camera.detail=vision".into()];
        let sets: Vec<String> =
            fixed.into_iter().chain(rewards).chain(sets.iter().map(|&set| set.to_owned())).collect();
        Lab::parse(text, name, &sets)
    }

    fn parse(text: &str, name: &str, sets: &[String]) -> Result<Self, ExperimentError> {
        let mut scenario = Scenario::parse(text, Path::new(name), sets)?;
        // Figures must not depend on which renderer was faster.
        scenario.world.renderer = Renderer::Cpu;
        let world = Arc::new(World::new(&scenario)?);
        Ok(Lab { scenario: Arc::new(scenario), world })
    }

    /// A task of the scenario.
    pub fn task(&self, task: usize) -> &Task {
        &self.scenario.tasks[task]
    }

    /// Centre of a task's goal area.
    pub fn goal(&self, task: usize) -> Point2<f64> {
        // The goals of experiments are areas.
        Point2::from(self.task(task).goal.unwrap_or([f64::NAN; 2]))
    }

    /// Some starts for each task, by the scenario's seed.
    pub fn evaluator(&self, starts: usize) -> Evaluator {
        Evaluator::new(self.scenario.clone(), self.world.clone(), starts, self.scenario.seed)
    }

    /// A random walk of some actions from the scenario's start.
    pub fn walk(&self, actions: usize) -> Walked {
        let (scenario, seed) = (&self.scenario, self.scenario.seed);
        let start = Pose::new(Point2::from(scenario.robot.start), scenario.robot.start_heading_deg.to_radians());
        let mut robot = Robot::new(&scenario.robot, start, stream(seed, "motion"));
        let mut walk = Walk::new(scenario, stream(seed, "explore"));
        let reflexes = Reflexes::new(scenario);
        let mut walked = Walked {
            poses: vec![robot.pose],
            odometry: vec![robot.odometry],
            actions: Vec::new(),
            blocked: Vec::new(),
        };
        let mut recent = Recent::default();
        for _ in 0..actions {
            let sonar = robot.sonar(&self.world.arena);
            let action = walk.choose(&sonar, reflexes, recent);
            let motion = robot.draw(action);
            let blocked = robot.drive(motion, &self.world.arena);
            recent = recent.then(action, blocked, &scenario.robot.actions);
            walked.poses.push(robot.pose);
            walked.odometry.push(robot.odometry);
            walked.actions.push(action);
            walked.blocked.push(blocked);
        }
        walked
    }

    /// What the camera sees along a way, one observation a column: `d × n`, in whole numbers around zero.
    pub fn video(&self, poses: &[Pose], bench: &Bench<'_>) -> Result<Mat<f32>, ExperimentError> {
        let scenario = &self.scenario;
        let noise = stream(scenario.seed, "camera");
        let mut sensor = Sensor::new(scenario, scenario.robot.frame_seconds(), noise);
        self.seen(poses, Some(&mut sensor), bench)
    }

    /// What a camera without noise and drift sees, `d × n`: for test maps.
    pub fn views(&self, poses: &[Pose], bench: &Bench<'_>) -> Result<Mat<f32>, ExperimentError> {
        self.seen(poses, None, bench)
    }

    fn seen(
        &self,
        poses: &[Pose],
        mut sensor: Option<&mut Sensor>,
        bench: &Bench<'_>,
    ) -> Result<Mat<f32>, ExperimentError> {
        let vision = &self.scenario.vision;
        let mut frames = Mat::zeros(3 * vision.width * vision.height, poses.len());
        let (mut image, mut observer, mut pixels) = (Image::default(), Observer::default(), Vec::new());
        for (j, pose) in poses.iter().enumerate() {
            if j.is_multiple_of(PATIENCE) {
                bench.go_on()?;
            }
            self.world.appearance.camera(0).render_into(pose, &mut image);
            if let Some(sensor) = &mut sensor {
                sensor.expose(&mut image, 1.0);
            }
            observer.observe(&image, vision, &mut pixels);
            for (entry, &pixel) in frames.col_mut(j).iter_mut().zip(&pixels) {
                *entry = f32::from(i16::from(pixel) - i16::from(ZERO));
            }
        }
        Ok(frames)
    }

    /// The places that the robot can be at, and its heading, as the axes of theory.
    pub fn axes(&self) -> Result<[Axis; 3], TheoryError> {
        let (low, high) = self.world.plan.reachable_box();
        Ok([
            Axis::free(low.x, high.x)?,
            Axis::free(low.y, high.y)?,
            Axis::cyclic(-std::f64::consts::PI, std::f64::consts::PI)?,
        ])
    }

    /// Height of the box around these places by its width.
    pub fn aspect(&self) -> f64 {
        let (low, high) = self.world.plan.reachable_box();
        (high.y - low.y) / (high.x - low.x)
    }

    /// The `k` slowest optimal responses of the lab for the speeds of some steps, where derivatives of moves weigh `move_weight`
    /// times those of turns.
    ///
    /// # Errors
    /// Steps that never move or never turn.
    pub fn optimal_responses(
        &self,
        steps: &Steps,
        move_weight: f64,
        k: usize,
    ) -> Result<OptimalResponses, TheoryError> {
        let (speed, turn) = steps.speeds(move_weight, self.scenario.robot.action_seconds);
        OptimalResponses::slowest(&self.axes()?, &plane_motion(speed, turn), k)
    }

    /// The weight of moves at which two half waves along x (φ200) are as slow as one turn of the heading (φ001).
    ///
    /// In the thesis's video they were, since its second and third feature mixed the two (§5.2.2). A random walk of the three
    /// actions turns more: without weights, its slow features hardly know the heading.
    pub fn thesis_weight(&self, steps: &Steps) -> f64 {
        let (low, high) = self.world.plan.reachable_box();
        // κ²⟨ẋ²⟩ with κ = 2π/L and ⟨ẋ²⟩ = ⟨v²⟩/2.
        let along = 0.5 * (std::f64::consts::TAU / (high.x - low.x)).powi(2) * steps.way;
        steps.turned / (along - steps.drift).max(f64::MIN_POSITIVE)
    }

    /// What joins two frames that are one action apart; derivatives of moves weigh `move_weight`, those of turns 1.
    pub fn link(&self, action: Action, move_weight: f64) -> Option<Link> {
        let weight = if action == Action::FORWARD { move_weight } else { 1.0 };
        Some(Link { dt: self.scenario.robot.action_seconds, weight })
    }

    /// [Links](Lab::link) of a walk's frames.
    pub fn links(&self, walked: &Walked, move_weight: f64) -> Vec<Option<Link>> {
        let links = walked.actions.iter().map(|&action| self.link(action, move_weight));
        std::iter::once(None).chain(links).collect()
    }

    /// Rewards of a task for some transitions between poses.
    pub fn rewards(&self, task: usize, poses: &[Pose], transitions: &[Transition]) -> Vec<f64> {
        transitions.iter().map(|t| self.world.plan.reward(self.task(task), poses[t.to].position)).collect()
    }
}

/// How far actions led: sums over them, from which speeds follow.
#[derive(Debug, Clone, Copy, Default)]
pub struct Steps {
    /// Actions that drive ahead, and others.
    moves: usize,
    turns: usize,
    /// Squared way of all moves, m².
    way: f64,
    /// Squared change of the heading during moves and during turns, rad².
    drift: f64,
    turned: f64,
}

impl Steps {
    /// Sums over actions, each with the poses before and after it.
    pub fn of<'a>(actions: impl Iterator<Item = (&'a Pose, &'a Pose, Action)>) -> Self {
        actions.fold(Steps::default(), |mut sums, (from, to, action)| {
            let turn = wrap(to.heading - from.heading).powi(2);
            if action == Action::FORWARD {
                sums.moves += 1;
                sums.way += (to.position - from.position).norm_squared();
                sums.drift += turn;
            } else {
                sums.turns += 1;
                sums.turned += turn;
            }
            sums
        })
    }

    /// Mean squares of speed and turn, m²/s² and rad²/s², of actions that take so many seconds, where moves weigh `move_weight`
    /// times as much as turns: what slowness in theory depends on.
    pub fn speeds(&self, move_weight: f64, seconds: f64) -> (f64, f64) {
        let weight = (move_weight * self.moves as f64 + self.turns as f64) * seconds.powi(2);
        (move_weight * self.way / weight, (move_weight * self.drift + self.turned) / weight)
    }
}

/// A random walk: poses, and what led from each to the next.
#[derive(Debug, Clone)]
pub struct Walked {
    /// One more than actions.
    pub poses: Vec<Pose>,
    /// Where the wheels say that it was at each of them.
    pub odometry: Vec<Pose>,
    /// The actions.
    pub actions: Vec<Action>,
    /// Whether a wall stopped each.
    pub blocked: Vec<bool>,
}

/// An action, and the frames before and after it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Transition {
    /// Number of the frame before.
    pub from: usize,
    /// Number of the frame after.
    pub to: usize,
    /// What was done.
    pub action: Action,
    /// Whether a wall stopped it.
    pub blocked: bool,
    /// What the reflexes know of it, and of what was done before.
    pub recent: Recent,
}

impl Walked {
    /// How far its actions led.
    pub fn steps(&self) -> Steps {
        Steps::of(self.poses.windows(2).zip(&self.actions).map(|(pair, &action)| (&pair[0], &pair[1], action)))
    }

    /// Its first actions.
    pub fn first(&self, actions: usize) -> Walked {
        Walked {
            poses: self.poses[..=actions].to_vec(),
            odometry: self.odometry[..=actions].to_vec(),
            actions: self.actions[..actions].to_vec(),
            blocked: self.blocked[..actions].to_vec(),
        }
    }

    /// `count` transitions of all kinds, spread evenly over the walk.
    pub fn spread(&self, count: usize) -> Vec<Transition> {
        let all: Vec<usize> = (0..self.actions.len()).collect();
        evenly(&all, count).into_iter().map(|t| self.transition(t)).collect()
    }

    /// About `count` transitions as the thesis took them out of its video (§5.3): moves that went their way, none that a wall
    /// stopped, and turns, each also the other way round; in the thesis's proportion, in the order of their time.
    pub fn as_in_the_thesis(&self, count: usize) -> Vec<Transition> {
        let of = |wanted: &dyn Fn(Action) -> bool| -> Vec<usize> {
            (0..self.actions.len()).filter(|&t| wanted(self.actions[t]) && !self.blocked[t]).collect()
        };
        let moves = count * MOVES / TRANSITIONS;
        let mut taken = evenly(&of(&|action| action == Action::FORWARD), moves);
        taken.extend(evenly(&of(&|action| action != Action::FORWARD), (count - moves) / 2));
        taken.sort_unstable();
        let set = ActionSet::differential_drive(1.0, 1.0);
        let with_mirrored = |t: usize| {
            let there = self.transition(t);
            let back = |action| Transition {
                from: there.to,
                to: there.from,
                action,
                blocked: false,
                recent: Recent::default().then(action, false, &set),
            };
            [Some(there), set.inverse(there.action).map(back)].into_iter().flatten()
        };
        taken.into_iter().flat_map(with_mirrored).collect()
    }

    fn transition(&self, t: usize) -> Transition {
        let set = ActionSet::differential_drive(1.0, 1.0);
        // What was not blocked lets the reflexes forget what was before.
        let first = (0..t).rev().find(|&before| !self.blocked[before]).unwrap_or(t);
        let after = |recent: Recent, t: usize| recent.then(self.actions[t], self.blocked[t], &set);
        let recent = (first..=t).fold(Recent::default(), after);
        Transition { from: t, to: t + 1, action: self.actions[t], blocked: self.blocked[t], recent }
    }
}

/// `count` entries of a list, or all, spread evenly.
fn evenly(list: &[usize], count: usize) -> Vec<usize> {
    let count = count.min(list.len());
    (0..count).map(|i| list[i * list.len() / count]).collect()
}

/// Poses as points of theory, `3 × n`.
pub fn points(poses: &[Pose]) -> Mat<f64> {
    Mat::from_fn(3, poses.len(), |i, j| [poses[j].position.x, poses[j].position.y, poses[j].heading][i])
}

/// What a result depends on beside its own settings: the world, the walk and the code that makes them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Data {
    /// Hash of the complete scenario, seed included.
    pub scenario: String,
    /// Actions of the walk.
    pub actions: usize,
}

impl Data {
    /// A walk of some actions through a lab.
    pub fn new(lab: &Lab, actions: usize) -> Self {
        Data { scenario: lab.scenario.sha256(), actions }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_are_weighted_means_over_the_actions() {
        let pose = |x: f64, heading: f64| Pose::new(Point2::new(x, 0.0), heading);
        let [forward, left, _] = Action::DRIVE;
        let poses = [pose(0.0, 0.0), pose(0.3, 0.1), pose(0.3, 0.9)];
        let steps = Steps::of([(&poses[0], &poses[1], forward), (&poses[1], &poses[2], left)].into_iter());
        let (speed, turn) = steps.speeds(3.0, 2.0);
        // Of one move that weighs 3 and one turn that weighs 1, two seconds each.
        assert!((speed - 3.0 * 0.09 / 16.0).abs() < 1e-12 && (turn - (3.0 * 0.01 + 0.64) / 16.0).abs() < 1e-12);
    }

    #[test]
    fn transitions_as_in_the_thesis_are_free_moves_and_turns_both_ways() {
        let [forward, left, right] = Action::DRIVE;
        let actions = [forward, left, forward, right, forward].repeat(20);
        let blocked: Vec<bool> = (0..100).map(|t| t % 5 == 2).collect();
        let poses = vec![Pose::new(Point2::origin(), 0.0); 101];
        let walked = Walked { odometry: poses.clone(), poses, actions, blocked };
        let found = walked.as_in_the_thesis(64);
        assert_eq!(found.iter().filter(|t| t.action == forward).count(), 64 * MOVES / TRANSITIONS);
        let set = ActionSet::differential_drive(1.0, 1.0);
        let is_mirrored = |t: &Transition| {
            found.iter().any(|of| (of.from, of.to, Some(of.action)) == (t.to, t.from, set.inverse(t.action)))
        };
        assert!(found.iter().all(|t| !t.blocked && (t.action == forward || is_mirrored(t))));
        assert_eq!(found.len(), 64);
        assert_eq!(walked.spread(1000).len(), 100);
        assert_eq!(walked.spread(50).iter().filter(|t| t.blocked).count(), 10);
    }
}
