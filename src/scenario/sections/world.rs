//! `[world]`: walls, surfaces, and what moves by itself.

use std::path::{Path, PathBuf};

use crate::scenario::distractors::Distractor;
use crate::scenario::keys::{Range, Reader, Section};
use crate::scenario::pyramids::Pyramid;
use crate::scenario::rooms::{Room, walls_of};

/// Who renders what the camera sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Renderer {
    /// Many views at once: whichever is faster on this machine. Single ones: the processor.
    Auto,
    /// The processor.
    Cpu,
    /// A graphics processor, if there is one.
    Gpu,
}

/// `[world]`: what the robot drives in.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// Who renders what the camera sees.
    pub renderer: Renderer,
    /// `[[world.room]]`
    pub rooms: Vec<Room>,
    /// `[[world.wall]]`, and behind them four walls for each room, in the order of [`SIDES`](crate::scenario::SIDES).
    pub walls: Vec<Wall>,
    /// `[[world.pyramid]]`
    pub pyramids: Vec<Pyramid>,
    /// `[[world.distractor]]`
    pub distractors: Vec<Distractor>,
    /// `[world.floor]`
    pub floor: Texture,
    /// `[world.surroundings]`: what is seen above the walls, far away.
    pub surroundings: Texture,
}

/// `[[world.wall]]`: a polyline that stands upright.
#[derive(Debug, Clone, PartialEq)]
pub struct Wall {
    /// Corners, metres.
    pub points: Vec<[f64; 2]>,
    /// Whether the last corner is joined to the first.
    pub closed: bool,
    /// Snapshot without a wall, from and to, metres along it, in order and apart from each other.
    pub gaps: Vec<[f64; 2]>,
    /// Height, metres.
    pub height: f64,
    /// Texture.
    pub texture: Texture,
}

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
const METRES: Range = Range::within(0.01, 1000.0);

/// Patterns by the words of the file.
const PATTERNS: [(&str, Pattern); 6] = [
    ("plain", Pattern::Plain),
    ("smooth", Pattern::Smooth),
    ("patches", Pattern::Patches),
    ("stripes", Pattern::Stripes),
    ("reliefs", Pattern::Reliefs),
    ("sky", Pattern::Sky),
];

pub(in crate::scenario) struct Defaults {
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
    const FLOOR: Defaults = Defaults {
        image: None,
        pattern: 1,
        scale: 0.6,
        hue: 40.0,
        hue_spread: 20.0,
        contrast: 0.3,
        seed: 1001,
        range: METRES,
    };
    const SURROUNDINGS: Defaults = Defaults {
        image: None,
        pattern: 1,
        scale: 40.0,
        hue: 210.0,
        hue_spread: 60.0,
        contrast: 0.5,
        seed: 1002,
        range: Range::within(1.0, 360.0),
    };

    /// Walls differ in hue and pattern unless the file says otherwise.
    fn wall(index: usize) -> Defaults {
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

    /// Rooms differ as walls do.
    pub(in crate::scenario) fn room(index: usize) -> Defaults {
        Defaults::wall(index)
    }

    /// A side of a room has the texture of the room, but in no two of them the pattern is the same.
    pub(in crate::scenario) fn side(room: &Texture, side: usize) -> Defaults {
        let Texture { image, scale, hue, hue_spread, contrast, .. } = room.clone();
        let pattern = PATTERNS.iter().position(|&(_, pattern)| pattern == room.pattern).unwrap_or(0);
        // Rooms of neighbouring seeds must not share patterns; a written seed must be one that can be read.
        let seed = (room.seed as usize + 1000 * (side + 1)) % u32::MAX as usize;
        Defaults { image, pattern, scale, hue, hue_spread, contrast, seed, range: METRES }
    }
}

impl World {
    pub(super) fn read(reader: &mut Reader<'_>, base: &Path) -> Self {
        let (texture_seed, renderer) = reader.section("world", "what the robot drives in", |s| {
            s.allow_sections(&["room", "wall", "pyramid", "distractor", "floor", "surroundings"]);
            let line = "seed of the textures of walls and floor; another number: other patterns of the same kinds";
            let texture_seed = s.count("texture_seed", 0, "", 0, 1_000_000, line) as u64;
            let words = [("auto", Renderer::Auto), ("cpu", Renderer::Cpu), ("gpu", Renderer::Gpu)];
            let line = "who renders: auto takes a graphics processor for many views at once, where that is faster";
            (texture_seed, s.choice("renderer", 0, &words, line))
        });
        let rooms = reader.sections("world.room", "a rectangle of floor; rooms that touch or overlap are joined", {
            |s, index| Room::read(s, base, index)
        });
        let mut walls = reader.sections("world.wall", "a polyline that stands upright", |s, index| Wall {
            points: s.points("points", "corners"),
            closed: s.flag("closed", false, "whether the last corner is joined to the first"),
            gaps: Vec::new(),
            height: s.number("height", 0.9, "m", Range::above(0.0, 100.0), "height of the wall"),
            texture: Texture::read(s, base, Defaults::wall(index)),
        });
        walls.extend(walls_of(&rooms));
        walls.iter_mut().for_each(|wall| wall.texture.reseed(texture_seed));
        let pyramids = reader.sections("world.pyramid", "stands outside, far away", Pyramid::read);
        let distractors = reader.sections(
            "world.distractor",
            "moves or blinks whatever the robot does; seen and not felt",
            Distractor::read,
        );
        let mut floor = reader.section("world.floor", "", |s| Texture::read(s, base, Defaults::FLOOR));
        floor.reseed(texture_seed);
        let surroundings = reader.section("world.surroundings", "seen above the walls, far away", |s| {
            Texture::read(s, base, Defaults::SURROUNDINGS)
        });
        World { renderer, rooms, walls, pyramids, distractors, floor, surroundings }
    }
}

impl Texture {
    /// Another texture of a wall; each change has its own unless the file says otherwise.
    pub(in crate::scenario) fn changed(s: &mut Section<'_, '_>, base: &Path, index: usize) -> Self {
        Texture::read(s, base, Defaults { seed: index + 501, ..Defaults::wall(index + 2) })
    }

    /// The same with the pattern of another number of texture_seed; 0 leaves it. Seeds in a file are far smaller than what is added.
    fn reseed(&mut self, texture_seed: u64) {
        self.seed += texture_seed << u32::BITS;
    }

    pub(in crate::scenario) fn read(s: &mut Section<'_, '_>, base: &Path, d: Defaults) -> Self {
        let image = s.file("image", base, "PNG file, relative to this file, instead of the pattern; empty: none");
        let image = image.or(d.image);
        if let Some(path) = &image
            && let Err(error) = image::ImageReader::open(path).map_err(image::ImageError::from).and_then(|r| r.decode())
        {
            s.fault_here("image", format!("= {:?} cannot be used: {error}", path.display().to_string()));
        }
        Texture {
            image,
            pattern: s.choice(
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
            hue: s.number("hue", d.hue, "degrees", Range::within(0.0, 360.0), "base colour"),
            hue_spread: s.number(
                "hue_spread",
                d.hue_spread,
                "degrees",
                Range::within(0.0, 360.0),
                "how far colours stray",
            ),
            contrast: s.number("contrast", d.contrast, "", Range::within(0.0, 1.0), "0: plain"),
            seed: s.count("seed", d.seed, "", 0, u32::MAX as usize, "seed of the pattern") as u64,
        }
    }
}
