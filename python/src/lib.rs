//! The Python package `adagio`: thin classes over the library, one file each.
//!
//! What users see are the Python files of `package/adagio`, which check arrays as scikit-learn does and keep
//! parameters. What is computed is the library's. An array of samples × features in C order is the library's features ×
//! samples in columns: a view.

mod agent;
mod arguments;
mod arrays;
mod dictionary;
mod experiment;
mod incremental;
mod kernel;
mod linear;
mod links;
mod local;
mod lspi;
mod many;
mod recorded;
mod state;
mod threads;

use pyo3::prelude::*;

/// The compiled part of `adagio`; not for use from outside of the package.
#[pymodule]
mod _adagio {
    use super::*;

    #[pymodule_export]
    use crate::agent::{Agent, RunOver};
    #[pymodule_export]
    use crate::dictionary::Ald;
    #[pymodule_export]
    use crate::experiment::{experiment, experiment_seed};
    #[pymodule_export]
    use crate::incremental::IncrementalStream;
    #[pymodule_export]
    use crate::kernel::{KernelModel, KernelStream, width_for_share};
    #[pymodule_export]
    use crate::linear::{LinearModel, LinearStream};
    #[pymodule_export]
    use crate::local::LocalValues;
    #[pymodule_export]
    use crate::lspi::{ActionWeights, lspi};
    #[pymodule_export]
    use crate::many::{learn, learn_part};
    #[pymodule_export]
    use crate::recorded::{Pilot, Recorded};

    #[pymodule_init]
    fn init(_module: &Bound<'_, PyModule>) -> PyResult<()> {
        // The same bits on any number of cores.
        adagio::random::fix_parallelism();
        Ok(())
    }
}
