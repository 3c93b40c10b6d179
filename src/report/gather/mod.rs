//! What a report shows of a log, gathered in one pass and bounded memory, however long the log is.

mod downsample;
mod seen;

pub use downsample::Downsample;
pub use seen::{HealthSeen, ModelSeen, Motion, Pursued, Sample, TopicSeen, Tried};

use std::collections::{BTreeMap, VecDeque};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use mcap::MAGIC;
use nalgebra::Point2;

use crate::log::messages::{
    Decision, DictionaryGrowth, Evaluation, FrameTaken, GoalMoved, Health, Image, Log, ModelUpdate, PoseStamped,
    Prospect, PursuitEnded, Text,
};
use crate::log::writer::METADATA_NAME;
use crate::log::{FilesReader, LogError, Record, topics};
use crate::robot::{Pose, wrap};
use crate::scenario::FORGET;

/// Entries of series that become lines.
const LINE: usize = 1200;
/// Poses of the end of the way.
const LAST: usize = 3000;
/// Observations with their poses.
const SAMPLES: usize = 1600;
/// Places where members of the dictionary were taken.
const MEMBERS: usize = 4000;
/// Poses that are remembered until the dictionary says which frames it took.
const RECENT: usize = 1 << 14;
/// Diagnostics and damaged records that are shown one by one.
const SHOWN: usize = 60;
/// Side of the cells in which visits are counted, metres, and their number at most.
pub const CELL: f64 = 0.05;
const CELLS: usize = 200_000;

/// What a log says of itself where its frames are not from the scenario's simulated world.
pub const ROOM: (&str, &str) = ("room", "not simulated");

/// What a log holds, as far as a report shows it.
#[derive(Debug, Default)]
pub struct Gathered {
    /// What the log's files say of the run.
    pub metadata: BTreeMap<String, String>,
    /// Topics with messages.
    pub topics: BTreeMap<String, TopicSeen>,
    /// First and last stamp, nanoseconds.
    pub stamps_ns: Option<(u64, u64)>,
    /// Files.
    pub files: usize,
    /// Whether the last file was closed.
    pub closed: bool,
    /// Records that could not be read: their number, and the first ones.
    pub damaged: u64,
    /// The first of them.
    pub damage: Vec<String>,
    /// Observations that are missing between two others, those included that the source dropped.
    skipped: u64,
    /// Frames taken; number of the last one.
    pub frames: u64,
    /// Number of the first frame.
    pub first_frame: Option<u64>,
    /// Number of the last frame.
    pub last_frame: u64,
    /// Actions that were done.
    pub actions: u64,
    /// Poses.
    pub poses: u64,
    /// The end of the way, frame by frame.
    pub last: VecDeque<Pose>,
    /// How often each cell was visited.
    pub visits: BTreeMap<(i32, i32), u32>,
    /// Motion while driving, and while turning.
    pub motion: [Motion; 2],
    /// Observations with their poses, evenly over the run.
    pub samples: Downsample<Sample>,
    /// Support vectors by frame.
    pub growth: Downsample<(u64, u32)>,
    /// Where members of the dictionary were taken.
    pub members: Downsample<(u64, Pose)>,
    /// Members whose pose is not known.
    pub members_elsewhere: u64,
    /// Last frame of the newest block that went through the dictionary.
    grown_to: u64,
    /// The frame from which on nothing more was accepted.
    pub full_since: Option<u64>,
    /// Frames that were left out because they are not finite.
    pub quarantined: u64,
    /// Models.
    pub models: Downsample<ModelSeen>,
    /// Number of the newest model.
    pub epoch: u32,
    /// Slowness of the newest model's features.
    pub slowness: Vec<f64>,
    /// Trials beside the run, by task.
    pub tried: BTreeMap<String, Downsample<Tried>>,
    /// How the program was doing.
    pub health: Downsample<HealthSeen>,
    /// Names of the queues.
    pub queues: Vec<String>,
    /// Frames that the source dropped.
    pub dropped: u64,
    /// Warnings and errors: their number, and the first ones with their seconds.
    pub warnings: u64,
    /// The first of them.
    pub said: Vec<(f64, String)>,
    /// Goals that were moved: frame, task, new centre; the first 60.
    pub moved: Vec<GoalMoved>,
    /// The newest centre of each goal area that was moved, by task.
    pub goals: BTreeMap<String, [f64; 2]>,
    /// Frames that were marked as the goal of a task, by its name: an even selection of their pictures.
    pub marked: BTreeMap<String, Downsample<Marked>>,
    /// Frames that were marked as the place of a task, by its name.
    pub marks: BTreeMap<String, u64>,
    /// The last pursuit that is over.
    pub pursuit: Option<PursuitEnded>,
    /// Pursuits of which something was expected: an even selection.
    pub pursued: Downsample<Pursued>,
    /// What was expected at the beginning of the pursuit under way.
    begun: Option<Prospect>,
    /// The tasks for which the next observation is marked.
    marking: Vec<String>,
    recent: VecDeque<(u64, Pose)>,
    sequence: Option<u32>,
    /// Whether the first observation of this file follows the last one before; none before it is read.
    goes_on: Option<bool>,
}

/// An observation that was marked as a goal.
#[derive(Debug, Clone)]
pub struct Marked {
    /// Number of its frame.
    pub frame: u64,
    /// Its width, pixels.
    pub width: u32,
    /// Its height, pixels.
    pub height: u32,
    /// Red, green and blue of each pixel.
    pub rgb: Vec<u8>,
}

/// Pictures of marks that are kept for a task, at most.
const MARKED: usize = 16;

/// Whether a file ends as a log that was closed: damage within it changes nothing about that.
fn is_closed(file: &Path) -> bool {
    let mut end = [0; MAGIC.len()];
    let read = File::open(file).and_then(|mut file| {
        file.seek(SeekFrom::End(-(MAGIC.len() as i64)))?;
        file.read_exact(&mut end)
    });
    read.is_ok() && end == MAGIC
}

impl Gathered {
    /// Read log files one after the other. `tell` is told now and then how many messages were read.
    ///
    /// # Errors
    /// A file cannot be opened or read. Damage is part of the result.
    pub fn of(files: Vec<PathBuf>, tell: &dyn Fn(u64)) -> Result<Self, LogError> {
        let mut gathered = Gathered::empty(files.len());
        let mut read = 0u64;
        // Damage in files that were not closed: how many records, and the texts about them.
        let mut torn: Vec<(u64, Range<usize>)> = Vec::new();
        for file in files {
            let (damaged, texts) = (gathered.damaged, gathered.damage.len());
            gathered.goes_on = None;
            let closed = is_closed(&file);
            for record in FilesReader::new(vec![file]) {
                read += 1;
                if read.is_multiple_of(20_000) {
                    tell(read);
                }
                let taken = record.and_then(|record| gathered.read(&record));
                gathered.note(taken)?;
            }
            gathered.closed = closed;
            let own = (gathered.damaged - damaged, gathered.damage.len() - texts);
            if gathered.goes_on == Some(true) {
                // A run that was killed and went on has lost nothing: this file has what was torn in those before.
                for (count, texts) in torn.drain(..).rev() {
                    gathered.damaged -= count;
                    gathered.damage.drain(texts);
                }
            }
            if !gathered.closed {
                let end = gathered.damage.len();
                torn.push((own.0, end - own.1..end));
            }
        }
        Ok(gathered)
    }

    /// Observations that are missing and were not dropped by the source, whose frames have numbers, too.
    pub fn missing(&self) -> u64 {
        self.skipped.saturating_sub(self.dropped)
    }

    /// What came of a record: damage is counted.
    ///
    /// # Errors
    /// A file cannot be opened or read.
    pub(crate) fn note(&mut self, taken: Result<(), LogError>) -> Result<(), LogError> {
        match taken {
            Ok(()) => {}
            Err(error @ (LogError::Open { .. } | LogError::Read { .. })) => return Err(error),
            Err(error) => {
                self.damaged += 1;
                if self.damage.len() < SHOWN {
                    self.damage.push(error.to_string());
                }
            }
        }
        Ok(())
    }

    /// Nothing yet, of so many files.
    pub(crate) fn empty(files: usize) -> Self {
        Gathered {
            files,
            samples: Downsample::first_of(SAMPLES),
            growth: Downsample::last_of(LINE),
            members: Downsample::first_of(MEMBERS),
            models: Downsample::last_of(LINE),
            health: Downsample::new(LINE, HealthSeen::merge),
            pursued: Downsample::first_of(LINE),
            ..Gathered::default()
        }
    }

    /// Whether this program wrote the log.
    pub fn is_own(&self) -> bool {
        !self.metadata.is_empty() || self.topics.contains_key(topics::FRAME.name())
    }

    /// Length of the log by its clock, seconds.
    pub fn seconds(&self) -> f64 {
        self.stamps_ns.map_or(0.0, |(first, last)| (last - first) as f64 / 1e9)
    }

    /// Seconds from the first message to a stamp.
    pub fn seconds_at(&self, stamp_ns: u64) -> f64 {
        self.stamps_ns.map_or(0.0, |(first, _)| stamp_ns.saturating_sub(first) as f64 / 1e9)
    }

    /// The next record.
    ///
    /// # Errors
    /// It is damaged.
    pub(crate) fn read(&mut self, record: &Record) -> Result<(), LogError> {
        let (topic, schema, sequence, stamp) = match record {
            Record::Message { topic, schema, sequence, log_time_ns, .. } => (topic, schema, *sequence, *log_time_ns),
            Record::Metadata { name, map } if name == METADATA_NAME => {
                if self.metadata.is_empty() {
                    self.metadata.clone_from(map);
                }
                return Ok(());
            }
            _ => return Ok(()),
        };
        match self.topics.get_mut(&**topic) {
            Some(seen) => seen.messages += 1,
            None => {
                self.topics.insert(topic.to_string(), TopicSeen { kind: schema.to_string(), messages: 1 });
            }
        }
        let (first, last) = self.stamps_ns.unwrap_or((stamp, stamp));
        self.stamps_ns = Some((first.min(stamp), last.max(stamp)));
        // Another program may have another type on a topic of this name.
        let known = topics::ALL.iter().any(|known| known.name == &**topic && known.message == &**schema);
        let is = |name: &str| known && **topic == *name;
        if is(topics::POSE.name()) {
            let pose = record.decode::<PoseStamped>()?.pose;
            let pose = Pose::new(Point2::new(pose.position.x, pose.position.y), pose.heading());
            if pose.position.x.is_finite() && pose.position.y.is_finite() && pose.heading.is_finite() {
                self.posed(u64::from(sequence), pose);
            }
        } else if is(topics::OBSERVATION.name()) {
            self.observed(sequence, record)?;
        } else if is(topics::FRAME.name()) {
            self.taken(&record.decode()?);
        } else if is(topics::GOAL.name()) {
            let moved: GoalMoved = record.decode()?;
            if moved.x.is_finite() && moved.y.is_finite() {
                self.goals.insert(moved.task.clone(), [moved.x, moved.y]);
                if self.moved.len() < SHOWN {
                    self.moved.push(moved);
                }
            }
        } else if is(topics::MARK.name()) {
            let text = record.decode::<Text>()?.data;
            if let Some(name) = text.strip_prefix(FORGET) {
                self.marked.remove(name);
                self.marks.remove(name);
            } else {
                *self.marks.entry(text.clone()).or_insert(0) += 1;
                self.marking.push(text);
            }
        } else if is(topics::PURSUIT.name()) {
            let end: PursuitEnded = record.decode()?;
            if let Some(begun) = self.begun.take().filter(|begun| begun.task == end.task && end.actions > 0) {
                self.pursued.push(Pursued {
                    expected: begun.actions,
                    arrival: begun.arrival,
                    actions: end.actions,
                    arrived: end.arrived,
                });
            }
            self.pursuit = Some(end);
        } else if is(topics::PROSPECT.name()) {
            let prospect: Prospect = record.decode()?;
            if prospect.done == 0 {
                self.begun = Some(prospect);
            }
        } else if is(topics::DECISION.name()) {
            let decision: Decision = record.decode()?;
            // A pursuit that was called off.
            self.begun.take_if(|begun| begun.task != decision.task);
        } else if is(topics::TRANSITION.name()) {
            self.actions += 1;
        } else if is(topics::DICTIONARY.name()) {
            self.grew(&record.decode()?);
        } else if is(topics::MODEL.name()) {
            self.modelled(record.decode()?);
        } else if is(topics::EVALUATION.name()) {
            let tried: Evaluation = record.decode()?;
            self.tried.entry(tried.task).or_insert_with(|| Downsample::last_of(LINE)).push(Tried {
                frame: tried.frame,
                success: tried.success,
                low: tried.success_wilson_low,
                quality: tried.convergence_quality,
            });
        } else if is(topics::HEALTH.name()) {
            self.measured(record.decode()?, stamp);
        } else if is(topics::DIAGNOSTICS.name()) {
            let said: Log = record.decode()?;
            if said.level >= Log::WARN {
                self.warnings += 1;
                if self.said.len() < SHOWN {
                    self.said.push((self.seconds_at(stamp), said.msg));
                }
            }
        }
        Ok(())
    }

    fn posed(&mut self, frame: u64, pose: Pose) {
        self.passed(pose);
        if self.recent.len() == RECENT {
            self.recent.pop_front();
        }
        self.recent.push_back((frame, pose));
    }

    /// The robot passed through a pose.
    pub fn passed(&mut self, pose: Pose) {
        self.poses += 1;
        if self.last.len() == LAST {
            self.last.pop_front();
        }
        self.last.push_back(pose);
        let cell = (pose.position / CELL).coords.map(|c| c.floor() as i32);
        if self.visits.len() < CELLS || self.visits.contains_key(&(cell.x, cell.y)) {
            *self.visits.entry((cell.x, cell.y)).or_insert(0) += 1;
        }
    }

    fn pose_of(&self, frame: u64) -> Option<Pose> {
        // Frames come in order; where they do not, some are not found.
        let found = self.recent.binary_search_by_key(&frame, |recent| recent.0).ok()?;
        self.recent.get(found).map(|recent| recent.1)
    }

    fn observed(&mut self, sequence: u32, record: &Record) -> Result<(), LogError> {
        if let Some(last) = self.sequence {
            let ahead = sequence.wrapping_sub(last);
            self.goes_on.get_or_insert(ahead == 1);
            if (2..1 << 31).contains(&ahead) {
                self.skipped += u64::from(ahead) - 1;
            }
        }
        self.sequence = Some(sequence);
        for task in std::mem::take(&mut self.marking) {
            let Image { width, height, data, .. } = record.decode()?;
            let marked = Marked { frame: u64::from(sequence), width, height, rgb: data };
            self.marked.entry(task).or_insert_with(|| Downsample::first_of(MARKED)).push(marked);
        }
        let Some((_, pose)) = self.recent.back().copied().filter(|recent| recent.0 == u64::from(sequence)) else {
            return Ok(());
        };
        let make = || Ok(Sample { frame: u64::from(sequence), pose, pixels: record.decode::<Image>()?.data });
        self.samples.offer(make)
    }

    fn taken(&mut self, taken: &FrameTaken) {
        let follows = self.first_frame.is_some() && taken.frame == self.last_frame + 1;
        self.frames += 1;
        self.first_frame.get_or_insert(taken.frame);
        self.last_frame = self.last_frame.max(taken.frame);
        if let (true, Some([a, b])) = (follows && taken.action != FrameTaken::NO_ACTION, self.last_two(taken.frame)) {
            let motion = &mut self.motion[usize::from(taken.action != Decision::FORWARD)];
            motion.steps += 1.0;
            motion.distance += (b.position - a.position).norm_squared();
            motion.angle += wrap(b.heading - a.heading).powi(2);
        }
    }

    /// The poses of a frame and of the one before, if they were the last two.
    fn last_two(&self, frame: u64) -> Option<[Pose; 2]> {
        let before = self.recent.len().checked_sub(2)?;
        let (a, b) = (self.recent.get(before)?, self.recent.back()?);
        (a.0 + 1 == b.0 && b.0 == frame).then_some([a.1, b.1])
    }

    fn grew(&mut self, growth: &DictionaryGrowth) {
        if growth.first_frame < self.grown_to {
            // It began anew, with a wider kernel.
            (self.members, self.members_elsewhere) = (Downsample::first_of(MEMBERS), 0);
            self.quarantined = 0;
        }
        self.grown_to = growth.last_frame;
        self.growth.push((growth.last_frame, growth.size));
        self.quarantined += growth.quarantined.len() as u64;
        for &frame in &growth.accepted {
            match self.pose_of(frame) {
                Some(pose) => self.members.push((frame, pose)),
                None => self.members_elsewhere += 1,
            }
        }
        if !growth.at_budget {
            self.full_since = None;
        } else {
            self.full_since.get_or_insert(growth.last_frame);
        }
    }

    fn modelled(&mut self, model: ModelUpdate) {
        let mean = model.slowness.iter().sum::<f64>() / model.slowness.len().max(1) as f64;
        let slowest = model.slowness.first().copied().unwrap_or(f64::NAN);
        self.models.push(ModelSeen { frames: model.frames, mean, slowest });
        self.epoch = model.epoch;
        self.slowness = model.slowness;
    }

    fn measured(&mut self, health: Health, stamp: u64) {
        self.dropped = self.dropped.max(health.dropped_frames);
        self.quarantined = self.quarantined.max(health.quarantined_frames);
        if self.queues.is_empty() {
            self.queues = health.queues;
        }
        self.health.push(HealthSeen {
            seconds: self.seconds_at(stamp),
            frames: health.frames,
            rate: health.frames_per_second,
            act_ms: health.act_p99_ms,
            frame_ms: health.frame_p99_ms,
            depths: health.queue_depths,
            rss: health.rss_bytes,
        });
    }
}
