//! Distractors as the camera sees them: upright cylinders of one colour, somewhere on their paths.

use nalgebra::{Point2, Vector2};

use super::texture::hsv;
use crate::scenario;

const SATURATION: f64 = 0.7;
/// Brightness of what is bright, and of a blinking thing while it is dark.
const BRIGHT: f64 = 0.95;
const DARK: f64 = 0.15;

/// A distractor in numbers that do not depend on time.
#[derive(Debug)]
pub struct Distractor {
    path: Vec<Point2<f64>>,
    /// Way from the first corner to each, metres.
    ways: Vec<f64>,
    speed: f64,
    blink_seconds: Option<f64>,
    /// Bright and dark texel.
    colours: [u32; 2],
    radius: f64,
    bottom: f64,
    top: f64,
}

/// A distractor at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Present {
    pub(super) centre: Point2<f64>,
    pub(super) radius: f64,
    /// Metres above the floor.
    pub bottom: f64,
    /// Metres above the floor.
    pub top: f64,
    /// Its texel.
    pub colour: u32,
}

fn texel(hue: f64, value: f64) -> u32 {
    let [r, g, b] = hsv(hue, SATURATION, value).map(|v| (255.0 * v).round() as u8);
    u32::from_le_bytes([r, g, b, 0])
}

impl Distractor {
    /// The distractor of a scenario.
    pub fn new(distractor: &scenario::Distractor) -> Self {
        let mut path: Vec<Point2<f64>> = distractor.path.iter().map(|&corner| Point2::from(corner)).collect();
        path.dedup();
        let ways = path.windows(2).scan(0.0, |way, pair| {
            *way += (pair[1] - pair[0]).norm();
            Some(*way)
        });
        let ways = std::iter::once(0.0).chain(ways).collect();
        Distractor {
            path,
            ways,
            speed: distractor.speed,
            blink_seconds: distractor.blink_seconds,
            colours: [BRIGHT, DARK].map(|value| texel(distractor.hue, value)),
            radius: distractor.radius,
            bottom: distractor.bottom,
            top: distractor.top,
        }
    }

    /// Where and how it is at a time, seconds.
    pub fn at(&self, seconds: f64) -> Present {
        let phase = self.blink_seconds.map_or(0, |each| (seconds / each).floor().rem_euclid(2.0) as usize);
        let Distractor { radius, bottom, top, .. } = *self;
        Present { centre: self.place(seconds), radius, bottom, top, colour: self.colours[phase] }
    }

    fn place(&self, seconds: f64) -> Point2<f64> {
        // A checked path has a corner at least.
        let length = self.ways.last().copied().unwrap_or(0.0);
        if length == 0.0 {
            return self.path.first().copied().unwrap_or_default();
        }
        let gone = (self.speed * seconds).rem_euclid(2.0 * length);
        let way = if gone > length { 2.0 * length - gone } else { gone };
        let next = self.ways.partition_point(|&corner| corner < way).clamp(1, self.path.len() - 1);
        let share = (way - self.ways[next - 1]) / (self.ways[next] - self.ways[next - 1]);
        self.path[next - 1] + (self.path[next] - self.path[next - 1]) * share
    }
}

impl Present {
    /// Something that can be pushed, where it is now.
    pub fn thing(centre: Point2<f64>, thing: &scenario::Movable) -> Self {
        Present { centre, radius: thing.radius, bottom: 0.0, top: thing.height, colour: texel(thing.hue, BRIGHT) }
    }

    /// Depth at which a ray on the floor plan, `from + depth · ray`, meets its side; `None` where it passes, or begins inside.
    pub fn depth(&self, from: Point2<f64>, ray: Vector2<f64>) -> Option<f64> {
        let to = self.centre - from;
        let (squared, ahead) = (ray.norm_squared(), to.dot(&ray));
        let under_root = ahead * ahead - squared * (to.norm_squared() - self.radius * self.radius);
        let depth = (ahead - under_root.max(0.0).sqrt()) / squared;
        (under_root >= 0.0 && depth > 0.0).then_some(depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walker(blink_seconds: Option<f64>) -> Distractor {
        Distractor::new(&scenario::Distractor {
            path: vec![[1.0, 0.0], [4.0, 0.0], [4.0, 1.0]],
            speed: 0.5,
            radius: 0.25,
            bottom: 0.0,
            top: 1.7,
            hue: 10.0,
            blink_seconds,
        })
    }

    #[test]
    fn it_goes_to_and_fro_at_its_speed() {
        let places = [(0.0, [1.0, 0.0]), (2.0, [2.0, 0.0]), (7.0, [4.0, 0.5]), (8.0, [4.0, 1.0]), (10.0, [4.0, 0.0])];
        for (seconds, place) in places {
            let at = walker(None).at(seconds).centre;
            assert!((at - Point2::from(place)).norm() < 1e-12, "{seconds} s: {at}");
            let later = walker(None).at(seconds + 32.0).centre;
            assert!((later - at).norm() < 1e-9, "{seconds} s, two ways back and forth later: {later}");
        }
    }

    #[test]
    fn it_is_bright_and_dark_in_turn() {
        let lamp = walker(Some(3.0));
        assert_eq!(lamp.at(0.0).colour, lamp.at(2.9).colour);
        assert_ne!(lamp.at(2.9).colour, lamp.at(3.1).colour);
        assert_eq!(lamp.at(6.1).colour, lamp.at(0.0).colour);
    }

    #[test]
    fn rays_meet_its_side_where_geometry_says() {
        let present = walker(None).at(0.0);
        assert_eq!(present.depth(Point2::origin(), Vector2::x()), Some(0.75));
        assert_eq!(present.depth(Point2::new(0.0, 0.3), Vector2::x()), None);
        assert_eq!(present.depth(Point2::new(1.0, 0.1), Vector2::x()), None);
        assert_eq!(present.depth(Point2::new(2.0, 0.0), Vector2::x()), None);
    }
}
