//! The log of a run: files that follow each other.
//!
//! A file is closed and the next one begun when it is large or old enough, with no message lost in between. Where a file
//! cannot be written any further, what was not in it yet goes into a new one; where that fails too, the run hears of it.

mod failure;
mod storage;

use std::collections::{BTreeMap, VecDeque};
use std::io::Write;
use std::time::{Duration, Instant};

use self::failure::{MOST_ATTEMPTS, Unflushed};
pub use self::storage::{Folder, NullStorage, Storage, log_files, log_number};

use super::expected::{Expected, Match};
use super::messages::{Log, Time};
use super::writer::{FileTotals, LogOptions, LogWriter};
use super::{LogError, Message, Topic, cdr, topics};

/// When a file ends and the next one begins, and how much all of them may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rotation {
    /// A file that has this many bytes is closed.
    pub file_bytes: u64,
    /// A file is closed after this time; `None`: never for its age.
    pub file_age: Option<Duration>,
    /// Above this sum the run's oldest files are deleted, never the one that is being written; `None`: all are kept.
    pub budget_bytes: Option<u64>,
}

impl Rotation {
    /// One file, however large.
    pub const NEVER: Rotation = Rotation { file_bytes: u64::MAX, file_age: None, budget_bytes: None };
}

/// What a run's log holds in the end.
#[derive(Debug, Clone, Default)]
pub struct RunTotals {
    /// Files that are there.
    pub files: u64,
    /// Bytes in them.
    pub bytes: u64,
    /// Messages that were written, also those in files that were deleted since.
    pub messages: u64,
    /// Files that were deleted to stay within the budget.
    pub deleted_files: u64,
    /// Bytes in these.
    pub deleted_bytes: u64,
    /// Time that the thread which writes them spent on it.
    pub busy: Duration,
    /// Files that could not be written any further, and why. No message was lost in them.
    pub failures: Vec<String>,
    /// How far a recording was repeated, if there was one to compare with.
    pub expected: Option<Expected>,
}

/// Writes the log of a run; end it with [`RunLog::finish`].
///
/// After [`LogError::Write`] every call reports that first failure and writes nothing.
pub struct RunLog {
    storage: Box<dyn Storage>,
    options: LogOptions,
    rotation: Rotation,
    metadata: BTreeMap<String, String>,
    number: u32,
    /// Number of the next file.
    next: u32,
    writer: LogWriter<Box<dyn Write + Send>>,
    opened: Option<Instant>,
    /// Where the next file could not be begun: this many times size and age before it is tried again.
    patience: u32,
    unflushed: Unflushed,
    /// Numbers and sizes of the files before the present one, the oldest first.
    closed: VecDeque<(u32, u64)>,
    totals: RunTotals,
    /// The failure that ended this log: name of the file, bytes in it, cause.
    failed: Option<(String, u64, String)>,
    expected: Option<(Expected, Repeating)>,
    /// The newest stamp, for the log's own diagnostics.
    stamp_ns: u64,
    body: Vec<u8>,
}

/// What happens with messages that a recording holds already.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Repeating {
    /// They are compared and written.
    Write,
    /// They are compared and not written: this log goes on where the recording ends. A difference is an error.
    Skip,
}

impl RunLog {
    /// Begin the log of a new run.
    ///
    /// # Errors
    /// As [`LogWriter::create`].
    pub fn create(
        storage: impl Storage + 'static,
        options: &LogOptions,
        rotation: Rotation,
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, LogError> {
        Self::append(storage, options, rotation, metadata, &[])
    }

    /// Go on with the log of a run that has files already: their numbers and sizes, in order.
    ///
    /// # Errors
    /// As [`LogWriter::create`].
    pub fn append(
        mut storage: impl Storage + 'static,
        options: &LogOptions,
        rotation: Rotation,
        metadata: &BTreeMap<String, String>,
        files: &[(u32, u64)],
    ) -> Result<Self, LogError> {
        let number = files.last().map_or(0, |(number, _)| number.saturating_add(1));
        let writer = open(&mut storage, number, options, metadata)?;
        Ok(RunLog {
            storage: Box::new(storage),
            options: options.clone(),
            rotation,
            metadata: metadata.clone(),
            number,
            next: number.saturating_add(1),
            writer,
            opened: None,
            patience: 1,
            unflushed: Unflushed::default(),
            closed: files.iter().copied().collect(),
            totals: RunTotals::default(),
            failed: None,
            expected: None,
            stamp_ns: 0,
            body: Vec::new(),
        })
    }

    /// Compare what is written with a recording from now on.
    #[must_use]
    pub fn expecting(mut self, expected: Expected, repeating: Repeating) -> Self {
        self.expected = Some((expected, repeating));
        self
    }

    /// Add a message. `stamp_ns` is the log's clock, nanoseconds.
    ///
    /// # Errors
    /// [`LogError::Write`] if neither this file nor a new one can be written; [`LogError::Differs`] if a run that goes on does
    /// not repeat what its log holds; [`LogError::TooLarge`], [`LogError::Encode`] and [`LogError::UnknownTopic`] leave the log
    /// as it was.
    pub fn write<M: Message>(
        &mut self,
        topic: Topic<M>,
        sequence: u32,
        stamp_ns: u64,
        message: &M,
    ) -> Result<(), LogError> {
        let mut body = std::mem::take(&mut self.body);
        let written = cdr::encode_into(message, &mut body)
            .and_then(|()| self.write_encoded(topic.name(), sequence, stamp_ns, &body));
        self.body = body;
        written
    }

    fn write_encoded(
        &mut self,
        topic: &'static str,
        sequence: u32,
        stamp_ns: u64,
        body: &[u8],
    ) -> Result<(), LogError> {
        self.check()?;
        if let Some((expected, repeating)) = &mut self.expected {
            match (expected.meet(topic, stamp_ns, body), *repeating) {
                (Match::Recorded, Repeating::Skip) => return Ok(()),
                (Match::Differs, Repeating::Skip) => return Err(LogError::Differs { topic, sequence }),
                _ => {}
            }
        }
        self.stamp_ns = stamp_ns;
        self.rotate_if_due(None)?;
        self.put(topic, sequence, stamp_ns, body)
    }

    fn put(&mut self, topic: &'static str, sequence: u32, stamp_ns: u64, body: &[u8]) -> Result<(), LogError> {
        self.unflushed.push(topic, sequence, stamp_ns, body);
        match self.writer.write_encoded(topic, sequence, stamp_ns, body) {
            Ok(()) => self.settle()?,
            Err(cause @ LogError::Write { .. }) => self.carry_on(&cause)?,
            Err(refused) => {
                self.unflushed.pop();
                return Err(refused);
            }
        }
        self.totals.messages += 1;
        Ok(())
    }

    /// Add an attachment and flush, so that it is in the file when this returns.
    ///
    /// # Errors
    /// As [`RunLog::write`].
    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        self.flush()?;
        // Each failure is followed by a file that could be written, and so by another try.
        for _ in 0..MOST_ATTEMPTS {
            match self.writer.attach(name, media_type, bytes, stamp_ns) {
                Ok(()) if self.storage.holds(self.number) => return Ok(()),
                Ok(()) => self.carry_on(&self.gone())?,
                Err(cause @ LogError::Write { .. }) => self.carry_on(&cause)?,
                Err(refused) => return Err(refused),
            }
        }
        let (log, bytes) = (self.storage.name(self.number), self.writer.flushed().bytes);
        Err(self.fail(log, bytes, format!("{MOST_ATTEMPTS} files could not take the attachment {name}")))
    }

    /// Flush, rotate and delete if it is time to; call it often, with the time.
    ///
    /// # Errors
    /// As [`RunLog::write`].
    pub fn tick(&mut self, now: Instant) -> Result<(), LogError> {
        self.check()?;
        match self.writer.tick(now) {
            Ok(()) => self.settle()?,
            Err(cause) => self.carry_on(&cause)?,
        }
        self.opened.get_or_insert(now);
        self.rotate_if_due(Some(now))
    }

    /// The stamp of the newest message, nanoseconds; 0 if there is none.
    pub fn stamp_ns(&self) -> u64 {
        self.stamp_ns
    }

    /// Hand everything to the operating system.
    ///
    /// # Errors
    /// As [`RunLog::write`].
    pub fn flush(&mut self) -> Result<(), LogError> {
        self.check()?;
        match self.writer.flush() {
            Ok(()) => self.settle(),
            Err(cause) => self.carry_on(&cause),
        }
    }

    /// Close the last file.
    ///
    /// # Errors
    /// As [`RunLog::write`]. That only the index of a file could not be written is a failure in the totals, and no error:
    /// its messages can be read.
    pub fn finish(mut self) -> Result<RunTotals, LogError> {
        self.flush()?;
        let (number, flushed) = (self.number, self.writer.flushed());
        let finished = self.writer.finish();
        let bytes = closed_bytes(self.storage.as_mut(), number, flushed.bytes, finished, &mut self.totals.failures);
        self.closed.push_back((number, bytes));
        self.totals.files = self.closed.len() as u64;
        self.totals.bytes = self.closed.iter().map(|(_, bytes)| bytes).sum();
        self.totals.expected = self.expected.map(|(expected, _)| expected);
        Ok(self.totals)
    }

    /// After writing: what was flushed need not be written again, if it is where it should be.
    fn settle(&mut self) -> Result<(), LogError> {
        let flushed = self.writer.flushed().messages;
        // The operating system goes on writing into a file that nobody can ever open again.
        if flushed > self.unflushed.first && !self.storage.holds(self.number) {
            return self.carry_on(&self.gone());
        }
        self.unflushed.forget(flushed);
        Ok(())
    }

    fn rotate_if_due(&mut self, now: Option<Instant>) -> Result<(), LogError> {
        let large = self.writer.flushed().bytes >= self.rotation.file_bytes.saturating_mul(self.patience.into());
        let age = now.zip(self.opened).map(|(now, opened)| now.saturating_duration_since(opened));
        let most = self.rotation.file_age.map(|most| most.saturating_mul(self.patience));
        let old = age.zip(most).is_some_and(|(age, most)| age >= most);
        // Every file holds something: a silent log is not split.
        if !(large || old) || self.writer.messages() == 0 {
            return self.stay_within_budget();
        }
        let number = self.number;
        self.flush()?;
        if self.number != number {
            // It failed just now, and the next one was begun for that.
            return self.stay_within_budget();
        }
        let next = match self.open_next() {
            Ok(next) => next,
            Err(error) => {
                // The present file can still be written: better a large one than none.
                self.totals.failures.push(format!("{error}; {} goes on", self.storage.name(self.number)));
                self.patience = self.patience.saturating_mul(2);
                return Ok(());
            }
        };
        let flushed = self.writer.flushed();
        let last = std::mem::replace(&mut self.writer, next);
        let failures = &mut self.totals.failures;
        let bytes = closed_bytes(self.storage.as_mut(), number, flushed.bytes, last.finish(), failures);
        self.closed.push_back((number, bytes));
        (self.opened, self.patience) = (now, 1);
        self.stay_within_budget()
    }

    /// Begin the next file; it becomes the present one, but for its writer.
    fn open_next(&mut self) -> Result<LogWriter<Box<dyn Write + Send>>, LogError> {
        let number = self.next;
        match open(self.storage.as_mut(), number, &self.options, &self.metadata) {
            Ok(writer) => {
                (self.number, self.next) = (number, number.saturating_add(1));
                self.unflushed.first = 0;
                Ok(writer)
            }
            Err(error) => {
                // Whatever is there by this name is not touched.
                if self.storage.holds(number) {
                    self.next = number.saturating_add(1);
                }
                Err(error)
            }
        }
    }

    /// Delete this run's oldest files until the rest is within the budget, and say so in the log.
    fn stay_within_budget(&mut self) -> Result<(), LogError> {
        let Some(budget) = self.rotation.budget_bytes else { return Ok(()) };
        let mut total = self.writer.bytes() + self.closed.iter().map(|(_, bytes)| bytes).sum::<u64>();
        while total > budget
            && let Some((number, bytes)) = self.closed.pop_front()
        {
            total -= bytes;
            let name = self.storage.name(number);
            let text = match self.storage.remove(number) {
                Ok(()) => {
                    self.totals.deleted_files += 1;
                    self.totals.deleted_bytes += bytes;
                    format!("{name} ({bytes} bytes) is deleted: the run's log may take {budget} bytes (log.budget_mb)")
                }
                Err(cause) => {
                    let text = format!("{name} cannot be deleted, although the log is over its budget: {cause}");
                    self.totals.failures.push(text.clone());
                    text
                }
            };
            self.say(text)?;
        }
        Ok(())
    }

    /// A diagnostic of the log itself.
    fn say(&mut self, text: String) -> Result<(), LogError> {
        let body = cdr::encode(&warning(self.stamp_ns, text))?;
        self.put(topics::DIAGNOSTICS.name(), 0, self.stamp_ns, &body)
    }
}

/// Bytes of a file that was finished. Where its index could not be written, it is cut to its messages.
fn closed_bytes(
    storage: &mut dyn Storage,
    number: u32,
    flushed: u64,
    finished: Result<FileTotals, LogError>,
    failures: &mut Vec<String>,
) -> u64 {
    match finished {
        Ok(file) => file.bytes,
        Err(error) => {
            failures.push(format!("{error}; its index is missing"));
            if let Err(cause) = storage.cut(number, flushed) {
                failures.push(format!("{} cannot be cut to {flushed} bytes: {cause}", storage.name(number)));
            }
            flushed
        }
    }
}

fn warning(stamp_ns: u64, text: String) -> Log {
    Log { stamp: Time::new(stamp_ns), level: Log::WARN, name: "adagio.log".into(), msg: text, ..Default::default() }
}

/// Begin a file; its metadata says which one of the run it is.
fn open(
    storage: &mut dyn Storage,
    number: u32,
    options: &LogOptions,
    metadata: &BTreeMap<String, String>,
) -> Result<LogWriter<Box<dyn Write + Send>>, LogError> {
    let log = storage.name(number);
    let mut metadata = metadata.clone();
    metadata.insert("file".to_owned(), number.to_string());
    match storage.create(number) {
        // A file that holds not even its definitions would only be in the way of the next try.
        Ok(sink) => LogWriter::with_sink(sink, &log, options, &metadata).inspect_err(|_| {
            let _ = storage.remove(number);
        }),
        Err(cause) => Err(LogError::Create { log, cause }),
    }
}
