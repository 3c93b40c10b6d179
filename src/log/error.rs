//! What can go wrong with a log, with the numbers that a person needs to act on it.

use std::io;

/// An error of writing, reading, encoding or decoding a log.
///
/// `log` is the path of the file, or the name that was given to another sink or source.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The log could not be created; the file may exist already.
    #[error(
        "cannot create the log {log}: {cause} (an existing log is never overwritten: choose another name, or move it away)"
    )]
    Create {
        /// The log.
        log: String,
        /// What the operating system said.
        cause: io::Error,
    },
    /// An option of the writer is outside its range.
    #[error(
        "log option {option} is {value}, but it must be between {low} and {high}: change it in the section [log] of the scenario"
    )]
    Option {
        /// The name of the option.
        option: &'static str,
        /// Its value.
        value: u64,
        /// The smallest value allowed.
        low: u64,
        /// The largest value allowed.
        high: u64,
    },
    /// Writing failed, now or earlier; nothing can be added to this log any more.
    #[error(
        "writing the log {log} failed after {bytes} bytes: {cause} (what was written before can be read; free space if the disk is full, then go on in a new log file)"
    )]
    Write {
        /// The log.
        log: String,
        /// Bytes that the operating system had accepted.
        bytes: u64,
        /// The first failure, also when a later call reports it.
        cause: String,
    },
    /// A run that goes on does not repeat what its log holds.
    #[error(
        "message {sequence} on {topic} is not the one that the log holds: this program does not repeat the run (was it recorded \
         by another version?); `adagio replay --verify` names the first difference"
    )]
    Differs {
        /// The topic.
        topic: &'static str,
        /// Sequence number of the message.
        sequence: u32,
    },
    /// A topic that is not in the table of topics.
    #[error("topic {topic} is not one of this log's channels: add it to `log::topics`")]
    UnknownTopic {
        /// The topic.
        topic: String,
    },
    /// A message or an attachment is larger than readers accept.
    #[error(
        "{what} has {bytes} bytes, more than the {limit} that a reader accepts: make it smaller or store it in a file of its own"
    )]
    TooLarge {
        /// What was to be written.
        what: String,
        /// Its size, bytes.
        bytes: u64,
        /// The limit, bytes.
        limit: u64,
    },
    /// A log could not be opened.
    #[error("cannot open the log {log}: {cause}")]
    Open {
        /// The log.
        log: String,
        /// What the operating system said.
        cause: io::Error,
    },
    /// The operating system failed to read.
    #[error("reading the log {log} failed at byte {offset}: {cause} (check the disk, then read again)")]
    Read {
        /// The log.
        log: String,
        /// Where in the file.
        offset: u64,
        /// What the operating system said.
        cause: io::Error,
    },
    /// The log's bytes contradict the format or their checksums.
    #[error(
        "the log {log} is damaged at byte {offset}: {cause} (`adagio recover` copies what can be read into a new file)"
    )]
    Damaged {
        /// The log.
        log: String,
        /// Where in the file the damaged record starts.
        offset: u64,
        /// What is wrong with it.
        cause: String,
    },
    /// A message could not be written as CDR.
    #[error("cannot encode a {message}: {cause}")]
    Encode {
        /// The message type.
        message: &'static str,
        /// Why.
        cause: String,
    },
    /// Bytes are not a message of the type asked for.
    #[error(
        "cannot decode {bytes} bytes as {message}: {cause} (they are damaged, or were written with another definition of that message)"
    )]
    Decode {
        /// The message type.
        message: &'static str,
        /// Number of bytes given.
        bytes: usize,
        /// Why.
        cause: String,
    },
    /// A record holds another type than the one asked for.
    #[error("{record} holds {found}, not {wanted}: look at the record's schema before decoding it")]
    WrongType {
        /// The record, in words.
        record: String,
        /// The type it has.
        found: String,
        /// The type asked for.
        wanted: &'static str,
    },
}
