//! What would be seen behind a turn that was never made.

use super::states::{PlaceMap, beside, cell};
use super::{Pose, turned};

/// What is seen at a pose is what was seen this near to it: moves and radians; a radian is as far as so many moves.
const NEAR: (f64, f64) = (0.7, 0.35);
const TURN: f64 = 2.0;

impl PlaceMap {
    /// Where a turn by an angle, radians, would lead from a state, and the state that looks as it does there. `None` where nobody knows: there
    /// is no such state, it has no place, or the robot never looked that way from there.
    pub fn behind_turn(&self, state: usize, angle: f64) -> Option<(Pose, usize)> {
        let from = self.poses.get(state).copied().flatten()?;
        let to = Pose { heading: from.heading + angle, ..from };
        let ([x, y], heading) = cell(to);
        let squares = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x.saturating_add(dx), y.saturating_add(dy)]));
        let over = |heading: usize| squares.clone().filter_map(move |square| Some(&self.cells.over(square)?[heading]));
        let states = beside(heading).into_iter().flat_map(over).flatten();
        let apart = |&state: &u32| {
            let pose = self.poses[state as usize]?;
            let (moves, turn) = ((pose.x - to.x).hypot(pose.y - to.y), turned(pose.heading, to.heading));
            (moves < NEAR.0 && turn < NEAR.1).then_some((moves.hypot(TURN * turn), state as usize))
        };
        let nearest = states.filter_map(apart).min_by(|a, b| a.0.total_cmp(&b.0))?;
        Some((to, nearest.1))
    }
}
