//! The save actor: writes snapshots of the run.

use std::convert::Infallible;

use super::messages::Item;
use super::record::{Level, Recorder};
use crate::agent::error::RunError;
use crate::agent::runtime::checkpoint::{SavedState, write_state};
use crate::agent::runtime::marker::SnapshotSettings;
use crate::agent::runtime::queue::Inbox;
use crate::scenario::Scenario;

/// Its loop: writes each snapshot after everything before it is in the log. What it returns is why the last
/// one could not be written, if so: what is in the log is not lost, and the run goes on.
pub fn run(
    marks: &Inbox<Item<Infallible>>,
    keep: Option<&SnapshotSettings>,
    scenario: &Scenario,
    record: &Recorder,
) -> Result<Option<String>, RunError> {
    let mut failure = None;
    while let Ok(Item::Save(marker)) = marks.take() {
        let Some(keep) = keep else { continue };
        if record.flush().is_err() {
            break;
        }
        let (frame, stamp) = (marker.frame, marker.stamp_ns);
        let state = SavedState { snapshot: marker.snapshot, frame, stamp_ns: stamp };
        failure = write_state(&keep.path, state, scenario).err();
        if let Some(error) = &failure {
            let text = format!("the state after frame {frame} is not kept: {error}");
            let _ = record.diagnostic(Level::Warn, stamp, text);
        }
    }
    Ok(failure.map(|error| error.to_string()))
}
