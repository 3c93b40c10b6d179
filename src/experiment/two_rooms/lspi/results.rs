//! Tables and plots of [`two-rooms-lspi`](super).

use std::collections::BTreeMap;

use super::{Features, Found, MORE, Policy, REGIME, ROUNDED, WORKS};
use crate::experiment::lab::Lab;
use crate::experiment::plot::{Line, chart};
use crate::experiment::quality::Quality;
use crate::experiment::trained::Iteration;
use crate::experiment::{Band, Cell, ExperimentError, Table};
use crate::report::draw::Axis;

fn band(policies: &[&Policy], of: impl Fn(&Policy) -> Option<f64>) -> Option<Band> {
    Band::of(policies.iter().filter_map(|policy| of(policy)))
}

/// Steps more than the optimum, as the mean over policies: log_γ of the convergence quality.
fn more(policies: &[&Policy], gamma: f64) -> Option<f64> {
    let mean = band(policies, |policy| Some(policy.all.quality)).map_or(0.0, |band| band.mean);
    (mean > 0.0).then(|| mean.ln() / gamma.ln())
}

/// For all features and iterations, the number of features of the best quality over all tasks.
pub fn best(found: &Found, gamma: f64) -> Table {
    let mut table = Table::new("What each kind of features reaches, both goals, at its best number of features");
    for kind in Features::ALL {
        for iteration in Iteration::ALL {
            let of = |d: usize| -> Vec<&Policy> {
                let wanted = found.iter().filter(|((k, n, _, i), _)| (*k, *n, *i) == (kind, d, iteration));
                wanted.flat_map(|(_, policies)| policies).collect()
            };
            let mut numbers: Vec<usize> = found.keys().map(|key| key.1).collect();
            numbers.sort_unstable();
            numbers.dedup();
            let quality = |d: usize| band(&of(d), |policy| Some(policy.all.quality)).map_or(0.0, |band| band.mean);
            let across = |d: usize| {
                band(&of(d), |policy| policy.across.map(|across| across.success)).map_or(0.0, |band| band.mean)
            };
            let Some(&d) = numbers.iter().max_by(|&&a, &&b| quality(a).total_cmp(&quality(b))) else { continue };
            let works = numbers.iter().copied().find(|&d| across(d) > WORKS);
            let more = more(&of(d), gamma);
            let thesis = kind == Features::Trigonometric && iteration == Iteration::Thesis;
            // Over goals and seeds together: no band.
            let mean =
                |value: &dyn Fn(&Policy) -> Option<f64>| Cell::maybe(band(&of(d), value).map(|band| band.mean), 3);
            let row = [
                ("features are", Cell::text(kind.name())),
                ("iteration", Cell::text(iteration.name())),
                ("best number", Cell::count(d)),
                ("works from", works.map_or(Cell::Empty, Cell::count)),
                ("thesis: works from", if thesis { Cell::count(REGIME) } else { Cell::Empty }),
                ("success within", mean(&|policy| policy.within.map(|within| within.success))),
                ("success across", mean(&|policy| policy.across.map(|across| across.success))),
                ("quality", mean(&|policy| Some(policy.all.quality))),
                ("more than the optimum", Cell::maybe(more, 2)),
                ("thesis: more than its reference", if thesis { Cell::text("about 4") } else { Cell::Empty }),
            ];
            table.push(row, says(kind, iteration, works, more));
        }
    }
    table
}

fn says(kind: Features, iteration: Iteration, works: Option<usize>, more: Option<f64>) -> String {
    match (kind, iteration, works) {
        (Features::Trigonometric, Iteration::Thesis, None) => "differs: with no number of features does it work".into(),
        (Features::Trigonometric, Iteration::Thesis, Some(works)) => {
            let begins = if works < REGIME { "differs: works with fewer" } else { "agrees: needs as many" };
            let steps = match more {
                Some(more) if (more - MORE).abs() <= ROUNDED => "agrees on the steps".into(),
                Some(more) => {
                    format!("differs: {:.1} steps {}", (more - MORE).abs(), if more < MORE { "fewer" } else { "more" })
                }
                None => "differs: no start arrives".into(),
            };
            format!("{begins}; {steps}")
        }
        (Features::Vision, Iteration::Thesis, None) => "agrees: no better than failing".into(),
        (Features::Vision, Iteration::Thesis, Some(_)) => "differs: it works".into(),
        _ => "not in the thesis".into(),
    }
}

pub fn table(found: &Found, lab: &Lab) -> Table {
    let mut table = Table::new("All policies");
    let gamma = lab.scenario.value.gamma;
    for (&(kind, d, task, iteration), policies) in found {
        let policies: Vec<&Policy> = policies.iter().collect();
        let settled = policies.iter().filter(|policy| policy.converged).count() as f64 / policies.len() as f64;
        let within = |of: fn(&Quality) -> Option<f64>| band(&policies, |policy| policy.within.as_ref().and_then(of));
        let across = |of: fn(&Quality) -> Option<f64>| band(&policies, |policy| policy.across.as_ref().and_then(of));
        let row = [
            ("features are", Cell::text(kind.name())),
            ("number", Cell::count(d)),
            ("goal in", Cell::text(&lab.task(task).name)),
            ("iteration", Cell::text(iteration.name())),
            ("settled", Cell::Number(settled, 2)),
            ("success within", Cell::band(within(|quality| Some(quality.success)), 3)),
            ("extra within", Cell::band(within(|quality| quality.extra), 2)),
            ("success across", Cell::band(across(|quality| Some(quality.success)), 3)),
            ("steps across", Cell::band(across(|quality| quality.steps), 1)),
            ("extra across", Cell::band(across(|quality| quality.extra), 1)),
            ("quality", Cell::band(band(&policies, |policy| Some(policy.all.quality)), 3)),
            ("more than the optimum", Cell::maybe(more(&policies, gamma), 2)),
        ];
        let says = if iteration == Iteration::Thesis && kind != Features::Optimal {
            "no number in its text"
        } else {
            "not in the thesis"
        };
        table.push(row, says);
    }
    table
}

pub fn plots(found: &Found) -> Result<Vec<(String, String)>, ExperimentError> {
    let mut plots = Vec::new();
    for (file, title, axis, of) in [
        (
            "across.svg",
            "Starts across the corridor that arrive",
            "share of starts in the other room",
            (|policy: &Policy| policy.across.map(|across| across.success)) as fn(&Policy) -> Option<f64>,
        ),
        ("quality.svg", "Convergence quality against the optimum, by number of features", "convergence quality C", {
            |policy: &Policy| Some(policy.all.quality)
        }),
    ] {
        let mut lines = Vec::new();
        for (colour, kind) in Features::ALL.into_iter().enumerate() {
            for iteration in [Iteration::Thesis, Iteration::Ours] {
                let mut points: BTreeMap<usize, Vec<&Policy>> = BTreeMap::new();
                let wanted = found.iter().filter(|((k, _, _, i), _)| (*k, *i) == (kind, iteration));
                wanted.for_each(|((_, d, ..), policies)| points.entry(*d).or_default().extend(policies));
                let short = if iteration == Iteration::Thesis { "thesis's LSPI" } else { "ours" };
                let points = points.into_iter().map(|(d, policies)| (d as f64, band(&policies, of)));
                let line = Line::new(format!("{}, {short}", kind.name()), colour, points);
                lines.push(if iteration == Iteration::Thesis { line.dashed() } else { line });
            }
        }
        let (x, y) = (Axis::log("features d"), Axis::new(axis).within(0.0, 1.0));
        plots.push(chart(file, title, (&x, &y), &lines)?);
    }
    Ok(plots)
}
