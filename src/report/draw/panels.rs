//! Rooms and maps from above: one large, or many small ones side by side, in one scale of colours.

use ::image::ExtendedColorType;
use plotters::prelude::*;

use super::chart::{Entry, key, key_height};
use super::{
    Area, DrawError, Drawn, INK, SMALL, TEXT, TOP, WIDTH, behind, data_url, png_bytes, sheet, short, text, width_of,
};
use crate::evaluate::Grid;

/// What the colours of a grid's values mean.
#[derive(Debug, Clone)]
pub enum Colours {
    /// From light to dark between two values.
    Sequential(f64, f64),
    /// From blue over white to red, between minus and plus a value.
    Diverging(f64),
    /// Whole numbers from 0 on, each with its colour and name.
    Classes(Vec<(RGBColor, String)>),
}

/// Lightness falls evenly, and dark marks can be read on all of them.
const SEQUENTIAL: [[f64; 3]; 4] =
    [[250.0, 247.0, 232.0], [207.0, 226.0, 214.0], [145.0, 192.0, 202.0], [84.0, 146.0, 187.0]];
const DIVERGING: [[f64; 3]; 5] =
    [[33.0, 84.0, 156.0], [136.0, 178.0, 214.0], [246.0, 246.0, 243.0], [232.0, 158.0, 128.0], [165.0, 30.0, 44.0]];

/// Shades of a scale; fewer make smaller files.
const SHADES: f64 = 96.0;

fn ramp(stops: &[[f64; 3]], share: f64) -> RGBColor {
    let share = (share.clamp(0.0, 1.0) * SHADES).round() / SHADES;
    let place = share * (stops.len() - 1) as f64;
    let below = (place as usize).min(stops.len() - 2);
    let part = place - below as f64;
    let [r, g, b] = [0, 1, 2].map(|c| (stops[below][c] + (stops[below + 1][c] - stops[below][c]) * part) as u8);
    RGBColor(r, g, b)
}

impl Colours {
    /// The colour of a value; none for what is not a number.
    pub fn of(&self, value: f64) -> Option<RGBColor> {
        if !value.is_finite() {
            return None;
        }
        Some(match self {
            Colours::Sequential(low, high) => ramp(&SEQUENTIAL, (value - low) / (high - low).max(f64::MIN_POSITIVE)),
            Colours::Diverging(most) => ramp(&DIVERGING, 0.5 + 0.5 * value / most.max(f64::MIN_POSITIVE)),
            Colours::Classes(classes) => classes.get(value as usize)?.0,
        })
    }

    /// Ends of the scale.
    fn ends(&self) -> Option<(f64, f64)> {
        match *self {
            Colours::Sequential(low, high) => Some((low, high)),
            Colours::Diverging(most) => Some((-most, most)),
            Colours::Classes(_) => None,
        }
    }
}

/// Something drawn into a room; places in metres, sizes of symbols in pixels.
#[derive(Debug, Clone)]
pub enum Mark {
    /// A line through points.
    Line(Vec<[f64; 2]>, RGBAColor, u32),
    /// A disc with its rim: centre, radius in metres.
    Disc([f64; 2], f64, RGBColor),
    /// A dot: centre, radius in pixels.
    Dot([f64; 2], i32, RGBAColor),
    /// A cross: centre, half its width in pixels.
    Cross([f64; 2], i32, RGBColor),
    /// An arrow around a place: heading in radians, length in pixels.
    Arrow([f64; 2], f64, f64, RGBColor),
}

/// One room or map.
#[derive(Debug, Clone, Default)]
pub struct Panel {
    /// What it shows, above it.
    pub label: String,
    /// Values on the grid, NaN where there are none; or nothing at all.
    pub values: Vec<f64>,
    /// What is drawn above that, and above the outline.
    pub marks: Vec<Mark>,
}

impl Panel {
    /// Marks without values and label.
    pub fn of(marks: Vec<Mark>) -> Self {
        Panel { marks, ..Panel::default() }
    }
}

/// Rooms or maps side by side.
#[derive(Debug, Clone)]
pub struct Panels {
    /// What they show.
    pub title: String,
    /// Corners of what each of them shows, metres.
    pub low: [f64; 2],
    /// The highest corner.
    pub high: [f64; 2],
    /// Where their values are.
    pub grid: Option<Grid>,
    /// Colours of their values.
    pub colours: Colours,
    /// What the values are.
    pub scale: String,
    /// What is drawn above the values of each of them.
    pub outline: Vec<Mark>,
    /// The panels, row by row.
    pub panels: Vec<Panel>,
    /// Panels in a row.
    pub per_row: usize,
    /// Whether there are numbers at the edges: metres.
    pub axes: bool,
    /// Colours and names of what is drawn.
    pub key: Vec<(RGBColor, String)>,
}

/// Where things are on the sheet, pixels.
struct Layout {
    left: f64,
    top: f64,
    width: f64,
    height: f64,
    label: f64,
    gap: f64,
    per_row: usize,
}

/// Tallest room, pixels.
const TALLEST: f64 = 600.0;
const MARGIN: f64 = 10.0;
/// Room for the numbers at the axes, pixels.
const NUMBERS: (f64, f64) = (44.0, 42.0);
/// Room for the scale of colours, pixels.
const SCALE: u32 = 58;

/// A legend of patches.
fn entries(named: &[(RGBColor, String)]) -> Vec<Entry<'_>> {
    named.iter().map(|(colour, name)| Entry { colour: *colour, name, dashed: false }).collect()
}

impl Panels {
    /// One large panel or several, without values, numbers or a legend.
    pub fn new(title: &str, (low, high): ([f64; 2], [f64; 2]), panels: Vec<Panel>) -> Self {
        Panels {
            title: title.to_owned(),
            low,
            high,
            grid: None,
            colours: Colours::Sequential(0.0, 1.0),
            scale: String::new(),
            outline: Vec::new(),
            panels,
            per_row: 1,
            axes: false,
            key: Vec::new(),
        }
    }

    fn layout(&self) -> Layout {
        let per_row = self.per_row.max(1);
        let left = if self.axes { NUMBERS.0 } else { MARGIN };
        let gap = 10.0;
        let all = f64::from(WIDTH) - left - MARGIN - gap * (per_row - 1) as f64;
        let [wide, high] = [0, 1].map(|axis| (self.high[axis] - self.low[axis]).max(1e-9));
        let width = (all / per_row as f64).min(TALLEST * wide / high).floor();
        let label = if self.panels.iter().any(|panel| !panel.label.is_empty()) { 20.0 } else { 0.0 };
        // The name of the axis upwards stands above it.
        let above = if self.axes { 14 } else { 0 };
        let top = f64::from(TOP + key_height(&entries(&self.key)) + above);
        Layout { left, top, width, height: (width * high / wide).ceil(), label, gap, per_row }
    }

    /// The drawing as an SVG text.
    ///
    /// # Errors
    /// [`DrawError`].
    pub fn svg(&self) -> Result<String, DrawError> {
        let layout = self.layout();
        let rows = self.panels.len().div_ceil(layout.per_row);
        let below = if self.axes { NUMBERS.1 } else { 0.0 };
        let bottom = layout.top + rows as f64 * (layout.label + layout.height + layout.gap) + below;
        let scaled = self.panels.iter().any(|panel| !panel.values.is_empty());
        let size = (WIDTH, bottom as u32 + if scaled { SCALE } else { 0 });
        let mut images = String::new();
        for (panel, corner) in self.panels.iter().zip(corners(&layout)) {
            images += &self.image(panel, &layout, corner)?;
        }
        let mut svg = sheet(&self.title, size, |root| {
            key(root, TOP as i32, &entries(&self.key))?;
            for (panel, corner) in self.panels.iter().zip(corners(&layout)) {
                if layout.label > 0.0 {
                    let at = (corner[0] as i32, (corner[1] - layout.label) as i32 + 1);
                    root.draw(&Text::new(panel.label.clone(), at, text(SMALL)))?;
                }
                for mark in self.outline.iter().chain(&panel.marks) {
                    self.mark(root, &layout, corner, mark)?;
                }
                if self.axes {
                    self.numbers(root, &layout, corner)?;
                }
            }
            if scaled { self.legend(root, bottom as i32 + 4) } else { Ok(()) }
        })?;
        behind(&mut svg, &images);
        Ok(svg)
    }

    /// Pixels of a place.
    fn at(&self, layout: &Layout, corner: [f64; 2], place: [f64; 2]) -> (i32, i32) {
        let scale = layout.width / (self.high[0] - self.low[0]).max(1e-9);
        let x = corner[0] + (place[0] - self.low[0]) * scale;
        let y = corner[1] + layout.height - (place[1] - self.low[1]) * scale;
        (x.round() as i32, y.round() as i32)
    }

    /// The values as one small image, stretched over the grid's box.
    fn image(&self, panel: &Panel, layout: &Layout, corner: [f64; 2]) -> Result<String, DrawError> {
        let Some(grid) = self.grid.filter(|grid| grid.columns * grid.rows == panel.values.len()) else {
            return Ok(String::new());
        };
        let mut pixels = Vec::with_capacity(4 * panel.values.len());
        for row in panel.values.chunks_exact(grid.columns).rev() {
            for &value in row {
                pixels.extend(self.colours.of(value).map_or([255, 255, 255, 0], |c| [c.0, c.1, c.2, 255]));
            }
        }
        let png = png_bytes((grid.columns, grid.rows), &pixels, ExtendedColorType::Rgba8)?;
        let (left, top) = self.at(layout, corner, [grid.low[0], grid.high[1]]);
        let (right, bottom) = self.at(layout, corner, [grid.high[0], grid.low[1]]);
        // Between classes there is nothing in between.
        let sharp = matches!(self.colours, Colours::Classes(_)) || panel.values.iter().any(|value| value.is_nan());
        let rendering =
            if sharp { " image-rendering=\"optimizeSpeed\" style=\"image-rendering:pixelated\"" } else { "" };
        Ok(format!(
            "\n<image x=\"{left}\" y=\"{top}\" width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\"{rendering} href=\"{}\"/>",
            right - left,
            bottom - top,
            data_url(&png)
        ))
    }

    fn mark(&self, root: &Area<'_>, layout: &Layout, corner: [f64; 2], mark: &Mark) -> Drawn {
        let at = |place: &[f64; 2]| self.at(layout, corner, *place);
        let scale = layout.width / (self.high[0] - self.low[0]).max(1e-9);
        match mark {
            Mark::Line(points, colour, width) => {
                let mut pixels: Vec<_> = points.iter().map(at).collect();
                pixels.dedup();
                root.draw(&PathElement::new(pixels, colour.stroke_width(*width)))
            }
            Mark::Disc(centre, radius, colour) => {
                let (centre, radius) = (at(centre), (radius * scale).round() as i32);
                root.draw(&Circle::new(centre, radius, colour.mix(0.45).filled()))?;
                root.draw(&Circle::new(centre, radius, colour.stroke_width(2)))
            }
            Mark::Dot(centre, radius, colour) => root.draw(&Circle::new(at(centre), *radius, colour.filled())),
            Mark::Cross(centre, half, colour) => {
                let ((x, y), half) = (at(centre), *half);
                let line = |ends| PathElement::new(ends, colour.stroke_width(2));
                root.draw(&line([(x - half, y - half), (x + half, y + half)]))?;
                root.draw(&line([(x - half, y + half), (x + half, y - half)]))
            }
            Mark::Arrow(place, heading, length, colour) => {
                let (x, y) = at(place);
                let pixel = |ahead: f64, aside: f64| {
                    let (dx, dy) =
                        (ahead * heading.cos() - aside * heading.sin(), ahead * heading.sin() + aside * heading.cos());
                    (x + (dx * length).round() as i32, y - (dy * length).round() as i32)
                };
                root.draw(&PathElement::new([pixel(-0.5, 0.0), pixel(0.2, 0.0)], colour))?;
                root.draw(&Polygon::new([pixel(0.5, 0.0), pixel(0.05, 0.25), pixel(0.05, -0.25)], colour.filled()))
            }
        }
    }

    /// Metres along both edges.
    fn numbers(&self, root: &Area<'_>, layout: &Layout, corner: [f64; 2]) -> Drawn {
        let (left, bottom) = (corner[0] as i32, (corner[1] + layout.height) as i32);
        for axis in [0, 1] {
            let (low, high) = (self.low[axis], self.high[axis]);
            let pixels = if axis == 0 { layout.width } else { layout.height };
            let step = round_step((high - low) / (pixels / 60.0).max(1.0));
            let first = (low / step).ceil() as i64;
            for i in (first..).take_while(|&i| i as f64 * step <= high) {
                let value = i as f64 * step;
                let label = short(value);
                let mut place = self.low;
                place[axis] = value;
                let (x, y) = self.at(layout, corner, place);
                if axis == 0 {
                    root.draw(&PathElement::new([(x, bottom), (x, bottom + 4)], INK.mix(0.5)))?;
                    root.draw(&Text::new(label.clone(), (x - width_of(&label, SMALL) / 2, bottom + 6), text(SMALL)))?;
                } else {
                    root.draw(&PathElement::new([(left - 4, y), (left, y)], INK.mix(0.5)))?;
                    root.draw(&Text::new(label.clone(), (left - 8 - width_of(&label, SMALL), y - 8), text(SMALL)))?;
                }
            }
        }
        let right = corner[0] + layout.width;
        root.draw(&Text::new("x, m", (right as i32 - 30, bottom + 22), text(SMALL)))?;
        root.draw(&Text::new("y, m", (4, corner[1] as i32 - 4), text(SMALL)))
    }

    /// The colours of the values, and what they are.
    fn legend(&self, root: &Area<'_>, top: i32) -> Drawn {
        const SLICES: i32 = 48;
        const LENGTH: i32 = 192;
        let Colours::Classes(classes) = &self.colours else {
            let Some((low, high)) = self.colours.ends() else { return Ok(()) };
            let width = LENGTH / SLICES;
            let mut x = MARGIN as i32;
            let numbers = [short(low), short(high)];
            root.draw(&Text::new(numbers[0].clone(), (x, top + 2), text(TEXT)))?;
            x += width_of(&numbers[0], TEXT) + 8;
            for slice in 0..SLICES {
                let value = low + (high - low) * (f64::from(slice) + 0.5) / f64::from(SLICES);
                let from = x + slice * width;
                let fill = self.colours.of(value).unwrap_or(WHITE).filled();
                root.draw(&Rectangle::new([(from, top), (from + width, top + 16)], fill))?;
            }
            x += LENGTH;
            root.draw(&Rectangle::new([(x - LENGTH, top), (x, top + 16)], INK.mix(0.4)))?;
            root.draw(&Text::new(numbers[1].clone(), (x + 8, top + 2), text(TEXT)))?;
            return root.draw(&Text::new(self.scale.clone(), (MARGIN as i32, top + 26), text(TEXT)));
        };
        key(root, top, &entries(classes))
    }
}

/// Upper left corners of the panels.
fn corners(layout: &Layout) -> impl Iterator<Item = [f64; 2]> + '_ {
    (0..).map(|i| {
        let (column, row) = (i % layout.per_row, i / layout.per_row);
        let x = layout.left + column as f64 * (layout.width + layout.gap);
        let y = layout.top + row as f64 * (layout.label + layout.height + layout.gap) + layout.label;
        [x, y]
    })
}

/// The next of 1, 2 and 5 times a power of ten.
fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.max(1e-9).log10().floor());
    [1.0, 2.0, 5.0].into_iter().map(|times| times * power).find(|&step| step >= least).unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round() {
        for (least, step) in [(0.3, 0.5), (0.11, 0.2), (5.1, 10.0), (1.0, 1.0)] {
            assert!((round_step(least) - step).abs() < 1e-12);
        }
    }

    #[test]
    fn a_grid_has_its_points_in_the_middle_of_its_cells() {
        let grid = Grid { columns: 2, rows: 2, low: [0.0, 0.0], high: [2.0, 4.0] };
        assert_eq!(grid.points().collect::<Vec<_>>(), [[0.5, 1.0], [1.5, 1.0], [0.5, 3.0], [1.5, 3.0]]);
    }

    #[test]
    fn colours_run_from_end_to_end_and_leave_out_what_is_no_number() {
        let colours = Colours::Diverging(2.0);
        assert_eq!(colours.of(-2.0), Some(RGBColor(33, 84, 156)));
        assert_eq!(colours.of(5.0), Some(RGBColor(165, 30, 44)));
        assert_eq!(colours.of(f64::NAN), None);
    }
}
