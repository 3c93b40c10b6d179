//! The learning stream: frames in blocks → dictionary → Newton coordinates → moments.

use faer::{Mat, MatRef};

use super::error::SlowError;
use super::links::{Link, check_links};
use super::moments::{MOST_COORDINATES, Moments};
use super::retained::{Fading, Frames, Retained};
use crate::dictionary::{Block, Dictionary, DictionaryError, FeatureMap, Selection, capacity};
use crate::kernel::{Scalar, is_usable_norm, squared_norms};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Options of a [`SlowStream`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Frames whose coordinates are kept for filling in: at most this many, or one chunk if that is more. They leave by
    /// whole chunks, the oldest first, so up to a chunk fewer may be kept.
    pub retained: usize,
    /// Frames that are gathered into a chunk, which goes into the moments as one product, in [1, [`MOST_CHUNK`]]. Small ones
    /// are slow; the storage of a chunk is taken when it begins.
    pub chunk: usize,
    /// Frames fade with this time constant, in frames, > 0; `None`: they never do. All frames of a block fade alike: after
    /// a block of `b` frames all earlier ones weigh `exp(−b/memory_frames)` times what they did.
    pub memory_frames: Option<f64>,
    /// New support vectors are settled at the latest when this many have gathered.
    pub settle_at: usize,
}

/// The most frames of a chunk.
pub const MOST_CHUNK: usize = 1 << 16;

impl Default for Options {
    fn default() -> Self {
        Options { retained: 20_000, chunk: 512, memory_frames: None, settle_at: 128 }
    }
}

/// What became of a block of frames some of which may not be usable ([`SlowStream::push_finite`]).
#[derive(Debug, Clone)]
pub struct Screened {
    /// What the frames that were taken did, in their order.
    pub block: Block,
    /// Their places in the block that was given.
    pub taken: Vec<usize>,
    /// The places of frames that were left out: their values are not finite, or their kernel values are not.
    pub quarantined: Vec<usize>,
}

/// Dictionary, moments and retained frames.
///
/// New support vectors give every retained frame new coordinates. They are filled in for whole batches of new support
/// vectors at a time ([`SlowStream::settle`]), and the moments then equal those of a batch run over the same frames with
/// the final dictionary. Frames that are no longer retained count as zero in coordinates that came after they left.
///
/// # Cost
/// With `m` support vectors, `d` values per frame and `n` frames, everything is matrix products: `2dmn` operations for
/// kernel values, `m²n` for coordinates and `2m²n` for the moments. Nothing of the size `m²` is touched per frame: frames
/// go into the moments by chunks. [`SlowStream::bytes`] says how much memory it takes.
///
/// ```
/// use adagio::dictionary::{Ald, Parameters, WhenFull};
/// use adagio::kernel::Kernel;
/// use adagio::slow::{Link, SlowModel, SlowStream, StreamOptions, solve};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// // A point goes round a circle; a sensor of it that is quick is (cos 5t, sin 5t, cos t).
/// let parameters =
///     Parameters { kernel: Kernel::gaussian(0.7)?, nu: 1e-4, budget: 100, when_full: WhenFull::Stop, par: Par::Seq };
/// let mut stream = SlowStream::new(Ald::new(parameters)?, StreamOptions::default())?;
/// let frame = |i: usize, t: usize| [(0.05 * t as f64).cos(), (0.05 * t as f64).sin(), (0.01 * t as f64).cos()][i];
/// for block in 0..40 {
///     let x = Mat::from_fn(3, 50, |i, t| frame(i, 50 * block + t));
///     stream.push(x.as_ref(), &[Some(Link { dt: 1.0, weight: 1.0 }); 50])?;
/// }
/// let features = solve(stream.settled_moments()?, 2, 1e-8, None)?;
/// assert!(features.slowness[0] < 1.1 * 0.01f64.powi(2));
/// // For use on new frames; the first row is the constant feature.
/// let model = SlowModel::new(stream.dictionary(), &features)?;
/// let phi = model.apply(Mat::from_fn(3, 5, frame).as_ref(), Par::Seq)?;
/// assert_eq!((phi.nrows(), phi[(0, 0)]), (3, 1.0));
/// # Ok(())
/// # }
/// ```
///
/// Any [`Selection`] that streams can fill the dictionary. Where one lets support vectors leave, coordinates and sums
/// follow by an orthogonal projection: exactly, and without the frames themselves.
#[derive(Debug)]
pub struct SlowStream<T: Scalar> {
    options: Options,
    selection: Box<dyn Selection<T>>,
    moments: Moments,
    retained: Retained<T>,
    frames: usize,
    /// The time, in frames, up to which the sums have faded.
    faded: usize,
    /// Whether the newest frame that was given is not among those that were taken.
    cut: bool,
    quarantined: usize,
}

impl<T: Scalar> SlowStream<T> {
    /// A stream of frames into the dictionary of a selection, which has to be empty.
    ///
    /// # Errors
    /// A selection that does not stream, or one that has begun already: its frames are not known here. A memory that is
    /// not positive; a chunk of no frames or of more than [`MOST_CHUNK`].
    pub fn new(selection: impl Selection<T> + 'static, options: Options) -> Result<Self, SlowError> {
        Self::from_boxed(Box::new(selection), options)
    }

    /// As [`SlowStream::new`], for a selection that is chosen when the program runs.
    ///
    /// # Errors
    /// Those of [`SlowStream::new`].
    pub fn from_boxed(selection: Box<dyn Selection<T>>, options: Options) -> Result<Self, SlowError> {
        if !selection.is_streaming() || !selection.dictionary().is_empty() {
            let members = selection.dictionary().len();
            return Err(DictionaryError::NotForStreams { streaming: selection.is_streaming(), members }.into());
        }
        if let Some(memory) = options.memory_frames
            && (memory.is_nan() || memory <= 0.0)
        {
            return Err(SlowError::Memory(memory));
        }
        match options.chunk {
            0 => return Err(SlowError::Empty("a chunk of frames is")),
            1..=MOST_CHUNK => {}
            asked => return Err(SlowError::TooMany { what: "frames of a chunk", asked, most: MOST_CHUNK }),
        }
        Ok(SlowStream {
            moments: Moments::new(selection.dictionary().par()),
            retained: Retained::new(options.chunk, selection.budget()),
            selection,
            frames: 0,
            faded: 0,
            cut: false,
            quarantined: 0,
            options,
        })
    }

    /// The dictionary.
    pub fn dictionary(&self) -> &Dictionary<T> {
        self.selection.dictionary()
    }

    /// What fills the dictionary.
    pub fn selection(&self) -> &dyn Selection<T> {
        self.selection.as_ref()
    }

    /// New features for a selection that judges by them.
    ///
    /// # Errors
    /// Features that cannot be computed for the support vectors.
    pub fn adopt(&mut self, features: FeatureMap<T>) -> Result<(), SlowError> {
        Ok(self.selection.adopt(features)?)
    }

    /// Number of frames taken.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Number of frames that [`SlowStream::push_finite`] left out.
    pub fn quarantined(&self) -> usize {
        self.quarantined
    }

    /// Number of frames that are retained at this moment.
    pub fn retained(&self) -> usize {
        self.retained.frames()
    }

    /// Bytes that a stream takes at `m` support vectors, for `d` values per frame in blocks of `b`: with `s` bytes per
    /// value, chunks of `c` frames and `r` retained frames (the larger one of `retained` and `c`, and `b` more, in whole
    /// chunks),
    ///
    /// `24m² + sdm + r(8m + sd + 40)`
    ///
    /// for dictionary, moments and frames, and for work of the moment `2m² + 16m(b + c + a) + 32ac`, where `a` support
    /// vectors are settled at a time (`settle_at` and `b`). Where members leave at the budget, `m` is the budget and a block
    /// more, and while they leave about `48m²` are taken beside this.
    pub fn bytes(options: &Options, m: usize, d: usize, block: usize) -> u64 {
        // Sizes of any kind can be asked about.
        let size = |size: usize| (size as u128).min(1 << 40);
        let [m, d, b, c, s] = [m, d, block, options.chunk.max(1), size_of::<T>()].map(size);
        let retained = (size(options.retained).max(c) + b).div_ceil(c) * c;
        let a = m.min(size(options.settle_at) + b);
        let held = 24 * m * m + s * d * m + 16 * m + retained * (8 * m + s * d + 40);
        let work = 2 * m * m + 16 * m * (b + c + a) + 32 * a * c;
        u64::try_from(held + work).unwrap_or(u64::MAX)
    }

    /// Bytes of the matrices that are held at this moment.
    pub fn held_bytes(&self) -> u64 {
        (self.dictionary().bytes() + self.moments.bytes() + self.retained.bytes()) as u64
    }

    /// The moments over all coordinates of the dictionary, after [`SlowStream::settle`].
    ///
    /// # Errors
    /// None that a stream of accepted blocks can meet.
    pub fn settled_moments(&mut self) -> Result<&Moments, SlowError> {
        self.settle()?;
        Ok(&self.moments)
    }

    /// Take a block of consecutive frames.
    ///
    /// # Shapes
    /// `x: d × b`; `links: b`, `None` where a frame does not follow the one before it (the first frame of all never does).
    ///
    /// # Errors
    /// Those of [`Selection::observe`], another number of links than of frames, a link with an impossible time or weight;
    /// nothing is changed then.
    pub fn push(&mut self, x: MatRef<'_, T>, links: &[Option<Link>]) -> Result<Block, SlowError> {
        self.check(x, links)?;
        let block = self.selection.observe(x)?;
        self.take(x, links, block)
    }

    /// As [`SlowStream::push`], but frames with values that are not finite, or so large that kernel values are not, are
    /// left out and named. The frame after one that was left out follows no other.
    ///
    /// # Errors
    /// Those of [`SlowStream::push`], but for values that are not finite.
    pub fn push_finite(&mut self, x: MatRef<'_, T>, links: &[Option<Link>]) -> Result<Screened, SlowError> {
        self.check(x, links)?;
        let kernel = self.dictionary().kernel();
        let usable = |norm: f64| is_usable_norm::<T>(norm) && kernel.diagonal(norm).is_finite();
        let norms = squared_norms(x);
        let mut taken: Vec<usize> = (0..x.ncols()).filter(|&t| usable(norms[t])).collect();
        let (part, block) = loop {
            let mut part = Mat::zeros(x.nrows(), taken.len());
            taken.iter().enumerate().for_each(|(place, &t)| part.col_mut(place).copy_from(x.col(t)));
            match self.selection.observe(part.as_ref()) {
                // What a selection computes from a frame, such as features, may not be finite either.
                Err(DictionaryError::NotFinite(place)) if place < taken.len() => taken.remove(place),
                Err(other) => return Err(other.into()),
                Ok(block) => break (part, block),
            };
        };
        let follows = |&t: &usize| if t == 0 || taken.binary_search(&(t - 1)).is_ok() { links[t] } else { None };
        let kept: Vec<Option<Link>> = taken.iter().map(follows).collect();
        let block = self.take(part.as_ref(), &kept, block)?;
        let quarantined: Vec<usize> = (0..x.ncols()).filter(|t| taken.binary_search(t).is_err()).collect();
        self.quarantined += quarantined.len();
        if let Some(last) = x.ncols().checked_sub(1) {
            self.cut = quarantined.last() == Some(&last);
        }
        Ok(Screened { block, taken, quarantined })
    }

    /// Refuse frames and links that do not fit.
    fn check(&self, x: MatRef<'_, T>, links: &[Option<Link>]) -> Result<(), SlowError> {
        if x.ncols() != links.len() {
            return Err(DictionaryError::Links { found: links.len(), expected: x.ncols() }.into());
        }
        check_links(links)?;
        // The dictionary knows the length of its members, but a stream may begin with frames of which none became one.
        match self.retained.dimension() {
            Some(expected) if expected != x.nrows() => {
                Err(DictionaryError::Dimension { found: x.nrows(), expected }.into())
            }
            _ => Ok(()),
        }
    }

    /// Take a block of frames that the selection has judged.
    fn take(&mut self, x: MatRef<'_, T>, links: &[Option<Link>], mut block: Block) -> Result<Block, SlowError> {
        if x.ncols() == 0 {
            return Ok(block);
        }
        let mut links = links.to_vec();
        if self.cut || self.frames == 0 {
            links[0] = None;
        }
        self.cut = false;
        // Selections can be written by anyone: one that drops support vectors on its own cannot be followed.
        let (known, m) = (self.moments.size(), block.coordinates.nrows());
        SlowError::unless_fits("a block's number of coordinates", m, self.dictionary().len())?;
        SlowError::unless_fits("a block's number of frames", block.coordinates.ncols(), x.ncols())?;
        if m < known {
            return Err(SlowError::Narrower { size: known, asked: m });
        }
        self.frames += x.ncols();
        let (norms, coordinates) = (squared_norms(x), block.coordinates.as_ref());
        self.retained.append(Frames { x, norms: &norms, coordinates, links: &links }, known, self.frames);
        self.sum(true)?;
        if m - known >= self.options.settle_at {
            self.settle()?;
        }
        self.forget()?;
        self.thin(&mut block)?;
        Ok(block)
    }

    /// The coordinates that its parts know of.
    #[cfg(feature = "snapshot")]
    fn sizes_fit(&self) -> bool {
        let (m, known) = (self.dictionary().len(), self.moments.size());
        known <= m && self.retained.coordinates().is_none_or(|of_frames| of_frames == known)
    }

    fn fading(&self) -> Fading {
        Fading { memory_frames: self.options.memory_frames, now: self.frames }
    }

    /// Bring the frames into the moments that are not in them yet: all, or those of full chunks.
    fn sum(&mut self, full_only: bool) -> Result<(), SlowError> {
        if full_only && !self.retained.has_full_chunk_to_sum() {
            return Ok(());
        }
        let fading = self.fading();
        if fading.memory_frames.is_some() && self.faded < self.frames {
            self.moments.fade(fading.since(self.faded))?;
            self.faded = self.frames;
        }
        self.retained.sum(&mut self.moments, fading, full_only)
    }

    /// Let support vectors leave where the selection has taken too many.
    fn thin(&mut self, block: &mut Block) -> Result<(), SlowError> {
        if !self.selection.is_over_budget() {
            return Ok(());
        }
        self.settle()?;
        if let Some(thinning) = self.selection.thin()? {
            self.moments.thin(&thinning)?;
            self.retained.thin(&thinning)?;
            block.coordinates = thinning.apply(block.coordinates.as_ref())?;
        }
        Ok(())
    }

    /// Bring the moments up to date: with all frames, and in all coordinates, which retained frames got by growth.
    ///
    /// # Errors
    /// None that a stream of accepted blocks can meet.
    pub fn settle(&mut self) -> Result<(), SlowError> {
        self.sum(false)?;
        let (from, m) = (self.moments.size(), self.dictionary().len());
        if from == m {
            return Ok(());
        }
        self.retained.fill_in(self.selection.dictionary())?;
        self.moments.reserve(capacity(m, self.selection.budget().min(MOST_COORDINATES)))?;
        self.moments.widen(m)?;
        let rows = self.retained.new_rows(from, m, self.fading(), self.dictionary().par());
        self.moments.set_rows(&rows);
        Ok(())
    }

    /// Drop the oldest chunks beyond the number of retained frames; the newest always stays.
    fn forget(&mut self) -> Result<(), SlowError> {
        while self.retained.exceeds(self.options.retained) {
            // New coordinates would be lost for the frames that leave, and the derivative behind them.
            if self.moments.size() < self.dictionary().len() || self.retained.oldest_is_needed() {
                self.settle()?;
            }
            self.retained.forget_oldest();
        }
        Ok(())
    }
}

/// A stream is restored into a new one with the same selection, parameters and options.
#[cfg(feature = "snapshot")]
impl<T: Scalar> Persist for SlowStream<T> {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.scope("selection", |snapshot| self.selection.persist(snapshot))?;
        snapshot.inner("moments", &mut self.moments)?;
        snapshot.inner("retained", &mut self.retained)?;
        snapshot.value("frames", &mut self.frames)?;
        snapshot.value("faded", &mut self.faded)?;
        snapshot.value("cut", &mut self.cut)?;
        snapshot.value("quarantined", &mut self.quarantined)?;
        snapshot.check(
            "moments",
            self.sizes_fit(),
            "another number of coordinates than support vectors and frames have",
        )
    }
}
