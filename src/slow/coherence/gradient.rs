//! Temporal coherence by gradient ascent (Einhäuser et al., Wyss et al.).
//!
//! Nothing is constrained; a sum of penalties is made as large as possible:
//!
//! `F = − Σ_i ⟨φ̇_i²⟩/V_i − β Σ_{i≠j} C_ij²/(V_i V_j) − μ Σ_i m_i²/V_i`,
//!
//! with mean `m_i`, variance `V_i` and covariances `C_ij` of the features `φ = Wᵀx − c`. The first term is slowness at unit
//! variance, the second (weight β) punishes correlation, the third (weight μ, Wyss et al.) a mean that is not 0.
//!
//! [`ascend`] climbs `F` on a recorded series, [`OnlineCoherence`] on a stream, where running estimates with a forgetting
//! rate stand for the expectations.
//!
//! # What the maximum is
//! `F` does not depend on the scale of a feature. Take inputs that are white, with slow features of slowness
//! `Δ_1 ≤ Δ_2 ≤ …`, and write `G = Σ_i w_i w_iᵀ` over unit weights. Then `F = −tr(ḊG) − β(‖G‖² − k)`, and every positive
//! semidefinite `G` of rank ≤ k and trace k can occur. So at the maximum `G` has the eigenvectors of the `k` slowest features,
//! with the eigenvalues `g_i = 1 + (Δ̄ − Δ_i)/(2β)`, `Δ̄` the mean of these `k` slownesses, and
//!
//! `F* = −Σ_i Δ_i + Σ_i (Δ_i − Δ̄)²/(4β)` as long as all `g_i ≥ 0` ([`Coherence::maximum`]).
//!
//! - The features span the `k` slowest ones, but which ones they are within this span is not determined: any rotation of
//!   them that keeps `G` is as good. Slow feature analysis afterwards (or the order of `Δ`) sorts them out.
//! - Among decorrelated features the best is `−ΣΔ_i`, and slow features reach it. But as a penalty of finite weight,
//!   decorrelation is given up for slowness: the slow features themselves are a saddle of `F`, not its maximum, unless
//!   all `Δ_i` are equal.
//! - If `Δ_k − Δ̄ > 2β`, the fastest features collapse onto the slow ones. With the printed `β = 1/(k−1)²` this happens
//!   easily for many features, and since Δ depends on the unit of time but β does not, it depends on that unit.
//!
//! # Reference
//! Einhäuser, Hipp, Eggert, Körner & König, Biol. Cybern. 93 (2005); Wyss, König & Verschure, PLoS Biol. 4 (2006);
//! thesis §4.1.1, eq. `sfa_problem_alt`.

use faer::{Mat, MatRef};

use super::{CoherenceError, LinearMap, check_features, check_frame, moments_of, project, random_weights};
use crate::slow::links::{Link, check_link};
use crate::slow::moments::Moments;

/// The objective `F`: weights of its penalties.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coherence {
    /// Weight β of correlation between features, ≥ 0.
    pub decorrelation: f64,
    /// Weight μ of a mean that is not 0, ≥ 0.
    pub mean: f64,
}

/// `F` and its gradient at one map.
#[derive(Debug, Clone, PartialEq)]
pub struct Slope {
    /// The value of `F`.
    pub value: f64,
    /// `∂F/∂W`, `d × k`.
    pub weights: Mat<f64>,
    /// `∂F/∂c`, `k`.
    pub offset: Vec<f64>,
}

impl Coherence {
    /// The weights of Einhäuser et al. as the thesis prints them: β = 1/(k−1)², μ = 0.
    pub fn einhauser(k: usize) -> Self {
        let others = k.saturating_sub(1) as f64;
        Coherence { decorrelation: if others > 0.0 { 1.0 / (others * others) } else { 0.0 }, mean: 0.0 }
    }

    fn check(&self) -> Result<(), CoherenceError> {
        let allowed = "≥ 0 and finite";
        for (name, weight) in
            [("the weight of decorrelation", self.decorrelation), ("the weight of the mean", self.mean)]
        {
            CoherenceError::unless(weight >= 0.0 && weight.is_finite(), name, weight, allowed)?;
        }
        Ok(())
    }

    /// The largest value `F` can take with `k` features, from the slownesses of the `k` slowest (of unit variance).
    ///
    /// `None` if β is too small for them: some would collapse onto others, and the formula does not hold.
    ///
    /// ```
    /// use adagio::slow::coherence::gradient::Coherence;
    ///
    /// let objective = Coherence { decorrelation: 1.0, mean: 0.0 };
    /// assert_eq!(objective.maximum(&[0.5, 0.5]), Some(-1.0)); // equally slow: no gain from correlation
    /// assert_eq!(objective.maximum(&[0.25, 0.75]), Some(-1.0 + 0.125 / 4.0));
    /// assert_eq!(objective.maximum(&[0.0, 8.0]), None);
    /// ```
    pub fn maximum(&self, slowness: &[f64]) -> Option<f64> {
        let mean = slowness.iter().sum::<f64>() / slowness.len() as f64;
        let spread: f64 = slowness.iter().map(|delta| (delta - mean).powi(2)).sum();
        let collapses = slowness.iter().any(|delta| delta - mean > 2.0 * self.decorrelation);
        let gain = if spread > 0.0 { spread / (4.0 * self.decorrelation) } else { 0.0 };
        (!slowness.is_empty() && !collapses && gain.is_finite()).then(|| gain - slowness.iter().sum::<f64>())
    }

    /// `F` and its gradient, from the moments of a series.
    ///
    /// # Errors
    /// Shapes that do not fit; a feature without variance; weights of penalties that are negative.
    pub fn slope(&self, map: &LinearMap, moments: &Moments) -> Result<Slope, CoherenceError> {
        self.check()?;
        CoherenceError::unless_fits("the number of rows of the weights", map.weights.nrows(), moments.size())?;
        CoherenceError::unless_fits("the length of the offset", map.offset.len(), map.weights.ncols())?;
        self.slope_of(map, &Expectations::new(moments))
    }

    fn slope_of(&self, map: &LinearMap, expectations: &Expectations) -> Result<Slope, CoherenceError> {
        let (w, k) = (&map.weights, map.weights.ncols());
        let cw = &expectations.covariance * w;
        let dw = &expectations.rate * w;
        let covariance = w.transpose() * &cw;
        let power = w.transpose() * &dw;
        let input_mean = w.transpose() * &expectations.mean;
        let variance = |i: usize| covariance[(i, i)];
        if let Some(feature) = (0..k).find(|&i| !(variance(i) > 0.0 && variance(i).is_finite())) {
            return Err(CoherenceError::NoVariance { feature, variance: variance(feature) });
        }
        let mean: Vec<f64> = (0..k).map(|i| input_mean[(i, 0)] - map.offset[i]).collect();

        let mut value = 0.0;
        // ∂F/∂W = Ḋ W diag(a) + C W B + m_x eᵀ: collect a, B and e.
        let mut of_rate = vec![0.0; k];
        let mut of_covariance = Mat::<f64>::zeros(k, k);
        let mut of_mean = vec![0.0; k];
        for i in 0..k {
            let v = variance(i);
            value -= power[(i, i)] / v;
            of_rate[i] = -2.0 / v;
            of_covariance[(i, i)] += 2.0 * power[(i, i)] / (v * v);
            value -= self.mean * mean[i] * mean[i] / v;
            of_mean[i] = -2.0 * self.mean * mean[i] / v;
            of_covariance[(i, i)] += 2.0 * self.mean * mean[i] * mean[i] / (v * v);
            for j in (0..k).filter(|&j| j != i) {
                let correlation = covariance[(j, i)] / (v * variance(j));
                value -= self.decorrelation * correlation * covariance[(j, i)];
                // Each pair stands twice in the sum, hence 4 and not 2.
                of_covariance[(j, i)] -= 4.0 * self.decorrelation * correlation;
                of_covariance[(i, i)] += 4.0 * self.decorrelation * correlation * covariance[(j, i)] / v;
            }
        }
        let mut weights = &cw * &of_covariance;
        for i in 0..k {
            for row in 0..w.nrows() {
                weights[(row, i)] += dw[(row, i)] * of_rate[i] + expectations.mean[(row, 0)] * of_mean[i];
            }
        }
        Ok(Slope { value, weights, offset: of_mean.iter().map(|slope| -slope).collect() })
    }
}

/// What `F` needs to know of a series.
struct Expectations {
    mean: Mat<f64>,
    covariance: Mat<f64>,
    rate: Mat<f64>,
}

impl Expectations {
    fn new(moments: &Moments) -> Self {
        Expectations { mean: moments.mean(), covariance: moments.covariance(), rate: moments.rate() }
    }
}

/// Steps of [`ascend`] stay finite, so that they can be halved.
const LONGEST_STEP: f64 = f64::MAX;

/// Options of [`ascend`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AscentOptions {
    /// The objective.
    pub objective: Coherence,
    /// Number of features `k`.
    pub features: usize,
    /// Converged when `‖∂F/∂W‖` is below this, at features of unit variance, > 0.
    pub tolerance: f64,
    /// Steps after which it gives up.
    pub most_steps: usize,
}

/// Where an ascent ended.
#[derive(Debug, Clone, PartialEq)]
pub struct Ascent {
    /// The map; features have unit variance on the series.
    pub map: LinearMap,
    /// The value of `F`.
    pub value: f64,
    /// Steps taken.
    pub steps: usize,
    /// Norm of the gradient there.
    pub slope: f64,
    /// Whether that is below the tolerance. If not, the map is the best one found, but no maximum.
    pub converged: bool,
}

/// Climb `F` over a recorded series, from random weights.
///
/// Every step goes along the gradient as far as `F` grows by at least half of what the gradient promises. Inputs should be
/// white (e.g. principal components of variance 1): otherwise steps are as small as the direction of most variance asks for.
///
/// # Shapes
/// `x: d × n`, `links: n`.
///
/// # Errors
/// Shapes that do not fit; values or links that are not finite; parameters out of range; constant inputs.
pub fn ascend(
    x: MatRef<'_, f64>,
    links: &[Option<Link>],
    options: AscentOptions,
    rng: &mut impl rand::Rng,
) -> Result<Ascent, CoherenceError> {
    let AscentOptions { objective, features: k, tolerance, most_steps } = options;
    objective.check()?;
    CoherenceError::unless(tolerance > 0.0 && tolerance.is_finite(), "the tolerance", tolerance, "> 0 and finite")?;
    check_features(k, x.nrows())?;
    let expectations = Expectations::new(&moments_of(x, links)?);
    let centred = |weights| LinearMap::centred(weights, expectations.mean.as_ref());
    let normalised = |mut weights: Mat<f64>| -> Result<LinearMap, CoherenceError> {
        let covariance = weights.transpose() * (&expectations.covariance * &weights);
        for feature in 0..k {
            let variance = covariance[(feature, feature)];
            if !(variance > 0.0 && variance.is_finite()) {
                return Err(CoherenceError::NoVariance { feature, variance });
            }
            weights.col_mut(feature).iter_mut().for_each(|weight| *weight /= variance.sqrt());
        }
        Ok(centred(weights))
    };
    let mut map = normalised(random_weights(x.nrows(), k, rng))?;
    let mut here = objective.slope_of(&map, &expectations)?;
    let mut length = 1.0f64;
    for steps in 0..most_steps {
        let slope = here.weights.norm_l2();
        if !slope.is_finite() {
            return Err(CoherenceError::Diverged { steps });
        }
        if slope <= tolerance {
            return Ok(Ascent { map, value: here.value, steps, slope, converged: true });
        }
        // Longer again after every success, shorter until one.
        length = (2.0 * length).min(LONGEST_STEP);
        let found = loop {
            let there = normalised(&map.weights + &here.weights * faer::Scale(length))
                .and_then(|map| Ok((objective.slope_of(&map, &expectations)?, map)));
            match there {
                Ok((next, map)) if next.value >= here.value + 0.5 * length * slope * slope => break Some((next, map)),
                _ if length * slope < f64::EPSILON => break None,
                _ => length *= 0.5, // ends, since length and slope are finite
            }
        };
        match found {
            Some((next, better)) => (here, map) = (next, better),
            // Rounding of F hides what is left to gain.
            None => return Ok(Ascent { map, value: here.value, steps, slope, converged: false }),
        }
    }
    let slope = here.weights.norm_l2();
    Ok(Ascent { map, value: here.value, steps: most_steps, slope, converged: slope <= tolerance })
}

/// Options of [`OnlineCoherence`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OnlineOptions {
    /// The objective.
    pub objective: Coherence,
    /// Number of features `k`.
    pub features: usize,
    /// Length of the first step along the gradient of one frame, > 0.
    pub learning_rate: f64,
    /// How the rate falls, ≥ 0: step `t` has the length `learning_rate / (1 + decay·t)`. With 0 it stays as it is, and weights tremble about a
    /// maximum for ever, by more the longer steps are.
    pub decay: f64,
    /// Share by which every frame replaces the running estimates, in (0, 1). Steps begin after `1/forgetting` derivatives,
    /// up to which the estimates are plain averages.
    pub forgetting: f64,
}

/// Gradient ascent on `F` along a stream, without any matrix of size `d × d`.
///
/// The expectations that stand as factors in the gradient are running estimates; what they multiply is taken from the
/// frame at hand. A frame costs `O(d k + k²)`.
#[derive(Debug, Clone)]
pub struct OnlineCoherence {
    options: OnlineOptions,
    map: LinearMap,
    /// Running mean of the inputs, of the features about it: variances and covariances; derivative power.
    input_mean: Vec<f64>,
    covariance: Mat<f64>,
    power: Vec<f64>,
    before: Option<Vec<f64>>,
    frames: usize,
    derivatives: usize,
    steps: usize,
}

impl OnlineCoherence {
    /// A start at random weights.
    ///
    /// # Errors
    /// Parameters out of range; more features than inputs, or none.
    pub fn new(inputs: usize, options: OnlineOptions, rng: &mut impl rand::Rng) -> Result<Self, CoherenceError> {
        let OnlineOptions { objective, features: k, learning_rate, decay, forgetting } = options;
        objective.check()?;
        CoherenceError::unless(
            learning_rate > 0.0 && learning_rate.is_finite(),
            "the learning rate",
            learning_rate,
            "> 0 and finite",
        )?;
        CoherenceError::unless(decay >= 0.0 && decay.is_finite(), "the decay", decay, "≥ 0 and finite")?;
        CoherenceError::unless(forgetting > 0.0 && forgetting < 1.0, "the forgetting rate", forgetting, "in (0, 1)")?;
        check_features(k, inputs)?;
        let scale = 1.0 / (inputs as f64).sqrt();
        Ok(OnlineCoherence {
            options,
            map: LinearMap { weights: random_weights(inputs, k, rng) * faer::Scale(scale), offset: vec![0.0; k] },
            input_mean: vec![0.0; inputs],
            covariance: Mat::zeros(k, k),
            power: vec![0.0; k],
            before: None,
            frames: 0,
            derivatives: 0,
            steps: 0,
        })
    }

    /// The map of this moment.
    pub fn map(&self) -> &LinearMap {
        &self.map
    }

    /// Take one frame of `d` inputs; `link` as in [`crate::slow::SlowStream::push`].
    ///
    /// # Errors
    /// Another number of inputs; values that are not finite; weights that run away. Nothing is changed then.
    pub fn update(&mut self, x: &[f64], link: Option<Link>) -> Result<(), CoherenceError> {
        CoherenceError::unless_fits("the number of inputs", x.len(), self.input_mean.len())?;
        check_frame(self.frames, x.iter().copied())?;
        check_link(self.frames, link)?;
        let mut next = self.clone();
        next.take(x, link);
        let finite = |matrix: &Mat<f64>| matrix.col_iter().all(|column| column.iter().all(|value| value.is_finite()));
        if !(finite(&next.map.weights)
            && finite(&next.covariance)
            && next.map.offset.iter().chain(&next.power).all(|v| v.is_finite()))
        {
            return Err(CoherenceError::Diverged { steps: self.derivatives });
        }
        *self = next;
        Ok(())
    }

    fn take(&mut self, x: &[f64], link: Option<Link>) {
        let k = self.options.features;
        self.frames += 1;
        let share = self.options.forgetting.max(1.0 / self.frames as f64);
        for (mean, value) in self.input_mean.iter_mut().zip(x) {
            *mean += share * (value - *mean);
        }
        let centred: Vec<f64> = x.iter().zip(&self.input_mean).map(|(value, mean)| value - mean).collect();
        let phi = project(&self.map.weights, &centred);
        for i in 0..k {
            for j in 0..k {
                self.covariance[(i, j)] += share * (phi[i] * phi[j] - self.covariance[(i, j)]);
            }
        }
        if let (Some(link), Some(before)) = (link, &self.before) {
            self.derivatives += 1;
            let share = self.options.forgetting.max(1.0 / self.derivatives as f64);
            let scale = link.weight.sqrt() / link.dt;
            let rate: Vec<f64> = x.iter().zip(before).map(|(now, before)| (now - before) * scale).collect();
            let phi_rate = project(&self.map.weights, &rate);
            for (power, rate) in self.power.iter_mut().zip(&phi_rate) {
                *power += share * (rate * rate - *power);
            }
            if self.derivatives as f64 * self.options.forgetting >= 1.0 {
                self.step(&centred, &phi, &rate, &phi_rate);
            }
        }
        self.before = Some(x.to_vec());
    }

    fn step(&mut self, centred: &[f64], phi: &[f64], rate: &[f64], phi_rate: &[f64]) {
        let OnlineOptions { objective: Coherence { decorrelation, mean: mean_weight }, learning_rate, decay, .. } =
            self.options;
        let length = learning_rate / (1.0 + decay * self.steps as f64);
        self.steps += 1;
        let k = phi.len();
        // A feature that does not vary yet has no slope: its terms would be divided by 0.
        let variance: Vec<f64> = (0..k).map(|i| self.covariance[(i, i)]).collect();
        if variance.iter().any(|&v| v < f64::MIN_POSITIVE) {
            return;
        }
        let input_mean = project(&self.map.weights, &self.input_mean);
        let means: Vec<f64> = input_mean.iter().zip(&self.map.offset).map(|(mean, offset)| mean - offset).collect();
        let steps: Vec<(f64, f64, f64)> = (0..k)
            .map(|i| {
                let v = variance[i];
                let mut along_centred = self.power[i] / (v * v) * phi[i];
                along_centred += mean_weight * means[i] * means[i] / (v * v) * phi[i];
                for j in (0..k).filter(|&j| j != i) {
                    let correlation = self.covariance[(i, j)] / (v * variance[j]);
                    along_centred -=
                        2.0 * decorrelation * correlation * (phi[j] - self.covariance[(i, j)] / v * phi[i]);
                }
                (2.0 * along_centred, -2.0 * phi_rate[i] / v, -2.0 * mean_weight * means[i] / v)
            })
            .collect();
        for (i, (along_centred, along_rate, along_mean)) in steps.into_iter().enumerate() {
            for (row, weight) in self.map.weights.col_mut(i).iter_mut().enumerate() {
                let slope = along_centred * centred[row] + along_rate * rate[row] + along_mean * self.input_mean[row];
                *weight += length * slope;
            }
            // Without the penalty the offset is free, and follows the mean.
            self.map.offset[i] =
                if mean_weight > 0.0 { self.map.offset[i] - length * along_mean } else { input_mean[i] };
        }
        self.rescale();
    }

    /// `F` does not see scale, but steps shrink with it: bring each feature back to unit variance, estimates included.
    fn rescale(&mut self) {
        for i in 0..self.options.features {
            let deviation = self.covariance[(i, i)].sqrt();
            self.map.weights.col_mut(i).iter_mut().for_each(|weight| *weight /= deviation);
            self.map.offset[i] /= deviation;
            self.power[i] /= deviation * deviation;
            for j in 0..self.options.features {
                self.covariance[(i, j)] /= deviation;
                self.covariance[(j, i)] /= deviation;
            }
        }
    }
}
