//! The floor plan: walls as segments, distances to them, and the places that a disc can reach.

use std::collections::VecDeque;

use nalgebra::{Point2, Vector2};

use super::rooms::Wall;
use super::sections::{Scenario, Task};

/// More cells than this are refused: the room is too large for its resolution.
const MOST_CELLS: usize = 4_000_000;

/// Walls and reachable places of a scenario, for a disc of the robot's size.
#[derive(Debug, Clone)]
pub struct Plan {
    segments: Vec<(Point2<f64>, Point2<f64>)>,
    low: Point2<f64>,
    size: [usize; 2],
    /// Cells whose centre the robot's centre can reach from the start.
    reachable: Vec<bool>,
    radius: f64,
}

/// Why there is no plan.
#[derive(Debug, Clone, PartialEq)]
pub enum PlanFault {
    /// The robot's start is closer to a wall than its radius; the distance.
    StartBlocked(f64),
    /// From the start the robot could leave the walls behind.
    Open,
    /// The walls span too large an area, metres.
    TooLarge(f64, f64),
}

impl Plan {
    /// Side of the cells on which reachability is decided, metres.
    pub const CELL: f64 = 0.05;

    /// Without walls nobody knows the floor: this far from the start to each side stands for it in drawings, metres.
    const UNKNOWN: f64 = 2.0;

    /// Reward of a task for an action that ended at a place.
    pub fn reward(&self, task: &Task, position: Point2<f64>) -> f64 {
        if in_goal(task, position) {
            task.reward
        } else if self.clearance(position) < task.wall_distance {
            task.reward * task.wall_reward
        } else {
            0.0
        }
    }

    /// The plan of a scenario, with everything reachable from the robot's start.
    ///
    /// # Errors
    /// See [`PlanFault`].
    pub fn new(scenario: &Scenario) -> Result<Self, PlanFault> {
        let segments: Vec<_> = scenario.world.walls.iter().flat_map(segments_of).collect();
        let points = segments.iter().flat_map(|(a, b)| [a, b]);
        let start = Point2::from(scenario.robot.start);
        let (low, high) = points.fold((start, start), |(low, high), p| (low.inf(p), high.sup(p)));
        let unknown = segments.is_empty();
        let margin = Vector2::repeat(if unknown { Self::UNKNOWN } else { 2.0 * Self::CELL });
        let (low, high) = (low - margin, high + margin);
        let size = [0, 1]
            .map(|axis| ((high[axis] - low[axis]) / Self::CELL).ceil() as usize)
            .map(|cells| cells.saturating_add(1));
        if size[0].saturating_mul(size[1]) > MOST_CELLS {
            return Err(PlanFault::TooLarge(high.x - low.x, high.y - low.y));
        }
        let radius = scenario.robot.radius;
        let mut plan = Plan { segments, low, size, reachable: vec![unknown; size[0] * size[1]], radius };
        if unknown {
            return Ok(plan);
        }
        let clearance = plan.clearance(start);
        if clearance < radius {
            return Err(PlanFault::StartBlocked(clearance));
        }
        plan.flood(start)?;
        Ok(plan)
    }

    /// Distance from a point to the nearest wall, metres; infinite without walls.
    pub fn clearance(&self, point: Point2<f64>) -> f64 {
        nearest(&self.segments, point)
    }

    /// Whether the robot's centre can be at a point.
    pub fn is_reachable(&self, point: Point2<f64>) -> bool {
        self.cell_of(point).is_some_and(|cell| self.reachable[cell]) && self.clearance(point) >= self.radius
    }

    /// Centres of the cells that the robot's centre can be in, in a fixed order; their side is [`Plan::CELL`].
    pub fn reachable_cells(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        (0..self.reachable.len()).filter(|&cell| self.reachable[cell]).map(|cell| self.centre(cell))
    }

    /// Corners of the box around all reachable places.
    pub fn reachable_box(&self) -> (Point2<f64>, Point2<f64>) {
        let cells = self.reachable_cells();
        let empty = (Point2::from([f64::INFINITY; 2]), Point2::from([f64::NEG_INFINITY; 2]));
        let (low, high) = cells.fold(empty, |(low, high), p| (low.inf(&p), high.sup(&p)));
        let half = Vector2::repeat(0.5 * Self::CELL);
        (low - half, high + half)
    }

    /// Whether the robot can reach some place within a circle.
    pub fn reaches_circle(&self, centre: Point2<f64>, radius: f64) -> bool {
        self.is_reachable(centre) || self.reachable_cells().any(|cell| (cell - centre).norm() <= radius)
    }

    /// Whether the robot can reach some place outside a circle, with room around it to draw places from.
    pub fn leaves_circle(&self, centre: Point2<f64>, radius: f64) -> bool {
        self.reachable_cells().any(|cell| (cell - centre).norm() > radius && self.clearance(cell) >= self.radius)
    }

    /// Corners of the box around all walls and the robot's start.
    pub fn walls_box(&self) -> (Point2<f64>, Point2<f64>) {
        let margin = Vector2::repeat(2.0 * Self::CELL);
        let extent = Vector2::new(self.size[0] as f64 - 1.0, self.size[1] as f64 - 1.0) * Self::CELL;
        (self.low + margin, self.low + extent - margin)
    }

    fn flood(&mut self, start: Point2<f64>) -> Result<(), PlanFault> {
        // The start itself may lie between cell centres that are too close to a wall.
        let Some(first) = self.cell_of(start) else { return Err(PlanFault::Open) };
        self.reachable[first] = true;
        let mut queue = VecDeque::from([first]);
        while let Some(cell) = queue.pop_front() {
            let (column, row) = (cell % self.size[0], cell / self.size[0]);
            if column == 0 || row == 0 || column + 1 == self.size[0] || row + 1 == self.size[1] {
                return Err(PlanFault::Open);
            }
            for next in [cell - 1, cell + 1, cell - self.size[0], cell + self.size[0]] {
                if !self.reachable[next] && self.clearance(self.centre(next)) >= self.radius {
                    self.reachable[next] = true;
                    queue.push_back(next);
                }
            }
        }
        Ok(())
    }

    fn cell_of(&self, point: Point2<f64>) -> Option<usize> {
        let [x, y] = [0, 1].map(|axis| ((point[axis] - self.low[axis]) / Self::CELL).floor());
        let inside = x >= 0.0 && y >= 0.0 && (x as usize) < self.size[0] && (y as usize) < self.size[1];
        inside.then(|| y as usize * self.size[0] + x as usize)
    }

    fn centre(&self, cell: usize) -> Point2<f64> {
        let (column, row) = (cell % self.size[0], cell / self.size[0]);
        self.low + Vector2::new(column as f64 + 0.5, row as f64 + 0.5) * Self::CELL
    }
}

/// The straight pieces of a wall.
pub fn segments_of(wall: &Wall) -> Vec<(Point2<f64>, Point2<f64>)> {
    pieces_of(wall).into_iter().map(|(a, b, _)| (a, b)).collect()
}

/// The straight pieces of a wall, each with the distance along the wall at which it begins.
pub fn pieces_of(wall: &Wall) -> Vec<(Point2<f64>, Point2<f64>, f64)> {
    let corners: Vec<Point2<f64>> = wall.points.iter().map(|&p| Point2::from(p)).collect();
    let mut sides: Vec<_> = corners.windows(2).map(|pair| (pair[0], pair[1])).collect();
    if wall.closed
        && let (Some(&last), Some(&first)) = (corners.last(), corners.first())
    {
        sides.push((last, first));
    }
    let mut pieces = Vec::new();
    let mut offset = 0.0;
    for (a, b) in sides {
        let length = (b - a).norm();
        // What gaps leave of this side, from the start of the wall on.
        let mut from = offset;
        let mut stand = |from: f64, to: f64| {
            let at = |place: f64| if length > 0.0 { a + (b - a) * ((place - offset) / length) } else { a };
            let end = if to == offset + length { b } else { at(to) };
            let start = if from == offset { a } else { at(from) };
            if to > from || wall.gaps.is_empty() {
                pieces.push((start, end, from));
            }
        };
        for &[open, close] in wall.gaps.iter().filter(|gap| gap[1] > offset && gap[0] < offset + length) {
            stand(from, open.max(offset));
            from = close;
        }
        if from < offset + length || wall.gaps.is_empty() {
            stand(from, offset + length);
        }
        offset += length;
    }
    pieces
}

/// Distance from a point to the nearest of some walls, metres.
pub fn clearance(walls: &[Wall], point: Point2<f64>) -> f64 {
    nearest(&walls.iter().flat_map(segments_of).collect::<Vec<_>>(), point)
}

/// Distance from a point to the nearest of some segments, metres; infinite without any.
pub(crate) fn nearest(segments: &[(Point2<f64>, Point2<f64>)], point: Point2<f64>) -> f64 {
    segments.iter().map(|&(a, b)| distance_to_segment(point, a, b)).fold(f64::INFINITY, f64::min)
}

pub(crate) fn distance_to_segment(point: Point2<f64>, a: Point2<f64>, b: Point2<f64>) -> f64 {
    let along = b - a;
    let length = along.norm_squared();
    let t = if length > 0.0 { ((point - a).dot(&along) / length).clamp(0.0, 1.0) } else { 0.0 };
    (point - (a + along * t)).norm()
}

/// Whether a place lies in the goal area of a task.
pub fn in_goal(task: &Task, position: Point2<f64>) -> bool {
    task.goal.is_some_and(|goal| (position - Point2::from(goal)).norm() <= task.radius)
}
