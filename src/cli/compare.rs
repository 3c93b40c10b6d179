//! `adagio compare RUN RUN`

use std::fmt::Write as _;
use std::path::Path;

use super::{CompareArgs, Ending, print, print_json};
use crate::replay::{self, Comparison, Recording};
use crate::report::Numbered;

/// Say in what two runs differ: settings, models, policies.
pub fn compare(args: &CompareArgs) -> Ending {
    let (a, b) = match (Recording::open(&args.a), Recording::open(&args.b)) {
        (Ok(a), Ok(b)) => (a, b),
        (Err(error), _) | (_, Err(error)) => return Ending::failed(error),
    };
    match replay::compare(&a, &b) {
        Err(error) => Ending::failed(error),
        Ok(comparison) if args.json => print_json(&comparison),
        Ok(comparison) => print(&text(&comparison, [&args.a, &args.b].map(|run| report(run)))),
    }
}

/// What the report of a run says of its tasks, if there is a report.
fn report(run: &Path) -> Option<serde_json::Value> {
    serde_json::from_str(&std::fs::read_to_string(run.join("report.json")).ok()?).ok()
}

fn text(c: &Comparison, reports: [Option<serde_json::Value>; 2]) -> String {
    let mut out = String::new();
    let mut line = |text: String| {
        let _ = writeln!(out, "{text}");
    };
    if c.settings.is_empty() {
        line("settings: the same".into());
    } else {
        line("settings that differ:".into());
        let width = c.settings.keys().map(String::len).max().unwrap_or(0);
        for (key, (a, b)) in &c.settings {
            let shown = |value: &str| if value.is_empty() { "-".to_owned() } else { value.to_owned() };
            line(format!("  {key:<width$}  {}  →  {}", shown(a), shown(b)));
        }
    }
    let by = reports.each_ref().map(|report| {
        let of = |report: &serde_json::Value| report["computed_by"]["pictures"]["gpu"].as_str().map(str::to_owned);
        report.as_ref().and_then(of).unwrap_or_else(|| "the processor".into())
    });
    if by[0] != by[1] {
        line(format!("pictures by {} and by {}: what was seen and reached in them can only be close", by[0], by[1]));
    }
    line(format!(
        "frames: {} and {}; models: {} and {}",
        Numbered(c.frames.0),
        Numbered(c.frames.1),
        c.models.0,
        c.models.1
    ));
    match (c.first_model_that_differs, &c.first_policy_that_differs) {
        (None, None) => line(format!("all {} common models and their policies are equal, bit for bit", c.epochs.len())),
        (None, Some((epoch, task))) => {
            line(format!("models are equal; first policy that differs: {task} of model {epoch}"))
        }
        (Some(epoch), _) => line(format!("first model that differs: {epoch}")),
    }
    if c.first_model_that_differs.is_some() {
        line(format!(
            "{:>7} {:>23} {:>17} {:>21}",
            "model", "asked for at frame", "support vectors", "mean slowness, 1/s²"
        ));
        for e in &c.epochs {
            line(format!(
                "{:>7} {:>11} {:>11} {:>8} {:>8} {:>10.4} {:>10.4}{}",
                e.epoch,
                e.asked_at.0,
                e.asked_at.1,
                e.support_vectors.0,
                e.support_vectors.1,
                e.slowness.0,
                e.slowness.1,
                if e.equal { "  equal" } else { "" }
            ));
        }
    }
    if let [Some(a), Some(b)] = reports {
        for (of_a, of_b) in a["tasks"].as_array().into_iter().flatten().zip(b["tasks"].as_array().into_iter().flatten())
        {
            let share = |task: &serde_json::Value, key: &str| task[key].as_f64().unwrap_or(f64::NAN);
            line(format!(
                "{}: success {:.1} % → {:.1} %, convergence quality {:.3} → {:.3}",
                of_a["name"].as_str().unwrap_or("?"),
                100.0 * share(of_a, "success"),
                100.0 * share(of_b, "success"),
                share(of_a, "convergence_quality"),
                share(of_b, "convergence_quality")
            ));
        }
    }
    out
}
