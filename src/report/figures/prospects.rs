//! What the robot expected of its pursuits, beside what came of them.

use super::learning::GREY;
use super::{Figure, Item, Material, Section};
use crate::evaluate::wilson_low;
use crate::report::draw::{Axis, Chart, DrawError, Line, SERIES, Stroke};
use crate::report::gather::Pursued;

/// Pursuits of a group at least, and groups at most.
const GROUP: usize = 10;
const GROUPS: usize = 6;

pub fn section(material: &Material<'_>) -> Result<Section, DrawError> {
    let mut pursued: Vec<&Pursued> = material.gathered.pursued.iter().collect();
    let mut items = Vec::new();
    if pursued.len() < GROUP {
        // A short run lacks nothing.
        items.push(Item::Text(format!(
            "What it expected cannot be held against what came of it: the log holds {} pursuits of which something was expected \
             (/adagio/prospect, with local values), and {GROUP} are needed.",
            pursued.len()
        )));
    } else {
        pursued.sort_by(|a, b| a.arrival.total_cmp(&b.arrival));
        items.push(Item::Figure(calibration(&pursued)?));
        items.push(Item::Figure(actions(&pursued)?));
    }
    Ok(Section { name: "prospects", heading: "What it expected", items })
}

/// Groups of pursuits that are about as many, in their order.
fn groups<'a, 'b>(sorted: &'a [&'b Pursued]) -> impl Iterator<Item = &'a [&'b Pursued]> {
    let count = (sorted.len() / GROUP).clamp(1, GROUPS);
    (0..count).map(move |k| &sorted[k * sorted.len() / count..(k + 1) * sorted.len() / count])
}

fn calibration(sorted: &[&Pursued]) -> Result<Figure, DrawError> {
    let of = |group: &[&Pursued]| {
        let (n, arrived) = (group.len(), group.iter().filter(|pursued| pursued.arrived).count());
        let stated = group.iter().map(|pursued| pursued.arrival).sum::<f64>() / n as f64;
        (stated, arrived as f64 / n as f64, wilson_low(arrived, n), 1.0 - wilson_low(n - arrived, n))
    };
    let groups: Vec<_> = groups(sorted).map(of).collect();
    let points = groups.iter().map(|group| (group.0, group.1)).collect();
    let band = groups.iter().map(|group| (group.0, group.2, group.3)).collect();
    let lines = vec![
        Line::new("as stated", GREY, vec![(0.0, 0.0), (1.0, 1.0)]).drawn(Stroke::Dashed),
        Line::new("groups of pursuits", SERIES[0], points).drawn(Stroke::Points).with_band(band),
    ];
    let axis = |label: &str| Axis::new(label).within(0.0, 1.05);
    let title = "Probability of arriving: stated and true";
    let chart = Chart::new(title, axis("stated when the pursuit began"), axis("share that arrived in time"), lines);
    let error = |pursued: &&Pursued| (pursued.arrival - f64::from(u8::from(pursued.arrived))).powi(2);
    let brier = sorted.iter().map(error).sum::<f64>() / sorted.len() as f64;
    let caption = format!(
        "{} pursuits while driving, grouped by what was stated; the band is the 95 % interval of each share. Brier score {brier:.3} \
         (0: always right and sure of it; 0.25: always even).",
        sorted.len()
    );
    Ok(Figure::new("stated-and-true", title, caption, chart.svg()?))
}

fn actions(sorted: &[&Pursued]) -> Result<Figure, DrawError> {
    let arrived: Vec<&&Pursued> = sorted.iter().filter(|pursued| pursued.arrived).collect();
    let points: Vec<(f64, f64)> =
        arrived.iter().map(|pursued| (pursued.expected, f64::from(pursued.actions))).collect();
    let most = points.iter().flat_map(|&(x, y)| [x, y]).fold(1.0, f64::max);
    let mut multiples: Vec<f64> = points.iter().map(|(expected, took)| took / expected).collect();
    multiples.sort_by(f64::total_cmp);
    let quantile = |share: f64| multiples.get((multiples.len() as f64 * share) as usize).copied().unwrap_or(f64::NAN);
    let caption = format!(
        "{} pursuits that arrived took {:.2} times as many actions as expected in the median; eight of ten {:.2} to {:.2} times.",
        points.len(),
        quantile(0.5),
        quantile(0.1),
        quantile(0.9)
    );
    let lines = vec![
        Line::new("as expected", GREY, vec![(0.0, 0.0), (most, most)]).drawn(Stroke::Dashed),
        Line::new("pursuits that arrived", SERIES[0], points).drawn(Stroke::Dots),
    ];
    let title = "Actions until the goal: expected and taken";
    let chart = Chart::new(title, Axis::new("expected when the pursuit began"), Axis::new("taken"), lines);
    Ok(Figure::new("expected-and-taken", title, caption, chart.svg()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_about_as_large_and_hold_all() {
        let pursued = Pursued { expected: 10.0, arrival: 0.5, actions: 12, arrived: true };
        let sizes = |n: usize| groups(&vec![&pursued; n]).map(<[_]>::len).collect::<Vec<_>>();
        assert_eq!(sizes(10), [10]);
        assert_eq!(sizes(35), [11, 12, 12]);
        assert_eq!(sizes(100), [16, 17, 17, 16, 17, 17]);
    }
}
