//! The actors of a run, one file each: its state, its pure step, its loop.

pub mod act;
mod doubts;
pub mod evaluate;
pub mod fit;
pub mod fleet;
pub mod health;
pub mod kernel_rows;
pub mod learn;
pub mod messages;
pub mod perceive;
pub mod record;
pub mod save;
pub mod saved;
pub mod solve;
pub mod source;
pub mod tasks;
mod way;
