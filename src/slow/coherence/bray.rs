//! The ratio of long-term to short-term variance (Bray & Martinez).
//!
//! A slow signal wanders far in a long time and little in a short one:
//!
//! `max F(φ) = V/S`, `V = Var[φ̄]`, `S = Var[φ̃]`.
//!
//! With [`TermVariance::AroundMean`], `φ̄_t = φ_t − (long-term mean of φ at t)` and `φ̃` the same with the short-term mean:
//! variances *around* moving means, as in Bray & Martinez and in Stone's work before them. With
//! [`TermVariance::OfMean`], `φ̄` and `φ̃` are the moving means themselves, which is how the thesis prints it. A mean over
//! a window removes a wave completely whose period divides the window, so the ratio of the second form is 0 for some slow
//! waves and not for faster ones; the first form falls steadily until the period gets as short as the short window. Prefer
//! the first.
//!
//! `φ = wᵀx` makes both variances quadratic forms, `V = wᵀV_x w`, and the ratio a generalised eigenproblem. Run on the
//! Newton coordinates of a dictionary, it is the kernel method of the paper, with no change.
//!
//! # Erratum of the thesis
//! It says that the solutions are decorrelated because they come from an eigenvalue problem. They are so with respect to
//! the long-term and to the short-term variance, both at once; their plain covariance is near 0 only as far as the
//! long-term variance is near the covariance, i.e. for a long window.
//!
//! # Reference
//! Bray & Martinez, NIPS 2002; Stone, Neural Computation 8 (1996); thesis §4.1.1.

use faer::{Mat, MatRef, Par};

use super::{CoherenceError, LinearMap, check_features, checked_series};
use crate::slow::links::Link;
use crate::slow::moments::Moments;
use crate::slow::solve::solve;

/// A moving mean. It never looks across a gap.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MovingMean {
    /// The mean over the frames `t − half_width … t + half_width`, as far as they exist; the thesis's form (which prints one
    /// frame less at the right end; a window that is not symmetric lags by half a frame).
    Box {
        /// Frames to either side, > 0.
        half_width: usize,
    },
    /// The mean of all earlier frames, weighted by `2^(−age/half_life)`; the paper's form.
    Exponential {
        /// Time after which a frame counts half, in the unit of [`Link::dt`], > 0.
        half_life: f64,
    },
}

/// Which variance the ratio is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TermVariance {
    /// Variance of the signal around its moving mean.
    AroundMean,
    /// Variance of the moving mean.
    OfMean,
}

/// The objective.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// The long-term mean.
    pub long: MovingMean,
    /// The short-term mean.
    pub short: MovingMean,
    /// What the variances are of.
    pub variance: TermVariance,
    /// Regulariser λ, added to the diagonal of `S`; 0 if the inputs are not redundant.
    pub lambda: f64,
}

/// Features of the largest ratio.
#[derive(Debug, Clone, PartialEq)]
pub struct RatioFeatures {
    /// The map; features have mean 0 and variance 1 on the training frames.
    pub map: LinearMap,
    /// Ratio `V/S` of each feature on the training frames (without λ), descending, `k`; infinite for one that does not
    /// vary in the short term.
    pub ratios: Vec<f64>,
}

/// The `k` features with the largest ratio of long-term to short-term variance.
///
/// The weights of the links do not count here, only where they are missing, and for exponential means their `dt`.
///
/// ```
/// use adagio::slow::Link;
/// use adagio::slow::coherence::bray::{MovingMean, Options, TermVariance, largest_ratio};
/// use faer::Mat;
///
/// // Two mixtures of a slow and a fast wave.
/// let n = 2000;
/// let (slow, fast) = (|t: usize| (t as f64 / 80.0).sin(), |t: usize| (t as f64 / 4.0).sin());
/// let x = Mat::from_fn(2, n, |i, t| if i == 0 { slow(t) + fast(t) } else { slow(t) - 2.0 * fast(t) });
/// let options = Options {
///     long: MovingMean::Box { half_width: 100 },
///     short: MovingMean::Box { half_width: 1 },
///     variance: TermVariance::AroundMean,
///     lambda: 0.0,
/// };
/// let features = largest_ratio(x.as_ref(), &vec![Some(Link { dt: 1.0, weight: 1.0 }); n], options, 1).unwrap();
/// let phi = features.map.apply(x.as_ref()).unwrap();
/// let product: f64 = (0..n).map(|t| phi[(0, t)] * slow(t)).sum::<f64>() / n as f64;
/// assert!(product.abs() / 0.5f64.sqrt() > 0.99);
/// ```
///
/// # Shapes
/// `x: d × n`, `links: n`.
///
/// # Errors
/// Shapes that do not fit; values or links that are not finite; a long-term mean that is not longer than the short-term
/// one; fewer than 2 frames that follow each other; more features than directions in which the inputs vary.
pub fn largest_ratio(
    x: MatRef<'_, f64>,
    links: &[Option<Link>],
    options: Options,
    k: usize,
) -> Result<RatioFeatures, CoherenceError> {
    check(options)?;
    check_features(k, x.nrows())?;
    let links = checked_series(x, links)?;
    // Far from the origin, differences of running sums would lose digits.
    let total_mean = Mat::from_fn(x.nrows(), 1, |i, _| x.row(i).iter().sum::<f64>() / x.ncols() as f64);
    let centred = Mat::from_fn(x.nrows(), x.ncols(), |i, t| x[(i, t)] - total_mean[(i, 0)]);
    let long = terms(&centred, &links, options.long, options.variance, false);
    let short = terms(&centred, &links, options.short, options.variance, true);
    if short.ncols() == 0 {
        return Err(CoherenceError::TooShort { frames: x.ncols(), links: links.iter().flatten().count() });
    }
    // To the solver, V is a covariance and S a derivative power; slowness is then S/V.
    let mut moments = Moments::new(Par::Seq);
    moments.widen(long.nrows())?;
    moments.add(long.as_ref(), short.as_ref(), short.ncols() as f64)?;
    let solution = solve(&moments, k, options.lambda, None)?;
    let mut weights = solution.weights;
    scale_to_unit_variance(&mut weights, &centred)?;
    Ok(RatioFeatures {
        map: LinearMap::centred(weights, total_mean.as_ref()),
        ratios: solution.slowness.iter().map(|slowness| 1.0 / slowness.max(0.0)).collect(),
    })
}

fn check(options: Options) -> Result<(), CoherenceError> {
    for (name, mean) in [("the long-term mean", options.long), ("the short-term mean", options.short)] {
        match mean {
            MovingMean::Box { half_width } => {
                CoherenceError::unless(half_width > 0, name, half_width as f64, "of a half width > 0")?;
            }
            MovingMean::Exponential { half_life } => {
                CoherenceError::unless(
                    half_life > 0.0 && half_life.is_finite(),
                    name,
                    half_life,
                    "of a half-life > 0",
                )?;
            }
        }
    }
    let longer = "longer than the short-term mean, and of the same kind";
    match (options.long, options.short) {
        (MovingMean::Box { half_width: long }, MovingMean::Box { half_width: short }) => {
            CoherenceError::unless(long > short, "the long-term mean", long as f64, longer)
        }
        (MovingMean::Exponential { half_life: long }, MovingMean::Exponential { half_life: short }) => {
            CoherenceError::unless(long > short, "the long-term mean", long, longer)
        }
        (MovingMean::Box { half_width: value }, _) => {
            CoherenceError::unless(false, "the long-term mean", value as f64, longer)
        }
        (MovingMean::Exponential { half_life: value }, _) => {
            CoherenceError::unless(false, "the long-term mean", value, longer)
        }
    }
}

/// `x̄_t` of the frames that have a neighbour, about their own mean; if `whole`, only of those whose window is.
///
/// Cut at the end of a recording, a window is one-sided, and a signal differs from its mean by its slope. In the middle it
/// differs by its curvature only, which is so much less for slow signals that the few frames at the ends would make up all
/// of their short-term variance. The long-term variance does not mind.
fn terms(x: &Mat<f64>, links: &[Option<Link>], mean: MovingMean, variance: TermVariance, whole: bool) -> Mat<f64> {
    let d = x.nrows();
    let mut starts: Vec<usize> = (0..x.ncols()).filter(|&t| links[t].is_none()).collect();
    starts.push(x.ncols());
    let margin = match mean {
        MovingMean::Box { half_width } if whole => half_width,
        _ => 0,
    };
    // A frame alone has no moving mean but itself.
    let long_enough = |(start, end): &(usize, usize)| end - start > 1 && (end - start) / 2 >= margin.max(1);
    let segments: Vec<(usize, usize)> = starts.windows(2).map(|pair| (pair[0], pair[1])).filter(long_enough).collect();
    let mut terms = Mat::zeros(d, segments.iter().map(|(start, end)| end - start - 2 * margin).sum());
    let mut column = 0;
    for (start, end) in segments {
        let segment = x.as_ref().subcols(start, end - start);
        let means = match mean {
            MovingMean::Box { half_width } => box_means(segment, half_width),
            MovingMean::Exponential { half_life } => exponential_means(segment, &links[start..end], half_life),
        };
        for t in margin..segment.ncols() - margin {
            for i in 0..d {
                terms[(i, column)] = match variance {
                    TermVariance::AroundMean => segment[(i, t)] - means[(i, t)],
                    TermVariance::OfMean => means[(i, t)],
                };
            }
            column += 1;
        }
    }
    for i in 0..d {
        let mean = terms.row(i).iter().sum::<f64>() / terms.ncols() as f64;
        terms.row_mut(i).iter_mut().for_each(|value| *value -= mean);
    }
    terms
}

/// Centred means of a segment, by running sums.
fn box_means(x: MatRef<'_, f64>, half_width: usize) -> Mat<f64> {
    let (d, n) = (x.nrows(), x.ncols());
    let mut sums = Mat::<f64>::zeros(d, n + 1);
    for t in 0..n {
        for i in 0..d {
            sums[(i, t + 1)] = sums[(i, t)] + x[(i, t)];
        }
    }
    Mat::from_fn(d, n, |i, t| {
        let (first, end) = (t.saturating_sub(half_width), t.saturating_add(half_width).saturating_add(1).min(n));
        (sums[(i, end)] - sums[(i, first)]) / (end - first) as f64
    })
}

/// Exponential means of what came before each frame; the first frame is its own mean.
fn exponential_means(x: MatRef<'_, f64>, links: &[Option<Link>], half_life: f64) -> Mat<f64> {
    let mut means = x.to_owned();
    if x.ncols() > 1 {
        means.col_mut(1).copy_from(x.col(0));
    }
    for t in 2..x.ncols() {
        // `links[t − 1]` tells how much older everything before frame t − 1 was than that frame.
        let keep = links[t - 1].map_or(0.0, |link| (-link.dt / half_life).exp2());
        for i in 0..x.nrows() {
            means[(i, t)] = keep * means[(i, t - 1)] + (1.0 - keep) * x[(i, t - 1)];
        }
    }
    means
}

fn scale_to_unit_variance(weights: &mut Mat<f64>, centred: &Mat<f64>) -> Result<(), CoherenceError> {
    let phi = weights.transpose() * centred;
    for feature in 0..weights.ncols() {
        let variance = phi.row(feature).iter().map(|value| value * value).sum::<f64>() / phi.ncols() as f64;
        if !(variance > 0.0 && variance.is_finite()) {
            return Err(CoherenceError::NoVariance { feature, variance });
        }
        weights.col_mut(feature).iter_mut().for_each(|weight| *weight /= variance.sqrt());
    }
    Ok(())
}
