//! Why a run ends early.

use thiserror::Error;

use super::runtime::checkpoint::CheckpointError;
use crate::kernel::KernelError;
use crate::log::LogError;
use crate::slow::SlowError;
use crate::snapshot::SnapshotError;

/// Why a run ended early.
#[derive(Debug, Error)]
pub enum RunError {
    /// Learning refused.
    #[error(transparent)]
    Learn(#[from] LearnError),
    /// The log could not be written.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The checkpoint could not be made.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// The state that the run was to go on from cannot be used.
    #[error("the state of the run cannot be used: {0}")]
    State(#[from] SnapshotError),
    /// A thread could not be started.
    #[error("cannot start a thread: {0}")]
    Thread(std::io::Error),
    /// An actor panicked: a defect of this program.
    #[error("the actor {0} panicked: {1}; this is a defect, please report it")]
    Panic(&'static str, String),
}

/// What learning can refuse.
#[derive(Debug, Error)]
pub enum LearnError {
    /// No kernel width could be found.
    #[error("no kernel width: {0}; set dictionary.sigma, or look at what the camera sees")]
    Width(#[from] KernelError),
    /// The dictionary refused a block of frames.
    #[error("frames up to {last_frame} cannot be learned from: {cause}")]
    Block {
        /// The newest frame of the block.
        last_frame: u64,
        /// What the dictionary says.
        cause: SlowError,
    },
}
