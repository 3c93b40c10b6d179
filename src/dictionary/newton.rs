//! The dictionary itself: support vectors, the Cholesky factor of their kernel matrix, and Newton coordinates.

use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par};

use super::DictionaryError;
use crate::kernel::products::{dot, for_columns, product, solve_lower};
use crate::kernel::{self, Kernel, KernelError, Scalar, squared_norms};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// What a block of observations did.
#[derive(Debug, Clone)]
pub struct Block {
    /// Newton coordinates of the block in the dictionary as it is *after* the block, `m × b`.
    pub coordinates: Mat<f64>,
    /// Residual `ε(x)` of each observation at the moment it was judged, in [0, k(x, x)]: a novelty signal.
    pub residuals: Vec<f64>,
    /// Which observations of the block became support vectors, in the order in which they did.
    pub accepted: Vec<usize>,
    /// The serial number of the support vector with the largest kernel value, among those accepted up to the observation.
    /// For radial kernels that is the nearest one.
    pub nearest: Vec<usize>,
}

/// What became of the coordinates when support vectors left.
///
/// With `m` support vectors before and `m′` after, `v′ = Qv`, and the rows of `Q` are orthonormal: the identity for the
/// first [`from`](Thinning::from) coordinates, a [rotation](Thinning::rotation) for the others. Only [`Dictionary::keep`]
/// makes one.
#[derive(Debug, Clone, PartialEq)]
pub struct Thinning {
    keep: Vec<usize>,
    from: usize,
    rotation: Mat<f64>,
    /// Threads for products with the rotation.
    par: Par,
}

impl Thinning {
    /// Places of the support vectors that stayed, ascending, `m′`.
    pub fn keep(&self) -> &[usize] {
        &self.keep
    }

    /// Number of coordinates that did not change: those before the first support vector that left.
    pub fn from(&self) -> usize {
        self.from
    }

    /// The part of `Q` behind them, `(m′ − from) × (m − from)`, with orthonormal rows.
    pub fn rotation(&self) -> MatRef<'_, f64> {
        self.rotation.as_ref()
    }

    /// Number of coordinates before, `m`.
    pub fn before(&self) -> usize {
        self.from + self.rotation.ncols()
    }

    /// Number of coordinates after, `m′`.
    pub fn after(&self) -> usize {
        self.keep.len()
    }

    /// Coordinates (or weights of functions over them) in the smaller dictionary.
    ///
    /// # Shapes
    /// `v: p × n` with `p ≤ m`; missing rows count as zero, as for observations that never got them. The result is `m′ × n`.
    ///
    /// # Errors
    /// More rows than there were coordinates.
    pub fn apply(&self, v: MatRef<'_, f64>) -> Result<Mat<f64>, DictionaryError> {
        if v.nrows() > self.before() {
            return Err(DictionaryError::Shape {
                what: "the number of coordinates",
                found: v.nrows(),
                expected: self.before(),
            });
        }
        let same = self.from.min(v.nrows());
        let tail = v.subrows(same, v.nrows() - same);
        let turned = product(self.rotation.as_ref().subcols(0, tail.nrows()), tail, self.par);
        Ok(Mat::from_fn(self.after(), v.ncols(), |i, j| match i.checked_sub(self.from) {
            Some(row) => turned[(row, j)],
            None if i < same => v[(i, j)],
            None => 0.0,
        }))
    }
}

/// A set of support vectors with its Cholesky factor.
///
/// The factor `L` grows by the row `[v(x)ᵀ, √ε(x)]` when `x` becomes a support vector, so coordinates that exist never
/// change. The inverse of `K`, which the thesis carries by the Woodbury identity (§2.2.6, algorithm 2), drifts at small ν
/// and then accepts other vectors; the factor does not.
///
/// A block of observations costs one matrix product and one triangular solve; what the block's own members do to each
/// other is settled by a partial Cholesky factorisation of the block's Schur complement, in the order of the observations.
/// Of that complement only the part behind accepted observations is ever computed. It accepts exactly what handling them
/// one after the other accepts.
///
/// Support vectors can leave again ([`Dictionary::keep`]). The Newton coordinates of the smaller set are an orthogonal
/// projection of those of the larger one, so everything that was summed over coordinates follows exactly.
///
/// It knows how to grow and to shrink; *which* observations it takes is the business of a [`Selection`](super::Selection).
///
/// ```
/// use adagio::dictionary::Dictionary;
/// use adagio::kernel::Kernel;
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::dictionary::DictionaryError> {
/// let mut dictionary = Dictionary::new(Kernel::gaussian(1.0)?, 10, Par::Seq);
/// let x = Mat::from_fn(1, 3, |_, t| [0.0, 2.0, 1.0][t]);
/// // Take the first two whatever their residuals.
/// let block = dictionary.grow(x.as_ref(), |index, _| index < 2)?;
/// assert_eq!(block.accepted, [0, 1]);
/// // Scalar products with a support vector's coordinates are kernel values, exactly.
/// let v = dictionary.coordinates(x.as_ref())?;
/// assert!((v.col(0).transpose() * v.col(2) - (-0.5f64).exp()).abs() < 1e-14);
/// // What is left of the third observation is its residual.
/// assert!((block.residuals[2] - (1.0 - v.col(2).squared_norm_l2())).abs() < 1e-14);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// The Newton basis: Müller & Schaback 2009. The thesis (§2.2.6, algorithm 2) carries `K⁻¹` instead of `L`; on the Lorenz
/// series at ν = 10⁻⁴ that accepts other observations after 600 samples.
#[derive(Debug, Clone)]
pub struct Dictionary<T: Scalar> {
    kernel: Kernel,
    par: Par,
    /// `d × m`.
    members: Mat<T>,
    /// Squared norms of the members.
    norms: Vec<f64>,
    /// How many were accepted before each member.
    serials: Vec<usize>,
    /// Number of observations that were ever accepted.
    accepted: usize,
    /// Lower triangle holds `L`, `m × m`; what stands above the diagonal is zero.
    factor: Mat<f64>,
    /// Storage is not reserved beyond this, unless it is needed.
    expected: usize,
}

#[cfg(feature = "snapshot")]
impl<T: Scalar> Persist for Dictionary<T> {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let room = |_: usize, columns: usize| capacity(columns, self.expected);
        snapshot.matrix("members", &mut self.members, |rows, columns| (rows, room(rows, columns)))?;
        snapshot.matrix("factor", &mut self.factor, |rows, columns| (room(columns, rows), room(rows, columns)))?;
        snapshot.numbers("norms", &mut self.norms)?;
        snapshot.value("serials", &mut self.serials)?;
        snapshot.value("accepted", &mut self.accepted)?;
        let m = self.norms.len();
        let sizes = [self.members.ncols(), self.factor.nrows(), self.factor.ncols(), self.serials.len()];
        snapshot.check("factor", sizes == [m; 4], "the sizes do not fit each other")
    }
}

/// Residuals below this share of `k(x, x)` are rounding: such an observation is a combination of the support vectors, and
/// would make the factor singular.
pub(super) const ROUNDING: f64 = 1e-14;

impl<T: Scalar> Dictionary<T> {
    /// An empty dictionary, expected to grow to `expected` support vectors. `par`: threads for the matrix products.
    pub fn new(kernel: Kernel, expected: usize, par: Par) -> Self {
        Dictionary {
            kernel,
            par,
            members: Mat::new(),
            norms: Vec::new(),
            serials: Vec::new(),
            accepted: 0,
            factor: Mat::new(),
            expected,
        }
    }

    /// Number of support vectors `m`.
    pub fn len(&self) -> usize {
        self.norms.len()
    }

    /// Whether nothing was accepted yet.
    pub fn is_empty(&self) -> bool {
        self.norms.is_empty()
    }

    /// The kernel.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// Threads for the matrix products (their bits do not depend on it; those of the decomposition in [`Dictionary::keep`]
    /// follow faer's global setting, see [`fix_parallelism`](crate::random::fix_parallelism)).
    pub fn par(&self) -> Par {
        self.par
    }

    /// The support vectors, `d × m`.
    pub fn members(&self) -> MatRef<'_, T> {
        self.members.as_ref()
    }

    /// Squared norms of the support vectors, `m`.
    pub fn norms(&self) -> &[f64] {
        &self.norms
    }

    /// Serial number of each support vector, ascending, `m`: it keeps its number when others leave.
    pub fn serials(&self) -> &[usize] {
        &self.serials
    }

    /// The serial number that the next support vector will get.
    pub(super) fn next_serial(&self) -> usize {
        self.accepted
    }

    /// The Cholesky factor `L` of the kernel matrix, `m × m`, lower triangular.
    pub fn factor(&self) -> MatRef<'_, f64> {
        self.factor.as_ref()
    }

    /// Bytes of the matrices held.
    pub(crate) fn bytes(&self) -> usize {
        let room = self.room();
        (size_of::<T>() * self.members.col_stride().unsigned_abs() + size_of::<f64>() * room) * room
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
        self.check(x)?;
        let mut v = self.rows_from(0, x, &finite_norms(x)?)?;
        solve_lower(self.factor.as_ref(), v.as_mut(), self.par);
        Ok(v)
    }

    /// The coordinates that observations got by growth: rows `old.nrows() .. m` of `v(x)`, given the earlier ones.
    ///
    /// # Shapes
    /// `x: d × n` with `norms: n`, `old: m₀ × n` with `m₀ ≤ m`; the result is `(m − m₀) × n`.
    ///
    /// # Errors
    /// Shapes that do not fit.
    pub fn new_coordinates(
        &self,
        x: MatRef<'_, T>,
        norms: &[f64],
        old: MatRef<'_, f64>,
    ) -> Result<Mat<f64>, DictionaryError> {
        self.check(x)?;
        let (before, m) = (old.nrows(), self.len());
        if before > m {
            return Err(DictionaryError::Shape { what: "the number of coordinates", found: before, expected: m });
        }
        if old.ncols() != x.ncols() {
            let (found, expected) = (old.ncols(), x.ncols());
            return Err(DictionaryError::Shape { what: "the number of old coordinates", found, expected });
        }
        let mut rows = self.rows_from(before, x, norms)?;
        let factor = self.factor.as_ref();
        let par = for_columns(self.par, old.ncols());
        matmul(rows.as_mut(), Accum::Add, factor.submatrix(before, 0, m - before, before), old, -1.0, par);
        let corner = factor.submatrix(before, before, m - before, m - before);
        solve_lower(corner, rows.as_mut(), self.par);
        Ok(rows)
    }

    /// Judge a block of observations in their order: `accept(i, ε)` says whether observation `i`, whose residual is `ε`
    /// at that moment, becomes a support vector. It is not asked about exact combinations of the support vectors.
    ///
    /// # Shapes
    /// `x: d × b`.
    ///
    /// # Errors
    /// Observations of another length than the support vectors, or with values that are not finite; nothing is changed
    /// then.
    pub fn grow(
        &mut self,
        x: MatRef<'_, T>,
        mut accept: impl FnMut(usize, f64) -> bool,
    ) -> Result<Block, DictionaryError> {
        self.check(x)?;
        let norms = finite_norms(x)?;
        let (m, b) = (self.len(), x.ncols());
        let mut coordinates = self.rows_from(0, x, &norms)?;
        let mut nearest: Vec<(usize, f64)> = (0..b)
            .map(|j| largest(coordinates.col_as_slice(j)))
            .map(|(i, value)| (self.serials.get(i).copied().unwrap_or(0), value))
            .collect();
        solve_lower(self.factor.as_ref(), coordinates.as_mut(), self.par);
        let whole = self.own_values(x, &norms)?;
        let explained = |j: usize| dot(coordinates.col_as_slice(j), coordinates.col_as_slice(j));
        let mut left: Vec<f64> = (0..b).map(|j| whole[j] - explained(j)).collect();
        if let Some(bad) = left.iter().position(|residual| !residual.is_finite()) {
            // Finite observations whose kernel values are beyond the range of f64.
            return Err(DictionaryError::NotFinite(bad));
        }

        let mut residuals = Vec::with_capacity(b);
        let mut accepted = Vec::new();
        let mut judge = |i: usize, left: &[f64]| {
            let residual = left[i].max(0.0);
            residuals.push(residual);
            (residual > ROUNDING * whole[i] && accept(i, residual)).then_some(residual)
        };
        let mut next = 0;
        while next < b {
            let first = next;
            let Some(residual) = judge(first, &left) else {
                next += 1;
                continue;
            };
            // From here on, what observations have in common beyond the dictionary is needed: some at a time.
            next = (first + PANEL).min(b);
            let common = self.common(x, &norms, first..next, first..b)?;
            let mut panel = Panel::new(first, &common, coordinates.as_ref(), self.par);
            let mut turn = Some(residual);
            for i in first..next {
                let taken = if i == first { turn.take() } else { judge(i, &left) };
                let Some(residual) = taken else { continue };
                panel.take(i, residual, &mut left);
                for (j, best) in nearest.iter_mut().enumerate().skip(i) {
                    let value = common[(i - first, j - first)];
                    if value > best.1 {
                        *best = (self.accepted + accepted.len() + panel.taken.len() - 1, value);
                    }
                }
            }
            let common = self.common_of(x, &norms, &panel.taken, 0..first)?;
            if accepted.is_empty() {
                coordinates.reserve(m + b, b);
            }
            accepted.extend_from_slice(&panel.taken);
            panel.extend(&mut coordinates, common, self.par);
        }
        self.append(x, &norms, &coordinates, &accepted);
        Ok(Block { coordinates, residuals, accepted, nearest: nearest.into_iter().map(|best| best.0).collect() })
    }

    /// Kernel values of observations with themselves, by products as with others (and never by a product of one row, which is
    /// summed in another way): those of equal observations then are equal to the last bit, for a block of more than one.
    fn own_values(&self, x: MatRef<'_, T>, norms: &[f64]) -> Result<Vec<f64>, DictionaryError> {
        let b = x.ncols();
        let mut values = Vec::with_capacity(b);
        for first in (0..b).step_by(PANEL) {
            let from = if first > 0 && first + 1 == b { first - 1 } else { first };
            let places = from..(first + PANEL).min(b);
            let common = self.common(x, norms, places.clone(), places)?;
            values.extend((first - from..common.nrows()).map(|i| common[(i, i)]));
        }
        Ok(values)
    }

    /// Kernel values between observations of a block.
    fn common(
        &self,
        x: MatRef<'_, T>,
        norms: &[f64],
        rows: Range<usize>,
        columns: Range<usize>,
    ) -> Result<Mat<f64>, DictionaryError> {
        let part = |places: &Range<usize>| x.subcols(places.start, places.len());
        let (left, right) = (part(&rows), part(&columns));
        Ok(self.kernel.matrix(left, &norms[rows], right, &norms[columns], self.par)?)
    }

    /// As [`Dictionary::common`], for some observations on the left.
    fn common_of(
        &self,
        x: MatRef<'_, T>,
        norms: &[f64],
        rows: &[usize],
        columns: Range<usize>,
    ) -> Result<Mat<f64>, DictionaryError> {
        let mut left = Mat::zeros(x.nrows(), rows.len());
        rows.iter().enumerate().for_each(|(place, &row)| left.col_mut(place).copy_from(x.col(row)));
        let left_norms: Vec<f64> = rows.iter().map(|&row| norms[row]).collect();
        let right = x.subcols(columns.start, columns.len());
        Ok(self.kernel.matrix(left.as_ref(), &left_norms, right, &norms[columns], self.par)?)
    }

    /// Let all support vectors go but those at the places `keep` (ascending), and say what becomes of coordinates.
    ///
    /// With `P` the rows that stay, `PL = L′Q` (an LQ factorisation): `L′` is the new factor and `v′ = Qv`. Only what stands
    /// behind the first one that leaves is touched.
    ///
    /// # Errors
    /// Places that are not ascending or not those of support vectors, and none at all.
    pub fn keep(&mut self, keep: &[usize]) -> Result<Thinning, DictionaryError> {
        let m = self.len();
        if keep.is_empty() || keep.windows(2).any(|pair| pair[0] >= pair[1]) || keep[keep.len() - 1] >= m {
            return Err(DictionaryError::Keep { found: keep.len(), size: m });
        }
        let from = keep.iter().enumerate().take_while(|&(place, &kept)| place == kept).count();
        let (left, stay) = (m - from, keep.len() - from);
        // The transposed rows that stay, from their first column that changes: Q R, with R = L′ᵀ.
        let rows = Mat::from_fn(left, stay, |column, row| self.factor[(keep[from + row], from + column)]);
        let qr = rows.qr();
        drop(rows);
        let (q, r) = (qr.compute_thin_Q(), qr.thin_R());
        let sign = |row: usize| if r[(row, row)] < 0.0 { -1.0 } else { 1.0 };
        let rotation = Mat::from_fn(stay, left, |row, column| sign(row) * q[(column, row)]);
        let factor = Mat::from_fn(keep.len(), keep.len(), |i, j| match (i.checked_sub(from), j.checked_sub(from)) {
            _ if j > i => 0.0,
            (Some(row), Some(column)) => sign(column) * r[(column, row)],
            _ => self.factor[(keep[i], j)],
        });
        self.members = Mat::from_fn(self.members.nrows(), keep.len(), |i, j| self.members[(i, keep[j])]);
        self.norms = keep.iter().map(|&place| self.norms[place]).collect();
        self.serials = keep.iter().map(|&place| self.serials[place]).collect();
        self.factor = factor;
        Ok(Thinning { keep: keep.to_vec(), from, rotation, par: self.par })
    }

    /// Append accepted observations; their coordinates are the new rows of `L`.
    fn append(&mut self, x: MatRef<'_, T>, norms: &[f64], coordinates: &Mat<f64>, accepted: &[usize]) {
        let (before, after) = (self.len(), self.len() + accepted.len());
        if before == after {
            return;
        }
        self.reserve(x.nrows(), after);
        self.members.resize_with(x.nrows(), after, |_, _| T::zero_impl());
        self.factor.resize_with(after, after, |_, _| 0.0);
        for (offset, &index) in accepted.iter().enumerate() {
            self.members.col_mut(before + offset).copy_from(x.col(index));
            self.norms.push(norms[index]);
            self.serials.push(self.accepted);
            self.accepted += 1;
        }
        // Column by column: the new rows of the factor are far apart in storage.
        let rows: Vec<&[f64]> = accepted.iter().map(|&index| coordinates.col_as_slice(index)).collect();
        for column in 0..after {
            let above = column.saturating_sub(before);
            let entries = &mut self.factor.col_as_slice_mut(column)[before + above..];
            entries.iter_mut().zip(&rows[above..]).for_each(|(entry, row)| *entry = row[column]);
        }
    }

    /// Have storage for `m` support vectors, so that appending does not copy everything each time.
    fn reserve(&mut self, d: usize, m: usize) {
        if m > self.room() {
            let room = capacity(m, self.expected);
            self.members.reserve(d, room);
            self.factor.reserve(room, room);
        }
    }

    /// Support vectors for which there is storage.
    fn room(&self) -> usize {
        self.factor.col_stride().unsigned_abs()
    }

    fn rows_from(&self, first: usize, x: MatRef<'_, T>, norms: &[f64]) -> Result<Mat<f64>, DictionaryError> {
        if self.is_empty() {
            return Ok(Mat::zeros(0, x.ncols()));
        }
        let members = self.members.as_ref().subcols(first, self.len() - first);
        Ok(self.kernel.matrix(members, &self.norms[first..], x, norms, self.par)?)
    }

    /// Refuse observations of another length than the support vectors.
    pub(super) fn check(&self, x: MatRef<'_, T>) -> Result<(), DictionaryError> {
        if !self.is_empty() && x.nrows() != self.members.nrows() {
            return Err(DictionaryError::Dimension { expected: self.members.nrows(), found: x.nrows() });
        }
        Ok(())
    }
}

/// Squared norms, all finite.
pub(super) fn finite_norms<T: Scalar>(x: MatRef<'_, T>) -> Result<Vec<f64>, DictionaryError> {
    kernel::finite_norms("observation", x).map_err(|error| match error {
        KernelError::NotFinite { index, .. } => DictionaryError::NotFinite(index),
        other => other.into(),
    })
}

/// Storage for something that has `needed` entries and is expected to grow to `expected`: it doubles, but goes no further
/// than expected unless it has to.
pub(crate) fn capacity(needed: usize, expected: usize) -> usize {
    let doubled = needed.saturating_mul(2).max(256);
    // The last step is never a small one, which would copy almost everything once more.
    if doubled >= expected / 2 { expected.max(needed) } else { doubled }
}

/// Observations of a block that are judged before what they have in common with the next ones is computed.
const PANEL: usize = 32;

/// Some observations of a block of which the first is taken, on their way through a partial Cholesky factorisation.
struct Panel {
    /// Place of the first one in the block.
    first: usize,
    /// What the panel has in common with itself and the observations behind it beyond all that are taken.
    schur: Mat<f64>,
    /// Places in the block of those that are taken.
    taken: Vec<usize>,
    /// Their new coordinates: of the observations from the first of the panel on.
    rows: Vec<Vec<f64>>,
}

impl Panel {
    /// `common: p × (b − first)`, kernel values; `coordinates: m × b`, in everything taken before this panel.
    fn new(first: usize, common: &Mat<f64>, coordinates: MatRef<'_, f64>, par: Par) -> Self {
        let mut schur = common.clone();
        let behind = coordinates.subcols(first, common.ncols());
        let own = coordinates.subcols(first, common.nrows());
        matmul(schur.as_mut(), Accum::Add, own.transpose(), behind, -1.0, par);
        Panel { first, schur, taken: Vec::new(), rows: Vec::new() }
    }

    /// Take the observation at a place of the block, and what it explains away from all behind it.
    fn take(&mut self, place: usize, residual: f64, left: &mut [f64]) {
        let (at, root) = (place - self.first, residual.sqrt());
        let mut row: Vec<f64> = (0..self.schur.ncols()).map(|j| self.schur[(at, j)] / root).collect();
        row[at] = root;
        let of_panel = &row[at + 1..self.schur.nrows()];
        for (j, &share) in row.iter().enumerate() {
            let rest = &mut self.schur.col_as_slice_mut(j)[at + 1..];
            rest.iter_mut().zip(of_panel).for_each(|(entry, &of_row)| *entry -= of_row * share);
        }
        left[place + 1..].iter_mut().zip(&row[at + 1..]).for_each(|(rest, &share)| *rest -= share * share);
        self.taken.push(place);
        self.rows.push(row);
    }

    /// Append the new coordinates. `common: p′ × first`, kernel values of those taken with the observations before the
    /// panel, which got theirs in everything taken earlier only.
    fn extend(self, coordinates: &mut Mat<f64>, mut common: Mat<f64>, par: Par) {
        let (first, count, before) = (self.first, self.taken.len(), coordinates.nrows());
        let mut own = Mat::zeros(before, count);
        self.taken.iter().enumerate().for_each(|(place, &of)| own.col_mut(place).copy_from(coordinates.col(of)));
        matmul(common.as_mut(), Accum::Add, own.transpose(), coordinates.as_ref().subcols(0, first), -1.0, par);
        let corner = Mat::from_fn(count, count, |i, j| if j <= i { self.rows[j][self.taken[i] - first] } else { 0.0 });
        solve_lower(corner.as_ref(), common.as_mut(), par);
        coordinates.resize_with(before + count, coordinates.ncols(), |i, j| match j.checked_sub(first) {
            Some(behind) => self.rows[i - before][behind],
            None => common[(i - before, j)],
        });
    }
}

/// Place and value of the largest entry, the first of equal ones; (0, −∞) if there is none.
fn largest(values: &[f64]) -> (usize, f64) {
    const LANES: usize = 8;
    let larger = |best: f64, value: f64| if value > best { value } else { best };
    let mut best = [f64::NEG_INFINITY; LANES];
    let (whole, rest) = values.as_chunks::<LANES>();
    whole.iter().for_each(|chunk| best.iter_mut().zip(chunk).for_each(|(best, &value)| *best = larger(*best, value)));
    let best = best.iter().chain(rest).fold(f64::NEG_INFINITY, |best, &value| larger(best, value));
    (values.iter().position(|&value| value == best).unwrap_or(0), best)
}
