//! What the robot's camera sees: a deterministic software renderer, and the errors of a real sensor on top.
//!
//! Perspective without roll or pitch. Each image column is one ray on the floor plan; along it the walls are known in the
//! order of their distance, and the column is painted from far to near: surroundings, floor, walls. All arithmetic is the same on every machine.

use std::sync::LazyLock;

use nalgebra::{Point2, Vector2};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::Pose;
use super::texture::TextureMap;
use crate::scenario::{self, Scenario, plan_segments};

/// An RGB image, 8 bits a channel, row by row from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Image {
    /// Pixels.
    pub width: usize,
    /// Pixels.
    pub height: usize,
    /// `3 · width · height` bytes.
    pub rgb: Vec<u8>,
}

struct Panel {
    from: Point2<f64>,
    along: Vector2<f64>,
    length: f64,
    /// Distance along the wall at which the panel begins.
    offset: f64,
    wall: usize,
}

/// Where the ray of an image column crosses a wall.
struct Hit {
    /// Distance along the camera's axis, metres.
    depth: f64,
    wall: usize,
    /// Texture column.
    column: usize,
}

/// The renderer of a scenario's world.
pub struct Camera {
    settings: scenario::Camera,
    panels: Vec<Panel>,
    walls: Vec<(f64, TextureMap)>,
    floor: TextureMap,
    surroundings: TextureMap,
}

impl std::fmt::Debug for Camera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Camera({} panels)", self.panels.len())
    }
}

impl Camera {
    /// The renderer for a scenario.
    ///
    /// # Errors
    /// A texture file that cannot be read.
    pub fn new(scenario: &Scenario) -> Result<Self, image::ImageError> {
        let mut panels = Vec::new();
        let mut walls = Vec::new();
        for (index, wall) in scenario.world.walls.iter().enumerate() {
            let mut offset = 0.0;
            for (a, b) in plan_segments(wall) {
                let length = (b - a).norm();
                if length > 0.0 {
                    panels.push(Panel { from: a, along: (b - a) / length, length, offset, wall: index });
                }
                offset += length;
            }
            walls.push((wall.height, TextureMap::new(&wall.texture, None)?));
        }
        Ok(Camera {
            settings: scenario.camera.clone(),
            panels,
            walls,
            floor: TextureMap::new(&scenario.world.floor, None)?,
            surroundings: TextureMap::new(&scenario.world.surroundings, Some(360.0))?,
        })
    }

    /// Mean RGB colour of each wall's surface, in the order of the scenario.
    pub fn wall_colours(&self) -> Vec<[u8; 3]> {
        self.walls.iter().map(|(_, texture)| texture.mean()).collect()
    }

    /// The image from a pose, without sensor errors.
    pub fn render(&self, pose: &Pose) -> Image {
        let (width, height) = (self.settings.width, self.settings.height);
        let mut rgb = vec![0u8; 3 * width * height];
        let focal = 0.5 * width as f64 / (0.5 * self.settings.field_of_view_deg.to_radians()).tan();
        let ahead = pose.direction();
        let right = Vector2::new(ahead.y, -ahead.x);
        // Rise of the ray per metre of depth, falling from the top row to the bottom one.
        let slopes: Vec<f64> = (0..height).map(|row| (0.5 * height as f64 - (row as f64 + 0.5)) / focal).collect();
        let horizon = slopes.partition_point(|&slope| slope >= 0.0);
        let mut hits: Vec<Hit> = Vec::new();
        let mut strip = vec![[0u8; 3]; height];
        for column in 0..width {
            let aside = (column as f64 + 0.5 - 0.5 * width as f64) / focal;
            let ray = ahead + right * aside;
            self.hits(pose.position, ray, &mut hits);
            self.paint(pose.position, ray, &slopes, horizon, &hits, &mut strip);
            for (pixel, colour) in rgb.chunks_exact_mut(3).skip(column).step_by(width).zip(&strip) {
                pixel.copy_from_slice(colour);
            }
        }
        Image { width, height, rgb }
    }

    /// Paint one image column: what is far first, what is nearer over it.
    fn paint(
        &self,
        from: Point2<f64>,
        ray: Vector2<f64>,
        slopes: &[f64],
        horizon: usize,
        hits: &[Hit],
        strip: &mut [[u8; 3]],
    ) {
        let mount = self.settings.mount_height;
        // Rows of a wall: those whose ray is neither above its height nor below the floor at its depth.
        let rows = |hit: &Hit| {
            let top = slopes.partition_point(|&slope| mount + slope * hit.depth > self.walls[hit.wall].0);
            let base = slopes.partition_point(|&slope| mount + slope * hit.depth >= 0.0);
            top..base
        };
        let first = hits.first().map(rows);
        let sky_ends = first.as_ref().map_or(horizon, |rows| rows.start.min(horizon));
        // Over a wall lower than the camera one sees the floor behind it.
        let low = hits.iter().any(|hit| self.walls[hit.wall].0 < mount);
        let floor_begins = if low { horizon } else { first.map_or(horizon, |rows| rows.end) };

        // The surroundings are a cylinder far away, its height measured in degrees as they are near the horizon.
        let far = self.surroundings.column(ray.y.atan2(ray.x).to_degrees());
        let degrees = (1.0 / ray.norm()).to_degrees();
        for (pixel, slope) in strip[..sky_ends].iter_mut().zip(slopes) {
            *pixel = self.surroundings.at(far, slope * degrees);
        }
        for (pixel, slope) in strip[floor_begins..].iter_mut().zip(&slopes[floor_begins..]) {
            let place = from + ray * (-mount / slope);
            *pixel = self.floor.at(self.floor.column(place.x), place.y);
        }
        for hit in hits.iter().rev() {
            let rows = rows(hit);
            let texture = &self.walls[hit.wall].1;
            for (pixel, slope) in strip[rows.clone()].iter_mut().zip(&slopes[rows]) {
                *pixel = texture.at(hit.column, mount + slope * hit.depth);
            }
        }
    }

    /// Depth, wall and texture column of every panel that a ray crosses, nearest first.
    fn hits(&self, from: Point2<f64>, ray: Vector2<f64>, hits: &mut Vec<Hit>) {
        hits.clear();
        for panel in &self.panels {
            let across = ray.perp(&panel.along);
            if across.abs() < 1e-12 {
                continue;
            }
            let to = panel.from - from;
            let depth = to.perp(&panel.along) / across;
            let along = to.perp(&ray) / across;
            if depth > 1e-6 && (0.0..=panel.length).contains(&along) {
                let column = self.walls[panel.wall].1.column(panel.offset + along);
                hits.push(Hit { depth, wall: panel.wall, column });
            }
        }
        hits.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    }
}

/// Standard normal quantiles at the centres of 256 equal shares: pixel noise from one random byte.
static NORMAL: LazyLock<[f32; 256]> = LazyLock::new(|| {
    // Inverse error function by Newton's method on the cumulative distribution, integrated from its density.
    let density = |x: f64| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
    let cumulative = |x: f64| {
        let steps = 400;
        let width = x / f64::from(steps);
        let inner: f64 = (0..steps).map(|i| density((f64::from(i) + 0.5) * width)).sum();
        0.5 + inner * width
    };
    let mut table = [0.0f32; 256];
    for (i, entry) in table.iter_mut().enumerate() {
        let target = (i as f64 + 0.5) / 256.0;
        let mut x = 0.0;
        for _ in 0..20 {
            x -= (cumulative(x) - target) / density(x);
        }
        *entry = x as f32;
    }
    table
});

/// The camera's sensor: exposure that drifts slowly, and pixel noise.
#[derive(Debug, Clone)]
pub struct Sensor {
    noise: ChaCha8Rng,
    /// Logarithm of the gain, an Ornstein–Uhlenbeck process.
    exposure: f64,
    pixel_noise: f32,
    /// Share that remains of the exposure's deviation after one frame, and standard deviation of what is added.
    keep: f64,
    stir: f64,
    bytes: Vec<u8>,
}

impl Sensor {
    /// A sensor whose exposure is somewhere in its range; `frame_seconds`: time between frames.
    pub fn new(settings: &scenario::Camera, frame_seconds: f64, mut noise: ChaCha8Rng) -> Self {
        let keep = (-frame_seconds / settings.exposure_seconds).exp();
        let normal: f64 = StandardNormal.sample(&mut noise);
        Sensor {
            exposure: settings.exposure_drift * normal,
            pixel_noise: settings.pixel_noise as f32,
            keep,
            stir: settings.exposure_drift * (1.0 - keep * keep).sqrt(),
            bytes: Vec::new(),
            noise,
        }
    }

    /// Expose one frame: change an image as the sensor would.
    pub fn expose(&mut self, image: &mut Image) {
        let normal: f64 = StandardNormal.sample(&mut self.noise);
        self.exposure = self.keep * self.exposure + self.stir * normal;
        let gain = self.exposure.exp() as f32;
        if self.pixel_noise > 0.0 {
            self.bytes.resize(image.rgb.len(), 0);
            self.noise.fill_bytes(&mut self.bytes);
            let table = NORMAL.map(|normal| normal * self.pixel_noise + 0.5);
            for (value, &byte) in image.rgb.iter_mut().zip(&self.bytes) {
                // The cast cuts at 0 and 255; the added half makes it round.
                *value = (f32::from(*value) * gain + table[usize::from(byte)]) as u8;
            }
        } else if gain != 1.0 {
            for value in &mut image.rgb {
                *value = (f32::from(*value) * gain + 0.5) as u8;
            }
        }
    }
}
