//! Line charts with bands, and maps of features over a room, as SVG.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;

use super::Band;

/// What plotters reports.
pub type DrawError = DrawingAreaErrorKind<std::io::Error>;

const INK: RGBColor = RGBColor(40, 44, 52);
const GRID: RGBColor = RGBColor(228, 228, 228);
/// Colours of lines, told apart by people who see few colours, too (Okabe & Ito).
const COLOURS: [RGBColor; 9] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(150, 110, 0),
    RGBColor(90, 90, 90),
    RGBColor(120, 30, 120),
    RGBColor(30, 90, 40),
];
const SIZE: (u32, u32) = (820, 440);
/// Width of the legend at the right, pixels, and the letters that have room in a line of it.
const LEGEND: u32 = 220;
const LETTERS: usize = 27;
/// Lines of more points than these are drawn without dots.
const MOST_DOTS: usize = 40;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

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
}

/// An axis.
#[derive(Debug, Clone)]
pub struct Scale {
    /// What it measures, with its unit.
    pub name: String,
    /// Whether it is logarithmic.
    pub log: bool,
    /// Ends; those of the lines where it has none.
    pub ends: (Option<f64>, Option<f64>),
}

impl Scale {
    /// An axis over whatever the lines need.
    pub fn new(name: &str) -> Self {
        Scale { name: name.to_owned(), log: false, ends: (None, None) }
    }

    /// The same on a logarithmic scale.
    pub fn log(self) -> Self {
        Scale { log: true, ..self }
    }

    /// The same with fixed ends.
    pub fn within(self, low: f64, high: f64) -> Self {
        Scale { ends: (Some(low), Some(high)), ..self }
    }

    /// The ends over some values, with a little room; those above 0 on a logarithmic scale.
    fn range(&self, values: impl Iterator<Item = f64>) -> (f64, f64) {
        let usable = values.filter(|value| value.is_finite() && (!self.log || *value > 0.0));
        let (low, high) = usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low <= high { (low, high) } else { (0.1, 1.0) };
        let (low, high) = if self.log {
            (low / 1.1, high * 1.1)
        } else {
            let room = 0.04 * (high - low).max(1e-9 * high.abs()).max(1e-12);
            (if low >= 0.0 && low < 0.3 * high { 0.0 } else { low - room }, high + room)
        };
        (self.ends.0.unwrap_or(low), self.ends.1.unwrap_or(high))
    }
}

/// One axis of a chart: with its ends, and round numbers at its grid lines.
#[derive(Clone)]
struct Drawn<'a> {
    scale: &'a Scale,
    low: f64,
    high: f64,
}

impl<'a> Drawn<'a> {
    fn new(scale: &'a Scale, values: impl Iterator<Item = f64>) -> Self {
        let (low, high) = scale.range(values);
        Drawn { scale, low, high }
    }

    /// Where a value is, from 0 to 1 along the axis; what is beyond its ends is at them.
    fn place(&self, value: f64) -> f64 {
        let value = value.clamp(self.low, self.high);
        if self.scale.log {
            (value.ln() - self.low.ln()) / (self.high.ln() - self.low.ln())
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// Round numbers between the ends.
    fn ticks(&self) -> Vec<f64> {
        if self.scale.log {
            let steps: &[f64] = if self.high / self.low > 300.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
            let decades = self.low.log10().floor() as i32..=self.high.log10().ceil() as i32;
            let all = decades.flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)));
            return all.filter(|tick| (self.low..=self.high).contains(tick)).collect();
        }
        let rough = (self.high - self.low) / 6.0;
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 2.5, 5.0, 10.0].map(|step| step * decade).into_iter().find(|step| *step >= rough);
        let step = step.unwrap_or(10.0 * decade);
        let (first, last) = ((self.low / step).ceil() as i64, (self.high / step).floor() as i64);
        (first..=last).map(|tick| tick as f64 * step).collect()
    }
}

impl Ranged for Drawn<'_> {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (from, to): (i32, i32)) -> i32 {
        from + (self.place(*value) * f64::from(to - from)).round() as i32
    }

    fn key_points<H: KeyPointHint>(&self, _: H) -> Vec<f64> {
        self.ticks()
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Drawn<'_> {
    fn format(value: &f64) -> String {
        let digits = if value.abs() >= 100.0 || value.abs() < 1e-9 { 0 } else { 3 };
        let text = format!("{value:.digits$}");
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    }
}

/// A chart of lines with a legend beside it.
///
/// # Errors
/// What the drawing library refuses.
pub fn chart(title: &str, (x, y): (&Scale, &Scale), lines: &[Line]) -> Result<String, DrawError> {
    let points = || lines.iter().flat_map(|line| &line.points);
    let x = Drawn::new(x, points().map(|point| point.0));
    let y = Drawn::new(y, points().flat_map(|(_, band)| [band.low, band.high, band.mean]));
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        root.draw(&Text::new(title.to_owned(), (14, 12), text(16).transform(FontTransform::None)))?;
        let area = root.clone().shrink((0, 36), (SIZE.0 - LEGEND, SIZE.1 - 36));
        draw(&area, (&x, &y), lines)?;
        legend(&root.clone().shrink((SIZE.0 - LEGEND + 8, 48), (LEGEND - 8, SIZE.1 - 48)), lines)?;
        root.present()?;
    }
    Ok(svg)
}

fn text(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

fn draw(area: &Area<'_>, (x, y): (&Drawn<'_>, &Drawn<'_>), lines: &[Line]) -> Result<(), DrawError> {
    let mut chart = ChartBuilder::on(area)
        .margin_right(10)
        .margin_left(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(x.clone(), y.clone())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(GRID)
        .axis_style(INK.mix(0.4))
        .label_style(text(12))
        .x_desc(x.scale.name.as_str())
        .y_desc(y.scale.name.as_str())
        .draw()?;
    for line in lines {
        let colour = COLOURS[line.colour % COLOURS.len()];
        let at = |of: fn(&Band) -> f64| line.points.iter().map(move |(place, band)| (*place, of(band)));
        if line.points.iter().any(|(_, band)| band.high > band.low) {
            let rim: Vec<_> =
                at(|band| band.low).chain(at(|band| band.high).collect::<Vec<_>>().into_iter().rev()).collect();
            chart.draw_series([Polygon::new(rim, colour.mix(0.18))])?;
        }
    }
    for line in lines {
        let colour = COLOURS[line.colour % COLOURS.len()];
        let way: Vec<_> = line.points.iter().map(|(place, band)| (*place, band.mean)).collect();
        if line.dashed {
            chart.draw_series(DashedLineSeries::new(way, 6, 4, colour.stroke_width(2)))?;
        } else {
            chart.draw_series(LineSeries::new(way.iter().copied(), colour.stroke_width(2)))?;
            if way.len() <= MOST_DOTS {
                chart.draw_series(way.into_iter().map(|point| Circle::new(point, 3, colour.filled())))?;
            }
        }
    }
    Ok(())
}

/// The lines' names, one under the other.
fn legend(area: &Area<'_>, lines: &[Line]) -> Result<(), DrawError> {
    let mut top = 0;
    for line in lines {
        let colour = COLOURS[line.colour % COLOURS.len()];
        let pieces: &[(i32, i32)] = if line.dashed { &[(0, 6), (10, 16), (20, 24)] } else { &[(0, 24)] };
        for &(from, to) in pieces {
            area.draw(&PathElement::new([(from, top + 7), (to, top + 7)], colour.stroke_width(2)))?;
        }
        for part in wrapped(&line.name, LETTERS) {
            area.draw(&Text::new(part, (30, top), text(12)))?;
            top += 16;
        }
        top += 5;
    }
    Ok(())
}

/// Words in lines of at most so many letters, where they have spaces.
fn wrapped(name: &str, letters: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in name.split(' ') {
        let last =
            lines.last_mut().filter(|line| line.is_empty() || line.chars().count() + word.chars().count() < letters);
        match last {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) => *line = format!("{line} {word}"),
            None => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers_between_the_ends() {
        let linear = Scale::new("steps").within(0.3, 7.1);
        let ticks = Drawn::new(&linear, std::iter::empty()).ticks();
        assert_eq!(ticks, [2.0, 4.0, 6.0]);
        let log = Scale::new("vectors").log().within(90.0, 900.0);
        let drawn = Drawn::new(&log, std::iter::empty());
        let labels: Vec<String> = drawn.ticks().iter().map(Drawn::format).collect();
        assert_eq!(labels, ["100", "200", "500"]);
        assert!((drawn.place(900.0) - 1.0).abs() < 1e-12 && drawn.place(0.0) == 0.0);
    }

    #[test]
    fn a_chart_has_its_lines_bands_and_names() {
        let bands = [(1.0, Band::of(&[1.0, 2.0])), (2.0, Band::of(&[3.0, 5.0])), (3.0, None)];
        let lines = [Line::new("a < b", 0, bands), Line::level("optimum", 6, (1.0, 3.0), 4.0)];
        let svg = chart("Title", (&Scale::new("x"), &Scale::new("y")), &lines).unwrap();
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
