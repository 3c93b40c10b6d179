//! What is in a log, in one pass and bounded memory.

use std::{collections::BTreeMap, path::Path};

use super::{Ending, LogError, LogReader, Record, topics};

/// Holes that a summary lists one by one; further ones are only counted.
pub const MOST_HOLES: usize = 1000;

/// Frames that are missing between two observations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Hole {
    /// Sequence number before the hole.
    pub after: u32,
    /// Sequence number behind it.
    pub before: u32,
}

/// What is in a log.
#[derive(Clone, Debug, PartialEq)]
pub struct LogSummary {
    /// Messages on each topic that has any.
    pub messages: BTreeMap<String, u64>,
    /// Size of the file, bytes.
    pub bytes: u64,
    /// Earliest and latest stamp of a message, nanoseconds.
    pub stamps_ns: Option<(u64, u64)>,
    /// Metadata records by name.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// How it ends.
    pub ending: Ending,
    /// Damaged records.
    pub damaged: u64,
    /// Where observations are missing, by their sequence numbers; at most [`MOST_HOLES`].
    pub holes: Vec<Hole>,
    /// Observations missing in all holes, listed or not.
    pub missing: u64,
    /// Observations whose sequence number is not above the one before.
    pub out_of_order: u64,
}

/// Reads a log from start to end and sums up what is in it. Damage is part of the result.
///
/// # Errors
/// [`LogError::Open`] and [`LogError::Read`].
pub fn summarise(path: &Path) -> Result<LogSummary, LogError> {
    let mut reader = LogReader::open(path)?.without_attachments();
    let mut summary = LogSummary {
        messages: BTreeMap::new(),
        bytes: std::fs::metadata(path)
            .map_err(|cause| LogError::Open { log: path.display().to_string(), cause })?
            .len(),
        stamps_ns: None,
        metadata: BTreeMap::new(),
        ending: Ending::NoFooter,
        damaged: 0,
        holes: Vec::new(),
        missing: 0,
        out_of_order: 0,
    };
    let mut last_observation = None;
    for record in reader.by_ref() {
        match record {
            Ok(Record::Message { topic, sequence, log_time_ns, .. }) => {
                summary.count(&topic, log_time_ns);
                if *topic == *topics::OBSERVATION.name() {
                    summary.follow(last_observation.replace(sequence), sequence);
                }
            }
            Ok(Record::Metadata { name, map }) => {
                summary.metadata.insert(name, map);
            }
            Ok(Record::Attachment { .. }) => {}
            Err(error @ LogError::Read { .. }) => return Err(error),
            Err(_) => summary.damaged += 1,
        }
    }
    if let Some(ending) = reader.ending() {
        summary.ending = ending.clone();
    }
    Ok(summary)
}

impl LogSummary {
    fn count(&mut self, topic: &str, stamp_ns: u64) {
        match self.messages.get_mut(topic) {
            Some(count) => *count += 1,
            None => {
                self.messages.insert(topic.to_owned(), 1);
            }
        }
        let (first, last) = self.stamps_ns.unwrap_or((stamp_ns, stamp_ns));
        self.stamps_ns = Some((first.min(stamp_ns), last.max(stamp_ns)));
    }

    fn follow(&mut self, last: Option<u32>, sequence: u32) {
        let Some(last) = last else { return };
        // Numbers wrap around after 2³²; more than half of that ahead means backwards.
        match sequence.wrapping_sub(last) {
            1 => {}
            0 | 0x8000_0000.. => self.out_of_order += 1,
            ahead => {
                self.missing += u64::from(ahead) - 1;
                if self.holes.len() < MOST_HOLES {
                    self.holes.push(Hole { after: last, before: sequence });
                }
            }
        }
    }
}
