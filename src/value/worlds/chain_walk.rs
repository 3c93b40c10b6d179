//! The chain walk: `S` states in a row and two actions, left and right. An action succeeds with some probability, otherwise
//! its opposite happens; the ends hold. Each step *from* a rewarded state pays 1.
//!
//! # Reference
//! Lagoudakis & Parr 2003, §9.1: success probability 0.9, γ = 0.9; 4 states with reward in the inner two, 20 states
//! with reward at both ends, 50 states with reward in states 10 and 41 (counted from 1).

use crate::value::error::parameter;
use crate::value::{FiniteMdp, Successor, ValueError};

/// One state to the left.
pub const LEFT: usize = 0;
/// One state to the right.
pub const RIGHT: usize = 1;

/// A chain walk; `rewarded` states are counted from 0.
///
/// ```
/// use adagio::value::exact::policy_iteration;
/// use adagio::value::worlds::chain_walk;
///
/// let optimum = policy_iteration(&chain_walk::process(4, 0.9, 0.9, &[1, 2])?)?;
/// assert_eq!(chain_walk::letters(&optimum.policy.chosen()), "RRLL");
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Errors
/// No states, a success probability outside [0, 1], γ outside [0, 1], a rewarded state that does not exist.
pub fn process(states: usize, success: f64, gamma: f64, rewarded: &[usize]) -> Result<FiniteMdp, ValueError> {
    parameter("success", success, (0.0..=1.0).contains(&success), "in [0, 1]")?;
    if let Some(&state) = rewarded.iter().find(|&&state| state >= states) {
        return Err(ValueError::State { state, states });
    }
    let step = |s: usize, a: usize| if a == LEFT { s.saturating_sub(1) } else { (s + 1).min(states - 1) };
    FiniteMdp::new(states, 2, gamma, |s, a| {
        let reward = f64::from(u8::from(rewarded.contains(&s)));
        let to = |action: usize, probability: f64| Successor { state: step(s, action), probability, reward };
        vec![to(a, success), to(1 - a, 1.0 - success)]
    })
}

/// The chain of 20 states with reward at both ends.
///
/// # Errors
/// None.
pub fn twenty() -> Result<FiniteMdp, ValueError> {
    process(20, 0.9, 0.9, &[0, 19])
}

/// The chain of 50 states with reward in the tenth state from either end.
///
/// # Errors
/// None.
pub fn fifty() -> Result<FiniteMdp, ValueError> {
    process(50, 0.9, 0.9, &[9, 40])
}

/// A policy as text: `L` or `R` for each state.
pub fn letters(chosen: &[usize]) -> String {
    chosen.iter().map(|&action| if action == LEFT { 'L' } else { 'R' }).collect()
}
