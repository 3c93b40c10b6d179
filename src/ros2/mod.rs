//! A robot on a ROS 2 network, without a ROS installation: DDS in pure Rust.
//!
//! [`Link`] is a [`Base`](crate::source::live::Base): images, odometry and the rest come in on threads of their own, so that a
//! camera never holds up a velocity; velocities go out from the loop of control. A watchdog with a thread and a publisher of its own
//! says zero when that loop hangs. [`Voice`] publishes how the run is doing, and hears what is asked of it. [`Doctor`] says what is on the network before anything drives.

mod doctor;
mod frames;
mod graph;
mod link;
mod listen;
mod losses;
mod navigate;
mod pace;
mod request;
mod said;
mod sensors;
mod voice;
mod watchdog;
mod wire;

pub use doctor::{Doctor, Finding};
pub use graph::{Graph, LinkError};
pub use link::Link;
pub use request::{Progress, Request};
pub use said::{Colour, DiagnosticStatus, KeyValue, Marker};
pub use voice::Voice;
