//! What is shown of a run at one moment, in the terminal and on the page alike.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::Point2;
use serde::Serialize;

use super::follow::Follower;
use super::maps::{Maps, RoomView};
use super::picture::{Picture, finely};
use crate::agent::Controls;
use crate::log::LogError;
use crate::log::messages::Decision;
use crate::report::gather::{Downsample, HealthSeen};
use crate::robot::DriveState;
use crate::scenario::{Avoid, Task, plan_segments};

/// Points of the way that are shown: the end of it.
const WAY: usize = 900;

/// Points of each curve at most.
const POINTS: usize = 240;

/// A run that has not been heard of for so long is said to be silent: its log is written once a second.
const SILENT: Duration = Duration::from_secs(5);

/// How a run is doing, as far as its log says.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// Its log is being read for the first time.
    #[default]
    Reading,
    /// New records come.
    Running,
    /// It stands still because somebody wants it to.
    Paused,
    /// Nothing new has come for a while, and the log was not closed: it waits, or was killed.
    Silent,
    /// Its log was closed.
    Over,
}

/// A task.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct TaskView {
    /// Its name.
    pub name: String,
    /// Centre of the goal area, metres.
    pub goal: Option<[f64; 2]>,
    /// Radius of the goal area, metres.
    pub radius: f64,
    /// It is told by coordinates, and can be moved to others.
    pub movable: bool,
}

/// A place that marks say.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ShownView {
    /// Name of the task.
    pub name: String,
    /// It is to be avoided.
    pub avoid: bool,
    /// Frames that are marked as it.
    pub marks: u64,
}

/// An area to be avoided.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct AvoidView {
    /// Its name.
    pub name: String,
    /// Its centre, metres, where it is known.
    pub at: Option<[f64; 2]>,
    /// Its radius, metres.
    pub radius: f64,
}

/// A wall: its corners, metres, and its mean colour.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct WallView {
    /// From corner to corner.
    pub points: Vec<[f64; 2]>,
    /// RGB.
    pub colour: [u8; 3],
}

/// What was decided last.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct DecisionView {
    /// Number of the action, from 0.
    pub number: u64,
    /// What to do.
    pub action: &'static str,
    /// The task that is pursued; empty while exploring.
    pub task: String,
    /// Worth of forward, left, right; or empty.
    pub q_values: Vec<f64>,
    /// A reflex replaced what was wished.
    pub reflex: bool,
    /// How probable the place is that the robot most probably is at, 0 to 1; where places are told.
    pub sure: Option<f64>,
    /// Of a pursuit, actions until the goal that are expected, and how probable it is to arrive before it is given up.
    pub prospect: Option<(f64, f64)>,
}

/// The dictionary.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct DictionaryView {
    /// Support vectors.
    pub size: u32,
    /// Most of them that the scenario allows, where it is known.
    pub budget: Option<usize>,
    /// Width of the kernel.
    pub sigma: f64,
    /// Threshold of acceptance.
    pub nu: f64,
    /// Nothing more is accepted.
    pub full: bool,
}

/// A line of a curve: points (frames, value).
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Curve {
    /// What it is of.
    pub name: String,
    /// Frames and values.
    pub points: Vec<(f64, f64)>,
}

/// All curves.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Curves {
    /// Share of trials that arrive, by task.
    pub success: Vec<Curve>,
    /// Convergence quality, by task.
    pub quality: Vec<Curve>,
    /// Mean slowness of the features of each model, 1/s².
    pub slowness: Curve,
    /// Support vectors.
    pub growth: Curve,
    /// Frames per second.
    pub speed: Curve,
    /// 99th percentile of learning from a frame, ms.
    pub latency: Curve,
    /// Memory, MB.
    pub memory: Curve,
}

/// How the program is doing.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct HealthView {
    /// Frames per second of wall-clock time.
    pub frames_per_second: f64,
    /// Frame to action, 99th percentile, ms.
    pub act_p99_ms: f64,
    /// Learning from a frame, 99th percentile, ms.
    pub frame_p99_ms: f64,
    /// Memory, MB.
    pub memory_mb: f64,
    /// Name and depth of each queue.
    pub queues: Vec<(String, u32)>,
    /// Frames that the source dropped.
    pub dropped: u64,
    /// Frames left out of learning.
    pub quarantined: u64,
    /// Records of the log that could not be read.
    pub damaged: u64,
    /// Warnings and errors in the log.
    pub warnings: u64,
    /// The last diagnostics.
    pub said: Vec<String>,
}

/// The features.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct FeaturesView {
    /// The model they are of.
    pub epoch: u32,
    /// The first ones at the ends of the last actions: of each, frames and values.
    pub series: Vec<Curve>,
    /// Slowness of each feature of the newest model in the log, slowest first, 1/s².
    pub slowness: Vec<f64>,
}

/// A run at one moment.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct View {
    /// Scenario and seed; for a log of another program, its name.
    pub title: String,
    /// How the run is doing.
    pub phase: Phase,
    /// Seconds without news.
    pub quiet_seconds: f64,
    /// The newest frame.
    pub frame: u64,
    /// Actions completed, as far as the log has them.
    pub actions: u64,
    /// Actions that the scenario asks for.
    pub planned: Option<u64>,
    /// Seconds by the log's clock.
    pub seconds: f64,
    /// The model in use.
    pub epoch: u32,
    /// Where the robot is: metres, radians.
    pub pose: Option<[f64; 3]>,
    /// What a robot that takes velocities is doing, and why it may not move.
    pub robot: Option<String>,
    /// The last part of its way, metres.
    pub way: Vec<[f64; 2]>,
    /// Corners of what is shown of the room, metres.
    pub corners: Option<[[f64; 2]; 2]>,
    /// Walls.
    pub walls: Vec<WallView>,
    /// Tasks.
    pub tasks: Vec<TaskView>,
    /// What is to be avoided.
    pub avoids: Vec<AvoidView>,
    /// Places that marks say.
    pub shown: Vec<ShownView>,
    /// How the last pursuit ended.
    pub pursuit: Option<String>,
    /// What was decided last.
    pub decision: Option<DecisionView>,
    /// What the camera sees, rendered anew.
    pub camera: Option<Picture>,
    /// What is learned from.
    pub observation: Option<Picture>,
    /// The dictionary.
    pub dictionary: Option<DictionaryView>,
    /// The features.
    pub features: FeaturesView,
    /// The program.
    pub health: Option<HealthView>,
    /// Why something is missing.
    pub missing: Option<String>,
    /// Curves over frames.
    #[serde(skip)]
    pub curves: Curves,
    /// What the newest model makes of the room.
    #[serde(skip)]
    pub maps: Option<Arc<Maps>>,
}

/// Follows a run and says what to show of it.
pub struct Watcher {
    follower: Follower,
    lookout: RoomView,
    /// Whether all of the log was read once.
    begun: bool,
}

impl Watcher {
    /// A watcher of a run folder or a log file.
    pub fn new(place: &Path) -> Self {
        Watcher { follower: Follower::new(place), lookout: RoomView::new(place), begun: false }
    }

    /// Read what is new, no longer than about `limit`. Whether there was something.
    ///
    /// # Errors
    /// A file of the log cannot be opened or read.
    pub fn read_on(&mut self, limit: Duration) -> Result<bool, LogError> {
        let news = self.follower.read_on(limit)?;
        self.begun |= self.follower.is_up_to_date();
        self.lookout.know(&self.follower.gathered);
        Ok(news)
    }

    /// Whether everything that is there has been read.
    pub fn is_up_to_date(&self) -> bool {
        self.follower.is_up_to_date()
    }

    /// Wait until the newest model was looked at, of a run that is read to its end.
    pub fn settle(&mut self) {
        self.lookout.learn(true);
        self.lookout.wait_for_maps();
    }

    /// The run at this moment. A new model is looked at beside; until that is done, the maps are of the one before.
    pub fn view(&mut self, controls: Option<&Controls>) -> View {
        let over = self.follower.is_closed() || (self.begun && self.follower.quiet_for() > SILENT);
        if self.begun {
            self.lookout.learn(over);
        }
        let maps = self.lookout.maps().filter(|_| self.begun);
        let (gathered, newest) = (&self.follower.gathered, &self.follower.newest);
        let series = series(self.lookout.features(newest.recent.iter()));
        let scenario = self.lookout.scenario();
        let pose = gathered.last.back();
        let health = gathered.health.iter().last().map(|health| self.health(health));
        let place = |p: Point2<f64>| [roughly(p.x), roughly(p.y)];
        let action = |decision: &Decision| match decision.action {
            Decision::FORWARD => "forward",
            Decision::TURN_LEFT => "left",
            Decision::TURN_RIGHT => "right",
            _ => "?",
        };
        let task = |task: &Task| TaskView {
            name: task.name.clone(),
            goal: gathered.goals.get(&task.name).copied().or(task.goal),
            radius: task.radius,
            movable: task.needs_pose(),
        };
        let avoid = |avoid: &Avoid| AvoidView { name: avoid.name.clone(), at: avoid.at, radius: avoid.radius };
        let damage = gathered.damage.last().map(|text| format!("the log is damaged: {text}"));
        View {
            title: scenario.map_or_else(
                || "a log of another program".to_owned(),
                |scenario| format!("{}, seed {}", scenario.name, scenario.seed),
            ),
            phase: self.phase(controls),
            quiet_seconds: self.follower.quiet_for().as_secs_f64(),
            frame: gathered.last_frame,
            actions: gathered.actions,
            planned: scenario.map(|scenario| scenario.actions as u64),
            seconds: gathered.seconds(),
            epoch: gathered.epoch,
            pose: pose.map(|pose| [roughly(pose.position.x), roughly(pose.position.y), roughly(pose.heading)]),
            robot: newest.robot.clone(),
            way: gathered
                .last
                .iter()
                .skip(gathered.last.len().saturating_sub(WAY))
                .map(|p| place(p.position))
                .collect(),
            corners: self.corners(),
            walls: self.walls(),
            tasks: scenario.map_or(&[][..], |scenario| &scenario.tasks).iter().map(task).collect(),
            avoids: scenario.map_or(&[][..], |scenario| &scenario.avoids).iter().map(avoid).collect(),
            shown: scenario.map_or_else(Vec::new, |scenario| {
                let view = |(number, name): (usize, &str)| ShownView {
                    name: name.to_owned(),
                    avoid: number >= scenario.tasks.len(),
                    marks: gathered.marks.get(name).copied().unwrap_or(0),
                };
                let names = scenario.names().enumerate();
                names.filter(|&(number, _)| scenario.is_shown(number)).map(view).collect()
            }),
            pursuit: gathered.pursuit.as_ref().map(|end| {
                let how = if end.arrived { "arrived at" } else { "gave up" };
                format!("{how} {}, after {} actions", end.task, end.actions)
            }),
            decision: newest.decision.as_ref().map(|decision| DecisionView {
                number: decision.action_index,
                action: action(decision),
                task: decision.task.clone(),
                q_values: decision.q_values.iter().map(|&q| finely(q)).collect(),
                reflex: decision.reflex,
                sure: newest
                    .places
                    .as_ref()
                    .filter(|places| places.frame == decision.frame)
                    .and_then(|places| places.probabilities.first().copied()),
                prospect: newest
                    .prospect
                    .as_ref()
                    .filter(|prospect| prospect.frame == decision.frame)
                    .map(|prospect| (finely(prospect.actions), prospect.arrival)),
            }),
            camera: pose.and_then(|pose| self.lookout.camera(gathered.last_frame, pose)),
            observation: newest.observation.as_ref().filter(|seen| !seen.rgb.is_empty()).map(|seen| Picture {
                width: seen.width,
                height: seen.height,
                rgb: seen.rgb.clone(),
            }),
            dictionary: newest.growth.as_ref().map(|growth| DictionaryView {
                size: growth.size,
                budget: scenario.map(|scenario| scenario.dictionary.budget),
                sigma: growth.sigma,
                nu: growth.nu,
                full: growth.at_budget,
            }),
            features: FeaturesView {
                epoch: self.lookout.epoch(),
                series,
                slowness: gathered.slowness.iter().map(|&slowness| finely(slowness)).collect(),
            },
            health,
            missing: self.lookout.missing.clone().or(damage),
            curves: self.curves(),
            maps,
        }
    }

    fn phase(&self, controls: Option<&Controls>) -> Phase {
        let stopped = |state: &String| !state.starts_with(DriveState::Driving.name());
        // A robot may stand in the middle of an action.
        let is_stopped = self.follower.newest.robot.as_ref().is_some_and(stopped);
        if !self.begun {
            Phase::Reading
        } else if self.follower.is_closed() {
            Phase::Over
        } else if controls.is_some_and(|controls| controls.stands_still() || controls.is_paused() && is_stopped) {
            Phase::Paused
        } else if self.follower.quiet_for() > SILENT {
            Phase::Silent
        } else {
            Phase::Running
        }
    }

    fn corners(&self) -> Option<[[f64; 2]; 2]> {
        let has_walls = self.lookout.scenario().is_some_and(|scenario| !scenario.world.walls.is_empty());
        if let Some(world) = self.lookout.world().filter(|_| has_walls) {
            let (low, high) = world.plan.walls_box();
            return Some([low.into(), high.into()]);
        }
        let ways = self.follower.gathered.last.iter();
        let empty = (Point2::from([f64::INFINITY; 2]), Point2::from([f64::NEG_INFINITY; 2]));
        let (low, high) = ways.fold(empty, |(low, high), pose| (low.inf(&pose.position), high.sup(&pose.position)));
        let margin = nalgebra::Vector2::repeat(0.5);
        (low.x <= high.x).then(|| [(low - margin).into(), (high + margin).into()])
    }

    fn walls(&self) -> Vec<WallView> {
        let (Some(scenario), Some(world)) = (self.lookout.scenario(), self.lookout.world()) else { return Vec::new() };
        let colours = world.appearance.camera(self.follower.gathered.last_frame).wall_colours();
        let walls = scenario.world.walls.iter().enumerate();
        walls
            .map(|(index, wall)| {
                let pieces = plan_segments(wall);
                let first = pieces.first().map(|piece| piece.0);
                let points = first.into_iter().chain(pieces.iter().map(|piece| piece.1)).map(Into::into).collect();
                WallView { points, colour: colours.get(index).copied().unwrap_or([90; 3]) }
            })
            .collect()
    }

    fn health(&self, health: &HealthSeen) -> HealthView {
        let gathered = &self.follower.gathered;
        HealthView {
            frames_per_second: health.rate,
            act_p99_ms: health.act_ms,
            frame_p99_ms: health.frame_ms,
            memory_mb: health.rss as f64 / 1e6,
            queues: gathered.queues.iter().cloned().zip(health.depths.iter().copied()).collect(),
            dropped: gathered.dropped,
            quarantined: gathered.quarantined,
            damaged: gathered.damaged,
            warnings: gathered.warnings,
            said: self.follower.newest.said.iter().map(|(_, text)| text.clone()).collect(),
        }
    }

    fn curves(&self) -> Curves {
        let gathered = &self.follower.gathered;
        let tried = |of: fn(&crate::report::gather::Tried) -> f64| {
            let each = gathered.tried.iter();
            each.map(|(task, tried)| curve(task, tried, |tried| (tried.frame, of(tried)))).collect()
        };
        let health = |name: &str, of: fn(&HealthSeen) -> f64| curve(name, &gathered.health, |h| (h.frames, of(h)));
        Curves {
            success: tried(|tried| tried.success),
            quality: tried(|tried| tried.quality),
            slowness: curve("mean slowness", &gathered.models, |model| (model.frames, model.mean)),
            growth: curve("support vectors", &gathered.growth, |&(frame, size)| (frame, f64::from(size))),
            speed: health("frames per second", |health| health.rate),
            latency: health("frame, ms", |health| health.frame_ms),
            memory: health("MB", |health| health.rss as f64 / 1e6),
        }
    }
}

/// A series as a curve of not too many points; its last point is always one of them.
fn curve<T>(name: &str, series: &Downsample<T>, of: impl Fn(&T) -> (u64, f64)) -> Curve {
    let points: Vec<(f64, f64)> = series.iter().map(of).map(|(frame, value)| (frame as f64, finely(value))).collect();
    let every = points.len().div_ceil(POINTS).max(1);
    let last = points.len().saturating_sub(1);
    let kept = points.into_iter().enumerate().filter(|(i, _)| i % every == 0 || *i == last);
    Curve { name: name.to_owned(), points: kept.map(|(_, point)| point).collect() }
}

/// Values by frame as a series for each feature.
fn series(features: &[(u64, Vec<f64>)]) -> Vec<Curve> {
    let count = features.last().map_or(0, |(_, values)| values.len());
    let of = |i: usize| features.iter().filter_map(move |(frame, values)| Some((*frame as f64, *values.get(i)?)));
    (0..count).map(|i| Curve { name: format!("feature {}", i + 1), points: of(i).collect() }).collect()
}

/// Metres to the millimetre.
fn roughly(metres: f64) -> f64 {
    (1e3 * metres).round() / 1e3
}
