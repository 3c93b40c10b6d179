//! The learning stream: frames in blocks → dictionary → Newton coordinates → moments.

use std::collections::VecDeque;

use faer::{Mat, MatRef};

use super::links::{Link, check_links};
use super::moments::{Moments, rates};
use super::solve::SlowError;
use crate::dictionary::{Block, Dictionary, DictionaryError, FeatureMap, Selection};
use crate::kernel::{Scalar, squared_norms};

/// Options of a [`SlowStream`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Frames whose coordinates are kept for filling in; memory is `retained · (8 m + d · size of a value)` bytes.
    pub retained: usize,
    /// Frames fade with this time constant, in frames, > 0; `None`: they never do. All frames of a block fade alike: after
    /// a block of `b` frames all earlier ones weigh `exp(−b/memory_frames)` times what they did.
    pub memory_frames: Option<f64>,
    /// New support vectors are settled at the latest when this many have gathered.
    pub settle_at: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options { retained: 20_000, memory_frames: None, settle_at: 128 }
    }
}

/// A block of frames that is retained.
#[derive(Debug, Clone)]
struct Retained<T: Scalar> {
    x: Mat<T>,
    norms: Vec<f64>,
    /// Coordinates, as many rows as the dictionary had when they were last filled in.
    v: Mat<f64>,
    links: Vec<Option<Link>>,
    /// Factor by which the block has faded.
    weight: f64,
}

/// Dictionary, moments and retained frames.
///
/// New support vectors give every retained frame new coordinates. They are filled in for whole batches of new support
/// vectors at a time ([`SlowStream::settle`]), and the moments then equal those of a batch run over the same frames with
/// the final dictionary. Frames that are no longer retained count as zero in coordinates that came after they left.
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
    retained: VecDeque<Retained<T>>,
    frames: usize,
}

impl<T: Scalar> SlowStream<T> {
    /// A stream of frames into the dictionary of a selection, which has to be empty.
    ///
    /// # Errors
    /// A selection that does not stream, or one that has begun already: its frames are not known here. A memory that is
    /// not positive.
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
        Ok(SlowStream {
            moments: Moments::new(selection.dictionary().par()),
            selection,
            retained: VecDeque::new(),
            frames: 0,
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

    /// Number of frames seen.
    pub fn frames(&self) -> usize {
        self.frames
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
        if x.ncols() != links.len() {
            return Err(DictionaryError::Links { found: links.len(), expected: x.ncols() }.into());
        }
        check_links(links)?;
        // The dictionary knows the length of its members, but a stream may begin with frames of which none became one.
        if let Some(chunk) = self.retained.back()
            && x.nrows() != chunk.x.nrows()
        {
            return Err(DictionaryError::Dimension { found: x.nrows(), expected: chunk.x.nrows() }.into());
        }
        let mut block = self.selection.observe(x)?;
        if x.ncols() == 0 {
            return Ok(block);
        }
        let mut links = links.to_vec();
        if self.retained.is_empty()
            && let Some(first) = links.first_mut()
        {
            *first = None;
        }
        if let Some(tau) = self.options.memory_frames {
            let factor = (-(x.ncols() as f64) / tau).exp();
            self.moments.fade(factor)?;
            self.retained.iter_mut().for_each(|chunk| chunk.weight *= factor);
        }
        let known = self.moments.size();
        // Selections can be written by anyone: one that drops support vectors on its own cannot be followed.
        SlowError::unless_fits("a block's number of coordinates", block.coordinates.nrows(), self.dictionary().len())?;
        SlowError::unless_fits("a block's number of frames", block.coordinates.ncols(), x.ncols())?;
        if block.coordinates.nrows() < known {
            return Err(SlowError::Narrower { size: known, asked: block.coordinates.nrows() });
        }
        let v = block.coordinates.as_ref().subrows(0, known);
        let before = self.retained.back().map(|chunk| {
            let last = chunk.v.ncols() - 1;
            chunk.v.as_ref().submatrix(0, last, known, 1)
        });
        let (rates, weight) = rates(v, &links, before)?;
        self.moments.add(v, rates.as_ref(), weight)?;
        self.frames += x.ncols();
        self.retained.push_back(Retained {
            x: x.to_owned(),
            norms: squared_norms(x),
            v: block.coordinates.clone(),
            links,
            weight: 1.0,
        });
        if self.dictionary().len() - known >= self.options.settle_at {
            self.settle()?;
        }
        self.forget()?;
        self.thin(&mut block)?;
        Ok(block)
    }

    /// Let support vectors leave where the selection has taken too many.
    fn thin(&mut self, block: &mut Block) -> Result<(), SlowError> {
        if !self.selection.is_over_budget() {
            return Ok(());
        }
        self.settle()?;
        if let Some(thinning) = self.selection.thin()? {
            self.moments.thin(&thinning)?;
            for chunk in &mut self.retained {
                chunk.v = thinning.apply(chunk.v.as_ref())?;
            }
            block.coordinates = thinning.apply(block.coordinates.as_ref())?;
        }
        Ok(())
    }

    /// Fill in the coordinates that retained frames got by growth, and bring the moments up to date.
    ///
    /// # Errors
    /// None that a stream of accepted blocks can meet.
    pub fn settle(&mut self) -> Result<(), SlowError> {
        let (from, m) = (self.moments.size(), self.dictionary().len());
        if from == m {
            return Ok(());
        }
        for chunk in &mut self.retained {
            let had = chunk.v.nrows();
            if had < m {
                let new =
                    self.selection.dictionary().new_coordinates(chunk.x.as_ref(), &chunk.norms, chunk.v.as_ref())?;
                if m > chunk.v.col_stride().unsigned_abs() {
                    let capacity = (m + m / 4).min(self.selection.budget()).max(m);
                    chunk.v.reserve(capacity, chunk.v.ncols());
                }
                let columns = chunk.v.ncols();
                chunk.v.resize_with(m, columns, |i, j| new[(i - had, j)]);
            }
        }
        self.moments.widen(m)?;
        let mut before: Option<MatRef<'_, f64>> = None;
        for chunk in &self.retained {
            let v = chunk.v.as_ref();
            // The oldest retained frame has lost its predecessor: that derivative keeps zero in the new coordinates.
            let mut links = chunk.links.clone();
            if before.is_none() {
                links[0] = None;
            }
            let (rates, _) = rates(v, &links, before)?;
            self.moments.grow(from, v, rates.as_ref(), chunk.weight)?;
            before = Some(v.subcols(v.ncols() - 1, 1));
        }
        Ok(())
    }

    /// Drop the oldest blocks beyond the number of retained frames; the newest block always stays.
    fn forget(&mut self) -> Result<(), SlowError> {
        let mut kept: usize = self.retained.iter().map(|chunk| chunk.v.ncols()).sum();
        while self.retained.len() > 1 && kept > self.options.retained {
            // What is pending would be lost for the block that leaves.
            self.settle()?;
            kept -= self.retained.pop_front().map_or(0, |chunk| chunk.v.ncols());
        }
        Ok(())
    }
}
