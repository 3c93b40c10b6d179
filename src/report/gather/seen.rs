//! What is kept of a log's messages.

use crate::robot::Pose;

/// Something recorded at a pose.
#[derive(Debug, Clone)]
pub struct Sample {
    /// The frame.
    pub frame: u64,
    /// Where it was taken.
    pub pose: Pose,
    /// The observation, RGB.
    pub pixels: Vec<u8>,
}

/// A model.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelSeen {
    /// Frames that it was learned from.
    pub frames: u64,
    /// Mean slowness of its features.
    pub mean: f64,
    /// Slowness of the slowest one.
    pub slowest: f64,
}

/// A trial beside the run.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// The newest frame that the policy had learned from.
    pub frame: u64,
    /// Share of trials that arrived.
    pub success: f64,
    /// Lower end of its interval.
    pub low: f64,
    /// Convergence quality.
    pub quality: f64,
}

/// A pursuit that is over, and what was expected of it when it began.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pursued {
    /// Actions that were expected.
    pub expected: f64,
    /// Probability of arriving in time that was stated.
    pub arrival: f64,
    /// Actions that it took.
    pub actions: u32,
    /// Whether it arrived.
    pub arrived: bool,
}

/// How the program was doing; the worst of several where they were merged.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HealthSeen {
    /// Seconds since the first message of the log.
    pub seconds: f64,
    /// Frames so far.
    pub frames: u64,
    /// Frames per second.
    pub rate: f64,
    /// Time from frame to an action that values decide on, 99th percentile, ms.
    pub act_ms: f64,
    /// Time of learning from a frame, 99th percentile, ms.
    pub frame_ms: f64,
    /// Entries that wait in each queue.
    pub depths: Vec<u32>,
    /// Memory, bytes.
    pub rss: u64,
}

impl HealthSeen {
    /// Put another state into this one: the worst of both.
    pub(super) fn merge(&mut self, other: Self) {
        self.rate = self.rate.min(other.rate);
        self.act_ms = self.act_ms.max(other.act_ms);
        self.frame_ms = self.frame_ms.max(other.frame_ms);
        self.rss = self.rss.max(other.rss);
        self.frames = other.frames;
        for (i, depth) in other.depths.into_iter().enumerate() {
            match self.depths.get_mut(i) {
                Some(own) => *own = depth.max(*own),
                None => self.depths.push(depth),
            }
        }
    }
}

/// Sums of squared motion between frames that follow each other.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Motion {
    /// Steps from frame to frame.
    pub steps: f64,
    /// Σ of squared distances, m².
    pub distance: f64,
    /// Σ of squared angles, rad².
    pub angle: f64,
}

/// A topic's messages.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct TopicSeen {
    /// Their type.
    pub kind: String,
    /// Their number.
    pub messages: u64,
}
