//! Writes a log.
//!
//! The file only grows: a chunk is put together in memory and appended with its final header.
//! A process that is killed leaves a file whose chunks can be read by any tool, and loses what
//! came after the last flush.

mod sink;

use std::{
    borrow::Cow,
    collections::BTreeMap,
    error::Error,
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};

use mcap::{
    Attachment, McapError, WriteOptions,
    records::{MessageHeader, Metadata},
    write::NoSeek,
};
use serde::{Deserialize, Serialize};

use self::sink::{GuardedSink, SinkState};
use super::{
    LogError, MAX_ATTACHMENT_BYTES, MAX_CHUNK_TARGET_BYTES, MAX_MESSAGE_BYTES, MAX_RECORD_BYTES, Message, Topic, cdr,
    topics,
};

/// Name of the metadata record with the scenario, version and seed.
pub const METADATA_NAME: &str = "adagio";

/// Smallest target size of a chunk, bytes: below, indexes outweigh the data.
const MIN_CHUNK_TARGET_BYTES: u64 = 1024;

/// What ROS 2 tools want to know of a channel: history keep-all, reliable, volatile, no deadlines.
/// As numbers, which all versions of ROS 2 read; the seconds stand for "never".
const QUALITY_OF_SERVICE: &str = "\
- history: 2
  depth: 0
  reliability: 1
  durability: 2
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
";

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Compression {
    /// Smallest files.
    #[default]
    Zstd,
    /// Less work to write (1.7 times the rate of zstd with noise as images), larger files.
    Lz4,
    /// Not at all.
    None,
}

/// How a log is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LogOptions {
    /// How chunks are compressed.
    pub compression: Compression,
    /// Size before compression at which a chunk is closed, bytes; 1 KiB to 16 MiB.
    pub chunk_bytes: u64,
    /// Longest time that messages wait in memory, as seen by [`LogWriter::tick`].
    pub flush_interval: Duration,
}

impl Default for LogOptions {
    /// zstd, chunks of 256 KiB (about 170 observations), flushed each second.
    fn default() -> Self {
        Self { compression: Compression::Zstd, chunk_bytes: 256 << 10, flush_interval: Duration::from_secs(1) }
    }
}

/// What a finished file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FileTotals {
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Messages.
    pub messages: u64,
}

/// Writes one file of a log; end it with [`LogWriter::finish`].
///
/// After a failure every call reports that first failure and writes nothing. A writer that is
/// dropped instead of finished closes the file as well as it can, but nobody hears of an error.
pub struct LogWriter<W: Write = File> {
    log: String,
    writer: mcap::Writer<NoSeek<BufWriter<GuardedSink<W>>>>,
    state: Arc<SinkState>,
    channels: BTreeMap<&'static str, u16>,
    chunk_bytes: u64,
    flush_interval: Duration,
    last_flush: Option<Instant>,
    /// Something was written since the last flush.
    pending: bool,
    /// Bytes of messages in the open chunk.
    open: u64,
    messages: u64,
    /// What the operating system had accepted at the last flush.
    flushed: FileTotals,
    /// The last message's bytes, kept for its allocation.
    body: Vec<u8>,
}

impl LogWriter<File> {
    /// Creates a log file with a channel for each topic and a metadata record.
    ///
    /// # Errors
    /// [`LogError::Create`] also if the file exists; otherwise as [`LogWriter::with_sink`].
    pub fn create(path: &Path, options: &LogOptions, metadata: &BTreeMap<String, String>) -> Result<Self, LogError> {
        check_options(options)?;
        let log = path.display().to_string();
        match File::create_new(path) {
            Ok(file) => Self::with_sink(file, &log, options, metadata),
            Err(cause) => Err(LogError::Create { log, cause }),
        }
    }
}

impl<W: Write> LogWriter<W> {
    /// Starts a log in any sink; `log` names it in errors. It need not buffer.
    ///
    /// # Errors
    /// [`LogError::Option`], [`LogError::TooLarge`] for the metadata, [`LogError::Write`].
    pub fn with_sink(
        sink: W,
        log: &str,
        options: &LogOptions,
        metadata: &BTreeMap<String, String>,
    ) -> Result<Self, LogError> {
        check_options(options)?;
        let size: usize = metadata.iter().map(|(key, value)| key.len() + value.len() + 8).sum();
        check_size("the log's metadata", size, MAX_RECORD_BYTES - 1024)?;

        let state = Arc::new(SinkState::default());
        let sink = GuardedSink::new(sink, Arc::clone(&state));
        let failed = |cause| write_error(log, &state, cause);
        let mut writer = write_options(options).create(NoSeek::new(BufWriter::new(sink))).map_err(failed)?;
        let channels = add_channels(&mut writer).map_err(failed)?;
        writer
            .write_metadata(&Metadata { name: METADATA_NAME.to_owned(), metadata: metadata.clone() })
            .map_err(failed)?;
        // So that a run that is killed in its first second can still be told by its metadata.
        writer.flush().map_err(failed)?;
        let mut created = Self {
            log: log.to_owned(),
            writer,
            state,
            channels,
            chunk_bytes: options.chunk_bytes,
            flush_interval: options.flush_interval,
            last_flush: None,
            pending: false,
            open: 0,
            messages: 0,
            flushed: FileTotals { bytes: 0, messages: 0 },
            body: Vec::new(),
        };
        created.flushed.bytes = created.state.bytes();
        Ok(created)
    }

    /// Adds a message. `stamp_ns` is the log's clock, nanoseconds.
    ///
    /// # Errors
    /// [`LogError::Write`]; [`LogError::TooLarge`], [`LogError::Encode`] and
    /// [`LogError::UnknownTopic`] leave the log as it was, and writing can go on.
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

    /// Adds a message that is encoded already, and closes the chunk if it is full.
    ///
    /// # Errors
    /// As [`LogWriter::write`].
    pub fn write_encoded(&mut self, topic: &str, sequence: u32, stamp_ns: u64, body: &[u8]) -> Result<(), LogError> {
        self.check()?;
        let channel_id = *self.channels.get(topic).ok_or_else(|| LogError::UnknownTopic { topic: topic.to_owned() })?;
        check_size(topic, body.len(), MAX_MESSAGE_BYTES)?;
        let header = MessageHeader { channel_id, sequence, log_time: stamp_ns, publish_time: stamp_ns };
        self.pending = true;
        let result = self.writer.write_to_known_channel(&header, body);
        self.settle(result)?;
        self.messages += 1;
        self.open += body.len() as u64;
        // Here and not by the mcap writer, so that what is in the file is known after every chunk.
        if self.open >= self.chunk_bytes { self.flush() } else { Ok(()) }
    }

    /// Adds an attachment and flushes, so that a checkpoint is in the file when this returns.
    ///
    /// # Errors
    /// [`LogError::Write`]; [`LogError::TooLarge`] leaves the log as it was.
    pub fn attach(&mut self, name: &str, media_type: &str, bytes: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        self.check()?;
        // The names stand in the same record and count towards its limit.
        let size = bytes.len() + name.len() + media_type.len();
        check_size(name, size, MAX_ATTACHMENT_BYTES - 1024)?;
        self.pending = true;
        let result = self.writer.attach(&Attachment {
            log_time: stamp_ns,
            create_time: stamp_ns,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: Cow::Borrowed(bytes),
        });
        self.settle(result)?;
        self.flush()
    }

    /// Flushes if the interval has passed since the last time; call it often, with the time.
    ///
    /// # Errors
    /// [`LogError::Write`].
    pub fn tick(&mut self, now: Instant) -> Result<(), LogError> {
        self.check()?;
        let last = *self.last_flush.get_or_insert(now);
        if now.saturating_duration_since(last) >= self.flush_interval {
            self.last_flush = Some(now);
            self.flush()?;
        }
        Ok(())
    }

    /// Closes the chunk and hands all of it to the operating system.
    ///
    /// # Errors
    /// [`LogError::Write`].
    pub fn flush(&mut self) -> Result<(), LogError> {
        self.check()?;
        if self.pending {
            let result = self.writer.flush();
            self.settle(result)?;
            (self.pending, self.open) = (false, 0);
            self.flushed = FileTotals { bytes: self.state.bytes(), messages: self.messages };
        }
        Ok(())
    }

    /// Bytes that the operating system has accepted so far; what waits in memory is not in it.
    pub fn bytes(&self) -> u64 {
        self.state.bytes()
    }

    /// What the operating system had accepted at the last flush. A failure leaves that much that can be read.
    pub fn flushed(&self) -> FileTotals {
        self.flushed
    }

    /// Messages so far, those that wait in memory included.
    pub fn messages(&self) -> u64 {
        self.messages
    }

    /// Writes the index and the footer, which say that the log is complete.
    ///
    /// # Errors
    /// [`LogError::Write`].
    pub fn finish(mut self) -> Result<FileTotals, LogError> {
        self.check()?;
        let result = self.writer.finish().map(|_| ());
        self.settle(result)?;
        Ok(FileTotals { bytes: self.state.bytes(), messages: self.messages })
    }

    /// The first failure, if there was one.
    fn check(&self) -> Result<(), LogError> {
        match self.state.failure() {
            None => Ok(()),
            Some(cause) => {
                Err(LogError::Write { log: self.log.clone(), bytes: self.state.bytes(), cause: cause.to_owned() })
            }
        }
    }

    /// Makes a failure of the mcap writer final.
    fn settle(&self, result: Result<(), McapError>) -> Result<(), LogError> {
        result.map_err(|cause| write_error(&self.log, &self.state, cause))
    }
}

/// Records a failure in the sink and words it by the first one.
fn write_error(log: &str, state: &SinkState, cause: McapError) -> LogError {
    // If the sink failed, its own words are there already and say more than these.
    state.fail(io::ErrorKind::Other, with_sources(&cause));
    LogError::Write { log: log.to_owned(), bytes: state.bytes(), cause: state.failure().unwrap_or_default().to_owned() }
}

/// An error's text with that of its causes, which the mcap crate does not repeat.
pub(super) fn with_sources(error: &dyn Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text.push_str(": ");
        text.push_str(&cause.to_string());
        source = cause.source();
    }
    text
}

fn check_options(options: &LogOptions) -> Result<(), LogError> {
    if (MIN_CHUNK_TARGET_BYTES..=MAX_CHUNK_TARGET_BYTES).contains(&options.chunk_bytes) {
        return Ok(());
    }
    Err(LogError::Option {
        option: "chunk_bytes",
        value: options.chunk_bytes,
        low: MIN_CHUNK_TARGET_BYTES,
        high: MAX_CHUNK_TARGET_BYTES,
    })
}

fn check_size(what: &str, bytes: usize, limit: u64) -> Result<(), LogError> {
    let bytes = bytes as u64;
    if bytes <= limit {
        return Ok(());
    }
    Err(LogError::TooLarge { what: what.to_owned(), bytes, limit })
}

fn write_options(options: &LogOptions) -> WriteOptions {
    WriteOptions::new()
        .profile("ros2")
        .library(concat!("adagio ", env!("CARGO_PKG_VERSION")))
        .compression(match options.compression {
            Compression::Zstd => Some(mcap::Compression::Zstd),
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::None => None,
        })
        // In the calling thread: the writer is an actor with a thread of its own already.
        .compression_threads(0)
        // Chunks are closed by `write_encoded`.
        .chunk_size(None)
        // By default a chunk's length is written after its data, and a killed run leaves 2⁶⁴ − 1.
        .disable_seeking(true)
}

fn add_channels<W: Write>(writer: &mut mcap::Writer<NoSeek<W>>) -> Result<BTreeMap<&'static str, u16>, McapError> {
    let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), QUALITY_OF_SERVICE.to_owned())]);
    topics::ALL
        .iter()
        .map(|topic| {
            let schema = writer.add_schema(topic.message, "ros2msg", topic.definition.concat().as_bytes())?;
            let channel = writer.add_channel(schema, topic.name, "cdr", &metadata)?;
            Ok((topic.name, channel))
        })
        .collect()
}
