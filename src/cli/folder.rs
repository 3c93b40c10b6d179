//! Run folders: making a new one, and finding what a run left.

use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};

use super::Ending;
use crate::agent::{CHECKPOINT_NAME, read_checkpoint};
use crate::log::newest;
use crate::log::run::log_number;
use crate::policy::Learned;
use crate::scenario::Scenario;
use crate::world::World;

/// Where runs go unless `--out` says otherwise.
const RUNS: &str = "logs";

/// Make the folder of a new run. Nothing that exists is touched.
pub fn create(out: Option<&Path>, scenario: &Scenario) -> Result<PathBuf, Ending> {
    let make = |path: &Path| std::fs::create_dir(path);
    if let Some(out) = out {
        return named(out, make);
    }
    let runs = Path::new(RUNS);
    std::fs::create_dir_all(runs).map_err(|cause| cannot_create(runs, &cause))?;
    let plain: String =
        scenario.name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' }).collect();
    numbered(&runs.join(format!("{plain}-seed{}", scenario.seed)), make)
}

/// Make a folder that must not be there yet, in folders that may have to be made, too.
pub fn named(out: &Path, make: impl Fn(&Path) -> io::Result<()>) -> Result<PathBuf, Ending> {
    // A file in the place of a parent "exists already", too.
    out.parent().map_or(Ok(()), std::fs::create_dir_all).map_err(|cause| cannot_create(out, &cause))?;
    make(out).map_err(|cause| match cause.kind() {
        ErrorKind::AlreadyExists => Ending::Usage(format!(
            "{} exists already, and nothing is ever overwritten: name another folder with --out",
            out.display()
        )),
        _ => cannot_create(out, &cause),
    })?;
    Ok(out.to_owned())
}

/// Make a folder of this name, or of the first of NAME-2, NAME-3, … that is not there yet.
pub fn numbered(base: &Path, make: impl Fn(&Path) -> io::Result<()>) -> Result<PathBuf, Ending> {
    for number in 1..100_000 {
        let suffix = if number == 1 { String::new() } else { format!("-{number}") };
        let path = PathBuf::from(format!("{}{suffix}", base.display()));
        match make(&path) {
            Ok(()) => return Ok(path),
            Err(cause) if cause.kind() == ErrorKind::AlreadyExists => {}
            Err(cause) => return Err(cannot_create(&path, &cause)),
        }
    }
    Err(format!("there are too many folders {}-N: name another one with --out", base.display()).into())
}

fn cannot_create(path: &Path, cause: &io::Error) -> Ending {
    Ending::Failed(format!("cannot create the folder {}: {cause} (name another place with --out)", path.display()))
}

/// The log files of a run folder in their order, or a log file itself.
pub fn logs(run: &Path) -> Result<Vec<PathBuf>, Ending> {
    if run.is_file() {
        return Ok(vec![run.to_owned()]);
    }
    let entries = std::fs::read_dir(run)
        .map_err(|cause| Ending::Failed(format!("cannot open the run {}: {cause}", run.display())))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "mcap"))
        .collect();
    // By number: run_1000 comes after run_999.
    let number = |path: &PathBuf| log_number(path).map_or((1, 0), |number| (0, number));
    files.sort_by(|a, b| number(a).cmp(&number(b)).then_with(|| a.cmp(b)));
    if files.is_empty() {
        return Err(Ending::Failed(format!("{} holds no .mcap file: it is not a run folder", run.display())));
    }
    Ok(files)
}

/// What a run learned: from the checkpoint in its folder, or from the newest one in its log.
pub fn learned(run: &Path) -> Result<(Learned, Scenario), Ending> {
    let file = run.join(CHECKPOINT_NAME);
    if file.is_file() {
        return checkpoint(&file);
    }
    let found = newest(logs(run)?, CHECKPOINT_NAME, |error| eprintln!("warning: {error}"));
    let (bytes, path) =
        found.ok_or_else(|| format!("{} holds no checkpoint: the run ended before its first model", run.display()))?;
    Ok(read_checkpoint(&bytes, &path).map_err(|error| format!("{}: {error}", path.display()))?)
}

/// The world of a run, with what can be pushed where its report says that the run left it.
///
/// # Errors
/// See [`World::new`].
pub fn world(run: &Path, scenario: &Scenario) -> Result<World, image::ImageError> {
    let world = World::new(scenario)?;
    let left = report(run).and_then(|report| serde_json::from_value(report.get("movables")?.clone()).ok());
    if let Some(movables) = left {
        world.set_movables(movables);
    }
    Ok(world)
}

/// The `report.json` of a run, if it has one.
pub fn report(run: &Path) -> Option<serde_json::Value> {
    serde_json::from_str(&std::fs::read_to_string(run.join("report.json")).ok()?).ok()
}

/// What a checkpoint holds.
pub fn checkpoint(path: &Path) -> Result<(Learned, Scenario), Ending> {
    let bytes = std::fs::read(path).map_err(|cause| format!("cannot read {}: {cause}", path.display()))?;
    Ok(read_checkpoint(&bytes, path).map_err(|error| format!("{}: {error}", path.display()))?)
}

/// Why a log shows nothing.
pub fn no_records(path: &Path) -> Ending {
    format!("{} holds no records: it is not an MCAP log, or was cut at its beginning", path.display()).into()
}
