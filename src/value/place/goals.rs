//! Where goals were found: that none is there tells where the robot is not.

use std::collections::BTreeMap;

use faer::Mat;

use super::{Pose, nearest};
use crate::value::ValueError;
use crate::value::error::parameter;

/// Side of a square of the floor, moves.
pub(super) const SIDE: f64 = 0.6;
/// Squares beside one count by this, as not all of them were visited.
const BESIDE: f64 = 0.5;
/// However sure a goal seems to be, the map may be wrong: a logarithm.
const SURE: f64 = -3.0;

/// The square of the floor that a pose lies in.
pub(super) fn square(pose: Pose) -> [i32; 2] {
    [pose.x, pose.y].map(|at| nearest(at / SIDE).clamp(i32::MIN.into(), i32::MAX.into()) as i32)
}

/// How often the robot was in the goal, by the squares of the floor.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct GoalPlaces(BTreeMap<[i32; 2], f64>);

impl GoalPlaces {
    /// By where the robot has come to, and whether that was in the goal.
    pub fn new(came_to: impl Iterator<Item = (Pose, bool)>) -> Self {
        let mut counts: BTreeMap<[i32; 2], [f64; 2]> = BTreeMap::new();
        for (pose, in_goal) in came_to {
            let [found, all] = counts.entry(square(pose)).or_default();
            (*found, *all) = (*found + f64::from(in_goal), *all + 1.0);
        }
        let around = |&[x, y]: &[i32; 2]| {
            [(0, 0, 1.0), (-1, 0, BESIDE), (1, 0, BESIDE), (0, -1, BESIDE), (0, 1, BESIDE)]
                .map(|(dx, dy, weight)| ([x.saturating_add(dx), y.saturating_add(dy)], weight))
        };
        let near = counts.iter().filter(|(_, count)| count[0] > 0.0).flat_map(|(square, _)| around(square));
        let share = |(square, _)| {
            let counted =
                around(&square).map(|(at, weight)| counts.get(&at).map_or([0.0; 2], |of| of.map(|n| weight * n)));
            let [found, all] = counted.iter().fold([0.0; 2], |sum, of| [sum[0] + of[0], sum[1] + of[1]]);
            // As if it had been there once more without a goal.
            (square, found / (all + 1.0))
        };
        GoalPlaces(near.map(share).collect())
    }

    /// Squares and shares, `3 × c`; of a goal that was never found, `0 × 0`.
    pub fn to_matrix(&self) -> Mat<f64> {
        let column = |(&[x, y], &share): (&[i32; 2], &f64)| [f64::from(x), f64::from(y), share];
        let columns: Vec<[f64; 3]> = self.0.iter().map(column).collect();
        Mat::from_fn(if columns.is_empty() { 0 } else { 3 }, columns.len(), |i, j| columns[j][i])
    }

    /// What this was the matrix of.
    ///
    /// # Errors
    /// Other than three rows, squares that are no whole numbers, shares outside 0 to 1.
    pub fn from_matrix(matrix: &Mat<f64>) -> Result<Self, ValueError> {
        if matrix.ncols() > 0 && matrix.nrows() != 3 {
            return Err(ValueError::Length { what: "the rows of goal places", found: matrix.nrows(), expected: 3 });
        }
        let whole = |at: f64| parameter("square", at, f64::from(at as i32) == at, "a whole number").map(|()| at as i32);
        let of = |j: usize| {
            let share = matrix[(2, j)];
            parameter("share", share, (0.0..1.0).contains(&share), "0 to 1")?;
            Ok(([whole(matrix[(0, j)])?, whole(matrix[(1, j)])?], share))
        };
        Ok(GoalPlaces((0..matrix.ncols()).map(of).collect::<Result<_, ValueError>>()?))
    }

    /// Logarithm of how probable it is at a pose to be in the goal, or not.
    pub(super) fn log_probability(&self, pose: Pose, in_goal: bool) -> f64 {
        let share = self.0.get(&square(pose)).copied().unwrap_or(0.0);
        (if in_goal { share } else { 1.0 - share }).ln().max(SURE)
    }
}
