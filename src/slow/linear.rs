//! Linear slow feature analysis: affine functions `y(x) = Wᵀ(x − x̄)` of a signal that vary as slowly as possible.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatMut, MatRef, Par};

use super::error::SlowError;
use super::links::{Link, check_links, lagged};
use super::moments::Moments;
use super::reveal::decorrelated;
use super::solve::{Method, SlowFeatures, SolveOptions, solve_with, sort};
use crate::kernel::products::{join, near_half};

/// The slowest affine functions of a signal.
///
/// Symbols: signal `x: d × n`, one frame a column; mean `x̄`; weights `W: d × k`; regulariser λ; slowness
/// `Δ_i = ⟨ẏ_i²⟩`, the weighted mean over all frames that have a [`Link`]. The outputs have mean 0, variance 1 and
/// covariance 0 on the training frames, and Δ ascends.
///
/// **Lags.** With a lag τ the derivative is `(x_t − x_{t−τ})/(time between the two)`. For regular sampling that finds what
/// correlates most with itself τ frames later, which is time-lagged independent component analysis (tICA) with a symmetric
/// estimate: `Δ·(τ dt)² = 2(1 − autocorrelation at τ)` up to the ends of the series. With several lags their slownesses are
/// averaged, each lag with the same weight.
///
/// **Precision.** The signal is centred before it is squared, and the outputs are made uncorrelated once more on the signal
/// itself, so the constraints hold to about 1e-12 whatever the means and scales of the channels, also where channels depend on
/// each other. Two things can't be had: a direction with less than about 10⁻⁶ of the amplitude of all channels that it is made
/// of counts as none, and values beyond about 10¹⁵⁰ or below 10⁻¹⁵⁰ have no squares.
///
/// For signals that do not fit into memory, [`LinearStream`](super::LinearStream) keeps the sums alone.
///
/// ```
/// use adagio::slow::{LinearSfa, Link};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::SlowError> {
/// // A slow sine is hidden in two fast channels.
/// let slow = |t: usize| (t as f64 * 0.01).sin();
/// let fast = |t: usize| (t as f64 * 1.3).sin();
/// let x = Mat::from_fn(2, 2000, |i, t| if i == 0 { 0.1 * slow(t) + fast(t) } else { fast(t) });
/// let sfa = LinearSfa::fit(x.as_ref(), &Link::regular(2000, 1.0)?, 1, 0.0)?;
/// // The slowest function is x₁ − x₂, up to its scale and to what the two sines share by chance.
/// assert!((sfa.weights[(0, 0)] + sfa.weights[(1, 0)]).abs() < 1e-3 * sfa.weights[(0, 0)].abs());
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §4.3.1 (`sec:SFA_linear`); Wiskott & Sejnowski 2002. The thesis writes `W = UΛ^{−1/2}Ũ_kᵀ` below its listing;
/// the listing has it right: `W = SᵀŨ_k`, without the transpose at the end. Lags: Molgedey & Schuster 1994 (tICA).
#[derive(Debug, Clone, PartialEq)]
pub struct LinearSfa {
    /// Weights `W`, `d × k`, one function a column, slowest first.
    pub weights: Mat<f64>,
    /// Mean `x̄` of the training frames, `d`.
    pub mean: Vec<f64>,
    /// Slowness Δ of each output on the training frames, ascending, `k`.
    pub slowness: Vec<f64>,
    /// Channels that say nothing new: `d` minus the number of independent directions with variance, whatever λ and the number
    /// of features.
    pub rank_deficit: usize,
}

impl LinearSfa {
    /// The `features` slowest affine functions of `x`.
    ///
    /// # Shapes
    /// `x: d × n`; `links: n` ([`Link::regular`], [`Link::sequences`], [`Link::at_times`] make them). The first is ignored.
    ///
    /// # Errors
    /// Shapes that do not fit, fewer than two frames, no link, values that are not finite, impossible links or λ, more
    /// features than directions with variance.
    pub fn fit(
        x: MatRef<'_, f64>,
        links: &[Option<Link>],
        features: usize,
        lambda: f64,
    ) -> Result<LinearSfa, SlowError> {
        LinearSfa::fit_lagged(x, links, &[1], features, lambda)
    }

    /// The same with differences over `lags` frames, whose slownesses are averaged.
    ///
    /// # Errors
    /// Those of [`LinearSfa::fit`], no lag, a lag of 0 or of more than `n − 1` frames, a lag that no two frames without a
    /// gap between them have.
    pub fn fit_lagged(
        x: MatRef<'_, f64>,
        links: &[Option<Link>],
        lags: &[usize],
        features: usize,
        lambda: f64,
    ) -> Result<LinearSfa, SlowError> {
        SlowError::unless_lambda(lambda)?;
        let (mean, centred) = centre(x)?;
        SlowError::unless_fits("the list of links", links.len(), x.ncols())?;
        check_links(links)?;
        if lags.is_empty() {
            return Err(SlowError::Empty("the list of lags is"));
        }
        let mut differences = Vec::with_capacity(lags.len());
        for &lag in lags {
            if lag == 0 || lag >= x.ncols().max(2) {
                return Err(SlowError::Lag { lag, frames: x.ncols() });
            }
            let pairs = lagged(links, lag);
            let weight: f64 = pairs.iter().map(|(_, link)| link.weight).sum();
            if !(weight > 0.0 && x.ncols() >= 2) {
                return Err(SlowError::TooFewFrames { frames: x.ncols() as f64, links: weight });
            }
            differences.push((lag, pairs, weight));
        }

        let moments = moments_of(centred.as_ref(), &differences)?;
        let (SlowFeatures { weights, .. }, rank_deficit) = solve_all(&moments, features, lambda)?;
        // The moments know the outputs' covariance to the rounding of the largest channel only: once more, on the outputs.
        let outputs = moments_of((weights.transpose() * &centred).as_ref(), &differences)?;
        let mut weights = decorrelated(weights, outputs.covariance().as_ref())?;
        let outputs = moments_of((weights.transpose() * &centred).as_ref(), &differences)?;
        let rate = outputs.rate();
        let mut slowness: Vec<f64> = (0..features).map(|i| rate[(i, i)]).collect();
        sort(&mut slowness, [&mut weights]);
        Ok(LinearSfa { weights, mean, slowness, rank_deficit })
    }

    /// Number of values per frame `d` that it takes.
    pub fn inputs(&self) -> usize {
        self.mean.len()
    }

    /// Number of outputs `k`.
    pub fn outputs(&self) -> usize {
        self.weights.ncols()
    }

    /// The offset `c = Wᵀx̄` of the form `y(x) = Wᵀx − c`, `k`.
    pub fn offset(&self) -> Vec<f64> {
        let product = |j| self.weights.col(j).iter().zip(&self.mean).map(|(weight, mean)| weight * mean).sum();
        (0..self.outputs()).map(product).collect()
    }

    /// Outputs of frames: `x: d × n` gives `k × n`.
    ///
    /// # Errors
    /// Frames of another length, weights and a mean that do not fit each other. Values that are not finite give outputs
    /// that are not.
    pub fn apply(&self, x: MatRef<'_, f64>) -> Result<Mat<f64>, SlowError> {
        let mut outputs = Mat::zeros(self.outputs(), x.ncols());
        self.apply_into(x, outputs.as_mut(), faer::get_global_parallelism())?;
        Ok(outputs)
    }

    /// As [`LinearSfa::apply`], into a matrix that exists, `k × n`, on these threads; their number does not change the bits.
    ///
    /// # Errors
    /// Those of [`LinearSfa::apply`], a matrix of another size.
    pub fn apply_into(&self, x: MatRef<'_, f64>, outputs: MatMut<'_, f64>, par: Par) -> Result<(), SlowError> {
        SlowError::unless_fits("a frame's number of values", x.nrows(), self.inputs())?;
        SlowError::unless_fits("the number of rows of W", self.weights.nrows(), self.inputs())?;
        SlowError::unless_fits("the number of outputs", outputs.nrows(), self.outputs())?;
        SlowError::unless_fits("the number of frames of the outputs", outputs.ncols(), x.ncols())?;
        self.apply_to(x, outputs, par);
        Ok(())
    }

    /// By halves, side by side, down to blocks that stay in the cache.
    fn apply_to(&self, x: MatRef<'_, f64>, mut outputs: MatMut<'_, f64>, par: Par) {
        let n = x.ncols();
        if n > APPLIED {
            let cut = near_half(n);
            let (first, second) = outputs.split_at_col_mut(cut);
            let (x, rest) = x.split_at_col(cut);
            return join(par, |par| self.apply_to(x, first, par), |par| self.apply_to(rest, second, par));
        }
        let mut centred = x.to_owned();
        for column in centred.as_mut().col_iter_mut() {
            column.iter_mut().zip(&self.mean).for_each(|(value, mean)| *value -= mean);
        }
        matmul(outputs.as_mut(), Accum::Replace, self.weights.transpose(), centred.as_ref(), 1.0, Par::Seq);
    }
}

/// Frames whose outputs are computed in one product.
const APPLIED: usize = 256;

/// Mean of the columns of `x`, and the columns without it.
///
/// # Errors
/// Values that are not finite, or whose squares are not.
pub(super) fn centre(x: MatRef<'_, f64>) -> Result<(Vec<f64>, Mat<f64>), SlowError> {
    SlowError::unless_finite("the signal is", x)?;
    let n = x.ncols().max(1) as f64;
    // Each value is divided before it is added, so that the sum of large finite values is finite.
    let mean: Vec<f64> = (0..x.nrows()).map(|i| (0..x.ncols()).map(|t| x[(i, t)] / n).sum()).collect();
    let centred = Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)] - mean[i]);
    let squares = (0..x.ncols()).flat_map(|t| (0..x.nrows()).map(move |i| (i, t)));
    let total: f64 = squares.map(|(i, t)| centred[(i, t)] * centred[(i, t)]).sum();
    if total.is_finite() {
        return Ok((mean, centred));
    }
    let reach = |i: usize| centred.row(i).iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let largest = (0..x.nrows()).max_by(|&a, &b| reach(a).total_cmp(&reach(b))).unwrap_or(0);
    let place = format!("channel {largest}, which reaches {:e} from its mean", reach(largest));
    Err(SlowError::NotFinite("the squares of the signal are").at(place))
}

/// The differences over one lag: the lag, its pairs `(later frame, link)`, and the sum of their weights.
type Differences = (usize, Vec<(usize, Link)>, f64);

/// Moments of a centred signal from its differences.
fn moments_of(x: MatRef<'_, f64>, differences: &[Differences]) -> Result<Moments, SlowError> {
    let mut moments = Moments::new(Par::Seq);
    moments.widen(x.nrows())?;
    moments.add(x, Mat::zeros(x.nrows(), 0).as_ref(), 0.0)?;
    let none = Mat::<f64>::zeros(x.nrows(), 0);
    for (lag, pairs, weight) in differences {
        let rates = Mat::from_fn(x.nrows(), pairs.len(), |i, column| {
            let (t, link) = pairs[column];
            (x[(i, t)] - x[(i, t - lag)]) * (link.weight / weight).sqrt() / link.dt
        });
        moments.add(none.as_ref(), rates.as_ref(), 1.0)?;
    }
    Ok(moments)
}

/// All features' solution, which knows how many directions have variance; and how many coordinates more there are.
pub(super) fn solve_all(moments: &Moments, features: usize, lambda: f64) -> Result<(SlowFeatures, usize), SlowError> {
    let options = SolveOptions { method: Method::Dense, ..Default::default() };
    let features = solve_with(moments, features, lambda, None, &options)?;
    let rank_deficit = features.rank_deficit().unwrap_or(0);
    Ok((features, rank_deficit))
}
