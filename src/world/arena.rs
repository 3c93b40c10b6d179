//! Walls for contacts and sonar, as rapier colliders.
//!
//! The robot is a disc that is swept through the walls: it goes as far as it can and stops there, as a robot with bumpers
//! does; it does not slide. Between frames it has no velocity, so its pose is all there is to know about it.

use nalgebra::{Point2, Vector2};
use rapier2d::parry::query::ShapeCastOptions;
use rapier2d::prelude::{Ball, ColliderBuilder, PhysicsWorld, Pose as RapierPose, Ray, Vector};

use crate::scenario::{Wall, nearest, plan_segments};

/// A swept disc stops this far from a wall, metres, so that the next sweep does not start inside it.
const SKIN: f64 = 1e-3;

/// The walls.
pub struct Arena {
    physics: PhysicsWorld,
    segments: Vec<(Point2<f64>, Point2<f64>)>,
}

impl std::fmt::Debug for Arena {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Arena({} walls)", self.physics.colliders.len())
    }
}

/// A point or vector in rapier's single precision: 1e-7 of a few metres, far below the skin.
fn single(x: f64, y: f64) -> Vector {
    Vector::new(x as f32, y as f32)
}

impl Arena {
    /// Colliders for polylines.
    pub fn new(walls: &[Wall]) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::ZERO;
        for wall in walls {
            if !wall.gaps.is_empty() {
                // What stands of a wall with gaps is not joined.
                for (a, b) in plan_segments(wall) {
                    let ends = vec![single(a.x, a.y), single(b.x, b.y)];
                    physics.insert_collider(ColliderBuilder::polyline(ends, None), None);
                }
                continue;
            }
            let mut corners: Vec<Vector> = wall.points.iter().map(|p| single(p[0], p[1])).collect();
            if wall.closed {
                corners.extend(corners.first().copied());
            }
            physics.insert_collider(ColliderBuilder::polyline(corners, None), None);
        }
        // Nothing moves in here by itself: one step builds the search tree.
        physics.step();
        Arena { physics, segments: walls.iter().flat_map(plan_segments).collect() }
    }

    /// Distance from a point to the nearest wall, metres; infinite without walls.
    pub fn clearance(&self, point: Point2<f64>) -> f64 {
        nearest(&self.segments, point)
    }

    /// Sweep a disc along a translation; the part of it that is free, and whether a wall stopped it.
    pub fn sweep(&self, from: Point2<f64>, translation: Vector2<f64>, radius: f64) -> (Vector2<f64>, bool) {
        let length = translation.norm();
        if length < 1e-9 {
            return (translation, false);
        }
        let direction = translation / length;
        let options = ShapeCastOptions {
            max_time_of_impact: length as f32,
            target_distance: SKIN as f32,
            stop_at_penetration: false,
            compute_impact_geometry_on_penetration: true,
        };
        let hit = self.physics.query_pipeline().cast_shape(
            &RapierPose::from_translation(single(from.x, from.y)),
            single(direction.x, direction.y),
            &Ball::new(radius as f32),
            options,
        );
        match hit {
            None => (translation, false),
            Some((_, hit)) => (direction * f64::from(hit.time_of_impact).clamp(0.0, length), true),
        }
    }

    /// Distance from a point to the first wall in a direction (a unit vector), at most `range`.
    pub fn range(&self, from: Point2<f64>, direction: Vector2<f64>, range: f64) -> f64 {
        let ray = Ray::new(single(from.x, from.y), single(direction.x, direction.y));
        let hit = self.physics.query_pipeline().cast_ray(&ray, range as f32, true);
        hit.map_or(range, |(_, distance)| f64::from(distance).min(range))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{Pattern, Texture};

    fn room() -> Arena {
        let texture = Texture {
            image: None,
            pattern: Pattern::Plain,
            scale: 1.0,
            hue: 0.0,
            hue_spread: 0.0,
            contrast: 0.0,
            seed: 0,
        };
        let points = vec![[0.0, 0.0], [3.0, 0.0], [3.0, 1.8], [0.0, 1.8]];
        Arena::new(&[Wall { points, closed: true, gaps: Vec::new(), height: 0.9, texture }])
    }

    #[test]
    fn a_disc_stops_at_walls_and_leaves_them_freely() {
        let arena = room();
        let (free, blocked) = arena.sweep(Point2::new(1.5, 0.9), Vector2::new(0.3, 0.0), 0.25);
        assert_eq!((free, blocked), (Vector2::new(0.3, 0.0), false));
        let (free, blocked) = arena.sweep(Point2::new(2.6, 0.9), Vector2::new(0.3, 0.0), 0.25);
        assert!(blocked && (free.x - (0.15 - SKIN)).abs() < 1e-5, "{free}");
        // At the wall: further in is blocked at once, away from it is free.
        let at = Point2::new(2.6 + free.x, 0.9);
        let (free, blocked) = arena.sweep(at, Vector2::new(0.3, 0.0), 0.25);
        assert!(blocked && free.norm() < 1e-5);
        let (free, blocked) = arena.sweep(at, Vector2::new(-0.3, 0.0), 0.25);
        assert!(!blocked && (free.x + 0.3).abs() < 1e-12);
    }

    #[test]
    fn sonar_measures_distances_to_walls() {
        let arena = room();
        let from = Point2::new(1.0, 0.5);
        assert!((arena.range(from, Vector2::x(), 5.0) - 2.0).abs() < 1e-5);
        assert!((arena.range(from, -Vector2::y(), 5.0) - 0.5).abs() < 1e-5);
        assert_eq!(arena.range(from, Vector2::x(), 1.2), 1.2);
    }
}
