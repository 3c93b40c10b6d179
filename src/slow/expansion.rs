//! Expanded slow feature analysis: linear SFA after a nonlinear expansion, as a pipeline of stages.

use faer::{Mat, MatRef};

use super::error::SlowError;
use super::linear::{LinearSfa, centre};
use super::links::Link;

/// Largest number of monomials: SFA on them needs matrices of this size squared, 3.2 GB at 20 000.
pub const MOST_MONOMIALS: usize = 20_000;

/// Singular values below this share of the largest are rounding, not variance.
const SINGULAR_TOLERANCE: f64 = 1e-12;

/// How many principal components to keep.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Keep {
    /// All that have variance.
    All,
    /// This many, largest variance first.
    Components(usize),
    /// As few as explain this share of the variance, in (0, 1].
    Variance(f64),
}

/// Principal component analysis: the directions of largest variance, optionally scaled to variance 1.
///
/// The sign of a component is such that its largest weight is positive.
///
/// ```
/// use adagio::slow::{Keep, Pca};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// let x = Mat::from_fn(2, 100, |i, t| [3.0, 4.0][i] * (t as f64).sin());
/// let pca = Pca::fit(x.as_ref(), Keep::Variance(0.99), false)?;
/// assert_eq!(pca.outputs(), 1);
/// assert!((pca.projection[(0, 0)] - 0.6).abs() < 1e-12 && (pca.projection[(1, 0)] - 0.8).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Pca {
    /// Mean of the training frames, `d`.
    pub mean: Vec<f64>,
    /// Projection, `d × r`; if whitening, already divided by the standard deviations.
    pub projection: Mat<f64>,
    /// Variance of each component on the training frames (divided by n), descending, `r`.
    pub variances: Vec<f64>,
    /// Variance of all components together, kept or not.
    pub total_variance: f64,
}

impl Pca {
    /// The principal components of `x: d × n`.
    ///
    /// # Errors
    /// Fewer than two frames, values that are not finite, a share outside (0, 1], more components than there are directions
    /// with variance, or none.
    pub fn fit(x: MatRef<'_, f64>, keep: Keep, whiten: bool) -> Result<Pca, SlowError> {
        if let Keep::Variance(share) = keep
            && !(share > 0.0 && share <= 1.0)
        {
            return Err(SlowError::VarianceShare(share));
        }
        let (mean, centred) = centre(x)?;
        let (d, n) = (x.nrows(), x.ncols());
        if n < 2 {
            return Err(SlowError::TooFewFrames { frames: n as f64, links: 1.0 });
        }
        if d == 0 {
            return Err(SlowError::Empty("the list of values of a frame is"));
        }
        let svd = centred.thin_svd().map_err(|_| SlowError::Eigenvalues(d))?;
        let singular: Vec<f64> = (0..d.min(n)).map(|i| svd.S()[i]).collect();
        let rounding = SINGULAR_TOLERANCE * singular[0].max(largest(&mean) * (n as f64).sqrt() * 1e-2);
        let rank = singular.iter().take_while(|&&value| value > rounding).count();
        let variance = |value: &f64| value * value / n as f64;
        let total_variance: f64 = singular.iter().map(variance).sum();
        let kept = match keep {
            Keep::All => rank,
            Keep::Components(asked) => asked,
            Keep::Variance(share) => {
                let sums = singular.iter().scan(0.0, |sum, value| {
                    *sum += variance(value);
                    Some(*sum)
                });
                // The last sums differ from the total by rounding only, so a share of 1 keeps what has variance.
                rank.min(sums.take_while(|&sum| sum < share * total_variance).count() + 1)
            }
        };
        if kept == 0 || kept > rank {
            return Err(SlowError::Features { asked: kept, rank });
        }
        let u = svd.U();
        let sign = |j: usize| {
            let largest =
                (0..d).map(|i| u[(i, j)]).fold(0.0, |best: f64, w| if w.abs() > best.abs() { w } else { best });
            if largest < 0.0 { -1.0 } else { 1.0 }
        };
        let scale: Vec<f64> =
            (0..kept).map(|j| sign(j) * if whiten { (n as f64).sqrt() / singular[j] } else { 1.0 }).collect();
        Ok(Pca {
            mean,
            projection: Mat::from_fn(d, kept, |i, j| u[(i, j)] * scale[j]),
            variances: singular[..kept].iter().map(variance).collect(),
            total_variance,
        })
    }

    /// Number of components `r`.
    pub fn outputs(&self) -> usize {
        self.projection.ncols()
    }

    /// Components of frames: `x: d × n` gives `r × n`.
    ///
    /// # Errors
    /// Frames of another length, a projection and a mean that do not fit each other.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        SlowError::unless_fits("a frame's number of values", x.nrows(), self.mean.len())?;
        SlowError::unless_fits("the number of rows of the projection", self.projection.nrows(), self.mean.len())?;
        let centred = Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)] - self.mean[i]);
        Ok(self.projection.transpose() * centred)
    }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most: f64, value| most.max(value.abs()))
}

/// All monomials of the values of a frame up to a degree, without the constant.
///
/// The order: degree by degree; within one, by the indices `i ≤ j ≤ k` of the factors, the first one slowest. For three
/// values and degree 2 that is `x₁ x₂ x₃ x₁² x₁x₂ x₁x₃ x₂² x₂x₃ x₃²`.
///
/// ```
/// use adagio::slow::Expansion;
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// let x = Mat::from_fn(2, 1, |i, _| [2.0, 3.0][i]);
/// let y = Expansion::Cubic.apply(x.as_ref())?;
/// let values: Vec<f64> = (0..y.nrows()).map(|i| y[(i, 0)]).collect();
/// assert_eq!(values, [2.0, 3.0, 4.0, 6.0, 9.0, 8.0, 12.0, 18.0, 27.0]);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Expansion {
    /// Up to degree 2: `d(d + 3)/2` monomials.
    Quadratic,
    /// Up to degree 3: `d(d + 3)/2 + d(d + 1)(d + 2)/6` monomials.
    Cubic,
}

impl Expansion {
    /// Number of monomials of `d` values.
    ///
    /// # Errors
    /// More than [`MOST_MONOMIALS`].
    pub fn outputs(self, d: usize) -> Result<usize, SlowError> {
        // There are never fewer monomials than values, and up to here the products can be counted.
        let wide = d.min(MOST_MONOMIALS + 1) as u128;
        let quadratic = wide * (wide + 3) / 2;
        let count = match self {
            Expansion::Quadratic => quadratic,
            Expansion::Cubic => quadratic + wide * (wide + 1) * (wide + 2) / 6,
        };
        match usize::try_from(count) {
            Ok(count) if count <= MOST_MONOMIALS => Ok(count),
            _ => Err(SlowError::Expansion { inputs: d, most: MOST_MONOMIALS }),
        }
    }

    /// The factors of each monomial of `d` values, as indices, in the order of the outputs.
    ///
    /// # Errors
    /// More than [`MOST_MONOMIALS`].
    pub fn monomials(self, d: usize) -> Result<Vec<Vec<usize>>, SlowError> {
        let mut all = Vec::with_capacity(self.outputs(d)?);
        all.extend((0..d).map(|i| vec![i]));
        all.extend((0..d).flat_map(|i| (i..d).map(move |j| vec![i, j])));
        if self == Expansion::Cubic {
            all.extend((0..d).flat_map(|i| (i..d).flat_map(move |j| (j..d).map(move |k| vec![i, j, k]))));
        }
        Ok(all)
    }

    /// The monomials of frames: `x: d × n` gives one row each.
    ///
    /// # Errors
    /// More than [`MOST_MONOMIALS`].
    pub fn apply(self, x: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        let monomials = self.monomials(x.nrows())?;
        Ok(Mat::from_fn(monomials.len(), x.ncols(), |row, t| monomials[row].iter().map(|&i| x[(i, t)]).product()))
    }
}

/// What to do at one place of a [`Pipeline`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Step {
    /// Principal components.
    Pca {
        /// How many.
        keep: Keep,
        /// Whether to scale them to variance 1.
        whiten: bool,
    },
    /// Monomials.
    Expand(Expansion),
    /// Linear SFA.
    Sfa {
        /// Number of outputs.
        features: usize,
        /// Regulariser λ.
        lambda: f64,
    },
    /// Outputs beyond ± this limit are set to it; Franzius 2007 clips at 4 standard deviations.
    Clip(f64),
}

/// A step that was fitted.
#[derive(Debug, Clone, PartialEq)]
pub enum Stage {
    /// Principal components.
    Pca(Pca),
    /// Monomials.
    Expand(Expansion),
    /// Linear SFA.
    Sfa(LinearSfa),
    /// Clipping at ± the limit.
    Clip(f64),
}

impl Stage {
    fn fit(step: &Step, x: MatRef<'_, f64>, links: &[Option<Link>]) -> Result<Stage, SlowError> {
        match *step {
            Step::Pca { keep, whiten } => Ok(Stage::Pca(Pca::fit(x, keep, whiten)?)),
            Step::Expand(expansion) => Ok(Stage::Expand(expansion)),
            Step::Sfa { features, lambda } => Ok(Stage::Sfa(LinearSfa::fit(x, links, features, lambda)?)),
            Step::Clip(limit) => Ok(Stage::Clip(limit)),
        }
    }

    /// Outputs of the stage for frames `x`, one a column.
    ///
    /// # Errors
    /// Frames of another length than in training, a limit for clipping that is not positive or not finite.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        match self {
            Stage::Pca(pca) => pca.apply(x),
            Stage::Expand(expansion) => expansion.apply(x),
            Stage::Sfa(sfa) => sfa.apply(x),
            &Stage::Clip(limit) if limit > 0.0 && limit.is_finite() => {
                Ok(Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)].clamp(-limit, limit)))
            }
            &Stage::Clip(limit) => Err(SlowError::Clip(limit)),
        }
    }
}

/// Fitted stages, one after the other.
///
/// A [`Step`] says what to do; [`Pipeline::fit`] does it stage by stage on a signal and keeps each fitted [`Stage`]. The
/// usual chain, also that of each node of a [`Network`](super::Network), is
///
/// ```text
///   x ──▶ PCA or SFA (fewer values) ──▶ monomials up to degree 2 or 3 ──▶ SFA ──▶ clip at ±4
/// ```
///
/// The number of monomials grows quickly (`d = 50`: 1 325 of degree ≤ 2, 23 425 of degree ≤ 3), hence the reduction first.
/// Monomials of extreme inputs take extreme values on frames unlike those of the training, hence the clipping last.
///
/// The signal of Wiskott & Sejnowski (2002) hides a sine that no linear function finds:
///
/// ```
/// use adagio::slow::{Expansion, Link, Pipeline, Step};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// let time = |i: usize| i as f64 * std::f64::consts::TAU / 1999.0;
/// let x = Mat::from_fn(2, 2000, |row, i| {
///     let fast = (11.0 * time(i)).cos();
///     if row == 0 { time(i).sin() + fast * fast } else { fast }
/// });
/// let steps = [Step::Expand(Expansion::Quadratic), Step::Sfa { features: 1, lambda: 0.0 }];
/// let pipeline = Pipeline::fit(&steps, x.as_ref(), &Link::regular(2000, time(1))?)?;
/// let y = pipeline.apply(x.as_ref())?;
/// // The output is the sine with variance 1: √2 sin t.
/// let sine: f64 = (0..2000).map(|i| y[(0, i)] * time(i).sin()).sum::<f64>() / 2000.0;
/// assert!((sine.abs() - 0.5f64.sqrt()).abs() < 1e-3);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §4.3.2 (`sec:SFA_expanded`); Wiskott & Sejnowski 2002; Berkes & Wiskott 2005; Franzius et al. 2007.
#[derive(Debug, Clone, PartialEq)]
pub struct Pipeline {
    inputs: usize,
    outputs: usize,
    stages: Vec<Stage>,
}

impl Pipeline {
    /// Fit each step to what the steps before it make of the signal.
    ///
    /// # Shapes
    /// `x: d × n`, `links: n`.
    ///
    /// # Errors
    /// No step; what a step refuses, with its number (from 1).
    pub fn fit(steps: &[Step], x: MatRef<'_, f64>, links: &[Option<Link>]) -> Result<Pipeline, SlowError> {
        if steps.is_empty() {
            return Err(SlowError::Empty("the list of steps is"));
        }
        SlowError::unless_fits("the list of links", links.len(), x.ncols())?;
        let mut stages = Vec::with_capacity(steps.len());
        let mut y = x.to_owned();
        for (number, step) in steps.iter().enumerate() {
            let fitted = Stage::fit(step, y.as_ref(), links).and_then(|stage| Ok((stage.apply(y.as_ref())?, stage)));
            let (next, stage) = fitted.map_err(|cause| cause.at(format!("step {}", number + 1)))?;
            y = next;
            stages.push(stage);
        }
        Ok(Pipeline { inputs: x.nrows(), outputs: y.nrows(), stages })
    }

    /// Number of values per frame that it takes.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of outputs per frame.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// The fitted stages, in their order.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }

    /// Slowness of the last SFA among the stages on the training frames; empty without one.
    pub fn slowness(&self) -> &[f64] {
        let last =
            self.stages.iter().rev().find_map(|stage| if let Stage::Sfa(sfa) = stage { Some(sfa) } else { None });
        last.map_or(&[], |sfa| &sfa.slowness)
    }

    /// Outputs of frames: `x: d × n` gives one column each.
    ///
    /// # Errors
    /// Frames of another length than in training.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        SlowError::unless_fits("a frame's number of values", x.nrows(), self.inputs)?;
        let mut y = x.to_owned();
        for stage in &self.stages {
            y = stage.apply(y.as_ref())?;
        }
        Ok(y)
    }
}
