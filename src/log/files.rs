//! Reads the files of a run one after the other.

use std::path::PathBuf;

use super::{Ending, LogError, LogReader, Record};

/// Records of several files, in order; the errors of each are passed on, and reading continues with the next file.
pub struct FilesReader {
    left: std::vec::IntoIter<PathBuf>,
    /// Attachments as well, which may be large.
    attachments: bool,
    reader: Option<LogReader>,
    endings: Vec<Ending>,
}

impl FilesReader {
    /// A reader of these files, without their attachments.
    pub fn new(files: Vec<PathBuf>) -> Self {
        FilesReader { left: files.into_iter(), attachments: false, reader: None, endings: Vec::new() }
    }

    /// How each file that was read ended.
    pub fn endings(&self) -> &[Ending] {
        &self.endings
    }
}

impl Iterator for FilesReader {
    type Item = Result<Record, LogError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(reader) = &mut self.reader {
                if let Some(item) = reader.next() {
                    return Some(item);
                }
                match reader.go_on() {
                    Ok(true) => continue,
                    Ok(false) => {}
                    Err(error) => {
                        self.reader = None;
                        return Some(Err(error));
                    }
                }
                self.endings.extend(reader.ending().cloned());
                self.reader = None;
            }
            match LogReader::open(&self.left.next()?) {
                Ok(reader) if self.attachments => self.reader = Some(reader),
                Ok(reader) => self.reader = Some(reader.without_attachments()),
                Err(error) => return Some(Err(error)),
            }
        }
    }
}

/// The newest attachment of a name in log files, also behind damage, and the file that holds it; `warn` is told of damage.
pub fn newest(files: Vec<PathBuf>, wanted: &str, warn: impl Fn(&LogError)) -> Option<(Vec<u8>, PathBuf)> {
    files.into_iter().rev().find_map(|path| {
        let records = FilesReader { attachments: true, ..FilesReader::new(vec![path.clone()]) };
        let found = records.filter_map(|record| match record.inspect_err(&warn) {
            Ok(Record::Attachment { name, data, .. }) if name == wanted => Some(data),
            _ => None,
        });
        found.last().map(|bytes| (bytes, path))
    })
}
