//! Copies what can be read of a damaged or unclosed log into a new file.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, Write};
use std::path::Path;
use std::sync::Arc;

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Attachment, McapError, WriteOptions};

use super::writer::with_sources;
use super::{Channel, Ending, LogError, LogReader, Record};

/// What a recovery found.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Recovered {
    /// Messages copied, by topic.
    pub messages: BTreeMap<String, u64>,
    /// Attachments copied.
    pub attachments: u64,
    /// What could not be read, each with its place; the first [`MOST_LOSSES`].
    pub losses: Vec<String>,
    /// Number of records that could not be read.
    pub lost: u64,
    /// How the damaged log ended.
    pub ending: Ending,
}

/// Losses that are described one by one.
pub const MOST_LOSSES: usize = 100;

/// Size at which a chunk of the new file is closed, bytes.
const CHUNK_BYTES: u64 = 1 << 20;

/// Copy all that can be read of a log of any program into a new file, in its order. Where a record's length is damaged, so
/// that the next record cannot be found, reading goes on at the next chunk.
///
/// # Errors
/// The old file cannot be opened or read, the new one exists or cannot be written.
pub fn recover(from: &Path, to: &Path) -> Result<Recovered, LogError> {
    let reader = LogReader::open(from)?;
    let log = to.display().to_string();
    let file = File::create_new(to).map_err(|cause| LogError::Create { log: log.clone(), cause })?;
    recover_into(reader, file, &log)
}

/// As [`recover`], from a reader that has not begun into any sink; `log` names the sink in errors.
///
/// # Errors
/// The old log cannot be read, or the new one cannot be written.
pub fn recover_into<R: Read + Seek, W: Write>(
    mut reader: LogReader<R>,
    sink: W,
    log: &str,
) -> Result<Recovered, LogError> {
    let mut copy = Copy { log: log.to_owned(), writer: None, sink: Some(sink), channels: BTreeMap::new() };
    let mut found = Recovered::default();
    loop {
        while let Some(record) = reader.next() {
            match record {
                Ok(record) => copy.record(&reader, &record, &mut found)?,
                Err(error @ LogError::Read { .. }) => return Err(error),
                Err(error) => {
                    found.lost += 1;
                    if found.losses.len() < MOST_LOSSES {
                        found.losses.push(error.to_string());
                    }
                }
            }
        }
        if !reader.go_on()? {
            break;
        }
    }
    found.ending = reader.ending().cloned().unwrap_or(Ending::NoFooter);
    copy.writer(&reader)?.finish().map_err(|cause| failed(log, &cause))?;
    Ok(found)
}

type Writer<W> = mcap::Writer<NoSeek<BufWriter<W>>>;

struct Copy<W: Write> {
    log: String,
    writer: Option<Writer<W>>,
    /// The new file, until the old one's profile is known.
    sink: Option<W>,
    /// Channels by their old number, and by topic and type: a damaged definition may use a number again.
    channels: BTreeMap<(u16, Arc<str>, Arc<str>), u16>,
}

impl<W: Write> Copy<W> {
    fn writer<R: Read>(&mut self, reader: &LogReader<R>) -> Result<&mut Writer<W>, LogError> {
        if let Some(file) = self.sink.take() {
            let writer = WriteOptions::new()
                .profile(reader.profile().unwrap_or("ros2"))
                .library(concat!("adagio ", env!("CARGO_PKG_VERSION"), " recover"))
                .compression_threads(0)
                .chunk_size(Some(CHUNK_BYTES))
                .disable_seeking(true)
                .create(NoSeek::new(BufWriter::new(file)))
                .map_err(|cause| failed(&self.log, &cause))?;
            self.writer = Some(writer);
        }
        self.writer.as_mut().ok_or_else(|| LogError::Write {
            log: self.log.clone(),
            bytes: 0,
            cause: "an earlier write failed".to_owned(),
        })
    }

    fn record<R: Read>(
        &mut self,
        reader: &LogReader<R>,
        record: &Record,
        found: &mut Recovered,
    ) -> Result<(), LogError> {
        let log = self.log.clone();
        let failed = |cause: McapError| failed(&log, &cause);
        match record {
            Record::Message { topic, schema, channel, sequence, log_time_ns, publish_time_ns, data, .. } => {
                let key = (*channel, topic.clone(), schema.clone());
                let channel_id = match self.channels.get(&key) {
                    Some(&id) => id,
                    None => {
                        let Some(defined) = reader.channel(*channel) else { return Ok(()) };
                        let writer = self.writer(reader)?;
                        let schema = match defined {
                            // A channel without a schema.
                            Channel { schema: "", definition: [], .. } => 0,
                            _ => writer
                                .add_schema(defined.schema, defined.schema_encoding, defined.definition)
                                .map_err(failed)?,
                        };
                        let id = writer
                            .add_channel(schema, defined.topic, defined.encoding, defined.metadata)
                            .map_err(failed)?;
                        self.channels.insert(key, id);
                        id
                    }
                };
                let (log_time, publish_time, sequence) = (*log_time_ns, *publish_time_ns, *sequence);
                let header = MessageHeader { channel_id, sequence, log_time, publish_time };
                self.writer(reader)?.write_to_known_channel(&header, data).map_err(failed)?;
                *found.messages.entry(topic.to_string()).or_default() += 1;
            }
            Record::Metadata { name, map } => {
                let metadata = Metadata { name: name.clone(), metadata: map.clone() };
                self.writer(reader)?.write_metadata(&metadata).map_err(failed)?;
            }
            Record::Attachment { name, media_type, log_time_ns, create_time_ns, data } => {
                let attachment = Attachment {
                    log_time: *log_time_ns,
                    create_time: *create_time_ns,
                    name: name.clone(),
                    media_type: media_type.clone(),
                    data: data.into(),
                };
                self.writer(reader)?.attach(&attachment).map_err(failed)?;
                found.attachments += 1;
            }
        }
        Ok(())
    }
}

fn failed(log: &str, cause: &McapError) -> LogError {
    LogError::Write { log: log.to_owned(), bytes: 0, cause: with_sources(cause) }
}
