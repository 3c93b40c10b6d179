//! Exact values and policies of finite processes: the oracle for everything that learns from samples.
//!
//! | | what it solves | cost |
//! |---|---|---|
//! | [`values`] | `(I − γP_π)V = R_π`, the values of one policy | `O(S³)` time, `O(S²)` memory, dense in the states `S` |
//! | [`action_values`] | `Q` from `V`: one step ahead | one look at each transition |
//! | [`policy_iteration`] | the optimum, by some ten evaluations as a rule | as [`values`], each |
//! | [`value_iteration`] | the optimum, as a check by other means | one look at each transition, each sweep |

use std::collections::HashSet;

use faer::Mat;

use super::error::{parameter, size};
use super::lstd::solve_or_pseudo_inverse;
use super::{FiniteMdp, Policy, ValueError};

/// The optimum of a process.
#[derive(Debug, Clone, PartialEq)]
pub struct Optimum {
    /// `V*(s)`, `S`.
    pub values: Vec<f64>,
    /// `Q*(s, a)`, `A × S`, one state a column.
    pub q: Mat<f64>,
    /// A deterministic policy that is greedy for `Q*`.
    pub policy: Policy,
    /// Policies evaluated, or sweeps done.
    pub iterations: usize,
}

/// An action must be better by this share of the largest value before policy iteration changes to it: rounding must not
/// make it swing between equal actions.
const BETTER: f64 = 1e-10;

/// `V^π`: the solution of `(I − γP_π)V = R_π`; 0 in terminal states.
///
/// # Errors
/// A policy of another size; γ = 1 and a state from which the policy reaches no end; too many states; values that are not
/// finite.
///
/// # Reference
/// Thesis §3.1.1, the Bellman equation.
pub fn values(process: &FiniteMdp, policy: &Policy) -> Result<Vec<f64>, ValueError> {
    let chain = process.under(policy)?;
    let states = chain.states();
    size("the equations of all states", states, states)?;
    if chain.gamma() == 1.0 {
        check_ends(&chain)?;
    }
    let mut system = Mat::<f64>::identity(states, states);
    let mut right = Mat::<f64>::zeros(states, 1);
    for s in 0..states {
        for to in chain.successors(s, 0) {
            system[(s, to.state)] -= chain.gamma() * to.probability;
            right[(s, 0)] += to.probability * to.reward;
        }
    }
    let values = solve_or_pseudo_inverse(system.as_ref(), right.as_ref())?;
    Ok((0..states).map(|s| values[(s, 0)]).collect())
}

/// `Q(s, a) = Σ_s′ P(s, a, s′) (R(s, a, s′) + γ V(s′))`, `A × S`.
///
/// # Errors
/// Another number of values than of states; values so large that those of the actions are not finite.
///
/// # Reference
/// Thesis §3.1.1 (definition of the Q-value).
pub fn action_values(process: &FiniteMdp, values: &[f64]) -> Result<Mat<f64>, ValueError> {
    if values.len() != process.states() {
        return Err(ValueError::Length { what: "values", found: values.len(), expected: process.states() });
    }
    let q = Mat::from_fn(process.actions(), process.states(), |a, s| {
        let successors = process.successors(s, a).iter();
        successors.map(|to| to.probability * (to.reward + process.gamma() * values[to.state])).sum::<f64>()
    });
    if q.is_all_finite() { Ok(q) } else { Err(ValueError::NotFinite(values.len())) }
}

/// Policy iteration with exact values, from the policy that takes all actions alike.
///
/// With γ < 1 it ends at the optimum after finitely many policies. With γ = 1 it does so where every improvement still
/// ends all episodes, as with a cost for each step. (Where rounding is larger than the difference between policies, as
/// with 1 − γ near 1e-16, it ends at one of those that it cannot tell apart.)
///
/// # Errors
/// γ = 1 and a policy on the way that never ends an episode; values that are not finite.
///
/// # Reference
/// Thesis §3.3; Howard 1960.
pub fn policy_iteration(process: &FiniteMdp) -> Result<Optimum, ValueError> {
    let mut policy = Policy::uniform(process.states(), process.actions())?;
    let mut chosen: Option<Vec<usize>> = None;
    let mut seen = HashSet::new();
    let mut iterations = 0;
    loop {
        let found = values(process, &policy)?;
        let q = action_values(process, &found)?;
        iterations += 1;
        let margin = BETTER * q.norm_max();
        let improved: Vec<usize> = (0..process.states())
            .map(|s| {
                let best = super::greedy((0..process.actions()).map(|a| q[(a, s)]));
                match &chosen {
                    Some(chosen) if q[(chosen[s], s)] >= q[(best, s)] - margin => chosen[s],
                    _ => best,
                }
            })
            .collect();
        policy = Policy::deterministic(&improved, process.actions())?;
        // Besides the policy just evaluated, an earlier one comes back only by rounding.
        if !seen.insert(improved.clone()) {
            return Ok(Optimum { values: found, q, policy, iterations });
        }
        chosen = Some(improved);
    }
}

/// Value iteration, `V ← max_a Q(·, a)`, until no value changes by more than `tolerance`.
///
/// The values are then within `γ/(1 − γ) · tolerance` of the optimum. After `max_sweeps` it stops anyway.
///
/// # Errors
/// A tolerance that is not positive or not finite, no sweeps, values that are not finite.
pub fn value_iteration(process: &FiniteMdp, tolerance: f64, max_sweeps: usize) -> Result<Optimum, ValueError> {
    parameter("tolerance", tolerance, tolerance > 0.0 && tolerance.is_finite(), "> 0 and finite")?;
    if max_sweeps == 0 {
        return Err(ValueError::Iterations);
    }
    let mut values = vec![0.0; process.states()];
    let mut iterations = 0;
    loop {
        let q = action_values(process, &values)?;
        let best: Vec<f64> =
            (0..process.states()).map(|s| (0..process.actions()).map(|a| q[(a, s)]).fold(f64::MIN, f64::max)).collect();
        let change = best.iter().zip(&values).map(|(new, old)| (new - old).abs()).fold(0.0, f64::max);
        values = best;
        iterations += 1;
        if change <= tolerance || iterations == max_sweeps {
            let q = action_values(process, &values)?;
            return Ok(Optimum { policy: Policy::greedy(q.as_ref())?, values, q, iterations });
        }
    }
}

/// Without discount every state must lead to a terminal one.
fn check_ends(chain: &FiniteMdp) -> Result<(), ValueError> {
    let mut ends: Vec<bool> = (0..chain.states()).map(|s| chain.is_terminal(s)).collect();
    let leads =
        |ends: &[bool], s: usize| chain.successors(s, 0).iter().any(|to| to.probability > 0.0 && ends[to.state]);
    loop {
        let more: Vec<usize> = (0..chain.states()).filter(|&s| !ends[s] && leads(&ends, s)).collect();
        if more.is_empty() {
            break;
        }
        more.into_iter().for_each(|s| ends[s] = true);
    }
    match ends.iter().position(|ends| !ends) {
        Some(state) => Err(ValueError::Endless { state }),
        None => Ok(()),
    }
}
