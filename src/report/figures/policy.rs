//! The room with the way and the policy, and what the policy makes of each place and heading.

use plotters::style::{Color, RGBColor};

use super::{Figure, Item, Material, Section, file_name};
use crate::evaluate::{Grid, HEADINGS, Map, RoomMaps, angle};
use crate::report::Numbered;
use crate::report::draw::{BAD, Colours, DrawError, GOAL, INK, Mark, PATH, Panel, Panels, SERIES, ends};
use crate::report::gather::CELL;
use crate::report::room::HATCH;
use crate::scenario::in_goal;

/// Most arrows along the longer side of a room.
const ARROWS: usize = 18;

/// What a task's values are called.
const WORTH: &str = "value of the best action, mean of headings";

pub fn section(material: &Material<'_>) -> Result<Section, DrawError> {
    let mut items = Vec::new();
    let named = material.task_names();
    match (&material.room, material.room_maps) {
        (Some(_), Some(room_maps)) => {
            // In the order in which drawings of one height stand side by side.
            let tasks = || named.iter().enumerate().take(room_maps.values.len());
            for (task, name) in tasks() {
                items.push(Item::Figure(room(material, room_maps, task, name)?));
            }
            items.push(way(material)?);
            for (task, name) in tasks() {
                items.push(Item::Figure(values(material, room_maps, task, name)?));
                items.push(Item::Figure(best(material, room_maps, task, name)?));
            }
            for (number, there) in room_maps.there.iter().enumerate() {
                let name = material.room.as_ref().and_then(|room| room.scenario.names().nth(number));
                if let (Some(there), Some(name)) = (there, name) {
                    items.push(Item::Figure(region(material, room_maps, there, number, name)?));
                }
            }
            if named.len().is_multiple_of(2) {
                let way = items.remove(named.len().min(room_maps.values.len()));
                items.push(way);
            }
        }
        _ => {
            items.push(Item::Missing(format!(
                "There are no arrows and no value function of each place: {}.",
                match (&material.learned, material.simulated) {
                    (Err(reason), _) => reason.clone(),
                    (Ok(_), false) =>
                        "they need images from every place, and the room that the log was recorded in is not \
                     simulated"
                            .to_owned(),
                    (Ok(_), true) => "the room is not known".to_owned(),
                }
            )));
            items.push(way(material)?);
        }
    }
    Ok(Section { name: "policy", heading: "Where it drives", items })
}

/// The walls, the goal and what is near a wall, for a task.
fn outline(material: &Material<'_>, task: usize, width: u32) -> Vec<Mark> {
    let Some(room) = &material.room else { return Vec::new() };
    let mut marks = if task < room.scenario.tasks.len() {
        room.goal(task)
    } else {
        room.avoided(task - room.scenario.tasks.len()).into_iter().collect()
    };
    marks.extend(room.walls(width));
    marks
}

/// The room from above with values, arrows and the last part of the way.
fn room(material: &Material<'_>, room_maps: &RoomMaps, task: usize, name: &str) -> Result<Figure, DrawError> {
    let worth = room_maps.worth(task);
    let values: Map = worth.iter().map(|worth| worth.0).collect();
    let mut marks = Vec::new();
    // Of goals that are shown, nearness to walls is not known.
    let punishes = material.room.as_ref().is_some_and(|room| !room.scenario.tasks[task].is_shown());
    if let Some(room) = &material.room {
        let (low, high) = room.corners();
        if punishes {
            marks.extend(room.near_walls(task, 0.014 * (high[0] - low[0])));
        }
        marks.extend(room.goal(task));
    }
    marks.extend(material.last_way());
    marks.extend(arrows(material, room_maps, task, &worth));
    marks.extend(material.walls(6));
    let title = format!("The room and the policy of {name}");
    let mut key = vec![
        (GOAL, "goal".to_owned()),
        (PATH, format!("the last {} actions", super::LAST_ACTIONS)),
        (INK, "where the policy turns to".to_owned()),
    ];
    let avoids = material.room.as_ref().is_some_and(|room| !room.scenario.avoids.is_empty());
    key.extend(avoids.then(|| (BAD, "to be avoided".to_owned())));
    key.extend(punishes.then(|| (HATCH, "near a wall, punished".to_owned())));
    let (low, high) = ends(&values);
    let svg = Panels {
        colours: Colours::Sequential(low, high),
        scale: WORTH.to_owned(),
        axes: true,
        key,
        ..drawing(material, &title, room_maps, vec![Panel { values, ..Panel::of(marks) }])
    }
    .svg()?;
    let caption = "Seen from above. Colours: how much the policy expects to gain from a place (goal soon: dark). Arrows: the \
                   heading at which a place is worth most, that is where the policy drives on from there.";
    Ok(Figure::new(file_name("room", task, name), &title, caption, svg))
}

/// Arrows at an even selection of the map's places, outside of the goal.
fn arrows(material: &Material<'_>, room_maps: &RoomMaps, task: usize, worth: &[(f64, usize)]) -> Vec<Mark> {
    let (grid, Some(room)) = (room_maps.grid, &material.room) else { return Vec::new() };
    let every = grid.columns.max(grid.rows).div_ceil(ARROWS).max(1);
    let goal = &room.scenario.tasks[task];
    let (low, high) = room.corners();
    let length = 0.62 * every as f64 * grid.step()[0] / (high[0] - low[0]) * 500.0;
    let shown = |&(i, _): &(usize, [f64; 2])| {
        (i % grid.columns) % every == every / 2 && (i / grid.columns) % every == every / 2
    };
    let placed = grid.points().enumerate().filter(shown);
    let wanted = placed.filter(|(i, place)| worth[*i].0.is_finite() && !in_goal(goal, (*place).into()));
    wanted.map(|(i, place)| Mark::Arrow(place, angle(worth[i].1), length.clamp(8.0, 22.0), INK)).collect()
}

/// The value of the best action for each heading.
fn values(material: &Material<'_>, room_maps: &RoomMaps, task: usize, name: &str) -> Result<Figure, DrawError> {
    let maps = &room_maps.values[task];
    let (low, high) = ends(maps.iter().flatten());
    let title = format!("Value function of {name}");
    let svg = Panels {
        colours: Colours::Sequential(low, high),
        scale: "value of the best action".to_owned(),
        outline: outline(material, task, 1),
        per_row: 2,
        key: vec![(GOAL, "goal".to_owned())],
        ..drawing(material, &title, room_maps, headings(maps))
    }
    .svg()?;
    let caption = "What the policy expects from each place, for eight headings. 0° looks along x (to the right), 90° along y \
                   (up).";
    Ok(Figure::new(file_name("values", task, name), &title, caption, svg))
}

/// The best action for each heading.
fn best(material: &Material<'_>, room_maps: &RoomMaps, task: usize, name: &str) -> Result<Figure, DrawError> {
    let title = format!("Greedy action of {name}");
    let colours: [RGBColor; 3] = [SERIES[0], SERIES[1], SERIES[2]].map(|c| {
        let lighter = |c: u8| c + (255 - c) / 3;
        RGBColor(lighter(c.0), lighter(c.1), lighter(c.2))
    });
    let names = ["forward", "turn left", "turn right"].map(str::to_owned);
    let svg = Panels {
        colours: Colours::Classes(colours.into_iter().zip(names).collect()),
        outline: outline(material, task, 1),
        per_row: 2,
        ..drawing(material, &title, room_maps, headings(&room_maps.best[task]))
    }
    .svg()?;
    let caption = "What the policy does at each place, for eight headings, before the reflexes have a say.";
    Ok(Figure::new(file_name("greedy", task, name), &title, caption, svg))
}

/// What counts as a place that was shown.
fn region(
    material: &Material<'_>,
    room_maps: &RoomMaps,
    there: &Map,
    task: usize,
    name: &str,
) -> Result<Figure, DrawError> {
    let title = format!("What counts as {name}");
    let is_goal = material.room.as_ref().is_some_and(|room| task < room.scenario.tasks.len());
    let panel = Panel { values: there.clone(), ..Panel::of(outline(material, task, 6)) };
    let svg = Panels {
        colours: Colours::Sequential(0.0, 1.0),
        scale: "share of eight headings at which the robot says that it is there".to_owned(),
        axes: true,
        key: vec![(if is_goal { GOAL } else { BAD }, "what evaluation counts".to_owned())],
        ..drawing(material, &title, room_maps, vec![panel])
    }
    .svg()?;
    let caption = "The place was shown, not measured: from pictures that were marked there, the agent tells by its camera whether \
                   this is it. The disc is what evaluation counts as a true arrival, or as an entry into what is to be avoided; the \
                   agent does not know it.";
    Ok(Figure::new(file_name("there", task, name), &title, caption, svg))
}

/// A panel for each heading.
pub fn headings(maps: &[Map; HEADINGS]) -> Vec<Panel> {
    let panel = |(h, map): (usize, &Map)| Panel { label: label(h), values: map.clone(), ..Panel::default() };
    maps.iter().enumerate().map(panel).collect()
}

/// What stands above the panel of a heading.
pub fn label(heading: usize) -> String {
    format!("heading {:.0}°", angle(heading).to_degrees())
}

/// Panels on the map's grid.
fn drawing(material: &Material<'_>, title: &str, room_maps: &RoomMaps, panels: Vec<Panel>) -> Panels {
    let corners = material.corners().unwrap_or((room_maps.grid.low, room_maps.grid.high));
    Panels { grid: Some(room_maps.grid), ..Panels::new(title, corners, panels) }
}

/// Where the robot was in all, and the last part of its way.
fn way(material: &Material<'_>) -> Result<Item, DrawError> {
    let Some((low, high)) = material.corners().filter(|_| !material.gathered.visits.is_empty()) else {
        return Ok(Item::Missing("There is no way to show: the log holds no poses (/pose).".to_owned()));
    };
    let title = "Where the robot was";
    let (grid, visits) = visits(material, low, high);
    let most = visits.iter().copied().filter(|value| value.is_finite()).fold(1.0, f64::max);
    let mut marks = material.last_way();
    marks.extend(material.walls(6));
    let svg = Panels {
        grid: Some(grid),
        colours: Colours::Sequential(0.0, most),
        scale: "frames in a cell of 5 cm, as a power of ten".to_owned(),
        axes: true,
        key: vec![(PATH, "the end of its way".to_owned())],
        ..Panels::new(title, (low, high), vec![Panel { values: visits, ..Panel::of(marks) }])
    }
    .svg()?;
    let caption = format!("All {} poses of the log. White: never visited.", Numbered(material.gathered.poses));
    Ok(Item::Figure(Figure::new("way", title, caption, svg)))
}

/// The frames in each cell, as a power of ten; NaN where there are none.
pub fn visits(material: &Material<'_>, low: [f64; 2], high: [f64; 2]) -> (Grid, Map) {
    // Coarser in a large room, so that there are at most some 200 cells along a side.
    let times = (((high[0] - low[0]).max(high[1] - low[1]) / CELL / 200.0).ceil() as i32).max(1);
    let cell = CELL * f64::from(times);
    let [left, bottom] = low.map(|low| (low / cell).floor());
    let [right, top] = high.map(|high| (high / cell).ceil());
    let (columns, rows) = ((right - left) as usize, (top - bottom) as usize);
    let grid = Grid { columns, rows, low: [left * cell, bottom * cell], high: [right * cell, top * cell] };
    let mut counts = vec![0u32; columns * rows];
    for (&(x, y), &count) in &material.gathered.visits {
        let (i, j) = (x.div_euclid(times) - left as i32, y.div_euclid(times) - bottom as i32);
        if let (Ok(i), Ok(j)) = (usize::try_from(i), usize::try_from(j))
            && i < columns
            && let Some(own) = counts.get_mut(j * columns + i)
        {
            *own += count;
        }
    }
    let power = |count: u32| if count > 0 { f64::from(count).log10() } else { f64::NAN };
    (grid, counts.into_iter().map(power).collect())
}

/// A colour between two, for early and late.
pub fn between(share: f64) -> plotters::style::RGBAColor {
    let (a, b) = (SERIES[0], SERIES[1]);
    let mix = |a: u8, b: u8| (f64::from(a) + (f64::from(b) - f64::from(a)) * share.clamp(0.0, 1.0)) as u8;
    RGBColor(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2)).mix(0.75)
}
