//! `adagio check SCENARIO|RUN`

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

use super::{CheckArgs, Ending, folder, print, print_json, run::load};
use crate::agent::{Memory, machine_memory};
use crate::log::{Ending as LogEnding, LogSummary, summarise};
use crate::report::Numbered;

/// Check a scenario, or the logs of a run.
pub fn check(args: &CheckArgs) -> Ending {
    let is_log = args.target.extension().is_some_and(|extension| extension == "mcap");
    if args.target.is_dir() || is_log { logs(&args.target, args.json) } else { scenario(args) }
}

/// What `--json` prints of a valid scenario.
#[derive(Serialize)]
struct Sizes {
    valid: bool,
    name: String,
    sha256: String,
    /// Bytes of all matrices of learning at full size.
    memory_bytes: u64,
    /// The parts of that.
    memory_parts: BTreeMap<&'static str, u64>,
    /// Bytes that this machine has; none where it does not say.
    machine_memory_bytes: Option<u64>,
    /// Length of the run, frames.
    frames: u64,
}

fn scenario(args: &CheckArgs) -> Ending {
    let scenario = match load(&args.target, &args.set) {
        Ok(scenario) => scenario,
        Err(ending) => return ending,
    };
    let memory = Memory::of(&scenario);
    let sizes = Sizes {
        valid: true,
        name: scenario.name.clone(),
        sha256: scenario.sha256(),
        memory_bytes: memory.total(),
        memory_parts: memory.parts.iter().copied().collect(),
        machine_memory_bytes: machine_memory(),
        frames: (scenario.actions * scenario.robot.frames_per_action) as u64 + 1,
    };
    if args.json {
        return print_json(&sizes);
    }
    let parts: Vec<String> =
        memory.parts.iter().map(|(name, bytes)| format!("{name} {:.0}", *bytes as f64 / 1e6)).collect();
    eprintln!(
        "{} is valid: {} frames; matrices of {:.0} MB at full size: {}",
        args.target.display(),
        Numbered(sizes.frames),
        sizes.memory_bytes as f64 / 1e6,
        parts.join(", ")
    );
    print(&scenario.text)
}

/// What `--json` prints of one log file.
#[derive(Serialize)]
struct Checked {
    file: String,
    messages: u64,
    complete: bool,
    ending: String,
    damaged_records: u64,
    missing_observations: u64,
    out_of_order: u64,
}

impl Checked {
    fn new(path: &Path, summary: &LogSummary) -> Self {
        let ending = match &summary.ending {
            LogEnding::Complete => "complete".to_owned(),
            LogEnding::NoFooter => "not closed: it ends without a footer".to_owned(),
            LogEnding::Damaged { offset, cause } => format!("damaged at byte {offset}: {cause}"),
        };
        Checked {
            file: path.display().to_string(),
            messages: summary.messages.values().sum(),
            complete: summary.ending == LogEnding::Complete,
            ending,
            damaged_records: summary.damaged,
            missing_observations: summary.missing,
            out_of_order: summary.out_of_order,
        }
    }

    fn is_whole(&self) -> bool {
        self.complete && self.damaged_records == 0 && self.missing_observations == 0 && self.out_of_order == 0
    }
}

fn logs(run: &Path, json: bool) -> Ending {
    let files = match folder::logs(run) {
        Ok(files) => files,
        Err(ending) => return ending,
    };
    let mut checked = Vec::new();
    for file in files {
        match summarise(&file) {
            Ok(summary) => checked.push(Checked::new(&file, &summary)),
            Err(error) => return Ending::failed(error),
        }
    }
    let mut text = String::new();
    if !json {
        for file in &checked {
            let _ = writeln!(text, "{}: {} messages, {}", file.file, Numbered(file.messages), file.ending);
            for (count, what) in [
                (file.damaged_records, "damaged records"),
                (file.missing_observations, "observations missing"),
                (file.out_of_order, "observations out of order"),
            ] {
                if count > 0 {
                    let _ = writeln!(text, "  {} {what}", Numbered(count));
                }
            }
        }
    }
    let printed = if json { print_json(&checked) } else { print(&text) };
    if printed != Ending::Done {
        return printed;
    }
    let bad = checked.iter().filter(|file| !file.is_whole()).count();
    if bad == 0 {
        Ending::Done
    } else {
        Ending::DataLoss(format!("{bad} of {} log files are not whole", checked.len()))
    }
}
