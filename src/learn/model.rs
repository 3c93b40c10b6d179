//! Features and policies from the sums of all logs.

use std::sync::Arc;

use super::{Dictionary, ManyError, Setting, Sums};
use crate::agent::steps::{FitPolicies, Solve, SolveRequest, Tasks};
use crate::dictionary::Selection as _;
use crate::policy;
use crate::source::{Mark, MarkKind};

/// What was learned, and what a person should know of it.
pub struct Learned {
    /// Features and policies.
    pub learned: Arc<policy::Learned>,
    /// Doubts about rewards, and the like.
    pub notes: Vec<String>,
    /// Transitions that values were fitted on.
    pub transitions: usize,
}

/// Solve for slow features, and fit policies, as a run does.
///
/// # Errors
/// Sums that span no direction, values that cannot be fitted.
pub fn model(setting: &Setting, dictionary: &Dictionary, sums: Sums) -> Result<Learned, ManyError> {
    let scenario = &setting.scenario;
    let mut tasks = Tasks::new(scenario, setting.plan.clone());
    let mut notes = Vec::new();
    for marked in &sums.marks {
        let place = marked.place.unwrap_or([f64::NAN; 2]).into();
        let mark = [Mark { task: marked.task, kind: MarkKind::Here }];
        notes.extend(tasks.mark(&mark, &marked.observation, place).1);
    }
    let request = SolveRequest {
        asked_at: sums.end.saturating_sub(2),
        stamp_ns: 0,
        frames: sums.frames,
        sums: Some((dictionary.selection.dictionary().clone(), sums.moments)),
        window: tasks.judged(&sums.window),
        goals: tasks.centres(),
        marks: tasks.marks.clone(),
    };
    let update =
        FitPolicies::new(scenario.clone(), setting.par).step(Solve::new(&scenario.slow, setting.par).step(request));
    let learned = update.learned.map_err(ManyError::NoModel)?;
    notes.extend(update.notes);
    Ok(Learned { learned, notes, transitions: update.transitions })
}
