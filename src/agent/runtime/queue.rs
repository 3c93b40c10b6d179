//! Bounded queues whose depth can be watched without keeping them open.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, TrySendError, bounded};

use super::interleaving::{Interleaving, NotifyWhenDropped};

/// The depth of a queue, for those who watch.
#[derive(Debug, Clone)]
pub struct Gauge {
    /// Name of the queue.
    pub name: &'static str,
    /// Most messages it holds.
    pub capacity: usize,
    depth: Arc<AtomicUsize>,
}

impl Gauge {
    /// Messages in the queue, about now.
    pub fn depth(&self) -> usize {
        self.depth.load(Ordering::Relaxed).min(self.capacity)
    }
}

/// The end of a queue into which messages are put.
pub struct Outbox<T> {
    sender: Sender<T>,
    depth: Arc<AtomicUsize>,
    /// Behind the sender: that is gone by then.
    interleaving: NotifyWhenDropped,
}

/// The end of a queue from which messages are taken.
pub struct Inbox<T> {
    receiver: Receiver<T>,
    depth: Arc<AtomicUsize>,
    /// Behind the receiver: that is gone by then.
    interleaving: NotifyWhenDropped,
}

/// The other end of a queue is gone: there is nothing left to do for this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Closed;

/// A queue for at most `capacity` messages; `interleaving`: the actors that use it take turns.
pub fn queue<T>(
    name: &'static str,
    capacity: usize,
    interleaving: Option<&Arc<Interleaving>>,
) -> (Outbox<T>, Inbox<T>, Gauge) {
    let (sender, receiver) = bounded(capacity);
    let depth = Arc::new(AtomicUsize::new(0));
    let gauge = Gauge { name, capacity, depth: depth.clone() };
    let interleaving = NotifyWhenDropped(interleaving.cloned());
    (
        Outbox { sender, depth: depth.clone(), interleaving: interleaving.clone() },
        Inbox { receiver, depth, interleaving },
        gauge,
    )
}

impl<T> Clone for Outbox<T> {
    fn clone(&self) -> Self {
        Outbox { sender: self.sender.clone(), depth: self.depth.clone(), interleaving: self.interleaving.clone() }
    }
}

impl<T> Clone for Inbox<T> {
    fn clone(&self) -> Self {
        Inbox { receiver: self.receiver.clone(), depth: self.depth.clone(), interleaving: self.interleaving.clone() }
    }
}

impl<T> Outbox<T> {
    /// Whether a message could be put in now without waiting. Of several senders another may be faster.
    pub fn has_room(&self) -> bool {
        !self.sender.is_full()
    }

    /// Whether at least half of the room is taken.
    pub fn is_half_full(&self) -> bool {
        self.sender.capacity().is_some_and(|capacity| self.sender.len() >= capacity.div_ceil(2))
    }

    /// Put a message in without waiting: where there is no room, the oldest ones go. `taker` is the other end of this queue, of which
    /// this side then holds a share: it does not notice any more that the other one has gone. How many went.
    pub fn put_newest(&self, message: T, taker: &Inbox<T>) -> u64 {
        let (mut message, mut dropped) = (message, 0);
        if let Some(interleaving) = &self.interleaving.0 {
            interleaving.pause();
        }
        self.depth.fetch_add(1, Ordering::Relaxed);
        loop {
            match self.sender.try_send(message) {
                Ok(()) => {
                    self.interleaving.0.iter().for_each(|interleaving| interleaving.notify());
                    return dropped;
                }
                Err(TrySendError::Full(back)) => message = back,
                Err(TrySendError::Disconnected(_)) => return dropped,
            }
            if matches!(taker.poll(), Ok(Some(_))) {
                dropped += 1;
            }
        }
    }

    /// Put a message in, waiting for room.
    pub fn put(&self, message: T) -> Result<(), Closed> {
        self.depth.fetch_add(1, Ordering::Relaxed);
        let Some(interleaving) = &self.interleaving.0 else { return self.sender.send(message).map_err(|_| Closed) };
        let mut waiting = Some(message);
        interleaving.attempt(|| match self.sender.try_send(waiting.take()?) {
            Ok(()) => Some(Ok(())),
            Err(TrySendError::Disconnected(_)) => Some(Err(Closed)),
            Err(TrySendError::Full(back)) => {
                waiting = Some(back);
                None
            }
        })
    }

    /// A queue for one message, between the same actors.
    pub fn reply<R>(&self) -> (Outbox<R>, Inbox<R>) {
        let (outbox, inbox, _) = queue("reply", 1, self.interleaving.0.as_ref());
        (outbox, inbox)
    }
}

impl<T> Inbox<T> {
    /// Whether there is no message in the queue now.
    pub fn is_empty(&self) -> bool {
        self.receiver.is_empty()
    }

    /// Wait until the queue is empty, no longer than `limit`.
    pub fn wait_until_empty(&self, limit: Duration) {
        if let Some(interleaving) = &self.interleaving.0 {
            return interleaving.attempt(|| self.is_empty().then_some(()));
        }
        let begin = Instant::now();
        while !self.is_empty() && begin.elapsed() < limit {
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Take the next message, waiting for it.
    pub fn take(&self) -> Result<T, Closed> {
        let Some(interleaving) = &self.interleaving.0 else {
            return self.counted(self.receiver.recv().map_err(|_| Closed));
        };
        self.counted(interleaving.attempt(|| match self.receiver.try_recv() {
            Ok(message) => Some(Ok(message)),
            Err(TryRecvError::Disconnected) => Some(Err(Closed)),
            Err(TryRecvError::Empty) => None,
        }))
    }

    /// Take the next message if there is one.
    pub fn poll(&self) -> Result<Option<T>, Closed> {
        if let Some(interleaving) = &self.interleaving.0 {
            interleaving.pause();
        }
        match self.receiver.try_recv() {
            Ok(message) => {
                let taken = self.counted(Ok(message)).map(Some);
                // There is room now.
                self.interleaving.0.iter().for_each(|interleaving| interleaving.notify());
                taken
            }
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(Closed),
        }
    }

    /// Take the next message, waiting for it no longer than `limit`; where actors take turns, there is no time.
    pub fn take_within(&self, limit: Duration) -> Result<Option<T>, Closed> {
        if self.interleaving.0.is_some() {
            return self.take().map(Some);
        }
        match self.receiver.recv_timeout(limit) {
            Ok(message) => self.counted(Ok(message)).map(Some),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => Err(Closed),
        }
    }

    fn counted(&self, taken: Result<T, Closed>) -> Result<T, Closed> {
        if taken.is_ok() {
            self.depth.fetch_sub(1, Ordering::Relaxed);
        }
        taken
    }
}
