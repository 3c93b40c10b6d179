//! The perceive actor: what a frame shows, and at the end of an action what it came to.
//!
//! [`Perceive`] is the step, [`PerceiveLoop`] runs it. Nothing here takes long: what is learned from a frame is left to the next actor.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use nalgebra::Point2;

use super::learn::{Sample, Seen};
use super::messages::{Item, Percept};
use super::record::{Level, Recorder};
use super::saved::{Observations, SavedMark, recent_numbers, recent_of};
use super::tasks::{ActionEnd, Tasks};
use crate::agent::runtime::marker::Quiescence;
use crate::agent::runtime::queue::{Closed, Inbox, Outbox};
use crate::agent::runtime::status::Status;
use crate::agent::runtime::timing::ModelTiming;
use crate::policy::{Recent, Reflexes, step_between};
use crate::robot::{ActionSet, Pose};
use crate::scenario::{Plan, Scenario};
use crate::slow::Link;
use crate::snapshot::{Persist, Snapshot, SnapshotError};
use crate::source::{Boundary, Frame, GoalMove, Mark, View};
use crate::vision::{Observation, Observer};

/// What a frame shows.
pub struct Perceived {
    /// At the end of an action.
    pub percept: Option<Percept>,
    /// Tasks that moved with it.
    pub moved: Vec<GoalMove>,
    /// Marks that count, and why others do not.
    pub marks: Vec<Mark>,
    pub refused: Vec<String>,
    /// To be learned from.
    pub seen: Seen,
}

/// Vision, the tasks as they are, and what the reflexes are to know.
pub struct Perceive {
    scenario: Arc<Scenario>,
    timing: Arc<ModelTiming>,
    observer: Observer,
    tasks: Arc<Tasks>,
    last_number: Option<u64>,
    /// Odometry at the end of the action before.
    stood: Option<Pose>,
    reflexes: Reflexes,
    actions: ActionSet,
    /// What the reflexes are to know of the actions so far.
    recent: Recent,
    /// Frames at which models are asked for, since the percept before.
    asked: Vec<u64>,
    /// Whether somebody marks, or did with the last action: policies follow when that is over.
    marking: bool,
    frames: u64,
}

impl Perceive {
    /// An actor that has seen nothing.
    pub fn new(scenario: Arc<Scenario>, plan: Arc<Plan>, timing: Arc<ModelTiming>) -> Self {
        Perceive {
            tasks: Arc::new(Tasks::new(&scenario, plan)),
            reflexes: Reflexes::new(&scenario),
            actions: scenario.robot.actions.clone(),
            scenario,
            timing,
            observer: Observer::default(),
            last_number: None,
            stood: None,
            recent: Recent::default(),
            asked: Vec::new(),
            marking: false,
            frames: 0,
        }
    }

    /// The tasks as they are.
    pub fn tasks(&self) -> Arc<Tasks> {
        self.tasks.clone()
    }

    /// See a frame. Tasks move at the end of actions, too, and what the action came to is judged by where they are then.
    pub fn step(&mut self, frame: Frame) -> Perceived {
        let pixels = match frame.view {
            View::Observation(pixels) => pixels,
            View::Image(image) => {
                let mut pixels = Vec::new();
                self.observer.observe(&image, &self.scenario.vision, &mut pixels);
                pixels
            }
        };
        let observation = Arc::new(Observation { frame: frame.number, pixels });
        let follows = self.last_number.is_some_and(|last| last + 1 == frame.number);
        let link = frame.action.filter(|_| follows).map(|action| Link {
            dt: self.scenario.robot.frame_seconds(),
            weight: if self.actions.advances(action) { self.scenario.slow.move_weight } else { 1.0 },
        });
        // Nothing is near a place that nobody knows: no reward, no goal.
        let place = frame.truth.map_or(Point2::new(f64::NAN, f64::NAN), |pose| pose.position);
        if let Some(boundary) = &frame.boundary {
            // Without an action the recording was interrupted: what was before has nothing to do with it.
            let after = |action| self.recent.then(action, boundary.blocked, &self.actions);
            self.recent = frame.action.map_or(Recent::default(), after);
        }
        let counted = frame.odometry.filter(|_| self.scenario.value.odometry);
        let step = frame.action.and_then(|_| Some(step_between(&self.stood?, &counted?)));
        if frame.boundary.is_some() {
            self.stood = counted;
        }
        let end = frame.boundary.map(|Boundary { blocked }| ActionEnd { place, blocked, step, rewards: frame.rewards });
        self.last_number = Some(frame.number);
        self.frames += 1;
        let moved = match &end {
            Some(_) => Arc::make_mut(&mut self.tasks).follow(frame.number, &frame.moved),
            None => Vec::new(),
        };
        let (marks, refused) = match frame.marks.is_empty() {
            true => (Vec::new(), Vec::new()),
            false => Arc::make_mut(&mut self.tasks).mark(&frame.marks, &observation, place),
        };
        self.marking |= !marks.is_empty();
        let marked = end.is_some() && marks.is_empty() && std::mem::take(&mut self.marking);
        let changed = marked || !moved.is_empty();
        if self.timing.announces(frame.number, self.frames, changed) {
            self.asked.push(frame.number);
        }
        let percept = end.as_ref().map(|end| Percept {
            observation: observation.clone(),
            stamp_ns: frame.stamp_ns,
            sonar: frame.sonar,
            action: frame.action,
            recent: self.recent,
            outcomes: self.tasks.outcomes_of(end),
            goto: frame.goto,
            asked: std::mem::take(&mut self.asked),
        });
        let boundary = end.map(|end| (end, self.reflexes.allowed(self.recent)));
        let sample = Sample { observation, link, boundary, action: frame.action };
        let seen = Seen { sample, stamp_ns: frame.stamp_ns, tasks: self.tasks(), changed };
        Perceived { percept, moved, marks, refused, seen }
    }
}

/// It is restored into a new one of the same scenario.
impl Persist for Perceive {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let tasks = Arc::make_mut(&mut self.tasks);
        snapshot.inner("tasks", tasks)?;
        snapshot.value("last_number", &mut self.last_number)?;
        let mut stood = self.stood.map(|pose| [pose.position.x, pose.position.y, pose.heading].map(f64::to_bits));
        snapshot.value("stood", &mut stood)?;
        self.stood =
            stood.map(|bits| bits.map(f64::from_bits)).map(|[x, y, heading]| Pose::new([x, y].into(), heading));
        let mut recent = recent_numbers(self.recent);
        snapshot.value("recent", &mut recent)?;
        self.recent = recent_of(snapshot, recent)?;
        snapshot.value("frames", &mut self.frames)?;
        if self.scenario.shows_any() {
            snapshot.value("marking", &mut self.marking)?;
            let mut seen = Observations::default();
            let mut marks: Vec<SavedMark> = tasks.marks.iter().map(|marked| seen.add_mark(marked)).collect();
            snapshot.value("marks", &mut marks)?;
            seen.persist(snapshot, self.scenario.vision.values())?;
            if snapshot.is_restoring() {
                tasks.marks = marks.into_iter().map(|mark| seen.mark(mark)).collect::<Result<_, _>>()?;
                let names = self.scenario.names().count();
                snapshot.check("marks", tasks.marks.iter().all(|marked| marked.task < names), "other tasks")?;
            }
        }
        Ok(())
    }
}

/// Whether nothing but learning needs a frame.
fn is_spare(frame: &Frame) -> bool {
    frame.boundary.is_none() && frame.marks.is_empty()
}

/// The perceive actor's surroundings.
pub struct PerceiveLoop<'a> {
    pub percepts: Outbox<Percept>,
    /// To the learn actor.
    pub seen: Outbox<Item<Seen>>,
    /// Whether frames that cannot be learned from in time are dropped. Neither the last one of an action nor a marked one is.
    pub drops: bool,
    pub record: Recorder,
    pub status: &'a Status,
    pub quiescence: &'a Quiescence,
}

impl PerceiveLoop<'_> {
    /// See frames until there are no more. Returns how many there were.
    pub fn run(&self, mut perceive: Perceive, frames: &Inbox<Item<Frame>>) -> u64 {
        // A run that goes on does so behind the last frame of an action.
        let mut last_boundary = perceive.last_number;
        while let Ok(item) = frames.take() {
            let sent = match item {
                Item::Work(frame) if self.drops && is_spare(&frame) && self.seen.is_half_full() => {
                    self.status.update(|s| s.dropped += 1);
                    Ok(())
                }
                Item::Work(frame) => self.see(&mut perceive, frame, &mut last_boundary),
                Item::Save(marker) => match marker.with("perceive", &mut perceive) {
                    Some(marker) => self.seen.put(Item::Save(marker)),
                    None => {
                        // Models may be asked for again.
                        self.quiescence.hold.store(false, Ordering::Relaxed);
                        Ok(())
                    }
                },
            };
            if sent.is_err() {
                return perceive.frames;
            }
        }
        perceive.frames
    }

    fn see(&self, perceive: &mut Perceive, frame: Frame, last_boundary: &mut Option<u64>) -> Result<(), Closed> {
        let record = &self.record;
        let (number, stamp, action, goto) = (frame.number, frame.stamp_ns, frame.action, frame.goto);
        record.frame(&frame)?;
        // Frames are missing before this one: the outcome of the action is not known.
        if perceive.last_number.is_none_or(|last| last + 1 != number) {
            *last_boundary = None;
        }
        let Perceived { percept, moved, marks, refused, seen } = perceive.step(frame);
        // With an observation, a replay has the whole frame.
        record.goals(&moved, number, stamp)?;
        record.marks(&marks, number, stamp)?;
        record.goto(goto, number, stamp)?;
        record.observation(&seen.sample.observation, stamp)?;
        for text in refused {
            record.diagnostic(Level::Warn, stamp, text)?;
        }
        if let Some(percept) = percept {
            if let (Some(from), Some(action)) = (last_boundary.replace(number), action) {
                record.transition(from, action, &percept)?;
            }
            self.percepts.put(percept)?;
        }
        self.status.update(|s| (s.frames, s.stamp_ns) = (perceive.frames, stamp));
        self.seen.put(Item::Work(seen))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Action;

    #[test]
    fn percepts_know_the_turn_before_a_push_until_a_recording_is_interrupted() {
        let text = include_str!("../../../scenarios/lab.toml");
        let scenario = Arc::new(Scenario::parse(text, std::path::Path::new("lab.toml"), &[]).unwrap());
        let plan = Arc::new(Plan::new(&scenario).unwrap());
        let timing = || Arc::new(ModelTiming::new(&scenario.agent, None));
        let mut perceive = Perceive::new(scenario.clone(), plan.clone(), timing());
        let frame = |number: u64, action: Option<Action>, blocked: bool| {
            let pose = Pose::new(Point2::new(1.5, 0.9), 0.0);
            let pixels = vec![128; scenario.vision.values()];
            let (sonar, moved) = (vec![1.0; 16], Vec::new());
            let (view, boundary) = (View::Observation(pixels), Some(Boundary { blocked }));
            let marks = Vec::new();
            let truth = Some(pose);
            let rewards = Vec::new();
            Frame {
                number,
                stamp_ns: number,
                view,
                truth,
                odometry: Some(Pose::new(Point2::new(0.0, 0.1 * number as f64), 0.2 * number as f64)),
                sonar,
                action,
                boundary,
                moved,
                marks,
                goto: None,
                rewards,
            }
        };
        let mut steps = Vec::new();
        let mut see = |frame| {
            let perceived = perceive.step(frame);
            let end = &perceived.seen.sample.boundary.as_ref().unwrap().0;
            assert_eq!(end.step, perceived.percept.as_ref().unwrap().outcomes.step);
            steps.push(end.step);
            (perceived.percept.unwrap().recent, perceived.seen.sample.boundary)
        };
        assert_eq!(see(frame(0, None, false)).0, Recent::default());
        see(frame(1, Some(Action::TURN_LEFT), false));
        let (recent, boundary) = see(frame(2, Some(Action::FORWARD), true));
        assert_eq!(recent, Recent { action: Some(Action::TURN_LEFT), blocked: Some(Action::FORWARD), standing: 2 });
        // Only the same turn may follow, and that is what values will count on.
        assert_eq!(boundary.unwrap().1, 1 << Action::TURN_LEFT.index());

        // It is the same after it was saved and restored.
        let mut snapshot = Snapshot::new();
        perceive.persist(&mut snapshot).unwrap();
        let mut again = Perceive::new(scenario.clone(), plan, timing());
        again.persist(&mut Snapshot::restoring(snapshot.matrices, snapshot.texts)).unwrap();
        assert_eq!(again.recent, recent);

        // Each is told by odometry what it did; nothing is known of what was before the first, nor of an interruption.
        let behind = again.step(frame(3, Some(Action::TURN_LEFT), false)).percept.unwrap();
        steps.push(behind.outcomes.step);
        assert_eq!(steps[0], None);
        for (step, heading) in steps[1..].iter().flatten().zip([0.0f64, 0.2, 0.4]) {
            // Straight to the left of where it stood first, 0.1 m.
            let along = 0.1 * (heading + 0.1).sin();
            assert!((step.turn - 0.2).abs() < 1e-12 && (step.distance.unwrap() - along).abs() < 1e-12, "{step:?}");
        }
        assert_eq!(steps.iter().flatten().count(), 3);
        let set = ["value.odometry=false".to_owned()];
        let told = Arc::new(Scenario::parse(text, std::path::Path::new("lab.toml"), &set).unwrap());
        let mut told = Perceive::new(told.clone(), Arc::new(Plan::new(&told).unwrap()), timing());
        let percepts = [frame(0, None, false), frame(1, Some(Action::TURN_LEFT), false)].map(|frame| told.step(frame));
        assert!(percepts.iter().all(|of| of.percept.as_ref().unwrap().outcomes.step.is_none()));
        let interrupted = again.step(frame(4, None, false)).percept.unwrap();
        assert_eq!((interrupted.recent, interrupted.outcomes.step), (Recent::default(), None));
    }
}
