//! The slow features: as maps of the room, and how slow they are beside the optimal responses.

use faer::Mat;

use super::policy::{headings, label};
use super::{Figure, Item, Material, Section};
use crate::evaluate::{FEATURES, HEADINGS, RoomMaps, angle, features_of};
use crate::report::draw::{Axis, Chart, Colours, DrawError, Line, Mark, Panel, Panels, SERIES, Stroke};
use crate::robot::wrap;
use crate::slow::theory::{Axis as Side, MOST_RESPONSES, OptimalResponses, plane_motion};
use crate::vision::Observation;

/// Features have mean 0 and variance 1 over the frames: colours reach two deviations.
const REACH: f64 = 2.0;

/// A recorded frame belongs to a heading within this angle: the thesis took 5°, out of more frames.
const NEAR_DEG: f64 = 22.5;

pub fn section(material: &Material<'_>) -> Result<Section, DrawError> {
    let mut items = slowness(material)?;
    match (&material.learned, material.room_maps) {
        (Ok(_), Some(room_maps)) => items.extend(maps(material, room_maps)?),
        (Ok(learned), None) => items.extend(scatter(material, learned)?),
        (Err(reason), _) => items.push(Item::Missing(format!("There are no features to show: {reason}."))),
    }
    Ok(Section { name: "features", heading: "What its features code", items })
}

/// Test maps of the first features.
fn maps(material: &Material<'_>, room_maps: &RoomMaps) -> Result<Vec<Item>, DrawError> {
    let (low, high) = material.corners().unwrap_or((room_maps.grid.low, room_maps.grid.high));
    let responses = optimal(material, 60).ok().map(|(responses, _)| responses);
    let grid = room_maps.grid;
    let mut items = vec![Item::Text(format!(
        "The first {} of them as test maps: {} × {} places, 8 headings, seen through a camera without noise{}. A feature of the \
         position appearance the same at all headings; a feature of the heading has one colour at each.",
        room_maps.features.len(),
        grid.columns,
        grid.rows,
        if room_maps.coarse { " (rendered as coarsely as vision allows)" } else { "" }
    ))];
    for (number, feature) in room_maps.features.iter().enumerate() {
        let title = format!("Feature {}", number + 1);
        let svg = Panels {
            grid: Some(grid),
            colours: Colours::Diverging(REACH),
            scale: "response, standard deviations".to_owned(),
            outline: material.walls(1),
            per_row: 4,
            ..Panels::new(&title, (low, high), headings(feature))
        }
        .svg()?;
        let slowness = material.gathered.slowness.get(number);
        let slowness = slowness.map_or(String::new(), |value| format!("Slowness {value:.3} /s². "));
        let alike = responses.as_ref().and_then(|responses| alike(room_maps, number, responses)).unwrap_or_default();
        let name = format!("feature-{:02}", number + 1);
        items.push(Item::Figure(Figure::new(name, &title, slowness + &alike, svg)));
    }
    Ok(items)
}

/// Which optimal response a feature resembles most, and how much: their correlation over all places and headings.
fn alike(room_maps: &RoomMaps, number: usize, responses: &OptimalResponses) -> Option<String> {
    let places: Vec<[f64; 2]> = room_maps.grid.points().collect();
    let maps = &room_maps.features[number];
    let inside: Vec<usize> = (0..places.len()).filter(|&i| maps[0][i].is_finite()).collect();
    let states = Mat::from_fn(3, inside.len() * HEADINGS, |axis, j| match axis {
        0 | 1 => places[inside[j / HEADINGS]][axis],
        _ => angle(j % HEADINGS),
    });
    let theory = responses.evaluate(states.as_ref()).ok()?;
    let own: Vec<f64> = (0..states.ncols()).map(|j| maps[j % HEADINGS][inside[j / HEADINGS]]).collect();
    let best = (0..theory.nrows())
        .map(|i| (i, correlation(&own, &(0..own.len()).map(|j| theory[(i, j)]).collect::<Vec<_>>())))
        .max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    let indices: Vec<String> = responses.responses()[best.0].indices.iter().map(usize::to_string).collect();
    Some(format!(
        "Most like the optimal response ({}) in (x, y, heading), correlation {:.2}.",
        indices.join(", "),
        best.1.abs()
    ))
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().max(1) as f64;
    let (ma, mb) = (a.iter().sum::<f64>() / n, b.iter().sum::<f64>() / n);
    let sum =
        |x: &[f64], mx: f64, y: &[f64], my: f64| -> f64 { x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum() };
    sum(a, ma, b, mb) / (sum(a, ma, a, ma) * sum(b, mb, b, mb)).sqrt().max(f64::MIN_POSITIVE)
}

/// Features at recorded frames, as dots where they were taken: the thesis's test maps of the real robot.
fn scatter(material: &Material<'_>, learned: &crate::policy::Learned) -> Result<Vec<Item>, DrawError> {
    let size = learned.model.members.as_ref().as_ref().nrows();
    let samples: Vec<_> = material.gathered.samples.iter().filter(|sample| sample.pixels.len() == size).collect();
    let Some((low, high)) = material.corners().filter(|_| !samples.is_empty()) else {
        return Ok(vec![Item::Missing(
            "There are no maps of the features: the log holds no observations with poses that the model knows the size of.".to_owned(),
        )]);
    };
    let seen: Vec<Observation> =
        samples.iter().map(|sample| Observation { frame: sample.frame, pixels: sample.pixels.clone() }).collect();
    let shown = FEATURES.min(learned.model.slowness.len());
    let features = features_of(learned, &seen, shown);
    let mut items = vec![Item::Text(format!(
        "There is no simulated room to look at, so the first {shown} of them are shown at {} recorded frames, each in the map of \
         the heading next to its own.",
        samples.len()
    ))];
    let colours = Colours::Diverging(REACH);
    for (number, title) in (0..shown).map(|number| (number, format!("Feature {}", number + 1))) {
        let panel = |heading: usize| {
            let near = |&i: &usize| wrap(samples[i].pose.heading - angle(heading)).abs().to_degrees() <= NEAR_DEG;
            let dots = (0..samples.len()).filter(near).filter_map(|i| {
                let colour = colours.of(*features[i].get(number)?)?;
                Some(Mark::Dot(samples[i].pose.position.into(), 3, colour.into()))
            });
            Panel { label: label(heading), ..Panel::of(dots.collect()) }
        };
        let classes = [-REACH, 0.0, REACH].map(|value| (colours.of(value).unwrap_or_default(), format!("{value:+.0}")));
        let svg = Panels {
            outline: material.walls(1),
            per_row: 4,
            key: classes.into(),
            ..Panels::new(&title, (low, high), (0..HEADINGS).map(panel).collect())
        }
        .svg()?;
        let slowness = material.gathered.slowness.get(number);
        let caption = slowness.map_or(String::new(), |value| format!("Slowness {value:.3} /s²."));
        items.push(Item::Figure(Figure::new(format!("feature-{:02}", number + 1), &title, caption, svg)));
    }
    Ok(items)
}

/// The optimal responses for the room and for how the robot moved in it; and what that is an approximation of.
fn optimal(material: &Material<'_>, count: usize) -> Result<(OptimalResponses, String), String> {
    let room = material.room.as_ref().ok_or("the room is not known")?;
    let [driving, turning] = material.gathered.motion;
    let weight = room.scenario.slow.move_weight;
    let steps = weight * driving.steps + turning.steps;
    if steps == 0.0 {
        return Err("the log does not say how the robot moved from frame to frame".to_owned());
    }
    let squared = room.scenario.robot.frame_seconds().powi(2) * steps;
    let speed = (weight * driving.distance + turning.distance) / squared;
    let turn = (weight * driving.angle + turning.angle) / squared;
    let (low, high) = room.world.plan.reachable_box();
    let text = |error: crate::slow::theory::TheoryError| error.to_string();
    let sides = [
        Side::free(low.x, high.x).map_err(text)?,
        Side::free(low.y, high.y).map_err(text)?,
        Side::cyclic(0.0, std::f64::consts::TAU).map_err(text)?,
    ];
    let responses = OptimalResponses::slowest(&sides, &plane_motion(speed, turn), count.clamp(1, MOST_RESPONSES));
    let cells = room.world.plan.reachable_cells().count() as f64;
    let filled = cells * crate::scenario::Plan::CELL.powi(2) / ((high.x - low.x) * (high.y - low.y));
    let note = if filled > 0.9 {
        String::new()
    } else {
        format!(" The room fills {:.0} % of the rectangle around it, which is what the theory knows.", 100.0 * filled)
    };
    Ok((responses.map_err(text)?, note))
}

/// Slowness of all features beside that of the optimal responses.
fn slowness(material: &Material<'_>) -> Result<Vec<Item>, DrawError> {
    let own = &material.gathered.slowness;
    if own.is_empty() {
        let reason = "There is no slowness to show: the log holds no model (/adagio/model).".to_owned();
        return Ok(vec![Item::Missing(reason)]);
    }
    let numbered = |values: &mut dyn Iterator<Item = f64>| -> Vec<(f64, f64)> {
        values.enumerate().map(|(i, value)| ((i + 1) as f64, value)).collect()
    };
    let mut lines = vec![Line::new("features", SERIES[0], numbered(&mut own.iter().copied()))];
    let caption = match optimal(material, own.len()) {
        Ok((responses, note)) => {
            let best: Vec<f64> = responses.responses().iter().map(|response| response.slowness).collect();
            let ratio = |n: usize| {
                let pairs = own.iter().zip(&best).take(n).filter(|(a, b)| **a > 0.0 && **b > 0.0);
                let (sum, count) = pairs.fold((0.0, 0.0), |(sum, count), (a, b)| (sum + (a / b).ln(), count + 1.0));
                (sum / f64::max(count, 1.0)).exp()
            };
            let first = own.len().min(10);
            let line = Line::new("optimal responses", SERIES[1], numbered(&mut best.iter().copied()));
            lines.push(line.drawn(Stroke::Dashed));
            format!(
                "Lower is slower. Optimal: the slowest there could be for a robot of this speed that knew its pose and moved \
                 evenly through the whole room (thesis §4.1.2); uneven motion can be slower. The first {first} features are \
                 {:.2} times as fast as these, all {} are {:.2} times as fast (geometric means).{note}",
                ratio(first),
                own.len(),
                ratio(own.len())
            )
        }
        Err(reason) => format!("Lower is slower. The optimal responses are missing: {reason}."),
    };
    let title = "Slowness of all features";
    let x =
        if own.len() > 30 { Axis::log("feature, from the slowest") } else { Axis::new("feature, from the slowest") };
    let svg = Chart::new(title, x, Axis::log("slowness Δ, 1/s²"), lines).svg()?;
    Ok(vec![Item::Figure(Figure::new("slowness", title, caption, svg))])
}
