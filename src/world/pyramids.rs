//! Pyramids as the camera sees them: solids of four faces, each of one colour.

use nalgebra::{Point2, Vector2};

use super::texture::hsv;
use crate::scenario;

/// Where light comes from, degrees from the x-axis: the four faces of a pyramid differ in brightness.
const SUN_DEG: f64 = 65.0;
/// Brightness of a face that looks away from the sun, and by how much one that looks into it is brighter.
const SHADE: f64 = 0.42;
const LIGHT: f64 = 0.48;
const SATURATION: f64 = 0.45;

/// A pyramid in numbers that do not depend on the camera's pose.
pub struct Pyramid {
    pub(super) centre: Point2<f64>,
    /// Unit vectors of the faces' normals on the floor plan.
    pub(super) normals: [Vector2<f64>; 4],
    /// Texels of the faces.
    pub(super) colours: [u32; 4],
    pub(super) half: f64,
    pub(super) height: f64,
    reach: f64,
}

/// A pyramid as a ray on the floor plan meets it: the height over its depth is at most `rise[i] · depth + at[i]` for each face.
pub struct Crossing {
    at: [f64; 4],
    rise: [f64; 4],
    colours: [u32; 4],
}

impl Pyramid {
    /// The pyramid of a scenario.
    pub fn new(pyramid: &scenario::Pyramid) -> Self {
        let degrees = |face: usize| pyramid.turn_deg + 90.0 * face as f64;
        let normal = |face: usize| {
            let (sin, cos) = degrees(face).to_radians().sin_cos();
            Vector2::new(cos, sin)
        };
        let colour = |face: usize| {
            let sun = (degrees(face) - SUN_DEG).to_radians().cos().max(0.0);
            let [r, g, b] = hsv(pyramid.hue, SATURATION, SHADE + LIGHT * sun).map(|v| (255.0 * v).round() as u8);
            u32::from_le_bytes([r, g, b, 0])
        };
        Pyramid {
            centre: Point2::from(pyramid.centre),
            normals: std::array::from_fn(normal),
            colours: std::array::from_fn(colour),
            half: 0.5 * pyramid.side,
            height: pyramid.height,
            reach: pyramid.reach(),
        }
    }

    /// How a ray on the floor plan, `from + depth · ray`, meets it; `None` where it passes.
    pub fn cross(&self, from: Point2<f64>, ray: Vector2<f64>) -> Option<Crossing> {
        let to = self.centre - from;
        let ahead = to.dot(&ray);
        if ahead <= 0.0 || to.perp(&ray).abs() > self.reach * ray.norm() {
            return None;
        }
        // Over a place at distance s along a face's normal, that face is height · (1 − s / half) high.
        let slant = self.height / self.half;
        let crossing = Crossing {
            at: self.normals.map(|normal| self.height + slant * to.dot(&normal)),
            rise: self.normals.map(|normal| -slant * ray.dot(&normal)),
            colours: self.colours,
        };
        Some(crossing)
    }
}

impl Crossing {
    /// Depth at which a line of sight, `mount + slope · depth` high, enters the pyramid above the ground, and the texel of the
    /// face that it enters.
    pub fn entry(&self, mount: f64, slope: f64) -> Option<(f64, u32)> {
        let (mut enter, mut leave, mut face) = (0.0f64, f64::INFINITY, None);
        for i in 0..4 {
            // Inside: (slope − rise) · depth ≤ at − mount.
            let (rate, room) = (slope - self.rise[i], self.at[i] - mount);
            if rate < 0.0 {
                let depth = room / rate;
                if depth > enter {
                    (enter, face) = (depth, Some(i));
                }
            } else if rate > 0.0 {
                leave = leave.min(room / rate);
            } else if room < 0.0 {
                return None;
            }
        }
        let texel = self.colours[face?];
        (enter <= leave && mount + slope * enter >= 0.0).then_some((enter, texel))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pyramid(turn_deg: f64) -> Pyramid {
        Pyramid::new(&scenario::Pyramid { centre: [20.0, 0.0], side: 10.0, height: 8.0, turn_deg, hue: 40.0 })
    }

    #[test]
    fn lines_of_sight_meet_faces_where_geometry_says() {
        let seen = pyramid(0.0).cross(Point2::origin(), Vector2::x()).unwrap();
        // Level: at 0.5 m above the ground the near face is 15 m + 0.5 · 5/8 m away.
        let (depth, _) = seen.entry(0.5, 0.0).unwrap();
        assert!((depth - 15.3125).abs() < 1e-12, "{depth}");
        // The top is 8 m high, 20 m away.
        assert!(seen.entry(0.5, 7.49 / 20.0).is_some() && seen.entry(0.5, 7.51 / 20.0).is_none());
        // Down to the ground before it.
        assert!(seen.entry(0.5, -0.5 / 14.9).is_none() && seen.entry(0.5, -0.5 / 15.1).is_some());
    }

    #[test]
    fn rays_pass_beside_and_behind() {
        let along = |degrees: f64| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            pyramid(0.0).cross(Point2::origin(), Vector2::new(cos, sin)).and_then(|seen| seen.entry(0.0, 0.0))
        };
        // Its corners stand on the ground, at atan(5/15).
        assert!(along(18.0).is_some() && along(-18.0).is_some() && along(19.0).is_none() && along(180.0).is_none());
        // Turned by 45° it shows an edge, nearer by √2.
        let seen = pyramid(45.0).cross(Point2::origin(), Vector2::x()).unwrap();
        let depth = seen.entry(0.0, 0.0).unwrap().0;
        assert!((depth - (20.0 - 50f64.sqrt())).abs() < 1e-9, "{depth}");
    }
}
