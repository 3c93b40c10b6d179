//! Sarsa: learning action values while acting on them, step by step.

use faer::{Mat, MatRef};
use rand::{Rng, RngExt};

use super::error::{discount_or_one, finite_list, parameter, weights};
use super::{ValueError, greedy};

/// Options of [`Sarsa`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SarsaOptions {
    /// Discount γ, in [0, 1].
    pub gamma: f64,
    /// α > 0: share of the error that a step corrects, for features of length 1; values above 1 overshoot.
    pub step: f64,
    /// ε: probability of any action at random, in [0, 1]. (The thesis's footnote to §3.3.1 has it the other way round:
    /// greedy with probability ε. Sutton & Barto, whom it cites, have it as here.)
    pub epsilon: f64,
}

/// On-policy control with linear features, `Q(x, a) = φ(x)ᵀ w_a`.
///
/// It is here as the counter-example of thesis §3.3.1. What it learns from is what its own policy does. A greedy one
/// repeats in each state the action that looks best already, the others are never tried, and their values stay what they
/// were by chance. Some exploration (ε > 0) mends that; [`Lspi`](super::Lspi) avoids it, because its samples do not
/// depend on the policy.
///
/// ```
/// use adagio::value::{Sarsa, SarsaOptions};
///
/// let mut sarsa = Sarsa::new(1, 2, SarsaOptions { gamma: 0.9, step: 0.5, epsilon: 0.0 })?;
/// // Action 1 pays 4 and ends the episode: half of the error of 4 is learned.
/// assert_eq!(sarsa.learn(&[1.0], 1, 4.0, None)?, 4.0);
/// assert_eq!(sarsa.weights()[(0, 1)], 2.0);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Reference
/// Thesis §3.3.1; Sutton & Barto 1998.
#[derive(Debug, Clone, PartialEq)]
pub struct Sarsa {
    options: SarsaOptions,
    /// `f × A`.
    weights: Mat<f64>,
}

impl Sarsa {
    /// All values zero.
    ///
    /// # Errors
    /// No features or actions, or too many; options outside their ranges.
    pub fn new(features: usize, actions: usize, options: SarsaOptions) -> Result<Self, ValueError> {
        weights(features, actions)?;
        discount_or_one(options.gamma)?;
        parameter("step", options.step, options.step > 0.0 && options.step.is_finite(), "> 0 and finite")?;
        parameter("epsilon", options.epsilon, (0.0..=1.0).contains(&options.epsilon), "in [0, 1]")?;
        Ok(Sarsa { options, weights: Mat::zeros(features, actions) })
    }

    /// The ε-greedy action.
    ///
    /// # Errors
    /// Another number of features, values that are not finite.
    pub fn choose(&self, phi: &[f64], rng: &mut impl Rng) -> Result<usize, ValueError> {
        self.check(phi)?;
        if rng.random::<f64>() < self.options.epsilon {
            return Ok(rng.random_range(0..self.weights.ncols()));
        }
        Ok(greedy((0..self.weights.ncols()).map(|a| self.value(phi, a))))
    }

    /// Learn from a step and the action chosen after it (`None` where the episode ended): with the error
    /// `δ = r + γQ(x′, a′) − Q(x, a)`, which is returned, `w_a ← w_a + αδφ(x)`.
    ///
    /// # Errors
    /// Vectors of another length, values that are not finite, an action out of range, weights that grow beyond all
    /// numbers. Nothing is then learned.
    pub fn learn(
        &mut self,
        phi: &[f64],
        action: usize,
        reward: f64,
        next: Option<(&[f64], usize)>,
    ) -> Result<f64, ValueError> {
        self.check(phi)?;
        finite_list("rewards", &[reward])?;
        let actions = self.weights.ncols();
        for action in [Some(action), next.map(|(_, action)| action)].into_iter().flatten() {
            if action >= actions {
                return Err(ValueError::Action { index: 0, action, actions });
            }
        }
        let after = match next {
            Some((phi, action)) => {
                self.check(phi)?;
                self.value(phi, action)
            }
            None => 0.0,
        };
        let error = reward + self.options.gamma * after - self.value(phi, action);
        let new: Vec<f64> =
            phi.iter().enumerate().map(|(i, p)| self.weights[(i, action)] + self.options.step * error * p).collect();
        if !(error.is_finite() && new.iter().all(|w| w.is_finite())) {
            return Err(ValueError::NotFinite(new.len()));
        }
        for (i, w) in new.into_iter().enumerate() {
            self.weights[(i, action)] = w;
        }
        Ok(error)
    }

    /// `f × A`, one action a column.
    pub fn weights(&self) -> MatRef<'_, f64> {
        self.weights.as_ref()
    }

    fn value(&self, phi: &[f64], action: usize) -> f64 {
        phi.iter().enumerate().map(|(i, p)| p * self.weights[(i, action)]).sum()
    }

    fn check(&self, phi: &[f64]) -> Result<(), ValueError> {
        if phi.len() != self.weights.nrows() {
            return Err(ValueError::Features { what: "phi", found: phi.len(), expected: self.weights.nrows() });
        }
        finite_list("phi", phi)
    }
}
