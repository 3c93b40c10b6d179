//! Images in a terminal: two pixels in each cell, one above the other.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;

use crate::live::picture::Picture;

/// Shades from dark to light, where there are no colours.
const SHADES: [char; 10] = [' ', '.', ':', '-', '=', '+', '*', '#', '%', '@'];

/// Draw an image as large as fits, in the middle.
pub fn picture(buffer: &mut Buffer, area: Rect, picture: &Picture, plain: bool) {
    if area.is_empty() || picture.width == 0 || picture.height == 0 {
        return;
    }
    let (wide, high) = (f64::from(area.width), 2.0 * f64::from(area.height));
    let scale = (wide / picture.width as f64).min(high / picture.height as f64);
    let columns = ((picture.width as f64 * scale) as u16).clamp(1, area.width);
    let lines = ((picture.height as f64 * scale / 2.0) as u16).clamp(1, area.height);
    let (left, top) = (area.x + (area.width - columns) / 2, area.y + (area.height - lines) / 2);
    for line in 0..lines {
        for column in 0..columns {
            let at = |half: u16| mean(picture, (column, columns), (2 * line + half, 2 * lines));
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

/// Mean colour of one part of an image that is cut into `columns.1` × `rows.1` parts.
fn mean(picture: &Picture, columns: (u16, u16), rows: (u16, u16)) -> [u8; 3] {
    let span = |(i, n): (u16, u16), length: usize| {
        let bound = |i: u16| usize::from(i) * length / usize::from(n);
        let start = bound(i).min(length - 1);
        start..bound(i + 1).clamp(start + 1, length)
    };
    let (across, down) = (span(columns, picture.width), span(rows, picture.height));
    let (mut sum, mut count) = ([0u32; 3], 0);
    for y in down {
        for x in across.clone() {
            let start = 3 * (y * picture.width + x);
            for (sum, &value) in sum.iter_mut().zip(picture.rgb.get(start..start + 3).unwrap_or(&[0; 3])) {
                *sum += u32::from(value);
            }
            count += 1;
        }
    }
    sum.map(|sum| (sum / count) as u8)
}
