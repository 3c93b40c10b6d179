//! What was seen where: states of the past with their places.

use std::ops::Range;

use faer::{Mat, MatRef};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

use super::belief::{Belief, draw};
use super::looks::{self, Cells, Looks};
use super::metric::{MotionNoise, OF_POSE, PlaceMetric};
use super::{Pose, placing};
use crate::random::stream;
use crate::value::error::parameter;
use crate::value::local::finite_points;
use crate::value::{MapStep, ValueError};

/// Width of likeness: so many times as far as states are from the third of those that are most like them and were not met beside them.
const WIDTH: f64 = 1.3;
const THIRD: usize = 2;
pub(super) const BESIDE: usize = 60;
/// An image that is less like what was seen at a pose than this share of what like images have in common is no match.
const ALIKE: f64 = 0.02;
/// However rare an image is, it is seen by chance with this likeness.
const LEAST_CHANCE: f64 = 1e-6;
/// Images that count as alike: so many of all that are most like one.
const LIKE: usize = 8;
/// States that tell how often such an image is seen by chance.
const ASKED: usize = 256;
/// Particles of a robot that may be anywhere: places of states, of so many at most, up to a share of a move and some radians.
const SCATTERED: usize = 2000;
const PLACES: usize = 8192;
const UP_TO: (f64, f64) = (0.3, 0.05);
/// A robot that expects what it sees by less than this (running mean of a logarithm) does not know where it is.
const LOST: f64 = -0.3;

/// States of the past, where they are known to lie.
#[derive(Debug, Clone)]
pub struct PlaceMap {
    pub(super) metric: PlaceMetric,
    /// `p × n`.
    pub(super) points: Mat<f32>,
    pub(super) poses: Vec<Option<Pose>>,
    pub(super) cells: Cells,
    /// Images are at least so much alike by chance.
    by_chance: f64,
}

impl PlaceMap {
    /// Place states in the order in which they were met. `None` where there is nothing to begin with: no two states that differ,
    /// or no moves.
    ///
    /// # Shapes
    /// `points: p × n`, as near as they look alike, such as slow features; `steps`: `n − 1`, between each state and the next one,
    /// `None` where something else happened; `before`: `n` poses of an earlier map, `None` where there is none.
    ///
    /// # Errors
    /// Shapes that do not fit, values that are not finite, noise outside its ranges.
    pub fn new(
        points: Mat<f32>,
        steps: &[Option<MapStep>],
        before: &[Option<Pose>],
        noise: MotionNoise,
    ) -> Result<Option<Self>, ValueError> {
        let n = points.ncols();
        let length = |what, found, expected| {
            if found == expected { Ok(()) } else { Err(ValueError::Length { what, found, expected }) }
        };
        length("the steps", steps.len(), n.saturating_sub(1))?;
        length("the poses before", before.len(), n)?;
        noise.check()?;
        steps.iter().flatten().try_for_each(|&step| check(step))?;
        finite_points("points", points.as_ref())?;
        for pose in before.iter().flatten() {
            let numbers = [("x", pose.x), ("y", pose.y), ("heading", pose.heading)];
            numbers.into_iter().try_for_each(|(name, value)| parameter(name, value, value.is_finite(), "finite"))?;
        }
        let moves: Vec<f64> = steps.iter().flatten().filter_map(|step| step.distance.filter(|d| *d != 0.0)).collect();
        let Some(width) = width(points.as_ref()).filter(|_| !moves.is_empty()) else { return Ok(None) };
        let unit = moves.iter().map(|distance| distance.abs()).sum::<f64>() / moves.len() as f64;
        let mut map = PlaceMap::begin(points, vec![None; n], PlaceMetric { noise, unit, width });
        placing::place(&mut map, steps, before);
        Ok(Some(map))
    }

    /// A map of states that have their places: points of a metric, `(p + 4) × n`.
    ///
    /// # Errors
    /// Points that are not finite or have too few coordinates, a metric whose noise is outside its ranges, or with lengths that are
    /// not above 0.
    pub fn of_points(points: MatRef<'_, f32>, metric: PlaceMetric) -> Result<Self, ValueError> {
        metric.noise.check()?;
        for (name, value) in [("unit", metric.unit), ("width", metric.width)] {
            parameter(name, value, value > 0.0 && value.is_finite(), "above 0")?;
        }
        finite_points("points", points)?;
        let p = PlaceMetric::features(points.nrows());
        if p == 0 {
            return Err(ValueError::Features { what: "points", found: points.nrows(), expected: OF_POSE + 1 });
        }
        let pose = |j: usize| {
            let [x, y, cos, sin] = [0, 1, 2, 3].map(|i| f64::from(points[(p + i, j)]));
            Some(Pose { x, y, heading: sin.atan2(cos) })
        };
        let seen = Mat::from_fn(p, points.ncols(), |i, j| metric.seen(points[(i, j)]));
        Ok(PlaceMap::begin(seen, (0..points.ncols()).map(pose).collect(), metric))
    }

    fn begin(points: Mat<f32>, poses: Vec<Option<Pose>>, metric: PlaceMetric) -> Self {
        let cells = Cells::of(&poses);
        let mut map = PlaceMap { metric, points, poses, cells, by_chance: 0.0 };
        map.by_chance = (ALIKE * map.likeness_of_like()).max(LEAST_CHANCE);
        map
    }

    /// How near its states are.
    pub fn metric(&self) -> PlaceMetric {
        self.metric
    }

    /// Where states lie, `n`; `None`: not known.
    pub fn poses(&self) -> &[Option<Pose>] {
        &self.poses
    }

    /// The states, `p × n`.
    pub fn points(&self) -> MatRef<'_, f32> {
        self.points.as_ref()
    }

    /// Go on with a belief: by the step that the robot has made, `None` where nothing is known of it, and by what it sees then,
    /// `p` coordinates. A robot that has not expected what it sees for some time begins anew, anywhere.
    ///
    /// # Errors
    /// Another number of coordinates than the states have, values that are not finite.
    pub fn follow(&self, belief: &mut Belief, step: Option<MapStep>, seen: &[f32]) -> Result<(), ValueError> {
        if seen.len() != self.points.nrows() {
            let (what, found, expected) = ("what is seen", seen.len(), self.points.nrows());
            return Err(ValueError::Features { what, found, expected });
        }
        finite_points("what is seen", MatRef::from_column_major_slice(seen, seen.len(), 1))?;
        step.map_or(Ok(()), check)?;
        let mut rng = stream(belief.draws, "belief");
        belief.draws += 1;
        match step.filter(|_| !belief.particles.is_empty()) {
            None => *belief = Belief { draws: belief.draws, ..self.anywhere(seen, 0..0, &mut rng) },
            Some(step) => {
                belief.drive(self.metric.noise, step, self.metric.unit, &mut rng);
                self.look(belief, seen, 0..0, looks::KNOWN, &mut rng);
            }
        }
        belief.resample(&mut rng);
        Ok(())
    }

    /// Weigh a belief by what is seen; where that was not expected for long, it begins anew. How much it was expected, and whether
    /// it goes on.
    pub(super) fn look(
        &self,
        belief: &mut Belief,
        seen: &[f32],
        without: Range<usize>,
        unseen: f64,
        rng: &mut impl Rng,
    ) -> (f64, bool) {
        let mut looks = Looks::new(self, seen, without.clone(), unseen);
        let expected = belief.weigh(|pose| looks.log_ratio(pose));
        let goes_on = belief.expected > LOST;
        if !goes_on {
            *belief = Belief { draws: belief.draws, ..self.anywhere(seen, without, rng) };
        }
        (expected, goes_on)
    }

    /// Where a robot may be that sees this: at states that look alike. No particles where no state has a place.
    pub(super) fn anywhere(&self, seen: &[f32], without: Range<usize>, rng: &mut impl Rng) -> Belief {
        let every = self.poses.len().div_ceil(PLACES);
        let states = (0..self.poses.len() as u32).step_by(every.max(1));
        let placed = states.filter(|&state| !without.contains(&(state as usize)));
        let placed: Vec<(Pose, f64)> = placed
            .filter_map(|state| Some((self.poses[state as usize]?, self.likeness(state, seen) + LEAST_CHANCE)))
            .collect();
        let drawn = if placed.is_empty() { Vec::new() } else { draw(placed.iter().map(|of| of.1), SCATTERED, rng) };
        let share = 1.0 / SCATTERED as f64;
        let mut normal = || -> f64 { StandardNormal.sample(&mut *rng) };
        let mut scatter = |pose: Pose| Pose {
            x: pose.x + UP_TO.0 * normal(),
            y: pose.y + UP_TO.0 * normal(),
            heading: pose.heading + UP_TO.1 * normal(),
        };
        let particles = drawn.iter().map(|&of| (scatter(placed[of as usize].0), share)).collect();
        Belief { particles, expected: 0.0, draws: 0 }
    }

    /// How alike such an image is by chance.
    pub(super) fn chance(&self, seen: &[f32], without: &Range<usize>) -> f64 {
        let of = asked(self.points.ncols()).filter(|state| !without.contains(state));
        let (sum, count) =
            of.fold((0.0, 0), |(sum, count), state| (sum + self.likeness(state as u32, seen), count + 1));
        (sum / f64::from(count.max(1))).max(self.by_chance)
    }

    pub(super) fn likeness(&self, state: u32, seen: &[f32]) -> f64 {
        // Columns of a matrix of our own lie in one piece.
        let Some(of) = self.points.col(state as usize).try_as_col_major() else { return 0.0 };
        let squared: f32 = of.as_slice().iter().zip(seen).map(|(&a, &b)| (a - b) * (a - b)).sum();
        (-0.5 * f64::from(squared) / (self.metric.width * self.metric.width)).exp()
    }

    /// How alike images are that are most alike.
    fn likeness_of_like(&self) -> f64 {
        let n = self.points.ncols();
        let of = |state: usize| {
            let seen: Vec<f32> = self.points.col(state).iter().copied().collect();
            let mut alike: Vec<f64> = (0..n as u32).map(|other| self.likeness(other, &seen)).collect();
            let place = LIKE.min(n - 1);
            *alike.select_nth_unstable_by(place, |a, b| b.total_cmp(a)).1
        };
        asked(n).map(of).sum::<f64>() / ASKED.min(n) as f64
    }
}

fn check(MapStep { turn, distance }: MapStep) -> Result<(), ValueError> {
    let distance = distance.unwrap_or(0.0);
    parameter("turn", turn, turn.is_finite(), "finite")?;
    parameter("distance", distance, distance.is_finite(), "finite")
}

fn asked(n: usize) -> impl Iterator<Item = usize> {
    (0..ASKED.min(n)).map(move |k| k * n / ASKED.min(n))
}

/// Width of likeness; `None` where no states differ.
fn width(points: MatRef<'_, f32>) -> Option<f64> {
    let n = points.ncols();
    let third = |state: usize| {
        let others = (0..n).filter(|&other| other.abs_diff(state) > BESIDE.min(n / 4));
        let mut apart: Vec<f32> =
            others.map(|other| (points.col(other) - points.col(state)).squared_norm_l2()).collect();
        // Robots stand before a wall and see the same again and again.
        apart.retain(|apart| *apart > 0.0 && apart.is_finite());
        let third = THIRD.min(apart.len().saturating_sub(1));
        (!apart.is_empty()).then(|| apart.select_nth_unstable_by(third, f32::total_cmp).1.sqrt())
    };
    let mut apart: Vec<f32> = asked(n).filter_map(third).collect();
    let middle = apart.len() / 2;
    (!apart.is_empty()).then(|| f64::from(*apart.select_nth_unstable_by(middle, f32::total_cmp).1) * WIDTH)
}
