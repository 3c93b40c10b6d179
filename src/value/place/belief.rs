//! A probability of every pose.

use super::grid::{Grid, Motion, Pose};

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

    /// The most probable poses, and how probable they are.
    pub fn likely(&self, count: usize) -> Vec<(Pose, f64)> {
        let mut cells = self.cells.clone();
        cells.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        cells.truncate(count);
        cells.into_iter().map(|(cell, probability)| (self.grid.pose(cell), probability)).collect()
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

    /// The most probable pose, between the cells next to it, and the probability of all within two moves of it with its heading.
    pub(super) fn mode(&self) -> (Pose, f64) {
        let most = self.cells.iter().fold((0, 0.0), |most, &of| if of.1 > most.1 { of } else { most }).0;
        let (heading, x, y) = self.grid.parts(most);
        let size = self.grid.size as isize;
        let away = |a: usize, b: usize| (a as isize - b as isize + size / 2).rem_euclid(size) - size / 2;
        let (mut near, mut sums, mut around) = (0.0, [0.0; 2], 0.0);
        for &(cell, probability) in &self.cells {
            let (of, cx, cy) = self.grid.parts(cell);
            let by = [away(cx, x), away(cy, y)];
            if of == heading && by.iter().all(|by| by.abs() <= 2) {
                around += probability;
                if by.iter().all(|by| by.abs() <= 1) {
                    near += probability;
                    (0..2).for_each(|axis| sums[axis] += probability * by[axis] as f64);
                }
            }
        }
        let pose = self.grid.pose(most);
        let between = |sum: f64| if near > 0.0 { sum / near } else { 0.0 };
        (Pose { x: pose.x + between(sums[0]), y: pose.y + between(sums[1]), ..pose }, around)
    }
}
