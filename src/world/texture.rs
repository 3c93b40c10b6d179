//! Surfaces: procedural patterns from a seed, or image files, as maps that repeat.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::random::stream;
use crate::scenario::{Pattern, Texture};

/// Elements of a procedural pattern before it repeats, unless a wall is longer.
const ELEMENTS: usize = 8;

/// Elements along a wall at most, before its pattern repeats nevertheless: the map takes 74 kB for each.
const MOST_ELEMENTS: usize = 64;

/// Texels per element.
const TEXELS: usize = 48;

/// How far a surface goes in the first of its directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Span {
    /// Any length: a procedural pattern repeats as a tile does.
    Endless,
    /// So many metres: a procedural pattern does not repeat on it, so that places along a wall can be told apart.
    Wall(f64),
    /// Around the robot: every pattern repeats after exactly so many degrees.
    Around(f64),
}

/// A surface colour map that repeats in both directions.
#[derive(Debug, Clone)]
pub struct TextureMap {
    width: usize,
    height: usize,
    /// Red, green, blue from the lowest byte on; column by column, each upwards, as walls are painted.
    texels: Vec<u32>,
    /// Periods per metre (or degree), along and upwards.
    periods: [f64; 2],
}

/// A coordinate in periods as a whole number: 2³² is one period, and whole periods overflow.
pub fn fixed(periods: f64) -> u32 {
    const PERIOD: f64 = (1u64 << 32) as f64;
    (periods * PERIOD) as i64 as u32
}

impl TextureMap {
    /// The map of a surface.
    ///
    /// # Errors
    /// An image file that cannot be read.
    pub fn new(texture: &Texture, span: Span) -> Result<Self, image::ImageError> {
        let mut map = match &texture.image {
            Some(path) => {
                let picture = image::ImageReader::open(path)?.decode()?.to_rgb8();
                let (width, height) = (picture.width() as usize, picture.height() as usize);
                let texel = |x: usize, y: usize| picture.get_pixel(x as u32, y as u32).0;
                TextureMap::of(width, height, height as f64 / texture.scale, texel)
            }
            None => procedural(texture, span),
        };
        if let Span::Around(length) = span {
            map.periods[0] = (map.periods[0] * length).round().max(1.0) / length;
        }
        Ok(map)
    }

    /// A map from the texels of a picture, whose row 0 is its top; `density`: texels per metre.
    fn of(width: usize, height: usize, density: f64, texel: impl Fn(usize, usize) -> [u8; 3]) -> Self {
        let colour = |[red, green, blue]: [u8; 3]| u32::from_le_bytes([red, green, blue, 0]);
        let texels = (0..width * height).map(|i| colour(texel(i / height, height - 1 - i % height))).collect();
        TextureMap { width, height, texels, periods: [width, height].map(|texels| density / texels as f64) }
    }

    /// Texels along and upwards.
    #[cfg(feature = "gpu")]
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Red, green, blue from the lowest byte on; column by column, each upwards.
    #[cfg(feature = "gpu")]
    pub fn texels(&self) -> &[u32] {
        &self.texels
    }

    /// Mean colour.
    pub fn mean(&self) -> [u8; 3] {
        let channel = |c: usize| self.texels.iter().map(|texel| u64::from(texel.to_le_bytes()[c])).sum::<u64>();
        [0, 1, 2].map(|c| (channel(c) / self.texels.len() as u64) as u8)
    }

    /// Periods per metre (or degree) along (0) or upwards (1).
    pub fn periods(&self, axis: usize) -> f64 {
        self.periods[axis]
    }

    /// A coordinate along (0) or upwards (1), as of [`fixed`].
    pub fn phase(&self, axis: usize, coordinate: f64) -> u32 {
        fixed(coordinate * self.periods[axis])
    }

    /// The texels above a coordinate along the surface, upwards.
    pub fn column(&self, along: u32) -> &[u32] {
        let start = texel(along, self.width) * self.height;
        &self.texels[start..start + self.height]
    }

    /// Colour at a coordinate along the surface and one upwards.
    pub fn at(&self, along: u32, up: u32) -> u32 {
        self.texels[texel(along, self.width) * self.height + texel(up, self.height)]
    }
}

/// The texel of a coordinate, on a map that repeats after `length` of them.
fn texel(phase: u32, length: usize) -> usize {
    ((u64::from(phase) * length as u64) >> 32) as usize
}

fn procedural(texture: &Texture, span: Span) -> TextureMap {
    let across = match span {
        Span::Endless => ELEMENTS,
        Span::Wall(length) => ((length / texture.scale).ceil() as usize).clamp(ELEMENTS, MOST_ELEMENTS),
        Span::Around(length) => (length / texture.scale).round().max(1.0) as usize,
    };
    let mut rng = stream(texture.seed, "texture");
    let palette: Vec<[f64; 3]> = (0..across * ELEMENTS).map(|_| colour(texture, &mut rng)).collect();
    let (width, height) = (across * TEXELS, ELEMENTS * TEXELS);
    let entry = |i: usize, j: usize| palette[(j % ELEMENTS) * across + i % across];
    let figures = if texture.pattern == Pattern::Reliefs { figures(palette.len(), &mut rng) } else { Vec::new() };
    let texel = |x: usize, y: usize| -> [f64; 3] {
        let (i, j) = (x / TEXELS, y / TEXELS);
        match texture.pattern {
            Pattern::Plain => hsv(texture.hue, 0.5, 0.6),
            Pattern::Patches => entry(i, j),
            Pattern::Stripes => entry(i, 0),
            Pattern::Reliefs => {
                let figure = figures[(j % ELEMENTS) * across + i % across];
                let shade = relief(figure, x % TEXELS, y % TEXELS, texture.contrast);
                entry(i, j).map(|value| value * shade)
            }
            Pattern::Sky => {
                let height = y as f64 / height as f64;
                hsv(texture.hue, 0.15 + 0.5 * height.sqrt(), 0.95 - 0.25 * height)
            }
            Pattern::Smooth => {
                let weight = |t: usize| {
                    let t = t as f64 / TEXELS as f64;
                    t * t * (3.0 - 2.0 * t)
                };
                let (u, v) = (weight(x % TEXELS), weight(y % TEXELS));
                let blend = |a: [f64; 3], b: [f64; 3], t: f64| [0, 1, 2].map(|c| a[c] + (b[c] - a[c]) * t);
                let low = blend(entry(i, j), entry(i + 1, j), u);
                let high = blend(entry(i, j + 1), entry(i + 1, j + 1), u);
                blend(low, high, v)
            }
        }
    };
    let density = TEXELS as f64 / texture.scale;
    // Patterns are laid out upwards.
    TextureMap::of(width, height, density, |x, y| texel(x, height - 1 - y).map(|value| (255.0 * value).round() as u8))
}

/// Cells of a figure in relief, along each side.
const CELLS: usize = 6;
/// Texels between a block's edge and its figure.
const FRAME: usize = 6;

/// Random figures, one bit for each cell. They are symmetric, as pictures of gods and beasts are, from the middle outwards.
fn figures(count: usize, rng: &mut ChaCha8Rng) -> Vec<u64> {
    let figure = |_| {
        let mut bits = 0u64;
        for row in 0..CELLS {
            for column in 0..CELLS / 2 {
                // Denser in the middle, so that figures hang together.
                if rng.random_range(0.0..1.0) < 0.3 + 0.15 * column as f64 {
                    bits |= 1 << (row * CELLS + column) | 1 << (row * CELLS + CELLS - 1 - column);
                }
            }
        }
        bits
    };
    (0..count).map(figure).collect()
}

/// Brightness of a texel of a block: dark in joints, in the sunk figure and at its upper edges, bright at its lower ones.
fn relief(figure: u64, x: usize, y: usize, contrast: f64) -> f64 {
    let joint = x < 2 || y < 2;
    let cell = |v: usize| v.checked_sub(FRAME).map(|v| v * CELLS / (TEXELS - 2 * FRAME)).filter(|&cell| cell < CELLS);
    let sunk = |x: usize, y: usize| match (cell(x), cell(y)) {
        (Some(column), Some(row)) => figure >> (row * CELLS + column) & 1 == 1,
        _ => false,
    };
    let depth = if joint {
        -0.9
    } else if sunk(x, y) {
        if sunk(x, y + 2) { -0.6 } else { -1.0 }
    } else if y >= 2 && sunk(x, y - 2) {
        0.35
    } else {
        0.0
    };
    1.0 + 0.8 * contrast * depth
}

/// A random colour of a texture's palette.
fn colour(texture: &Texture, rng: &mut ChaCha8Rng) -> [f64; 3] {
    let hue = texture.hue + texture.hue_spread * rng.random_range(-1.0..1.0);
    let saturation = 0.5 + 0.4 * texture.contrast * rng.random_range(-1.0..1.0);
    let value = 0.55 + 0.4 * texture.contrast * rng.random_range(-1.0..1.0);
    hsv(hue, saturation, value)
}

/// Hue in degrees, saturation and value in [0, 1], to RGB in [0, 1].
pub fn hsv(hue: f64, saturation: f64, value: f64) -> [f64; 3] {
    let sector = hue.rem_euclid(360.0) / 60.0;
    [5.0, 3.0, 1.0].map(|n: f64| {
        let k = (n + sector) % 6.0;
        value - value * saturation * k.min(4.0 - k).clamp(0.0, 1.0)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn smooth(seed: u64) -> Texture {
        Texture { image: None, pattern: Pattern::Smooth, scale: 0.5, hue: 30.0, hue_spread: 40.0, contrast: 0.8, seed }
    }

    #[test]
    fn primary_colours() {
        assert_eq!(hsv(0.0, 1.0, 1.0), [1.0, 0.0, 0.0]);
        assert_eq!(hsv(120.0, 1.0, 1.0), [0.0, 1.0, 0.0]);
        assert_eq!(hsv(240.0, 1.0, 0.5), [0.0, 0.0, 0.5]);
        assert_eq!(hsv(77.0, 0.0, 0.3), [0.3; 3]);
    }

    #[test]
    fn patterns_repeat_and_depend_on_the_seed_only() {
        let map = TextureMap::new(&smooth(3), Span::Endless).unwrap();
        let again = TextureMap::new(&smooth(3), Span::Endless).unwrap();
        let other = TextureMap::new(&smooth(4), Span::Endless).unwrap();
        assert_eq!(map.texels, again.texels);
        assert_ne!(map.texels, other.texels);
        let column = |along| map.column(map.phase(0, along));
        let at = |up| map.at(5, map.phase(1, up));
        let period = 0.5 * ELEMENTS as f64;
        assert_eq!(column(0.77), column(0.77 + period));
        assert_ne!(column(0.77), column(1.01));
        assert_eq!(at(0.31), at(0.31 + period));
        assert_eq!(column(-0.01), &map.texels[(map.width - 1) * map.height..]);
    }

    #[test]
    fn a_long_wall_does_not_repeat_and_a_short_one_is_as_any_surface() {
        let tile = TextureMap::new(&smooth(3), Span::Endless).unwrap();
        let period = 0.5 * ELEMENTS as f64;
        assert_eq!(TextureMap::new(&smooth(3), Span::Wall(period)).unwrap().texels, tile.texels);
        let wall = TextureMap::new(&smooth(3), Span::Wall(period + 1.2)).unwrap();
        let column = |along| wall.column(wall.phase(0, along));
        assert_eq!(wall.width, (ELEMENTS + 3) * TEXELS);
        for along in [0.1, 0.4, 0.9, 1.1] {
            assert_ne!(column(along), column(along + period));
        }
        assert_eq!(column(0.1), column(0.1 + period + 1.5));
        let longest = TextureMap::new(&smooth(3), Span::Wall(1e9)).unwrap();
        assert_eq!(longest.width, MOST_ELEMENTS * TEXELS);
    }

    #[test]
    fn surroundings_close_after_a_full_turn() {
        let far = Texture { scale: 35.0, ..smooth(8) };
        let map = TextureMap::new(&far, Span::Around(360.0)).unwrap();
        let column = |degrees| map.column(map.phase(0, degrees));
        assert_eq!(column(0.01), column(360.01));
        assert_eq!(column(359.999), &map.texels[(map.width - 1) * map.height..]);
    }
}
