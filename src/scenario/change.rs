//! `[[change]]`: what happens to the world and the camera while the robot drives.

use std::path::Path;

use super::keys::{Section, within};
use super::sections::Robot;
use super::texture::Texture;

/// Something that changes during the run.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// It happens before this action, counted from 0.
    pub action: usize,
    /// What happens.
    pub what: ChangeKind,
}

/// What happens.
#[derive(Debug, Clone, PartialEq)]
pub enum ChangeKind {
    /// The light becomes brighter or darker.
    Light {
        /// Brightness from then on, as a share of the scenario's own.
        factor: f64,
        /// Actions that it takes to get there, evenly; 0: at once.
        over: usize,
    },
    /// A wall gets another texture.
    Texture {
        /// Number of the wall, from 0.
        wall: usize,
        /// The new one.
        texture: Texture,
    },
    /// The goal of a task is somewhere else.
    Goal {
        /// Number of the task, from 0.
        task: usize,
        /// The new centre of its goal area, metres.
        goal: [f64; 2],
    },
    /// The camera gives the same picture again and again.
    Freeze {
        /// So many frames.
        frames: usize,
    },
    /// The camera gives no picture, but for the last ones of actions.
    Lose {
        /// So many frames, those that are not lost among them.
        frames: usize,
    },
}

impl std::fmt::Display for ChangeKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            ChangeKind::Light { factor, over: 0 } => write!(f, "light × {factor}"),
            ChangeKind::Light { factor, over } => write!(f, "light × {factor}, within {over} actions"),
            ChangeKind::Texture { wall, .. } => write!(f, "wall {wall} gets another texture"),
            ChangeKind::Goal { task, goal: [x, y] } => write!(f, "the goal of task {task} moves to ({x}, {y})"),
            ChangeKind::Freeze { frames } => write!(f, "the camera freezes for {frames} frames"),
            ChangeKind::Lose { frames } => write!(f, "the camera loses frames for {frames} frames"),
        }
    }
}

impl Change {
    /// The first frame of the action before which it happens. Frame 0 is there before the first action.
    pub fn first_frame(&self, robot: &Robot) -> u64 {
        self.action as u64 * robot.frames_per_action as u64 + 1
    }

    pub(super) fn read(s: &mut Section<'_, '_>, base: &Path, index: usize) -> Self {
        const MOST_FRAMES: usize = 1_000_000;
        let action = s.count("action", 0, "", 0..=1_000_000_000, "it happens before this action, counted from 0");
        let kinds = ["light", "wall", "goal", "freeze", "lose"].map(|kind| (kind, kind));
        let what = match s.choice("kind", &kinds, "what happens") {
            "light" => ChangeKind::Light {
                factor: s.number("factor", 1.0, "", within(0.05, 20.0), "brightness from then on, 1: as at first"),
                over: s.count("over", 0, "actions", 0..=1_000_000_000, "how long it takes to get there"),
            },
            "wall" => ChangeKind::Texture {
                wall: s.count("wall", 0, "", 0..=100_000, "number of the wall that gets another texture, from 0"),
                texture: Texture::changed(s, base, index),
            },
            "goal" => ChangeKind::Goal {
                task: s.count("task", 0, "", 0..=100_000, "number of the task whose goal moves, from 0"),
                goal: s.point("goal", [1.5, 0.9], "the new centre of its goal area"),
            },
            "freeze" => ChangeKind::Freeze {
                frames: s.count("frames", 50, "frames", 1..=MOST_FRAMES, "how long the camera gives the same picture"),
            },
            _ => ChangeKind::Lose {
                frames: s.count(
                    "frames",
                    50,
                    "frames",
                    1..=MOST_FRAMES,
                    "how long the camera gives no pictures but the last one of each action",
                ),
            },
        };
        Change { action, what }
    }
}
