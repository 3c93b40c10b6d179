//! Kernel slow feature analysis on kernel matrices: exact, and with the projected process.

use faer::{Mat, MatRef, Par};

use super::error::SlowError;
use super::linear::LinearSfa;
use super::links::Link;
use super::model::SlowModel;
use super::reveal::descending;
use crate::kernel::{Kernel, Scalar, squared_norms};

/// How far a kernel matrix may be from symmetric and positive, as a share of its largest entry or eigenvalue. Products in
/// `f32` are wrong by about 1e-5.
const GRAM_ERROR: f64 = 1e-4;

/// Slow features over support vectors, in terms of kernel values alone.
///
/// Symbols: training observations `x⁽¹⁾ … x⁽ⁿ⁾`; support vectors `s₁ … s_m`, a subset of them or all; kernel matrix of the
/// support vectors `K: m × m`; kernel rows `K̂: m × n`, whose column t is `k̂(x⁽ᵗ⁾) = [k(s₁, x⁽ᵗ⁾) … k(s_m, x⁽ᵗ⁾)]`; its
/// derivative `K̇: m × l`. A feature is `φ(x) = αᵀk̂(x) − c`, with norm² `αᵀKα` in the kernel's Hilbert space.
///
/// - **Exact** ([`KernelSfa::exact`]): all training observations are support vectors. The centred kernel matrix
///   `K_c = HKH = VΛVᵀ`, `H = I − 11ᵀ/n`, gives the coordinates `Λ^{1/2}Vᵀ` of the training frames in feature space, and
///   linear SFA on them is the solution. O(n³): this is the reference, and for small n.
/// - **Projected process** ([`KernelSfa::projected`]): features in the span of the support vectors. This *is* linear SFA on
///   `k̂(x)`; with λ it minimises `αᵀ(K̇K̇ᵀ/l + λK)α`, which is regularised sparse kernel SFA. O(m²n). A
///   [`SlowStream`](super::SlowStream) does the same in the Newton basis `v = L⁻¹k̂`, frame by frame.
///
/// Without λ a kernel whose matrix has full rank fits any sequence: the outputs then are the discrete cosines of time
/// whatever was observed. With many support vectors λ is therefore needed (Böhmer et al., ECML 2011).
///
/// # Errata of the thesis (§4.3.3, `alg_kernelSFA`)
/// 1. The listing centres the m×m matrix `K̂K̂ᵀ` with the n×n operator `H`. Right is `K̂K̂ᵀ/n − k̄k̄ᵀ` with `k̄` the mean row.
/// 2. It names the eigenvectors `V_r` and then uses `U_r`.
/// 3. Its `S = Λ_r^{−1/2}V_rᵀ` comes from the matrix that is not divided by n: the outputs have variance 1/n, not 1.
/// 4. In the text, `S = n^{−1/2}Λ_r⁻¹V_rᵀΨᵀ` gives the variance 1/n²: the factor must be `n^{1/2}`. The slowness matrix with
///    `1/(n(n − 1))` follows from that slip and must have `n/(n − 1)`; the order of the features is not affected.
/// 5. `A` is printed with `Ũ_kᵀ`; the shapes ask for `Ũ_k`.
/// 6. The square root of the eigenvalues of `K̂K̂ᵀ` that the text takes is not needed: whitening `k̂(x)` uses its covariance.
///
/// ```
/// use adagio::slow::{KernelSfa, Link};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// // The kernel of "both equal" tells all frames apart: the features are cosines of time.
/// let gram = Mat::<f64>::identity(40, 40);
/// let sfa = KernelSfa::exact(gram.as_ref(), &Link::regular(40, 1.0)?, 2, 0.0)?;
/// let cosine = |j: f64, t: usize| 2f64.sqrt() * (j * std::f64::consts::PI * (t as f64 + 0.5) / 40.0).cos();
/// let y = sfa.apply(gram.as_ref())?;
/// assert!((0..40).all(|t| (y[(1, t)].abs() - cosine(2.0, t).abs()).abs() < 1e-9));
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §4.3.3 (`sec:SFA_kernel`), with the errata above; Böhmer et al., ECML 2011 (λ).
#[derive(Debug, Clone, PartialEq)]
pub struct KernelSfa {
    /// Coefficients `A`, `m × k`, one feature a column, slowest first.
    pub projection: Mat<f64>,
    /// Offset `c`, `k`.
    pub offset: Vec<f64>,
    /// Slowness of each feature on the training frames, ascending, `k`.
    pub slowness: Vec<f64>,
    /// Number of independent directions in the (centred) kernel matrix.
    pub rank: usize,
}

impl KernelSfa {
    /// Kernel SFA with all training observations as support vectors.
    ///
    /// # Shapes
    /// `gram: n × n`, `links: n`.
    ///
    /// # Errors
    /// A matrix that is not square, symmetric, positive and finite; what [`LinearSfa::fit`] refuses.
    pub fn exact(
        gram: MatRef<'_, f64>,
        links: &[Option<Link>],
        features: usize,
        lambda: f64,
    ) -> Result<KernelSfa, SlowError> {
        check_gram(gram)?;
        let n = gram.nrows();
        let means: Vec<f64> = (0..n).map(|j| gram.col(j).sum() / n as f64).collect();
        let total = means.iter().sum::<f64>() / n as f64;
        let centred = Mat::from_fn(n, n, |i, j| {
            let (low, high) = (i.min(j), i.max(j));
            gram[(high, low)] - means[i] - means[j] + total
        });
        let basis = Basis::of(&centred, gram)?;
        // K_c·VΛ^{−1/2} = VΛ^{1/2}: the coordinates of the training frames.
        let coordinates = Mat::from_fn(basis.rank(), n, |i, t| basis.vectors[(t, i)] * basis.roots[i]);
        let linear = LinearSfa::fit(coordinates.as_ref(), links, features, lambda)?;
        let mut projection = basis.coefficients(linear.weights.as_ref());
        // H from the left: the coefficients of centred observations, in terms of the observations.
        for j in 0..features {
            let mean = projection.col(j).sum() / n as f64;
            projection.col_mut(j).iter_mut().for_each(|a| *a -= mean);
        }
        let offset = (0..features).map(|j| (0..n).map(|i| projection[(i, j)] * means[i]).sum()).collect();
        Ok(KernelSfa { projection, offset, slowness: linear.slowness, rank: basis.rank() })
    }

    /// Kernel SFA in the span of some support vectors.
    ///
    /// # Shapes
    /// `gram: m × m`, the kernel matrix of the support vectors; `rows: m × n`, their kernel values at the training frames;
    /// `links: n`.
    ///
    /// # Errors
    /// A matrix that is not square, symmetric, positive and finite; what [`LinearSfa::fit`] refuses.
    pub fn projected(
        gram: MatRef<'_, f64>,
        rows: MatRef<'_, f64>,
        links: &[Option<Link>],
        features: usize,
        lambda: f64,
    ) -> Result<KernelSfa, SlowError> {
        check_gram(gram)?;
        SlowError::unless_fits("the number of kernel values", rows.nrows(), gram.nrows())?;
        SlowError::unless_finite("the kernel values are", rows)?;
        let m = gram.nrows();
        let basis = Basis::of(&Mat::from_fn(m, m, |i, j| gram[(i.max(j), i.min(j))]), gram)?;
        // Λ^{−1/2}Vᵀk̂(x) has the scalar product of the feature space, like the Newton coordinates L⁻¹k̂(x).
        let coordinates = basis.coefficients(Mat::<f64>::identity(basis.rank(), basis.rank()).as_ref());
        let linear = LinearSfa::fit((coordinates.transpose() * rows).as_ref(), links, features, lambda)?;
        let projection = basis.coefficients(linear.weights.as_ref());
        Ok(KernelSfa { projection, offset: linear.offset(), slowness: linear.slowness, rank: basis.rank() })
    }

    /// Exact kernel SFA of observations, as a model for new ones.
    ///
    /// # Shapes
    /// `x: d × n`, `links: n`.
    ///
    /// # Errors
    /// Those of [`KernelSfa::exact`] and of the kernel.
    pub fn model<T: Scalar>(
        kernel: Kernel,
        x: MatRef<'_, T>,
        links: &[Option<Link>],
        features: usize,
        lambda: f64,
    ) -> Result<SlowModel<T>, SlowError> {
        let norms = squared_norms(x);
        let gram = kernel.matrix(x, &norms, x, &norms, Par::Seq)?;
        let KernelSfa { projection, offset, slowness, .. } = KernelSfa::exact(gram.as_ref(), links, features, lambda)?;
        SlowModel::from_parts(kernel, x.to_owned(), projection, offset, slowness)
    }

    /// Features from kernel values `k̂(x)`: `rows: m × n` gives `k × n`.
    ///
    /// # Errors
    /// Rows of another number of support vectors, an offset of another length than the features.
    pub fn apply(&self, rows: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        SlowError::unless_fits("the number of kernel values", rows.nrows(), self.projection.nrows())?;
        SlowError::unless_fits("the length of c", self.offset.len(), self.projection.ncols())?;
        let mut y = self.projection.transpose() * rows;
        for t in 0..y.ncols() {
            for (value, offset) in y.col_mut(t).iter_mut().zip(&self.offset) {
                *value -= offset;
            }
        }
        Ok(y)
    }
}

/// The directions of a kernel matrix `VΛVᵀ` that are more than rounding.
struct Basis {
    /// `V`, `m × r`.
    vectors: Mat<f64>,
    /// `Λ^{1/2}`, `r`.
    roots: Vec<f64>,
}

impl Basis {
    /// `matrix` is `gram` itself or its centred form; rounding is judged by the size of `gram`.
    fn of(matrix: &Mat<f64>, gram: MatRef<'_, f64>) -> Result<Basis, SlowError> {
        let (values, vectors) = descending(matrix)?;
        let size = (0..gram.nrows()).map(|i| gram[(i, i)]).fold(0.0, f64::max);
        let largest = values[0].max(size);
        let smallest = values[values.len() - 1];
        if smallest < -GRAM_ERROR * largest {
            return Err(SlowError::Gram(format!("it has the eigenvalue {smallest:e}, the largest is {largest:e}")));
        }
        // A kernel matrix has no negative eigenvalues: those that are there show how large the rounding is.
        let rounding = (values.len() as f64 * f64::EPSILON * largest).max(-2.0 * smallest);
        let rank = values.iter().take_while(|&&value| value > rounding).count();
        let vectors = vectors.subcols(0, rank).to_owned();
        Ok(Basis { vectors, roots: values[..rank].iter().map(|value| value.sqrt()).collect() })
    }

    fn rank(&self) -> usize {
        self.roots.len()
    }

    /// `VΛ^{−1/2}W`: coefficients of the support vectors, from weights in this basis.
    fn coefficients(&self, weights: MatRef<'_, f64>) -> Mat<f64> {
        &self.vectors * Mat::from_fn(self.rank(), weights.ncols(), |i, j| weights[(i, j)] / self.roots[i])
    }
}

/// Refuse what cannot be a kernel matrix.
fn check_gram(gram: MatRef<'_, f64>) -> Result<(), SlowError> {
    let n = gram.nrows();
    SlowError::unless_fits("a row of the kernel matrix", gram.ncols(), n)?;
    SlowError::unless_finite("the kernel matrix is", gram)?;
    if n == 0 {
        return Err(SlowError::Empty("the kernel matrix is"));
    }
    let largest = gram.norm_max();
    if largest > f64::MAX.sqrt() {
        return Err(SlowError::NotFinite("the kernel matrix is"));
    }
    for j in 0..n {
        for i in 0..j {
            if (gram[(i, j)] - gram[(j, i)]).abs() > GRAM_ERROR * largest {
                let (upper, lower) = (gram[(i, j)], gram[(j, i)]);
                return Err(SlowError::Gram(format!("entry ({i}, {j}) is {upper}, but entry ({j}, {i}) is {lower}")));
            }
        }
    }
    Ok(())
}
