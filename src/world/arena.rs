//! Walls for contacts and sonar.
//!
//! The robot is a disc that is swept through the walls: it goes as far as it can and stops there, as a robot with bumpers
//! does; it does not slide. Between frames it has no velocity, so its pose is all there is to know about it.
//!
//! Sonar asks rapier's colliders. Contacts do not: its cast of a disc, which is iterative and in single precision, misses the wall in 3
//! of 10 000 blind moves, where a disc that touches one goes on at a slant, and lets it in by some centimetres. The way of a disc to
//! a straight wall is known in closed form.

use nalgebra::{Point2, Vector2};
use rapier2d::prelude::{ColliderBuilder, PhysicsWorld, Ray, Vector};

use crate::scenario::{Wall, nearest, plan_segments};

/// A swept disc stops this far from a wall, metres, so that rounding never puts it into one.
const SKIN: f64 = 1e-3;
/// A disc that touches a wall may come nearer by this, metres, so that rounding does not stop one that goes along it.
const SLACK: f64 = 1e-9;

/// A straight piece of a wall, from end to end.
pub type Segment = (Point2<f64>, Point2<f64>);

/// The walls.
pub struct Arena {
    physics: PhysicsWorld,
    segments: Vec<Segment>,
}

impl std::fmt::Debug for Arena {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Arena({} walls)", self.physics.colliders.len())
    }
}

/// A point or vector in rapier's single precision: 1e-7 of a few metres.
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

    /// All walls.
    pub fn walls(&self) -> &[Segment] {
        &self.segments
    }

    /// Sweep a disc along a translation; the part of it that is free, and whether a wall stopped it.
    pub fn sweep(&self, from: Point2<f64>, translation: Vector2<f64>, radius: f64) -> (Vector2<f64>, bool) {
        sweep(&self.segments, from, translation, radius)
    }

    /// The walls that come at least this near to a point, metres.
    pub fn walls_within(&self, reach: f64, point: Point2<f64>) -> Vec<Segment> {
        self.segments.iter().copied().filter(|&wall| nearest(&[wall], point) <= reach).collect()
    }

    /// Distance from a point to the first wall in a direction (a unit vector), at most `range`.
    pub fn range(&self, from: Point2<f64>, direction: Vector2<f64>, range: f64) -> f64 {
        let ray = Ray::new(single(from.x, from.y), single(direction.x, direction.y));
        let hit = self.physics.query_pipeline().cast_ray(&ray, range as f32, true);
        hit.map_or(range, |(_, distance)| f64::from(distance).min(range))
    }
}

/// [`Arena::sweep`] among some of the walls.
pub(super) fn sweep(
    walls: &[Segment],
    from: Point2<f64>,
    translation: Vector2<f64>,
    radius: f64,
) -> (Vector2<f64>, bool) {
    let length = translation.norm();
    if length < 1e-9 {
        return (translation, false);
    }
    let direction = translation / length;
    let free = walls.iter().filter_map(|&wall| way_to(wall, from, direction, radius));
    let free = free.fold(f64::INFINITY, f64::min);
    if free < length { (direction * free, true) } else { (translation, false) }
}

/// How far a disc goes in a direction (a unit vector) until it touches a wall from `a` to `b`; `None` if it never does.
///
/// The distance to the wall is a convex function of the way: a disc that touches it and does not come nearer at first never does.
fn way_to((a, b): Segment, from: Point2<f64>, direction: Vector2<f64>, radius: f64) -> Option<f64> {
    let distance = nearest(&[(a, b)], from);
    // One that is nearer than it should be may not come nearer still.
    let touching = if distance > radius + SKIN { radius + SKIN } else { (distance - SLACK).max(radius).min(distance) };
    let along = b - a;
    let length = along.norm();
    // To the straight part, on the side that it is on.
    let straight = (length > 0.0).then(|| along / length).and_then(|along| {
        let normal = Vector2::new(-along.y, along.x);
        let distance = (from - a).dot(&normal);
        let approach = -direction.dot(&normal) * distance.signum();
        let gap = distance.abs() - touching;
        let way = gap.max(0.0) / approach;
        let foot = (from + direction * way - a).dot(&along);
        (approach > 0.0 && gap > -SLACK && (0.0..=length).contains(&foot)).then_some(way)
    });
    // To its ends, which are round.
    let to_end = |end: Point2<f64>| {
        let offset = end - from;
        let middle = offset.dot(&direction);
        let aside = offset.norm_squared() - middle * middle;
        let way = middle - (touching * touching - aside).max(0.0).sqrt();
        (aside < touching * touching && middle > 0.0).then_some(way.max(0.0))
    };
    [straight, to_end(a), to_end(b)].into_iter().flatten().min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;
    use crate::scenario::{Pattern, Texture};
    use rand::RngExt;
    use std::f64::consts::{FRAC_PI_2, TAU};

    fn room_texture() -> Texture {
        Texture { image: None, pattern: Pattern::Plain, scale: 1.0, hue: 0.0, hue_spread: 0.0, contrast: 0.0, seed: 0 }
    }

    fn room() -> Arena {
        let texture = room_texture();
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
    fn a_disc_that_drives_blindly_never_gets_into_a_wall() {
        let texture = room_texture();
        let edge = Wall {
            points: vec![[1.0, 0.0], [1.0, 0.7], [1.3, 1.1]],
            closed: false,
            gaps: Vec::new(),
            height: 0.9,
            texture: texture.clone(),
        };
        let points = vec![[0.0, 0.0], [3.0, 0.0], [3.0, 1.8], [0.0, 1.8]];
        let arena = Arena::new(&[Wall { points, closed: true, gaps: Vec::new(), height: 0.9, texture }, edge]);
        let (mut place, radius) = (Point2::new(2.0, 0.9), 0.1);
        let mut rng = stream(1, "blind");
        let (mut stopped, mut touched) = (0, 0);
        for i in 0..300_000 {
            // Along walls, away from them and into them, and short ways beside long ones.
            let angle =
                if i % 5 == 0 { FRAC_PI_2 * f64::from(rng.random_range(0..4)) } else { rng.random_range(0.0..TAU) };
            let way = Vector2::new(angle.cos(), angle.sin()) * rng.random_range(0.0..0.7);
            let (free, blocked) = arena.sweep(place, way, radius);
            assert!((free - way).norm() < 1e-12 || blocked, "{place} {way}");
            // Nothing on the way is nearer than the disc's rim, and where it stops there is a wall.
            for share in [0.25, 0.5, 0.75, 1.0] {
                let clearance = arena.clearance(place + free * share);
                assert!(clearance > radius, "{clearance} from {place} by {way}");
            }
            place += free;
            stopped += i32::from(blocked);
            touched += i32::from(blocked && arena.clearance(place) < radius + SKIN + 1e-9);
        }
        assert!(stopped == touched && stopped > 10_000, "{stopped} {touched}");
    }

    #[test]
    fn a_disc_slips_along_a_wall_that_it_touches_and_gets_out_of_one() {
        let arena = room();
        let at = Point2::new(0.5, 0.1 + SKIN);
        let (free, blocked) = arena.sweep(at, Vector2::new(1.5, 0.0), 0.1);
        assert_eq!((free, blocked), (Vector2::new(1.5, 0.0), false));
        // In it by a millimetre: out is free, and further in is not.
        let (free, blocked) = arena.sweep(Point2::new(0.5, 0.099), Vector2::new(0.0, 0.5), 0.1);
        assert_eq!((free, blocked), (Vector2::new(0.0, 0.5), false));
        let (free, blocked) = arena.sweep(Point2::new(0.5, 0.099), Vector2::new(0.5, -0.01), 0.1);
        assert!(blocked && free.norm() < 1e-6, "{free}");
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
