//! Why an experiment ended without its table.

use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::dictionary::DictionaryError;
use crate::kernel::KernelError;
use crate::policy::PolicyError;
use crate::regression::RegressionError;
use crate::report::draw::DrawError;
use crate::scenario::ScenarioError;
use crate::slow::SlowError;
use crate::slow::coherence::CoherenceError;
use crate::slow::ica::IcaError;
use crate::slow::region::RegionError;
use crate::slow::theory::TheoryError;
use crate::value::ValueError;
use crate::value::place::GraphError;

/// Why an experiment ended without its table.
#[derive(Debug, Error)]
pub enum ExperimentError {
    /// There is none of this name.
    #[error("there is no experiment {name:?}; there are {known}{hint}")]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The names there are.
        known: String,
        /// The nearest of them, if one is near.
        hint: String,
    },
    /// Seeds that are none.
    #[error("{0}")]
    Seeds(String),
    /// The folder for the results is there already.
    #[error("{0} exists already, and an experiment never overwrites anything: name another folder with --out")]
    Exists(PathBuf),
    /// It was asked to stop.
    #[error("stopped; {0} finished settings are kept, and the same command goes on from there")]
    Stopped(usize),
    /// A file or folder.
    #[error("cannot {what} {path}: {cause}")]
    File {
        /// What was to be done with it.
        what: &'static str,
        /// Which one.
        path: PathBuf,
        /// What the operating system says.
        cause: std::io::Error,
    },
    /// Data that a package ships are not there.
    #[error("{name} is not in {looked}: get it with `{got_by}`, and name the folder of the packages with --data")]
    Data {
        /// The file.
        name: String,
        /// Where it was looked for.
        looked: String,
        /// How to get it.
        got_by: String,
    },
    /// A result that cannot be kept as JSON.
    #[error("a result cannot be written as JSON: {0}")]
    Json(#[from] serde_json::Error),
    /// A plot.
    #[error("cannot draw a plot: {0}")]
    Draw(#[from] DrawError),
    /// The scenario with the experiment's changes.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A texture of the scenario, or a map.
    #[error(transparent)]
    Texture(#[from] image::ImageError),
    /// No kernel width gives the number of support vectors that is asked for.
    #[error("no kernel width was found at which {frames} frames have about {target} support vectors; tried: {tried}")]
    Width {
        /// Frames to select from.
        frames: usize,
        /// Support vectors asked for.
        target: usize,
        /// Widths and what they gave.
        tried: String,
    },
    /// The library's part.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// The library's part.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// The library's part.
    #[error(transparent)]
    Slow(#[from] SlowError),
    /// The library's part.
    #[error(transparent)]
    Theory(#[from] TheoryError),
    /// The library's part.
    #[error(transparent)]
    Region(#[from] RegionError),
    /// The library's part.
    #[error(transparent)]
    Value(#[from] ValueError),
    /// The library's part.
    #[error(transparent)]
    Regression(#[from] RegressionError),
    /// The library's part.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The library's part.
    #[error(transparent)]
    Ica(#[from] IcaError),
    /// The library's part.
    #[error(transparent)]
    Coherence(#[from] CoherenceError),
    /// A pose graph.
    #[error(transparent)]
    Graph(#[from] GraphError),
    /// A run of the agent.
    #[error("a run of the agent failed: {0}")]
    Run(String),
    /// Two spans cannot be compared.
    #[error("the singular values of two subspaces did not converge")]
    Spans,
}

impl ExperimentError {
    pub(super) fn file(what: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |cause| ExperimentError::File { what, path, cause }
    }
}
