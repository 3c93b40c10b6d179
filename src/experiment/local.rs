//! Local values from the transitions of a walk, over slow features or over the true pose.

use std::sync::Arc;

use faer::Mat;

use super::lab::{Lab, Transition, Walked};
use super::trained::Trained;
use super::{Bench, ExperimentError};
use crate::evaluate::{Evaluator, Situation, Trip};
use crate::policy::{Learned, Reflexes, points};
use crate::robot::{Action, Pose};
use crate::value::{Instances, Local, LocalOptions, LocalOutcomes};

/// What a radian of the heading is beside a metre, for distances between true poses.
pub const METRES_PER_RADIAN: f64 = 0.5;

/// How values are made.
#[derive(Debug, Clone, Copy)]
pub struct Rule {
    /// Ridge on the slopes of the regressions.
    pub ridge: f64,
    /// Whether rewards near walls count.
    pub walls: bool,
    /// Whether they take at most half of what follows, as in the agent.
    pub bounded: bool,
}

/// Values of all tasks of a world, with the scenario's neighbours and discount: where actions were tried, and what each transition is
/// worth for each task, `N × 1`. `at` gives the points of frames, `p × n`.
fn values(
    lab: &Lab,
    walked: &Walked,
    mut transitions: Vec<Transition>,
    rule: Rule,
    at: impl Fn(&[usize]) -> Result<Mat<f32>, ExperimentError>,
) -> Result<(Arc<Instances>, Vec<Mat<f64>>), ExperimentError> {
    let settings = &lab.scenario.value;
    let reflexes = Reflexes::new(&lab.scenario);
    transitions.sort_by_key(|t| t.action.index());
    let points = |frame: fn(&Transition) -> usize| at(&transitions.iter().map(frame).collect::<Vec<usize>>());
    let counts =
        Action::DRIVE.iter().map(|action| transitions.iter().filter(|t| t.action == *action).count()).collect();
    let options = LocalOptions { neighbours: settings.neighbours, ridge: rule.ridge };
    let instances = Arc::new(Instances::new(points(|t| t.from)?, counts, options)?);
    let local = Local::new(&instances, points(|t| t.to)?.as_ref())?;
    let allowed: Vec<u32> = transitions.iter().map(|t| reflexes.allowed(t.recent)).collect();
    let (ended, bounded) = (vec![false; transitions.len()], vec![rule.bounded; transitions.len()]);
    let worth = |task: usize| {
        let mut rewards = lab.rewards(task, &walked.poses, &transitions);
        if !rule.walls {
            rewards.iter_mut().for_each(|reward| *reward = reward.max(0.0));
        }
        let outcomes = LocalOutcomes { rewards: &rewards, allowed: &allowed, ended: &ended, bounded: &bounded };
        Ok(local.fit(&outcomes, settings.gamma)?.weights)
    };
    let worths = (0..lab.scenario.tasks.len()).map(worth).collect::<Result<_, ExperimentError>>()?;
    Ok((instances, worths))
}

/// Local values in the metric of the slowest features of a walk.
pub fn of_features(
    trained: &Trained<'_>,
    transitions: Vec<Transition>,
    rule: Rule,
    bench: &Bench<'_>,
) -> Result<Learned, ExperimentError> {
    let features = trained.lab.scenario.value.metric_features;
    let at = |frames: &[usize]| {
        let phi = trained.features_at(frames, bench)?;
        Ok(points(&trained.model, phi.as_ref(), features))
    };
    let (instances, worths) = values(trained.lab, &trained.walked, transitions, rule, at)?;
    Ok(Learned::local(1, 0, 0, trained.model.clone(), instances, worths, None)?)
}

/// Policies of the true pose, with our reflexes.
pub struct PosePolicies {
    instances: Arc<Instances>,
    worths: Vec<Mat<f64>>,
    reflexes: Reflexes,
}

/// Local values over the true pose.
pub fn of_pose(lab: &Lab, walked: &Walked, transitions: Vec<Transition>) -> Result<PosePolicies, ExperimentError> {
    let rule = Rule { ridge: lab.scenario.value.local_ridge, walls: true, bounded: true };
    let at = |frames: &[usize]| {
        let points: Vec<[f32; 4]> = frames.iter().map(|&frame| point(&walked.poses[frame])).collect();
        Ok(Mat::from_fn(4, points.len(), |i, j| points[j][i]))
    };
    let (instances, worths) = values(lab, walked, transitions, rule, at)?;
    Ok(PosePolicies { instances, worths, reflexes: Reflexes::new(&lab.scenario) })
}

impl PosePolicies {
    /// Ways from the starts of a task.
    pub fn trips(&self, evaluator: &Evaluator, task: usize) -> Vec<Trip> {
        let worth: Vec<f64> = self.worths[task].col(0).iter().copied().collect();
        let choose = |situation: &Situation<'_>| {
            let point = point(situation.pose);
            let point = Mat::from_fn(4, 1, |i, _| point[i]);
            // A pose is finite, and so are the values then.
            let told = self.instances.action_values(&[&worth], point.as_ref()).unwrap_or_default();
            let values = told.first().map_or([0.0; 3], |q| [q[(0, 0)], q[(1, 0)], q[(2, 0)]]);
            self.reflexes.best(&values, situation.recent).0
        };
        evaluator.trips(task, false, &choose)
    }
}

/// A pose as a point.
fn point(pose: &Pose) -> [f32; 4] {
    let (place, ahead) = (pose.position, METRES_PER_RADIAN * pose.direction());
    [place.x as f32, place.y as f32, ahead.x as f32, ahead.y as f32]
}
