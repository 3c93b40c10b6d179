//! Least-squares policy iteration over a fixed set of transitions.
//!
//! The weights of action `a` solve the block row `G_a w_a − γ Σ_b M_ab w_b = Σ_{i: a_i = a} ω_i φ_i r_i`, with
//! `G_a = Σ_{i: a_i = a} ω_i φ_i φ_iᵀ`, which does not depend on the policy and is built once, and
//! `M_ab = Σ_{i: a_i = a} ω_i π(b | x′_i) φ_i φ′_iᵀ`.
//!
//! The first evaluation is of the policy that takes all actions alike (thesis §5.3.2: this doubled the range in which
//! the iteration converges). Later ones move it towards the greedy policy, `π ← (1 − β)π + β·greedy`: with β = 1 this is
//! plain LSPI, which can run in circles; such a circle is found and reported. `M` is linear in π, so a step costs one
//! product per transition, `M ← (1 − β)M + β·M(greedy)`, whatever the mixture.

use std::collections::HashMap;

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Scale};

use super::ValueError;
use super::lstd::solve_or_pseudo_inverse;

/// States and the actions taken in them: column `i` of `phi` is what was seen before action `actions[i]`.
#[derive(Debug, Clone, Copy)]
pub struct Samples<'a> {
    /// `Φ`, `f × N`.
    pub phi: MatRef<'a, f64>,
    /// Action numbers, `N`, each below the number of actions.
    pub actions: &'a [usize],
    /// Weights `ω` ≥ 0, `N`.
    pub weights: &'a [f64],
}

/// What came of each sample, for one task.
#[derive(Debug, Clone, Copy)]
pub struct Outcomes<'a> {
    /// `Φ′`, `f × N`: what was seen after each action; a zero column where the episode ended.
    pub next: MatRef<'a, f64>,
    /// Rewards, `N`.
    pub rewards: &'a [f64],
    /// Which actions may follow each sample, as bits (bit `b`: action `b` may), `N`; `None`: all of them.
    ///
    /// With rules such as "a turn is not undone" what may follow depends on the action taken, not on what came
    /// before it, so `Q(x, a)` stays a function of `x` and `a`: `Q(x, a) = r + γ max_{b may follow} Q(x′, b)`.
    pub allowed: Option<&'a [u32]>,
}

impl Outcomes<'_> {
    fn allows(&self, sample: usize, action: usize) -> bool {
        self.allowed.is_none_or(|allowed| allowed[sample] & (1 << action) != 0)
    }

    fn check(&self, n: usize, actions: usize) -> Result<(), ValueError> {
        let allowed = self.allowed.map_or(n, <[u32]>::len);
        for (what, found) in [("next", self.next.ncols()), ("rewards", self.rewards.len()), ("allowed", allowed)] {
            if found != n {
                return Err(ValueError::Length { what, found, expected: n });
            }
        }
        match (0..n).find(|&sample| (0..actions).all(|action| !self.allows(sample, action))) {
            Some(index) => Err(ValueError::NothingAllowed { index, actions }),
            None => Ok(()),
        }
    }
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
    /// Give up after this many evaluations.
    pub max_iterations: usize,
    /// Converged when no weight changes by more than this share of the largest one.
    pub tolerance: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { gamma: 0.9, ridge: 0.0, mixing: 1.0, max_iterations: 100, tolerance: 1e-6 }
    }
}

/// The result of policy iteration.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// `Q(x, a) = φ(x)ᵀ w_a`, `f × A`, one action a column.
    pub weights: Mat<f64>,
    /// Evaluations done.
    pub iterations: usize,
    /// Whether the weights and the greedy actions stopped changing.
    pub converged: bool,
    /// Length of the circle in which the greedy policy ran, if it did.
    pub cycle: Option<usize>,
}

/// The part of the problem that depends on neither policy nor rewards; tasks share it.
#[derive(Debug)]
pub struct Lspi<'a> {
    data: Samples<'a>,
    actions: usize,
    /// Transition numbers of each action.
    members: Vec<Vec<usize>>,
    /// `ω_i φ_i` of the members of each action, `f × N_a`.
    weighted: Vec<Mat<f64>>,
    /// `G_a`, `f × f`.
    gram: Vec<Mat<f64>>,
    par: Par,
}

impl<'a> Lspi<'a> {
    /// Prepare the samples for fitting.
    ///
    /// # Errors
    /// Lists of different lengths, no transitions, an action out of range.
    pub fn new(data: Samples<'a>, actions: usize, par: Par) -> Result<Self, ValueError> {
        let n = data.phi.ncols();
        if n == 0 {
            return Err(ValueError::Empty);
        }
        for (what, found) in [("actions", data.actions.len()), ("weights", data.weights.len())] {
            if found != n {
                return Err(ValueError::Length { what, found, expected: n });
            }
        }
        let mut members = vec![Vec::new(); actions];
        for (index, &action) in data.actions.iter().enumerate() {
            members.get_mut(action).ok_or(ValueError::Action { index, action, actions })?.push(index);
        }
        let f = data.phi.nrows();
        let mut weighted = Vec::with_capacity(actions);
        let mut gram = Vec::with_capacity(actions);
        for of_action in &members {
            let plain = Mat::from_fn(f, of_action.len(), |i, j| data.phi[(i, of_action[j])]);
            let heavy = Mat::from_fn(f, of_action.len(), |i, j| plain[(i, j)] * data.weights[of_action[j]]);
            let mut g = Mat::zeros(f, f);
            matmul(g.as_mut(), Accum::Replace, heavy.as_ref(), plain.transpose(), 1.0, par);
            weighted.push(heavy);
            gram.push(g);
        }
        Ok(Lspi { data, actions, members, weighted, gram, par })
    }

    /// Policy iteration for one task.
    ///
    /// # Errors
    /// Outcomes of another length than the samples, a sample after which nothing is allowed, options outside their
    /// ranges, values that are not finite.
    ///
    /// # Reference
    /// Lagoudakis & Parr 2003; thesis §3.3, algorithm 5.
    pub fn fit(&self, outcomes: &Outcomes<'_>, options: &Options) -> Result<Fit, ValueError> {
        outcomes.check(self.data.phi.ncols(), self.actions)?;
        if !(0.0..1.0).contains(&options.gamma) {
            return Err(ValueError::Gamma(options.gamma));
        }
        if !(options.ridge >= 0.0 && options.ridge.is_finite()) {
            return Err(ValueError::Ridge(options.ridge));
        }
        if !(options.mixing > 0.0 && options.mixing <= 1.0) {
            return Err(ValueError::Mixing(options.mixing));
        }
        let right = self.right_hand_side(outcomes.rewards);
        let mut cross = self.cross_of_uniform(outcomes);
        let mut weights = Mat::zeros(self.data.phi.nrows(), self.actions);
        let mut chosen: Vec<usize> = Vec::new();
        let mut seen: HashMap<Vec<usize>, usize> = HashMap::new();
        let mut fit = Fit { weights: weights.clone(), iterations: 0, converged: false, cycle: None };
        for iteration in 1..=options.max_iterations {
            let new = self.evaluate(&cross, &right, options)?;
            let change = (&new - &weights).norm_max();
            let settled = change <= options.tolerance * new.norm_max();
            weights = new;
            let next_chosen = self.greedy_after(outcomes, &weights);
            let same = next_chosen == chosen;
            chosen = next_chosen;
            fit.iterations = iteration;
            if same && (settled || options.mixing == 1.0) {
                fit.converged = true;
                break;
            }
            if options.mixing == 1.0
                && let Some(before) = seen.insert(chosen.clone(), iteration)
            {
                fit.cycle = Some(iteration - before);
                break;
            }
            self.mix_in_greedy(&mut cross, outcomes.next, &chosen, options.mixing);
        }
        fit.weights = weights;
        Ok(fit)
    }

    /// `b_a = Σ_{i: a_i = a} ω_i φ_i r_i`, stacked, `fA × 1`.
    fn right_hand_side(&self, rewards: &[f64]) -> Mat<f64> {
        let f = self.data.phi.nrows();
        let mut right = Mat::zeros(f * self.actions, 1);
        for (a, members) in self.members.iter().enumerate() {
            let of_action = Mat::from_fn(members.len(), 1, |i, _| rewards[members[i]]);
            let part = &self.weighted[a] * of_action;
            right.as_mut().subrows_mut(a * f, f).copy_from(&part);
        }
        right
    }

    /// `M` of the policy that takes all allowed actions alike: the blocks `M_ab` as one `fA × fA` matrix.
    fn cross_of_uniform(&self, outcomes: &Outcomes<'_>) -> Mat<f64> {
        let f = self.data.phi.nrows();
        let share = |sample: usize, action: usize| {
            let may = (0..self.actions).filter(|&b| outcomes.allows(sample, b)).count();
            if outcomes.allows(sample, action) { 1.0 / may as f64 } else { 0.0 }
        };
        let mut cross = Mat::zeros(f * self.actions, f * self.actions);
        for (a, members) in self.members.iter().enumerate() {
            for b in 0..self.actions {
                let after =
                    Mat::from_fn(f, members.len(), |i, j| share(members[j], b) * outcomes.next[(i, members[j])]);
                let block = cross.as_mut().submatrix_mut(a * f, b * f, f, f);
                matmul(block, Accum::Replace, self.weighted[a].as_ref(), after.transpose(), 1.0, self.par);
            }
        }
        cross
    }

    /// `M ← (1 − β)M + β·M(greedy)`, where the greedy policy takes action `chosen[i]` at `x′_i`.
    fn mix_in_greedy(&self, cross: &mut Mat<f64>, next: MatRef<'_, f64>, chosen: &[usize], beta: f64) {
        let f = self.data.phi.nrows();
        *cross *= Scale(1.0 - beta);
        for (a, members) in self.members.iter().enumerate() {
            for b in 0..self.actions {
                // (column among the members of a, transition) of those that go on with b.
                let acting: Vec<(usize, usize)> =
                    members.iter().copied().enumerate().filter(|&(_, index)| chosen[index] == b).collect();
                let before = Mat::from_fn(f, acting.len(), |i, j| self.weighted[a][(i, acting[j].0)]);
                let after = Mat::from_fn(f, acting.len(), |i, j| next[(i, acting[j].1)]);
                let block = cross.as_mut().submatrix_mut(a * f, b * f, f, f);
                matmul(block, Accum::Add, before.as_ref(), after.transpose(), beta, self.par);
            }
        }
    }

    /// Q-weights of the policy with the given `M`, `f × A`.
    fn evaluate(&self, cross: &Mat<f64>, right: &Mat<f64>, options: &Options) -> Result<Mat<f64>, ValueError> {
        let f = self.data.phi.nrows();
        let mut system = cross * Scale(-options.gamma);
        for (a, gram) in self.gram.iter().enumerate() {
            let mut block = system.as_mut().submatrix_mut(a * f, a * f, f, f);
            block += gram;
        }
        for i in 0..system.nrows() {
            system[(i, i)] += options.ridge;
        }
        let stacked = solve_or_pseudo_inverse(system.as_ref(), right.as_ref())?;
        Ok(Mat::from_fn(f, self.actions, |i, a| stacked[(a * f + i, 0)]))
    }

    /// The best action of those that may follow each sample.
    fn greedy_after(&self, outcomes: &Outcomes<'_>, weights: &Mat<f64>) -> Vec<usize> {
        let mut q = Mat::zeros(self.actions, outcomes.next.ncols());
        matmul(q.as_mut(), Accum::Replace, weights.transpose(), outcomes.next, 1.0, self.par);
        let value =
            |sample: usize, a: usize| if outcomes.allows(sample, a) { q[(a, sample)] } else { f64::NEG_INFINITY };
        (0..q.ncols()).map(|sample| greedy((0..self.actions).map(|a| value(sample, a)))).collect()
    }
}

/// The number of the largest value; of equal ones the first, and 0 where nothing compares.
pub fn greedy(values: impl IntoIterator<Item = f64>) -> usize {
    values
        .into_iter()
        .enumerate()
        .fold((0, f64::NEG_INFINITY), |best, (index, value)| if value > best.1 { (index, value) } else { best })
        .0
}
