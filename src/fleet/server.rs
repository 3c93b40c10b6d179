//! The learner's side of the connection to its robots.

use std::collections::{BTreeMap, VecDeque};
use std::convert::Infallible;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use http_body_util::{BodyExt, Full, Limited};
use hyper::body::{Bytes, Incoming};
use hyper::header::HeaderValue;
use hyper::{Method, Request, Response, StatusCode, Uri};
use serde_json::json;

use super::learner::{Learner, batch_of, update_bytes};
use super::{LOST, STANDING, Standing, Welcome};
use crate::agent::{Batch, CheckpointError, LearnError};
use crate::live::SetWhenDropped;
use crate::live::serve::{self, Guard, ServeError, listen, random_token, refused, response};
use crate::lock::lock;
use crate::scenario::{Mode, Scenario};

/// Most bytes of a batch, and longest time for it.
const MOST_BATCH: usize = 256 << 20;
const BATCH_TIME: Duration = Duration::from_secs(20);
/// Most batches of a robot that wait.
const MOST_WAITING: usize = 16;
/// How long a robot that has joined may take until it drives: its world has to be prepared.
const BEGINS: Duration = Duration::from_secs(120);
/// Time between looks at what has come.
const LOOK: Duration = Duration::from_millis(5);

/// What a robot has done that a person may want to know, or the learner.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Told {
    /// It has begun; so many are there.
    Joined(String, usize),
    /// Nothing was heard of it for [`LOST`]: the others go on without it.
    Lost(String),
    /// It is heard again.
    Back(String),
    /// It has left, after so many frames.
    Left(String, u64),
    /// There is a model: its number, its frames, robots that handed something over, and seconds that it took.
    Model(u32, u64, usize, u64),
    /// What could not be done.
    Warning(String),
}

/// A robot that has joined.
struct Present {
    run: u64,
    heard: Instant,
    /// Whether it drives: it was heard since it has joined.
    begun: bool,
    lost: bool,
    left: bool,
    /// Whether a person was told that it has left.
    said: bool,
    waiting: VecDeque<(u64, Batch)>,
    /// The first frame that it has not handed over, that no model knows, and that is not saved.
    next: u64,
    learned: u64,
    saved: u64,
}

impl Present {
    fn new(run: u64, next: u64) -> Self {
        let (waiting, heard) = (VecDeque::new(), Instant::now());
        Present {
            run,
            heard,
            begun: false,
            lost: false,
            left: false,
            said: false,
            waiting,
            next,
            learned: next,
            saved: next,
        }
    }

    fn is_there(&self) -> bool {
        !self.left && self.heard.elapsed() < if self.begun { LOST } else { BEGINS }
    }
}

/// What the threads share.
struct Hub {
    guard: Guard,
    scenario: Arc<Scenario>,
    welcome: Bytes,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    robots: BTreeMap<String, Present>,
    /// Robots that have begun a run since the learner looked.
    begun: Vec<(String, u64)>,
    epoch: u32,
    model: Bytes,
}

impl Hub {
    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

/// An address at which robots find a learner.
pub struct Server(serve::Server);

impl Server {
    /// Take an address. Robots need the token that is given, or a random one.
    ///
    /// # Errors
    /// See [`ServeError`].
    pub fn new(address: SocketAddr, token: Option<String>) -> Result<Self, ServeError> {
        serve::Server::new(address, Some(token.unwrap_or_else(random_token))).map(Server)
    }

    /// Where robots find it.
    pub fn address(&self) -> SocketAddr {
        self.0.address
    }

    /// What robots must know.
    pub fn token(&self) -> &str {
        self.0.guard.token().unwrap_or_default()
    }

    /// Learn from robots until all of at least `robots` have left, or it is stopped. What there is is saved at `path` now and then, and
    /// at the end; `tell` hears what happens, with each model that there is.
    ///
    /// # Errors
    /// Frames cannot be learned from.
    pub fn learn(
        &self,
        learner: &mut Learner,
        scenario: &Arc<Scenario>,
        (robots, path): (usize, &Path),
        stop: &AtomicBool,
        tell: &mut dyn FnMut(&Learner, Told),
    ) -> Result<(), LearnError> {
        let welcome = Welcome { version: env!("CARGO_PKG_VERSION").to_owned(), scenario: scenario.text.clone() };
        let welcome = serde_json::to_vec(&welcome).map(Bytes::from).unwrap_or_default();
        let hub = Arc::new(Hub {
            guard: self.0.guard.clone(),
            scenario: scenario.clone(),
            welcome,
            state: Mutex::new(State::default()),
        });
        for (name, robot) in learner.robots() {
            // It drives, or is gone.
            let present = Present { begun: true, ..Present::new(robot.run, robot.next) };
            hub.state().robots.insert(name.clone(), present);
        }
        let mut rounds = Rounds { hub: &hub, scenario, path, robots, saved: Instant::now() };
        rounds.publish(learner, tell);
        let over = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let hub = hub.clone();
                let answer = move |request| answer(request, hub.clone());
                if let Err(cause) = listen(&self.0.listener, || over.load(Ordering::Relaxed), answer) {
                    eprintln!("warning: robots cannot reach {} any more: {cause}", self.0.address);
                }
            });
            let _over = SetWhenDropped(&over);
            while !stop.load(Ordering::Relaxed) && !rounds.step(learner, tell)? {
                std::thread::sleep(LOOK);
            }
            // What has come is learned from, though nobody asks any more.
            rounds.take(learner, tell)?;
            rounds.save(learner, tell);
            Ok(())
        })
    }
}

/// The learner's turns.
struct Rounds<'a> {
    hub: &'a Hub,
    scenario: &'a Scenario,
    path: &'a Path,
    robots: usize,
    saved: Instant,
}

impl Rounds<'_> {
    /// Look at what has come, and make a model if it is time. Whether all have left.
    fn step(&mut self, learner: &mut Learner, tell: &mut dyn FnMut(&Learner, Told)) -> Result<bool, LearnError> {
        let mut told = Vec::new();
        let (ready, ended) = {
            let mut state = self.hub.state();
            for (name, run) in std::mem::take(&mut state.begun) {
                learner.begin(&name, run);
                told.push(Told::Joined(name, state.robots.values().filter(|robot| robot.is_there()).count()));
            }
            for (name, robot) in &mut state.robots {
                if robot.left && !robot.said {
                    robot.said = true;
                    told.push(Told::Left(name.clone(), robot.next));
                }
                if !robot.left && robot.lost == robot.is_there() {
                    robot.lost = !robot.lost;
                    told.push(if robot.lost { Told::Lost(name.clone()) } else { Told::Back(name.clone()) });
                }
            }
            let enough = state.robots.len() >= self.robots;
            let waits = |robot: &Present| !robot.waiting.is_empty();
            let all = || state.robots.values().filter(|robot| robot.is_there()).all(waits);
            let ready =
                enough && state.robots.values().any(waits) && (self.scenario.agent.mode == Mode::Realtime || all());
            let ended = enough && state.robots.values().all(|robot| robot.left && !waits(robot));
            (ready, ended)
        };
        told.into_iter().for_each(|told| tell(learner, told));
        if ready {
            self.take(learner, tell)?;
        }
        Ok(ended)
    }

    /// Learn from everything that waits, and make a model of it.
    fn take(&mut self, learner: &mut Learner, tell: &mut dyn FnMut(&Learner, Told)) -> Result<(), LearnError> {
        let begin = Instant::now();
        let mut waiting: Vec<(String, VecDeque<(u64, Batch)>)> = Vec::new();
        for (name, robot) in &mut self.hub.state().robots {
            // One that has begun just now waits for the next round: the learner does not know it yet.
            if learner.robots().get(name).is_some_and(|known| known.run == robot.run) {
                waiting.push((name.clone(), std::mem::take(&mut robot.waiting)));
            }
        }
        waiting.retain(|(_, batches)| !batches.is_empty());
        if waiting.is_empty() {
            return Ok(());
        }
        let count = waiting.len();
        for (name, batches) in waiting {
            for (run, batch) in batches {
                // It may have begun again meanwhile.
                if learner.robots().get(&name).is_some_and(|robot| robot.run == run) {
                    learner.take(&name, batch)?;
                }
            }
        }
        learner.model()?;
        if self.scenario.agent.snapshot_every().is_some_and(|every| self.saved.elapsed() >= every) {
            self.save(learner, tell);
        }
        self.publish(learner, tell);
        let made = learner.update.as_ref().and_then(|update| update.learned.as_ref().ok());
        if let Some((epoch, frames)) = made.map(|learned| (learned.epoch, learned.frames)) {
            tell(learner, Told::Model(epoch, frames, count, begin.elapsed().as_secs()));
        }
        Ok(())
    }

    /// Let robots have the newest model.
    fn publish(&self, learner: &Learner, tell: &mut dyn FnMut(&Learner, Told)) {
        let Some(update) = &learner.update else { return };
        match update_bytes(update, self.scenario) {
            Ok(bytes) => {
                let mut state = self.hub.state();
                (state.model, state.epoch) = (bytes.into(), update.learned.as_ref().map_or(state.epoch, |of| of.epoch));
                for (name, robot) in learner.robots() {
                    if let Some(present) = state.robots.get_mut(name).filter(|present| present.run == robot.run) {
                        present.learned = robot.next;
                    }
                }
            }
            Err(cause) => tell(learner, Told::Warning(format!("a model cannot be sent: {cause}"))),
        }
    }

    fn save(&mut self, learner: &mut Learner, tell: &mut dyn FnMut(&Learner, Told)) {
        self.saved = Instant::now();
        match learner.save(self.path) {
            Ok(()) => {
                let mut state = self.hub.state();
                for (name, robot) in learner.robots() {
                    if let Some(present) = state.robots.get_mut(name).filter(|present| present.run == robot.run) {
                        present.saved = robot.next;
                    }
                }
            }
            Err(cause) => tell(learner, Told::Warning(format!("what was learned is not saved: {cause}"))),
        }
    }
}

type Answer = Response<Full<Bytes>>;

/// Answer a robot. It never fails; the error is what hyper wants to hear.
async fn answer(request: Request<Incoming>, hub: Arc<Hub>) -> Result<Answer, Infallible> {
    let (parts, body) = request.into_parts();
    if let Err((status, text)) = hub.guard.admit(&parts.method, &parts.uri, &parts.headers) {
        return Ok(refused(status, text));
    }
    let who = || {
        let number = |name: &str| query(&parts.uri, name)?.parse::<u64>().ok();
        Some((query(&parts.uri, "name")?.to_owned(), number("run")?, number("frame")))
    };
    let answered = match (&parts.method, parts.uri.path()) {
        (&Method::GET, "/") => Ok(json_response(&status(&hub))),
        (&Method::GET, "/welcome") => Ok(response(StatusCode::OK, "application/json", hub.welcome.clone())),
        (&Method::PUT, "/robot" | "/batch" | "/beat" | "/leave") | (&Method::GET, "/model") => match who() {
            None => Err((StatusCode::BAD_REQUEST, "name and run of a robot are expected".to_owned())),
            Some((name, run, _)) if parts.uri.path() == "/robot" => join(&hub, name, run),
            Some((name, run, frame)) => {
                let batch = match parts.uri.path() {
                    "/batch" => read(body, &hub).await.map(Some),
                    _ => Ok(None),
                };
                batch.and_then(|batch| heard(&hub, parts.uri.path(), (&name, run, frame), batch))
            }
        },
        _ => Err((StatusCode::NOT_FOUND, "there is nothing of this name".to_owned())),
    };
    Ok(answered.unwrap_or_else(|(status, text)| refused(status, &text)))
}

/// A value from the query of an address; those of robots need no escapes.
fn query<'a>(uri: &'a Uri, name: &str) -> Option<&'a str> {
    uri.query()?
        .split('&')
        .find_map(|pair| pair.split_once('=').filter(|(key, _)| *key == name))
        .map(|(_, value)| value)
}

fn json_response(value: &serde_json::Value) -> Answer {
    response(StatusCode::OK, "application/json", value.to_string().into())
}

/// What a person may want to see.
fn status(hub: &Hub) -> serde_json::Value {
    let state = hub.state();
    let robots = state.robots.iter().map(|(name, robot)| {
        json!({
            "name": name, "frames_handed_over": robot.next, "frames_learned": robot.learned, "frames_saved": robot.saved,
            "seconds_since_heard": robot.heard.elapsed().as_secs_f64(), "left": robot.left, "lost": robot.lost,
        })
    });
    json!({ "scenario": hub.scenario.name, "epoch": state.epoch, "robots": robots.collect::<Vec<_>>() })
}

type Refused = (StatusCode, String);

/// A robot begins, or comes back.
fn join(hub: &Hub, name: String, run: u64) -> Result<Answer, Refused> {
    let mut state = hub.state();
    let here = state.robots.get(&name);
    if here.is_some_and(|robot| robot.run != run && robot.is_there()) {
        return Err((
            StatusCode::CONFLICT,
            format!("there is another robot {name} in the fleet: seed or name must differ"),
        ));
    }
    if here.is_none_or(|robot| robot.run != run) {
        state.robots.insert(name.clone(), Present::new(run, 0));
        state.begun.push((name.clone(), run));
    }
    Ok(json_response(&json!({ "robot": name })))
}

/// A robot is heard: it hands something over, asks for a model, or leaves.
fn heard(
    hub: &Hub,
    path: &str,
    (name, run, frame): (&str, u64, Option<u64>),
    batch: Option<Batch>,
) -> Result<Answer, Refused> {
    let mut state = hub.state();
    let State { robots, model, .. } = &mut *state;
    let Some(robot) = robots.get_mut(name).filter(|robot| robot.run == run) else {
        return Err((StatusCode::NOT_FOUND, format!("the robot {name} has not joined")));
    };
    (robot.heard, robot.begun, robot.left) = (Instant::now(), true, path == "/leave");
    if let Some((_, last)) = batch.as_ref().and_then(Batch::span).filter(|(_, last)| *last >= robot.next) {
        if robot.waiting.len() >= MOST_WAITING {
            return Err((StatusCode::SERVICE_UNAVAILABLE, "too much of this robot waits already".to_owned()));
        }
        robot.next = last + 1;
        robot.waiting.extend(batch.map(|batch| (run, batch)));
    }
    let standing = Standing { next: robot.next, saved: robot.saved };
    // One that knows this frame; or the newest, for who has just come.
    let has_model = !model.is_empty() && frame.is_none_or(|frame| robot.learned > frame);
    let mut answer = match path == "/model" && has_model {
        true => response(StatusCode::OK, "application/octet-stream", model.clone()),
        false => response(StatusCode::NO_CONTENT, "application/json", Bytes::new()),
    };
    if let Some(text) = serde_json::to_string(&standing).ok().and_then(|text| HeaderValue::from_str(&text).ok()) {
        answer.headers_mut().insert(STANDING, text);
    }
    Ok(answer)
}

/// A batch, if it is not too long and comes soon enough.
async fn read(body: Incoming, hub: &Hub) -> Result<Batch, Refused> {
    let body = tokio::time::timeout(BATCH_TIME, Limited::new(body, MOST_BATCH).collect()).await;
    let body = body.map_err(|_| (StatusCode::REQUEST_TIMEOUT, "the batch took too long".to_owned()))?;
    let too_long = |_| (StatusCode::PAYLOAD_TOO_LARGE, format!("a batch has at most {MOST_BATCH} bytes"));
    let body = body.map_err(too_long)?.to_bytes();
    batch_of(&body, &hub.scenario).map_err(|cause: CheckpointError| (StatusCode::BAD_REQUEST, cause.to_string()))
}
