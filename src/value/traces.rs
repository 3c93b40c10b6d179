//! LSTD(λ): least-squares temporal differences over whole trajectories.

use faer::Mat;

use super::ValueError;
use super::error::{discount_or_one, finite_list, parameter, ridge as check_ridge, sample_weights, size};
use super::lstd::solve_or_pseudo_inverse;

/// Sums of LSTD(λ) over a stream of transitions, `O(f²)` memory and time for each.
///
/// An eligibility trace `z_t = γλ z_{t−1} + φ_t` credits a reward to all states before it, not to the last one alone. With
/// `A = Σ ω_t z_t (φ_t − γφ′_t)ᵀ` and `b = Σ ω_t z_t r_t` the weights solve `Aw = b`. λ = 0 is [`lstd`](super::lstd());
/// λ = 1 is the linear regression of the rewards that really followed (Monte Carlo), which does not rely on the Markov
/// property, but has more noise.
///
/// ```
/// use adagio::value::LstdLambda;
///
/// // One episode of two steps, 1 paid at its end. With λ = 1, V is the return: γ, then 1.
/// let mut sums = LstdLambda::new(2, 0.9, 1.0)?;
/// sums.push(&[1.0, 0.0], 0.0, Some(&[0.0, 1.0]), 1.0)?;
/// sums.push(&[0.0, 1.0], 1.0, None, 1.0)?;
/// let w = sums.solve(0.0)?;
/// assert!((w[0] - 0.9).abs() < 1e-12 && (w[1] - 1.0).abs() < 1e-12);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Reference
/// Boyan 1999; thesis §3.2.1 names it, and describes λ = 0.
#[derive(Debug, Clone, PartialEq)]
pub struct LstdLambda {
    gamma: f64,
    lambda: f64,
    /// z, `f`.
    trace: Vec<f64>,
    /// A, `f × f`.
    a: Mat<f64>,
    /// b, `f × 1`.
    b: Mat<f64>,
    transitions: usize,
}

impl LstdLambda {
    /// No transitions yet, for `features` features.
    ///
    /// # Errors
    /// No features or too many, γ or λ outside [0, 1].
    pub fn new(features: usize, gamma: f64, lambda: f64) -> Result<Self, ValueError> {
        if features == 0 {
            return Err(ValueError::Features { what: "phi", found: 0, expected: 1 });
        }
        discount_or_one(gamma)?;
        parameter("lambda", lambda, (0.0..=1.0).contains(&lambda), "in [0, 1]")?;
        size("the sums of LSTD(λ)", features, features)?;
        let (a, b) = (Mat::zeros(features, features), Mat::zeros(features, 1));
        Ok(LstdLambda { gamma, lambda, trace: vec![0.0; features], a, b, transitions: 0 })
    }

    /// Add the transition that follows the last one; `next` is `None` where the episode ends, which resets the trace.
    ///
    /// The weight counts what this transition adds to the sums, whole trace included. An episode that shall count twice
    /// has weight 2 on each transition.
    ///
    /// # Errors
    /// Vectors of another length, values that are not finite, a negative weight. Nothing is then added.
    pub fn push(&mut self, phi: &[f64], reward: f64, next: Option<&[f64]>, weight: f64) -> Result<(), ValueError> {
        let expected = self.trace.len();
        for (what, vector) in [("phi", phi), ("next", next.unwrap_or(phi))] {
            if vector.len() != expected {
                return Err(ValueError::Features { what, found: vector.len(), expected });
            }
            finite_list(what, vector)?;
        }
        finite_list("rewards", &[reward])?;
        sample_weights(&[weight])?;
        for (z, p) in self.trace.iter_mut().zip(phi) {
            *z = self.gamma * self.lambda * *z + p;
        }
        for j in 0..expected {
            let difference = phi[j] - self.gamma * next.map_or(0.0, |next| next[j]);
            for (i, z) in self.trace.iter().enumerate() {
                self.a[(i, j)] += weight * z * difference;
            }
        }
        for (i, z) in self.trace.iter().enumerate() {
            self.b[(i, 0)] += weight * z * reward;
        }
        self.transitions += 1;
        if next.is_none() {
            self.gap();
        }
        Ok(())
    }

    /// What comes next does not follow the last transition (a gap, a restart): nothing of it is credited to what came
    /// before.
    pub fn gap(&mut self) {
        self.trace.fill(0.0);
    }

    /// Value weights `w`, with `ridge` on the diagonal of `A`; the smallest ones where `A` is singular.
    ///
    /// # Errors
    /// No transitions, a negative ridge, sums that are not finite.
    pub fn solve(&self, ridge: f64) -> Result<Vec<f64>, ValueError> {
        check_ridge(ridge)?;
        if self.transitions == 0 {
            return Err(ValueError::Empty);
        }
        let mut a = self.a.clone();
        for i in 0..a.nrows() {
            a[(i, i)] += ridge;
        }
        let w = solve_or_pseudo_inverse(a.as_ref(), self.b.as_ref())?;
        Ok((0..a.nrows()).map(|i| w[(i, 0)]).collect())
    }
}
