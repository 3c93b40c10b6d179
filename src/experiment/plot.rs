//! Charts of an experiment: lines through several trials, with bands.

use super::Band;
use crate::report::draw::{self, Axis, Chart, DrawError, SERIES, Stroke};

/// Height of a chart, pixels.
const HEIGHT: u32 = 360;
/// Lines of more points than these are drawn without dots.
const MOST_DOTS: usize = 40;

/// A line: its name and its points, with bands where there are several numbers.
#[derive(Debug, Clone)]
pub struct Line {
    /// For the legend.
    pub name: String,
    /// Place on the horizontal axis, and what is there.
    pub points: Vec<(f64, Band)>,
    /// Drawn dashed, as what is only to be compared with.
    pub dashed: bool,
    /// Which colour; lines of one thing have one colour.
    pub colour: usize,
}

impl Line {
    /// A line through bands; places without any are left out.
    pub fn new(name: impl Into<String>, colour: usize, points: impl IntoIterator<Item = (f64, Option<Band>)>) -> Self {
        let points = points.into_iter().filter_map(|(x, band)| Some((x, band?))).collect();
        Line { name: name.into(), points, dashed: false, colour }
    }

    /// A level from one end of the chart to the other.
    pub fn level(name: impl Into<String>, colour: usize, (from, to): (f64, f64), level: f64) -> Self {
        let at = Band { mean: level, deviation: 0.0, low: level, high: level, count: 1 };
        Line { name: name.into(), points: vec![(from, at), (to, at)], dashed: true, colour }
    }

    /// The same line, dashed.
    pub fn dashed(self) -> Self {
        Line { dashed: true, ..self }
    }

    fn drawn(&self) -> draw::Line {
        let stroke = match self.points.len() {
            _ if self.dashed => Stroke::Dashed,
            ..=MOST_DOTS => Stroke::Points,
            _ => Stroke::Line,
        };
        let means = self.points.iter().map(|(x, band)| (*x, band.mean)).collect();
        let line = draw::Line::new(&self.name, SERIES[self.colour % SERIES.len()], means).drawn(stroke);
        if self.points.iter().all(|(_, band)| band.high <= band.low) {
            return line;
        }
        line.with_band(self.points.iter().map(|(x, band)| (*x, band.low, band.high)).collect())
    }
}

/// A chart of lines with a legend above it: the name of its file, and an SVG text.
pub fn chart(file: &str, title: &str, (x, y): (&Axis, &Axis), lines: &[Line]) -> Result<(String, String), DrawError> {
    let lines = lines.iter().map(Line::drawn).collect();
    Ok((file.to_owned(), Chart { height: HEIGHT, ..Chart::new(title, x.clone(), y.clone(), lines) }.svg()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_has_its_lines_bands_and_names() {
        let bands = [(1.0, Band::of([1.0, 2.0])), (2.0, Band::of([3.0, 5.0])), (3.0, None)];
        let lines = [Line::new("a < b", 0, bands), Line::level("optimum", 6, (1.0, 3.0), 4.0)];
        let (_, svg) = chart("a.svg", "Title", (&Axis::new("x"), &Axis::new("y")), &lines).unwrap();
        let document = roxmltree::Document::parse(&svg).unwrap();
        let texts: Vec<String> =
            document.descendants().filter_map(|node| node.text()).map(|t| t.trim().to_owned()).collect();
        for name in ["Title", "x", "y", "a < b", "optimum"] {
            assert!(texts.iter().any(|text| text == name), "{name} is not in {texts:?}");
        }
        assert_eq!(document.descendants().filter(|node| node.has_tag_name("polygon")).count(), 1);
        assert_eq!(document.descendants().filter(|node| node.has_tag_name("circle")).count(), 2);
    }
}
