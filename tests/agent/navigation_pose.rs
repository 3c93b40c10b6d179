//! Navigation by the true pose in trigonometric features, the thesis's own yardstick (§5.3.3: with 20 to 70 of them the goal
//! in the centre takes less than one step more than the reference policy needs).

use crate::common::package_file;
use adagio::evaluate::reference_action;
use adagio::policy::{Recent, Reflexes, Walk};
use adagio::random::stream;
use adagio::robot::{Action, Pose};
use adagio::scenario::in_goal;
use adagio::scenario::{Scenario, Task};
use adagio::slow::theory::Axis;
use adagio::value::{Lspi, LspiOptions, Outcomes, Samples, Trigonometric};
use adagio::world::{Robot, World};
use faer::{Mat, Par};
use nalgebra::Point2;
use rand::RngExt;

/// The thesis's number of transitions in its lab.
const TRANSITIONS: usize = 11_656;

/// Drive one action; whether a wall stopped it.
fn execute(robot: &mut Robot, action: Action, scenario: &Scenario, world: &World) -> bool {
    let motion = robot.draw(action);
    (0..scenario.robot.frames_per_action).fold(false, |blocked, _| robot.drive(motion, &world.arena) | blocked)
}

/// States before and after each action of a random walk, the actions, and what may follow them.
struct Walked {
    poses: Vec<Pose>,
    actions: Vec<usize>,
    allowed: Vec<u32>,
}

fn walk(scenario: &Scenario, world: &World, seed: u64) -> Walked {
    let start = Pose::new(Point2::from(scenario.robot.start), 0.0);
    let mut robot = Robot::new(&scenario.robot, start, stream(seed, "motion"));
    let mut walk = Walk::new(scenario, stream(seed, "explore"));
    let reflexes = Reflexes::new(scenario);
    let mut walked = Walked { poses: vec![robot.pose], actions: vec![], allowed: vec![] };
    let mut recent = Recent::default();
    for _ in 0..TRANSITIONS {
        let sonar = robot.sonar(&world.arena);
        let action = walk.choose(&sonar, reflexes, recent);
        let blocked = execute(&mut robot, action, scenario, world);
        recent = recent.then(action, blocked, &scenario.robot.actions);
        walked.poses.push(robot.pose);
        walked.actions.push(action.index());
        let follow = Action::DRIVE.into_iter().filter(|&action| reflexes.allow(action, recent));
        walked.allowed.push(follow.fold(0, |bits, action| bits | 1 << action.index()));
    }
    walked
}

fn coordinates(poses: &[Pose]) -> Mat<f64> {
    Mat::from_fn(3, poses.len(), |i, j| [poses[j].position.x, poses[j].position.y, poses[j].heading][i])
}

/// Steps to the goal from a start, if it is reached within 100.
fn steps_to(
    task: &Task,
    start: Pose,
    seed: u64,
    (scenario, world): (&Scenario, &World),
    mut choose: impl FnMut(&Pose, Recent) -> Action,
) -> Option<usize> {
    let mut robot = Robot::new(&scenario.robot, start, stream(seed, "trial"));
    let mut recent = Recent::default();
    for step in 0..100 {
        if in_goal(task, robot.pose.position) {
            return Some(step);
        }
        let action = choose(&robot.pose, recent);
        let blocked = execute(&mut robot, action, scenario, world);
        recent = recent.then(action, blocked, &scenario.robot.actions);
    }
    None
}

#[test]
fn trigonometric_features_of_the_true_pose_match_the_reference_policy() {
    let scenario = Scenario::load(&package_file("scenarios/lab.toml"), &[]).unwrap();
    let world = World::new(&scenario).unwrap();
    let (low, high) = world.plan.reachable_box();
    let (x, y) = (Axis::free(low.x, high.x).unwrap(), Axis::free(low.y, high.y).unwrap());
    let heading = Axis::cyclic(-std::f64::consts::PI, std::f64::consts::PI).unwrap();
    let reflexes = Reflexes::new(&scenario);
    let mut rng = stream(21, "starts");
    let starts: Vec<Pose> = std::iter::repeat_with(|| {
        let place = Point2::new(rng.random_range(low.x..high.x), rng.random_range(low.y..high.y));
        Pose::new(place, rng.random_range(0.0..std::f64::consts::TAU))
    })
    .filter(|pose| world.plan.is_reachable(pose.position))
    .take(200)
    .collect();
    let basis = Trigonometric::new(&[(x, 3), (y, 3), (heading, 1)]).unwrap();
    let features = |poses: &[Pose]| basis.apply(coordinates(poses).as_ref()).unwrap();
    for seed in 1..=3 {
        let walked = walk(&scenario, &world, seed);
        let phi = features(&walked.poses);
        let (before, after) = (phi.as_ref().subcols(0, TRANSITIONS), phi.as_ref().subcols(1, TRANSITIONS));
        let weights = vec![1.0; TRANSITIONS];
        let samples = Samples { phi: before, actions: &walked.actions, weights: &weights };
        let problem = Lspi::new(samples, 3, Par::Seq).unwrap();
        for task in &scenario.tasks {
            let rewards: Vec<f64> =
                walked.poses[1..].iter().map(|pose| world.plan.reward(task, pose.position)).collect();
            let outcomes = Outcomes { next: after, rewards: &rewards, allowed: Some(&walked.allowed) };
            let options = LspiOptions { mixing: 0.3, ridge: 1e-3, ..LspiOptions::plain() };
            let fit = problem.fit(&outcomes, &options).unwrap();
            let learned = |pose: &Pose, recent: Recent| {
                let q = fit.weights.transpose() * features(&[*pose]);
                reflexes.best(&[q[(0, 0)], q[(1, 0)], q[(2, 0)]], recent).0
            };
            let goal = Point2::from(task.goal.unwrap());
            let (mut arrived, mut both, mut extra) = (0, 0, 0.0);
            for (number, &start) in starts.iter().enumerate() {
                let seed = number as u64;
                let house = (&scenario, &world);
                let found = steps_to(task, start, seed, house, learned);
                let reference = steps_to(task, start, seed, house, |pose, _| reference_action(pose, goal));
                arrived += usize::from(found.is_some());
                if let (Some(found), Some(reference)) = (found, reference) {
                    both += 1;
                    extra += found as f64 - reference as f64;
                }
            }
            let extra = extra / f64::from(both);
            println!("walk {seed}, {}: {arrived} of 200 arrive, {extra:+.2} steps", task.name);
            assert!(arrived >= 190, "{arrived} of 200 arrive");
            assert!(both > 150 && extra < 1.0, "{extra} steps more than the reference policy, over {both} starts");
        }
    }
}
