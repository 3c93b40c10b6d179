//! The page of a soak test: the verdict, then what was measured over the hours of driving.

use super::{Sample, Soak};
use crate::report::draw::{Axis, Chart, DrawError, Line, Page, SERIES, Stroke, Table};

/// The whole page, one file that needs nothing else.
///
/// # Errors
/// [`DrawError::Draw`].
pub fn page(soak: &Soak) -> Result<String, DrawError> {
    let mut page = Page::new(&format!("Soak test of {}, seed {}", soak.scenario, soak.seed));
    let (class, headline) = if soak.passed { ("good", "Passed") } else { ("bad", "Failed") };
    let failing = soak.rules.iter().filter(|rule| !rule.holds);
    let mut sentences = vec![format!("{:.1} hours of driving in {:.0} seconds.", soak.hours, soak.seconds)];
    sentences.extend(failing.map(|rule| format!("It fails: {}: {}.", rule.rule, rule.measured)));
    page.verdict(class, headline, &sentences);
    let mut table = Table::new(&["rule", "holds", "measured"]);
    for rule in &soak.rules {
        let holds = if rule.holds { "yes" } else { "NO" };
        table.row([rule.rule.clone(), holds.to_owned(), rule.measured.clone()]);
    }
    page.table(&table);

    page.section("learned", "What was learned");
    if !soak.changes.is_empty() {
        let changes: Vec<String> = soak.changes.iter().map(|(hour, what)| format!("{hour:.2} h: {what}")).collect();
        page.note(&format!("What the scenario changes, as dashed lines: {}.", changes.join("; ")));
    }
    let curve = |name: &str, colour: usize, of: &dyn Fn(&crate::agent::CurvePoint) -> f64| {
        Line::new(name, SERIES[colour], soak.curve.iter().map(|(hour, point)| (*hour, of(point))).collect())
    };
    let success = vec![
        curve("success", 0, &|point| 100.0 * point.success),
        curve("quality", 1, &|point| 100.0 * point.convergence_quality),
    ];
    let slowness = vec![curve("", 0, &|point| point.slowness_mean)];
    let drift = vec![curve("", 0, &|point| point.feature_drift_deg.unwrap_or(f64::NAN))];
    add(&mut page, soak, "success", "Success and convergence quality", Axis::new("%").within(0.0, 100.0), success)?;
    add(&mut page, soak, "slowness", "Slowness of the features", Axis::new("mean, 1/s²"), slowness)?;
    add(&mut page, soak, "drift", "Drift of the slowest features from model to model", Axis::new("degrees"), drift)?;

    page.section("program", "How the program did");
    let line = |name: &str, colour: usize, of: &dyn Fn(&Sample) -> f64| {
        let points = soak.samples.iter().map(|sample| (sample.hours, of(sample))).collect();
        Line::new(name, SERIES[colour % SERIES.len()], points)
    };
    let names: Vec<&str> = soak.samples.last().map_or(Vec::new(), |s| s.queues.iter().map(|queue| queue.0).collect());
    let depth = |sample: &Sample, i: usize| sample.queues.get(i).map_or(f64::NAN, |queue| queue.1 as f64);
    let queues = names.iter().enumerate().map(|(i, name)| line(name, i, &|sample| depth(sample, i))).collect();
    let megabytes = |bytes: Option<u64>| bytes.map_or(f64::NAN, |bytes| bytes as f64 / 1e6);
    let one = |of: &dyn Fn(&Sample) -> f64| vec![line("", 0, of)];
    add(&mut page, soak, "memory", "Memory", Axis::new("MB"), one(&|s| megabytes(s.rss_bytes)))?;
    let files = one(&|sample| sample.open_files.map_or(f64::NAN, |count| count as f64));
    add(&mut page, soak, "files", "Open files", Axis::new("files"), files)?;
    add(&mut page, soak, "log", "The log", Axis::new("MB"), one(&|s| s.log_bytes as f64 / 1e6))?;
    let latencies =
        vec![line("learning from a frame", 0, &|s| s.frame_p99_ms), line("frame to action", 1, &|s| s.act_p99_ms)];
    add(&mut page, soak, "latency", "Latency so far", Axis::log("99th percentile, ms"), latencies)?;
    add(&mut page, soak, "queues", "Queue depths", Axis::new("entries that wait"), queues)?;
    add(&mut page, soak, "speed", "Speed", Axis::new("frames per second"), one(&|s| s.frames_per_second))?;
    let vectors = one(&|sample| sample.support_vectors as f64);
    add(&mut page, soak, "dictionary", "The dictionary", Axis::new("support vectors"), vectors)?;
    Ok(page.html())
}

/// A chart over the hours of driving, with a dashed line where the scenario changes.
fn add(page: &mut Page, soak: &Soak, name: &str, title: &str, y: Axis, mut lines: Vec<Line>) -> Result<(), DrawError> {
    let values = || lines.iter().flat_map(|line| &line.points).map(|point| point.1).filter(|value| value.is_finite());
    let high = y.range.map_or_else(|| values().fold(0.0, f64::max), |range| range.1);
    let low = if y.log { values().filter(|&value| value > 0.0).fold(f64::INFINITY, f64::min) } else { 0.0 };
    if high > low && low.is_finite() {
        let grey = plotters::style::RGBColor(130, 130, 130);
        let at =
            |(hour, _): &(f64, String)| Line::new("", grey, vec![(*hour, low), (*hour, high)]).drawn(Stroke::Dashed);
        lines.extend(soak.changes.iter().map(at));
    }
    let x = Axis::new("hours of driving").within(0.0, soak.hours);
    let svg = Chart { height: 280, ..Chart::new(title, x, y, lines) }.svg()?;
    page.figure(name, title, "", &svg);
    Ok(())
}
