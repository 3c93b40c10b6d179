//! Charts of lines over one axis, with bands, linear or logarithmic.

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;

use super::{Area, DrawError, Drawn, FAINT, INK, SMALL, TEXT, TOP, WIDTH, sheet, short, text, width_of};

/// An axis of a chart.
#[derive(Debug, Clone, Default)]
pub struct Axis {
    /// What it measures, with its unit.
    pub label: String,
    /// Its ends; by default those of the data.
    pub range: Option<(f64, f64)>,
    /// Logarithmic: only what is positive is shown.
    pub log: bool,
}

impl Axis {
    /// A linear axis as long as the data.
    pub fn new(label: &str) -> Self {
        Axis { label: label.to_owned(), ..Axis::default() }
    }

    /// A logarithmic axis as long as the data.
    pub fn log(label: &str) -> Self {
        Axis { log: true, ..Axis::new(label) }
    }

    /// The same axis with other ends.
    #[must_use]
    pub fn within(mut self, low: f64, high: f64) -> Self {
        self.range = Some((low, high));
        self
    }

    /// Whether a coordinate can be shown.
    fn shows(&self, value: f64) -> bool {
        value.is_finite() && (!self.log || value > 0.0)
    }

    /// Ends that hold all values; `from_zero`: a linear axis begins there if all values are positive.
    fn ends(&self, values: impl Iterator<Item = f64>, from_zero: bool) -> (f64, f64) {
        if let Some((low, high)) = self.range {
            return if high > low { (low, high) } else { (low, low + 1.0) };
        }
        let shown = values.filter(|&value| self.shows(value));
        let (low, high) = shown.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            return if self.log { (0.1, 1.0) } else { (0.0, 1.0) };
        }
        if self.log {
            return (0.8 * low, 1.25 * high);
        }
        // What begins near zero begins there.
        let near = from_zero || low < 0.3 * high;
        let low = if near && low >= 0.0 { 0.0 } else { low };
        let high = if high > low { high } else { low + 1.0 };
        // Room above the highest line, and below the lowest if that is not the axis.
        let room = if from_zero { 0.05 * (high - low) } else { 0.0 };
        (if low < 0.0 { low - room } else { low }, high + room)
    }
}

/// An axis with its ends, and round numbers at its grid lines.
#[derive(Clone)]
struct Span {
    log: bool,
    low: f64,
    high: f64,
}

impl Span {
    /// Where a value is, from 0 to 1 along the axis; what is beyond its ends is at them.
    fn place(&self, value: f64) -> f64 {
        let value = value.clamp(self.low, self.high);
        if self.log {
            (value.ln() - self.low.ln()) / (self.high.ln() - self.low.ln())
        } else {
            (value - self.low) / (self.high - self.low)
        }
    }

    /// Round numbers between the ends.
    fn ticks(&self) -> Vec<f64> {
        if self.log {
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

impl Ranged for Span {
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

impl ValueFormatter<f64> for Span {
    fn format(value: &f64) -> String {
        short(*value)
    }
}

/// How a line is drawn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Mark {
    /// A line.
    #[default]
    Line,
    /// A line with a dot at each point.
    Points,
    /// Dots alone.
    Dots,
    /// A dashed line.
    Dashed,
}

/// A line of a chart.
#[derive(Debug, Clone)]
pub struct Line {
    /// Its name in the legend; none without.
    pub name: String,
    /// Its colour.
    pub colour: RGBColor,
    /// Its points; where a number is not finite there is a gap.
    pub points: Vec<(f64, f64)>,
    /// A band around it: x, lower and upper end. May be empty.
    pub band: Vec<(f64, f64, f64)>,
    /// How it is drawn.
    pub mark: Mark,
}

impl Line {
    /// A plain line.
    pub fn new(name: &str, colour: RGBColor, points: Vec<(f64, f64)>) -> Self {
        Line { name: name.to_owned(), colour, points, band: Vec::new(), mark: Mark::Line }
    }

    /// The same line, drawn otherwise.
    #[must_use]
    pub fn drawn(mut self, mark: Mark) -> Self {
        self.mark = mark;
        self
    }

    /// The same line with a band: x, lower and upper end.
    #[must_use]
    pub fn with_band(mut self, band: Vec<(f64, f64, f64)>) -> Self {
        self.band = band;
        self
    }
}

/// A chart.
#[derive(Debug, Clone)]
pub struct Chart {
    /// What it shows.
    pub title: String,
    /// The axis across.
    pub x: Axis,
    /// The axis upwards; a linear one begins at zero unless its range says otherwise.
    pub y: Axis,
    /// Lines, the last one on top.
    pub lines: Vec<Line>,
    /// Height, pixels.
    pub height: u32,
}

impl Chart {
    /// A chart of the usual height.
    pub fn new(title: &str, x: Axis, y: Axis, lines: Vec<Line>) -> Self {
        Chart { title: title.to_owned(), x, y, lines, height: 330 }
    }

    /// The chart as an SVG text.
    ///
    /// # Errors
    /// [`DrawError::Draw`].
    pub fn svg(&self) -> Result<String, DrawError> {
        let points = || self.lines.iter().flat_map(|line| &line.points);
        let bands = || self.lines.iter().flat_map(|line| &line.band);
        let (left, right) = self.x.ends(points().map(|p| p.0).chain(bands().map(|b| b.0)), false);
        let ys = points().map(|p| p.1).chain(bands().flat_map(|b| [b.1, b.2]));
        let (low, high) = self.y.ends(ys, true);
        let named = self.lines.iter().filter(|line| !line.name.is_empty());
        let named: Vec<Entry<'_>> = named
            .map(|line| Entry { colour: line.colour, name: &line.name, dashed: line.mark == Mark::Dashed })
            .collect();
        let key_height = key_height(&named);
        sheet(&self.title, (WIDTH, self.height + key_height), |root| {
            key(root, TOP as i32, &named)?;
            let top = TOP + key_height;
            let inner = root.clone().shrink((0, top), (WIDTH, self.height + key_height - top));
            let mut builder = ChartBuilder::on(&inner);
            builder.margin_right(18).margin_top(6).x_label_area_size(48).y_label_area_size(66);
            let x = Span { log: self.x.log, low: left, high: right };
            let y = Span { log: self.y.log, low, high };
            self.fill(builder.build_cartesian_2d(x, y)?)
        })
    }

    fn fill<'a>(&self, mut chart: ChartContext<'a, SVGBackend<'a>, Cartesian2d<Span, Span>>) -> Drawn {
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(FAINT)
            .axis_style(INK.mix(0.4))
            .label_style(text(SMALL))
            .axis_desc_style(text(TEXT))
            .x_desc(&self.x.label)
            .y_desc(&self.y.label)
            .draw()?;
        for line in &self.lines {
            let band: Vec<_> = line
                .band
                .iter()
                .filter(|band| self.x.shows(band.0) && self.y.shows(band.1) && self.y.shows(band.2))
                .collect();
            if band.len() > 1 {
                let there = band.iter().map(|band| (band.0, band.1));
                let back = band.iter().rev().map(|band| (band.0, band.2));
                let around: Vec<_> = there.chain(back).collect();
                chart.draw_series([Polygon::new(around, line.colour.mix(0.2))])?;
            }
        }
        for line in &self.lines {
            let colour = line.colour;
            for part in line.points.split(|&(x, y)| !self.x.shows(x) || !self.y.shows(y)) {
                let part = part.iter().copied();
                match line.mark {
                    Mark::Line | Mark::Points => {
                        chart.draw_series(LineSeries::new(part.clone(), colour.stroke_width(2)))?;
                    }
                    Mark::Dots => {}
                    Mark::Dashed => {
                        chart.draw_series(DashedLineSeries::new(part.clone(), 6, 4, colour.stroke_width(2)))?;
                    }
                }
                if matches!(line.mark, Mark::Points | Mark::Dots) {
                    chart.draw_series(part.map(|point| Circle::new(point, 3, colour.filled())))?;
                }
            }
        }
        Ok(())
    }
}

const KEY_LINE: u32 = 22;

/// An entry of a legend.
pub(super) struct Entry<'a> {
    pub colour: RGBColor,
    pub name: &'a str,
    pub dashed: bool,
}

/// The places of a legend's entries, and the number of its lines.
fn key_places(entries: &[Entry<'_>]) -> (Vec<(i32, i32)>, u32) {
    let (mut x, mut line, mut places) = (10, 0, Vec::new());
    for entry in entries {
        let width = 24 + width_of(entry.name, TEXT) + 16;
        if x > 10 && x + width > WIDTH as i32 {
            (x, line) = (10, line + 1);
        }
        places.push((x, line));
        x += width;
    }
    (places, if entries.is_empty() { 0 } else { line as u32 + 1 })
}

/// Pixels that a legend takes.
pub(super) fn key_height(entries: &[Entry<'_>]) -> u32 {
    key_places(entries).1 * KEY_LINE
}

/// A legend above a drawing: a patch of colour, in two pieces for a dashed line, and a name for each entry.
pub(super) fn key(root: &Area<'_>, top: i32, entries: &[Entry<'_>]) -> Drawn {
    for (entry, (x, line)) in entries.iter().zip(key_places(entries).0) {
        let y = top + line * KEY_LINE as i32;
        let pieces: &[(i32, i32)] = if entry.dashed { &[(0, 6), (10, 16)] } else { &[(0, 16)] };
        for (from, to) in pieces {
            root.draw(&Rectangle::new([(x + from, y + 4), (x + to, y + 12)], entry.colour.filled()))?;
        }
        root.draw(&Text::new(entry.name.to_owned(), (x + 22, y), text(TEXT)))?;
    }
    Ok(())
}
