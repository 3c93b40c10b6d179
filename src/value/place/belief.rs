//! A probability of every pose.

use super::grid::{Grid, Motion, Pose};
use crate::value::ValueError;
use crate::value::error::parameter;

/// Headings and size of a grid; cells and the bits of their probabilities; bits of how much was expected.
pub type BeliefParts = ((usize, usize), Vec<(usize, u64)>, u64);

/// Poses less probable than this share of the most probable one are given up.
const LEAST: f64 = 1e-5;

/// How probable each pose is: those that are not given up. They sum to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Belief {
    pub(super) grid: Grid,
    /// Cells and their probabilities.
    pub(super) cells: Vec<(usize, f64)>,
    /// Running mean of how much better than by chance what was seen had been expected, as a logarithm.
    pub(super) expected: f64,
}

impl Belief {
    /// As probable everywhere.
    pub(super) fn even(grid: Grid, cells: impl Iterator<Item = usize>) -> Self {
        let mut cells: Vec<(usize, f64)> = cells.map(|cell| (cell, 1.0)).collect();
        let share = 1.0 / cells.len().max(1) as f64;
        cells.iter_mut().for_each(|of| of.1 = share);
        Belief { grid, cells, expected: 0.0 }
    }

    /// Where the robot may be: the most probable pose with all around it, then that of the others, and so on, at most `count`
    /// of them until they make up `share`; and how probable each is.
    pub fn modes(&self, count: usize, share: f64) -> Vec<(Pose, f64)> {
        let (mut left, mut modes, mut told) = (self.clone(), Vec::new(), 0.0);
        while modes.len() < count && told < share && !left.cells.is_empty() {
            let mode = left.mode();
            left.cells.retain(|&(cell, _)| !left.grid.is_near(cell, mode.cell));
            told += mode.around;
            modes.push((mode.pose, mode.around));
        }
        modes
    }

    /// Headings and size of its grid, its cells and their probabilities, and how much was expected; fractions bit by bit.
    pub fn to_parts(&self) -> BeliefParts {
        let cells = self.cells.iter().map(|&(cell, probability)| (cell, probability.to_bits())).collect();
        ((self.grid.headings, self.grid.size), cells, self.expected.to_bits())
    }

    /// What these were the parts of.
    ///
    /// # Errors
    /// A cell that is not on the grid, a probability that is none.
    pub fn from_parts((grid, cells, expected): BeliefParts) -> Result<Self, ValueError> {
        let grid = Grid { headings: grid.0, size: grid.1 };
        let cells: Vec<(usize, f64)> = cells.into_iter().map(|(cell, bits)| (cell, f64::from_bits(bits))).collect();
        for &(cell, probability) in &cells {
            parameter("cell", cell as f64, cell < grid.cells(), "on the grid")?;
            parameter("probability", probability, (0.0..=1.0 + 1e-9).contains(&probability), "0 to 1")?;
        }
        Ok(Belief { grid, cells, expected: f64::from_bits(expected) })
    }

    /// One motion later. `at`: one zero for each cell; they are zeros again behind it.
    pub(super) fn after(&self, motion: &Motion, at: &mut [f64]) -> Vec<(usize, f64)> {
        let mut touched = Vec::with_capacity(2 * self.cells.len());
        for &(cell, probability) in &self.cells {
            for (to, share) in motion.from(cell) {
                if at[to] == 0.0 {
                    touched.push(to);
                }
                at[to] += probability * share;
            }
        }
        touched.into_iter().map(|cell| (cell, std::mem::take(&mut at[cell]))).collect()
    }

    /// Make these probabilities the belief, and say what they had summed to.
    pub(super) fn settle(&mut self, mut cells: Vec<(usize, f64)>) -> f64 {
        let sum = cells.iter().map(|of| of.1).sum::<f64>();
        let most = cells.iter().fold(0.0f64, |most, of| most.max(of.1));
        cells.retain(|of| of.1 > LEAST * most);
        let kept = cells.iter().map(|of| of.1).sum::<f64>();
        if kept > 0.0 {
            cells.iter_mut().for_each(|of| of.1 /= kept);
        }
        self.cells = cells;
        sum
    }

    /// The most probable pose, and what is around it.
    pub(super) fn mode(&self) -> Mode {
        let cell = self.cells.iter().fold((0, 0.0), |most, &of| if of.1 > most.1 { of } else { most }).0;
        let (mut near, mut sums, mut around) = (0.0, [0.0; 2], 0.0);
        for &(of, probability) in self.cells.iter().filter(|of| self.grid.is_near(of.0, cell)) {
            around += probability;
            let by = self.grid.away(of, cell);
            if by.iter().all(|by| by.abs() <= 1) {
                near += probability;
                (0..2).for_each(|axis| sums[axis] += probability * by[axis] as f64);
            }
        }
        let pose = self.grid.pose(cell);
        let between = |sum: f64| if near > 0.0 { sum / near } else { 0.0 };
        Mode { cell, pose: Pose { x: pose.x + between(sums[0]), y: pose.y + between(sums[1]), ..pose }, around }
    }
}

/// A most probable pose.
pub(super) struct Mode {
    cell: usize,
    /// Between the cells next to it.
    pub pose: Pose,
    /// Probability of all within two moves of it with its heading.
    pub around: f64,
}
