//! Optimal responses in a floor plan of any shape, by finite differences.
//!
//! In a rectangle the slowest functions of the position are cosines ([`theory`](super::theory)). In any other region with walls
//! that reflect, they are the eigenfunctions of the Laplacian with Neumann boundary, `−∇²ψ = κ²ψ`, `∂ψ/∂n = 0`: among functions
//! of variance 1 that are uncorrelated with those before, each has the smallest mean squared gradient. The Laplacian stands on
//! a grid of square cells; what lies beyond a wall takes no part, which is the Neumann condition. Eigenvalues are in error by
//! `O(κ²h²)` for cells of side `h`, and by somewhat more (`O(h^{4/3})` of themselves) where walls have corners that stick out.
//!
//! With a heading that is independent of the position, responses are products `ψ_i(x, y) · √2 sin, cos(jθ)`, of slowness
//! `½⟨v²⟩κ_i² + j²⟨θ̇²⟩`, for the same motion and with the same caveats as in a box.
//!
//! The smallest eigenvalues of the Laplacian `A` are found as the largest of `(A + sI)⁻¹`, by block Lanczos iteration. With
//! cells numbered along the shorter side, `A` is a band as wide as that side, and so is its Cholesky factor.
//!
//! # Reference
//! Thesis §4.1.2 (optimal responses), §5.2.4, where it says that those of two rooms are not known.

mod band;

use std::f64::consts::SQRT_2;

use faer::{Mat, MatRef, Par};
use thiserror::Error;

use self::band::Band;
use super::error::SlowError;
use super::lanczos;
use crate::kernel::products::map_all;

/// The most cells of a region: its factor then takes at most some GiB.
pub const MOST_CELLS: usize = 1 << 18;

/// Residuals of eigenvalues, as a share: far below the error of the grid.
const TOLERANCE: f64 = 1e-9;

/// Why there are no responses of a region.
#[derive(Debug, Error)]
pub enum RegionError {
    /// No region of this kind.
    #[error(
        "{cells} cells of side {side} are not allowed: there must be 2 to {MOST_CELLS}, with a side > 0 and finite"
    )]
    Cells {
        /// Cells inside.
        cells: usize,
        /// Their side.
        side: f64,
    },
    /// Cells that cannot be reached from each other have more than one constant.
    #[error("the region is in {0} pieces: it must be connected")]
    Pieces(usize),
    /// Too many responses, or none.
    #[error("{asked} responses are asked for: allowed are 1 to {most}, for a region of {cells} cells")]
    Responses {
        /// Responses asked for.
        asked: usize,
        /// The most there are.
        most: usize,
        /// Cells of the region.
        cells: usize,
    },
    /// Speeds that leave something standing still.
    #[error("mean square speeds {0} and {1} are not allowed: both must be > 0 and finite")]
    Speeds(f64, f64),
    /// The eigenvalues were not found.
    #[error("the eigenvalues of the region did not converge")]
    Converge,
    /// A failure of the iteration.
    #[error(transparent)]
    Slow(#[from] SlowError),
}

/// A region of the plane: square cells.
#[derive(Debug, Clone, PartialEq)]
pub struct Region {
    low: [f64; 2],
    side: f64,
    size: [usize; 2],
    /// Number of each cell, row by row; `None` outside.
    numbers: Vec<Option<usize>>,
    /// Column and row of each number.
    places: Vec<[usize; 2]>,
}

impl Region {
    /// The cells of a grid that are inside. `low`: the grid's corner; `size`: columns and rows; `inside` is asked for the centre
    /// of each cell.
    ///
    /// # Errors
    /// Too few cells inside, or too many; cells that do not hang together by their sides.
    pub fn new(
        low: [f64; 2],
        side: f64,
        size: [usize; 2],
        inside: impl Fn([f64; 2]) -> bool,
    ) -> Result<Self, RegionError> {
        let all = size[0].saturating_mul(size[1]);
        if !(side > 0.0 && side.is_finite()) || all > 64 * MOST_CELLS {
            return Err(RegionError::Cells { cells: all, side });
        }
        // Neighbours must have near numbers: count along the shorter side first.
        let [long, short] = if size[0] >= size[1] { [0, 1] } else { [1, 0] };
        let mut region = Region { low, side, size, numbers: vec![None; all], places: Vec::new() };
        for i in 0..size[long] {
            for j in 0..size[short] {
                let mut place = [0; 2];
                (place[long], place[short]) = (i, j);
                if inside(region.centre(place)) {
                    let cell = region.cell(place);
                    region.numbers[cell] = Some(region.places.len());
                    region.places.push(place);
                }
            }
        }
        let cells = region.places.len();
        if !(2..=MOST_CELLS).contains(&cells) {
            return Err(RegionError::Cells { cells, side });
        }
        match region.pieces() {
            1 => Ok(region),
            pieces => Err(RegionError::Pieces(pieces)),
        }
    }

    /// Cells inside.
    pub fn cells(&self) -> usize {
        self.places.len()
    }

    /// Centres of the cells, in the order of their numbers.
    pub fn centres(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.places.iter().map(|&place| self.centre(place))
    }

    fn centre(&self, place: [usize; 2]) -> [f64; 2] {
        [0, 1].map(|axis| self.low[axis] + self.side * (place[axis] as f64 + 0.5))
    }

    fn cell(&self, [column, row]: [usize; 2]) -> usize {
        row * self.size[0] + column
    }

    /// Numbers of the cells beside one.
    fn beside(&self, number: usize) -> impl Iterator<Item = usize> + '_ {
        let [column, row] = self.places[number];
        let moved = [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().filter_map(move |(x, y)| {
            let place = [column.checked_add_signed(x)?, row.checked_add_signed(y)?];
            (place[0] < self.size[0] && place[1] < self.size[1]).then_some(place)
        });
        moved.filter_map(|place| self.numbers[self.cell(place)])
    }

    fn pieces(&self) -> usize {
        let mut seen = vec![false; self.cells()];
        let mut pieces = 0;
        for first in 0..self.cells() {
            if seen[first] {
                continue;
            }
            pieces += 1;
            seen[first] = true;
            let mut waiting = vec![first];
            while let Some(cell) = waiting.pop() {
                for next in self.beside(cell) {
                    if !std::mem::replace(&mut seen[next], true) {
                        waiting.push(next);
                    }
                }
            }
        }
        pieces
    }

    /// The numbers of up to four cells around a point, with their weights for linear interpolation; cells outside are left out.
    /// Farther away, the nearest cell.
    fn around(&self, point: [f64; 2]) -> Vec<(usize, f64)> {
        let at = [0, 1].map(|axis| (point[axis] - self.low[axis]) / self.side - 0.5);
        let base = at.map(f64::floor);
        let mut found = Vec::with_capacity(4);
        for [x, y] in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
            let place = [base[0] + x, base[1] + y];
            let within = (0..2).all(|axis| place[axis] >= 0.0 && place[axis] < self.size[axis] as f64);
            if within && let Some(number) = self.numbers[self.cell(place.map(|value| value as usize))] {
                let weight = (0..2).map(|axis| 1.0 - (at[axis] - place[axis]).abs()).product::<f64>();
                found.push((number, weight));
            }
        }
        let sum: f64 = found.iter().map(|(_, weight)| weight).sum();
        if sum > 1e-9 {
            found.iter_mut().for_each(|(_, weight)| *weight /= sum);
            return found;
        }
        let distance = |number: &usize| {
            let centre = self.centre(self.places[*number]);
            (centre[0] - point[0]).hypot(centre[1] - point[1])
        };
        // A region has cells.
        let nearest = (0..self.cells()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
        vec![(nearest, 1.0)]
    }

    /// The `k` slowest functions of the position: wave numbers squared, ascending, without the constant, and the functions, `cells × k`, each
    /// with mean 0 and mean square 1 over the cells.
    fn modes(&self, k: usize, par: Par) -> Result<(Vec<f64>, Mat<f64>), RegionError> {
        let n = self.cells();
        // The slowest wave a region of this size can have, about: a shift that keeps the constant apart from it.
        let longest = self.size[0].max(self.size[1]) as f64;
        let shift = (std::f64::consts::PI / longest).powi(2);
        let factor = Band::factor(self, shift);
        let operator = |x: Mat<f64>| {
            let columns: Vec<Vec<f64>> = map_all(x.ncols(), |j| factor.solve(x.col(j).iter().copied().collect()));
            Mat::from_fn(n, x.ncols(), |i, j| columns[j][i])
        };
        let (values, vectors) = if lanczos::fits(n, k + 1) {
            let found = lanczos::largest(&operator, n, k + 1, TOLERANCE, par)?.ok_or(RegionError::Converge)?;
            (found.values, found.vectors)
        } else {
            // So few cells that all eigenvalues cost nothing.
            let inverse = operator(Mat::identity(n, n));
            let all = inverse.self_adjoint_eigen(faer::Side::Lower).map_err(|_| RegionError::Converge)?;
            let values: Vec<f64> = (0..=k).map(|i| all.S()[n - 1 - i]).collect();
            (values, Mat::from_fn(n, k + 1, |i, j| all.U()[(i, n - 1 - j)]))
        };
        let unit = (n as f64).sqrt();
        // The sign is arbitrary: the first cell of some size is positive.
        let sign = |j: usize| {
            let first = (0..n).map(|i| vectors[(i, j)]).find(|value| value.abs() * unit > 0.1).unwrap_or(1.0);
            first.signum()
        };
        let signs: Vec<f64> = (1..=k).map(sign).collect();
        let squares = values[1..].iter().map(|value| (1.0 / value - shift).max(0.0) / self.side.powi(2)).collect();
        Ok((squares, Mat::from_fn(n, k, |i, j| signs[j] * unit * vectors[(i, j + 1)])))
    }
}

/// A response: a function of the position times one of the heading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegionResponse {
    /// Number of the function of the position, from the slowest; 0: the constant.
    pub position: usize,
    /// Number of the function of the heading: 0 the constant, 1 the sine and 2 the cosine of one turn, 3 and 4 of two, …
    pub heading: usize,
    /// Slowness, 1/s².
    pub slowness: f64,
}

/// The slowest responses of a region and a heading.
#[derive(Debug, Clone)]
pub struct RegionResponses {
    region: Region,
    /// Wave numbers squared of the functions of the position, without the constant.
    squares: Vec<f64>,
    modes: Mat<f64>,
    responses: Vec<RegionResponse>,
}

impl RegionResponses {
    /// The `k` slowest responses of a robot that moves in the plane with `⟨v²⟩` = `speed` in whatever direction, and turns with
    /// `⟨θ̇²⟩` = `turn` (m²/s², rad²/s²).
    ///
    /// # Errors
    /// No responses asked for, or more than there are cells; speeds that are not positive.
    pub fn slowest(region: Region, speed: f64, turn: f64, k: usize, par: Par) -> Result<Self, RegionError> {
        let cells = region.cells();
        if k == 0 || k >= cells {
            return Err(RegionError::Responses { asked: k, most: cells - 1, cells });
        }
        if !(speed > 0.0 && speed.is_finite() && turn > 0.0 && turn.is_finite()) {
            return Err(RegionError::Speeds(speed, turn));
        }
        // As many functions of the position as are slower than the last response; doubled until that is so.
        let mut count = k.min(32);
        loop {
            let (squares, modes) = region.modes(count, par)?;
            let beyond = 0.5 * speed * squares[count - 1];
            let all = products(&squares, 0.5 * speed, turn, k);
            let enough = all.len() == k && all[k - 1].slowness <= beyond;
            if enough || count == k {
                return Ok(RegionResponses { region, squares, modes, responses: all });
            }
            count = (2 * count).min(k);
        }
    }

    /// The responses, slowest first.
    pub fn responses(&self) -> &[RegionResponse] {
        &self.responses
    }

    /// Wave numbers squared of the functions of the position, 1/m², ascending, without the constant.
    pub fn wave_numbers_squared(&self) -> &[f64] {
        &self.squares
    }

    /// The region.
    pub fn region(&self) -> &Region {
        &self.region
    }

    /// The responses at given poses: `3 × n` (x, y, heading) gives `k × n`, each with variance 1 over region and headings.
    /// Between centres of cells they are interpolated.
    ///
    /// # Panics
    /// Points of other than three coordinates.
    pub fn evaluate(&self, points: MatRef<'_, f64>) -> Mat<f64> {
        assert_eq!(points.nrows(), 3, "a pose has three coordinates");
        let mut phi = Mat::zeros(self.responses.len(), points.ncols());
        let mut position = vec![1.0; self.squares.len() + 1];
        for point in 0..points.ncols() {
            let around = self.region.around([points[(0, point)], points[(1, point)]]);
            for mode in 0..self.squares.len() {
                position[mode + 1] = around.iter().map(|&(cell, weight)| weight * self.modes[(cell, mode)]).sum();
            }
            for (i, response) in self.responses.iter().enumerate() {
                phi[(i, point)] = position[response.position] * wave(response.heading, points[(2, point)]);
            }
        }
        phi
    }
}

/// Function of the heading, of variance 1.
fn wave(number: usize, heading: f64) -> f64 {
    let turns = number.div_ceil(2) as f64;
    match number {
        0 => 1.0,
        _ if number % 2 == 1 => SQRT_2 * (turns * heading).sin(),
        _ => SQRT_2 * (turns * heading).cos(),
    }
}

/// The slowest `k` products of a function of the position and one of the heading, without the constant.
fn products(squares: &[f64], place: f64, turn: f64, k: usize) -> Vec<RegionResponse> {
    let of_place = |position: usize| if position == 0 { 0.0 } else { place * squares[position - 1] };
    let mut all: Vec<RegionResponse> = (0..=squares.len())
        .flat_map(|position| {
            (0..=2 * k).map(move |heading| (position, heading)).filter(|&(position, heading)| position + heading > 0)
        })
        .map(|(position, heading)| {
            let turns = heading.div_ceil(2) as f64;
            RegionResponse { position, heading, slowness: of_place(position) + turn * turns * turns }
        })
        .collect();
    // Stable: equally slow ones stay in the order of their numbers.
    all.sort_by(|a, b| a.slowness.total_cmp(&b.slowness));
    all.truncate(k);
    all
}
