//! A lattice of the poses that a robot has been near, and functions of the pose on it.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use faer::MatRef;

use super::states::{BySquare, HEADINGS};
use super::{Pose, around};

/// Side of a square, moves.
const SIDE: f64 = 0.5;
/// A point of the floor is known where states lie this near, moves: at least this share of what is usual.
const KNOWN: f64 = 0.5;
const USUAL: f64 = 0.1;

/// Poses on a square grid of the floor, at points that the robot has been near, each with the same number of headings.
#[derive(Debug, Clone)]
pub(super) struct Lattice {
    points: Vec<[i32; 2]>,
    numbers: BySquare<u32>,
}

impl Lattice {
    /// Where states lie: a point that few are near, beside others, may be where one was misplaced, and is left out.
    pub fn new(states: impl Iterator<Item = Pose>) -> Self {
        let mut near: BTreeMap<[i32; 2], u32> = BTreeMap::new();
        for state in states {
            points_near(state, KNOWN).for_each(|(point, _)| *near.entry(point).or_default() += 1);
        }
        let mut counts: Vec<u32> = near.values().copied().collect();
        counts.sort_unstable();
        let least = counts.get(counts.len() / 2).map_or(0.0, |&usual| USUAL * f64::from(usual));
        let points: Vec<[i32; 2]> = near.into_iter().filter(|of| f64::from(of.1) >= least).map(|of| of.0).collect();
        let numbers = points.iter().copied().zip(0..).collect();
        Lattice { points, numbers }
    }

    /// Number of its poses.
    pub fn len(&self) -> usize {
        self.points.len() * HEADINGS
    }

    pub(super) fn pose(&self, number: usize) -> Pose {
        let [x, y] = self.points[number / HEADINGS];
        let heading = (number % HEADINGS) as f64 / HEADINGS as f64 * TAU;
        Pose { x: f64::from(x) * SIDE, y: f64::from(y) * SIDE, heading }
    }

    /// Number of the point of the floor that a pose of the lattice stands on, and of all of them.
    pub(super) fn point(number: usize) -> usize {
        number / HEADINGS
    }

    pub(super) fn points(&self) -> usize {
        self.points.len()
    }

    /// Points of the floor that are near a pose, with the squares of their distances.
    pub(super) fn near(&self, pose: Pose, within: f64) -> impl Iterator<Item = (usize, f64)> {
        points_near(pose, within).filter_map(|(point, squared)| Some((*self.numbers.get(&point)? as usize, squared)))
    }

    /// The poses around one and how much each counts in an interpolation; what is not known is missing, and less than 1 is counted.
    pub(super) fn around(&self, pose: Pose) -> impl Iterator<Item = (usize, f64)> {
        let [(x, along_x), (y, along_y)] = [pose.x, pose.y].map(|at| split(at / SIDE));
        let (heading, on) = split(around(pose.heading) / TAU * HEADINGS as f64);
        let heading = heading as usize;
        let corners = [(0, 0), (0, 1), (1, 0), (1, 1)].into_iter().filter_map(move |(dx, dy)| {
            let share = |along: f64, d: i32| if d == 0 { 1.0 - along } else { along };
            let weight = share(along_x, dx) * share(along_y, dy);
            let point = [x.saturating_add(dx), y.saturating_add(dy)];
            (weight > 0.0).then(|| Some((*self.numbers.get(&point)?, weight))).flatten()
        });
        corners.flat_map(move |(point, weight)| {
            let of = |turn: usize| point as usize * HEADINGS + (heading + turn) % HEADINGS;
            [(of(0), weight * (1.0 - on)), (of(1), weight * on)].into_iter().filter(|of| of.1 > 0.0)
        })
    }

    /// How well a pose is known: 1 in the midst of the lattice, 0 where nobody was.
    pub(super) fn known(&self, pose: Pose) -> f64 {
        self.around(pose).map(|of| of.1).sum()
    }

    /// Whether the floor is known from a pose to another and in the midst between them, as [`known`](Lattice::known).
    pub(super) fn is_way(&self, from: Pose, to: Pose) -> f64 {
        let middle = Pose { x: 0.5 * (from.x + to.x), y: 0.5 * (from.y + to.y), heading: to.heading };
        self.known(middle).min(self.known(to))
    }

    /// Functions of the pose, `len × A`, one for each column, at one; `None` where it is nowhere near the lattice.
    pub fn mean(&self, of: MatRef<'_, f64>, pose: Pose) -> Option<Vec<f64>> {
        let (mut sums, mut known) = (vec![0.0; of.ncols()], 0.0);
        for (number, weight) in self.around(pose) {
            known += weight;
            sums.iter_mut().zip(0..).for_each(|(sum, column)| *sum += weight * of[(number, column)]);
        }
        (known > 0.0).then(|| sums.iter().map(|sum| sum / known).collect())
    }
}

fn split(at: f64) -> (i32, f64) {
    (at.floor() as i32, at - at.floor())
}

fn points_near(pose: Pose, within: f64) -> impl Iterator<Item = ([i32; 2], f64)> {
    let range = move |at: f64| ((at - within) / SIDE).ceil() as i32..=((at + within) / SIDE).floor() as i32;
    range(pose.x).flat_map(move |x| range(pose.y).map(move |y| [x, y])).filter_map(move |[x, y]| {
        let squared = (f64::from(x) * SIDE - pose.x).powi(2) + (f64::from(y) * SIDE - pose.y).powi(2);
        (squared <= within * within).then_some(([x, y], squared))
    })
}
