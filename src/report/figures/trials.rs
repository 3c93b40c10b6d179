//! Trials of what was learned: where they began and how they ended, and their ways, failures first.

use plotters::style::RGBColor;

use super::{Figure, Item, Material, Section, file_name};
use crate::evaluate::Trip;
use crate::report::draw::{BAD, DrawError, INK, Mark, PATH, Panel, Panels, Table};

/// Ways that are drawn.
const SHOWN: usize = 16;

/// Steps beyond the optimum, up to which a trial has a colour; its colour, and what it is called.
const EXTRA: [(usize, RGBColor, &str); 3] = [
    (1, RGBColor(46, 139, 87), "at most 1 step too many"),
    (4, RGBColor(222, 170, 40), "2 to 4"),
    (usize::MAX, RGBColor(224, 110, 50), "5 or more"),
];

pub fn section(material: &Material<'_>) -> Result<Section, DrawError> {
    let mut items = Vec::new();
    match (&material.trials, &material.room) {
        (Ok(trials), Some(_)) => {
            for (task, (result, ways)) in trials.iter().enumerate() {
                items.push(Item::Figure(starts(material, task, &result.name, ways)?));
                items.push(Item::Figure(trajectories(material, task, &result.name, ways)?));
            }
            for (result, ways) in trials.iter() {
                let failed = ways.iter().filter(|way| !way.arrived).count();
                let summary = format!("All {} trials of {}, failures ({failed}) first", ways.len(), result.name);
                items.push(Item::Folded(summary, table(ways)));
            }
        }
        (Err(reason), _) => items.push(Item::Missing(format!("There are no trials to show: {reason}."))),
        (Ok(_), None) => items.push(Item::Missing("There are no trials to show: the room is not known.".to_owned())),
    }
    Ok(Section { name: "trials", heading: "Where it fails", items })
}

/// Failures first, then those with the most steps too many.
fn worst_first(ways: &[Trip]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..ways.len()).collect();
    let badness = |way: &Trip| (!way.arrived, way.extra().unwrap_or(usize::MAX), way.steps());
    order.sort_by(|&a, &b| badness(&ways[b]).cmp(&badness(&ways[a])));
    order
}

fn colour(way: &Trip) -> RGBColor {
    let found = way.extra().and_then(|extra| EXTRA.iter().find(|(most, ..)| extra <= *most));
    found.map_or(BAD, |found| found.1)
}

/// All starts, in the colour of how their trial ended.
fn starts(material: &Material<'_>, task: usize, name: &str, ways: &[Trip]) -> Result<Figure, DrawError> {
    let mut marks: Vec<Mark> = material.room.iter().flat_map(|room| room.goal(task)).collect();
    marks.extend(material.walls(6));
    for i in worst_first(ways).into_iter().rev() {
        let (way, start) = (&ways[i], ways[i].poses[0]);
        marks.push(Mark::Arrow(start.position.into(), start.heading, 15.0, colour(way)));
        if !way.arrived {
            marks.push(Mark::Cross(start.position.into(), 7, BAD));
        }
    }
    let title = format!("Starts of the trials of {name}");
    let count = |which: &dyn Fn(&Trip) -> bool| ways.iter().filter(|way| which(way)).count();
    let mut key = vec![(BAD, format!("failed: {}", count(&|way| !way.arrived)))];
    key.extend(
        EXTRA.map(|(_, own, what)| (own, format!("{what}: {}", count(&|way| way.arrived && colour(way) == own)))),
    );
    let corners = material.corners().unwrap_or(([0.0; 2], [1.0; 2]));
    let svg = Panels { axes: true, key, ..Panels::new(&title, corners, vec![Panel::of(marks)]) }.svg()?;
    let caption = "An arrow at each start, in its heading. Starts were never used for learning.";
    Ok(Figure::new(file_name("starts", task, name), &title, caption, svg))
}

/// The ways of the worst trials.
fn trajectories(material: &Material<'_>, task: usize, name: &str, ways: &[Trip]) -> Result<Figure, DrawError> {
    let panels = worst_first(ways).into_iter().take(SHOWN).map(|i| {
        let (way, start) = (&ways[i], ways[i].poses[0]);
        let points = way.poses.iter().map(|pose| pose.position.into()).collect();
        let mut marks =
            vec![Mark::Line(points, PATH.into(), 2), Mark::Arrow(start.position.into(), start.heading, 15.0, INK)];
        marks.extend(way.poses.last().map(|end| match way.arrived {
            true => Mark::Dot(end.position.into(), 3, PATH.into()),
            false => Mark::Cross(end.position.into(), 4, BAD),
        }));
        let best = way.optimal.map_or(String::new(), |best| format!(", best {best}"));
        let label = match way.arrived {
            true => format!("{} steps{best}", way.steps()),
            false => format!("failed, {} steps", way.steps()),
        };
        Panel { label, ..Panel::of(marks) }
    });
    let title = format!("The worst trials of {name}, failures first");
    let corners = material.corners().unwrap_or(([0.0; 2], [1.0; 2]));
    let mut outline: Vec<Mark> = material.room.iter().flat_map(|room| room.goal(task)).collect();
    outline.extend(material.walls(1));
    let svg = Panels { outline, per_row: 4, ..Panels::new(&title, corners, panels.collect()) }.svg()?;
    let failed = ways.iter().filter(|way| !way.arrived).count();
    let caption = format!(
        "{} of {} trials, {}. Arrow: the start; dot: the end, which is in the goal when an action ends there.",
        ways.len().min(SHOWN),
        ways.len(),
        match failed {
            0 => "none failed: those with the most steps too many".to_owned(),
            1 => "the one that failed first".to_owned(),
            failed => format!("the {failed} that failed first"),
        }
    );
    Ok(Figure::new(file_name("trajectories", task, name), &title, caption, svg))
}

fn table(ways: &[Trip]) -> Table {
    let mut table = Table::new(&["trial", "x, m", "y, m", "heading, °", "arrived", "steps", "optimal", "too many"]);
    for i in worst_first(ways) {
        let (way, start) = (&ways[i], ways[i].poses[0]);
        table.row([
            (i + 1).to_string(),
            format!("{:.2}", start.position.x),
            format!("{:.2}", start.position.y),
            format!("{:.0}", start.heading.to_degrees()),
            if way.arrived { "yes" } else { "no" }.to_owned(),
            way.steps().to_string(),
            way.optimal.map_or("–".to_owned(), |best| best.to_string()),
            way.extra().map_or("–".to_owned(), |extra| extra.to_string()),
        ]);
    }
    table
}
