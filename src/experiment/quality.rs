//! How good a policy's trips are: against the optimum, and against the thesis's reference policy.

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::lab::Lab;
use crate::evaluate::{Evaluator, Trip, reference_action};
use crate::policy::{Learned, Reflexes};
use crate::robot::{Action, ActionValues, Pose};

/// What the trips of a policy came to.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Quality {
    /// Share of starts from which it arrived.
    pub success: f64,
    /// Steps of those, mean.
    pub steps: Option<f64>,
    /// Steps beyond the optimum, mean over those.
    pub extra: Option<f64>,
    /// Convergence quality against the optimum: mean of γ^(steps − optimal steps), 0 where it did not arrive.
    pub quality: f64,
    /// The thesis's convergence quality, against the reference policy, over starts from which that arrives. It can be above 1:
    /// the reference policy is not the best one.
    pub to_reference: f64,
    /// `log_γ` of that: about the steps more than the reference policy; `None` if no trip arrived.
    pub more_than_reference: Option<f64>,
}

/// Random starts in a lab, for each of its tasks, and how far the reference policy gets from them.
pub struct Trials<'a> {
    /// The lab.
    pub lab: &'a Lab,
    /// What drives from the starts.
    pub evaluator: Evaluator,
    /// Trips of the reference policy, by task.
    pub reference: Vec<Vec<Trip>>,
}

impl<'a> Trials<'a> {
    /// Some starts for each task.
    pub fn new(lab: &'a Lab, starts: usize) -> Self {
        Trials::against(lab, starts, reference_action)
    }

    /// The same with another reference policy: what it does at a pose for a goal.
    pub fn against(lab: &'a Lab, starts: usize, policy: impl Fn(&Pose, Point2<f64>) -> Action + Sync) -> Self {
        let evaluator = lab.evaluator(starts);
        let of_task = |task: usize| {
            let goal = lab.goal(task);
            evaluator.trips(task, false, &|situation| policy(situation.pose, goal))
        };
        let reference = (0..lab.scenario.tasks.len()).map(of_task).collect();
        Trials { lab, evaluator, reference }
    }

    /// What the trips of a task come to.
    pub fn quality(&self, task: usize, trips: &[Trip]) -> Quality {
        Quality::of(trips, &self.reference[task], self.lab.scenario.value.gamma)
    }
}

/// Ways of a learned policy that sees the camera's images, from an evaluator's starts for a task, by one of its policies.
pub fn driven(evaluator: &Evaluator, task: usize, learned: &Learned, policy: usize, reflexes: Reflexes) -> Vec<Trip> {
    evaluator.trips(task, true, &|situation| {
        // These trips have a camera.
        let none = ActionValues::new([]);
        let values = situation.seen.map_or(none, |seen| learned.q_values(seen, policy));
        reflexes.best(&values, situation.recent).0
    })
}

impl Quality {
    /// Of trips from the same starts as those of the reference policy.
    pub fn of(trips: &[Trip], reference: &[Trip], gamma: f64) -> Self {
        let n = trips.len() as f64;
        let arrived: Vec<&Trip> = trips.iter().filter(|trip| trip.arrived).collect();
        let mean = |values: Vec<f64>| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
        let extra = |trip: &Trip| Some(trip.steps() as f64 - trip.optimal? as f64);
        let share = |trip: &&Trip| gamma.powi(trip.steps().saturating_sub(trip.optimal.unwrap_or(0)) as i32);
        let against = |(trip, reference): (&Trip, &Trip)| {
            let ratio = gamma.powi(trip.steps() as i32 - reference.steps() as i32);
            reference.arrived.then_some(if trip.arrived { ratio } else { 0.0 })
        };
        let to_reference = mean(trips.iter().zip(reference).filter_map(against).collect()).unwrap_or(0.0);
        Quality {
            success: arrived.len() as f64 / n,
            steps: mean(arrived.iter().map(|trip| trip.steps() as f64).collect()),
            extra: mean(arrived.iter().filter_map(|trip| extra(trip)).collect()),
            // Not `sum`: that of nothing is −0.
            quality: arrived.iter().map(share).fold(0.0, |sum, share| sum + share) / n,
            to_reference,
            more_than_reference: (to_reference > 0.0).then(|| to_reference.ln() / gamma.ln()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trip(steps: usize, arrived: bool, optimal: usize) -> Trip {
        Trip {
            poses: vec![Pose::new(Point2::origin(), 0.0); steps + 1],
            arrived,
            declared_at: None,
            optimal: Some(optimal),
        }
    }

    #[test]
    fn qualities_are_those_of_the_definition() {
        let trips = [trip(5, true, 4), trip(100, false, 3), trip(2, true, 3)];
        let reference = [trip(6, true, 4), trip(4, true, 3), trip(100, false, 3)];
        let found = Quality::of(&trips, &reference, 0.9);
        assert!((found.success - 2.0 / 3.0).abs() < 1e-12);
        assert_eq!((found.steps, found.extra), (Some(3.5), Some(0.0)));
        // Noise can make a trip shorter than the optimum: that counts as optimal.
        assert!((found.quality - (0.9 + 1.0) / 3.0).abs() < 1e-12);
        // The third start is left out, since the reference policy does not arrive from it.
        let expected: f64 = (0.9f64.powi(-1) + 0.0) / 2.0;
        assert!((found.to_reference - expected).abs() < 1e-12);
        assert!((found.more_than_reference.unwrap() - expected.ln() / 0.9f64.ln()).abs() < 1e-12);
        assert_eq!(Quality::of(&[trip(9, false, 1)], &[trip(1, true, 1)], 0.9).more_than_reference, None);
    }
}
