//! Finite Markov decision processes: states and actions by number, with known probabilities.

use faer::MatRef;
use rand::{Rng, RngExt};

use super::error::{discount_or_one, size};
use super::policy::{SUM_TOLERANCE, draw};
use super::{Batch, Policy, ValueError};

/// One of the states that may follow a state and an action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Successor {
    /// Its number.
    pub state: usize,
    /// `P(s, a, s′)`.
    pub probability: f64,
    /// `R(s, a, s′)`.
    pub reward: f64,
}

/// A step that was drawn from a process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// State before.
    pub from: usize,
    /// Action taken.
    pub action: usize,
    /// Reward received.
    pub reward: f64,
    /// State after.
    pub to: usize,
}

/// A finite Markov decision process `(S, A, P, R, γ)` with sparse transitions.
///
/// In state `s` action `a` leads to `s′` with probability `P(s, a, s′)` and pays `R(s, a, s′)`. A Markov *reward* process
/// is one with a single action (thesis §3.1.1). A state with no successors is *terminal*: the episode ends on entering
/// it, its value is 0.
///
/// Such processes serve as worlds with known answers: [`exact`](super::exact) solves them, and [`FiniteMdp::expected`]
/// hands all their transitions, weighted by probability, to the algorithms that learn from samples.
///
/// ```
/// use adagio::value::{FiniteMdp, Policy, Successor, exact};
///
/// // Wait (action 0) or leave (action 1), which pays 1 and ends the episode.
/// let certain = |state, reward| vec![Successor { state, probability: 1.0, reward }];
/// let process = FiniteMdp::new(2, 2, 0.9, |s, a| match (s, a) {
///     (0, 0) => certain(0, 0.0),
///     (0, _) => certain(1, 1.0),
///     _ => vec![],
/// })?;
/// let half = exact::values(&process, &Policy::uniform(2, 2)?)?;
/// // V = ½·0.9·V + ½
/// assert!((half[0] - 0.5 / (1.0 - 0.45)).abs() < 1e-12);
/// assert_eq!(exact::policy_iteration(&process)?.policy.chosen()[0], 1);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
///
/// # Reference
/// Thesis §3.1.1.
#[derive(Debug, Clone, PartialEq)]
pub struct FiniteMdp {
    states: usize,
    actions: usize,
    gamma: f64,
    /// Successors of `(s, a)` at `s·A + a`.
    successors: Vec<Vec<Successor>>,
}

impl FiniteMdp {
    /// A process from a function that lists what may follow a state and an action; nothing follows a terminal state.
    ///
    /// # Errors
    /// No states or actions, or too many; γ outside [0, 1]; a successor out of range; probabilities that are negative, not finite or
    /// do not sum to 1; a reward that is not finite; a state in which some actions lead somewhere and others do not.
    pub fn new(
        states: usize,
        actions: usize,
        gamma: f64,
        successors: impl Fn(usize, usize) -> Vec<Successor>,
    ) -> Result<Self, ValueError> {
        if states == 0 {
            return Err(ValueError::Empty);
        }
        if actions == 0 {
            return Err(ValueError::NoActions);
        }
        discount_or_one(gamma)?;
        size("a process", states, actions)?;
        let mut lists = Vec::new();
        for state in 0..states {
            for action in 0..actions {
                let list = successors(state, action);
                check(state, action, &list, states)?;
                let first: &Vec<Successor> = if action == 0 { &list } else { &lists[state * actions] };
                if first.is_empty() != list.is_empty() {
                    let fault = "nothing follows, but after another action something does".to_owned();
                    return Err(ValueError::Probability { state, action, fault });
                }
                lists.push(list);
            }
        }
        Ok(FiniteMdp { states, actions, gamma, successors: lists })
    }

    /// A process whose rewards depend on the state entered alone, `R(s′)`, as in most of the thesis.
    /// `successors` lists (state, probability).
    ///
    /// # Errors
    /// As [`FiniteMdp::new`]; another number of rewards than of states.
    pub fn with_target_rewards(
        states: usize,
        actions: usize,
        gamma: f64,
        rewards: &[f64],
        successors: impl Fn(usize, usize) -> Vec<(usize, f64)>,
    ) -> Result<Self, ValueError> {
        if rewards.len() != states {
            return Err(ValueError::Length { what: "rewards of states", found: rewards.len(), expected: states });
        }
        let paid = |(state, probability): (usize, f64)| {
            // A state out of range is refused by `new`.
            Successor { state, probability, reward: rewards.get(state).copied().unwrap_or(0.0) }
        };
        FiniteMdp::new(states, actions, gamma, |s, a| successors(s, a).into_iter().map(paid).collect())
    }

    /// Number of states, terminal ones included.
    pub fn states(&self) -> usize {
        self.states
    }

    /// Number of actions.
    pub fn actions(&self) -> usize {
        self.actions
    }

    /// Discount γ.
    pub fn gamma(&self) -> f64 {
        self.gamma
    }

    /// What may follow a state and an action; nothing for numbers out of range.
    pub fn successors(&self, state: usize, action: usize) -> &[Successor] {
        let known = state < self.states && action < self.actions;
        if known { &self.successors[state * self.actions + action] } else { &[] }
    }

    /// Whether an episode ends on entering `state`; true for numbers out of range, since nothing follows them.
    pub fn is_terminal(&self, state: usize) -> bool {
        self.successors(state, 0).is_empty()
    }

    /// The reward process of a policy: one action, `P(s, s′) = Σ_a π(a | s) P(s, a, s′)`.
    ///
    /// Its values are the policy's (thesis §3.1.1, the lemma on equal values). A state may be listed once for each action
    /// that leads there, since the rewards may differ.
    ///
    /// # Errors
    /// A policy of another size.
    pub fn under(&self, policy: &Policy) -> Result<FiniteMdp, ValueError> {
        policy.check_size(self.states, self.actions)?;
        let p = policy.probabilities();
        let of_state = |s: usize| {
            let of_action = |a: usize| {
                let share = move |to: &Successor| Successor { probability: p[(a, s)] * to.probability, ..*to };
                self.successors(s, a).iter().map(share)
            };
            (0..self.actions).filter(|&a| p[(a, s)] > 0.0).flat_map(of_action).collect()
        };
        // Process and policy are checked already; their products are probabilities again.
        let successors = (0..self.states).map(of_state).collect();
        Ok(FiniteMdp { states: self.states, actions: 1, gamma: self.gamma, successors })
    }

    /// The probability to arrive from each state within so many steps: to get a reward above 0, or into a terminal state. What policy
    /// iteration calls converged may never arrive.
    ///
    /// # Errors
    /// A policy of another size.
    pub fn arrival(&self, policy: &Policy, steps: usize) -> Result<Vec<f64>, ValueError> {
        let driven = self.under(policy)?;
        let mut arrival: Vec<f64> = (0..self.states).map(|s| f64::from(u8::from(self.is_terminal(s)))).collect();
        for _ in 0..steps {
            let of = |to: &Successor| to.probability * if to.reward > 0.0 { 1.0 } else { arrival[to.state] };
            let after = |s: usize| driven.successors(s, 0).iter().map(of).sum();
            let next: Vec<f64> = (0..self.states).map(|s| if self.is_terminal(s) { 1.0 } else { after(s) }).collect();
            if next == arrival {
                break;
            }
            arrival = next;
        }
        Ok(arrival)
    }

    /// Draw what follows a state and an action; `None` in a terminal state.
    ///
    /// # Errors
    /// A state or an action out of range.
    pub fn step(&self, state: usize, action: usize, rng: &mut impl Rng) -> Result<Option<Step>, ValueError> {
        self.check_state(state)?;
        if action >= self.actions {
            return Err(ValueError::Action { index: 0, action, actions: self.actions });
        }
        let list = self.successors(state, action);
        if list.is_empty() {
            return Ok(None);
        }
        let to = list[draw(list.iter().map(|to| to.probability), rng.random())];
        Ok(Some(Step { from: state, action, reward: to.reward, to: to.state }))
    }

    /// Follow a policy from `start` until the episode ends, at most `longest` steps.
    ///
    /// # Errors
    /// A start out of range, a policy of another size.
    pub fn episode(
        &self,
        start: usize,
        policy: &Policy,
        longest: usize,
        rng: &mut impl Rng,
    ) -> Result<Vec<Step>, ValueError> {
        policy.check_size(self.states, self.actions)?;
        self.check_state(start)?;
        let mut steps = Vec::new();
        let mut state = start;
        while steps.len() < longest {
            let action = policy.pick(state, rng.random());
            let Some(step) = self.step(state, action, rng)? else { break };
            steps.push(step);
            state = step.to;
        }
        Ok(steps)
    }

    /// `count` single steps from states and actions that are drawn uniformly: the sampling that policy iteration likes
    /// best (thesis §3.3.1). Terminal states are never drawn; there are fewer steps only if all states are terminal.
    pub fn uniform_steps(&self, count: usize, rng: &mut impl Rng) -> Vec<Step> {
        let alive: Vec<usize> = (0..self.states).filter(|&state| !self.is_terminal(state)).collect();
        if alive.is_empty() {
            return Vec::new();
        }
        let mut steps = Vec::new();
        for _ in 0..count {
            let state = alive[rng.random_range(0..alive.len())];
            let action = rng.random_range(0..self.actions);
            // State and action are in range, and the state is not terminal.
            steps.extend(self.step(state, action, rng).ok().flatten());
        }
        steps
    }

    /// All transitions, each with `P(s, a, s′) · weight(s, a)` as its weight: what infinitely many samples would give.
    ///
    /// # Shapes
    /// `basis`: `f × S`, the features of each state a column (the identity for tabular ones).
    ///
    /// # Errors
    /// A basis for another number of states, one that is not finite, weights that are negative or not finite.
    pub fn expected(&self, basis: MatRef<'_, f64>, weight: impl Fn(usize, usize) -> f64) -> Result<Batch, ValueError> {
        let mut batch = self.batch(basis)?;
        for state in 0..self.states {
            for action in 0..self.actions {
                for to in self.successors(state, action) {
                    let step = Step { from: state, action, reward: to.reward, to: to.state };
                    self.add(&mut batch, basis, step, to.probability * weight(state, action))?;
                }
            }
        }
        Ok(batch)
    }

    /// Drawn steps in features, all with weight 1.
    ///
    /// # Shapes
    /// `basis`: `f × S`.
    ///
    /// # Errors
    /// A basis for another number of states or one that is not finite, steps of another process.
    pub fn in_features(&self, steps: &[Step], basis: MatRef<'_, f64>) -> Result<Batch, ValueError> {
        let mut batch = self.batch(basis)?;
        for &step in steps {
            self.add(&mut batch, basis, step, 1.0)?;
        }
        Ok(batch)
    }

    fn batch(&self, basis: MatRef<'_, f64>) -> Result<Batch, ValueError> {
        if basis.ncols() != self.states {
            return Err(ValueError::Length { what: "the basis", found: basis.ncols(), expected: self.states });
        }
        Batch::new(basis.nrows(), self.actions)
    }

    fn add(&self, batch: &mut Batch, basis: MatRef<'_, f64>, step: Step, weight: f64) -> Result<(), ValueError> {
        self.check_state(step.from)?;
        self.check_state(step.to)?;
        let column = |s: usize| -> Vec<f64> { (0..basis.nrows()).map(|i| basis[(i, s)]).collect() };
        let next = if self.is_terminal(step.to) { None } else { Some(column(step.to)) };
        batch.push(&column(step.from), step.action, step.reward, next.as_deref(), weight)
    }

    fn check_state(&self, state: usize) -> Result<(), ValueError> {
        if state < self.states { Ok(()) } else { Err(ValueError::State { state, states: self.states }) }
    }
}

fn check(state: usize, action: usize, list: &[Successor], states: usize) -> Result<(), ValueError> {
    let mut sum = 0.0;
    for to in list {
        if to.state >= states {
            return Err(ValueError::State { state: to.state, states });
        }
        if !(to.probability >= 0.0 && to.probability.is_finite()) {
            let fault = format!("{} is not a probability", to.probability);
            return Err(ValueError::Probability { state, action, fault });
        }
        if !to.reward.is_finite() {
            return Err(ValueError::Reward { state, action, value: to.reward });
        }
        sum += to.probability;
    }
    if !list.is_empty() && (sum - 1.0f64).abs() > SUM_TOLERANCE {
        let fault = format!("they sum to {sum}, not to 1");
        return Err(ValueError::Probability { state, action, fault });
    }
    Ok(())
}
