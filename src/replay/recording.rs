//! What a run's log holds beside its frames, in one pass.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use thiserror::Error;

use crate::agent::{CurvePoint, RecordedEvents};
use crate::log::messages::{Decision, Evaluation, FrameTaken, ModelRequest, ModelUpdate};
use crate::log::writer::METADATA_NAME;
use crate::log::{Ending, Expected, FilesReader, LogError, Record, log_files, topics};
use crate::scenario::{Scenario, ScenarioError};

/// Why a run cannot be repeated.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// The folder or file cannot be read.
    #[error("cannot open the run {path}: {cause}")]
    Open {
        /// The folder or file.
        path: PathBuf,
        /// What the operating system says.
        cause: std::io::Error,
    },
    /// There is nothing in it.
    #[error(
        "{0} holds no log file run_NNN.mcap: it is not a run folder, or the run was ended before it had begun (begin it again with \
         `adagio run SCENARIO`; `adagio replay` learns from another program's logs with --scenario FILE)"
    )]
    Empty(PathBuf),
    /// The log does not say what was run.
    #[error(
        "{0} does not say which scenario was run: the run was ended before it had begun (begin it again with `adagio run \
         SCENARIO`), its metadata is damaged, or another program wrote it (`adagio replay` learns from such a log with \
         --scenario FILE)"
    )]
    NoScenario(PathBuf),
    /// The log has no frames that could be repeated.
    #[error(
        "{0} holds no frames (/adagio/frame), so there is nothing to repeat or to go on from: begin again \
         with `adagio run SCENARIO`, where the folder of a run keeps its scenario.toml"
    )]
    NoFrames(PathBuf),
    /// Its scenario, with the changes that were asked for, is not valid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A file cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
}

/// A recorded run.
#[derive(Debug, Clone, Default)]
pub struct Recording {
    /// The log files, in order.
    pub files: Vec<PathBuf>,
    /// Where the scenario's image files are looked for.
    path: PathBuf,
    /// Texts about the run.
    pub metadata: BTreeMap<String, String>,
    /// How often the run went on after it had ended.
    pub part: u32,
    /// What is known of each model, by its epoch.
    models: BTreeMap<u32, ModelUpdate>,
    /// Success and convergence quality of each task, by the epoch of the policy.
    evaluations: BTreeMap<u32, Vec<(f64, f64)>>,
    /// Requests, swaps, decisions.
    pub events: RecordedEvents,
    /// The messages that a run that goes on must log again.
    expected: Expected,
    /// Messages after the last frame, which finished the run: a repetition logs them too, a run that goes on does not.
    closing: Vec<(Arc<str>, u64, Vec<u8>)>,
    /// The course without what finished the run.
    open_events: Option<RecordedEvents>,
    /// Number of the first frame that is there; not 0 if the oldest files were deleted.
    pub first_frame: u64,
    /// Frames.
    pub frames: u64,
    /// The newest stamp of what follows from frames, nanoseconds.
    pub last_stamp_ns: u64,
    /// Whether the last file was closed.
    pub closed: bool,
    /// Records that could not be read, the first 20.
    pub damage: Vec<String>,
    /// Number of records that could not be read.
    pub damaged: u64,
}

/// Damaged records that are described one by one.
const MOST_DAMAGE: usize = 20;

impl Recording {
    /// Read the log of a run folder, or one log file.
    ///
    /// # Errors
    /// See [`RecordingError`]. Damage within the log is part of the result.
    pub fn open(run: &Path) -> Result<Self, RecordingError> {
        let files: Vec<PathBuf> = if run.is_file() {
            vec![run.to_owned()]
        } else {
            let files = log_files(run).map_err(|cause| RecordingError::Open { path: run.to_owned(), cause })?;
            files.into_iter().map(|(_, path)| path).collect()
        };
        let Some(first) = files.first() else { return Err(RecordingError::Empty(run.to_owned())) };
        let mut recording =
            Recording { path: first.clone(), files: files.clone(), first_frame: u64::MAX, ..Recording::default() };
        let mut records = FilesReader::new(files);
        for record in records.by_ref() {
            match record.and_then(|record| recording.read(&record)) {
                Ok(()) => {}
                Err(error @ (LogError::Open { .. } | LogError::Read { .. })) => return Err(error.into()),
                Err(error) => {
                    recording.damaged += 1;
                    if recording.damage.len() < MOST_DAMAGE {
                        recording.damage.push(error.to_string());
                    }
                }
            }
        }
        recording.closed = records.endings().last() == Some(&Ending::Complete);
        if recording.metadata.is_empty() {
            return Err(RecordingError::NoScenario(run.to_owned()));
        }
        if recording.frames == 0 {
            return Err(RecordingError::NoFrames(run.to_owned()));
        }
        Ok(recording)
    }

    /// Every file has the same texts, but for its number and that of the part of the run.
    fn begin_file(&mut self, metadata: &BTreeMap<String, String>) {
        let part = metadata.get("part").and_then(|part| part.parse().ok()).unwrap_or(0);
        if part > self.part {
            self.part = part;
            // The run went on: what had finished the part before does not count.
            self.closing.clear();
            if let Some(course) = self.open_events.take() {
                self.events = course;
            }
        }
        if self.metadata.is_empty() {
            self.metadata.clone_from(metadata);
        }
    }

    fn read(&mut self, record: &Record) -> Result<(), LogError> {
        let (topic, stamp_ns, data) = match record {
            Record::Message { topic, log_time_ns, data, .. } => (topic, *log_time_ns, data),
            Record::Metadata { name, map } if name == METADATA_NAME => {
                self.begin_file(map);
                return Ok(());
            }
            _ => return Ok(()),
        };
        if !topics::is_of_robot(topic) {
            self.last_stamp_ns = self.last_stamp_ns.max(stamp_ns);
        }
        let is = |name: &str| **topic == *name;
        if is(topics::END.name()) {
            self.open_events = Some(self.events.clone());
        }
        if self.open_events.is_some() {
            self.closing.push((topic.clone(), stamp_ns, data.clone()));
        } else {
            self.expected.record(topic, stamp_ns, data);
        }
        if is(topics::FRAME.name()) {
            let taken: FrameTaken = record.decode()?;
            self.first_frame = self.first_frame.min(taken.frame);
            self.frames += 1;
            self.events.seen(taken.frame);
        } else if is(topics::REQUEST.name()) {
            self.events.asked(record.decode::<ModelRequest>()?.frame);
        } else if is(topics::MODEL.name()) {
            let update: ModelUpdate = record.decode()?;
            self.events.effective(update.asked_at_frame, update.effective_at_frame);
            self.models.insert(update.epoch, update);
        } else if is(topics::EVALUATION.name()) {
            let Evaluation { epoch, success, convergence_quality, .. } = record.decode()?;
            self.evaluations.entry(epoch).or_default().push((success, convergence_quality));
        } else if is(topics::DECISION.name()) {
            record.decode::<Decision>()?;
            self.events.decided();
        }
        Ok(())
    }

    /// The scenario that was run, with changes.
    ///
    /// # Errors
    /// It is not valid with them.
    pub fn scenario(&self, sets: &[String]) -> Result<Scenario, RecordingError> {
        let text = self.metadata.get("scenario").ok_or_else(|| RecordingError::NoScenario(self.path.clone()))?;
        Ok(Scenario::parse(text, &self.path, sets)?)
    }

    /// The messages that a repetition of the whole run must log again.
    pub fn expected(&self) -> Expected {
        let mut expected = self.expected.clone();
        for (topic, stamp_ns, body) in &self.closing {
            expected.record(topic, *stamp_ns, body);
        }
        expected
    }

    /// What a run that goes on must do again: the messages that it must log again, and its course.
    pub fn open_end(&self) -> (Expected, RecordedEvents) {
        (self.expected.clone(), self.open_events.clone().unwrap_or_else(|| self.events.clone()))
    }

    /// The evaluations beside the run of models that acted up to a frame.
    pub fn curve(&self, frame: u64, scenario: &Scenario) -> Vec<CurvePoint> {
        let tasks = scenario.tasks.len();
        let models = self.models.values().filter(|model| model.effective_at_frame <= frame);
        let evaluated = models.filter_map(|model| Some((model, self.evaluations.get(&model.epoch)?)));
        evaluated
            .filter(|(_, results)| results.len() == tasks)
            .map(|(model, results)| CurvePoint {
                frames: model.frames,
                actions: (model.frames - 1) / scenario.robot.frames_per_action as u64,
                support_vectors: model.support_vectors as usize,
                success: results.iter().map(|result| result.0).sum::<f64>() / tasks as f64,
                convergence_quality: results.iter().map(|result| result.1).sum::<f64>() / tasks as f64,
                slowness_mean: model.slowness.iter().sum::<f64>() / model.slowness.len() as f64,
                // Models themselves are not in the log.
                feature_drift_deg: None,
            })
            .collect()
    }

    /// A reader of all its files.
    pub fn records(&self) -> FilesReader {
        FilesReader::new(self.files.clone())
    }
}
