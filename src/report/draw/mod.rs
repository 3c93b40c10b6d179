//! Drawing for reports of all kinds: charts of lines with bands, rooms and maps from above, and pages to put them on.
//!
//! A drawing is an SVG text that refers to nothing outside of itself; [`png`] makes an image of it. All of one page are
//! [`WIDTH`] pixels wide, so that their letters can still be read on a phone.

mod chart;
mod gallery;
mod image;
mod page;
mod panels;
mod raster;

pub use chart::{Axis, Chart, Line, Mark as Stroke};
pub use gallery::{Picture, gallery};
pub use image::{data_url, enlarged, png_bytes, thinned};
pub use page::{Page, Table, escape};
pub use panels::{Colours, Mark, Panel, Panels};
pub use raster::png;

use plotters::coord::Shift;
use plotters::prelude::*;
use thiserror::Error;

/// Width of a drawing, pixels.
pub const WIDTH: u32 = 520;

/// Sizes of letters; the library's unit is 1.24 of a pixel's.
pub const TITLE: u32 = 21;
/// Labels of axes and legends.
pub const TEXT: u32 = 18;
/// Numbers at axes, labels of small maps.
pub const SMALL: u32 = 15;

/// Letters and frames.
pub const INK: RGBColor = RGBColor(40, 44, 52);
/// Lines of a grid.
pub const FAINT: RGBColor = RGBColor(226, 228, 232);

/// Colours of lines in their order: they differ in lightness, too.
pub const SERIES: [RGBColor; 9] = [
    RGBColor(38, 96, 150),
    RGBColor(214, 120, 40),
    RGBColor(46, 139, 87),
    RGBColor(150, 60, 130),
    RGBColor(120, 120, 120),
    RGBColor(170, 140, 20),
    RGBColor(30, 170, 180),
    RGBColor(230, 120, 150),
    RGBColor(110, 70, 30),
];

/// What went wrong.
pub const BAD: RGBColor = RGBColor(196, 38, 46);
/// Goals.
pub const GOAL: RGBColor = RGBColor(46, 139, 87);
/// The way of a robot.
pub const PATH: RGBColor = RGBColor(196, 78, 40);

/// A drawing area of an SVG text.
pub type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Why something cannot be drawn.
#[derive(Debug, Error)]
pub enum DrawError {
    /// The drawing library refuses.
    #[error("cannot draw {what:?}: {cause}")]
    Draw {
        /// Title of the drawing.
        what: String,
        /// What the library says.
        cause: DrawingAreaErrorKind<std::io::Error>,
    },
    /// An image cannot be encoded.
    #[error("cannot encode an image of {width} × {height} pixels: {cause}")]
    Encode {
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// What the encoder says.
        cause: ::image::ImageError,
    },
    /// An SVG text cannot be made into pixels.
    #[error("cannot make an image of a drawing: {0}")]
    Raster(String),
}

/// What drawing steps return.
pub type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

/// An SVG text of a size with a title, and what `draw` draws below it.
///
/// `draw` gets the whole area; the title takes [`TOP`] pixels of it.
///
/// # Errors
/// [`DrawError::Draw`].
pub fn sheet(title: &str, size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> Drawn) -> Result<String, DrawError> {
    let mut svg = String::new();
    let drawn = {
        let root = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        root.fill(&WHITE)
            .and_then(|()| root.draw(&Text::new(title.to_owned(), (10, 8), bold(TITLE))))
            .and_then(|()| draw(&root))
            .and_then(|()| root.present())
    };
    drawn.map_err(|cause| DrawError::Draw { what: title.to_owned(), cause })?;
    Ok(svg)
}

/// Pixels that a sheet's title takes.
pub const TOP: u32 = 38;

/// Letters of a size.
pub fn text(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().color(&INK)
}

/// Fat letters of a size.
pub fn bold(size: u32) -> TextStyle<'static> {
    ("sans-serif", size).into_font().style(FontStyle::Bold).color(&INK)
}

/// About how wide a text is, pixels: letters of the reader's font have about this width.
pub fn width_of(text: &str, size: u32) -> i32 {
    (0.47 * f64::from(size) * text.chars().count() as f64).ceil() as i32
}

/// Put elements behind all that was drawn, but before the background.
pub fn behind(svg: &mut String, elements: &str) {
    // The first element is the root, the second the background's rectangle.
    let end = svg.find("<rect").and_then(|start| svg[start..].find("/>").map(|end| start + end + 2));
    svg.insert_str(end.unwrap_or(svg.len()), elements);
}

/// The lowest and the highest of the numbers that are finite; infinite the other way round if there are none.
pub fn ends<'a>(values: impl IntoIterator<Item = &'a f64>) -> (f64, f64) {
    let finite = values.into_iter().filter(|value| value.is_finite());
    finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)))
}

/// A number as short as its size allows: 75000 → "75 k", 0.0123 → "0.012".
pub fn short(value: f64) -> String {
    let size = value.abs();
    let trimmed = |text: String| {
        if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
    };
    match size {
        _ if !value.is_finite() => "–".to_owned(),
        0.0 => "0".to_owned(),
        1e9.. => trimmed(format!("{:.1}", value / 1e9)) + " G",
        1e6.. => trimmed(format!("{:.1}", value / 1e6)) + " M",
        1e4.. => trimmed(format!("{:.1}", value / 1e3)) + " k",
        100.0.. => format!("{value:.0}"),
        1.0.. => trimmed(format!("{value:.2}")),
        0.01.. => trimmed(format!("{value:.3}")),
        _ => format!("{value:.0e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let cases = [(75_000.0, "75 k"), (0.0123, "0.012"), (1.5e6, "1.5 M"), (4.0, "4"), (-250.0, "-250"), (0.0, "0")];
        for (value, expected) in cases {
            assert_eq!(short(value), expected);
        }
        assert_eq!(short(2e-5), "2e-5");
    }
}
