//! A room from above: its walls, goals, and where it is near a wall.

use nalgebra::{Point2, Vector2};
use plotters::prelude::*;

use super::draw::{BAD, GOAL, INK, Mark};
use crate::robot::Pose;
use crate::scenario::{Plan, Scenario, Task, plan_segments};
use crate::world::World;

/// Where it is near a wall.
pub const HATCH: RGBColor = RGBColor(90, 90, 90);
const NO_WALL_COLOUR: [u8; 3] = [60, 60, 60];

/// A room.
#[derive(Clone, Copy)]
pub struct Room<'a> {
    /// Its walls and tasks.
    pub scenario: &'a Scenario,
    /// The same, as the robot meets them.
    pub world: &'a World,
}

impl Room<'_> {
    /// Whether it has any; that of another program's robot may have none.
    pub fn has_walls(&self) -> bool {
        !self.scenario.world.walls.is_empty()
    }

    /// Corners of what is shown of it, metres.
    pub fn corners(&self) -> ([f64; 2], [f64; 2]) {
        let (low, high) = self.world.plan.walls_box();
        let margin = Vector2::repeat(0.03 * (high - low).max());
        ((low - margin).into(), (high + margin).into())
    }

    /// Its walls in their colours, `width` pixels wide.
    pub fn walls(&self, width: u32) -> Vec<Mark> {
        let colours = self.world.appearance.camera(u64::MAX).wall_colours();
        let pieces = |width: u32, colour: &dyn Fn(usize) -> RGBColor| -> Vec<Mark> {
            let walls = self.scenario.world.walls.iter().enumerate();
            let pieces = walls.flat_map(|(index, wall)| {
                let colour = colour(index).mix(1.0);
                plan_segments(wall).into_iter().map(move |(a, b)| Mark::Line(vec![a.into(), b.into()], colour, width))
            });
            pieces.collect()
        };
        let mut marks = pieces(width + 3, &|_| INK);
        marks.extend(pieces(width, &|index| {
            let [r, g, b] = colours.get(index).copied().unwrap_or(NO_WALL_COLOUR);
            RGBColor(r, g, b)
        }));
        marks
    }

    /// The goal area of a task, and what is to be avoided, where they are known.
    pub fn goal(&self, task: usize) -> Vec<Mark> {
        let task = &self.scenario.tasks[task];
        let goal = task.goal.map(|goal| Mark::Disc(goal, task.radius, GOAL));
        goal.into_iter().chain((0..self.scenario.avoids.len()).filter_map(|avoid| self.avoided(avoid))).collect()
    }

    /// One of the areas that are to be avoided, where it is known.
    pub fn avoided(&self, avoid: usize) -> Option<Mark> {
        let avoid = &self.scenario.avoids[avoid];
        Some(Mark::Disc(avoid.at?, avoid.radius, BAD))
    }

    /// Lines over the places that a task calls near a wall, `apart` metres from each other.
    pub fn near_walls(&self, task: usize, apart: f64) -> Vec<Mark> {
        let (task, (low, high)) = (&self.scenario.tasks[task], self.world.plan.walls_box());
        let lines = hatching(low, high, apart, |point| self.is_near_wall(task, point));
        lines.into_iter().map(|(a, b)| Mark::Line(vec![a.into(), b.into()], HATCH.mix(0.3), 1)).collect()
    }

    /// Whether a point of the room counts as near a wall; what lies behind the walls is no part of the room.
    fn is_near_wall(&self, task: &Task, point: Point2<f64>) -> bool {
        if self.world.plan.clearance(point) >= task.wall_distance {
            return false;
        }
        let (plan, arena): (&Plan, _) = (&self.world.plan, &self.world.arena);
        // From the last corner of a room a robot in that corner is √2 radii away.
        let reach = 1.5 * self.scenario.robot.radius;
        plan.is_reachable(point)
            || (0..16).any(|i| {
                let direction = Pose::new(point, std::f64::consts::TAU * f64::from(i) / 16.0).direction();
                plan.is_reachable(point + direction * reach) && arena.range(point, direction, reach) >= reach
            })
    }
}

/// Diagonal lines, `apart` metres from each other along x, over all points that `covers` names.
fn hatching(
    low: Point2<f64>,
    high: Point2<f64>,
    apart: f64,
    covers: impl Fn(Point2<f64>) -> bool,
) -> Vec<(Point2<f64>, Point2<f64>)> {
    let size = high - low;
    let step = 0.25 * apart;
    let mut pieces = Vec::new();
    for line in 0..((size.x + size.y) / apart) as usize {
        let start = Point2::new(low.x - size.y + line as f64 * apart, low.y);
        let points = (0..=(size.y / step) as usize).map(|i| start + Vector2::repeat(i as f64 * step));
        let mut piece: Option<(Point2<f64>, Point2<f64>)> = None;
        for point in points.filter(|point| (low.x..=high.x).contains(&point.x)) {
            if covers(point) {
                piece = Some((piece.map_or(point, |(from, _)| from), point));
            } else {
                pieces.extend(piece.take());
            }
        }
        pieces.extend(piece);
    }
    pieces
}
