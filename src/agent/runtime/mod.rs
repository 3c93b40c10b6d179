//! What actors run on: queues, threads, their order, clocks, the timing of models, snapshots, controls, status. It knows no actor.

pub mod checkpoint;
pub mod clock;
pub mod controls;
pub mod interleaving;
pub mod marker;
pub mod queue;
pub mod status;
pub mod threads;
pub mod timing;
