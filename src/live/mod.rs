//! A run, watched while it goes on: in the terminal, or on a local web page.
//!
//! ```text
//!  the run's log, as it grows ──tail──▶ follow ──┐
//!  the newest checkpoint ─────────────▶ look ────┴──▶ view ──▶ terminal
//!                                                         └──▶ serve ──▶ a page in a browser ──▶ controls of the run
//! ```
//!
//! All of it comes from the log and the checkpoint, read in a thread of their own: whoever watches never meets the stream, and
//! it makes no difference whether the run belongs to this process, to another one, or is over. Only the page's buttons reach
//! the run, through [`Controls`](crate::agent::Controls), which it looks at once per action.

mod ask;
mod follow;
mod maps;
mod picture;
#[cfg(feature = "ros2")]
pub mod ros2;
pub mod serve;

mod tail;
pub mod terminal;

mod view;

pub use follow::{Follower, Newest, Seen};
pub use maps::{Maps, RoomView};
pub use picture::Picture;
pub use tail::Tail;
pub use view::{
    Curve, Curves, DecisionView, DictionaryView, FeaturesView, HealthView, Phase, TaskView, View, WallView, Watcher,
};

/// Tells other threads that something is over, also if it panics.
pub(crate) struct SetWhenDropped<'a>(pub &'a std::sync::atomic::AtomicBool);

impl Drop for SetWhenDropped<'_> {
    fn drop(&mut self) {
        self.0.store(true, std::sync::atomic::Ordering::Relaxed);
    }
}
