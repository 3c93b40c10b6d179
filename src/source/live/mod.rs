//! A robot that drives while the agent learns.
//!
//! [`Base`] is the seam: readings come in, velocities go out. [`Drive`] makes frames and velocities of them. [`Live`] is the source
//! that runs both, in simulated time or in real time.

mod base;
mod drive;
#[cfg(test)]
mod tests;
mod threaded;

pub use base::{Base, Reading, Received, Scan};
pub use drive::{Drive, Event};
pub use threaded::Threaded;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::robot::Action;
use crate::scenario::{Equipment, Motion, Scenario};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::source::{Frame, Journal, Source, give_until_boundary};

/// What people ask of a robot from other threads, and what it asks of them.
#[derive(Debug, Clone, Default)]
pub struct Switches {
    /// The run is paused.
    pub paused: Arc<AtomicBool>,
    /// The run is to end.
    pub stop: Arc<AtomicBool>,
    /// Somebody lets the robot go on; taken back when it was heard.
    pub go_on: Arc<AtomicBool>,
    /// The robot says that its battery has become low; taken back when it was heard.
    pub battery_low: Arc<AtomicBool>,
}

/// A robot as a source of frames: the loop of control goes on while an action is executed.
pub struct Live<B> {
    base: B,
    drive: Drive,
    switches: Switches,
    journal: Option<Journal>,
    period: Duration,
    /// When the next velocity is due.
    next: Duration,
}

impl<B: Base> Live<B> {
    /// A robot that stands; its frames come behind `last`, the number and the stamp of one that is recorded.
    pub fn new(
        scenario: Arc<Scenario>,
        motion: Motion,
        equipment: Equipment,
        base: B,
        last: Option<(u64, u64)>,
    ) -> Self {
        let (period, next) = (motion.period(), base.now());
        let drive = Drive::new(scenario, motion, equipment, last);
        Live { base, drive, switches: Switches::default(), journal: None, period, next }
    }

    /// The same, with what people ask of it.
    pub fn with_switches(self, switches: Switches) -> Self {
        Live { switches, ..self }
    }

    /// The robot.
    pub fn base(&self) -> &B {
        &self.base
    }

    /// One step of control.
    fn cycle(&mut self) {
        self.next = self.base.now().max(self.next) + self.period;
        self.listen(self.next);
        self.tick();
    }

    /// Take what comes in until a time.
    fn listen(&mut self, until: Duration) {
        let drive = &mut self.drive;
        self.base.receive(until, &mut |received| drive.hear(received));
    }

    /// Command the next velocity.
    fn tick(&mut self) {
        let drive = &mut self.drive;
        let safety = drive.safety();
        safety.pause(self.switches.paused.load(Ordering::Relaxed));
        if self.switches.go_on.swap(false, Ordering::Relaxed) {
            safety.release();
        }
        if self.switches.stop.load(Ordering::Relaxed) {
            safety.end();
        }
        if drive.take_battery_low() {
            self.switches.battery_low.store(true, Ordering::Relaxed);
        }
        let velocity = drive.step(self.base.now());
        self.base.command(velocity);
        while let Some(event) = drive.event() {
            if let Some(journal) = &self.journal {
                journal(event);
            }
        }
    }

    /// Go on until there is a frame; none where the run is to end.
    fn next(&mut self) -> Option<Frame> {
        loop {
            if let Some(frame) = self.drive.frame() {
                return Some(frame);
            }
            let ends = self.switches.stop.load(Ordering::Relaxed);
            self.cycle();
            if ends {
                return None;
            }
        }
    }
}

impl<B: Base> Source for Live<B> {
    fn first(&mut self) -> Option<Frame> {
        self.next()
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        self.drive.order(action);
        give_until_boundary(|| self.next(), give)
    }

    fn keep_journal(&mut self, journal: Option<Journal>) {
        self.journal = journal;
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let time_goes_on = snapshot.scope("base", |snapshot| self.base.persist(snapshot))?;
        snapshot.scope("drive", |snapshot| self.drive.persist(snapshot, time_goes_on))?;
        match time_goes_on {
            true => snapshot.value("next", &mut self.next),
            false => Ok(()),
        }
    }
}
