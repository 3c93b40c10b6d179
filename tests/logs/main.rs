//! The log: written, damaged, recovered, replayed, exported, and logs of other programs.
//!
//! One program, so that the library is linked once for all of them.

#[path = "../common/mod.rs"]
mod common;
#[path = "../log_samples/mod.rs"]
mod log_samples;

mod cdr;
mod crash;
mod damage;
mod export;
mod import;
mod import_damage;
mod interop;
mod learn;
mod recover;
mod replay;
mod run;
