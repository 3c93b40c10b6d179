//! The records inside a chunk: decompressed and checked by the mcap crate, which is only ever
//! shown a chunk whose frame adds up.

use mcap::{
    parse_record,
    records::{Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use super::lengths::{self, HEAD};
use crate::log::{MAX_RECORD_BYTES, writer::with_sources};

/// Bytes of a chunk's header without the name of its compression.
const HEADER: u64 = 8 + 8 + 8 + 4 + 4 + 8;

/// The longest name of a compression that is looked for.
const LONGEST_NAME: usize = 8;

/// Bytes of a chunk's header at most, as far as [`could_start`] looks.
pub(super) const LONGEST_HEADER: usize = HEADER as usize + LONGEST_NAME;

/// Whether bytes look like the head of a chunk: its sizes add up. `left`: bytes up to the end of the file.
pub(super) fn could_start(bytes: &[u8], left: u64) -> bool {
    let number = |at: usize| Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?));
    let fits = || {
        let length = number(1)?;
        let name_at = HEAD + 8 + 8 + 8 + 4;
        let name = u32::from_le_bytes(bytes.get(name_at..name_at + 4)?.try_into().ok()?) as usize;
        let compressed = (name <= LONGEST_NAME).then(|| number(name_at + 4 + name)).flatten()?;
        let whole = length <= MAX_RECORD_BYTES && HEAD as u64 + length <= left;
        // Any bytes may stand where the size is looked for.
        Some(whole && (HEADER + name as u64).checked_add(compressed)? == length)
    };
    bytes.first() == Some(&op::CHUNK) && fits() == Some(true)
}

/// The chunk that is being read.
pub(super) struct Chunk {
    reader: LinearReader,
    /// The chunk's record in the file, and how much of it the reader was given.
    record: Vec<u8>,
    given: usize,
    /// Bytes of records that were promised, and that were seen.
    promised: u64,
    seen: u64,
}

impl Chunk {
    /// No chunk.
    pub(super) fn none() -> Self {
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(MAX_RECORD_BYTES as usize);
        let reader = LinearReader::new_with_options(options);
        Self { reader, record: Vec::new(), given: 0, promised: 0, seen: 0 }
    }

    /// Starts on a chunk, given as its record in the file. The error says what is wrong.
    pub(super) fn start(&mut self, record: &[u8]) -> Result<(), String> {
        self.promised = check(record.get(HEAD..).unwrap_or_default())?;
        self.record.clear();
        self.record.extend_from_slice(record);
        self.given = 0;
        self.seen = 0;
        Ok(())
    }

    /// Hands the next record to `visit` and returns what that returns; `None` after the last.
    /// After an error of the chunk itself there is no next record.
    pub(super) fn next<T>(&mut self, mut visit: impl FnMut(u8, &[u8]) -> T) -> Option<Result<T, String>> {
        loop {
            let left = &self.record[self.given..];
            let wanted = match self.reader.next_event() {
                Some(Ok(LinearReadEvent::Record { opcode, data })) => {
                    self.seen += (HEAD + data.len()) as u64;
                    return Some(Ok(visit(opcode, data)));
                }
                Some(Ok(LinearReadEvent::ReadRequest(wanted))) => wanted,
                Some(Err(cause)) => return Some(Err(self.abandon(with_sources(&cause)))),
                None => return Some(Err(self.abandon("it ends the file".into()))),
            };
            if left.is_empty() {
                if self.seen == self.promised {
                    return None;
                }
                let cause = format!("it holds {} of {} bytes", self.seen, self.promised);
                return Some(Err(self.abandon(cause)));
            }
            let count = wanted.clamp(1, left.len());
            self.reader.insert(count)[..count].copy_from_slice(&left[..count]);
            self.reader.notify_read(count);
            self.given += count;
        }
    }

    /// Forgets the chunk; a fresh reader, since the old one is in the middle of it.
    fn abandon(&mut self, cause: String) -> String {
        *self = Self::none();
        cause
    }
}

/// Checks that a chunk's sizes add up; returns the size of its records.
///
/// The mcap reader believes these sizes where a chunk has no checksum: bytes after the data would
/// be read as part of its last record.
fn check(body: &[u8]) -> Result<u64, String> {
    lengths::check(op::CHUNK, body)?;
    let header = match parse_record(op::CHUNK, body) {
        Ok(Record::Chunk { header, .. }) => header,
        Ok(_) => return Err("it is no chunk".into()),
        Err(cause) => return Err(with_sources(&cause)),
    };
    let size = body.len() as u64;
    let data = size.checked_sub(HEADER + header.compression.len() as u64);
    if data != Some(header.compressed_size) {
        return Err(format!("a chunk of {size} bytes claims {} bytes of data", header.compressed_size));
    }
    if header.uncompressed_size > MAX_RECORD_BYTES {
        return Err(format!(
            "a chunk claims {} bytes of records, more than the limit of {MAX_RECORD_BYTES}",
            header.uncompressed_size
        ));
    }
    if header.compression.is_empty() && header.uncompressed_size != header.compressed_size {
        return Err(format!(
            "an uncompressed chunk claims {} bytes stored and {} bytes of records",
            header.compressed_size, header.uncompressed_size
        ));
    }
    Ok(header.uncompressed_size)
}
