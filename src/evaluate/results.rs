//! What trials came to.

use serde::Serialize;

/// Results of one task, as in `report.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TaskResult {
    /// The task's name.
    pub name: String,
    /// Number of trials.
    pub starts: usize,
    /// Share of trials that arrived.
    pub success: f64,
    /// Lower end of its 95 % Wilson interval.
    pub success_wilson_low: f64,
    /// Steps of the trials that arrived, mean; `None` if none did.
    pub mean_steps: Option<f64>,
    /// Steps that the policy expected at the starts of the trials that arrived, by its values, mean; `None` where values do not tell it.
    pub expected_steps: Option<f64>,
    /// Optimal steps from the same starts, mean.
    pub optimal_mean_steps: f64,
    /// Steps beyond the optimal ones, mean over the trials that arrived.
    pub extra_steps: Option<f64>,
    /// Mean of γ^(steps − optimal steps), where trials that failed count 0.
    pub convergence_quality: f64,
    /// Share of trials in which the thesis's reference policy arrives from the same starts.
    pub reference_success: f64,
    /// Sequences left–right–left–right (or the reverse) per 1000 actions.
    pub dithers_per_1000: f64,
    /// The same starts without reflexes, with the same weights, which count on the reflexes.
    pub without_reflexes: Option<WithoutReflexes>,
    /// Of a goal that was shown: how well the agent knows that it is there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub arrival: Option<Arrival>,
    /// Where something is to be avoided: how often that was entered.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub avoided: Option<Avoided>,
}

/// How often the robot entered what is to be avoided, on the way to a task's goal.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Avoided {
    /// Actions that led from outside into such an area, or across it, in all trials that begin at least half a move away from it.
    pub entries: usize,
    /// The same of values that were fitted on the same features as if nothing was to be avoided, from the same starts; `None` if
    /// that was not tried.
    pub entries_without: Option<usize>,
    /// Steps of the trials that arrived over those of the shortest way around, mean of the ratio; `None` if none arrived.
    pub detour: Option<f64>,
}

/// What came of trials in which the agent itself says that it has arrived, and ends them with that.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Arrival {
    /// Trials that the agent ended so.
    pub declared: usize,
    /// Share of all trials that ended so truly at the goal: within the task's radius of the shown place.
    pub true_rate: f64,
    /// Share of those that ended so elsewhere.
    pub false_rate: f64,
    /// Distance from the shown place where they ended, median, metres; `None` if none did.
    pub distance_p50_m: Option<f64>,
    /// The same for 99 of 100.
    pub distance_p99_m: Option<f64>,
    /// Mean of γ^(steps − optimal steps to the radius), where all but true arrivals count 0.
    pub quality: f64,
}

/// What the policy reaches without reflexes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WithoutReflexes {
    /// Share of trials that arrived.
    pub success: f64,
    /// Steps of the trials that arrived, mean.
    pub mean_steps: Option<f64>,
    /// Mean of γ^(steps − optimal steps), where trials that failed count 0.
    pub convergence_quality: f64,
    /// Sequences left–right–left–right per 1000 actions.
    pub dithers_per_1000: f64,
}
