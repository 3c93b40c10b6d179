//! Whatever is handed to the public functions of `value`: an error or finite numbers, never a panic.

use crate::common::generator;
use adagio::value::worlds::{bases, boyan, chain_walk, koller_parr, pendulum, rooms, walk};
use adagio::value::{
    Batch, FiniteMdp, Lspi, LspiOptions, LstdLambda, Outcomes, Policy, Samples, Sarsa, SarsaOptions, Smoothing, Start,
    Successor, ValueError, Window, balance, closeness_weights, exact, greedy, lstd, maximiser_probabilities,
    solve_or_pseudo_inverse,
};
use faer::{Mat, Par};
use proptest::prelude::*;

/// Numbers of all kinds, odd ones often.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => -2.0f64..2.0,
        1 => Just(0.0),
        1 => prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 1e-300, 1.0, -1.0]),
    ]
}

/// A number that is mostly as it should be.
fn tame() -> impl Strategy<Value = f64> {
    prop_oneof![20 => -1.0f64..1.0, 1 => number()]
}

fn list(longest: usize) -> impl Strategy<Value = Vec<f64>> {
    prop::collection::vec(tame(), 0..longest)
}

/// A matrix of given shape from an endless list.
fn matrix(rows: usize, columns: usize, values: &[f64]) -> Mat<f64> {
    Mat::from_fn(rows, columns, |i, j| if values.is_empty() { 1.0 } else { values[(i + j * rows) % values.len()] })
}

fn options() -> impl Strategy<Value = LspiOptions> {
    let fraction = || prop_oneof![8 => 0.0f64..1.0, 1 => number()];
    let start = prop::sample::select(vec![Start::Uniform, Start::Drawn(3), Start::First]);
    (fraction(), fraction(), fraction(), 0usize..6, fraction(), start, any::<bool>(), prop::option::of(fraction()))
        .prop_map(|(gamma, ridge, mixing, max_iterations, tolerance, start, soft, closeness)| LspiOptions {
            gamma,
            ridge,
            mixing,
            max_iterations,
            tolerance,
            start,
            soft,
            closeness,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn policy_iteration_of_anything(
        shape in (0usize..4, 0usize..8, 0usize..5, 0usize..5),
        off in (0usize..12, 0usize..12, 0usize..12),
        values in list(40), numbers in prop::collection::vec(0usize..4, 8), rewards in list(9), weights in list(9),
        bits in prop::option::of(prop::collection::vec(0u32..16, 8)), options in options()
    ) {
        let (f, n, actions, constant) = shape;
        // Mostly lists that fit.
        let fit = |off: usize, right: usize| if off > 9 { off - 9 } else { right };
        let values = if constant == 0 { vec![1.0] } else { values };
        let phi = matrix(f, n, &values);
        let next = matrix(fit(off.0, f), fit(off.1, n), &values);
        let cycled = |list: &[f64], length: usize| -> Vec<f64> { matrix(1, length, list).row(0).iter().copied().collect() };
        let weights: Vec<f64> = cycled(&weights, n).iter().map(|w| if *w > -0.9 { w.abs() } else { *w }).collect();
        let rewards = cycled(&rewards, fit(off.2, n));
        let samples = Samples { phi: phi.as_ref(), actions: &numbers[..n], weights: &weights };
        if let Ok(problem) = Lspi::new(samples, actions, Par::Seq) {
            let allowed = bits.as_ref().map(|bits| &bits[..n]);
            let outcomes = Outcomes { next: next.as_ref(), rewards: &rewards, allowed };
            if let Ok(fit) = problem.fit(&outcomes, &options) {
                prop_assert!(fit.weights.is_all_finite());
                prop_assert!(fit.action_values(phi.as_ref()).is_ok() && fit.policy(next.as_ref()).is_ok());
            }
            for states in [n, 2] {
                if let Ok(q) = problem.evaluate(&outcomes, &Policy::uniform(states, actions).unwrap(), options.gamma, options.ridge) {
                    prop_assert!(q.is_all_finite());
                }
            }
        }
        if let Ok(w) = lstd(phi.as_ref(), next.as_ref(), &rewards, &weights, options.gamma, options.ridge) {
            prop_assert!(w.iter().all(|w| w.is_finite()));
        }
    }

    #[test]
    fn systems_of_anything(rows in 0usize..5, columns in 0usize..5, right in 0usize..5, values in list(20)) {
        let solved = solve_or_pseudo_inverse(matrix(rows, columns, &values).as_ref(), matrix(right, 2, &values).as_ref());
        if let Ok(w) = solved {
            prop_assert!(w.is_all_finite());
        }
    }

    #[test]
    fn streams_of_anything(
        features in 0usize..4, actions in 0usize..4, parameters in (number(), number(), number()),
        pushes in prop::collection::vec((list(4), tame(), prop::option::of(list(4)), tame(), 0usize..4), 0..12)
    ) {
        let (first, second, third) = parameters;
        let mut traces = LstdLambda::new(features, first, second);
        let mut batch = Batch::new(features, actions);
        let mut sarsa = Sarsa::new(features, actions, SarsaOptions { gamma: first, step: second, epsilon: third });
        let mut smoothing = Smoothing::new(first);
        let mut rng = generator(1);
        for (phi, reward, next, weight, action) in &pushes {
            if let Ok(traces) = &mut traces {
                let _ = traces.push(phi, *reward, next.as_deref(), *weight);
            }
            if let Ok(batch) = &mut batch {
                let _ = batch.push(phi, *action, *reward, next.as_deref(), *weight);
            }
            if let Ok(sarsa) = &mut sarsa {
                let _ = sarsa.choose(phi, &mut rng);
                let _ = sarsa.learn(phi, *action, *reward, next.as_deref().map(|next| (next, 0)));
                prop_assert!(sarsa.weights().is_all_finite());
            }
            if let Ok(smoothing) = &mut smoothing
                && let Ok(x) = smoothing.push(phi)
            {
                prop_assert!(x.iter().all(|x| x.is_finite()));
            }
        }
        if let Ok(traces) = traces && let Ok(w) = traces.solve(third) {
            prop_assert!(w.iter().all(|w| w.is_finite()));
        }
        if let Ok(batch) = batch && let Ok(fit) = batch.fit(&LspiOptions { max_iterations: 3, ..LspiOptions::plain() }) {
            prop_assert!(fit.weights.is_all_finite());
        }
    }

    #[test]
    fn processes_of_anything(
        states in 0usize..5, actions in 0usize..4, gamma in prop_oneof![0.0f64..1.0, Just(1.0), number()],
        targets in prop::collection::vec((0usize..6, prop_oneof![Just(1.0), Just(0.5), number()], tame()), 1..6),
        empty in 0usize..6, values in list(8)
    ) {
        let made = FiniteMdp::new(states, actions, gamma, |s, a| {
            if s == empty {
                return Vec::new();
            }
            let (state, probability, reward) = targets[(s + a) % targets.len()];
            let rest = Successor { state: states.wrapping_sub(1), probability: 1.0 - probability, reward };
            vec![Successor { state: state.min(states), probability, reward }, rest]
        });
        let mut rng = generator(1);
        if let Ok(process) = made {
            let found = [exact::policy_iteration(&process), exact::value_iteration(&process, 1e-3, 50)];
            for optimum in found.into_iter().flatten() {
                prop_assert!(optimum.values.iter().all(|value| value.is_finite()));
            }
            let _ = exact::action_values(&process, &values);
            let basis = matrix(values.len(), process.states(), &values);
            let steps = process.uniform_steps(5, &mut rng);
            for batch in [process.expected(basis.as_ref(), |_, _| 1.0), process.in_features(&steps, basis.as_ref())] {
                let _ = batch.and_then(|batch| batch.fit(&LspiOptions { max_iterations: 3, ..LspiOptions::plain() }));
            }
            let _ = process.step(states + 1, 0, &mut rng);
            let _ = process.step(0, actions, &mut rng);
            let uniform = Policy::uniform(process.states(), process.actions()).unwrap();
            prop_assert!(process.episode(0, &uniform, 10, &mut rng).is_ok());
            prop_assert!(process.episode(states, &uniform, 10, &mut rng).is_err());
            prop_assert!(process.under(&Policy::uniform(states + 1, actions).unwrap()).is_err());
        }
        let _ = Policy::new(matrix(actions, states, &values).as_ref());
        let _ = Policy::greedy(matrix(actions, states, &values).as_ref());
    }

    #[test]
    fn probabilities_of_anything(
        means in prop::collection::vec(number(), 0..5), deviations in prop::collection::vec(number(), 0..5), kappa in number()
    ) {
        let positive: Vec<f64> = deviations.iter().map(|d| d.abs()).collect();
        for deviations in [&deviations, &positive] {
            if let Ok(p) = maximiser_probabilities(&means, deviations) {
                prop_assert!((p.iter().sum::<f64>() - 1.0).abs() < 1e-9 && p.iter().all(|p| *p >= 0.0), "{p:?}");
            }
            for rows in 0..3 {
                let q = matrix(rows, deviations.len(), &means);
                if let Ok(weights) = closeness_weights(q.as_ref(), deviations, kappa) {
                    prop_assert!(weights.iter().all(|w| w.is_finite() && *w >= 0.0), "{weights:?}");
                }
            }
        }
        prop_assert!(greedy(means.iter().copied()) < means.len().max(1));
        if let Ok(weights) = balance(&[(0, 0), (0, 0), (1, 0)], kappa) {
            prop_assert!(weights.iter().all(|w| w.is_finite()));
        }
        prop_assert!(balance(&[], 0.5).unwrap().is_empty());
    }

    #[test]
    fn worlds_of_anything(states in 0usize..5, numbers in (number(), number()), text in "[#.DGx\n]{0,20}", rewards in list(5)) {
        let (first, second) = numbers;
        let _ = chain_walk::process(states, first, second, &[0]);
        let _ = walk::reflecting(&rewards, first);
        let _ = walk::cyclic(&rewards, first);
        let _ = bases::bumps(states, states);
        let _ = bases::powers(states, 3);
        let _ = walk::cosines(states, 3);
        if let Ok(rooms) = rooms::Rooms::parse(&text) {
            let _ = rooms.process(first, second);
            prop_assert!(rooms.neighbour(usize::MAX, 0) == usize::MAX && rooms.state_at(usize::MAX, 0).is_none());
        }
        let pole = pendulum::Pendulum { angle: first, speed: second };
        let _ = (pole.pushed(first).has_fallen(), pole.step(states, &mut generator(1)));
        let _ = pendulum::balanced_steps(matrix(states, 3, &rewards).as_ref(), 10, &mut generator(1));
        let _ = koller_parr::on_policy_iteration(&Policy::uniform(states, 2).unwrap(), 2);
    }
}

/// Sizes that no memory holds, and values that overflow on the way.
#[test]
fn sizes_and_values_out_of_reach_are_refused() {
    let most = usize::MAX;
    let one = Mat::<f64>::from_fn(1, 1, |_, _| 1.0);
    let refused = |error: ValueError| {
        let text = error.to_string();
        assert!(matches!(error, ValueError::Size { .. }) && text.contains("1073741824"), "{text}");
    };
    refused(Policy::uniform(most, 2).unwrap_err());
    refused(Policy::deterministic(&[0], most).unwrap_err());
    refused(LstdLambda::new(most, 0.9, 0.5).unwrap_err());
    let options = SarsaOptions { gamma: 0.9, step: 0.1, epsilon: 0.1 };
    refused(Sarsa::new(most, 2, options).unwrap_err());
    refused(Sarsa::new(2, most, options).unwrap_err());
    let mut wide = Batch::new(1, most).unwrap();
    wide.push(&[1.0], 0, 0.0, None, 1.0).unwrap();
    refused(wide.lspi().unwrap_err());
    let samples = Samples { phi: one.as_ref(), actions: &[0], weights: &[1.0] };
    refused(Lspi::new(samples, most, Par::Seq).unwrap_err());
    refused(FiniteMdp::new(most, 2, 0.9, |_, _| vec![]).unwrap_err());
    refused(chain_walk::process(most, 0.9, 0.9, &[]).unwrap_err());
    refused(bases::powers(most, 3).unwrap_err());
    refused(bases::powers(3, u32::MAX).unwrap_err());
    refused(bases::bumps(3, most).unwrap_err());
    refused(walk::cosines(most, most).unwrap_err());
    assert_eq!(Policy::deterministic(&[], 0).unwrap_err(), ValueError::NoActions);
    assert_eq!(Batch::new(most, 1).unwrap().len(), 0);
    assert!(Smoothing::new(0.5).unwrap().push(&[]).is_err());

    // A high degree takes no more time than its numbers.
    assert!(bases::powers(3, 100_000).unwrap().is_all_finite());
    let nan = Mat::from_fn(1, 1, |_, _| f64::NAN);
    let mut batch = Batch::new(1, 2).unwrap();
    batch.push(&[1.0], 0, 1.0, None, 1.0).unwrap();
    let fit = batch.fit(&LspiOptions::plain()).unwrap();
    assert!(fit.action_values(nan.as_ref()).is_err() && fit.policy(nan.as_ref()).is_err());
    assert!(Policy::greedy(nan.as_ref()).is_err());
    assert!(pendulum::balanced_steps(Mat::from_fn(10, 3, |_, _| f64::NAN).as_ref(), 10, &mut generator(1)).is_err());
    assert!(
        pendulum::balanced_steps(Mat::zeros(10, 2).as_ref(), 10, &mut generator(1))
            .unwrap_err()
            .to_string()
            .contains("has 2")
    );
    // Rewards near the end of the numbers: all values lie beyond it.
    for reward in [1.7e308, -1.7e308] {
        let huge = FiniteMdp::with_target_rewards(1, 2, 0.9, &[reward], |_, _| vec![(0, 1.0)]).unwrap();
        assert!(exact::policy_iteration(&huge).is_err() && exact::value_iteration(&huge, 1e-6, 100).is_err());
        assert!(exact::action_values(&huge, &[reward]).is_err());
    }
    let two = FiniteMdp::with_target_rewards(2, 1, 0.9, &[0.0, 1.0], |s, _| vec![(s, 1.0)]).unwrap();
    let text = two.expected(one.as_ref(), |_, _| 1.0).unwrap_err().to_string();
    assert_eq!(text, "the basis has 1 entries, but it must have 2");
    // Equal values far from zero, with deviations that are small beside them, share alike.
    assert_eq!(maximiser_probabilities(&[1e300; 2], &[1e-10; 2]).unwrap(), [0.5, 0.5]);
    assert_eq!(maximiser_probabilities(&[1.7e308, -1.7e308], &[1.0, 1.0]).unwrap(), [1.0, 0.0]);
}

/// With a discount so near to 1 that rounding is larger than the difference between policies, policy iteration still ends.
#[test]
fn policy_iteration_ends_whatever_the_discount() {
    for gamma in [1.0 - 1e-9, 1.0 - 1e-13, 1.0 - f64::EPSILON / 2.0] {
        for states in [2, 5, 20] {
            let process = chain_walk::process(states, 0.7, gamma, &[0, states - 1]).unwrap();
            if let Ok(optimum) = exact::policy_iteration(&process) {
                assert!(optimum.values.iter().all(|value| value.is_finite()));
            }
        }
    }
}

/// The errors name what was wrong, with its numbers.
#[test]
fn impossible_requests_are_refused_with_their_numbers() {
    let phi = Mat::<f64>::zeros(2, 3);
    let data = Samples { phi: phi.as_ref(), actions: &[0, 1, 2], weights: &[1.0; 3] };
    assert_eq!(Lspi::new(data, 2, Par::Seq).unwrap_err(), ValueError::Action { index: 2, action: 2, actions: 2 });
    assert_eq!(Lspi::new(data, 0, Par::Seq).unwrap_err(), ValueError::NoActions);
    let negative = Samples { weights: &[1.0, -0.5, 1.0], ..data };
    assert_eq!(Lspi::new(negative, 3, Par::Seq).unwrap_err(), ValueError::Weight { index: 1, value: -0.5 });
    let none = Mat::<f64>::zeros(0, 3);
    let without = Samples { phi: none.as_ref(), ..data };
    assert_eq!(
        Lspi::new(without, 3, Par::Seq).unwrap_err(),
        ValueError::Features { what: "phi", found: 0, expected: 1 }
    );
    let problem = Lspi::new(data, 3, Par::Seq).unwrap();
    let outcomes = Outcomes { next: phi.as_ref(), rewards: &[0.0; 3], allowed: None };
    let fit = |outcomes: Outcomes<'_>, options: LspiOptions| problem.fit(&outcomes, &options).unwrap_err();
    let plain = LspiOptions::plain();
    assert_eq!(fit(outcomes, LspiOptions { gamma: 1.0, ..plain }), ValueError::Gamma(1.0));
    assert_eq!(fit(outcomes, LspiOptions { ridge: -1.0, ..plain }), ValueError::Ridge(-1.0));
    assert_eq!(fit(outcomes, LspiOptions { mixing: 0.0, ..plain }), ValueError::Mixing(0.0));
    assert_eq!(fit(outcomes, LspiOptions { max_iterations: 0, ..plain }), ValueError::Iterations);
    assert!(fit(outcomes, LspiOptions { tolerance: f64::NAN, ..plain }).to_string().contains("tolerance = NaN"));
    assert!(fit(outcomes, LspiOptions { closeness: Some(0.0), ..plain }).to_string().contains("closeness = 0"));
    assert_eq!(
        fit(Outcomes { rewards: &[0.0; 2], ..outcomes }, plain),
        ValueError::Length { what: "rewards", found: 2, expected: 3 }
    );
    let other = Mat::<f64>::zeros(4, 3);
    assert_eq!(
        fit(Outcomes { next: other.as_ref(), ..outcomes }, plain),
        ValueError::Features { what: "next", found: 4, expected: 2 }
    );
    let text = fit(Outcomes { rewards: &[0.0, f64::NAN, 0.0], ..outcomes }, plain).to_string();
    assert_eq!(text, "rewards holds NaN at place 1: all values must be finite");
    let many = Lspi::new(data, 33, Par::Seq).unwrap();
    let outcomes = Outcomes { allowed: Some(&[1; 3]), ..outcomes };
    assert_eq!(many.fit(&outcomes, &plain).unwrap_err(), ValueError::AllowedBits(33));
    // No weight anywhere: nothing is known, and the smallest weights are zero.
    let weightless = Lspi::new(Samples { weights: &[0.0; 3], ..data }, 3, Par::Seq).unwrap();
    let fit = weightless.fit(&Outcomes { allowed: None, ..outcomes }, &plain).unwrap();
    assert_eq!(fit.weights, Mat::<f64>::zeros(2, 3));
    let half = FiniteMdp::with_target_rewards(2, 1, 0.9, &[0.0, 1.0], |s, _| vec![(s, 0.25), (1, 0.25)]);
    assert_eq!(
        half.unwrap_err().to_string(),
        "the probabilities after state 0, action 0 are not allowed: they sum to 0.5, not to 1"
    );
    let endless = FiniteMdp::with_target_rewards(2, 1, 1.0, &[0.0, 1.0], |s, _| vec![(s, 1.0)]).unwrap();
    assert_eq!(exact::policy_iteration(&endless).unwrap_err(), ValueError::Endless { state: 0 });
    assert!(exact::policy_iteration(&boyan::process().unwrap()).is_ok());
    assert_eq!(Window::<u32, f64>::new(0).len(), 0);
}
