//! Running sums over Newton coordinates, from which slow features are solved.

use faer::{Col, ColMut, Mat, MatRef, Par, unzip, zip};

use super::error::SlowError;
use super::links::{Link, check_links};
use super::symmetric::mirror;
use crate::dictionary::Thinning;
use crate::kernel::products::{add_square, join, product};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// The most coordinates that are summed over: two matrices of this size squared take 64 GiB.
pub const MOST_COORDINATES: usize = 1 << 16;

/// The running sums over `m` coordinates: what [`solve()`](super::solve()) needs to know of a signal.
///
/// `n`, `Σv`, `Σvvᵀ` and `Σ g·v̇v̇ᵀ` are kept in `f64`. A derivative exists only between frames that follow each other:
/// a gap, a restart or a teleport gives none. Sums can be widened by coordinates that come later ([`Moments::widen`]), and
/// can fade ([`Moments::fade`]) for scenes that change.
///
/// They take `16m²` bytes.
///
/// ```
/// use adagio::slow::{Link, Moments};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// let mut moments = Moments::new(Par::Seq);
/// moments.widen(1)?;
/// // Frames 0, 1, 3 half a second apart, then a gap, then 5 and 6.
/// let v = Mat::from_fn(1, 5, |_, t| [0.0, 1.0, 3.0, 5.0, 6.0][t]);
/// moments.add_series(v.as_ref(), &Link::sequences(&[3, 2], 0.5)?, None)?;
/// assert_eq!((moments.frames(), moments.links()), (5.0, 3.0));
/// assert_eq!(moments.mean()[(0, 0)], 3.0);
/// assert!((moments.covariance()[(0, 0)] - (9.0 + 4.0 + 0.0 + 4.0 + 9.0) / 5.0).abs() < 1e-12);
/// assert_eq!(moments.rate()[(0, 0)], (2f64.powi(2) + 4f64.powi(2) + 2f64.powi(2)) / 3.0);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Moments {
    /// Weighted number of frames.
    pub(super) frames: f64,
    /// `Σv`, `m × 1`.
    pub(super) sum: Mat<f64>,
    /// Lower triangle of `Σvvᵀ`, `m × m`.
    pub(super) square: Mat<f64>,
    /// `Σg`.
    pub(super) links: f64,
    /// Lower triangle of `Σ g·v̇v̇ᵀ`, `m × m`.
    pub(super) derivative: Mat<f64>,
    par: Par,
}

impl Moments {
    /// Sums over no frames and no coordinates.
    pub fn new(par: Par) -> Self {
        Moments { frames: 0.0, sum: Mat::zeros(0, 1), square: Mat::new(), links: 0.0, derivative: Mat::new(), par }
    }

    /// Number of coordinates `m` in the sums.
    pub fn size(&self) -> usize {
        self.sum.nrows()
    }

    /// Number of frames in the sums (weighted, if they fade).
    pub fn frames(&self) -> f64 {
        self.frames
    }

    /// Sum of the weights of all derivatives.
    pub fn links(&self) -> f64 {
        self.links
    }

    /// Add a block of frames.
    ///
    /// # Shapes
    /// `v: m × b`, the coordinates of the frames; `rates: m × l`, the derivatives `√g·v̇`  of those that have one;
    /// `weight`: the sum of the `g` of these.
    ///
    /// # Errors
    /// Rows that are not [`Moments::size`], a weight that is negative or not finite; nothing is changed then. Values that
    /// are not finite are found by [`solve`](super::solve()), which sees every sum.
    pub fn add(&mut self, v: MatRef<'_, f64>, rates: MatRef<'_, f64>, weight: f64) -> Result<(), SlowError> {
        self.check(v, rates, weight)?;
        self.frames += v.ncols() as f64;
        self.links += weight;
        self.sum_up(v, |_| 1.0);
        self.add_squares(v, rates);
        Ok(())
    }

    /// Add a block of a series: frames and how each follows the one before it.
    ///
    /// # Shapes
    /// `v: m × b`; `links: b`; `before: m × 1`, the last frame before the block, which is needed if the first link is not
    /// `None`.
    ///
    /// # Errors
    /// Shapes that do not fit, a link without a frame before it, a link with an impossible time or weight.
    pub fn add_series(
        &mut self,
        v: MatRef<'_, f64>,
        links: &[Option<Link>],
        before: Option<MatRef<'_, f64>>,
    ) -> Result<(), SlowError> {
        let (rates, weight) = rates(v, links, before)?;
        self.add(v, rates.as_ref(), weight)
    }

    /// As [`Moments::add_series`], for frames that have faded: `weights`, one each, if so.
    pub(super) fn add_faded(
        &mut self,
        v: MatRef<'_, f64>,
        links: &[Option<Link>],
        before: Option<MatRef<'_, f64>>,
        weights: Option<&[f64]>,
    ) -> Result<(), SlowError> {
        let Some(weights) = weights else { return self.add_series(v, links, before) };
        let faded: Vec<Option<Link>> =
            links.iter().zip(weights).map(|(link, w)| link.map(|l| Link { weight: l.weight * w, ..l })).collect();
        let (rates, weight) = rates(v, &faded, before)?;
        self.check(v, rates.as_ref(), weight)?;
        self.frames += weights.iter().sum::<f64>();
        self.links += weight;
        self.sum_up(v, |t| weights[t]);
        let mut scaled = v.to_owned();
        for (t, weight) in weights.iter().enumerate() {
            scale(scaled.col_mut(t), weight.sqrt());
        }
        self.add_squares(scaled.as_ref(), rates.as_ref());
        Ok(())
    }

    /// Both side by side: two small products make better use of threads than one does.
    fn add_squares(&mut self, v: MatRef<'_, f64>, rates: MatRef<'_, f64>) {
        let (square, derivative) = (self.square.as_mut(), self.derivative.as_mut());
        join(self.par, |par| add_square(square, v, par), |par| add_square(derivative, rates, par));
    }

    fn sum_up(&mut self, v: MatRef<'_, f64>, weight: impl Fn(usize) -> f64) {
        for (t, column) in v.col_iter().enumerate() {
            let weight = weight(t);
            zip!(self.sum.as_mut().col_mut(0), column).for_each(|unzip!(sum, value)| *sum += weight * *value);
        }
    }

    /// Have storage for `m` coordinates, so that widening up to there copies nothing.
    ///
    /// # Errors
    /// More than [`MOST_COORDINATES`].
    pub fn reserve(&mut self, m: usize) -> Result<(), SlowError> {
        if m > MOST_COORDINATES {
            return Err(SlowError::TooMany { what: "coordinates", asked: m, most: MOST_COORDINATES });
        }
        self.square.reserve(m, m);
        self.derivative.reserve(m, m);
        Ok(())
    }

    /// Make room for coordinates `size() .. m`, zero so far. Sums that are widened again and again are copied each time
    /// beyond what was [reserved](Moments::reserve).
    ///
    /// # Errors
    /// Fewer coordinates than there are, or more than [`MOST_COORDINATES`].
    pub fn widen(&mut self, m: usize) -> Result<(), SlowError> {
        if m < self.size() {
            return Err(SlowError::Narrower { size: self.size(), asked: m });
        }
        self.reserve(m)?;
        self.sum.resize_with(m, 1, |_, _| 0.0);
        self.square.resize_with(m, m, |_, _| 0.0);
        self.derivative.resize_with(m, m, |_, _| 0.0);
        Ok(())
    }

    /// Put in what frames that are in the sums contribute to the newest coordinates, which are zero so far.
    pub(super) fn set_rows(&mut self, rows: &NewRows) {
        let (from, new) = (rows.cross.ncols(), rows.sum.nrows());
        self.sum.as_mut().col_mut(0).subrows_mut(from, new).copy_from(&rows.sum);
        let (of_values, of_rates) = rows.cross.as_ref().split_at_row(new);
        for (target, cross, corner) in
            [(&mut self.square, of_values, &rows.square), (&mut self.derivative, of_rates, &rows.derivative)]
        {
            target.as_mut().submatrix_mut(from, 0, new, from).copy_from(cross);
            target.as_mut().submatrix_mut(from, from, new, new).copy_from(corner);
        }
    }

    /// Bytes of all storage.
    pub(super) fn bytes(&self) -> usize {
        let of = |matrix: &Mat<f64>| size_of::<f64>() * matrix.col_stride().unsigned_abs().pow(2);
        of(&self.square) + of(&self.derivative)
    }

    fn check(&self, v: MatRef<'_, f64>, rates: MatRef<'_, f64>, weight: f64) -> Result<(), SlowError> {
        SlowError::unless_fits("a frame's number of coordinates", v.nrows(), self.size())?;
        SlowError::unless_fits("a derivative's number of coordinates", rates.nrows(), self.size())?;
        if weight >= 0.0 && weight.is_finite() { Ok(()) } else { Err(SlowError::Weight(weight)) }
    }

    /// Let all sums fade by a factor in [0, 1].
    ///
    /// # Errors
    /// A factor out of this range; nothing is changed then.
    pub fn fade(&mut self, factor: f64) -> Result<(), SlowError> {
        if !(0.0..=1.0).contains(&factor) {
            return Err(SlowError::Fade(factor));
        }
        self.frames *= factor;
        self.links *= factor;
        for matrix in [&mut self.sum, &mut self.square, &mut self.derivative] {
            matrix.as_mut().col_iter_mut().for_each(|column| scale(column, factor));
        }
        Ok(())
    }

    /// Add the sums over other frames; no derivative leads from one to the other.
    ///
    /// # Errors
    /// Another number of coordinates; nothing is changed then.
    pub fn append(&mut self, other: &Moments) -> Result<(), SlowError> {
        SlowError::unless_fits("the number of coordinates in the other sums", other.size(), self.size())?;
        self.frames += other.frames;
        self.links += other.links;
        self.sum += &other.sum;
        self.square += &other.square;
        self.derivative += &other.derivative;
        Ok(())
    }

    /// The same frames with `by`, `m`, added to the coordinates of each.
    ///
    /// # Errors
    /// Another number of values than of coordinates; nothing is changed then.
    pub fn shift(&mut self, by: &[f64]) -> Result<(), SlowError> {
        SlowError::unless_fits("the shift", by.len(), self.size())?;
        // Σ(v + b)(v + b)ᵀ = Σvvᵀ + s bᵀ + b sᵀ + n b bᵀ with s = Σv.
        for j in 0..self.size() {
            for i in j..self.size() {
                let cross = self.sum[(i, 0)] * by[j] + by[i] * self.sum[(j, 0)];
                self.square[(i, j)] += cross + self.frames * by[i] * by[j];
            }
        }
        (0..self.size()).for_each(|i| self.sum[(i, 0)] += self.frames * by[i]);
        Ok(())
    }

    /// Follow a dictionary that lost support vectors: the sums over the coordinates in the smaller one, exactly.
    ///
    /// # Errors
    /// A thinning of another number of coordinates.
    pub fn thin(&mut self, thinning: &Thinning) -> Result<(), SlowError> {
        let (from, before, after) = (thinning.from(), thinning.before(), thinning.after());
        SlowError::unless_fits("the number of coordinates in the sums", self.size(), before)?;
        self.sum = thinning.apply(self.sum.as_ref())?;
        let rotation = thinning.rotation();
        for matrix in [&mut self.square, &mut self.derivative] {
            let cross = product(rotation, matrix.submatrix(from, 0, before - from, from), self.par);
            let corner = symmetric(before - from, |i, j| matrix[(from + i, from + j)]);
            let half = product(rotation, corner.as_ref(), self.par);
            drop(corner);
            let turned = product(half.as_ref(), rotation.transpose(), self.par);
            *matrix = Mat::from_fn(after, after, |i, j| match (i.checked_sub(from), j.checked_sub(from)) {
                _ if j > i => 0.0,
                (Some(row), Some(column)) => turned[(row, column)],
                (Some(row), None) => cross[(row, j)],
                _ => matrix[(i, j)],
            });
        }
        Ok(())
    }

    /// Mean coordinates `v̄`, `m × 1`; not a number without frames.
    pub fn mean(&self) -> Mat<f64> {
        &self.sum * faer::Scale(1.0 / self.frames)
    }

    /// Centred covariance `C` of the coordinates (divided by n), `m × m`, both triangles; not a number without frames.
    pub fn covariance(&self) -> Mat<f64> {
        let mean = self.mean();
        symmetric(self.size(), |i, j| self.square[(i, j)] / self.frames - mean[(i, 0)] * mean[(j, 0)])
    }

    /// Uncentred mean squares of the coordinates, `m`: they bound the rounding of [`Moments::covariance`].
    pub(super) fn mean_squares(&self) -> Vec<f64> {
        (0..self.size()).map(|i| self.square[(i, i)] / self.frames).collect()
    }

    /// Weighted mean `Ḋ` of `v̇v̇ᵀ`, `m × m`, both triangles; not a number without links. The difference is not centred: a
    /// steady drift is motion, too.
    pub fn rate(&self) -> Mat<f64> {
        symmetric(self.size(), |i, j| self.derivative[(i, j)] / self.links)
    }
}

#[cfg(feature = "snapshot")]
impl Persist for Moments {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let room = |rows: usize, columns: usize| (rows, columns);
        snapshot.number("frames", &mut self.frames)?;
        snapshot.number("links", &mut self.links)?;
        snapshot.matrix("sum", &mut self.sum, room)?;
        snapshot.matrix("square", &mut self.square, room)?;
        snapshot.matrix("derivative", &mut self.derivative, room)?;
        let m = self.sum.nrows();
        let sizes = [&self.square, &self.derivative].map(|matrix| (matrix.nrows(), matrix.ncols()));
        snapshot.check("square", sizes == [(m, m); 2] && self.sum.ncols() == 1, "the sizes do not fit each other")
    }
}

/// Derivatives `√g·(v_t − v_{t−1})/Δt` of the frames of a block that have a link.
///
/// # Shapes
/// `v: m × b`, `links: b`, `before: m × 1`, the last frame before the block, if its first frame has a link. The result is
/// `m × l`, with the sum of the weights.
///
/// # Errors
/// Another number of links than of frames, a first link without a frame before it, impossible times or weights.
fn rates(
    v: MatRef<'_, f64>,
    links: &[Option<Link>],
    before: Option<MatRef<'_, f64>>,
) -> Result<(Mat<f64>, f64), SlowError> {
    SlowError::unless_fits("the list of links", links.len(), v.ncols())?;
    check_links(links)?;
    if let Some(before) = before {
        SlowError::unless_fits("the frame before the block", before.nrows(), v.nrows())?;
        SlowError::unless_fits("the number of frames before the block", before.ncols(), 1)?;
    }
    let linked: Vec<(usize, Link)> = links.iter().enumerate().filter_map(|(t, link)| link.map(|l| (t, l))).collect();
    let weight = linked.iter().map(|(_, link)| link.weight).sum();
    let mut rates = Mat::<f64>::zeros(v.nrows(), linked.len());
    for (column, &(t, link)) in linked.iter().enumerate() {
        let scale = link.weight.sqrt() / link.dt;
        let earlier = match (t, before) {
            (0, Some(before)) => before.col(0),
            (0, None) => return Err(SlowError::NoPredecessor),
            (t, _) => v.col(t - 1),
        };
        zip!(rates.col_mut(column), v.col(t), earlier)
            .for_each(|unzip!(rate, now, before)| *rate = (*now - *before) * scale);
    }
    Ok((rates, weight))
}

/// What frames contribute to coordinates that are new to them.
pub(super) struct NewRows {
    /// `Σv`, of `m − from` new coordinates.
    pub sum: Col<f64>,
    /// `2(m − from) × from`, with the earlier coordinates: new rows of `Σvvᵀ` above those of `Σ g·v̇v̇ᵀ`.
    pub cross: Mat<f64>,
    /// Lower triangle of `Σvvᵀ` of the new coordinates.
    pub square: Mat<f64>,
    /// Lower triangle of `Σ g·v̇v̇ᵀ` of the new coordinates.
    pub derivative: Mat<f64>,
}

impl NewRows {
    pub fn zeros(from: usize, new: usize) -> Self {
        NewRows {
            sum: Col::zeros(new),
            cross: Mat::zeros(2 * new, from),
            square: Mat::zeros(new, new),
            derivative: Mat::zeros(new, new),
        }
    }
}

fn scale(column: ColMut<'_, f64>, factor: f64) {
    zip!(column).for_each(|unzip!(value)| *value *= factor);
}

/// Fill a symmetric matrix from a function of its lower triangle.
fn symmetric(m: usize, lower: impl Fn(usize, usize) -> f64) -> Mat<f64> {
    let mut full = Mat::from_fn(m, m, |i, j| if i >= j { lower(i, j) } else { 0.0 });
    mirror(full.as_mut());
    full
}
