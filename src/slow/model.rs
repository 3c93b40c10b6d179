//! Slow features in the form in which they are used: `φ(x) = [1, Aᵀk(x) − c]`.

use std::sync::Arc;

use faer::linalg::matmul::matmul;
use faer::linalg::triangular_solve::solve_upper_triangular_in_place;
use faer::{Accum, Mat, MatRef, Par};

use super::error::SlowError;
use super::solve::SlowFeatures;
use crate::dictionary::{Dictionary, FeatureMap};
use crate::kernel::{Kernel, Scalar, squared_norms};

/// Slow features over the support vectors of one moment, independent of the dictionary's further growth.
#[derive(Debug, Clone, PartialEq)]
pub struct SlowModel<T: Scalar> {
    /// The kernel.
    pub kernel: Kernel,
    /// Support vectors, `d × m`.
    pub members: Arc<Mat<T>>,
    /// `A = L⁻ᵀW`, `m × k`.
    pub projection: Mat<f64>,
    /// `c = Wᵀv̄`, `k`.
    pub offset: Vec<f64>,
    /// Slowness of each feature on the training frames, ascending, `k`.
    pub slowness: Vec<f64>,
    norms: Vec<f64>,
}

impl<T: Scalar> SlowModel<T> {
    /// The runtime form of features that were solved over `dictionary`.
    ///
    /// # Errors
    /// Features (weights or mean) with another number of coordinates than the dictionary has support vectors.
    pub fn new(dictionary: &Dictionary<T>, features: &SlowFeatures) -> Result<Self, SlowError> {
        SlowError::unless_fits("the number of coordinates", features.weights.nrows(), dictionary.len())?;
        SlowError::unless_fits("the number of mean coordinates", features.mean.nrows(), dictionary.len())?;
        SlowError::unless_fits("the number of means", features.mean.ncols(), 1)?;
        let mut projection = features.weights.clone();
        solve_upper_triangular_in_place(dictionary.factor().transpose(), projection.as_mut(), Par::Seq);
        let centre = features.weights.transpose() * &features.mean;
        Self::from_parts(
            dictionary.kernel(),
            dictionary.members().to_owned(),
            projection,
            (0..centre.nrows()).map(|i| centre[(i, 0)]).collect(),
            features.slowness.clone(),
        )
    }

    /// Weights `W` of the same features over the support vectors of another dictionary, which may have lost some of the
    /// model's: the orthogonal projection onto the functions that it spans. At a support vector of both, `wᵀv` is the same.
    ///
    /// With `Σⱼ aⱼ k(sⱼ, ·)` a feature, that is `V a` with the Newton coordinates `V` of the model's support vectors.
    ///
    /// # Shapes
    /// The result is `m′ × k` for a dictionary of `m′` support vectors.
    ///
    /// # Errors
    /// A dictionary of another kernel, or with support vectors of another length.
    pub fn weights_over(&self, dictionary: &Dictionary<T>) -> Result<Mat<f64>, SlowError> {
        if dictionary.kernel() != self.kernel {
            return Err(SlowError::OtherKernel { model: self.kernel, dictionary: dictionary.kernel() });
        }
        Ok(dictionary.coordinates(self.members.as_ref().as_ref())? * &self.projection)
    }

    /// A model from its stored parts.
    ///
    /// # Shapes
    /// `members: d × m`, `projection: m × k`, `offset: k`, `slowness: k`.
    ///
    /// # Errors
    /// Shapes that do not fit.
    pub fn from_parts(
        kernel: Kernel,
        members: Mat<T>,
        projection: Mat<f64>,
        offset: Vec<f64>,
        slowness: Vec<f64>,
    ) -> Result<Self, SlowError> {
        SlowError::unless_fits("the length of the slowness", slowness.len(), projection.ncols())?;
        let norms = squared_norms(members.as_ref());
        let model = SlowModel { kernel, members: Arc::new(members), projection, offset, slowness, norms };
        model.check()?;
        Ok(model)
    }

    /// Refuse parts that do not fit each other: all but the norms can be exchanged from outside.
    fn check(&self) -> Result<(), SlowError> {
        SlowError::unless_fits("the number of rows of A", self.projection.nrows(), self.members.ncols())?;
        SlowError::unless_fits("the length of c", self.offset.len(), self.projection.ncols())
    }

    /// The features as a space to judge observations in, for [`FeatureAld`](crate::dictionary::FeatureAld).
    pub fn feature_map(&self) -> FeatureMap<T> {
        let model = self.clone();
        FeatureMap::new(move |x| model.apply(x, Par::Seq).map_err(|error| error.to_string()))
    }

    /// Squared norms of the support vectors, `m`.
    pub fn norms(&self) -> &[f64] {
        &self.norms
    }

    /// Number of features, the constant one included: `k + 1`.
    pub fn features(&self) -> usize {
        self.offset.len() + 1
    }

    /// Features of observations: `x: d × n` gives `(k + 1) × n`; the first row is the constant feature 1.
    ///
    /// # Errors
    /// Observations of another length than the support vectors.
    pub fn apply(&self, x: MatRef<'_, T>, par: Par) -> Result<Mat<f64>, SlowError> {
        self.apply_to_rows(self.kernel_rows(x, par)?.as_ref(), par)
    }

    /// Kernel rows `k(x)`: `x: d × n` gives `m × n`.
    ///
    /// # Errors
    /// Observations of another length than the support vectors.
    pub fn kernel_rows(&self, x: MatRef<'_, T>, par: Par) -> Result<Mat<f64>, SlowError> {
        Ok(self.kernel.matrix(self.members.as_ref().as_ref(), &self.norms, x, &squared_norms(x), par)?)
    }

    /// Linear functions of the features as functions of the kernel values: `(B, c)` with `Wᵀφ(x) = Bᵀk(x) + c`.
    ///
    /// Whoever needs the functions alone saves the features, `m × k` operations for each observation. The two forms are
    /// equal up to rounding.
    ///
    /// # Shapes
    /// `weights: (k + 1) × r` gives `m × r` and `r` constants.
    ///
    /// # Errors
    /// Weights for another number of features.
    pub fn over_kernel_values(&self, weights: MatRef<'_, f64>) -> Result<(Mat<f64>, Vec<f64>), SlowError> {
        self.check()?;
        SlowError::unless_fits("the number of features that have weights", weights.nrows(), self.features())?;
        let others = weights.subrows(1, self.offset.len());
        let centre = |j: usize| others.col(j).iter().zip(&self.offset).map(|(w, c)| w * c).sum::<f64>();
        let constants = (0..weights.ncols()).map(|j| weights[(0, j)] - centre(j)).collect();
        Ok((&self.projection * others, constants))
    }

    /// Features from kernel rows: `m × n` gives `(k + 1) × n`.
    ///
    /// # Errors
    /// Rows of another number of support vectors.
    pub fn apply_to_rows(&self, rows: MatRef<'_, f64>, par: Par) -> Result<Mat<f64>, SlowError> {
        self.slowest_of_rows(rows, self.offset.len(), par)
    }

    /// The constant and the `k` slowest features, or as many as there are, from kernel rows: `m × n` gives `(k + 1) × n`.
    ///
    /// # Errors
    /// Those of [`apply_to_rows`](SlowModel::apply_to_rows).
    pub fn slowest_of_rows(&self, rows: MatRef<'_, f64>, k: usize, par: Par) -> Result<Mat<f64>, SlowError> {
        self.check()?;
        SlowError::unless_fits("the number of kernel values", rows.nrows(), self.members.ncols())?;
        let k = k.min(self.offset.len());
        let mut phi = Mat::from_fn(k + 1, rows.ncols(), |i, _| if i == 0 { 1.0 } else { -self.offset[i - 1] });
        let projection = self.projection.as_ref().subcols(0, k).transpose();
        matmul(phi.as_mut().subrows_mut(1, k), Accum::Add, projection, rows, 1.0, par);
        Ok(phi)
    }
}
