//! What another program's log holds, and which of its topics is what.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::log::messages::{self as msg, Message as _, foreign};
use crate::log::{LogError, LogReader, Record, topics};
use crate::robot::ActionSet;
use crate::scenario::{Scenario, Stamps, TopicChoice};

/// Intervals between messages that the usual one is the median of.
const INTERVALS: usize = 1000;

/// Damaged records that are described one by one.
const MOST_DAMAGE: usize = 5;

/// Why another program's log cannot be learned from.
#[derive(Debug, Error)]
pub enum ImportError {
    /// The folder or file cannot be read.
    #[error("cannot open the log {path}: {cause}")]
    Open {
        /// The folder or file.
        path: PathBuf,
        /// What the operating system says.
        cause: std::io::Error,
    },
    /// There is no log in it.
    #[error("{0} holds no .mcap file")]
    NoFiles(PathBuf),
    /// A file cannot be read.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A topic is missing, is of another type, or is one of several.
    #[error("{reason}\n{path} holds:\n{topics}")]
    Topic {
        /// What is wrong, and what can be done.
        reason: String,
        /// The log.
        path: PathBuf,
        /// Its topics, one a line.
        topics: String,
    },
    /// Images come too fast or too slowly for the scenario's actions.
    #[error("{0}")]
    Rate(String),
    /// Nothing came of all images.
    #[error("{path}: none of {images} images could be used: {reason}")]
    Nothing {
        /// The log.
        path: PathBuf,
        /// Images on the camera's topic.
        images: u64,
        /// Why.
        reason: String,
    },
}

/// A topic of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Seen {
    /// Type of its messages.
    pub kind: String,
    /// How they are encoded; only `cdr` can be read.
    pub encoding: String,
    /// Messages.
    pub messages: u64,
    /// Earliest and latest stamp, nanoseconds.
    pub stamps_ns: (u64, u64),
    last_ns: u64,
    intervals_ns: Vec<u64>,
}

impl Seen {
    /// Usual time between messages, nanoseconds; `None` for a single one.
    pub fn interval_ns(&self) -> Option<u64> {
        let mut sorted = self.intervals_ns.clone();
        sorted.sort_unstable();
        sorted.get(sorted.len() / 2).copied().filter(|&interval| interval > 0)
    }
}

/// What a log holds.
#[derive(Debug, Clone)]
pub struct LogContents {
    /// The folder or file.
    pub path: PathBuf,
    /// The log files, in order.
    pub files: Vec<PathBuf>,
    /// The topics that have messages.
    pub topics: BTreeMap<String, Seen>,
    /// Records that could not be read, the first few.
    pub damage: Vec<String>,
}

/// Which topic is what.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Roles {
    /// Camera images.
    pub camera: String,
    /// Where the robot is.
    pub pose: Option<String>,
    /// Where it is by its own counting.
    pub odometry: Option<String>,
    /// The velocity that was commanded.
    pub command: Option<String>,
    /// Actions.
    pub action: Option<String>,
    /// Distances.
    pub sonar: Option<String>,
    /// What somebody marks.
    pub mark: Option<String>,
    /// Rewards, by task.
    pub rewards: Vec<Option<String>>,
}

/// Types of images.
const CAMERA: [&str; 2] = [msg::Image::TYPE, foreign::CompressedImage::TYPE];
/// Types of poses that are one; transforms hold many, and are only taken where there is nothing else.
const POSE: [&str; 3] = [msg::Odometry::TYPE, msg::PoseStamped::TYPE, foreign::PoseWithCovarianceStamped::TYPE];
const TRANSFORMS: &str = foreign::TfMessage::TYPE;
const COMMAND: [&str; 2] = [msg::Twist::TYPE, msg::TwistStamped::TYPE];
/// Types of actions that are nothing else, and those that could be anything.
const ACTION: &str = msg::Decision::TYPE;
const INTEGERS: [&str; 8] = [
    foreign::Int8::TYPE,
    foreign::Int16::TYPE,
    foreign::Int32::TYPE,
    foreign::Int64::TYPE,
    foreign::UInt8::TYPE,
    foreign::UInt16::TYPE,
    foreign::UInt32::TYPE,
    foreign::UInt64::TYPE,
];
/// Types of rewards beside those.
const NUMBERS: [&str; 3] = [foreign::Bool::TYPE, foreign::Float32::TYPE, foreign::Float64::TYPE];
const SONAR: &str = msg::LaserScan::TYPE;

/// Whether messages of a type begin with a header.
fn has_header(kind: &str) -> bool {
    let stamped = [SONAR, ACTION, msg::TwistStamped::TYPE];
    CAMERA.contains(&kind) || POSE.contains(&kind) || stamped.contains(&kind)
}

/// When a message was, nanoseconds: by its header if it has one that is set, else when it was logged.
pub fn stamp_ns(kind: &str, data: &[u8], log_time_ns: u64, stamps: Stamps) -> u64 {
    if stamps == Stamps::Log || !has_header(kind) {
        return log_time_ns;
    }
    // The header is the first field, and its stamp the header's: seconds and nanoseconds after the four bytes of CDR.
    let number = |at: usize| Some(u32::from_le_bytes(data.get(at..at + 4)?.try_into().ok()?));
    let header = || Some(msg::Time { sec: number(4)?.cast_signed(), nanosec: number(8)? }.stamp_ns());
    header().filter(|&stamp| stamp > 0).unwrap_or(log_time_ns)
}

/// The files of a log: itself, or those in its folder, numbered as recorders number them (`bag_2` before `bag_10`).
fn files_of(path: &Path) -> Result<Vec<PathBuf>, ImportError> {
    let failed = |cause| ImportError::Open { path: path.to_owned(), cause };
    if !std::fs::metadata(path).map_err(failed)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let mut files = Vec::new();
    for entry in std::fs::read_dir(path).map_err(failed)? {
        let file = entry.map_err(failed)?.path();
        if file.extension().is_some_and(|extension| extension == "mcap") {
            files.push(file);
        }
    }
    let number = |file: &PathBuf| {
        let stem = file.file_stem()?.to_str()?;
        stem.rsplit(|c: char| !c.is_ascii_digit()).next()?.parse::<u64>().ok()
    };
    files.sort_by(|a, b| number(a).cmp(&number(b)).then_with(|| a.cmp(b)));
    if files.is_empty() { Err(ImportError::NoFiles(path.to_owned())) } else { Ok(files) }
}

impl LogContents {
    /// Read a log file, or all of a folder, in one pass.
    ///
    /// # Errors
    /// A file that cannot be read. Damage is part of the result.
    pub fn of(path: &Path, stamps: Stamps) -> Result<Self, ImportError> {
        let files = files_of(path)?;
        let mut survey = LogContents { path: path.to_owned(), files, topics: BTreeMap::new(), damage: Vec::new() };
        for file in survey.files.clone() {
            let mut reader = LogReader::open(&file)?.without_attachments();
            loop {
                while let Some(record) = reader.next() {
                    match record {
                        Ok(record) => survey.take(&record, &reader, stamps),
                        Err(error @ LogError::Read { .. }) => return Err(error.into()),
                        Err(error) if survey.damage.len() < MOST_DAMAGE => survey.damage.push(error.to_string()),
                        Err(_) => {}
                    }
                }
                if !reader.go_on()? {
                    break;
                }
            }
        }
        Ok(survey)
    }

    fn take(&mut self, record: &Record, reader: &LogReader, stamps: Stamps) {
        let Record::Message { topic, schema, channel, log_time_ns, data, .. } = record else { return };
        let stamp = stamp_ns(schema, data, *log_time_ns, stamps);
        let Some(seen) = self.topics.get_mut(&**topic) else {
            let encoding = reader.channel(*channel).map_or("unknown", |channel| channel.encoding).to_owned();
            let (kind, messages, stamps_ns) = (schema.to_string(), 1, (stamp, stamp));
            let seen = Seen { kind, encoding, messages, stamps_ns, last_ns: stamp, intervals_ns: Vec::new() };
            self.topics.insert(topic.to_string(), seen);
            return;
        };
        seen.messages += 1;
        seen.stamps_ns = (seen.stamps_ns.0.min(stamp), seen.stamps_ns.1.max(stamp));
        if seen.intervals_ns.len() < INTERVALS {
            seen.intervals_ns.extend(stamp.checked_sub(seen.last_ns));
        }
        seen.last_ns = stamp;
    }

    /// Which topic is what, as the scenario says, or by their types. A pose is needed for goals by coordinates, and to find actions
    /// where they were not recorded.
    ///
    /// # Errors
    /// [`ImportError::Topic`].
    pub fn roles(&self, scenario: &Scenario) -> Result<Roles, ImportError> {
        let wanted = &scenario.topics;
        let missing = |key: &str| self.refuse(format!("topics.{key} = \"none\": without it nothing can be learned"));
        let pose_kinds = [&POSE[..], &[TRANSFORMS]].concat();
        let camera = self.role("topics.camera", &wanted.camera, &CAMERA, &[&CAMERA], true)?;
        let action_kinds = [&[ACTION, msg::Text::TYPE][..], &INTEGERS].concat();
        let action = self.role("topics.action", &wanted.action, &action_kinds, &[&[ACTION]], false)?;
        let robot = &scenario.robot;
        // Which of others it was cannot be told from a motion.
        if action.is_none()
            && robot.actions != ActionSet::differential_drive(robot.forward, robot.turn_deg.to_radians())
        {
            return Err(self.refuse(
                "topics.action is not given: with [[action]] the log must say which of them was done".to_owned(),
            ));
        }
        let needs_pose = scenario.robot.pose_known || action.is_none();
        let pose = self.role("topics.pose", &wanted.pose, &pose_kinds, &[&POSE, &[TRANSFORMS]], needs_pose)?;
        if pose.is_none() && needs_pose {
            let known = scenario.robot.pose_known;
            let why =
                if known { "robot.pose = \"known\" needs it" } else { "without topics.action it finds the actions" };
            return Err(self.refuse(format!("topics.pose = \"none\": {why}")));
        }
        let mark = match &wanted.mark {
            TopicChoice::Auto if !self.topics.contains_key(topics::MARK.name()) => None,
            TopicChoice::Auto => Some(TopicChoice::Named(topics::MARK.name().to_owned())),
            choice => Some(choice.clone()),
        };
        let mark =
            mark.map(|choice| self.role("topics.mark", &choice, &[msg::Text::TYPE], &[], false)).transpose()?.flatten();
        let number_kinds = [&INTEGERS[..], &NUMBERS].concat();
        let reward = |(number, topic): (usize, &Option<String>)| match topic {
            None => Ok(None),
            Some(topic) => {
                let choice = TopicChoice::Named(topic.clone());
                self.role(&format!("task.{number}.topic"), &choice, &number_kinds, &[], true)
            }
        };
        let rewards = scenario.tasks.iter().map(|task| &task.topic).enumerate().map(reward);
        Ok(Roles {
            camera: camera.ok_or_else(|| missing("camera"))?,
            odometry: self.odometry(&wanted.odometry, pose.as_deref())?,
            pose,
            command: self.role("topics.command", &wanted.command, &COMMAND, &[&COMMAND], false)?,
            sonar: self.role("topics.sonar", &wanted.sonar, &[SONAR], &[&[SONAR]], false)?,
            action,
            mark,
            rewards: rewards.collect::<Result<_, _>>()?,
        })
    }

    /// The topic of odometry: the named one; or the only one of its type, where the pose's does not count if there is another.
    fn odometry(&self, wanted: &TopicChoice, pose: Option<&str>) -> Result<Option<String>, ImportError> {
        let is = |seen: &Seen| seen.encoding == "cdr" && seen.kind == msg::Odometry::TYPE;
        let others = self.topics.iter().filter(|(name, seen)| is(seen) && Some(name.as_str()) != pose);
        match (wanted, &others.collect::<Vec<_>>()[..]) {
            (TopicChoice::Auto, [(other, _)]) => Ok(Some((*other).clone())),
            _ => self.role("topics.odometry", wanted, &POSE, &[&[msg::Odometry::TYPE]], false),
        }
    }

    /// The topic of one part: the named one, which must be of one of `kinds`; or the only one of the first group of types
    /// that has any.
    fn role(
        &self,
        key: &str,
        wanted: &TopicChoice,
        kinds: &[&str],
        groups: &[&[&str]],
        needed: bool,
    ) -> Result<Option<String>, ImportError> {
        let name = match wanted {
            TopicChoice::None => return Ok(None),
            TopicChoice::Named(name) => name,
            TopicChoice::Auto => {
                for group in groups {
                    let fits = |seen: &Seen| seen.encoding == "cdr" && group.contains(&seen.kind.as_str());
                    let found: Vec<&String> =
                        self.topics.iter().filter(|(_, seen)| fits(seen)).map(|(name, _)| name).collect();
                    match found[..] {
                        [] => {}
                        [only] => return Ok(Some(only.clone())),
                        [first, ..] => {
                            return Err(self.refuse(format!(
                                "{} topics could be {key}: choose one, such as --set {key}={first}",
                                found.len()
                            )));
                        }
                    }
                }
                let reason = format!("no topic can be {key}: it must hold {} as cdr", kinds.join(" or "));
                return if needed { Err(self.refuse(reason)) } else { Ok(None) };
            }
        };
        match self.topics.get(name) {
            None => Err(self.refuse(format!("{key} = {name:?} has no messages"))),
            Some(seen) if seen.encoding == "cdr" && kinds.contains(&seen.kind.as_str()) => Ok(Some(name.clone())),
            Some(seen) => Err(self.refuse(format!(
                "{key} = {name:?} holds {} as {}: it must hold {} as cdr",
                seen.kind,
                seen.encoding,
                kinds.join(" or ")
            ))),
        }
    }

    fn refuse(&self, reason: String) -> ImportError {
        let mut topics = String::new();
        for (name, seen) in &self.topics {
            let encoding = if seen.encoding == "cdr" { String::new() } else { format!(" as {}", seen.encoding) };
            let _ = writeln!(topics, "  {name}: {} × {}{encoding}", seen.messages, seen.kind);
        }
        if self.topics.is_empty() {
            topics.push_str("  no messages");
            for damage in &self.damage {
                let _ = write!(topics, "\n  {damage}");
            }
        }
        ImportError::Topic { reason, path: self.path.clone(), topics: topics.trim_end().to_owned() }
    }
}
