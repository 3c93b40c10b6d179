//! The robot with a mass as a [`Base`]: readings with latencies, in simulated time.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point2, Vector2};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::distractors::Present;
use super::dynamic::{Dynamic, STEP};
use super::eye::Eye;
use super::simulated::EPOCH_NS;
use super::{Sensor, World};
use crate::random::stream;
use crate::robot::{Pose, Velocity};
use crate::scenario::{BodySettings, Equipment, Scenario, in_goal};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::source::live::{Base, Reading, Received, Scan};
use crate::vision::Image;

/// Scans a second.
const SCAN_HZ: f64 = 10.0;

/// The robot with a mass, its sensors, and its world.
pub struct DynamicBase {
    scenario: Arc<Scenario>,
    settings: BodySettings,
    world: Arc<World>,
    body: Dynamic,
    /// Its camera; without one, pictures show nothing but that time passes.
    sensor: Option<Sensor>,
    sonar_noise: ChaCha8Rng,
    /// Steps that have passed.
    steps: u64,
    waiting: VecDeque<Received>,
    touched: bool,
}

impl DynamicBase {
    /// The robot of a scenario at its start, with a camera.
    pub fn new(scenario: Arc<Scenario>, world: Arc<World>, settings: BodySettings) -> Self {
        let start = Pose::new(Point2::from(scenario.robot.start), scenario.robot.start_heading_deg.to_radians());
        let seed = scenario.seed;
        let sensor = Sensor::new(&scenario, 1.0 / settings.camera_hz, stream(seed, "camera"));
        let noise = (stream(seed, "motion"), stream(seed, "sonar"));
        DynamicBase { sensor: Some(sensor), ..DynamicBase::blind(scenario, world, settings, start, noise) }
    }

    /// A robot at a pose, without a camera, which moves nothing for anybody else; `noise` draws the errors of its odometry and of its sonars.
    pub fn blind(
        scenario: Arc<Scenario>,
        world: Arc<World>,
        settings: BodySettings,
        start: Pose,
        noise: (ChaCha8Rng, ChaCha8Rng),
    ) -> Self {
        DynamicBase {
            body: Dynamic::new(&scenario, &settings, start, &world.movables(), noise.0),
            sonar_noise: noise.1,
            scenario,
            settings,
            world,
            sensor: None,
            steps: 0,
            waiting: VecDeque::new(),
            touched: false,
        }
    }

    /// What it has beside camera and odometry.
    pub fn equipment(&self) -> Equipment {
        Equipment { scan: true, emergency_stop: false, lock: false }
    }

    /// The body.
    pub fn body(&self) -> &Dynamic {
        &self.body
    }

    /// What can be pushed, as cameras see it.
    pub fn things(&self) -> Vec<Present> {
        self.body.things().map(|(place, thing)| Present::thing(place, thing)).collect()
    }

    fn time(&self) -> Duration {
        Duration::from_micros(self.steps * (1e6 * STEP) as u64)
    }

    /// Sense what is due after this step.
    fn sense(&mut self) {
        let due = |hz: f64| self.steps.is_multiple_of((1.0 / hz / STEP).round().max(1.0) as u64);
        let (odometry, scan, image) = (due(self.settings.odometry_hz), due(SCAN_HZ), due(self.settings.camera_hz));
        let (camera_late, odometry_late) = (self.settings.camera_latency, self.settings.odometry_latency);
        if odometry {
            let of = self.body.odometry();
            self.put(odometry_late, Reading::Odometry { pose: of.pose, velocity: of.velocity });
        }
        if self.settings.bumper && self.body.is_touched() != self.touched {
            self.touched = self.body.is_touched();
            self.put(odometry_late, Reading::Bumper(self.touched));
        }
        if scan {
            let scan = self.scan();
            self.put(odometry_late, Reading::Scan(Arc::new(scan)));
        }
        if image {
            let pose = self.body.pose();
            for (number, task) in
                self.scenario.clone().tasks.iter().enumerate().filter(|(_, task)| task.topic.is_some())
            {
                let reward = f64::from(u8::from(in_goal(task, pose.position)));
                self.put(camera_late, Reading::Reward { task: number, reward });
            }
            self.put(camera_late, Reading::Pose(pose));
            let image = self.picture(&pose);
            self.put(camera_late, Reading::Image(image));
        }
    }

    fn put(&mut self, latency: f64, reading: Reading) {
        let now = self.time();
        let at = now + Duration::from_secs_f64(latency);
        let place = self.waiting.partition_point(|received| received.at <= at);
        let stamp_ns = EPOCH_NS + now.as_nanos() as u64;
        self.waiting.insert(place, Received { at, stamp_ns, reading });
    }

    fn picture(&mut self, pose: &Pose) -> Image {
        let things = self.things();
        let Some(sensor) = &mut self.sensor else {
            let (low, high) = (self.steps as u8, (self.steps >> 8) as u8);
            return Image { width: 1, height: 1, cropped: false, rgb: vec![low, high, 0] };
        };
        let frame = (self.steps as f64 * STEP / self.scenario.robot.frame_seconds()) as u64;
        let appearance = &self.world.appearance;
        let mut image = Image::default();
        appearance.render_into(&Eye { pose: *pose, later: 0, things }, frame, &mut image);
        sensor.expose(&mut image, appearance.light(frame));
        image
    }

    fn scan(&mut self) -> Scan {
        let robot = &self.scenario.robot;
        let (count, range, pose) = (robot.sonars, robot.sonar_range, self.body.pose());
        let step = std::f64::consts::TAU / count as f64;
        let things = self.things();
        let ranges = (0..count).map(|i| {
            let angle = pose.heading + step * i as f64;
            let ray = Vector2::new(angle.cos(), angle.sin());
            let wall = self.world.arena.range(pose.position, ray, range);
            let nearest = things.iter().filter_map(|thing| thing.depth(pose.position, ray)).fold(wall, f64::min);
            let noise: f64 = self.sonar_noise.sample(StandardNormal);
            let measured = (nearest + robot.sonar_noise * noise).clamp(0.0, range);
            if nearest < range { measured as f32 } else { f32::INFINITY }
        });
        Scan { first: 0.0, step, ranges: ranges.collect() }
    }
}

impl Base for DynamicBase {
    fn now(&self) -> Duration {
        self.time()
    }

    fn receive(&mut self, until: Duration, take: &mut dyn FnMut(Received)) {
        let steps = until.saturating_sub(self.time()).as_secs_f64() / STEP;
        let mut left = steps.round() as u64;
        let mut contacts = self.body.contacts();
        while left > 0 {
            self.body.step(&mut contacts);
            self.steps += 1;
            left -= 1;
            self.sense();
            let now = self.time();
            while self.waiting.front().is_some_and(|received| received.at <= now) {
                self.waiting.pop_front().into_iter().for_each(&mut *take);
            }
        }
        if self.sensor.is_some() {
            self.world.set_movables(self.body.things().map(|(place, _)| place.into()).collect());
        }
    }

    fn command(&mut self, velocity: Velocity) {
        self.body.command(velocity);
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<bool, SnapshotError> {
        snapshot.inner("body", &mut self.body)?;
        if let Some(sensor) = &mut self.sensor {
            snapshot.inner("sensor", sensor)?;
        }
        snapshot.random("sonar", &mut self.sonar_noise)?;
        snapshot.value("steps", &mut self.steps)?;
        snapshot.value("touched", &mut self.touched)?;
        snapshot.scope("waiting", |snapshot| waiting(snapshot, &mut self.waiting))?;
        Ok(true)
    }
}

/// Save or restore what is on its way to the program.
fn waiting(snapshot: &mut Snapshot, waiting: &mut VecDeque<Received>) -> Result<(), SnapshotError> {
    let mut count = waiting.len();
    snapshot.value("count", &mut count)?;
    let mut restored = VecDeque::new();
    for place in 0..count {
        let of = waiting.get(place);
        let (mut at, mut stamp_ns) = of.map_or((Duration::ZERO, 0), |of| (of.at, of.stamp_ns));
        let (mut kind, mut numbers, mut pixels) = of.map_or_else(Default::default, |of| flat(&of.reading));
        snapshot.scope(&place.to_string(), |snapshot| {
            snapshot.value("at", &mut at)?;
            snapshot.value("stamp_ns", &mut stamp_ns)?;
            snapshot.value("kind", &mut kind)?;
            snapshot.numbers("numbers", &mut numbers)?;
            snapshot.numbers("pixels", &mut pixels)?;
            let reading = reading_of(&kind, &numbers, pixels);
            snapshot.check("kind", reading.is_some(), "no reading")?;
            restored.extend(reading.map(|reading| Received { at, stamp_ns, reading }));
            Ok(())
        })?;
    }
    *waiting = restored;
    Ok(())
}

/// A reading of this base as a word, numbers and pixels.
fn flat(reading: &Reading) -> (String, Vec<f64>, Vec<u8>) {
    let (kind, numbers, pixels) = match reading {
        Reading::Image(image) => {
            let numbers = vec![image.width as f64, image.height as f64, f64::from(u8::from(image.cropped))];
            ("image", numbers, image.rgb.clone())
        }
        Reading::Odometry { pose, velocity } => {
            let Pose { position, heading } = pose;
            ("odometry", vec![position.x, position.y, *heading, velocity.linear, velocity.angular], Vec::new())
        }
        Reading::Scan(scan) => {
            let ranges = scan.ranges.iter().map(|&range| f64::from(range));
            ("scan", [scan.first, scan.step].into_iter().chain(ranges).collect(), Vec::new())
        }
        Reading::Bumper(pressed) => ("bumper", vec![f64::from(u8::from(*pressed))], Vec::new()),
        Reading::Reward { task, reward } => ("reward", vec![*task as f64, *reward], Vec::new()),
        Reading::Pose(pose) => ("pose", vec![pose.position.x, pose.position.y, pose.heading], Vec::new()),
        // It senses nothing else.
        _ => ("", Vec::new(), Vec::new()),
    };
    (kind.to_owned(), numbers, pixels)
}

fn reading_of(kind: &str, numbers: &[f64], rgb: Vec<u8>) -> Option<Reading> {
    // Not by `Pose::new`: the heading is in its range already, and every bit counts.
    let pose = |x, y, heading| Pose { position: Point2::new(x, y), heading };
    Some(match (kind, numbers) {
        ("image", &[width, height, cropped]) => {
            Reading::Image(Image { width: width as usize, height: height as usize, cropped: cropped == 1.0, rgb })
        }
        ("odometry", &[x, y, heading, linear, angular]) => {
            Reading::Odometry { pose: pose(x, y, heading), velocity: Velocity { linear, angular } }
        }
        ("scan", &[first, step, ref ranges @ ..]) => {
            let ranges = ranges.iter().map(|&range| range as f32).collect();
            Reading::Scan(Arc::new(Scan { first, step, ranges }))
        }
        ("bumper", &[pressed]) => Reading::Bumper(pressed == 1.0),
        ("reward", &[task, reward]) => Reading::Reward { task: task as usize, reward },
        ("pose", &[x, y, heading]) => Reading::Pose(pose(x, y, heading)),
        _ => return None,
    })
}
