//! A robot behind a ROS 2 network.

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, bounded, select, unbounded};

use super::graph::{LOOK_INTERVAL, LinkError};
use super::listen::leave;
use super::losses::Losses;
use super::pace::Pace;
use super::sensors::Shared;
use super::voice::{Mind, NewEnds, Voice};
use super::watchdog::Watchdog;
use super::wire::{Commands, Join, Wire};
use crate::lock::lock;
use crate::robot::Velocity;
use crate::scenario::{Equipment, Ros2, Scenario};
use crate::source::live::{Base, Reading, Received};

/// Images that wait for the loop of control; then the oldest is dropped.
const MOST_IMAGES: usize = 5;

/// Zeros that are said at the end.
const LAST_ZEROS: usize = 5;

/// Where nothing at all came for so long, real time, the network is joined anew.
const SILENCE: Duration = Duration::from_secs(5);

/// Where the loop of control was held up for so long, too: the process was stopped, or the machine was suspended. RustDDS's loops of
/// events end for good where a wait for them is interrupted by that; if only that of discovery does, others forget us later.
const HELD_UP: Duration = Duration::from_secs(1);

/// How much longer than the network may take that joining it anew is waited for.
const PATIENCE: Duration = Duration::from_secs(30);

/// A robot behind a ROS 2 network.
pub struct Link {
    scenario: Arc<Scenario>,
    settings: Ros2,
    shared: Shared,
    small: Receiver<Received>,
    images: Receiver<Received>,
    watchdog: Watchdog,
    /// By whom the watchdog says zero.
    of_watchdog: Arc<Mutex<Commands>>,
    wire: Wire,
    new_ends: NewEnds,
    /// When something came in, or the network was joined, last.
    heard: Instant,
    /// When the loop of control was here last.
    seen: Instant,
    /// What is worth a word to people.
    pub warnings: Vec<String>,
    /// The network is being joined anew.
    joining: Option<(JoinHandle<Result<Join, LinkError>>, Instant)>,
}

impl Link {
    /// Find the robot of a scenario on the network, and wait for its first image; the voice is what the run says to the network
    /// beside velocities, and what the network asks of it.
    ///
    /// # Errors
    /// See [`LinkError`]: each names the key, the topic, and what is there.
    pub fn open(scenario: &Arc<Scenario>) -> Result<(Self, Voice), LinkError> {
        let settings = scenario.ros2.clone().expect("a scenario with robot.body = \"ros2\" has [ros2]");
        let wait = Duration::from_secs_f64(settings.wait_seconds);
        let until = Instant::now() + wait;
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
            mind: Mind::default(),
        };
        let Join { wire, of_watchdog, ends, warnings } = Wire::join(scenario, &shared, until)?;
        let of_watchdog = Arc::new(Mutex::new(of_watchdog));
        let (by, time, pace) = (of_watchdog.clone(), shared.time.clone(), shared.pace.clone());
        let zero = move || lock(&by).say(Velocity::ZERO, time.now(&pace));
        let watchdog = Watchdog::start(zero)
            .map_err(|cause| LinkError::Network { domain: wire.domain(), cause: cause.to_string() })?;
        let new_ends = NewEnds::default();
        let (time, pace) = (shared.time.clone(), shared.pace.clone());
        let (name, told) = (settings.topic(&settings.node), shared.losses.clone());
        let voice = Voice::new(ends, new_ends.clone(), name, shared.mind.clone(), told, move || time.now(&pace));
        let (scenario, heard, joining) = (scenario.clone(), Instant::now(), None);
        let mut link = Link {
            scenario,
            settings,
            shared,
            small,
            images,
            watchdog,
            of_watchdog,
            wire,
            new_ends,
            heard,
            seen: heard,
            warnings,
            joining,
        };
        let until = until + wait;
        link.wait_for_image(until)?;
        while link.settings.use_sim_time && !link.shared.pace.is_known() && Instant::now() < until {
            link.watchdog.beat();
            std::thread::sleep(LOOK_INTERVAL);
        }
        link.seen = Instant::now();
        Ok((link, voice))
    }

    /// What the robot has beside camera and odometry.
    pub fn equipment(&self) -> Equipment {
        let Ros2 { scan, emergency_stop, lock, .. } = &self.settings;
        let present = |topic: &str| !topic.is_empty();
        Equipment { scan: present(scan), emergency_stop: present(emergency_stop), lock: present(lock) }
    }

    fn wait_for_image(&self, until: Instant) -> Result<(), LinkError> {
        let camera = &self.settings.topic(&self.settings.camera);
        while self.images.is_empty() {
            self.watchdog.beat();
            // Other topics may be refused, too, and no image waits for them.
            let refused = lock(&self.shared.refused).clone();
            if let Some(reason) = refused.as_deref().and_then(|text| text.strip_prefix(&format!("{camera}: "))) {
                return Err(LinkError::Camera { topic: camera.to_owned(), reason: reason.to_owned() });
            }
            if Instant::now() >= until {
                let reason = "it is there, and no image comes".to_owned();
                return Err(LinkError::Camera { topic: camera.to_owned(), reason });
            }
            std::thread::sleep(LOOK_INTERVAL);
        }
        Ok(())
    }

    /// Where the network has fallen silent, or this process was stopped, join it anew beside what goes on, and go on with that.
    fn keep_joined(&mut self) {
        let wait = Duration::from_secs_f64(self.settings.wait_seconds);
        let held_up = std::mem::replace(&mut self.seen, Instant::now()).elapsed() > HELD_UP;
        if self.joining.is_none() && (held_up || self.heard.elapsed() > SILENCE) {
            let (scenario, shared) = (self.scenario.clone(), self.shared.clone());
            let join = move || Wire::join(&scenario, &shared, Instant::now() + wait);
            // A system that has no thread left may have one later.
            let joining = std::thread::Builder::new().name("join".into()).spawn(join).ok();
            self.joining = joining.map(|joining| (joining, Instant::now()));
        }
        // A join that was interrupted itself may hang.
        let is_over = |(joining, begun): &mut (JoinHandle<_>, Instant)| {
            joining.is_finished() || begun.elapsed() > wait + PATIENCE
        };
        let Some((joining, _)) = self.joining.take_if(is_over) else { return };
        self.heard = Instant::now();
        if !joining.is_finished() {
            return;
        }
        // If nobody was there, it is tried again.
        if let Ok(Ok(Join { wire, of_watchdog, ends, .. })) = joining.join() {
            let of_watchdog = std::mem::replace(&mut *lock(&self.of_watchdog), of_watchdog);
            let untaken = lock(&self.new_ends).replace(ends);
            leave((of_watchdog, untaken, std::mem::replace(&mut self.wire, wire)));
            self.shared.put(0, Reading::Note("the network was joined anew".to_owned()));
        }
    }
}

impl Base for Link {
    fn now(&self) -> Duration {
        self.shared.pace.now()
    }

    fn receive(&mut self, until: Duration, take: &mut dyn FnMut(Received)) {
        self.watchdog.beat();
        self.keep_joined();
        loop {
            let left = self.shared.pace.real(until.saturating_sub(self.now()));
            let received = select! {
                recv(self.small) -> received => received,
                recv(self.images) -> received => received,
                default(left) => return,
            };
            self.heard = Instant::now();
            received.into_iter().for_each(&mut *take);
            if left.is_zero() {
                return;
            }
        }
    }

    fn command(&mut self, velocity: Velocity) {
        let velocity = if velocity.is_finite() { velocity } else { Velocity::ZERO };
        self.wire.commands.say(velocity, self.shared.time.now(&self.shared.pace));
        self.watchdog.beat();
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        for _ in 0..LAST_ZEROS {
            self.command(Velocity::ZERO);
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}
