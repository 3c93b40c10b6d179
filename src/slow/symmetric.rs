//! Symmetric matrices of which only the lower triangle is stored: products, a Cholesky factor and eigenvalues.
//!
//! Products and factors have the same bits for any number of threads. faer's eigenvalues do not: they run on one.

use faer::diag::Diag;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{cholesky_in_place, cholesky_in_place_scratch};
use faer::linalg::evd::{ComputeEigenvectors, self_adjoint_evd, self_adjoint_evd_scratch};
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::prelude::{Reborrow, ReborrowMut};
use faer::{Accum, Mat, MatMut, MatRef, Par};

use super::error::SlowError;
use crate::kernel::products::{add_product, for_columns};

/// Columns that the Cholesky factor is made of at a time. It decides about the bits: it must not depend on the machine.
const PANEL: usize = 256;

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
