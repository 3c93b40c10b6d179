//! The records of a file as they lie in it: a kind, a length, a body.

use std::io::{self, Read, Seek, SeekFrom};

use mcap::{MAGIC, records::op};

use super::{chunk, lengths::HEAD};
use crate::log::{MAX_ATTACHMENT_BYTES, MAX_RECORD_BYTES};

/// What comes next in a file.
pub(super) enum Next {
    /// A record, which is now in [`Frames::record`].
    Record,
    /// The end of a complete log.
    Complete,
    /// The end of the file where a record could start.
    NoFooter,
    /// The file cannot be followed further.
    Lost(String),
    /// The operating system failed.
    Failed(io::Error),
}

/// Steps through a file's records, with one of them in memory.
pub(super) struct Frames<R> {
    pub(super) source: R,
    /// Where the current record starts, bytes from the start of the file.
    pub(super) offset: u64,
    /// Where the next one does.
    next_offset: u64,
    /// The current record with its head.
    pub(super) record: Vec<u8>,
    /// Where a record starts that did not add up: its length may be wrong, and with it all that seemed to follow.
    doubtful: Option<u64>,
    /// Attachments are stepped over and not loaded.
    pub(super) skip_attachments: bool,
}

impl<R: Read> Frames<R> {
    pub(super) fn new(source: R) -> Self {
        Self { source, offset: 0, next_offset: 0, record: Vec::new(), doubtful: None, skip_attachments: false }
    }

    /// The current record does not add up.
    pub(super) fn doubt(&mut self) {
        self.doubtful.get_or_insert(self.offset);
    }

    /// The current record adds up, and so the ones before it ended where they said.
    pub(super) fn trust(&mut self) {
        self.doubtful = None;
    }

    /// Kind and body of the current record.
    pub(super) fn parts(&self) -> (u8, &[u8]) {
        match self.record.split_at_checked(HEAD) {
            Some((head, body)) => (head[0], body),
            None => (0, &[]),
        }
    }

    /// Steps to the next record.
    pub(super) fn advance(&mut self) -> Next {
        match self.step() {
            Ok(next) => next,
            Err(cause) => Next::Failed(cause),
        }
    }

    fn step(&mut self) -> io::Result<Next> {
        if self.next_offset == 0 {
            match self.fill(MAGIC.len() as u64)? {
                0 => return Ok(Next::NoFooter),
                _ if self.record == MAGIC => {}
                _ => {
                    let cause = "it does not start with the eight bytes of an MCAP file";
                    return Ok(Next::Lost(cause.into()));
                }
            }
        } else if self.parts().0 == op::FOOTER {
            return self.end();
        }
        loop {
            let found = self.fill(HEAD as u64)?;
            let Ok(head) = <[u8; HEAD]>::try_from(self.record.as_slice()) else {
                return Ok(match found {
                    0 => Next::NoFooter,
                    _ => Next::Lost(format!("the file ends after {found} bytes of a record")),
                });
            };
            let [kind, length @ ..] = head;
            let length = u64::from_le_bytes(length);
            let limit = match kind {
                // Neither is ever written: whatever stands here is no record.
                0 | 0x10..=0x7f => {
                    return Ok(Next::Lost(format!("{kind:#04x} is no kind of record")));
                }
                // Kinds of other programs' own: rather a wrong length before.
                0x80.. if self.doubtful.is_some() => {
                    return Ok(Next::Lost(format!("a record of kind {kind:#04x} follows one that does not add up")));
                }
                op::ATTACHMENT => MAX_ATTACHMENT_BYTES,
                _ => MAX_RECORD_BYTES,
            };
            if length > limit {
                return Ok(Next::Lost(format!(
                    "a record of kind {kind:#04x} claims {length} bytes, more than the limit of {limit}"
                )));
            }
            let skip = self.skip_attachments && kind == op::ATTACHMENT;
            let body = if skip {
                let copied = io::copy(&mut self.source.by_ref().take(length), &mut io::sink())?;
                self.next_offset += copied;
                copied
            } else {
                self.append(length)?
            };
            if body < length {
                return Ok(Next::Lost(format!("the file ends after {body} of a record's {length} bytes")));
            }
            if !skip {
                return Ok(Next::Record);
            }
        }
    }

    /// What follows the footer: the eight bytes again, and nothing more.
    fn end(&mut self) -> io::Result<Next> {
        self.fill(MAGIC.len() as u64)?;
        if self.record != MAGIC {
            let cause = "the eight bytes that end an MCAP file are missing after the footer";
            return Ok(Next::Lost(cause.into()));
        }
        Ok(match self.fill(1)? {
            0 => Next::Complete,
            _ => Next::Lost("there are bytes after the end of the log".into()),
        })
    }

    /// Reads the next bytes in place of the record; fewer only at the end of the file.
    fn fill(&mut self, length: u64) -> io::Result<u64> {
        self.record.clear();
        self.offset = self.next_offset;
        self.append(length)
    }

    /// Adds bytes to the record. Memory grows with what is read and not with what is claimed.
    fn append(&mut self, length: u64) -> io::Result<u64> {
        let read = self.source.by_ref().take(length).read_to_end(&mut self.record)? as u64;
        self.next_offset += read;
        Ok(read)
    }
}

/// Bytes of a footer's record and of what follows it.
const TAIL: u64 = HEAD as u64 + 20 + MAGIC.len() as u64;

/// Bytes of a summary that are looked at. Definitions come first in it, the index of chunks last.
const MOST_SUMMARY: u64 = 1 << 20;

/// Bytes that are looked through at a time.
const LOOK_THROUGH: usize = 1 << 16;

/// The records that lie in some bytes, as far as they are whole: kind and body.
pub(super) fn records_in(mut bytes: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    std::iter::from_fn(move || {
        let (&[kind, ref length @ ..], rest) = bytes.split_first_chunk::<HEAD>()?;
        let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
        let (body, rest) = rest.split_at_checked(length)?;
        bytes = rest;
        Some((kind, body))
    })
}

impl<R: Read + Seek> Frames<R> {
    /// The summary at the end of a closed file, or its beginning; empty if there is none. The next record is the first again.
    pub(super) fn summary(&mut self) -> io::Result<Vec<u8>> {
        let Ok(size) = self.source.seek(SeekFrom::End(0)) else { return Ok(Vec::new()) };
        let mut summary = Vec::new();
        if let Some(tail_at) = size.checked_sub(TAIL) {
            self.source.seek(SeekFrom::Start(tail_at))?;
            let mut tail = Vec::new();
            self.source.by_ref().take(TAIL).read_to_end(&mut tail)?;
            let start = tail.get(HEAD..HEAD + 8).and_then(|bytes| bytes.try_into().ok()).map_or(0, u64::from_le_bytes);
            if tail.first() == Some(&op::FOOTER) && tail.ends_with(MAGIC) && (1..tail_at).contains(&start) {
                self.source.seek(SeekFrom::Start(start))?;
                self.source.by_ref().take(MOST_SUMMARY.min(tail_at - start)).read_to_end(&mut summary)?;
            }
        }
        self.source.seek(SeekFrom::Start(0))?;
        Ok(summary)
    }

    /// Look for a chunk behind the start of the current record, or of the doubtful one that led to it, and step to it. Whether
    /// there is one.
    pub(super) fn find_chunk(&mut self) -> io::Result<bool> {
        let mut start = self.doubtful.take().unwrap_or(self.offset) + 1;
        let size = self.source.seek(SeekFrom::End(0))?;
        self.source.seek(SeekFrom::Start(start))?;
        let mut window = Vec::new();
        loop {
            let read = self.source.by_ref().take(LOOK_THROUGH as u64).read_to_end(&mut window)?;
            let found = (0..window.len()).find(|&at| {
                let left = size - (start + at as u64);
                window[at] == op::CHUNK && chunk::could_start(&window[at..], left)
            });
            if let Some(at) = found {
                self.next_offset = start + at as u64;
                self.offset = self.next_offset;
                self.record.clear();
                self.source.seek(SeekFrom::Start(self.next_offset))?;
                return Ok(true);
            }
            if read == 0 {
                return Ok(false);
            }
            // The last bytes may be the beginning of a head that continues in the next part.
            let done = window.len().saturating_sub(HEAD + chunk::LONGEST_HEADER);
            window.drain(..done);
            start += done as u64;
        }
    }
}
