//! The log of a run: files that follow each other.
//!
//! A file is closed and the next one begun when it is large or old enough, with no message lost in between. Where a file
//! cannot be written any further, what was not in it yet goes into a new one; where that fails too, the run hears of it.

use std::collections::{BTreeMap, VecDeque};
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::expected::{Expected, Met};
use super::messages::{Log, Time};
use super::writer::{LogOptions, LogWriter};
use super::{LogError, Message, Topic, cdr, topics};

/// Where the files of a run are kept, by their numbers.
pub trait Storage: Send {
    /// Begin a file, which must not exist.
    ///
    /// # Errors
    /// It exists, or the operating system refuses.
    fn create(&mut self, number: u32) -> io::Result<Box<dyn Write + Send>>;

    /// Whether a file that was begun is still where it was.
    fn holds(&self, number: u32) -> bool;

    /// Shorten a file.
    ///
    /// # Errors
    /// The operating system refuses.
    fn cut(&mut self, number: u32, bytes: u64) -> io::Result<()>;

    /// Delete a file.
    ///
    /// # Errors
    /// The operating system refuses.
    fn remove(&mut self, number: u32) -> io::Result<()>;

    /// Name of a file, for people.
    fn name(&self, number: u32) -> String;
}

/// A run's folder as storage.
#[derive(Debug, Clone)]
pub struct Folder(PathBuf);

impl Folder {
    /// Storage in a folder, which must exist.
    pub fn new(path: &Path) -> Self {
        Folder(path.to_owned())
    }

    fn path(&self, number: u32) -> PathBuf {
        self.0.join(format!("run_{number:03}.mcap"))
    }
}

impl Storage for Folder {
    fn create(&mut self, number: u32) -> io::Result<Box<dyn Write + Send>> {
        Ok(Box::new(File::create_new(self.path(number))?))
    }

    fn holds(&self, number: u32) -> bool {
        self.path(number).is_file()
    }

    fn cut(&mut self, number: u32, bytes: u64) -> io::Result<()> {
        OpenOptions::new().write(true).open(self.path(number))?.set_len(bytes)
    }

    fn remove(&mut self, number: u32) -> io::Result<()> {
        std::fs::remove_file(self.path(number))
    }

    fn name(&self, number: u32) -> String {
        self.path(number).display().to_string()
    }
}

/// Storage that keeps nothing: for a repetition that is only compared.
#[derive(Debug, Clone, Copy)]
pub struct Nowhere;

impl Storage for Nowhere {
    fn create(&mut self, _: u32) -> io::Result<Box<dyn Write + Send>> {
        Ok(Box::new(io::sink()))
    }

    fn holds(&self, _: u32) -> bool {
        true
    }

    fn cut(&mut self, _: u32, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn remove(&mut self, _: u32) -> io::Result<()> {
        Ok(())
    }

    fn name(&self, _: u32) -> String {
        "(not kept)".into()
    }
}

/// The numbers and paths of a run folder's log files, in order.
///
/// # Errors
/// The folder cannot be read.
pub fn log_files(run: &Path) -> io::Result<Vec<(u32, PathBuf)>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(run)? {
        let path = entry?.path();
        files.extend(log_number(&path).map(|number| (number, path)));
    }
    files.sort();
    Ok(files)
}

/// The number of a log file of a run folder, by its name.
pub fn log_number(path: &Path) -> Option<u32> {
    let name = path.file_name()?.to_str()?;
    name.strip_prefix("run_")?.strip_suffix(".mcap")?.parse().ok()
}

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
    /// Files that could not be written any further, and why. No message was lost in them.
    pub failures: Vec<String>,
    /// How far a recording was repeated, if there was one to compare with.
    pub expected: Option<Expected>,
}

/// Messages that were written since the last flush, to be written once more if the file fails.
#[derive(Default)]
struct Unflushed {
    messages: Vec<(&'static str, u32, u64, usize)>,
    bodies: Vec<u8>,
}

impl Unflushed {
    fn push(&mut self, topic: &'static str, sequence: u32, stamp_ns: u64, body: &[u8]) {
        self.messages.push((topic, sequence, stamp_ns, body.len()));
        self.bodies.extend_from_slice(body);
    }

    fn pop(&mut self) {
        if let Some((.., length)) = self.messages.pop() {
            self.bodies.truncate(self.bodies.len() - length);
        }
    }

    fn clear(&mut self) {
        self.messages.clear();
        self.bodies.clear();
    }
}

/// Writes the log of a run; end it with [`RunLog::finish`].
pub struct RunLog {
    storage: Box<dyn Storage>,
    options: LogOptions,
    rotation: Rotation,
    metadata: BTreeMap<String, String>,
    number: u32,
    writer: LogWriter<Box<dyn Write + Send>>,
    opened: Option<Instant>,
    unflushed: Unflushed,
    /// Numbers and sizes of the files before the present one, the oldest first.
    closed: VecDeque<(u32, u64)>,
    totals: RunTotals,
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
        Self::begin(Box::new(storage), options, rotation, metadata, VecDeque::new())
    }

    /// Go on with the log of a run that has files already: their numbers and sizes, in order.
    ///
    /// # Errors
    /// As [`LogWriter::create`].
    pub fn append(
        storage: impl Storage + 'static,
        options: &LogOptions,
        rotation: Rotation,
        metadata: &BTreeMap<String, String>,
        files: &[(u32, u64)],
    ) -> Result<Self, LogError> {
        Self::begin(Box::new(storage), options, rotation, metadata, files.iter().copied().collect())
    }

    /// Compare what is written with a recording from now on.
    #[must_use]
    pub fn expecting(mut self, expected: Expected, repeating: Repeating) -> Self {
        self.expected = Some((expected, repeating));
        self
    }

    fn begin(
        mut storage: Box<dyn Storage>,
        options: &LogOptions,
        rotation: Rotation,
        metadata: &BTreeMap<String, String>,
        closed: VecDeque<(u32, u64)>,
    ) -> Result<Self, LogError> {
        let number = closed.back().map_or(0, |(number, _)| number + 1);
        let writer = open(storage.as_mut(), number, options, metadata)?;
        Ok(RunLog {
            storage,
            options: options.clone(),
            rotation,
            metadata: metadata.clone(),
            number,
            writer,
            opened: None,
            unflushed: Unflushed::default(),
            closed,
            totals: RunTotals::default(),
            expected: None,
            stamp_ns: 0,
            body: Vec::new(),
        })
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
        if let Some((expected, repeating)) = &mut self.expected {
            match (expected.meet(topic, stamp_ns, body), *repeating) {
                (Met::Recorded, Repeating::Skip) => return Ok(()),
                (Met::Differs, Repeating::Skip) => return Err(LogError::Differs { topic, sequence }),
                _ => {}
            }
        }
        self.stamp_ns = stamp_ns;
        self.rotate_if_due(None)?;
        self.unflushed.push(topic, sequence, stamp_ns, body);
        match self.writer.write_encoded(topic, sequence, stamp_ns, body) {
            Ok(()) => {}
            Err(cause @ LogError::Write { .. }) => self.carry_on(cause)?,
            Err(refused) => {
                self.unflushed.pop();
                return Err(refused);
            }
        }
        self.totals.messages += 1;
        self.forget_flushed();
        Ok(())
    }

    /// Add an attachment and flush, so that it is in the file when this returns.
    ///
    /// # Errors
    /// As [`RunLog::write`].
    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        self.flush()?;
        if let Err(cause) = self.writer.attach(name, media_type, bytes, stamp_ns) {
            if !matches!(cause, LogError::Write { .. }) {
                return Err(cause);
            }
            self.carry_on(cause)?;
            self.writer.attach(name, media_type, bytes, stamp_ns)?;
        }
        Ok(())
    }

    /// Flush, rotate and delete if it is time to; call it often, with the time.
    ///
    /// # Errors
    /// As [`RunLog::write`].
    pub fn tick(&mut self, now: Instant) -> Result<(), LogError> {
        let before = self.writer.flushed();
        if let Err(cause) = self.writer.tick(now) {
            self.carry_on(cause)?;
        }
        if self.writer.flushed() != before && !self.storage.holds(self.number) {
            // The operating system goes on writing into a file that nobody can ever open again.
            let cause = "the file is gone".to_owned();
            let (log, bytes) = (self.storage.name(self.number), self.writer.bytes());
            self.carry_on(LogError::Write { log, bytes, cause })?;
        }
        self.forget_flushed();
        self.opened.get_or_insert(now);
        self.rotate_if_due(Some(now))
    }

    /// Hand everything to the operating system.
    ///
    /// # Errors
    /// As [`RunLog::write`].
    pub fn flush(&mut self) -> Result<(), LogError> {
        if let Err(cause) = self.writer.flush() {
            self.carry_on(cause)?;
        }
        self.forget_flushed();
        Ok(())
    }

    /// Close the last file.
    ///
    /// # Errors
    /// As [`RunLog::write`]. That only the index of a file could not be written is a failure in the totals, and no error:
    /// its messages can be read.
    pub fn finish(mut self) -> Result<RunTotals, LogError> {
        self.flush()?;
        let flushed = self.writer.flushed();
        match self.writer.finish() {
            Ok(file) => self.closed.push_back((self.number, file.bytes)),
            Err(error) => {
                self.totals.failures.push(error.to_string());
                self.closed.push_back((self.number, flushed.bytes));
            }
        }
        self.totals.files = self.closed.len() as u64;
        self.totals.bytes = self.closed.iter().map(|(_, bytes)| bytes).sum();
        self.totals.expected = self.expected.map(|(expected, _)| expected);
        Ok(self.totals)
    }

    fn forget_flushed(&mut self) {
        if self.writer.flushed().messages == self.writer.messages() {
            self.unflushed.clear();
        }
    }

    fn rotate_if_due(&mut self, now: Option<Instant>) -> Result<(), LogError> {
        let large = self.writer.flushed().bytes >= self.rotation.file_bytes;
        let age = now.zip(self.opened).map(|(now, opened)| now.saturating_duration_since(opened));
        let old = age.zip(self.rotation.file_age).is_some_and(|(age, most)| age >= most);
        // Every file holds something: a silent log is not split.
        if !(large || old) || self.writer.messages() == 0 {
            return self.stay_within_budget();
        }
        self.flush()?;
        let next = match open(self.storage.as_mut(), self.number + 1, &self.options, &self.metadata) {
            Ok(next) => next,
            Err(error) => {
                // The present file can still be written: better a large one than none. Tried again when it has doubled.
                self.totals.failures.push(format!("{error}; {} goes on", self.storage.name(self.number)));
                self.rotation.file_bytes = self.rotation.file_bytes.saturating_mul(2);
                self.rotation.file_age = self.rotation.file_age.map(|age| 2 * age);
                return Ok(());
            }
        };
        let flushed = self.writer.flushed();
        let last = std::mem::replace(&mut self.writer, next);
        let bytes = match last.finish() {
            Ok(file) => file.bytes,
            Err(error) => {
                self.totals.failures.push(error.to_string());
                flushed.bytes
            }
        };
        self.closed.push_back((self.number, bytes));
        (self.number, self.opened) = (self.number + 1, now);
        self.stay_within_budget()
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

    /// After a failure of the present file: a new one, with everything that was not in the old one yet.
    fn carry_on(&mut self, mut cause: LogError) -> Result<(), LogError> {
        loop {
            let flushed = self.writer.flushed();
            // Behind the last flush stands a part of a chunk, which no reader can use.
            let _ = self.storage.cut(self.number, flushed.bytes);
            self.totals.failures.push(cause.to_string());
            self.closed.push_back((self.number, flushed.bytes));
            if flushed.messages == 0 {
                // Not even one chunk: another file would fare no better.
                return Err(cause);
            }
            let failed = self.storage.name(self.number);
            match open(self.storage.as_mut(), self.number + 1, &self.options, &self.metadata) {
                Ok(next) => self.writer = next,
                Err(second) => {
                    let (log, bytes) = (failed, flushed.bytes);
                    let cause = format!("{cause}; {second}");
                    return Err(LogError::Write { log, bytes, cause });
                }
            }
            (self.number, self.opened) = (self.number + 1, None);
            match self.write_again(format!("{failed} could not be written any further, this file goes on: {cause}")) {
                Ok(()) => return Ok(()),
                Err(next) => cause = next,
            }
        }
    }

    fn write_again(&mut self, why: String) -> Result<(), LogError> {
        let mut from = 0;
        for &(topic, sequence, stamp_ns, length) in &self.unflushed.messages {
            self.writer.write_encoded(topic, sequence, stamp_ns, &self.unflushed.bodies[from..from + length])?;
            from += length;
        }
        self.writer.write(topics::DIAGNOSTICS, 0, self.stamp_ns, &warning(self.stamp_ns, why))?;
        self.writer.flush()
    }

    /// A diagnostic of the log itself.
    fn say(&mut self, text: String) -> Result<(), LogError> {
        let body = cdr::encode(&warning(self.stamp_ns, text))?;
        let topic = topics::DIAGNOSTICS.name();
        self.unflushed.push(topic, 0, self.stamp_ns, &body);
        self.totals.messages += 1;
        match self.writer.write_encoded(topic, 0, self.stamp_ns, &body) {
            Err(cause) => self.carry_on(cause),
            Ok(()) => Ok(()),
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
        Ok(sink) => LogWriter::with_sink(sink, &log, options, &metadata),
        Err(cause) => Err(LogError::Create { log, cause }),
    }
}
