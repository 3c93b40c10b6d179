//! What to run: the TOML file of a scenario as checked values.
//!
//! [`Scenario::load`] reads a file with overrides, and reports everything that is wrong with it at once, each fault with
//! its line, key, value and allowed range. [`Scenario::text`] is the complete file with every default filled in and
//! every key explained; reading it again gives the same scenario.

mod change;
mod checks;
mod distractors;
mod keys;
mod plan;
mod pyramids;
mod rooms;
mod sections;
mod texture;
mod topics;

pub use change::{Change, ChangeKind};
pub(crate) use checks::FORGET;
pub use distractors::Distractor;
pub use keys::Fault;
pub use plan::{Plan, PlanFault, in_goal, pieces_of as plan_pieces, segments_of as plan_segments};
pub(crate) use plan::{distance_to_segment, nearest};
pub use pyramids::Pyramid;
pub use rooms::{Room, SIDES, Wall};
pub use sections::*;
pub use texture::{Pattern, Texture};
pub use topics::{Stamps, TopicChoice, Topics};

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use thiserror::Error;

/// Why a scenario cannot be used.
#[derive(Debug, Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("cannot read the scenario {path}: {cause}")]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        cause: std::io::Error,
    },
    /// The file was read and is not a valid scenario.
    #[error("{}", list(path, faults))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Everything that is wrong, in the order of the lines.
        faults: Vec<Fault>,
    },
}

fn list(path: &Path, faults: &[Fault]) -> String {
    let lines = faults.iter().map(|fault| {
        let place = match fault.line {
            Some(line) => format!("{}:{line}: ", path.display()),
            None => format!("{}: ", path.display()),
        };
        format!("{place}{}{}{}", fault.key, if fault.key.is_empty() { "" } else { " " }, fault.text)
    });
    let count = faults.len();
    let head = format!("the scenario has {count} fault{}:\n", if count == 1 { "" } else { "s" });
    head + &lines.collect::<Vec<_>>().join("\n")
}

impl Scenario {
    /// Read a scenario file, with `KEY=VALUE` overrides.
    ///
    /// # Errors
    /// The file cannot be read, or it has faults; all of them are listed.
    pub fn load(path: &Path, sets: &[String]) -> Result<Self, ScenarioError> {
        let text =
            std::fs::read_to_string(path).map_err(|cause| ScenarioError::Read { path: path.to_owned(), cause })?;
        Self::parse(&text, path, sets)
    }

    /// Read a scenario from a text; `path` is where it came from: for messages, and image files are relative to it.
    ///
    /// # Errors
    /// The text has faults; all of them are listed.
    pub fn parse(text: &str, path: &Path, sets: &[String]) -> Result<Self, ScenarioError> {
        let base = path.parent().unwrap_or(Path::new("")).to_owned();
        let stem = path.file_stem().map_or("scenario".to_owned(), |stem| stem.to_string_lossy().into_owned());
        let mut reader = keys::Reader::new(text, sets);
        if !reader.faults.is_empty() {
            // What a broken text holds cannot be told: faults of its values would be inventions.
            let (faults, _) = reader.finish();
            return Err(ScenarioError::Invalid { path: path.to_owned(), faults });
        }
        let mut scenario = Scenario::read(&mut reader, &base, &stem);
        checks::check(&scenario, &mut reader);
        let notes = std::mem::take(&mut reader.notes);
        let (faults, written) = reader.finish();
        if !faults.is_empty() {
            return Err(ScenarioError::Invalid { path: path.to_owned(), faults });
        }
        (scenario.text, scenario.notes) = (written, notes);
        Ok(scenario)
    }

    /// SHA-256 of [`Scenario::text`] as hexadecimal digits: what was run, whatever the file looked like.
    pub fn sha256(&self) -> String {
        hex(&Sha256::digest(self.text.as_bytes()))
    }
}

/// Bytes as hexadecimal digits.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
