//! The sections of a scenario: every key with its unit, default, range and meaning.

use std::path::{Path, PathBuf};

use super::Topics;
use super::change::Change;
use super::distractors::Distractor;
use super::keys::{Range, Reader, Section};
use super::pyramids::Pyramid;
use super::rooms::{Room, walls_of};
use crate::dictionary::WhenFull;
use crate::log::{Compression, MAX_CHUNK_TARGET_BYTES};

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
    /// The complete file, every default filled in.
    pub text: String,
}

/// `[world]`: what the robot drives in.
#[derive(Debug, Clone, PartialEq)]
pub struct World {
    /// `[[world.room]]`
    pub rooms: Vec<Room>,
    /// `[[world.wall]]`, and behind them four walls for each room, in the order of [`SIDES`](super::SIDES).
    pub walls: Vec<Wall>,
    /// `[[world.pyramid]]`
    pub pyramids: Vec<Pyramid>,
    /// `[[world.distractor]]`
    pub distractors: Vec<Distractor>,
    /// `[world.floor]`
    pub floor: Texture,
    /// `[world.surroundings]`: what is seen above the walls, far away.
    pub surroundings: Texture,
}

/// `[[world.wall]]`: a polyline that stands upright.
#[derive(Debug, Clone, PartialEq)]
pub struct Wall {
    /// Corners, metres.
    pub points: Vec<[f64; 2]>,
    /// Whether the last corner is joined to the first.
    pub closed: bool,
    /// Parts without a wall, from and to, metres along it, in order and apart from each other.
    pub gaps: Vec<[f64; 2]>,
    /// Height, metres.
    pub height: f64,
    /// Wallpaper.
    pub texture: Texture,
}

/// A surface: an image file or a procedural pattern.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    /// Image file (PNG), repeated; overrides the pattern.
    pub image: Option<PathBuf>,
    /// Procedural pattern. Walls have no two places alike, unless they are longer than 64 elements.
    pub pattern: Pattern,
    /// Size of the pattern's elements, or height of one image, metres (degrees for the surroundings).
    pub scale: f64,
    /// Base hue, degrees.
    pub hue: f64,
    /// How far hues stray from the base, degrees.
    pub hue_spread: f64,
    /// Contrast of the pattern, 0 (plain) to 1.
    pub contrast: f64,
    /// Seed of the pattern; on walls and floor `world.papers` is in it.
    pub seed: u64,
}

/// Procedural patterns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pattern {
    /// One colour.
    Plain,
    /// Smooth blobs of colour.
    Smooth,
    /// Sheets of wallpaper of random colours side by side.
    Patches,
    /// Blocks of stone, each with a figure of its own in relief.
    Reliefs,
    /// Vertical stripes of random colours.
    Stripes,
    /// The base colour, paler towards the horizon: for the surroundings.
    Sky,
}

/// `[robot]`
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// Radius, metres.
    pub radius: f64,
    /// Length of the action *forward*, metres.
    pub forward: f64,
    /// Angle of the actions *left* and *right*, degrees.
    pub turn_deg: f64,
    /// Duration of an action, seconds.
    pub action_seconds: f64,
    /// Frames per action.
    pub frames_per_action: usize,
    /// Standard deviation of the executed length, as a share.
    pub forward_noise: f64,
    /// Standard deviation of the executed angle, as a share.
    pub turn_noise: f64,
    /// Standard deviation of the heading's drift over one *forward*, degrees.
    pub drift_deg: f64,
    /// Standard deviation of the odometry's error per frame, as a share of the motion.
    pub odometry_noise: f64,
    /// Start position, metres.
    pub start: [f64; 2],
    /// Start heading, degrees from the x-axis, counter-clockwise.
    pub start_heading_deg: f64,
    /// Number of sonars in the ring, the first one straight ahead.
    pub sonars: usize,
    /// Range of the sonars, metres.
    pub sonar_range: f64,
    /// Standard deviation of a sonar reading, metres.
    pub sonar_noise: f64,
}

impl Robot {
    /// Time between frames, seconds.
    pub fn frame_seconds(&self) -> f64 {
        self.action_seconds / self.frames_per_action as f64
    }
}

/// How finely the simulated camera renders.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Detail {
    /// All pixels of the camera.
    Full,
    /// What vision needs and no more: [`VISION_SAMPLES`] × [`VISION_SAMPLES`] samples for each pixel of an observation,
    /// none for the lines that vision cuts away. Field of view, exposure and the noise of observations are those of
    /// the full image.
    Vision,
}

/// Samples for each pixel of an observation, along each axis, with [`Detail::Vision`].
pub const VISION_SAMPLES: usize = 4;

/// `[camera]`
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// How finely images are rendered.
    pub detail: Detail,
    /// Image width, pixels.
    pub width: usize,
    /// Image height, pixels.
    pub height: usize,
    /// Horizontal field of view, degrees.
    pub field_of_view_deg: f64,
    /// Height of the lens above the floor, metres.
    pub mount_height: f64,
    /// Standard deviation of pixel noise, grey levels.
    pub pixel_noise: f64,
    /// Standard deviation of the slow exposure drift, as a share.
    pub exposure_drift: f64,
    /// Time constant of the exposure drift, seconds.
    pub exposure_seconds: f64,
}

/// `[vision]`
#[derive(Debug, Clone, PartialEq)]
pub struct Vision {
    /// Upper image lines that are cut away, pixels; of an image that is not as high as the camera's, as large a share.
    pub cut_rows: usize,
    /// Width of an observation, pixels.
    pub width: usize,
    /// Height of an observation, pixels.
    pub height: usize,
    /// Mean grey level that every observation is corrected to; `None`: no correction.
    pub brightness: Option<f64>,
}

/// `[dictionary]`
#[derive(Debug, Clone, PartialEq)]
pub struct Dictionary {
    /// How support vectors are chosen.
    pub selection: SelectionRule,
    /// Exponent of the radial kernel.
    pub exponent: f64,
    /// Kernel width in grey levels; `None`: the one at which `sigma_share` of the first frames become support vectors,
    /// but at least half of their median distance.
    pub sigma: Option<f64>,
    /// With an automatic width: the share of the first frames that become support vectors.
    pub sigma_share: f64,
    /// With an automatic width: measured over this many first frames.
    pub sigma_frames: usize,
    /// Acceptance threshold ν.
    pub nu: f64,
    /// Largest number of support vectors.
    pub budget: usize,
    /// What happens when there are that many.
    pub when_full: WhenFull,
    /// Frames that are handled together.
    pub block_frames: usize,
    /// Frames whose coordinates are kept for filling in new ones.
    pub retained_frames: usize,
}

/// How support vectors are chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SelectionRule {
    /// Approximate linear dependence.
    Ald,
    /// A random sample of all frames so far.
    Random,
}

/// `[slow]`
#[derive(Debug, Clone, PartialEq)]
pub struct Slow {
    /// Number of slow features.
    pub features: usize,
    /// Regulariser λ.
    pub lambda: f64,
    /// Weight of derivatives while moving; turning has weight 1.
    pub move_weight: f64,
    /// Time constant with which frames fade; `None`: never.
    pub memory_frames: Option<f64>,
}

/// `[value]`
#[derive(Debug, Clone, PartialEq)]
pub struct Value {
    /// How values are found.
    pub method: Method,
    /// Discount per action.
    pub gamma: f64,
    /// Transitions in the window.
    pub window: usize,
    /// Local values: transitions that tell the value of an action.
    pub neighbours: usize,
    /// Local values: slowest features that tell which states are near each other.
    pub metric_features: usize,
    /// Local values: ridge on the slopes of the regression, in mean squared distances of the neighbours.
    pub local_ridge: f64,
    /// LSPI: ridge on the diagonal of the summed system.
    pub ridge: f64,
    /// LSPI: share of the greedy policy in each step of policy iteration.
    pub mixing: f64,
    /// LSPI: largest number of policy evaluations.
    pub max_iterations: usize,
    /// LSPI: relative change of weights that counts as converged.
    pub tolerance: f64,
    /// LSPI: 0: transitions weigh alike; 1: every (cell, action) weighs alike.
    pub balance: f64,
}

/// How values are found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// From the transitions nearby, by local regression: [`Local`](crate::value::Local).
    Local,
    /// Linear in all features, by least-squares policy iteration: [`Lspi`](crate::value::Lspi).
    Lspi,
}

/// `[policy]`
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    /// Actions of pure exploration at the start.
    pub explore_actions: usize,
    /// Share of pursuits among legs when the run ends; it rises linearly from 0.
    pub pursue_share: f64,
    /// Length of a leg of exploration, actions.
    pub explore_leg: usize,
    /// A pursuit gives up after this many actions.
    pub pursue_leg: usize,
    /// Probability of *forward* in the random walk.
    pub forward_probability: f64,
    /// Sonar reflex of the random walk: no *forward* with less clearance ahead, metres.
    pub sonar_stop: f64,
    /// Share of times that the sonar reflex is heeded.
    pub sonar_heed: f64,
    /// Reflex: an action that was just blocked is not repeated.
    pub no_repeat_blocked: bool,
    /// Reflex: a turn is not undone by the opposite turn, not even after a blocked action.
    pub no_undo_turn: bool,
}

/// How model swaps are timed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// A model asked for at frame t takes effect at frame t + L exactly.
    Lockstep,
    /// A model takes effect when it is ready.
    Realtime,
}

/// What to do where a run would need more memory than there is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OverMemory {
    /// Refuse the scenario.
    Refuse,
    /// Lower the budget of support vectors, and the number of features with it, to what fits.
    Shrink,
}

/// `[agent]`
#[derive(Debug, Clone, PartialEq)]
pub struct Agent {
    /// Timing of model swaps.
    pub mode: Mode,
    /// Frames between two requests for a new model.
    pub resolve_frames: usize,
    /// L: frames from the request to the effect.
    pub latency_frames: usize,
    /// Capacity of the queues between actors, messages.
    pub queue: usize,
    /// Threads for each matrix product; results do not depend on them.
    pub threads: usize,
    /// Most memory that a run may need, GB; `None`: what the machine has.
    pub memory_gb: Option<f64>,
    /// What to do where a run would need more.
    pub over_memory: OverMemory,
    /// What happens to frames that are not taken in time.
    pub when_behind: WhenBehind,
    /// Times real time at which a simulated robot drives; `None`: as fast as its frames are taken.
    pub speed: Option<f64>,
    /// Time between two states of the run that are put away, minutes; 0: none but when it is interrupted.
    pub keep_minutes: f64,
}

impl Agent {
    /// Time between two states of the run that are put away; none of them but when it is interrupted, if that is `None`.
    pub fn keep_every(&self) -> Option<std::time::Duration> {
        (self.keep_minutes > 0.0).then(|| std::time::Duration::from_secs_f64(60.0 * self.keep_minutes))
    }
}

/// `[evaluate]`
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluate {
    /// Random starts per task.
    pub starts: usize,
    /// A trial fails after this many actions.
    pub max_steps: usize,
    /// Every how many models is evaluated during the run; 0: only the last.
    pub every: usize,
    /// Poses from which the decoding of position and heading is learned.
    pub decode_train: usize,
    /// Poses on which it is tested.
    pub decode_test: usize,
}

/// What happens to frames that are not taken in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WhenBehind {
    /// The source waits.
    Wait,
    /// The oldest ones are dropped, counted and reported.
    Drop,
}

/// `[log]`
#[derive(Debug, Clone, PartialEq)]
pub struct Log {
    /// Compression of chunks.
    pub compression: Compression,
    /// Size of a chunk before compression, bytes.
    pub chunk_bytes: usize,
    /// Longest time that a message stays in memory only, seconds.
    pub flush_seconds: f64,
    /// Size at which a file is closed and the next one begun, megabytes.
    pub file_mb: f64,
    /// Age at which a file is closed; `None`: none is closed for its age, minutes.
    pub file_minutes: Option<f64>,
    /// Most that all files may take before the oldest ones are deleted; `None`: all are kept, megabytes.
    pub budget_mb: Option<f64>,
}

/// What happens when a goal is reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Then {
    /// The schedule decides what the next leg is.
    Schedule,
    /// A leg of exploration follows.
    Explore,
    /// The next task is pursued.
    NextTask,
}

/// `[[task]]`
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// Name, unique.
    pub name: String,
    /// Centre of the goal area, metres.
    pub goal: [f64; 2],
    /// Radius of the goal area, metres.
    pub radius: f64,
    /// Reward for an action that ends in the goal area.
    pub reward: f64,
    /// Reward for an action that ends near a wall, outside the goal area.
    pub wall_reward: f64,
    /// Near a wall is closer than this, robot centre to wall, metres.
    pub wall_distance: f64,
    /// Whether values count the goal as the end of an episode.
    pub absorbing: bool,
    /// What comes after the goal was reached.
    pub then: Then,
}

impl Scenario {
    /// Read all sections; what is wrong goes to `reader.faults`, with the default in its place.
    pub(super) fn read(reader: &mut Reader<'_>, base: &Path, stem: &str) -> Self {
        let (name, seed, actions) = reader.section("", "", |s| {
            s.allow_sections(&[
                "world",
                "robot",
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
            ]);
            (
                s.text("name", stem, "name for people"),
                s.count("seed", 1, "", 0, i64::MAX as usize, "seed of all random streams") as u64,
                s.count("actions", 15_000, "actions", 10, 1_000_000_000, "the run ends after this many"),
            )
        });
        let papers = reader.section("world", "what the robot drives in", |s| {
            s.allow_sections(&["room", "wall", "pyramid", "distractor", "floor", "surroundings"]);
            let line = "another number: other patterns on walls and floor, of the same kinds";
            s.count("papers", 0, "", 0, 1_000_000, line) as u64
        });
        let rooms = reader.sections("world.room", "a rectangle of floor; rooms that touch or overlap are joined", {
            |s, index| Room::read(s, base, index)
        });
        let mut walls = reader.sections("world.wall", "a polyline that stands upright", |s, index| Wall {
            points: s.points("points", "corners"),
            closed: s.flag("closed", false, "whether the last corner is joined to the first"),
            gaps: Vec::new(),
            height: s.number("height", 0.9, "m", Range::above(0.0, 100.0), "height of the wall"),
            texture: Texture::read(s, base, Defaults::wall(index)),
        });
        walls.extend(walls_of(&rooms));
        walls.iter_mut().for_each(|wall| wall.texture.paper_anew(papers));
        let pyramids = reader.sections("world.pyramid", "stands outside, far away", Pyramid::read);
        let distractors = reader.sections(
            "world.distractor",
            "moves or blinks whatever the robot does; seen and not felt",
            Distractor::read,
        );
        let mut floor = reader.section("world.floor", "", |s| Texture::read(s, base, Defaults::FLOOR));
        floor.paper_anew(papers);
        let surroundings = reader.section("world.surroundings", "seen above the walls, far away", |s| {
            Texture::read(s, base, Defaults::SURROUNDINGS)
        });
        Scenario {
            name,
            seed,
            actions,
            world: World { rooms, walls, pyramids, distractors, floor, surroundings },
            robot: reader.section("robot", "", Robot::read),
            camera: reader.section("camera", "", Camera::read),
            vision: reader.section("vision", "camera image to observation", Vision::read),
            dictionary: reader.section("dictionary", "support vectors", Dictionary::read),
            slow: reader.section("slow", "slow features", Slow::read),
            value: reader.section("value", "least-squares policy iteration", Value::read),
            policy: reader.section("policy", "exploration, pursuit, reflexes", Policy::read),
            agent: reader.section("agent", "", Agent::read),
            evaluate: reader.section("evaluate", "", Evaluate::read),
            log: reader.section("log", "", Log::read),
            topics: reader.section("topics", "what another program's log calls its things", Topics::read),
            changes: reader
                .sections("change", "what changes while the robot drives", |s, index| Change::read(s, base, index)),
            tasks: reader.sections("task", "", Task::read),
            text: String::new(),
        }
    }
}

/// Scales of walls and floors, metres.
const METRES: Range = Range::within(0.01, 1000.0);

/// Patterns by the words of the file.
const PATTERNS: [(&str, Pattern); 6] = [
    ("plain", Pattern::Plain),
    ("smooth", Pattern::Smooth),
    ("patches", Pattern::Patches),
    ("stripes", Pattern::Stripes),
    ("reliefs", Pattern::Reliefs),
    ("sky", Pattern::Sky),
];

pub(super) struct Defaults {
    /// An image in place of the pattern.
    image: Option<PathBuf>,
    pattern: usize,
    scale: f64,
    hue: f64,
    hue_spread: f64,
    contrast: f64,
    seed: usize,
    /// Allowed scales: finer ones would alias in any image, and repeat too often.
    range: Range,
}

impl Defaults {
    const FLOOR: Defaults = Defaults {
        image: None,
        pattern: 1,
        scale: 0.6,
        hue: 40.0,
        hue_spread: 20.0,
        contrast: 0.3,
        seed: 1001,
        range: METRES,
    };
    const SURROUNDINGS: Defaults = Defaults {
        image: None,
        pattern: 1,
        scale: 40.0,
        hue: 210.0,
        hue_spread: 60.0,
        contrast: 0.5,
        seed: 1002,
        range: Range::within(1.0, 360.0),
    };

    /// Walls differ in hue and pattern unless the file says otherwise.
    fn wall(index: usize) -> Defaults {
        let hue = (index as f64 * 97.0) % 360.0;
        Defaults {
            image: None,
            pattern: 2,
            scale: 0.45,
            hue,
            hue_spread: 60.0,
            contrast: 0.6,
            seed: index + 1,
            range: METRES,
        }
    }

    /// Rooms differ as walls do.
    pub(super) fn room(index: usize) -> Defaults {
        Defaults::wall(index)
    }

    /// A side of a room is papered as the room is, but in no two of them the pattern is the same.
    pub(super) fn side(room: &Texture, side: usize) -> Defaults {
        let Texture { image, scale, hue, hue_spread, contrast, .. } = room.clone();
        let pattern = PATTERNS.iter().position(|&(_, pattern)| pattern == room.pattern).unwrap_or(0);
        // Rooms of neighbouring seeds must not share patterns; a written seed must be one that can be read.
        let seed = (room.seed as usize + 1000 * (side + 1)) % u32::MAX as usize;
        Defaults { image, pattern, scale, hue, hue_spread, contrast, seed, range: METRES }
    }
}

impl Texture {
    /// Another texture of a wall; each change has its own unless the file says otherwise.
    pub(super) fn new_paper(s: &mut Section<'_, '_>, base: &Path, index: usize) -> Self {
        Texture::read(s, base, Defaults { seed: index + 501, ..Defaults::wall(index + 2) })
    }

    /// The same with the pattern of another number of papers; 0 leaves it. Seeds in a file are far smaller than what is added.
    fn paper_anew(&mut self, papers: u64) {
        self.seed += papers << u32::BITS;
    }

    pub(super) fn read(s: &mut Section<'_, '_>, base: &Path, d: Defaults) -> Self {
        let image = s.file("image", base, "PNG file, relative to this file, instead of the pattern; empty: none");
        let image = image.or(d.image);
        if let Some(path) = &image
            && let Err(error) = image::ImageReader::open(path).map_err(image::ImageError::from).and_then(|r| r.decode())
        {
            s.fault_here("image", format!("= {:?} cannot be used: {error}", path.display().to_string()));
        }
        Texture {
            image,
            pattern: s.choice(
                "pattern",
                d.pattern,
                &PATTERNS,
                "procedural pattern; on a wall of up to 64 elements it does not repeat",
            ),
            scale: s.number(
                "scale",
                d.scale,
                "m (surroundings: degrees)",
                d.range,
                "size of the pattern's elements, or height of one image",
            ),
            hue: s.number("hue", d.hue, "degrees", Range::within(0.0, 360.0), "base colour"),
            hue_spread: s.number(
                "hue_spread",
                d.hue_spread,
                "degrees",
                Range::within(0.0, 360.0),
                "how far colours stray",
            ),
            contrast: s.number("contrast", d.contrast, "", Range::within(0.0, 1.0), "0: plain"),
            seed: s.count("seed", d.seed, "", 0, u32::MAX as usize, "seed of the pattern") as u64,
        }
    }
}

impl Robot {
    fn read(s: &mut Section<'_, '_>) -> Self {
        let share = Range::within(0.0, 0.5);
        Robot {
            radius: s.number("radius", 0.25, "m", Range::above(0.0, 10.0), "Pioneer 3-DX: 0.25"),
            forward: s.number("forward", 0.30, "m", Range::above(0.0, 10.0), "length of the action forward"),
            turn_deg: s.number("turn_deg", 45.0, "degrees", Range::above(0.0, 180.0), "angle of a turn"),
            action_seconds: s.number("action_seconds", 1.0, "s", Range::above(0.0, 60.0), "duration of an action"),
            frames_per_action: s.count("frames_per_action", 5, "frames", 1, 100, "camera frames per action"),
            forward_noise: s.number("forward_noise", 0.05, "share", share, "standard deviation of the executed length"),
            turn_noise: s.number("turn_noise", 0.05, "share", share, "standard deviation of the executed angle"),
            drift_deg: s.number("drift_deg", 1.0, "degrees", Range::within(0.0, 45.0), "heading noise of one forward"),
            odometry_noise: s.number("odometry_noise", 0.02, "share", share, "error of the odometry per frame"),
            start: s.point("start", [1.5, 0.9], "position at the start"),
            start_heading_deg: s.number(
                "start_heading_deg",
                0.0,
                "degrees",
                Range::within(-360.0, 360.0),
                "heading at the start, from the x-axis, counter-clockwise",
            ),
            sonars: s.count("sonars", 16, "", 1, 360, "sonars in the ring, the first one straight ahead"),
            sonar_range: s.number("sonar_range", 5.0, "m", Range::above(0.0, 100.0), "longest distance measured"),
            sonar_noise: s.number("sonar_noise", 0.01, "m", Range::within(0.0, 1.0), "standard deviation of a reading"),
        }
    }
}

impl Camera {
    /// Width and height of the images that are rendered, pixels.
    pub fn rendered(&self, vision: &Vision) -> (usize, usize) {
        match self.detail {
            Detail::Full => (self.width, self.height),
            Detail::Vision => (VISION_SAMPLES * vision.width, VISION_SAMPLES * vision.height),
        }
    }

    fn read(s: &mut Section<'_, '_>) -> Self {
        Camera {
            detail: s.choice(
                "detail",
                0,
                &[("full", Detail::Full), ("vision", Detail::Vision)],
                "render all pixels, or only 4 × 4 samples for each pixel of an observation (several times faster)",
            ),
            width: s.count("width", 320, "px", 8, 4096, "image width"),
            height: s.count("height", 240, "px", 8, 4096, "image height"),
            field_of_view_deg: s.number(
                "field_of_view_deg",
                66.0,
                "degrees",
                Range::within(10.0, 150.0),
                "horizontal field of view",
            ),
            mount_height: s.number("mount_height", 0.5, "m", Range::above(0.0, 50.0), "lens above the floor"),
            pixel_noise: s.number("pixel_noise", 2.0, "grey levels", Range::within(0.0, 64.0), "noise of a pixel"),
            exposure_drift: s.number(
                "exposure_drift",
                0.05,
                "share",
                Range::within(0.0, 0.5),
                "slow drift of the gain",
            ),
            exposure_seconds: s.number(
                "exposure_seconds",
                60.0,
                "s",
                Range::above(0.0, 1e6),
                "time constant of the drift",
            ),
        }
    }
}

impl Vision {
    fn read(s: &mut Section<'_, '_>) -> Self {
        let cut_rows = s.count(
            "cut_rows",
            80,
            "px",
            0,
            4095,
            "upper lines that are cut away; of images that are not camera.height high, as large a share",
        );
        let width = s.count("width", 32, "px", 1, 1024, "width of an observation");
        let height = s.count("height", 16, "px", 1, 1024, "height of an observation");
        let brightness = s.number(
            "brightness",
            128.0,
            "grey levels",
            Range::within(0.0, 255.0),
            "mean that observations are corrected to; 0: no correction",
        );
        Vision { cut_rows, width, height, brightness: (brightness > 0.0).then_some(brightness) }
    }
}

impl Dictionary {
    fn read(s: &mut Section<'_, '_>) -> Self {
        let selection = s.choice(
            "selection",
            0,
            &[("ald", SelectionRule::Ald), ("random", SelectionRule::Random)],
            "how support vectors are chosen: what the others do not span up to nu, or a random sample of all frames",
        );
        let exponent = s.choice("kernel", 0, &[("gaussian", 2.0), ("laplacian", 1.0)], "radial kernel");
        Dictionary {
            selection,
            exponent,
            sigma: s.number_or_auto(
                "sigma",
                "grey levels",
                Range::above(0.0, 1e9),
                "kernel width, as a distance of observations",
            ),
            sigma_share: s.number(
                "sigma_share",
                0.65,
                "",
                Range::above(0.0, 1.0),
                "sigma = \"auto\": the width (at least half the median distance) at which this share of the first frames become support vectors",
            ),
            sigma_frames: s.count("sigma_frames", 1000, "frames", 2, 5000, "sigma = \"auto\": first frames"),
            nu: s.number("nu", 0.01, "", Range::above(0.0, 0.999), "a frame is accepted when its residual is above"),
            budget: s.count("budget", 2000, "", 10, 20_000, "largest number of support vectors"),
            when_full: s.choice(
                "when_full",
                0,
                &[("stop", WhenFull::Stop), ("raise_nu", WhenFull::RaiseNu), ("replace", WhenFull::Replace)],
                "selection = \"ald\", at the budget: stop growing, raise nu and thin out, or let the least independent go",
            ),
            block_frames: s.count("block_frames", 128, "frames", 1, 4096, "frames that are handled together"),
            retained_frames: s.count(
                "retained_frames",
                20_000,
                "frames",
                1,
                10_000_000,
                "newest frames for which new coordinates are filled in",
            ),
        }
    }
}

impl Slow {
    fn read(s: &mut Section<'_, '_>) -> Self {
        let features = s.count("features", 200, "", 1, 5000, "number of slow features");
        let lambda = s.number("lambda", 1e-7, "1/s²", Range::above(0.0, 1e6), "regulariser");
        let move_weight = s.number(
            "move_weight",
            5.0,
            "",
            Range::above(0.0, 1e6),
            "weight of derivatives while moving; turning has weight 1",
        );
        let memory = s.number(
            "memory_frames",
            0.0,
            "frames",
            Range::within(0.0, 1e12),
            "frames fade with this time constant; 0: never",
        );
        Slow { features, lambda, move_weight, memory_frames: (memory > 0.0).then_some(memory) }
    }
}

impl Value {
    fn read(s: &mut Section<'_, '_>) -> Self {
        Value {
            method: s.choice(
                "method",
                0,
                &[("local", Method::Local), ("lspi", Method::Lspi)],
                "values by regression on transitions nearby, or linear in all features",
            ),
            gamma: s.number("gamma", 0.9, "per action", Range::within(0.0, 0.9999), "discount"),
            window: s.count("window", 20_000, "transitions", 10, 10_000_000, "rolling window"),
            neighbours: s.count("neighbours", 16, "transitions", 1, 1000, "local: that tell the value of an action"),
            metric_features: s.count(
                "metric_features",
                40,
                "",
                1,
                5000,
                "local: slowest features that tell which states are near",
            ),
            local_ridge: s.number(
                "local_ridge",
                0.3,
                "mean squared distances",
                Range::above(0.0, 1e9),
                "local: on the slopes of the regression",
            ),
            ridge: s.number("ridge", 0.1, "", Range::within(0.0, 1e9), "lspi: on the diagonal of the summed system"),
            mixing: s.number(
                "mixing",
                0.3,
                "",
                Range::above(0.0, 1.0),
                "lspi: share of the greedy policy in each iteration",
            ),
            max_iterations: s.count("max_iterations", 40, "", 1, 10_000, "lspi: largest number of policy evaluations"),
            tolerance: s.number(
                "tolerance",
                1e-3,
                "",
                Range::above(0.0, 1.0),
                "lspi: change of weights that counts as none",
            ),
            balance: s.number(
                "balance",
                0.5,
                "",
                Range::within(0.0, 1.0),
                "lspi: 0: transitions weigh alike, 1: every (cell, action) weighs alike",
            ),
        }
    }
}

impl Policy {
    fn read(s: &mut Section<'_, '_>) -> Self {
        Policy {
            explore_actions: s.count(
                "explore_actions",
                6000,
                "actions",
                0,
                1_000_000_000,
                "pure exploration at the start",
            ),
            pursue_share: s.number(
                "pursue_share",
                0.5,
                "",
                Range::within(0.0, 1.0),
                "share of pursuits among legs at the end of the run",
            ),
            explore_leg: s.count("explore_leg", 40, "actions", 1, 1_000_000, "length of a leg of exploration"),
            pursue_leg: s.count("pursue_leg", 40, "actions", 1, 1_000_000, "a pursuit gives up after"),
            forward_probability: s.number(
                "forward_probability",
                0.5,
                "",
                Range::within(0.01, 0.99),
                "random walk: probability of forward",
            ),
            sonar_stop: s.number(
                "sonar_stop",
                0.10,
                "m",
                Range::within(0.0, 10.0),
                "random walk: no forward with less clearance ahead",
            ),
            sonar_heed: s.number(
                "sonar_heed",
                0.5,
                "share",
                Range::within(0.0, 1.0),
                "times that the sonar reflex is heeded; contacts must be learned too",
            ),
            no_repeat_blocked: s.flag(
                "no_repeat_blocked",
                true,
                "reflex: an action that was just blocked is not repeated",
            ),
            no_undo_turn: s.flag(
                "no_undo_turn",
                true,
                "reflex: a turn is not undone by the opposite turn, not even after a blocked action",
            ),
        }
    }
}

impl Agent {
    fn read(s: &mut Section<'_, '_>) -> Self {
        Agent {
            mode: s.choice(
                "mode",
                0,
                &[("lockstep", Mode::Lockstep), ("realtime", Mode::Realtime)],
                "a model takes effect latency_frames after the request, or when it is ready",
            ),
            resolve_frames: s.count(
                "resolve_frames",
                5000,
                "frames",
                10,
                1_000_000_000,
                "between two requests for a model",
            ),
            latency_frames: s.count(
                "latency_frames",
                2500,
                "frames",
                0,
                1_000_000_000,
                "from request to effect (lockstep)",
            ),
            queue: s.count("queue", 64, "messages", 1, 65_536, "capacity of the queues between actors"),
            threads: s.count(
                "threads",
                1,
                "",
                1,
                256,
                "for each matrix product, of the stream and of the solvers beside it; results do not depend on it",
            ),
            memory_gb: s.number_or_auto(
                "memory_gb",
                "GB",
                Range::above(0.0, 1e6),
                "most memory; auto: four fifths of what the machine has",
            ),
            over_memory: s.choice(
                "over_memory",
                0,
                &[("refuse", OverMemory::Refuse), ("shrink", OverMemory::Shrink)],
                "a scenario that needs more is refused, or its budget of support vectors is lowered",
            ),
            when_behind: s.choice(
                "when_behind",
                0,
                &[("wait", WhenBehind::Wait), ("drop", WhenBehind::Drop)],
                "the source waits until its frames are taken, or drops the oldest (realtime only)",
            ),
            speed: s.number_or_auto(
                "speed",
                "times real time",
                Range::within(0.01, 1e6),
                "of a simulated robot; auto: as fast as its frames are taken",
            ),
            keep_minutes: s.number(
                "keep_minutes",
                10.0,
                "min",
                Range::within(0.0, 1e6),
                "between two states from which the run can go on; 0: only when it is interrupted",
            ),
        }
    }
}

impl Evaluate {
    fn read(s: &mut Section<'_, '_>) -> Self {
        Evaluate {
            starts: s.count("starts", 200, "", 1, 1_000_000, "random starts per task"),
            max_steps: s.count("max_steps", 100, "actions", 1, 1_000_000, "a trial fails after"),
            every: s.count("every", 1, "models", 0, 1_000_000, "evaluate during the run; 0: only the last"),
            decode_train: s.count("decode_train", 2000, "poses", 2, 1_000_000, "decoding of the pose is learned from"),
            decode_test: s.count("decode_test", 1000, "poses", 1, 1_000_000, "and tested on"),
        }
    }
}

impl Log {
    fn read(s: &mut Section<'_, '_>) -> Self {
        Log {
            compression: s.choice(
                "compression",
                0,
                &[("zstd", Compression::Zstd), ("lz4", Compression::Lz4), ("none", Compression::None)],
                "of chunks",
            ),
            chunk_bytes: s.count(
                "chunk_bytes",
                262_144,
                "bytes",
                1024,
                MAX_CHUNK_TARGET_BYTES as usize,
                "size of a chunk before compression",
            ),
            flush_seconds: s.number("flush_seconds", 1.0, "s", Range::above(0.0, 1.0), "longest time in memory only"),
            file_mb: s.number(
                "file_mb",
                1000.0,
                "MB",
                Range::within(0.1, 1e9),
                "a file that is larger is closed, and the next one begun",
            ),
            file_minutes: s.number_or_auto(
                "file_minutes",
                "min",
                Range::within(0.01, 1e9),
                "a file that is older is closed; auto: never for its age",
            ),
            budget_mb: s.number_or_auto(
                "budget_mb",
                "MB",
                Range::within(0.2, 1e12),
                "all files together; beyond, this run's oldest are deleted; auto: none is",
            ),
        }
    }
}

impl Task {
    fn read(s: &mut Section<'_, '_>, index: usize) -> Self {
        Task {
            name: s.text("name", &format!("task {}", index + 1), "unique name"),
            goal: s.point("goal", [1.5, 0.9], "centre of the goal area"),
            radius: s.number("radius", 0.2, "m", Range::above(0.0, 1000.0), "radius of the goal area"),
            reward: s.number("reward", 1.0, "", Range::above(0.0, 1e6), "for an action that ends in the goal area"),
            wall_reward: s.number(
                "wall_reward",
                -0.3,
                "",
                Range::within(-1e6, 0.0),
                "for an action that ends near a wall, outside the goal area",
            ),
            wall_distance: s.number(
                "wall_distance",
                0.3,
                "m",
                Range::within(0.0, 1000.0),
                "robot centre to wall that counts as near",
            ),
            absorbing: s.flag("absorbing", false, "whether values count the goal as the end of an episode"),
            then: s.choice(
                "then",
                0,
                &[("schedule", Then::Schedule), ("explore", Then::Explore), ("next_task", Then::NextTask)],
                "what follows when the goal is reached",
            ),
        }
    }
}
