//! Symmetric matrices of which only the lower triangle is stored: products, a Cholesky factor, solutions by it, and eigenvalues.
//!
//! Products and factors have the same bits for any number of threads. faer's eigenvalues do not: they run on one.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Accum, Mat, MatMut, MatRef, Par};

use super::error::SlowError;
use crate::kernel::products::{add_product, for_columns};

/// Columns that the Cholesky factor is made of at a time. It decides about the bits: it must not depend on the machine.
pub(super) const PANEL: usize = 256;

/// Product `scale·A·X` of a symmetric `A`, of which the lower triangle is read.
pub(super) fn times(lower: MatRef<'_, f64>, x: MatRef<'_, f64>, scale: f64, par: Par) -> Mat<f64> {
    let par = for_columns(par, x.ncols());
    // By rows: faster where there are few columns.
    let mut rows = Mat::zeros(x.ncols(), x.nrows());
    let rectangle = BlockStructure::Rectangular;
    for (accum, a, structure) in [
        (Accum::Replace, lower, BlockStructure::TriangularLower),
        (Accum::Add, lower.transpose(), BlockStructure::StrictTriangularUpper),
    ] {
        triangular_matmul(rows.as_mut().transpose_mut(), rectangle, accum, a, structure, x, rectangle, scale, par);
    }
    rows.transpose().to_owned()
}

/// Are all values of the lower triangle finite?
pub(super) fn is_finite(lower: MatRef<'_, f64>) -> bool {
    let finite = |j: usize| lower.col(j).subrows(j, lower.nrows() - j).iter().fold(true, |all, x| all & x.is_finite());
    (0..lower.ncols()).all(finite)
}

/// Replace the lower triangle of a symmetric matrix by that of its Cholesky factor; what stands above it is lost. False if
/// there is none.
///
/// Panels of columns from the left to the right, so that nearly all of the work is products of large blocks.
pub(super) fn cholesky(mut a: MatMut<'_, f64>, par: Par) -> bool {
    let m = a.nrows();
    let mut memory = MemBuffer::new(cholesky_in_place_scratch::<f64>(PANEL.min(m), Par::Seq, Default::default()));
    for start in (0..m).step_by(PANEL) {
        let width = PANEL.min(m - start);
        let (_, _, left, right) = a.rb_mut().split_at_mut(start, start);
        let left = left.rb();
        let mut panel = right.subcols_mut(0, width);
        add_product(panel.rb_mut(), left, left.subrows(0, width), -1.0, par);
        let (mut corner, below) = panel.split_at_row_mut(width);
        let stack = MemStack::new(&mut memory);
        if cholesky_in_place(corner.rb_mut(), Default::default(), Par::Seq, stack, Default::default()).is_err() {
            return false;
        }
        let par = for_columns(par, below.nrows());
        solve_lower_triangular_in_place(corner.rb(), below.transpose_mut(), par);
    }
    true
}

/// Make a matrix symmetric by its lower triangle.
pub(super) fn mirror(mut a: MatMut<'_, f64>) {
    /// Rows and columns of a tile: one and its mirror image stay in the first cache.
    const TILE: usize = 32;
    let m = a.nrows();
    for first in (0..m).step_by(TILE) {
        for below in (first..m).step_by(TILE) {
            for j in first..m.min(first + TILE) {
                for i in below.max(j)..m.min(below + TILE) {
                    a[(j, i)] = a[(i, j)];
                }
            }
        }
    }
}

/// `XA` for few rows `X` and a symmetric `A` that is stored as a whole. Such a product reads `A` once, as it lies in memory, which is up to
/// twice as fast as the other forms.
///
/// # Shapes
/// `a: m × m`, `x: b × m`; the result: `b × m`.
pub(super) fn rows_times(x: MatRef<'_, f64>, a: MatRef<'_, f64>, par: Par) -> Mat<f64> {
    let mut rows = Mat::zeros(x.nrows(), a.ncols());
    matmul(rows.as_mut(), Accum::Replace, x, a, 1.0, for_columns(par, x.nrows()));
    rows
}

/// A Cholesky factor `R` for solutions with few columns, which are products of large blocks here.
///
/// `R⁻¹X` is solved by halves: what the first half of the rows has in the second one is subtracted there in one product. Parts of
/// one panel are multiplied with the inverse of its corner.
pub(super) struct Factor {
    /// `R`, and `Rᵀ` above its diagonal, so that both are read as they lie in memory.
    whole: Mat<f64>,
    /// Inverse corners of the panels, of [`PANEL`] columns each.
    corners: Vec<Mat<f64>>,
    par: Par,
}

impl Factor {
    /// From a factor, of which the lower triangle is read.
    pub fn new(mut lower: Mat<f64>, par: Par) -> Self {
        mirror(lower.as_mut());
        let m = lower.nrows();
        let corner = |start: usize| {
            let width = PANEL.min(m - start);
            let mut inverse = Mat::identity(width, width);
            let corner = lower.submatrix(start, start, width, width);
            solve_lower_triangular_in_place(corner, inverse.as_mut(), Par::Seq);
            inverse
        };
        let corners = (0..m).step_by(PANEL).map(corner).collect();
        Factor { whole: lower, corners, par }
    }

    /// `R`; only its lower triangle has a meaning.
    pub fn lower(&self) -> MatRef<'_, f64> {
        self.whole.as_ref()
    }

    /// Replace `X` by `R⁻¹X`. `rows`: `Xᵀ`, `b × m`.
    pub fn solve(&self, rows: MatMut<'_, f64>) {
        self.solve_part(rows, 0);
    }

    /// Replace `X` by `R⁻ᵀX`. `rows`: `Xᵀ`, `b × m`.
    pub fn solve_transposed(&self, rows: MatMut<'_, f64>) {
        self.solve_part_transposed(rows, 0);
    }

    fn solve_part(&self, rows: MatMut<'_, f64>, start: usize) {
        if rows.ncols() <= PANEL {
            return self.times(rows, self.corners[start / PANEL].transpose());
        }
        let half = (rows.ncols() / 2).next_multiple_of(PANEL);
        let (mut first, mut second) = rows.split_at_col_mut(half);
        self.solve_part(first.rb_mut(), start);
        let between = self.whole.submatrix(start, start + half, half, second.ncols());
        self.subtract(second.rb_mut(), first.rb(), between);
        self.solve_part(second, start + half);
    }

    fn solve_part_transposed(&self, rows: MatMut<'_, f64>, start: usize) {
        if rows.ncols() <= PANEL {
            return self.times(rows, self.corners[start / PANEL].as_ref());
        }
        let half = (rows.ncols() / 2).next_multiple_of(PANEL);
        let (mut first, mut second) = rows.split_at_col_mut(half);
        self.solve_part_transposed(second.rb_mut(), start + half);
        let between = self.whole.submatrix(start + half, start, second.ncols(), half);
        self.subtract(first.rb_mut(), second.rb(), between);
        self.solve_part_transposed(first, start);
    }

    fn times(&self, mut rows: MatMut<'_, f64>, corner: MatRef<'_, f64>) {
        let par = for_columns(self.par, rows.nrows().min(rows.ncols()));
        let before = rows.rb().to_owned();
        matmul(rows.rb_mut(), Accum::Replace, before.as_ref(), corner, 1.0, par);
    }

    fn subtract(&self, from: MatMut<'_, f64>, rows: MatRef<'_, f64>, between: MatRef<'_, f64>) {
        let par = for_columns(self.par, from.nrows().min(from.ncols()));
        matmul(from, Accum::Add, rows, between, -1.0, par);
    }
}

/// Eigenvalues of a symmetric matrix, of which the lower triangle is read, in ascending order, with their vectors.
pub(super) fn ascending(lower: MatRef<'_, f64>) -> Result<(Vec<f64>, Mat<f64>), SlowError> {
    let m = lower.nrows();
    let mut values = Diag::zeros(m);
    let mut vectors = Mat::zeros(m, m);
    let scratch = self_adjoint_evd_scratch::<f64>(m, ComputeEigenvectors::Yes, Par::Seq, Default::default());
    let mut memory = MemBuffer::new(scratch);
    let (s, u) = (values.as_mut(), Some(vectors.as_mut()));
    self_adjoint_evd(lower, s, u, Par::Seq, MemStack::new(&mut memory), Default::default())
        .map_err(|_| SlowError::Eigenvalues(m))?;
    Ok((values.column_vector().iter().copied().collect(), vectors))
}
