//! States of the past, and what is seen by chance.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Range;

use faer::{Mat, MatRef};

use super::goals::{GoalPlaces, square};
use super::{MotionNoise, PlaceMetric, Pose, nearest};
use crate::value::ValueError;
use crate::value::error::parameter;
use crate::value::local::finite_points;
use crate::value::nearest::apart;

/// Width of likeness: so many times as far as states are from the third of those that are most like them and were not met beside them.
const WIDTH: f64 = 1.3;
const THIRD: usize = 2;
pub(super) const BESIDE: usize = 60;
/// An image that is less like what was seen at a pose than this share of what like images have in common is no match.
const ALIKE: f64 = 0.02;
/// However rare an image is, it is seen by chance with this likeness.
pub(super) const LEAST_CHANCE: f64 = 1e-6;
/// Images that count as alike: so many of all that are most like one.
const LIKE: usize = 8;
/// States that tell how often such an image is seen by chance.
const ASKED: usize = 256;
/// Cells: a square of the floor, and one of so many headings.
pub(super) const HEADINGS: usize = 24;
/// States of a cell that are asked.
const MOST: usize = 8;

/// States of the past, where they are known to lie.
#[derive(Debug, Clone)]
pub struct PlaceMap {
    pub(super) metric: PlaceMetric,
    /// `p × n`.
    pub(super) points: Mat<f32>,
    pub(super) poses: Vec<Option<Pose>>,
    pub(super) cells: Cells,
    /// Where goals were found, by task.
    pub(super) goals: Vec<GoalPlaces>,
    /// Images are at least so much alike by chance.
    by_chance: f64,
}

impl PlaceMap {
    pub(super) fn begin(points: Mat<f32>, poses: Vec<Option<Pose>>, metric: PlaceMetric) -> Self {
        let cells = Cells::of(&poses);
        let mut map = PlaceMap { metric, points, poses, cells, goals: Vec::new(), by_chance: 0.0 };
        map.by_chance = (ALIKE * map.likeness_of_like()).max(LEAST_CHANCE);
        map
    }

    /// States that somebody else has placed: what was seen, `p × n`, and `n` poses; the width of likeness is chosen as when a map is
    /// found. `None` where no two states differ. `unit`: length of a move.
    ///
    /// # Errors
    /// Another number of poses than states, values that are not finite, noise outside its ranges, a unit that is not above 0.
    pub fn placed(points: Mat<f32>, poses: &[Pose], noise: MotionNoise, unit: f64) -> Result<Option<Self>, ValueError> {
        noise.check()?;
        parameter("unit", unit, unit > 0.0 && unit.is_finite(), "above 0")?;
        finite_points("points", points.as_ref())?;
        if poses.len() != points.ncols() {
            return Err(ValueError::Length { what: "the poses", found: poses.len(), expected: points.ncols() });
        }
        for pose in poses {
            let sum = pose.x + pose.y + pose.heading;
            parameter("pose", sum, sum.is_finite(), "finite")?;
        }
        let Some(width) = width(points.as_ref()) else { return Ok(None) };
        let metric = PlaceMetric { noise, unit, width };
        Ok(Some(PlaceMap::begin(points, poses.iter().copied().map(Some).collect(), metric)))
    }

    /// The same, where goals were found at these places, by task.
    pub fn with_goals(self, goals: Vec<GoalPlaces>) -> Self {
        PlaceMap { goals, ..self }
    }

    /// Where goals were found, by task.
    pub fn goals(&self) -> &[GoalPlaces] {
        &self.goals
    }

    /// How near its states are.
    pub fn metric(&self) -> PlaceMetric {
        self.metric
    }

    /// Where states lie, `n`; `None`: not known.
    pub fn poses(&self) -> &[Option<Pose>] {
        &self.poses
    }

    /// The states, `p × n`.
    pub fn points(&self) -> MatRef<'_, f32> {
        self.points.as_ref()
    }

    /// How alike such an image is by chance.
    pub(super) fn chance(&self, seen: &[f32], without: &Range<usize>) -> f64 {
        let of = asked(self.points.ncols()).filter(|state| !without.contains(state));
        let (sum, count) =
            of.fold((0.0, 0), |(sum, count), state| (sum + self.likeness(state as u32, seen), count + 1));
        (sum / f64::from(count.max(1))).max(self.by_chance)
    }

    pub(super) fn likeness(&self, state: u32, seen: &[f32]) -> f64 {
        let squared = apart(self.points.as_ref(), state, seen);
        (-0.5 * f64::from(squared) / (self.metric.width * self.metric.width)).exp()
    }

    /// How alike images are that are most alike.
    fn likeness_of_like(&self) -> f64 {
        let n = self.points.ncols();
        let of = |state: usize| {
            let seen: Vec<f32> = self.points.col(state).iter().copied().collect();
            let mut alike: Vec<f64> = (0..n as u32).map(|other| self.likeness(other, &seen)).collect();
            let place = LIKE.min(n - 1);
            *alike.select_nth_unstable_by(place, |a, b| b.total_cmp(a)).1
        };
        asked(n).map(of).sum::<f64>() / ASKED.min(n) as f64
    }
}

/// A square of the floor, and which of the headings.
pub(super) type Cell = ([i32; 2], usize);
pub(super) type BySquare<T> = Hashed<[i32; 2], T>;
pub(super) type Hashed<K, T> = HashMap<K, T, BuildHasherDefault<Mix>>;

/// Squares are looked up thousands of times for each image, and nobody chooses them to collide: few multiplications are enough.
#[derive(Debug, Clone, Default)]
pub(super) struct Mix(u64);

impl Hasher for Mix {
    fn write(&mut self, bytes: &[u8]) {
        for bytes in bytes.chunks(8) {
            let mut number = [0; 8];
            number[..bytes.len()].copy_from_slice(bytes);
            self.0 = (self.0.rotate_left(23) ^ u64::from_le_bytes(number)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        }
    }

    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 32
    }
}

pub(super) fn cell(pose: Pose) -> Cell {
    let heading = nearest(pose.heading / TAU * HEADINGS as f64);
    (square(pose), heading.rem_euclid(HEADINGS as i64) as usize)
}

/// A heading and those beside it.
pub(super) fn beside(heading: usize) -> [usize; 3] {
    [(heading + HEADINGS - 1) % HEADINGS, heading, (heading + 1) % HEADINGS]
}

/// States by the cells that they lie in.
#[derive(Debug, Clone, Default)]
pub(super) struct Cells(BySquare<[Vec<u32>; HEADINGS]>);

impl Cells {
    /// All that have poses, evenly thinned where they are many.
    pub fn of(poses: &[Option<Pose>]) -> Self {
        let mut cells = Cells::default();
        for (state, pose) in poses.iter().enumerate().filter_map(|(state, pose)| Some((state, (*pose)?))) {
            cells.at(cell(pose)).push(state as u32);
        }
        for states in cells.0.values_mut().flatten().filter(|states| states.len() > MOST) {
            *states = (0..MOST).map(|k| states[k * states.len() / MOST]).collect();
        }
        cells
    }

    /// The states over a square of the floor, by heading; `None`: there are none.
    pub fn over(&self, square: [i32; 2]) -> Option<&[Vec<u32>; HEADINGS]> {
        self.0.get(&square)
    }

    /// A state has another pose now; of a full cell, the state that came first is left out.
    pub fn place(&mut self, state: u32, from: Option<Pose>, to: Option<Pose>) {
        if let Some(from) = from {
            self.at(cell(from)).retain(|&of| of != state);
        }
        if let Some(to) = to {
            let states = self.at(cell(to));
            if states.len() == MOST {
                states.remove(0);
            }
            states.push(state);
        }
    }

    fn at(&mut self, (square, heading): Cell) -> &mut Vec<u32> {
        &mut self.0.entry(square).or_default()[heading]
    }
}

fn asked(n: usize) -> impl Iterator<Item = usize> {
    (0..ASKED.min(n)).map(move |k| k * n / ASKED.min(n))
}

/// Width of likeness; `None` where no states differ.
pub(super) fn width(points: MatRef<'_, f32>) -> Option<f64> {
    let n = points.ncols();
    let third = |state: usize| {
        let others = (0..n).filter(|&other| other.abs_diff(state) > BESIDE.min(n / 4));
        let mut apart: Vec<f32> =
            others.map(|other| (points.col(other) - points.col(state)).squared_norm_l2()).collect();
        // Robots stand before a wall and see the same again and again.
        apart.retain(|apart| *apart > 0.0 && apart.is_finite());
        let third = THIRD.min(apart.len().saturating_sub(1));
        (!apart.is_empty()).then(|| apart.select_nth_unstable_by(third, f32::total_cmp).1.sqrt())
    };
    let mut apart: Vec<f32> = asked(n).filter_map(third).collect();
    let middle = apart.len() / 2;
    (!apart.is_empty()).then(|| f64::from(*apart.select_nth_unstable_by(middle, f32::total_cmp).1) * WIDTH)
}
