//! Reads a log, also a damaged or unfinished one, record by record.
//!
//! Memory is bounded by one record (see [`MAX_RECORD_BYTES`](super::MAX_RECORD_BYTES)) whatever
//! the file says. No bytes make it panic. A damaged chunk costs that chunk: it is reported as an
//! error, and reading goes on behind it as long as the file's records can be told apart.

mod chunk;
mod definitions;
mod frames;
mod lengths;

use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufReader, Read, Seek},
    path::Path,
    sync::Arc,
};

use mcap::records::op;

use self::{
    chunk::Chunk,
    definitions::Definitions,
    frames::{Frames, Next, records_in},
};
use super::{LogError, Message, cdr};

/// A record of a log.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A message.
    Message {
        /// Its topic.
        topic: Arc<str>,
        /// Its type, for example `sensor_msgs/msg/Image`.
        schema: Arc<str>,
        /// Its channel within this file: [`LogReader::channel`].
        channel: u16,
        /// Its sequence number on the topic.
        sequence: u32,
        /// When it was logged, nanoseconds.
        log_time_ns: u64,
        /// When it was made, nanoseconds.
        publish_time_ns: u64,
        /// Its body, CDR.
        data: Vec<u8>,
    },
    /// Texts about the run.
    Metadata {
        /// Name of the record.
        name: String,
        /// Keys and values.
        map: BTreeMap<String, String>,
    },
    /// A file within the log.
    Attachment {
        /// Its name.
        name: String,
        /// Its kind, for example `application/json`.
        media_type: String,
        /// When it was logged, nanoseconds.
        log_time_ns: u64,
        /// When it was made, nanoseconds.
        create_time_ns: u64,
        /// Its content.
        data: Vec<u8>,
    },
}

/// A channel, as the file defines it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Channel<'a> {
    /// Its topic.
    pub topic: &'a str,
    /// How its messages are encoded, for example `cdr`.
    pub encoding: &'a str,
    /// Texts about it.
    pub metadata: &'a BTreeMap<String, String>,
    /// The type of its messages; empty if the channel has no schema.
    pub schema: &'a str,
    /// The language of the definition, for example `ros2msg`.
    pub schema_encoding: &'a str,
    /// The definition of the type.
    pub definition: &'a [u8],
}

impl Record {
    /// Decodes a message.
    ///
    /// # Errors
    /// [`LogError::WrongType`] if the record is no message or one of another type,
    /// [`LogError::Decode`] if its bytes are not such a message.
    pub fn decode<M: Message>(&self) -> Result<M, LogError> {
        let (record, found) = match self {
            Self::Message { schema, data, .. } if **schema == *M::TYPE => return cdr::decode(data),
            Self::Message { topic, schema, sequence, .. } => {
                (format!("message {sequence} on {topic}"), schema.to_string())
            }
            Self::Metadata { name, .. } => (format!("record {name}"), "metadata".to_owned()),
            Self::Attachment { name, media_type, .. } => {
                (format!("record {name}"), format!("an attachment of type {media_type}"))
            }
        };
        Err(LogError::WrongType { record, found, wanted: M::TYPE })
    }
}

/// How a log ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// It was finished, and all of it was read.
    Complete,
    /// It stops between two records: the run was killed, or is still going on.
    #[default]
    NoFooter,
    /// Bytes are wrong or missing. What came before was read, and as much as possible behind.
    Damaged {
        /// Where the first damaged record starts, bytes from the start of the file.
        offset: u64,
        /// What is wrong with it.
        cause: String,
    },
}

/// Reads a log; iterate over it.
///
/// An error is no end: the iterator goes on behind it where it can, and ends when it cannot.
pub struct LogReader<R = BufReader<File>> {
    log: String,
    frames: Frames<R>,
    chunk: Chunk,
    in_chunk: bool,
    definitions: Definitions,
    damage: Option<Ending>,
    ending: Option<Ending>,
    /// It ended where the file could not be followed further.
    lost: bool,
    /// It ended between two records, where a file that is still being written goes on.
    paused: bool,
}

impl LogReader {
    /// Opens a log file.
    ///
    /// # Errors
    /// [`LogError::Open`]. That it is no log shows as damage when it is read.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let log = path.display().to_string();
        match File::open(path) {
            Ok(file) => Self::new(BufReader::with_capacity(1 << 16, file), &log).with_summary(),
            Err(cause) => Err(LogError::Open { log, cause }),
        }
    }
}

impl<R: Read> LogReader<R> {
    /// Reads a log from anywhere; `log` names it in errors.
    pub fn new(source: R, log: &str) -> Self {
        Self {
            log: log.to_owned(),
            frames: Frames::new(source),
            chunk: Chunk::none(),
            in_chunk: false,
            definitions: Definitions::default(),
            damage: None,
            ending: None,
            lost: false,
            paused: false,
        }
    }

    /// Steps over attachments, which may be large.
    #[must_use]
    pub fn without_attachments(mut self) -> Self {
        self.frames.skip_attachments = true;
        self
    }

    /// Where the log is read from.
    pub fn source(&mut self) -> &mut R {
        &mut self.frames.source
    }

    /// A channel that was defined so far.
    pub fn channel(&self, id: u16) -> Option<Channel<'_>> {
        self.definitions.channel(id)
    }

    /// The profile that the file's header names, once that was read.
    pub fn profile(&self) -> Option<&str> {
        self.definitions.profile.as_deref()
    }

    /// How the log ended; `None` until the iterator has.
    pub fn ending(&self) -> Option<&Ending> {
        self.ending.as_ref()
    }

    /// After the iterator has ended between two records: the file may have grown, and the iterator goes on where it stopped.
    pub fn look_again(&mut self) {
        if std::mem::take(&mut self.paused) {
            self.ending = None;
        }
    }

    /// Notes damage at the current record; the first one becomes the ending.
    fn damaged(&mut self, cause: String) -> LogError {
        let offset = self.frames.offset;
        self.damage.get_or_insert_with(|| Ending::Damaged { offset, cause: cause.clone() });
        LogError::Damaged { log: self.log.clone(), offset, cause }
    }

    fn end(&mut self, ending: Ending) {
        self.ending = Some(self.damage.clone().unwrap_or(ending));
    }

    /// The next record of the open chunk that is for the user; `None` at the chunk's end.
    fn next_in_chunk(&mut self) -> Option<Result<Record, LogError>> {
        while self.in_chunk {
            let definitions = &mut self.definitions;
            match self.chunk.next(|kind, body| definitions.take(kind, body)) {
                Some(Ok(Ok(Some(record)))) => return Some(Ok(record)),
                Some(Ok(Ok(None))) => {}
                // One record is wrong, but the chunk can be followed.
                Some(Ok(Err(cause))) => return Some(Err(self.damaged(cause))),
                Some(Err(cause)) => {
                    self.in_chunk = false;
                    return Some(Err(self.damaged(cause)));
                }
                None => self.in_chunk = false,
            }
        }
        None
    }
}

impl<R: Read + Seek> LogReader<R> {
    /// Before the first record: read definitions from the summary of a closed file, too. Where their own chunk is damaged,
    /// the messages can be read all the same.
    ///
    /// # Errors
    /// [`LogError::Read`].
    pub fn with_summary(mut self) -> Result<Self, LogError> {
        let summary = self.frames.summary();
        let summary = summary.map_err(|cause| LogError::Read { log: self.log.clone(), offset: 0, cause })?;
        for (kind, body) in records_in(&summary).filter(|(kind, _)| [op::SCHEMA, op::CHANNEL].contains(kind)) {
            // Not needed unless the definition itself is missing, which is complained of then.
            let _ = self.definitions.take(kind, body);
        }
        Ok(self)
    }

    /// After the iterator has ended where the file could not be followed further: look for the next chunk behind that place and
    /// go on there, with what was defined before. Whether one was found; the damage stays the log's ending.
    ///
    /// # Errors
    /// [`LogError::Read`].
    pub fn go_on(&mut self) -> Result<bool, LogError> {
        if !self.lost {
            return Ok(false);
        }
        let failed = |offset, cause| LogError::Read { log: self.log.clone(), offset, cause };
        let offset = self.frames.offset;
        let found = self.frames.find_chunk().map_err(|cause| failed(offset, cause))?;
        if found {
            (self.lost, self.ending) = (false, None);
        }
        Ok(found)
    }
}

impl<R: Read> Iterator for LogReader<R> {
    type Item = Result<Record, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.ending.is_none() {
            if let Some(item) = self.next_in_chunk() {
                return Some(item);
            }
            match self.frames.advance() {
                Next::Record => {}
                Next::Complete => {
                    self.end(Ending::Complete);
                    continue;
                }
                Next::NoFooter => {
                    self.paused = true;
                    self.end(Ending::NoFooter);
                    continue;
                }
                Next::Lost(cause) => {
                    let error = self.damaged(cause);
                    self.lost = true;
                    self.end(Ending::NoFooter);
                    return Some(Err(error));
                }
                Next::Failed(cause) => {
                    let offset = self.frames.offset;
                    self.damaged(cause.to_string());
                    self.end(Ending::NoFooter);
                    let log = self.log.clone();
                    return Some(Err(LogError::Read { log, offset, cause }));
                }
            }
            let (kind, body) = self.frames.parts();
            let taken = if kind == op::CHUNK {
                let started = self.chunk.start(&self.frames.record);
                self.in_chunk = started.is_ok();
                started.map(|()| None)
            } else {
                self.definitions.take(kind, body)
            };
            match taken {
                Ok(Some(record)) => {
                    self.frames.trust();
                    return Some(Ok(record));
                }
                Ok(None) if self.in_chunk => self.frames.trust(),
                Ok(None) => {}
                Err(cause) => {
                    self.frames.doubt();
                    return Some(Err(self.damaged(cause)));
                }
            }
        }
        None
    }
}
