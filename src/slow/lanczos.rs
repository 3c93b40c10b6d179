//! The largest eigenvalues of a symmetric operator by block Lanczos iteration.
//!
//! 1. The basis `V` grows by a block at a time: the operator's image of the newest block, made orthogonal to all of the basis
//!    (twice, so that it is so to the last bits) and orthonormal in itself, is the next block. `MX = V·H + X₊β`.
//! 2. `T = VᵀMV` is known from the products of the orthogonalisation. Its largest eigenvalues θ and their vectors `y` (the
//!    Ritz pairs) approximate those of `M`, where `u = Vy`. The residual costs no product with `M`: `‖Mu − θu‖ = ‖βy_b‖`, with the
//!    rows `y_b` of the newest block.
//! 3. Eigenvalues of `T` are costly, so they are found only when the residuals, by their trend, will be small enough.
//! 4. A basis that reaches its limit is replaced by its best Ritz vectors, and grows on from these (a thick restart).
//!
//! Small blocks need far fewer products in all than a block of the size of the number of eigenvalues that are wanted.
//!
//! # Reference
//! Golub & Underwood, in: Mathematical Software III (1977) (block Lanczos); Wu & Simon, SIAM J. Matrix Anal. Appl. 22 (2000)
//! (thick restart).

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::householder::{
    apply_block_householder_sequence_on_the_left_in_place_scratch,
    apply_block_householder_sequence_on_the_left_in_place_with_conj,
};
use faer::linalg::matmul::matmul;
use faer::linalg::qr::no_pivoting::factor::{qr_in_place, qr_in_place_scratch};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Conj, Mat, MatRef, Par};
use rand::RngExt;

use super::error::SlowError;
use super::symmetric::{ascending, cholesky};
use crate::kernel::products::for_columns;
use crate::random;

/// Columns of a block. Products with wider blocks are faster, but more vectors are needed then, and the basis must be larger.
pub(super) const BLOCK: usize = 32;

/// Columns of the Householder reflections that are applied at a time.
const REFLECTIONS: usize = 16;

/// Ritz values below this share of the largest are near the rounding of the operator.
const ROUNDING: f64 = 1e-11;

/// The largest eigenvalues that were found.
pub(super) struct Found {
    /// Eigenvalues, descending, `k`.
    pub values: Vec<f64>,
    /// Their orthonormal vectors, `m × k`.
    pub vectors: Mat<f64>,
    /// Vectors that the operator was applied to.
    pub applied: usize,
    /// Largest of the residuals `‖Mu − θu‖/θ`.
    pub residual: f64,
}

/// Is the iteration one for `k` of `m` eigenvalues? Its basis must have room, and be worth it.
pub(super) fn fits(m: usize, k: usize) -> bool {
    has_room(m, k, BLOCK)
}

/// May the basis for `k` features with blocks of `block` be as large as it needs? Any `k` can be asked for, also the largest.
fn has_room(m: usize, k: usize, block: usize) -> bool {
    (1..m).contains(&k) && 3 * basis_limit(k, block) <= 2 * m
}

/// The most vectors that the basis for `k` features with blocks of `block` may have.
pub(super) fn basis_limit(k: usize, block: usize) -> usize {
    (k + (3 * k).max(8 * block)).next_multiple_of(block)
}

/// The `k` largest eigenvalues of a symmetric operator over `m` values, each with a residual of at most `tolerance` times
/// itself. The residual bounds the error of an eigenvalue; that is of the order of its square, divided by the distance to the
/// eigenvalues that were not looked for.
///
/// None if they are not found: too many vectors for iterations to be worth it, eigenvalues within the operator's rounding, or
/// no convergence.
///
/// An eigenvalue of a higher multiplicity than the block has columns would be found only that many times. As many equal
/// values as that are therefore not trusted: the iteration starts anew, with a block of twice the size.
pub(super) fn largest(
    operator: &dyn Fn(Mat<f64>) -> Mat<f64>,
    m: usize,
    k: usize,
    tolerance: f64,
    par: Par,
) -> Result<Option<Found>, SlowError> {
    let mut block = BLOCK;
    while has_room(m, k, block) {
        match iterate(operator, m, k, block, tolerance, par)? {
            Some(found) if may_have_missed_some(&found.values, block, tolerance) => block *= 2,
            other => return Ok(other),
        }
    }
    Ok(None)
}

/// Does a whole block of equal values stand before others?
fn may_have_missed_some(values: &[f64], block: usize, tolerance: f64) -> bool {
    values.windows(block + 1).any(|window| window[0] - window[block - 1] <= 10.0 * tolerance * window[0])
}

fn iterate(
    operator: &dyn Fn(Mat<f64>) -> Mat<f64>,
    m: usize,
    k: usize,
    block: usize,
    tolerance: f64,
    par: Par,
) -> Result<Option<Found>, SlowError> {
    let limit = basis_limit(k, block);
    let mut generator = random::stream(0, "block Lanczos");
    let start = Mat::from_fn(m, block, |_, _| generator.random_range(-1.0..1.0));
    let (mut newest, _) = thin_qr(start, par);
    let mut basis = Mat::with_capacity(m, limit);
    let mut projected = Mat::<f64>::zeros(0, 0);
    let mut schedule = Schedule { next: 2 * k + 4 * block, last: None };
    let mut applied = 0;
    while applied < 2 * m + limit {
        append(&mut basis, newest.as_ref());
        let image = operator(newest);
        applied += block;
        let (next, beta) = expand(&basis, &mut projected, image, par);
        newest = next;
        let size = basis.ncols();
        if size < schedule.next && size + block <= limit {
            continue;
        }

        let (values, vectors) = ascending(projected.as_ref())?;
        let last = vectors.subrows(size - block, block);
        let residuals = &beta * last;
        let share = |j: usize| match values[size - 1 - j] {
            value if value > 0.0 => residuals.col(size - 1 - j).norm_l2() / value,
            _ => f64::INFINITY,
        };
        let worst = (0..k).map(share).fold(0.0, f64::max);
        let (first, smallest) = (values[size - 1], values[size - k]);
        let chosen = |count: usize| {
            let mut best = Mat::zeros(m, count);
            let columns = vectors.subcols(size - count, count).reverse_cols();
            matmul(best.as_mut(), Accum::Replace, basis.as_ref(), columns, 1.0, for_columns(par, count));
            best
        };
        let hopeless = residuals.col(size - k).norm_l2() <= ROUNDING * first && smallest <= ROUNDING * first;
        if hopeless || !first.is_finite() {
            return Ok(None);
        }
        if worst <= tolerance {
            let values = values.into_iter().rev().take(k).collect();
            return Ok(Some(Found { values, vectors: chosen(k), applied, residual: worst }));
        }
        if size + block > limit {
            let kept = k + (limit - k) / 3;
            basis = chosen(kept);
            basis.reserve(m, limit);
            projected = Mat::from_fn(kept, kept, |i, j| if i == j { values[size - 1 - i] } else { 0.0 });
            schedule.restart(kept, block);
        } else {
            schedule.plan(size, worst / tolerance, block);
        }
    }
    Ok(None)
}

/// When to look at the Ritz pairs: the basis' size then.
struct Schedule {
    next: usize,
    /// Size of the basis, and by what factor the worst residual was too large, when they were last looked at.
    last: Option<(usize, f64)>,
}

impl Schedule {
    /// Residuals fall by a factor per block that changes little: go where they are small enough. The first guess is 10.
    fn plan(&mut self, size: usize, excess: f64, block: usize) {
        let blocks = match self.last {
            Some((before, was)) if was > excess => excess.ln() / (was / excess).ln() * ((size - before) / block) as f64,
            _ => excess.log10(),
        };
        // Far guesses are bad ones.
        self.next = size + (blocks.clamp(1.0, 8.0).round() as usize) * block;
        self.last = Some((size, excess));
    }

    fn restart(&mut self, kept: usize, block: usize) {
        (self.next, self.last) = (kept + 2 * block, None);
    }
}

/// Project the image of the newest block: extends `T`, and gives the next block and its coupling `β`.
fn expand(basis: &Mat<f64>, projected: &mut Mat<f64>, mut image: Mat<f64>, par: Par) -> (Mat<f64>, Mat<f64>) {
    let (size, block) = (basis.ncols(), image.ncols());
    let products = project_out(basis, &mut image, par);
    projected.resize_with(size, size, |_, _| 0.0);
    projected.as_mut().subrows_mut(size - block, block).copy_from(products.transpose());
    // Twice is enough; if nothing new is left, the factor's directions are arbitrary ones, and as good as random ones.
    let (mut next, mut beta) = thin_qr(image, par);
    for _ in 0..3 {
        project_out(basis, &mut next, par);
        let (again, factor) = thin_qr(next, par);
        next = again;
        beta = &factor * beta;
        if (0..block).all(|j| factor[(j, j)].abs() > 0.5) {
            break;
        }
    }
    (next, beta)
}

/// Subtract from the columns of `x` their part in the basis; what it was, in coordinates of the basis.
fn project_out(basis: &Mat<f64>, x: &mut Mat<f64>, par: Par) -> Mat<f64> {
    let par = for_columns(par, x.ncols());
    // A product whose result is stored by rows reads the basis once, as it lies in memory.
    let mut rows = Mat::zeros(x.ncols(), basis.ncols());
    matmul(rows.as_mut(), Accum::Replace, x.transpose(), basis.as_ref(), 1.0, par);
    let products = rows.transpose().to_owned();
    matmul(x.as_mut(), Accum::Add, basis.as_ref(), products.as_ref(), -1.0, par);
    products
}

/// Add columns to a basis that has room for them.
fn append(basis: &mut Mat<f64>, columns: MatRef<'_, f64>) {
    let size = basis.ncols();
    basis.resize_with(columns.nrows(), size + columns.ncols(), |i, j| columns[(i, j - size)]);
}

/// `X = QR` with orthonormal columns, also where those of `X` depend on each other.
///
/// By a Cholesky factor of `XᵀX`. Columns are orthonormal up to 2⁻⁵³ divided by the square of the least ratio of two pivots, which is mended where a block goes
/// through here a second time. By reflections, on one thread for the bits, where that ratio is too small.
fn thin_qr(x: Mat<f64>, par: Par) -> (Mat<f64>, Mat<f64>) {
    /// Least ratio of two pivots. Their squares would be lost in the rounding at 10⁻⁸.
    const PIVOTS: f64 = 1e-5;
    let b = x.ncols();
    let par = for_columns(par, b);
    let mut rows = x.transpose().to_owned();
    let mut factor = Mat::zeros(b, b);
    matmul(factor.as_mut(), Accum::Replace, rows.as_ref(), x.as_ref(), 1.0, par);
    let is_factor = cholesky(factor.as_mut(), Par::Seq);
    let pivots = || (0..b).map(|i| factor[(i, i)]);
    if !(is_factor && pivots().fold(f64::INFINITY, f64::min) > PIVOTS * pivots().fold(0.0, f64::max)) {
        return by_reflections(x);
    }
    solve_lower_triangular_in_place(factor.as_ref(), rows.as_mut(), par);
    (rows.transpose().to_owned(), Mat::from_fn(b, b, |i, j| if i <= j { factor[(j, i)] } else { 0.0 }))
}

/// The same by Householder reflections.
fn by_reflections(mut x: Mat<f64>) -> (Mat<f64>, Mat<f64>) {
    let (m, b) = (x.nrows(), x.ncols());
    let mut reflections = Mat::zeros(REFLECTIONS.min(b), b);
    let mut memory = MemBuffer::new(
        qr_in_place_scratch::<f64>(m, b, REFLECTIONS, Par::Seq, Default::default())
            .or(apply_block_householder_sequence_on_the_left_in_place_scratch::<f64>(m, REFLECTIONS, b)),
    );
    let stack = MemStack::new(&mut memory);
    qr_in_place(x.as_mut(), reflections.as_mut(), Par::Seq, stack, Default::default());
    let factor = Mat::from_fn(b, b, |i, j| if i <= j { x[(i, j)] } else { 0.0 });
    let mut q = Mat::identity(m, b);
    apply_block_householder_sequence_on_the_left_in_place_with_conj(
        x.as_ref(),
        reflections.as_ref(),
        Conj::No,
        q.as_mut(),
        Par::Seq,
        MemStack::new(&mut memory),
    );
    (q, factor)
}
