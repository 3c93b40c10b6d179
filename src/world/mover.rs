//! A robot in a trial: the disc that is where its actions lead, or the one with a mass.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;

use super::{DynamicBase, Eye, Robot, World};
use crate::robot::{Action, Pose};
use crate::scenario::Scenario;
use crate::source::Source;
use crate::source::live::Live;

/// A robot that does actions where nobody looks through its camera.
pub enum Mover {
    /// The disc.
    Disc(Box<Robot>),
    /// The robot with a mass, and its loop of control.
    Body(Box<Live<DynamicBase>>),
}

impl Mover {
    /// The robot of a scenario at a pose; `noise` gives the random numbers of a name.
    pub fn new(scenario: &Arc<Scenario>, world: &Arc<World>, pose: Pose, noise: impl Fn(&str) -> ChaCha8Rng) -> Self {
        let (Some(motion), Some(body)) = (&scenario.motion, &scenario.body) else {
            return Mover::Disc(Box::new(Robot::new(&scenario.robot, pose, noise("motion"))));
        };
        let noise = (noise("motion"), noise("sonar"));
        let base = DynamicBase::blind(scenario.clone(), world.clone(), body.clone(), pose, noise);
        let mut live = Live::new(scenario.clone(), motion.clone(), base.equipment(), base, None);
        live.first();
        Mover::Body(Box::new(live))
    }

    /// Where it is.
    pub fn pose(&self) -> Pose {
        match self {
            Mover::Disc(robot) => robot.pose,
            Mover::Body(live) => live.base().body().pose(),
        }
    }

    /// Where its odometry believes it to be.
    pub fn odometry(&self) -> Pose {
        match self {
            Mover::Disc(robot) => robot.odometry,
            Mover::Body(live) => live.base().body().odometry().pose,
        }
    }

    /// What it would see, with distractors so many frames `later`.
    pub fn eye(&self, later: u64) -> Eye {
        match self {
            Mover::Disc(robot) => Eye::from((robot.pose, later)),
            Mover::Body(live) => Eye { things: live.base().things(), ..Eye::from((self.pose(), later)) },
        }
    }

    /// Do an action; whether something stopped it.
    pub fn act(&mut self, action: Action, scenario: &Scenario, world: &World) -> bool {
        let mut blocked = false;
        match self {
            Mover::Disc(robot) => {
                let motion = robot.draw(action);
                for _ in 0..scenario.robot.frames_per_action {
                    blocked |= robot.drive(motion, &world.arena);
                }
            }
            Mover::Body(live) => {
                live.execute(action, &mut |frame| {
                    blocked |= frame.boundary.is_some_and(|boundary| boundary.blocked);
                    true
                });
            }
        }
        blocked
    }
}
