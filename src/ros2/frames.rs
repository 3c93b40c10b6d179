//! Where the robot is, by transforms between frames.

use std::collections::BTreeMap;

use crate::log::messages::foreign::TransformStamped;
use crate::robot::Pose;
use crate::source::imported::ROBOT_FRAMES;
use crate::source::planar;

/// Frames that may stand between the robot's and the outermost.
const MOST_BETWEEN: usize = 16;

/// The newest transform of each frame.
#[derive(Debug, Default)]
pub struct Frames(BTreeMap<String, (String, Pose)>);

impl Frames {
    /// A transform; where it is the robot's, its stamp and where the robot is in the outermost frame that is known, in the plane.
    pub fn hear(&mut self, transform: &TransformStamped) -> Option<(u64, Pose)> {
        let name = |text: &str| text.trim_start_matches('/').to_owned();
        let (child, parent) = (name(&transform.child_frame_id), name(&transform.header.frame_id));
        let pose = planar(&transform.transform.pose());
        self.0.insert(child.clone(), (parent.clone(), pose));
        if !ROBOT_FRAMES.contains(&child.as_str()) {
            return None;
        }
        let (mut at, mut frame) = (pose, parent);
        for _ in 0..MOST_BETWEEN {
            let Some((outer, of)) = self.0.get(&frame) else { break };
            (at, frame) = (of.then(&at), outer.clone());
        }
        Some((transform.header.stamp_ns(), at))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::messages::{Header, Quaternion, Vector3, foreign::Transform};

    #[test]
    fn a_robot_is_where_the_map_and_its_odometry_say() {
        let transform = |parent: &str, child: &str, [x, y, heading]: [f64; 3]| TransformStamped {
            header: Header::new(7, parent),
            child_frame_id: child.to_owned(),
            transform: Transform {
                translation: Vector3 { x, y, z: 0.2 },
                rotation: Quaternion { x: 0.0, y: 0.0, z: (heading / 2.0).sin(), w: (heading / 2.0).cos() },
            },
        };
        let quarter = std::f64::consts::FRAC_PI_2;
        let mut frames = Frames::default();
        let (stamp_ns, alone) = frames.hear(&transform("odom", "base_link", [1.0, 0.5, 0.0])).unwrap();
        assert_eq!((stamp_ns, alone.position), (7, [1.0, 0.5].into()));
        assert_eq!(frames.hear(&transform("/map", "odom", [2.0, 1.0, quarter])), None);
        let (_, pose) = frames.hear(&transform("odom", "base_link", [1.0, 0.5, 0.0])).unwrap();
        assert!((pose.position - nalgebra::Point2::from([1.5, 2.0])).norm() < 1e-12, "{pose:?}");
        assert!((pose.heading - quarter).abs() < 1e-12);
        // Frames in a circle end somewhere.
        frames.hear(&transform("base_link", "map", [0.0; 3]));
        assert!(frames.hear(&transform("odom", "base_link", [1.0, 0.5, 0.0])).is_some());
    }
}
