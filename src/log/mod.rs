//! The log: one or more MCAP files per run, which other tools of robotics open as it is.
//!
//! The profile is `ros2`: each channel holds CDR bodies, and the full text of its message
//! definition is in the file. Nothing has to be configured to read it elsewhere.
//!
//! ```text
//!  message ──cdr──▶ run ──▶ writer ──chunks──▶ file ──▶ reader ──records──▶ cdr ──▶ message
//!     messages       files      topics: which message is on which topic      summary
//! ```
//!
//! - [`messages`]: the message types and their definitions.
//! - [`cdr`]: a message as bytes and back, safe on hostile bytes.
//! - [`topics`]: the table of topics; a topic fixes its message type at compile time.
//! - [`run`]: the files of a run: rotation, a disk budget, a new file after a failure.
//! - [`expected`]: what a run that is repeated must log again.
//! - [`writer`]: append only, so that a killed process leaves a log that can be read.
//! - [`files`]: the files of a run as one.
//! - [`reader`]: bounded memory, never a panic, goes on after a damaged chunk.
//! - [`mod@recover`]: a clean file from a damaged one.
//! - [`summary`]: what is in a log, in one pass.

pub mod cdr;
pub mod error;
pub mod expected;
pub mod files;
pub mod messages;
pub mod reader;
pub mod recover;
pub mod run;
pub mod summary;
pub mod topics;
pub mod writer;

pub use error::LogError;
pub use expected::{Difference, Expected};
pub use files::{FilesReader, newest};
pub use messages::Message;
pub use reader::{Channel, Ending, LogReader, Record};
pub use recover::{Recovered, recover, recover_into};
pub use run::{Folder, NullStorage, Rotation, RunLog, RunTotals, Storage, log_files};
pub use summary::{LogSummary, summarise};
pub use topics::Topic;
pub use writer::{Compression, FileTotals, LogOptions, LogWriter};

/// Largest message body, bytes. The writer refuses more; a 2048 × 2048 RGB image fits.
pub const MAX_MESSAGE_BYTES: u64 = 16 << 20;

/// Largest target size of a chunk before compression, bytes.
pub const MAX_CHUNK_TARGET_BYTES: u64 = 16 << 20;

/// Largest record other than an attachment that the reader accepts, bytes.
///
/// A chunk exceeds its target by at most one message, so this is twice what the writer produces.
/// It bounds the reader's memory: one compressed and one decompressed chunk.
pub const MAX_RECORD_BYTES: u64 = 64 << 20;

/// Largest attachment, bytes. The largest part of a checkpoint with 8 000 support vectors, a square
/// matrix of them, has 512 MB.
pub const MAX_ATTACHMENT_BYTES: u64 = 1 << 30;
