//! From the messages of another program's log to what was sensed with each image.

use std::collections::VecDeque;
use std::sync::Arc;

use super::ImportReport;
use super::picture::{self, PictureError};
use super::topics::{Roles, stamp_ns};
use crate::log::messages::{self as msg, Message, foreign};
use crate::log::{FilesReader, LogError, Record, cdr};
use crate::robot::{Action, ActionSet, Pose, wrap};
use crate::scenario::{Scenario, Stamps};
use crate::source::live::Scan;
use crate::source::{Mark, parse_mark, planar};
use crate::vision::Observer;

/// Images that wait for a pose after them; then the oldest is given up.
const MOST_WAITING: usize = 4096;

/// Poses, commands, actions and scans that wait for an image; then the oldest is forgotten.
const MOST_AHEAD: usize = 1 << 16;

/// The names that a robot's own coordinate frame has.
pub const ROBOT_FRAMES: [&str; 2] = ["base_link", "base_footprint"];

/// An image with what else was known when it was taken.
#[derive(Debug, Clone)]
pub struct Sensed {
    pub stamp_ns: u64,
    /// The observation that vision made of it.
    pub pixels: Vec<u8>,
    /// Where the robot was; `None` where the log does not say it.
    pub pose: Option<Pose>,
    /// Where it was by its own counting; `None` where the log does not say it.
    pub odometry: Option<Pose>,
    /// Distances, the first straight ahead, counter-clockwise, metres.
    pub sonar: Vec<f32>,
    /// What was commanded since the image before, metres ahead.
    pub commanded: f64,
    /// What somebody marked since the image before, or with it.
    pub marks: Vec<Mark>,
    /// The newest rewards, by task.
    pub rewards: Vec<f64>,
}

/// Poses of one topic.
#[derive(Default)]
struct Track {
    /// The last one before the first image that waits, and those after it.
    poses: VecDeque<(u64, Pose)>,
}

impl Track {
    fn take(&mut self, kind: &str, data: &[u8], stamp_ns: u64, stamps: Stamps) -> Result<(), LogError> {
        let Some((own, pose)) = pose_of(kind, data)? else { return Ok(()) };
        let stamp_ns = own.filter(|&own| stamps == Stamps::Header && own > 0).unwrap_or(stamp_ns);
        let finite = pose.position.x.is_finite() && pose.position.y.is_finite() && pose.heading.is_finite();
        // Poses that are late, or repeated, say nothing new.
        if finite && self.poses.back().is_none_or(|last| last.0 < stamp_ns) {
            keep(&mut self.poses, (stamp_ns, pose), MOST_AHEAD);
        }
        Ok(())
    }

    /// The pose at a time, between two that are at most `hold_ns` apart: `None` if it is not known yet and there may be more,
    /// `Some(None)` if it never can be known.
    fn at(&mut self, stamp_ns: u64, hold_ns: u64, more: bool) -> Option<Option<Pose>> {
        // The last pose that is not after the image stays.
        while self.poses.get(1).is_some_and(|next| next.0 <= stamp_ns) {
            self.poses.pop_front();
        }
        let Some(&(before, a)) = self.poses.front() else { return (!more).then_some(None) };
        if before >= stamp_ns {
            // Where poses begin after the image, it has none.
            return Some((before == stamp_ns).then_some(a));
        }
        let Some(&(after, b)) = self.poses.get(1) else { return (!more).then_some(None) };
        if after - before > hold_ns {
            return Some(None);
        }
        let share = (stamp_ns - before) as f64 / (after - before) as f64;
        let position = a.position + (b.position - a.position) * share;
        Some(Some(Pose::new(position, a.heading + share * wrap(b.heading - a.heading))))
    }
}

/// The pose in a message of one of the types that hold some; none where transforms are those of other things. With it the
/// stamp of a transform, since a message of them has no header.
///
/// # Errors
/// The bytes are no such message.
pub fn pose_of(kind: &str, data: &[u8]) -> Result<Option<(Option<u64>, Pose)>, LogError> {
    Ok(Some(match kind {
        msg::Odometry::TYPE => (None, planar(&cdr::decode::<msg::Odometry>(data)?.pose.pose)),
        msg::PoseStamped::TYPE => (None, planar(&cdr::decode::<msg::PoseStamped>(data)?.pose)),
        foreign::PoseWithCovarianceStamped::TYPE => {
            (None, planar(&cdr::decode::<foreign::PoseWithCovarianceStamped>(data)?.pose.pose))
        }
        _ => {
            let transforms: foreign::TfMessage = cdr::decode(data)?;
            let robot = |transform: &&foreign::TransformStamped| {
                ROBOT_FRAMES.contains(&transform.child_frame_id.trim_start_matches('/'))
            };
            let Some(found) = transforms.transforms.iter().find(robot) else { return Ok(None) };
            (Some(found.header.stamp_ns()), planar(&found.transform.pose()))
        }
    }))
}

/// Puts together what was sensed, image by image.
pub struct Senses {
    scenario: Arc<Scenario>,
    roles: Roles,
    records: FilesReader,
    observer: Observer,
    ended: bool,
    /// Images that wait for their poses: their stamps and pixels.
    waiting: VecDeque<(u64, Vec<u8>)>,
    poses: Track,
    odometry: Track,
    commands: VecDeque<(u64, f64)>,
    /// The command that is being followed, and up to when it was counted.
    following: Option<(u64, f64)>,
    counted_to_ns: u64,
    scans: VecDeque<(u64, Vec<f32>)>,
    actions: VecDeque<(u64, Option<Action>)>,
    marks: VecDeque<(u64, Mark)>,
    /// Rewards that were published: the number of the task, and the reward.
    published: VecDeque<(u64, (usize, f64))>,
    /// Those that hold, by task.
    rewards: Vec<f64>,
    last_image_ns: Option<u64>,
    passed_over: usize,
    /// What came of the log, as far as it was read.
    pub report: ImportReport,
}

impl Senses {
    pub fn new(scenario: Arc<Scenario>, roles: Roles, records: FilesReader) -> Self {
        let any = roles.rewards.iter().any(Option::is_some);
        let rewards = if any { vec![f64::NAN; roles.rewards.len()] } else { Vec::new() };
        let known = &scenario.robot.actions;
        let action_names = known.iter().map(|action| known.name(action).to_owned()).collect();
        let report = ImportReport { actions: vec![0; known.len()], action_names, ..ImportReport::default() };
        Senses {
            scenario,
            roles,
            records,
            observer: Observer::default(),
            ended: false,
            waiting: VecDeque::new(),
            poses: Track::default(),
            odometry: Track::default(),
            commands: VecDeque::new(),
            following: None,
            counted_to_ns: 0,
            scans: VecDeque::new(),
            actions: VecDeque::new(),
            marks: VecDeque::new(),
            published: VecDeque::new(),
            rewards,
            last_image_ns: None,
            passed_over: 0,
            report,
        }
    }

    /// The next image that can be used; none at the end of the log.
    pub fn next(&mut self) -> Option<Sensed> {
        loop {
            if let Some((pose, odometry)) = self.poses_of_first() {
                let (stamp_ns, pixels) = self.waiting.pop_front()?;
                if pose.is_none() && self.roles.pose.is_some() {
                    self.report.without_pose += 1;
                    continue;
                }
                let (sonar, commanded) = (self.sonar_at(stamp_ns), self.known_until(stamp_ns));
                let marks = std::iter::from_fn(|| self.marks.pop_front_if(|mark| mark.0 <= stamp_ns));
                let marks = marks.map(|mark| mark.1).collect();
                while let Some((_, (task, reward))) = self.published.pop_front_if(|reward| reward.0 <= stamp_ns) {
                    self.rewards[task] = reward;
                }
                let rewards = self.rewards.clone();
                return Some(Sensed { stamp_ns, pixels, pose, odometry, sonar, commanded, marks, rewards });
            } else if self.ended {
                return None;
            } else {
                self.read();
            }
        }
    }

    /// The next action that began before a time; the inner `None` is a word for no action.
    pub fn action_before(&mut self, stamp_ns: u64) -> Option<(u64, Option<Action>)> {
        self.actions.pop_front_if(|action| action.0 < stamp_ns)
    }

    fn read(&mut self) {
        match self.records.next() {
            None => self.ended = true,
            Some(Err(_)) => self.report.damaged += 1,
            Some(Ok(Record::Message { topic, schema, log_time_ns, data, .. })) => {
                let stamp = stamp_ns(&schema, &data, log_time_ns, self.scenario.topics.stamps);
                let is = |role: &Option<String>| role.as_deref() == Some(&*topic);
                let stamps = self.scenario.topics.stamps;
                let (is_pose, is_odometry) = (is(&self.roles.pose), is(&self.roles.odometry));
                let taken = if *topic == *self.roles.camera {
                    self.image(&schema, &data, stamp);
                    Ok(())
                } else if is_pose || is_odometry {
                    // One topic can be both.
                    let mut tracks = [(is_pose, &mut self.poses), (is_odometry, &mut self.odometry)].into_iter();
                    tracks
                        .try_for_each(|(is, track)| if is { track.take(&schema, &data, stamp, stamps) } else { Ok(()) })
                } else if is(&self.roles.action) {
                    self.action(&schema, &data, stamp)
                } else if is(&self.roles.command) {
                    self.command(&schema, &data, stamp)
                } else if is(&self.roles.sonar) {
                    self.scan(&data, stamp)
                } else if is(&self.roles.mark) {
                    self.mark(&data, stamp)
                } else {
                    self.reward(&topic, &schema, &data, stamp)
                };
                self.report.damaged += u64::from(taken.is_err());
            }
            Some(Ok(_)) => {}
        }
    }

    fn image(&mut self, kind: &str, data: &[u8], stamp_ns: u64) {
        if self.passed_over > 0 {
            self.passed_over -= 1;
            return;
        }
        self.passed_over = self.scenario.topics.every - 1;
        self.report.images += 1;
        if self.last_image_ns.is_some_and(|last| stamp_ns <= last) {
            self.report.out_of_order += 1;
            return;
        }
        match self.observe(kind, data) {
            Ok(pixels) => {
                self.last_image_ns = Some(stamp_ns);
                self.waiting.push_back((stamp_ns, pixels));
            }
            Err(reason) => {
                self.report.unusable_images += 1;
                self.report.first_unusable.get_or_insert(reason);
            }
        }
    }

    /// What vision makes of an image.
    fn observe(&mut self, kind: &str, data: &[u8]) -> Result<Vec<u8>, String> {
        let text = |error: PictureError| error.to_string();
        let broken = |error: LogError| error.to_string();
        let image = if kind == msg::Image::TYPE {
            picture::raw(&cdr::decode(data).map_err(broken)?).map_err(text)?
        } else {
            picture::compressed(&cdr::decode(data).map_err(broken)?).map_err(text)?
        };
        let vision = &self.scenario.vision;
        let image = picture::crop(image, &self.scenario.camera, vision).map_err(text)?;
        let mut pixels = Vec::new();
        self.observer.observe(&image, vision, &mut pixels);
        Ok(pixels)
    }

    /// Pose and odometry of the first image that waits: `None` while one of them is not known yet.
    fn poses_of_first(&mut self) -> Option<(Option<Pose>, Option<Pose>)> {
        let stamp = self.waiting.front()?.0;
        let (hold, ended) = (self.hold_ns(), self.ended);
        if self.roles.pose.is_none() && self.roles.odometry.is_none() {
            // What belongs to an image has come when the next one is there.
            return (ended || self.waiting.len() > 1).then_some((None, None));
        }
        let more = !ended && self.waiting.len() <= MOST_WAITING;
        let at = |role: &Option<String>, track: &mut Track| match role {
            Some(_) => track.at(stamp, hold, more),
            None => Some(None),
        };
        at(&self.roles.pose, &mut self.poses).zip(at(&self.roles.odometry, &mut self.odometry))
    }

    /// What was true this long ago is still true: one duration of an action, and a little for stamps that jitter.
    fn hold_ns(&self) -> u64 {
        (1.05e9 * self.scenario.robot.action_seconds) as u64
    }

    fn command(&mut self, kind: &str, data: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        let twist = if kind == msg::Twist::TYPE {
            cdr::decode::<msg::Twist>(data)?
        } else {
            cdr::decode::<msg::TwistStamped>(data)?.twist
        };
        let late = self.commands.back().is_some_and(|last| stamp_ns < last.0);
        if twist.linear.x.is_finite() && !late {
            keep(&mut self.commands, (stamp_ns, twist.linear.x), MOST_AHEAD);
        }
        Ok(())
    }

    /// Metres ahead that were commanded from where the last image was counted to this one. A command holds until the next,
    /// but no longer than [`Senses::hold_ns`].
    fn known_until(&mut self, stamp_ns: u64) -> f64 {
        let mut commanded = 0.0;
        let hold = self.hold_ns();
        let mut at = self.counted_to_ns;
        let mut follow = |following: Option<(u64, f64)>, to: u64| {
            if let Some((since, speed)) = following {
                let seconds = to.min(since.saturating_add(hold)).saturating_sub(at.max(since)) as f64 / 1e9;
                commanded += speed * seconds;
            }
            at = to.max(at);
        };
        while let Some(next) = self.commands.pop_front_if(|next| next.0 <= stamp_ns) {
            follow(self.following, next.0);
            self.following = Some(next);
        }
        follow(self.following, stamp_ns);
        self.counted_to_ns = stamp_ns;
        commanded
    }

    fn scan(&mut self, data: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        let scan: msg::LaserScan = cdr::decode(data)?;
        let robot = &self.scenario.robot;
        let ring = Scan::of(&scan).ring(robot.sonars, robot.sonar_range as f32);
        keep(&mut self.scans, (stamp_ns, ring), MOST_WAITING);
        Ok(())
    }

    /// The last scan before a time; nothing in range if there is none.
    fn sonar_at(&mut self, stamp_ns: u64) -> Vec<f32> {
        while self.scans.get(1).is_some_and(|next| next.0 <= stamp_ns) {
            self.scans.pop_front();
        }
        let hold = self.hold_ns();
        let robot = &self.scenario.robot;
        match self.scans.front() {
            Some((stamp, scan)) if *stamp <= stamp_ns && stamp_ns - stamp <= hold => scan.clone(),
            _ => vec![robot.sonar_range as f32; robot.sonars],
        }
    }

    fn mark(&mut self, data: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        match parse_mark(&cdr::decode::<msg::Text>(data)?.data, &self.scenario) {
            Ok(mark) => keep(&mut self.marks, (stamp_ns, mark), MOST_AHEAD),
            Err(reason) => {
                self.report.unknown_marks += 1;
                self.report.first_unknown_mark.get_or_insert(reason);
            }
        }
        Ok(())
    }

    /// A number for the tasks whose reward a topic gives, if it is such a topic.
    fn reward(&mut self, topic: &str, kind: &str, data: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        for task in 0..self.roles.rewards.len() {
            if self.roles.rewards[task].as_deref() != Some(topic) {
                continue;
            }
            let reward = match kind {
                foreign::Bool::TYPE => f64::from(u8::from(cdr::decode::<foreign::Bool>(data)?.data)),
                foreign::Float32::TYPE => cdr::decode::<foreign::Float32>(data)?.data.into(),
                foreign::Float64::TYPE => cdr::decode::<foreign::Float64>(data)?.data,
                _ => integer(kind, data)?.map_or(f64::NAN, |number| number as f64),
            };
            keep(&mut self.published, (stamp_ns, (task, reward)), MOST_AHEAD);
        }
        Ok(())
    }

    fn action(&mut self, kind: &str, data: &[u8], stamp_ns: u64) -> Result<(), LogError> {
        let actions = &self.scenario.robot.actions;
        let numbered = |number: Option<i64>| actions.get(usize::try_from(number?).ok()?);
        let action = match kind {
            msg::Decision::TYPE => numbered(Some(cdr::decode::<msg::Decision>(data)?.action.into())),
            msg::Text::TYPE => named(actions, &cdr::decode::<msg::Text>(data)?.data),
            _ => numbered(integer(kind, data)?),
        };
        keep(&mut self.actions, (stamp_ns, action), MOST_AHEAD);
        Ok(())
    }
}

/// The action of a name; "turn left" is "turn_left" and "left", too.
fn named(actions: &ActionSet, word: &str) -> Option<Action> {
    let word = word.trim();
    let plain = |text: &str| text.to_lowercase().replace('_', " ");
    let is = |action: &Action| {
        let (name, word) = (plain(actions.name(*action)), plain(word));
        name == word || name.strip_prefix("turn ") == Some(&word)
    };
    let is_exactly = |action: &Action| actions.name(*action) == word;
    actions.iter().find(is_exactly).or_else(|| actions.iter().find(is))
}

/// The number in a message of one of the types of integers; `None` beyond those of 64 bits with a sign, and for other types.
fn integer(kind: &str, data: &[u8]) -> Result<Option<i64>, LogError> {
    Ok(match kind {
        foreign::Int8::TYPE => Some(cdr::decode::<foreign::Int8>(data)?.data.into()),
        foreign::Int16::TYPE => Some(cdr::decode::<foreign::Int16>(data)?.data.into()),
        foreign::Int32::TYPE => Some(cdr::decode::<foreign::Int32>(data)?.data.into()),
        foreign::Int64::TYPE => Some(cdr::decode::<foreign::Int64>(data)?.data),
        foreign::UInt8::TYPE => Some(cdr::decode::<foreign::UInt8>(data)?.data.into()),
        foreign::UInt16::TYPE => Some(cdr::decode::<foreign::UInt16>(data)?.data.into()),
        foreign::UInt32::TYPE => Some(cdr::decode::<foreign::UInt32>(data)?.data.into()),
        foreign::UInt64::TYPE => i64::try_from(cdr::decode::<foreign::UInt64>(data)?.data).ok(),
        _ => None,
    })
}

/// Add to a queue, and forget its oldest entry where it has too many.
fn keep<T>(queue: &mut VecDeque<T>, entry: T, most: usize) {
    queue.push_back(entry);
    if queue.len() > most {
        queue.pop_front();
    }
}
