//! The optimal number of steps to a goal, by breadth-first search over noise-free moves.

use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

use nalgebra::{Point2, Vector2};

use crate::robot::Pose;
use crate::scenario::{Robot, Task, distance_to_segment, in_goal};
use crate::world::{Arena, FrameMotion, drive};

/// Poses that agree within this distance (metres) and angle (degrees) count as one.
const SAME_PLACE: f64 = 0.02;
const SAME_HEADING: f64 = 2.0;

/// Side of the squares over which free moves are told from the distance to walls, metres.
const SQUARE: f64 = 0.1;
/// A move that stays farther than this from a wall, beyond the robot's radius, cannot be stopped by it, metres: ten times the
/// distance at which a sweep stops.
const WELL_CLEAR: f64 = 0.01;

/// An area of the floor that is to be avoided.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Its centre, metres.
    pub centre: Point2<f64>,
    /// Its radius, metres.
    pub radius: f64,
}

impl Circle {
    /// Whether a straight move goes from outside into it, or across it.
    pub fn is_entered(&self, from: Point2<f64>, to: Point2<f64>) -> bool {
        (from - self.centre).norm() >= self.radius && distance_to_segment(self.centre, from, to) < self.radius
    }
}

/// The least number of noise-free actions from a pose into a task's goal area without entering what is to be avoided, or `None`
/// beyond `most`.
///
/// The lattice of poses is laid out from the start pose itself, so the first steps are exact; only poses that are reached
/// again within 2 cm and 2° are dropped.
pub fn optimal_steps(
    arena: &Arena,
    robot: &Robot,
    task: &Task,
    avoid: &[Circle],
    start: Pose,
    most: usize,
) -> Option<usize> {
    if in_goal(task, start.position) {
        return Some(0);
    }
    let actions = &robot.actions;
    let motions = actions.iter().map(|action| actions.motion(action));
    let motions: Vec<_> = motions.map(|motion| FrameMotion { length: motion.distance, angle: motion.angle }).collect();
    let key = |pose: &Pose| {
        let place = |value: f64, origin: f64| ((value - origin) / SAME_PLACE).round() as i32;
        let degrees = (pose.heading - start.heading).to_degrees().rem_euclid(360.0);
        let headings = (360.0 / SAME_HEADING) as u32;
        let Point2 { coords } = pose.position;
        // 180 headings take 8 bits; 28 bits of 2 cm reach farther than any room.
        let (x, y) = (place(coords.x, start.position.x) as u32, place(coords.y, start.position.y) as u32);
        u64::from(x) << 36 ^ u64::from(y) << 8 ^ u64::from((degrees / SAME_HEADING).round() as u32 % headings)
    };
    let mut open = Open { arena, reach: robot.radius + robot.forward + WELL_CLEAR, squares: HashMap::new() };
    let mut seen: HashSet<u64, BuildHasherDefault<Mix>> = HashSet::from_iter([key(&start)]);
    let mut frontier = vec![start];
    for steps in 1..=most {
        let mut next = Vec::new();
        for pose in &frontier {
            let free = open.around(pose.position);
            for &motion in &motions {
                let moved = if free { unhindered(*pose, motion) } else { drive(*pose, motion, arena, robot.radius).0 };
                if avoid.iter().any(|area| area.is_entered(pose.position, moved.position)) {
                    continue;
                }
                if in_goal(task, moved.position) {
                    return Some(steps);
                }
                if seen.insert(key(&moved)) {
                    next.push(moved);
                }
            }
        }
        if next.is_empty() {
            return None;
        }
        frontier = next;
    }
    None
}

/// Mixes the bits of a key: most of the time of a search goes into looking keys up, which nobody chooses to make it slow.
#[derive(Default)]
struct Mix(u64);

impl Hasher for Mix {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_u64(u64::from(byte)));
    }

    fn write_u64(&mut self, key: u64) {
        // Fibonacci hashing: the odd number next to 2⁶⁴ over the golden ratio; the map reads high and low bits.
        let product = (self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = product ^ product >> 32;
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Where a motion leads that no wall stops: what [`drive`] says there, without asking the walls.
fn unhindered(pose: Pose, motion: FrameMotion) -> Pose {
    let turned = Pose::new(pose.position, pose.heading + motion.angle);
    Pose { position: pose.position + turned.direction() * motion.length, ..turned }
}

/// Squares of the floor from which no wall can stop a move, found when they are first asked for.
struct Open<'a> {
    arena: &'a Arena,
    /// Distance from a robot's centre to a wall beyond which the wall does not matter, metres.
    reach: f64,
    squares: HashMap<(i32, i32), bool>,
}

impl Open<'_> {
    fn around(&mut self, place: Point2<f64>) -> bool {
        let square = (place / SQUARE).map(|value| value.floor() as i32);
        *self.squares.entry((square.x, square.y)).or_insert_with(|| {
            let centre = (square.map(f64::from) + Vector2::repeat(0.5)) * SQUARE;
            // The farthest point of the square is half its diagonal away.
            self.arena.clearance(centre) - SQUARE * std::f64::consts::FRAC_1_SQRT_2 > self.reach
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::Scenario;
    use crate::world::World;

    const LAB: &str = include_str!("../../scenarios/lab.toml");

    #[test]
    fn free_moves_lead_where_the_walls_let_them() {
        let scenario = Scenario::parse(LAB, "lab.toml".as_ref(), &[]).unwrap();
        let arena = World::new(&scenario).unwrap().arena;
        let (radius, length) = (scenario.robot.radius, scenario.robot.forward);
        let mut open = Open { arena: &arena, reach: radius + length + WELL_CLEAR, squares: HashMap::new() };
        let mut free = 0;
        for i in 0..5000 {
            let (x, y) = (0.3 + 2.4 * f64::from(i % 71) / 71.0, 0.3 + 1.2 * f64::from(i % 83) / 83.0);
            let pose = Pose::new(Point2::new(x, y), 0.37 * f64::from(i));
            let motion = FrameMotion { length, angle: 0.0 };
            if open.around(pose.position) {
                assert_eq!(drive(pose, motion, &arena, radius), (unhindered(pose, motion), false));
                free += 1;
            }
        }
        assert!((100..4000).contains(&free), "{free} of 5000 are free");
    }
}
