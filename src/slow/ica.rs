//! Independent components of slow features: from waves over the whole room to place cells.
//!
//! Slow features are only fixed up to rotations within equal slowness, and spread over the whole state space. Rotating them
//! so that they become as independent, hence as sparse, as possible gives features that are active in one place only.
//!
//! FastICA: the inputs are made white, `z = K(x − x̄)` with `⟨zzᵀ⟩ = I`; unit vectors `w_i` follow the fixed-point step
//!
//! `w ← ⟨z g(wᵀz)⟩ − ⟨g′(wᵀz)⟩ w`
//!
//! and are made orthonormal again, all at once ([`Decorrelation::Symmetric`]) or each after those before it
//! ([`Decorrelation::Deflation`]), until they stand still. If they have not after a while, steps are made shorter
//! (`w ← w − s·(⟨z g⟩ − b w)/(⟨g′⟩ − b)`, `b = ⟨wᵀz g⟩`, with `s = 1` the step above).
//!
//! Independent components have no natural sign, scale or order. Here: variance 1; positive skewness; descending kurtosis,
//! so that the sparsest comes first.
//!
//! # Reference
//! Hyvärinen, IEEE Trans. Neural Networks 10 (1999); thesis §4.2.3 (place cells); Franzius, Sprekeler & Wiskott 2007.

use faer::{Mat, MatRef, Side};
use rand_distr::{Distribution, StandardNormal};
use thiserror::Error;

/// Why there are no independent components.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum IcaError {
    /// Too few samples.
    #[error("at least 2 samples are needed: there are {0}")]
    TooFewSamples(usize),
    /// An input that is not a number, or too large for its kurtosis to be one.
    #[error("input {row} of sample {sample} is {value}: it must be finite, and at most 1e70")]
    NotFinite {
        /// Which input.
        row: usize,
        /// Which sample.
        sample: usize,
        /// Its value.
        value: f64,
    },
    /// More components than directions with variance, or none.
    #[error("{asked} components are asked for, but the inputs span {rank} directions only: allowed are 1 to {rank}")]
    Components {
        /// Components asked for.
        asked: usize,
        /// Directions in which the inputs vary.
        rank: usize,
    },
    /// A parameter out of range.
    #[error("{name} = {value} is not allowed: it must be {allowed}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The directions still move.
    #[error(
        "component {component} still moves by {change} after {iterations} iterations (tolerance {tolerance}): \
         more than one source may be Gaussian; try fewer components, another contrast or start, or more iterations"
    )]
    NotConverged {
        /// The component that moves most.
        component: usize,
        /// By how much its direction moved in the last iteration.
        change: f64,
        /// Iterations made.
        iterations: usize,
        /// The change that was asked for.
        tolerance: f64,
    },
    /// Inputs of another length.
    #[error("an input has {found} values, but the components were found with {expected}")]
    Inputs {
        /// Length of the input.
        found: usize,
        /// Length that fits.
        expected: usize,
    },
    /// A decomposition failed on finite values.
    #[error("the decomposition of a {0} × {0} matrix did not converge")]
    Decomposition(usize),
}

/// The nonlinearity `g` by which FastICA sees that a direction is not Gaussian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Contrast {
    /// `g = tanh u`: for all purposes.
    Tanh,
    /// `g = u³`: kurtosis; the fastest, but led astray by outliers. Slow features are bounded and have none: from 20 optimal
    /// responses of a room it finds place cells in about 300 iterations, where the others creep along almost flat directions
    /// for thousands.
    Cube,
    /// `g = u exp(−u²/2)`: for very sparse sources and outliers.
    Gauss,
}

impl Contrast {
    /// `g(u)` and `g′(u)`.
    fn at(self, u: f64) -> (f64, f64) {
        match self {
            Contrast::Tanh => (u.tanh(), 1.0 - u.tanh().powi(2)),
            Contrast::Cube => (u * u * u, 3.0 * u * u),
            Contrast::Gauss => {
                let bell = (-0.5 * u * u).exp();
                (u * bell, (1.0 - u * u) * bell)
            }
        }
    }
}

/// How directions are kept apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decorrelation {
    /// All together: errors are shared alike.
    Symmetric,
    /// One after the other: errors add up in the later ones.
    Deflation,
}

/// Options of [`fast_ica`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Number of components; `None`: as many as the inputs have directions with variance.
    pub components: Option<usize>,
    /// The nonlinearity.
    pub contrast: Contrast,
    /// How directions are kept apart.
    pub decorrelation: Decorrelation,
    /// Converged when no direction moves farther than this in an iteration, in (0, 1).
    pub tolerance: f64,
    /// Iterations after which it gives up (for each component, with deflation).
    pub most_iterations: usize,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            components: None,
            contrast: Contrast::Tanh,
            decorrelation: Decorrelation::Symmetric,
            tolerance: 1e-6,
            most_iterations: 1000,
        }
    }
}

/// Directions whose variance is below this share of the largest count as not there: rounding of a covariance is 1e-16 of it.
const RANK_TOLERANCE: f64 = 1e-12;

/// After this many iterations at one step length without convergence, the length is halved.
const PATIENCE: usize = 100;

/// Shorter steps than 1/8 only take longer: full steps converge at least linearly, and 1/2 stops them from jumping back and forth.
const MOST_HALVINGS: usize = 3;

/// Independent components `y = B(x − x̄)`, of variance 1 on the training samples, sparsest first.
#[derive(Debug, Clone, PartialEq)]
pub struct IndependentComponents {
    /// Unmixing matrix `B`, `k × d`, a component in each row.
    pub unmixing: Mat<f64>,
    /// Mean input `x̄`, `d`.
    pub mean: Vec<f64>,
    /// Excess kurtosis `⟨y⁴⟩ − 3` of each component on the training samples, descending; 0 for a Gaussian.
    pub kurtosis: Vec<f64>,
    /// Skewness `⟨y³⟩ ≥ 0` of each component on the training samples.
    pub skewness: Vec<f64>,
    /// Iterations until convergence (the most of any component, with deflation).
    pub iterations: usize,
}

impl IndependentComponents {
    /// Components of inputs: `x: d × n` gives `k × n`.
    ///
    /// # Errors
    /// Inputs of another length; an unmixing matrix and a mean that do not fit each other.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, IcaError> {
        if x.nrows() != self.mean.len() {
            return Err(IcaError::Inputs { found: x.nrows(), expected: self.mean.len() });
        }
        if self.unmixing.ncols() != self.mean.len() {
            return Err(IcaError::Inputs { found: self.mean.len(), expected: self.unmixing.ncols() });
        }
        let centred = Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)] - self.mean[i]);
        Ok(&self.unmixing * centred)
    }
}

/// Find independent components with FastICA.
///
/// If fewer components are asked for than there are directions, those of the largest variance are kept; with slow features,
/// which all have variance 1, pass only the slowest ones. Random numbers are the starting directions.
///
/// ```
/// use adagio::slow::ica::{Options, fast_ica};
/// use faer::Mat;
///
/// // A square wave and a saw tooth, mixed.
/// let square = |t: usize| if (t / 37) % 2 == 0 { 1.0 } else { -1.0 };
/// let saw = |t: usize| (t % 101) as f64 / 50.0 - 1.0;
/// let x = Mat::from_fn(2, 5000, |i, t| if i == 0 { square(t) + saw(t) } else { square(t) - 2.0 * saw(t) });
/// let found = fast_ica(x.as_ref(), Options::default(), &mut adagio::random::stream(1, "ica")).unwrap();
/// let y = found.apply(x.as_ref()).unwrap();
/// // The saw tooth has a kurtosis of −1.2, the square wave of −2: that is the order they come in.
/// let product: f64 = (0..5000).map(|t| y[(1, t)] * square(t)).sum::<f64>() / 5000.0;
/// assert!(product.abs() > 0.99);
/// ```
///
/// # Shapes
/// `x: d × n`, samples are columns.
///
/// # Errors
/// Fewer than 2 samples, values that are not finite, more components than directions with variance (constant inputs have
/// none), options out of range, and directions that do not come to rest.
pub fn fast_ica(
    x: MatRef<'_, f64>,
    options: Options,
    rng: &mut impl rand::Rng,
) -> Result<IndependentComponents, IcaError> {
    if !(options.tolerance > 0.0 && options.tolerance < 1.0) {
        return Err(IcaError::Parameter { name: "the tolerance", value: options.tolerance, allowed: "in (0, 1)" });
    }
    if options.most_iterations == 0 {
        return Err(IcaError::Parameter { name: "the number of iterations", value: 0.0, allowed: "> 0" });
    }
    let White { z, whitening, mean } = whiten(x, options.components)?;
    let k = z.nrows();
    let start = Mat::from_fn(k, k, |_, _| StandardNormal.sample(rng));
    let (w, iterations) = match options.decorrelation {
        Decorrelation::Symmetric => symmetric(&z, start, options)?,
        Decorrelation::Deflation => deflation(&z, start, options)?,
    };
    Ok(in_order(&z, w, &whitening, mean, iterations))
}

/// White inputs, and how they were made.
struct White {
    /// `z = K(x − x̄)`, `k × n`.
    z: Mat<f64>,
    /// `K`, `k × d`.
    whitening: Mat<f64>,
    mean: Vec<f64>,
}

/// Principal components of variance 1, from the eigenvectors of the covariance.
fn whiten(x: MatRef<'_, f64>, components: Option<usize>) -> Result<White, IcaError> {
    let (d, n) = (x.nrows(), x.ncols());
    if n < 2 {
        return Err(IcaError::TooFewSamples(n));
    }
    for sample in 0..n {
        for row in 0..d {
            let value = x[(row, sample)];
            if value.is_nan() || value.abs() > 1e70 {
                return Err(IcaError::NotFinite { row, sample, value });
            }
        }
    }
    let mean: Vec<f64> = (0..d).map(|i| x.row(i).iter().sum::<f64>() / n as f64).collect();
    // What is left of a constant after its mean is rounding, not variance.
    let magnitude = (0..d).flat_map(|i| x.row(i).iter().map(|value| value.abs())).fold(0.0, f64::max);
    let rounding = (magnitude * f64::EPSILON * n as f64).powi(2);
    let centred = Mat::from_fn(d, n, |i, t| x[(i, t)] - mean[i]);
    let covariance = &centred * centred.transpose() * faer::Scale(1.0 / n as f64);
    let eigen = covariance.self_adjoint_eigen(Side::Lower).map_err(|_| IcaError::Decomposition(d))?;
    let variance = |j: usize| eigen.S()[d - 1 - j];
    let floor = if d == 0 { 0.0 } else { (RANK_TOLERANCE * variance(0)).max(rounding).max(f64::MIN_POSITIVE) };
    let rank = (0..d).take_while(|&j| variance(j) > floor).count();
    let k = components.unwrap_or(rank);
    if k == 0 || k > rank {
        return Err(IcaError::Components { asked: k, rank });
    }
    let whitening = Mat::from_fn(k, d, |j, i| eigen.U()[(i, d - 1 - j)] / variance(j).sqrt());
    Ok(White { z: &whitening * &centred, whitening, mean })
}

/// One step for every column of `w`: `s = 1` is the fixed-point step, shorter ones go only part of the way.
///
/// Both forms point the same way for `s = 1`; this one is the fixed-point step divided by `b − ⟨g′⟩`.
fn stepped(z: &Mat<f64>, w: &Mat<f64>, contrast: Contrast, length: f64) -> Mat<f64> {
    let (k, n) = (z.nrows(), z.ncols() as f64);
    let mut u = w.transpose() * z;
    let mut slope = vec![0.0; w.ncols()];
    let mut along = vec![0.0; w.ncols()];
    for t in 0..u.ncols() {
        for i in 0..u.nrows() {
            let (g, derivative) = contrast.at(u[(i, t)]);
            along[i] += u[(i, t)] * g / n;
            slope[i] += derivative / n;
            u[(i, t)] = g;
        }
    }
    let pull = z * u.transpose() * faer::Scale(1.0 / n);
    Mat::from_fn(k, w.ncols(), |row, i| {
        let curvature = slope[i] - along[i];
        if length == 1.0 || curvature == 0.0 {
            pull[(row, i)] - slope[i] * w[(row, i)]
        } else {
            w[(row, i)] - length * (pull[(row, i)] - along[i] * w[(row, i)]) / curvature
        }
    })
}

/// All directions at once, `k × k`, one a column.
fn symmetric(z: &Mat<f64>, start: Mat<f64>, options: Options) -> Result<(Mat<f64>, usize), IcaError> {
    let mut w = nearest_orthogonal(&start)?;
    let mut moved = (0, f64::INFINITY);
    for iteration in 1..=options.most_iterations {
        let next = nearest_orthogonal(&stepped(z, &w, options.contrast, step_length(iteration)))?;
        moved =
            (0..w.ncols()).map(|i| (i, distance(&next, &w, i))).max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
        w = next;
        if moved.1 <= options.tolerance {
            return Ok((w, iteration));
        }
    }
    Err(IcaError::NotConverged {
        component: moved.0,
        change: moved.1,
        iterations: options.most_iterations,
        tolerance: options.tolerance,
    })
}

/// One direction after the other, each orthogonal to those before it.
fn deflation(z: &Mat<f64>, start: Mat<f64>, options: Options) -> Result<(Mat<f64>, usize), IcaError> {
    let k = start.ncols();
    let mut w = start;
    let mut most = 0;
    for i in 0..k {
        orthonormalise(&mut w, i);
        let mut change = f64::INFINITY;
        for iteration in 1..=options.most_iterations {
            let before = w.as_ref().subcols(i, 1).to_owned();
            let next = stepped(z, &before, options.contrast, step_length(iteration));
            w.col_mut(i).copy_from(next.col(0));
            orthonormalise(&mut w, i);
            let after = w.as_ref().subcols(i, 1).to_owned();
            change = distance(&after, &before, 0);
            most = most.max(iteration);
            if change <= options.tolerance {
                break;
            }
        }
        // Not a number is no rest either.
        if change.is_nan() || change > options.tolerance {
            let (iterations, tolerance) = (options.most_iterations, options.tolerance);
            return Err(IcaError::NotConverged { component: i, change, iterations, tolerance });
        }
    }
    Ok((w, most))
}

fn step_length(iteration: usize) -> f64 {
    0.5f64.powi(((iteration - 1) / PATIENCE).min(MOST_HALVINGS) as i32)
}

/// How far direction `i` moved, whatever its sign.
fn distance(a: &Mat<f64>, b: &Mat<f64>, i: usize) -> f64 {
    let (plus, minus) = a
        .col(i)
        .iter()
        .zip(b.col(i).iter())
        .fold((0.0, 0.0), |(plus, minus), (a, b)| (plus + (a + b) * (a + b), minus + (a - b) * (a - b)));
    f64::min(plus, minus).sqrt()
}

/// The orthogonal matrix nearest to `w`: `UVᵀ` of its singular value decomposition, the same as `(WWᵀ)^(−1/2) W`.
fn nearest_orthogonal(w: &Mat<f64>) -> Result<Mat<f64>, IcaError> {
    let svd = w.svd().map_err(|_| IcaError::Decomposition(w.nrows()))?;
    Ok(svd.U() * svd.V().transpose())
}

/// Make column `i` a unit vector orthogonal to the columns before it (twice is enough, once is not).
fn orthonormalise(w: &mut Mat<f64>, i: usize) {
    for _ in 0..2 {
        for j in 0..i {
            let along: f64 = (0..w.nrows()).map(|row| w[(row, i)] * w[(row, j)]).sum();
            for row in 0..w.nrows() {
                let other = w[(row, j)];
                w[(row, i)] -= along * other;
            }
        }
        let length = w.col(i).iter().map(|value| value * value).sum::<f64>().sqrt();
        w.col_mut(i).iter_mut().for_each(|value| *value /= length);
    }
}

/// Signs, order and scale.
fn in_order(
    z: &Mat<f64>,
    w: Mat<f64>,
    whitening: &Mat<f64>,
    mean: Vec<f64>,
    iterations: usize,
) -> IndependentComponents {
    let (k, n) = (w.ncols(), z.ncols() as f64);
    let y = w.transpose() * z;
    let moment = |i: usize, power: i32| y.row(i).iter().map(|value| value.powi(power)).sum::<f64>() / n;
    let skewness: Vec<f64> = (0..k).map(|i| moment(i, 3)).collect();
    let kurtosis: Vec<f64> = (0..k).map(|i| moment(i, 4) - 3.0).collect();
    let mut order: Vec<usize> = (0..k).collect();
    order.sort_by(|&a, &b| kurtosis[b].total_cmp(&kurtosis[a]));
    let sign = |i: usize| if skewness[i] < 0.0 { -1.0 } else { 1.0 };
    let rows = Mat::from_fn(k, k, |i, j| sign(order[i]) * w[(j, order[i])]);
    IndependentComponents {
        unmixing: rows * whitening,
        mean,
        kurtosis: order.iter().map(|&i| kurtosis[i]).collect(),
        skewness: order.iter().map(|&i| skewness[i].abs()).collect(),
        iterations,
    }
}
