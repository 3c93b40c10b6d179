//! Surfaces: procedural patterns from a seed, or image files, as maps that repeat.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::random::stream;
use crate::scenario::{Pattern, Texture};

/// Elements of a procedural pattern before it repeats.
const ELEMENTS: usize = 8;

/// Texels per element.
const TEXELS: usize = 48;

/// A surface colour map that repeats in both directions.
#[derive(Debug, Clone)]
pub struct TextureMap {
    width: usize,
    height: usize,
    texels: Vec<[u8; 3]>,
    /// Texels per metre (or degree).
    density: [f64; 2],
}

impl TextureMap {
    /// The map of a surface. `around`: the pattern must repeat after exactly this length (360° for surroundings).
    ///
    /// # Errors
    /// An image file that cannot be read.
    pub fn new(texture: &Texture, around: Option<f64>) -> Result<Self, image::ImageError> {
        let mut map = match &texture.image {
            Some(path) => {
                let picture = image::ImageReader::open(path)?.decode()?.to_rgb8();
                let (width, height) = (picture.width() as usize, picture.height() as usize);
                let texels = picture.pixels().map(|pixel| pixel.0).collect();
                let density = height as f64 / texture.scale;
                TextureMap { width, height, texels, density: [density, density] }
            }
            None => procedural(texture, around),
        };
        if let Some(length) = around {
            let repeats = (map.density[0] * length / map.width as f64).round().max(1.0);
            map.density[0] = repeats * map.width as f64 / length;
        }
        Ok(map)
    }

    /// Mean colour.
    pub fn mean(&self) -> [u8; 3] {
        let sum = self.texels.iter().fold([0u64; 3], |sum, texel| [0, 1, 2].map(|c| sum[c] + u64::from(texel[c])));
        sum.map(|sum| (sum / self.texels.len() as u64) as u8)
    }

    /// Texel column of a coordinate along the surface.
    pub fn column(&self, along: f64) -> usize {
        repeat(along * self.density[0], self.width)
    }

    /// Colour in a texel column, at a coordinate upwards.
    pub fn at(&self, column: usize, up: f64) -> [u8; 3] {
        let row = repeat(up * self.density[1], self.height);
        // Row 0 of an image is its top.
        self.texels[(self.height - 1 - row) * self.width + column]
    }
}

/// The texel of a coordinate in texels, on a map that repeats after `length` of them.
fn repeat(coordinate: f64, length: usize) -> usize {
    // Far enough into the positive numbers that the cast is the floor; single-width division is several times faster.
    const PERIODS: usize = 4096;
    ((coordinate + (PERIODS * length) as f64) as u32 % length as u32) as usize
}

fn procedural(texture: &Texture, around: Option<f64>) -> TextureMap {
    let across = around.map_or(ELEMENTS, |length| (length / texture.scale).round().max(1.0) as usize);
    let mut rng = stream(texture.seed, "texture");
    let palette: Vec<[f64; 3]> = (0..across * ELEMENTS).map(|_| colour(texture, &mut rng)).collect();
    let (width, height) = (across * TEXELS, ELEMENTS * TEXELS);
    let entry = |i: usize, j: usize| palette[(j % ELEMENTS) * across + i % across];
    let texel = |x: usize, y: usize| -> [f64; 3] {
        let (i, j) = (x / TEXELS, y / TEXELS);
        match texture.pattern {
            Pattern::Plain => hsv(texture.hue, 0.5, 0.6),
            Pattern::Patches => entry(i, j),
            Pattern::Stripes => entry(i, 0),
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
    let texels = (0..width * height)
        .map(|index| texel(index % width, height - 1 - index / width).map(|value| (255.0 * value).round() as u8))
        .collect();
    let density = TEXELS as f64 / texture.scale;
    TextureMap { width, height, texels, density: [density, density] }
}

/// A random colour of a texture's palette.
fn colour(texture: &Texture, rng: &mut ChaCha8Rng) -> [f64; 3] {
    let hue = texture.hue + texture.hue_spread * rng.random_range(-1.0..1.0);
    let saturation = 0.5 + 0.4 * texture.contrast * rng.random_range(-1.0..1.0);
    let value = 0.55 + 0.4 * texture.contrast * rng.random_range(-1.0..1.0);
    hsv(hue, saturation, value)
}

/// Hue in degrees, saturation and value in [0, 1], to RGB in [0, 1].
fn hsv(hue: f64, saturation: f64, value: f64) -> [f64; 3] {
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
        let map = TextureMap::new(&smooth(3), None).unwrap();
        let again = TextureMap::new(&smooth(3), None).unwrap();
        let other = TextureMap::new(&smooth(4), None).unwrap();
        assert_eq!(map.texels, again.texels);
        assert_ne!(map.texels, other.texels);
        let period = 0.5 * ELEMENTS as f64;
        assert_eq!(map.column(0.77), map.column(0.77 + period));
        assert_eq!(map.at(5, 0.31), map.at(5, 0.31 + period));
        assert_eq!(map.column(-0.01), map.width - 1);
    }

    #[test]
    fn surroundings_close_after_a_full_turn() {
        let far = Texture { scale: 35.0, ..smooth(8) };
        let map = TextureMap::new(&far, Some(360.0)).unwrap();
        assert_eq!(map.column(0.01), map.column(360.01));
        assert_eq!(map.column(359.999), map.width - 1);
    }
}
