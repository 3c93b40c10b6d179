//! What all experiments share: scope, cache, progress, and the folder that their results go to.

use std::cell::{Cell, OnceCell, RefCell};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use faer::Par;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::{BAND, Cache, ExperimentError, Seeds, Table};
use crate::report::Program;

/// How much of an experiment is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Size {
    /// The thesis's sizes.
    Full,
    /// Coarse, in minutes.
    Quick,
    /// Everything runs, in seconds; the numbers mean nothing.
    Smoke,
}

/// A value for each size.
#[derive(Debug, Clone, Copy)]
pub struct Sizes<T> {
    /// For [`Size::Full`].
    pub full: T,
    /// For [`Size::Quick`].
    pub quick: T,
    /// For [`Size::Smoke`].
    pub smoke: T,
}

/// What is to be done.
#[derive(Debug, Clone)]
pub struct Scope {
    /// How much.
    pub size: Size,
    /// Support vectors in place of the size's own number, where an experiment has one; the most of them, where it has
    /// several.
    pub vectors: Option<usize>,
    /// Seeds; more than one give bands.
    pub seeds: Seeds,
    /// Of [`worlds`](super::worlds): the name of one world alone.
    pub world: Option<String>,
    /// Folders of packages that ship data; none: that of `python3`, and `node_modules`.
    pub data: Vec<PathBuf>,
    /// Threads for matrix products; results do not depend on them.
    pub par: Par,
    /// Where finished settings are kept.
    pub cache: PathBuf,
    /// No progress.
    pub quiet: bool,
}

impl Scope {
    /// How many support vectors, if the size's own number is `sized`.
    pub fn vectors_or(&self, sized: usize) -> usize {
        self.vectors.unwrap_or(sized)
    }

    /// Those of the size's own numbers of support vectors that are asked for; the number itself, if all are larger.
    pub fn vectors_up_to(&self, sized: &[usize]) -> Vec<usize> {
        let Some(most) = self.vectors else { return sized.to_vec() };
        let up_to: Vec<usize> = sized.iter().copied().filter(|&number| number <= most).collect();
        if up_to.is_empty() { vec![most] } else { up_to }
    }

    /// The value for this scope's size.
    pub fn pick<T>(&self, sizes: Sizes<T>) -> T {
        match self.size {
            Size::Full => sizes.full,
            Size::Quick => sizes.quick,
            Size::Smoke => sizes.smoke,
        }
    }
}

/// An experiment: its name, and how to do it.
pub struct Experiment {
    /// Its name on the command line.
    pub name: &'static str,
    /// What it shows, in a line.
    pub line: &'static str,
    /// How long it takes on two cores, at each size.
    pub lasts: Sizes<&'static str>,
    /// Do it.
    pub run: fn(&Bench<'_>) -> Result<Results, ExperimentError>,
}

/// What came of an experiment.
#[derive(Debug, Clone, Default)]
pub struct Results {
    /// Tables.
    pub tables: Vec<Table>,
    /// What is to be known beside them, in sentences.
    pub notes: Vec<String>,
    /// Plots: file names and SVG.
    pub plots: Vec<(String, String)>,
}

/// Where an experiment is done: it hands out results of settings, new or kept, and tells how far it is.
pub struct Bench<'a> {
    /// What is to be done.
    pub scope: &'a Scope,
    experiment: &'static str,
    cache: Cache,
    stop: &'a AtomicBool,
    planned: Cell<usize>,
    done: Cell<usize>,
    /// Settings that were computed, and the seconds that took.
    computed: Cell<(usize, f64)>,
    other_builds: Cell<usize>,
    files: RefCell<Vec<String>>,
}

impl<'a> Bench<'a> {
    fn new(experiment: &Experiment, scope: &'a Scope, stop: &'a AtomicBool) -> Result<Self, ExperimentError> {
        crate::random::fix_parallelism();
        Ok(Bench {
            scope,
            experiment: experiment.name,
            cache: Cache::open(&scope.cache)?,
            stop,
            planned: Cell::default(),
            done: Cell::default(),
            computed: Cell::default(),
            other_builds: Cell::default(),
            files: RefCell::default(),
        })
    }

    /// Say how many settings there will be, for the progress.
    pub fn plan(&self, settings: usize) {
        self.planned.set(self.planned.get() + settings);
    }

    /// The result of some settings, computed or kept. `settings` must hold all that it depends on, data included.
    ///
    /// # Errors
    /// Those of `compute`; [`ExperimentError::Stopped`]; files.
    pub fn result<S: Serialize, R: Serialize + DeserializeOwned>(
        &self,
        label: &str,
        settings: &S,
        compute: impl FnOnce() -> Result<R, ExperimentError>,
    ) -> Result<R, ExperimentError> {
        self.go_on()?;
        let begin = Instant::now();
        let found = self.cache.get(self.experiment, label, settings, compute)?;
        self.done.set(self.done.get() + 1);
        if let Some((reason, aside)) = &found.damaged {
            eprintln!(
                "warning: {} was damaged ({reason}): it is now {}, and was computed again",
                found.path.display(),
                aside.display()
            );
        }
        if found.other_build {
            self.other_builds.set(self.other_builds.get() + 1);
        }
        if let Some(name) = found.path.file_name() {
            self.files.borrow_mut().push(name.to_string_lossy().into_owned());
        }
        let seconds = begin.elapsed().as_secs_f64();
        if !found.kept {
            let (count, sum) = self.computed.get();
            self.computed.set((count + 1, sum + seconds));
        }
        if !self.scope.quiet {
            let (count, sum) = self.computed.get();
            let left = self.planned.get().saturating_sub(self.done.get());
            let how = if found.kept { "kept".to_owned() } else { format!("{seconds:.1} s") };
            let rest = if count > 0 && left > 0 {
                format!(", at this rate {:.0} s left", sum / count as f64 * left as f64)
            } else {
                String::new()
            };
            eprintln!("{} of {}: {label} ({how}{rest})", self.done.get(), self.planned.get());
        }
        Ok(found.result)
    }

    /// Tell what is being done.
    pub fn say(&self, text: &str) {
        if !self.scope.quiet {
            eprintln!("  {text}");
        }
    }

    /// What says that it was asked to stop, for other threads.
    pub fn stop(&self) -> &AtomicBool {
        self.stop
    }

    /// Refuse to go on if the experiment was asked to stop.
    ///
    /// # Errors
    /// [`ExperimentError::Stopped`].
    pub fn go_on(&self) -> Result<(), ExperimentError> {
        if self.stop.load(Ordering::Relaxed) { Err(ExperimentError::Stopped(self.done.get())) } else { Ok(()) }
    }
}

/// Something that several settings share, made when the first of them needs it: if all are kept, never.
#[derive(Debug)]
pub struct Once<T>(OnceCell<T>);

impl<T> Default for Once<T> {
    fn default() -> Self {
        Once(OnceCell::new())
    }
}

impl<T> Once<T> {
    /// The thing; it is made if there is none yet.
    ///
    /// # Errors
    /// Those of `make`; the next call tries again.
    pub fn get<E>(&self, make: impl FnOnce() -> Result<T, E>) -> Result<&T, E> {
        if let Some(made) = self.0.get() {
            return Ok(made);
        }
        let made = make()?;
        Ok(self.0.get_or_init(|| made))
    }
}

/// Tables, notes and plots of an experiment.
const TABLE: &str = "table.md";

/// Do an experiment only for the settings that it keeps, so that [`run`] with these seeds and others finds them.
///
/// # Errors
/// Those of [`run`], but for the folder.
pub fn keep(experiment: &Experiment, scope: &Scope, stop: &AtomicBool) -> Result<(), ExperimentError> {
    (experiment.run)(&Bench::new(experiment, scope, stop)?).map(drop)
}

/// Do an experiment, and write its tables and plots into a new folder.
///
/// Returns what is in `result.json`, and the tables as text.
///
/// # Errors
/// The folder exists; [`ExperimentError::Stopped`] if `stop` is set, with finished settings kept; whatever goes wrong in the
/// experiment.
pub fn run(
    experiment: &Experiment,
    scope: &Scope,
    out: &Path,
    stop: &AtomicBool,
) -> Result<(Value, String), ExperimentError> {
    if out.exists() {
        return Err(ExperimentError::Exists(out.to_owned()));
    }
    let begin = Instant::now();
    let bench = Bench::new(experiment, scope, stop)?;
    let mut results = (experiment.run)(&bench)?;
    if scope.seeds.len() > 1 {
        results.notes.push(format!("Bands over seeds {}: mean [{BAND}].", scope.seeds));
    }
    if bench.other_builds.get() > 0 {
        results.notes.push(format!(
            "{} of {} results were kept from other builds of the program.",
            bench.other_builds.get(),
            bench.done.get()
        ));
    }
    let json = json!({
        "experiment": experiment.name,
        "program": Program::this(),
        "size": scope.size,
        "vectors": scope.vectors,
        "seeds": scope.seeds,
        "band": BAND,
        "seconds": begin.elapsed().as_secs_f64(),
        "tables": results.tables.iter().map(Table::json).collect::<Vec<_>>(),
        "notes": results.notes,
        "plots": results.plots.iter().map(|(name, _)| name).collect::<Vec<_>>(),
        "cache": bench.files.into_inner(),
    });
    let text = text(&results);
    write(out, experiment, &results, &json, &text)?;
    Ok((json, text))
}

fn text(results: &Results) -> String {
    let mut parts: Vec<String> = results.tables.iter().map(Table::text).collect();
    parts.extend((!results.notes.is_empty()).then(|| results.notes.join("\n") + "\n"));
    parts.join("\n")
}

/// Where the files of a folder are written before it is there.
pub fn part_of(out: &Path) -> PathBuf {
    out.with_added_extension(format!("{}.part", std::process::id()))
}

/// Put the tables of experiments that were done into a folder, each under its name, on one page there, `experiments.md`.
///
/// # Errors
/// Files.
pub fn page(folder: &Path, done: &[&str]) -> Result<String, ExperimentError> {
    let mut page = "# Experiments\n".to_owned();
    for name in done {
        let path = folder.join(name).join(TABLE);
        let table = std::fs::read_to_string(&path).map_err(ExperimentError::file("read", &path))?;
        // A heading below that of the page, and plots where they are.
        page += &format!("\n#{}", table.replace(".svg](", &format!(".svg]({name}/")));
    }
    let path = folder.join("experiments.md");
    std::fs::write(&path, &page).map_err(ExperimentError::file("write", &path))?;
    Ok(page)
}

/// All files of the results. They are written beside the folder first: it is whole or not there.
fn write(
    out: &Path,
    experiment: &Experiment,
    results: &Results,
    json: &Value,
    text: &str,
) -> Result<(), ExperimentError> {
    if let Some(parent) = out.parent() {
        std::fs::create_dir_all(parent).map_err(ExperimentError::file("create the folder", parent))?;
    }
    let part = part_of(out);
    std::fs::create_dir(&part).map_err(ExperimentError::file("create the folder", &part))?;
    let file = |name: &str, contents: &str| {
        let path = part.join(name);
        std::fs::write(&path, contents).map_err(ExperimentError::file("write", &path))
    };
    file("result.json", &(serde_json::to_string_pretty(json)? + "\n"))?;
    file("table.txt", text)?;
    let mut markdown = format!("# {}\n\n{}\n", experiment.name, experiment.line);
    for (index, table) in results.tables.iter().enumerate() {
        markdown += &format!("\n{}", table.markdown());
        file(&format!("table-{}.csv", index + 1), &table.csv())?;
    }
    results.notes.iter().for_each(|note| markdown += &format!("\n{note}\n"));
    for (name, svg) in &results.plots {
        markdown += &format!("\n![{name}]({name})\n");
        file(name, svg)?;
    }
    file(TABLE, &markdown)?;
    if out.exists() {
        return Err(ExperimentError::Exists(out.to_owned()));
    }
    std::fs::rename(&part, out).map_err(ExperimentError::file("create the folder", out))
}
