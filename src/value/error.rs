//! What can be wrong with a request to this folder, each with its numbers.

use thiserror::Error;

/// The largest matrix that is made from a number alone (8 GiB): larger ones are a mistake in that number.
pub(super) const MOST_NUMBERS: usize = 1 << 30;

/// Why values could not be estimated.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum ValueError {
    /// A list, or the columns of a matrix, of another length than needed.
    #[error("{what} has {found} entries, but it must have {expected}")]
    Length {
        /// Which list or matrix.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that fits.
        expected: usize,
    },
    /// A matrix that would be too large.
    #[error("{what} of {rows} × {columns} numbers is not allowed: it must have at most {MOST_NUMBERS} in all")]
    Size {
        /// What would be too large.
        what: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
    },
    /// Feature vectors of different lengths, or with no entries.
    #[error("{what} has {found} features, but it must have {expected}, and at least one")]
    Features {
        /// Which vector or matrix.
        what: &'static str,
        /// Its number of rows.
        found: usize,
        /// The number of rows that it must have.
        expected: usize,
    },
    /// A system of equations whose parts do not fit.
    #[error(
        "a system of {rows} × {columns} coefficients with {right} right-hand sides cannot be solved: it must be square"
    )]
    System {
        /// Rows of the coefficients.
        rows: usize,
        /// Columns of the coefficients.
        columns: usize,
        /// Rows of the right-hand side.
        right: usize,
    },
    /// Nothing to learn from.
    #[error("there are no transitions to learn from")]
    Empty,
    /// A number of the input is NaN or infinite.
    #[error("{what} holds {value} at place {place}: all values must be finite")]
    Input {
        /// Which list or matrix.
        what: &'static str,
        /// Column of a matrix, or entry of a list.
        place: usize,
        /// What stands there.
        value: f64,
    },
    /// A sample cannot count negatively.
    #[error("weight {value} of transition {index} is not allowed: it must be ≥ 0 and finite")]
    Weight {
        /// Which transition.
        index: usize,
        /// Its weight.
        value: f64,
    },
    /// No action to choose from.
    #[error("there are no actions: at least one is needed")]
    NoActions,
    /// More actions than the bits of `allowed`.
    #[error("{0} actions do not fit into the 32 bits of a list of allowed actions")]
    AllowedBits(usize),
    /// An action number out of range.
    #[error("transition {index} has action {action}, but there are {actions} actions, numbered from 0")]
    Action {
        /// Which transition.
        index: usize,
        /// Its action.
        action: usize,
        /// Number of actions.
        actions: usize,
    },
    /// A state number out of range.
    #[error("state {state} does not exist: there are {states} states, numbered from 0")]
    State {
        /// The number asked for.
        state: usize,
        /// Number of states.
        states: usize,
    },
    /// A sample after which no action may follow.
    #[error("no action may follow sample {index}: at least one of {actions} must be allowed")]
    NothingAllowed {
        /// Which sample.
        index: usize,
        /// Number of actions.
        actions: usize,
    },
    /// Probabilities of what follows a state and an action.
    #[error("the probabilities after state {state}, action {action} are not allowed: {fault}")]
    Probability {
        /// The state.
        state: usize,
        /// The action.
        action: usize,
        /// What is wrong, with the number.
        fault: String,
    },
    /// A reward that is not a number.
    #[error("the reward {value} after state {state}, action {action} is not allowed: it must be finite")]
    Reward {
        /// The state.
        state: usize,
        /// The action.
        action: usize,
        /// The reward.
        value: f64,
    },
    /// Probabilities of a policy.
    #[error("the policy is not a distribution over actions in state {state}: {fault}")]
    Policy {
        /// The state, or the number of the sample.
        state: usize,
        /// What is wrong, with the number.
        fault: String,
    },
    /// A policy for something else.
    #[error("the policy is for {found_states} states and {found_actions} actions, not for {states} and {actions}")]
    PolicySize {
        /// States of the policy.
        found_states: usize,
        /// Actions of the policy.
        found_actions: usize,
        /// States that there are.
        states: usize,
        /// Actions that there are.
        actions: usize,
    },
    /// Without discount, values are finite only where every episode ends.
    #[error("without discount, state {state} has no finite value: the policy never ends an episode from there")]
    Endless {
        /// A state from which no end can be reached.
        state: usize,
    },
    /// The discount factor must leave the sum of rewards finite.
    #[error("gamma = {0} is not allowed: it must be in [0, 1), or 1 where all episodes end")]
    Gamma(f64),
    /// The ridge must not be negative.
    #[error("ridge = {0} is not allowed: it must be ≥ 0 and finite")]
    Ridge(f64),
    /// The mixing rate of policies.
    #[error("mixing = {0} is not allowed: it must be in (0, 1]")]
    Mixing(f64),
    /// At least one evaluation is needed.
    #[error("max_iterations = 0 is not allowed: it must be at least 1")]
    Iterations,
    /// Any other number outside of its range.
    #[error("{name} = {value} is not allowed: it must be {range}")]
    Parameter {
        /// Name of the parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Its range, in words.
        range: &'static str,
    },
    /// The text of a map.
    #[error("line {line} of the map is not allowed: {fault}")]
    Map {
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong with it.
        fault: String,
    },
    /// The result is not finite.
    #[error("the values of {0} weights are not finite: features or rewards are too large, or not numbers")]
    NotFinite(usize),
}

/// `rows × columns` numbers must be few enough to be stored.
pub(super) fn size(what: &'static str, rows: usize, columns: usize) -> Result<(), ValueError> {
    match rows.checked_mul(columns) {
        Some(numbers) if numbers <= MOST_NUMBERS => Ok(()),
        _ => Err(ValueError::Size { what, rows, columns }),
    }
}

/// There must be features and actions, and few enough for their weights to be stored.
pub(super) fn weights(features: usize, actions: usize) -> Result<(), ValueError> {
    if features == 0 {
        return Err(ValueError::Features { what: "phi", found: 0, expected: 1 });
    }
    if actions == 0 {
        return Err(ValueError::NoActions);
    }
    size("the weights", features, actions)
}

/// `name` must lie in `range`, which `inside` tells.
pub(super) fn parameter(name: &'static str, value: f64, inside: bool, range: &'static str) -> Result<(), ValueError> {
    if inside { Ok(()) } else { Err(ValueError::Parameter { name, value, range }) }
}

/// Every entry of a list must be finite.
pub(super) fn finite_list(what: &'static str, values: &[f64]) -> Result<(), ValueError> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(place) => Err(ValueError::Input { what, place, value: values[place] }),
        None => Ok(()),
    }
}

/// Every entry of a matrix must be finite.
pub(super) fn finite_matrix(what: &'static str, values: faer::MatRef<'_, f64>) -> Result<(), ValueError> {
    for place in 0..values.ncols() {
        for i in 0..values.nrows() {
            let value = values[(i, place)];
            if !value.is_finite() {
                return Err(ValueError::Input { what, place, value });
            }
        }
    }
    Ok(())
}

/// Weights of samples must be finite and not negative.
pub(super) fn sample_weights(weights: &[f64]) -> Result<(), ValueError> {
    match weights.iter().position(|weight| !(*weight >= 0.0 && weight.is_finite())) {
        Some(index) => Err(ValueError::Weight { index, value: weights[index] }),
        None => Ok(()),
    }
}

/// γ in [0, 1): for algorithms without an end of episodes.
pub(super) fn discount(gamma: f64) -> Result<(), ValueError> {
    if (0.0..1.0).contains(&gamma) { Ok(()) } else { Err(ValueError::Gamma(gamma)) }
}

/// γ in [0, 1].
pub(super) fn discount_or_one(gamma: f64) -> Result<(), ValueError> {
    if (0.0..=1.0).contains(&gamma) { Ok(()) } else { Err(ValueError::Gamma(gamma)) }
}

/// Ridge ≥ 0.
pub(super) fn ridge(ridge: f64) -> Result<(), ValueError> {
    if ridge >= 0.0 && ridge.is_finite() { Ok(()) } else { Err(ValueError::Ridge(ridge)) }
}
