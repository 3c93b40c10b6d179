//! The world of the thesis's figures 3.1 and 3.2: 16 × 16 places, deterministic, γ = 0.9, a goal `G` whose entry is
//! rewarded, and a policy whose arrows all lead there.
//!
//! The figures show the idea; their arrows are not printed as numbers. Here the goal is in column 11, line 4 (from 0), and
//! the policy goes along its line's direction last: first left or right to the goal's column, then up or down. That is
//! a shortest way from everywhere, so its values are known: `V(s) = γ^(d − 1)` at distance `d > 0`, and 0 in the
//! goal, where the episode ends. A move out of the square stays.

use super::rooms::{DOWN, LEFT, RIGHT, Rooms, UP};
use crate::value::{FiniteMdp, Policy, ValueError};

/// Places on each side.
pub const SIDE: usize = 16;
/// (column, line) of the goal.
pub const GOAL: (usize, usize) = (11, 4);
/// Discount of the figures.
pub const GAMMA: f64 = 0.9;

/// The square; states are numbered line by line.
///
/// # Errors
/// None.
pub fn rooms() -> Result<Rooms, ValueError> {
    let place = |x: usize, y: usize| if (x, y) == GOAL { 'G' } else { '.' };
    let line = |y: usize| (0..SIDE).map(move |x| place(x, y)).chain(['\n']);
    Rooms::parse(&(0..SIDE).flat_map(line).collect::<String>())
}

/// The decision process of figure 3.2.
///
/// # Errors
/// None.
pub fn process() -> Result<FiniteMdp, ValueError> {
    rooms()?.process(GAMMA, 0.0)
}

/// The arrows.
///
/// # Errors
/// None.
pub fn policy() -> Result<Policy, ValueError> {
    let arrow = |&(x, y): &(usize, usize)| match (x.cmp(&GOAL.0), y < GOAL.1) {
        (std::cmp::Ordering::Less, _) => RIGHT,
        (std::cmp::Ordering::Greater, _) => LEFT,
        (_, true) => DOWN,
        (_, false) => UP,
    };
    Policy::deterministic(&rooms()?.places().iter().map(arrow).collect::<Vec<_>>(), 4)
}

/// The reward process of figure 3.1: the arrows, followed.
///
/// # Errors
/// None.
pub fn reward_process() -> Result<FiniteMdp, ValueError> {
    process()?.under(&policy()?)
}

/// Steps from a place to the goal.
pub fn distance((x, y): (usize, usize)) -> usize {
    x.abs_diff(GOAL.0) + y.abs_diff(GOAL.1)
}
