//! The agent and its worlds: scenarios, simulation, what is learned in a run.
//!
//! One program, so that the library is linked once for all of them.

#[path = "../common/mod.rs"]
mod common;

mod budgets;
mod changes;
mod control_path;
mod determinism;
mod features;
mod navigation;
mod navigation_pose;
mod rooms;
mod rows;
mod scenario;
mod shown;
mod simulation;
mod views;
