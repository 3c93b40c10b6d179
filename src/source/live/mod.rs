//! A robot that drives while the agent learns.

mod base;

pub use base::{Base, Reading, Received, Scan};
