//! Policies: in every state a distribution over the actions.

use faer::{Mat, MatRef};

use super::ValueError;
use super::error::{finite_matrix, parameter, size};

/// By how much probabilities may miss 1 in sum: rounding, not mistakes.
pub(super) const SUM_TOLERANCE: f64 = 1e-9;

/// A stationary, possibly stochastic policy `π(a | s)` as a table; column `s` is the distribution in state `s`.
///
/// ```
/// use adagio::value::Policy;
/// use faer::mat;
///
/// // Greedy for the values of two actions (rows) in three states; of equal actions the first.
/// let greedy = Policy::greedy(mat![[1.0, 0.0, 5.0], [2.0, 0.0, -5.0]].as_ref())?;
/// assert_eq!(greedy.chosen(), [1, 0, 0]);
/// // One time in ten any action.
/// let soft = greedy.softened(0.1)?;
/// assert!((soft.probabilities()[(1, 0)] - 0.95).abs() < 1e-15);
/// assert!(Policy::new(mat![[0.5], [0.6]].as_ref()).is_err());
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Reference
/// Thesis §3.1.1 (definition of a stationary policy).
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    /// `A × S`.
    probabilities: Mat<f64>,
}

impl Policy {
    /// A policy from its probabilities.
    ///
    /// # Shapes
    /// `A × S`: one column for each state.
    ///
    /// # Errors
    /// No actions, a negative probability, one that is not finite, a column whose sum is not 1.
    pub fn new(probabilities: MatRef<'_, f64>) -> Result<Self, ValueError> {
        if probabilities.nrows() == 0 {
            return Err(ValueError::NoActions);
        }
        for state in 0..probabilities.ncols() {
            let column = (0..probabilities.nrows()).map(|a| probabilities[(a, state)]);
            if let Some(value) = column.clone().find(|p| !(*p >= 0.0 && p.is_finite())) {
                return Err(ValueError::Policy { state, fault: format!("{value} is not a probability") });
            }
            let sum: f64 = column.sum();
            if (sum - 1.0).abs() > SUM_TOLERANCE {
                return Err(ValueError::Policy { state, fault: format!("the probabilities sum to {sum}, not to 1") });
            }
        }
        Ok(Policy { probabilities: probabilities.to_owned() })
    }

    /// The policy that takes all actions alike.
    ///
    /// # Errors
    /// No actions, too many states and actions.
    pub fn uniform(states: usize, actions: usize) -> Result<Self, ValueError> {
        if actions == 0 {
            return Err(ValueError::NoActions);
        }
        size("a policy", actions, states)?;
        Ok(Policy { probabilities: Mat::from_fn(actions, states, |_, _| 1.0 / actions as f64) })
    }

    /// The policy that takes action `chosen[s]` in state `s`.
    ///
    /// # Errors
    /// No actions, an action out of range, too many states and actions.
    pub fn deterministic(chosen: &[usize], actions: usize) -> Result<Self, ValueError> {
        if actions == 0 {
            return Err(ValueError::NoActions);
        }
        size("a policy", actions, chosen.len())?;
        if let Some((index, &action)) = chosen.iter().enumerate().find(|&(_, &action)| action >= actions) {
            return Err(ValueError::Action { index, action, actions });
        }
        let probability = |a: usize, s: usize| f64::from(u8::from(chosen[s] == a));
        Ok(Policy { probabilities: Mat::from_fn(actions, chosen.len(), probability) })
    }

    /// The policy that is greedy for the values `q`, `A × S`; of equal actions the first.
    ///
    /// # Errors
    /// No actions, values that are not finite; −∞ is allowed for an action of which nothing is known, and is not chosen.
    pub fn greedy(q: MatRef<'_, f64>) -> Result<Self, ValueError> {
        let known = |a: usize, s: usize| if q[(a, s)] == f64::NEG_INFINITY { 0.0 } else { q[(a, s)] };
        finite_matrix("q", Mat::from_fn(q.nrows(), q.ncols(), known).as_ref())?;
        let chosen: Vec<usize> = (0..q.ncols()).map(|s| greedy((0..q.nrows()).map(|a| q[(a, s)]))).collect();
        Policy::deterministic(&chosen, q.nrows())
    }

    /// With probability `epsilon` any action, otherwise this policy's.
    ///
    /// # Errors
    /// `epsilon` outside [0, 1].
    pub fn softened(&self, epsilon: f64) -> Result<Self, ValueError> {
        parameter("epsilon", epsilon, (0.0..=1.0).contains(&epsilon), "in [0, 1]")?;
        let p = &self.probabilities;
        let any = epsilon / p.nrows() as f64;
        Ok(Policy { probabilities: Mat::from_fn(p.nrows(), p.ncols(), |a, s| (1.0 - epsilon) * p[(a, s)] + any) })
    }

    /// The policy's distributions in a list of states: column `i` belongs to `states[i]`. With the states after each sample
    /// it is what [`Lspi::evaluate`](super::Lspi::evaluate) takes.
    ///
    /// # Errors
    /// A state out of range.
    pub fn at(&self, states: &[usize]) -> Result<Self, ValueError> {
        let p = &self.probabilities;
        match states.iter().find(|&&state| state >= p.ncols()) {
            Some(&state) => Err(ValueError::State { state, states: p.ncols() }),
            None => Ok(Policy { probabilities: Mat::from_fn(p.nrows(), states.len(), |a, i| p[(a, states[i])]) }),
        }
    }

    /// `π(a | s)` as a matrix, `A × S`.
    pub fn probabilities(&self) -> MatRef<'_, f64> {
        self.probabilities.as_ref()
    }

    /// Number of states.
    pub fn states(&self) -> usize {
        self.probabilities.ncols()
    }

    /// Number of actions.
    pub fn actions(&self) -> usize {
        self.probabilities.nrows()
    }

    /// The most probable action of each state; of equal ones the first.
    pub fn chosen(&self) -> Vec<usize> {
        let p = &self.probabilities;
        (0..p.ncols()).map(|s| greedy((0..p.nrows()).map(|a| p[(a, s)]))).collect()
    }

    /// An action for a probability `u` drawn uniformly from [0, 1). `state` is in range.
    pub(super) fn pick(&self, state: usize, u: f64) -> usize {
        let column = (0..self.actions()).map(|a| self.probabilities[(a, state)]);
        draw(column, u)
    }

    /// The policy must be for this many states and actions.
    pub(super) fn check_size(&self, states: usize, actions: usize) -> Result<(), ValueError> {
        if self.states() == states && self.actions() == actions {
            return Ok(());
        }
        let (found_states, found_actions) = (self.states(), self.actions());
        Err(ValueError::PolicySize { found_states, found_actions, states, actions })
    }
}

/// The number drawn from a distribution by `u` in [0, 1); the last possible one where rounding leaves a rest.
pub(super) fn draw(probabilities: impl Iterator<Item = f64>, u: f64) -> usize {
    let mut below = 0.0;
    let mut last = 0;
    for (index, probability) in probabilities.enumerate() {
        below += probability;
        if probability > 0.0 {
            last = index;
            if u < below {
                return index;
            }
        }
    }
    last
}

/// The number of the largest value; of equal ones the first, and 0 where nothing compares.
pub fn greedy(values: impl IntoIterator<Item = f64>) -> usize {
    values
        .into_iter()
        .enumerate()
        .fold((0, f64::NEG_INFINITY), |best, (index, value)| if value > best.1 { (index, value) } else { best })
        .0
}
