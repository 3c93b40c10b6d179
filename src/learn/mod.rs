//! One model from many logs.
//!
//! What slow features need of frames are sums over them, and sums of two logs are the sum over both. So each log, and each stretch of a
//! long one, is worked on alone, by whoever is next to it, and what comes back is small:
//!
//! 1. [`Recordings`]: each log is looked at once. What does not fit, or is damaged, is named before anything else begins.
//! 2. [`Job::Members`]: each log gives candidates for support vectors; the union of them, thinned by the same rule, is the
//!    [`Dictionary`]. Again, from that one on, until no log has a frame that it lacks, or the dictionary is full.
//! 3. [`Job::Moments`]: each log gives its sums over that dictionary, and a window of transitions.
//! 4. [`model`]: sums are added in pairs, in the order of the logs' digests and of the frames in them; features and values follow as in a run.
//!
//! # Parts
//! Jobs leave files. A part says of which log it is (a digest of its files), for which scenario, over which dictionary (its digest) and which
//! frames it covers. One that is there is not made again: that is all there is to a worker that fails, on any engine.
//!
//! # Repeatability
//! The same logs give the same bits for one scenario, on any number of workers, in any order and under any name: nothing is added in the order of arrival.
//! No derivative is taken across the border of a log; across that of a stretch it is. The union of one log's candidates is the dictionary of a run, if that does not thin;
//! but all frames then have all coordinates, which in a run those have only that are retained.

mod dictionary;
mod model;
mod recordings;
mod sums;

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use faer::Par;
use thiserror::Error;

pub use dictionary::{Candidates, Dictionary, candidates, first_dictionary, union};
pub use model::{Learned, model};
pub use recordings::{LeftOut, Log, Piece, Recordings, STRETCH};
pub use sums::{Sums, merge, sums};

use crate::agent::{CheckpointError, SavedState, read_state, read_state_head, write_state};
use crate::scenario::{Plan, Scenario};
use crate::slow::SlowError;
use crate::snapshot::{Snapshot, SnapshotError};

/// Why nothing can be learned from logs.
#[derive(Debug, Error)]
pub enum ManyError {
    /// A log cannot be read, or is damaged.
    #[error("{0}")]
    Log(LeftOut),
    /// A log of another camera or other actions.
    #[error("{0}")]
    Unlike(LeftOut),
    /// All of these.
    #[error("{} of the logs cannot be learned from together with the scenario:\n{}", .0.len(), list(.0))]
    AllUnlike(Vec<LeftOut>),
    /// A part is of something else, or damaged.
    #[error("the part {}: {cause}", path.display())]
    Part {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: String,
    },
    /// Parts that do not belong together.
    #[error("{0}")]
    Together(String),
    /// A part cannot be written.
    #[error(transparent)]
    Write(#[from] CheckpointError),
    /// Sums that cannot be added or solved.
    #[error(transparent)]
    Slow(#[from] SlowError),
    /// There are no features or policies.
    #[error("{0}")]
    NoModel(String),
}

fn list(logs: &[LeftOut]) -> String {
    logs.iter().map(|log| format!("  {log}")).collect::<Vec<String>>().join("\n")
}

/// What is learned for: a scenario, and its floor plan.
#[derive(Debug, Clone)]
pub struct Setting {
    /// Settings of dictionary, features and values, and the tasks.
    pub scenario: Arc<Scenario>,
    /// Where rewards near walls are.
    pub plan: Arc<Plan>,
    /// Threads for matrix products. Their bits do not depend on it.
    pub par: Par,
}

/// Work on frames of one log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Job {
    /// Candidates for support vectors that a dictionary lacks.
    Members,
    /// Sums over a dictionary, and transitions.
    Moments,
}

impl Job {
    /// The command that does it.
    pub fn verb(&self) -> &'static str {
        match self {
            Job::Members => "members",
            Job::Moments => "moments",
        }
    }

    /// The job of a command.
    pub fn of_verb(verb: &str) -> Option<Self> {
        [Job::Members, Job::Moments].into_iter().find(|job| job.verb() == verb)
    }

    /// Do it for frames of a log, or all, unless the part is there already.
    ///
    /// # Errors
    /// A log that cannot be read any more or has no such frames, a part that cannot be written.
    pub fn run(
        &self,
        setting: &Setting,
        log: &Path,
        frames: Option<Range<u64>>,
        dictionary: &Dictionary,
        out: &Path,
    ) -> Result<(), ManyError> {
        let log = Log::open(log, &setting.scenario)?;
        let frames = frames.unwrap_or(0..log.frames);
        if frames.end > log.frames {
            return Err(ManyError::Together(format!(
                "{} has {} frames: {}..{} are not in it",
                log.path.display(),
                log.frames,
                frames.start,
                frames.end
            )));
        }
        let of = Piece { log: &log, frames };
        if self.is_done(setting, &of, &dictionary.digest(), out) {
            return Ok(());
        }
        if out.exists() {
            let cause = "it is there already, damaged or of something else: delete it to have it made again".to_owned();
            return Err(ManyError::Part { path: out.to_owned(), cause });
        }
        match self {
            Job::Members => candidates(setting, &of, dictionary)?.write(out, &setting.scenario),
            Job::Moments => sums(setting, &of, dictionary)?.write(out, &setting.scenario),
        }
    }

    /// Whether a part is there, whole and of this work; `dictionary`: its digest.
    pub fn is_done(&self, setting: &Setting, of: &Piece<'_>, dictionary: &str, out: &Path) -> bool {
        let head = Head::of(self, of, dictionary.to_owned());
        read_part(out, &setting.scenario)
            .is_ok_and(|mut part| Head::take(&mut part.snapshot).is_ok_and(|of| of == head))
    }
}

/// What `adagio members` or `adagio moments` does, with absolute paths.
#[derive(Debug, Clone)]
pub struct Work {
    /// `members` or `moments`.
    pub verb: &'static str,
    /// The log.
    pub log: PathBuf,
    /// Which of its frames, as they come in it from 0.
    pub frames: Range<u64>,
    /// The complete scenario.
    pub scenario: PathBuf,
    /// The dictionary.
    pub dictionary: PathBuf,
    /// The part to be made.
    pub out: PathBuf,
}

/// What a part says of itself.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Head {
    kind: String,
    /// Digest of the log's files.
    log: String,
    /// Digest of the dictionary.
    dictionary: String,
    /// Its frames.
    frames: Range<u64>,
    /// How many the log has.
    frames_of_log: u64,
}

impl Head {
    fn of(job: &Job, Piece { log, frames }: &Piece<'_>, dictionary: String) -> Self {
        Head {
            kind: job.verb().to_owned(),
            log: log.digest.clone(),
            dictionary,
            frames: frames.clone(),
            frames_of_log: log.frames,
        }
    }

    /// Whether the log ends with it.
    fn is_last(&self) -> bool {
        self.frames.end == self.frames_of_log
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.value("kind", &mut self.kind)?;
        snapshot.value("log", &mut self.log)?;
        snapshot.value("dictionary", &mut self.dictionary)?;
        snapshot.value("frames", &mut self.frames)?;
        snapshot.value("frames_of_log", &mut self.frames_of_log)
    }

    fn take(snapshot: &mut Snapshot) -> Result<Self, SnapshotError> {
        let mut head = Head::default();
        head.persist(snapshot)?;
        Ok(head)
    }
}

/// Parts, and the digests of the logs that they should be of, where that is known.
pub type PartsOf<'a> = (&'a [PathBuf], Option<&'a [&'a str]>);

/// Parts of one kind over one dictionary, in the order of the logs and of their frames; of each log there is every frame, once.
fn in_order<'a>(
    (paths, logs): PartsOf<'a>,
    scenario: &Scenario,
    (job, dictionary): (&Job, &Dictionary),
) -> Result<Vec<(Head, &'a Path)>, ManyError> {
    let head = |path: &'a PathBuf| {
        let part = |cause: String| ManyError::Part { path: path.clone(), cause };
        let mut of = read_state_head(path, scenario).map_err(|cause| part(cause.to_string()))?;
        Ok((Head::take(&mut of).map_err(|cause| part(cause.to_string()))?, path.as_path()))
    };
    let mut parts: Vec<(Head, &Path)> = paths.iter().map(head).collect::<Result<_, ManyError>>()?;
    parts.sort_by(|(a, _), (b, _)| (&a.log, a.frames.start).cmp(&(&b.log, b.frames.start)));
    let digest = dictionary.digest();
    for (head, path) in &parts {
        let refuse = |cause: String| Err(ManyError::Part { path: path.to_path_buf(), cause });
        if head.kind != job.verb() {
            return refuse(format!("it holds {}, not {}", head.kind, job.verb()));
        }
        if head.dictionary != digest {
            return refuse(format!("it is over dictionary {:.8}, not over {digest:.8}", head.dictionary));
        }
        if logs.is_some_and(|logs| !logs.contains(&head.log.as_str())) {
            return Err(ManyError::Together(format!(
                "{} is of another log: one has changed meanwhile, or lies elsewhere under the same name",
                path.display()
            )));
        }
    }
    for of_log in parts.chunk_by(|(a, _), (b, _)| a.log == b.log) {
        if let Some([a, b]) = of_log.array_windows().find(|[a, b]| a.0.frames.end > b.0.frames.start) {
            let text =
                format!("{} and {} are parts of the same frames: each counts once", a.1.display(), b.1.display());
            return Err(ManyError::Together(text));
        }
        let ends = of_log.iter().map(|(head, _)| head.frames.end);
        let (head, path) = &of_log[0];
        let starts = of_log[1..].iter().map(|(head, _)| head.frames.start).chain([head.frames_of_log]);
        let missing = ends.zip(starts).chain([(0, head.frames.start)]).find(|(end, start)| end < start);
        if let Some((end, start)) = missing {
            let text = format!("frames {end}..{start} of the log of {} are in no part", path.display());
            return Err(ManyError::Together(text));
        }
    }
    Ok(parts)
}

/// A part whose content does not fit.
fn unusable(path: &Path, cause: &SnapshotError) -> ManyError {
    ManyError::Part { path: path.to_owned(), cause: cause.to_string() }
}

fn read_part(path: &Path, scenario: &Scenario) -> Result<SavedState, ManyError> {
    let part = |cause: String| ManyError::Part { path: path.to_owned(), cause };
    let bytes = std::fs::read(path).map_err(|cause| part(cause.to_string()))?;
    read_state(&bytes, scenario).map_err(|cause| part(cause.to_string()))
}

fn write_part(path: &Path, snapshot: Snapshot, frames: u64, scenario: &Scenario) -> Result<(), ManyError> {
    Ok(write_state(path, SavedState { snapshot, frame: frames, stamp_ns: 0 }, scenario)?)
}
