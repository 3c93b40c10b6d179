//! Where a robot is among the states of the past.

use std::collections::HashSet;
use std::ops::Range;

use faer::{Mat, MatRef};
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::belief::{Belief, draw};
use super::looks::{self, Looks};
use super::metric::{OF_POSE, PlaceMetric};
use super::states::{LEAST_CHANCE, PlaceMap};
use super::{GoalPlaces, Pose};
use crate::random::stream;
use crate::value::error::parameter;
use crate::value::local::finite_points;
use crate::value::{MapStep, ValueError};

/// Particles of a robot that may be anywhere: places of states, of so many at most, up to a share of a move and some radians.
const SCATTERED: usize = 2000;
const PLACES: usize = 8192;
const UP_TO: (f64, f64) = (0.3, 0.05);
/// Whatever is believed, with this probability the robot is anywhere; and of what a goal that is not there has proved wrong, this share
/// is. So many particles stand for that.
const DOUBT: f64 = 0.02;
const REFUTED: f64 = 0.1;
const DOUBTS: usize = 10;
/// Of so many states, others at each step.
const DOUBTED: usize = 1024;
/// A robot that expects what it sees by less than this (running mean of a logarithm) does not know where it is.
const LOST: f64 = -0.3;

impl PlaceMap {
    /// A map of states that have their places: points of a metric, `(p + 4) × n`. Of points that are the same, as those of actions from
    /// one state are, one counts.
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
        let mut known = HashSet::new();
        let bits = |j: usize| points.col(j).iter().map(|x| x.to_bits()).collect::<Vec<u32>>();
        let states: Vec<usize> = (0..points.ncols()).filter(|&j| known.insert(bits(j))).collect();
        let pose = |&j: &usize| {
            let [x, y, cos, sin] = [0, 1, 2, 3].map(|i| f64::from(points[(p + i, j)]));
            Some(Pose { x, y, heading: sin.atan2(cos) })
        };
        let seen = Mat::from_fn(p, states.len(), |i, j| metric.seen(points[(i, states[j])]));
        Ok(PlaceMap::begin(seen, states.iter().map(pose).collect(), metric))
    }

    /// Go on with a belief: by the step that the robot has made, `None` where nothing is known of it, and by what it sees then,
    /// `p` coordinates, and by whether it is in the goals, by task, `None` where nobody says it. A robot that has not expected what it sees for some time begins anew, anywhere.
    ///
    /// # Errors
    /// Another number of coordinates than the states have, values that are not finite.
    pub fn follow(
        &self,
        belief: &mut Belief,
        step: Option<MapStep>,
        seen: &[f32],
        in_goal: &[Option<bool>],
    ) -> Result<(), ValueError> {
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
                let told = self.goals.iter().zip(in_goal).filter_map(|(goal, told)| Some((goal, (*told)?)));
                let told: Vec<(&GoalPlaces, bool)> = told.collect();
                let told = belief.weigh(|pose| told.iter().map(|(goal, told)| goal.log_probability(pose, *told)).sum());
                self.look(belief, seen, 0..0, (looks::KNOWN, told), &mut rng);
                let doubt = DOUBT.max(REFUTED * (1.0 - told.exp()));
                belief.doubt(doubt, self.scattered(seen, 0..0, (DOUBTED, DOUBTS), &mut rng).into_iter());
            }
        }
        belief.resample(&mut rng);
        Ok(())
    }

    /// Weigh a belief by what is seen; where that was not expected for long, it begins anew. How much it was expected, and whether
    /// it goes on. `told`: how much what else was perceived had been expected.
    pub(super) fn look(
        &self,
        belief: &mut Belief,
        seen: &[f32],
        without: Range<usize>,
        (unseen, told): (f64, f64),
        rng: &mut impl Rng,
    ) -> (f64, bool) {
        let mut looks = Looks::new(self, seen, without.clone(), unseen);
        let expected = belief.weigh(|pose| looks.log_ratio(pose));
        belief.expected(told + expected);
        let goes_on = belief.expected > LOST;
        if !goes_on {
            *belief = Belief { draws: belief.draws, ..self.anywhere(seen, without, rng) };
        }
        (expected, goes_on)
    }

    /// Where a robot may be that sees this: at states that look alike. No particles where no state has a place.
    pub(super) fn anywhere(&self, seen: &[f32], without: Range<usize>, rng: &mut impl Rng) -> Belief {
        let share = 1.0 / SCATTERED as f64;
        let particles =
            self.scattered(seen, without, (PLACES, SCATTERED), rng).into_iter().map(|pose| (pose, share)).collect();
        Belief { particles, expected: 0.0, draws: 0 }
    }

    /// Around those of so many states that look alike, so many poses.
    fn scattered(
        &self,
        seen: &[f32],
        without: Range<usize>,
        (of, count): (usize, usize),
        rng: &mut impl Rng,
    ) -> Vec<Pose> {
        let every = self.poses.len().div_ceil(of).max(1);
        let first = if every > 1 { rng.random_range(0..every) } else { 0 };
        let states = (first as u32..self.poses.len() as u32).step_by(every);
        let placed = states.filter(|&state| !without.contains(&(state as usize)));
        let placed: Vec<(Pose, f64)> = placed
            .filter_map(|state| Some((self.poses[state as usize]?, self.likeness(state, seen) + LEAST_CHANCE)))
            .collect();
        let drawn = if placed.is_empty() { Vec::new() } else { draw(placed.iter().map(|of| of.1), count, rng) };
        let mut normal = || -> f64 { StandardNormal.sample(&mut *rng) };
        let mut scatter = |pose: Pose| Pose {
            x: pose.x + UP_TO.0 * normal(),
            y: pose.y + UP_TO.0 * normal(),
            heading: pose.heading + UP_TO.1 * normal(),
        };
        drawn.iter().map(|&of| scatter(placed[of as usize].0)).collect()
    }
}

pub(super) fn check(MapStep { turn, distance }: MapStep) -> Result<(), ValueError> {
    let distance = distance.unwrap_or(0.0);
    parameter("turn", turn, turn.is_finite(), "finite")?;
    parameter("distance", distance, distance.is_finite(), "finite")
}
