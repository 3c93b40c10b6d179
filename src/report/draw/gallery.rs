//! Images side by side, each with a line above it.

use ::image::ExtendedColorType;
use plotters::prelude::*;

use super::{DrawError, SMALL, TOP, WIDTH, behind, data_url, enlarged, png_bytes, sheet, text};

/// An RGB image with a line above it.
#[derive(Debug, Clone)]
pub struct Picture {
    /// The line.
    pub label: String,
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// `3 · width · height` bytes, row by row from the top.
    pub rgb: Vec<u8>,
}

/// Images of fewer pixels across are shown with their pixels as squares.
const SQUARES: usize = 100;

const MARGIN: u32 = 10;
const LABEL: u32 = 20;

/// Images in rows of `per_row`, as wide as fits, as an SVG text.
///
/// # Errors
/// [`DrawError`]; an image whose bytes do not fit its size.
pub fn gallery(title: &str, per_row: usize, pictures: &[Picture]) -> Result<String, DrawError> {
    let per_row = per_row.max(1);
    let width = (WIDTH - MARGIN * (per_row as u32 + 1)) / per_row as u32;
    let height = |picture: &Picture| width * picture.height as u32 / picture.width.max(1) as u32;
    let (mut top, mut placed, mut images) = (TOP, Vec::new(), String::new());
    for row in pictures.chunks(per_row) {
        for (i, picture) in row.iter().enumerate() {
            let left = MARGIN + i as u32 * (width + MARGIN);
            let times = if picture.width < SQUARES { 320 / picture.width.max(1) } else { 1 };
            let pixels = if times > 1 { &enlarged(&picture.rgb, picture.width, times) } else { &picture.rgb };
            let size = (times * picture.width, times * picture.height);
            let address = data_url(&png_bytes(size, pixels, ExtendedColorType::Rgb8)?);
            images += &format!(
                "\n<image x=\"{left}\" y=\"{}\" width=\"{width}\" height=\"{}\" href=\"{address}\"/>",
                top + LABEL,
                height(picture)
            );
            placed.push((left as i32, top as i32));
        }
        top += LABEL + row.iter().map(height).max().unwrap_or(0) + MARGIN;
    }
    let mut svg = sheet(title, (WIDTH, top), |root| {
        for (picture, place) in pictures.iter().zip(placed) {
            root.draw(&Text::new(picture.label.clone(), place, text(SMALL)))?;
        }
        Ok(())
    })?;
    behind(&mut svg, &images);
    Ok(svg)
}
