//! Kernel recursive least squares: a function of the kernel's space that is up to date after every sample.
//!
//! # Reference
//! Engel, Mannor & Meir, *The kernel recursive least-squares algorithm*, IEEE Trans. Signal Processing 52(8), 2004;
//! Golub & Van Loan, *Matrix Computations*, 2013, §6.5.3 (adding rows to a QR factorisation).

use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Mat, MatRef, Par};

use super::error::{RegressionError, check_finite};
use super::function::Linear;
use super::kernel::KernelModel;
use crate::dictionary::{Ald, Dictionary, Parameters, Selection, Thinning};
use crate::kernel::{KernelError, Scalar, finite_norms};

/// Kernel recursive least squares over a growing dictionary.
///
/// The dictionary decides by approximate linear dependence whether a sample becomes a support vector. The samples'
/// Newton coordinates `v` enter a recursive least squares problem, `minimise Σ(wᵀv − t)²`, without regulariser. When a
/// support vector is accepted, older samples count as zero in the new coordinate. That is what Engel, Mannor & Meir do:
/// they pad the coefficients `a = K⁻¹k(x)` of older samples with zeros, and since `v = Lᵀa` with a lower triangular `L`
/// that grows by a row, this pads `v` with zeros too.
///
/// They carry the inverse `P = (Σaaᵀ)⁻¹`, from which each sample subtracts; its errors add up. Here its triangular
/// factor is carried instead, `ΛΛᵀ = Σvvᵀ`, and each sample is rotated into it (Givens rotations): same result, no
/// subtraction, and a new coordinate is just a row of zeros before the rotation.
///
/// # Example
/// ```
/// use adagio::dictionary::{Parameters, WhenFull};
/// use adagio::kernel::Kernel;
/// use adagio::regression::KernelRls;
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let kernel = Kernel::gaussian(1.0)?;
/// let parameters = Parameters { kernel, nu: 1e-3, budget: 100, when_full: WhenFull::Stop, par: Par::Seq };
/// let mut rls = KernelRls::<f64>::new(parameters, 1)?;
/// let x = Mat::<f64>::from_fn(1, 500, |_, j| (0.7 * j as f64) % 6.0);
/// let t = Mat::<f64>::from_fn(1, 500, |_, j| x[(0, j)].cos());
/// // Each prediction is made before its target is learned.
/// let predicted = rls.observe(x.as_ref(), t.as_ref())?;
/// assert_eq!(predicted[(0, 0)], 0.0);
/// assert!((predicted[(0, 499)] - t[(0, 499)]).abs() < 0.01);
/// assert!(rls.dictionary().len() < 15);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct KernelRls<T: Scalar> {
    selection: Ald<T>,
    samples: usize,
    /// Lower triangle holds `Λ`, `m × m`.
    factor: Mat<f64>,
    /// `Λ⁻¹Σvtᵀ`, transposed: `q × m`.
    rotated: Mat<f64>,
    /// `W`, `m × q`.
    weights: Mat<f64>,
    /// `Σ(Wᵀv − t)²` over the samples, their padded coordinates in place of what they would have been.
    squared_error: f64,
}

impl<T: Scalar> KernelRls<T> {
    /// A function to `targets` values that is zero everywhere, over an empty dictionary.
    ///
    /// # Errors
    /// Parameters that the dictionary refuses, more targets than can be stored.
    pub fn new(parameters: Parameters, targets: usize) -> Result<Self, RegressionError> {
        RegressionError::unless_stored("the targets of a sample", targets, 1)?;
        Ok(KernelRls {
            selection: Ald::new(parameters)?,
            samples: 0,
            factor: Mat::new(),
            rotated: Mat::zeros(targets, 0),
            weights: Mat::zeros(0, targets),
            squared_error: 0.0,
        })
    }

    /// Learn from samples, one after the other in their order; the predictions made for each before its target was
    /// learned (*a priori*).
    ///
    /// # Shapes
    /// `x: d × b`, `t: q × b`; the result is `q × b`.
    ///
    /// # Errors
    /// Shapes that do not fit, or values that are not finite; nothing is changed then. A function or a prediction too
    /// large for `f64`; the samples up to there are learned then.
    pub fn observe(&mut self, x: MatRef<'_, T>, t: MatRef<'_, f64>) -> Result<Mat<f64>, RegressionError> {
        RegressionError::unless_fits("the length of a target", t.nrows(), self.weights.ncols())?;
        RegressionError::unless_fits("the number of targets", t.ncols(), x.ncols())?;
        if !self.dictionary().is_empty() {
            let expected = self.dictionary().members().nrows();
            RegressionError::unless_fits("the length of an observation", x.nrows(), expected)?;
        }
        check_finite("target", t)?;
        let kernel = self.dictionary().kernel();
        // By Cauchy–Schwarz no kernel value is larger than the largest k(x, x).
        if finite_norms("observation", x)?.iter().any(|&norm| !kernel.diagonal(norm).is_finite()) {
            return Err(KernelError::Overflow.into());
        }
        let mut predictions = Mat::zeros(t.nrows(), t.ncols());
        for j in 0..x.ncols() {
            let before = self.dictionary().len();
            let block = self.selection.observe(x.subcols(j, 1))?;
            let v = block.coordinates;
            for (k, prediction) in predictions.col_mut(j).iter_mut().enumerate() {
                *prediction = (0..before).map(|i| self.weights[(i, k)] * v[(i, 0)]).sum();
            }
            self.learn((0..v.nrows()).map(|i| v[(i, 0)]).collect(), t.col(j).iter().copied().collect());
            if let Some(thinning) = self.selection.thin()? {
                self.follow(&thinning)?;
            }
            self.solve()?;
        }
        if predictions.is_all_finite() { Ok(predictions) } else { Err(RegressionError::Overflow("a prediction")) }
    }

    fn learn(&mut self, v: Vec<f64>, t: Vec<f64>) {
        let (m, q) = (v.len(), t.len());
        self.factor.resize_with(m, m, |_, _| 0.0);
        self.rotated.resize_with(q, m, |_, _| 0.0);
        self.rotate(v, t);
        self.samples += 1;
    }

    /// Rotate a sample into the factor.
    fn rotate(&mut self, mut v: Vec<f64>, mut t: Vec<f64>) {
        for i in 0..v.len() {
            if v[i] == 0.0 {
                continue;
            }
            let length = self.factor[(i, i)].hypot(v[i]);
            let (cosine, sine) = (self.factor[(i, i)] / length, v[i] / length);
            for (kept, row) in self.factor.col_mut(i).iter_mut().zip(&mut v).skip(i) {
                (*kept, *row) = (cosine * *kept + sine * *row, cosine * *row - sine * *kept);
            }
            for (kept, row) in self.rotated.col_mut(i).iter_mut().zip(&mut t) {
                (*kept, *row) = (cosine * *kept + sine * *row, cosine * *row - sine * *kept);
            }
        }
        // What no rotation could take up is the sample's part in the least squared error.
        self.squared_error += t.iter().map(|rest| rest * rest).sum::<f64>();
    }

    /// Follow a dictionary that lost support vectors: with `TΛ = Λ′Q`, the right-hand side becomes `Q` times itself.
    fn follow(&mut self, thinning: &Thinning) -> Result<(), RegressionError> {
        let qr = thinning.apply(self.factor.as_ref())?.transpose().qr();
        let rotated = &self.rotated * qr.compute_thin_Q();
        self.squared_error += (self.rotated.squared_norm_l2() - rotated.squared_norm_l2()).max(0.0);
        self.factor = qr.thin_R().transpose().to_owned();
        self.rotated = rotated;
        // Where members of very different size leave, of a coordinate only rounding may be left beside what the
        // coordinates before it explain. No sample speaks for it then: its column's rest goes to the later coordinates.
        let m = self.factor.nrows();
        for i in 0..m {
            let rounding = m as f64 * f64::EPSILON * self.factor.row(i).subcols(0, i + 1).norm_l2();
            if self.factor[(i, i)].abs() <= rounding {
                self.factor[(i, i)] = 0.0;
                let v = self.factor.col(i).iter().copied().collect();
                let t = self.rotated.col(i).iter().copied().collect();
                self.factor.col_mut(i).fill(0.0);
                self.rotated.col_mut(i).fill(0.0);
                self.rotate(v, t);
            }
        }
        Ok(())
    }

    /// The weights; zero for a coordinate that no sample speaks for.
    fn solve(&mut self) -> Result<(), RegressionError> {
        self.weights = self.rotated.transpose().to_owned();
        let m = self.factor.nrows();
        if (0..m).all(|i| self.factor[(i, i)] != 0.0) {
            solve_upper_triangular_in_place(self.factor.transpose(), self.weights.as_mut(), Par::Seq);
        } else {
            // Column and right-hand side of such a coordinate are zero: any pivot gives the weight zero.
            let pivot = |i, j, value| if i == j && value == 0.0 { 1.0 } else { value };
            let factor = Mat::from_fn(m, m, |i, j| pivot(i, j, self.factor[(i, j)]));
            solve_upper_triangular_in_place(factor.transpose(), self.weights.as_mut(), Par::Seq);
        }
        if self.weights.is_all_finite() { Ok(()) } else { Err(RegressionError::Overflow("the weights")) }
    }

    /// The mean squared error of the function over all samples so far, with each sample's coordinates as they were when
    /// it came and zero for later ones; 0 before the first.
    pub fn training_error(&self) -> f64 {
        if self.samples == 0 { 0.0 } else { self.squared_error / self.samples as f64 }
    }

    /// The support vectors.
    pub fn dictionary(&self) -> &Dictionary<T> {
        self.selection.dictionary()
    }

    /// The weights `W` of the Newton coordinates, `m × q`.
    pub fn weights(&self) -> MatRef<'_, f64> {
        self.weights.as_ref()
    }

    /// The function as it is now, for use on its own.
    pub fn model(&self) -> KernelModel<T> {
        let function = Linear {
            weights: self.weights.clone(),
            bias: vec![0.0; self.weights.ncols()],
            parameters: self.weights.nrows() as f64,
        };
        KernelModel::over(self.dictionary(), &function).expect("there is one weight for each support vector")
    }
}
