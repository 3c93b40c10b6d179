//! What is on the network, before anything drives.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io::Cursor;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::Serialize;

use super::graph::{Domain, End, Graph, LinkError, kinds, sensor_qos};
use super::listen::Threads;
use crate::lock::lock;
use crate::log::Message;
use crate::log::messages::{self as msg, foreign};
use crate::scenario::Ros2;
use crate::source::imported::picture;
use crate::vision::Image;

/// What came on one of the robot's topics.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Heard {
    /// Messages.
    pub messages: u64,
    /// Messages a second, between the first and the last one.
    pub hz: Option<f64>,
    /// By how much its stamps are ahead of this machine's clock, the least delayed one, seconds.
    pub stamps_ahead_s: Option<f64>,
    /// Of transforms, which frame is in which.
    #[serde(skip_serializing_if = "BTreeSet::is_empty")]
    pub frames: BTreeSet<String>,
    /// What was wrong with the first one that could not be used.
    pub unusable: Option<String>,
}

/// Something that should be otherwise.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// Whether a run cannot begin like this.
    pub is_error: bool,
    /// What it is, and what to do.
    pub text: String,
}

/// What was seen within some seconds.
#[derive(Debug, Clone, Serialize)]
pub struct Doctor {
    /// The DDS domain.
    pub domain: u16,
    /// How long was listened, seconds.
    pub seconds: f64,
    /// What others publish.
    pub published: Vec<End>,
    /// What others listen to.
    pub listened_to: Vec<End>,
    /// What came on the topics that the scenario names.
    pub heard: BTreeMap<String, Heard>,
    /// What should be otherwise.
    pub findings: Vec<Finding>,
    /// The first camera image, as PNG.
    #[serde(skip)]
    pub picture: Option<Vec<u8>>,
}

/// Where transforms are.
const TRANSFORMS: &str = "/tf";

/// Takes note of messages as they come.
#[derive(Clone, Default)]
struct Ear(Arc<Mutex<Notes>>);

#[derive(Default)]
struct Notes {
    heard: Heard,
    first_and_last: Option<(Instant, Instant)>,
    image: Option<Image>,
}

impl Ear {
    fn hear(&self, header: &msg::Header) {
        let (now, notes) = (Instant::now(), &mut lock(&self.0));
        notes.heard.messages += 1;
        notes.first_and_last = Some((notes.first_and_last.map_or(now, |(first, _)| first), now));
        let ours = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64());
        let ahead = header.stamp_ns() as f64 / 1e9 - ours;
        notes.heard.stamps_ahead_s = Some(notes.heard.stamps_ahead_s.map_or(ahead, |before| before.max(ahead)));
    }

    fn see(&self, header: &msg::Header, image: Result<Image, picture::PictureError>) {
        self.hear(header);
        match image {
            Ok(image) => {
                lock(&self.0).image.get_or_insert(image);
            }
            Err(error) => {
                lock(&self.0).heard.unusable.get_or_insert(error.to_string());
            }
        }
    }

    fn refuse(&self) -> impl FnMut(String) + Send + 'static {
        let of = self.clone();
        move |reason| {
            lock(&of.0).heard.unusable.get_or_insert(reason);
        }
    }

    fn heard(&self) -> Heard {
        let notes = lock(&self.0);
        let seconds = notes.first_and_last.map_or(0.0, |(first, last)| (last - first).as_secs_f64());
        let hz = (seconds > 0.0).then(|| (notes.heard.messages - 1) as f64 / seconds);
        Heard { hz, ..notes.heard.clone() }
    }
}

impl Doctor {
    /// Listen for so many seconds.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn listen(settings: &Ros2, seconds: f64) -> Result<Self, LinkError> {
        let mut graph = Domain::join(settings)?.node("")?;
        let begun = Instant::now();
        let until = begun + Duration::from_secs_f64(seconds);
        let (mut notes, mut threads) = (BTreeMap::new(), Threads::default());
        // Whom to listen to is known only once they were found.
        let names = [&settings.camera, &settings.odometry, &settings.scan];
        let mut wanted: Vec<String> =
            names.into_iter().filter(|name| !name.is_empty()).map(|name| settings.topic(name)).collect();
        wanted.push(TRANSFORMS.to_owned());
        while Instant::now() < until {
            let published = graph.published();
            let (mut left, mut ears) = (Vec::new(), Vec::new());
            for topic in std::mem::take(&mut wanted) {
                let Some(end) = published.iter().find(|end| end.topic == topic) else {
                    left.push(topic);
                    continue;
                };
                let ear_of = Ear::default();
                if let Some(ear) = listen_to(&mut graph, end, &ear_of)? {
                    ears.push(ear);
                }
                notes.insert(topic, ear_of);
            }
            wanted = left;
            if !ears.is_empty() {
                threads.listen("doctor", ears).map_err(|cause| graph.failed(&cause))?;
            }
            std::thread::sleep(super::graph::LOOK_INTERVAL);
        }
        drop(threads);
        let image = notes.values().find_map(|of| lock(&of.0).image.take());
        let mut doctor = Doctor {
            domain: graph.domain(),
            seconds: begun.elapsed().as_secs_f64(),
            published: graph.published(),
            listened_to: graph.listened_to(),
            heard: notes.into_iter().map(|(topic, of)| (topic, of.heard())).collect(),
            findings: Vec::new(),
            picture: image.and_then(|image| png(&image)),
        };
        doctor.findings = doctor.examine(settings);
        Ok(doctor)
    }

    fn examine(&self, settings: &Ros2) -> Vec<Finding> {
        let mut findings = Vec::new();
        let mut find = |is_error: bool, text: String| findings.push(Finding { is_error, text });
        let publishers = |topic: &str| self.published.iter().filter(|end| end.topic == topic).count();
        let topics = settings.topics().into_iter().filter(|&(key, name)| key != "command" && !name.is_empty());
        for (key, name) in topics {
            let (topic, kinds) = (settings.topic(name), kinds(key));
            let found = self.published.iter().find(|end| end.topic == topic);
            match found {
                None => {
                    let fitting: Vec<&str> = self
                        .published
                        .iter()
                        .filter(|end| kinds.contains(&end.kind.as_str()))
                        .map(|end| end.topic.as_str())
                        .collect();
                    let hint = match fitting.is_empty() {
                        true => String::new(),
                        false => format!("; of its type there is {}", fitting.join(", ")),
                    };
                    // A person who is not there does not drive.
                    find(key != "teleop", format!("ros2.{key} = {topic}: nobody publishes it{hint}"));
                }
                Some(end) if !kinds.contains(&end.kind.as_str()) => {
                    let wanted = kinds.join(" or ");
                    find(true, format!("ros2.{key} = {topic} is {}: it must be {wanted}", end.kind));
                }
                Some(_) if publishers(&topic) > 1 => {
                    find(false, format!("{} publish {topic}: two robots may be mixed", publishers(&topic)));
                }
                Some(_) => {}
            }
        }
        for (topic, heard) in &self.heard {
            if let Some(reason) = &heard.unusable {
                find(true, format!("{topic}: {reason}"));
            } else if heard.messages == 0 {
                find(true, format!("{topic} is published, and nothing comes: a firewall, or quality of service"));
            }
            if let Some(ahead) = heard.stamps_ahead_s.filter(|ahead| ahead.abs() > 0.5) {
                let text = format!(
                    "the stamps of {topic} are {ahead:+.1} s from this machine's clock: a run takes the robot's"
                );
                find(false, text);
            }
        }
        let command = settings.topic(&settings.command);
        let heard_as = |kind: &str| self.listened_to.iter().any(|end| end.topic == command && end.kind == kind);
        match (heard_as(msg::Twist::TYPE), heard_as(msg::TwistStamped::TYPE)) {
            (false, false) => find(true, format!("ros2.command = {command}: nobody listens to it")),
            (true, true) => find(
                settings.command_type == crate::scenario::CommandType::Auto,
                format!("{command} is listened to as Twist and as TwistStamped: set ros2.command_type"),
            ),
            _ => {}
        }
        if publishers(&command) > 0 {
            find(
                false,
                format!("{} others publish {command}: whoever speaks last moves the robot", publishers(&command)),
            );
        }
        if settings.emergency_stop.is_empty() && settings.lock.is_empty() {
            find(false, "there is no emergency stop and no lock: keep a hand on the robot's own switch".to_owned());
        }
        find(
            false,
            "whether the base stops by itself without commands cannot be seen from here: lift its wheels and try"
                .to_owned(),
        );
        findings
    }
}

impl fmt::Display for Doctor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "ROS 2, domain {}, {:.1} s", self.domain, self.seconds)?;
        for (what, ends) in [("published", &self.published), ("listened to", &self.listened_to)] {
            writeln!(f, "\n{what}:")?;
            if ends.is_empty() {
                writeln!(f, "  nothing")?;
            }
            for end in ends {
                let kept = match end.best_effort {
                    Some(true) => ", best effort",
                    Some(false) => ", reliable",
                    None => "",
                };
                writeln!(f, "  {} ({}{kept})", end.topic, end.kind)?;
            }
        }
        writeln!(f, "\nheard:")?;
        for (topic, heard) in &self.heard {
            let hz = heard.hz.map_or(String::new(), |hz| format!(", {hz:.1} a second"));
            let ahead = heard.stamps_ahead_s.map_or(String::new(), |ahead| format!(", stamps {ahead:+.3} s"));
            writeln!(f, "  {topic}: {} messages{hz}{ahead}", heard.messages)?;
            if !heard.frames.is_empty() {
                writeln!(f, "    {}", heard.frames.iter().map(String::as_str).collect::<Vec<_>>().join(", "))?;
            }
        }
        writeln!(f)?;
        for finding in &self.findings {
            writeln!(f, "{}: {}", if finding.is_error { "error" } else { "note" }, finding.text)?;
        }
        let fails = self.findings.iter().any(|finding| finding.is_error);
        writeln!(f, "{}", if fails { "a run cannot begin like this" } else { "a run can begin" })
    }
}

/// An ear for a topic of a type that is known here.
fn listen_to(graph: &mut Graph, end: &End, of: &Ear) -> Result<Option<super::listen::Ear>, LinkError> {
    let (topic, note, refuse) = (end.topic.as_str(), of.clone(), of.refuse());
    let ear = match end.kind.as_str() {
        msg::Image::TYPE => {
            graph.hear(topic, sensor_qos(), move |of: msg::Image| note.see(&of.header, picture::raw(&of)), refuse)
        }
        foreign::CompressedImage::TYPE => {
            let take = move |of: foreign::CompressedImage| note.see(&of.header, picture::compressed(&of));
            graph.hear(topic, sensor_qos(), take, refuse)
        }
        msg::Odometry::TYPE => graph.hear(topic, sensor_qos(), move |of: msg::Odometry| note.hear(&of.header), refuse),
        msg::LaserScan::TYPE => {
            graph.hear(topic, sensor_qos(), move |of: msg::LaserScan| note.hear(&of.header), refuse)
        }
        foreign::TfMessage::TYPE => {
            let take = move |message: foreign::TfMessage| {
                for transform in &message.transforms {
                    note.hear(&transform.header);
                    let (frame, outer) = (&transform.child_frame_id, &transform.header.frame_id);
                    lock(&note.0).heard.frames.insert(format!("{frame} in {outer}"));
                }
            };
            graph.hear(topic, sensor_qos(), take, refuse)
        }
        _ => return Ok(None),
    };
    ear.map(Some)
}

fn png(image: &Image) -> Option<Vec<u8>> {
    let pixels = image::RgbImage::from_raw(image.width as u32, image.height as u32, image.rgb.clone())?;
    let mut bytes = Vec::new();
    pixels.write_to(&mut Cursor::new(&mut bytes), image::ImageFormat::Png).ok()?;
    Some(bytes)
}
