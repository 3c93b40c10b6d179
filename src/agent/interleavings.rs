//! Promise: in whatever order the actors get to do things, nothing is lost, nothing is done twice, and nobody waits for ever.
//!
//! Each order is given by a seed. `ADAGIO_INTERLEAVING=17 cargo test --release --lib interleavings` repeats one;
//! `ADAGIO_INTERLEAVINGS=10000` tries more than the ordinary run of the tests.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rand::RngExt;

use super::run::run_interleaved;
use super::runtime::interleaving::Interleaving;
use super::runtime::marker::SnapshotSettings;
use super::{Outcome, RecordedEvents, RunOptions, Status};
use crate::log::messages::{Decision, DictionaryGrowth, FrameTaken, ModelRequest, ModelUpdate};
use crate::log::run::{NullStorage, Repeating};
use crate::log::{Expected, LogOptions, LogReader, Record, Rotation, RunLog, Storage, topics};
use crate::random::stream;
use crate::robot::Action;
use crate::scenario::Scenario;
use crate::source::{Frame, Source};
use crate::world::Simulated;
use crate::world::World;

/// Orders that are tried, of all kinds together.
const INTERLEAVINGS: u64 = 400;

/// Actions of a run, of five frames each.
const ACTIONS: usize = 10;
const FRAMES: u64 = 5 * ACTIONS as u64 + 1;

fn scenario(sets: &[&str]) -> Arc<Scenario> {
    let text = include_str!("../../scenarios/smoke.toml");
    let own = [
        "actions=10",
        "camera.detail=vision",
        "vision.width=8",
        "vision.height=4",
        "dictionary.budget=12",
        "dictionary.block_frames=4",
        "dictionary.sigma=300",
        "dictionary.retained_frames=100",
        "slow.features=3",
        "agent.resolve_frames=12",
        "agent.latency_frames=11",
        "policy.explore_share=0.2",
        "policy.explore_length=2",
        "log.compression=none",
    ];
    let sets: Vec<String> = own.iter().chain(sets).map(|&set| set.to_owned()).collect();
    Arc::new(Scenario::parse(text, Path::new("smoke.toml"), &sets).unwrap())
}

/// The log's bytes.
#[derive(Clone, Default)]
struct Memory(Arc<Mutex<Vec<u8>>>);

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

impl Storage for Memory {
    fn create(&mut self, _: u32) -> std::io::Result<Box<dyn Write + Send>> {
        Ok(Box::new(self.clone()))
    }

    fn holds(&self, _: u32) -> bool {
        true
    }

    fn cut(&mut self, _: u32, _: u64) -> std::io::Result<()> {
        unreachable!("memory does not fail")
    }

    fn remove(&mut self, _: u32) -> std::io::Result<()> {
        unreachable!("there is no budget")
    }

    fn name(&self, _: u32) -> String {
        "memory".into()
    }
}

/// A robot that counts its frames.
struct Counting<'a> {
    robot: Simulated,
    given: &'a AtomicU64,
    stop_at: Option<u64>,
    stop: &'a AtomicBool,
}

impl Counting<'_> {
    fn count(&self) {
        let given = self.given.fetch_add(1, Ordering::Relaxed) + 1;
        if self.stop_at.is_some_and(|at| given >= at) {
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

impl Source for Counting<'_> {
    fn first(&mut self) -> Option<Frame> {
        self.count();
        self.robot.first()
    }

    fn execute(&mut self, action: Action, give: &mut dyn FnMut(Frame) -> bool) -> bool {
        let mut frames = Vec::new();
        let more = self.robot.execute(action, &mut |frame| {
            frames.push(frame);
            true
        });
        for frame in frames {
            self.count();
            if !give(frame) {
                break;
            }
        }
        more
    }

    fn persist(&mut self, parts: &mut crate::snapshot::Snapshot) -> Result<(), crate::snapshot::SnapshotError> {
        self.robot.persist(parts)
    }
}

/// One run, by threads or in interleaving.
struct Run<'a> {
    scenario: &'a Arc<Scenario>,
    world: &'a Arc<World>,
    interleaving: Option<Arc<Interleaving>>,
    /// Set like Ctrl-C once the robot has given this many frames.
    stop_at: Option<u64>,
    keep: Option<SnapshotSettings>,
    recording: Option<&'a RecordedEvents>,
}

impl Run<'_> {
    /// What came of it, and the frames that the robot gave.
    fn go(self, log: RunLog) -> (Outcome, u64) {
        let (stop, status, given) = (AtomicBool::new(false), Status::default(), AtomicU64::new(0));
        let robot = Simulated::new(self.scenario.clone(), self.world.clone());
        let mut source = Counting { robot, given: &given, stop_at: self.stop_at, stop: &stop };
        let options = RunOptions { recording: self.recording, keep: self.keep, ..RunOptions::new(&stop, &status) };
        let outcome =
            run_interleaved(self.scenario, &self.world.plan, &mut source, log, options, self.interleaving.as_ref());
        let stuck = self.interleaving.and_then(|interleaving| interleaving.deadlock());
        assert_eq!(stuck, None);
        (outcome.expect("a run"), given.load(Ordering::Relaxed))
    }
}

fn log_in(storage: impl Storage + 'static) -> RunLog {
    RunLog::create(storage, &LogOptions::default(), Rotation::NEVER, &BTreeMap::new()).unwrap()
}

/// Everything that a log says.
struct LogContents {
    expected: Expected,
    frames: Vec<u64>,
    decisions: Vec<Decision>,
    requests: Vec<ModelRequest>,
    models: Vec<ModelUpdate>,
    warnings: usize,
    /// The last frame of each block behind the end, and how many models are.
    finishing: Vec<u64>,
    last_models: usize,
    ended: bool,
}

fn said(log: &Memory) -> LogContents {
    let bytes = log.0.lock().unwrap().clone();
    let mut all = LogContents {
        expected: Expected::default(),
        frames: Vec::new(),
        decisions: Vec::new(),
        requests: Vec::new(),
        models: Vec::new(),
        warnings: 0,
        finishing: Vec::new(),
        last_models: 0,
        ended: false,
    };
    for record in LogReader::new(std::io::Cursor::new(bytes), "memory") {
        let record = record.expect("a whole log");
        let Record::Message { topic, log_time_ns, data, .. } = &record else { continue };
        all.expected.record(topic, *log_time_ns, data);
        let is = |name: &str| **topic == *name;
        if is(topics::FRAME.name()) {
            all.frames.push(record.decode::<FrameTaken>().unwrap().frame);
        } else if is(topics::DECISION.name()) {
            all.decisions.push(record.decode().unwrap());
        } else if is(topics::REQUEST.name()) {
            all.requests.push(record.decode().unwrap());
        } else if is(topics::MODEL.name()) {
            all.models.push(record.decode().unwrap());
            all.last_models += usize::from(all.ended);
        } else if is(topics::END.name()) {
            all.ended = true;
        } else if is(topics::DICTIONARY.name()) && all.ended {
            all.finishing.push(record.decode::<DictionaryGrowth>().unwrap().last_frame);
        } else if is(topics::DIAGNOSTICS.name()) {
            let text: crate::log::messages::Log = record.decode().unwrap();
            all.warnings += usize::from(text.msg.starts_with("no model"));
        }
    }
    all
}

/// Try all seeds of a share of [`INTERLEAVINGS`]: of every `of` seeds the one that is number `kind`. Says which one failed.
fn try_all(kind: u64, of: u64, attempt: impl Fn(u64)) {
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    if let Some(seed) = number("ADAGIO_INTERLEAVING") {
        if seed % of == kind {
            attempt(seed);
        }
        return;
    }
    for seed in (kind..number("ADAGIO_INTERLEAVINGS").unwrap_or(INTERLEAVINGS)).step_by(of as usize) {
        if std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| attempt(seed))).is_err() {
            panic!("this order fails: ADAGIO_INTERLEAVING={seed} cargo test --release --lib interleavings");
        }
    }
}

/// Short queues overflow, long ones let actors run ahead.
fn queue_of(seed: u64) -> String {
    format!("agent.queue={}", [1, 2, 3, 64][(seed / 4 % 4) as usize])
}

#[test]
fn in_lockstep_every_order_gives_the_same_messages_on_every_topic() {
    let reference = scenario(&[]);
    let world = Arc::new(World::new(&reference).unwrap());
    let log = Memory::default();
    let run = |interleaving| Run {
        scenario: &reference,
        world: &world,
        interleaving,
        stop_at: None,
        keep: None,
        recording: None,
    };
    let (outcome, given) = run(None).go(log_in(log.clone()));
    assert_eq!((outcome.frames, outcome.actions, given), (FRAMES, ACTIONS as u64, FRAMES));
    let (expected, digest) = (said(&log).expected, outcome.learned.expect("a model").digest());
    let folder = tempfile::tempdir().unwrap();
    try_all(0, 2, |seed| {
        let scenario = scenario(&[&queue_of(seed)]);
        let interleaving = Interleaving::new(stream(seed, "timing"));
        // In some the state of the run is saved between all actions.
        let path = folder.path().join(format!("{seed}"));
        let keep = seed.is_multiple_of(50).then_some(SnapshotSettings { path, every: Some(Duration::ZERO) });
        let run = Run {
            scenario: &scenario,
            world: &world,
            interleaving: Some(interleaving),
            stop_at: None,
            keep,
            recording: None,
        };
        let (outcome, given) = run.go(log_in(NullStorage).expecting(expected.clone(), Repeating::Write));
        assert_eq!((outcome.frames, outcome.actions, given), (FRAMES, ACTIONS as u64, FRAMES));
        assert_eq!(outcome.learned.expect("a model").digest(), digest);
        let repeated = outcome.log.expected.unwrap();
        assert_eq!(repeated.first_difference(), None);
        assert_eq!(repeated.beyond(), 0);
    });
}

#[test]
fn in_realtime_every_order_adds_up_and_is_repeated_from_its_log() {
    let world = Arc::new(World::new(&scenario(&[])).unwrap());
    try_all(1, 2, |seed| {
        let mut random = stream(seed, "what happens");
        let drops = random.random_range(0..2) == 0;
        let behind = if drops { "agent.when_behind=drop" } else { "agent.when_behind=wait" };
        let scenario = scenario(&[&queue_of(seed), "agent.mode=realtime", behind]);
        // In some the run is interrupted.
        let stop_at = (random.random_range(0..4) == 0).then(|| random.random_range(1..FRAMES));
        let log = Memory::default();
        let interleaving = Interleaving::new(stream(seed, "timing"));
        let run = Run {
            scenario: &scenario,
            world: &world,
            interleaving: Some(interleaving),
            stop_at,
            keep: None,
            recording: None,
        };
        let (outcome, given) = run.go(log_in(log.clone()));
        let said = said(&log);
        // Frames come in order; what is missing was dropped, and the robot gave all of them.
        assert!(said.frames.windows(2).all(|pair| pair[0] < pair[1]));
        assert_eq!(said.frames.len() as u64, outcome.frames);
        assert_eq!(outcome.frames + outcome.dropped, given);
        assert!(drops || outcome.dropped == 0);
        assert_eq!(given, 5 * outcome.actions + 1);
        assert_eq!(said.frames.last(), Some(&(given - 1)), "the last frame of an action is never dropped");
        // Behind the end is only what finishes the run: a run that goes on does not hold to it, and has learned all else.
        assert!(said.ended && said.finishing.len() <= 1, "{:?}", said.finishing);
        assert!(said.finishing.iter().all(|&last| last == given - 1), "{:?}", said.finishing);
        let (acted, last_models) = said.models.split_at(said.models.len() - said.last_models);
        assert!(acted.iter().all(|model| model.effective_at_frame < given));
        assert!(last_models.iter().all(|model| model.effective_at_frame == given));
        // One decision for each action, at the frame after the one before.
        let decided: Vec<(u64, u64)> = said.decisions.iter().map(|d| (d.action_index, d.frame)).collect();
        assert_eq!(decided, (0..outcome.actions).map(|n| (n, 5 * n)).collect::<Vec<_>>());
        assert!(stop_at.is_some() || outcome.actions == ACTIONS as u64);
        // Every request has its answer, in order, and no model acts before it was asked for.
        assert_eq!(said.requests.len(), said.models.len() + said.warnings);
        assert!(said.models.windows(2).all(|pair| pair[0].asked_at_frame < pair[1].asked_at_frame));
        assert!(said.models.iter().all(|model| model.asked_at_frame <= model.effective_at_frame));
        let epochs = said.models.iter().map(|model| model.epoch);
        assert!(epochs.eq(1..=said.models.len() as u32));
    });
}
