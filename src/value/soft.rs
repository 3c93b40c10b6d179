//! Soft actions: which action a greedy policy would choose, if its values have errors.

use faer::{Mat, MatRef, Side};

use super::ValueError;
use super::blocks::{Blocks, Outcomes};
use super::error::{finite_list, parameter};
use crate::kernel::products::map_all;

/// Eigenvalues of a Gram matrix below this share of the largest one count as directions that were never seen.
const UNSEEN: f64 = 1e-12;

/// What of the local errors does not change during policy iteration.
#[derive(Debug)]
pub(super) struct LocalErrors {
    /// `φ′_iᵀ(G_b + ρI)⁻¹φ′_i`, `A × N`.
    leverage: Mat<f64>,
    /// Samples of each action.
    members: Vec<Vec<usize>>,
    /// `N_a − f`, at least 1, of each action; samples without weight do not count.
    freedom: Vec<f64>,
}

impl LocalErrors {
    pub fn new(blocks: &Blocks, weights: &[f64], next: MatRef<'_, f64>, ridge: f64) -> Result<Self, ValueError> {
        let mut leverage = Mat::zeros(blocks.gram().len(), next.ncols());
        let mut freedom = Vec::with_capacity(blocks.gram().len());
        for (b, gram) in blocks.gram().iter().enumerate() {
            let f = gram.nrows();
            if !gram.is_all_finite() {
                return Err(ValueError::NotFinite(f));
            }
            let eigen = gram.self_adjoint_eigen(Side::Lower).map_err(|_| ValueError::NotFinite(f))?;
            let largest = (0..f).map(|i| eigen.S()[i]).fold(0.0, f64::max);
            let seen = |i: usize| eigen.S()[i] > UNSEEN * largest;
            let inverse_of = |i: usize| {
                let inverse = 1.0 / (eigen.S()[i].max(0.0) + ridge);
                // A ridge below 1/f64::MAX has no inverse.
                if (seen(i) || ridge > 0.0) && inverse.is_finite() { inverse } else { 0.0 }
            };
            let inverses: Vec<f64> = (0..f).map(inverse_of).collect();
            let turned = eigen.U().transpose() * next;
            for i in 0..next.ncols() {
                leverage[(b, i)] = inverses.iter().enumerate().map(|(k, s)| s * turned[(k, i)].powi(2)).sum();
            }
            let rank = (0..f).filter(|&i| seen(i)).count();
            let samples = blocks.members(b).iter().filter(|&&i| weights[i] > 0.0).count();
            freedom.push(samples.saturating_sub(rank).max(1) as f64);
        }
        Ok(LocalErrors {
            leverage,
            members: (0..blocks.actions()).map(|b| blocks.members(b).to_vec()).collect(),
            freedom,
        })
    }

    /// The probability of each action to be the best one that may follow, `A × N`, from the values `q` at `x′` and the
    /// Bellman residuals of all samples.
    pub fn soft_policy(
        &self,
        outcomes: &Outcomes<'_>,
        q: &Mat<f64>,
        residuals: &[f64],
        weights: &[f64],
    ) -> Result<Mat<f64>, ValueError> {
        let variance = |(members, freedom): (&Vec<usize>, &f64)| {
            members.iter().map(|&i| weights[i] * residuals[i].powi(2)).sum::<f64>() / freedom
        };
        let variances: Vec<f64> = self.members.iter().zip(&self.freedom).map(variance).collect();
        let mut policy = Mat::zeros(q.nrows(), q.ncols());
        let of_sample = |i: usize| {
            let may: Vec<usize> = (0..q.nrows()).filter(|&b| outcomes.allows(i, b)).collect();
            let means: Vec<f64> = may.iter().map(|&b| q[(b, i)]).collect();
            let deviations: Vec<f64> =
                may.iter().map(|&b| (variances[b] * self.leverage[(b, i)]).max(0.0).sqrt()).collect();
            let probabilities = maximiser_probabilities(&means, &deviations)?;
            Ok(may.into_iter().zip(probabilities).collect::<Vec<_>>())
        };
        for (i, of_sample) in map_all(q.ncols(), of_sample).into_iter().enumerate() {
            of_sample?.into_iter().for_each(|(b, probability)| policy[(b, i)] = probability);
        }
        Ok(policy)
    }
}

/// Beyond this many standard deviations nothing is left of a Gaussian (6e-16 of its mass).
const REACH: i32 = 8;

/// Nodes (positive ones) and weights of the Gauss–Legendre rule with 8 points on [−1, 1] (Abramowitz & Stegun, table 25.4).
const LEGENDRE: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_5),
    (0.960_289_856_497_536_2, 0.101_228_536_290_376_3),
];

/// Step of the trapezoidal rule, in standard deviations of the narrowest of `A` Gaussians, times `√A`. The spectrum of a product of
/// `A` Gaussians or their integrals falls as `exp(−σ²ω²/2A)` at least: at `ω = 2π/h` that is `exp(−2π²/0.81²)`, 1e-13.
const STEP: f64 = 0.81;

/// The probability of each of several independent Gaussians to be the largest one:
/// `p_a = ∫ 𝒩(t; μ_a, σ_a²) Π_{b ≠ a} Φ((t − μ_b)/σ_b) dt`.
///
/// A greedy step puts all weight on the action with the largest estimated value, however close the next one is. The
/// thesis's outlook ("Consider local errors in policy iteration") suggests to estimate the local errors instead and to
/// let action `a` follow with the probability that it really is the best one:
/// `φ′ = Σ_a p(a) φ(x′, a)`.
///
/// In [`Lspi::fit`](super::Lspi::fit) the error of `Q(x, a) = w_aᵀφ(x)` is that of a linear regression on the samples of action `a`:
/// `σ_a²(x) = s_a² · φᵀ(G_a + ρI)⁻¹φ`, with `s_a² = Σ ω δ²/(N_a − f)` from the Bellman residuals
/// `δ = r + γ Σ_b π(b | x′) Q(x′, b) − Q(x, a)`, the ridge ρ, and `N_a` samples in `f` dimensions. It is large where an action
/// was rarely tried, and where values jump.
///
/// What it leaves out: an error at `x′` is inherited by the values before it; an action that was never tried has no
/// residuals, so its value counts as certain; and without a ridge so does what lies in a direction never seen (`G_a`
/// is then inverted on the others, and `f` is its rank).
///
/// Two values have a closed form. More are integrated by the trapezoidal rule, which is all but exact for Gaussians; where their σ
/// are so different that it needs more nodes, panel by panel, with panels no wider than the narrowest Gaussian that changes
/// there. The error is about 1e-10 or less. Values without error (σ = 0) that are equal share alike.
///
/// ```
/// use adagio::value::maximiser_probabilities;
///
/// let p = maximiser_probabilities(&[1.0, 0.0], &[0.6, 0.8])?;
/// assert!((p[0] - 0.841_344_746_068_543).abs() < 1e-10); // Φ(1), since σ of the difference is 1
/// assert_eq!(maximiser_probabilities(&[1.0, 0.0], &[0.0, 0.0])?, [1.0, 0.0]);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Errors
/// No values, lists of different lengths, values that are not finite, a negative deviation.
pub fn maximiser_probabilities(means: &[f64], deviations: &[f64]) -> Result<Vec<f64>, ValueError> {
    if means.is_empty() {
        return Err(ValueError::NoActions);
    }
    if deviations.len() != means.len() {
        return Err(ValueError::Length { what: "deviations", found: deviations.len(), expected: means.len() });
    }
    finite_list("means", means)?;
    for &deviation in deviations {
        parameter("deviation", deviation, deviation >= 0.0 && deviation.is_finite(), "≥ 0 and finite")?;
    }
    // In units of the problem, so that neither very large nor very small numbers overflow.
    let centre = means.iter().copied().fold(f64::MIN, f64::max);
    let gap = means.iter().map(|mean| centre / 2.0 - mean / 2.0).fold(0.0, f64::max);
    let scale = deviations.iter().copied().fold(gap, f64::max);
    if scale == 0.0 {
        return Ok(vec![1.0 / means.len() as f64; means.len()]);
    }
    let scaled = |(mean, deviation): (&f64, &f64)| ((mean - centre) / scale, deviation / scale);
    let bells: Vec<(f64, f64)> = means.iter().zip(deviations).map(scaled).collect();

    // The largest value is at least that of the best certain one.
    let certain = bells.iter().filter(|bell| bell.1 == 0.0).map(|bell| bell.0).fold(f64::NEG_INFINITY, f64::max);
    let ties = bells.iter().filter(|bell| bell.1 == 0.0 && bell.0 == certain).count();
    let reach = |bell: &(f64, f64), sign: f64| bell.0 + sign * f64::from(REACH) * bell.1;
    let low = bells.iter().map(|bell| reach(bell, -1.0)).fold(certain, f64::max);
    let high = bells.iter().map(|bell| reach(bell, 1.0)).fold(certain, f64::max);
    // Only these can be the largest.
    let contenders: Vec<usize> = (0..bells.len()).filter(|&a| reach(&bells[a], 1.0) >= low).collect();
    if contenders.len() < bells.len() {
        let of = |all: &[f64]| contenders.iter().map(|&a| all[a]).collect::<Vec<f64>>();
        let mut probabilities = vec![0.0; bells.len()];
        let found = maximiser_probabilities(&of(means), &of(deviations))?;
        contenders.iter().zip(found).for_each(|(&a, found)| probabilities[a] = found);
        return Ok(probabilities);
    }
    // Of two, it is the sign of one Gaussian.
    if let [a, b] = bells[..] {
        let first = 0.5 * libm::erfc((b.0 - a.0) / (a.1.hypot(b.1) * std::f64::consts::SQRT_2));
        return Ok(vec![first, 1.0 - first]);
    }
    let mut edges: Vec<f64> = vec![low, high];
    for &(mean, deviation) in bells.iter().filter(|bell| bell.1 > 0.0) {
        edges.extend(
            (-REACH..=REACH).map(|k| mean + f64::from(k) * deviation).filter(|edge| *edge > low && *edge < high),
        );
    }
    edges.sort_by(f64::total_cmp);

    let below = |t: f64, (mean, deviation): (f64, f64)| match deviation {
        0.0 => f64::from(u8::from(mean <= t)),
        _ => 0.5 * libm::erfc((mean - t) / (deviation * std::f64::consts::SQRT_2)),
    };
    let density = |t: f64, (mean, deviation): (f64, f64)| {
        let z = (t - mean) / deviation;
        if deviation == 0.0 { 0.0 } else { (-0.5 * z * z).exp() / (deviation * std::f64::consts::TAU.sqrt()) }
    };
    let others =
        |all: &[f64], a: usize| all.iter().enumerate().filter(|&(b, _)| b != a).map(|(_, p)| p).product::<f64>();

    // Certain values: the best of them is the largest one if all uncertain ones are below.
    let all_below: f64 = bells.iter().filter(|bell| bell.1 > 0.0).map(|&bell| below(certain, bell)).product();
    let of_certain = |bell: &(f64, f64)| {
        if bell.1 == 0.0 && bell.0 == certain { all_below / ties as f64 } else { 0.0 }
    };
    let mut probabilities: Vec<f64> = bells.iter().map(of_certain).collect();
    let mut cumulative = vec![0.0; bells.len()];
    let mut add = |t: f64, weight: f64| {
        cumulative.iter_mut().zip(&bells).for_each(|(cumulative, &bell)| *cumulative = below(t, bell));
        for (a, probability) in probabilities.iter_mut().enumerate() {
            *probability += weight * density(t, bells[a]) * others(&cumulative, a);
        }
    };
    let narrowest = bells.iter().map(|bell| bell.1).fold(f64::INFINITY, f64::min);
    let step = STEP * narrowest / (bells.len() as f64).sqrt();
    if step > 0.0 && (high - low) / step < (2 * LEGENDRE.len() * (edges.len() - 1)) as f64 {
        (0..=((high - low) / step) as usize).for_each(|k| add(low + k as f64 * step, step));
    } else {
        let nodes = LEGENDRE.into_iter().flat_map(|(node, weight)| [(-node, weight), (node, weight)]);
        for panel in edges.windows(2) {
            let (middle, half) = ((panel[0] + panel[1]) / 2.0, (panel[1] - panel[0]) / 2.0);
            nodes.clone().for_each(|(node, weight)| add(middle + half * node, half * weight));
        }
    }
    let total: f64 = probabilities.iter().sum();
    if total > 0.5 {
        return Ok(probabilities.into_iter().map(|p| p / total).collect());
    }
    // Deviations so small beside the means that they vanish in rounding.
    let best = super::greedy(means.iter().copied());
    Ok((0..means.len()).map(|a| f64::from(u8::from(a == best))).collect())
}
