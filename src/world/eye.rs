//! Views to be rendered, and the threads that share such work.

use super::distractors::Present;
use crate::robot::Pose;

/// What is seen from where.
pub struct Viewpoint<'a> {
    /// Of the robot.
    pub pose: &'a Pose,
    /// Distractors as they are then: as many for each view.
    pub distractors: &'a [Present],
}

/// A camera somewhere, at a moment of its own.
#[derive(Debug, Clone)]
pub struct Eye {
    /// Of the robot.
    pub pose: Pose,
    /// Frames by which distractors are ahead: a trial takes its time while nothing else changes.
    pub later: u64,
    /// What was pushed around, where it is now.
    pub things: Vec<Present>,
}

impl From<(Pose, u64)> for Eye {
    fn from((pose, later): (Pose, u64)) -> Self {
        Eye { pose, later, things: Vec::new() }
    }
}

/// Do something with each item, on as many threads as there are cores, each of them with a part of its own.
///
/// Not by rayon: whoever waits there takes up other work, which may wait for the same device.
pub(super) fn on_all_threads<T: Send>(items: &mut [T], work: impl Fn(usize, &mut T) + Sync) {
    let all = |first: usize, part: &mut [T]| part.iter_mut().enumerate().for_each(|(i, item)| work(first + i, item));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let size = items.len().div_ceil(threads).max(FEWEST_FOR_A_THREAD);
    if items.len() <= size {
        return all(0, items);
    }
    std::thread::scope(|scope| {
        let parts = items.chunks_mut(size).enumerate();
        parts.for_each(|(number, part)| drop(scope.spawn(move || all(number * size, part))));
    });
}

/// A thread takes as long to start as this many small views take to be copied.
const FEWEST_FOR_A_THREAD: usize = 32;
