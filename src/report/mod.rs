//! What a run came to: `report.json` for scripts, a table and a page with drawings for people.
//!
//! ```text
//!  log ──one pass──▶ gather ─┐
//!  checkpoint ─────▶ room_maps ─┼─▶ figures, verdict ──▶ make ──▶ report.html, report/NAME.svg, report/NAME.png
//!  trials ───────────────────┘    (drawn by draw)
//! ```

pub mod draw;
pub mod figures;
pub mod foreign;
pub mod gather;
mod make;
mod room;
mod table;
mod verdict;

pub use make::{Made, MakeError, PLOTS_NAME, REPORT_NAME, make, write};
pub use room::Room;
pub use table::{Numbered, table, tasks_table};
pub use verdict::{Verdict, verdict};

use serde::Serialize;

use crate::agent::{CurvePoint, Outcome, Timing, peak_resident_bytes};
use crate::evaluate::{PoseDecode, TaskResult};
use crate::gpu::Choice;
use crate::scenario::Scenario;
use crate::source::ImportReport;

/// `report.json`. Keys stay once introduced; `None` is what a run could not know.
#[derive(Debug, Clone, Serialize)]
pub struct Report {
    /// The program.
    pub adagio: Program,
    /// What was run.
    pub scenario: RunInfo,
    /// How long it ran.
    pub run: Run,
    /// The dictionary at the end.
    pub dictionary: Option<Dictionary>,
    /// The newest features.
    pub model: Option<Model>,
    /// Results of each task.
    pub tasks: Vec<TaskResult>,
    /// Where each thing that can be pushed lay at the end, metres: trials find it there.
    pub movables: Vec<[f64; 2]>,
    /// What the features know of the pose.
    pub pose_decode: Option<PoseDecode>,
    /// Durations.
    pub timing_ms: Timing,
    /// Evaluations during the run.
    pub curve: Vec<CurvePoint>,
    /// Memory.
    pub memory: Memory,
    /// The log.
    pub log: Log,
    /// Pursuits during the run.
    pub pursuits: Vec<Pursuits>,
    /// What came of another program's log, if the frames are from one.
    pub imported: Option<ImportReport>,
    /// A hash of dictionary, features and policy weights.
    pub digest: Option<String>,
    /// Who made the numbers.
    pub computed_by: ComputedBy,
}

/// Who made a run's numbers, where a graphics processor may have.
#[derive(Debug, Clone, Serialize)]
pub struct ComputedBy {
    /// Pictures of many places at once, as in trials; those of the robot's camera too, if the scenario asks for a device. `None`:
    /// there were none, or the scenario leaves them to the processor.
    pub pictures: Option<Choice>,
    /// Kernel values of the window of transitions: they are the same whoever computes them. `None`: as above.
    pub kernel_values: Option<Choice>,
}

/// The program that ran.
#[derive(Debug, Clone, Serialize)]
pub struct Program {
    /// Version of the package.
    pub version: &'static str,
    /// Commit it was built from, where that is known.
    pub commit: Option<&'static str>,
}

impl Program {
    /// This program.
    pub fn this() -> Self {
        Program { version: env!("CARGO_PKG_VERSION"), commit: option_env!("ADAGIO_COMMIT") }
    }
}

/// What was run.
#[derive(Debug, Clone, Serialize)]
pub struct RunInfo {
    /// Name of the scenario.
    pub name: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// Hash of the complete scenario.
    pub sha256: String,
}

/// How long it ran.
#[derive(Debug, Clone, Serialize)]
pub struct Run {
    /// Actions executed.
    pub actions: u64,
    /// Frames seen.
    pub frames: u64,
    /// Wall-clock time of the run without the final evaluation, seconds.
    pub seconds: f64,
    /// Frames per second of wall-clock time.
    pub frames_per_second: f64,
    /// Frames that the source dropped.
    pub dropped_frames: u64,
    /// Frames left out of learning, because their values are not finite.
    pub quarantined_frames: u64,
    /// Whether the run continued an earlier one.
    pub resumed: bool,
    /// The run whose recorded frames this one was given, if it was.
    pub replay_of: Option<String>,
    /// Why the newest model could not be made, if it could not.
    pub without_model: Option<String>,
}

/// Where a run's frames came from, if not from a robot alone.
#[derive(Debug, Clone, Default)]
pub struct Origin {
    /// How often it went on after it had ended: 0 for a run of one part.
    pub part: u32,
    /// The run whose recorded frames it was given.
    pub replay_of: Option<String>,
    /// Its models are from the learner of a fleet.
    pub fleet: bool,
    /// Its frames are from a room that the scenario's simulated world does not look like.
    pub elsewhere: bool,
}

/// The dictionary.
#[derive(Debug, Clone, Serialize)]
pub struct Dictionary {
    /// Number of support vectors.
    pub support_vectors: usize,
    /// Kernel width, grey levels.
    pub sigma: f64,
    /// Acceptance threshold at the end; `None` for a random selection.
    pub nu: Option<f64>,
}

/// The newest features.
#[derive(Debug, Clone, Serialize)]
pub struct Model {
    /// Number of the model.
    pub epoch: u32,
    /// Number of slow features, without the constant one.
    pub features: usize,
    /// Slowness of each feature, 1/s², weighted as in training, ascending.
    pub slowness: Vec<f64>,
    /// Regulariser.
    pub lambda: f64,
}

/// Memory of the process.
#[derive(Debug, Clone, Serialize)]
pub struct Memory {
    /// The most it has held, bytes.
    pub peak_rss_bytes: Option<u64>,
}

/// The log.
#[derive(Debug, Clone, Serialize)]
pub struct Log {
    /// Files.
    pub files: u64,
    /// Bytes in all files.
    pub bytes: u64,
    /// Messages that this program wrote, in all files.
    pub messages: u64,
    /// Time that writing took its thread, seconds.
    pub busy_seconds: f64,
    /// Files that were deleted to stay within the budget.
    pub deleted_files: u64,
    /// Files that could not be written any further, and why; no message was lost.
    pub failures: Vec<String>,
}

/// How pursuits of a task during the run ended.
#[derive(Debug, Clone, Serialize)]
pub struct Pursuits {
    /// Name of the task.
    pub task: String,
    /// Pursuits that reached the goal.
    pub reached: usize,
    /// Pursuits that ended.
    pub ended: usize,
}

impl Report {
    /// The report of a run and of its final evaluation.
    pub fn new(
        scenario: &Scenario,
        outcome: &Outcome,
        tasks: Vec<TaskResult>,
        pose_decode: Option<PoseDecode>,
        origin: Origin,
        imported: Option<ImportReport>,
        computed_by: ComputedBy,
    ) -> Self {
        let learned = outcome.learned.as_deref();
        Report {
            adagio: Program::this(),
            scenario: RunInfo { name: scenario.name.clone(), seed: scenario.seed, sha256: scenario.sha256() },
            run: Run {
                actions: outcome.actions,
                frames: outcome.frames,
                seconds: outcome.seconds,
                frames_per_second: outcome.frames as f64 / outcome.seconds,
                dropped_frames: outcome.dropped,
                quarantined_frames: outcome.quarantined,
                resumed: origin.part > 0,
                replay_of: origin.replay_of,
                without_model: outcome.without_model.clone(),
            },
            dictionary: learned.map(|learned| Dictionary {
                support_vectors: outcome.support_vectors,
                sigma: learned.sigma(),
                nu: outcome.nu,
            }),
            model: learned.map(|learned| Model {
                epoch: learned.epoch,
                features: learned.model.slowness.len(),
                slowness: learned.model.slowness.clone(),
                lambda: scenario.slow.lambda,
            }),
            tasks,
            movables: Vec::new(),
            pose_decode,
            timing_ms: outcome.timing.clone(),
            curve: outcome.curve.clone(),
            memory: Memory { peak_rss_bytes: peak_resident_bytes() },
            log: Log {
                files: outcome.log.files,
                bytes: outcome.log.bytes,
                messages: outcome.log.messages,
                busy_seconds: outcome.log.busy.as_secs_f64(),
                deleted_files: outcome.log.deleted_files,
                failures: outcome.log.failures.clone(),
            },
            pursuits: scenario
                .tasks
                .iter()
                .zip(&outcome.pursuits)
                .map(|(task, tally)| Pursuits { task: task.name.clone(), reached: tally.reached, ended: tally.ended })
                .collect(),
            imported,
            digest: learned.map(|learned| learned.digest()),
            computed_by,
        }
    }
}
