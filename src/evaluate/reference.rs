//! The thesis's reference policy, which knows the true pose.

use nalgebra::Point2;

use crate::robot::{Action, Pose, wrap};

/// Drive forward while the goal is within 45° of the heading, else turn towards it.
///
/// It is not optimal: it drives past goals that it is beside, and for goals near walls it may never arrive.
///
/// # Reference
/// Thesis §5.3.1, algorithm 8.
pub fn reference_action(pose: &Pose, goal: Point2<f64>) -> Action {
    let to = goal - pose.position;
    let off = wrap(pose.heading - to.y.atan2(to.x));
    if off.abs() <= std::f64::consts::FRAC_PI_4 {
        Action::FORWARD
    } else if off < 0.0 {
        Action::TURN_LEFT
    } else {
        Action::TURN_RIGHT
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_turns_towards_the_goal_and_drives() {
        let at = |heading: f64| Pose::new(Point2::new(1.0, 1.0), heading.to_radians());
        let goal = Point2::new(2.0, 1.0);
        assert_eq!(reference_action(&at(40.0), goal), Action::FORWARD);
        assert_eq!(reference_action(&at(-44.0), goal), Action::FORWARD);
        assert_eq!(reference_action(&at(60.0), goal), Action::TURN_RIGHT);
        assert_eq!(reference_action(&at(-60.0), goal), Action::TURN_LEFT);
        assert_eq!(reference_action(&at(170.0), Point2::new(0.0, 1.0)), Action::FORWARD);
    }
}
