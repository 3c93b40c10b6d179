//! The panes of the terminal view.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Chart, Dataset, GraphType, Paragraph, Widget, Wrap};

use super::Choice;
use super::picture::picture;
use super::room::{Shown, room};
use crate::live::view::{Curve, Phase, View};
use crate::report::Numbered;
use crate::report::draw::{SERIES, ends, short};

/// Smallest terminal, columns and lines.
const SMALLEST: (u16, u16) = (72, 22);

/// Levels of a small curve.
const LEVELS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// Draw a view into all of a buffer.
pub fn draw(buffer: &mut Buffer, view: &View, choice: Choice) {
    let area = buffer.area;
    if area.width < SMALLEST.0 || area.height < SMALLEST.1 {
        let text = format!(
            "This terminal has {} × {} characters; the view needs {} × {}. Make it larger, or press q.",
            area.width, area.height, SMALLEST.0, SMALLEST.1
        );
        return Paragraph::new(text).wrap(Wrap { trim: true }).render(area, buffer);
    }
    let rows = [Constraint::Length(1), Constraint::Min(10), Constraint::Length(5), Constraint::Length(1)];
    let [head, body, health_area, keys] = Layout::vertical(rows).areas(area);
    let [left, right] = Layout::horizontal([Constraint::Percentage(54), Constraint::Percentage(46)]).areas(body);
    let rows = [Constraint::Percentage(38), Constraint::Percentage(34), Constraint::Min(3)];
    let [seen, learned, features_area] = Layout::vertical(rows).areas(right);
    headline(view).render(head, buffer);
    let shown = Shown::of(view, choice.map);
    let inner = pane(buffer, left, &shown.title(view));
    room(buffer, inner, view, shown, choice.plain);
    pictures(buffer, seen, view, choice.plain);
    curves(buffer, learned, view);
    features(buffer, features_area, view);
    health(buffer, health_area, view);
    let text = "q leave   Tab next map: tasks, features";
    Paragraph::new(text).style(Style::default().add_modifier(Modifier::DIM)).render(keys, buffer);
}

fn pane(buffer: &mut Buffer, area: Rect, title: &str) -> Rect {
    let block = Block::bordered().title(title).border_style(Style::default().add_modifier(Modifier::DIM));
    let inner = block.inner(area);
    block.render(area, buffer);
    inner
}

fn headline(view: &View) -> Line<'static> {
    let (phase, colour) = match view.phase {
        Phase::Reading => ("reading the log", Color::Yellow),
        Phase::Running => ("running", Color::Green),
        Phase::Paused => ("paused", Color::Yellow),
        Phase::Silent => ("silent", Color::Red),
        Phase::Over => ("over", Color::Blue),
    };
    let silent = if view.phase == Phase::Silent { format!(" for {:.0} s", view.quiet_seconds) } else { String::new() };
    let of = view.planned.map_or(String::new(), |planned| format!(" of {}", Numbered(planned)));
    let text = format!(
        "  frame {}, action {}{of}, {:.0} s of driving, model {}",
        Numbered(view.frame),
        Numbered(view.actions),
        view.seconds,
        view.epoch
    );
    Line::from(vec![
        Span::styled(view.title.clone(), Style::default().add_modifier(Modifier::BOLD)),
        Span::styled(format!("  {phase}{silent}"), Style::default().fg(colour)),
        Span::raw(text),
        Span::raw(view.robot.as_ref().map_or(String::new(), |robot| format!("  robot {robot}"))),
    ])
}

/// What the camera sees, and what is made of it.
fn pictures(buffer: &mut Buffer, area: Rect, view: &View, plain: bool) {
    let [left, right] = Layout::horizontal([Constraint::Percentage(50), Constraint::Percentage(50)]).areas(area);
    for (area, title, image) in
        [(left, " camera, without noise ", &view.camera), (right, " what is learned from ", &view.observation)]
    {
        let inner = pane(buffer, area, title);
        match image {
            Some(image) => picture(buffer, inner, image, plain),
            None => Paragraph::new("not in the log").render(inner, buffer),
        }
    }
}

fn curves(buffer: &mut Buffer, area: Rect, view: &View) {
    let [left, right] = Layout::horizontal([Constraint::Percentage(50), Constraint::Percentage(50)]).areas(area);
    let tried = !view.curves.success.is_empty();
    let names: Vec<String> = view
        .curves
        .success
        .iter()
        .filter_map(|curve| Some(format!("{} {:.0}%", curve.name, 100.0 * curve.points.last()?.1)))
        .collect();
    let title = if tried { format!(" success: {} ", names.join(", ")) } else { " success ".to_owned() };
    chart(buffer, left, &title, &view.curves.success, Some([0.0, 1.0]));
    let slowness = std::slice::from_ref(&view.curves.slowness);
    let newest = view.curves.slowness.points.last().map_or(String::new(), |point| format!(": {} /s²", short(point.1)));
    chart(buffer, right, &format!(" mean slowness{newest} "), slowness, None);
}

/// Lines over frames.
fn chart(buffer: &mut Buffer, area: Rect, title: &str, curves: &[Curve], y: Option<[f64; 2]>) {
    let inner = pane(buffer, area, title);
    let points = || curves.iter().flat_map(|curve| &curve.points);
    let Some(last) = points().map(|point| point.0).reduce(f64::max) else {
        return Paragraph::new("nothing yet").render(inner, buffer);
    };
    let most = points().map(|point| point.1).filter(|value| value.is_finite()).fold(f64::MIN_POSITIVE, f64::max);
    let y = y.unwrap_or([0.0, 1.1 * most]);
    let datasets = curves.iter().enumerate().map(|(i, curve)| {
        let colour = SERIES[i % SERIES.len()];
        let kind = if curve.points.len() < 2 { GraphType::Scatter } else { GraphType::Line };
        let style = Style::default().fg(Color::Rgb(colour.0, colour.1, colour.2));
        Dataset::default().data(&curve.points).marker(Marker::Braille).graph_type(kind).style(style)
    });
    let x = Axis::default().bounds([0.0, last.max(1.0)]).labels(["0".to_owned(), short(last)]);
    let y = Axis::default().bounds(y).labels(y.map(short));
    Chart::new(datasets.collect()).x_axis(x).y_axis(y).render(inner, buffer);
}

/// A line of text for each feature: its slowness, and its values at the ends of the last actions.
fn features(buffer: &mut Buffer, area: Rect, view: &View) {
    let inner = pane(buffer, area, &format!(" features of model {}: Δ /s², last actions ", view.features.epoch));
    if view.features.series.is_empty() {
        return Paragraph::new("no model yet").render(inner, buffer);
    }
    let lines = view.features.series.iter().enumerate().map(|(i, series)| {
        let slowness = view.features.slowness.get(i).map_or("–".to_owned(), |&slowness| short(slowness));
        let head = format!("{:>2} {slowness:>7} ", i + 1);
        let room = usize::from(inner.width).saturating_sub(head.chars().count());
        let colour = SERIES[i % SERIES.len()];
        let style = Style::default().fg(Color::Rgb(colour.0, colour.1, colour.2));
        Line::from(vec![Span::raw(head), Span::styled(levels(series, room), style)])
    });
    Paragraph::new(lines.collect::<Vec<_>>()).render(inner, buffer);
}

/// The last values of a curve as letters of different heights.
fn levels(curve: &Curve, count: usize) -> String {
    let values: Vec<f64> = curve.points.iter().map(|point| point.1).collect();
    let values = &values[values.len().saturating_sub(count)..];
    let (low, high) = ends(values);
    let level = |value: f64| (value - low) / (high - low).max(1e-9) * (LEVELS.len() - 1) as f64;
    let letter = |&value: &f64| if value.is_finite() { LEVELS[level(value).round() as usize] } else { ' ' };
    values.iter().map(letter).collect()
}

fn health(buffer: &mut Buffer, area: Rect, view: &View) {
    let inner = pane(buffer, area, " health ");
    let mut lines = Vec::new();
    let decision = view.decision.as_ref().map_or_else(String::new, |decision| {
        let why = if decision.task.is_empty() { "exploring".to_owned() } else { format!("to {}", decision.task) };
        let reflex = if decision.reflex { " (reflex)" } else { "" };
        let sure =
            decision.sure.map_or_else(String::new, |sure| format!(", sure of the place by {:.0} %", 100.0 * sure));
        let prospect = decision.prospect.map_or_else(String::new, |(actions, arrival)| {
            format!(", about {actions:.0} actions to go, {:.0} % in time", 100.0 * arrival)
        });
        format!("{why}: {}{reflex}{prospect}{sure}   ", decision.action)
    });
    let dictionary = view.dictionary.as_ref().map_or_else(String::new, |dictionary| {
        let budget = dictionary.budget.map_or(String::new(), |budget| format!(" of {}", Numbered(budget as u64)));
        let full = if dictionary.full { ", full" } else { "" };
        format!(
            "{}{budget} support vectors{full} (sigma {})",
            Numbered(u64::from(dictionary.size)),
            short(dictionary.sigma)
        )
    });
    lines.push(decision + &dictionary);
    if let Some(health) = &view.health {
        lines.push(format!(
            "{:.0} frames/s   act p99 {} ms, frame p99 {} ms   memory {:.0} MB   dropped {}, left out {}, damaged {}",
            health.frames_per_second,
            short(health.act_p99_ms),
            short(health.frame_p99_ms),
            health.memory_mb,
            health.dropped,
            health.quarantined,
            health.damaged
        ));
        let queues: Vec<String> = health.queues.iter().map(|(name, depth)| format!("{name} {depth}")).collect();
        let last = health.said.last().map_or(String::new(), |said| format!("   {said}"));
        lines.push(format!("queues: {}{last}", queues.join(", ")));
    }
    if let Some(missing) = &view.missing {
        lines.insert(0, missing.clone());
    }
    Paragraph::new(lines.into_iter().map(Line::from).collect::<Vec<_>>()).render(inner, buffer);
}
