//! The logs, and the frames in them.

use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use sha2::{Digest, Sha256};

use super::{ManyError, Setting};
use crate::agent::steps::{ModelTiming, Perceive, Sample, Tasks};
use crate::replay::Recording;
use crate::scenario::{Scenario, hex};
use crate::source::Recorded;
use crate::vision::Observation;

/// Bytes of a file that are hashed at a time.
const AT_ONCE: usize = 1 << 20;
/// Frames that are worked on alone, at most: some hours of driving.
pub const STRETCH: u64 = 1 << 16;

/// A log that can be learned from.
#[derive(Debug, Clone)]
pub struct Log {
    /// The run folder or file.
    pub path: PathBuf,
    /// Its files, in order.
    pub files: Vec<PathBuf>,
    /// A hash of all their bytes: what the log is called, wherever it lies.
    pub digest: String,
    /// Frames.
    pub frames: u64,
}

impl Log {
    /// Look at a log, from its first byte to its last.
    ///
    /// # Errors
    /// It cannot be read, is damaged, or is of another camera or other actions than the scenario's.
    pub fn open(path: &Path, scenario: &Scenario) -> Result<Self, ManyError> {
        let refuse = |cause: String| ManyError::Log(LeftOut { path: path.to_owned(), cause });
        let recording = Recording::open(path).map_err(|error| refuse(error.to_string()))?;
        if let Some(damage) = recording.damage.first() {
            return Err(refuse(format!("it is damaged, {} records cannot be read: {damage}", recording.damaged)));
        }
        let recorded = recording.scenario(&[]).map_err(|error| refuse(error.to_string()))?;
        if let Some(cause) = unlike(&recorded, scenario) {
            return Err(ManyError::Unlike(LeftOut { path: path.to_owned(), cause }));
        }
        let mut hash = Sha256::new();
        for file in &recording.files {
            let read = File::open(file).and_then(|mut file| {
                let mut bytes = vec![0; AT_ONCE];
                loop {
                    match file.read(&mut bytes)? {
                        0 => return Ok(()),
                        count => hash.update(&bytes[..count]),
                    }
                }
            });
            read.map_err(|error| refuse(error.to_string()))?;
        }
        let Recording { files, frames, .. } = recording;
        Ok(Log { path: path.to_owned(), files, digest: hex(&hash.finalize()), frames })
    }

    /// Its frames in stretches that are worked on alone.
    pub fn pieces(&self) -> impl Iterator<Item = Piece<'_>> {
        let starts = (0..self.frames).step_by(STRETCH as usize);
        starts.map(|start| Piece { log: self, frames: start..self.frames.min(start + STRETCH) })
    }
}

/// Frames of a log.
#[derive(Debug, Clone)]
pub struct Piece<'a> {
    /// The log.
    pub log: &'a Log,
    /// Which, as they come in it from 0.
    pub frames: Range<u64>,
}

impl<'a> Piece<'a> {
    /// All of them.
    pub fn whole(log: &'a Log) -> Self {
        Piece { log, frames: 0..log.frames }
    }

    /// The frames, as a run would see them: what was before is perceived, too.
    pub fn samples(&self, setting: &Setting) -> Samples {
        let (scenario, plan) = (setting.scenario.clone(), setting.plan.clone());
        let timing = Arc::new(ModelTiming::new(&scenario.agent, None));
        let recorded = Recorded::new(scenario.clone(), crate::log::FilesReader::new(self.log.files.clone()));
        let mut samples = Samples {
            recorded,
            perceive: Perceive::new(scenario, plan, timing),
            boundary: None,
            last: None,
            left: self.frames.start,
            seen: 0,
        };
        while let Some(sample) = samples.step() {
            if sample.link.is_none() {
                samples.boundary = None;
            }
            samples.last = Some(sample.observation.clone());
            if sample.boundary.is_some() {
                samples.boundary = Some(sample);
            }
        }
        samples.left = self.frames.end - self.frames.start;
        samples.seen = 0;
        samples
    }
}

/// In what a recorded run differs so that nothing can be learned from both.
fn unlike(recorded: &Scenario, scenario: &Scenario) -> Option<String> {
    let (of, ours) = (&recorded.robot, &scenario.robot);
    let camera = |scenario: &Scenario| {
        let (camera, vision) = (&scenario.camera, &scenario.vision);
        format!(
            "{} × {} pixels, {}° wide, {} m high, [vision] {vision:?}",
            camera.width, camera.height, camera.field_of_view_deg, camera.mount_height
        )
    };
    if camera(recorded) != camera(scenario) {
        return Some(format!("its camera is another one: {}, here {}", camera(recorded), camera(scenario)));
    }
    if of.actions != ours.actions {
        let motion = |scenario: &Scenario| {
            let of = |action| (scenario.robot.actions.name(action).to_owned(), scenario.robot.actions.motion(action));
            format!("{:?}", scenario.robot.actions.iter().map(of).collect::<Vec<_>>())
        };
        return Some(format!("its actions are others: {}, here {}", motion(recorded), motion(scenario)));
    }
    let [frames, ours] = [of, ours].map(|robot| (robot.frames_per_action, robot.frame_seconds()));
    (frames != ours)
        .then(|| format!("it has {} frames an action, {} s each, here {} and {} s", frames.0, frames.1, ours.0, ours.1))
}

/// Frames of a log, one after the other.
pub struct Samples {
    recorded: Recorded,
    perceive: Perceive,
    /// The last frame of the action before them, if none is missing since.
    pub(super) boundary: Option<Sample>,
    /// The one before them.
    pub(super) last: Option<Arc<Observation>>,
    left: u64,
    seen: u64,
}

impl Samples {
    /// The next ones, so many; fewer at the end.
    pub fn next(&mut self, count: usize) -> Vec<Sample> {
        std::iter::from_fn(|| self.step()).take(count).collect()
    }

    fn step(&mut self) -> Option<Sample> {
        self.left = self.left.checked_sub(1)?;
        let sample = self.perceive.step(self.recorded.take()?).seen.sample;
        self.seen += 1;
        Some(sample)
    }

    /// How many there were, behind the last one: all, or nothing can be learned from the log.
    pub(super) fn check(&self, of: &Piece<'_>) -> Result<u64, ManyError> {
        let (damaged, frames) = (self.recorded.damaged(), of.frames.end - of.frames.start);
        if damaged == 0 && self.seen == frames {
            return Ok(frames);
        }
        let cause = format!("{} of its {frames} frames can be learned from, {damaged} lack a part", self.seen);
        Err(ManyError::Log(LeftOut { path: of.log.path.clone(), cause }))
    }

    /// The tasks as they are behind the last frame.
    pub fn tasks(&self) -> Arc<Tasks> {
        self.perceive.tasks()
    }
}

/// A log that is left out, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeftOut {
    /// The run folder or file.
    pub path: PathBuf,
    /// Why.
    pub cause: String,
}

impl std::fmt::Display for LeftOut {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: {}", self.path.display(), self.cause)
    }
}

/// Logs that are learned from together.
#[derive(Debug, Default)]
pub struct Recordings {
    /// Those that can be, in the order of their digests.
    pub logs: Vec<Log>,
    /// Those that are damaged or cannot be read.
    pub left_out: Vec<LeftOut>,
}

impl Recordings {
    /// Look at logs; `tell` hears how many have been looked at, and says whether to go on.
    ///
    /// # Errors
    /// Logs of other cameras or other actions, all of them in one list; the same log twice; none that can be learned from.
    pub fn open(paths: &[PathBuf], scenario: &Scenario, tell: &dyn Fn(usize) -> bool) -> Result<Self, ManyError> {
        let (mut recordings, mut unlike) = (Recordings::default(), Vec::new());
        for (number, path) in paths.iter().enumerate() {
            match Log::open(path, scenario) {
                Ok(log) => recordings.logs.push(log),
                Err(ManyError::Unlike(log)) => unlike.push(log),
                Err(ManyError::Log(log)) => recordings.left_out.push(log),
                Err(other) => return Err(other),
            }
            if !tell(number + 1) {
                return Err(ManyError::NoModel("it was interrupted".into()));
            }
        }
        if !unlike.is_empty() {
            return Err(ManyError::AllUnlike(unlike));
        }
        recordings.logs.sort_by(|a, b| a.digest.cmp(&b.digest));
        if let Some([a, b]) = recordings.logs.array_windows().find(|[a, b]| a.digest == b.digest) {
            return Err(ManyError::Together(format!(
                "{} and {} are the same log: each counts once",
                a.path.display(),
                b.path.display()
            )));
        }
        match recordings.logs.is_empty() {
            true => Err(ManyError::Together(format!(
                "there is no log to learn from:\n{}",
                super::list(&recordings.left_out)
            ))),
            false => Ok(recordings),
        }
    }
}
