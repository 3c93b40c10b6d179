//! The least-squares system of action values, block by block.

use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Scale};

use super::ValueError;
use super::error::{finite_list, finite_matrix, sample_weights, size};
use super::lstd::solve_or_pseudo_inverse;
use crate::kernel::products::{add_product, for_columns};

/// States and the actions taken in them: column `i` of `phi` is what was seen before action `actions[i]`.
///
/// A state–action pair has one block of `f` features for each action, all zero but the one of its action (thesis §3.2.2;
/// its definition prints the lengths of the zero blocks as multiples of `n` and `m − i`: they are `(i − 1)m` and
/// `(k − i)m` for `m` features and `k` actions). The zeros are never built. What remains is, for each action `a`,
///
/// `G_a w_a − γ Σ_b M_ab w_b = b_a`
///
/// with `G_a = Σ_{i: a_i = a} ω_i φ_i φ_iᵀ`, `M_ab = Σ_{i: a_i = a} ω_i π(b | x′_i) φ_i φ′_iᵀ` and
/// `b_a = Σ_{i: a_i = a} ω_i φ_i r_i`. Only `M` depends on the policy π, and it is linear in π.
#[derive(Debug, Clone, Copy)]
pub struct Samples<'a> {
    /// `Φ`, `f × N`.
    pub phi: MatRef<'a, f64>,
    /// Action numbers, `N`, each below the number of actions.
    pub actions: &'a [usize],
    /// Weights `ω` ≥ 0, `N`.
    pub weights: &'a [f64],
}

impl Samples<'_> {
    /// Shapes, finite values, actions in range.
    fn check(&self, actions: usize) -> Result<(), ValueError> {
        let n = self.phi.ncols();
        if n == 0 {
            return Err(ValueError::Empty);
        }
        if actions == 0 {
            return Err(ValueError::NoActions);
        }
        if self.phi.nrows() == 0 {
            return Err(ValueError::Features { what: "phi", found: 0, expected: 1 });
        }
        for (what, found) in [("actions", self.actions.len()), ("weights", self.weights.len())] {
            if found != n {
                return Err(ValueError::Length { what, found, expected: n });
            }
        }
        if let Some((index, &action)) = self.actions.iter().enumerate().find(|&(_, &action)| action >= actions) {
            return Err(ValueError::Action { index, action, actions });
        }
        let unknowns = self.phi.nrows().saturating_mul(actions);
        size("the system of action values", unknowns, unknowns)?;
        sample_weights(self.weights)?;
        finite_matrix("phi", self.phi)
    }
}

/// What came of each sample, for one task.
#[derive(Debug, Clone, Copy)]
pub struct Outcomes<'a> {
    /// `Φ′`, `f × N`: what was seen after each action; a zero column where the episode ended.
    pub next: MatRef<'a, f64>,
    /// Rewards, `N`.
    pub rewards: &'a [f64],
    /// Which actions may follow each sample, as bits (bit `b`: action `b` may), `N`; `None`: all of them. For at most 32
    /// actions.
    ///
    /// With rules such as "a turn is not undone" what may follow depends on the action taken, not on what came
    /// before it, so `Q(x, a)` stays a function of `x` and `a`: `Q(x, a) = r + γ max_{b may follow} Q(x′, b)`.
    pub allowed: Option<&'a [u32]>,
}

impl Outcomes<'_> {
    /// Whether an action may follow a sample; both are in range.
    pub(super) fn allows(&self, sample: usize, action: usize) -> bool {
        self.allowed.is_none_or(|allowed| allowed[sample] & (1 << action) != 0)
    }

    /// Shapes, finite values, something allowed after each of the `n` samples with `f` features.
    pub(super) fn check(&self, f: usize, n: usize, actions: usize) -> Result<(), ValueError> {
        if self.next.nrows() != f {
            return Err(ValueError::Features { what: "next", found: self.next.nrows(), expected: f });
        }
        let allowed = self.allowed.map_or(n, <[u32]>::len);
        for (what, found) in [("next", self.next.ncols()), ("rewards", self.rewards.len()), ("allowed", allowed)] {
            if found != n {
                return Err(ValueError::Length { what, found, expected: n });
            }
        }
        if self.allowed.is_some() && actions > u32::BITS as usize {
            return Err(ValueError::AllowedBits(actions));
        }
        finite_list("rewards", self.rewards)?;
        finite_matrix("next", self.next)?;
        match (0..n).find(|&sample| (0..actions).all(|action| !self.allows(sample, action))) {
            Some(index) => Err(ValueError::NothingAllowed { index, actions }),
            None => Ok(()),
        }
    }
}

/// What of the system depends on the samples and their weights alone.
#[derive(Debug)]
pub(super) struct Blocks {
    features: usize,
    actions: usize,
    /// Sample numbers of each action.
    members: Vec<Vec<usize>>,
    /// `ω_i φ_i` of the members of each action, `f × N_a`.
    weighted: Vec<Mat<f64>>,
    /// `G_a`, `f × f`.
    gram: Vec<Mat<f64>>,
    par: Par,
}

impl Blocks {
    pub fn new(data: Samples<'_>, actions: usize, par: Par) -> Result<Self, ValueError> {
        data.check(actions)?;
        let mut members = vec![Vec::new(); actions];
        for (index, &action) in data.actions.iter().enumerate() {
            members[action].push(index);
        }
        let f = data.phi.nrows();
        let mut weighted = Vec::with_capacity(actions);
        let mut gram = Vec::with_capacity(actions);
        for of_action in &members {
            let mut plain = Mat::zeros(f, of_action.len());
            let mut heavy = Mat::zeros(f, of_action.len());
            for (column, &sample) in of_action.iter().enumerate() {
                plain.col_mut(column).copy_from(data.phi.col(sample));
                let weight = data.weights[sample];
                faer::zip!(heavy.col_mut(column), data.phi.col(sample))
                    .for_each(|faer::unzip!(heavy, phi)| *heavy = phi * weight);
            }
            let mut g = Mat::zeros(f, f);
            add_product(g.as_mut(), heavy.as_ref(), plain.as_ref(), 1.0, par);
            weighted.push(heavy);
            gram.push(g);
        }
        Ok(Blocks { features: f, actions, members, weighted, gram, par })
    }

    /// Number of features `f`.
    pub fn features(&self) -> usize {
        self.features
    }

    /// Number of actions `A`.
    pub fn actions(&self) -> usize {
        self.actions
    }

    /// Sample numbers of an action.
    pub fn members(&self, action: usize) -> &[usize] {
        &self.members[action]
    }

    /// `ω_i φ_i` of the samples of an action, `f × N_a`.
    pub fn weighted(&self, action: usize) -> MatRef<'_, f64> {
        self.weighted[action].as_ref()
    }

    /// On which threads products run.
    pub fn par(&self) -> Par {
        self.par
    }

    /// `G_a` of each action.
    pub fn gram(&self) -> &[Mat<f64>] {
        &self.gram
    }

    /// `b_a`, stacked, `fA × 1`.
    pub fn right_hand_side(&self, rewards: &[f64]) -> Mat<f64> {
        let f = self.features;
        let mut right = Mat::zeros(f * self.actions, 1);
        for (a, members) in self.members.iter().enumerate() {
            let of_action = Mat::from_fn(members.len(), 1, |i, _| rewards[members[i]]);
            let part = right.as_mut().subrows_mut(a * f, f);
            matmul(part, Accum::Replace, self.weighted[a].as_ref(), of_action.as_ref(), 1.0, for_columns(self.par, 1));
        }
        right
    }

    /// Q-weights of the policy with the given `M`, `f × A`.
    pub fn solve(&self, cross: &Mat<f64>, right: &Mat<f64>, gamma: f64, ridge: f64) -> Result<Mat<f64>, ValueError> {
        let f = self.features;
        let mut system = cross * Scale(-gamma);
        for (a, gram) in self.gram.iter().enumerate() {
            let mut block = system.as_mut().submatrix_mut(a * f, a * f, f, f);
            block += gram;
        }
        for i in 0..system.nrows() {
            system[(i, i)] += ridge;
        }
        let stacked = solve_or_pseudo_inverse(system.as_ref(), right.as_ref())?;
        Ok(Mat::from_fn(f, self.actions, |i, a| stacked[(a * f + i, 0)]))
    }

    /// `Q(x_i, a)` of some features, `A × N`.
    pub fn action_values(&self, weights: &Mat<f64>, phi: MatRef<'_, f64>) -> Mat<f64> {
        let mut q = Mat::zeros(self.actions, phi.ncols());
        matmul(q.as_mut(), Accum::Replace, weights.transpose(), phi, 1.0, self.par);
        q
    }
}
