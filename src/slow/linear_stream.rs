//! Linear slow feature analysis of a stream: sums, and no frames.

use faer::{MatRef, Par};

use super::error::SlowError;
use super::linear::{LinearSfa, solve_all};
use super::links::{Link, check_links};
use super::moments::Moments;
use super::solve::SlowFeatures;
use crate::kernel::products::dot;
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Linear slow feature analysis of a signal that comes in blocks and is not kept.
///
/// The first frame is subtracted from all of them, so that channels far from zero do not lose their variance in the
/// rounding of the squares.
///
/// ```
/// use adagio::slow::{LinearStream, Link};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// let mut stream = LinearStream::new();
/// let link = Some(Link { dt: 0.1, weight: 1.0 });
/// for block in 0..20 {
///     let x = Mat::from_fn(2, 50, |i, t| ([0.03, 0.9][i] * (block * 50 + t) as f64).sin());
///     stream.push(x.as_ref(), &[link; 50])?;
/// }
/// let sfa = stream.solve(2, 0.0)?;
/// assert!(sfa.slowness[0] < 0.01 * sfa.slowness[1]);
/// # Ok(())
/// # }
/// ```
///
/// Frames go into the sums by chunks, so the bits do not depend on the blocks in which they come.
#[derive(Debug, Clone)]
pub struct LinearStream {
    moments: Moments,
    /// The first frame, `d`.
    origin: Vec<f64>,
    /// The last frame, less the origin, `d`.
    last: Vec<f64>,
    gathered: Gathered,
}

/// Frames of a chunk.
const CHUNK: usize = 256;

/// Frames that are not in the sums yet: less than a chunk.
#[derive(Debug, Clone, Default)]
struct Gathered {
    /// Less the origin, one after another, `d` values each.
    frames: Vec<f64>,
    /// Derivatives `√g·ẋ` of those that have a link.
    rates: Vec<f64>,
    /// Sum of the weights of the links.
    weight: f64,
}

impl Gathered {
    fn add_to(&self, moments: &mut Moments) -> Result<(), SlowError> {
        let d = moments.size().max(1);
        let matrix = |values| MatRef::from_column_major_slice(values, moments.size(), values.len() / d);
        let (frames, rates) = (matrix(&self.frames), matrix(&self.rates));
        moments.add(frames, rates, self.weight)
    }
}

impl Default for LinearStream {
    fn default() -> Self {
        LinearStream::new()
    }
}

impl LinearStream {
    /// A stream without any frame yet, on one thread.
    pub fn new() -> LinearStream {
        LinearStream::on(Par::Seq)
    }

    /// A stream without any frame yet that is summed on these threads. Their number does not change the bits.
    pub fn on(par: Par) -> LinearStream {
        let (origin, last) = Default::default();
        LinearStream { moments: Moments::new(par), origin, last, gathered: Gathered::default() }
    }

    /// Number of values per frame, once there was one.
    pub fn inputs(&self) -> Option<usize> {
        (!self.origin.is_empty()).then_some(self.origin.len())
    }

    /// Take a block of frames; the link of the first frame of all is ignored.
    ///
    /// # Shapes
    /// `x: d × b`, `links: b`.
    ///
    /// # Errors
    /// Shapes that do not fit, impossible links, values that are not finite, or whose squares or squared derivatives are not;
    /// nothing is changed then.
    pub fn push(&mut self, x: MatRef<'_, f64>, links: &[Option<Link>]) -> Result<(), SlowError> {
        SlowError::unless_fits("the list of links", links.len(), x.ncols())?;
        check_links(links)?;
        if x.ncols() == 0 || (self.origin.is_empty() && x.nrows() == 0) {
            return Ok(());
        }
        let mut links = links.to_vec();
        let (mut origin, mut last) = (self.origin.clone(), self.last.clone());
        if origin.is_empty() {
            links[0] = None;
            origin.extend(x.col(0).iter());
            last.resize(x.nrows(), 0.0);
        }
        SlowError::unless_fits("a frame's number of values", x.nrows(), origin.len())?;
        // What is in the sums once stays there: a square that is not finite would spoil all that comes.
        let (mut squares, mut squared_rates) = (0.0, 0.0);
        walk(x, &links, &origin, &mut last.clone(), |frame, rate| {
            squares += dot(frame, frame);
            squared_rates += rate.map_or(0.0, |(rate, _)| dot(rate, rate));
            Ok(())
        })?;
        if !squares.is_finite() {
            SlowError::unless_finite("the signal is", x)?;
            return Err(SlowError::NotFinite("the squares of the signal are"));
        }
        if !squared_rates.is_finite() {
            return Err(SlowError::NotFinite("the squares of its derivative are"));
        }
        self.moments.widen(x.nrows())?;
        let (gathered, moments) = (&mut self.gathered, &mut self.moments);
        walk(x, &links, &origin, &mut last, |frame, rate| {
            gathered.frames.extend_from_slice(frame);
            if let Some((rate, weight)) = rate {
                gathered.rates.extend_from_slice(rate);
                gathered.weight += weight;
            }
            if gathered.frames.len() == CHUNK * frame.len() {
                gathered.add_to(moments)?;
                gathered.frames.clear();
                gathered.rates.clear();
                gathered.weight = 0.0;
            }
            Ok(())
        })?;
        (self.origin, self.last) = (origin, last);
        Ok(())
    }

    /// Take all frames of another stream after those of this one; no derivative leads from one to the other.
    ///
    /// # Errors
    /// Frames of another length, or so far from those of this stream that their squares are not finite; nothing is
    /// changed then.
    pub fn append(&mut self, other: &LinearStream) -> Result<(), SlowError> {
        if other.origin.is_empty() {
            return Ok(());
        }
        if self.origin.is_empty() {
            *self = other.clone();
            return Ok(());
        }
        SlowError::unless_fits("a frame's number of values", other.origin.len(), self.origin.len())?;
        let away: Vec<f64> = other.origin.iter().zip(&self.origin).map(|(other, own)| other - own).collect();
        let mut others = other.summed()?;
        others.shift(&away)?;
        if !others.mean_squares().iter().sum::<f64>().is_finite() {
            return Err(SlowError::NotFinite("the squares of the signal are"));
        }
        self.moments = self.summed()?;
        self.gathered = Gathered::default();
        self.moments.append(&others)?;
        self.last = other.last.iter().zip(&away).map(|(last, away)| last + away).collect();
        Ok(())
    }

    /// The slowest affine functions of all frames so far.
    ///
    /// # Errors
    /// Those of [`solve()`](super::solve()).
    pub fn solve(&self, features: usize, lambda: f64) -> Result<LinearSfa, SlowError> {
        let (SlowFeatures { weights, mean, slowness, .. }, rank_deficit) =
            solve_all(&self.summed()?, features, lambda)?;
        let mean = self.origin.iter().enumerate().map(|(i, origin)| origin + mean[(i, 0)]).collect();
        Ok(LinearSfa { weights, mean, slowness, rank_deficit })
    }

    /// The sums over all frames.
    fn summed(&self) -> Result<Moments, SlowError> {
        let mut moments = self.moments.clone();
        self.gathered.add_to(&mut moments)?;
        Ok(moments)
    }
}

/// What becomes of each frame of a block: itself less the origin, and its derivative `√g·ẋ` with the weight `g` of its link.
///
/// `last` is the frame before the block, less the origin, and then the last one of the block.
fn walk(
    x: MatRef<'_, f64>,
    links: &[Option<Link>],
    origin: &[f64],
    last: &mut Vec<f64>,
    mut take: impl FnMut(&[f64], Option<(&[f64], f64)>) -> Result<(), SlowError>,
) -> Result<(), SlowError> {
    let (mut frame, mut rate) = (vec![0.0; origin.len()], vec![0.0; origin.len()]);
    for (column, link) in x.col_iter().zip(links) {
        frame.iter_mut().zip(column.iter()).zip(origin).for_each(|((frame, x), origin)| *frame = x - origin);
        let rate = link.map(|link| {
            let scale = link.weight.sqrt() / link.dt;
            let pairs = frame.iter().zip(last.iter());
            rate.iter_mut().zip(pairs).for_each(|(rate, (now, before))| *rate = (now - before) * scale);
            (rate.as_slice(), link.weight)
        });
        take(&frame, rate)?;
        std::mem::swap(&mut frame, last);
    }
    Ok(())
}

/// It is restored into a new stream.
#[cfg(feature = "snapshot")]
impl Persist for LinearStream {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("moments", &mut self.moments)?;
        snapshot.numbers("origin", &mut self.origin)?;
        snapshot.numbers("last", &mut self.last)?;
        snapshot.numbers("frames", &mut self.gathered.frames)?;
        snapshot.numbers("rates", &mut self.gathered.rates)?;
        snapshot.number("weight", &mut self.gathered.weight)?;
        let d = self.origin.len();
        let of_frames = |values: &[f64]| values.len() < CHUNK * d.max(1) && values.len().is_multiple_of(d.max(1));
        let fits = [self.moments.size(), self.last.len()] == [d; 2];
        let gathered = of_frames(&self.gathered.frames) && self.gathered.rates.len() <= self.gathered.frames.len();
        snapshot.check("frames", fits && gathered && of_frames(&self.gathered.rates), "the sizes do not fit each other")
    }
}
