//! Which regulariser, which kernel, how many support vectors: model selection by cross-validation over a grid.
//!
//! # Reference
//! Thesis §2.1.4 ("the simplest model which estimates f well"); Hastie, Tibshirani & Friedman 2009, §7.10.1 (one
//! standard error), §7.6 (effective number of parameters).

use faer::{Mat, MatRef, Par};

use super::error::RegressionError;
use super::function::Bias;
use super::kernel::KernelModel;
use super::linear::{check_lambda, ridge};
use super::sums::Sums;
use super::validate::{Errors, Folds, Score, shuffled};
use crate::dictionary::{Ald, Dictionary, Parameters, Selection as _, WhenFull};
use crate::kernel::{Kernel, Scalar};

/// One row of the table of a selection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate<P> {
    /// Its settings.
    pub settings: P,
    /// What they came to.
    pub score: Score,
}

/// The whole table of a selection: every candidate, in the order of the grid. It has at least one row.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelSelection<P> {
    candidates: Vec<Candidate<P>>,
}

impl<P> ModelSelection<P> {
    /// Every candidate, in the order of the grid.
    pub fn candidates(&self) -> &[Candidate<P>] {
        &self.candidates
    }

    /// The candidate of the smallest test error.
    pub fn best(&self) -> &Candidate<P> {
        self.least(&self.candidates[0], |candidate| Some(candidate.score.test))
    }

    /// The simplest candidate – that of the fewest effective parameters – whose test error is within one standard error
    /// of the best.
    ///
    /// Where test errors saturate, the best of them is a matter of chance; this is the model at which the saturation
    /// begins.
    pub fn simplest(&self) -> &Candidate<P> {
        let best = self.best();
        let limit = best.score.test + best.score.standard_error;
        self.least(best, |candidate| (candidate.score.test <= limit).then_some(candidate.score.parameters))
    }

    /// The first candidate of the least value, among those that have one, or else `fallback`.
    fn least<'a>(
        &'a self,
        fallback: &'a Candidate<P>,
        value: impl Fn(&Candidate<P>) -> Option<f64>,
    ) -> &'a Candidate<P> {
        let with_value = self.candidates.iter().filter_map(|candidate| value(candidate).map(|v| (v, candidate)));
        with_value.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(fallback, |(_, candidate)| candidate)
    }
}

/// Cross-validate ridge regression for each λ of a grid.
///
/// # Shapes
/// `x: p × n`, `t: q × n`; the folds divide the same `n` samples.
///
/// # Errors
/// Shapes that do not fit, values that are not finite, an empty grid, a λ that is negative or not finite.
///
/// # Example
/// ```
/// use adagio::regression::{Bias, Folds, select_ridge};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::regression::RegressionError> {
/// // A noiseless line: every penalty does harm.
/// let x = Mat::<f64>::from_fn(1, 30, |_, j| j as f64);
/// let t = Mat::<f64>::from_fn(1, 30, |_, j| 5.0 - 2.0 * j as f64);
/// let folds = Folds::contiguous(30, 5)?;
/// let selection = select_ridge(x.as_ref(), t.as_ref(), &[1000.0, 1.0, 0.0], &folds, Bias::Free, Par::Seq)?;
/// assert_eq!(selection.best().settings, 0.0);
/// assert_eq!(selection.candidates().len(), 3);
/// # Ok(())
/// # }
/// ```
pub fn select_ridge(
    x: MatRef<'_, f64>,
    t: MatRef<'_, f64>,
    lambdas: &[f64],
    folds: &Folds,
    bias: Bias,
    par: Par,
) -> Result<ModelSelection<f64>, RegressionError> {
    check_grid("values of lambda", lambdas.len())?;
    lambdas.iter().try_for_each(|&lambda| check_lambda(lambda))?;
    check_samples(x.ncols(), t, folds)?;
    let mut tests = Vec::with_capacity(folds.len());
    for fold in 0..folds.len() {
        tests.push(sums_of(columns(x, folds.test(fold)).as_ref(), columns(t, folds.test(fold)).as_ref(), par)?);
    }
    let mut errors = vec![Vec::with_capacity(folds.len()); lambdas.len()];
    for (fold, test) in tests.iter().enumerate() {
        let mut training = Sums::new(x.nrows(), t.nrows())?;
        for (_, other) in tests.iter().enumerate().filter(|(index, _)| *index != fold) {
            training.merge(other)?;
        }
        for (errors, &lambda) in errors.iter_mut().zip(lambdas) {
            errors.push(errors_of(&training, test, lambda, bias)?);
        }
    }
    let rows = lambdas.iter().zip(&errors);
    let candidates = rows.map(|(&settings, errors)| Candidate { settings, score: Score::over(errors) });
    Ok(ModelSelection { candidates: candidates.collect() })
}

/// The settings of sparse kernel ridge regression that a selection chooses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KernelSettings {
    /// The kernel.
    pub kernel: Kernel,
    /// The largest number of support vectors.
    pub support_vectors: usize,
    /// The regulariser λ.
    pub lambda: f64,
}

/// The grid of a selection of kernel ridge regression: all combinations of its three lists.
///
/// Support vectors are chosen by approximate linear dependence from the training samples in a random order, so that a
/// small number of them is spread over all of the samples and not the first ones of a time series.
#[derive(Debug, Clone, PartialEq)]
pub struct KernelGrid {
    /// Kernels to choose from.
    pub kernels: Vec<Kernel>,
    /// Numbers of support vectors to choose from, ≥ 1. A dictionary that ν keeps smaller has as many as it has.
    pub support_vectors: Vec<usize>,
    /// Regularisers to choose from.
    pub lambdas: Vec<f64>,
    /// Threshold ν of the dictionaries, > 0.
    pub nu: f64,
    /// Whether the function has a constant part.
    pub bias: Bias,
    /// Seed of the order in which training samples are offered to a dictionary.
    pub seed: u64,
}

impl KernelGrid {
    /// Fit kernel ridge regression with one of the settings to samples: the last step of a selection.
    ///
    /// # Shapes
    /// `x: d × n`, `t: q × n`.
    ///
    /// # Errors
    /// What the dictionary refuses; shapes that do not fit; values that are not finite; no samples.
    pub fn fit<T: Scalar>(
        &self,
        settings: &KernelSettings,
        x: MatRef<'_, T>,
        t: MatRef<'_, f64>,
        par: Par,
    ) -> Result<KernelModel<T>, RegressionError> {
        RegressionError::unless_fits("the number of targets", t.ncols(), x.ncols())?;
        let dictionary = self.dictionary(settings.kernel, settings.support_vectors, x, par)?;
        let v = dictionary.coordinates(x)?;
        KernelModel::over(&dictionary, &ridge(&sums_of(v.as_ref(), t, par)?, settings.lambda, self.bias)?)
    }

    /// Support vectors out of all samples, in a random order.
    fn dictionary<T: Scalar>(
        &self,
        kernel: Kernel,
        budget: usize,
        x: MatRef<'_, T>,
        par: Par,
    ) -> Result<Dictionary<T>, RegressionError> {
        let mut ald = Ald::new(Parameters { kernel, nu: self.nu, budget, when_full: WhenFull::Stop, par })?;
        for block in shuffled(x.ncols(), self.seed).chunks(BLOCK) {
            if ald.is_full() {
                break;
            }
            ald.observe(columns(x, block).as_ref())?;
        }
        Ok(ald.into_dictionary())
    }
}

/// Samples offered to a dictionary at a time: enough for matrix products to pay.
const BLOCK: usize = 256;

/// Cross-validate sparse kernel ridge regression for all combinations of a grid, in the order kernel, number of support
/// vectors, λ.
///
/// Ridge regression needs only sums, and sums over folds merge: the samples are looked at once, and each λ then costs
/// one solution per fold, whose training and test errors come from the sums too. Kernel ridge regression over a
/// dictionary is ridge regression on Newton coordinates, and the first `m` of these do not change when more support
/// vectors follow. So per fold and kernel *one* dictionary of the largest size serves all numbers of support vectors
/// and all λ.
///
/// # Shapes
/// `x: d × n`, `t: q × n`; the folds divide the same `n` samples.
///
/// # Errors
/// Shapes that do not fit, values that are not finite, an empty list in the grid, no support vectors, a λ that is negative
/// or not finite, what the dictionary refuses.
///
/// # Example
/// ```
/// use adagio::kernel::Kernel;
/// use adagio::regression::{Bias, Folds, KernelGrid, select_kernel_ridge};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::regression::RegressionError> {
/// let x = Mat::<f64>::from_fn(1, 120, |_, j| 0.1 * j as f64);
/// let t = Mat::<f64>::from_fn(1, 120, |_, j| (0.1 * j as f64).sin());
/// let grid = KernelGrid {
///     kernels: vec![Kernel::gaussian(0.01)?, Kernel::gaussian(1.5)?],
///     support_vectors: vec![2, 20],
///     lambdas: vec![1e-6],
///     nu: 1e-6,
///     bias: Bias::Free,
///     seed: 1,
/// };
/// let folds = Folds::shuffled(120, 4, 7)?;
/// let best = *select_kernel_ridge(x.as_ref(), t.as_ref(), &grid, &folds, Par::Seq)?.best();
/// // A width below the distance of the samples predicts nothing between them, and two support vectors are too few for two periods.
/// assert_eq!(best.settings.kernel.sigma(), Some(1.5));
/// assert_eq!(best.settings.support_vectors, 20);
/// let model = grid.fit(&best.settings, x.as_ref(), t.as_ref(), Par::Seq)?;
/// assert!(model.members().ncols() <= 20);
/// # Ok(())
/// # }
/// ```
pub fn select_kernel_ridge<T: Scalar>(
    x: MatRef<'_, T>,
    t: MatRef<'_, f64>,
    grid: &KernelGrid,
    folds: &Folds,
    par: Par,
) -> Result<ModelSelection<KernelSettings>, RegressionError> {
    check_grid("kernels", grid.kernels.len())?;
    check_grid("numbers of support vectors", grid.support_vectors.len())?;
    check_grid("values of lambda", grid.lambdas.len())?;
    grid.lambdas.iter().try_for_each(|&lambda| check_lambda(lambda))?;
    if grid.support_vectors.contains(&0) {
        return Err(RegressionError::NoSupportVectors);
    }
    check_samples(x.ncols(), t, folds)?;
    let largest = grid.support_vectors.iter().copied().max().unwrap_or(0);
    let mut candidates = Vec::new();
    for &kernel in &grid.kernels {
        let combinations: Vec<KernelSettings> = grid
            .support_vectors
            .iter()
            .flat_map(|&support_vectors| {
                grid.lambdas.iter().map(move |&lambda| KernelSettings { kernel, support_vectors, lambda })
            })
            .collect();
        let mut errors = vec![Vec::with_capacity(folds.len()); combinations.len()];
        for fold in 0..folds.len() {
            let (inside, outside) = (folds.training(fold), folds.test(fold));
            let (x_inside, x_outside) = (columns(x, &inside), columns(x, outside));
            let dictionary = grid.dictionary(kernel, largest, x_inside.as_ref(), par)?;
            let sums = |x: &Mat<T>, of: &[usize]| {
                let v = dictionary.coordinates(x.as_ref())?;
                sums_of(v.as_ref(), columns(t, of).as_ref(), par)
            };
            let (training, test) = (sums(&x_inside, &inside)?, sums(&x_outside, outside)?);
            for (errors, settings) in errors.iter_mut().zip(&combinations) {
                let m = settings.support_vectors;
                errors.push(errors_of(&training.leading(m), &test.leading(m), settings.lambda, grid.bias)?);
            }
        }
        let rows = combinations.into_iter().zip(&errors);
        candidates.extend(rows.map(|(settings, errors)| Candidate { settings, score: Score::over(errors) }));
    }
    Ok(ModelSelection { candidates })
}

fn errors_of(training: &Sums, test: &Sums, lambda: f64, bias: Bias) -> Result<Errors, RegressionError> {
    let function = ridge(training, lambda, bias)?;
    Ok(Errors {
        training: training.mean_squared_error(&function)?,
        test: test.mean_squared_error(&function)?,
        parameters: function.parameters,
    })
}

fn sums_of(x: MatRef<'_, f64>, t: MatRef<'_, f64>, par: Par) -> Result<Sums, RegressionError> {
    let mut sums = Sums::new(x.nrows(), t.nrows())?;
    sums.add(x, t, par)?;
    Ok(sums)
}

/// Some of the columns of a matrix.
fn columns<T: Scalar>(matrix: MatRef<'_, T>, which: &[usize]) -> Mat<T> {
    Mat::from_fn(matrix.nrows(), which.len(), |i, j| matrix[(i, which[j])])
}

fn check_samples(samples: usize, t: MatRef<'_, f64>, folds: &Folds) -> Result<(), RegressionError> {
    RegressionError::unless_fits("the number of targets", t.ncols(), samples)?;
    RegressionError::unless_fits("the number of samples in the folds", folds.samples(), samples)
}

fn check_grid(what: &'static str, size: usize) -> Result<(), RegressionError> {
    if size == 0 { Err(RegressionError::EmptyGrid(what)) } else { Ok(()) }
}
