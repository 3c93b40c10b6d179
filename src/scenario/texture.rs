//! What surfaces look like: an image file or a procedural pattern.

use std::path::{Path, PathBuf};

use super::keys::{Range, Section, within};

/// A surface: an image file or a procedural pattern.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Image file (PNG), repeated; overrides the pattern.
    pub image: Option<PathBuf>,
    /// Procedural pattern. Along a wall of up to 64 elements it does not repeat.
    pub pattern: Pattern,
    /// Size of the pattern's elements, or height of one image, metres (degrees for the surroundings).
    pub scale: f64,
    /// Base hue, degrees.
    pub hue: f64,
    /// How far hues stray from the base, degrees.
    pub hue_spread: f64,
    /// Contrast of the pattern, 0 (plain) to 1.
    pub contrast: f64,
    /// Seed of the pattern; on walls and floor `world.texture_seed` is in it.
    pub seed: u64,
}

/// Procedural patterns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pattern {
    /// One colour.
    Plain,
    /// Smooth blobs of colour.
    Smooth,
    /// Sheets of random colours side by side.
    Patches,
    /// Blocks of stone, each with a figure of its own in relief.
    Reliefs,
    /// Vertical stripes of random colours.
    Stripes,
    /// The base colour, paler towards the horizon: for the surroundings.
    Sky,
}

/// Scales of walls and floors, metres.
const METRES: Range = within(0.01, 1000.0);

/// Patterns by the words of the file.
const PATTERNS: [(&str, Pattern); 6] = [
    ("plain", Pattern::Plain),
    ("smooth", Pattern::Smooth),
    ("patches", Pattern::Patches),
    ("stripes", Pattern::Stripes),
    ("reliefs", Pattern::Reliefs),
    ("sky", Pattern::Sky),
];

pub(super) struct Defaults {
    /// An image in place of the pattern.
    image: Option<PathBuf>,
    pattern: usize,
    scale: f64,
    hue: f64,
    hue_spread: f64,
    contrast: f64,
    seed: usize,
    /// Allowed scales: finer ones would alias in any image, and repeat too often.
    range: Range,
}

impl Defaults {
    pub(super) const FLOOR: Defaults = Defaults {
        image: None,
        pattern: 1,
        scale: 0.6,
        hue: 40.0,
        hue_spread: 20.0,
        contrast: 0.3,
        seed: 1001,
        range: METRES,
    };
    pub(super) const SURROUNDINGS: Defaults = Defaults {
        image: None,
        pattern: 1,
        scale: 40.0,
        hue: 210.0,
        hue_spread: 60.0,
        contrast: 0.5,
        seed: 1002,
        range: within(1.0, 360.0),
    };

    /// Walls differ in hue and pattern unless the file says otherwise.
    pub(super) fn wall(index: usize) -> Defaults {
        let hue = (index as f64 * 97.0) % 360.0;
        Defaults {
            image: None,
            pattern: 2,
            scale: 0.45,
            hue,
            hue_spread: 60.0,
            contrast: 0.6,
            seed: index + 1,
            range: METRES,
        }
    }

    /// A side of a room has the texture of the room, but in no two of them the pattern is the same.
    pub(super) fn side(room: &Texture, side: usize) -> Defaults {
        let Texture { image, scale, hue, hue_spread, contrast, .. } = room.clone();
        let pattern = PATTERNS.iter().position(|&(_, pattern)| pattern == room.pattern).unwrap_or(0);
        // Rooms of neighbouring seeds must not share patterns; a written seed must be one that can be read.
        let seed = (room.seed as usize + 1000 * (side + 1)) % u32::MAX as usize;
        Defaults { image, pattern, scale, hue, hue_spread, contrast, seed, range: METRES }
    }
}

impl Texture {
    /// Another texture of a wall; each change has its own unless the file says otherwise.
    pub(super) fn changed(s: &mut Section<'_, '_>, base: &Path, index: usize) -> Self {
        Texture::read(s, base, Defaults { seed: index + 501, ..Defaults::wall(index + 2) })
    }

    /// The same with the pattern of another number of texture_seed; 0 leaves it. Seeds in a file are far smaller than what is added.
    pub(super) fn reseed(&mut self, texture_seed: u64) {
        self.seed += texture_seed << u32::BITS;
    }

    pub(super) fn read(s: &mut Section<'_, '_>, base: &Path, d: Defaults) -> Self {
        let image = s.file("image", base, "PNG file, relative to this file, instead of the pattern; empty: none");
        let image = image.or(d.image);
        if let Some(path) = &image
            && let Err(error) = image::ImageReader::open(path).map_err(image::ImageError::from).and_then(|r| r.decode())
        {
            s.fault_here("image", format!("= {:?} cannot be used: {error}", path.display().to_string()));
        }
        Texture {
            image,
            pattern: s.choice_from(
                "pattern",
                d.pattern,
                &PATTERNS,
                "procedural pattern; on a wall of up to 64 elements it does not repeat",
            ),
            scale: s.number(
                "scale",
                d.scale,
                "m (surroundings: degrees)",
                d.range,
                "size of the pattern's elements, or height of one image",
            ),
            hue: s.number("hue", d.hue, "degrees", within(0.0, 360.0), "base colour"),
            hue_spread: s.number("hue_spread", d.hue_spread, "degrees", within(0.0, 360.0), "how far colours stray"),
            contrast: s.number("contrast", d.contrast, "", within(0.0, 1.0), "0: plain"),
            seed: s.count("seed", d.seed, "", 0..=u32::MAX as usize, "seed of the pattern") as u64,
        }
    }
}
