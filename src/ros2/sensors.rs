//! What comes in from a robot's topics.

use std::sync::{Arc, Mutex};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crossbeam_channel::{Receiver, Sender, TrySendError};

use super::frames::Frames;
use super::graph::{Graph, LinkError, reliable_qos, sensor_qos};
use super::listen::Ear;
use super::losses::Losses;
use super::pace::Pace;
use super::voice::Mind;
use crate::lock::lock;
use crate::log::Message;
use crate::log::messages::{self as msg, foreign};
use crate::log::topics::MARK;
use crate::robot::Velocity;
use crate::scenario::Scenario;
use crate::source::imported::picture;
use crate::source::live::{Reading, Received, Scan};
use crate::source::{parse_mark, planar};
use crate::vision::Image;

/// A simulator's time.
const CLOCK: &str = "/clock";

/// The newest time by the robot's clock, and when it came.
#[derive(Default)]
pub struct RobotTime(Mutex<Option<(u64, Instant)>>);

impl RobotTime {
    fn hear(&self, stamp_ns: u64) {
        *lock(&self.0) = Some((stamp_ns, Instant::now()));
    }

    pub fn now(&self, pace: &Pace) -> u64 {
        match *lock(&self.0) {
            Some((stamp_ns, at)) => stamp_ns + pace.of(at.elapsed()).as_nanos() as u64,
            None => system_ns(),
        }
    }
}

fn system_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}

/// What the threads that listen share.
#[derive(Clone)]
pub struct Shared {
    pub pace: Arc<Pace>,
    pub time: Arc<RobotTime>,
    pub small: Sender<Received>,
    pub images: Sender<Received>,
    /// The other end, to drop the oldest.
    pub waiting: Receiver<Received>,
    pub losses: Losses,
    /// Why what was refused last could not be used.
    pub refused: Arc<Mutex<Option<String>>>,
    /// What the voice was asked.
    pub mind: Mind,
}

impl Shared {
    fn received(&self, stamp_ns: u64, reading: Reading) -> Received {
        let at = self.pace.now();
        // Without a stamp it was now.
        let stamp_ns = if stamp_ns == 0 { self.time.now(&self.pace) } else { stamp_ns };
        Received { at, stamp_ns, reading }
    }

    /// Something came in; where the stamp is 0, now.
    pub fn put(&self, stamp_ns: u64, reading: Reading) {
        // Nobody takes it where the run has ended.
        let _ = self.small.send(self.received(stamp_ns, reading));
    }

    fn put_image(&self, topic: &str, stamp_ns: u64, image: Image) {
        let mut received = self.received(stamp_ns, Reading::Image(image));
        while let Err(TrySendError::Full(back)) = self.images.try_send(received) {
            received = back;
            if self.waiting.try_recv().is_ok() {
                self.losses.add(topic);
            }
        }
    }

    /// Something came that cannot be used: counted, and told unless it was the last one that was told.
    fn refuse(&self, topic: &str, reason: String) {
        self.losses.add(topic);
        let text = format!("{topic}: {reason}");
        if lock(&self.refused).replace(text.clone()).as_ref() != Some(&text) {
            self.put(0, Reading::Note(text));
        }
    }

    fn count_broken(&self, topic: &str) -> impl FnMut(String) + Send + 'static {
        let (losses, topic) = (self.losses.clone(), topic.to_owned());
        move |_| losses.add(&topic)
    }
}

/// Listens to a simulator's time.
pub fn clock(graph: &mut Graph, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
    graph.wait_for("use_sim_time", CLOCK, until)?;
    let pace = shared.pace.clone();
    let take = move |said: foreign::Clock| pace.hear(said.clock.stamp_ns());
    graph.hear(CLOCK, sensor_qos(), take, shared.count_broken(CLOCK))
}

/// Listens to the camera: images are decoded and cut on its thread.
pub fn eye(
    graph: &mut Graph,
    scenario: &Arc<Scenario>,
    topic: &str,
    kind: &str,
    shared: &Shared,
) -> Result<Ear, LinkError> {
    let (scenario, of, from) = (scenario.clone(), shared.clone(), topic.to_owned());
    let mut size = None;
    let mut put = move |header: &msg::Header, image: Result<Image, picture::PictureError>| {
        let seen = image.map(|image| ((image.width, image.height), image));
        let size_of = |(width, height): (usize, usize)| format!("{width} × {height}");
        match seen.and_then(|(seen, image)| Ok((seen, picture::crop(image, &scenario.camera, &scenario.vision)?))) {
            Ok((seen, image)) if *size.get_or_insert(seen) == seen => of.put_image(&from, header.stamp_ns(), image),
            Ok((seen, _)) => {
                let was = size.map_or_else(String::new, size_of);
                of.refuse(&from, format!("images were {was} pixels and are {} now: they are left out", size_of(seen)));
            }
            Err(error) => of.refuse(&from, error.to_string()),
        }
    };
    let (of, from) = (shared.clone(), topic.to_owned());
    let broken = move |error: String| of.refuse(&from, error);
    if kind == msg::Image::TYPE {
        let take = move |image: msg::Image| put(&image.header, picture::raw(&image));
        graph.hear(topic, sensor_qos(), take, broken)
    } else {
        let take = move |image: foreign::CompressedImage| put(&image.header, picture::compressed(&image));
        graph.hear(topic, sensor_qos(), take, broken)
    }
}

pub fn odometry(graph: &mut Graph, topic: &str, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
    graph.wait_for("odometry", topic, until)?;
    let of = shared.clone();
    let take = move |odometry: msg::Odometry| {
        let stamp_ns = odometry.header.stamp_ns();
        if stamp_ns > 0 {
            of.time.hear(stamp_ns);
        }
        let (pose, velocity) = (planar(&odometry.pose.pose), velocity(&odometry.twist.twist));
        of.put(stamp_ns, Reading::Odometry { pose, velocity });
    };
    graph.hear(topic, sensor_qos(), take, shared.count_broken(topic))
}

/// Listens to everything else that the scenario names; `stamped`: the base takes velocities with stamps.
pub fn switches(
    graph: &mut Graph,
    scenario: &Arc<Scenario>,
    shared: &Shared,
    stamped: bool,
    until: Instant,
) -> Result<Vec<Ear>, LinkError> {
    let settings = scenario.ros2.clone().expect("a scenario with robot.body = \"ros2\" has [ros2]");
    let mut ears = Vec::new();
    if !settings.scan.is_empty() {
        let topic = settings.topic(&settings.scan);
        graph.wait_for("scan", &topic, until)?;
        let of = shared.clone();
        let take = move |scan: msg::LaserScan| of.put(scan.header.stamp_ns(), Reading::Scan(Arc::new(Scan::of(&scan))));
        ears.push(graph.hear(&topic, sensor_qos(), take, shared.count_broken(&topic))?);
    }
    let bools = [
        ("bumper", &settings.bumper, Reading::Bumper as fn(bool) -> Reading),
        ("emergency_stop", &settings.emergency_stop, Reading::EmergencyStop),
        ("lock", &settings.lock, Reading::Lock),
    ];
    for (key, topic, reading) in bools.into_iter().filter(|(_, topic, _)| !topic.is_empty()) {
        let (topic, of) = (settings.topic(topic), shared.clone());
        graph.kind_of(key, &topic)?;
        // One that is not there yet is silent, and that stops the robot.
        let take = move |said: foreign::Bool| of.put(0, reading(said.data));
        ears.push(graph.hear(&topic, reliable_qos(), take, shared.count_broken(&topic))?);
    }
    if !settings.teleop.is_empty() {
        let topic = settings.topic(&settings.teleop);
        let (of, broken) = (shared.clone(), shared.count_broken(&topic));
        // A person may come later: then it is of the type that the base takes.
        let of_base = if stamped { msg::TwistStamped::TYPE } else { msg::Twist::TYPE };
        let kind = graph.kind_of("teleop", &topic)?.unwrap_or_else(|| of_base.to_owned());
        ears.push(if kind == msg::Twist::TYPE {
            let take = move |twist: msg::Twist| of.put(0, Reading::Teleop(velocity(&twist)));
            graph.hear(&topic, reliable_qos(), take, broken)
        } else {
            let take = move |said: msg::TwistStamped| of.put(0, Reading::Teleop(velocity(&said.twist)));
            graph.hear(&topic, reliable_qos(), take, broken)
        }?);
    }
    if !settings.battery.is_empty() {
        let (topic, of) = (settings.topic(&settings.battery), shared.clone());
        graph.kind_of("battery", &topic)?;
        let take = move |battery: foreign::BatteryState| of.put(0, Reading::Battery(f64::from(battery.percentage)));
        ears.push(graph.hear(&topic, sensor_qos(), take, shared.count_broken(&topic))?);
    }
    if !settings.pose.is_empty() {
        ears.push(true_pose(graph, &settings.topic(&settings.pose), shared, until)?);
    }
    let (of, names, mark) = (shared.clone(), scenario.clone(), MARK.name());
    let take = move |said: msg::Text| match parse_mark(&said.data, &names) {
        Ok(mark) => of.put(0, Reading::Mark(mark)),
        Err(reason) => of.refuse(MARK.name(), reason),
    };
    ears.push(graph.hear(mark, reliable_qos(), take, shared.count_broken(mark))?);
    for (task, topic) in scenario.tasks.iter().enumerate().filter_map(|(task, of)| Some((task, of.topic.clone()?))) {
        ears.push(reward(graph, task, &settings.topic(&topic), shared, until)?);
    }
    Ok(ears)
}

fn true_pose(graph: &mut Graph, topic: &str, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
    let kind = graph.wait_for("pose", topic, until)?;
    let of = shared.clone();
    let put = move |header: &msg::Header, pose: &msg::Pose| of.put(header.stamp_ns(), Reading::Pose(planar(pose)));
    let broken = shared.count_broken(topic);
    match kind.as_str() {
        msg::PoseStamped::TYPE => {
            graph.hear(topic, sensor_qos(), move |of: msg::PoseStamped| put(&of.header, &of.pose), broken)
        }
        msg::Odometry::TYPE => {
            graph.hear(topic, sensor_qos(), move |of: msg::Odometry| put(&of.header, &of.pose.pose), broken)
        }
        foreign::TfMessage::TYPE => {
            let (mut frames, of) = (Frames::default(), shared.clone());
            let take = move |message: foreign::TfMessage| {
                for transform in &message.transforms {
                    if let Some((stamp_ns, pose)) = frames.hear(transform) {
                        of.put(stamp_ns, Reading::Pose(pose));
                    }
                }
            };
            // Transforms are published reliably, and those of a slow localisation seldom.
            graph.hear(topic, reliable_qos(), take, broken)
        }
        _ => {
            let take = move |of: foreign::PoseWithCovarianceStamped| put(&of.header, &of.pose.pose);
            graph.hear(topic, sensor_qos(), take, broken)
        }
    }
}

fn reward(graph: &mut Graph, task: usize, topic: &str, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
    let kind = graph.wait_for("reward", topic, until)?;
    let of = shared.clone();
    let put = move |reward: f64| of.put(0, Reading::Reward { task, reward });
    let (qos, broken) = (reliable_qos(), shared.count_broken(topic));
    match kind.as_str() {
        foreign::Bool::TYPE => {
            graph.hear(topic, qos, move |said: foreign::Bool| put(f64::from(u8::from(said.data))), broken)
        }
        foreign::Float32::TYPE => {
            graph.hear(topic, qos, move |said: foreign::Float32| put(f64::from(said.data)), broken)
        }
        _ => graph.hear(topic, qos, move |said: foreign::Float64| put(said.data), broken),
    }
}

fn velocity(twist: &msg::Twist) -> Velocity {
    Velocity { linear: twist.linear.x, angular: twist.angular.z }
}
