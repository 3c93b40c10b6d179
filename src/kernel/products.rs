//! Symmetric products and triangular solves on several threads.
//!
//! Work is cut in two, again and again, at places that do not depend on the number of threads, and every part runs on one
//! thread; so the result has the same bits on any number of them. Large plain products stay with faer, which cuts them well.

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatMut, MatRef, Par};

/// Run two parts of a piece of work, side by side if there are threads for it; each part is told how many it has.
///
/// Where the work is cut must not depend on `par`: then its result does not either, to the last bit.
pub(crate) fn join(par: Par, first: impl FnOnce(Par) + Send, second: impl FnOnce(Par) + Send) {
    match par {
        #[cfg(feature = "rayon")]
        Par::Rayon(threads) if threads.get() > 1 => {
            let half = threads.get() / 2;
            rayon::join(|| first(Par::rayon(threads.get() - half)), || second(Par::rayon(half)));
        }
        _ => {
            first(Par::Seq);
            second(Par::Seq);
        }
    }
}

/// `of(0), …, of(n − 1)`, on all threads of the process.
pub(crate) fn map_all<R: Send>(n: usize, of: impl Fn(usize) -> R + Send + Sync) -> Vec<R> {
    #[cfg(feature = "rayon")]
    {
        use rayon::prelude::*;
        (0..n).into_par_iter().map(of).collect()
    }
    #[cfg(not(feature = "rayon"))]
    (0..n).map(of).collect()
}

/// Threads for a product or a solve with `columns` columns: one thread for a single column, because faer sums such a product
/// in as many parts as there are threads, with other bits.
pub(crate) fn for_columns(par: Par, columns: usize) -> Par {
    if columns > 1 { par } else { Par::Seq }
}

/// `AB`, with the same bits for any number of threads.
pub(crate) fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>, par: Par) -> Mat<f64> {
    let mut c = Mat::zeros(a.nrows(), b.ncols());
    // One row is as bad as one column.
    let par = for_columns(par, a.nrows().min(b.ncols()));
    matmul(c.as_mut(), Accum::Replace, a, b, 1.0, par);
    c
}

/// Where to cut `size` > 32 into two parts of nearly the same size: parts of one row would be summed in another way than
/// larger ones, and uneven parts would keep one thread waiting. The first is a multiple of what vector registers hold.
pub(crate) fn near_half(size: usize) -> usize {
    size.div_ceil(2).next_multiple_of(16)
}

/// Columns of the factors that one product goes through. Deeper products are slower than several of this depth.
const DEPTH: usize = 256;

/// The lower triangle of `C += AAᵀ`; what stands above the diagonal is not touched.
///
/// # Shapes
/// `c: m × m`, `a: m × n`.
pub(crate) fn add_square(mut c: MatMut<'_, f64>, a: MatRef<'_, f64>, par: Par) {
    let (whole, lower) = (BlockStructure::Rectangular, BlockStructure::TriangularLower);
    let par = for_columns(par, a.nrows());
    for start in (0..a.ncols()).step_by(DEPTH) {
        let part = a.subcols(start, DEPTH.min(a.ncols() - start));
        let right = transposed(part);
        triangular_matmul(c.as_mut(), lower, Accum::Add, part, whole, right.as_ref(), whole, 1.0, par);
    }
}

/// `C += scale·ABᵀ`.
///
/// # Shapes
/// `c: m × l`, `a: m × n`, `b: l × n`.
pub(crate) fn add_product(mut c: MatMut<'_, f64>, a: MatRef<'_, f64>, b: MatRef<'_, f64>, scale: f64, par: Par) {
    let par = for_columns(par, b.nrows());
    for start in (0..a.ncols()).step_by(DEPTH) {
        let depth = DEPTH.min(a.ncols() - start);
        let right = transposed(b.subcols(start, depth));
        matmul(c.as_mut(), Accum::Add, a.subcols(start, depth), right.as_ref(), scale, par);
    }
}

/// `Aᵀ` with columns that are contiguous. A product whose right factor jumps from one column to the next with each value is a
/// fifth slower, which is many times what this copy takes.
fn transposed(a: MatRef<'_, f64>) -> Mat<f64> {
    /// Values that stand side by side in a line of the cache.
    const LINE: usize = 8;
    let (m, n) = (a.nrows(), a.ncols());
    let mut to = Mat::zeros(n, m);
    for start in (0..n).step_by(LINE) {
        let width = LINE.min(n - start);
        let from: Option<Vec<&[f64]>> =
            (start..start + width).map(|j| a.col(j).try_as_col_major().map(|column| column.as_slice())).collect();
        for i in 0..m {
            let line = &mut to.col_as_slice_mut(i)[start..start + width];
            match &from {
                Some(columns) => line.iter_mut().zip(columns).for_each(|(to, column)| *to = column[i]),
                None => line.iter_mut().enumerate().for_each(|(j, to)| *to = a[(i, start + j)]),
            }
        }
    }
    to
}

/// Rows that are solved before all of them are subtracted from the next ones in one product.
const ROWS: usize = 256;
/// Columns of such rows that one thread solves for.
const COLUMNS: usize = 128;

/// `X ← L⁻¹X` for a lower triangular `L`.
///
/// # Shapes
/// `l: m × m`, `x: m × n`.
pub(crate) fn solve_lower(l: MatRef<'_, f64>, mut x: MatMut<'_, f64>, par: Par) {
    let m = x.nrows();
    let par = for_columns(par, x.ncols());
    for start in (0..m).step_by(ROWS) {
        let rows = ROWS.min(m - start);
        let (solved, rest) = x.as_mut().split_at_row_mut(start);
        let mut next = rest.split_at_row_mut(rows).0;
        matmul(next.as_mut(), Accum::Add, l.submatrix(start, 0, rows, start), solved.as_ref(), -1.0, par);
        solve_columns(l.submatrix(start, start, rows, rows), next, par);
    }
}

fn solve_columns(l: MatRef<'_, f64>, x: MatMut<'_, f64>, par: Par) {
    let n = x.ncols();
    if n <= COLUMNS {
        return solve_lower_triangular_in_place(l, x, Par::Seq);
    }
    let (left, right) = x.split_at_col_mut(near_half(n));
    join(par, |par| solve_columns(l, left, par), |par| solve_columns(l, right, par));
}

/// `Σ a_i b_i` of lists of one length.
#[inline]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut sums = [0.0; LANES];
    let ((a, rest_a), (b, rest_b)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    a.iter().zip(b).for_each(|(a, b)| (0..LANES).for_each(|lane| sums[lane] += a[lane] * b[lane]));
    sums.iter().sum::<f64>() + rest_a.iter().zip(rest_b).map(|(a, b)| a * b).sum::<f64>()
}

#[cfg(all(test, feature = "rayon"))]
mod tests {
    use super::*;

    fn numbers(rows: usize, columns: usize) -> Mat<f64> {
        Mat::from_fn(rows, columns, |i, j| ((i * 37 + j * 101 + i * j) % 181) as f64 / 90.0 - 1.0)
    }

    #[test]
    fn parts_add_up_to_the_plain_product_and_solution_on_any_number_of_threads() {
        let (m, n) = (1300, 300);
        let a = numbers(m, n);
        let full = &a * a.transpose();
        let l = Mat::from_fn(m, m, |i, j| {
            if i == j {
                40.0
            } else if i > j {
                full[(i, j)] / 300.0
            } else {
                0.0
            }
        });
        let (mut square, mut solved) = (Mat::zeros(m, m), a.clone());
        add_square(square.as_mut(), a.as_ref(), Par::Seq);
        solve_lower(l.as_ref(), solved.as_mut(), Par::Seq);
        let difference = |i: usize, j: usize| if i >= j { square[(i, j)] - full[(i, j)] } else { square[(i, j)] };
        assert!(Mat::from_fn(m, m, difference).norm_max() < 1e-12 * full.norm_max());
        assert!((&l * &solved - &a).norm_max() < 1e-12);
        for threads in 1..5 {
            let (mut again, mut once_more) = (Mat::zeros(m, m), a.clone());
            add_square(again.as_mut(), a.as_ref(), Par::rayon(threads));
            solve_lower(l.as_ref(), once_more.as_mut(), Par::rayon(threads));
            assert!(again == square && once_more == solved, "{threads} threads");
        }
    }
}
