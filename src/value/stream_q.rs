//! Stream-Q(λ): learning action values from one stream of experience, without any memory of it.

use faer::{Mat, MatRef};
use rand::{Rng, RngExt};

use super::error::{discount_or_one, finite_list, parameter, weights};
use super::{ValueError, greedy};

/// Options of [`StreamQ`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StreamQOptions {
    /// Discount γ, in [0, 1].
    pub gamma: f64,
    /// λ of the eligibility traces, in [0, 1].
    pub lambda: f64,
    /// The largest step size, > 0; 1 in the paper.
    pub step: f64,
    /// κ > 1: the step is made so small that no error is corrected by more than its 1/κ part; 2 in the paper.
    pub kappa: f64,
}

impl Default for StreamQOptions {
    fn default() -> Self {
        StreamQOptions { gamma: 0.9, lambda: 0.8, step: 1.0, kappa: 2.0 }
    }
}

/// Off-policy control with linear features, `Q(x, a) = φ(x)ᵀ w_a`, from each step once.
///
/// Watkins's Q(λ): the error `δ = r + γ max_b Q(x′, b) − Q(x, a)` corrects all earlier steps by their traces, which are cut
/// where an action was not the greedy one. What makes it stable without replay is the step size that is bounded against
/// overshooting (ObGD): `α / max(1, ακ·max(|δ|, 1)·‖z‖₁)` for traces `z`. That bound is one for features within [−1, 1].
///
/// ```
/// use adagio::value::{StreamQ, StreamQOptions};
///
/// let mut values = StreamQ::new(1, 2, StreamQOptions::default())?;
/// for _ in 0..100 {
///     values.learn(&[1.0], 1, 4.0, None)?; // action 1 pays 4 and ends the episode
/// }
/// assert!((values.weights()[(0, 1)] - 4.0).abs() < 1e-3);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Reference
/// Elsayed, Vasan & Mahmood, *Streaming deep reinforcement learning finally works* (2024), algorithms 1 (ObGD) and 3
/// (Stream Q(λ)), here without a network.
#[derive(Debug, Clone, PartialEq)]
pub struct StreamQ {
    options: StreamQOptions,
    /// `f × A`.
    weights: Mat<f64>,
    traces: Mat<f64>,
}

impl StreamQ {
    /// All values zero.
    ///
    /// # Errors
    /// No features or actions, or too many; options outside their ranges.
    pub fn new(features: usize, actions: usize, options: StreamQOptions) -> Result<Self, ValueError> {
        weights(features, actions)?;
        discount_or_one(options.gamma)?;
        parameter("lambda", options.lambda, (0.0..=1.0).contains(&options.lambda), "in [0, 1]")?;
        parameter("step", options.step, options.step > 0.0 && options.step.is_finite(), "> 0 and finite")?;
        parameter("kappa", options.kappa, options.kappa > 1.0 && options.kappa.is_finite(), "> 1 and finite")?;
        Ok(StreamQ { options, weights: Mat::zeros(features, actions), traces: Mat::zeros(features, actions) })
    }

    /// The ε-greedy action.
    ///
    /// # Errors
    /// Another number of features, values that are not finite, ε outside [0, 1].
    pub fn choose(&self, phi: &[f64], epsilon: f64, rng: &mut impl Rng) -> Result<usize, ValueError> {
        self.check(phi)?;
        parameter("epsilon", epsilon, (0.0..=1.0).contains(&epsilon), "in [0, 1]")?;
        if rng.random::<f64>() < epsilon {
            return Ok(rng.random_range(0..self.weights.ncols()));
        }
        Ok(self.best(phi).0)
    }

    /// Learn from a step; `next` is `None` where the episode ended. Returns the error δ.
    ///
    /// # Errors
    /// Vectors of another length, values that are not finite, an action out of range, weights that grow beyond all numbers.
    /// Nothing is then learned.
    pub fn learn(&mut self, phi: &[f64], action: usize, reward: f64, next: Option<&[f64]>) -> Result<f64, ValueError> {
        self.check(phi)?;
        finite_list("rewards", &[reward])?;
        let actions = self.weights.ncols();
        if action >= actions {
            return Err(ValueError::Action { index: 0, action, actions });
        }
        let after = match next {
            Some(next) => {
                self.check(next)?;
                self.best(next).1
            }
            None => 0.0,
        };
        let StreamQOptions { gamma, lambda, step, kappa } = self.options;
        // Earlier steps have nothing to do with what an action that was not the greedy one leads to.
        let keep = if self.best(phi).0 == action { gamma * lambda } else { 0.0 };
        let mut traces = self.traces.clone();
        let mut length = 0.0;
        for a in 0..actions {
            for (i, trace) in traces.col_mut(a).iter_mut().enumerate() {
                *trace = keep * *trace + if a == action { phi[i] } else { 0.0 };
                length += trace.abs();
            }
        }
        let error = reward + gamma * after - self.value(phi, action);
        let bounded = step / (step * kappa * error.abs().max(1.0) * length).max(1.0);
        let weights = &self.weights + faer::Scale(bounded * error) * &traces;
        if !(error.is_finite() && weights.is_all_finite()) {
            return Err(ValueError::NotFinite(weights.nrows() * weights.ncols()));
        }
        self.weights = weights;
        self.traces = if next.is_some() { traces } else { Mat::zeros(phi.len(), actions) };
        Ok(error)
    }

    /// Cut the traces: what comes now has nothing to do with what was before.
    pub fn interrupt(&mut self) {
        self.traces.fill(0.0);
    }

    /// `f × A`, one action a column.
    pub fn weights(&self) -> MatRef<'_, f64> {
        self.weights.as_ref()
    }

    fn value(&self, phi: &[f64], action: usize) -> f64 {
        phi.iter().enumerate().map(|(i, p)| p * self.weights[(i, action)]).sum()
    }

    /// The greedy action and its value.
    fn best(&self, phi: &[f64]) -> (usize, f64) {
        let values: Vec<f64> = (0..self.weights.ncols()).map(|a| self.value(phi, a)).collect();
        let best = greedy(values.iter().copied());
        (best, values[best])
    }

    fn check(&self, phi: &[f64]) -> Result<(), ValueError> {
        if phi.len() != self.weights.nrows() {
            return Err(ValueError::Features { what: "phi", found: phi.len(), expected: self.weights.nrows() });
        }
        finite_list("phi", phi)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;

    /// dlib's LSPI test: a row of 4 states, reward 1 for going right at the last, γ = 0.8.
    #[test]
    fn the_values_of_a_chain_are_found_from_a_stream_of_exploration() {
        let mut values = StreamQ::new(4, 2, StreamQOptions { gamma: 0.8, ..StreamQOptions::default() }).unwrap();
        let mut rng = stream(1, "chain");
        let one = |state: usize| (0..4).map(|i| f64::from(u8::from(i == state))).collect::<Vec<f64>>();
        let mut state = 0usize;
        for _ in 0..20_000 {
            let action = values.choose(&one(state), 0.5, &mut rng).unwrap();
            let next = if action == 1 { (state + 1).min(3) } else { state.saturating_sub(1) };
            let reward = f64::from(u8::from((state, action) == (3, 1)));
            values.learn(&one(state), action, reward, Some(&one(next))).unwrap();
            state = next;
        }
        let expected = [[2.048, 2.56], [2.048, 3.2], [2.56, 4.0], [3.2, 5.0]];
        for (state, row) in expected.iter().enumerate() {
            for (action, value) in row.iter().enumerate() {
                let found = values.weights()[(state, action)];
                assert!((found - value).abs() < 0.02 * value, "Q({state}, {action}) = {found}, not {value}");
            }
        }
    }

    #[test]
    fn a_step_never_overshoots() {
        // However large the error is, that of the same step afterwards is smaller, and of the same sign.
        for (scale, reward) in [(0.1, 1.0), (1.0, 1.0), (1.0, -50.0)] {
            let mut values = StreamQ::new(2, 1, StreamQOptions::default()).unwrap();
            let phi = [scale, -scale];
            let before = values.learn(&phi, 0, reward, None).unwrap();
            let after = values.learn(&phi, 0, reward, None).unwrap();
            assert!(before * after > 0.0 && after.abs() < before.abs(), "{before} {after}");
        }
    }

    #[test]
    fn wrong_input_changes_nothing() {
        let mut values = StreamQ::new(2, 2, StreamQOptions::default()).unwrap();
        values.learn(&[1.0, 0.5], 0, 1.0, Some(&[0.0, 1.0])).unwrap();
        let before = values.clone();
        assert!(values.learn(&[1.0], 0, 1.0, None).is_err());
        assert!(values.learn(&[1.0, f64::NAN], 0, 1.0, None).is_err());
        assert!(values.learn(&[1.0, 1.0], 2, 1.0, None).is_err());
        assert!(values.learn(&[1.0, 1.0], 0, f64::INFINITY, None).is_err());
        assert!(values.choose(&[1.0, 1.0], 1.5, &mut stream(1, "test")).is_err());
        assert_eq!(values, before);
        for wrong in
            [StreamQOptions { kappa: 1.0, ..Default::default() }, StreamQOptions { lambda: 2.0, ..Default::default() }]
        {
            assert!(StreamQ::new(2, 2, wrong).is_err());
        }
    }
}
