//! A robot's side of the connection to the learner.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use http_body_util::{BodyExt, Full};
use hyper::body::Bytes;
use hyper::client::conn::http1;
use hyper::header::{AUTHORIZATION, HOST};
use hyper::{Method, Request, StatusCode};
use hyper_util::rt::TokioIo;
use thiserror::Error;
use tokio::net::TcpStream;
use tokio::runtime::Runtime;
use tokio::time::timeout;

use super::learner::{batch_bytes, update_of};
use super::{LOST, STANDING, Standing, Unlike, Welcome, in_common};
use crate::agent::{Batch, Fleet, Update};
use crate::scenario::Scenario;

/// Longest time for the body of an answer: models have some megabytes.
const BODY_TIME: Duration = Duration::from_secs(60);
/// Time between questions for a model.
const ASK: Duration = Duration::from_millis(50);
/// Most bytes that wait for a learner that does not answer.
const MOST_BACKLOG: usize = 256 << 20;

/// A robot cannot join.
#[derive(Debug, Error)]
pub enum FleetError {
    /// Nobody answers, or something else than a learner.
    #[error("there is no learner at {address}: {cause}")]
    NotReached {
        /// The address.
        address: SocketAddr,
        /// Why.
        cause: String,
    },
    /// The learner does not want it.
    #[error("the learner at {address} refuses this robot: {cause}")]
    Refused {
        /// The address.
        address: SocketAddr,
        /// What it says.
        cause: String,
    },
    /// It learns something else.
    #[error(transparent)]
    Unlike(#[from] Unlike),
}

/// A batch that the learner has not saved yet.
struct Waiting {
    first: u64,
    last: u64,
    bytes: Bytes,
}

/// A connection to a learner.
pub struct Connection {
    address: SocketAddr,
    token: String,
    /// Of this robot, and which run of it.
    name: String,
    run: u64,
    /// The learner's scenario.
    scenario: Arc<Scenario>,
    runtime: Runtime,
    backlog: VecDeque<Waiting>,
    standing: Standing,
    /// Why nobody answered, when it was asked last.
    lost: Option<String>,
    /// What a person should know.
    notes: Vec<String>,
}

/// What came of a request.
type Reply = Result<(StatusCode, Option<Standing>, Bytes), String>;

impl Connection {
    /// Join the learner at an address.
    ///
    /// # Errors
    /// See [`FleetError`].
    pub fn join(address: SocketAddr, token: String, robot: &Scenario) -> Result<Self, FleetError> {
        let not_reached = |cause: String| FleetError::NotReached { address, cause };
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
        let runtime = runtime.map_err(|error| not_reached(error.to_string()))?;
        let plain = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' };
        let name = format!("{}-seed{}", robot.name, robot.seed).chars().map(plain).collect();
        let mut connection = Connection {
            address,
            token,
            name,
            run: rand::random(),
            scenario: Arc::new(robot.clone()),
            runtime,
            backlog: VecDeque::new(),
            standing: Standing::default(),
            lost: None,
            notes: Vec::new(),
        };
        let refused = |cause: String| FleetError::Refused { address, cause };
        let accepted = |(status, _, body): (StatusCode, _, Bytes)| match status {
            StatusCode::OK => Ok(body),
            _ => Err(refused(said(status, &body))),
        };
        let body = accepted(connection.ask(Method::GET, "/welcome", Bytes::new()).map_err(not_reached)?)?;
        let welcome: Welcome =
            serde_json::from_slice(&body).map_err(|_| not_reached("something else answers there".to_owned()))?;
        let version = env!("CARGO_PKG_VERSION");
        if welcome.version != version {
            return Err(refused(format!("it is version {}, this is {version}", welcome.version)));
        }
        let theirs = Scenario::parse(&welcome.scenario, "the learner's scenario".as_ref(), &[]);
        connection.scenario = Arc::new(theirs.map_err(|error| refused(error.to_string()))?);
        in_common(robot, &connection.scenario)?;
        let path = connection.path("/robot");
        accepted(connection.ask(Method::PUT, &path, Bytes::new()).map_err(not_reached)?)?;
        Ok(connection)
    }

    /// What this robot is called there.
    pub fn name(&self) -> &str {
        &self.name
    }

    fn path(&self, path: &str) -> String {
        format!("{path}?name={}&run={}", self.name, self.run)
    }

    /// One request; nobody waits longer than [`LOST`] for the beginning of an answer.
    fn ask(&self, method: Method, path: &str, body: Bytes) -> Reply {
        let request = async {
            let stream = TcpStream::connect(self.address).await.map_err(|error| error.to_string())?;
            let (mut sender, connection) =
                http1::handshake(TokioIo::new(stream)).await.map_err(|error| error.to_string())?;
            tokio::spawn(connection);
            let request = Request::builder()
                .method(method)
                .uri(path)
                .header(HOST, self.address.to_string())
                .header(AUTHORIZATION, format!("Bearer {}", self.token))
                .body(Full::new(body))
                .map_err(|error| error.to_string())?;
            sender.send_request(request).await.map_err(|error| error.to_string())
        };
        self.runtime.block_on(async {
            let late = |limit: Duration| format!("no answer within {} s", limit.as_secs());
            let answer = timeout(LOST, request).await.map_err(|_| late(LOST))??;
            let (status, standing) = (answer.status(), answer.headers().get(STANDING));
            let standing = standing.and_then(|text| serde_json::from_slice(text.as_bytes()).ok());
            let body = timeout(BODY_TIME, answer.into_body().collect()).await.map_err(|_| late(BODY_TIME))?;
            Ok((status, standing, body.map_err(|error| error.to_string())?.to_bytes()))
        })
    }

    /// One request in the name of this robot, which joins again if the learner has forgotten it.
    fn ask_as_robot(&mut self, method: &Method, path: &str, body: &Bytes) -> Reply {
        let reply = self.ask(method.clone(), path, body.clone())?;
        let reply = match reply.0 {
            StatusCode::NOT_FOUND => {
                let (status, _, said_by) = self.ask(Method::PUT, &self.path("/robot"), Bytes::new())?;
                if status != StatusCode::OK {
                    return Err(said(status, &said_by));
                }
                self.ask(method.clone(), path, body.clone())?
            }
            _ => reply,
        };
        match (reply.0, reply.1) {
            (StatusCode::OK | StatusCode::NO_CONTENT, Some(standing)) => {
                self.standing = standing;
                self.backlog.retain(|waiting| waiting.last >= standing.saved);
                Ok(reply)
            }
            (StatusCode::SERVICE_UNAVAILABLE, _) => Ok(reply),
            (status, _) => Err(said(status, &reply.2)),
        }
    }

    /// Hand over what the learner lacks, as far as it has room: whether that is all, or why it is not.
    fn hand_over(&mut self) -> Result<bool, String> {
        let (beat, path) = (self.path("/beat"), self.path("/batch"));
        self.ask_as_robot(&Method::PUT, &beat, &Bytes::new())?;
        loop {
            let next = self.standing.next;
            let Some(waiting) = self.backlog.iter().find(|waiting| waiting.last >= next) else { return Ok(true) };
            let bytes = waiting.bytes.clone();
            self.ask_as_robot(&Method::PUT, &path, &bytes)?;
            if self.standing.next <= next {
                return Ok(false);
            }
        }
    }

    /// A model that knows a frame; nothing as long as there is none.
    fn model(&mut self, path: &str, asked_at: u64) -> Result<Option<Update>, String> {
        let (status, _, body) = self.ask_as_robot(&Method::GET, path, &Bytes::new())?;
        if status != StatusCode::OK {
            return Ok(None);
        }
        update_of(&body, asked_at, &self.scenario).map(Some).map_err(|error| error.to_string())
    }

    /// Take note of whether the learner answers.
    fn note(&mut self, lost: Option<String>) {
        match (&self.lost, &lost) {
            (None, Some(cause)) => self.notes.push(format!(
                "the fleet's learner at {} does not answer ({cause}): the robot goes on with the model it has",
                self.address
            )),
            (Some(_), None) => self.notes.push(format!("the fleet's learner at {} answers again", self.address)),
            _ => {}
        }
        self.lost = lost;
    }

    fn keep(&mut self, batch: Batch) {
        let Some((first, last)) = batch.span() else { return };
        match batch_bytes(batch, &self.scenario) {
            Ok(bytes) => self.backlog.push_back(Waiting { first, last, bytes: bytes.into() }),
            Err(cause) => self.notes.push(format!("frames {first} to {last} cannot be handed over: {cause}")),
        }
        while self.backlog.iter().map(|waiting| waiting.bytes.len()).sum::<usize>() > MOST_BACKLOG {
            if let Some(Waiting { first, last, .. }) =
                self.backlog.pop_front().filter(|of| of.last >= self.standing.next)
            {
                self.notes.push(format!(
                    "frames {first} to {last} are not handed over: too many wait for the fleet's learner; they are in the log"
                ));
            }
        }
    }
}

/// What an answer says that is no success.
fn said(status: StatusCode, body: &[u8]) -> String {
    let text = serde_json::from_slice::<serde_json::Value>(body).ok();
    text.and_then(|text| Some(text.get("error")?.as_str()?.to_owned())).unwrap_or_else(|| status.to_string())
}

impl Fleet for Connection {
    fn newest(&mut self) -> Option<Update> {
        let path = self.path("/model");
        self.model(&path, 0).ok().flatten().filter(|update| update.learned.is_ok())
    }

    fn learn(&mut self, batch: Batch, stop: &AtomicBool) -> Update {
        let asked_at = batch.span().map_or(0, |(_, last)| last);
        self.keep(batch);
        let path = format!("{}&frame={asked_at}", self.path("/model"));
        let learned = loop {
            let answered = self.hand_over().and_then(|_| self.model(&path, asked_at));
            self.note(answered.as_ref().err().cloned());
            match answered {
                Ok(Some(update)) => break Ok(update),
                Ok(None) if stop.load(Ordering::Relaxed) => break Err("the run is being stopped".to_owned()),
                Ok(None) => std::thread::sleep(ASK),
                Err(cause) => break Err(format!("the fleet's learner does not answer: {cause}")),
            }
        };
        let notes = std::mem::take(&mut self.notes);
        match learned {
            Ok(update) => Update { notes: [update.notes, notes].concat(), ..update },
            Err(reason) => Update { asked_at, learned: Err(reason), fits: Vec::new(), transitions: 0, notes },
        }
    }

    fn beat(&mut self) {
        let answered = self.hand_over();
        self.note(answered.err());
    }

    fn leave(&mut self) -> Option<String> {
        let cause = loop {
            match self.hand_over() {
                Ok(true) => break None,
                Ok(false) => std::thread::sleep(ASK),
                Err(cause) => break Some(cause),
            }
        };
        let path = self.path("/leave");
        // A learner that does not hear it notices that nothing comes.
        let _ = self.ask_as_robot(&Method::PUT, &path, &Bytes::new());
        // What it has and has not saved may be lost with it.
        let (cause, first, last) = (cause?, self.backlog.front()?.first, self.backlog.back()?.last);
        Some(format!(
            "frames {first} to {last} were not handed over to the fleet's learner at {}, or it has not saved them: {cause}; `adagio \
             learn` takes them from the log",
            self.address
        ))
    }
}
