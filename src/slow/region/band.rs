//! The Laplacian of a region as a band matrix, and its Cholesky factor.

use super::Region;

/// The Cholesky factor of a region's Laplacian, shifted: a band below the diagonal.
pub(super) struct Band {
    n: usize,
    /// Entries of a row: the diagonal and `width − 1` to its left.
    width: usize,
    rows: Vec<f64>,
}

impl Band {
    /// The factor of `A + shift·I`, where `A` is the Laplacian in units of the cells' side.
    pub fn factor(region: &Region, shift: f64) -> Self {
        let n = region.cells();
        let reach = |i: usize| region.beside(i).map(|j| i.saturating_sub(j)).max().unwrap_or(0);
        let width = 1 + (0..n).map(reach).max().unwrap_or(0);
        let mut band = Band { n, width, rows: vec![0.0; n * width] };
        for i in 0..n {
            let neighbours: Vec<usize> = region.beside(i).collect();
            band.rows[i * width + width - 1] = neighbours.len() as f64 + shift;
            for j in neighbours.into_iter().filter(|&j| j < i) {
                band.rows[i * width + width - 1 - (i - j)] = -1.0;
            }
        }
        for i in 0..n {
            let first = i.saturating_sub(width - 1);
            for j in first..=i {
                // Columns that both rows have, left of j.
                let common = first.max(j.saturating_sub(width - 1));
                let (a, b) = (band.left(i, common, j), band.left(j, common, j));
                let dot: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
                let entry = band.rows[i * width + width - 1 - (i - j)] - dot;
                // The shifted Laplacian is positive definite.
                let value = if i == j { entry.sqrt() } else { entry / band.rows[j * width + width - 1] };
                band.rows[i * width + width - 1 - (i - j)] = value;
            }
        }
        band
    }

    /// Entries of a row in columns `from` to `to`, without the latter.
    fn left(&self, row: usize, from: usize, to: usize) -> &[f64] {
        let start = row * self.width + self.width - 1 - row;
        &self.rows[start + from..start + to]
    }

    /// The solution of `(A + shift·I) y = x`.
    pub fn solve(&self, mut x: Vec<f64>) -> Vec<f64> {
        for i in 0..self.n {
            let first = i.saturating_sub(self.width - 1);
            let dot: f64 = self.left(i, first, i).iter().zip(&x[first..i]).map(|(a, b)| a * b).sum();
            x[i] = (x[i] - dot) / self.rows[i * self.width + self.width - 1];
        }
        for i in (0..self.n).rev() {
            x[i] /= self.rows[i * self.width + self.width - 1];
            let (first, value) = (i.saturating_sub(self.width - 1), x[i]);
            for (x, a) in x[first..i].iter_mut().zip(self.left(i, first, i)) {
                *x -= a * value;
            }
        }
        x
    }
}
