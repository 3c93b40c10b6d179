//! What is in a log, in one pass and bounded memory.

use std::{collections::BTreeMap, path::Path};

use super::messages::Health;
use super::{Ending, FilesReader, LogError, Record, topics};

/// Holes that a summary lists one by one; further ones are only counted.
pub const MOST_HOLES: usize = 1000;

/// Frames that are missing between two observations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameGap {
    /// Sequence number before the hole.
    pub after: u32,
    /// Sequence number behind it.
    pub before: u32,
}

/// A step forward is longer than this many times the one before, and than a second.
const LONG_STEP: u64 = 100;

/// What is in a log.
#[derive(Clone, Debug, Default, PartialEq)]
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
    pub holes: Vec<FrameGap>,
    /// Observations missing in all holes, listed or not.
    pub missing: u64,
    /// Observations whose sequence number is not above the one before.
    pub out_of_order: u64,
    /// Sequence numbers of the first and the last observation.
    pub observations: Option<(u32, u32)>,
    /// How often the clock goes backwards, or forward much further than before; at most [`MOST_HOLES`].
    pub clock_steps: usize,
    /// Frames that the source dropped, up to the end of this file.
    pub dropped: u64,
}

/// Reads a log from start to end and sums up what is in it. Damage is part of the result.
///
/// # Errors
/// [`LogError::Open`] and [`LogError::Read`].
pub fn summarise(path: &Path) -> Result<LogSummary, LogError> {
    let about = std::fs::metadata(path).map_err(|cause| LogError::Open { log: path.display().to_string(), cause })?;
    let mut summary = LogSummary { bytes: about.len(), ..LogSummary::default() };
    let (mut records, mut clock) = (FilesReader::new(vec![path.to_owned()]), Clock::default());
    for record in records.by_ref() {
        match record {
            Ok(record @ Record::Message { .. }) => summary.message(&record, &mut clock),
            Ok(Record::Metadata { name, map }) => drop(summary.metadata.insert(name, map)),
            Ok(Record::Attachment { .. }) => {}
            Err(error @ (LogError::Open { .. } | LogError::Read { .. })) => return Err(error),
            Err(_) => summary.damaged += 1,
        }
    }
    summary.ending = records.endings().first().cloned().unwrap_or_default();
    Ok(summary)
}

/// The stamps of the last observations.
#[derive(Default)]
struct Clock {
    last: Option<(u32, u64)>,
    step_ns: Option<u64>,
}

impl LogSummary {
    fn message(&mut self, record: &Record, clock: &mut Clock) {
        let Record::Message { topic, sequence, log_time_ns, .. } = record else { return };
        self.count(topic, *log_time_ns);
        if **topic == *topics::HEALTH.name()
            && let Ok(health) = record.decode::<Health>()
        {
            self.dropped = self.dropped.max(health.dropped_frames);
        }
        if **topic != *topics::OBSERVATION.name() {
            return;
        }
        let last = clock.last.replace((*sequence, *log_time_ns));
        self.follow(last.map(|(sequence, _)| sequence), *sequence);
        self.observations = Some((self.observations.map_or(*sequence, |(first, _)| first), *sequence));
        let Some((after, from_ns)) = last else { return };
        let step = log_time_ns.checked_sub(from_ns);
        // Frames that are missing take their time, too.
        let frames = u64::from(sequence.wrapping_sub(after)).max(1);
        let usual =
            clock.step_ns.map_or(u64::MAX, |usual| usual.max(1).saturating_mul(LONG_STEP).saturating_mul(frames));
        let jumps = step.is_none_or(|step| step > usual && step > 1_000_000_000);
        if jumps {
            self.clock_steps = MOST_HOLES.min(self.clock_steps + 1);
        } else {
            clock.step_ns = step.map(|step| step / frames);
        }
    }

    fn count(&mut self, topic: &str, stamp_ns: u64) {
        match self.messages.get_mut(topic) {
            Some(count) => *count += 1,
            None => drop(self.messages.insert(topic.to_owned(), 1)),
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
                    self.holes.push(FrameGap { after: last, before: sequence });
                }
            }
        }
    }
}
