//! Success, convergence quality and slowness over frames; how the dictionary grew, and where its members were taken.

use plotters::style::RGBColor;

use super::policy::{between, visits};
use super::{Figure, Item, Material, Section};
use crate::log::messages::GoalMoved;
use crate::report::Numbered;
use crate::report::draw::{Axis, Chart, Colours, DrawError, Line, Mark, Panel, Panels, SERIES, Stroke};
use crate::report::gather::{ModelSeen, Tried};

/// How many models a stranger needs to see a curve.
const FEW: usize = 2;

/// What happened at a moment.
pub const GREY: RGBColor = RGBColor(130, 130, 130);

pub fn section(material: &Material<'_>) -> Result<Section, DrawError> {
    let gathered = material.gathered;
    let mut items = Vec::new();
    if gathered.tried.is_empty() {
        items.push(Item::Missing(
            "There is no curve of success: no policy was tried out during the run (no /adagio/evaluation in the log)."
                .to_owned(),
        ));
    } else {
        let lines = |of: fn(&Tried) -> f64| {
            gathered.tried.iter().enumerate().map(move |(i, (task, tried))| {
                let points = tried.iter().map(|tried| (tried.frame as f64, of(tried))).collect();
                Line::new(task, SERIES[i % SERIES.len()], points).drawn(Stroke::Points)
            })
        };
        let chart = |title: &str, y: &str, mut lines: Vec<Line>| {
            lines.extend(gathered.moved.iter().map(|moved| upright(moved.frame)));
            Chart::new(title, Axis::new("frames learned from"), Axis::new(y).within(0.0, 1.05), lines).svg()
        };
        let title = "Success over frames";
        let success = lines(|tried| tried.success).zip(gathered.tried.values()).map(|(line, tried)| {
            line.with_band(tried.iter().map(|tried| (tried.frame as f64, tried.low, tried.success)).collect())
        });
        let svg = chart(title, "share of trials that arrive", success.collect())?;
        let mut caption =
            "From random starts, in trials beside the run. The band reaches down to the lower end of the 95 % \
                           interval."
                .to_owned();
        for GoalMoved { frame, task, x, y, .. } in &gathered.moved {
            caption +=
                &format!(" The goal of {task} moved to ({x:.2}, {y:.2}) m at frame {} (dashed).", Numbered(*frame));
        }
        items.push(Item::Figure(Figure::new("success", title, &caption, svg)));

        let title = "Convergence quality over frames";
        let svg = chart(title, "quality (1: optimal)", lines(|tried| tried.quality).collect())?;
        let caption = "Mean of γ to the power of the steps beyond the optimum; a trial that does not arrive counts 0.";
        items.push(Item::Figure(Figure::new("quality", title, caption, svg)));
    }
    let models: Vec<_> = gathered.models.iter().collect();
    if models.len() < FEW {
        items.push(Item::Missing(format!(
            "There is no curve of slowness: the log holds {} models (/adagio/model).",
            gathered.models.offered()
        )));
    } else {
        let line = |name: &str, i: usize, of: fn(&ModelSeen) -> f64| {
            let points = models.iter().map(|model| (model.frames as f64, of(model))).collect();
            Line::new(name, SERIES[i], points).drawn(Stroke::Points)
        };
        let title = "Slowness over frames";
        let lines =
            vec![line("mean of all features", 0, |model| model.mean), line("slowest", 1, |model| model.slowest)];
        let svg = Chart::new(title, Axis::new("frames learned from"), Axis::log("slowness Δ, 1/s²"), lines).svg()?;
        let caption = "Lower is slower. A model that knows more of the room may be faster on the frames that it was learned from.";
        items.push(Item::Figure(Figure::new("slowness-over-frames", title, caption, svg)));
    }
    Ok(Section { name: "learning", heading: "How it learned", items })
}

/// A line at a frame, over all shares.
fn upright(frame: u64) -> Line {
    Line::new("", GREY, vec![(frame as f64, 0.0), (frame as f64, 1.0)]).drawn(Stroke::Dashed)
}

/// Growth of the dictionary, and where its members were taken.
pub fn dictionary(material: &Material<'_>) -> Result<Section, DrawError> {
    let gathered = material.gathered;
    let mut items = Vec::new();
    let growth: Vec<_> = gathered.growth.iter().map(|&(frame, size)| (frame as f64, f64::from(size))).collect();
    if growth.is_empty() {
        items.push(Item::Missing(
            "There is no dictionary: no frame was learned from (no /adagio/dictionary).".to_owned(),
        ));
    } else {
        let title = "Growth of the dictionary";
        let line = Line::new("", SERIES[0], growth);
        let svg = Chart::new(title, Axis::new("frames"), Axis::new("support vectors"), vec![line]).svg()?;
        let caption = match gathered.full_since {
            Some(frame) => format!("Its budget is used up since frame {}: nothing more is taken.", Numbered(frame)),
            None => "It may still grow: its budget is not used up.".to_owned(),
        };
        items.push(Item::Figure(Figure::new("dictionary", title, caption, svg)));
        items.push(members(material)?);
    }
    Ok(Section { name: "dictionary", heading: "What it remembers", items })
}

fn members(material: &Material<'_>) -> Result<Item, DrawError> {
    let gathered = material.gathered;
    let (taken, Some((low, high))) = (gathered.members.offered(), material.corners()) else {
        return Ok(Item::Missing(
            "Where its members were taken is not known: the log holds no poses (/pose).".to_owned(),
        ));
    };
    if taken == 0 {
        return Ok(Item::Missing("Where its members were taken is not known: their frames have no pose.".to_owned()));
    }
    let title = "Where its members were taken";
    let (grid, values) = visits(material, low, high);
    let most = values.iter().copied().filter(|value| value.is_finite()).fold(1.0, f64::max);
    let ends =
        gathered.members.iter().fold((u64::MAX, 0), |(first, last), (frame, _)| (first.min(*frame), last.max(*frame)));
    let age = |frame: u64| (frame - ends.0) as f64 / (ends.1 - ends.0).max(1) as f64;
    let mut marks: Vec<Mark> =
        gathered.members.iter().map(|(frame, pose)| Mark::Dot(pose.position.into(), 2, between(age(*frame)))).collect();
    marks.extend(material.walls(6));
    let svg = Panels {
        grid: Some(grid),
        // Pale, so that the dots can be seen on it.
        colours: Colours::Sequential(0.0, 2.0 * most),
        scale: "frames in a cell, as a power of ten".to_owned(),
        axes: true,
        key: vec![
            (SERIES[0], format!("taken first (frame {})", Numbered(ends.0))),
            (SERIES[1], format!("last ({})", Numbered(ends.1))),
        ],
        ..Panels::new(title, (low, high), vec![Panel { values, ..Panel::of(marks) }])
    }
    .svg()?;
    let shown = gathered.members.iter().count() as u64;
    let some = if shown < taken { format!(" ({} of them are shown)", Numbered(shown)) } else { String::new() };
    let elsewhere = match gathered.members_elsewhere {
        0 => String::new(),
        count => format!(" Of {} more the pose is not known.", Numbered(count)),
    };
    let caption = format!("{} frames became support vectors{some}.{elsewhere}", Numbered(taken));
    Ok(Item::Figure(Figure::new("members", title, caption, svg)))
}
