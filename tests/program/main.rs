//! The program as its users see it: commands, pages, reports, experiments, soak tests.
//!
//! One program, so that the library is linked once for all of them.

#[path = "../common/mod.rs"]
mod common;

mod architecture;
mod commands;
mod experiment;
mod fleet;
mod fuzz;
mod live;
mod report;
mod slam;
mod soak;
