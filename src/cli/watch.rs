//! `adagio watch RUN`

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use super::{Ending, WatchArgs, folder, print};
use crate::live::terminal;
use crate::log::log_files;

/// Show a run while it goes on, or one that is over.
pub fn watch(args: &WatchArgs, stop: &AtomicBool) -> Result<(), Ending> {
    let place = place(args)?;
    if args.once {
        return print(&terminal::once(&place)?);
    }
    if !(std::io::stdout().is_terminal() && std::io::stdin().is_terminal()) {
        let text = "stdin or stdout is no terminal: adagio watch --once prints one picture as plain text";
        return Err(Ending::Usage(text.to_owned()));
    }
    Ok(terminal::watch(&place, stop)?)
}

/// What is followed: a run folder, or a single log file.
fn place(args: &WatchArgs) -> Result<PathBuf, Ending> {
    let mut logs = folder::logs(&args.run)?;
    if args.run.is_dir() && log_files(&args.run).is_ok_and(|files| !files.is_empty()) {
        return Ok(args.run.clone());
    }
    match (logs.pop(), logs.len()) {
        (Some(log), 0) => Ok(log),
        (_, others) => {
            let (path, count) = (args.run.display(), others + 1);
            Err(Ending::Usage(format!(
                "{path} holds {count} logs that are no run's (run_000.mcap, …): name one of them"
            )))
        }
    }
}
