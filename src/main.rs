//! The program: parse, dispatch, exit code.

use std::process::{ExitCode, exit};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use adagio::cli::{Cli, Ending, dispatch, finishes};
use clap::Parser;

/// The command failed.
const FAILED: u8 = 1;
/// Wrong usage, or an invalid scenario (clap uses the same).
const USAGE: u8 = 2;
/// The command finished, but data is damaged or missing.
const DATA_LOSS: u8 = 3;
/// A second Ctrl-C: ended at once.
const INTERRUPTED: i32 = 130;

/// Matrices come and go in threads of their own. glibc's allocator keeps what they free, up to the size of all of them once
/// more; this one gives it back.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let stop = Arc::new(AtomicBool::new(false));
    // Other commands have nothing to finish: Ctrl-C ends them as it ends any program.
    if let Some(what) = finishes(&cli.command) {
        let asked = stop.clone();
        let handler = ctrlc::set_handler(move || {
            if asked.swap(true, Ordering::Relaxed) {
                exit(INTERRUPTED);
            }
            eprintln!("finishing: {what}; Ctrl-C again to end at once");
        });
        if let Err(error) = handler {
            eprintln!("Ctrl-C will end this at once: {error}");
        }
    }
    let (code, text) = match dispatch(cli, &stop) {
        Ok(()) => return ExitCode::SUCCESS,
        Err(Ending::Failed(text)) => (FAILED, text),
        Err(Ending::Usage(text)) => (USAGE, text),
        Err(Ending::DataLoss(text)) => (DATA_LOSS, text),
    };
    eprintln!("adagio: {text}");
    ExitCode::from(code)
}
