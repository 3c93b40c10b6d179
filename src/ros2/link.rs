//! A robot behind a ROS 2 network.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crossbeam_channel::{Receiver, Sender, TrySendError, bounded, select, unbounded};
use nalgebra::Point2;
use ros2_client::Publisher;

use super::frames::Frames;
use super::graph::{Graph, LOOK_INTERVAL, LinkError, reliable_qos, sensor_qos};
use super::listen::{Ear, ear, listen};
use super::losses::Losses;
use super::pace::Pace;
use super::voice::Voice;
use super::watchdog::Watchdog;
use crate::log::Message;
use crate::log::messages::{self as msg, foreign};
use crate::robot::{Pose, Velocity};
use crate::scenario::{CommandType, Equipment, Scenario};
use crate::source::imported::picture;
use crate::source::live::{Base, Reading, Received, Scan};
use crate::source::parse_mark;
use crate::vision::Image;

/// Images that wait for the loop of control; then the oldest is dropped.
const MOST_IMAGES: usize = 5;

/// A simulator's time.
const CLOCK: &str = "/clock";

/// Zeros that are said at the end.
const LAST_ZEROS: usize = 5;

/// By whom velocities are published, as which type.
enum Commands {
    Twist(Publisher<msg::Twist>),
    Stamped(Publisher<msg::TwistStamped>),
}

impl Commands {
    fn say(&self, velocity: Velocity, stamp_ns: u64) {
        let twist = msg::Twist {
            linear: msg::Vector3 { x: velocity.linear, y: 0.0, z: 0.0 },
            angular: msg::Vector3 { x: 0.0, y: 0.0, z: velocity.angular },
        };
        // What is not sent now is too old to be sent later; the next one comes soon.
        match self {
            Commands::Twist(publisher) => drop(publisher.publish(twist)),
            Commands::Stamped(publisher) => {
                let header = msg::Header::new(stamp_ns, "base_link");
                drop(publisher.publish(msg::TwistStamped { header, twist }));
            }
        }
    }
}

/// The newest time by the robot's clock, and when it came.
#[derive(Default)]
struct RobotTime(Mutex<Option<(u64, Instant)>>);

impl RobotTime {
    fn hear(&self, stamp_ns: u64) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some((stamp_ns, Instant::now()));
    }

    fn now(&self, pace: &Pace) -> u64 {
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
struct Shared {
    pace: Arc<Pace>,
    time: Arc<RobotTime>,
    small: Sender<Received>,
    images: Sender<Received>,
    /// The other end, to drop the oldest.
    waiting: Receiver<Received>,
    losses: Losses,
    /// Why what was refused last could not be used.
    refused: Arc<Mutex<Option<String>>>,
}

impl Shared {
    fn received(&self, stamp_ns: u64, reading: Reading) -> Received {
        let at = self.pace.now();
        // Without a stamp it was now.
        let stamp_ns = if stamp_ns == 0 { self.time.now(&self.pace) } else { stamp_ns };
        Received { at, stamp_ns, reading }
    }

    fn put(&self, stamp_ns: u64, reading: Reading) {
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
            self.put(0, Reading::Unusable(text));
        }
    }

    fn count_broken(&self, topic: &str) -> impl FnMut(String) + Send + 'static {
        let (losses, topic) = (self.losses.clone(), topic.to_owned());
        move |_| losses.add(&topic)
    }
}

/// A robot behind a ROS 2 network.
pub struct Link {
    shared: Shared,
    small: Receiver<Received>,
    images: Receiver<Received>,
    commands: Commands,
    watchdog: Watchdog,
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    equipment: Equipment,
    /// What is worth a word to people.
    pub warnings: Vec<String>,
    /// Our node leaves the network last.
    graph: Graph,
}

impl Link {
    /// Find the robot of a scenario on the network, and wait for its first image.
    ///
    /// # Errors
    /// See [`LinkError`]: each names the key, the topic, and what is there.
    pub fn open(scenario: &Arc<Scenario>) -> Result<Self, LinkError> {
        let settings = scenario.ros2.clone().expect("a scenario with robot.body = \"ros2\" has [ros2]");
        let mut graph = Graph::join(&settings)?;
        let domain = graph.domain();
        let until = Instant::now() + Duration::from_secs_f64(settings.wait_seconds);
        let (small_in, small) = unbounded();
        let (images_in, images) = bounded(MOST_IMAGES);
        let shared = Shared {
            pace: Arc::new(Pace::new()),
            time: Arc::default(),
            small: small_in,
            images: images_in,
            waiting: images.clone(),
            losses: Losses::default(),
            refused: Arc::default(),
        };
        let camera = settings.topic(&settings.camera);
        let kind = graph.wait_for("camera", &camera, &[msg::Image::TYPE, foreign::CompressedImage::TYPE], until)?;
        let eye = eye(&mut graph, scenario, &camera, &kind, &shared)?;
        let mut ears = vec![odometry(&mut graph, &settings.topic(&settings.odometry), &shared, until)?];
        if settings.use_sim_time {
            graph.wait_for("use_sim_time", CLOCK, &[foreign::Clock::TYPE], until)?;
            let (subscription, pace) =
                (graph.subscribe::<foreign::Clock>(CLOCK, foreign::Clock::TYPE, sensor_qos())?, shared.pace.clone());
            ears.push(ear(
                subscription,
                move |said: foreign::Clock| pace.hear(said.clock.stamp_ns()),
                shared.count_broken(CLOCK),
            ));
        }
        let command = settings.topic(&settings.command);
        let stamped = is_stamped(&graph, settings.command_type, &command, settings.wait_seconds, until)?;
        ears.extend(switches(&mut graph, scenario, &shared, stamped, until)?);
        let mut warnings = Vec::new();
        let others = graph.published().into_iter().filter(|end| end.topic == command).count();
        if others > 0 {
            warnings.push(format!("{others} others publish on {command}: whoever speaks last moves the robot"));
        }
        for topic in [&camera, &settings.topic(&settings.odometry)] {
            let publishers = graph.published().into_iter().filter(|end| end.topic == *topic).count();
            if publishers > 1 {
                warnings.push(format!("{publishers} publish {topic}: images or poses of two robots may be mixed"));
            }
        }
        let mut commands = || -> Result<Commands, LinkError> {
            Ok(match stamped {
                true => Commands::Stamped(graph.publish(&command, msg::TwistStamped::TYPE)?),
                false => Commands::Twist(graph.publish(&command, foreign::TWIST)?),
            })
        };
        let (own, of_watchdog) = (commands()?, commands()?);
        let failed = |cause: std::io::Error| LinkError::Network { domain, cause: cause.to_string() };
        let (time, pace) = (shared.time.clone(), shared.pace.clone());
        let watchdog = Watchdog::start(move || of_watchdog.say(Velocity::ZERO, time.now(&pace))).map_err(failed)?;
        let over = Arc::new(AtomicBool::new(false));
        let threads =
            vec![listen("images", vec![eye], &over).map_err(failed)?, listen("sensors", ears, &over).map_err(failed)?];
        let present = |topic: &str| !topic.is_empty();
        let equipment = Equipment {
            scan: present(&settings.scan),
            emergency_stop: present(&settings.emergency_stop),
            lock: present(&settings.lock),
        };
        let link = Link { shared, small, images, commands: own, watchdog, over, threads, equipment, warnings, graph };
        let until = until + Duration::from_secs_f64(settings.wait_seconds);
        link.wait_for_image(&camera, until)?;
        while settings.use_sim_time && !link.shared.pace.is_known() && Instant::now() < until {
            link.watchdog.beat();
            std::thread::sleep(LOOK_INTERVAL);
        }
        Ok(link)
    }

    /// What the robot has beside camera and odometry.
    pub fn equipment(&self) -> Equipment {
        self.equipment
    }

    /// What the run says to the network, and what the network asks of it: on a node of its own.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn voice(&self, scenario: &Arc<Scenario>) -> Result<Voice, LinkError> {
        let (time, pace) = (self.shared.time.clone(), self.shared.pace.clone());
        Voice::open(self.graph.beside("run")?, scenario, self.shared.losses.clone(), move || time.now(&pace))
    }

    fn wait_for_image(&self, camera: &str, until: Instant) -> Result<(), LinkError> {
        while self.images.is_empty() {
            self.watchdog.beat();
            let refused = self.shared.refused.lock().unwrap_or_else(PoisonError::into_inner).clone();
            if let Some(reason) = refused {
                let reason = reason.trim_start_matches(&format!("{camera}: ")).to_owned();
                return Err(LinkError::Camera { topic: camera.to_owned(), reason });
            }
            if Instant::now() >= until {
                let reason = "it is there, and no image comes".to_owned();
                return Err(LinkError::Camera { topic: camera.to_owned(), reason });
            }
            std::thread::sleep(LOOK_INTERVAL);
        }
        Ok(())
    }
}

impl Base for Link {
    fn now(&self) -> Duration {
        self.shared.pace.now()
    }

    fn receive(&mut self, until: Duration, take: &mut dyn FnMut(Received)) {
        self.watchdog.beat();
        loop {
            let left = self.shared.pace.real(until.saturating_sub(self.now()));
            select! {
                recv(self.small) -> received => received.into_iter().for_each(&mut *take),
                recv(self.images) -> received => received.into_iter().for_each(&mut *take),
                default(left) => return,
            }
            if left.is_zero() {
                return;
            }
        }
    }

    fn command(&mut self, velocity: Velocity) {
        let velocity = if velocity.is_finite() { velocity } else { Velocity::ZERO };
        self.commands.say(velocity, self.shared.time.now(&self.shared.pace));
        self.watchdog.beat();
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        for _ in 0..LAST_ZEROS {
            self.command(Velocity::ZERO);
            std::thread::sleep(Duration::from_millis(20));
        }
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Whether velocities have stamps, by who listens.
fn is_stamped(graph: &Graph, wanted: CommandType, topic: &str, waited: f64, until: Instant) -> Result<bool, LinkError> {
    loop {
        let ends = graph.listened_to();
        let heard_as = |kind: &str| ends.iter().any(|end| end.topic == topic && end.kind == kind);
        let (plain, stamped) = (heard_as(foreign::TWIST), heard_as(msg::TwistStamped::TYPE));
        match (wanted, plain, stamped) {
            (CommandType::Auto, true, true) => return Err(LinkError::BothTypes(topic.to_owned())),
            (CommandType::Twist, ..) | (CommandType::Auto, true, false) => return Ok(false),
            (CommandType::TwistStamped, ..) | (CommandType::Auto, false, true) => return Ok(true),
            (CommandType::Auto, false, false) if Instant::now() >= until => {
                let (topic, domain, seen) = (topic.to_owned(), graph.domain(), super::graph::texts(&ends));
                return Err(LinkError::Deaf { topic, domain, waited, seen });
            }
            _ => std::thread::sleep(LOOK_INTERVAL),
        }
    }
}

/// Listens to the camera: images are decoded and cut on its thread.
fn eye(
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

fn odometry(graph: &mut Graph, topic: &str, shared: &Shared, until: Instant) -> Result<Ear, LinkError> {
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
fn switches(
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
