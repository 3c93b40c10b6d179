//! The thesis's batch pipeline: choose support vectors, sum over all frames, solve for slow features.
//!
//! The thesis kept ν = 0.1 and varied the kernel width by hand until the number of support vectors suited (§5.2);
//! [`Widths`] does that search. Sums are exact over all frames, since the dictionary is complete before the first of them
//! is added.

use faer::{MatRef, Par};

use super::spans::variance;
use super::{Bench, ExperimentError};
use crate::dictionary::Dictionary;
use crate::kernel::{Kernel, Scalar, median_distance};
use crate::slow::{Link, Moments, SlowFeatures, SlowModel, SolveOptions, solve_with};

/// The thesis's threshold (§5.2).
pub const NU: f64 = 0.1;
/// Regulariser: the scenarios' default. The thesis has none, and its solver drops directions without variance; this is so
/// small that only such directions notice.
pub const LAMBDA: f64 = 1e-7;

/// A number of support vectors counts as the one asked for within this share.
const NEAR: f64 = 0.08;
/// Widths that are tried for one number at most.
const TRIES: usize = 12;
/// Observations that are judged together.
const BLOCK: usize = 256;
/// Frames that are summed together.
const CHUNK: usize = 1024;
/// Observations of which the median distance is taken.
const SAMPLE: usize = 1000;
/// The search for a number begins at numbers that are smaller by this factor, where a try costs little.
const LADDER: usize = 4;
/// The smallest number at which it begins.
const FIRST: usize = 200;

/// Kernel widths that were tried for a video, and the support vectors that ALD with ν = [`NU`] keeps at them.
#[derive(Debug, Default)]
pub struct Widths {
    tried: Vec<(f64, usize)>,
}

impl Widths {
    /// About `target` support vectors for a video, `d × n`, chosen by ALD in the order of its frames.
    ///
    /// # Errors
    /// No width is found; [`ExperimentError::Stopped`].
    pub fn select<T: Scalar>(
        &mut self,
        x: MatRef<'_, T>,
        target: usize,
        bench: &Bench<'_>,
    ) -> Result<Dictionary<T>, ExperimentError> {
        if target / LADDER >= FIRST && self.tried.iter().all(|&(_, size)| size < target / LADDER / 2) {
            self.select(x, target / LADDER, bench)?;
        }
        let par = bench.scope.par;
        let most = (target as f64 * (1.0 + NEAR)) as usize;
        let least = (target as f64 * (1.0 - NEAR)) as usize;
        let mut sigma = match self.guess(target) {
            Some(sigma) => sigma,
            None => {
                let stride = (x.ncols() / SAMPLE).max(1);
                let sample = faer::Mat::from_fn(x.nrows(), x.ncols().div_ceil(stride), |i, j| x[(i, j * stride)]);
                median_distance(sample.as_ref())?
            }
        };
        // Widths that keep too many (they are too narrow) and too few.
        let (mut narrow, mut wide) = (0.0f64, f64::INFINITY);
        for _ in 0..TRIES {
            let mut dictionary = Dictionary::new(Kernel::gaussian(sigma)?, most + BLOCK, par);
            let seen = grow(&mut dictionary, x, most, bench)?;
            let size = dictionary.len();
            if size > most {
                narrow = narrow.max(sigma);
                // Too many before the end: about as many more as there are frames left, at half the rate.
                let share = seen as f64 / x.ncols() as f64;
                sigma *= (size as f64 / target as f64 * share.powf(-0.5)).powf(0.35).max(1.03);
            } else {
                self.tried.push((sigma, size));
                bench.say(&format!("sigma {sigma:.0}: {size} support vectors of {} frames", x.ncols()));
                if size >= least {
                    return Ok(dictionary);
                }
                wide = wide.min(sigma);
                sigma = match self.guess(target) {
                    Some(better) if better < sigma => better,
                    _ => sigma * (size.max(1) as f64 / target as f64).powf(0.35).min(0.97),
                };
            }
            if narrow > 0.0 && wide.is_finite() && !(narrow < sigma && sigma < wide) {
                sigma = (narrow * wide).sqrt();
            }
        }
        let tried =
            self.tried.iter().map(|(sigma, size)| format!("{sigma:.0} ({size})")).collect::<Vec<_>>().join(", ");
        Err(ExperimentError::Width { frames: x.ncols(), target, tried })
    }

    /// The width for a number by what was tried: numbers go with a power of the width, from one pair of widths to the next.
    fn guess(&self, target: usize) -> Option<f64> {
        let mut known = self.tried.clone();
        known.sort_by(|a, b| a.0.total_cmp(&b.0));
        known.dedup_by(|a, b| a.0 == b.0 || a.1 == b.1);
        let distance = |(_, size): &(f64, usize)| ((*size).max(1) as f64 / target as f64).ln().abs();
        known.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        let (&(near, near_size), &(far, far_size)) = (known.first()?, known.get(1)?);
        let power = (far_size.max(1) as f64 / near_size.max(1) as f64).ln() / (far / near).ln();
        // Wider kernels keep fewer: where noise says otherwise, there is nothing to go by.
        let power = if power < -0.5 { power } else { -2.0 };
        Some(near * (target as f64 / near_size.max(1) as f64).powf(1.0 / power))
    }
}

/// Let ALD choose from a video, in the order of its frames, until there are more than `most`; the frames that were seen.
fn grow<T: Scalar>(
    dictionary: &mut Dictionary<T>,
    x: MatRef<'_, T>,
    most: usize,
    bench: &Bench<'_>,
) -> Result<usize, ExperimentError> {
    for start in (0..x.ncols()).step_by(BLOCK) {
        bench.go_on()?;
        let end = (start + BLOCK).min(x.ncols());
        dictionary.grow(x.subcols(start, end - start), |_, residual| residual > NU)?;
        if dictionary.len() > most {
            return Ok(end);
        }
    }
    Ok(x.ncols())
}

/// The `k` slowest features of a video over the support vectors of a dictionary, or as many as there are; slowness is that on
/// the video.
///
/// # Errors
/// A video without any change; [`ExperimentError::Stopped`].
pub fn slow_features(
    dictionary: &Dictionary<f32>,
    x: MatRef<'_, f32>,
    links: &[Option<Link>],
    k: usize,
    bench: &Bench<'_>,
) -> Result<(SlowFeatures, SlowModel<f32>), ExperimentError> {
    let (m, par) = (dictionary.len(), bench.scope.par);
    let mut moments = Moments::new(par);
    moments.widen(m)?;
    let mut before: Option<faer::Mat<f64>> = None;
    for start in (0..x.ncols()).step_by(CHUNK) {
        bench.go_on()?;
        let count = CHUNK.min(x.ncols() - start);
        let v = dictionary.coordinates(x.subcols(start, count))?;
        let mut links = links[start..start + count].to_vec();
        if before.is_none() {
            links[0] = None;
        }
        moments.add_series(v.as_ref(), &links, before.as_ref().map(|last| last.as_ref()))?;
        before = Some(v.subcols(count - 1, 1).to_owned());
    }
    bench.say(&format!("summed {} frames over {m} support vectors", x.ncols()));
    let features = solved(&moments, k.min(m), par)?;
    let model = SlowModel::new(dictionary, &features)?;
    Ok((features, model))
}

/// As many of `k` features as there are directions with variance.
fn solved(moments: &Moments, k: usize, par: Par) -> Result<SlowFeatures, ExperimentError> {
    let options = SolveOptions { par, ..SolveOptions::default() };
    match solve_with(moments, k, LAMBDA, None, &options) {
        Err(crate::slow::SlowError::Features { rank, .. }) if rank > 0 => {
            Ok(solve_with(moments, rank, LAMBDA, None, &options)?)
        }
        other => Ok(other?),
    }
}

/// Slowness of signals, `k × n`, on a video: mean square of their derivatives over their variance, each.
pub fn slowness_of(signals: MatRef<'_, f64>, links: &[Option<Link>]) -> Vec<f64> {
    (0..signals.nrows())
        .map(|i| {
            let row: Vec<f64> = signals.row(i).iter().copied().collect();
            let (mut sum, mut weight) = (0.0, 0.0);
            for t in 1..row.len() {
                if let Some(link) = links[t] {
                    sum += link.weight * ((row[t] - row[t - 1]) / link.dt).powi(2);
                    weight += link.weight;
                }
            }
            sum / weight.max(f64::MIN_POSITIVE) / variance(&row)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn guesses_follow_the_power_law_of_what_was_tried() {
        let widths = Widths { tried: vec![(1000.0, 100), (500.0, 400), (2000.0, 25)] };
        assert!((widths.guess(1600).unwrap() - 250.0).abs() < 1e-6);
        assert_eq!(Widths::default().guess(100), None);
    }

    #[test]
    fn slowness_is_that_of_a_sine() {
        let sine = faer::Mat::from_fn(1, 6284, |_, t| 3.0 * (0.01 * t as f64).sin() + 1.0);
        let links = Link::regular(6284, 0.5).unwrap();
        let found = slowness_of(sine.as_ref(), &links)[0];
        assert!((found - (0.01f64 / 0.5).powi(2)).abs() < 1e-7, "{found}");
    }
}
