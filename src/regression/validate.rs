//! How well a function predicts samples that it was not fitted to.
//!
//! # Reference
//! Thesis §2.1.4; Hastie, Tibshirani & Friedman 2009, §7.10.

use rand::seq::SliceRandom;

use super::error::RegressionError;
use crate::random::stream;

/// A division of samples into folds of almost equal size: every sample is in exactly one.
///
/// A function that explains its training samples well may have learned their noise. So some samples are withheld: if
/// the error on them (*test error*) is much larger than the error on the others (*training error*), the function is
/// over-fitting.
///
/// *Cross-validation* divides the samples into folds, and withholds one after the other. Samples of a time series
/// resemble their neighbours in time; if neighbours end up on both sides, the test error is too small. Such series are
/// divided into contiguous blocks.
///
/// # Example
/// ```
/// use adagio::regression::Folds;
///
/// let folds = Folds::contiguous(7, 3)?;
/// assert_eq!(folds.test(0), [0, 1]);
/// assert_eq!(folds.test(2), [4, 5, 6]);
/// assert_eq!(folds.training(0), [2, 3, 4, 5, 6]);
/// # Ok::<(), adagio::regression::RegressionError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Folds {
    tests: Vec<Vec<usize>>,
}

impl Folds {
    /// Blocks of consecutive samples: for time series.
    ///
    /// # Errors
    /// Fewer than two folds, more folds than samples, more samples than can be stored.
    pub fn contiguous(samples: usize, folds: usize) -> Result<Self, RegressionError> {
        RegressionError::unless_stored("a list of samples", samples, 1)?;
        Self::of((0..samples).collect(), folds)
    }

    /// Samples in a random order: for samples that are independent of each other.
    ///
    /// # Errors
    /// As [`Folds::contiguous`].
    pub fn shuffled(samples: usize, folds: usize, seed: u64) -> Result<Self, RegressionError> {
        RegressionError::unless_stored("a list of samples", samples, 1)?;
        Self::of(shuffled(samples, seed), folds)
    }

    fn of(order: Vec<usize>, folds: usize) -> Result<Self, RegressionError> {
        let samples = order.len();
        if folds < 2 || folds > samples {
            return Err(RegressionError::Folds { folds, samples });
        }
        // Fold k begins at ⌊k·samples/folds⌋. The product of two numbers of samples fits: there are at most 2³⁰.
        let begin = |k: usize| (k as u64 * samples as u64 / folds as u64) as usize;
        let tests = (0..folds).map(|k| {
            let mut test = order[begin(k)..begin(k + 1)].to_vec();
            test.sort_unstable();
            test
        });
        Ok(Folds { tests: tests.collect() })
    }

    /// Number of folds.
    pub fn len(&self) -> usize {
        self.tests.len()
    }

    /// Never: there are at least two folds.
    pub fn is_empty(&self) -> bool {
        self.tests.is_empty()
    }

    /// Number of samples in all folds.
    pub fn samples(&self) -> usize {
        self.tests.iter().map(Vec::len).sum()
    }

    /// The samples withheld in a fold, ascending; none if there is no such fold.
    pub fn test(&self, fold: usize) -> &[usize] {
        self.tests.get(fold).map_or(&[], Vec::as_slice)
    }

    /// The samples trained on in a fold, ascending.
    pub fn training(&self, fold: usize) -> Vec<usize> {
        let others = self.tests.iter().enumerate().filter(|(index, _)| *index != fold);
        let mut training: Vec<usize> = others.flat_map(|(_, test)| test.iter().copied()).collect();
        training.sort_unstable();
        training
    }
}

/// A withheld test set: the indices to train on and those to test on, ascending.
///
/// Without a seed, the last samples are withheld (time series: learn from the past, test on the future); with one,
/// random samples.
///
/// # Errors
/// A share outside (0, 1), or one that leaves no sample on either side; more samples than can be stored.
///
/// # Example
/// ```
/// let (training, test) = adagio::regression::hold_out(10, 0.2, None)?;
/// assert_eq!(test, [8, 9]);
/// assert_eq!(training.len(), 8);
/// # Ok::<(), adagio::regression::RegressionError>(())
/// ```
pub fn hold_out(samples: usize, share: f64, seed: Option<u64>) -> Result<(Vec<usize>, Vec<usize>), RegressionError> {
    RegressionError::unless_stored("a list of samples", samples, 1)?;
    let withheld = (samples as f64 * share).round();
    if !(share > 0.0 && share < 1.0 && withheld >= 1.0 && withheld < samples as f64) {
        return Err(RegressionError::Share { share, samples });
    }
    let mut training = match seed {
        Some(seed) => shuffled(samples, seed),
        None => (0..samples).collect(),
    };
    let mut test = training.split_off(samples - withheld as usize);
    training.sort_unstable();
    test.sort_unstable();
    Ok((training, test))
}

/// The numbers below `samples` in an order given by a seed.
pub(super) fn shuffled(samples: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..samples).collect();
    order.shuffle(&mut stream(seed, "validation"));
    order
}

/// What one function came to in one fold.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    /// Mean squared error on the samples it was fitted to.
    pub training: f64,
    /// Mean squared error on the withheld samples.
    pub test: f64,
    /// Effective number of parameters, [`Linear::parameters`](super::Linear::parameters): how complex the function is.
    pub parameters: f64,
}

/// What a way of fitting came to over all folds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Score {
    /// Mean over the folds of the training errors.
    pub training: f64,
    /// Mean over the folds of the test errors.
    pub test: f64,
    /// Standard error of the mean test error: the standard deviation over the folds, divided by the root of their
    /// number.
    pub standard_error: f64,
    /// Mean over the folds of the effective numbers of parameters.
    pub parameters: f64,
}

impl Score {
    /// The score of the errors of all folds; all zero if there are none.
    pub(super) fn over(folds: &[Errors]) -> Score {
        let n = folds.len().max(1) as f64;
        let mean = |value: fn(&Errors) -> f64| folds.iter().map(value).sum::<f64>() / n;
        let test = mean(|errors| errors.test);
        let squares: f64 = folds.iter().map(|errors| (errors.test - test) * (errors.test - test)).sum();
        Score {
            training: mean(|errors| errors.training),
            test,
            standard_error: (squares / (n - 1.0).max(1.0) / n).sqrt(),
            parameters: mean(|errors| errors.parameters),
        }
    }
}

/// Cross-validate any way of fitting: `fit(training, test)` fits to the samples of the first list and says how it does
/// on both.
///
/// For ridge and kernel ridge regression, [`select_ridge`](super::select_ridge) and
/// [`select_kernel_ridge`](super::select_kernel_ridge) do it at a fraction of the cost.
///
/// # Errors
/// The first error of a fit.
///
/// # Example
/// ```
/// use adagio::regression::{Errors, Folds, RegressionError, cross_validate};
///
/// // Predicting every sample by the mean of the others.
/// let samples = [1.0, 2.0, 3.0, 6.0];
/// let error = |of: &[usize], y: f64| of.iter().map(|&i| (samples[i] - y).powi(2)).sum::<f64>() / of.len() as f64;
/// let score = cross_validate(&Folds::contiguous(4, 4)?, |training, test| {
///     let mean = training.iter().map(|&i| samples[i]).sum::<f64>() / training.len() as f64;
///     Ok::<_, RegressionError>(Errors { training: error(training, mean), test: error(test, mean), parameters: 1.0 })
/// })?;
/// // Each sample is (4/3)² of its squared distance from the mean of all away: 14/4 · 16/9.
/// assert!((score.test - 14.0 / 4.0 * 16.0 / 9.0).abs() < 1e-12);
/// # Ok::<(), RegressionError>(())
/// ```
pub fn cross_validate<E>(
    folds: &Folds,
    mut fit: impl FnMut(&[usize], &[usize]) -> Result<Errors, E>,
) -> Result<Score, E> {
    let errors: Result<Vec<Errors>, E> =
        (0..folds.len()).map(|fold| fit(&folds.training(fold), folds.test(fold))).collect();
    Ok(Score::over(&errors?))
}
