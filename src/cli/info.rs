//! `adagio info RUN`

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde::Serialize;

use super::folder::no_records;
use super::{Ending, InfoArgs, folder, print, print_json};
use crate::log::writer::METADATA_NAME;
use crate::log::{Ending as LogEnding, summarise};
use crate::report::Numbered;

/// What `--json` prints: of each log file, and the run's report if there is one.
#[derive(Serialize)]
struct Info {
    files: Vec<File>,
    report: Option<serde_json::Value>,
}

#[derive(Serialize)]
struct File {
    file: String,
    bytes: u64,
    seconds: f64,
    complete: bool,
    messages: BTreeMap<String, u64>,
    metadata: BTreeMap<String, String>,
}

/// Say what a run folder or log holds.
pub fn info(args: &InfoArgs) -> Result<(), Ending> {
    let paths = folder::logs(&args.run)?;
    let mut files = Vec::new();
    for path in paths {
        let mut summary = summarise(&path)?;
        if summary.messages.is_empty() && summary.metadata.is_empty() {
            return Err(no_records(&path));
        }
        files.push(File {
            file: path.display().to_string(),
            bytes: summary.bytes,
            seconds: summary.stamps_ns.map_or(0.0, |(first, last)| (last - first) as f64 / 1e9),
            complete: summary.ending == LogEnding::Complete,
            messages: summary.messages,
            metadata: summary.metadata.remove(METADATA_NAME).unwrap_or_default(),
        });
    }
    let info = Info { files, report: folder::report(&args.run) };
    if args.json {
        return print_json(&info);
    }
    let mut text = String::new();
    for file in &info.files {
        let entry = |key: &str| file.metadata.get(key).map_or("unknown", String::as_str);
        let _ = if file.metadata.is_empty() {
            writeln!(text, "{}: another program wrote it, or its first record is missing", file.file)
        } else {
            let (name, seed, version) = (entry("scenario_name"), entry("seed"), entry("version"));
            writeln!(text, "{}: {name}, seed {seed}, written by adagio {version}", file.file)
        };
        let _ = writeln!(
            text,
            "  {:.1} MB, {:.0} s, {}",
            file.bytes as f64 / 1e6,
            file.seconds,
            if file.complete { "complete" } else { "not closed" }
        );
        for (topic, count) in &file.messages {
            let _ = writeln!(text, "  {:>9}  {topic}", Numbered(*count));
        }
    }
    if let Some(report) = &info.report {
        let digest = report["digest"].as_str().unwrap_or("none");
        let _ = writeln!(text, "report: {} actions, digest {digest}", report["run"]["actions"]);
        for task in report["tasks"].as_array().into_iter().flatten() {
            let _ = writeln!(text, "  {}: success {}", task["name"].as_str().unwrap_or("?"), task["success"]);
        }
    }
    print(&text)
}
