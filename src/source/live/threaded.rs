//! The loop of control on a thread of its own: it goes on whatever the actors do.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError, unbounded};

use super::{Base, Live, Switches};
use crate::lock::lock;
use crate::robot::Action;
use crate::snapshot::{Snapshot, SnapshotError};
use crate::source::{Frame, Journal, Source, give_until_boundary};

/// How often whoever waits for a frame sees whether the run is to end.
const LOOK_INTERVAL: Duration = Duration::from_millis(100);

/// Zeros that are sent after the end, one at each step of control.
const LAST_ZEROS: usize = 20;

/// A robot whose loop of control has a thread of its own, in real time.
pub struct Threaded {
    orders: Option<Sender<Order>>,
    frames: Receiver<Frame>,
    /// Boundaries that were taken.
    taken: u64,
    switches: Switches,
    journal: Arc<Mutex<Option<Journal>>>,
    thread: Option<JoinHandle<()>>,
}

/// How often in a step of control frames are given and orders are taken.
const SLICES: u32 = 10;

enum Order {
    /// An action that was decided on at a boundary, by their number. It is void where there is a later one: that leads to another.
    Do(Action, u64),
    /// Save or restore the count of frames.
    Persist(Box<Snapshot>, Sender<Persisted>),
}

type Persisted = (Box<Snapshot>, Result<(), SnapshotError>);

impl Threaded {
    /// Start the loop of control.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn start<B: Base + 'static>(live: Live<B>) -> std::io::Result<Self> {
        let (orders, taken) = unbounded();
        let (given, frames) = unbounded();
        let journal: Arc<Mutex<Option<Journal>>> = Arc::default();
        let (switches, told) = (live.switches.clone(), journal.clone());
        let control = move || control(live, &taken, &given, told);
        let thread = Some(std::thread::Builder::new().name("control".into()).spawn(control)?);
        Ok(Threaded { orders: Some(orders), frames, taken: 0, switches, journal, thread })
    }

    /// The next frame; none where the run is to end.
    fn next(&mut self) -> Option<Frame> {
        loop {
            match self.frames.recv_timeout(LOOK_INTERVAL) {
                Ok(frame) => {
                    self.taken += u64::from(frame.boundary.is_some());
                    return Some(frame);
                }
                Err(RecvTimeoutError::Timeout) if self.switches.stop.load(Ordering::Relaxed) => return None,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
    }

    fn order(&self, order: Order) -> bool {
        self.orders.as_ref().is_some_and(|orders| orders.send(order).is_ok())
    }
}

fn control<B: Base>(
    mut live: Live<B>,
    orders: &Receiver<Order>,
    frames: &Sender<Frame>,
    journal: Arc<Mutex<Option<Journal>>>,
) {
    live.journal = Some(Box::new(move |event| {
        if let Some(journal) = lock(&journal).as_ref() {
            journal(event);
        }
    }));
    let (mut next, mut given) = (live.base.now(), 0);
    loop {
        let mut ordered = false;
        match orders.try_recv() {
            Ok(Order::Do(action, at)) => {
                ordered = at == given;
                if ordered {
                    live.drive.order(action);
                }
            }
            Ok(Order::Persist(mut snapshot, answer)) => {
                let result = live.persist(&mut snapshot);
                // Whoever asked may have ended.
                let _ = answer.send((snapshot, result));
            }
            Err(TryRecvError::Empty) => {}
            Err(TryRecvError::Disconnected) => break,
        }
        // What was decided is done at once; a frame is given as soon as it is there.
        let now = live.base.now();
        if ordered || now >= next {
            live.tick();
            next = now.max(next) + live.period;
        }
        live.listen(next.min(now + live.period / SLICES));
        while let Some(frame) = live.drive.frame() {
            given += u64::from(frame.boundary.is_some());
            // Nobody takes it where the run has ended.
            let _ = frames.send(frame);
        }
    }
    live.drive.safety().end();
    for _ in 0..LAST_ZEROS {
        live.cycle();
    }
}

impl Source for Threaded {
    fn first(&mut self) -> Option<Frame> {
        self.next()
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        self.order(Order::Do(action, self.taken)) && give_until_boundary(|| self.next(), give)
    }

    fn keep_journal(&mut self, journal: Option<Journal>) {
        *lock(&self.journal) = journal;
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let unable = SnapshotError::Unable("a robot whose loop of control has ended");
        let (answer, answered) = unbounded();
        if !self.order(Order::Persist(Box::new(std::mem::take(snapshot)), answer)) {
            return Err(unable);
        }
        let (restored, result) = answered.recv().map_err(|_| unable)?;
        *snapshot = *restored;
        result
    }
}

impl Drop for Threaded {
    fn drop(&mut self) {
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            // If it panicked, the base was dropped, which sends zeros.
            let _ = thread.join();
        }
    }
}
