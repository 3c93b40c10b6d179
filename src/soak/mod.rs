//! Soak tests: a long run that is watched, and judged by rules.
//!
//! ```text
//!  a run ──status──▶ sampler ──samples──┐
//!    └──── evaluations (the curve) ─────┴──▶ rules ──▶ verdict, soak.json, soak.html
//! ```

mod page;
mod rules;
mod sampler;

pub use page::page;
pub use rules::{CheckedRule, check_rules};
pub use sampler::{Sample, Sampler};

use serde::Serialize;

use crate::agent::CurvePoint;

/// What a soak test came to: `soak.json`.
#[derive(Debug, Clone, Serialize)]
pub struct Soak {
    /// Name of the scenario.
    pub scenario: String,
    /// Its seed.
    pub seed: u64,
    /// Hours of driving, as the robot's clock tells them.
    pub hours: f64,
    /// Wall-clock time, seconds.
    pub seconds: f64,
    /// Whether every rule holds.
    pub passed: bool,
    /// The rules, with what was measured.
    pub rules: Vec<CheckedRule>,
    /// When what a scenario changes was changed, hours.
    pub changes: Vec<(f64, String)>,
    /// What was seen from outside, evenly over the run.
    pub samples: Vec<Sample>,
    /// What was learned, model by model, with the hour of each.
    pub curve: Vec<(f64, CurvePoint)>,
}

impl Soak {
    /// The verdict as text: each rule with what was measured.
    pub fn text(&self) -> String {
        let mut text = format!(
            "{}, seed {}: {:.1} h of driving in {:.0} s: {}\n",
            self.scenario,
            self.seed,
            self.hours,
            self.seconds,
            if self.passed { "passed" } else { "FAILED" }
        );
        for rule in &self.rules {
            let mark = if rule.holds { "holds" } else { "FAILS" };
            text += &format!("  {mark}  {}: {}\n", rule.rule, rule.measured);
        }
        text
    }
}
