//! What comes in from a robot's topics.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

use crossbeam_channel::{Receiver, Sender, TrySendError};
use nalgebra::Point2;

use super::frames::Frames;
use super::graph::{Graph, LinkError, reliable_qos, sensor_qos};
use super::listen::{Ear, ear};
use super::losses::Losses;
use super::pace::Pace;
use super::voice::Mind;
use crate::log::Message;
use crate::log::messages::{self as msg, foreign};
use crate::robot::{Pose, Velocity};
use crate::scenario::Scenario;
use crate::source::imported::picture;
use crate::source::live::{Reading, Received, Scan};
use crate::source::parse_mark;
use crate::vision::Image;

/// A simulator's time.
const CLOCK: &str = "/clock";

/// The newest time by the robot's clock, and when it came.
#[derive(Default)]
pub struct RobotTime(Mutex<Option<(u64, Instant)>>);

impl RobotTime {
    fn hear(&self, stamp_ns: u64) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some((stamp_ns, Instant::now()));
    }

    pub fn now(&self, pace: &Pace) -> u64 {
        match *self.0.lock().unwrap_or_else(PoisonError::into_inner) {
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

    /// Something came that cannot be used: counted, and told where the one before was of use, or the reason was another one.
    fn refuse(&self, topic: &str, reason: String) {
        self.losses.add(topic);
        let text = format!("{topic}: {reason}");
        let mut refused = self.refused.lock().unwrap_or_else(PoisonError::into_inner);
        if refused.replace(text.clone()).as_ref() != Some(&text) {
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
    graph.wait_for("use_sim_time", CLOCK, &[foreign::Clock::TYPE], until)?;
    let subscription = graph.subscribe::<foreign::Clock>(CLOCK, foreign::Clock::TYPE, sensor_qos())?;
    let pace = shared.pace.clone();
    let take = move |said: foreign::Clock| pace.hear(said.clock.stamp_ns());
    Ok(ear(subscription, take, shared.count_broken(CLOCK)))
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
    Ok(match kind == msg::Image::TYPE {
        true => {
            let subscription = graph.subscribe::<msg::Image>(topic, kind, sensor_qos())?;
            ear(subscription, move |image| put(&image.header, picture::raw(&image)), broken)
        }
        false => {
            let subscription = graph.subscribe::<foreign::CompressedImage>(topic, kind, sensor_qos())?;
            ear(subscription, move |image| put(&image.header, picture::compressed(&image)), broken)
        }
    })
}

pub fn odometry(graph: &mut Graph, topic: &str, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
    let kind = graph.wait_for("odometry", topic, &[msg::Odometry::TYPE], until)?;
    let (subscription, of) = (graph.subscribe::<msg::Odometry>(topic, &kind, sensor_qos())?, shared.clone());
    let take = move |odometry: msg::Odometry| {
        let stamp_ns = odometry.header.stamp_ns();
        if stamp_ns > 0 {
            of.time.hear(stamp_ns);
        }
        let twist = &odometry.twist.twist;
        let velocity = Velocity { linear: twist.linear.x, angular: twist.angular.z };
        of.put(stamp_ns, Reading::Odometry { pose: planar(&odometry.pose.pose), velocity });
    };
    Ok(ear(subscription, take, shared.count_broken(topic)))
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
        let kind = graph.wait_for("scan", &topic, &[msg::LaserScan::TYPE], until)?;
        let (subscription, of) = (graph.subscribe::<msg::LaserScan>(&topic, &kind, sensor_qos())?, shared.clone());
        let take = move |scan: msg::LaserScan| of.put(scan.header.stamp_ns(), Reading::Scan(Arc::new(Scan::of(&scan))));
        ears.push(ear(subscription, take, shared.count_broken(&topic)));
    }
    let bools = [
        ("bumper", &settings.bumper, Reading::Bumper as fn(bool) -> Reading),
        ("emergency_stop", &settings.emergency_stop, Reading::EmergencyStop),
        ("lock", &settings.lock, Reading::Lock),
    ];
    for (key, topic, reading) in bools.into_iter().filter(|(_, topic, _)| !topic.is_empty()) {
        let topic = settings.topic(topic);
        graph.kind_of(key, &topic, &[foreign::Bool::TYPE])?;
        // One that is not there yet is silent, and that stops the robot.
        let subscription = graph.subscribe::<foreign::Bool>(&topic, foreign::Bool::TYPE, reliable_qos())?;
        let of = shared.clone();
        ears.push(ear(
            subscription,
            move |said: foreign::Bool| of.put(0, reading(said.data)),
            shared.count_broken(&topic),
        ));
    }
    if !settings.teleop.is_empty() {
        let topic = settings.topic(&settings.teleop);
        let said = |twist: &msg::Twist| Velocity { linear: twist.linear.x, angular: twist.angular.z };
        let (of, broken) = (shared.clone(), shared.count_broken(&topic));
        // A person may come later: then it is of the type that the base takes.
        let kinds = [foreign::TWIST, msg::TwistStamped::TYPE];
        let kind = graph.kind_of("teleop", &topic, &kinds)?.unwrap_or_else(|| kinds[usize::from(stamped)].to_owned());
        ears.push(if kind == foreign::TWIST {
            let subscription = graph.subscribe::<msg::Twist>(&topic, &kind, reliable_qos())?;
            ear(subscription, move |twist| of.put(0, Reading::Teleop(said(&twist))), broken)
        } else {
            let subscription = graph.subscribe::<msg::TwistStamped>(&topic, &kind, reliable_qos())?;
            ear(
                subscription,
                move |of_stamp: msg::TwistStamped| of.put(0, Reading::Teleop(said(&of_stamp.twist))),
                broken,
            )
        });
    }
    if !settings.battery.is_empty() {
        let topic = settings.topic(&settings.battery);
        graph.kind_of("battery", &topic, &[foreign::BatteryState::TYPE])?;
        let subscription =
            graph.subscribe::<foreign::BatteryState>(&topic, foreign::BatteryState::TYPE, sensor_qos())?;
        let of = shared.clone();
        let take = move |battery: foreign::BatteryState| of.put(0, Reading::Battery(f64::from(battery.percentage)));
        ears.push(ear(subscription, take, shared.count_broken(&topic)));
    }
    if !settings.pose.is_empty() {
        ears.push(true_pose(graph, &settings.topic(&settings.pose), shared, until)?);
    }
    let (of, names) = (shared.clone(), scenario.clone());
    let subscription =
        graph.subscribe::<msg::Text>(crate::log::topics::MARK.name(), msg::Text::TYPE, reliable_qos())?;
    let take = move |said: msg::Text| match parse_mark(&said.data, &names) {
        Ok(mark) => of.put(0, Reading::Mark(mark)),
        Err(reason) => of.refuse(crate::log::topics::MARK.name(), reason),
    };
    ears.push(ear(subscription, take, shared.count_broken(crate::log::topics::MARK.name())));
    for (task, topic) in scenario.tasks.iter().enumerate().filter_map(|(task, of)| Some((task, of.topic.clone()?))) {
        ears.push(reward(graph, task, &settings.topic(&topic), shared, until)?);
    }
    Ok(ears)
}

fn true_pose(graph: &mut Graph, topic: &str, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
    let kinds = [
        msg::PoseStamped::TYPE,
        foreign::PoseWithCovarianceStamped::TYPE,
        msg::Odometry::TYPE,
        foreign::TfMessage::TYPE,
    ];
    let kind = graph.wait_for("pose", topic, &kinds, until)?;
    let of = shared.clone();
    let put = move |header: &msg::Header, pose: &msg::Pose| of.put(header.stamp_ns(), Reading::Pose(planar(pose)));
    let broken = shared.count_broken(topic);
    Ok(if kind == msg::PoseStamped::TYPE {
        let subscription = graph.subscribe::<msg::PoseStamped>(topic, &kind, sensor_qos())?;
        ear(subscription, move |of| put(&of.header, &of.pose), broken)
    } else if kind == msg::Odometry::TYPE {
        let subscription = graph.subscribe::<msg::Odometry>(topic, &kind, sensor_qos())?;
        ear(subscription, move |of| put(&of.header, &of.pose.pose), broken)
    } else if kind == foreign::TfMessage::TYPE {
        // Transforms are published reliably, and those of a slow localisation seldom.
        let subscription = graph.subscribe::<foreign::TfMessage>(topic, &kind, reliable_qos())?;
        let (mut frames, of) = (Frames::default(), shared.clone());
        let take = move |message: foreign::TfMessage| {
            for transform in &message.transforms {
                if let Some((stamp_ns, pose)) = frames.hear(transform) {
                    of.put(stamp_ns, Reading::Pose(pose));
                }
            }
        };
        ear(subscription, take, broken)
    } else {
        let subscription = graph.subscribe::<foreign::PoseWithCovarianceStamped>(topic, &kind, sensor_qos())?;
        ear(subscription, move |of| put(&of.header, &of.pose.pose), broken)
    })
}

fn reward(graph: &mut Graph, task: usize, topic: &str, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
    let kinds = [foreign::Bool::TYPE, foreign::Float32::TYPE, foreign::Float64::TYPE];
    let kind = graph.wait_for("reward", topic, &kinds, until)?;
    let of = shared.clone();
    let put = move |reward: f64| of.put(0, Reading::Reward { task, reward });
    let broken = shared.count_broken(topic);
    Ok(if kind == foreign::Bool::TYPE {
        let subscription = graph.subscribe::<foreign::Bool>(topic, &kind, reliable_qos())?;
        ear(subscription, move |said| put(f64::from(u8::from(said.data))), broken)
    } else if kind == foreign::Float32::TYPE {
        let subscription = graph.subscribe::<foreign::Float32>(topic, &kind, reliable_qos())?;
        ear(subscription, move |said| put(f64::from(said.data)), broken)
    } else {
        let subscription = graph.subscribe::<foreign::Float64>(topic, &kind, reliable_qos())?;
        ear(subscription, move |said| put(said.data), broken)
    })
}

fn planar(pose: &msg::Pose) -> Pose {
    Pose::new(Point2::new(pose.position.x, pose.position.y), pose.heading())
}
