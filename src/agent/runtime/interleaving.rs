//! Actors that take turns: only one of them runs at a time, and a seeded generator says which.
//!
//! The threads of a run wait for each other in their queues alone, so every order in which they can do things is an order of
//! queue operations. Here each operation is a point where another actor may go first. A seed gives the same order every time,
//! on every machine: what goes wrong once can be looked at again.

use std::cell::Cell;
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::Thread;
use std::time::Duration;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::lock::lock;

/// What an actor is up to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ActorState {
    /// It can go on.
    Ready,
    /// It waits for a queue, and nothing has happened in any since it looked.
    Waiting,
    /// It has ended.
    Gone,
}

struct Actor {
    name: &'static str,
    thread: Option<Thread>,
    doing: ActorState,
    /// How often it comes: some are slow.
    weight: u32,
}

struct State {
    random: ChaCha8Rng,
    actors: Vec<Actor>,
    turn: Option<usize>,
    begun: bool,
    deadlock: Option<String>,
}

/// Whose turn it is.
pub struct Interleaving {
    state: Mutex<State>,
}

thread_local! {
    /// The actor that runs on this thread.
    static ME: Cell<Option<usize>> = const { Cell::new(None) };
}

/// How often actors come, each drawn for every order.
#[cfg(test)]
const WEIGHTS: [u32; 4] = [100, 100, 10, 1];

/// The actor that only ends when the threads outside do.
const LAST: &str = "log";

/// Time between looks of a thread that is no actor.
const LOOK: Duration = Duration::from_micros(50);

impl Interleaving {
    /// Interleaving in the order of a seed.
    #[cfg(test)]
    pub fn new(random: ChaCha8Rng) -> Arc<Self> {
        let state = State { random, actors: Vec::new(), turn: None, begun: false, deadlock: None };
        Arc::new(Interleaving { state: Mutex::new(state) })
    }

    /// A new actor, before its thread is started.
    pub fn add(&self, name: &'static str) -> usize {
        let mut state = self.lock();
        #[cfg(test)]
        let weight = WEIGHTS[state.random.random_range(0..WEIGHTS.len())];
        #[cfg(not(test))]
        let weight = 1;
        state.actors.push(Actor { name, thread: None, doing: ActorState::Ready, weight });
        state.actors.len() - 1
    }

    /// In an actor's thread: wait for its first turn. It is gone when the result is dropped.
    pub fn enter(self: &Arc<Self>, me: usize) -> ActorGuard {
        ME.set(Some(me));
        self.lock().actors[me].thread = Some(std::thread::current());
        let entered = ActorGuard(self.clone());
        self.wait(me);
        entered
    }

    /// All actors are there: begin.
    pub fn begin(&self) {
        let mut state = self.lock();
        state.begun = true;
        state.hand_over();
    }

    /// Try until it succeeds, with others before and in between.
    pub fn attempt<R>(&self, mut operation: impl FnMut() -> Option<R>) -> R {
        let Some(me) = ME.get() else {
            // A thread outside waits in its own time.
            loop {
                if let Some(done) = operation() {
                    self.notify();
                    return done;
                }
                std::thread::sleep(LOOK);
            }
        };
        self.pause();
        loop {
            if let Some(done) = operation() {
                self.notify();
                return done;
            }
            {
                let mut state = self.lock();
                state.actors[me].doing = ActorState::Waiting;
                state.turn = None;
                state.hand_over();
            }
            self.wait(me);
        }
    }

    /// A point where others may go first.
    pub fn pause(&self) {
        let Some(me) = ME.get() else { return };
        {
            let mut state = self.lock();
            state.turn = None;
            state.hand_over();
        }
        self.wait(me);
    }

    /// Something has happened: whoever waits may look again.
    pub fn notify(&self) {
        let mut state = self.lock();
        state
            .actors
            .iter_mut()
            .filter(|actor| actor.doing == ActorState::Waiting)
            .for_each(|actor| actor.doing = ActorState::Ready);
        if state.turn.is_none() {
            state.hand_over();
        }
    }

    /// What has brought all actors to a halt, if something has.
    #[cfg(test)]
    pub fn deadlock(&self) -> Option<String> {
        self.lock().deadlock.clone()
    }

    fn wait(&self, me: usize) {
        loop {
            {
                let state = self.lock();
                assert!(state.deadlock.is_none(), "{}", state.deadlock.as_deref().unwrap_or_default());
                if state.turn == Some(me) {
                    return;
                }
            }
            std::thread::park();
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }
}

impl State {
    /// Give the turn to one of those that can go on. If none can, and none outside will change that, it is a deadlock.
    fn hand_over(&mut self) {
        if !self.begun || self.deadlock.is_some() {
            return;
        }
        let ready = |actor: &Actor| actor.doing == ActorState::Ready;
        let total: u32 = self.actors.iter().filter(|actor| ready(actor)).map(|actor| actor.weight).sum();
        if total == 0 {
            let waiting: Vec<&str> =
                self.actors.iter().filter(|actor| actor.doing == ActorState::Waiting).map(|actor| actor.name).collect();
            if waiting.iter().any(|&name| name != LAST) {
                self.deadlock = Some(format!("a deadlock: {} wait for each other", waiting.join(", ")));
                self.actors.iter().filter_map(|actor| actor.thread.as_ref()).for_each(Thread::unpark);
            }
            return;
        }
        let mut left = self.random.random_range(0..total);
        for (place, actor) in self.actors.iter().enumerate().filter(|(_, actor)| ready(actor)) {
            if left < actor.weight {
                self.turn = Some(place);
                if let Some(thread) = &actor.thread {
                    thread.unpark();
                }
                return;
            }
            left -= actor.weight;
        }
    }
}

/// An actor's presence.
pub struct ActorGuard(Arc<Interleaving>);

impl Drop for ActorGuard {
    fn drop(&mut self) {
        let mut state = self.0.lock();
        if let Some(me) = ME.take() {
            state.actors[me].doing = ActorState::Gone;
            if state.turn == Some(me) {
                state.turn = None;
            }
        }
        drop(state);
        // Its ends of queues are gone, too.
        self.0.notify();
    }
}

/// Says that something has happened when it is dropped: to stand behind the end of a queue.
#[derive(Clone, Default)]
pub struct NotifyWhenDropped(pub Option<Arc<Interleaving>>);

impl Drop for NotifyWhenDropped {
    fn drop(&mut self) {
        if let Some(interleaving) = &self.0 {
            interleaving.notify();
        }
    }
}
