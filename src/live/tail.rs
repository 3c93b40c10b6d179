//! The end of a log file that is still being written.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use mcap::MAGIC;
use mcap::records::op;

use crate::log::{MAX_ATTACHMENT_BYTES, MAX_RECORD_BYTES};

/// Bytes before a record's body: its kind and the body's length.
const HEAD: u64 = 1 + 8;

/// A log file of which only whole records can be read: a record that is being written seems not to be there yet, so that a
/// reader of the log ends between two records, and can go on when there is more.
#[derive(Debug)]
pub struct Tail {
    file: File,
    /// Where the next byte is read, and where the last whole record ends.
    at: u64,
    whole: u64,
    /// Nothing more is waited for: all bytes can be read, also those of a record that stops in its middle.
    sealed: bool,
    /// Its footer is there.
    closed: bool,
    /// Size of the file when it was last looked at.
    size: u64,
}

impl Tail {
    /// Open a file, which need not hold anything yet.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Tail { file: File::open(path)?, at: 0, whole: 0, sealed: false, closed: false, size: 0 })
    }

    /// Nothing will be added to the file any more: a record that stops in its middle is damage. Whether that is news, of a
    /// file that was not closed.
    pub fn seal(&mut self) -> bool {
        !self.closed && !std::mem::replace(&mut self.sealed, true)
    }

    /// Whether the file has a footer: it was closed.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Bytes at the end that are no whole record yet.
    pub fn torn(&self) -> u64 {
        self.size.saturating_sub(self.whole)
    }

    /// Look how far the file can be read by now.
    fn look(&mut self) -> io::Result<()> {
        self.size = self.file.metadata()?.len();
        while !self.sealed && self.whole < self.size {
            let Some(next) = self.next_end()? else { break };
            self.whole = next;
        }
        if self.sealed {
            self.whole = self.size;
        }
        self.file.seek(SeekFrom::Start(self.at))?;
        Ok(())
    }

    /// Where the record after the last whole one ends, if it is all there.
    fn next_end(&mut self) -> io::Result<Option<u64>> {
        let start = self.whole;
        let fits = |end: u64, size: u64| (end <= size).then_some(end);
        if start == 0 {
            return Ok(fits(MAGIC.len() as u64, self.size));
        }
        if start + HEAD > self.size {
            return Ok(None);
        }
        self.file.seek(SeekFrom::Start(start))?;
        let mut head = [0; HEAD as usize];
        self.file.read_exact(&mut head)?;
        let [kind, length @ ..] = head;
        let length = u64::from_le_bytes(length);
        let most = if kind == op::ATTACHMENT { MAX_ATTACHMENT_BYTES } else { MAX_RECORD_BYTES };
        if matches!(kind, 0 | 0x10..=0x7f) || length > most {
            // This is no record: to find the next one is the reader's task.
            self.sealed = true;
            return Ok(None);
        }
        let end = start + HEAD + length;
        // The footer and the eight bytes behind it end the file.
        if kind != op::FOOTER {
            return Ok(fits(end, self.size));
        }
        let end = fits(end + MAGIC.len() as u64, self.size);
        self.closed = end.is_some();
        Ok(end)
    }
}

impl Read for Tail {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.at >= self.whole {
            self.look()?;
        }
        let left = usize::try_from(self.whole.saturating_sub(self.at)).unwrap_or(usize::MAX);
        let most = buffer.len().min(left);
        let read = self.file.read(&mut buffer[..most])?;
        self.at += read as u64;
        Ok(read)
    }
}

impl Seek for Tail {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => {
                self.look()?;
                self.whole.checked_add_signed(by)
            }
        };
        self.at = at.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        self.file.seek(SeekFrom::Start(self.at))
    }
}
