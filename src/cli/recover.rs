//! `adagio recover FILE --out FILE`

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;

use super::{Ending, RecoverArgs, print, print_json};
use crate::log::{Ending as LogEnding, recover as copy, summarise};
use crate::report::Numbered;

/// What `--json` prints.
#[derive(Serialize)]
struct Recovered {
    out: String,
    messages: BTreeMap<String, u64>,
    attachments: u64,
    /// Records that could not be read.
    lost_records: u64,
    /// The first of them, each with its place.
    losses: Vec<String>,
    /// Observations that are missing in the new file.
    missing_observations: u64,
    /// Whether the old file had been closed.
    closed: bool,
}

/// Copy what can be read of a log into a new, clean file, and say what is lost.
pub fn recover(args: &RecoverArgs) -> Result<(), Ending> {
    let out = args.out.clone().unwrap_or_else(|| args.file.with_extension("recovered.mcap"));
    let found = copy(&args.file, &out)?;
    let summary = summarise(&out)?;
    let result = Recovered {
        out: out.display().to_string(),
        messages: found.messages,
        attachments: found.attachments,
        lost_records: found.lost,
        losses: found.losses,
        // Frames that the source dropped were never recorded.
        missing_observations: summary.missing.saturating_sub(summary.dropped),
        closed: found.ending == LogEnding::Complete,
    };
    let mut text = String::new();
    let total: u64 = result.messages.values().sum();
    let _ = writeln!(text, "{}: {} messages, {} attachments", result.out, Numbered(total), result.attachments);
    if result.lost_records == 0 {
        let closed = if result.closed { "" } else { "; the log had not been closed" };
        let _ = writeln!(text, "nothing that was written is lost{closed}");
    } else {
        let _ = writeln!(text, "{} records are lost:", Numbered(result.lost_records));
        result.losses.iter().for_each(|loss| text.push_str(&format!("  {loss}\n")));
    }
    if result.missing_observations > 0 {
        let _ = writeln!(text, "{} observations are missing", Numbered(result.missing_observations));
    }
    if args.json { print_json(&result) } else { print(&text) }?;
    if result.lost_records > 0 || result.missing_observations > 0 {
        return Err(Ending::DataLoss(format!("{} is not all that was recorded", result.out)));
    }
    Ok(())
}
