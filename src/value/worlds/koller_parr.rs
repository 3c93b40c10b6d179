//! The chain of Koller & Parr: four states, reward in the inner two, features 1, s, s².
//!
//! The value of a policy, weighted by how often that policy itself visits each state, leads to its opposite here: the
//! greedy policies swing RRRR → LLLL → RRRR for ever, although the features can express the optimal one, RRLL. With weights
//! that are uniform over states and actions LSPI finds it at once.
//!
//! # Reference
//! Koller & Parr 2000; Lagoudakis & Parr 2003, §9.1.

use faer::Mat;

use super::chain_walk;
use crate::value::{Batch, FiniteMdp, Policy, ValueError, exact};

/// The chain: success probability 0.9, γ = 0.9.
///
/// # Errors
/// None.
pub fn process() -> Result<FiniteMdp, ValueError> {
    chain_walk::process(4, 0.9, 0.9, &[1, 2])
}

/// 1, s, s² (in thirds of the row), `3 × 4`: [`bases::powers`](super::bases::powers) of degree 2.
pub fn basis() -> Mat<f64> {
    Mat::from_fn(3, 4, |i, s| (s as f64 / 3.0).powi(i as i32))
}

/// Steps after which the distribution over the states has settled.
const SETTLED: usize = 2000;

/// How often a policy visits each state in the long run, after a uniform start.
///
/// # Errors
/// A policy of another size.
pub fn visits(process: &FiniteMdp, policy: &Policy) -> Result<Vec<f64>, ValueError> {
    let chain = process.under(policy)?;
    let mut visits = vec![1.0 / chain.states() as f64; chain.states()];
    for _ in 0..SETTLED {
        let mut next = vec![0.0; chain.states()];
        for (s, visits) in visits.iter().enumerate() {
            for to in chain.successors(s, 0) {
                next[to.state] += to.probability * visits;
            }
        }
        visits = next;
    }
    Ok(visits)
}

/// The swinging iteration: LSTD from the policy's own visits, then the greedy policy of the true model.
///
/// The result lists the policies, the first one included.
///
/// # Errors
/// A policy that is not for four states and two actions.
pub fn on_policy_iteration(start: &Policy, iterations: usize) -> Result<Vec<Policy>, ValueError> {
    let (process, basis) = (process()?, basis());
    let mut policies = vec![start.clone()];
    let mut policy = start.clone();
    for _ in 0..iterations {
        let visits = visits(&process, &policy)?;
        let batch: Batch = process.under(&policy)?.expected(basis.as_ref(), |s, _| visits[s])?;
        let w = batch.lstd(process.gamma(), 0.0)?;
        let values: Vec<f64> =
            (0..process.states()).map(|s| (0..basis.nrows()).map(|i| w[i] * basis[(i, s)]).sum()).collect();
        policy = Policy::greedy(exact::action_values(&process, &values)?.as_ref())?;
        policies.push(policy.clone());
    }
    Ok(policies)
}
