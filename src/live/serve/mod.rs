//! A local web page of a run that goes on in this process.
//!
//! ```text
//!  follower thread: log ──▶ view ──▶ published bytes ◀── server thread: all clients
//!                                                              └─ pause, goal, mark, stop ──▶ controls of the run
//! ```
//!
//! Both threads belong to the page alone, and end with the run. A request only copies what is published already, so that
//! however many clients there are, and however slowly they read, nobody waits for them: not the follower, and least of all
//! the stream. Clients that take too long are dropped.

mod address;
mod answer;
mod guard;
mod page;

use std::convert::Infallible;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::pin::pin;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Request, Response};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde::Serialize;
use thiserror::Error;
use tokio::sync::Semaphore;

pub use address::{AddressError, parse_address};
pub(crate) use answer::{refused, response};
pub(crate) use guard::random_token;
pub use guard::{Guard, TokenError};

use super::SetWhenDropped;
use super::view::{View, Watcher};
use crate::agent::Controls;
use crate::lock::lock;
use crate::scenario::{Plan, Scenario};
use crate::source::GoalMove;
use crate::world::World;
use page::Page;

/// Time between two views.
const TICK: Duration = Duration::from_millis(200);

/// Longest time that the log is read at a time.
const READ: Duration = Duration::from_millis(150);

/// Nothing is drawn for nobody: how long a client counts as present after it has asked.
const PRESENT: Duration = Duration::from_secs(10);

/// How long the end of a run is shown to clients that are present.
const LINGER: Duration = Duration::from_millis(1500);

/// Connections at a time.
const MOST_CONNECTIONS: usize = 32;

/// Longest time for the head of a request, and longest life of a connection: then it is closed behind an answer, and a little
/// later in any case.
const HEAD_TIME: Duration = Duration::from_secs(5);
const LIFE: Duration = Duration::from_secs(30);
const GRACE: Duration = Duration::from_secs(5);

/// Most bytes of a request's head.
const HEAD_BYTES: usize = 16 << 10;

/// Time between looks at whether the run is over.
const LOOK: Duration = Duration::from_millis(20);

/// Why there is no page.
#[derive(Debug, Error)]
pub enum ServeError {
    /// The address cannot be used.
    #[error("cannot serve a page at {address}: {cause}")]
    Bind {
        /// The address.
        address: SocketAddr,
        /// What the operating system says.
        cause: io::Error,
    },
    /// The token cannot be used.
    #[error(transparent)]
    Token(#[from] TokenError),
}

/// An address at which a page is going to be.
#[derive(Debug)]
pub struct Server {
    pub(crate) listener: TcpListener,
    pub(crate) address: SocketAddr,
    pub(crate) guard: Guard,
}

/// The run that a page is of.
pub struct ServedRun<'a> {
    /// Its folder.
    pub run: &'a Path,
    /// Its scenario.
    pub scenario: &'a Scenario,
    /// Its world.
    pub world: &'a World,
    /// What is asked of it.
    pub controls: &'a Arc<Controls>,
    /// Set to end it cleanly.
    pub stop: &'a AtomicBool,
}

/// What clients get; bytes that are copied, not made, for each of them.
#[derive(Debug, Default)]
struct Published {
    /// Grows with each view.
    version: u64,
    now: Bytes,
    curves: Bytes,
    maps: Bytes,
    /// The model that `maps` is of.
    epoch: u32,
}

/// What the threads of a page share.
struct Shared {
    guard: Guard,
    page: Page,
    published: Mutex<Published>,
    controls: Arc<Controls>,
    scenario: Scenario,
    plan: Arc<Plan>,
    /// A client wants the run to end.
    stop: AtomicBool,
    /// When a client asked last.
    asked: Mutex<Option<Instant>>,
}

impl Shared {
    fn published(&self) -> MutexGuard<'_, Published> {
        lock(&self.published)
    }

    fn is_asked(&self) -> bool {
        let asked = *lock(&self.asked);
        asked.is_some_and(|asked| asked.elapsed() < PRESENT)
    }

    fn ask(&self) {
        *lock(&self.asked) = Some(Instant::now());
    }
}

impl Server {
    /// Take an address. One that is not loopback needs a token: the one that is given, or a random one.
    ///
    /// # Errors
    /// See [`ServeError`].
    pub fn new(address: SocketAddr, token: Option<String>) -> Result<Self, ServeError> {
        let guard = Guard::new(address.ip(), token)?;
        let failed = |cause| ServeError::Bind { address, cause };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok(Server { listener, address, guard })
    }

    /// Where a person finds the page.
    pub fn url(&self) -> String {
        let query = self.guard.token().map_or(String::new(), |token| format!("?token={token}"));
        format!("http://{}/{query}", self.address)
    }

    /// What a person should know of it beside that.
    pub fn warning(&self) -> Option<String> {
        let address = self.address.ip();
        let open = !address.is_loopback();
        open.then(|| format!("{address} can be reached from other machines, and what is sent is not encrypted"))
    }

    /// Serve the page of a run while some work is done: the run.
    pub fn beside<R>(&self, stage: &ServedRun<'_>, work: impl FnOnce() -> R) -> R {
        let shared = Arc::new(Shared {
            guard: self.guard.clone(),
            page: Page::new(),
            published: Mutex::default(),
            controls: stage.controls.clone(),
            scenario: stage.scenario.clone(),
            plan: stage.world.plan.clone(),
            stop: AtomicBool::new(false),
            asked: Mutex::default(),
        });
        let (over, gone) = (AtomicBool::new(false), AtomicBool::new(false));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                // Also if it panics: the server must not wait for it.
                let _gone = SetWhenDropped(&gone);
                follow(stage.run, &shared, &over);
            });
            scope.spawn(|| {
                if let Err(cause) = self.listen(&shared, stage.stop, &gone) {
                    eprintln!("warning: the page at {} is gone: {cause}", self.address);
                }
            });
            // Also if the run panics: this scope ends with these threads.
            let _over = SetWhenDropped(&over);
            work()
        })
    }

    /// The server thread: all clients, until the run is over.
    fn listen(&self, shared: &Arc<Shared>, stop: &AtomicBool, gone: &AtomicBool) -> io::Result<()> {
        let over = || {
            if shared.stop.swap(false, Ordering::Relaxed) && !stop.swap(true, Ordering::Relaxed) {
                eprintln!("finishing: somebody has stopped the run on its page");
            }
            gone.load(Ordering::Relaxed)
        };
        let shared = shared.clone();
        listen(&self.listener, over, move |request| answer::answer(request, shared.clone()))
    }
}

/// Answer all clients of a listener that does not block, until it is over. Connections end with it.
///
/// # Errors
/// The operating system refuses.
pub(crate) fn listen<A, F>(listener: &TcpListener, over: impl Fn() -> bool, answer: A) -> io::Result<()>
where
    A: Fn(Request<Incoming>) -> F + Clone + Send + 'static,
    F: Future<Output = Result<Response<Full<Bytes>>, Infallible>> + Send + 'static,
{
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let listener = listener.try_clone()?;
    runtime.block_on(async {
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let room = Arc::new(Semaphore::new(MOST_CONNECTIONS));
        while !over() {
            let Ok(accepted) = tokio::time::timeout(LOOK, listener.accept()).await else { continue };
            // Too many files are open, or a client was gone at once: later ones may have more luck.
            let Ok((stream, _)) = accepted else {
                tokio::time::sleep(LOOK).await;
                continue;
            };
            let Ok(permit) = room.clone().try_acquire_owned() else { continue };
            let answer = answer.clone();
            tokio::spawn(async move {
                converse(stream, answer).await;
                drop(permit);
            });
        }
        Ok(())
    })
}

/// One connection, as long as it may live.
async fn converse<A, F>(stream: tokio::net::TcpStream, answer: A)
where
    A: Fn(Request<Incoming>) -> F,
    F: Future<Output = Result<Response<Full<Bytes>>, Infallible>>,
{
    let mut http = http1::Builder::new();
    http.timer(TokioTimer::new()).header_read_timeout(HEAD_TIME).max_buf_size(HEAD_BYTES);
    let mut connection = pin!(http.serve_connection(TokioIo::new(stream), service_fn(answer)));
    // What goes wrong with a client is its own affair.
    if tokio::time::timeout(LIFE, connection.as_mut()).await.is_err() {
        connection.as_mut().graceful_shutdown();
        let _ = tokio::time::timeout(GRACE, connection).await;
    }
}

/// The follower thread: reads the log, and publishes a view now and then while somebody looks.
fn follow(run: &Path, shared: &Shared, over: &AtomicBool) {
    let mut watcher = Watcher::new(run);
    let mut last = 0;
    loop {
        let begin = Instant::now();
        let ends = over.load(Ordering::Relaxed);
        let news = watcher.read_on(READ);
        if let Err(error) = &news {
            eprintln!("warning: the page of the run stays as it is: {error}");
        }
        if shared.is_asked() || last == 0 {
            last += 1;
            publish(&mut watcher, shared, last);
        }
        if ends || news.is_err() {
            break;
        }
        while begin.elapsed() < TICK && !over.load(Ordering::Relaxed) {
            std::thread::sleep(LOOK);
        }
    }
    // Those who look are to see how it ended.
    let begin = Instant::now();
    while shared.is_asked() && begin.elapsed() < LINGER {
        std::thread::sleep(LOOK);
    }
}

/// What `/now` says.
#[derive(Serialize)]
struct Now<'a> {
    version: u64,
    #[serde(flatten)]
    view: &'a View,
    /// The model that `/maps` is of.
    maps: u32,
    /// A pause is wanted, though an action may still be under way.
    pausing: bool,
    /// Moves of goals that the run has not taken yet.
    moves: Vec<serde_json::Value>,
    /// Name of what is being marked.
    marking: Option<&'a str>,
}

fn publish(watcher: &mut Watcher, shared: &Shared, version: u64) {
    let view = watcher.view(Some(&shared.controls));
    let moved = |GoalMove { task, goal: [x, y] }: GoalMove| serde_json::json!({ "task": task, "x": x, "y": y });
    let epoch = view.maps.as_ref().map_or(0, |maps| maps.epoch);
    let now = Now {
        version,
        view: &view,
        maps: epoch,
        pausing: shared.controls.is_paused(),
        marking: shared.controls.marking().and_then(|task| shared.scenario.names().nth(task)),
        moves: shared.controls.waiting_moves().into_iter().map(moved).collect(),
    };
    let old = shared.published().epoch;
    let maps = (epoch != old).then(|| bytes(&view.maps.as_deref()));
    let (now, curves) = (bytes(&now), bytes(&view.curves));
    let mut published = shared.published();
    (published.version, published.now, published.curves) = (version, now, curves);
    if let Some(maps) = maps {
        (published.maps, published.epoch) = (maps, epoch);
    }
}

/// A value as JSON. None of ours can fail: their keys are texts.
fn bytes(value: &impl Serialize) -> Bytes {
    serde_json::to_vec(value).map(Bytes::from).unwrap_or_default()
}
