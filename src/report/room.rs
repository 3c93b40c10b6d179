//! A room from above: its walls and goal, the robot's last path, and what a policy makes of each place.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::path::PathBuf;

use nalgebra::{Point2, Vector2};
use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use rayon::prelude::*;

use super::picture::{DrawError, INK, SMALL, text};
use crate::log::messages::PoseStamped;
use crate::log::{FilesReader, LogError, Record, topics};
use crate::policy::Learned;
use crate::scenario::{Plan, Scenario, Task, plan_segments};
use crate::vision::observe;
use crate::world::{Pose, World, in_goal};

/// Headings at which a place is looked at.
pub const HEADINGS: usize = 8;

/// Smallest distance of places in the picture, metres: half an action of the lab's robot.
const FINEST: f64 = 0.15;

/// Most places along x and y: more arrows than these cannot be told apart at the picture's size.
const MOST_PLACES: [f64; 2] = [20.0, 12.0];

/// Places whose images are held in memory together.
const BLOCK: usize = 8;

pub const GOAL: RGBColor = RGBColor(46, 139, 87);
pub const PATH: RGBColor = RGBColor(196, 78, 40);
pub const HATCH: RGBColor = RGBColor(90, 90, 90);
const NO_WALL_COLOUR: [u8; 3] = [60, 60, 60];

/// Colours of values from low to high: lightness falls evenly, and dark arrows can be read on all of them.
const RAMP: [[f64; 3]; 4] = [[250.0, 247.0, 232.0], [207.0, 226.0, 214.0], [145.0, 192.0, 202.0], [84.0, 146.0, 187.0]];

/// The colour of a share between 0 and 1 of the values' range.
pub fn colour(share: f64) -> RGBColor {
    let place = share.clamp(0.0, 1.0) * (RAMP.len() - 1) as f64;
    let below = (place as usize).min(RAMP.len() - 2);
    let [r, g, b] =
        [0, 1, 2].map(|c| (RAMP[below][c] + (RAMP[below + 1][c] - RAMP[below][c]) * (place - below as f64)) as u8);
    RGBColor(r, g, b)
}

/// The last poses that the files of a log hold, at most `most` of them, oldest first.
///
/// # Errors
/// The log cannot be opened or read; damage within it costs the poses there.
pub fn last_poses(logs: Vec<PathBuf>, most: usize) -> Result<Vec<Pose>, LogError> {
    let mut poses = VecDeque::new();
    for record in FilesReader::new(logs) {
        match record {
            Ok(record @ Record::Message { .. }) => {
                if !matches!(&record, Record::Message { topic, .. } if **topic == *topics::POSE.name()) {
                    continue;
                }
                let pose = record.decode::<PoseStamped>()?.pose;
                if poses.len() == most {
                    poses.pop_front();
                }
                poses.push_back(Pose::new(Point2::new(pose.position.x, pose.position.y), pose.heading()));
            }
            Err(error @ (LogError::Open { .. } | LogError::Read { .. })) => return Err(error),
            Ok(_) | Err(_) => {}
        }
    }
    Ok(poses.into())
}

/// What a policy makes of one place.
#[derive(Debug, Clone, Copy)]
pub struct Worth {
    /// Value of the best action, mean over all headings.
    value: f64,
    /// The heading of the highest value, as its number counter-clockwise from the x-axis.
    heading: usize,
}

/// Places on a grid, and what the policies of the first tasks make of them.
#[derive(Debug)]
pub struct Survey {
    /// Distance of neighbours, metres.
    step: f64,
    places: Vec<Point2<f64>>,
    /// For each task, for each place.
    worth: Vec<Vec<Worth>>,
}

impl Survey {
    /// Look around at every place of a grid that the robot can reach, through a camera without noise.
    pub fn new(scenario: &Scenario, world: &World, learned: &Learned, tasks: usize) -> Self {
        let (low, high) = world.plan.reachable_box();
        let size = high - low;
        let step = FINEST.max(size.x / MOST_PLACES[0]).max(size.y / MOST_PLACES[1]);
        let counts = size.map(|length| (length / step).floor().max(1.0));
        let first = low + (size - counts * step + Vector2::repeat(step)) * 0.5;
        let grid = (0..counts.y as usize).flat_map(|j| (0..counts.x as usize).map(move |i| (i, j)));
        let places: Vec<_> = grid
            .map(|(i, j)| first + Vector2::new(i as f64, j as f64) * step)
            .filter(|&place| world.plan.is_reachable(place))
            .collect();
        let blocks: Vec<Vec<Vec<Worth>>> = places
            .par_chunks(BLOCK)
            .map(|block| {
                let poses = block.iter().flat_map(|&place| (0..HEADINGS).map(move |h| Pose::new(place, angle(h))));
                let seen: Vec<_> = poses
                    .map(|pose| observe(&world.looks.camera(learned.asked_at + 1).render(&pose), &scenario.vision, 0))
                    .collect();
                let judge = |task| {
                    let highest = |q: [f64; 3]| q.into_iter().fold(f64::NEG_INFINITY, f64::max);
                    let best: Vec<f64> = seen.iter().map(|seen| highest(learned.q_values(seen, task))).collect();
                    best.chunks(HEADINGS).map(Worth::new).collect()
                };
                (0..tasks).map(judge).collect()
            })
            .collect();
        let worth = (0..tasks).map(|task| blocks.iter().flat_map(|block| block[task].iter().copied()).collect());
        Survey { step, places, worth: worth.collect() }
    }

    /// Lowest and highest value of a task.
    fn range(&self, task: usize) -> (f64, f64) {
        let values = self.worth[task].iter().map(|worth| worth.value);
        values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
    }
}

impl Worth {
    fn new(values: &[f64]) -> Self {
        let heading = (0..values.len()).max_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap_or(0);
        Worth { value: values.iter().sum::<f64>() / values.len() as f64, heading }
    }
}

fn angle(heading: usize) -> f64 {
    TAU * heading as f64 / HEADINGS as f64
}

/// What all rooms of a picture show.
pub struct Shown<'a> {
    pub scenario: &'a Scenario,
    pub world: &'a World,
    pub path: &'a [Pose],
    pub survey: Option<&'a Survey>,
}

type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// Space around the plan for its axes, and right of it for the colours' legend, pixels.
const LEFT: f64 = 52.0;
const RIGHT: f64 = 64.0;
const BOTTOM: f64 = 42.0;

impl Shown<'_> {
    /// Draw the room as one task sees it, as large as fits, at one scale in both directions.
    pub fn draw<'a>(&self, area: &DrawingArea<SVGBackend<'a>, Shift>, task: usize) -> Result<(), DrawError> {
        let (low, high) = self.world.plan.walls_box();
        let margin = Vector2::repeat(0.02 * (high - low).max());
        let (low, high) = (low - margin, high + margin);
        let size = high - low;
        let (width, height) = area.dim_in_pixel();
        let scale = ((f64::from(width) - LEFT - RIGHT) / size.x).min((f64::from(height) - BOTTOM) / size.y);
        let plan = (size * scale).map(f64::round);
        let inner = area.clone().shrink((0, 0), ((plan.x + LEFT) as i32, (plan.y + BOTTOM) as i32));
        let mut chart = ChartBuilder::on(&inner)
            .x_label_area_size(BOTTOM)
            .y_label_area_size(LEFT)
            .build_cartesian_2d(low.x..high.x, low.y..high.y)?;
        let metres = |value: &f64| format!("{value:.1}");
        chart
            .configure_mesh()
            .disable_mesh()
            .axis_style(INK.mix(0.4))
            .label_style(text(SMALL))
            .x_labels(8)
            .y_labels(6)
            .x_label_formatter(&metres)
            .y_label_formatter(&metres)
            .x_desc("x, m")
            .y_desc("y, m")
            .draw()?;
        let goal = &self.scenario.tasks[task];
        if let Some(survey) = self.survey {
            cells(&mut chart, survey, task)?;
            let bar = area.clone().shrink(((LEFT + plan.x) as i32 + 10, 0), (RIGHT as i32 - 10, plan.y as i32));
            legend(&bar, survey.range(task))?;
        }
        let apart = 7.0 / scale;
        let near = hatching(low, high, apart, |point| self.is_near_wall(goal, point));
        chart.draw_series(near.into_iter().map(|(a, b)| PathElement::new([at(a), at(b)], HATCH.mix(0.3))))?;
        let (centre, radius) = ((goal.goal[0], goal.goal[1]), (goal.radius * scale).round() as i32);
        chart.draw_series([
            Circle::new(centre, radius, GOAL.mix(0.45).filled()),
            Circle::new(centre, radius, GOAL.stroke_width(2)),
        ])?;
        chart.draw_series(LineSeries::new(self.path.iter().map(|pose| at(pose.position)), PATH.mix(0.45)))?;
        if let Some(survey) = self.survey {
            // In the goal there is nowhere left to go.
            let outside = survey.places.iter().zip(&survey.worth[task]).filter(|(place, _)| !in_goal(goal, **place));
            let wishes = outside.map(|(&place, worth)| (place, angle(worth.heading)));
            arrows(&mut chart, wishes, (0.6 * survey.step * scale).min(18.0), INK)?;
        }
        self.walls(&mut chart)?;
        if let Some(last) = self.path.last() {
            arrows(&mut chart, [(last.position, last.heading)].into_iter(), 24.0, PATH)?;
        }
        Ok(())
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
            || (0..2 * HEADINGS).any(|i| {
                let direction = Pose::new(point, 0.5 * angle(i)).direction();
                plan.is_reachable(point + direction * reach) && arena.range(point, direction, reach) >= reach
            })
    }

    fn walls(&self, chart: &mut Chart<'_>) -> Result<(), DrawError> {
        let colours = self.world.looks.camera(u64::MAX).wall_colours();
        let walls = &self.scenario.world.walls;
        let pieces = |width: u32, colour: &dyn Fn(usize) -> RGBColor| {
            let pieces = walls.iter().enumerate().flat_map(|(index, wall)| {
                let style = colour(index).stroke_width(width);
                plan_segments(wall).into_iter().map(move |(a, b)| PathElement::new([at(a), at(b)], style))
            });
            pieces.collect::<Vec<_>>()
        };
        chart.draw_series(pieces(9, &|_| INK))?;
        chart.draw_series(pieces(6, &|index| {
            let [r, g, b] = colours.get(index).copied().unwrap_or(NO_WALL_COLOUR);
            RGBColor(r, g, b)
        }))?;
        Ok(())
    }
}

fn at(point: Point2<f64>) -> (f64, f64) {
    (point.x, point.y)
}

fn cells(chart: &mut Chart<'_>, survey: &Survey, task: usize) -> Result<(), DrawError> {
    let (low, high) = survey.range(task);
    let half = Vector2::repeat(0.5 * survey.step);
    let cell = |(&place, worth): (&Point2<f64>, &Worth)| {
        let share = (worth.value - low) / (high - low).max(f64::MIN_POSITIVE);
        Rectangle::new([at(place - half), at(place + half)], colour(share).filled())
    };
    chart.draw_series(survey.places.iter().zip(&survey.worth[task]).map(cell))?;
    Ok(())
}

/// Arrows around places. Their shape is in pixels, so that arrows of one direction look alike.
fn arrows(
    chart: &mut Chart<'_>,
    poses: impl Iterator<Item = (Point2<f64>, f64)>,
    length: f64,
    colour: RGBColor,
) -> Result<(), DrawError> {
    chart.draw_series(poses.map(|(place, heading)| {
        let pixel = |ahead: f64, aside: f64| {
            let (x, y) = (ahead * heading.cos() - aside * heading.sin(), ahead * heading.sin() + aside * heading.cos());
            ((x * length).round() as i32, (-y * length).round() as i32)
        };
        EmptyElement::at(at(place))
            + PathElement::new([pixel(-0.5, 0.0), pixel(0.2, 0.0)], colour)
            + Polygon::new([pixel(0.5, 0.0), pixel(0.05, 0.22), pixel(0.05, -0.22)], colour.filled())
    }))?;
    Ok(())
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

/// The colours of values, with the values at both ends.
fn legend(area: &DrawingArea<SVGBackend<'_>, Shift>, (low, high): (f64, f64)) -> Result<(), DrawError> {
    const SLICES: i32 = 32;
    let height = area.dim_in_pixel().1 as i32;
    for slice in 0..SLICES {
        let edge = |slice: i32| height - slice * height / SLICES;
        let fill = colour((f64::from(slice) + 0.5) / f64::from(SLICES)).filled();
        area.draw(&Rectangle::new([(0, edge(slice)), (12, edge(slice + 1))], fill))?;
    }
    area.draw(&Rectangle::new([(0, 0), (12, height)], INK.mix(0.4)))?;
    for (value, y) in [(high, 1), (0.5 * (low + high), height / 2 - 6), (low, height - 13)] {
        area.draw(&Text::new(format!("{value:.2}"), (17, y), text(SMALL)))?;
    }
    Ok(())
}
