//! `adagio compare RUN RUN`

use std::fmt::Write as _;

use serde::Serialize;
use serde_json::Value;

use super::{CompareArgs, Ending, folder, print, print_json};
use crate::replay::{self, Comparison, Observations, Recording};
use crate::report::Numbered;

/// What `--json` prints.
#[derive(Serialize)]
struct Compared<'a> {
    #[serde(flatten)]
    comparison: &'a Comparison,
    /// Who computed each of them, as in `report.json`; null where there is no report.
    computed_by: [&'a Value; 2],
}

/// Say in what two runs differ: settings, observations, models, policies.
pub fn compare(args: &CompareArgs) -> Result<(), Ending> {
    let (a, b) = (Recording::open(&args.a)?, Recording::open(&args.b)?);
    let comparison = replay::compare(&a, &b)?;
    let reports = [&args.a, &args.b].map(|run| folder::report(run).unwrap_or_default());
    if args.json {
        let computed_by = reports.each_ref().map(|report| &report["computed_by"]);
        return print_json(&Compared { comparison: &comparison, computed_by });
    }
    print(&text(&comparison, &reports))
}

/// How close two runs' observations are.
fn closeness(seen: &Observations) -> String {
    let common = Numbered(seen.frames);
    let course = match (seen.frames, seen.parted_at) {
        (0, Some(frame)) => return format!("observations: none to compare, the runs part at frame {frame}"),
        (0, None) => return "observations: no frame is in both runs".into(),
        (_, Some(frame)) => format!("the common frames ({common}), before the runs part at frame {}", Numbered(frame)),
        (_, None) => format!("all common frames ({common})"),
    };
    let Some(first) = seen.first_that_differs else { return format!("observations: the same in {course}") };
    let share = match seen.share {
        0.0 => "no value differs by more than a grey level".to_owned(),
        share => format!("{share:.1e} of the values differ by more than a grey level, by {} at most", seen.largest),
    };
    format!("observations in {course}: {share}; the first difference is in frame {}", Numbered(first))
}

fn text(c: &Comparison, reports: &[Value; 2]) -> String {
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
    let by =
        reports.each_ref().map(|report| report["computed_by"]["pictures"]["gpu"].as_str().unwrap_or("the processor"));
    if reports.iter().all(|report| !report.is_null()) && by[0] != by[1] {
        line(format!("pictures by {} and by {}: what was seen and reached in them can only be close", by[0], by[1]));
    }
    line(c.observations.as_ref().map_or_else(
        || "observations: not comparable, of other sizes or of a scenario that this version cannot read".into(),
        closeness,
    ));
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
    let [a, b] = reports.each_ref().map(|report| report["tasks"].as_array().into_iter().flatten());
    for of_a in a {
        let Some(of_b) = b.clone().find(|of_b| of_b["name"] == of_a["name"]) else { continue };
        let share = |task: &Value, key: &str| task[key].as_f64().unwrap_or(f64::NAN);
        line(format!(
            "{}: success {:.1} % → {:.1} %, convergence quality {:.3} → {:.3}",
            of_a["name"].as_str().unwrap_or("?"),
            100.0 * share(of_a, "success"),
            100.0 * share(of_b, "success"),
            share(of_a, "convergence_quality"),
            share(of_b, "convergence_quality")
        ));
    }
    out
}
