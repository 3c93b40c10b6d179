//! Least-squares policy iteration over a fixed set of transitions, and the evaluation of one policy (LSQ).

use std::collections::HashMap;

use faer::{Mat, MatRef, Par};
use rand::RngExt;

use super::blocks::{Blocks, Outcomes, Samples};
use super::cross::{self, GreedyCross};
use super::error::{discount, finite_matrix, parameter, ridge};
use super::norm::closeness_weights;
use super::soft::LocalErrors;
use super::{Policy, ValueError, greedy};

/// The policy of the first evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Start {
    /// All actions that may follow, alike: `φ′ = 1/|A| Σ_a φ(x′, a)` (thesis §5.3.2).
    #[default]
    Uniform,
    /// For each sample one action, drawn with this seed: the initial random policy of the thesis's algorithm 7.
    Drawn(u64),
    /// For each sample the first action that may follow: greedy for weights that are all zero.
    First,
}

/// Options of [`Lspi::fit`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Discount γ per action, in [0, 1).
    pub gamma: f64,
    /// Added to the diagonal of the summed system, ≥ 0.
    pub ridge: f64,
    /// β: share of the greedy policy in each step, in (0, 1].
    pub mixing: f64,
    /// Give up after this many evaluations, ≥ 1.
    pub max_iterations: usize,
    /// Converged when no weight changes by more than this share of the largest one, ≥ 0.
    pub tolerance: f64,
    /// The policy of the first evaluation.
    pub start: Start,
    /// Let each action follow with the probability that it is the best one, given the local errors of the values,
    /// instead of the greedy action alone. Each evaluation takes 20 to 150 times as long: of 20 000 samples 0.02 to 0.1 s on two
    /// cores, for 2 to 5 actions and 10 to 50 features.
    pub soft: bool,
    /// κ > 0 of the policy-dependent norm: samples whose two best actions are close in value weigh more, the more the
    /// smaller κ is. `None`: weights as given.
    pub closeness: Option<f64>,
}

/// γ = 0.9 and β = 0.3, which converges where the greedy iteration of [`Options::plain`] often runs in circles.
impl Default for Options {
    fn default() -> Self {
        Options { mixing: 0.3, ..Options::plain() }
    }
}

impl Options {
    /// The thesis's iteration, which is that of Lagoudakis & Parr: each policy is the greedy one (β = 1). It may run in circles, or
    /// settle on a policy that never arrives; see [`Lspi::fit`].
    pub fn plain() -> Self {
        Options {
            gamma: 0.9,
            ridge: 0.0,
            mixing: 1.0,
            max_iterations: 100,
            tolerance: 1e-6,
            start: Start::Uniform,
            soft: false,
            closeness: None,
        }
    }
}

impl Options {
    fn check(&self) -> Result<(), ValueError> {
        discount(self.gamma)?;
        ridge(self.ridge)?;
        if !(self.mixing > 0.0 && self.mixing <= 1.0) {
            return Err(ValueError::Mixing(self.mixing));
        }
        if self.max_iterations == 0 {
            return Err(ValueError::Iterations);
        }
        parameter("tolerance", self.tolerance, self.tolerance >= 0.0 && self.tolerance.is_finite(), "≥ 0 and finite")?;
        let kappa = self.closeness.unwrap_or(1.0);
        parameter("closeness", kappa, kappa > 0.0 && kappa.is_finite(), "> 0 and finite")
    }

    /// Whether a step changes nothing but the greedy actions, so that equal actions mean equal weights, but for rounding.
    fn is_plain(&self) -> bool {
        self.mixing == 1.0 && !self.soft && self.closeness.is_none()
    }
}

/// The result of policy iteration.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// `Q(x, a) = φ(x)ᵀ w_a`, `f × A`, one action a column.
    pub weights: Mat<f64>,
    /// Evaluations done.
    pub iterations: usize,
    /// Whether the weights and the greedy actions stopped changing. It does not say that the policy is any good: one that drives in
    /// circles, or never arrives, can be as settled as another. Follow the policy to know
    /// ([`FiniteMdp::arrival`](super::FiniteMdp::arrival), trials).
    pub converged: bool,
    /// Length of the circle in which the greedy policy ran, if it did.
    pub cycle: Option<usize>,
    /// Actions of which there was no sample, by their numbers: their weights are 0 and mean nothing.
    pub untried: Vec<usize>,
}

impl Fit {
    /// `Q(x, a)` of the columns of `phi`, `A × n`. Of an action that was never tried nothing is known: its value is −∞, so that no
    /// greedy policy takes it.
    ///
    /// # Errors
    /// Another number of features than was fitted, values that are not finite.
    pub fn action_values(&self, phi: MatRef<'_, f64>) -> Result<Mat<f64>, ValueError> {
        if phi.nrows() != self.weights.nrows() {
            let expected = self.weights.nrows();
            return Err(ValueError::Features { what: "phi", found: phi.nrows(), expected });
        }
        finite_matrix("phi", phi)?;
        let mut q = self.weights.transpose() * phi;
        if !q.is_all_finite() {
            return Err(ValueError::NotFinite(self.weights.nrows() * self.weights.ncols()));
        }
        for &action in &self.untried {
            (0..q.ncols()).for_each(|j| q[(action, j)] = f64::NEG_INFINITY);
        }
        Ok(q)
    }

    /// The greedy policy in the states whose features are the columns of `phi`.
    ///
    /// # Errors
    /// Another number of features than was fitted, values that are not finite.
    pub fn policy(&self, phi: MatRef<'_, f64>) -> Result<Policy, ValueError> {
        Policy::greedy(self.action_values(phi)?.as_ref())
    }
}

/// The part of the problem that depends on neither policy nor rewards; tasks share it.
///
/// *LSQ* is LSTD on state–action pairs: [`Lspi::evaluate`] solves the block system of a given policy once
/// (thesis §3.2.2). *LSPI* alternates it with an improvement of the policy (thesis §3.3): only the actions that
/// follow `x′_i` change, the samples stay.
///
/// The first evaluation is of the policy that takes all actions alike (thesis §5.3.2: this doubled the range in which
/// the iteration converges). Later ones move it towards the greedy policy, `π ← (1 − β)π + β·greedy`: with β = 1 this is
/// plain LSPI, which can run in circles; such a circle is found and reported. `M` is linear in π, so a step costs at most
/// one product per transition, `M ← (1 − β)M + β·M(greedy)`, whatever the mixture; from the second improvement on only the
/// transitions whose greedy action changed cost one.
///
/// Two ideas of the thesis's outlook are options, off by default: soft actions ([`Options::soft`], see
/// [`maximiser_probabilities`](super::maximiser_probabilities)) and the policy-dependent norm ([`Options::closeness`],
/// see [`closeness_weights`]). Both need the policy itself, `A × N`, and rebuild `M` in each step: `A` products per
/// transition, and with the norm the Gram matrices too.
#[derive(Debug)]
pub struct Lspi<'a> {
    data: Samples<'a>,
    actions: usize,
    blocks: Blocks,
}

impl<'a> Lspi<'a> {
    /// Prepare the samples for fitting.
    ///
    /// # Errors
    /// Lists of different lengths, no transitions, no features, an action out of range, weights that are negative, values
    /// that are not finite, more features and actions than a system of equations has room for.
    pub fn new(data: Samples<'a>, actions: usize, par: Par) -> Result<Self, ValueError> {
        let blocks = Blocks::new(data, actions, par)?;
        Ok(Lspi { data, actions, blocks })
    }

    /// LSQ: the Q-weights of a fixed policy, `f × A`.
    ///
    /// Column `i` of `policy` tells which actions follow sample `i`, at `x′_i` (see [`Policy::at`]); what
    /// [`Outcomes::allowed`] says does not matter here. γ = 1 is allowed, for tasks that end.
    ///
    /// # Errors
    /// Outcomes or a policy of another size than the samples, γ outside [0, 1], a negative ridge, values that are not
    /// finite.
    ///
    /// # Reference
    /// Lagoudakis & Parr 2003 (LSTDQ); thesis §3.2.2, algorithm 6, there with one drawn action `a′_i`, here with its
    /// expectation over the policy.
    pub fn evaluate(
        &self,
        outcomes: &Outcomes<'_>,
        policy: &Policy,
        gamma: f64,
        ridge: f64,
    ) -> Result<Mat<f64>, ValueError> {
        outcomes.check(self.data.phi.nrows(), self.data.phi.ncols(), self.actions)?;
        policy.check_size(self.data.phi.ncols(), self.actions)?;
        super::error::discount_or_one(gamma)?;
        super::error::ridge(ridge)?;
        let cross = cross::of_policy(&self.blocks, outcomes.next, policy.probabilities());
        self.blocks.solve(&cross, &self.blocks.right_hand_side(outcomes.rewards), gamma, ridge)
    }

    /// Policy iteration for one task.
    ///
    /// The first evaluation is of the policy that [`Options::start`] names. Later ones move it towards the greedy policy,
    /// `π ← (1 − β)π + β·greedy` with β = [`Options::mixing`]. With β = 1 this is plain LSPI, which can run in circles; such a
    /// circle is found and its length reported in [`Fit::cycle`].
    ///
    /// # What the options bring
    /// In two rooms (slip 0.1, γ = 0.95, ridge 1e-3, at most 60 evaluations, 500 random steps, 20 seeds) with 16 and 36 cosine
    /// features, the runs that converged, and the value of all policies as a share of the optimum, were:
    ///
    /// | | 16 features | 36 features |
    /// |---|---|---|
    /// | plain, from all actions alike | 11 of 20, 0.40 ± 0.06 | 2 of 20, 0.11 ± 0.02 |
    /// | plain, from drawn actions | 7 of 20, 0.36 ± 0.07 | 2 of 20, 0.12 ± 0.03 |
    /// | β = 0.3 | 20 of 20, 0.58 ± 0.06 | 17 of 20, 0.57 ± 0.08 |
    /// | soft actions | 16 of 20, 0.48 ± 0.06 | 15 of 20, 0.55 ± 0.08 |
    /// | soft actions, β = 0.3 | 20 of 20, 0.58 ± 0.06 | 17 of 20, 0.58 ± 0.07 |
    /// | norm κ = 1 | 4 of 20, 0.23 ± 0.06 | 2 of 20, 0.09 ± 0.02 |
    /// | norm κ = 1, β = 0.3 | 14 of 20, 0.65 ± 0.06 | 14 of 20, 0.61 ± 0.06 |
    ///
    /// So mixing helps most. Soft actions help plain LSPI nearly as much, but add nothing to mixing. The norm alone does harm; with
    /// mixing its gain is within the error, and fewer runs converge. The thesis's gain from the first policy is a
    /// tendency at best here. (`cargo run --release --example outlook` prints the table; ± is the standard error.)
    ///
    /// # Errors
    /// Outcomes of another size than the samples, a sample after which nothing is allowed, options outside their
    /// ranges, values that are not finite.
    ///
    /// # Reference
    /// Lagoudakis & Parr 2003; thesis §3.3.1, algorithm 7.
    pub fn fit(&self, outcomes: &Outcomes<'_>, options: &Options) -> Result<Fit, ValueError> {
        outcomes.check(self.data.phi.nrows(), self.data.phi.ncols(), self.actions)?;
        options.check()?;
        let untried: Vec<usize> = (0..self.actions).filter(|&a| self.blocks.members(a).is_empty()).collect();
        let allowed = self.tried(outcomes, &untried);
        let outcomes = &Outcomes { allowed: allowed.as_deref().or(outcomes.allowed), ..*outcomes };
        let mut system = System::new(self, outcomes, options)?;
        let mut weights = Mat::zeros(self.data.phi.nrows(), self.actions);
        let mut chosen: Vec<usize> = Vec::new();
        let mut seen: HashMap<Vec<usize>, usize> = HashMap::new();
        let mut fit = Fit { weights: weights.clone(), iterations: 0, converged: false, cycle: None, untried };
        for iteration in 1..=options.max_iterations {
            let new = system.solve()?;
            let change = (&new - &weights).norm_max();
            let settled = change <= options.tolerance * new.norm_max();
            weights = new;
            let q = self.blocks.action_values(&weights, outcomes.next);
            let next_chosen = greedy_after(outcomes, &q);
            let same = next_chosen == chosen;
            chosen = next_chosen;
            fit.iterations = iteration;
            if same && (settled || options.is_plain()) {
                fit.converged = true;
                break;
            }
            if options.is_plain()
                && let Some(before) = seen.insert(chosen.clone(), iteration)
            {
                fit.cycle = Some(iteration - before);
                break;
            }
            system.improve(&weights, &q, &chosen)?;
        }
        fit.weights = weights;
        Ok(fit)
    }

    /// What may follow each sample, without actions that were never tried: nothing is known of them, and 0 would be the best of
    /// negative values. After a sample where only such may follow, all that was tried may. `None`: as the outcomes say (also for
    /// more actions than there are bits).
    fn tried(&self, outcomes: &Outcomes<'_>, untried: &[usize]) -> Option<Vec<u32>> {
        if untried.is_empty() || self.actions > u32::BITS as usize {
            return None;
        }
        let tried = (0..self.actions).filter(|a| !untried.contains(a)).fold(0u32, |bits, a| bits | 1 << a);
        let given = |i: usize| outcomes.allowed.map_or(u32::MAX, |allowed| allowed[i]);
        let of = |i: usize| if given(i) & tried == 0 { tried } else { given(i) & tried };
        Some((0..self.data.phi.ncols()).map(of).collect())
    }
}

/// The system of the current policy, and how it moves to the next one.
struct System<'p> {
    problem: &'p Lspi<'p>,
    outcomes: &'p Outcomes<'p>,
    options: &'p Options,
    cross: Mat<f64>,
    /// `M` of the greedy policy alone, from the first improvement on, where no option needs the policy itself.
    greedy: Option<GreedyCross>,
    right: Mat<f64>,
    /// Blocks under the policy-dependent norm.
    reweighted: Option<Blocks>,
    /// `π(b | x′_i)`, `A × N`: kept only where an option needs it.
    policy: Option<Mat<f64>>,
    /// For soft actions: the errors under the weights as given, with or without the norm.
    errors: Option<LocalErrors>,
}

impl<'p> System<'p> {
    fn new(problem: &'p Lspi<'p>, outcomes: &'p Outcomes<'p>, options: &'p Options) -> Result<Self, ValueError> {
        let policy = first_policy(outcomes, problem.actions, options.start);
        let cross = cross::of_policy(&problem.blocks, outcomes.next, policy.as_ref());
        let right = problem.blocks.right_hand_side(outcomes.rewards);
        let policy = (options.soft || options.closeness.is_some()).then_some(policy);
        let local = || LocalErrors::new(&problem.blocks, problem.data.weights, outcomes.next, options.ridge);
        let errors = if options.soft { Some(local()?) } else { None };
        Ok(System { problem, outcomes, options, cross, greedy: None, right, reweighted: None, policy, errors })
    }

    fn blocks(&self) -> &Blocks {
        self.reweighted.as_ref().unwrap_or(&self.problem.blocks)
    }

    fn solve(&self) -> Result<Mat<f64>, ValueError> {
        self.blocks().solve(&self.cross, &self.right, self.options.gamma, self.options.ridge)
    }

    /// Move the policy towards the better one. `q` are the values of `weights` at `x′`, `chosen` the greedy actions there.
    fn improve(&mut self, weights: &Mat<f64>, q: &Mat<f64>, chosen: &[usize]) -> Result<(), ValueError> {
        let Some(mut policy) = self.policy.take() else {
            // No policy is kept only without soft actions and norm: the blocks are the problem's.
            let (blocks, next) = (&self.problem.blocks, self.outcomes.next);
            match &mut self.greedy {
                Some(greedy) => greedy.update(blocks, next, chosen),
                greedy => *greedy = Some(GreedyCross::new(blocks, next, chosen)),
            }
            if let Some(greedy) = &self.greedy {
                let beta = self.options.mixing;
                faer::zip!(&mut self.cross, greedy.matrix())
                    .for_each(|faer::unzip!(mixed, greedy)| *mixed = (1.0 - beta) * *mixed + beta * greedy);
            }
            return Ok(());
        };
        let data = self.problem.data;
        let before = self.problem.blocks.action_values(weights, data.phi);
        let better = if let Some(errors) = &self.errors {
            let residual = |i: usize| {
                let after: f64 = (0..q.nrows()).map(|b| policy[(b, i)] * q[(b, i)]).sum();
                self.outcomes.rewards[i] + self.options.gamma * after - before[(data.actions[i], i)]
            };
            let residuals: Vec<f64> = (0..data.phi.ncols()).map(residual).collect();
            errors.soft_policy(self.outcomes, q, &residuals, data.weights)?
        } else {
            Mat::from_fn(q.nrows(), q.ncols(), |b, i| f64::from(u8::from(chosen[i] == b)))
        };
        let beta = self.options.mixing;
        policy = Mat::from_fn(q.nrows(), q.ncols(), |b, i| (1.0 - beta) * policy[(b, i)] + beta * better[(b, i)]);
        if let Some(kappa) = self.options.closeness {
            let weights = closeness_weights(before.as_ref(), data.weights, kappa)?;
            let blocks =
                Blocks::new(Samples { weights: &weights, ..data }, self.problem.actions, self.problem.blocks.par())?;
            self.right = blocks.right_hand_side(self.outcomes.rewards);
            self.reweighted = Some(blocks);
        }
        self.cross = cross::of_policy(self.blocks(), self.outcomes.next, policy.as_ref());
        self.policy = Some(policy);
        Ok(())
    }
}

/// Where the iteration starts, `A × N`.
fn first_policy(outcomes: &Outcomes<'_>, actions: usize, start: Start) -> Mat<f64> {
    let n = outcomes.next.ncols();
    let may = |sample: usize| (0..actions).filter(move |&b| outcomes.allows(sample, b));
    let counts: Vec<usize> = (0..n).map(|sample| may(sample).count()).collect();
    let alone = |picked: Vec<usize>| Mat::from_fn(actions, n, |b, i| f64::from(u8::from(picked[i] == b)));
    match start {
        Start::Uniform => {
            let share = |b, i| if outcomes.allows(i, b) { 1.0 / counts[i] as f64 } else { 0.0 };
            Mat::from_fn(actions, n, share)
        }
        Start::Drawn(seed) => {
            let mut rng = crate::random::stream(seed, "first policy");
            // Every sample allows an action: the outcomes were checked.
            alone((0..n).map(|i| may(i).nth(rng.random_range(0..counts[i].max(1))).unwrap_or(0)).collect())
        }
        Start::First => alone((0..n).map(|i| may(i).next().unwrap_or(0)).collect()),
    }
}

/// The best action of those that may follow each sample, from the values `q` there.
fn greedy_after(outcomes: &Outcomes<'_>, q: &Mat<f64>) -> Vec<usize> {
    let value = |sample: usize, a: usize| if outcomes.allows(sample, a) { q[(a, sample)] } else { f64::NEG_INFINITY };
    (0..q.ncols()).map(|sample| greedy((0..q.nrows()).map(|a| value(sample, a)))).collect()
}
