//! From camera image to observation.
//!
//! Cut the upper lines (people and surroundings move above the walls), average areas down to a few pixels, and correct the
//! mean brightness. Observations are 8-bit RGB, and what is logged is what is learned from.
//!
//! # Reference
//! Thesis §5.1.5 (video generation), figure *preprocessing*.

use crate::scenario::Vision;
use crate::world::Image;

/// Grey level that counts as zero in [`Observation::values`].
pub const ZERO: u8 = 128;

/// A small image that is learned from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Observation {
    /// Frame number.
    pub frame: u64,
    /// `3 · width · height` bytes, RGB, row by row from the top.
    pub pixels: Vec<u8>,
}

impl Observation {
    /// The observation as a vector of whole numbers, `pixel − 128`, for the kernel: `d` values in [−128, 127].
    ///
    /// Squared norms stay below 2²⁴ for 1536 values with a root mean square below 104 grey levels, and products of such
    /// vectors are exact in `f32` (see [`crate::kernel`]).
    pub fn values(&self) -> impl Iterator<Item = f32> + '_ {
        self.pixels.iter().map(|&pixel| f32::from(i16::from(pixel) - i16::from(ZERO)))
    }
}

/// Bounds of cell `i` of `n` over `length` pixels.
fn cell(i: usize, n: usize, length: usize) -> std::ops::Range<usize> {
    i * length / n..(i + 1) * length / n
}

/// Make an observation of a camera image.
pub fn observe(image: &Image, settings: &Vision, frame: u64) -> Observation {
    let (width, height) = (settings.width, settings.height);
    let visible = image.height - settings.cut_rows;
    let mut means = Vec::with_capacity(3 * width * height);
    for row in 0..height {
        let lines = cell(row, height, visible);
        for column in 0..width {
            let columns = cell(column, width, image.width);
            let mut sum = [0u32; 3];
            for line in lines.clone() {
                let start = 3 * ((line + settings.cut_rows) * image.width + columns.start);
                for pixel in image.rgb[start..start + 3 * columns.len()].chunks_exact(3) {
                    for (sum, &value) in sum.iter_mut().zip(pixel) {
                        *sum += u32::from(value);
                    }
                }
            }
            let area = (lines.len() * columns.len()) as f32;
            means.extend(sum.map(|sum| sum as f32 / area));
        }
    }
    let gain = settings.brightness.map_or(1.0, |target| {
        let mean = means.iter().map(|&value| f64::from(value)).sum::<f64>() / means.len() as f64;
        if mean > 0.0 { target / mean } else { 1.0 }
    }) as f32;
    Observation { frame, pixels: means.iter().map(|&mean| (mean * gain).round() as u8).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Vision = Vision { cut_rows: 2, width: 2, height: 1, brightness: None };

    fn image(value: impl Fn(usize, usize, usize) -> u8) -> Image {
        let (width, height) = (4, 4);
        let rgb = (0..3 * width * height).map(|i| value(i / 3 % width, i / 3 / width, i % 3)).collect();
        Image { width, height, rgb }
    }

    #[test]
    fn upper_lines_are_cut_and_areas_averaged() {
        let picture = image(|x, y, channel| if y < 2 { 255 } else { (10 * x + y + 100 * (channel / 2)) as u8 });
        let observation = observe(&picture, &SETTINGS, 7);
        // Columns 0, 1 have mean 5, columns 2, 3 mean 25; lines 2, 3 add 2.5; halves round away from zero.
        assert_eq!(observation.pixels, [8, 8, 108, 28, 28, 128]);
        assert_eq!(observation.frame, 7);
    }

    #[test]
    fn brightness_is_corrected_whatever_the_exposure() {
        let settings = Vision { brightness: Some(128.0), ..SETTINGS };
        let dark = image(|x, _, _| if x < 2 { 20 } else { 60 });
        let bright = image(|x, _, _| if x < 2 { 40 } else { 120 });
        assert_eq!(observe(&dark, &settings, 0).pixels, observe(&bright, &settings, 0).pixels);
        assert_eq!(observe(&dark, &settings, 0).pixels, [64, 64, 64, 192, 192, 192]);
        let black = image(|_, _, _| 0);
        assert_eq!(observe(&black, &settings, 0).pixels, [0; 6]);
    }

    #[test]
    fn values_are_whole_numbers_around_zero() {
        let observation = Observation { frame: 0, pixels: vec![0, 128, 255] };
        assert_eq!(observation.values().collect::<Vec<_>>(), [-128.0, 0.0, 127.0]);
    }
}
