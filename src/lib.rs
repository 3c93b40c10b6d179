//! Adagio.

pub mod agent;
pub mod cli;
pub mod dictionary;
pub mod evaluate;
pub mod kernel;
pub mod log;
pub mod policy;
pub mod random;
pub mod report;
pub mod scenario;
pub mod slow;
pub mod source;
pub mod value;
pub mod vision;
pub mod world;
