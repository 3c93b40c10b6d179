//! Values of given policies (LSTD, LSTD(λ), LSQ, Sarsa) against exact ones and published weights.

use adagio::random::stream;
use adagio::value::worlds::{boyan, chain_walk, koller_parr, sixteen, walk};
use adagio::value::{
    FiniteMdp, LspiOptions, LstdLambda, Policy, Sarsa, SarsaOptions, Smoothing, Step, exact, maximiser_probabilities,
};
use faer::{Mat, MatRef};
use proptest::prelude::*;
use rand::RngExt;

fn column(basis: MatRef<'_, f64>, s: usize) -> Vec<f64> {
    (0..basis.nrows()).map(|i| basis[(i, s)]).collect()
}

fn assert_close(found: &[f64], known: &[f64], tolerance: f64) {
    assert_eq!(found.len(), known.len());
    for (found, known) in found.iter().zip(known) {
        assert!((found - known).abs() < tolerance, "{found} against {known}");
    }
}

/// Boyan 1999: the end belongs to the data.
#[test]
fn boyan_chain_with_and_without_its_end() {
    let (process, basis) = (boyan::process().unwrap(), boyan::basis());
    let with_end = process.expected(basis.as_ref(), |_, _| 1.0).unwrap().lstd(1.0, 0.0).unwrap();
    assert_close(&with_end, &boyan::WEIGHTS, 1e-9);
    let not_the_end = |s: usize, _| f64::from(u8::from(s != 0));
    let without = process.expected(basis.as_ref(), not_the_end).unwrap().lstd(1.0, 0.0).unwrap();
    assert_close(&without, &boyan::WEIGHTS_WITHOUT_END, 1e-9);
    let values = exact::values(&process, &Policy::uniform(14, 1).unwrap()).unwrap();
    for (s, value) in values.iter().enumerate().take(13) {
        assert!((value + 2.0 * s as f64).abs() < 1e-9, "V({s}) = {value}");
    }
}

/// Without discount LSQ is as good as LSTD where episodes end: with one action, Q is V.
#[test]
fn lsq_without_discount() {
    let (process, basis) = (boyan::process().unwrap(), boyan::basis());
    let batch = process.expected(basis.as_ref(), |_, _| 1.0).unwrap();
    let only = Policy::uniform(batch.len(), 1).unwrap();
    let weights = batch.lspi().unwrap().evaluate(&batch.outcomes(), &only, 1.0, 0.0).unwrap();
    assert_close(&column(weights.as_ref(), 0), &boyan::WEIGHTS, 1e-9);
}

/// All 233 episodes of Boyan's chain from the top, each with its probability.
fn boyan_episodes(process: &FiniteMdp) -> Vec<(f64, Vec<Step>)> {
    let mut open = vec![(1.0, boyan::START, Vec::new())];
    let mut done = Vec::new();
    while let Some((probability, from, steps)) = open.pop() {
        if process.is_terminal(from) {
            done.push((probability, steps));
            continue;
        }
        for to in process.successors(from, 0) {
            let mut longer = steps.clone();
            longer.push(Step { from, action: 0, reward: to.reward, to: to.state });
            open.push((probability * to.probability, to.state, longer));
        }
    }
    done
}

/// The value is linear in the features, so every λ gives the same weights in expectation.
#[test]
fn boyan_chain_with_traces() {
    let (process, basis) = (boyan::process().unwrap(), boyan::basis());
    let episodes = boyan_episodes(&process);
    assert_eq!(episodes.len(), 233);
    for lambda in [0.0, 0.3, 0.7, 0.9, 1.0] {
        let mut sums = LstdLambda::new(4, 1.0, lambda).unwrap();
        for (probability, steps) in &episodes {
            for step in steps {
                let next = (step.to != boyan::END).then(|| column(basis.as_ref(), step.to));
                sums.push(&column(basis.as_ref(), step.from), step.reward, next.as_deref(), *probability).unwrap();
            }
        }
        assert_close(&sums.solve(0.0).unwrap(), &boyan::WEIGHTS, 1e-8);
    }
}

/// Random vectors in episodes of random lengths.
fn random_episodes(features: usize, episodes: usize, seed: u64) -> Vec<Vec<(Vec<f64>, f64)>> {
    let mut rng = stream(seed, "episodes");
    (0..episodes)
        .map(|_| {
            let length = rng.random_range(1..8);
            let mut vector = || (0..features).map(|_| rng.random_range(-1.0..1.0)).collect::<Vec<f64>>();
            let phis: Vec<Vec<f64>> = (0..length).map(|_| vector()).collect();
            phis.into_iter().map(|phi| (phi, rng.random_range(-1.0..1.0))).collect()
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// λ = 1 is the regression of the discounted returns on the features.
    #[test]
    fn lstd_of_one_is_monte_carlo_regression(features in 1usize..5, seed in 0u64..10_000, gamma in 0.0f64..=1.0) {
        let episodes = random_episodes(features, 30, seed);
        let mut sums = LstdLambda::new(features, gamma, 1.0).unwrap();
        let (mut rows, mut returns) = (Vec::new(), Vec::new());
        for episode in &episodes {
            for (t, (phi, reward)) in episode.iter().enumerate() {
                let next = episode.get(t + 1).map(|(phi, _)| phi.as_slice());
                sums.push(phi, *reward, next, 1.0).unwrap();
                rows.push(phi.clone());
                returns.push(episode[t..].iter().rev().fold(0.0, |sum, (_, reward)| reward + gamma * sum));
            }
        }
        // Least squares by QR: another way than sums and LU.
        use faer::linalg::solvers::SolveLstsq;
        let x = Mat::from_fn(rows.len(), features, |t, i| rows[t][i]);
        let y = Mat::from_fn(rows.len(), 1, |t, _| returns[t]);
        let w = x.qr().solve_lstsq(&y);
        let known: Vec<f64> = (0..features).map(|i| w[(i, 0)]).collect();
        let found = sums.solve(0.0).unwrap();
        let scale = known.iter().fold(1.0f64, |scale, w| scale.max(w.abs()));
        for (found, known) in found.iter().zip(&known) {
            prop_assert!((found - known).abs() < 1e-8 * scale, "{found} against {known}");
        }
    }

    /// λ = 0 is LSTD, whether episodes end or have gaps; with λ > 0 a gap is as good as another stream.
    #[test]
    fn traces_of_zero_and_gaps(features in 1usize..5, seed in 0u64..10_000, ridge in 0.0f64..1.0) {
        let episodes = random_episodes(features, 20, seed);
        let process = |lambda: f64| LstdLambda::new(features, 0.9, lambda).unwrap();
        let mut zero = process(0.0);
        let mut batch = adagio::value::Batch::new(features, 1).unwrap();
        let (mut gaps, mut reordered) = (process(0.8), process(0.8));
        for episode in &episodes {
            for pair in episode.windows(2) {
                zero.push(&pair[0].0, pair[0].1, Some(&pair[1].0), 1.0).unwrap();
                batch.push(&pair[0].0, 0, pair[0].1, Some(&pair[1].0), 1.0).unwrap();
                gaps.push(&pair[0].0, pair[0].1, Some(&pair[1].0), 1.0).unwrap();
            }
            gaps.gap();
        }
        prop_assume!(!batch.is_empty());
        for episode in episodes.iter().rev() {
            for pair in episode.windows(2) {
                reordered.push(&pair[0].0, pair[0].1, Some(&pair[1].0), 1.0).unwrap();
            }
            reordered.gap();
        }
        let ridge = ridge + 0.1;
        let pairs = [(zero, batch.lstd(0.9, ridge).unwrap()), (gaps, reordered.solve(ridge).unwrap())];
        for (sums, known) in pairs {
            let scale = known.iter().fold(1.0f64, |scale, w| scale.max(w.abs()));
            for (found, known) in sums.solve(ridge).unwrap().iter().zip(&known) {
                prop_assert!((found - known).abs() < 1e-7 * scale, "{found} against {known}");
            }
        }
    }

    /// LSQ with one feature for each state is exact for every policy, deterministic or not.
    #[test]
    fn lsq_of_a_stochastic_policy_is_exact(states in 1usize..15, actions in 1usize..4, seed in 0u64..10_000) {
        let mut rng = stream(seed, "policy");
        let raw = Mat::from_fn(actions, states, |_, _| rng.random_range(0.01..1.0));
        let sum = |s: usize| (0..actions).map(|a| raw[(a, s)]).sum::<f64>();
        let policy = Policy::new(Mat::from_fn(actions, states, |a, s| raw[(a, s)] / sum(s)).as_ref()).unwrap();
        let drawn: Vec<[(usize, f64); 2]> = (0..states * actions)
            .map(|_| [(); 2].map(|()| (rng.random_range(0..states), rng.random_range(0.1..0.9))))
            .collect();
        let rewards: Vec<f64> = (0..states).map(|_| rng.random_range(-1.0..1.0)).collect();
        let process = FiniteMdp::with_target_rewards(states, actions, 0.9, &rewards, |s, a| {
            let [first, second] = drawn[s * actions + a];
            vec![(first.0, first.1), (second.0, 1.0 - first.1)]
        })
        .unwrap();
        let known = exact::action_values(&process, &exact::values(&process, &policy).unwrap()).unwrap();
        let found = lsq(&process, &policy);
        prop_assert!((&found - &known).norm_max() < 1e-8);
    }

    /// The probabilities of being the largest: for two by the error function of their difference.
    #[test]
    fn probabilities_of_the_maximiser(
        means in prop::collection::vec(-5.0f64..5.0, 1..6), deviations in prop::collection::vec(1e-6f64..4.0, 6)
    ) {
        let p = maximiser_probabilities(&means, &deviations[..means.len()]).unwrap();
        prop_assert!((p.iter().sum::<f64>() - 1.0).abs() < 1e-12 && p.iter().all(|p| *p >= 0.0));
        if means.len() >= 2 {
            let two = maximiser_probabilities(&means[..2], &deviations[..2]).unwrap();
            let sigma = deviations[0].hypot(deviations[1]);
            let known = 0.5 * libm::erfc(-(means[0] - means[1]) / (sigma * std::f64::consts::SQRT_2));
            prop_assert!((two[0] - known).abs() < 1e-9, "{} against {known}", two[0]);
        }
        let alike = maximiser_probabilities(&vec![means[0]; means.len()], &vec![deviations[0]; means.len()]).unwrap();
        prop_assert!(alike.iter().all(|p| (p - 1.0 / means.len() as f64).abs() < 1e-9));
    }
}

/// Three Gaussians, by plain summation over a very fine grid.
#[test]
fn probabilities_of_the_maximiser_of_three() {
    for (means, deviations) in
        [([0.0, 0.5, 1.0], [1.0, 2.0, 0.3]), ([0.0, 0.0, 0.1], [1e-3, 1.0, 0.05]), ([1.0, 0.9, -3.0], [0.1, 0.1, 5.0])]
    {
        let below = |t: f64, b: usize| 0.5 * libm::erfc((means[b] - t) / (deviations[b] * std::f64::consts::SQRT_2));
        let found = maximiser_probabilities(&means, &deviations).unwrap();
        for a in 0..3 {
            let (n, width) = (400_000, 16.0 * deviations[a]);
            let dt = width / f64::from(n);
            let known: f64 = (0..n)
                .map(|i| {
                    let t = means[a] - width / 2.0 + (f64::from(i) + 0.5) * dt;
                    let z: f64 = (t - means[a]) / deviations[a];
                    let others: f64 = (0..3).filter(|&b| b != a).map(|b| below(t, b)).product();
                    (-0.5 * z * z).exp() / (deviations[a] * std::f64::consts::TAU.sqrt()) * others * dt
                })
                .sum();
            assert!((found[a] - known).abs() < 1e-8, "{} against {known}", found[a]);
        }
    }
}

/// LSQ by tabular features from expected transitions, `A × S`.
fn lsq(process: &FiniteMdp, policy: &Policy) -> Mat<f64> {
    let batch = process.expected(Mat::identity(process.states(), process.states()).as_ref(), |_, _| 1.0).unwrap();
    let mut to = Vec::new();
    for s in 0..process.states() {
        for a in 0..process.actions() {
            to.extend(process.successors(s, a).iter().map(|to| to.state));
        }
    }
    let after = policy.at(&to).unwrap();
    let weights = batch.lspi().unwrap().evaluate(&batch.outcomes(), &after, process.gamma(), 0.0).unwrap();
    weights.transpose().to_owned()
}

#[test]
fn lsq_of_the_optimal_policy_gives_the_optimal_values() {
    for process in [chain_walk::twenty().unwrap(), sixteen::process().unwrap()] {
        let optimum = exact::policy_iteration(&process).unwrap();
        let found = lsq(&process, &optimum.policy);
        assert!((&found - &optimum.q).norm_max() < 1e-9);
    }
}

/// A cosine of the walk between walls has μ/(1 − γμ) times itself as its value, and four features hold it.
#[test]
fn cosines_of_random_walks_are_their_own_values() {
    let (states, gamma) = (20, 0.9);
    let basis = walk::cosines(states, 4).unwrap();
    for j in 0..4 {
        let process = walk::reflecting(&column(basis.transpose(), j), gamma).unwrap();
        let w = process.expected(basis.as_ref(), |_, _| 1.0).unwrap().lstd(gamma, 0.0).unwrap();
        let mu = walk::reflecting_eigenvalue(states, j);
        for (i, w) in w.iter().enumerate() {
            let known = if i == j { mu / (1.0 - gamma * mu) } else { 0.0 };
            assert!((w - known).abs() < 1e-9, "feature {i} of reward {j}: {w}");
        }
    }
    for j in 0..4 {
        let rewards: Vec<f64> =
            (0..states).map(|s| (std::f64::consts::TAU * (j * s) as f64 / states as f64).sin()).collect();
        let process = walk::cyclic(&rewards, gamma).unwrap();
        let values = exact::values(&process, &Policy::uniform(states, 1).unwrap()).unwrap();
        let mu = walk::cyclic_eigenvalue(states, j);
        let known: Vec<f64> = rewards.iter().map(|r| mu / (1.0 - gamma * mu) * r).collect();
        assert_close(&values, &known, 1e-9);
    }
}

/// Thesis §3.3.1: greedy sampling leaves the other actions unlearned. Sarsa on the chain of four states, tabular.
#[test]
fn sarsa_needs_exploration() {
    let process = koller_parr::process().unwrap();
    let phi = |s: usize| column(Mat::<f64>::identity(4, 4).as_ref(), s);
    let run = |epsilon: f64, seed: u64| {
        let mut rng = stream(seed, "sarsa");
        let mut sarsa = Sarsa::new(4, 2, SarsaOptions { gamma: 0.9, step: 0.02, epsilon }).unwrap();
        let mut tried = [[0usize; 4]; 2];
        // Trajectories of 20 steps from uniform starts, as the thesis describes them.
        for _ in 0..5000 {
            let mut state = rng.random_range(0..4);
            let mut action = sarsa.choose(&phi(state), &mut rng).unwrap();
            for _ in 0..20 {
                tried[action][state] += 1;
                let step = process.step(state, action, &mut rng).unwrap().unwrap();
                let next = sarsa.choose(&phi(step.to), &mut rng).unwrap();
                sarsa.learn(&phi(state), action, step.reward, Some((&phi(step.to), next))).unwrap();
                (state, action) = (step.to, next);
            }
        }
        (sarsa.weights().transpose().to_owned(), tried)
    };
    let mut starved = 0;
    for seed in 0..5 {
        // With exploration: the optimal policy, and the values of its ε-greedy version.
        let (q, _) = run(0.2, seed);
        assert_eq!(chain_walk::letters(&Policy::greedy(q.as_ref()).unwrap().chosen()), "RRLL");
        let soft = exact::policy_iteration(&process).unwrap().policy.softened(0.2).unwrap();
        let known = exact::action_values(&process, &exact::values(&process, &soft).unwrap()).unwrap();
        let error = (&q - &known).norm_max() / known.norm_max();
        assert!(error < 0.1, "seed {seed}: {error}");
        // Without: the first action that pays is all that is ever done; the other one keeps its first value, zero.
        let (q, tried) = run(0.0, seed);
        assert_eq!(chain_walk::letters(&Policy::greedy(q.as_ref()).unwrap().chosen()), "LLLL");
        starved += (0..4).filter(|&s| tried[chain_walk::RIGHT][s] == 0 && q[(chain_walk::RIGHT, s)] == 0.0).count();
    }
    assert_eq!(starved, 20, "states in which going right was never tried, of 20");
}

/// η = 0 hands every vector through, bit for bit; otherwise the state is the sum of what was seen, with shares (1 − η)ηᵏ.
#[test]
fn smoothing_is_an_exponential_mean() {
    let mut rng = stream(3, "smoothing");
    let seen: Vec<[f64; 2]> = (0..30).map(|_| [rng.random_range(-1.0..1.0), -0.0]).collect();
    let (mut none, mut some) = (Smoothing::new(0.0).unwrap(), Smoothing::new(0.3).unwrap());
    for (t, phi) in seen.iter().enumerate() {
        let out = none.push(phi).unwrap();
        assert!(out.iter().zip(phi).all(|(a, b)| a.to_bits() == b.to_bits()));
        let share = |k: usize| if k == t { 0.3f64.powi(k as i32) } else { 0.7 * 0.3f64.powi(k as i32) };
        let known: f64 = (0..=t).map(|k| share(k) * seen[t - k][0]).sum();
        assert!((some.push(phi).unwrap()[0] - known).abs() < 1e-14);
    }
    assert!(Smoothing::new(1.0).is_err() && Smoothing::new(f64::NAN).is_err());
}

/// Sampled steps follow the probabilities, and values from samples tend to the exact ones.
#[test]
fn sampled_steps_follow_the_process() {
    let process = chain_walk::process(4, 0.9, 0.9, &[1, 2]).unwrap();
    let steps = process.uniform_steps(40_000, &mut stream(2, "steps"));
    let right = steps.iter().filter(|step| step.from == 1 && step.action == chain_walk::RIGHT);
    let arrived = right.clone().filter(|step| step.to == 2).count() as f64 / right.count() as f64;
    assert!((arrived - 0.9).abs() < 0.02, "{arrived}");
    let batch = process.in_features(&steps, Mat::<f64>::identity(4, 4).as_ref()).unwrap();
    let q = batch.fit(&LspiOptions::plain()).unwrap().weights.transpose().to_owned();
    assert!((&q - &exact::policy_iteration(&process).unwrap().q).norm_max() < 0.2);
    let chain = boyan::process().unwrap();
    let episode =
        chain.episode(boyan::START, &Policy::uniform(14, 1).unwrap(), 100, &mut stream(2, "episode")).unwrap();
    assert_eq!((episode[0].from, episode.last().unwrap().to), (boyan::START, boyan::END));
    assert!(episode.windows(2).all(|pair| pair[0].to == pair[1].from));
}
