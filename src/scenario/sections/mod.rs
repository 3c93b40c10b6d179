//! The sections of a scenario: every key with its unit, default, range and meaning.

mod actions;
mod agent;
mod body;
mod conduct;
mod learning;
mod motion;
mod robot;
mod ros2;
mod world;

pub use agent::*;
pub use body::{BodySettings, Movable};
pub use conduct::*;
pub use learning::*;
pub use motion::{Equipment, Motion, Safety};
pub use robot::*;
pub use ros2::{CommandType, Ros2};
pub use world::{Renderer, World};

use std::path::Path;

use super::Topics;
use super::change::Change;
use super::keys::Reader;
use conduct::Entry;

/// A checked scenario.
#[derive(Debug, Clone, PartialEq)]
pub struct Scenario {
    /// A name for people; by default the name of the file.
    pub name: String,
    /// Seed of all random streams.
    pub seed: u64,
    /// The run ends after this many actions.
    pub actions: usize,
    /// `[world]`
    pub world: World,
    /// `[robot]`
    pub robot: Robot,
    /// `[motion]` and `[safety]`, of robots that take velocities.
    pub motion: Option<Motion>,
    /// `[ros2]`, of robots on such a network.
    pub ros2: Option<Ros2>,
    /// `[body]`, of simulated robots with a mass.
    pub body: Option<BodySettings>,
    /// `[camera]`
    pub camera: Camera,
    /// `[vision]`
    pub vision: Vision,
    /// `[dictionary]`
    pub dictionary: Dictionary,
    /// `[slow]`
    pub slow: Slow,
    /// `[value]`
    pub value: Value,
    /// `[policy]`
    pub policy: Policy,
    /// `[agent]`
    pub agent: Agent,
    /// `[evaluate]`
    pub evaluate: Evaluate,
    /// `[log]`
    pub log: Log,
    /// `[topics]`
    pub topics: Topics,
    /// `[[change]]`
    pub changes: Vec<Change>,
    /// `[[task]]`, at least one.
    pub tasks: Vec<Task>,
    /// `[[task]]` with `avoid`; in the file they stand behind the others, and their numbers go on from theirs.
    pub avoids: Vec<Avoid>,
    /// `[[show]]`, in the order in which they happen.
    pub shows: Vec<Show>,
    /// The complete file, every default filled in.
    pub text: String,
    /// Old names of keys that the file uses, and the names of today: for people, not part of what is run.
    pub notes: Vec<String>,
}

impl Scenario {
    /// Read all sections; what is wrong goes to `reader.faults`, with the default in its place.
    pub(super) fn read(reader: &mut Reader<'_>, base: &Path, stem: &str) -> Self {
        let (name, seed, actions) = reader.section("", "", |s| {
            s.allow_sections(&[
                "world",
                "robot",
                "action",
                "motion",
                "safety",
                "body",
                "ros2",
                "camera",
                "vision",
                "dictionary",
                "slow",
                "value",
                "policy",
                "agent",
                "evaluate",
                "log",
                "topics",
                "change",
                "task",
                "show",
            ]);
            (
                s.text("name", stem, "name for people"),
                s.count("seed", 1, "", 0..=i64::MAX as usize, "seed of all random streams") as u64,
                s.count("actions", 15_000, "actions", 10..=1_000_000_000, "the run ends after this many"),
            )
        });
        let world = World::read(reader, base);
        let rooms = world.rooms.len();
        let mut robot = reader.section("robot", "", Robot::read);
        robot.actions = actions::read(reader, &robot);
        let (dynamic, on_ros2) = (robot.body == Body::Dynamic, robot.body == Body::Ros2);
        let motion = (dynamic || on_ros2).then(|| Motion::read(reader));
        let body = dynamic
            .then(|| reader.section("body", "the simulated robot's mass, motors, wheels, sensors", BodySettings::read));
        let ros2 = on_ros2.then(|| reader.section("ros2", "a robot on a ROS 2 network", Ros2::read));
        let either = "\"dynamic\" or \"ros2\"";
        let uses = [
            ("motion", motion.is_some(), either),
            ("safety", motion.is_some(), either),
            ("body", dynamic, "\"dynamic\""),
            ("ros2", on_ros2, "\"ros2\""),
        ];
        for (section, _, bodies) in uses.into_iter().filter(|(_, used, _)| !used) {
            reader.refuse_section(section, &format!("is for robot.body = {bodies}"));
        }
        let mut scenario = Scenario {
            name,
            seed,
            actions,
            world,
            robot: robot.clone(),
            motion,
            body,
            ros2,
            camera: reader.section("camera", "", Camera::read),
            vision: reader.section("vision", "camera image to observation", |s| Vision::read(s, robot.body)),
            dictionary: reader.section("dictionary", "support vectors", Dictionary::read),
            slow: reader.section("slow", "slow features", Slow::read),
            value: reader.section("value", "what actions are worth", |s| Value::read(s, rooms, actions)),
            policy: reader.section("policy", "exploration, pursuit, reflexes", |s| Policy::read(s, actions)),
            agent: reader.section("agent", "", |s| Agent::read(s, &robot)),
            evaluate: reader.section("evaluate", "", Evaluate::read),
            log: reader.section("log", "", Log::read),
            topics: reader.section("topics", "what another program's log calls its things", Topics::read),
            changes: reader
                .sections("change", "what changes while the robot drives", |s, index| Change::read(s, base, index)),
            tasks: Vec::new(),
            avoids: Vec::new(),
            shows: Vec::new(),
            text: String::new(),
            notes: Vec::new(),
        };
        for (index, entry) in reader.sections("task", "", Entry::read).into_iter().enumerate() {
            match entry {
                Entry::KeepAway(avoid) => scenario.avoids.push(avoid),
                Entry::Pursue(_) if !scenario.avoids.is_empty() => {
                    let text = "is behind a task with avoid: those must stand behind all others".to_owned();
                    reader.fault_at(&format!("task.{index}"), text);
                }
                Entry::Pursue(task) => scenario.tasks.push(task),
            }
        }
        scenario.shows = reader.sections("show", "somebody shows the robot a place", |s, _| Show::read(s));
        scenario
    }

    /// Names of all places that can be marked or driven to, by their number: tasks, then what is to be avoided.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        let tasks = self.tasks.iter().map(|task| task.name.as_str());
        tasks.chain(self.avoids.iter().map(|avoid| avoid.name.as_str()))
    }

    /// Whether marks say where the place of a number is.
    pub fn is_shown(&self, number: usize) -> bool {
        match self.tasks.get(number) {
            Some(task) => task.is_shown(),
            None => self.avoids.get(number - self.tasks.len()).is_some_and(Avoid::is_shown),
        }
    }

    /// Whether any place is shown.
    pub fn shows_any(&self) -> bool {
        self.tasks.iter().any(Task::is_shown) || self.avoids.iter().any(Avoid::is_shown)
    }
}
