//! Bounded queues whose depth can be watched without keeping them open.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, TrySendError, bounded};

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
}

/// The end of a queue from which messages are taken.
pub struct Inbox<T> {
    receiver: Receiver<T>,
    depth: Arc<AtomicUsize>,
}

/// The other end of a queue is gone: there is nothing left to do for this one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Closed;

/// A queue for at most `capacity` messages.
pub fn queue<T>(name: &'static str, capacity: usize) -> (Outbox<T>, Inbox<T>, Gauge) {
    let (sender, receiver) = bounded(capacity);
    let depth = Arc::new(AtomicUsize::new(0));
    let gauge = Gauge { name, capacity, depth: depth.clone() };
    (Outbox { sender, depth: depth.clone() }, Inbox { receiver, depth }, gauge)
}

impl<T> Clone for Outbox<T> {
    fn clone(&self) -> Self {
        Outbox { sender: self.sender.clone(), depth: self.depth.clone() }
    }
}

impl<T> Clone for Inbox<T> {
    fn clone(&self) -> Self {
        Inbox { receiver: self.receiver.clone(), depth: self.depth.clone() }
    }
}

impl<T> Outbox<T> {
    /// Whether a message could be put in now without waiting. Of several senders another may be faster.
    pub fn has_room(&self) -> bool {
        !self.sender.is_full()
    }

    /// Put a message in at once: where there is no room, the oldest ones go. `taker` is the other end of this queue, of which
    /// this side then holds a share: it does not notice any more that the other one has gone. How many went.
    pub fn put_newest(&self, message: T, taker: &Inbox<T>) -> u64 {
        let (mut message, mut dropped) = (message, 0);
        self.depth.fetch_add(1, Ordering::Relaxed);
        loop {
            match self.sender.try_send(message) {
                Ok(()) => return dropped,
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
        self.sender.send(message).map_err(|_| Closed)
    }
}

impl<T> Inbox<T> {
    /// Whether there is no message in the queue now.
    pub fn is_empty(&self) -> bool {
        self.receiver.is_empty()
    }

    /// Take the next message, waiting for it.
    pub fn take(&self) -> Result<T, Closed> {
        self.counted(self.receiver.recv().map_err(|_| Closed))
    }

    /// Take the next message if there is one.
    pub fn poll(&self) -> Result<Option<T>, Closed> {
        match self.receiver.try_recv() {
            Ok(message) => self.counted(Ok(message)).map(Some),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(Closed),
        }
    }

    /// Take the next message, waiting for it no longer than `limit`.
    pub fn take_within(&self, limit: std::time::Duration) -> Result<Option<T>, Closed> {
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
