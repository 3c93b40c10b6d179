//! What the agent is compared with: each learns in a world of its own, and all are tried from the same starts.

use faer::Mat;
use nalgebra::Point2;
use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::lab::{Lab, Walked, points};
use super::quality::{Quality, Trials};
use super::trained::{Iteration, Sampled, Training, train, trips, with_one};
use super::{Bench, ExperimentError};
use super::{local, planned};
use crate::evaluate::{OptimalSteps, Situation, Trip, draw_pose};
use crate::policy::Reflexes;
use crate::random::stream;
use crate::robot::{Action, Pose};
use crate::scenario::in_goal;
use crate::slow::coherence::incremental::{IncrementalSlow, Options as IncrementalOptions};
use crate::value::{Fit, StreamQ, StreamQOptions};
use crate::vision::{Image, Observation, Observer};
use crate::world::{Robot, Sensor};

/// Stream-Q(λ): probability of a random action, at first and from the middle of the run on.
const EPSILON: (f64, f64) = (1.0, 0.1);

/// How good a policy is after some actions, mean over tasks.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub struct Point {
    /// Actions that were executed.
    pub actions: usize,
    /// Frames that were seen.
    pub frames: usize,
    /// Share of starts that arrive.
    pub success: f64,
    /// Convergence quality against the optimum.
    pub quality: f64,
}

impl Point {
    /// The means of all tasks, after so many actions with one frame for each.
    pub fn new(actions: usize, qualities: &[Quality]) -> Self {
        let mean = |of: fn(&Quality) -> f64| qualities.iter().map(of).sum::<f64>() / qualities.len().max(1) as f64;
        Point { actions, frames: actions + 1, success: mean(|q| q.success), quality: mean(|q| q.quality) }
    }
}

/// How Stream-Q(λ) is run.
pub struct StreamQRun<'a> {
    /// Numbers of actions after which its policy is tried.
    pub actions: &'a [usize],
    /// Actions of an episode at most.
    pub episode: usize,
    /// Number of features.
    pub features: usize,
}

/// The world of a seed, its walk, and the trials.
pub struct Field<'a> {
    /// The world.
    pub lab: &'a Lab,
    walked: Walked,
    /// What its camera sees.
    pub video: Mat<f32>,
    /// The starts for each task.
    pub trials: Trials<'a>,
    bench: &'a Bench<'a>,
}

impl<'a> Field<'a> {
    /// A walk of some actions through a world, and its starts for each task.
    pub fn new(lab: &'a Lab, actions: usize, starts: usize, bench: &'a Bench<'a>) -> Result<Self, ExperimentError> {
        let walked = lab.walk(actions);
        let video = lab.video(&walked.poses, bench)?;
        Ok(Field { lab, walked, video, trials: Trials::new(lab, starts), bench })
    }
}

impl Field<'_> {
    /// How good the trips of each task are.
    pub fn qualities(
        &self,
        mut trips_of: impl FnMut(usize) -> Result<Vec<Trip>, ExperimentError>,
    ) -> Result<Vec<Quality>, ExperimentError> {
        let of_task = |task: usize| {
            self.bench.go_on()?;
            Ok(self.trials.quality(task, &trips_of(task)?))
        };
        (0..self.lab.scenario.tasks.len()).map(of_task).collect()
    }

    /// The optimal numbers of steps from the same starts.
    pub fn optimum(&self) -> Result<Vec<Quality>, ExperimentError> {
        self.qualities(|task| {
            let best = |trip: &Trip| Trip {
                poses: vec![trip.poses[0]; trip.optimal.unwrap_or(0) + 1],
                arrived: trip.optimal.is_some(),
                declared_at: None,
                optimal: trip.optimal,
            };
            Ok(self.trials.reference[task].iter().map(best).collect())
        })
    }

    /// The shortest way from the true pose, looked for again after every action: what execution noise alone costs.
    pub fn replanned(&self) -> Result<Vec<Quality>, ExperimentError> {
        let (scenario, arena) = (&self.lab.scenario, &self.lab.world.arena);
        self.qualities(|task| {
            let search =
                OptimalSteps::new(arena, &scenario.robot, self.lab.task(task), &[], scenario.evaluate.max_steps);
            // From where no way is short enough any action is as good.
            let choose = |situation: &Situation<'_>| search.first(*situation.pose).unwrap_or(Action::FORWARD);
            Ok(self.trials.evaluator.trips(task, false, &choose))
        })
    }

    /// Trips of the greedy policy over features of what is seen, with our reflexes.
    fn greedy_trips(
        &self,
        task: usize,
        camera: bool,
        weights: &Mat<f64>,
        features: impl Fn(&Situation<'_>) -> Mat<f64> + Sync,
    ) -> Vec<Trip> {
        let reflexes = Reflexes::new(&self.lab.scenario);
        self.trials.evaluator.trips(task, camera, &|situation| {
            let q = weights.transpose() * features(situation);
            reflexes.best(&[q[(0, 0)], q[(1, 0)], q[(2, 0)]], situation.recent).0
        })
    }

    /// The batch pipeline on the first part of the walk, and how many support vectors it has.
    pub fn batch(
        &self,
        actions: usize,
        features: usize,
        vectors: usize,
    ) -> Result<(Vec<Quality>, usize), ExperimentError> {
        let training = Training::new(self.lab, actions, vectors, features - 1);
        let trained = train(self.lab, &training, self.bench)?;
        let sampled = Sampled::new(&trained, actions, Iteration::Thesis, self.bench)?;
        let qualities = self.qualities(|task| {
            let fit = sampled.fit(features, task, Iteration::Thesis)?;
            trips(&trained.model, &fit, (&self.trials.evaluator, task), Iteration::Thesis.reflexes(self.lab))
        })?;
        Ok((qualities, trained.model.members.ncols()))
    }

    /// Policies over optimal responses of the true pose, `f` with the constant, by our LSPI.
    ///
    /// # Errors
    /// A walk that never moves or never turns; [`ExperimentError::Stopped`].
    pub fn true_pose(&self, actions: usize, f: usize) -> Result<Vec<Quality>, ExperimentError> {
        let part = self.walked.first(actions);
        let theory = self.lab.optimal_responses(&part.steps(), self.lab.thesis_weight(&part.steps()), f - 1)?;
        let features =
            |poses: &[Pose]| with_one(&theory.evaluate(points(poses).as_ref()).expect("the robot is near the room"));
        let phi = features(&part.poses);
        let sampled = Sampled::whole(self.lab, &part, &phi);
        self.qualities(|task| {
            let Fit { weights, .. } = sampled.fit(f, task, Iteration::Ours)?;
            Ok(self.greedy_trips(task, false, &weights, |situation| features(&[*situation.pose])))
        })
    }

    /// Local values in the true pose, from the whole walk.
    pub fn true_pose_locally(&self) -> Result<Vec<Quality>, ExperimentError> {
        let transitions = self.walked.spread(self.walked.actions.len());
        let policies = local::of_pose(self.lab, &self.walked, transitions)?;
        self.qualities(|task| Ok(policies.trips(&self.trials.evaluator, task)))
    }

    /// Values that are planned on a lattice of the true poses of the whole walk, where what actions do is known.
    pub fn planned(&self) -> Result<Vec<Quality>, ExperimentError> {
        let (lab, walked) = (self.lab, &self.walked);
        let steps = planned::steps(lab, walked, &walked.poses);
        let (planner, reflexes) = (planned::planner(lab, &steps)?, Reflexes::new(&lab.scenario));
        self.qualities(|task| {
            let fit = planned::fit(lab, &planner, walked, task)?;
            let choose = |situation: &Situation<'_>| {
                let place = planned::place(lab, situation.pose);
                reflexes.best(&planned::values(lab, (&planner, &fit), place), situation.recent).0
            };
            Ok(self.trials.evaluator.trips(task, false, &choose))
        })
    }

    /// IncSFA sees the walk once; policies are made on its features of each of these moments.
    pub fn incremental(&self, actions: &[usize], (k, whitened): (usize, usize)) -> Result<Vec<Point>, ExperimentError> {
        let links = self.lab.links(&self.walked, self.lab.thesis_weight(&self.walked.steps()));
        let mut rng = stream(self.lab.scenario.seed, "incremental features");
        let options = IncrementalOptions::new(k, whitened);
        let mut learner = IncrementalSlow::new(self.video.nrows(), options, &mut rng)?;
        let (mut points, mut seen) = (Vec::new(), 0);
        for &count in actions {
            while seen <= count {
                if seen.is_multiple_of(200) {
                    self.bench.go_on()?;
                }
                let frame: Vec<f64> = self.video.col(seen).iter().map(|&value| scaled(value)).collect();
                learner.update(&frame, links[seen])?;
                seen += 1;
            }
            let map = learner.map();
            let of = |x: Mat<f64>| {
                with_one(&map.apply(x.as_ref()).expect("frames are as long as those that were learned from"))
            };
            let part = self.walked.first(count);
            let phi = of(Mat::from_fn(self.video.nrows(), count + 1, |i, j| scaled(self.video[(i, j)])));
            let sampled = Sampled::whole(self.lab, &part, &phi);
            let qualities = self.qualities(|task| {
                let Fit { weights, .. } = sampled.fit(k + 1, task, Iteration::Ours)?;
                Ok(self.greedy_trips(task, true, &weights, |situation| of(pixels(situation))))
            })?;
            points.push(Point::new(count, &qualities));
        }
        Ok(points)
    }

    /// Stream-Q(λ) drives by itself, from a new random start whenever a goal was reached or an episode is over: what its policies
    /// come to at each moment.
    pub fn stream_q(
        &self,
        run: &StreamQRun<'_>,
        features: impl Fn(Mat<f64>) -> Mat<f64> + Sync,
    ) -> Result<Vec<Vec<Quality>>, ExperimentError> {
        let scenario = &self.lab.scenario;
        let actions = run.actions;
        let most = actions.iter().copied().max().unwrap_or(1);
        let cells: Vec<Point2<f64>> = self.lab.world.plan.reachable_cells().collect();
        // Of each task, the weights at each of the moments.
        let mut weights: Vec<Vec<Mat<f64>>> = Vec::new();
        for task in &scenario.tasks {
            let named = |what: &str| stream(scenario.seed, &format!("stream-q: {what} of {}", task.name));
            let (mut explore, mut starts) = (named("choices"), named("starts"));
            let mut sensor = Sensor::new(scenario, scenario.robot.frame_seconds(), named("camera"));
            let mut values =
                StreamQ::new(run.features, 3, StreamQOptions { gamma: scenario.value.gamma, ..Default::default() })?;
            let (mut image, mut observer) = (Image::default(), Observer::default());
            let mut look = |pose: &Pose| -> Vec<f64> {
                self.lab.world.appearance.camera(0).render_into(pose, &mut image);
                sensor.expose(&mut image, 1.0);
                let mut seen = Observation { frame: 0, pixels: Vec::new() };
                observer.observe(&image, &scenario.vision, &mut seen.pixels);
                features(of_observation(&seen)).col(0).iter().copied().collect()
            };
            let mut begin = || {
                let pose = draw_pose(&self.lab.world.plan, &cells, &mut starts, |place| in_goal(task, place));
                let noise = stream(scenario.seed, &format!("stream-q: motion {}", starts.random::<u64>()));
                Robot::new(&scenario.robot, pose, noise)
            };
            let mut robot = begin();
            let mut phi = look(&robot.pose);
            let (mut left, mut taken) = (run.episode, Vec::new());
            for done in 1..=most {
                if done.is_multiple_of(100) {
                    self.bench.go_on()?;
                }
                let share = (2.0 * done as f64 / most as f64).min(1.0);
                let epsilon = EPSILON.0 + (EPSILON.1 - EPSILON.0) * share;
                let action = values.choose(&phi, epsilon, &mut explore)?;
                let motion = robot.draw(Action::DRIVE[action]);
                robot.drive(motion, &self.lab.world.arena);
                let reward = self.lab.world.plan.reward(task, robot.pose.position);
                let next = look(&robot.pose);
                let arrived = in_goal(task, robot.pose.position);
                values.learn(&phi, action, reward, (!arrived).then_some(next.as_slice()))?;
                left -= 1;
                phi = next;
                if arrived || left == 0 {
                    values.interrupt();
                    robot = begin();
                    phi = look(&robot.pose);
                    left = run.episode;
                }
                if actions.contains(&done) {
                    taken.push(values.weights().to_owned());
                }
            }
            weights.push(taken);
        }
        let at = |moment: usize| {
            self.qualities(|task| {
                let weights = &weights[task][moment];
                Ok(self.greedy_trips(task, true, weights, |situation| features(pixels(situation))))
            })
        };
        (0..actions.len()).map(at).collect()
    }

    /// Actions that have nothing to do with what is seen.
    pub fn random(&self) -> Result<Vec<Quality>, ExperimentError> {
        let seed = self.lab.scenario.seed;
        self.qualities(|task| {
            Ok(self.trials.evaluator.trips(task, false, &|Situation { pose, .. }| {
                // A choice of its own for each pose: no pose comes twice.
                let name = format!("random action at {:?}", (pose.position.x.to_bits(), pose.heading.to_bits()));
                Action::DRIVE[stream(seed, &name).random_range(0..3)]
            }))
        })
    }
}

/// Grey levels as numbers of about 1.
fn scaled(value: f32) -> f64 {
    f64::from(value) / 128.0
}

fn of_observation(seen: &Observation) -> Mat<f64> {
    let values: Vec<f64> = seen.values().map(scaled).collect();
    Mat::from_fn(values.len(), 1, |i, _| values[i])
}

/// What is seen in a trial with a camera, `d × 1`.
fn pixels(situation: &Situation<'_>) -> Mat<f64> {
    situation.seen.map_or(Mat::zeros(0, 1), of_observation)
}
