//! Exact values and policies of finite processes: the oracle for everything that learns from samples.
//!
//! All solutions are dense in the number of states `S`: `O(S³)` time, `O(S²)` memory.

use faer::Mat;

use super::error::parameter;
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
/// A policy of another size; γ = 1 and a state from which the policy reaches no end.
///
/// # Reference
/// Thesis §3.1.1, the Bellman equation.
pub fn values(process: &FiniteMdp, policy: &Policy) -> Result<Vec<f64>, ValueError> {
    let chain = process.under(policy)?;
    let states = chain.states();
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
/// Another number of values than of states.
///
/// # Reference
/// Thesis §3.1.1 (definition of the Q-value).
pub fn action_values(process: &FiniteMdp, values: &[f64]) -> Result<Mat<f64>, ValueError> {
    if values.len() != process.states() {
        return Err(ValueError::Length { what: "values", found: values.len(), expected: process.states() });
    }
    Ok(Mat::from_fn(process.actions(), process.states(), |a, s| {
        let successors = process.successors(s, a).iter();
        successors.map(|to| to.probability * (to.reward + process.gamma() * values[to.state])).sum()
    }))
}

/// Policy iteration with exact values, from the policy that takes all actions alike.
///
/// With γ < 1 it ends at the optimum after finitely many policies. With γ = 1 it does so where every improvement still
/// ends all episodes, as with a cost for each step.
///
/// # Errors
/// γ = 1 and a policy on the way that never ends an episode.
///
/// # Reference
/// Thesis §3.3; Howard 1960.
pub fn policy_iteration(process: &FiniteMdp) -> Result<Optimum, ValueError> {
    let mut policy = Policy::uniform(process.states(), process.actions())?;
    let mut chosen: Option<Vec<usize>> = None;
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
        if chosen.as_ref() == Some(&improved) {
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
/// A tolerance that is not positive, no sweeps, values that grow beyond all numbers.
pub fn value_iteration(process: &FiniteMdp, tolerance: f64, max_sweeps: usize) -> Result<Optimum, ValueError> {
    parameter("tolerance", tolerance, tolerance > 0.0 && tolerance.is_finite(), "> 0")?;
    if max_sweeps == 0 {
        return Err(ValueError::Iterations);
    }
    let mut values = vec![0.0; process.states()];
    let mut iterations = 0;
    loop {
        let q = action_values(process, &values)?;
        let best: Vec<f64> =
            (0..process.states()).map(|s| (0..process.actions()).map(|a| q[(a, s)]).fold(f64::MIN, f64::max)).collect();
        if !best.iter().all(|value| value.is_finite()) {
            return Err(ValueError::NotFinite(best.len()));
        }
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
