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
//! the feature `rayon`, and has the same bits on any number of them: each point is computed alone. Only with many hundred
//! neighbours does the Cholesky factor of a regression follow faer's global setting
//! ([`fix_parallelism`](crate::random::fix_parallelism)).
//!
//! # Reference
//! Ormoneit & Sen 2002 (kernel-based reinforcement learning: the same with averages in place of regressions); Ernst, Geurts &
//! Wehenkel 2005 (fitted Q iteration); Atkeson, Moore & Schaal 1997 (locally weighted regression).

use std::array::from_fn;
use std::cmp::Ordering;
use std::ops::Range;

use faer::linalg::matmul::matmul;
use faer::linalg::solvers::Solve;
use faer::{Accum, ColRef, Mat, MatRef, Par, Side};

use super::error::{discount, finite_list, finite_matrix, parameter};
use super::{Fit, ValueError};
use crate::kernel::products::map_all;
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// States whose neighbours are searched in one product.
pub(super) const AT_ONCE: usize = 128;
/// The least weight of a neighbour, before regression, as a share of the mean.
const LEAST_WEIGHT: f64 = 1e-3;
/// Points whose mean is at most this many times as far from the origin, squared, as they are from their mean are searched as they
/// are: single precision then keeps at least five of its seven digits of their distances.
const UNMOVED_OFFSET: f64 = 100.0;
/// Mean squared distances from the mean whose points are searched in their own units: squares of products stay in range.
const UNMOVED_SQUARES: std::ops::Range<f64> = 1e-12..1e12;
/// Neighbours found in single precision are trusted where its rounding is at most this share of the squared distance of the last
/// one; elsewhere they are searched again in double precision.
const TRUSTED: f64 = 1.0 / 16.0;
/// Points in a square of a grid, about; how many points tell whether a grid pays: where less than this share of all has to be looked at.
const GRID_POINTS: f64 = 4.0;
const GRID_ASKED: usize = 32;
const GRID_SHARE: f64 = 1.0 / 8.0;
/// Squares out of which nothing is told apart.
const GRID_FAR: f64 = 1e12;
/// Coordinates, of those that vary most, that tell of most points that they are too far away.
const WIDE: usize = 4;
/// Coordinates whose differences are squared side by side.
const LANES: usize = 8;
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

/// Distances come from `‖x‖² − 2xᵀy` in single precision, which loses them where points are far from the origin compared with
/// their spread, or where squares leave the range of numbers. Such points are searched around their mean, in other units.
#[derive(Debug, Clone, PartialEq)]
struct Move {
    /// Mean of each coordinate.
    shift: Vec<f64>,
    /// A power of two.
    scale: f64,
}

impl Move {
    /// What points need, if they need it.
    fn of(points: MatRef<'_, f32>) -> Option<Self> {
        let n = points.ncols() as f64;
        let mean = |i: usize| (0..points.ncols()).map(|j| f64::from(points[(i, j)])).sum::<f64>() / n;
        let shift: Vec<f64> = (0..points.nrows()).map(mean).collect();
        let square = |i: usize, j: usize| (f64::from(points[(i, j)]) - shift[i]).powi(2);
        let spread =
            (0..points.ncols()).map(|j| (0..points.nrows()).map(|i| square(i, j)).sum::<f64>()).sum::<f64>() / n;
        let offset = shift.iter().map(|mean| mean * mean).sum::<f64>();
        let moderate = UNMOVED_SQUARES.contains(&spread) || spread == 0.0;
        if offset <= UNMOVED_OFFSET * spread && moderate {
            return None;
        }
        let scale = if spread > 0.0 { (-0.5 * spread.log2()).round().exp2() } else { 1.0 };
        Some(Move { shift, scale })
    }

    fn apply(&self, points: MatRef<'_, f32>) -> Mat<f32> {
        let moved = |i: usize, j: usize| ((f64::from(points[(i, j)]) - self.shift[i]) * self.scale) as f32;
        Mat::from_fn(points.nrows(), points.ncols(), moved)
    }
}

/// Points of an action by the squares that they lie in, over two coordinates: far apart in these is far apart. Where places are among
/// the coordinates, next to all points lie too far away to be looked at.
#[derive(Debug, Clone, PartialEq)]
struct Grid {
    /// The coordinates that vary most, of the squares first.
    axes: Vec<usize>,
    corner: [f64; 2],
    side: f64,
    /// Squares along each axis.
    squares: [i64; 2],
    /// Where the points of each square begin in `points`; one more than squares.
    begins: Vec<u32>,
    points: Vec<(u32, [f32; WIDE])>,
}

impl Grid {
    /// `None` where the points lie on a line or in one place.
    fn new(points: MatRef<'_, f32>, axes: &[usize], of: Range<usize>) -> Option<Self> {
        let at = |j: usize| [0, 1].map(|axis| f64::from(points[(axes[axis], j)]));
        let axes = axes.to_vec();
        let (mut corner, mut end) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in of.clone().map(at) {
            for axis in 0..2 {
                (corner[axis], end[axis]) = (corner[axis].min(point[axis]), end[axis].max(point[axis]));
            }
        }
        let n = of.len();
        if n == 0 {
            return Some(Grid {
                axes,
                corner: [0.0; 2],
                side: 1.0,
                squares: [0; 2],
                begins: vec![0],
                points: Vec::new(),
            });
        }
        let side = ((end[0] - corner[0]) * (end[1] - corner[1]) * GRID_POINTS / n as f64).sqrt();
        let mut grid = Grid { axes, corner, side, squares: [0; 2], begins: Vec::new(), points: Vec::new() };
        grid.squares = grid.square(end).map(|last| last + 1);
        let count =
            grid.squares[0].checked_mul(grid.squares[1]).filter(|&count| side > 0.0 && count <= (2 * n) as i64)?;
        let square = |j: usize| {
            let [x, y] = grid.square(at(j));
            (x * grid.squares[1] + y) as usize
        };
        let mut sorted: Vec<(usize, u32)> = of.map(|j| (square(j), j as u32)).collect();
        sorted.sort_unstable();
        grid.begins = (0..=count as usize).map(|k| sorted.partition_point(|of| of.0 < k) as u32).collect();
        let wide = |j: u32| grid.wide(points.col(j as usize));
        grid.points = sorted.into_iter().map(|of| (of.1, wide(of.1))).collect();
        Some(grid)
    }

    /// The coordinates of a point that vary most; 0 where there are fewer.
    fn wide(&self, point: ColRef<'_, f32>) -> [f32; WIDE] {
        from_fn(|i| self.axes.get(i).map_or(0.0, |&axis| point[axis]))
    }

    fn square(&self, at: [f64; 2]) -> [i64; 2] {
        // From so far away all points are equally far.
        [0, 1].map(|axis| ((at[axis] - self.corner[axis]) / self.side).floor().clamp(-GRID_FAR, GRID_FAR) as i64)
    }

    /// The `kept` nearest points, the nearest first, and how many were looked at. Squares around the point are searched ring by ring, until
    /// none farther out can hold a nearer one.
    fn nearest(&self, points: MatRef<'_, f32>, at: ColRef<'_, f32>, kept: usize) -> (Vec<u32>, usize) {
        let wide = self.wide(at);
        let middle = self.square([0, 1].map(|axis| f64::from(wide[axis])));
        let at: Vec<f32> = at.iter().copied().collect();
        // A sum of squares in single precision may be less than another of some of them by this share.
        let slack = 1.0 + (at.len() + WIDE) as f32 * f32::EPSILON;
        let (mut nearest, mut looked_at) = (Vec::<(f32, u32)>::with_capacity(kept + 1), 0);
        // How far out the grid begins, and where it ends.
        let outside = |axis: usize| (-middle[axis]).max(middle[axis] - (self.squares[axis] - 1)).max(0);
        let farthest = |axis: usize| middle[axis].abs().max((self.squares[axis] - 1 - middle[axis]).abs());
        for ring in outside(0).max(outside(1))..=farthest(0).max(farthest(1)) {
            let worst = if nearest.len() == kept { nearest[kept - 1].0 } else { f32::INFINITY };
            if f64::from(worst) <= ((ring - 1).max(0) as f64 * self.side).powi(2) {
                break;
            }
            let [ends_x, ends_y] = middle.map(|at| [at - ring, at + ring]);
            let within = |axis: usize, [first, end]: [i64; 2]| first.max(0)..=end.min(self.squares[axis] - 1);
            for x in within(0, ends_x) {
                let mut look = |y: i64| {
                    let square = (x * self.squares[1] + y) as usize;
                    let of = &self.points[self.begins[square] as usize..self.begins[square + 1] as usize];
                    looked_at += of.len();
                    for (point, coordinates) in of {
                        let part = coordinates.iter().zip(wide).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
                        if nearest.len() < kept || part <= slack * nearest[kept - 1].0 {
                            nearer(&mut nearest, kept, (apart(points, *point, &at), *point));
                        }
                    }
                };
                if ends_x.contains(&x) {
                    within(1, ends_y).for_each(&mut look);
                } else {
                    ends_y.into_iter().filter(|y| (0..self.squares[1]).contains(y)).for_each(&mut look);
                }
            }
        }
        (nearest.into_iter().map(|of| of.1).collect(), looked_at)
    }
}

/// Keep a point if it is among the nearest; of equally near ones the first.
fn nearer(nearest: &mut Vec<(f32, u32)>, kept: usize, of: (f32, u32)) {
    if nearest.len() < kept || of < nearest[kept - 1] {
        let place = nearest.partition_point(|other| *other < of);
        nearest.insert(place, of);
        nearest.truncate(kept);
    }
}

/// Squared distance of two points, in single precision: of differences, so that nothing is lost.
pub(super) fn apart(points: MatRef<'_, f32>, point: u32, at: &[f32]) -> f32 {
    let Some(of) = points.col(point as usize).try_as_col_major() else { return f32::INFINITY };
    let (of, rest) = of.as_slice().as_chunks::<LANES>();
    let (at, rest_at) = at.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (a, b) in of.iter().zip(at) {
        for lane in 0..LANES {
            sums[lane] += (a[lane] - b[lane]) * (a[lane] - b[lane]);
        }
    }
    sums.iter().sum::<f32>() + rest.iter().zip(rest_at).map(|(a, b)| (a - b) * (a - b)).sum::<f32>()
}

/// The coordinates that vary most, of two or more.
fn widest(points: MatRef<'_, f32>) -> Option<Vec<usize>> {
    let n = points.ncols() as f64;
    let variance = |i: usize| {
        let row = || points.row(i).iter().map(|&x| f64::from(x));
        let mean = row().sum::<f64>() / n;
        row().map(|x| (x - mean).powi(2)).sum::<f64>()
    };
    let mut axes: Vec<(f64, usize)> = (0..points.nrows()).map(|i| (variance(i), i)).collect();
    axes.sort_by(|a, b| b.0.total_cmp(&a.0));
    (axes.len() > 1).then(|| axes.into_iter().take(WIDE).map(|of| of.1).collect())
}

/// The transitions that a value is estimated from: their numbers, and how much each counts. The weights sum to 1.
pub(super) type Neighbours = Vec<(u32, f64)>;

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
                for (j, near) in self.neighbours(a, block).into_iter().enumerate() {
                    for (values, worth) in values.iter_mut().zip(worths) {
                        values[(a, start + j)] =
                            if self.counts[a] == 0 { f64::NEG_INFINITY } else { estimate(&near, worth) };
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

    /// Which transitions of an action tell its value at each point, on this thread.
    pub(super) fn neighbours(&self, action: usize, points: MatRef<'_, f32>) -> Vec<Neighbours> {
        let places = self.of_action(action);
        if places.is_empty() {
            return vec![Vec::new(); points.ncols()];
        }
        if let Some(grid) = self.grid.as_ref().and_then(|grids| grids.get(action)) {
            let near = |j: usize| {
                let (nearest, _) = grid.nearest(self.points.as_ref(), points.col(j), self.kept(places.len()));
                self.regress(nearest, points, j)
            };
            return (0..points.ncols()).map(near).collect();
        }
        let moved = self.moved.as_ref().map(|(by, _)| by.apply(points));
        let searched = self.moved.as_ref().map_or(&self.points, |(_, moved)| moved);
        let of_action = searched.as_ref().subcols(places.start, places.len());
        let mut products = Mat::zeros(of_action.ncols(), points.ncols());
        let at = moved.as_ref().map_or(points, |moved| moved.as_ref());
        matmul(products.as_mut(), Accum::Replace, of_action.transpose(), at, 1.0, Par::Seq);
        let kept = self.kept(places.len());
        let norms = &self.norms[places.clone()];
        let longest = f64::from(norms.iter().copied().fold(0.0, f32::max));
        let scale = self.moved.as_ref().map_or(1.0, |(by, _)| by.scale);
        let mut distances = vec![0.0; places.len()];
        let near = |j: usize| {
            // Up to the norm of the point itself, which is the same for all.
            let pairs = norms.iter().zip(products.col_as_slice(j));
            distances.iter_mut().zip(pairs).for_each(|(to, (norm, product))| *to = norm - 2.0 * product);
            let mut nearest = least(&distances, kept);
            let squared = |i: usize| self.squared(places.start + i, points, j);
            let reach = nearest.iter().map(|&i| squared(i)).fold(0.0, f64::max) * scale * scale;
            let at = at.col(j).iter().map(|&x| f64::from(x).powi(2)).sum::<f64>();
            if kept < places.len() && rounding(points.nrows(), longest, at) > TRUSTED * reach {
                nearest = least(&(0..places.len()).map(squared).collect::<Vec<f64>>(), kept);
            }
            self.regress(nearest.into_iter().map(|i| (places.start + i) as u32).collect(), points, j)
        };
        (0..points.ncols()).map(near).collect()
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

    /// Squared distance of a transition's point to one of `points`.
    fn squared(&self, place: usize, points: MatRef<'_, f32>, j: usize) -> f64 {
        let pairs = self.points.col(place).iter().zip(points.col(j).iter());
        pairs.map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum()
    }

    /// Weights of the nearest transitions in the value at a point: those of a linear regression with ridge on its slopes.
    ///
    /// With differences `D` to the point and weights `u` by distance, the intercept that minimises
    /// `Σ u_i (q_i − c − bᵀD_i)² + ρ‖b‖²` is `c = 1ᵀG⁻¹q / 1ᵀG⁻¹1` with `G = DᵀD/ρ + diag(u)⁻¹`.
    fn regress(&self, nearest: Vec<u32>, points: MatRef<'_, f32>, j: usize) -> Neighbours {
        let difference = |i: usize, place: u32| f64::from(self.points[(i, place as usize)]) - f64::from(points[(i, j)]);
        let squared = |place: u32| (self.squared(place as usize, points, j), place);
        let mut near: Vec<(f64, u32)> = nearest.into_iter().map(squared).collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let farthest = near.last().map_or(0.0, |&(distance, _)| distance);
        let reach = if near.len() > self.options.neighbours { farthest } else { 2.0 * farthest };
        near.truncate(self.options.neighbours);
        let k = near.len();
        let mean = near.iter().map(|&(distance, _)| distance).sum::<f64>() / k as f64;
        if k == 1 || mean == 0.0 {
            return near.iter().map(|&(_, place)| (place, 1.0 / k as f64)).collect();
        }
        let by_distance: Vec<f64> = near.iter().map(|&(distance, _)| (1.0 - distance / reach).max(0.0)).collect();
        let mean_weight = (by_distance.iter().sum::<f64>() / k as f64).max(f64::MIN_POSITIVE);
        let differences = Mat::from_fn(points.nrows(), k, |i, c| difference(i, near[c].1));
        let mut gram = differences.transpose() * &differences;
        let slopes = 1.0 / (self.options.ridge * mean);
        for c in 0..k {
            for r in 0..k {
                gram[(r, c)] *= slopes;
            }
            gram[(c, c)] += 1.0 / (by_distance[c] / mean_weight).max(LEAST_WEIGHT);
        }
        let ones = Mat::from_fn(k, 1, |_, _| 1.0);
        let weights = match gram.llt(Side::Lower) {
            Ok(factor) => factor.solve(&ones),
            // It is positive definite unless numbers overflow: then a mean.
            Err(_) => ones,
        };
        let sum: f64 = (0..k).map(|c| weights[(c, 0)]).sum();
        (0..k).map(|c| (near[c].1, weights[(c, 0)] / sum)).collect()
    }
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

/// The places of the `kept` ≥ 1 least numbers, the least first; of equal ones the first ones.
fn least<T: PartialOrd + Copy>(numbers: &[T], kept: usize) -> Vec<usize> {
    /// Numbers that are compared at once, on vectors.
    const BLOCK: usize = 32;
    let mut least: Vec<(T, usize)> = Vec::with_capacity(kept + 1);
    for (block, start) in numbers.chunks(BLOCK).zip((0..).step_by(BLOCK)) {
        // Few of all come in, so that this takes less than the products.
        if let Some(&(most, _)) = least.get(kept - 1)
            && !block.iter().fold(false, |any, &number| any | (number < most))
        {
            continue;
        }
        for (i, &number) in block.iter().enumerate() {
            if least.len() < kept || number < least[kept - 1].0 {
                let place = least.partition_point(|&(less, _)| less <= number);
                least.insert(place, (number, start + i));
                least.truncate(kept);
            }
        }
    }
    least.into_iter().map(|(_, i)| i).collect()
}

/// By how much `‖x‖² − 2xᵀy` in single precision may miss, for `p` coordinates and squared norms up to these; infinite where it
/// may overflow.
fn rounding(p: usize, x: f64, y: f64) -> f64 {
    let size = x + 2.0 * (x * y).sqrt();
    let underflow = p as f64 * f64::from(f32::MIN_POSITIVE);
    if size < f64::from(f32::MAX) {
        (p + 4) as f64 * 0.5 * f64::from(f32::EPSILON) * size + underflow
    } else {
        f64::INFINITY
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

/// A value from what its neighbours are worth.
pub(super) fn estimate(near: &[(u32, f64)], worth: &[f64]) -> f64 {
    near.iter().map(|&(place, weight)| weight * worth[place as usize]).sum()
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
    /// For each end and action which transitions tell the action's value there.
    after: Vec<Vec<Neighbours>>,
}

impl<'a> Local<'a> {
    /// Find the neighbours of the states after each transition, `p × N`. `N N′p` products for `N′` states that differ, beside the
    /// regressions; what is found takes `16 A N′` bytes for each neighbour, and does not depend on the number of threads.
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
            let mut of_action: Vec<_> =
                (0..instances.counts.len()).map(|a| instances.neighbours(a, block.as_ref()).into_iter()).collect();
            let next = |_| of_action.iter_mut().map(|near| near.next().unwrap_or_default()).collect();
            (0..block.ncols()).map(next).collect::<Vec<Vec<Neighbours>>>()
        };
        let blocks = map_all(distinct.len().div_ceil(AT_ONCE), of_block);
        Ok(Local { instances, ends: numbers, after: blocks.into_iter().flatten().collect() })
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
        discount(gamma)?;
        self.check(outcomes)?;
        let (n, actions) = (self.instances.len(), self.instances.counts.len());
        let (least, most) = outcomes.rewards.iter().fold((0.0f64, 0.0f64), |(l, m), &r| (l.min(r), m.max(r)));
        let (least, most) = (least / (1.0 - gamma), most / (1.0 - gamma));
        if most.max(-least) > LARGEST {
            return Err(ValueError::NotFinite(n));
        }
        let mut worth = vec![0.0; n];
        let untried = (0..actions).filter(|&a| self.instances.counts[a] == 0).collect();
        let mut fit = Fit { weights: Mat::new(), iterations: 0, converged: false, cycle: None, untried };
        for sweep in 1..=(SWEEPS / (1.0 - gamma)).min(MOST_SWEEPS).ceil() as usize {
            let values = self.values(&worth);
            let of = |i: usize| {
                if outcomes.ended[i] {
                    return outcomes.rewards[i];
                }
                let (_, next) = self.best_after(outcomes, i, &values);
                let next = gamma * next;
                worth_of(outcomes.rewards[i], next, outcomes.bounded[i]).clamp(least, most)
            };
            let new: Vec<f64> = map_all(n, of);
            let size = new.iter().fold(0.0f64, |size, value| size.max(value.abs()));
            let change = new.iter().zip(&worth).fold(0.0f64, |change, (new, old)| change.max((new - old).abs()));
            worth = new;
            fit.iterations = sweep;
            if change <= SETTLED * size {
                fit.converged = true;
                break;
            }
        }
        fit.weights = Mat::from_fn(n, 1, |i, _| worth[i]);
        Ok(fit)
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
        let values = self.values(&worth);
        // An action that was tried has a nearest transition.
        let nearest = |i: usize| self.after[self.ends[i] as usize][self.best_after(outcomes, i, &values).0].first();
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

    /// Values of all actions at each end, `A` for one after the other; −∞ of actions that were never tried.
    fn values(&self, worth: &[f64]) -> Vec<f64> {
        let actions = self.instances.counts.len();
        let of_block = |number: usize| {
            let ends = &self.after[number * AT_ONCE..self.after.len().min((number + 1) * AT_ONCE)];
            let of = |near: &Neighbours| if near.is_empty() { f64::NEG_INFINITY } else { estimate(near, worth) };
            let mut values = Vec::with_capacity(ends.len() * actions);
            values.extend(ends.iter().flatten().map(of));
            values
        };
        map_all(self.after.len().div_ceil(AT_ONCE), of_block).concat()
    }

    /// The best action that may follow a transition, and its value; of actions that were tried, and of all of these where none that
    /// may follow was.
    fn best_after(&self, outcomes: &LocalOutcomes<'_>, i: usize, values: &[f64]) -> (usize, f64) {
        let actions = self.instances.counts.len();
        let values = &values[self.ends[i] as usize * actions..][..actions];
        let best = |may: &dyn Fn(usize) -> bool| {
            let values = values.iter().enumerate().filter(|of| may(of.0));
            values.fold((0, f64::NEG_INFINITY), |best, of| if *of.1 > best.1 { (of.0, *of.1) } else { best })
        };
        let found = best(&|b| outcomes.allowed[i] & (1 << b) != 0);
        if found.1 == f64::NEG_INFINITY { best(&|_| true) } else { found }
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
        assert_eq!(few.neighbours(0, asked.as_ref())[25].len(), 4);
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
        assert_eq!((local.ends, local.after.len()), (ends, 11));
        let near = |x: f32| instances.neighbours(1, Mat::from_fn(1, 1, |_, _| x).as_ref()).remove(0);
        assert_eq!(local.after[7][1], near(7.0));

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
