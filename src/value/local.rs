//! Local values: the value of an action, estimated from the transitions nearby in which it was tried.
//!
//! Least-squares policy iteration finds values in the span of a few smooth features: a goal that is smaller than their
//! wavelength is lost. Here features only say which states are near each other. The value of an action is a local linear
//! regression on the nearest transitions with that action, and what each of those is worth follows from what came after it:
//!
//! `Q(x, a) = Σ_i w_i(x) Q_i` over the nearest transitions `i` with `a_i = a`, `Q_i = r_i + γ max_b Q(x′_i, b)`
//!
//! The weights depend on neither rewards nor policy: they are found once, and tasks share them. Where a penalty is bounded
//! ([`LocalOutcomes::bounded`], a rule of our own) and what follows is worth more than 0, it takes at most half of that.
//!
//! # How to use it
//! [`LocalBatch`](super::LocalBatch) takes transitions one by one and gives [`LocalValues`](super::LocalValues), with a greedy policy for any
//! point; the example
//! `local_values` finds a way through a room with it. Who has matrices, several tasks, or rules of what may follow uses
//! [`Instances`] (where actions were tried), [`Local`] (what the ends of transitions are near to) and [`Local::fit`] (one task).
//!
//! - All depends on distances: the coordinates of a point should be in units in which states that are near are alike. Where a thin
//!   wall separates two places, coordinates of the plane call them near; slow features do not.
//! - Where points lie and how they are scaled does not matter, but for what `f32` itself can hold ([`LocalBatch`](super::LocalBatch) takes `f64`).
//! - Of an action that was never tried nothing is known: its value is −∞, and no greedy policy takes it. To try it is up to
//!   exploration.
//! - [`Fit::converged`] says that values settled, not that the policy is good: see [`Local::arrival`].
//!
//! # Numerics
//! Points are `f32`, all else is `f64`. Neighbours are searched by products in single precision, and again in double precision
//! where its rounding could matter: that takes about ten times as long. Where two coordinates are so wide that few points are near in
//! them, as those of a place, only these are looked at. All runs on the threads of the process, if there is
//! the feature `rayon`, and has the same bits on any number of them: each point is computed alone.
//!
//! # Reference
//! Ormoneit & Sen 2002 (kernel-based reinforcement learning: the same with averages in place of regressions); Ernst, Geurts &
//! Wehenkel 2005 (fitted Q iteration); Atkeson, Moore & Schaal 1997 (locally weighted regression).

use std::cmp::Ordering;
use std::ops::Range;

use faer::{Mat, MatRef};

use super::error::{discount, finite_list, finite_matrix, parameter};
use super::nearest::{Grid, Move, nearest, rounding, widest};
use super::{Fit, ValueError};
use crate::kernel::products::{dot, map_all};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// States whose neighbours are searched in one product.
pub(super) const AT_ONCE: usize = 128;
/// The least weight of a neighbour, before regression, as a share of the mean.
const LEAST_WEIGHT: f64 = 1e-3;
/// Neighbours found in single precision are trusted where its rounding is at most this share of the squared distance of the last
/// one; elsewhere they are searched again in double precision.
const TRUSTED: f64 = 1.0 / 16.0;
/// How many points tell whether a grid pays: where less than this share of all has to be looked at.
const GRID_ASKED: usize = 32;
const GRID_SHARE: f64 = 1.0 / 8.0;
/// Tasks that are fitted together, with values that are summed side by side.
const TASKS: usize = 8;
/// Share of what follows a transition that its penalty takes at most, where penalties are bounded.
const PENALTY: f64 = 0.5;
/// Values have settled when none changes by more than this share of the largest.
pub(super) const SETTLED: f64 = 1e-6;
/// Sweeps until values must have settled, times `1 − γ`: what is left of the first ones then is e⁻²⁰.
pub(super) const SWEEPS: f64 = 20.0;
/// However near to 1 γ is, no more sweeps than these.
pub(super) const MOST_SWEEPS: f64 = 1e5;
/// Values may be as large as this, so that what a regression makes of them is finite.
const LARGEST: f64 = 1e300;

/// How values are estimated from those of neighbours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalOptions {
    /// Transitions with the same action that a value is estimated from, ≥ 1. More than there are: all of them.
    pub neighbours: usize,
    /// Ridge on the slopes of the regression, in mean squared distances of the neighbours, > 0. Large values leave a weighted
    /// mean.
    pub ridge: f64,
}

/// 16 neighbours and a ridge of 0.3, as the agent has them.
impl Default for LocalOptions {
    fn default() -> Self {
        LocalOptions { neighbours: 16, ridge: 0.3 }
    }
}

impl LocalOptions {
    fn check(&self) -> Result<(), ValueError> {
        parameter("neighbours", self.neighbours as f64, self.neighbours >= 1, "at least 1")?;
        parameter("ridge", self.ridge, self.ridge > 0.0 && self.ridge.is_finite(), "> 0 and finite")
    }
}

/// Where actions were tried: the states before transitions, as points whose distance says how near they are.
///
/// Points may lie anywhere and be of any scale: where it matters, neighbours are searched around the mean of all points and in units
/// of their spread. Only what `f32` itself cannot hold is lost: points 10⁶ times as far from the origin as from each other have
/// one digit left.
///
/// # Shapes
/// `p × N` points, those of action 0 first, then those of action 1, and so on.
#[derive(Debug, Clone, PartialEq)]
pub struct Instances {
    options: LocalOptions,
    points: Mat<f32>,
    counts: Vec<usize>,
    /// How points are moved for the search of neighbours, and the moved points; `None` where they are searched as they are.
    moved: Option<(Move, Mat<f32>)>,
    /// Squared norm of each point of the search.
    norms: Vec<f32>,
    /// The points of each action by two of their coordinates, where that leaves few to be looked at.
    grid: Option<Vec<Grid>>,
}

/// The transitions that values are estimated from, list by list: their numbers, and how much each counts. The weights of a list sum to 1.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Neighbours {
    /// Where each list ends.
    ends: Vec<usize>,
    places: Vec<u32>,
    weights: Vec<f64>,
}

impl Neighbours {
    /// Number of lists.
    fn len(&self) -> usize {
        self.ends.len()
    }

    fn push(&mut self, list: impl Iterator<Item = (u32, f64)>) {
        for (place, weight) in list {
            self.places.push(place);
            self.weights.push(weight);
        }
        self.ends.push(self.places.len());
    }

    /// The lists of several, one after the other.
    pub fn concat(parts: Vec<Neighbours>) -> Self {
        let sizes = |size: fn(&Neighbours) -> usize| parts.iter().map(size).sum::<usize>();
        let (lists, entries) = (sizes(|part| part.ends.len()), sizes(|part| part.places.len()));
        let mut all = Neighbours {
            ends: Vec::with_capacity(lists),
            places: Vec::with_capacity(entries),
            weights: Vec::with_capacity(entries),
        };
        for part in parts {
            let before = all.places.len();
            all.ends.extend(part.ends.iter().map(|end| before + end));
            all.places.extend(part.places);
            all.weights.extend(part.weights);
        }
        all
    }

    /// A list; empty of an action that was never tried.
    #[inline]
    pub fn of(&self, number: usize) -> impl Iterator<Item = (u32, f64)> {
        let range = if number == 0 { 0 } else { self.ends[number - 1] }..self.ends[number];
        self.places[range.clone()].iter().copied().zip(self.weights[range].iter().copied())
    }

    /// A value from what the neighbours of a list are worth.
    #[inline]
    pub fn estimate(&self, number: usize, worth: &[f64]) -> f64 {
        self.of(number).map(|(place, weight)| weight * worth[place as usize]).sum()
    }
}

impl Instances {
    /// Transitions of actions, `counts` of each, from these states.
    ///
    /// # Errors
    /// No transitions, counts that do not add up to the number of points, values that are not finite, options outside their
    /// ranges.
    pub fn new(points: Mat<f32>, counts: Vec<usize>, options: LocalOptions) -> Result<Self, ValueError> {
        options.check()?;
        let (n, dimensions) = (points.ncols(), points.nrows());
        if n == 0 {
            return Err(ValueError::Empty);
        }
        if counts.is_empty() {
            return Err(ValueError::NoActions);
        }
        if dimensions == 0 {
            return Err(ValueError::Features { what: "points", found: 0, expected: 1 });
        }
        let found = counts.iter().fold(0usize, |sum, &count| sum.saturating_add(count));
        if found != n {
            return Err(ValueError::Length { what: "the counts of actions together", found, expected: n });
        }
        finite_points("points", points.as_ref())?;
        let moved = Move::of(points.as_ref()).map(|of| {
            let moved = of.apply(points.as_ref());
            (of, moved)
        });
        let searched = moved.as_ref().map_or(&points, |(_, moved)| moved);
        let norms = (0..n).map(|j| searched.col(j).squared_norm_l2()).collect();
        let mut instances = Instances { options, points, counts, moved, norms, grid: None };
        // Their distances are in single precision.
        instances.grid = if instances.moved.is_none() { instances.grids() } else { None };
        Ok(instances)
    }

    /// Number of transitions `N`.
    pub fn len(&self) -> usize {
        self.points.ncols()
    }

    /// Never: there is at least one transition.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The points, `p × N`.
    pub fn points(&self) -> MatRef<'_, f32> {
        self.points.as_ref()
    }

    /// Transitions of each action.
    pub fn counts(&self) -> &[usize] {
        &self.counts
    }

    /// How values are estimated from those of neighbours.
    pub fn options(&self) -> LocalOptions {
        self.options
    }

    /// `Q(x, a)` of states, `p × n` points, for each list of what the transitions are worth (`N`): `A × n` for each. Of an
    /// action that was never tried nothing is known: its value is −∞, so that no greedy policy takes it.
    ///
    /// # Errors
    /// Points of another dimension or not finite, another number of worths than of transitions.
    pub fn action_values(&self, worths: &[&[f64]], points: MatRef<'_, f32>) -> Result<Vec<Mat<f64>>, ValueError> {
        self.check_points("points", points)?;
        if let Some(worth) = worths.iter().find(|worth| worth.len() != self.len()) {
            return Err(ValueError::Length { what: "worth", found: worth.len(), expected: self.len() });
        }
        let mut values = vec![Mat::zeros(self.counts.len(), points.ncols()); worths.len()];
        for start in (0..points.ncols()).step_by(AT_ONCE) {
            let block = points.subcols(start, AT_ONCE.min(points.ncols() - start));
            for a in 0..self.counts.len() {
                let near = self.neighbours(a, block);
                for j in 0..block.ncols() {
                    for (values, worth) in values.iter_mut().zip(worths) {
                        values[(a, start + j)] =
                            if self.counts[a] == 0 { f64::NEG_INFINITY } else { near.estimate(j, worth) };
                    }
                }
            }
        }
        Ok(values)
    }

    fn check_points(&self, what: &'static str, points: MatRef<'_, f32>) -> Result<(), ValueError> {
        if points.nrows() != self.points.nrows() {
            return Err(ValueError::Features { what, found: points.nrows(), expected: self.points.nrows() });
        }
        finite_points(what, points)
    }

    /// Places of an action's transitions.
    fn of_action(&self, action: usize) -> Range<usize> {
        let start: usize = self.counts[..action].iter().sum();
        start..start + self.counts[action]
    }

    /// Which transitions of an action tell its value at each point, on this thread; nothing of an action that was never tried.
    pub(super) fn neighbours(&self, action: usize, points: MatRef<'_, f32>) -> Neighbours {
        let mut regression = Regression::new(self, points);
        let of_action = self.of_action(action);
        let kept = self.kept(of_action.len());
        if kept == of_action.len() {
            (0..points.ncols()).for_each(|j| regression.add(j, of_action.clone().map(|place| place as u32)));
        } else if let Some(grid) = self.grid.as_ref().and_then(|grids| grids.get(action)) {
            for j in 0..points.ncols() {
                regression.add(j, grid.nearest(self.points.as_ref(), points.col(j), kept).0.into_iter());
            }
        } else {
            let moved = self.moved.as_ref().map(|(by, _)| by.apply(points));
            let searched = self.moved.as_ref().map_or(&self.points, |(_, moved)| moved);
            let at = moved.as_ref().map_or(points, |moved| moved.as_ref());
            let norms = &self.norms[of_action.clone()];
            let longest = f64::from(norms.iter().copied().fold(0.0, f32::max));
            let scale = self.moved.as_ref().map_or(1.0, |(by, _)| by.scale);
            let found = nearest(searched.as_ref().subcols(of_action.start, of_action.len()), norms, at, kept);
            for (j, found) in found.into_iter().enumerate() {
                let enough = found.len() == kept;
                let reach =
                    regression.look(j, found.into_iter().map(|place| of_action.start as u32 + place)) * scale * scale;
                let at = at.col(j).iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
                if !enough || rounding(points.nrows(), longest, at) > TRUSTED * reach {
                    regression.look(j, of_action.clone().map(|place| place as u32));
                }
                regression.solve();
            }
        }
        regression.found
    }

    /// One more than needed: the distance of that one is where weights end.
    fn kept(&self, count: usize) -> usize {
        self.options.neighbours.saturating_add(1).min(count)
    }

    /// Grids of all actions, if they leave few points to be looked at.
    fn grids(&self) -> Option<Vec<Grid>> {
        let points = self.points.as_ref();
        let axes = widest(points)?;
        let grids: Option<Vec<Grid>> =
            (0..self.counts.len()).map(|a| Grid::new(points, &axes, self.of_action(a))).collect();
        let grids = grids?;
        let asked = GRID_ASKED.min(points.ncols());
        let looked_at = |k: usize| {
            let at = points.col(k * points.ncols() / asked);
            let of = grids.iter().zip(&self.counts).filter(|(_, count)| **count > 0);
            of.map(|(grid, &count)| grid.nearest(points, at, self.kept(count)).1).sum::<usize>()
        };
        let share = (0..asked).map(looked_at).sum::<usize>() as f64 / (asked * points.ncols()) as f64;
        (share < GRID_SHARE).then_some(grids)
    }
}

/// Weights of the nearest transitions in the values at some points: those of a linear regression with ridge on its slopes.
///
/// With differences `D` to the point and weights `u` by distance, the intercept that minimises
/// `Σ u_i (q_i − c − bᵀD_i)² + ρ‖b‖²` is `c = 1ᵀG⁻¹q / 1ᵀG⁻¹1` with `G = DᵀD/ρ + diag(u)⁻¹`.
struct Regression<'a> {
    instances: &'a Instances,
    at: MatRef<'a, f32>,
    /// Squared distance of each transition that was looked at, its number, and its place in the differences.
    near: Vec<(f64, u32, usize)>,
    /// Their differences to the point, `p` after `p`.
    differences: Vec<f64>,
    /// The lower triangle of `G`, by rows; then of its factor.
    gram: Vec<f64>,
    weights: Vec<f64>,
    found: Neighbours,
}

impl<'a> Regression<'a> {
    fn new(instances: &'a Instances, at: MatRef<'a, f32>) -> Self {
        let (near, differences, gram, weights) = Default::default();
        Regression { instances, at, near, differences, gram, weights, found: Neighbours::default() }
    }

    /// Look at some transitions from a point; the largest squared distance.
    fn look(&mut self, j: usize, places: impl Iterator<Item = u32>) -> f64 {
        self.near.clear();
        self.differences.clear();
        let p = self.at.nrows();
        for (number, place) in places.enumerate() {
            let pairs = self.instances.points.col(place as usize).iter().zip(self.at.col(j).iter());
            self.differences.extend(pairs.map(|(&of, &at)| f64::from(of) - f64::from(at)));
            let difference = &self.differences[p * number..];
            self.near.push((dot(difference, difference), place, number));
        }
        self.near.iter().map(|near| near.0).fold(0.0, f64::max)
    }

    fn add(&mut self, j: usize, places: impl Iterator<Item = u32>) {
        self.look(j, places);
        self.solve();
    }

    /// The weights of the nearest of those that were looked at are the next list.
    fn solve(&mut self) {
        let (p, options) = (self.at.nrows(), &self.instances.options);
        self.near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        // Weights end at the first one that does not count.
        let last = self.near.get(options.neighbours).or(self.near.last()).map_or(0.0, |near| near.0);
        let reach = if self.near.len() > options.neighbours { last } else { 2.0 * last };
        self.near.truncate(options.neighbours);
        let k = self.near.len();
        let mean = self.near.iter().map(|near| near.0).sum::<f64>() / k as f64;
        self.weights.clear();
        self.weights.resize(k, 1.0);
        if k > 1 && mean > 0.0 {
            let by_distance = |near: &(f64, u32, usize)| (1.0 - near.0 / reach).max(0.0);
            let mean_weight = (self.near.iter().map(by_distance).sum::<f64>() / k as f64).max(f64::MIN_POSITIVE);
            let slopes = 1.0 / (options.ridge * mean);
            let difference = |near: &(f64, u32, usize)| &self.differences[p * near.2..][..p];
            self.gram.clear();
            for (r, row) in self.near.iter().enumerate() {
                self.gram
                    .extend(self.near[..=r].iter().map(|column| slopes * dot(difference(row), difference(column))));
                self.gram[r * (r + 3) / 2] += 1.0 / (by_distance(row) / mean_weight).max(LEAST_WEIGHT);
            }
            if !solve_positive(&mut self.gram, &mut self.weights) {
                // It is positive definite unless numbers overflow: then a mean.
                self.weights.fill(1.0);
            }
        }
        let sum: f64 = self.weights.iter().sum();
        self.found.push(self.near.iter().zip(&self.weights).map(|(near, weight)| (near.1, weight / sum)));
    }
}

/// Replace `x` by `G⁻¹x` for a positive definite `G`, of which the rows of the lower triangle stand one after the other and become those
/// of its Cholesky factor. False, and anything in `x`, if it is not positive definite. For the few rows here a library's calls take longer than the work.
fn solve_positive(g: &mut [f64], x: &mut [f64]) -> bool {
    let k = x.len();
    let row = |r: usize| r * (r + 1) / 2;
    for r in 0..k {
        let (above, rest) = g.split_at_mut(row(r));
        let this = &mut rest[..=r];
        for c in 0..r {
            let column = &above[row(c)..][..=c];
            let (before, value) = this[..=c].split_at_mut(c);
            value[0] = (value[0] - dot(before, &column[..c])) / column[c];
        }
        let (before, pivot) = this.split_at_mut(r);
        let square = pivot[0] - dot(before, before);
        if !(square > 0.0 && square.is_finite()) {
            return false;
        }
        pivot[0] = square.sqrt();
        x[r] = (x[r] - dot(before, &x[..r])) / pivot[0];
    }
    for r in (0..k).rev() {
        let (before, pivot) = g[row(r)..][..=r].split_at(r);
        x[r] /= pivot[0];
        let value = x[r];
        x[..r].iter_mut().zip(before).for_each(|(x, g)| *x -= g * value);
    }
    true
}

/// Restored into any other.
#[cfg(feature = "snapshot")]
impl Persist for Instances {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        let (mut points, mut counts, mut options) = (self.points.clone(), self.counts.clone(), self.options);
        snapshot.matrix("points", &mut points, |rows, columns| (rows, columns))?;
        snapshot.value("counts", &mut counts)?;
        snapshot.value("neighbours", &mut options.neighbours)?;
        snapshot.number("ridge", &mut options.ridge)?;
        match Instances::new(points, counts, options) {
            Ok(instances) => *self = instances,
            Err(cause) => return snapshot.check("points", false, &cause.to_string()),
        }
        Ok(())
    }
}

/// Columns that differ in any bit, by the first of each, and for all columns the number of the one that they equal.
fn distinct_columns(points: MatRef<'_, f32>) -> (Vec<usize>, Vec<u32>) {
    let order = |&a: &usize, &b: &usize| {
        let pairs = points.col(a).iter().zip(points.col(b).iter());
        pairs.map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne()).unwrap_or(Ordering::Equal)
    };
    let mut sorted: Vec<usize> = (0..points.ncols()).collect();
    // Stable: the first of equal ones stays the first.
    sorted.sort_by(order);
    let mut first: Vec<usize> = vec![0; points.ncols()];
    for equal in sorted.chunk_by(|a, b| order(a, b).is_eq()) {
        equal.iter().for_each(|&of| first[of] = equal[0]);
    }
    let (mut distinct, mut numbers) = (Vec::new(), Vec::with_capacity(first.len()));
    for (place, &first) in first.iter().enumerate() {
        if first == place {
            distinct.push(place);
            numbers.push((distinct.len() - 1) as u32);
        } else {
            numbers.push(numbers[first]);
        }
    }
    (distinct, numbers)
}

pub(super) fn finite_points(what: &'static str, points: MatRef<'_, f32>) -> Result<(), ValueError> {
    if points.is_all_finite() {
        return Ok(());
    }
    finite_matrix(what, Mat::from_fn(points.nrows(), points.ncols(), |i, j| f64::from(points[(i, j)])).as_ref())
}

/// What a reward and what follows are worth together, see [`LocalOutcomes::bounded`].
pub(super) fn worth_of(reward: f64, next: f64, bounded: bool) -> f64 {
    let worth = reward + next;
    if bounded && next > 0.0 { worth.max((1.0 - PENALTY) * next) } else { worth }
}

/// Values of all actions at each end, for some tasks; −∞ of actions that were never tried.
struct EndValues {
    values: Vec<f64>,
    actions: usize,
    tasks: usize,
}

impl EndValues {
    #[inline]
    fn of(&self, end: u32, action: usize, task: usize) -> f64 {
        self.values[(end as usize * self.actions + action) * self.tasks + task]
    }
}

/// What came of each transition, for one task; in the order of [`Instances`].
#[derive(Debug, Clone, Copy)]
pub struct LocalOutcomes<'a> {
    /// Rewards, `N`.
    pub rewards: &'a [f64],
    /// Which actions may follow each transition, as bits, `N`; as in [`Outcomes::allowed`](super::Outcomes::allowed).
    pub allowed: &'a [u32],
    /// Whether the episode ended with a transition, `N`: nothing follows it then.
    pub ended: &'a [bool],
    /// Whether a transition's penalty, a reward below 0, is bounded, `N`: it then takes at most half of what follows, where that is
    /// above 0. However small a goal's reward is, and however far it is, the way there is then worth more than to stay where nothing is
    /// gained or lost; a penalty that is small beside what follows counts as it is.
    pub bounded: &'a [bool],
}

/// Transitions whose ends know their neighbours: the part of the problem that tasks share.
#[derive(Debug)]
pub struct Local<'a> {
    instances: &'a Instances,
    /// Number of each transition's end. Several transitions may end in one state.
    ends: Vec<u32>,
    /// For each action which transitions tell its value at each end.
    after: Vec<Neighbours>,
}

impl<'a> Local<'a> {
    /// Find the neighbours of the states after each transition, `p × N`. `N N′p` products for `N′` states that differ, beside the
    /// regressions; what is found takes `12 A N′` bytes for each neighbour, and does not depend on the number of threads.
    ///
    /// # Errors
    /// Another number or dimension of points than there are transitions, values that are not finite.
    pub fn new(instances: &'a Instances, ends: MatRef<'_, f32>) -> Result<Self, ValueError> {
        if ends.ncols() != instances.len() {
            return Err(ValueError::Length { what: "the ends", found: ends.ncols(), expected: instances.len() });
        }
        instances.check_points("ends", ends)?;
        let (distinct, numbers) = distinct_columns(ends);
        let of_block = |number: usize| {
            let places = &distinct[number * AT_ONCE..distinct.len().min((number + 1) * AT_ONCE)];
            let block = Mat::from_fn(ends.nrows(), places.len(), |i, j| ends[(i, places[j])]);
            (0..instances.counts.len()).map(|a| instances.neighbours(a, block.as_ref())).collect::<Vec<Neighbours>>()
        };
        let blocks = map_all(distinct.len().div_ceil(AT_ONCE), of_block);
        let mut of_actions: Vec<Vec<Neighbours>> = vec![Vec::with_capacity(blocks.len()); instances.counts.len()];
        for block in blocks {
            of_actions.iter_mut().zip(block).for_each(|(all, part)| all.push(part));
        }
        Ok(Local { instances, ends: numbers, after: of_actions.into_iter().map(Neighbours::concat).collect() })
    }

    /// What each transition is worth, for one task, as the one column of [`Fit::weights`]: for [`Instances::action_values`].
    ///
    /// Values stay within those that the rewards allow, so that they cannot run away where a regression extrapolates. Whether
    /// they settled is in the result; regressions, unlike averages, are no contraction, and there are at most 100 000 sweeps, which
    /// may be too few for γ above 0.9998.
    ///
    /// # Errors
    /// Lists of other lengths than there are transitions, one after which nothing may follow, more than 32 actions, rewards that
    /// are not finite or make values above 1e300, γ outside [0, 1).
    pub fn fit(&self, outcomes: &LocalOutcomes<'_>, gamma: f64) -> Result<Fit, ValueError> {
        Ok(self.fit_all(std::slice::from_ref(outcomes), gamma)?.remove(0))
    }

    /// The same for several tasks, in less time than for one after the other: neighbours are looked up once for eight of them, with
    /// `8 (3N + 2AN′)` bytes for each of these.
    ///
    /// # Errors
    /// Those of [`Local::fit`].
    pub fn fit_all(&self, tasks: &[LocalOutcomes<'_>], gamma: f64) -> Result<Vec<Fit>, ValueError> {
        let together = |tasks: &[LocalOutcomes<'_>]| self.fit_together(tasks, gamma);
        Ok(tasks.chunks(TASKS).map(together).collect::<Result<Vec<_>, _>>()?.concat())
    }

    fn fit_together(&self, tasks: &[LocalOutcomes<'_>], gamma: f64) -> Result<Vec<Fit>, ValueError> {
        discount(gamma)?;
        let (n, actions, count) = (self.instances.len(), self.instances.counts.len(), tasks.len());
        let range = |outcomes: &LocalOutcomes<'_>| {
            self.check(outcomes)?;
            let (least, most) = outcomes.rewards.iter().fold((0.0f64, 0.0f64), |(l, m), &r| (l.min(r), m.max(r)));
            let (least, most) = (least / (1.0 - gamma), most / (1.0 - gamma));
            if most.max(-least) > LARGEST { Err(ValueError::NotFinite(n)) } else { Ok((least, most)) }
        };
        let ranges = tasks.iter().map(range).collect::<Result<Vec<(f64, f64)>, ValueError>>()?;
        // Of all tasks for one transition after the other.
        let mut worth = vec![0.0; n * count];
        let untried: Vec<usize> = (0..actions).filter(|&a| self.instances.counts[a] == 0).collect();
        let fit = Fit { weights: Mat::new(), iterations: 0, converged: false, cycle: None, untried };
        let mut fits = vec![fit; count];
        for sweep in 1..=(SWEEPS / (1.0 - gamma)).min(MOST_SWEEPS).ceil() as usize {
            if fits.iter().all(|fit| fit.converged) {
                break;
            }
            let values = self.values(&worth, count);
            let of = |i: usize, task: usize| {
                let (outcomes, (least, most)) = (&tasks[task], ranges[task]);
                if fits[task].converged {
                    return worth[i * count + task];
                }
                if outcomes.ended[i] {
                    return outcomes.rewards[i];
                }
                let next =
                    gamma * self.best_after(outcomes.allowed[i], |action| values.of(self.ends[i], action, task)).1;
                worth_of(outcomes.rewards[i], next, outcomes.bounded[i]).clamp(least, most)
            };
            let of_block = |block: usize| {
                let transitions = block * AT_ONCE..n.min((block + 1) * AT_ONCE);
                let mut new = Vec::with_capacity(transitions.len() * count);
                transitions.for_each(|i| new.extend((0..count).map(|task| of(i, task))));
                new
            };
            let new = map_all(n.div_ceil(AT_ONCE), of_block).concat();
            let (mut size, mut change) = (vec![0.0f64; count], vec![0.0f64; count]);
            for (new, old) in new.chunks(count).zip(worth.chunks(count)) {
                for task in 0..count {
                    size[task] = size[task].max(new[task].abs());
                    change[task] = change[task].max((new[task] - old[task]).abs());
                }
            }
            worth = new;
            for (task, fit) in fits.iter_mut().enumerate().filter(|(_, fit)| !fit.converged) {
                fit.iterations = sweep;
                fit.converged = change[task] <= SETTLED * size[task];
            }
        }
        for (task, fit) in fits.iter_mut().enumerate() {
            fit.weights = Mat::from_fn(n, 1, |i, _| worth[i * count + task]);
        }
        Ok(fits)
    }

    /// The share of transitions after which the greedy policy arrives: it gets a reward above 0, or ends the episode. The others run
    /// in circles. [`Fit::converged`] does not tell one from the other.
    ///
    /// From the end of a transition it goes on with the nearest one of the greedy action, then from the end of that one, and so
    /// on. Where the world is random that is one of the ways it may take. Transitions that ended their episode do not count.
    ///
    /// # Errors
    /// Outcomes that [`Local::fit`] refuses, a fit of other transitions.
    pub fn arrival(&self, outcomes: &LocalOutcomes<'_>, fit: &Fit) -> Result<f64, ValueError> {
        self.check(outcomes)?;
        let n = self.instances.len();
        if fit.weights.nrows() != n || fit.weights.ncols() != 1 {
            let found = fit.weights.nrows() * fit.weights.ncols();
            return Err(ValueError::Length { what: "the weights of the fit", found, expected: n });
        }
        let worth: Vec<f64> = fit.weights.col(0).iter().copied().collect();
        let values = self.values(&worth, 1);
        // An action that was tried has a nearest transition.
        let nearest = |i: usize| {
            let best = self.best_after(outcomes.allowed[i], |action| values.of(self.ends[i], action, 0)).0;
            self.after[best].of(self.ends[i] as usize).next()
        };
        let next: Vec<usize> = (0..n).map(|i| nearest(i).map_or(i, |near| near.0 as usize)).collect();
        let there = |i: usize| outcomes.ended[i] || outcomes.rewards[i] > 0.0;
        let mut arrives: Vec<Option<bool>> = (0..n).map(|i| there(i).then_some(true)).collect();
        for start in 0..n {
            let (mut path, mut at) = (Vec::new(), start);
            while arrives[at].is_none() {
                // Who comes here again runs in a circle.
                arrives[at] = Some(false);
                path.push(at);
                at = next[at];
            }
            path.into_iter().for_each(|i| arrives[i] = arrives[at]);
        }
        let going_on: Vec<usize> = (0..n).filter(|&i| !outcomes.ended[i]).collect();
        let arriving = going_on.iter().filter(|&&i| arrives[next[i]] == Some(true)).count();
        Ok(if going_on.is_empty() { 1.0 } else { arriving as f64 / going_on.len() as f64 })
    }

    /// Values of all actions at each end, from what the transitions are worth for `tasks` tasks.
    fn values(&self, worth: &[f64], tasks: usize) -> EndValues {
        let actions = self.instances.counts.len();
        let ends = self.after.first().map_or(0, Neighbours::len);
        let of_block = |block: usize| {
            let ends = block * AT_ONCE..ends.min((block + 1) * AT_ONCE);
            let mut values = vec![0.0; ends.len() * actions * tasks];
            let mut rows = values.chunks_mut(tasks);
            for end in ends {
                for (of, &tried) in self.after.iter().zip(&self.instances.counts) {
                    let Some(sums) = rows.next() else { continue };
                    if tried == 0 {
                        sums.fill(f64::NEG_INFINITY);
                        continue;
                    }
                    let (chunks, last) = sums.as_chunks_mut::<TASKS>();
                    for (chunk, to) in chunks.iter_mut().enumerate() {
                        let mut sums = [0.0; TASKS];
                        for (place, weight) in of.of(end) {
                            let (worth, _) = worth[place as usize * tasks..][..tasks].as_chunks::<TASKS>();
                            (0..TASKS).for_each(|task| sums[task] += weight * worth[chunk][task]);
                        }
                        *to = sums;
                    }
                    for (task, sum) in (tasks - last.len()..tasks).zip(last) {
                        *sum = of.of(end).map(|(place, weight)| weight * worth[place as usize * tasks + task]).sum();
                    }
                }
            }
            values
        };
        EndValues { values: map_all(ends.div_ceil(AT_ONCE), of_block).concat(), actions, tasks }
    }

    /// The best of the actions that are allowed, as bits, and its value; of those that were tried, and of all of these where none that
    /// is allowed was.
    #[inline]
    fn best_after(&self, allowed: u32, value: impl Fn(usize) -> f64) -> (usize, f64) {
        let best = |allowed: u32| {
            let mut best = (0, f64::NEG_INFINITY);
            for action in (0..self.instances.counts.len()).filter(|action| allowed & (1 << action) != 0) {
                let value = value(action);
                if value > best.1 {
                    best = (action, value);
                }
            }
            best
        };
        let found = best(allowed);
        if found.1 == f64::NEG_INFINITY { best(u32::MAX) } else { found }
    }

    fn check(&self, outcomes: &LocalOutcomes<'_>) -> Result<(), ValueError> {
        let (n, actions) = (self.instances.len(), self.instances.counts.len());
        if actions > u32::BITS as usize {
            return Err(ValueError::AllowedBits(actions));
        }
        let LocalOutcomes { rewards, allowed, ended, bounded } = outcomes;
        let lengths = [
            ("rewards", rewards.len()),
            ("allowed", allowed.len()),
            ("ended", ended.len()),
            ("bounded", bounded.len()),
        ];
        for (what, found) in lengths {
            if found != n {
                return Err(ValueError::Length { what, found, expected: n });
            }
        }
        finite_list("rewards", outcomes.rewards)?;
        match (0..n).find(|&i| (0..actions).all(|b| outcomes.allowed[i] & (1 << b) == 0)) {
            Some(index) => Err(ValueError::NothingAllowed { index, actions }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OPTIONS: LocalOptions = LocalOptions { neighbours: 4, ridge: 1e-6 };

    #[test]
    fn weights_reproduce_linear_functions() {
        // On a grid, seen from between its points.
        let points = Mat::from_fn(2, 49, |i, j| [(j % 7) as f32, (j / 7) as f32][i]);
        let instances = Instances::new(points.clone(), vec![49], LocalOptions { neighbours: 9, ridge: 1e-6 }).unwrap();
        let worth: Vec<f64> =
            (0..49).map(|j| 1.0 + 2.0 * f64::from(points[(0, j)]) - 3.0 * f64::from(points[(1, j)])).collect();
        for (x, y) in [(2.3f32, 3.1f32), (4.9, 1.2), (0.1, 5.7)] {
            let q =
                instances.action_values(&[&worth], Mat::from_fn(2, 1, |i, _| [x, y][i]).as_ref()).unwrap()[0][(0, 0)];
            let expected = 1.0 + 2.0 * f64::from(x) - 3.0 * f64::from(y);
            assert!((q - expected).abs() < 1e-3, "({x}, {y}): {q}, not {expected}");
        }
    }

    #[test]
    fn a_grid_finds_the_same_neighbours() {
        let mut state = 1u64;
        let mut random = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 40) as f32 / (1 << 24) as f32
        };
        // Two wide coordinates among narrow ones, of two actions and one that was never tried; and all alike.
        let wide = Mat::from_fn(11, 900, |i, _| random() * if i == 4 || i == 9 { 100.0 } else { 3.0 });
        let alike = Mat::from_fn(11, 900, |_, _| random());
        let options = LocalOptions { neighbours: 6, ridge: 0.3 };
        let instances = Instances::new(wide.clone(), vec![500, 0, 400], options).unwrap();
        let plain = Instances { grid: None, ..instances.clone() };
        assert!(instances.grid.is_some() && Instances::new(alike, vec![900], options).unwrap().grid.is_none());
        // Points of its own, between them, and far outside on all sides.
        let asked = Mat::from_fn(11, 60, |i, j| match j {
            0..20 => wide[(i, 7 * j)],
            20..50 => random() * if i == 4 || i == 9 { 100.0 } else { 3.0 },
            _ => 400.0 * random() - 150.0,
        });
        for action in 0..3 {
            let [found, expected] = [&instances, &plain].map(|of| of.neighbours(action, asked.as_ref()));
            assert_eq!(found, expected, "action {action}");
        }
        // However far: all points are then as far away.
        for far in [1e12, -1e30, f32::MAX] {
            let q = instances.action_values(&[&[1.0; 900]], Mat::from_fn(11, 1, |_, _| far).as_ref()).unwrap();
            assert!((q[0][(0, 0)] - 1.0).abs() < 1e-6 && (q[0][(2, 0)] - 1.0).abs() < 1e-6, "{far}: {q:?}");
        }
        // No more points than neighbours; all in one place.
        let few = Instances::new(wide.as_ref().subcols(0, 4).to_owned(), vec![4], options).unwrap();
        assert_eq!(few.neighbours(0, asked.as_ref()).of(25).count(), 4);
        assert!(Instances::new(Mat::zeros(11, 50), vec![50], options).unwrap().grid.is_none());
    }

    #[test]
    fn a_large_ridge_leaves_means_which_stay_between_the_neighbours() {
        let points = Mat::from_fn(1, 5, |_, j| j as f32);
        let instances = Instances::new(points, vec![5], LocalOptions { neighbours: 3, ridge: 1e9 }).unwrap();
        let worth = [0.0, 0.0, 1.0, 0.0, 0.0];
        let at = |x: f32| instances.action_values(&[&worth], Mat::from_fn(1, 1, |_, _| x).as_ref()).unwrap()[0][(0, 0)];
        // The nearest one counts more than each of the others, and all of them count.
        assert!(at(2.0) > 1.0 / 3.0 && at(2.4) > 1.0 / 3.0 && at(1.4) > 1.0 / 6.0);
        // Beyond the points too.
        assert!([2.0, 2.4, 1.4, -7.0, 12.0].into_iter().all(|x| (0.0..1.0).contains(&at(x))));
    }

    /// A corridor of states 0 … 10, left and right, the goal at its right end.
    fn corridor() -> (Mat<f32>, Mat<f32>, Vec<usize>, Vec<f64>) {
        let end = |action: usize, x: usize| if action == 0 { x.saturating_sub(1) } else { (x + 1).min(10) };
        let ends: Vec<usize> = (0..22).map(|i| end(i / 11, i % 11)).collect();
        let points = Mat::from_fn(1, 22, |_, i| (i % 11) as f32);
        let after = Mat::from_fn(1, 22, |_, i| ends[i] as f32);
        let rewards = ends.iter().map(|&x| f64::from(u8::from(x == 10))).collect();
        (points, after, vec![11, 11], rewards)
    }

    #[test]
    fn neighbours_of_an_end_are_searched_once() {
        let (points, after, counts, _) = corridor();
        let instances = Instances::new(points, counts, OPTIONS).unwrap();
        let local = Local::new(&instances, after.as_ref()).unwrap();
        // Numbered as they are met: 0 to 9 on the way to the left, then 10.
        let ends: Vec<u32> = (0..22).map(|i| after[(0, i)] as u32).collect();
        assert_eq!((local.ends, local.after[1].len()), (ends, 11));
        let near = instances.neighbours(1, Mat::from_fn(1, 1, |_, _| 7.0).as_ref());
        assert!(local.after[1].of(7).eq(near.of(0)));

        // All coordinates count, and all bits.
        let columns =
            Mat::from_fn(2, 6, |i, j| [[1.0, 1.0, 0.0, 1.0, -0.0, 1.0], [2.0, 3.0, 0.0, 2.0, 0.0, 3.0]][i][j]);
        assert_eq!(distinct_columns(columns.as_ref()), (vec![0, 1, 2, 4], vec![0, 1, 2, 0, 3, 1]));
    }

    #[test]
    fn values_of_a_corridor_are_the_exact_ones() {
        let (points, after, counts, rewards) = corridor();
        // A single neighbour: the table itself.
        let instances = Instances::new(points, counts, LocalOptions { neighbours: 1, ridge: 1.0 }).unwrap();
        let local = Local::new(&instances, after.as_ref()).unwrap();
        let outcomes = |ended| LocalOutcomes { rewards: &rewards, allowed: &[3; 22], ended, bounded: &[false; 22] };
        let fit = local.fit(&outcomes(&[false; 22]), 0.9).unwrap();
        assert!(fit.converged);
        for x in 0..11 {
            let exact = 0.9f64.powi((9 - x as i32).max(0)) / (1.0 - 0.9);
            assert!((fit.weights[(11 + x, 0)] - exact).abs() < 1e-4, "right of {x}: {}", fit.weights[(11 + x, 0)]);
        }
        let ended: Vec<bool> = rewards.iter().map(|&reward| reward > 0.0).collect();
        let fit = local.fit(&outcomes(&ended), 0.9).unwrap();
        assert!((fit.weights[(11 + 5, 0)] - 0.9f64.powi(4)).abs() < 1e-4);
    }

    #[test]
    fn tasks_together_have_the_values_that_each_has_alone() {
        let (points, after, mut counts, _) = corridor();
        // An action that was never tried, too.
        counts.push(0);
        let instances = Instances::new(points, counts, OPTIONS).unwrap();
        let local = Local::new(&instances, after.as_ref()).unwrap();
        // Ten goals, some of which end the episode: they settle one after the other.
        let rewards: Vec<Vec<f64>> =
            (0..10).map(|goal| (0..22).map(|i| f64::from(u8::from(after[(0, i)] == goal as f32))).collect()).collect();
        let ended: Vec<Vec<bool>> = rewards
            .iter()
            .enumerate()
            .map(|(goal, rewards)| rewards.iter().map(|&reward| goal % 2 == 0 && reward > 0.0).collect())
            .collect();
        let tasks: Vec<LocalOutcomes<'_>> = rewards
            .iter()
            .zip(&ended)
            .map(|(rewards, ended)| LocalOutcomes { rewards, allowed: &[7; 22], ended, bounded: &[false; 22] })
            .collect();
        let together = local.fit_all(&tasks, 0.9).unwrap();
        for (task, fit) in tasks.iter().zip(&together) {
            let alone = local.fit(task, 0.9).unwrap();
            assert!(fit.weights == alone.weights && fit.converged);
            assert_eq!((fit.iterations, &fit.untried), (alone.iterations, &vec![2]));
        }
        assert!(together.iter().any(|fit| fit.iterations != together[0].iterations));
        assert!(local.fit_all(&[], 0.9).unwrap().is_empty());
    }

    #[test]
    fn a_factor_solves_what_is_positive_definite_and_refuses_the_rest() {
        for k in [1, 2, 9, 23] {
            let g = |r: usize, c: usize| 1.0 / (1.0 + r.abs_diff(c) as f64) + if r == c { 1.0 } else { 0.0 };
            let mut lower: Vec<f64> = (0..k).flat_map(|r| (0..=r).map(move |c| g(r, c))).collect();
            let expected: Vec<f64> = (0..k).map(|i| 1.0 + i as f64).collect();
            let mut x: Vec<f64> = (0..k).map(|r| (0..k).map(|c| g(r, c) * expected[c]).sum()).collect();
            assert!(solve_positive(&mut lower, &mut x));
            assert!(x.iter().zip(&expected).all(|(x, expected)| (x - expected).abs() < 1e-12), "{k}: {x:?}");
        }
        assert!(!solve_positive(&mut [1.0, 2.0, 1.0], &mut [1.0, 1.0]));
        assert!(!solve_positive(&mut [f64::INFINITY], &mut [1.0]) && !solve_positive(&mut [f64::NAN], &mut [1.0]));
    }

    #[test]
    fn bounded_penalties_leave_the_way_to_a_goal_worth_going() {
        let (points, after, counts, mut rewards) = corridor();
        let instances = Instances::new(points, counts, LocalOptions { neighbours: 1, ridge: 1.0 }).unwrap();
        let local = Local::new(&instances, after.as_ref()).unwrap();
        let ended: Vec<bool> = rewards.iter().map(|&reward| reward > 0.0).collect();
        // Going right costs something in the first half of the corridor, and a little at its end.
        (0..5).for_each(|x| rewards[11 + x] = -2.0);
        rewards[11 + 8] = -0.1;
        let worth = |bounded: bool| {
            let bounded = [bounded; 22];
            let outcomes = LocalOutcomes { rewards: &rewards, allowed: &[3; 22], ended: &ended, bounded: &bounded };
            local.fit(&outcomes, 0.9).unwrap().weights
        };
        let (bounded, plain) = (worth(true), worth(false));
        for x in 0..11 {
            let (left, right) = (bounded[(x, 0)], bounded[(11 + x, 0)]);
            assert!(x > 8 || right > left && left > 0.0, "at {x}: left {left}, right {right}");
        }
        assert!(plain[(11, 0)] < -1.0 && plain[(0, 0)] <= 0.0);
        let exact = |x: usize| 0.9f64.powi(9 - x as i32) - 0.1 * 0.9f64.powi(8 - x as i32);
        assert_eq!(rewards[11 + 9], 1.0);
        for x in 5..9 {
            assert!((bounded[(11 + x, 0)] - exact(x)).abs() < 1e-9 && (plain[(11 + x, 0)] - exact(x)).abs() < 1e-9);
        }
        for x in 0..5 {
            let halved = exact(5) * (0.5 * 0.9f64).powi(5 - x as i32);
            assert!((bounded[(11 + x, 0)] - halved).abs() < 1e-9, "at {x}");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let (points, after, counts, rewards) = corridor();
        assert_eq!(Instances::new(Mat::new(), vec![], OPTIONS).unwrap_err(), ValueError::Empty);
        assert!(Instances::new(points.clone(), vec![11, 10], OPTIONS).is_err());
        assert!(Instances::new(points.clone(), vec![usize::MAX, 23], OPTIONS).is_err());
        assert!(Instances::new(points.clone(), counts.clone(), LocalOptions { neighbours: 0, ..OPTIONS }).is_err());
        assert!(Instances::new(points.clone(), counts.clone(), LocalOptions { ridge: f64::NAN, ..OPTIONS }).is_err());
        let mut odd = points.clone();
        odd[(0, 3)] = f32::NAN;
        assert!(matches!(Instances::new(odd, counts.clone(), OPTIONS), Err(ValueError::Input { place: 3, .. })));
        let instances = Instances::new(points, counts, OPTIONS).unwrap();
        assert!(Local::new(&instances, after.as_ref().subcols(0, 21)).is_err());
        let local = Local::new(&instances, after.as_ref()).unwrap();
        let never = [false; 22];
        let outcomes = LocalOutcomes { rewards: &rewards, allowed: &[0; 22], ended: &never, bounded: &never };
        assert!(matches!(local.fit(&outcomes, 0.9), Err(ValueError::NothingAllowed { index: 0, actions: 2 })));
        assert!(local.fit(&LocalOutcomes { allowed: &[3; 22], ..outcomes }, 1.0).is_err());
        assert!(instances.action_values(&[&[0.0; 3]], after.as_ref()).is_err());
        let mut many = vec![0; 33];
        many[32] = 22;
        let instances = Instances::new(after.clone(), many, OPTIONS).unwrap();
        let local = Local::new(&instances, after.as_ref()).unwrap();
        assert_eq!(local.fit(&outcomes, 0.9).unwrap_err(), ValueError::AllowedBits(33));
    }

    #[test]
    fn of_an_action_that_was_never_tried_nothing_is_known() {
        let points = Mat::from_fn(1, 2, |_, j| j as f32);
        let instances = Instances::new(points.clone(), vec![2, 0], OPTIONS).unwrap();
        let q = instances.action_values(&[&[1.0, 1.0]], points.as_ref()).unwrap();
        assert_eq!((q[0][(0, 0)], q[0][(1, 0)]), (1.0, f64::NEG_INFINITY));
    }
}
