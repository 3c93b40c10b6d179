//! What the learner of a fleet learns: the steps of a run, on batches of several robots.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::agent::steps::{
    FitPolicies, Learn, Marked, ModelTiming, Observations, SERIES, SavedMark, Seen, Solve, Tasks, answer, parallelism,
};
use crate::agent::{Batch, CheckpointError, LearnError, SavedState, Update, read_state, state_bytes, write_state};
use crate::scenario::{Plan, Scenario};
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::vision::Observation;

/// What is known of a robot.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Robot {
    /// Which run of it: a robot that begins again counts its frames from 0.
    pub run: u64,
    /// Frames that were learned from.
    pub frames: u64,
    /// The first frame that was not learned from.
    pub next: u64,
    /// Its frames are numbered from so many times [`SERIES`] on: as one way that goes on from batch to batch.
    series: u64,
}

/// Dictionary, sums, window and values of a fleet.
pub struct Learner {
    scenario: Arc<Scenario>,
    tasks: Tasks,
    learn: Learn,
    solve: Solve,
    fit: FitPolicies,
    /// By name.
    robots: BTreeMap<String, Robot>,
    /// What each robot has marked.
    marks: BTreeMap<String, Vec<Marked>>,
    /// Runs of robots that frames were learned from.
    runs: u64,
    /// The newest model.
    pub update: Option<Update>,
    /// Frames that were left out, as their values were not finite.
    pub quarantined: u64,
}

impl Learner {
    /// One that has learned nothing.
    pub fn new(scenario: &Arc<Scenario>, plan: &Arc<Plan>) -> Self {
        let (par, tasks) = (parallelism(&scenario.agent), Tasks::new(scenario, plan.clone()));
        // Nothing is asked for by the number of frames: robots ask.
        let timing = Arc::new(ModelTiming::Lockstep { every: u64::MAX, latency: 0 });
        Learner {
            learn: Learn::new(scenario.clone(), Arc::new(tasks.clone()), timing),
            solve: Solve::new(&scenario.slow, par),
            fit: FitPolicies::new(scenario.clone(), par),
            scenario: scenario.clone(),
            tasks,
            robots: BTreeMap::new(),
            marks: BTreeMap::new(),
            runs: 0,
            update: None,
            quarantined: 0,
        }
    }

    /// What is known of robots, by name.
    pub fn robots(&self) -> &BTreeMap<String, Robot> {
        &self.robots
    }

    /// A robot has begun a run.
    pub fn begin(&mut self, name: &str, run: u64) {
        self.robots.insert(name.to_owned(), Robot { run, ..Robot::default() });
        self.marks.remove(name);
    }

    /// Learn from what a robot has handed over; frames that are known already are passed over.
    ///
    /// # Errors
    /// The dictionary refuses them, or no kernel width can be found.
    pub fn take(&mut self, name: &str, mut batch: Batch) -> Result<(), LearnError> {
        let robot = self.robots.entry(name.to_owned()).or_default();
        batch.samples.retain(|sample| sample.observation.frame >= robot.next);
        let Some(last) = batch.samples.last().map(|sample| sample.observation.frame) else { return Ok(()) };
        if robot.frames == 0 {
            // Not in the order in which they have joined, which may be another each time.
            robot.series = self.runs;
            self.runs += 1;
        }
        let first = robot.series * SERIES;
        let numbered = |of: &Observation| Arc::new(Observation { frame: first + of.frame, pixels: of.pixels.clone() });
        let marks = batch.marks.iter().map(|of| Marked { observation: numbered(&of.observation), ..of.clone() });
        self.marks.insert(name.to_owned(), marks.collect());
        let mut tasks = self.tasks.clone();
        tasks.set_marks(self.marks.values().flatten().cloned().collect());
        let tasks = Arc::new(tasks);
        robot.frames += batch.samples.len() as u64;
        robot.next = last + 1;
        for (number, mut sample) in batch.samples.into_iter().enumerate() {
            if let (0, Some(link)) = (number, &mut sample.link) {
                // The action goes on; but the frame that comes before it here is another robot's, or was long ago.
                link.weight = 0.0;
            }
            sample.observation = numbered(&sample.observation);
            let seen = Seen { sample, stamp_ns: 0, tasks: tasks.clone(), changed: false };
            let learned = self.learn.step(seen, true)?;
            self.quarantined += learned.growth.map_or(0, |growth| growth.quarantined.len() as u64);
        }
        Ok(())
    }

    /// Make a model of everything.
    ///
    /// # Errors
    /// As for [`Learner::take`].
    pub fn model(&mut self) -> Result<Option<&Update>, LearnError> {
        let learned = self.learn.finish()?;
        self.quarantined += learned.growth.map_or(0, |growth| growth.quarantined.len() as u64);
        if let Some(request) = learned.request {
            let solved = self.solve.step(request);
            let update = self.fit.step(solved);
            self.update = Some(update);
        }
        Ok(self.update.as_ref())
    }

    /// Save what there is.
    ///
    /// # Errors
    /// The file system refused.
    pub fn save(&mut self, path: &Path) -> Result<(), CheckpointError> {
        let mut snapshot = Snapshot::new();
        self.persist(&mut snapshot).map_err(|cause| CheckpointError::Damaged(cause.to_string()))?;
        write_state(path, SavedState { snapshot, frame: 0, stamp_ns: 0 }, &self.scenario.clone())
    }

    /// Go on from what was saved by a learner of the same scenario.
    ///
    /// # Errors
    /// It is no whole state, or of another scenario.
    pub fn restore(&mut self, bytes: &[u8]) -> Result<(), CheckpointError> {
        let mut state = read_state(bytes, &self.scenario)?;
        self.persist(&mut state.snapshot).map_err(|cause| CheckpointError::Damaged(cause.to_string()))
    }
}

impl Persist for Learner {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("learn", &mut self.learn)?;
        snapshot.inner("solve", &mut self.solve)?;
        snapshot.inner("fit", &mut self.fit)?;
        snapshot.value("robots", &mut self.robots)?;
        snapshot.value("runs", &mut self.runs)?;
        snapshot.value("quarantined", &mut self.quarantined)?;
        let mut there = self.update.is_some();
        snapshot.value("update", &mut there)?;
        if there {
            snapshot.scope("update", |snapshot| answer(snapshot, &mut self.update))?;
        }
        let (mut seen, values) = (Observations::default(), self.scenario.vision.values());
        let mut marks: BTreeMap<String, Vec<SavedMark>> = BTreeMap::new();
        for (name, of) in &self.marks {
            marks.insert(name.clone(), of.iter().map(|marked| seen.add_mark(marked)).collect());
        }
        snapshot.value("marks", &mut marks)?;
        snapshot.scope("marks", |snapshot| seen.persist(snapshot, values))?;
        if snapshot.is_restoring() {
            let restored = marks.into_iter().map(|(name, of)| {
                Ok((name, of.into_iter().map(|mark| seen.mark(mark)).collect::<Result<_, SnapshotError>>()?))
            });
            self.marks = restored.collect::<Result<_, SnapshotError>>()?;
        }
        Ok(())
    }
}

/// A batch as bytes.
pub fn batch_bytes(mut batch: Batch, scenario: &Scenario) -> Result<Vec<u8>, CheckpointError> {
    let mut snapshot = Snapshot::new();
    batch.persist(&mut snapshot, scenario).map_err(|cause| CheckpointError::Damaged(cause.to_string()))?;
    state_bytes(SavedState { snapshot, frame: 0, stamp_ns: 0 }, scenario)
}

/// A batch from bytes.
pub fn batch_of(bytes: &[u8], scenario: &Scenario) -> Result<Batch, CheckpointError> {
    let (mut state, mut batch) = (read_state(bytes, scenario)?, Batch::default());
    let restored = batch.persist(&mut state.snapshot, scenario);
    restored.map_err(|cause| CheckpointError::Damaged(cause.to_string()))?;
    Ok(batch)
}

/// A model as bytes.
pub fn update_bytes(update: &Update, scenario: &Scenario) -> Result<Vec<u8>, CheckpointError> {
    let mut snapshot = Snapshot::new();
    let answered = answer(&mut snapshot, &mut Some(update.clone()));
    answered.map_err(|cause| CheckpointError::Damaged(cause.to_string()))?;
    state_bytes(SavedState { snapshot, frame: 0, stamp_ns: 0 }, scenario)
}

/// A model from bytes, as if it had been asked for at a frame.
pub fn update_of(bytes: &[u8], asked_at: u64, scenario: &Scenario) -> Result<Update, CheckpointError> {
    let (mut state, mut update) = (read_state(bytes, scenario)?, None);
    answer(&mut state.snapshot, &mut update).map_err(|cause| CheckpointError::Damaged(cause.to_string()))?;
    let update = update.ok_or_else(|| CheckpointError::Damaged("there is no model in it".into()))?;
    // Frames of the learner are those of all robots.
    let learned = update.learned.map(|mut learned| {
        Arc::make_mut(&mut learned).asked_at = asked_at;
        learned
    });
    Ok(Update { asked_at, learned, ..update })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::steps::{ActionEnd, Sample};
    use crate::slow::Link;

    fn batch(frames: std::ops::Range<u64>, marked: &[u64], scenario: &Scenario) -> Batch {
        let seen = |frame| {
            let pixels = (0..scenario.vision.values()).map(|i| ((i as u64 * 31 + frame * 7) % 251) as u8).collect();
            Arc::new(Observation { frame, pixels })
        };
        let samples = frames.map(|frame| Sample { observation: seen(frame), link: None, boundary: None, action: None });
        let mark = |&frame: &u64| Marked { task: 0, observation: seen(frame), place: Some([frame as f64, 1.0]) };
        Batch { samples: samples.collect(), marks: marked.iter().map(mark).collect() }
    }

    #[test]
    fn what_robots_mark_counts_for_all_and_each_frame_counts_once() {
        let text = include_str!("../../scenarios/shown.toml");
        let sets = ["dictionary.sigma=1000".to_owned()];
        let scenario = Arc::new(Scenario::parse(text, Path::new("shown.toml"), &sets).unwrap());
        let plan = Arc::new(Plan::new(&scenario).unwrap());
        let mut learner = Learner::new(&scenario, &plan);
        learner.begin("a", 1);
        learner.begin("b", 2);
        // As they come over the wire.
        let wire = |batch| batch_of(&batch_bytes(batch, &scenario).unwrap(), &scenario).unwrap();
        learner.take("a", wire(batch(0..10, &[3], &scenario))).unwrap();
        learner.take("b", wire(batch(0..20, &[4], &scenario))).unwrap();
        // Frames 5 to 9 are known; the mark of the batch before stays what it is.
        learner.take("a", wire(batch(5..15, &[3, 12], &scenario))).unwrap();
        let marks = |learner: &Learner| -> Vec<(u64, Option<[f64; 2]>)> {
            let marks = learner.marks.values().flatten();
            marks.map(|marked| (marked.observation.frame, marked.place)).collect()
        };
        // The other robot's frames are numbered from there on.
        let of_a = [(3, Some([3.0, 1.0])), (12, Some([12.0, 1.0]))];
        assert_eq!(marks(&learner), [of_a[0], of_a[1], (SERIES + 4, Some([4.0, 1.0]))]);
        let robots = |learner: &Learner| learner.robots().values().map(|of| (of.frames, of.next)).collect::<Vec<_>>();
        assert_eq!(robots(&learner), [(15, 15), (20, 20)]);

        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state");
        learner.save(&path).unwrap();
        let mut restored = Learner::new(&scenario, &plan);
        restored.restore(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!((marks(&restored), robots(&restored)), (marks(&learner), robots(&learner)));
        // Forgotten by one robot, and gone with the other one's run.
        restored.take("a", wire(batch(15..16, &[], &scenario))).unwrap();
        restored.begin("b", 3);
        assert!(marks(&restored).is_empty());
        restored.take("b", wire(batch(0..5, &[], &scenario))).unwrap();
        assert_eq!(robots(&restored), [(16, 16), (5, 5)]);
    }

    #[test]
    fn the_way_of_a_robot_goes_on_from_batch_to_batch() {
        let text = include_str!("../../scenarios/lab.toml");
        let scenario =
            Arc::new(Scenario::parse(text, Path::new("lab.toml"), &["dictionary.sigma=1000".into()]).unwrap());
        let mut learner = Learner::new(&scenario, &Arc::new(Plan::new(&scenario).unwrap()));
        // An action a frame; with the frames that are missing before frame 30 the outcome of one is not known.
        let driven = |frames: std::ops::Range<u64>, missing: bool| {
            let mut batch = batch(frames, &[], &scenario);
            for (number, sample) in batch.samples.iter_mut().enumerate() {
                let end = ActionEnd { place: [0.0, 0.0].into(), blocked: false, step: None, rewards: Vec::new() };
                (sample.boundary, sample.action) = (Some((end, 7)), scenario.robot.actions.get(0));
                sample.link = (number > 0 || !missing).then_some(Link { dt: 0.2, weight: 5.0 });
            }
            batch
        };
        for (name, batch) in [
            ("a", driven(0..10, true)),
            ("b", driven(0..5, true)),
            ("a", driven(10..20, false)),
            ("b", driven(5..10, false)),
            ("a", driven(30..35, true)),
        ] {
            learner.take(name, batch).unwrap();
        }
        assert_eq!(learner.model().unwrap().unwrap().transitions, 19 + 9 + 4);
    }
}
