//! `adagio check SCENARIO|RUN`

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use serde::Serialize;

use super::drive::{log_options, metadata};
use super::forecast::LogForecast;
use super::{CheckArgs, Ending, folder, print, print_json, run::load};
use crate::agent::{Memory, machine_memory};
use crate::log::{Ending as LogEnding, LogSummary, summarise};
use crate::report::{Numbered, Origin};
use crate::world::World;

/// Check a scenario, or the logs of a run.
pub fn check(args: &CheckArgs) -> Result<(), Ending> {
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
    /// Size of the log.
    log: LogForecast,
}

fn scenario(args: &CheckArgs) -> Result<(), Ending> {
    let scenario = load(&args.target, &args.set)?;
    let memory = Memory::of(&scenario);
    let (options, rotation) = log_options(&scenario);
    let world = Arc::new(World::new(&scenario)?);
    let log = LogForecast::of(&scenario, &world, &options, rotation, &metadata(&scenario, &Origin::default()))?;
    let sizes = Sizes {
        valid: true,
        name: scenario.name.clone(),
        sha256: scenario.sha256(),
        memory_bytes: memory.total(),
        memory_parts: memory.parts.iter().copied().collect(),
        machine_memory_bytes: machine_memory(),
        frames: (scenario.actions * scenario.robot.frames_per_action) as u64 + 1,
        log,
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
    let log = &sizes.log;
    let budget = scenario.log.budget_mb.filter(|budget| 1e6 * budget < log.bytes as f64);
    let kept =
        budget.map(|budget| format!("; log.budget_mb keeps the last {:.1} h", 1e6 * budget / log.bytes_per_hour));
    eprintln!(
        "its log takes about {:.1} MB for {:.1} h of driving: {:.1} MB an hour, as {} frames show, and at the end {:.1} MB \
         for what was learned{}",
        log.bytes as f64 / 1e6,
        log.hours,
        log.bytes_per_hour / 1e6,
        Numbered(log.measured_frames),
        log.learned_bytes as f64 / 1e6,
        kept.unwrap_or_default()
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
    clock_steps: usize,
    /// Frames that the source dropped, up to the end of this file; they are missing observations, too.
    dropped_frames: u64,
    /// Observations that are missing between the file before and this one.
    missing_before: u64,
    /// It was not closed, but the next file goes on with the next observation.
    continued: bool,
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
            clock_steps: summary.clock_steps,
            dropped_frames: summary.dropped,
            missing_before: 0,
            continued: false,
        }
    }

    /// Everything is there that was recorded: a run that was killed and resumed has lost nothing, although a file of it was
    /// never closed. Frames that were dropped were never recorded, and are no damage of the log.
    fn is_whole(&self, dropped_before: u64) -> bool {
        let dropped = self.dropped_frames.saturating_sub(dropped_before);
        let missing = self.missing_observations + self.missing_before;
        (self.continued || self.complete && self.damaged_records == 0)
            && missing <= dropped
            && self.out_of_order == 0
            && self.clock_steps == 0
    }
}

fn logs(run: &Path, json: bool) -> Result<(), Ending> {
    let files = folder::logs(run)?;
    let mut checked: Vec<Checked> = Vec::new();
    // Files since the last observation that were not closed: a run may be killed and resumed several times without one.
    let mut unclosed: Vec<usize> = Vec::new();
    let mut last = None;
    for file in files {
        let summary = summarise(&file)?;
        let mut this = Checked::new(&file, &summary);
        if let Some((first, end)) = summary.observations {
            // Numbers wrap around; a file that begins again before the last one ended would be out of order.
            match last.map(|last: u32| first.wrapping_sub(last)) {
                None | Some(1) => {}
                Some(0 | 0x8000_0000..) => this.out_of_order += 1,
                Some(ahead) => this.missing_before = u64::from(ahead) - 1,
            }
            let continued = this.missing_before == 0 && this.out_of_order == 0;
            unclosed.drain(..).for_each(|file| checked[file].continued = continued);
            last = Some(end);
        } else if this.complete {
            // Nothing was left to record but the end of the run.
            unclosed.drain(..).for_each(|file| checked[file].continued = true);
        }
        if !this.complete {
            unclosed.push(checked.len());
        }
        checked.push(this);
    }
    let mut text = String::new();
    for file in checked.iter().filter(|_| !json) {
        let continued = if file.continued { "; nothing is lost, the next file goes on" } else { "" };
        let _ = writeln!(text, "{}: {} messages, {}{continued}", file.file, Numbered(file.messages), file.ending);
        for (count, what) in [
            (file.damaged_records, "damaged records"),
            (file.missing_before, "observations missing between the file before and this one"),
            (file.missing_observations, "observations missing"),
            (file.dropped_frames, "frames dropped by the source so far"),
            (file.out_of_order, "observations out of order"),
            (file.clock_steps as u64, "steps of the clock"),
        ] {
            if count > 0 {
                let _ = writeln!(text, "  {} {what}", Numbered(count));
            }
        }
    }
    if json { print_json(&checked) } else { print(&text) }?;
    let mut dropped = 0;
    let bad = checked.iter().filter(|file| !file.is_whole(std::mem::replace(&mut dropped, file.dropped_frames)));
    match bad.count() {
        0 => Ok(()),
        bad => Err(Ending::DataLoss(format!("{bad} of {} log files are not whole", checked.len()))),
    }
}
