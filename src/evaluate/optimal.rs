//! The optimal number of steps to a goal, by breadth-first search over noise-free moves on the ways that can be short enough.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap, HashSet};
use std::hash::{BuildHasherDefault, Hasher};

use nalgebra::{Point2, Vector2};

use crate::robot::{Action, Pose};
use crate::scenario::{Robot, Task, distance_to_segment, in_goal};
use crate::world::{Arena, FrameMotion, Segment, drive};

/// Poses that agree within this distance (metres) and angle (degrees) count as one.
const SAME_PLACE: f64 = 0.02;
const SAME_HEADING: f64 = 2.0;

/// Side of the squares of which it is known which walls are near, metres.
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

/// Searches the least number of noise-free actions from poses into a task's goal area, without entering what is to be avoided.
pub struct OptimalSteps<'a> {
    arena: &'a Arena,
    robot: &'a Robot,
    task: &'a Task,
    avoid: &'a [Circle],
    motions: Vec<FrameMotion>,
    left: WayLeft,
    most: usize,
}

impl<'a> OptimalSteps<'a> {
    /// Find out how far it is to the goal from where it can be reached by `most` actions; more are never searched.
    pub fn new(arena: &'a Arena, robot: &'a Robot, task: &'a Task, avoid: &'a [Circle], most: usize) -> Self {
        let actions = &robot.actions;
        let motions = actions.iter().map(|action| actions.motion(action));
        let motions: Vec<_> =
            motions.map(|motion| FrameMotion { length: motion.distance, angle: motion.angle }).collect();
        let stride = motions.iter().map(|motion| motion.length.abs()).fold(0.0, f64::max);
        let left = WayLeft::new(arena, robot.radius, task, stride, most);
        OptimalSteps { arena, robot, task, avoid, motions, left, most }
    }

    /// The least number of actions from a pose, or `None` beyond the most.
    ///
    /// Poses are searched breadth first, those only from which the goal is near enough to arrive within a limit. The limit grows
    /// until the search arrives, so what it finds is what a search without a limit would. The lattice of poses is laid out from the start
    /// pose itself, so the first steps are exact; only poses that are reached again within 2 cm and 2° are dropped.
    pub fn from(&self, start: Pose) -> Option<usize> {
        if in_goal(self.task, start.position) {
            return Some(0);
        }
        let mut limit = self.left.steps(start.position)?;
        loop {
            // A robot turns now and then: the way alone is hardly ever enough.
            limit = self.most.min(limit + limit / 5 + 4);
            let steps = self.within(start, limit);
            if steps.is_some() || limit == self.most {
                return steps;
            }
        }
    }

    /// The first action of a shortest way from a pose, the first one of several; `None` where there is none.
    pub fn first(&self, start: Pose) -> Option<Action> {
        let steps = self.motions.iter().map(|&motion| self.from(self.moved(start, motion, self.arena.walls())?));
        let ways = self.robot.actions.iter().zip(steps).filter_map(|(action, steps)| Some((steps?, action)));
        ways.min_by_key(|way| way.0).map(|way| way.1)
    }

    /// Where a motion leads; `None` if into what is to be avoided.
    fn moved(&self, from: Pose, motion: FrameMotion, walls: &[Segment]) -> Option<Pose> {
        let moved = drive(from, motion, walls, self.robot.radius).0;
        let enters = |area: &Circle| area.is_entered(from.position, moved.position);
        (!self.avoid.iter().any(enters)).then_some(moved)
    }

    fn within(&self, start: Pose, limit: usize) -> Option<usize> {
        let key = |pose: &Pose| {
            let place = |value: f64, origin: f64| ((value - origin) / SAME_PLACE).round() as i32;
            let degrees = (pose.heading - start.heading).to_degrees().rem_euclid(360.0);
            let headings = (360.0 / SAME_HEADING) as u32;
            let Point2 { coords } = pose.position;
            // 180 headings take 8 bits; 28 bits of 2 cm reach farther than any room.
            let (x, y) = (place(coords.x, start.position.x) as u32, place(coords.y, start.position.y) as u32);
            u64::from(x) << 36 ^ u64::from(y) << 8 ^ u64::from((degrees / SAME_HEADING).round() as u32 % headings)
        };
        let mut near = Near::new(self);
        let mut seen: HashSet<u64, BuildHasherDefault<Mix>> = HashSet::from_iter([key(&start)]);
        let mut frontier = vec![start];
        for steps in 1..=limit {
            let mut next = Vec::new();
            for pose in &frontier {
                let walls = near.walls(pose.position);
                for moved in self.motions.iter().filter_map(|&motion| self.moved(*pose, motion, walls)) {
                    if in_goal(self.task, moved.position) {
                        return Some(steps);
                    }
                    let arrives = self.left.steps(moved.position).is_some_and(|left| steps + left <= limit);
                    if arrives && seen.insert(key(&moved)) {
                        next.push(moved);
                    }
                }
            }
            frontier = next;
        }
        None
    }
}

/// From where a goal can be reached, and in how many actions at least if turning took none.
struct WayLeft {
    /// Side of a cell, metres.
    side: f64,
    /// Length of the longest motion, metres.
    stride: f64,
    /// Length of the way from cells to the goal, in units of [`WayLeft::UNIT`] of a side.
    cells: HashMap<(i32, i32), u32>,
}

impl WayLeft {
    /// Units of a step to a cell beside and across a corner: 7/5 stands for √2, and is less.
    const UNIT: [u32; 2] = [5, 7];
    /// A way over cells is at most 1.0771 times as long as the straight one, where walls leave it free (√(1 + 0.4²), at 21.8°).
    const STRAIGHT: f64 = 0.92;
    /// Cells by which rounding places to them may lengthen a way.
    const ROUNDING: f64 = 2.0;

    fn new(arena: &Arena, radius: f64, task: &Task, stride: f64, most: usize) -> Self {
        let side = radius / 3.0;
        let mut left = WayLeft { side, stride, cells: HashMap::new() };
        let Some(goal) = task.goal.map(Point2::from) else { return left };
        // A cell is open if the robot's centre fits into it or into one beside it.
        let is_open = |cell: (i32, i32)| arena.clearance(left.centre(cell)) > radius - 1.5 * side;
        let farthest =
            ((most as f64 * stride / side + Self::ROUNDING) / Self::STRAIGHT * f64::from(Self::UNIT[0])) as u32;
        let (middle, reach) = (left.cell(goal), (task.radius / side).ceil() as i32 + 1);
        let around = (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (middle.0 + x, middle.1 + y)));
        let within = around.filter(|&cell| (left.centre(cell) - goal).norm() <= task.radius + side);
        let mut queue: BinaryHeap<_> = within.filter(|&cell| is_open(cell)).map(|cell| Reverse((0, cell))).collect();
        let mut cells = HashMap::new();
        while let Some(Reverse((way, cell))) = queue.pop() {
            if way > farthest || cells.contains_key(&cell) {
                continue;
            }
            cells.insert(cell, way);
            let beside = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)].into_iter().enumerate();
            let beside = beside.map(|(i, (x, y))| (way + Self::UNIT[i % 2], (cell.0 + x, cell.1 + y)));
            queue.extend(beside.filter(|(_, cell)| !cells.contains_key(cell) && is_open(*cell)).map(Reverse));
        }
        left.cells = cells;
        left
    }

    fn cell(&self, place: Point2<f64>) -> (i32, i32) {
        let cell = (place / self.side).map(|value| value.floor() as i32);
        (cell.x, cell.y)
    }

    fn centre(&self, (x, y): (i32, i32)) -> Point2<f64> {
        Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5) * self.side
    }

    /// The least number of actions from a place, or `None` where no way leads to the goal.
    fn steps(&self, place: Point2<f64>) -> Option<usize> {
        let way = f64::from(*self.cells.get(&self.cell(place))?) / f64::from(Self::UNIT[0]);
        let metres = ((way * Self::STRAIGHT - Self::ROUNDING) * self.side).max(0.0);
        // Without a stride nothing moves: the search finds out.
        Some(if self.stride > 0.0 { (metres / self.stride).ceil() as usize } else { 0 })
    }
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

/// The walls that can stop a motion from somewhere in a square of the floor, found when they are first asked for.
struct Near<'a> {
    arena: &'a Arena,
    /// Distance from the middle of a square to a wall beyond which the wall does not matter, metres.
    reach: f64,
    squares: HashMap<(i32, i32), Vec<Segment>>,
}

impl<'a> Near<'a> {
    fn new(search: &OptimalSteps<'a>) -> Self {
        let longest = search.motions.iter().map(|motion| motion.length.abs()).fold(0.0, f64::max);
        // The farthest point of the square is half its diagonal away.
        let reach = search.robot.radius + longest + WELL_CLEAR + SQUARE * std::f64::consts::FRAC_1_SQRT_2;
        Near { arena: search.arena, reach, squares: HashMap::new() }
    }

    fn walls(&mut self, place: Point2<f64>) -> &[Segment] {
        let square = (place / SQUARE).map(|value| value.floor() as i32);
        self.squares.entry((square.x, square.y)).or_insert_with(|| {
            let centre = (square.map(f64::from) + Vector2::repeat(0.5)) * SQUARE;
            self.arena.walls_within(self.reach, centre)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::draw_pose;
    use crate::random::stream;
    use crate::scenario::Scenario;
    use crate::world::World;

    const LAB: &str = include_str!("../../scenarios/lab.toml");

    #[test]
    fn walls_that_are_too_far_away_stop_nothing() {
        for text in [LAB, include_str!("../../scenarios/doors.toml")] {
            let scenario = Scenario::parse(text, "scenario.toml".as_ref(), &[]).unwrap();
            let (world, robot) = (World::new(&scenario).unwrap(), &scenario.robot);
            let search = OptimalSteps::new(&world.arena, robot, &scenario.tasks[0], &[], 100);
            let (mut near, mut asked, mut stopped) = (Near::new(&search), 0, 0);
            let cells: Vec<Point2<f64>> = world.plan.reachable_cells().collect();
            let mut rng = stream(7, "test: moves");
            for _ in 0..5000 {
                let pose = draw_pose(&world.plan, &cells, &mut rng, |_| false);
                let motion = FrameMotion { length: robot.forward, angle: 0.0 };
                let all = drive(pose, motion, world.arena.walls(), robot.radius);
                let walls = near.walls(pose.position);
                assert_eq!(drive(pose, motion, walls, robot.radius), all, "{pose:?}");
                asked += walls.len();
                stopped += usize::from(all.1);
            }
            assert!(stopped > 200 && asked < 5000 * world.arena.walls().len() / 2, "{stopped} stopped, {asked} asked");
        }
    }

    #[test]
    fn what_cannot_be_short_enough_is_not_searched_and_nothing_else_is_left_out() {
        for (text, starts) in [
            (LAB, 200),
            (include_str!("../../scenarios/two_rooms.toml"), 5),
            (include_str!("../../scenarios/apartment.toml"), 5),
            (include_str!("../../scenarios/doors.toml"), 5),
        ] {
            let scenario = Scenario::parse(text, "scenario.toml".as_ref(), &[]).unwrap();
            let (world, robot) = (World::new(&scenario).unwrap(), &scenario.robot);
            let cells: Vec<Point2<f64>> = world.plan.reachable_cells().collect();
            let mut rng = stream(7, "test: starts");
            let mut arrive = 0;
            for task in &scenario.tasks {
                let search = OptimalSteps::new(&world.arena, robot, task, &[], scenario.evaluate.max_steps);
                let mut whole = OptimalSteps::new(&world.arena, robot, task, &[], scenario.evaluate.max_steps);
                // As if one action could lead anywhere.
                whole.left.stride = f64::INFINITY;
                for _ in 0..starts {
                    let start = draw_pose(&world.plan, &cells, &mut rng, |position| in_goal(task, position));
                    let steps = search.from(start);
                    assert_eq!(steps, whole.from(start), "{} {}: {start:?}", scenario.name, task.name);
                    arrive += usize::from(steps.is_some());
                }
            }
            assert_eq!(
                arrive,
                starts * scenario.tasks.len(),
                "{}: goals can be reached from everywhere",
                scenario.name
            );
        }
    }
}
