//! `adagio check SCENARIO|RUN`

use std::fmt::Write as _;
use std::path::Path;

use serde::Serialize;

use super::{CheckArgs, Ending, folder, print, print_json, run::load};
use crate::dictionary::WhenFull;
use crate::log::{Ending as LogEnding, LogSummary, summarise};
use crate::report::Numbered;
use crate::scenario::{Scenario, SelectionRule};

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
    /// Length of the run, frames.
    frames: u64,
}

/// Bytes of all matrices of learning at full size, with m = budget, d = values of an observation, r = retained frames,
/// k = features, N = window: dictionary `8m² + 4md` and moments `16m²`, twice while a request is on its way; retained frames
/// `r(8m + 4d)`; the solver's `48m²`; the window `N(d + 24k)` and policy iteration `72k²`. The process holds more than that:
/// images, queues, copies on the way, and what the allocator keeps (the lab peaks at two and a half times this).
fn memory_bytes(s: &Scenario) -> u64 {
    // Where members can leave, a block may exceed the budget before they do.
    let exceeds = s.dictionary.selection != SelectionRule::Ald || s.dictionary.when_full != WhenFull::Stop;
    let m = (s.dictionary.budget + if exceeds { s.dictionary.block_frames } else { 0 }) as u64;
    let d = 3 * (s.vision.width * s.vision.height) as u64;
    let r = s.dictionary.retained_frames.min(s.actions.saturating_mul(s.robot.frames_per_action)) as u64;
    let (k, n) = (s.slow.features as u64 + 1, s.value.window.min(s.actions) as u64);
    let square = 8 * m * m;
    let dictionary = square + 4 * m * d;
    let moments = 2 * square;
    let retained = r * (8 * m + 4 * d);
    let solver = 6 * square;
    let window = n * (d + 3 * 8 * k) + 9 * 8 * k * k;
    2 * (dictionary + moments) + retained + solver + window
}

fn scenario(args: &CheckArgs) -> Ending {
    let scenario = match load(&args.target, &args.set) {
        Ok(scenario) => scenario,
        Err(ending) => return ending,
    };
    let sizes = Sizes {
        valid: true,
        name: scenario.name.clone(),
        sha256: scenario.sha256(),
        memory_bytes: memory_bytes(&scenario),
        frames: (scenario.actions * scenario.robot.frames_per_action) as u64 + 1,
    };
    if args.json {
        return print_json(&sizes);
    }
    eprintln!(
        "{} is valid: {} frames; matrices of {:.0} MB at full size",
        args.target.display(),
        Numbered(sizes.frames),
        sizes.memory_bytes as f64 / 1e6
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
