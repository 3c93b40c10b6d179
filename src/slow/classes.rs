//! Slow features of classes: where samples of one class follow each other, what varies slowly tells the classes apart.
//!
//! A labelled set has no time. [`class_moments`] takes every pair of samples of one class for two frames that follow each
//! other, and so the slowest features vary little within classes. With all functions of the samples there would be `C − 1`
//! features for `C` classes that are constant within each (Berkes 2005). [`Gaussians`] classifies by features.
//!
//! # Reference
//! Thesis §4.2.2; Berkes, *Pattern recognition with slow feature analysis*, CogPrints 4104 (2005).

use std::ops::Range;

use faer::{Mat, MatRef, Par, Side};

use super::error::SlowError;
use super::moments::Moments;

/// Samples whose coordinates are computed together.
const BLOCK: usize = 512;

/// Sums over a labelled set in which every two samples of one class are two frames that follow each other after a second.
///
/// The squares of all pairs need no pairs: over the `n` samples `v` of a class with mean `μ` the mean of `(v − v′)(v − v′)ᵀ` is
/// `2n/(n − 1)` times that of `(v − μ)(v − μ)ᵀ`. Each class counts by its number of samples. [`solve()`](super::solve()) minimises
/// within classes while it keeps the variance of all: linear features are those of Fisher's discriminant analysis.
///
/// `classes` has the class of each sample, numbered from 0 on: sums are kept for each number up to the largest.
/// `coordinates` gives the coordinates of some of the samples, `m × b`; it is called twice for each of them, so that monomials or
/// kernel values of all of them never have to be in memory.
///
/// ```
/// use adagio::slow::classes::class_moments;
/// use adagio::slow::solve;
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// // Two classes, far apart along the second axis alone.
/// let x = Mat::from_fn(2, 100, |i, t| if i == 0 { (t as f64).sin() } else { (t % 2) as f64 + 0.1 * (7.0 * t as f64).sin() });
/// let classes: Vec<usize> = (0..100).map(|t| t % 2).collect();
/// let moments = class_moments(&classes, |part| Ok(x.subcols(part.start, part.len()).to_owned()), Par::Seq)?;
/// let features = solve(&moments, 1, 0.0, None)?;
/// assert!(features.weights[(1, 0)].abs() > 30.0 * features.weights[(0, 0)].abs());
/// # Ok(())
/// # }
/// ```
///
/// # Errors
/// What `coordinates` refuses, coordinates of other shapes.
pub fn class_moments(
    classes: &[usize],
    coordinates: impl Fn(Range<usize>) -> Result<Mat<f64>, SlowError>,
    par: Par,
) -> Result<Moments, SlowError> {
    let parts = || (0..classes.len()).step_by(BLOCK).map(|start| start..classes.len().min(start + BLOCK));
    let count = classes.iter().max().map_or(0, |&largest| largest + 1);
    let (mut moments, mut means, mut samples) = (Moments::new(par), Mat::<f64>::new(), vec![0usize; count]);
    for part in parts() {
        let v = coordinates(part.clone())?;
        SlowError::unless_fits("a block of coordinates", v.ncols(), part.len())?;
        if moments.size() == 0 {
            moments.widen(v.nrows())?;
            means = Mat::zeros(v.nrows(), count);
        }
        SlowError::unless_fits("a sample's number of coordinates", v.nrows(), moments.size())?;
        for (&class, sample) in classes[part].iter().zip(v.col_iter()) {
            samples[class] += 1;
            let add = 1.0 / samples[class] as f64;
            let mut mean = means.col_mut(class);
            (0..v.nrows()).for_each(|i| mean[i] += add * (sample[i] - mean[i]));
        }
    }
    for part in parts() {
        let v = coordinates(part.clone())?;
        let paired: Vec<usize> = part.clone().filter(|&sample| samples[classes[sample]] > 1).collect();
        let rates = Mat::from_fn(v.nrows(), paired.len(), |i, j| {
            let (sample, class) = (paired[j], classes[paired[j]]);
            let n = samples[class] as f64;
            (2.0 * n / (n - 1.0)).sqrt() * (v[(i, sample - part.start)] - means[(i, class)])
        });
        moments.add(v.as_ref(), rates.as_ref(), paired.len() as f64)?;
    }
    Ok(moments)
}

/// What is held to be the spread of a class.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spread {
    /// Each class has its own covariance.
    Own,
    /// All have one, the mean of theirs: borders between classes are planes, as in linear discriminant analysis.
    Shared,
}

/// A classifier: a Gaussian distribution for each class, which is as probable beforehand as it was frequent.
///
/// ```
/// use adagio::slow::classes::{Gaussians, Spread};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// let x = Mat::from_fn(1, 6, |_, t| [-1.1, -1.0, -0.9, 1.9, 2.0, 2.1][t]);
/// let gaussians = Gaussians::fit(x.as_ref(), &[0, 0, 0, 1, 1, 1], Spread::Own, 0.0)?;
/// assert_eq!(gaussians.classify(Mat::full(1, 1, 0.4).as_ref())?, [0]);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Gaussians {
    classes: Vec<Gaussian>,
}

#[derive(Debug, Clone)]
struct Gaussian {
    class: usize,
    mean: Vec<f64>,
    /// `L⁻¹`, where `LLᵀ` is the covariance.
    whitening: Mat<f64>,
    /// Logarithm of its share of the samples, less that of the determinant of `L`.
    height: f64,
}

impl Gaussians {
    /// Mean and covariance of each class of `x: k × n`; `floor` is added to the variances. Classes without samples are never found.
    ///
    /// # Errors
    /// A list of classes of another length, or of none, values that are not finite, a covariance that is singular with this floor.
    pub fn fit(x: MatRef<'_, f64>, classes: &[usize], spread: Spread, floor: f64) -> Result<Self, SlowError> {
        SlowError::unless_fits("the list of classes", classes.len(), x.ncols())?;
        SlowError::unless_finite("the features of a sample are", x)?;
        if classes.is_empty() {
            return Err(SlowError::Empty("the list of classes is"));
        }
        let (k, n) = (x.nrows(), x.ncols() as f64);
        let count = classes.iter().max().map_or(0, |&largest| largest + 1);
        let mut of_class = Vec::new();
        let mut shared = Mat::<f64>::zeros(k, k);
        for class in 0..count {
            let members: Vec<usize> = (0..x.ncols()).filter(|&t| classes[t] == class).collect();
            if members.is_empty() {
                continue;
            }
            let share = members.len() as f64;
            let mean: Vec<f64> = (0..k).map(|i| members.iter().map(|&t| x[(i, t)]).sum::<f64>() / share).collect();
            let centred = Mat::from_fn(k, members.len(), |i, j| x[(i, members[j])] - mean[i]);
            let scatter = &centred * centred.transpose();
            shared += &scatter;
            of_class.push((class, mean, share, scatter));
        }
        let gaussian = |(class, mean, share, scatter): (usize, Vec<f64>, f64, Mat<f64>)| {
            let (sum, over) = if spread == Spread::Own { (&scatter, share) } else { (&shared, n) };
            let covariance = Mat::from_fn(k, k, |i, j| sum[(i, j)] / over + if i == j { floor } else { 0.0 });
            // What is left of a direction after the others, beside what it was: rounding counts as nothing.
            let factor = covariance.llt(Side::Lower).map_err(|_| SlowError::Singular(class))?.L().to_owned();
            if (0..k).any(|i| factor[(i, i)].powi(2) <= 1e-14 * covariance[(i, i)]) {
                return Err(SlowError::Singular(class));
            }
            let mut whitening = Mat::identity(k, k);
            factor.as_ref().solve_lower_triangular_in_place(whitening.as_mut());
            let height = (share / n).ln() - (0..k).map(|i| factor[(i, i)].ln()).sum::<f64>();
            Ok(Gaussian { class, mean, whitening, height })
        };
        Ok(Gaussians { classes: of_class.into_iter().map(gaussian).collect::<Result<_, SlowError>>()? })
    }

    /// The most probable class of each sample of `x: k × n`.
    ///
    /// # Errors
    /// Samples with another number of features.
    pub fn classify(&self, x: MatRef<'_, f64>) -> Result<Vec<usize>, SlowError> {
        let mut best = vec![(f64::NEG_INFINITY, 0); x.ncols()];
        for gaussian in &self.classes {
            SlowError::unless_fits("a sample's number of features", x.nrows(), gaussian.mean.len())?;
            let centred = Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)] - gaussian.mean[i]);
            let white = &gaussian.whitening * centred;
            for (best, white) in best.iter_mut().zip(white.col_iter()) {
                let likely = gaussian.height - white.squared_norm_l2() / 2.0;
                if likely > best.0 {
                    *best = (likely, gaussian.class);
                }
            }
        }
        Ok(best.into_iter().map(|(_, class)| class).collect())
    }
}
