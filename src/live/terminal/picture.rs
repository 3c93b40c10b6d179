//! Images in a terminal: two pixels in each cell, one above the other.

use image::RgbImage;
use image::imageops::{FilterType, resize};
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;

use crate::live::picture::Picture;

/// Shades from dark to light, where there are no colours.
const SHADES: [char; 10] = [' ', '.', ':', '-', '=', '+', '*', '#', '%', '@'];

/// Draw an image as large as fits, in the middle.
pub fn picture(buffer: &mut Buffer, area: Rect, picture: &Picture, plain: bool) {
    let image = RgbImage::from_raw(picture.width as u32, picture.height as u32, picture.rgb.clone());
    let Some(image) = image.filter(|image| !area.is_empty() && image.width() > 0 && image.height() > 0) else { return };
    let (wide, high) = (f64::from(area.width), 2.0 * f64::from(area.height));
    let scale = (wide / picture.width as f64).min(high / picture.height as f64);
    let columns = ((picture.width as f64 * scale) as u16).clamp(1, area.width);
    let lines = ((picture.height as f64 * scale / 2.0) as u16).clamp(1, area.height);
    let (left, top) = (area.x + (area.width - columns) / 2, area.y + (area.height - lines) / 2);
    // Pixels stay squares where there is room for them.
    let filter = if usize::from(columns) < picture.width { FilterType::Triangle } else { FilterType::Nearest };
    let image = resize(&image, columns.into(), 2 * u32::from(lines), filter);
    for line in 0..lines {
        for column in 0..columns {
            let at = |half: u16| image.get_pixel(column.into(), (2 * line + half).into()).0;
            let (upper, lower) = (at(0), at(1));
            let cell = &mut buffer[(left + column, top + line)];
            if plain {
                let light = |[r, g, b]: [u8; 3]| 0.3 * f64::from(r) + 0.59 * f64::from(g) + 0.11 * f64::from(b);
                let shade = (light(upper) + light(lower)) / 2.0 / 256.0 * SHADES.len() as f64;
                cell.set_char(SHADES[(shade as usize).min(SHADES.len() - 1)]);
            } else {
                let colour = |[r, g, b]: [u8; 3]| Color::Rgb(r, g, b);
                cell.set_char('▀').set_fg(colour(upper)).set_bg(colour(lower));
            }
        }
    }
}
