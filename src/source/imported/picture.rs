//! Camera images of other programs: raw pixels or image files to RGB, safe on any bytes.

use std::io::Cursor;

use image::{ImageFormat, ImageReader};
use thiserror::Error;

use crate::log::messages::{self as msg, foreign};
use crate::scenario::{Camera, Vision};
use crate::vision::Image;

/// Most pixels of an image: 4096 × 4096. A file of a few bytes may claim any size; memory is only taken for less than this.
pub const MOST_PIXELS: u64 = 4096 * 4096;

/// Encodings of raw images: bytes per pixel, and where red, green and blue are among them.
const ENCODINGS: [(&str, usize, [usize; 3]); 5] = [
    ("rgb8", 3, [0, 1, 2]),
    ("bgr8", 3, [2, 1, 0]),
    ("mono8", 1, [0, 0, 0]),
    ("rgba8", 4, [0, 1, 2]),
    ("bgra8", 4, [2, 1, 0]),
];

/// Why an image cannot be used.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum PictureError {
    /// Pixels of another kind.
    #[error("its encoding is {0:?}: it must be rgb8, bgr8, mono8, rgba8 or bgra8")]
    Encoding(String),
    /// No pixels, or too many.
    #[error("it has {width} × {height} pixels: there must be 1 to {MOST_PIXELS}")]
    Size {
        /// Pixels.
        width: u64,
        /// Pixels.
        height: u64,
    },
    /// Its lines are shorter than their pixels.
    #[error("its lines have step = {step} bytes: {width} pixels of {encoding} need {needed}")]
    Step {
        /// Bytes from line to line.
        step: u32,
        /// Pixels.
        width: u32,
        /// What a pixel is.
        encoding: &'static str,
        /// Bytes of a line's pixels.
        needed: u64,
    },
    /// Data is missing.
    #[error("it has {found} bytes of data: {height} lines of {step} bytes need {needed}")]
    Short {
        /// Bytes.
        found: usize,
        /// Lines.
        height: u32,
        /// Bytes from line to line.
        step: u32,
        /// Bytes up to the last pixel.
        needed: u64,
    },
    /// It is no image file, or a damaged one.
    #[error("it is no JPEG or PNG file that can be read: {0}")]
    File(String),
    /// There are fewer pixels than an observation has.
    #[error(
        "of its {width} × {height} pixels {cut} lines are cut away (vision.cut_rows): what is left is smaller than an observation \
         of {} × {} pixels", observation.0, observation.1
    )]
    Small {
        /// Pixels.
        width: usize,
        /// Pixels.
        height: usize,
        /// Lines.
        cut: usize,
        /// Pixels of an observation.
        observation: (usize, usize),
    },
}

/// The pixels of a raw image.
///
/// # Errors
/// Another encoding, or sizes that contradict each other; see [`PictureError`].
pub fn raw(image: &msg::Image) -> Result<Image, PictureError> {
    let found = ENCODINGS.iter().find(|(name, ..)| *name == image.encoding);
    let &(encoding, bytes, places) = found.ok_or_else(|| PictureError::Encoding(image.encoding.clone()))?;
    let (width, height, step) = (u64::from(image.width), u64::from(image.height), u64::from(image.step));
    check_size(width, height)?;
    let line = width * bytes as u64;
    if step < line {
        return Err(PictureError::Step { step: image.step, width: image.width, encoding, needed: line });
    }
    // Whoever cuts an image out of a larger one may leave out what follows its last pixel.
    let needed = step * (height - 1) + line;
    if (image.data.len() as u64) < needed {
        return Err(PictureError::Short { found: image.data.len(), height: image.height, step: image.step, needed });
    }
    let (width, height) = (image.width as usize, image.height as usize);
    let mut rgb = Vec::with_capacity(3 * width * height);
    for line in image.data.chunks(image.step as usize).take(height) {
        let pixels = line.chunks_exact(bytes).take(width);
        rgb.extend(pixels.flat_map(|pixel| places.map(|place| pixel[place])));
    }
    Ok(Image { width, height, cropped: false, rgb })
}

/// The pixels of an image file. What kind it is, its first bytes say; the message's own word for it is not needed.
///
/// # Errors
/// It is no JPEG or PNG file, a damaged one, or claims to be larger than [`MOST_PIXELS`].
pub fn compressed(image: &foreign::CompressedImage) -> Result<Image, PictureError> {
    let failed = |cause: image::ImageError| PictureError::File(cause.to_string());
    let format = image::guess_format(&image.data).map_err(failed)?;
    if !matches!(format, ImageFormat::Jpeg | ImageFormat::Png) {
        return Err(PictureError::File(format!("it is of another kind, {format:?}")));
    }
    let open = || ImageReader::with_format(Cursor::new(&image.data), format);
    let (width, height) = open().into_dimensions().map_err(failed)?;
    check_size(width.into(), height.into())?;
    let rgb = open().decode().map_err(failed)?.into_rgb8();
    Ok(Image { width: width as usize, height: height as usize, cropped: false, rgb: rgb.into_raw() })
}

fn check_size(width: u64, height: u64) -> Result<(), PictureError> {
    if width == 0 || height == 0 || width * height > MOST_PIXELS {
        return Err(PictureError::Size { width, height });
    }
    Ok(())
}

/// Cut away the upper lines of an image of any size: the share that the scenario cuts from those of its own camera.
///
/// # Errors
/// What is left is smaller than an observation.
pub fn crop(mut image: Image, camera: &Camera, vision: &Vision) -> Result<Image, PictureError> {
    let share = vision.cut_rows as f64 / camera.height as f64;
    let cut = (share * image.height as f64).round() as usize;
    let left = image.height.saturating_sub(cut);
    if left < vision.height || image.width < vision.width {
        let (width, height) = (image.width, image.height);
        return Err(PictureError::Small { width, height, cut, observation: (vision.width, vision.height) });
    }
    image.rgb.drain(..3 * cut * image.width);
    (image.height, image.cropped) = (left, true);
    Ok(image)
}

#[cfg(test)]
mod tests {
    use image::codecs::jpeg::JpegEncoder;
    use image::codecs::png::PngEncoder;
    use image::{ExtendedColorType, ImageEncoder as _};

    use super::*;

    fn message(encoding: &str, width: u32, height: u32, step: u32, data: Vec<u8>) -> msg::Image {
        msg::Image { encoding: encoding.into(), width, height, step, data, ..Default::default() }
    }

    #[test]
    fn every_encoding_becomes_red_green_blue_and_padding_is_left_out() {
        for (encoding, data, expected) in [
            ("rgb8", vec![1, 2, 3, 4, 5, 6], [1, 2, 3, 4, 5, 6]),
            ("bgr8", vec![1, 2, 3, 4, 5, 6], [3, 2, 1, 6, 5, 4]),
            ("mono8", vec![7, 8], [7, 7, 7, 8, 8, 8]),
            ("rgba8", vec![1, 2, 3, 99, 4, 5, 6, 99], [1, 2, 3, 4, 5, 6]),
            ("bgra8", vec![1, 2, 3, 99, 4, 5, 6, 99], [3, 2, 1, 6, 5, 4]),
        ] {
            let step = data.len() as u32 + 3;
            // Two lines of two pixels, with three bytes of padding between them and none at the end.
            let lines = [&data[..], &[0; 3], &data].concat();
            let image = raw(&message(encoding, 2, 2, step, lines)).unwrap();
            assert_eq!((image.width, image.height, image.rgb), (2, 2, [expected, expected].concat()), "{encoding}");
        }
    }

    #[test]
    fn sizes_that_contradict_each_other_are_refused_with_numbers() {
        let text = |image: &msg::Image| raw(image).unwrap_err().to_string();
        assert!(text(&message("16UC1", 2, 2, 4, vec![0; 8])).contains("\"16UC1\""));
        assert!(text(&message("rgb8", 2, 2, 5, vec![0; 99])).contains("step = 5 bytes: 2 pixels of rgb8 need 6"));
        assert!(text(&message("rgb8", 2, 2, 8, vec![0; 13])).contains("13 bytes of data: 2 lines of 8 bytes need 14"));
        assert!(text(&message("rgb8", 0, 2, 8, vec![0; 13])).contains("0 × 2"));
        assert!(text(&message("mono8", u32::MAX, u32::MAX, u32::MAX, vec![0; 13])).contains("4294967295 × 4294967295"));
        let step = text(&message("mono8", 4096, 4096, u32::MAX, vec![0; 13]));
        assert!(step.contains(&(4095 * u64::from(u32::MAX) + 4096).to_string()), "{step}");
    }

    fn file(format: &str, bytes: Vec<u8>) -> foreign::CompressedImage {
        foreign::CompressedImage { format: format.into(), data: bytes, ..Default::default() }
    }

    fn gradient() -> (Vec<u8>, Vec<u8>, Vec<u8>) {
        let rgb: Vec<u8> = (0..24 * 16).flat_map(|i| [(i % 24 * 10) as u8, (i / 24 * 15) as u8, 90]).collect();
        let (mut png, mut jpeg) = (Vec::new(), Vec::new());
        PngEncoder::new(&mut png).write_image(&rgb, 24, 16, ExtendedColorType::Rgb8).unwrap();
        JpegEncoder::new_with_quality(&mut jpeg, 95).write_image(&rgb, 24, 16, ExtendedColorType::Rgb8).unwrap();
        (rgb, png, jpeg)
    }

    #[test]
    fn image_files_are_read_whatever_the_message_calls_them() {
        let (rgb, png, jpeg) = gradient();
        let image = compressed(&file("rgb8; jpeg compressed bgr8", png)).unwrap();
        assert_eq!((image.width, image.height, &image.rgb), (24, 16, &rgb));
        let image = compressed(&file("", jpeg)).unwrap();
        let off = image.rgb.iter().zip(&rgb).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(off < 12, "JPEG loses {off} grey levels");
    }

    #[test]
    fn damaged_files_are_errors_and_claims_of_size_take_no_memory() {
        let (_, png, jpeg) = gradient();
        assert!(compressed(&file("jpeg", b"no image".to_vec())).is_err());
        assert!(compressed(&file("jpeg", Vec::new())).is_err());
        // A GIF is an image, but not one of these.
        assert!(compressed(&file("gif", b"GIF89a\x01\x00\x01\x00\x00\x00\x00".to_vec())).is_err());
        assert!(compressed(&file("png", png[..png.len() / 2].to_vec())).is_err());
        // The start of frame of a JPEG has height and width behind its length and precision.
        let frame = jpeg.windows(2).position(|bytes| bytes == [0xff, 0xc0]).unwrap();
        let mut huge = jpeg.clone();
        huge[frame + 5..frame + 9].copy_from_slice(&[0xff; 4]);
        assert_eq!(compressed(&file("jpeg", huge)), Err(PictureError::Size { width: 65_535, height: 65_535 }));
        for (seed, bytes) in [(1, &png), (2, &jpeg)] {
            let mut state = seed as u64;
            let mut random = |below: usize| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 33) as usize % below
            };
            for _ in 0..3000 {
                let mut mutant = bytes.clone();
                for _ in 0..1 + random(4) {
                    let at = random(mutant.len());
                    mutant[at] = random(256) as u8;
                }
                mutant.truncate(mutant.len() - random(8));
                // Some mutants are images still; none panics, and all that come out fit their size.
                if let Ok(image) = compressed(&file("", mutant)) {
                    assert_eq!(image.rgb.len(), 3 * image.width * image.height);
                }
            }
        }
    }

    #[test]
    fn the_upper_lines_are_cut_as_a_share() {
        let scenario = crate::scenario::Scenario::load(
            &std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/lab.toml"),
            &[],
        );
        let scenario = scenario.unwrap();
        let line = |y: usize| vec![y as u8; 3 * 64];
        let image = Image { width: 64, height: 48, cropped: false, rgb: (0..48).flat_map(line).collect() };
        // A third, as of the lab's 240 lines.
        let cut = crop(image.clone(), &scenario.camera, &scenario.vision).unwrap();
        assert_eq!((cut.height, cut.cropped, cut.rgb[0], cut.rgb.len()), (32, true, 16, 3 * 64 * 32));
        let small = Image { width: 31, rgb: image.rgb[..3 * 31 * 48].to_vec(), ..image };
        let text = crop(small, &scenario.camera, &scenario.vision).unwrap_err().to_string();
        assert!(text.contains("31 × 48") && text.contains("16 lines") && text.contains("32 × 16"), "{text}");
    }
}
