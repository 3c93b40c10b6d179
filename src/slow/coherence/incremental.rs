//! Incremental slow feature analysis (IncSFA): slow features of a stream without any covariance matrix.
//!
//! Two stages, each of `O(d p + p k²)` per frame and with no memory of the past but its vectors:
//!
//! 1. *Whitening* by candid covariance-free incremental principal components (CCIPCA): the `p` vectors `v_j = λ_j·(direction)`
//!    follow `v_j ← (1 − η)v_j + η (u·v̂_j) u`, each seeing what the earlier ones leave over, `u ← u − (u·v̂_j)v̂_j`, with
//!    `u = x − x̄` at first. White coordinates: `z_j = v̂_j·(x − x̄)/√λ_j`.
//! 2. *Slowest directions* of `ż` by incremental minor components with sequential addition (CIMCA): `k` unit vectors follow
//!    `w_i ← (1 − η)w_i − η [(ż·w_i)ż + γ Σ_{j<i} (w_j·w_i) w_j]`, normalised. The last sum makes directions that are taken
//!    already look as fast as the fastest, `γ` = the largest variance of `ż`, which is followed by CCIPCA too.
//!
//! Learning rates: principal components use amnesic averages, `η_t = (1 + μ(t))/t` with `μ = 0` up to `t₁ = 20`, then
//! rising to `c = 3` at `t₂ = 200`, then by `1/r` per frame, `r = 2000`: a plain average at first, a memory of about `r`
//! frames in the end. Minor components rise from `start` to `peak` with the square of time over `ramp` frames, and then stay:
//! the features go on adapting for ever, and for ever jitter by about that rate.
//!
//! Where this departs from the paper:
//! - `ż = z_t − z_{t−1}` uses the whitening of now for both frames, so that a change of the whitening is no derivative.
//! - `ż` is divided by the root of its largest variance, so that the learning rate and `γ = 1` do not depend on the unit of
//!   time; and a frame whose `ż` is much longer than usual counts at most as far as it does not turn `w` round.
//!
//! # Reference
//! Kompella, Luciw & Schmidhuber, Neural Computation 24 (2012); Weng, Zhang & Hwang, IEEE PAMI 25 (2003) (CCIPCA);
//! Peng & Yi 2006, Chen et al. 2001 (minor components, sequential addition).

use faer::{Mat, MatRef};

use super::{CoherenceError, LinearMap, check_features, check_frame, project, random_weights};
use crate::slow::links::{Link, check_link};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Amnesic averages: frames of plain averaging, end of the first rise, its height (Weng 2003, as used by Kompella et al.).
const AMNESIC: (f64, f64, f64) = (20.0, 200.0, 3.0);
/// Frames per unit after that rise (the same).
const REACH: f64 = 2000.0;

/// `η(1 + ‖ż‖²)` stays below this, so that no single frame turns a direction round.
const LONGEST_STEP: f64 = 0.5;

/// Options of [`IncrementalSlow`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Number of features `k`, 1 to `whitened`.
    pub features: usize,
    /// Number of principal components `p` that are made white, at most the number of inputs.
    pub whitened: usize,
    /// Components whose variance is below this share of the largest are left out, in [0, 1): they are rounding or noise.
    pub smallest_variance: f64,
    /// Learning rate of the minor components at the first frame, > 0.
    pub start: f64,
    /// Learning rate after `ramp` frames, `start ≤ peak < 0.5`.
    pub peak: f64,
    /// Frames of the rise.
    pub ramp: usize,
}

impl Options {
    /// Rates of 10⁻⁵ rising to 0.01, reached after 10 000 frames.
    ///
    /// The rate is a share of the largest variance of `ż`. The authors' published example has a peak of 0.05 where that
    /// variance is about 0.3, i.e. 0.015 here, and less for later features. A rate averages over about `1/rate` frames: if
    /// these are fewer than the waves of the signal last, slow features are found in a wrong order or not at all (with 0.05
    /// here, all but the first of that example).
    pub fn new(features: usize, whitened: usize) -> Self {
        Options { features, whitened, smallest_variance: 1e-6, start: 1e-5, peak: 0.01, ramp: 10_000 }
    }
}

/// Slow features that follow a stream.
///
/// ```
/// use adagio::slow::Link;
/// use adagio::slow::coherence::incremental::{IncrementalSlow, Options};
///
/// // A slow and a fast wave, mixed.
/// let mut stream = IncrementalSlow::new(2, Options::new(1, 2), &mut adagio::random::stream(1, "doc")).unwrap();
/// let frame = |t: usize| {
///     let (slow, fast) = ((t as f64 / 50.0).sin(), (t as f64 / 3.0).cos());
///     [slow + fast, slow - 0.5 * fast]
/// };
/// for t in 0..40_000 {
///     stream.update(&frame(t), Some(Link { dt: 1.0, weight: 1.0 })).unwrap();
/// }
/// let phi = |t| stream.features(&frame(t)).unwrap()[0];
/// let n = 50_000;
/// let (mut product, mut power) = (0.0, 0.0);
/// for t in 0..n {
///     product += phi(t) * (t as f64 / 50.0).sin() / n as f64;
///     power += phi(t) * phi(t) / n as f64;
/// }
/// assert!(product.abs() / (0.5 * power).sqrt() > 0.99);
/// // √2 sin(t/50) has the slowness 1/50².
/// assert!((stream.slowness()[0] * 50.0 * 50.0 - 1.0).abs() < 0.2);
/// ```
#[derive(Debug, Clone)]
pub struct IncrementalSlow {
    options: Options,
    whitening: Whitening,
    /// Largest principal component of `ż`.
    fastest: PrincipalComponents,
    /// Unit vectors `w_i`, `p × k`.
    minor: Mat<f64>,
    before: Option<Vec<f64>>,
    /// Mean of `(ż·w_i)²`, `k`.
    slowness: Vec<f64>,
    derivatives: usize,
}

impl IncrementalSlow {
    /// A stream of `inputs` values per frame that has seen nothing yet.
    ///
    /// # Errors
    /// Options out of range.
    pub fn new(inputs: usize, options: Options, rng: &mut impl rand::Rng) -> Result<Self, CoherenceError> {
        let Options { features, whitened, smallest_variance, start, peak, .. } = options;
        check_features(whitened, inputs)?;
        check_features(features, whitened)?;
        CoherenceError::unless(
            (0.0..1.0).contains(&smallest_variance),
            "the smallest variance",
            smallest_variance,
            "in [0, 1)",
        )?;
        CoherenceError::unless(
            start > 0.0 && start <= peak,
            "the first learning rate",
            start,
            "> 0, and not above the peak",
        )?;
        CoherenceError::unless(peak < 0.5, "the peak of the learning rate", peak, "below 0.5")?;
        let mut minor = random_weights(whitened, features, rng);
        minor.col_iter_mut().for_each(|column| normalise(column.iter_mut()));
        Ok(IncrementalSlow {
            options,
            whitening: Whitening::new(inputs, whitened, smallest_variance, REACH),
            fastest: PrincipalComponents::new(whitened, 1),
            minor,
            before: None,
            slowness: vec![0.0; features],
            derivatives: 0,
        })
    }

    /// Number of frames seen.
    pub fn frames(&self) -> usize {
        self.whitening.frames
    }

    /// Slowness of each feature, the mean square of its derivative, `k`: an amnesic average over about the last 2000
    /// frames, while the features themselves change.
    pub fn slowness(&self) -> &[f64] {
        &self.slowness
    }

    /// Take one frame; without a link there is no derivative to the frame before it.
    ///
    /// # Errors
    /// Another number of inputs; values that are not finite or too large to be squared. Nothing is changed then.
    pub fn update(&mut self, x: &[f64], link: Option<Link>) -> Result<(), CoherenceError> {
        CoherenceError::unless_fits("the number of inputs", x.len(), self.whitening.mean.len())?;
        check_squares(self.frames(), x)?;
        check_link(self.frames(), link)?;
        self.whitening.update(x);
        if let (Some(link), Some(before)) = (link, self.before.replace(x.to_vec())) {
            let scale = link.weight.sqrt() / link.dt;
            let (now, before) = (self.whitening.apply(x), self.whitening.apply(&before));
            let rate: Vec<f64> = now.iter().zip(&before).map(|(now, before)| (now - before) * scale).collect();
            if rate.iter().all(|value| value.abs() < 1e70) {
                self.turn(rate);
            }
        }
        Ok(())
    }

    /// The features as one linear map of the inputs, `d × k`; unit variance as far as the whitening has converged.
    pub fn map(&self) -> LinearMap {
        let Whitening { mean, components, smallest_variance, .. } = &self.whitening;
        let directions = components.white_directions(*smallest_variance);
        LinearMap::centred(directions * &self.minor, MatRef::from_column_major_slice(mean, mean.len(), 1))
    }

    /// The features of one frame.
    ///
    /// # Errors
    /// Another number of inputs.
    pub fn features(&self, x: &[f64]) -> Result<Vec<f64>, CoherenceError> {
        CoherenceError::unless_fits("the number of inputs", x.len(), self.whitening.mean.len())?;
        Ok(project(&self.minor, &self.whitening.apply(x)))
    }

    /// Turn the minor components by one derivative.
    fn turn(&mut self, mut rate: Vec<f64>) {
        self.derivatives += 1;
        let share = amnesic_share(self.derivatives, REACH);
        self.fastest.update(rate.clone(), share);
        let largest = self.fastest.variance(0);
        if largest <= 0.0 {
            return;
        }
        rate.iter_mut().for_each(|value| *value /= largest.sqrt());
        let length = rate.iter().map(|value| value * value).sum::<f64>();
        let progress = (self.derivatives as f64 / self.options.ramp.max(1) as f64).min(1.0);
        let scheduled = self.options.start + (self.options.peak - self.options.start) * progress * progress;
        let (p, k) = (self.minor.nrows(), self.minor.ncols());
        for i in 0..k {
            // Each earlier direction adds 1 to the largest eigenvalue of the sum in brackets.
            let step = scheduled.min(LONGEST_STEP / (1.0 + length + i as f64));
            let mut pull: Vec<f64> = rate.clone();
            let along: f64 = self.minor.col(i).iter().zip(&rate).map(|(w, r)| w * r).sum();
            self.slowness[i] += share * (along * along * largest - self.slowness[i]);
            pull.iter_mut().for_each(|value| *value *= along);
            for j in 0..i {
                let overlap: f64 = (0..p).map(|row| self.minor[(row, j)] * self.minor[(row, i)]).sum();
                for (row, value) in pull.iter_mut().enumerate() {
                    *value += overlap * self.minor[(row, j)];
                }
            }
            for (w, pull) in self.minor.col_mut(i).iter_mut().zip(&pull) {
                *w = (1.0 - step) * *w - step * pull;
            }
            normalise(self.minor.col_mut(i).iter_mut());
        }
    }
}

/// It is restored into one of the same number of inputs and the same options.
#[cfg(feature = "snapshot")]
impl Persist for IncrementalSlow {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let sizes = |of: &Self| [of.whitening.mean.len(), of.minor.nrows(), of.minor.ncols(), of.slowness.len()];
        let expected = sizes(self);
        snapshot.numbers("mean", &mut self.whitening.mean)?;
        snapshot.inner("whitening", &mut self.whitening.components)?;
        snapshot.inner("fastest", &mut self.fastest)?;
        snapshot.matrix("minor", &mut self.minor, |rows, columns| (rows, columns))?;
        let mut before = self.before.take().unwrap_or_default();
        snapshot.numbers("before", &mut before)?;
        snapshot.numbers("slowness", &mut self.slowness)?;
        snapshot.value("frames", &mut self.whitening.frames)?;
        snapshot.value("derivatives", &mut self.derivatives)?;
        self.before = (self.frames() > 0).then_some(before);
        let fits = sizes(self) == expected && self.before.as_ref().is_none_or(|before| before.len() == expected[0]);
        snapshot.check("minor", fits, "the sizes do not fit each other")
    }
}

/// Refuse a frame with values that are not finite, or whose fourth powers are not, since products of squares are formed.
pub(super) fn check_squares(frame: usize, x: &[f64]) -> Result<(), CoherenceError> {
    check_frame(frame, x.iter().copied())?;
    match x.iter().enumerate().find(|(_, value)| value.abs() > 1e70) {
        Some((row, &value)) => Err(CoherenceError::NotFinite { row, frame, value }),
        None => Ok(()),
    }
}

/// Inputs of a stream about their running mean, on principal components that follow it, in units of these components' deviations.
#[derive(Debug, Clone)]
pub(super) struct Whitening {
    mean: Vec<f64>,
    components: PrincipalComponents,
    smallest_variance: f64,
    /// Frames that averages reach back in the end, about.
    reach: f64,
    frames: usize,
}

impl Whitening {
    /// `p` components of `d` inputs; components whose variance is below a share of the largest are 0.
    pub(super) fn new(d: usize, p: usize, smallest_variance: f64, reach: f64) -> Self {
        let components = PrincipalComponents::new(d, p);
        Whitening { mean: vec![0.0; d], components, smallest_variance, reach, frames: 0 }
    }

    /// Follow inputs that were checked.
    pub(super) fn update(&mut self, x: &[f64]) {
        self.frames += 1;
        let share = amnesic_share(self.frames, self.reach);
        for (mean, value) in self.mean.iter_mut().zip(x) {
            *mean += share * (value - *mean);
        }
        self.components.update(self.centred(x), share);
    }

    /// White coordinates, `p`.
    pub(super) fn apply(&self, x: &[f64]) -> Vec<f64> {
        self.components.white(&self.centred(x), self.smallest_variance)
    }

    fn centred(&self, x: &[f64]) -> Vec<f64> {
        x.iter().zip(&self.mean).map(|(value, mean)| value - mean).collect()
    }
}

/// Principal components that follow a stream of centred vectors (CCIPCA).
#[derive(Debug, Clone)]
struct PrincipalComponents {
    /// `v_j`, `d × p`: directions times variances.
    vectors: Mat<f64>,
    /// Variances `λ_j = ‖v_j‖`.
    variances: Vec<f64>,
}

#[cfg(feature = "snapshot")]
impl Persist for PrincipalComponents {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let sizes = |of: &Self| [of.vectors.nrows(), of.vectors.ncols(), of.variances.len()];
        let expected = sizes(self);
        snapshot.matrix("vectors", &mut self.vectors, |rows, columns| (rows, columns))?;
        snapshot.numbers("variances", &mut self.variances)?;
        snapshot.check("vectors", sizes(self) == expected, "the sizes do not fit each other")
    }
}

impl PrincipalComponents {
    fn new(d: usize, p: usize) -> Self {
        PrincipalComponents { vectors: Mat::zeros(d, p), variances: vec![0.0; p] }
    }

    fn variance(&self, j: usize) -> f64 {
        self.variances[j]
    }

    fn update(&mut self, mut rest: Vec<f64>, share: f64) {
        for j in 0..self.variances.len() {
            if self.variances[j] > 0.0 {
                let along: f64 =
                    self.vectors.col(j).iter().zip(&rest).map(|(v, u)| v * u).sum::<f64>() / self.variances[j];
                for (v, u) in self.vectors.col_mut(j).iter_mut().zip(&rest) {
                    *v = (1.0 - share) * *v + share * along * u;
                }
            } else {
                // The first thing that earlier components leave over starts the next one, with its own variance.
                let length = rest.iter().map(|u| u * u).sum::<f64>().sqrt();
                for (v, u) in self.vectors.col_mut(j).iter_mut().zip(&rest) {
                    *v = share * length * u;
                }
            }
            let length = self.vectors.col(j).iter().map(|v| v * v).sum::<f64>().sqrt();
            // Too short to have a direction.
            if length < 1e-150 {
                self.variances[j] = 0.0;
                return;
            }
            self.variances[j] = length;
            let along: f64 = self.vectors.col(j).iter().zip(&rest).map(|(v, u)| v * u).sum::<f64>() / length;
            for (u, v) in rest.iter_mut().zip(self.vectors.col(j).iter()) {
                *u -= along * v / length;
            }
        }
    }

    /// `v̂_j/√λ_j`, `d × p`; zero where the variance is too small a share of the largest.
    fn white_directions(&self, smallest: f64) -> Mat<f64> {
        let floor = self.floor(smallest);
        Mat::from_fn(self.vectors.nrows(), self.variances.len(), |i, j| {
            let variance = self.variances[j];
            if variance > floor { self.vectors[(i, j)] / (variance * variance.sqrt()) } else { 0.0 }
        })
    }

    fn white(&self, centred: &[f64], smallest: f64) -> Vec<f64> {
        let floor = self.floor(smallest);
        let along = project(&self.vectors, centred);
        let white = |(along, &variance): (f64, &f64)| {
            if variance > floor { along / (variance * variance.sqrt()) } else { 0.0 }
        };
        along.into_iter().zip(&self.variances).map(white).collect()
    }

    fn floor(&self, smallest: f64) -> f64 {
        smallest * self.variances.iter().copied().fold(0.0, f64::max)
    }
}

/// `(1 + μ(t))/t`, the share of frame `t` (from 1) in an amnesic average, which grows by `1/r` per frame in the end.
fn amnesic_share(t: usize, r: f64) -> f64 {
    let (t1, t2, c) = AMNESIC;
    let t = t as f64;
    let amnesia = if t < t1 {
        0.0
    } else if t < t2 {
        c * (t - t1) / (t2 - t1)
    } else {
        c + (t - t2) / r
    };
    ((1.0 + amnesia) / t).min(1.0)
}

fn normalise<'a>(values: impl Iterator<Item = &'a mut f64>) {
    let values: Vec<&mut f64> = values.collect();
    let length = values.iter().map(|value| **value * **value).sum::<f64>().sqrt();
    if length > 0.0 {
        values.into_iter().for_each(|value| *value /= length);
    }
}
