//! What several tests share.
#![allow(dead_code, unused_imports)] // each test binary uses its own part of it

#[cfg(feature = "cli")]
mod program;
mod signals;

#[cfg(feature = "cli")]
pub use program::*;
pub use signals::*;

use std::path::{Path, PathBuf};

/// Whether slow tests try all that they can; see CONTRIBUTING.md.
pub fn long() -> bool {
    std::env::var("ADAGIO_LONG").is_ok_and(|value| value == "1")
}

/// A file of this package.
pub fn package_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}
