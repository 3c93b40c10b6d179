//! Where the states of the past lie.

use std::collections::VecDeque;
use std::ops::Range;

use faer::Mat;
use rand::Rng;

use super::Pose;
use super::belief::{Belief, mode};
use super::looks::{GROWS, KNOWN};
use super::map::check;
use super::metric::{MotionNoise, PlaceMetric};
use super::states::{BESIDE, Cells, PlaceMap, width};
use crate::kernel::products::map_all;
use crate::random::stream;
use crate::value::MapStep;
use crate::value::ValueError;
use crate::value::error::parameter;
use crate::value::local::finite_points;

/// Tries from nothing: of the first map, and of each one behind it.
const TRIES: [u64; 2] = [6, 2];
/// A map from nothing must have expected what was seen by so much more than one that goes on, a logarithm for each state: who knows the
/// one need not learn another.
const BETTER: f64 = 0.02;
/// How often all ways are followed in a try.
const SWEEPS: usize = 3;
/// Where no other map is looked for, as often.
const GOING_ON: usize = 1;
/// How often the map that stays is straightened, and all ways followed once more: where another one was looked for, and where not.
const ROUNDS: [usize; 2] = [3, 1];
/// A state belongs to the map when so many others came behind it; so many are placed in one go.
const LAG: usize = 40;
const AT_ONCE: usize = 10;
/// A state has a place if particles lie there with this probability, and what was seen lately was expected by more than this (a
/// logarithm).
const SETTLED: f64 = 0.6;
const EXPECTED: f64 = 0.0;
/// A way that is shorter than this says too little.
const SHORT: usize = 12;
/// Particles of a robot whose place is known.
const PARTICLES: usize = 200;

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
        PlaceMap::of_ways(points, steps, (before, true), noise)
    }

    /// The same from what is known alone: states that are new are placed on the map before, all others once more, and no other map is
    /// looked for. That takes a sixth of the sweeps. Where next to nothing is known it is as [`new`](PlaceMap::new).
    ///
    /// # Errors
    /// As `new`.
    pub fn go_on(
        points: Mat<f32>,
        steps: &[Option<MapStep>],
        before: &[Option<Pose>],
        noise: MotionNoise,
    ) -> Result<Option<Self>, ValueError> {
        PlaceMap::of_ways(points, steps, (before, false), noise)
    }

    fn of_ways(
        points: Mat<f32>,
        steps: &[Option<MapStep>],
        (before, anew): (&[Option<Pose>], bool),
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
        let (Some(width), Some(unit)) = (width(points.as_ref()), length_of_move(steps)) else { return Ok(None) };
        let mut map = PlaceMap::begin(points, vec![None; n], PlaceMetric { noise, unit, width });
        place(&mut map, steps, (before, anew));
        Ok(Some(map))
    }
}

/// Place the states of a map that has none with a place, from those that are known from another; `anew`: and see whether another map is
/// better.
fn place(map: &mut PlaceMap, steps: &[Option<MapStep>], (before, anew): (&[Option<Pose>], bool)) {
    let ways = ways(steps);
    let goes_on = before.iter().flatten().count() > PARTICLES;
    let anew = anew || !goes_on;
    let (tries, sweeps) = if anew { (TRIES[usize::from(goes_on)], SWEEPS) } else { (0, GOING_ON) };
    let first = u64::from(!goes_on);
    let from = &*map;
    let attempt = |number: usize| {
        let number = first + number as u64;
        let mut map = from.clone();
        map.poses = if number == 0 { before.to_vec() } else { vec![None; before.len()] };
        map.cells = Cells::of(&map.poses);
        let mut expected = 0.0;
        for sweep in 0..sweeps {
            let mut rng = stream(before.len() as u64, &format!("places {number} {sweep}"));
            expected = follow(&mut map, (&ways, !anew), steps, &mut rng);
        }
        if number == 0 {
            expected += BETTER * before.len() as f64;
        }
        (expected, map.poses, map.cells)
    };
    let attempts = map_all((tries + 1 - first) as usize, attempt);
    // Of equal ones the first.
    let best = attempts.into_iter().reduce(|best, of| if of.0 > best.0 { of } else { best });
    let Some((_, poses, cells)) = best else { return };
    (map.poses, map.cells) = (poses, cells);
    for round in 0..ROUNDS[usize::from(!anew)] {
        map.relax(&ways, steps);
        let mut rng = stream(before.len() as u64, &format!("places straightened {round}"));
        follow(map, (&ways, true), steps, &mut rng);
    }
}

/// Follow all ways that are not too short; how much what was seen was expected in all. `stay`: they begin where they lay before.
fn follow(
    map: &mut PlaceMap,
    (ways, stay): (&[Range<usize>], bool),
    steps: &[Option<MapStep>],
    rng: &mut impl Rng,
) -> f64 {
    let ways = ways.iter().filter(|way| way.len() >= SHORT);
    ways.map(|way| Track::new(map, (way.clone(), stay), steps).run(rng)).sum()
}

/// A way that is followed.
struct Track<'a> {
    map: &'a mut PlaceMap,
    way: Range<usize>,
    steps: &'a [Option<MapStep>],
    belief: Belief,
    /// Particles of the last states, and of each one which of those of the state before it comes from.
    trail: VecDeque<Vec<(Pose, u32)>>,
    /// The first way of all, which tells where everything else lies.
    is_first: bool,
    /// It begins where that lay before.
    stays: bool,
    /// Whether it begins at a known place and was never lost since, or has come to one: otherwise the map does not grow, as nobody knows
    /// where.
    known: bool,
    joined: bool,
}

impl<'a> Track<'a> {
    fn new(map: &'a mut PlaceMap, (way, stays): (Range<usize>, bool), steps: &'a [Option<MapStep>]) -> Self {
        let is_first = map.poses.iter().all(Option::is_none);
        Track {
            map,
            way,
            steps,
            belief: Belief::default(),
            trail: VecDeque::new(),
            is_first,
            stays,
            known: false,
            joined: false,
        }
    }

    /// Place its states; how much what was seen was expected in all, a logarithm.
    fn run(mut self, rng: &mut impl Rng) -> f64 {
        let mut sum = 0.0;
        for state in self.way.clone() {
            let seen: Vec<f32> = self.map.points.col(state).iter().copied().collect();
            let without = state.saturating_sub(BESIDE)..state + BESIDE;
            let mut goes_on = true;
            if state > self.way.start {
                let step = self.steps[state - 1].expect("a way has a step between any two states");
                let metric = self.map.metric;
                self.belief.drive(metric.noise, step, metric.unit, rng);
                let unseen = if self.known || self.joined { GROWS } else { KNOWN };
                let (expected, on) = self.map.look(&mut self.belief, &seen, without, (unseen, 0.0), rng);
                (sum, goes_on) = (sum + expected, on);
                self.known &= goes_on;
                self.joined = goes_on && (self.joined || self.belief.expected > GROWS);
            } else {
                self.begin(state, &seen, without, rng);
            }
            self.remember(goes_on);
            if state + 1 == self.way.end {
                self.settle(state, self.trail.len());
            } else if self.trail.len() == LAG + AT_ONCE {
                self.settle(state, AT_ONCE);
            }
            if let (Some(drawn), Some(last)) = (self.belief.resample(rng), self.trail.back_mut()) {
                *last = drawn.iter().map(|&of| last[of as usize]).collect();
            }
        }
        sum
    }

    fn begin(&mut self, state: usize, seen: &[f32], without: Range<usize>, rng: &mut impl Rng) {
        // Where another map is looked for, where it lay is no more than a guess.
        let known = if self.is_first { Some(Pose::default()) } else { self.map.poses[state] };
        self.known = known.is_some();
        if known.is_none() || !self.stays {
            self.belief = self.map.anywhere(seen, without, rng);
        }
        let share = 1.0 / PARTICLES as f64;
        self.belief.particles.extend(known.into_iter().flat_map(|pose| [(pose, share); PARTICLES]));
        let sum = self.belief.particles.iter().map(|of| of.1).sum::<f64>();
        self.belief.particles.iter_mut().for_each(|of| of.1 /= sum);
    }

    /// Where particles are; `goes_on`: they come from those before.
    fn remember(&mut self, goes_on: bool) {
        if !goes_on {
            // What has led to nowhere tells nothing.
            self.trail.iter_mut().for_each(Vec::clear);
        }
        let of = self.belief.particles.iter().zip(0..);
        self.trail.push_back(of.map(|(of, place)| (of.0, place)).collect());
    }

    /// Place the first states of the trail, so many.
    fn settle(&mut self, last: usize, count: usize) {
        let first = last + 1 - self.trail.len();
        let knows = self.is_first || (self.known || self.joined) && self.belief.expected > EXPECTED;
        let mut at: Vec<u32> = (0..self.belief.particles.len() as u32).collect();
        for (place, particles) in self.trail.iter().enumerate().rev() {
            if particles.is_empty() {
                // They began behind it.
                at.clear();
            }
            if place < count {
                let weights = self.belief.particles.iter().map(|of| of.1);
                let came_from: Vec<(Pose, f64)> =
                    at.iter().zip(weights).map(|(&of, weight)| (particles[of as usize].0, weight)).collect();
                let (pose, share) = mode(&came_from);
                let pose = (knows && share > SETTLED).then_some(pose);
                let state = first + place;
                self.map.cells.place(state as u32, self.map.poses[state], pose);
                self.map.poses[state] = pose;
            }
            at.iter_mut().for_each(|of| *of = particles[*of as usize].1);
        }
        self.trail.drain(..count);
    }
}

/// The median length of moves that are half as long as the longest one or longer: measured ones that a wall has stopped are shorter,
/// and measured turns move a robot a little. `None`: there are no moves.
fn length_of_move(steps: &[Option<MapStep>]) -> Option<f64> {
    let lengths = steps.iter().flatten().filter_map(|step| step.distance).map(f64::abs);
    let longest = lengths.clone().fold(0.0, f64::max);
    let mut moves: Vec<f64> = lengths.filter(|&length| length > 0.0 && length >= 0.5 * longest).collect();
    let middle = moves.len() / 2;
    (!moves.is_empty()).then(|| *moves.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Stretches of states with a step between any two of them.
fn ways(steps: &[Option<MapStep>]) -> Vec<Range<usize>> {
    let mut ways = Vec::new();
    let mut start = 0;
    for (state, step) in steps.iter().enumerate() {
        if step.is_none() {
            ways.push(start..state + 1);
            start = state + 1;
        }
    }
    ways.push(start..steps.len() + 1);
    ways
}
