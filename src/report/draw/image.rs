//! Images inside of drawings and pages.

use std::io::Cursor;

use ::image::{ExtendedColorType, ImageEncoder as _, codecs::png::PngEncoder};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::DrawError;

/// An RGB or RGBA image as a PNG file.
///
/// # Errors
/// [`DrawError::Encode`]: a size that does not fit the pixels.
pub fn png_bytes(
    (width, height): (usize, usize),
    pixels: &[u8],
    kind: ExtendedColorType,
) -> Result<Vec<u8>, DrawError> {
    let mut png = Cursor::new(Vec::new());
    let written = PngEncoder::new(&mut png).write_image(pixels, width as u32, height as u32, kind);
    written.map_err(|cause| DrawError::Encode { width, height, cause })?;
    Ok(png.into_inner())
}

/// A PNG file as an address that holds it.
pub fn data_url(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", STANDARD.encode(png))
}

/// The size and pixels of an RGB image with every second, third, … pixel left out, such that it is at most so wide.
pub fn thinned((width, height): (usize, usize), rgb: &[u8], widest: usize) -> (usize, usize, Vec<u8>) {
    let every = width.div_ceil(widest).max(1);
    let lines = rgb.chunks_exact(3 * width.max(1)).step_by(every).take(height / every);
    let pixels =
        |line: &[u8]| line.chunks_exact(3).step_by(every).take(width / every).flatten().copied().collect::<Vec<u8>>();
    (width / every, height / every, lines.flat_map(pixels).collect())
}

/// An RGB image with every pixel repeated `times` × `times`: viewers smooth small images whatever a file asks for.
pub fn enlarged(rgb: &[u8], width: usize, times: usize) -> Vec<u8> {
    let wide = |row: &[u8]| -> Vec<u8> { row.chunks_exact(3).flat_map(|pixel| pixel.repeat(times)).collect() };
    rgb.chunks_exact(3 * width.max(1)).flat_map(|row| wide(row).repeat(times)).collect()
}
