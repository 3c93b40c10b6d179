//! A simulation of `adagio learn`: the collector's steps one after the other, and between them, event by event, machines that take pieces
//! of work from a list: fetch over the network, compute, hand the result back.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use adagio::learn::STRETCH;
use adagio::random;
use rand::{Rng, RngExt};

/// Frames per second of a robot, and frames of an action.
pub const RATE: f64 = 5.0;
pub const PER_ACTION: f64 = 5.0;

/// How often a piece is tried, as by `adagio learn`.
const TRIES: u32 = 3;

/// Machines, each with a link, and the one that logs and parts lie on. Rates in bytes per second.
#[derive(Debug, Clone, Copy)]
pub struct Machines {
    pub workers: usize,
    /// Of a worker beside the others, as a share of that at which costs were measured: 1, where each has a processor of its own.
    pub speed: f64,
    /// Of a worker's link, and of that of the machine with the files, in each direction.
    pub link: f64,
    pub server: f64,
    /// Failures of a worker per second of computing; one that has failed gets no more work.
    pub failures: f64,
}

/// Pieces of work that are alike.
#[derive(Debug, Clone, Copy)]
pub struct Work {
    pub pieces: usize,
    /// Bytes that a worker fetches for its first piece alone, for each piece, and hands back of each.
    pub once: f64,
    pub fetch: f64,
    pub give: f64,
    /// Seconds of computing.
    pub compute: f64,
}

/// What became of it.
#[derive(Debug, Clone, Copy, Default)]
pub struct Passed {
    pub seconds: f64,
    /// Seconds that workers computed, all together.
    pub busy: f64,
    /// Bytes over the network.
    pub wire: f64,
}

/// A moment that is not negative: its bits are in its order.
fn at(seconds: f64) -> u64 {
    seconds.to_bits()
}

/// Transfers in one direction, which share the bandwidth equally: each has got as many bytes since the beginning as any other.
struct Transfers {
    each: f64,
    all: f64,
    now: f64,
    /// Bytes that a transfer would have got that was there from the beginning.
    served: f64,
    /// When it is done, in these bytes, and whose it is.
    open: BinaryHeap<Reverse<(u64, usize)>>,
}

impl Transfers {
    fn new(each: f64, all: f64) -> Self {
        Transfers { each, all, now: 0.0, served: 0.0, open: BinaryHeap::new() }
    }

    fn rate(&self) -> f64 {
        self.each.min(self.all / self.open.len() as f64)
    }

    /// When the next one is done.
    fn due(&self) -> f64 {
        let until = |&Reverse((bytes, _)): &Reverse<(u64, usize)>| f64::from_bits(bytes) - self.served;
        self.open.peek().map_or(f64::INFINITY, |next| self.now + until(next).max(0.0) / self.rate())
    }

    fn go_on(&mut self, now: f64) {
        if !self.open.is_empty() {
            self.served += (now - self.now) * self.rate();
        }
        self.now = now;
    }

    fn begin(&mut self, worker: usize, bytes: f64) {
        self.open.push(Reverse((at(self.served + bytes), worker)));
    }

    /// Whose transfer is done.
    fn end(&mut self) -> usize {
        let Reverse((bytes, worker)) = self.open.pop().expect("one that is due");
        self.served = self.served.max(f64::from_bits(bytes));
        worker
    }
}

impl Machines {
    /// All pieces of work; nothing if one has failed too often, or no worker is left.
    pub fn pass(&self, work: &Work, random: &mut impl Rng) -> Option<Passed> {
        let mut todo: VecDeque<u32> = vec![0; work.pieces].into();
        let (mut done, mut passed, mut now) = (0, Passed::default(), 0.0);
        let [mut down, mut up] = [(); 2].map(|()| Transfers::new(self.link, self.server));
        // When a worker has computed, or fails.
        let mut computing: BinaryHeap<Reverse<(u64, usize, bool)>> = BinaryHeap::new();
        // The tries before this one of what a worker works on; and whether it has what it fetches once.
        let (mut holds, mut begun) = (vec![0; self.workers], vec![false; self.workers]);
        let mut idle: Vec<usize> = (0..self.workers).rev().collect();
        while done < work.pieces {
            while let Some(&worker) = idle.last()
                && let Some(tries) = todo.pop_front()
            {
                idle.pop();
                let bytes = work.fetch + if begun[worker] { 0.0 } else { work.once };
                (holds[worker], begun[worker]) = (tries, true);
                down.begin(worker, bytes);
                passed.wire += bytes;
            }
            let computed = computing.peek().map_or(f64::INFINITY, |Reverse(next)| f64::from_bits(next.0));
            now = computed.min(down.due()).min(up.due());
            if now == f64::INFINITY {
                return None;
            }
            let (fetched, given) = (down.due() <= now, up.due() <= now);
            down.go_on(now);
            up.go_on(now);
            if fetched {
                let worker = down.end();
                let fails = match self.failures > 0.0 {
                    true => -random.random::<f64>().max(f64::MIN_POSITIVE).ln() / self.failures,
                    false => f64::INFINITY,
                };
                let seconds = (work.compute / self.speed).min(fails);
                passed.busy += seconds;
                computing.push(Reverse((at(now + seconds), worker, fails <= seconds)));
            } else if given {
                idle.push(up.end());
                done += 1;
            } else if let Some(Reverse((_, worker, fails))) = computing.pop() {
                if !fails {
                    up.begin(worker, work.give);
                    passed.wire += work.give;
                } else if holds[worker] + 1 < TRIES {
                    todo.push_back(holds[worker] + 1);
                } else {
                    return None;
                }
            }
        }
        Some(Passed { seconds: now, ..passed })
    }
}

/// What the steps cost at one number of support vectors: seconds, and bytes.
#[derive(Debug, Clone, Copy, Default)]
pub struct Costs {
    pub m: f64,
    pub d: f64,
    /// A process, with its scenario.
    pub start: f64,
    /// Of a frame: its log is looked at and hashed; it is decoded; it is decoded and judged; it is decoded and summed up.
    pub look: f64,
    pub decode: f64,
    pub judge: f64,
    pub sum: f64,
    /// What the first frames of a log cost beyond that, while the dictionary grows from nothing.
    pub growth: f64,
    /// The width of the kernel, from observations.
    pub search: f64,
    pub dictionary_written: f64,
    pub dictionary_read: f64,
    pub digest: f64,
    /// A part without candidates and each candidate, written and read.
    pub candidates_written: [f64; 2],
    pub candidates_read: [f64; 2],
    pub sums_written: f64,
    /// Sums read and added.
    pub merged: f64,
    /// A transition in sums, read.
    pub transition: f64,
    /// Features and policies: without transitions, and for each of them.
    pub model: [f64; 2],
    pub frame_bytes: f64,
    pub dictionary_bytes: f64,
    pub candidate_bytes: f64,
    pub sums_bytes: f64,
    pub transition_bytes: f64,
}

/// Logs that are alike.
pub struct Logs {
    pub count: usize,
    pub frames: f64,
    /// Frames of a piece of each until its dictionary is full.
    pub judged: f64,
    /// Candidates of a piece of a log, for each round.
    pub found: Vec<f64>,
    /// Whether the program is as it could be: see [`learn`].
    pub changed: bool,
}

pub const STAGES: [&str; 7] = ["look", "width", "members", "union", "moments", "merge", "model"];

/// What learning takes: seconds of each of [`STAGES`].
pub struct Forecast {
    pub stages: [f64; 7],
    pub passed: Passed,
    pub parts: f64,
    pub memory: f64,
}

impl Forecast {
    pub fn seconds(&self) -> f64 {
        self.stages.iter().sum()
    }
}

/// Transitions that a scenario's window holds, and frames that a width is found from.
pub const WINDOW: f64 = 20_000.0;
pub const WIDTH_FRAMES: usize = 1000;

/// The steps of `adagio learn`, in its order. The collector does one thing at a time, and waits while workers work.
///
/// If the program is changed, workers look at the logs, and a log is not decoded to its end for a few observations.
pub fn learn(costs: &Costs, logs: &Logs, machines: &Machines) -> Option<Forecast> {
    let (count, frames, c) = (logs.count as f64, logs.frames, costs);
    // Each piece is found by reading what comes before it in its log.
    let pieces = (frames / STRETCH as f64).ceil();
    let (parts_of_all, of_piece) = (count * pieces, frames / pieces);
    let before = 0.5 * (pieces - 1.0) * of_piece * c.decode;
    let (log_bytes, transitions) = (frames * c.frame_bytes, WINDOW.min(of_piece / PER_ACTION));
    let sums_bytes = c.sums_bytes + transitions * c.transition_bytes;
    let mut random = random::stream(1, "bench failures");
    let [mut members, mut union, mut parts] = [0.0; 3];
    let mut passed = Passed::default();
    let mut pass = |of_log: f64, once: f64, give: f64, compute: f64| {
        let (pieces, compute) = (logs.count * of_log as usize, c.start + frames * c.look + compute);
        let now = machines.pass(&Work { pieces, once, fetch: log_bytes, give, compute }, &mut random)?;
        passed = Passed { seconds: 0.0, busy: passed.busy + now.busy, wire: passed.wire + now.wire };
        Some(now.seconds)
    };

    // The first log is opened twice more, for its scenario.
    let opened = if logs.changed { 2.0 } else { count + 2.0 };
    let mut look = c.start + opened * (frames * c.look + log_bytes / machines.server);
    if logs.changed {
        look += pass(1.0, 0.0, 0.0, 0.0)?;
    }
    // Observations of up to 1000 logs, which are decoded to their end.
    let asked = logs.count.div_ceil(logs.count.div_ceil(WIDTH_FRAMES));
    let of_each = WIDTH_FRAMES.div_ceil(asked) as f64;
    let apart = if logs.changed || asked == 1 { 1.0 } else { (frames / of_each).floor().max(1.0) };
    let decoded = asked as f64 * (of_each * apart).min(frames);
    let width = decoded * (c.decode + c.frame_bytes / machines.server) + c.search;
    for (round, &found) in logs.found.iter().enumerate() {
        let give = found * c.candidate_bytes;
        let [seconds, once, growth] =
            if round == 0 { [0.0, 0.0, c.growth] } else { [c.dictionary_read, c.dictionary_bytes, 0.0] };
        let written = c.candidates_written[0] + found * c.candidates_written[1];
        let found_in = of_piece * c.decode + of_piece.min(logs.judged) * (c.judge - c.decode);
        members += pass(pieces, once, give, seconds + before + found_in + growth + written)?;
        // Parts are read until the dictionary is full.
        let read = c.candidates_read[0] + found * c.candidates_read[1] + give / machines.server;
        let judged = if found > 0.0 { parts_of_all.min((c.m / found).ceil()) } else { parts_of_all };
        union += judged * (read + found * (c.judge - c.decode)) + growth + c.dictionary_written + 4.0 * c.digest;
        parts += parts_of_all * give;
    }
    let compute = c.dictionary_read + before + of_piece * c.sum + c.sums_written;
    let moments = pass(pieces, c.dictionary_bytes, sums_bytes, compute)?;
    parts += parts_of_all * sums_bytes;
    let merge = parts_of_all * (c.merged + transitions * c.transition + sums_bytes / machines.server) + 2.0 * c.digest;
    let model = c.model[0] + c.model[1] * WINDOW.min(parts_of_all * transitions);
    // Sums of a power of two logs each; and of the part that is read its bytes, its matrices, and a copy of one of them.
    let memory = (parts_of_all.log2().floor() + 1.0 + 2.5) * c.sums_bytes + c.dictionary_bytes;
    Some(Forecast { stages: [look, width, members, union, moments, merge, model], passed, parts, memory })
}
