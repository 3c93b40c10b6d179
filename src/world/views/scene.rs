//! A camera's world in the numbers that the shader reads.

use nalgebra::{Point2, Vector2};

use super::super::Camera;
use super::super::distractors::Present;
use crate::robot::Pose;

/// Rows of four words.
pub type Words = Vec<[u32; 4]>;

/// What all views of a camera have in common.
pub struct Scene {
    /// Columns, panels, pyramids, textures.
    pub words: Words,
    /// Texels of all textures, one after another.
    pub texels: Vec<u32>,
    /// Where the words of panels, pyramids and textures begin.
    pub begins: [u32; 3],
    /// How many panels and pyramids there are.
    pub counts: [u32; 2],
    /// Places are relative to this point, so that single precision suffices far from the world's origin.
    origin: Point2<f64>,
}

/// Numbers as their bits in single precision.
fn bits(numbers: [f64; 4]) -> [u32; 4] {
    numbers.map(|number| (number as f32).to_bits())
}

/// The part of a number of periods behind the point.
fn phase(periods: f64) -> f64 {
    periods.rem_euclid(1.0)
}

impl Scene {
    pub fn new(camera: &Camera) -> Self {
        let corners: Vec<Vector2<f64>> = camera.panels.iter().map(|panel| panel.from.coords).collect();
        let origin = Point2::from(corners.iter().sum::<Vector2<f64>>() / corners.len().max(1) as f64);
        let mut words: Words =
            camera.columns.iter().map(|column| bits([column.aside, column.bearing, column.degrees, 0.0])).collect();
        let panels = words.len() as u32;
        for panel in &camera.panels {
            let from = panel.from - origin;
            words.push(bits([from.x, from.y, panel.along.x, panel.along.y]));
            let mut more = bits([panel.length, panel.offset, camera.walls[panel.wall].0, 0.0]);
            more[3] = TEXTURE_WORDS * (panel.wall as u32 + 2);
            words.push(more);
        }
        let pyramids = words.len() as u32;
        for pyramid in &camera.pyramids {
            let centre = pyramid.centre - origin;
            let [a, b, c, d] = pyramid.normals;
            words.push(bits([centre.x, centre.y, pyramid.half, pyramid.height]));
            words.push(bits([a.x, a.y, b.x, b.y]));
            words.push(bits([c.x, c.y, d.x, d.y]));
            words.push(pyramid.colours);
        }
        let textures = words.len() as u32;
        let mut texels = Vec::new();
        let walls = camera.walls.iter().map(|(_, texture)| texture);
        for texture in [&camera.floor, &camera.surroundings].into_iter().chain(walls) {
            let (width, height) = texture.size();
            words.push([texels.len() as u32, width as u32, height as u32, 0]);
            words.push(bits([texture.periods(0), texture.periods(1), 0.0, 0.0]));
            texels.extend_from_slice(texture.texels());
        }
        let counts = [camera.panels.len() as u32, camera.pyramids.len() as u32];
        Scene { words, texels, begins: [panels, pyramids, textures], counts, origin }
    }

    /// The words of a view.
    pub fn view(&self, camera: &Camera, pose: &Pose, distractors: &[Present], words: &mut Words) {
        let (place, ahead) = (pose.position - self.origin, pose.direction());
        words.push(bits([place.x, place.y, ahead.x, ahead.y]));
        let floor = |axis: usize| phase(pose.position[axis] * camera.floor.periods(axis));
        let around = phase(pose.heading.to_degrees() * camera.surroundings.periods(0));
        words.push(bits([floor(0), floor(1), around, 0.0]));
        for present in distractors {
            let centre = present.centre - self.origin;
            words.push(bits([centre.x, centre.y, present.radius, present.bottom]));
            words.push([(present.top as f32).to_bits(), present.colour, 0, 0]);
        }
    }

    /// Rows of four words of a view among so many distractors.
    pub fn view_words(distractors: usize) -> usize {
        2 + 2 * distractors
    }
}

/// Rows of four words of a texture.
const TEXTURE_WORDS: u32 = 2;
