//! Frames that a stream keeps, in chunks, with their coordinates: what moments are summed and filled in from.

use std::collections::VecDeque;
use std::mem::size_of;

use faer::{ColRef, Mat, MatRef, Par, unzip, zip};

use super::error::SlowError;
use super::links::Link;
use super::moments::{Moments, NewRows};
use crate::dictionary::{Dictionary, Thinning, capacity};
use crate::kernel::Scalar;
use crate::kernel::products::{add_product, add_square};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// How frames fade.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fading {
    /// The time constant, in frames; `None`: they do not.
    pub memory_frames: Option<f64>,
    /// The time, in frames.
    pub now: usize,
}

impl Fading {
    /// The factor since a time.
    pub fn since(&self, then: usize) -> f64 {
        self.memory_frames.map_or(1.0, |tau| (-((self.now - then) as f64) / tau).exp())
    }
}

/// Consecutive frames.
#[derive(Debug, Clone)]
struct Chunk<T: Scalar> {
    /// `d × c`, of which the first [`Chunk::len`] columns are in use.
    x: Mat<T>,
    /// Coordinates, `m × c`; as many rows as there are in the moments.
    v: Mat<f64>,
    norms: Vec<f64>,
    links: Vec<Option<Link>>,
    /// The time, in frames, from which each frame fades.
    times: Vec<usize>,
    /// How many of the frames are in the moments.
    summed: usize,
}

impl<T: Scalar> Chunk<T> {
    fn new(d: usize, m: usize, frames: usize, budget: usize) -> Self {
        let mut v = Mat::with_capacity(capacity(m, budget), frames);
        v.resize_with(m, frames, |_, _| 0.0);
        Chunk {
            x: Mat::zeros(d, frames),
            v,
            norms: Vec::with_capacity(frames),
            links: Vec::with_capacity(frames),
            times: Vec::with_capacity(frames),
            summed: 0,
        }
    }

    fn len(&self) -> usize {
        self.norms.len()
    }

    fn coordinates(&self) -> MatRef<'_, f64> {
        self.v.as_ref().subcols(0, self.len())
    }

    fn last(&self) -> MatRef<'_, f64> {
        self.v.as_ref().subcols(self.len() - 1, 1)
    }

    fn weights(&self, fading: Fading) -> Vec<f64> {
        self.times.iter().map(|&time| fading.since(time)).collect()
    }

    fn bytes(&self) -> usize {
        let side = size_of::<f64>() + size_of::<Option<Link>>() + size_of::<usize>();
        let column =
            size_of::<T>() * self.x.col_stride().unsigned_abs() + size_of::<f64>() * self.v.col_stride().unsigned_abs();
        column * self.x.ncols() + side * self.norms.capacity()
    }
}

#[cfg(feature = "snapshot")]
impl<T: Scalar> Chunk<T> {
    /// Save or restore; of the matrices only the columns in use are kept.
    fn persist(&mut self, snapshot: &mut Snapshot, size: usize, budget: usize) -> Result<(), SnapshotError> {
        let (mut x, mut v) = (Mat::new(), Mat::new());
        if !snapshot.is_restoring() {
            x = self.x.as_ref().subcols(0, self.len()).to_owned();
            v = self.coordinates().to_owned();
        }
        snapshot.matrix("x", &mut x, |rows, _| (rows, size))?;
        snapshot.matrix("v", &mut v, |rows, _| (capacity(rows, budget), size))?;
        snapshot.numbers("norms", &mut self.norms)?;
        let mut links: Vec<Option<(u64, u64)>> =
            self.links.iter().map(|link| link.map(|link| (link.dt.to_bits(), link.weight.to_bits()))).collect();
        snapshot.value("links", &mut links)?;
        snapshot.value("times", &mut self.times)?;
        snapshot.value("summed", &mut self.summed)?;
        if snapshot.is_restoring() {
            let link = |(dt, weight): (u64, u64)| Link { dt: f64::from_bits(dt), weight: f64::from_bits(weight) };
            self.links = links.into_iter().map(|bits| bits.map(link)).collect();
            let n = self.norms.len();
            let sizes = [x.ncols(), v.ncols(), self.links.len(), self.times.len()];
            let fits = sizes == [n; 4] && n <= size && self.summed <= n;
            snapshot.check("x", fits, "the sizes do not fit each other")?;
            x.resize_with(x.nrows(), size, |_, _| T::default());
            v.resize_with(v.nrows(), size, |_, _| 0.0);
            (self.x, self.v) = (x, v);
        }
        Ok(())
    }
}

#[cfg(feature = "snapshot")]
impl<T: Scalar> Persist for Retained<T> {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let mut count = self.chunks.len();
        snapshot.value("chunks", &mut count)?;
        if snapshot.is_restoring() {
            // Each of them has parts of its own: a number that is wrong ends at the first that is missing.
            self.chunks.clear();
        }
        for place in 0..count {
            if snapshot.is_restoring() {
                self.chunks.push_back(Chunk::new(0, 0, 0, 0));
            }
            let (size, budget) = (self.size, self.budget);
            let Some(chunk) = self.chunks.get_mut(place) else { break };
            snapshot.scope(&place.to_string(), |snapshot| chunk.persist(snapshot, size, budget))?;
        }
        let alike = |chunk: &Chunk<T>| (chunk.x.nrows(), chunk.v.nrows());
        let first = self.chunks.front().map(alike);
        let fits = self.chunks.iter().all(|chunk| Some(alike(chunk)) == first && chunk.len() > 0);
        let full = self.chunks.iter().rev().skip(1).all(|chunk| chunk.len() == self.size);
        snapshot.check("chunks", fits && full, "they do not fit each other")
    }
}

/// A block of frames on its way in.
pub(super) struct Frames<'a, T: Scalar> {
    pub x: MatRef<'a, T>,
    pub norms: &'a [f64],
    /// At least as many rows as there are coordinates in the moments.
    pub coordinates: MatRef<'a, f64>,
    pub links: &'a [Option<Link>],
}

/// Retained frames, in chunks that are all full but the newest.
#[derive(Debug, Clone)]
pub(super) struct Retained<T: Scalar> {
    /// Frames of a chunk.
    size: usize,
    /// Coordinates for which chunks make room.
    budget: usize,
    chunks: VecDeque<Chunk<T>>,
}

impl<T: Scalar> Retained<T> {
    pub fn new(size: usize, budget: usize) -> Self {
        Retained { size, budget, chunks: VecDeque::new() }
    }

    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.chunks.iter().map(Chunk::len).sum()
    }

    /// Values of a frame, if there is one.
    pub fn dimension(&self) -> Option<usize> {
        self.chunks.back().map(|chunk| chunk.x.nrows())
    }

    /// Coordinates of a frame, if there is one.
    #[cfg(feature = "snapshot")]
    pub fn coordinates(&self) -> Option<usize> {
        self.chunks.back().map(|chunk| chunk.v.nrows())
    }

    /// Take frames with their first `m` coordinates; `time`: when they begin to fade.
    pub fn append(&mut self, frames: Frames<'_, T>, m: usize, time: usize) {
        let n = frames.x.ncols();
        let mut taken = 0;
        while taken < n {
            if self.chunks.back().is_none_or(|newest| newest.len() == self.size) {
                self.chunks.push_back(Chunk::new(frames.x.nrows(), m, self.size, self.budget));
            }
            let Some(newest) = self.chunks.back_mut() else { return };
            let (at, count) = (newest.len(), (self.size - newest.len()).min(n - taken));
            newest.x.as_mut().subcols_mut(at, count).copy_from(frames.x.subcols(taken, count));
            newest.v.as_mut().subcols_mut(at, count).copy_from(frames.coordinates.submatrix(0, taken, m, count));
            newest.norms.extend_from_slice(&frames.norms[taken..taken + count]);
            newest.links.extend_from_slice(&frames.links[taken..taken + count]);
            newest.times.resize(at + count, time);
            taken += count;
        }
    }

    /// Whether there is a full chunk with frames that are not in the moments.
    pub fn has_full_chunk_to_sum(&self) -> bool {
        self.chunks.iter().any(|chunk| chunk.len() == self.size && chunk.summed < self.size)
    }

    /// Add to the moments the frames that are not in them: of all chunks, or of full ones only.
    pub fn sum(&mut self, moments: &mut Moments, fading: Fading, full_only: bool) -> Result<(), SlowError> {
        let mut before: Option<MatRef<'_, f64>> = None;
        for chunk in &mut self.chunks {
            let (from, to) = (chunk.summed, chunk.len());
            if from < to && (to == self.size || !full_only) {
                let v = chunk.v.as_ref().subcols(from, to - from);
                let before = if from > 0 { Some(chunk.v.as_ref().subcols(from - 1, 1)) } else { before };
                let weights = fading.memory_frames.map(|_| chunk.weights(fading));
                moments.add_faded(v, &chunk.links[from..], before, weights.as_deref().map(|w| &w[from..]))?;
                chunk.summed = to;
            }
            before = Some(chunk.last());
        }
        Ok(())
    }

    /// Compute the coordinates that came with the newest support vectors.
    pub fn fill_in(&mut self, dictionary: &Dictionary<T>) -> Result<(), SlowError> {
        let m = dictionary.len();
        for chunk in &mut self.chunks {
            let (had, n) = (chunk.v.nrows(), chunk.len());
            let new = dictionary.new_coordinates(chunk.x.as_ref().subcols(0, n), &chunk.norms, chunk.coordinates())?;
            if m > chunk.v.col_stride().unsigned_abs() {
                chunk.v.reserve(capacity(m, self.budget), self.size);
            }
            chunk.v.resize_with(m, self.size, |_, _| 0.0);
            chunk.v.as_mut().submatrix_mut(had, 0, m - had, n).copy_from(&new);
        }
        Ok(())
    }

    /// What frames that are all in the sums contribute to coordinates `from .. m`, which they got later.
    ///
    /// With `V` all earlier and `N` all new coordinates, and `Ṅ = ND` for the operator `D` that takes differences, the new
    /// rows of `Σvvᵀ` and `Σv̇v̇ᵀ` are `NVᵀ` and `ṄV̇ᵀ = (NDDᵀ)Vᵀ`: one product with `V`, and differences of the few new
    /// rows only.
    pub fn new_rows(&self, from: usize, m: usize, fading: Fading, par: Par) -> NewRows {
        let new = m - from;
        let mut rows = NewRows::zeros(from, new);
        for (place, chunk) in self.chunks.iter().enumerate() {
            let (n, weights) = (chunk.len(), chunk.weights(fading));
            let mut values = chunk.coordinates().subrows(from, new).to_owned();
            let scale =
                |values: &mut Mat<f64>, t: usize| values.col_mut(t).iter_mut().for_each(|v| *v *= weights[t].sqrt());
            (0..n).for_each(|t| scale(&mut values, t));
            let (rates, scales) = self.new_rates(place, from, new, fading);
            add_square(rows.square.as_mut(), values.as_ref(), par);
            add_square(rows.derivative.as_mut(), rates.as_ref().subcols(0, n), par);

            let mut stacked = Mat::<f64>::zeros(2 * new, n);
            let (mut above, mut below) = stacked.as_mut().split_at_row_mut(new);
            for t in 0..n {
                scale(&mut values, t);
                zip!(above.as_mut().col_mut(t), values.col(t), rows.sum.as_mut()).for_each(|unzip!(to, value, sum)| {
                    *to = *value;
                    *sum += *value;
                });
                let (of_this, of_next) = (scales[t], scales[t + 1]);
                zip!(below.as_mut().col_mut(t), rates.col(t), rates.col(t + 1))
                    .for_each(|unzip!(to, this, next)| *to = of_this * *this - of_next * *next);
            }
            let earlier = chunk.coordinates().subrows(0, from);
            add_product(rows.cross.as_mut(), stacked.as_ref(), earlier, 1.0, par);
        }
        rows
    }

    /// Derivatives `√(wg)·v̇` in new coordinates of the frames of a chunk and of the one behind it, with the scales
    /// `√(wg)/Δt` of their differences; both are zero where there is no link.
    fn new_rates(&self, place: usize, from: usize, new: usize, fading: Fading) -> (Mat<f64>, Vec<f64>) {
        let chunk = &self.chunks[place];
        let (n, added) = (chunk.len(), chunk.v.as_ref().subrows(from, new));
        let (mut rates, mut scales) = (Mat::<f64>::zeros(new, n + 1), vec![0.0; n + 1]);
        let mut set = |t: usize, of: &Chunk<T>, at: usize, now: ColRef<'_, f64>, before: ColRef<'_, f64>| {
            let Some(link) = of.links[at] else { return };
            let scale = (fading.since(of.times[at]) * link.weight).sqrt() / link.dt;
            scales[t] = scale;
            zip!(rates.col_mut(t), now, before).for_each(|unzip!(rate, now, before)| *rate = (*now - *before) * scale);
        };
        // The oldest retained frame has lost its predecessor: that derivative keeps zero in the new coordinates.
        if let Some(earlier) = place.checked_sub(1).map(|place| &self.chunks[place]) {
            set(0, chunk, 0, added.col(0), earlier.v.as_ref().subrows(from, new).col(earlier.len() - 1));
        }
        (1..n).for_each(|t| set(t, chunk, t, added.col(t), added.col(t - 1)));
        if let Some(later) = self.chunks.get(place + 1) {
            set(n, later, 0, later.v.as_ref().subrows(from, new).col(0), added.col(n - 1));
        }
        (rates, scales)
    }

    /// Follow a dictionary that lost support vectors.
    pub fn thin(&mut self, thinning: &Thinning) -> Result<(), SlowError> {
        for chunk in &mut self.chunks {
            chunk.v = thinning.apply(chunk.v.as_ref())?;
        }
        Ok(())
    }

    /// Whether the oldest chunk has to go so that no more than `most` frames stay; the newest always stays.
    pub fn exceeds(&self, most: usize) -> bool {
        self.chunks.len() > 1 && self.frames() > most
    }

    /// Whether the derivative of the frame behind the oldest chunk is still to be summed.
    pub fn oldest_is_needed(&self) -> bool {
        self.chunks.get(1).is_some_and(|chunk| chunk.summed == 0)
    }

    /// Drop the oldest chunk.
    pub fn forget_oldest(&mut self) {
        self.chunks.pop_front();
    }

    /// Bytes of all storage.
    pub fn bytes(&self) -> usize {
        self.chunks.iter().map(Chunk::bytes).sum()
    }
}
