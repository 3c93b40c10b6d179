//! Transitions in features, collected one by one and owned in one place.

use faer::{MatRef, Par};

use super::error::{finite_list, sample_weights};
use super::{Fit, Lspi, LspiOptions, Outcomes, Samples, ValueError, lstd};

/// Transitions `(φ, a, r, φ′)` with weights, ready for [`Lspi`] and [`lstd`].
///
/// ```
/// use adagio::value::{Batch, LspiOptions};
///
/// // One state; action 1 pays 1 for ever, action 0 pays nothing.
/// let mut batch = Batch::new(1, 2)?;
/// batch.push(&[1.0], 0, 0.0, Some(&[1.0]), 1.0)?;
/// batch.push(&[1.0], 1, 1.0, Some(&[1.0]), 1.0)?;
/// let fit = batch.fit(&LspiOptions { gamma: 0.9, ..LspiOptions::plain() })?;
/// assert!((fit.weights[(0, 1)] - 10.0).abs() < 1e-9); // 1/(1 − γ)
/// assert!((fit.weights[(0, 0)] - 9.0).abs() < 1e-9); // γ/(1 − γ)
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Batch {
    features: usize,
    number_of_actions: usize,
    /// Columns one after another.
    phi: Vec<f64>,
    next: Vec<f64>,
    actions: Vec<usize>,
    rewards: Vec<f64>,
    weights: Vec<f64>,
}

impl Batch {
    /// An empty batch for vectors of `features` entries.
    ///
    /// # Errors
    /// No features, no actions.
    pub fn new(features: usize, actions: usize) -> Result<Self, ValueError> {
        if features == 0 {
            return Err(ValueError::Features { what: "phi", found: 0, expected: 1 });
        }
        if actions == 0 {
            return Err(ValueError::NoActions);
        }
        let (phi, next, rewards, weights) = Default::default();
        Ok(Batch { features, number_of_actions: actions, phi, next, actions: Vec::new(), rewards, weights })
    }

    /// Add a transition; `next` is `None` where the episode ended.
    ///
    /// # Errors
    /// Vectors of another length, an action out of range, values that are not finite, a negative weight. The batch is then
    /// as it was.
    pub fn push(
        &mut self,
        phi: &[f64],
        action: usize,
        reward: f64,
        next: Option<&[f64]>,
        weight: f64,
    ) -> Result<(), ValueError> {
        let expected = self.features;
        for (what, vector) in [("phi", phi), ("next", next.unwrap_or(phi))] {
            if vector.len() != expected {
                return Err(ValueError::Features { what, found: vector.len(), expected });
            }
            finite_list(what, vector)?;
        }
        if action >= self.number_of_actions {
            return Err(ValueError::Action { index: self.len(), action, actions: self.number_of_actions });
        }
        finite_list("rewards", &[reward])?;
        sample_weights(&[weight])?;
        self.phi.extend_from_slice(phi);
        match next {
            Some(next) => self.next.extend_from_slice(next),
            None => self.next.resize(self.phi.len(), 0.0),
        }
        self.actions.push(action);
        self.rewards.push(reward);
        self.weights.push(weight);
        Ok(())
    }

    /// Number of transitions `N`.
    pub fn len(&self) -> usize {
        self.actions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    /// `Φ`, `f × N`.
    pub fn phi(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice(&self.phi, self.features, self.len())
    }

    /// `Φ′`, `f × N`; a zero column where an episode ended.
    pub fn next(&self) -> MatRef<'_, f64> {
        MatRef::from_column_major_slice(&self.next, self.features, self.len())
    }

    /// Rewards, `N`.
    pub fn rewards(&self) -> &[f64] {
        &self.rewards
    }

    /// Weights ω, `N`.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// What was seen and done.
    pub fn samples(&self) -> Samples<'_> {
        Samples { phi: self.phi(), actions: &self.actions, weights: &self.weights }
    }

    /// What came of it; every action may follow.
    pub fn outcomes(&self) -> Outcomes<'_> {
        Outcomes { next: self.next(), rewards: &self.rewards, allowed: None }
    }

    /// Prepare policy iteration, on one thread.
    ///
    /// # Errors
    /// An empty batch.
    pub fn lspi(&self) -> Result<Lspi<'_>, ValueError> {
        Lspi::new(self.samples(), self.number_of_actions, Par::Seq)
    }

    /// Least-squares policy iteration, see [`Lspi::fit`].
    ///
    /// # Errors
    /// An empty batch, options outside their ranges.
    pub fn fit(&self, options: &LspiOptions) -> Result<Fit, ValueError> {
        self.lspi()?.fit(&self.outcomes(), options)
    }

    /// The value of the states under the policy that made the transitions, see [`lstd`].
    ///
    /// # Errors
    /// An empty batch, γ or ridge outside their ranges.
    pub fn lstd(&self, gamma: f64, ridge: f64) -> Result<Vec<f64>, ValueError> {
        lstd(self.phi(), self.next(), &self.rewards, &self.weights, gamma, ridge)
    }
}
