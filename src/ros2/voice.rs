//! What a run says to the network beside velocities, and what the network asks of it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use crossbeam_channel::{Receiver, Sender, unbounded};
use ros2_client::{Message as Call, Publisher, ServiceTypeName};
use serde::{Deserialize, Serialize};

use super::graph::{Domain, Graph, LinkError, reliable_qos};
use super::listen::{Ear, Threads, answers, leave};
use super::losses::Losses;
use super::navigate::navigate;
use super::request::{Errand, Progress, Request};
use super::said::{
    DiagnosticArray, DiagnosticStatus, KeyValue, MapMetaData, Marker, MarkerArray, MessagesLostEvent,
    MessagesLostEventTopicStat, OccupancyGrid,
};
use crate::lock::lock;
use crate::log::Message;
use crate::log::messages::{self as msg, foreign};
use crate::scenario::{Ros2, Scenario};

/// The frame that places are in.
const MAP: &str = "map";

/// Publishers of a run, and requests to it.
pub struct Voice {
    ends: Ends,
    new_ends: NewEnds,
    now: Box<dyn Fn() -> u64 + Send>,
    name: String,
    losses: Losses,
    errand: Errand,
    /// Losses that were told.
    told: BTreeMap<String, u64>,
    requests: Receiver<Request>,
}

/// What a voice has to have beside the network.
#[derive(Clone)]
pub struct Mind {
    asked: Sender<Request>,
    requests: Receiver<Request>,
    errand: Errand,
}

impl Default for Mind {
    fn default() -> Self {
        let (asked, requests) = unbounded();
        Mind { asked, requests, errand: Errand::default() }
    }
}

/// What the voice goes on with, where the network was joined anew.
pub type NewEnds = Arc<Mutex<Option<Ends>>>;

/// Our ends of the topics, as long as the network carries them.
pub struct Ends {
    /// They listen, and end before anything else of it.
    _threads: Threads,
    graph: Graph,
    observation: Publisher<msg::Image>,
    diagnostics: Publisher<DiagnosticArray>,
    markers: Publisher<MarkerArray>,
    values: BTreeMap<String, Publisher<OccupancyGrid>>,
    lost: Publisher<MessagesLostEvent>,
}

impl Ends {
    /// Publishers and requests on a node of their own.
    ///
    /// # Errors
    /// [`LinkError::Network`].
    pub fn open(domain: &Domain, scenario: &Scenario, mind: &Mind) -> Result<Self, LinkError> {
        let settings = scenario.ros2.as_ref().expect("a scenario with robot.body = \"ros2\" has [ros2]");
        let mut graph = domain.node("_run")?;
        let mut ears = ears(&mut graph, scenario, settings, &mind.asked)?;
        ears.push(navigate(&mut graph, &settings.topic("navigate_to_pose"), mind.asked.clone(), mind.errand.clone())?);
        let mut values = BTreeMap::new();
        for task in scenario.tasks.iter().filter(|task| is_name(&task.name)) {
            let topic = settings.topic(&format!("adagio/value/{}", task.name));
            values.insert(task.name.clone(), graph.publish(&topic, OccupancyGrid::TYPE)?);
        }
        let mut threads = Threads::default();
        threads.listen("requests", ears).map_err(|cause| domain.failed(&cause))?;
        Ok(Ends {
            _threads: threads,
            observation: graph.publish(&settings.topic("adagio/observation"), msg::Image::TYPE)?,
            // Where ROS's tools look for them.
            diagnostics: graph.publish("/diagnostics", DiagnosticArray::TYPE)?,
            markers: graph.publish(&settings.topic("adagio/markers"), MarkerArray::TYPE)?,
            lost: graph.publish(&settings.topic("events/rosbag2_messages_lost"), MessagesLostEvent::TYPE)?,
            graph,
            values,
        })
    }
}

impl Voice {
    /// Some ends, and those that come in their place when the network was joined anew; `now` is the robot's time, nanoseconds since 1970.
    pub(super) fn new(
        ends: Ends,
        new_ends: NewEnds,
        name: String,
        mind: Mind,
        losses: Losses,
        now: impl Fn() -> u64 + Send + 'static,
    ) -> Self {
        let Mind { requests, errand, .. } = mind;
        Voice { ends, new_ends, now: Box::new(now), name, losses, errand, told: BTreeMap::new(), requests }
    }

    /// Where the network was joined anew, go on there.
    pub fn follow(&mut self) {
        let new = lock(&self.new_ends).take();
        if let Some(new) = new {
            leave(std::mem::replace(&mut self.ends, new));
        }
    }

    /// The next thing that was asked, and not taken yet.
    pub fn request(&self) -> Option<Request> {
        self.requests.try_recv().ok()
    }

    /// How far the robot is with the place that was asked for last.
    pub fn progress(&self) -> Progress {
        self.errand.now()
    }

    /// It is so far now.
    pub fn tell_progress(&self, progress: Progress) {
        self.errand.set(progress);
    }

    /// A line of diagnostics, on `/rosout`.
    pub fn say(&self, warns: bool, text: &str) {
        self.ends.graph.say(warns, text);
    }

    /// What is learned from: RGB, row by row.
    pub fn observation(&self, width: usize, height: usize, rgb: &[u8]) {
        let (height, width, step) = (height as u32, width as u32, 3 * width as u32);
        let header = msg::Header::new((self.now)(), "camera");
        let (encoding, data) = ("rgb8".to_owned(), rgb.to_vec());
        // What nobody listens to, or takes in time, comes again.
        let image = msg::Image { header, height, width, encoding, step, data, ..msg::Image::default() };
        drop(self.ends.observation.publish(image));
    }

    /// How parts of the run are doing: their names follow that of our node.
    pub fn diagnostics(&self, mut status: Vec<DiagnosticStatus>) {
        for part in &mut status {
            part.name = format!("{}: {}", self.name, part.name);
        }
        let lost: u64 = self.losses.now().values().sum();
        let values = self.losses.now().iter().map(|(topic, count)| KeyValue::new(topic, count)).collect();
        status.push(DiagnosticStatus {
            level: if lost == 0 { DiagnosticStatus::OK } else { DiagnosticStatus::WARN },
            name: format!("{}: losses", self.name),
            message: format!("{lost} messages were not taken in time, or of no use"),
            hardware_id: String::new(),
            values,
        });
        drop(self.ends.diagnostics.publish(DiagnosticArray { header: msg::Header::new((self.now)(), ""), status }));
    }

    /// Messages that were lost since this was last asked, if there are any.
    pub fn losses(&mut self) {
        let now = self.losses.now();
        let new = now.iter().map(|(topic, &count)| (topic, count - self.told.get(topic).copied().unwrap_or(0)));
        let of = |(topic, count): (&String, u64)| MessagesLostEventTopicStat {
            topic_name: topic.clone(),
            messages_lost_in_transport: 0,
            messages_lost_in_recorder: count,
        };
        let messages_lost_statistics: Vec<_> = new.filter(|&(_, count)| count > 0).map(of).collect();
        if !messages_lost_statistics.is_empty() {
            drop(self.ends.lost.publish(MessagesLostEvent { node_name: self.name.clone(), messages_lost_statistics }));
            self.told = now;
        }
    }

    /// Things to draw, in the map's frame.
    pub fn markers(&self, mut markers: Vec<Marker>) {
        let header = msg::Header::new((self.now)(), MAP);
        for (id, marker) in markers.iter_mut().enumerate() {
            (marker.header, marker.id) = (header.clone(), id as i32);
        }
        drop(self.ends.markers.publish(MarkerArray { markers }));
    }

    /// What places are worth to a task, from 0 to 100, −1 where that is not known: rows of `width` cells from the lowest corner.
    pub fn values(&self, task: &str, low: [f64; 2], cell: f64, width: usize, data: Vec<i8>) {
        let Some(publisher) = self.ends.values.get(task) else { return };
        let header = msg::Header::new((self.now)(), MAP);
        let origin = msg::Pose::planar(low[0], low[1], 0.0);
        let (map_load_time, height) = (header.stamp.clone(), (data.len() / width.max(1)) as u32);
        let info = MapMetaData { map_load_time, resolution: cell as f32, width: width as u32, height, origin };
        drop(publisher.publish(OccupancyGrid { header, info, data }));
    }

    /// Messages that were lost, by topic.
    pub fn lost(&self) -> BTreeMap<String, u64> {
        self.losses.now()
    }
}

impl KeyValue {
    /// A number or a word with its name.
    pub fn new(key: &str, value: impl ToString) -> Self {
        KeyValue { key: key.to_owned(), value: value.to_string() }
    }
}

/// Whether a task's name can be part of a topic's.
fn is_name(task: &str) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    task.starts_with(|c: char| c.is_ascii_alphabetic()) && task.chars().all(plain)
}

/// A call of `std_srvs/srv/Trigger`.
impl Call for foreign::Empty {}

/// A call of `std_srvs/srv/SetBool`.
#[derive(Clone, Serialize, Deserialize)]
struct Switch {
    data: bool,
}

impl Call for Switch {}

/// The answer of both services.
#[derive(Serialize, Deserialize)]
struct Answer {
    success: bool,
    message: String,
}

impl Call for Answer {}

fn ears(
    graph: &mut Graph,
    scenario: &Scenario,
    settings: &Ros2,
    asked: &Sender<Request>,
) -> Result<Vec<Ear>, LinkError> {
    let mut ears = vec![
        hear(graph, settings, "adagio/pause", asked, |of: foreign::Bool| Request::Pause(of.data))?,
        hear(graph, settings, "adagio/go_on", asked, |_: foreign::Empty| Request::GoOn)?,
        hear(graph, settings, "adagio/stop", asked, |_: foreign::Empty| Request::Stop)?,
        hear(graph, settings, "adagio/goto", asked, |of: msg::Text| Request::Goto(of.data))?,
        serve(graph, settings, "adagio/pause", "SetBool", asked, |of: Switch| Request::Pause(of.data))?,
        serve(graph, settings, "adagio/go_on", "Trigger", asked, |_: foreign::Empty| Request::GoOn)?,
        serve(graph, settings, "adagio/stop", "Trigger", asked, |_: foreign::Empty| Request::Stop)?,
    ];
    let at = |of: &msg::PoseStamped| [of.pose.position.x, of.pose.position.y];
    ears.push(hear(graph, settings, "goal_pose", asked, move |of| Request::GoalPose(at(&of)))?);
    for (task, of) in scenario.tasks.iter().enumerate().filter(|(_, task)| task.needs_pose() && is_name(&task.name)) {
        let topic = format!("adagio/goal/{}", of.name);
        ears.push(hear(graph, settings, &topic, asked, move |of| Request::MoveGoal(task, at(&of)))?);
    }
    Ok(ears)
}

fn hear<M: Message + Send + 'static>(
    graph: &mut Graph,
    settings: &Ros2,
    topic: &str,
    asked: &Sender<Request>,
    request: impl Fn(M) -> Request + Send + 'static,
) -> Result<Ear, LinkError> {
    let asked = asked.clone();
    let take = move |message: M| {
        // Nobody takes it where the run has ended.
        let _ = asked.send(request(message));
    };
    graph.hear(&settings.topic(topic), reliable_qos(), take, |_| {})
}

fn serve<Q: Call + Clone + Send + 'static>(
    graph: &mut Graph,
    settings: &Ros2,
    service: &str,
    kind: &str,
    asked: &Sender<Request>,
    request: impl Fn(Q) -> Request + Send + 'static,
) -> Result<Ear, LinkError> {
    let server = graph.answer(&settings.topic(service), &ServiceTypeName::new("std_srvs", kind))?;
    let asked = asked.clone();
    Ok(answers(server, move |call| match asked.send(request(call)) {
        Ok(()) => Answer { success: true, message: String::new() },
        Err(_) => Answer { success: false, message: "the run is over".to_owned() },
    }))
}
