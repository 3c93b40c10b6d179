//! Approximate linear dependence (ALD) in the Newton basis, in blocks.
//!
//! An observation becomes a support vector when its image in feature space is farther than `ν` (squared) from the span of
//! the support vectors so far: `ε(x) > ν`. (The thesis prints the inequality of its algorithm 2 the wrong way round, and
//! its text says it right.) The factor `L` then grows by the row `[v(x)ᵀ, √ε]`. The inverse of `K`, which the thesis carries
//! by the Woodbury identity, drifts at small ν and then accepts other vectors; the factor does not.
//!
//! A block of observations costs one matrix product and one triangular solve; what the block's own members do to each
//! other is settled by a partial Cholesky factorisation of the block's Schur complement, in the order of the observations.
//! It accepts exactly what handling them one after the other accepts.

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Accum, Mat, MatRef, Par};
use thiserror::Error;

use crate::kernel::{Kernel, KernelError, Scalar, squared_norms};

/// What a dictionary refuses.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum DictionaryError {
    /// ν must be positive: with ν = 0 rounding alone decides.
    #[error("nu = {0} is not allowed: it must be in (0, 1)")]
    Nu(f64),
    /// A dictionary without room.
    #[error("a budget of 0 support vectors is not allowed: at least 1 is needed")]
    Budget,
    /// Observations of another length than the support vectors.
    #[error("an observation has {found} values, but the dictionary was begun with {expected}")]
    Dimension {
        /// Values per support vector.
        expected: usize,
        /// Values per observation given.
        found: usize,
    },
    /// Frames of a stream without one link each.
    #[error("there are {found} links for {expected} frames: one each is needed, None where a frame follows no other")]
    Links {
        /// Links given.
        found: usize,
        /// Frames given.
        expected: usize,
    },
    /// What the kernel refuses.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// A value that is not a number.
    #[error("observation {0} of the block holds a value that is not finite")]
    NotFinite(usize),
}

/// The checked parameters of a dictionary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameters {
    /// The kernel.
    pub kernel: Kernel,
    /// Acceptance threshold ν on the residual `ε(x)`, in (0, 1).
    pub nu: f64,
    /// The dictionary stops growing at this many support vectors.
    pub budget: usize,
    /// Threads for the matrix products (their bits do not depend on it).
    pub par: Par,
}

/// What a block of observations did.
#[derive(Debug, Clone)]
pub struct Block {
    /// Newton coordinates of the block in the dictionary as it is *after* the block, `m × b`.
    pub coordinates: Mat<f64>,
    /// Residual `ε(x)` of each observation at the moment it was judged, in [0, k(x, x)]: a novelty signal.
    pub residuals: Vec<f64>,
    /// Which observations of the block became support vectors, ascending.
    pub accepted: Vec<usize>,
    /// The nearest support vector of each observation, by kernel value, among those accepted up to it.
    pub nearest: Vec<usize>,
}

/// A growing set of support vectors with its Cholesky factor.
///
/// # Reference
/// Engel, Mannor & Meir 2004 (ALD); thesis §2.2.6, eq. `ald_condition2`; the Newton basis: Müller & Schaback 2009.
#[derive(Debug, Clone)]
pub struct Dictionary<T: Scalar> {
    parameters: Parameters,
    /// `d × m`.
    members: Mat<T>,
    /// Squared norms of the members.
    norms: Vec<f64>,
    /// Lower triangle holds `L`, `m × m`; what stands above the diagonal is zero.
    factor: Mat<f64>,
    /// Support vectors for which there is storage.
    capacity: usize,
}

impl<T: Scalar> Dictionary<T> {
    /// An empty dictionary.
    ///
    /// # Errors
    /// ν outside (0, 1), budget 0.
    pub fn new(parameters: Parameters) -> Result<Self, DictionaryError> {
        if !(parameters.nu > 0.0 && parameters.nu < 1.0) {
            return Err(DictionaryError::Nu(parameters.nu));
        }
        if parameters.budget == 0 {
            return Err(DictionaryError::Budget);
        }
        Ok(Dictionary { parameters, members: Mat::new(), norms: Vec::new(), factor: Mat::new(), capacity: 0 })
    }

    /// Number of support vectors `m`.
    pub fn len(&self) -> usize {
        self.norms.len()
    }

    /// Whether nothing was accepted yet.
    pub fn is_empty(&self) -> bool {
        self.norms.is_empty()
    }

    /// Whether the budget is used up, so that nothing more will be accepted.
    pub fn at_budget(&self) -> bool {
        self.len() >= self.parameters.budget
    }

    /// The parameters it was made with.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The support vectors, `d × m`.
    pub fn members(&self) -> MatRef<'_, T> {
        self.members.as_ref()
    }

    /// Squared norms of the support vectors, `m`.
    pub fn norms(&self) -> &[f64] {
        &self.norms
    }

    /// The Cholesky factor `L` of the kernel matrix, `m × m`, lower triangular.
    pub fn factor(&self) -> MatRef<'_, f64> {
        self.factor.as_ref()
    }

    /// Kernel rows `k(x)` of observations against all support vectors: `x: d × n` gives `m × n`.
    ///
    /// # Errors
    /// Observations of another length.
    pub fn kernel_rows(&self, x: MatRef<'_, T>) -> Result<Mat<f64>, DictionaryError> {
        self.check(x)?;
        self.rows_from(0, x, &squared_norms(x))
    }

    /// Newton coordinates `v(x) = L⁻¹k(x)` without growing: `x: d × n` gives `m × n`.
    ///
    /// # Errors
    /// Observations of another length, or not finite.
    pub fn coordinates(&self, x: MatRef<'_, T>) -> Result<Mat<f64>, DictionaryError> {
        let mut v = self.kernel_rows(x)?;
        solve_lower_triangular_in_place(self.factor.as_ref(), v.as_mut(), self.parameters.par);
        Ok(v)
    }

    /// The coordinates that observations got by growth: rows `old.nrows() .. m` of `v(x)`, given the earlier ones.
    ///
    /// # Shapes
    /// `x: d × n`, `old: m₀ × n` with `m₀ ≤ m`; the result is `(m − m₀) × n`.
    ///
    /// # Errors
    /// Shapes that do not fit.
    pub fn new_coordinates(
        &self,
        x: MatRef<'_, T>,
        norms: &[f64],
        old: MatRef<'_, f64>,
    ) -> Result<Mat<f64>, DictionaryError> {
        let (before, m) = (old.nrows(), self.len());
        let mut rows = self.rows_from(before, x, norms)?;
        let par = self.parameters.par;
        let factor = self.factor.as_ref();
        matmul(rows.as_mut(), Accum::Add, factor.submatrix(before, 0, m - before, before), old, -1.0, par);
        let corner = factor.submatrix(before, before, m - before, m - before);
        solve_lower_triangular_in_place(corner, rows.as_mut(), par);
        Ok(rows)
    }

    /// Judge a block of observations in their order, and accept those with `ε(x) > ν` while the budget lasts.
    ///
    /// # Shapes
    /// `x: d × b`.
    ///
    /// # Errors
    /// Observations of another length than earlier ones, or with values that are not finite; nothing is changed then.
    pub fn observe(&mut self, x: MatRef<'_, T>) -> Result<Block, DictionaryError> {
        self.check(x)?;
        let norms = squared_norms(x);
        if let Some(bad) = norms.iter().position(|norm| !norm.is_finite()) {
            return Err(DictionaryError::NotFinite(bad));
        }
        let Parameters { kernel, nu, budget, par } = self.parameters;
        let (m, b) = (self.len(), x.ncols());
        let mut known = self.rows_from(0, x, &norms)?;
        let mut nearest: Vec<(usize, f64)> = (0..b).map(|j| largest((0..m).map(|i| known[(i, j)]))).collect();
        solve_lower_triangular_in_place(self.factor.as_ref(), known.as_mut(), par);

        // Schur complement of the block: what its members have in common beyond the dictionary.
        let common = kernel.matrix(x, &norms, x, &norms, par)?;
        let mut schur = common.clone();
        matmul(schur.as_mut(), Accum::Add, known.transpose(), known.as_ref(), -1.0, par);

        let mut residuals = Vec::with_capacity(b);
        let mut accepted = Vec::new();
        let mut fresh: Vec<Vec<f64>> = Vec::new();
        for i in 0..b {
            let residual = schur[(i, i)].max(0.0);
            residuals.push(residual);
            if residual <= nu || m + accepted.len() >= budget {
                continue;
            }
            for (j, best) in nearest.iter_mut().enumerate().skip(i) {
                if common[(i, j)] > best.1 {
                    *best = (m + accepted.len(), common[(i, j)]);
                }
            }
            let root = residual.sqrt();
            let coordinate: Vec<f64> = (0..b).map(|j| schur[(i, j)] / root).collect();
            for (j, &of_column) in coordinate.iter().enumerate() {
                for (h, &of_row) in coordinate.iter().enumerate() {
                    schur[(h, j)] -= of_row * of_column;
                }
            }
            accepted.push(i);
            fresh.push(coordinate);
        }

        let coordinates = Mat::from_fn(m + fresh.len(), b, |i, j| if i < m { known[(i, j)] } else { fresh[i - m][j] });
        self.extend(x, &norms, &coordinates, &accepted);
        Ok(Block { coordinates, residuals, accepted, nearest: nearest.into_iter().map(|best| best.0).collect() })
    }

    /// Append accepted observations; their coordinates are the new rows of `L`.
    fn extend(&mut self, x: MatRef<'_, T>, norms: &[f64], coordinates: &Mat<f64>, accepted: &[usize]) {
        let (before, after) = (self.len(), self.len() + accepted.len());
        if before == after {
            return;
        }
        self.reserve(x.nrows(), after);
        self.members.resize_with(x.nrows(), after, |i, j| x[(i, accepted[j - before])]);
        self.factor.resize_with(after, after, |_, _| 0.0);
        for (offset, &index) in accepted.iter().enumerate() {
            let row = before + offset;
            for column in 0..=row {
                self.factor[(row, column)] = coordinates[(column, index)];
            }
            self.norms.push(norms[index]);
        }
    }

    /// Grow the storage by half of its size, so that appending does not copy everything each time.
    fn reserve(&mut self, d: usize, m: usize) {
        if m > self.capacity {
            self.capacity = (m + m / 2 + 64).min(self.parameters.budget).max(m);
            self.members.reserve(d, self.capacity);
            self.factor.reserve(self.capacity, self.capacity);
        }
    }

    fn rows_from(&self, first: usize, x: MatRef<'_, T>, norms: &[f64]) -> Result<Mat<f64>, DictionaryError> {
        if self.is_empty() {
            return Ok(Mat::zeros(0, x.ncols()));
        }
        let members = self.members.as_ref().subcols(first, self.len() - first);
        Ok(self.parameters.kernel.matrix(members, &self.norms[first..], x, norms, self.parameters.par)?)
    }

    fn check(&self, x: MatRef<'_, T>) -> Result<(), DictionaryError> {
        if !self.is_empty() && x.nrows() != self.members.nrows() {
            return Err(DictionaryError::Dimension { expected: self.members.nrows(), found: x.nrows() });
        }
        Ok(())
    }
}

/// Place and value of the largest entry; (0, −∞) if there is none.
fn largest(values: impl Iterator<Item = f64>) -> (usize, f64) {
    values.enumerate().fold((0, f64::NEG_INFINITY), |best, entry| if entry.1 > best.1 { entry } else { best })
}
