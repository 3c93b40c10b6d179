//! Running sums over samples: all that least squares and ridge regression need to know of them.
//!
//! # Reference
//! Thesis §2.1.5; Chan, Golub & LeVeque 1983 (merging).

use faer::linalg::matmul::matmul;
use faer::linalg::matmul::triangular::{BlockStructure, matmul as triangular_matmul};
use faer::{Accum, Mat, MatRef, Par};

use super::error::{RegressionError, check_finite};
use super::function::{Bias, Linear};

/// Running sums over samples of `p` inputs and `q` targets.
///
/// The textbook keeps `C = Σxxᵀ` and `B = Σxtᵀ`. With a free bias, what matters is how inputs and targets vary about
/// their means, and subtracting `n x̄x̄ᵀ` at the end loses all digits where the mean is far from zero. So the sums are
/// kept *centred*: number, means, and `Σ(x − x̄)(x − x̄)ᵀ`, `Σ(x − x̄)(t − t̄)ᵀ`, `Σ(t − t̄)²`. Two of them merge
/// exactly: with `δ` the difference of the means, each centred sum gains `δδᵀ·nₐn_b/(nₐ + n_b)`.
///
/// Blocks of any size give the same sums up to rounding, and sums over different samples can be merged.
///
/// # Example
/// ```
/// use adagio::regression::{Bias, Sums, least_squares};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::regression::RegressionError> {
/// let x = Mat::<f64>::from_fn(2, 6, |i, j| (j * (i + 1) % 5) as f64);
/// let t = Mat::<f64>::from_fn(1, 6, |_, j| x[(0, j)] - 3.0 * x[(1, j)] + 4.0);
/// let mut sums = Sums::new(2, 1)?;
/// sums.add(x.as_ref().subcols(0, 2), t.as_ref().subcols(0, 2), Par::Seq)?;
/// let mut rest = Sums::new(2, 1)?;
/// rest.add(x.as_ref().subcols(2, 4), t.as_ref().subcols(2, 4), Par::Seq)?;
/// sums.merge(&rest)?;
///
/// let fit = least_squares(&sums, Bias::Free)?;
/// assert_eq!(sums.samples(), 6);
/// assert!((fit.weights[(1, 0)] + 3.0).abs() < 1e-12 && (fit.bias[0] - 4.0).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Sums {
    samples: usize,
    /// `x̄`, `p × 1`.
    input_mean: Mat<f64>,
    /// `t̄`, `q × 1`.
    target_mean: Mat<f64>,
    /// Lower triangle of `Σ(x − x̄)(x − x̄)ᵀ`, `p × p`.
    inputs: Mat<f64>,
    /// `Σ(x − x̄)(t − t̄)ᵀ`, `p × q`.
    cross: Mat<f64>,
    /// `Σ‖t − t̄‖²`.
    targets: f64,
}

/// `C` (both triangles) and `B` as a function class without or with a free bias sees them.
pub(super) struct Normal {
    pub c: Mat<f64>,
    pub b: Mat<f64>,
    /// An eigenvalue of `C` below this is rounding of the samples.
    pub floor: f64,
}

impl Sums {
    /// Sums over no samples of `inputs` values and `targets` values.
    ///
    /// # Errors
    /// Sizes whose sums no memory holds.
    pub fn new(inputs: usize, targets: usize) -> Result<Self, RegressionError> {
        check_size(inputs, targets)?;
        Ok(Sums {
            samples: 0,
            input_mean: Mat::zeros(inputs, 1),
            target_mean: Mat::zeros(targets, 1),
            inputs: Mat::zeros(inputs, inputs),
            cross: Mat::zeros(inputs, targets),
            targets: 0.0,
        })
    }

    /// Number of samples `n`.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Values per input, `p`.
    pub fn inputs(&self) -> usize {
        self.input_mean.nrows()
    }

    /// Values per target, `q`.
    pub fn targets(&self) -> usize {
        self.target_mean.nrows()
    }

    /// Add a block of samples.
    ///
    /// # Shapes
    /// `x: p × b`, `t: q × b`.
    ///
    /// # Errors
    /// Shapes that do not fit, values that are not finite; nothing is changed then.
    pub fn add(&mut self, x: MatRef<'_, f64>, t: MatRef<'_, f64>, par: Par) -> Result<(), RegressionError> {
        RegressionError::unless_fits("the length of an input", x.nrows(), self.inputs())?;
        RegressionError::unless_fits("the length of a target", t.nrows(), self.targets())?;
        RegressionError::unless_fits("the number of targets", t.ncols(), x.ncols())?;
        check_finite("input", x)?;
        check_finite("target", t)?;
        if x.ncols() == 0 {
            return Ok(());
        }
        let (input_mean, dx) = centre(x);
        let (target_mean, dt) = centre(t);
        let mut inputs = Mat::zeros(x.nrows(), x.nrows());
        triangular_matmul(
            inputs.as_mut(),
            BlockStructure::TriangularLower,
            Accum::Replace,
            dx.as_ref(),
            BlockStructure::Rectangular,
            dx.transpose(),
            BlockStructure::Rectangular,
            1.0,
            par,
        );
        let mut cross = Mat::zeros(x.nrows(), t.nrows());
        matmul(cross.as_mut(), Accum::Replace, dx.as_ref(), dt.transpose(), 1.0, par);
        let targets = (0..dt.ncols()).map(|j| dt.col(j).iter().map(|d| d * d).sum::<f64>()).sum();
        self.merge(&Sums { samples: x.ncols(), input_mean, target_mean, inputs, cross, targets })
    }

    /// Add the samples of other sums.
    ///
    /// # Errors
    /// Sums over inputs or targets of another size.
    pub fn merge(&mut self, other: &Sums) -> Result<(), RegressionError> {
        RegressionError::unless_fits("the length of an input", other.inputs(), self.inputs())?;
        RegressionError::unless_fits("the length of a target", other.targets(), self.targets())?;
        if other.samples == 0 {
            return Ok(());
        }
        let (mine, theirs) = (self.samples as f64, other.samples as f64);
        let share = theirs / (mine + theirs);
        let weight = mine * share;
        let dx = &other.input_mean - &self.input_mean;
        let dt = &other.target_mean - &self.target_mean;
        let (p, q) = (self.inputs(), self.targets());
        for j in 0..p {
            for i in j..p {
                self.inputs[(i, j)] += other.inputs[(i, j)] + weight * dx[(i, 0)] * dx[(j, 0)];
            }
        }
        for j in 0..q {
            for i in 0..p {
                self.cross[(i, j)] += other.cross[(i, j)] + weight * dx[(i, 0)] * dt[(j, 0)];
            }
            self.targets += weight * dt[(j, 0)] * dt[(j, 0)];
            self.target_mean[(j, 0)] += share * dt[(j, 0)];
        }
        for i in 0..p {
            self.input_mean[(i, 0)] += share * dx[(i, 0)];
        }
        self.targets += other.targets;
        self.samples += other.samples;
        Ok(())
    }

    /// Make room for inputs `inputs() .. p` that count as zero in all samples so far: what a growing dictionary needs.
    /// Never shrinks.
    ///
    /// # Errors
    /// A size whose sums no memory holds; nothing is changed then.
    pub fn widen(&mut self, p: usize) -> Result<(), RegressionError> {
        let p = p.max(self.inputs());
        check_size(p, self.targets())?;
        self.input_mean.resize_with(p, 1, |_, _| 0.0);
        self.inputs.resize_with(p, p, |_, _| 0.0);
        self.cross.resize_with(p, self.targets(), |_, _| 0.0);
        Ok(())
    }

    /// The sums over the first `p` inputs only (all of them, if there are fewer): those of the first `p` support
    /// vectors, if the inputs are Newton coordinates.
    pub fn leading(&self, p: usize) -> Sums {
        let p = p.min(self.inputs());
        Sums {
            samples: self.samples,
            input_mean: self.input_mean.as_ref().subrows(0, p).to_owned(),
            target_mean: self.target_mean.clone(),
            inputs: self.inputs.as_ref().submatrix(0, 0, p, p).to_owned(),
            cross: self.cross.as_ref().subrows(0, p).to_owned(),
            targets: self.targets,
        }
    }

    /// The mean squared error `Σ‖y(x) − t‖²/n` of a function on the samples in the sums: its training error, if it was
    /// fitted to them, and its test error, if it was not.
    ///
    /// It is a difference of sums, so an error far below the targets' variance has an accuracy of 1e-16 of that
    /// variance.
    ///
    /// # Errors
    /// A function of another size; no samples; an error too large for `f64`.
    pub fn mean_squared_error(&self, function: &Linear) -> Result<f64, RegressionError> {
        RegressionError::unless_fits("the number of rows of W", function.weights.nrows(), self.inputs())?;
        RegressionError::unless_fits("the number of columns of W", function.weights.ncols(), self.targets())?;
        RegressionError::unless_fits("the length of the bias", function.bias.len(), self.targets())?;
        if self.samples == 0 {
            return Err(RegressionError::NoSamples);
        }
        let w = &function.weights;
        let spread = symmetric(&self.inputs) * w;
        let (mut sum, mut offset) = (self.targets, 0.0);
        for j in 0..self.targets() {
            let mut miss = self.target_mean[(j, 0)] - function.bias[j];
            for i in 0..self.inputs() {
                sum += w[(i, j)] * (spread[(i, j)] - 2.0 * self.cross[(i, j)]);
                miss -= w[(i, j)] * self.input_mean[(i, 0)];
            }
            offset += miss * miss;
        }
        let error = if sum < 0.0 { 0.0 } else { sum / self.samples as f64 } + offset;
        if error.is_finite() { Ok(error) } else { Err(RegressionError::Overflow("the mean squared error")) }
    }

    /// `C` and `B` about the means (free bias) or about zero (none).
    pub(super) fn normal(&self, bias: Bias) -> Result<Normal, RegressionError> {
        if self.samples == 0 {
            return Err(RegressionError::NoSamples);
        }
        let n = self.samples as f64;
        let (x, t) = (&self.input_mean, &self.target_mean);
        let mut c = symmetric(&self.inputs);
        let mut b = self.cross.clone();
        let far = n * (0..self.inputs()).map(|i| x[(i, 0)] * x[(i, 0)]).sum::<f64>();
        let floor = match bias {
            // A deviation from the mean is rounded to 2⁻⁵² of the mean; 4 of these, squared, in each sample.
            Bias::Free => 16.0 * f64::EPSILON * f64::EPSILON * far,
            Bias::None => {
                c += x * x.transpose() * faer::Scale(n);
                b += x * t.transpose() * faer::Scale(n);
                0.0
            }
        };
        if c.is_all_finite() && b.is_all_finite() && floor.is_finite() {
            Ok(Normal { c, b, floor })
        } else {
            Err(RegressionError::Overflow("the sums of squares"))
        }
    }

    /// The bias that makes the mean prediction the mean target.
    pub(super) fn free_bias(&self, weights: MatRef<'_, f64>) -> Vec<f64> {
        let predicted = weights.transpose() * &self.input_mean;
        (0..self.targets()).map(|j| self.target_mean[(j, 0)] - predicted[(j, 0)]).collect()
    }
}

fn check_size(inputs: usize, targets: usize) -> Result<(), RegressionError> {
    RegressionError::unless_stored("a sum of targets", targets, 1)?;
    RegressionError::unless_stored("a sum of products", inputs, inputs.max(targets))
}

/// Mean of the columns, and the columns minus it.
fn centre(matrix: MatRef<'_, f64>) -> (Mat<f64>, Mat<f64>) {
    let n = matrix.ncols() as f64;
    let mean = Mat::from_fn(matrix.nrows(), 1, |i, _| matrix.row(i).iter().sum::<f64>() / n);
    let rest = Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] - mean[(i, 0)]);
    (mean, rest)
}

/// Both triangles of a symmetric matrix whose lower triangle is given.
fn symmetric(lower: &Mat<f64>) -> Mat<f64> {
    Mat::from_fn(lower.nrows(), lower.ncols(), |i, j| lower[(i.max(j), i.min(j))])
}
