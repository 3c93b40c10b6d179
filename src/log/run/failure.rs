//! When a file of the log cannot be written any further: a new one takes what the old one did not, or the log ends with the
//! first cause.

use std::collections::VecDeque;

use super::{LogError, RunLog, warning};
use crate::log::{cdr, topics};

/// Messages that are not in the file for certain, to be written once more if it fails.
#[derive(Default)]
pub(super) struct Unflushed {
    /// Number of the first of them in the present file.
    pub(super) first: u64,
    /// Topic, sequence number, stamp, and length of the body.
    messages: VecDeque<(&'static str, u32, u64, usize)>,
    bodies: Vec<u8>,
}

impl Unflushed {
    pub(super) fn push(&mut self, topic: &'static str, sequence: u32, stamp_ns: u64, body: &[u8]) {
        self.messages.push_back((topic, sequence, stamp_ns, body.len()));
        self.bodies.extend_from_slice(body);
    }

    pub(super) fn pop(&mut self) {
        if let Some((.., length)) = self.messages.pop_back() {
            self.bodies.truncate(self.bodies.len() - length);
        }
    }

    /// Forget the messages before number `flushed` of the present file.
    pub(super) fn forget(&mut self, flushed: u64) {
        let known = flushed.saturating_sub(self.first).min(self.messages.len() as u64);
        let bytes: usize = self.messages.drain(..known as usize).map(|(.., length)| length).sum();
        self.bodies.drain(..bytes);
        self.first += known;
    }
}

/// New files that are tried, one after the other, when one cannot be written any further.
pub(super) const MOST_ATTEMPTS: usize = 3;

impl RunLog {
    /// The failure that ended this log, if there was one.
    pub(super) fn check(&self) -> Result<(), LogError> {
        match &self.failed {
            None => Ok(()),
            Some((log, bytes, cause)) => Err(LogError::Write { log: log.clone(), bytes: *bytes, cause: cause.clone() }),
        }
    }

    pub(super) fn fail(&mut self, log: String, bytes: u64, cause: String) -> LogError {
        self.failed = Some((log.clone(), bytes, cause.clone()));
        LogError::Write { log, bytes, cause }
    }

    pub(super) fn gone(&self) -> LogError {
        let (log, bytes) = (self.storage.name(self.number), self.writer.bytes());
        LogError::Write { log, bytes, cause: "the file is gone".to_owned() }
    }

    /// After a failure of the present file: a new one, with everything that was not in the old one yet.
    pub(super) fn carry_on(&mut self, first: &LogError) -> Result<(), LogError> {
        let (log, bytes) = (self.storage.name(self.number), self.writer.flushed().bytes);
        let cause = cause_of(first);
        self.leave(first);
        let text = format!("{log} could not be written any further, this file goes on: {cause}");
        let body = cdr::encode(&warning(self.stamp_ns, text))?;
        self.unflushed.push(topics::DIAGNOSTICS.name(), 0, self.stamp_ns, &body);
        self.totals.messages += 1;
        let mut last = String::new();
        for _ in 0..MOST_ATTEMPTS {
            let name = self.storage.name(self.next);
            let written = self.open_next().and_then(|writer| {
                self.writer = writer;
                self.opened = None;
                self.write_again().inspect_err(|error| self.leave(error))
            });
            match written {
                Ok(()) => return Ok(()),
                Err(error) => last = format!("{name}: {}", cause_of(&error)),
            }
        }
        Err(self.fail(log, bytes, format!("{cause}; nor could a new file be written, {last}")))
    }

    /// Give up the present file. What was flushed stays in it.
    fn leave(&mut self, why: &LogError) {
        self.totals.failures.push(why.to_string());
        let flushed = self.writer.flushed();
        if !self.storage.holds(self.number) {
            return;
        }
        self.unflushed.forget(flushed.messages);
        // Behind the last flush stands a part of a chunk, which no reader can use, or a whole one that is written again.
        if let Err(cause) = self.storage.cut(self.number, flushed.bytes) {
            let name = self.storage.name(self.number);
            let text =
                format!("{name} cannot be cut to {} bytes: the next file may repeat its end: {cause}", flushed.bytes);
            self.totals.failures.push(text);
        }
        self.closed.push_back((self.number, flushed.bytes));
    }

    /// Write what the last file did not take, and see that it is there.
    fn write_again(&mut self) -> Result<(), LogError> {
        let mut from = 0;
        for &(topic, sequence, stamp_ns, length) in &self.unflushed.messages {
            self.writer.write_encoded(topic, sequence, stamp_ns, &self.unflushed.bodies[from..from + length])?;
            from += length;
        }
        self.writer.flush()?;
        if !self.storage.holds(self.number) {
            return Err(self.gone());
        }
        self.unflushed.forget(self.writer.flushed().messages);
        Ok(())
    }
}

/// The cause alone, for a text that names the file already.
fn cause_of(error: &LogError) -> String {
    match error {
        LogError::Write { cause, .. } => cause.clone(),
        LogError::Create { cause, .. } => cause.to_string(),
        other => other.to_string(),
    }
}
