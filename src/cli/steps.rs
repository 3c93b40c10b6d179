//! Progress of work in steps, on stderr: a line that changes on a terminal, one line for each step elsewhere.

use std::cell::Cell;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget};

/// Time between lines about the same step.
const LINE_INTERVAL: Duration = Duration::from_secs(5);

/// Tells what is being done.
pub struct Steps {
    quiet: bool,
    bar: Option<ProgressBar>,
    last_line: Cell<Instant>,
}

impl Steps {
    /// Nothing yet; nothing ever if `quiet`.
    pub fn new(quiet: bool) -> Self {
        let bar = (!quiet && std::io::stderr().is_terminal()).then(|| {
            let bar = ProgressBar::new_spinner();
            bar.set_draw_target(ProgressDrawTarget::stderr());
            bar.enable_steady_tick(Duration::from_millis(100));
            bar
        });
        Steps { quiet, bar, last_line: Cell::new(Instant::now()) }
    }

    /// A step begins.
    pub fn begin(&self, what: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(what.to_owned()),
            None if !self.quiet => eprintln!("{what}"),
            None => {}
        }
        self.last_line.set(Instant::now());
    }

    /// A step has come this far.
    pub fn at(&self, what: &str) {
        if self.bar.is_some() || self.last_line.get().elapsed() >= LINE_INTERVAL {
            self.begin(what);
        }
    }

    /// All is done.
    pub fn end(self, what: &str) {
        self.bar.iter().for_each(ProgressBar::finish_and_clear);
        if !self.quiet {
            eprintln!("{what}");
        }
    }
}
