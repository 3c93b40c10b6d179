//! From camera image to observation.
//!
//! Cut the upper lines (people and surroundings move above the walls), average areas down to a few pixels, and correct the
//! mean brightness. Observations are 8-bit RGB, and what is logged is what is learned from.
//!
//! # Reference
//! Thesis §5.1.5 (video generation), figure *preprocessing*.

mod image;

pub use image::Image;

use pulp::NullaryFnOnce;

use crate::scenario::Vision;

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

/// Makes observations, in memory of its own that is used again.
#[derive(Debug, Clone, Default)]
pub struct Observer {
    /// Sums over the lines of a row of cells, for each value of a line.
    columns: Vec<u32>,
    means: Vec<f32>,
}

impl Observer {
    /// Make an observation of a camera image, in place of what `pixels` held: [`Observation::pixels`].
    pub fn observe(&mut self, image: &Image, settings: &Vision, pixels: &mut Vec<u8>) {
        pulp::Arch::new().dispatch(Observe { observer: self, image, settings, pixels });
    }

    /// Means of the cells' areas: along the lines of a row of cells first, then across.
    #[inline(always)]
    fn average(&mut self, image: &Image, settings: &Vision) {
        let cut = if image.cropped { 0 } else { settings.cut_rows };
        let line_length = 3 * image.width;
        self.means.clear();
        for row in 0..settings.height {
            let lines = cell(row, settings.height, image.height - cut);
            self.columns.clear();
            self.columns.resize(line_length, 0);
            let seen = &image.rgb[(cut + lines.start) * line_length..(cut + lines.end) * line_length];
            for line in seen.chunks_exact(line_length) {
                for (sum, &value) in self.columns.iter_mut().zip(line) {
                    *sum += u32::from(value);
                }
            }
            for column in 0..settings.width {
                let columns = cell(column, settings.width, image.width);
                let mut sum = [0u32; 3];
                let (sums, _) = self.columns[3 * columns.start..3 * columns.end].as_chunks::<3>();
                for value in sums {
                    sum = [sum[0] + value[0], sum[1] + value[1], sum[2] + value[2]];
                }
                let area = (lines.len() * columns.len()) as f32;
                self.means.extend(sum.map(|sum| sum as f32 / area));
            }
        }
    }
}

/// The loops over an image, for the widest vectors of the machine.
struct Observe<'a> {
    observer: &'a mut Observer,
    image: &'a Image,
    settings: &'a Vision,
    pixels: &'a mut Vec<u8>,
}

impl NullaryFnOnce for Observe<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Observe { observer, image, settings, pixels } = self;
        observer.average(image, settings);
        let means = &observer.means;
        let gain = settings.brightness.map_or(1.0, |target| {
            let mean = means.iter().map(|&value| f64::from(value)).sum::<f64>() / means.len() as f64;
            if mean > 0.0 { target / mean } else { 1.0 }
        }) as f32;
        pixels.clear();
        // The cast cuts at 255; the added half makes it round.
        pixels.extend(means.iter().map(|&mean| (mean * gain + 0.5) as u8));
    }
}

/// Whether an image has at least a pixel for each one of an observation.
///
/// # Errors
/// It has not; the text has the sizes.
pub fn check_size(image: &Image, settings: &Vision) -> Result<(), String> {
    let cut = if image.cropped { 0 } else { settings.cut_rows };
    if image.width >= settings.width && image.height.saturating_sub(cut) >= settings.height {
        return Ok(());
    }
    Err(format!(
        "an image of {} × {} pixels (width × height) without its {cut} upper lines (vision.cut_rows) is smaller than an observation \
         of {} × {}: set vision.width and vision.height to what there is at most",
        image.width, image.height, settings.width, settings.height
    ))
}

/// Bounds of cell `i` of `n` over `length` pixels.
fn cell(i: usize, n: usize, length: usize) -> std::ops::Range<usize> {
    i * length / n..(i + 1) * length / n
}

/// Make an observation of a camera image.
pub fn observe(image: &Image, settings: &Vision, frame: u64) -> Observation {
    let mut pixels = Vec::with_capacity(3 * settings.width * settings.height);
    Observer::default().observe(image, settings, &mut pixels);
    Observation { frame, pixels }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Vision = Vision { cut_rows: 2, width: 2, height: 1, brightness: None };

    fn image(value: impl Fn(usize, usize, usize) -> u8) -> Image {
        let (width, height) = (4, 4);
        let rgb = (0..3 * width * height).map(|i| value(i / 3 % width, i / 3 / width, i % 3)).collect();
        Image { width, height, cropped: false, rgb }
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
