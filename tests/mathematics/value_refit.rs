//! Policy iteration against a plain form of itself: each policy's system built anew, sample by sample.

use adagio::random::stream;
use adagio::value::{Fit, Lspi, LspiOptions, Outcomes, Samples, greedy, solve_or_pseudo_inverse};
use faer::{Mat, Par};
use proptest::prelude::*;
use rand::RngExt;

/// Transitions of a random problem; what may follow differs between samples if `limited`.
struct Problem {
    phi: Mat<f64>,
    next: Mat<f64>,
    actions: Vec<usize>,
    weights: Vec<f64>,
    rewards: Vec<f64>,
    allowed: Option<Vec<u32>>,
    number_of_actions: usize,
}

impl Problem {
    fn random(f: usize, n: usize, number_of_actions: usize, limited: bool, seed: u64) -> Self {
        let mut rng = stream(seed, "problem");
        let mut matrix = || Mat::from_fn(f, n, |i, _| if i == 0 { 1.0 } else { rng.random_range(-1.0..1.0) });
        let (phi, mut next) = (matrix(), matrix());
        let mut rng = stream(seed, "lists");
        for j in 0..n {
            if rng.random_range(0.0..1.0) < 0.1 {
                next.col_mut(j).fill(0.0);
            }
        }
        let actions: Vec<usize> = (0..n).map(|_| rng.random_range(0..number_of_actions)).collect();
        let weights = (0..n).map(|_| rng.random_range(0.1..2.0)).collect();
        let rewards = (0..n).map(|_| rng.random_range(-1.0..1.0)).collect();
        let mut bits = |_| rng.random_range(1..1u32 << number_of_actions);
        let allowed = limited.then(|| (0..n).map(&mut bits).collect());
        Problem { phi, next, actions, weights, rewards, allowed, number_of_actions }
    }

    fn outcomes(&self) -> Outcomes<'_> {
        Outcomes { next: self.next.as_ref(), rewards: &self.rewards, allowed: self.allowed.as_deref() }
    }

    fn lspi(&self, par: Par) -> Lspi<'_> {
        let samples = Samples { phi: self.phi.as_ref(), actions: &self.actions, weights: &self.weights };
        Lspi::new(samples, self.number_of_actions, par).unwrap()
    }

    fn allows(&self, i: usize, b: usize) -> bool {
        self.allowed.as_ref().is_none_or(|allowed| allowed[i] & (1 << b) != 0)
    }

    /// Features of a sample and an action, with all their zeros (thesis §3.2.2).
    fn block(&self, phi: &Mat<f64>, i: usize, shares: &[f64]) -> Vec<f64> {
        shares.iter().flat_map(|share| phi.col(i).iter().map(move |x| share * x)).collect()
    }

    /// LSPI as it is written down: `w = (Σ ω φ(x, a)(φ(x, a) − γ Σ_b π(b | x′) φ(x′, b))ᵀ + ρI)⁻¹ Σ ω φ(x, a) r`.
    fn plain(&self, options: &LspiOptions) -> Fit {
        let (f, n, actions) = (self.phi.nrows(), self.phi.ncols(), self.number_of_actions);
        let share = |b: usize, i: usize| {
            let may = (0..actions).filter(|&b| self.allows(i, b)).count();
            if self.allows(i, b) { 1.0 / may as f64 } else { 0.0 }
        };
        let mut policy = Mat::from_fn(actions, n, share);
        let mut weights = Mat::zeros(f, actions);
        let mut chosen = Vec::new();
        let mut fit =
            Fit { weights: Mat::zeros(f, actions), iterations: 0, converged: false, cycle: None, untried: Vec::new() };
        for iteration in 1..=options.max_iterations {
            let mut system = Mat::from_fn(f * actions, f * actions, |i, j| if i == j { options.ridge } else { 0.0 });
            let mut right = Mat::zeros(f * actions, 1);
            for i in 0..n {
                let mut one = vec![0.0; actions];
                one[self.actions[i]] = 1.0;
                let before = self.block(&self.phi, i, &one);
                let shares: Vec<f64> = (0..actions).map(|b| policy[(b, i)]).collect();
                let after = self.block(&self.next, i, &shares);
                for (row, x) in before.iter().enumerate().filter(|(_, x)| **x != 0.0) {
                    for column in 0..f * actions {
                        system[(row, column)] += self.weights[i] * x * (before[column] - options.gamma * after[column]);
                    }
                    right[(row, 0)] += self.weights[i] * x * self.rewards[i];
                }
            }
            let stacked = solve_or_pseudo_inverse(system.as_ref(), right.as_ref()).unwrap();
            let new = Mat::from_fn(f, actions, |i, a| stacked[(a * f + i, 0)]);
            let settled = (&new - &weights).norm_max() <= options.tolerance * new.norm_max();
            weights = new;
            let q = weights.transpose() * &self.next;
            let value = |i, b| if self.allows(i, b) { q[(b, i)] } else { f64::NEG_INFINITY };
            let best: Vec<usize> = (0..n).map(|i| greedy((0..actions).map(|b| value(i, b)))).collect();
            let same = best == chosen;
            chosen = best;
            fit.iterations = iteration;
            if same && settled {
                fit.converged = true;
                break;
            }
            let beta = options.mixing;
            policy = Mat::from_fn(actions, n, |b, i| {
                (1.0 - beta) * policy[(b, i)] + beta * f64::from(u8::from(chosen[i] == b))
            });
        }
        Fit { weights, ..fit }
    }
}

fn difference(a: &Fit, b: &Fit) -> f64 {
    (&a.weights - &b.weights).norm_max() / b.weights.norm_max()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever follows what: grouped samples, moved samples and sums made anew give the plain form's weights and steps.
    #[test]
    fn fits_are_those_of_the_plain_form(
        f in 1usize..9, n in 40usize..200, actions in 1usize..5, limited in any::<bool>(), seed in 0u64..10_000,
        mixing in prop::sample::select(vec![0.1, 0.3, 0.7])
    ) {
        let problem = Problem::random(f, n, actions, limited, seed);
        let options = LspiOptions { ridge: 0.1, mixing, tolerance: 1e-5, max_iterations: 30, ..LspiOptions::plain() };
        let known = problem.plain(&options);
        let found = problem.lspi(Par::Seq).fit(&problem.outcomes(), &options).unwrap();
        prop_assert_eq!((found.iterations, found.converged), (known.iterations, known.converged));
        prop_assert!(difference(&found, &known) < 1e-8, "{}", difference(&found, &known));
    }
}

#[cfg(feature = "rayon")]
#[test]
fn threads_do_not_change_the_bits() {
    adagio::random::fix_parallelism();
    let problem = Problem::random(70, 3000, 3, true, 1);
    let options = LspiOptions { mixing: 0.3, ridge: 0.1, ..LspiOptions::plain() };
    let one = problem.lspi(Par::Seq).fit(&problem.outcomes(), &options).unwrap();
    for threads in 1..=4 {
        assert_eq!(problem.lspi(Par::rayon(threads)).fit(&problem.outcomes(), &options).unwrap(), one);
    }
}
