//! Pictures and numbers as they are shown.

use ::image::ExtendedColorType;
use serde::{Serialize, Serializer};

use crate::report::draw::{data_url, png_bytes};

/// An RGB image, row by row from the top; as JSON, an address that holds it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Picture {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// Three bytes for each pixel.
    pub rgb: Vec<u8>,
}

impl Serialize for Picture {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let png = png_bytes((self.width, self.height), &self.rgb, ExtendedColorType::Rgb8);
        png.ok().map(|png| data_url(&png)).serialize(serializer)
    }
}

/// A number to four digits: what is shown is not computed with.
pub fn finely(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    let unit = 10f64.powf(3.0 - value.abs().log10().floor());
    (value * unit).round() / unit
}
