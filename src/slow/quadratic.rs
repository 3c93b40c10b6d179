//! Quadratic forms: what a quadratic feature responds to.

use faer::{Mat, MatRef, Side};

use super::error::SlowError;
use super::expansion::{Expansion, Pca};
use super::linear::LinearSfa;

/// A quadratic form `q(x) = ½xᵀHx + fᵀx + c`.
///
/// ```
/// use adagio::slow::QuadraticForm;
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// // q = x₁² + x₂: on the circle of radius 1 largest where 2x₁ = λx₁, 1 = λx₂.
/// let h = Mat::from_fn(2, 2, |i, j| [[2.0, 0.0], [0.0, 0.0]][i][j]);
/// let form = QuadraticForm::new(h, vec![0.0, 1.0], 0.0)?;
/// let best = form.largest_at(1.0)?;
/// assert!((best[1] - 0.5).abs() < 1e-9 && (form.at(&best) - 1.25).abs() < 1e-9);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Berkes & Wiskott, *On the analysis and interpretation of inhomogeneous quadratic forms as receptive fields*, Neural Computation
/// 18 (2006).
#[derive(Debug, Clone, PartialEq)]
pub struct QuadraticForm {
    /// `H`, symmetric, `n × n`.
    pub h: Mat<f64>,
    /// `f`, `n`.
    pub f: Vec<f64>,
    /// `c`.
    pub c: f64,
}

impl QuadraticForm {
    /// The form with these coefficients; of `h` the lower triangle is read.
    ///
    /// # Errors
    /// Sizes that do not fit, values that are not finite.
    pub fn new(h: Mat<f64>, f: Vec<f64>, c: f64) -> Result<Self, SlowError> {
        SlowError::unless_fits("the matrix H of a quadratic form", h.nrows(), f.len())?;
        SlowError::unless_fits("the number of columns of H", h.ncols(), f.len())?;
        let h = Mat::from_fn(f.len(), f.len(), |i, j| h[(i.max(j), i.min(j))]);
        SlowError::unless_finite("the coefficients of a quadratic form are", h.as_ref())?;
        if f.iter().chain([&c]).any(|value| !value.is_finite()) {
            return Err(SlowError::NotFinite("the coefficients of a quadratic form are"));
        }
        Ok(QuadraticForm { h, f, c })
    }

    /// A feature of linear SFA over the quadratic monomials of principal components, as a form of the components before they are scaled to
    /// variance 1: coordinates in an orthonormal basis of what the components see, with the mean at 0.
    ///
    /// # Errors
    /// No such feature, weights that are not those of so many components.
    pub fn of_feature(sfa: &LinearSfa, pca: &Pca, feature: usize) -> Result<Self, SlowError> {
        if feature >= sfa.outputs() {
            return Err(SlowError::Features { asked: feature + 1, rank: sfa.outputs() });
        }
        let r = pca.outputs();
        let monomials = Expansion::Quadratic.monomials(r)?;
        SlowError::unless_fits("the number of weights of a quadratic feature", sfa.inputs(), monomials.len())?;
        // A whitened component is the plain one times the length of its column, which is 1 where nothing was scaled.
        let scale: Vec<f64> = (0..r).map(|i| pca.projection.col(i).norm_l2()).collect();
        let (mut h, mut f) = (Mat::zeros(r, r), vec![0.0; r]);
        for (row, factors) in monomials.iter().enumerate() {
            let weight = sfa.weights[(row, feature)] * factors.iter().map(|&i| scale[i]).product::<f64>();
            match factors[..] {
                [i] => f[i] = weight,
                [i, j] => h[(j, i)] = if i == j { 2.0 * weight } else { weight },
                _ => {}
            }
        }
        QuadraticForm::new(h, f, -sfa.offset()[feature])
    }

    /// Its value.
    ///
    /// # Panics
    /// If `x` has not as many values as `f`.
    pub fn at(&self, x: &[f64]) -> f64 {
        assert_eq!(x.len(), self.f.len(), "the values of a quadratic form");
        let along = |i: usize| (0..x.len()).map(|j| self.h[(i, j)] * x[j]).sum::<f64>() / 2.0 + self.f[i];
        (0..x.len()).map(|i| x[i] * along(i)).sum::<f64>() + self.c
    }

    /// The form with all signs changed.
    pub fn negative(&self) -> Self {
        QuadraticForm { h: -&self.h, f: self.f.iter().map(|value| -value).collect(), c: -self.c }
    }

    /// Where the form is largest on the sphere of this radius: the *optimal excitatory stimulus*, of [`negative`](QuadraticForm::negative)
    /// the optimal inhibitory one.
    ///
    /// It is `(λI − H)⁻¹f` for the λ, above all eigenvalues of `H`, that gives the radius; if `f` has nothing along the first
    /// eigenvectors and this stays too short, what is missing lies along the first of them.
    ///
    /// # Errors
    /// A radius that is not positive and finite, no values, eigenvalues that do not converge.
    pub fn largest_at(&self, radius: f64) -> Result<Vec<f64>, SlowError> {
        if !(radius > 0.0 && radius.is_finite()) {
            return Err(SlowError::Radius(radius));
        }
        if self.f.is_empty() {
            return Err(SlowError::Empty("the list of values of a quadratic form is"));
        }
        let n = self.f.len();
        let eigen = self.h.self_adjoint_eigen(Side::Lower).map_err(|_| SlowError::Eigenvalues(n))?;
        let (u, values) = (eigen.U(), eigen.S().column_vector());
        let along: Vec<f64> = (0..n).map(|i| (0..n).map(|j| u[(j, i)] * self.f[j]).sum()).collect();
        let top = values[n - 1];
        let size = along.iter().fold(0.0, |sum: f64, value| sum.hypot(*value));
        // Gaps to the first eigenvalue, and the length of what a distance λ − top gives.
        let gap = |i: usize| top - values[i];
        let length = |above: f64| (0..n).fold(0.0, |sum: f64, i| sum.hypot(along[i] / (above + gap(i))));
        let scale = values[0].abs().max(top.abs()) + size / radius;
        // As far above the first eigenvalue as `f` alone would need, the length is at most the radius.
        let (mut low, mut high) = (f64::EPSILON * scale, size / radius);
        let mut y = vec![0.0; n];
        if high <= low || length(low) <= radius {
            for i in (0..n).filter(|&i| gap(i) > 1e-12 * scale) {
                y[i] = along[i] / gap(i);
            }
            let rest = (radius * radius - y.iter().map(|value| value * value).sum::<f64>()).max(0.0).sqrt();
            y[n - 1] = rest.copysign(along[n - 1]);
        } else {
            while high > low * (1.0 + 4.0 * f64::EPSILON) {
                // In the middle of their orders of magnitude, as the smallest may be tiny.
                let middle = (low * high).sqrt();
                if middle <= low || middle >= high {
                    break;
                }
                if length(middle) > radius { low = middle } else { high = middle }
            }
            (0..n).for_each(|i| y[i] = along[i] / (high + gap(i)));
        }
        let found: Vec<f64> = (0..n).map(|j| (0..n).map(|i| u[(j, i)] * y[i]).sum()).collect();
        let norm = found.iter().fold(0.0, |sum: f64, value| sum.hypot(*value));
        Ok(found.into_iter().map(|value| value * radius / norm).collect())
    }

    /// The directions on the sphere along which the form changes least around an extremum `x`, least first: unit vectors at right angles
    /// to `x`, one a column, and the second derivatives along them.
    ///
    /// # Errors
    /// Another number of values, an `x` of length 0, eigenvalues that do not converge.
    pub fn invariances(&self, x: &[f64]) -> Result<(Vec<f64>, Mat<f64>), SlowError> {
        let n = self.f.len();
        SlowError::unless_fits("the extremum", x.len(), n)?;
        let norm = x.iter().fold(0.0, |sum: f64, value| sum.hypot(*value));
        if norm == 0.0 {
            return Err(SlowError::Radius(0.0));
        }
        let x = Mat::from_fn(n, 1, |i, _| x[i]);
        let f = Mat::from_fn(n, 1, |i, _| self.f[i]);
        // The sphere bends away from its tangents.
        let bend = (x.transpose() * (&self.h * &x) + x.transpose() * f)[(0, 0)] / (norm * norm);
        let tangents = tangents(x.as_ref());
        let inner = tangents.transpose() * &self.h * &tangents;
        let eigen = inner.self_adjoint_eigen(Side::Lower).map_err(|_| SlowError::Eigenvalues(n - 1))?;
        let second: Vec<f64> = (0..n - 1).map(|i| eigen.S()[i] - bend).collect();
        let mut order: Vec<usize> = (0..n - 1).collect();
        order.sort_by(|&a, &b| second[a].abs().total_cmp(&second[b].abs()));
        let directions = tangents * eigen.U();
        let columns = Mat::from_fn(n, n - 1, |i, j| directions[(i, order[j])]);
        Ok((order.iter().map(|&i| second[i]).collect(), columns))
    }
}

/// An orthonormal basis of what is at right angles to a vector, `n × (n − 1)`.
fn tangents(x: MatRef<'_, f64>) -> Mat<f64> {
    let n = x.nrows();
    let q = x.qr().compute_Q();
    q.subcols(1, n - 1).to_owned()
}
