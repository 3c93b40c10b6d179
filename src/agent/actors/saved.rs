//! What several actors keep in a snapshot of the run: models, policies, actions, places.

use std::collections::BTreeMap;
use std::sync::Arc;

use faer::Mat;
use nalgebra::Point2;

use super::messages::Marked;
use crate::kernel::Kernel;
use crate::policy::{FloorMap, GoalRegion, Learned, Recent};
use crate::robot::{Action, MOST_ACTIONS};
use crate::slow::{Link, SlowModel};
use crate::snapshot::{Snapshot, SnapshotError};
use crate::value::place::{GoalPlaces, PlaceMetric};
use crate::value::{Instances, LocalOptions, MapStep};
use crate::vision::Observation;

/// What was learned.
pub fn learned(snapshot: &mut Snapshot, name: &str, learned: &mut Option<Arc<Learned>>) -> Result<(), SnapshotError> {
    snapshot.scope(name, |snapshot| {
        let of = learned.as_ref();
        let mut numbers = of.map(|of| (of.epoch, of.asked_at, of.frames, of.weights.len()));
        snapshot.value("there", &mut numbers)?;
        // NaN is a place that nobody knows.
        let bits = |goal: &Option<[f64; 2]>| goal.unwrap_or([f64::NAN; 2]).map(f64::to_bits);
        let mut goals: Vec<[u64; 2]> = of.map_or(Vec::new(), |of| of.goals.iter().map(bits).collect());
        let Some((epoch, asked_at, frames, tasks)) = numbers else { return Ok(()) };
        snapshot.value("goals", &mut goals)?;
        let mut model = of.map(|of| of.model.clone());
        slow_model(snapshot, "model", &mut model)?;
        let mut weights: Vec<Mat<f64>> = of.map_or(Vec::new(), |of| of.weights.clone());
        for task in 0..tasks {
            let mut of_task = weights.get(task).cloned().unwrap_or_else(Mat::new);
            snapshot.matrix(&format!("weights.{task}"), &mut of_task, |rows, columns| (rows, columns))?;
            if snapshot.is_restoring() {
                weights.push(of_task);
            }
        }
        let mut heedless: Vec<Mat<f64>> = of.map_or(Vec::new(), |of| of.heedless.clone());
        matrices(snapshot, "heedless", &mut heedless)?;
        let mut rare: Vec<Mat<f64>> = of.map_or(Vec::new(), |of| of.rare.clone());
        matrices(snapshot, "rare", &mut rare)?;
        let mut instances = of.and_then(|of| of.instances.clone());
        places(snapshot, &mut instances)?;
        let fits = |of: &Mat<f64>| (instances.as_ref().map_or(0, |of| of.len()), 1) == (of.nrows(), of.ncols());
        snapshot.check("rare", rare.iter().all(fits), "of other transitions")?;
        let mut metric = of.and_then(|of| of.places.as_ref()).map(|map| map.metric().to_bits());
        snapshot.value("place_metric", &mut metric)?;
        let mut goal_places = of.and_then(|of| of.places.as_ref()).map_or(Vec::new(), |map| map.goals().to_vec());
        let mut count = goal_places.len();
        snapshot.value("goal_places", &mut count)?;
        goal_places.resize_with(count, GoalPlaces::default);
        for (task, of_task) in goal_places.iter_mut().enumerate() {
            let mut matrix = of_task.to_matrix();
            snapshot.matrix(&format!("goal_places.{task}"), &mut matrix, |rows, columns| (rows, columns))?;
            *of_task = GoalPlaces::from_matrix(&matrix).map_err(|cause| wrong("goal_places", cause))?;
        }
        let mut map = of.and_then(|of| of.map.clone());
        floor_map(snapshot, &mut map, instances.as_ref().filter(|_| metric.is_none()))?;
        let mut regions = of.map_or(Vec::new(), |of| of.regions.clone());
        goal_regions(snapshot, &mut regions)?;
        if let Some(model) = model.filter(|_| snapshot.is_restoring()) {
            let places = metric.map(PlaceMetric::from_bits);
            let restored = Learned::of((epoch, asked_at, frames), model, weights, instances, places);
            let goal = |bits: [u64; 2]| Some(bits.map(f64::from_bits)).filter(|goal| !goal[0].is_nan());
            let restored =
                restored.map(|learned| learned.with_heedless(heedless).with_rare(rare).with_goal_places(goal_places));
            let restored = restored.map(|learned| learned.for_goals(goals.into_iter().map(goal).collect()));
            let restored = restored.and_then(|learned| learned.with_regions(map, regions));
            *learned = Some(Arc::new(restored.map_err(|cause| wrong("learned", cause))?));
        }
        Ok(())
    })
}

/// Where states lie on the floor, those of local values or others.
fn floor_map(
    snapshot: &mut Snapshot,
    map: &mut Option<FloorMap>,
    of_values: Option<&Arc<Instances>>,
) -> Result<(), SnapshotError> {
    snapshot.scope("map", |snapshot| {
        let mut there = map.is_some();
        snapshot.value("there", &mut there)?;
        if !there {
            return Ok(());
        }
        let mut coordinates = map.as_ref().map_or(Mat::new(), FloorMap::places);
        snapshot.matrix("places", &mut coordinates, |rows, columns| (rows, columns))?;
        let mut states = of_values.or(map.as_ref().map(FloorMap::instances)).cloned();
        if of_values.is_none() {
            places(snapshot, &mut states)?;
        }
        if let Some(states) = states.filter(|_| snapshot.is_restoring()) {
            *map = Some(FloorMap::new(states, coordinates.as_ref()).map_err(|cause| wrong("map", cause))?);
        }
        Ok(())
    })
}

/// What counts as being at places that were shown.
fn goal_regions(snapshot: &mut Snapshot, regions: &mut Vec<Option<GoalRegion>>) -> Result<(), SnapshotError> {
    let head = |region: &GoalRegion| [region.within(), region.unlike()].map(f64::to_bits);
    let mut heads: Vec<Option<[u64; 2]>> = regions.iter().map(|region| region.as_ref().map(head)).collect();
    snapshot.value("regions", &mut heads)?;
    for (task, head) in heads.into_iter().enumerate() {
        let of = regions.get(task).and_then(Option::as_ref);
        let mut marks = of.map_or(Mat::new(), |of| of.marks().to_owned());
        let mut marked = of.map_or(Mat::new(), |of| of.marked().to_owned());
        if head.is_some() {
            let room = |rows: usize, columns: usize| (rows, columns);
            snapshot.matrix(&format!("region.{task}.marks"), &mut marks, room)?;
            snapshot.matrix(&format!("region.{task}.marked"), &mut marked, room)?;
        }
        if snapshot.is_restoring() {
            let region = head.map(|bits| {
                let [within, unlike] = bits.map(f64::from_bits);
                GoalRegion::from_parts(marks, marked, within, unlike)
            });
            regions.push(region.transpose().map_err(|cause| wrong("regions", cause))?);
        }
    }
    Ok(())
}

/// Where actions were tried, of local values.
fn places(snapshot: &mut Snapshot, instances: &mut Option<Arc<Instances>>) -> Result<(), SnapshotError> {
    snapshot.scope("instances", |snapshot| {
        let of = instances.as_ref();
        let mut there = of.map(|of| (of.counts().to_vec(), of.options().neighbours, of.options().ridge.to_bits()));
        snapshot.value("there", &mut there)?;
        let Some((counts, neighbours, ridge)) = there else { return Ok(()) };
        let mut points = of.map_or(Mat::new(), |of| of.points().to_owned());
        snapshot.matrix("points", &mut points, |rows, columns| (rows, columns))?;
        if snapshot.is_restoring() {
            let options = LocalOptions { neighbours, ridge: f64::from_bits(ridge) };
            *instances =
                Some(Arc::new(Instances::new(points, counts, options).map_err(|cause| wrong("instances", cause))?));
        }
        Ok(())
    })
}

/// A model over a radial kernel, as a scenario's are.
pub fn slow_model(
    snapshot: &mut Snapshot,
    name: &str,
    model: &mut Option<SlowModel<f32>>,
) -> Result<(), SnapshotError> {
    snapshot.scope(name, |snapshot| {
        let room = |rows: usize, columns: usize| (rows, columns);
        let of = model.as_ref();
        let mut there = of.is_some();
        snapshot.value("there", &mut there)?;
        if !there {
            return Ok(());
        }
        let mut sigma = of.and_then(|of| of.kernel.sigma()).unwrap_or(f64::NAN);
        let mut exponent = of.and_then(|of| of.kernel.exponent()).unwrap_or(f64::NAN);
        let mut members = of.map_or(Mat::new(), |of| of.members.as_ref().clone());
        let mut projection = of.map_or(Mat::new(), |of| of.projection.clone());
        let mut offset = of.map_or(Vec::new(), |of| of.offset.clone());
        let mut slowness = of.map_or(Vec::new(), |of| of.slowness.clone());
        snapshot.number("sigma", &mut sigma)?;
        snapshot.number("exponent", &mut exponent)?;
        snapshot.matrix("members", &mut members, room)?;
        snapshot.matrix("projection", &mut projection, room)?;
        snapshot.numbers("offset", &mut offset)?;
        snapshot.numbers("slowness", &mut slowness)?;
        if snapshot.is_restoring() {
            let kernel = Kernel::radial(sigma, exponent).map_err(|cause| wrong("kernel", cause))?;
            let restored = SlowModel::from_parts(kernel, members, projection, offset, slowness);
            *model = Some(restored.map_err(|cause| wrong("model", cause))?);
        }
        Ok(())
    })
}

/// Bits of a link.
pub fn link_bits(link: Link) -> (u64, u64) {
    (link.dt.to_bits(), link.weight.to_bits())
}

/// A link from its bits.
pub fn link_of((dt, weight): (u64, u64)) -> Link {
    Link { dt: f64::from_bits(dt), weight: f64::from_bits(weight) }
}

/// A step, bit by bit: its turn, and its distance where that is known.
pub type StepBits = (u64, Option<u64>);

/// Bits of a step.
pub fn step_bits(step: MapStep) -> StepBits {
    (step.turn.to_bits(), step.distance.map(f64::to_bits))
}

/// A step from its bits.
pub fn step_from((turn, distance): StepBits) -> MapStep {
    MapStep { turn: f64::from_bits(turn), distance: distance.map(f64::from_bits) }
}

/// Bits of a place.
pub fn place_bits(place: Point2<f64>) -> [u64; 2] {
    [place.x.to_bits(), place.y.to_bits()]
}

/// A place from its bits.
pub fn place_of(bits: [u64; 2]) -> Point2<f64> {
    bits.map(f64::from_bits).into()
}

/// An action from its number.
pub fn action_of(snapshot: &Snapshot, number: usize) -> Result<Action, SnapshotError> {
    let action = Action::first(MOST_ACTIONS).nth(number);
    snapshot.check("action", action.is_some(), "no action has this number")?;
    Ok(action.unwrap_or(Action::FORWARD))
}

/// What the robot did last, by the numbers of actions.
pub fn recent_numbers(recent: Recent) -> ([Option<usize>; 2], u32) {
    ([recent.action, recent.blocked].map(|action| action.map(Action::index)), recent.standing)
}

/// What the robot did last, from the numbers of actions.
pub fn recent_of(
    snapshot: &Snapshot,
    ([action, blocked], standing): ([Option<usize>; 2], u32),
) -> Result<Recent, SnapshotError> {
    let of = |number: Option<usize>| number.map(|number| action_of(snapshot, number)).transpose();
    Ok(Recent { action: of(action)?, blocked: of(blocked)?, standing })
}

pub fn wrong(name: &str, cause: impl std::fmt::Display) -> SnapshotError {
    SnapshotError::Wrong { name: name.to_owned(), cause: cause.to_string() }
}

/// A mark: its task, the frame of its observation, and the bits of its place.
pub type SavedMark = (usize, u64, Option<[u64; 2]>);

/// Observations that several others refer to by their frames: each is kept once.
#[derive(Default)]
pub struct Observations {
    observations: BTreeMap<u64, Arc<Observation>>,
}

impl Observations {
    /// Take note of one, and name it by its frame.
    pub fn add(&mut self, observation: &Arc<Observation>) -> u64 {
        self.observations.entry(observation.frame).or_insert_with(|| observation.clone()).frame
    }

    /// One that was added.
    pub fn get(&self, frame: u64) -> Result<Arc<Observation>, SnapshotError> {
        self.observations
            .get(&frame)
            .cloned()
            .ok_or_else(|| SnapshotError::Missing(format!("the observation of frame {frame}")))
    }

    /// A mark; its observation is added.
    pub fn add_mark(&mut self, marked: &Marked) -> SavedMark {
        (marked.task, self.add(&marked.observation), marked.place.map(|at| at.map(f64::to_bits)))
    }

    /// A mark whose observation was added.
    pub fn mark(&self, (task, frame, place): SavedMark) -> Result<Marked, SnapshotError> {
        Ok(Marked { task, observation: self.get(frame)?, place: place.map(|bits| bits.map(f64::from_bits)) })
    }

    /// Save or restore all of them, each of `values` pixels.
    pub fn persist(&mut self, snapshot: &mut Snapshot, values: usize) -> Result<(), SnapshotError> {
        let mut frames: Vec<u64> = self.observations.keys().copied().collect();
        let mut pixels = Vec::with_capacity(if snapshot.is_restoring() { 0 } else { values * frames.len() });
        self.observations.values().for_each(|seen| pixels.extend_from_slice(&seen.pixels));
        snapshot.value("seen", &mut frames)?;
        snapshot.numbers("seen_pixels", &mut pixels)?;
        snapshot.check("seen_pixels", pixels.len() == values * frames.len(), "another number than the frames have")?;
        if snapshot.is_restoring() {
            let of = |(frame, pixels): (u64, &[u8])| (frame, Arc::new(Observation { frame, pixels: pixels.to_vec() }));
            self.observations = frames.into_iter().zip(pixels.chunks_exact(values)).map(of).collect();
        }
        Ok(())
    }
}

/// Any number of matrices.
fn matrices(snapshot: &mut Snapshot, name: &str, of: &mut Vec<Mat<f64>>) -> Result<(), SnapshotError> {
    let mut count = of.len();
    snapshot.value(name, &mut count)?;
    of.resize_with(count, Mat::new);
    let mut numbered = of.iter_mut().enumerate();
    numbered.try_for_each(|(number, matrix)| {
        snapshot.matrix(&format!("{name}.{number}"), matrix, |rows, columns| (rows, columns))
    })
}
