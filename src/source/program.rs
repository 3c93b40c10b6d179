//! A robot, or an environment, that another program drives: it gives a frame and takes the action that is to follow.
//!
//! [`Driven`] is the source that the actors have, [`Driver`] the program's end of it. The program says what an action came to when
//! it gives the frame behind it.

use std::sync::Arc;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, bounded};

use super::{Boundary, Frame, Mark, Source, View, give_until_boundary};
use crate::policy::Goto;
use crate::robot::{Action, Pose};
use crate::scenario::Scenario;
use crate::snapshot::{Snapshot, SnapshotError};
use crate::vision::Image;

/// Stamps of frames begin here, nanoseconds since 1970: 2026-01-01.
const EPOCH_NS: u64 = 1_767_225_600_000_000_000;

/// What a program shows.
#[derive(Debug, Clone)]
pub struct Shown {
    /// What the camera sees.
    pub image: Image,
    /// The true pose, where it is known.
    pub truth: Option<Pose>,
    /// It is the first of an episode: what was before has nothing to do with it.
    pub begins: bool,
    /// What the frame ends.
    pub ends: Ends,
    /// What is marked with it.
    pub marks: Vec<Mark>,
    /// Where the robot is sent from here.
    pub goto: Option<Goto>,
}

/// What a frame ends.
#[derive(Debug, Clone)]
pub enum Ends {
    /// Nothing: it was taken during an action.
    Nothing,
    /// An action.
    Action {
        /// Whether something stopped the robot.
        blocked: bool,
        /// Rewards by task, not a number where there is none.
        rewards: Vec<f64>,
        /// Whether it ends an episode, too: the next frame has nothing to do with it.
        episode: bool,
    },
}

/// The source: what another program drives.
pub struct Driven {
    scenario: Arc<Scenario>,
    shown: Receiver<Shown>,
    actions: Sender<Action>,
    number: u64,
    /// Stamp of the newest frame.
    stamp_ns: u64,
    /// The next frame belongs to no action: there was none, or it ended an episode.
    fresh: bool,
}

/// A program's end of a robot that it drives.
pub struct Driver {
    shown: Sender<Shown>,
    actions: Receiver<Action>,
}

/// The run is over: nobody takes frames any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Over;

/// Both ends of a robot that a program drives; its frames come behind `last`, the number and the stamp of one that is recorded.
pub fn driven(scenario: Arc<Scenario>, last: Option<(u64, u64)>) -> (Driver, Driven) {
    let ((shown, frames), (orders, actions)) = (bounded(1), bounded(1));
    let (number, stamp_ns) = last.map_or((0, EPOCH_NS), |(number, stamp_ns)| (number + 1, stamp_ns));
    let driven = Driven { scenario, shown: frames, actions: orders, number, stamp_ns, fresh: true };
    (Driver { shown, actions }, driven)
}

impl Driver {
    /// Show a frame.
    ///
    /// # Errors
    /// [`Over`].
    pub fn show(&self, shown: Shown) -> Result<(), Over> {
        self.shown.send(shown).map_err(|_| Over)
    }

    /// The action that is to follow the frame that was shown last, if it is decided on within a time.
    ///
    /// # Errors
    /// [`Over`].
    pub fn action(&self, within: Duration) -> Result<Option<Action>, Over> {
        match self.actions.recv_timeout(within) {
            Ok(action) => Ok(Some(action)),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(Over),
        }
    }
}

impl Driven {
    /// The next frame, during an action or behind it.
    fn next(&mut self, action: Option<Action>) -> Option<Frame> {
        let Shown { image, truth, begins, ends, marks, goto } = self.shown.recv().ok()?;
        self.fresh |= begins;
        // The first frame of an episode ends whatever was before it.
        let action = action.filter(|_| !self.fresh);
        let (boundary, rewards, episode) = match ends {
            // An episode may be over with its first frame.
            Ends::Action { episode, .. } if self.fresh => (Some(Boundary { blocked: false }), Vec::new(), episode),
            Ends::Nothing if self.fresh => (Some(Boundary { blocked: false }), Vec::new(), false),
            Ends::Nothing => (None, Vec::new(), false),
            Ends::Action { blocked, rewards, episode } => (Some(Boundary { blocked }), rewards, episode),
        };
        self.fresh = episode;
        let frame = Frame {
            number: self.number,
            stamp_ns: self.stamp_ns + (1e9 * self.scenario.robot.frame_seconds()) as u64,
            view: View::Image(image),
            truth: truth.filter(|_| self.scenario.robot.pose_known),
            odometry: None,
            sonar: Vec::new(),
            action,
            boundary,
            moved: Vec::new(),
            marks,
            goto: goto.filter(|_| boundary.is_some()),
            rewards,
        };
        (self.number, self.stamp_ns) = (frame.number + 1, frame.stamp_ns);
        Some(frame)
    }
}

impl Source for Driven {
    fn first(&mut self) -> Option<Frame> {
        self.next(None)
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        // What was decided on at the end of an episode is void.
        if !self.fresh && self.actions.send(action).is_err() {
            return false;
        }
        give_until_boundary(|| self.next(Some(action)), give)
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let recorded = (self.number, self.stamp_ns);
        snapshot.value("number", &mut self.number)?;
        snapshot.value("stamp_ns", &mut self.stamp_ns)?;
        if snapshot.is_restoring() {
            // Frames that were recorded after the state have their numbers and stamps already.
            (self.number, self.stamp_ns) = (self.number.max(recorded.0), self.stamp_ns.max(recorded.1));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_episode_ends_with_its_last_action_and_the_next_begins_with_none() {
        let text = "[robot]\nbody = \"program\"\n[[action]]\nname = \"a\"\n[[action]]\nname = \"b\"\n[[task]]\nreward = \"topic\"\n";
        let scenario = Arc::new(Scenario::parse(text, "program.toml".as_ref(), &[]).unwrap());
        let action = |number: usize| scenario.robot.actions.get(number).unwrap();
        let (driver, mut driven) = driven(scenario.clone(), Some((6, 1000)));
        let program = std::thread::spawn(move || {
            let image = || Image { width: 1, height: 1, cropped: false, rgb: vec![7; 3] };
            let show = |ends: Ends| {
                let shown = Shown { image: image(), truth: None, begins: false, ends, marks: Vec::new(), goto: None };
                driver.show(shown).unwrap();
            };
            let end = |episode: bool| Ends::Action { blocked: false, rewards: vec![0.5], episode };
            let next = || driver.action(Duration::from_secs(60)).unwrap().map(Action::index);
            show(end(false));
            let first = next();
            show(Ends::Nothing);
            show(end(true));
            // Nothing follows an episode but the next one, be it of a single frame.
            show(end(true));
            show(end(false));
            (first, next())
        });
        let mut frames = vec![driven.first().unwrap()];
        for number in [1, 0, 0] {
            assert!(driven.execute(action(number), &mut |frame| {
                frames.push(frame);
                true
            }));
        }
        // What was decided on behind the first frame of the third episode; the program goes away instead of driving it.
        assert!(!driven.execute(action(1), &mut |_| panic!("there is no frame")));
        assert_eq!(program.join().unwrap(), (Some(1), Some(1)));
        let told = |frame: &Frame| (frame.number, frame.action.map(Action::index), frame.boundary.is_some());
        let told: Vec<_> = frames.iter().map(told).collect();
        assert_eq!(
            told,
            [(7, None, true), (8, Some(1), false), (9, Some(1), true), (10, None, true), (11, None, true)]
        );
        assert_eq!(frames.iter().map(|frame| frame.rewards.len()).collect::<Vec<_>>(), [0, 0, 1, 0, 0]);
        assert!(frames.windows(2).all(|pair| pair[0].stamp_ns < pair[1].stamp_ns && pair[0].stamp_ns > 1000));
    }
}
