//! The eigenvalue problem of the covariance in a kernel's space: kernel PCA, exactly or from a subset of support
//! vectors.
//!
//! # Reference
//! Thesis §2.2.4, §2.2.5; Schölkopf, Smola & Müller 1998 (kernel PCA); Williams & Seeger 2001 (Nyström).

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Side};

use super::error::KernelError;
use super::function::Kernel;
use super::matrix::{Scalar, finite_norms};

/// How the eigenvalue problem of all samples is approximated by one of the size of the support vectors.
///
/// With every sample as support vector, each of them is exact.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Approximation {
    /// *Subset of data*: kernel PCA of the support vectors alone. The other samples are not looked at.
    SubsetOfData,
    /// *Nyström*: the eigenvectors of the support vectors' centred kernel matrix, extended to all samples by
    /// `φ(x) = Aᵀk(x) − c`. The centre `c` and the variances are those over all samples; the directions are those of
    /// the subset, so the projections of all samples are only approximately uncorrelated.
    Nystrom,
    /// *Projected process*: among all functions that the support vectors span, those of the largest variance over all
    /// samples.
    ///
    /// In an orthonormal basis of that span – the Newton coordinates `v(x) = L⁻¹k(x)` with `K_S = LLᵀ` are one – this
    /// is ordinary PCA of the samples' coordinates: eigenvectors of `L⁻¹(K̂HK̂ᵀ/n)L⁻ᵀ`. It uses all of `K̂`, its
    /// projections are uncorrelated over all samples, and no other choice in the span explains more variance.
    ///
    /// The thesis takes the eigenvectors of `K̂K̂ᵀ` itself and the roots of its eigenvalues. After centring, this is no
    /// longer exact even if all samples are support vectors, because the eigenvectors of `KHK` are not those of `HKH`;
    /// the metric `K_S` repairs it. (Its listing also centres `K̂K̂ᵀ`, `m × m`, by an `n × n` operator: right is
    /// `K̂HK̂ᵀ = K̂K̂ᵀ − n k̄k̄ᵀ`.)
    ProjectedProcess,
}

/// The scale of the projections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scaling {
    /// Coordinates along unit vectors of the kernel's space: their variances are the eigenvalues of the covariance.
    Principal,
    /// Every projection has variance 1 over the samples (whitening).
    UnitVariance,
}

/// Principal components in a kernel's space, in the form in which they are used: `φ(x) = Aᵀk(x) − c`.
///
/// Symbols: samples `X` (`d × n`), support vectors `S` (`d × m`), `ψ(x)` the image of `x` in the kernel's space, `K`
/// the kernel matrix of all samples, `K_S` that of the support vectors, `K̂ = k(S, X)` (`m × n`), `k(x)` the kernel
/// values of `x` with `S`, `k̄` their mean over the samples, and `H = I − 11ᵀ/n`, which subtracts a mean.
///
/// **Exact.** The covariance of the centred images has the eigenvalues `λ/n`, where `HKH = VΛVᵀ`, and the unit
/// eigenvectors `Σᵢ aᵢψ(xᵢ)` with `a = H v/√λ`. So the projection of any observation is `φ(x) = Aᵀk(x) − c`, where
/// `A = HVΛ^(−1/2)` and `c = Aᵀk̄`, and its variance over the samples is `λ/n`.
///
/// The thesis's equation for this projection has a factor `√n` too many, which gives neither the projection on unit
/// vectors nor unit variance (that is `A·√n Λ^(−1/2)`), and its runtime form leaves out the centring, `c` here.
///
/// **Approximations** make do with `m` support vectors; see [`Approximation`].
///
/// # Example
/// ```
/// use adagio::kernel::{Kernel, KernelPca, Scaling};
/// use faer::{Mat, Par};
///
/// # fn main() -> Result<(), adagio::kernel::KernelError> {
/// // With the linear kernel it is ordinary PCA: four points on the line (3, 4)·s, s = −2, −1, 1, 2.
/// let x = Mat::<f64>::from_fn(2, 4, |i, j| [3.0, 4.0][i] * [-2.0, -1.0, 1.0, 2.0][j]);
/// let pca = KernelPca::exact(Kernel::linear(), x.as_ref(), 1, Scaling::Principal, Par::Seq)?;
/// // Distances from the centre are 10, 5, 5, 10: variance (100 + 25 + 25 + 100)/4.
/// assert!((pca.variances()[0] - 62.5).abs() < 1e-10);
/// let projected = pca.apply(x.as_ref(), Par::Seq)?;
/// assert!((projected[(0, 3)].abs() - 10.0).abs() < 1e-10);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct KernelPca<T: Scalar> {
    kernel: Kernel,
    /// Support vectors `S`, `d × m`.
    members: Mat<T>,
    norms: Vec<f64>,
    /// `A`, `m × k`.
    projection: Mat<f64>,
    /// `c = Aᵀk̄`, `k`.
    offset: Vec<f64>,
    /// Variances of the unscaled projections, `k`.
    variances: Vec<f64>,
}

/// Eigenvalues below this share of the trace of the kernel matrix are directions without variance: rounding of a kernel
/// matrix changes eigenvalues by about m·2⁻⁵³ of it, which is this much for m = 9000.
const RANK_TOLERANCE: f64 = 1e-12;

impl<T: Scalar> KernelPca<T> {
    /// The first `components` principal components of the samples, exactly. Takes `O(n²)` memory and `O(n³)` time.
    ///
    /// # Shapes
    /// `x: d × n`, the samples.
    ///
    /// # Errors
    /// As [`KernelPca::approximate`].
    pub fn exact(
        kernel: Kernel,
        x: MatRef<'_, T>,
        components: usize,
        scaling: Scaling,
        par: Par,
    ) -> Result<Self, KernelError> {
        Self::approximate(kernel, x, x, Approximation::SubsetOfData, components, scaling, par)
    }

    /// The first `components` principal components of the samples, over support vectors. Takes `O(mn)` memory and
    /// `O(m²n + m³)` time.
    ///
    /// The sign of each is such that the entry of `A` with the largest magnitude is positive.
    ///
    /// # Shapes
    /// `s: d × m`, the support vectors; `x: d × n`, the samples.
    ///
    /// # Errors
    /// Fewer than two support vectors or samples; observations of different lengths, or that are not finite; 0
    /// components or more than there are directions with variance.
    pub fn approximate(
        kernel: Kernel,
        s: MatRef<'_, T>,
        x: MatRef<'_, T>,
        approximation: Approximation,
        components: usize,
        scaling: Scaling,
        par: Par,
    ) -> Result<Self, KernelError> {
        for (what, found) in [("support vectors", s.ncols()), ("samples", x.ncols())] {
            if found < 2 {
                return Err(KernelError::TooFew { what, found });
            }
        }
        let s_norms = finite_norms("support vector", s)?;
        let x_norms = finite_norms("sample", x)?;
        let own = finite(kernel.matrix(s, &s_norms, s, &s_norms, par)?)?;
        // Only the subset of data needs nothing from the samples; what they have in common with S is checked all the
        // same.
        let cross = match approximation {
            Approximation::SubsetOfData if x.nrows() == s.nrows() => own.clone(),
            _ => finite(kernel.matrix(s, &s_norms, x, &x_norms, par)?)?,
        };
        let Directions { mut projection, mut variances, rank } = match approximation {
            Approximation::SubsetOfData | Approximation::Nystrom => of_subset(own.as_ref(), components)?,
            Approximation::ProjectedProcess => of_projected_process(own.as_ref(), cross.as_ref(), components, par)?,
        };
        if projection.ncols() < components || components == 0 {
            return Err(KernelError::Components { asked: components, rank });
        }
        if approximation == Approximation::Nystrom {
            variances = variances_over(projection.as_ref(), cross.as_ref(), par);
            let floor = RANK_TOLERANCE * trace(own.as_ref()) / own.nrows() as f64;
            let varied = variances.iter().filter(|&&variance| variance > floor).count();
            if varied < components {
                return Err(KernelError::Components { asked: components, rank: varied });
            }
        }
        for (j, &variance) in variances.iter().enumerate() {
            let largest = projection.col(j).iter().fold(0.0f64, |best, &a| if a.abs() > best.abs() { a } else { best });
            let scale = match scaling {
                Scaling::Principal => 1.0f64,
                Scaling::UnitVariance => variance.sqrt().recip(),
            };
            projection.col_mut(j).iter_mut().for_each(|a| *a *= scale.copysign(largest));
        }
        let centre = projection.transpose() * row_means(cross.as_ref());
        let offset = (0..components).map(|i| centre[(i, 0)]).collect();
        Ok(KernelPca { kernel, members: s.to_owned(), norms: s_norms, projection, offset, variances })
    }

    /// Projections of observations: `x: d × n` gives `k × n`.
    ///
    /// # Errors
    /// Observations of another length than the support vectors, or that are not finite.
    pub fn apply(&self, x: MatRef<'_, T>, par: Par) -> Result<Mat<f64>, KernelError> {
        let x_norms = finite_norms("observation", x)?;
        let rows = self.kernel.matrix(self.members.as_ref(), &self.norms, x, &x_norms, par)?;
        let mut phi = Mat::from_fn(self.offset.len(), x.ncols(), |i, _| -self.offset[i]);
        matmul(phi.as_mut(), Accum::Add, self.projection.transpose(), rows, 1.0, par);
        finite(phi)
    }

    /// The kernel.
    pub fn kernel(&self) -> Kernel {
        self.kernel
    }

    /// The support vectors `S`, `d × m`.
    pub fn members(&self) -> MatRef<'_, T> {
        self.members.as_ref()
    }

    /// The coefficients `A`, `m × k`.
    pub fn projection(&self) -> MatRef<'_, f64> {
        self.projection.as_ref()
    }

    /// The centre `c = Aᵀk̄`, `k`.
    pub fn offset(&self) -> &[f64] {
        &self.offset
    }

    /// The variance of each component over the samples (over the support vectors for the subset of data), before any
    /// scaling to unit variance, in descending order (for Nyström in the order of the subset's eigenvalues), `k`.
    pub fn variances(&self) -> &[f64] {
        &self.variances
    }
}

/// Unit vectors of the kernel's space as coefficients over the support vectors, with the variance along each.
struct Directions {
    /// `m × k`, fewer columns than asked for if there are not as many.
    projection: Mat<f64>,
    variances: Vec<f64>,
    /// How many directions have variance.
    rank: usize,
}

/// Principal directions of the support vectors themselves: `A = HVΛ^(−1/2)` with `HK_SH = VΛVᵀ`, variances `λ/m`.
fn of_subset(own: MatRef<'_, f64>, components: usize) -> Result<Directions, KernelError> {
    let m = own.nrows();
    let half = centred_rows(own);
    let both = centred_rows(half.transpose());
    let Spectrum { vectors, values } = spectrum(both.as_ref(), RANK_TOLERANCE * trace(own))?;
    let k = components.min(values.len());
    let scaled = Mat::from_fn(m, k, |i, j| vectors[(i, j)] / values[j].sqrt());
    // The eigenvectors are centred up to rounding; dividing by √λ enlarges that, so centre again.
    let projection = centred_rows(scaled.transpose()).transpose().to_owned();
    Ok(Directions { projection, variances: values[..k].iter().map(|l| l / m as f64).collect(), rank: values.len() })
}

/// PCA of the samples' coordinates in an orthonormal basis of the span of the support vectors.
///
/// The basis is `Q = UΛ^(−1/2)` of `K_S = UΛUᵀ` rather than `L⁻ᵀ`: it spans the same, and stands support vectors that
/// depend on each other.
fn of_projected_process(
    own: MatRef<'_, f64>,
    cross: MatRef<'_, f64>,
    components: usize,
    par: Par,
) -> Result<Directions, KernelError> {
    let (m, n) = (cross.nrows(), cross.ncols() as f64);
    let floor = RANK_TOLERANCE * trace(own);
    let Spectrum { vectors, values } = spectrum(own, floor)?;
    let r = values.len();
    let basis = Mat::from_fn(m, r, |i, j| vectors[(i, j)] / values[j].sqrt());
    let mut v = Mat::zeros(r, cross.ncols());
    matmul(v.as_mut(), Accum::Replace, basis.transpose(), centred_rows(cross), 1.0, par);
    let mut covariance = Mat::zeros(r, r);
    matmul(covariance.as_mut(), Accum::Replace, v.as_ref(), v.transpose(), 1.0 / n, par);
    let Spectrum { vectors, values } = spectrum(covariance.as_ref(), floor / m as f64)?;
    let k = components.min(values.len());
    let mut projection = Mat::zeros(m, k);
    matmul(projection.as_mut(), Accum::Replace, basis.as_ref(), vectors.as_ref().subcols(0, k), 1.0, par);
    Ok(Directions { projection, variances: values[..k].to_vec(), rank: values.len() })
}

/// Eigenvalues above a floor, descending, with their eigenvectors as columns.
struct Spectrum {
    vectors: Mat<f64>,
    values: Vec<f64>,
}

fn spectrum(matrix: MatRef<'_, f64>, floor: f64) -> Result<Spectrum, KernelError> {
    let size = matrix.nrows();
    if size == 0 {
        return Ok(Spectrum { vectors: Mat::new(), values: Vec::new() });
    }
    let eigen = matrix.self_adjoint_eigen(Side::Lower).map_err(|_| KernelError::Eigenvalues(size))?;
    let values: Vec<f64> = (0..size).rev().map(|i| eigen.S()[i]).take_while(|&value| value > floor).collect();
    let vectors = Mat::from_fn(size, values.len(), |i, j| eigen.U()[(i, size - 1 - j)]);
    Ok(Spectrum { vectors, values })
}

/// Variances of `Aᵀk(x)` over the samples.
fn variances_over(projection: MatRef<'_, f64>, cross: MatRef<'_, f64>, par: Par) -> Vec<f64> {
    let mut projected = Mat::zeros(projection.ncols(), cross.ncols());
    matmul(projected.as_mut(), Accum::Replace, projection.transpose(), centred_rows(cross), 1.0, par);
    let n = cross.ncols() as f64;
    (0..projected.nrows()).map(|i| projected.row(i).iter().map(|p| p * p).sum::<f64>() / n).collect()
}

/// Mean of each row, as a column.
fn row_means(matrix: MatRef<'_, f64>) -> Mat<f64> {
    let n = matrix.ncols() as f64;
    Mat::from_fn(matrix.nrows(), 1, |i, _| matrix.row(i).iter().sum::<f64>() / n)
}

/// The matrix with the mean of each row subtracted from it, `MH`.
fn centred_rows(matrix: MatRef<'_, f64>) -> Mat<f64> {
    let means = row_means(matrix);
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] - means[(i, 0)])
}

fn trace(matrix: MatRef<'_, f64>) -> f64 {
    (0..matrix.nrows()).map(|i| matrix[(i, i)]).sum()
}

/// The matrix, if all of it is finite.
fn finite(matrix: Mat<f64>) -> Result<Mat<f64>, KernelError> {
    if matrix.is_all_finite() { Ok(matrix) } else { Err(KernelError::Overflow) }
}
