//! Known answers of the pure parts: kernel, dictionary, slow features, values.
//!
//! One program, so that the library is linked once for all of them.

#[path = "../common/mod.rs"]
mod common;

mod coherence;
mod dictionary;
mod ica;
mod kernel;
mod metric_map;
mod options;
mod region;
mod regression;
mod selection;
mod slow;
mod slow_classes;
mod slow_dependent;
mod slow_expanded;
mod slow_hierarchy;
mod slow_input;
mod slow_kernel;
mod slow_lanczos;
mod slow_linear;
mod slow_quadratic;
#[cfg(feature = "snapshot")]
mod snapshots;
mod theory;
mod value;
mod value_estimation;
mod value_input;
mod value_refit;
mod value_traps;
