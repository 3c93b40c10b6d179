//! What the benches share: the machine's own rates, frames, and the calls to the library that are measured.
#![allow(dead_code)] // each bench uses its own part of it

pub mod data;
pub mod machine;
pub mod machines;
pub mod operations;
pub mod relearning;
pub mod simulation;

use std::fmt;

use faer::Par;

/// Sizes of a benchmark, as they stand in its name. What is `None` plays no part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Support vectors; 0 where they play no part.
    pub m: usize,
    /// Values per observation.
    pub d: Option<usize>,
    /// Frames in a block, or transitions.
    pub n: Option<usize>,
    /// Features.
    pub k: Option<usize>,
    /// Threads.
    pub threads: usize,
}

impl Size {
    /// `m` support vectors, on one thread.
    pub const fn of(m: usize) -> Self {
        Size { m, d: None, n: None, k: None, threads: 1 }
    }

    pub const fn d(self, d: usize) -> Self {
        Size { d: Some(d), ..self }
    }

    pub const fn n(self, n: usize) -> Self {
        Size { n: Some(n), ..self }
    }

    pub const fn k(self, k: usize) -> Self {
        Size { k: Some(k), ..self }
    }

    pub const fn threads(self, threads: usize) -> Self {
        Size { threads, ..self }
    }

    pub fn par(self) -> Par {
        if self.threads == 1 { Par::Seq } else { Par::rayon(self.threads) }
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let m = (self.m > 0).then_some(self.m);
        let threads = (self.threads > 1).then_some(self.threads);
        let parts = [("m", m), ("d", self.d), ("n", self.n), ("k", self.k), ("threads", threads)];
        let given: Vec<String> =
            parts.iter().filter_map(|(name, value)| value.map(|value| format!("{name}={value}"))).collect();
        f.pad(&given.join(" "))
    }
}

/// Environment variable with the largest `m` that is measured: `ADAGIO_BENCH_MAX_M=1000` is the quick mode.
const MAX_M: &str = "ADAGIO_BENCH_MAX_M";

/// The largest `m` that is measured; all of them unless the environment says otherwise.
pub fn max_m() -> usize {
    match std::env::var(MAX_M) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{MAX_M} is {text:?}, but must be a whole number")),
        Err(_) => usize::MAX,
    }
}

/// Those sizes that the environment does not forbid.
pub fn allowed(sizes: impl IntoIterator<Item = Size>) -> Vec<Size> {
    let most = max_m();
    sizes.into_iter().filter(|size| size.m <= most).collect()
}

/// The sizes that all hot paths are measured at.
pub fn standard() -> Vec<Size> {
    allowed([500, 1000, 2000, 4000, 8000].map(Size::of))
}

/// Threads for what shall use the whole machine.
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// A list of names wants no figures, and neither does a test of whether everything runs.
pub fn wants_figures() -> bool {
    !std::env::args().any(|argument| argument == "--list" || argument == "--test")
}

/// The head of every divan bench, then its benchmarks.
pub fn main() {
    adagio::random::fix_parallelism();
    if wants_figures() {
        machine::header();
    }
    divan::main();
}

/// The value behind `--NAME` on the command line of a bench that is a plain program.
///
/// # Panics
/// A value that cannot be read: whoever typed it shall see.
pub fn argument<T: std::str::FromStr>(name: &str) -> Option<T> {
    let mut arguments = std::env::args().skip_while(|argument| argument != name);
    arguments.next()?;
    let text = arguments.next().unwrap_or_else(|| panic!("{name} wants a value"));
    Some(text.parse().unwrap_or_else(|_| panic!("{name} {text}: this value cannot be read")))
}
