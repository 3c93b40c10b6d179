//! Where states lie on the floor, learned from what actions do.
//!
//! Slow features tell states apart, but their distances are no lengths: a metre counts more in one place or direction than in
//! another. A robot knows the lengths, because it knows its actions: a turn changes the heading by an angle, a move goes a
//! distance along the heading. [`MetricMap`] finds headings and positions that are functions of the features and obey that.
//!
//! 1. *Headings* as a linear function of the features. `z = e^{iθ}` obeys `z′ = e^{iα} z` for a turn by α, so
//!    `w` minimises `Σ |wᵀφ′ − e^{iα} wᵀφ|²`: the smallest eigenvector of a Hermitian matrix, a slow feature but for the turns.
//! 2. *Positions* as a linear function of the features, in turns: along the path, positions are smoothed so that each move has its
//!    length and its heading; then features are fitted to these positions. (Fitting to the moves at once would shrink the map,
//!    because features are noisy.)
//! 3. The same with local regressions in place of linear functions. The two halves of the window, cut into short pieces, are
//!    estimated from each other, so that no state vouches for itself.
//!
//! The map is right up to a rotation and a shift, which nothing can tell.
//!
//! # Reference
//! Smoothing of paths with returns: Lu & Milios 1997 (consistent pose estimation).

use faer::linalg::solvers::Solve;
use faer::{Mat, MatRef, Side, c64};

use super::error::{finite_matrix, parameter};
use super::local::{AT_ONCE, Neighbours};
use super::{Instances, LocalOptions, ValueError};
use crate::kernel::products::map_all;

/// Features of the linear functions, the constant one beside them.
const FEATURES: usize = 100;
/// States that come from one half in one piece.
const PIECE: usize = 20;
/// Deviations: of a turned heading along the path, and of one that features tell. That falls from round to round: first far places are
/// brought into line, by long pieces of the path, then near ones.
const TURN_ERROR: f64 = 0.03;
const HEADING_ERRORS: [f64; 2] = [2.0, 0.1];
const HEADING_ROUNDS: usize = 40;
/// Deviations of positions in lengths of a move: of a known move, of a blocked one, of what linear functions and of what local
/// regressions tell.
const MOVE_ERROR: f64 = 0.1;
const BLOCKED_ERROR: f64 = 1.0;
const LINEAR_ERROR: f64 = 3.0;
const LOCAL_ERRORS: [f64; 2] = [3.0, 0.5];
const LINEAR_ROUNDS: usize = 60;
const LOCAL_ROUNDS: usize = 40;
/// Steps of the pieces by which the size of the map is set.
const STRETCHED: usize = 6;
/// Ridge of the linear functions, as a share of the number of states.
const RIDGE: f64 = 1e-3;

/// What an action did between two states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    /// Angle by which it turned, radians, counter-clockwise.
    pub turn: f64,
    /// Distance that it went along the new heading; `None`: unknown, as of a robot that was stopped by a wall.
    pub distance: Option<f64>,
}

/// Positions and headings of states.
#[derive(Debug, Clone, PartialEq)]
pub struct MetricMap {
    positions: Vec<[f64; 2]>,
    headings: Vec<f64>,
    error: f64,
}

impl MetricMap {
    /// Find the map of states in the order in which they were met. `None` where the steps say too little: no moves, or no turns.
    ///
    /// # Shapes
    /// `phi: f × n`, slow features, the constant one first; `points: p × n`, where states are near each other;
    /// `steps`: `n − 1`, between each state and the next one, `None` where something else happened.
    ///
    /// # Errors
    /// Shapes that do not fit, values that are not finite.
    pub fn new(
        phi: MatRef<'_, f64>,
        points: MatRef<'_, f32>,
        steps: &[Option<Step>],
        options: LocalOptions,
    ) -> Result<Option<Self>, ValueError> {
        let n = phi.ncols();
        if points.ncols() != n {
            return Err(ValueError::Length { what: "the points", found: points.ncols(), expected: n });
        }
        if steps.len() + 1 != n {
            return Err(ValueError::Length { what: "the steps", found: steps.len(), expected: n.saturating_sub(1) });
        }
        finite_matrix("phi", phi)?;
        for step in steps.iter().flatten() {
            let distance = step.distance.unwrap_or(0.0);
            parameter("turn", step.turn, step.turn.is_finite(), "finite")?;
            parameter("distance", distance, distance.is_finite(), "finite")?;
        }
        let moves: Vec<f64> = steps.iter().flatten().filter_map(|step| step.distance.filter(|d| *d != 0.0)).collect();
        let turns = steps.iter().flatten().filter(|step| step.turn.sin().abs() > 1e-3).count();
        if moves.len() < FEATURES || turns < FEATURES {
            return Ok(None);
        }
        let unit = moves.iter().map(|distance| distance.abs()).sum::<f64>() / moves.len() as f64;
        let path = Path { phi: phi.subrows(0, phi.nrows().min(FEATURES + 1)), steps, unit };
        let halves = Halves::new(points, options)?;

        let mut heading = path.linear_headings();
        for error in falling(HEADING_ERRORS, HEADING_ROUNDS) {
            heading = directions(halves.estimates(&directions(path.smooth_headings(&heading, error))));
        }
        let mut position = vec![c64::new(0.0, 0.0); n];
        let solver = path.normal_equations();
        for _ in 0..LINEAR_ROUNDS {
            position = path.linear(&solver, &path.smooth_positions(&position, &heading, LINEAR_ERROR));
        }
        for error in falling(LOCAL_ERRORS, LOCAL_ROUNDS) {
            position = halves.estimates(&path.smooth_positions(&position, &heading, error));
        }
        let stretch = path.stretch(&position, &heading);
        position.iter_mut().for_each(|x| *x *= stretch);
        let missed = path.links().filter_map(|(t, step)| {
            let moved = heading[t + 1] * step.distance?;
            Some((position[t + 1] - position[t] - moved).norm_sqr())
        });
        let (sum, count) = missed.fold((0.0, 0usize), |(sum, count), missed| (sum + missed, count + 1));
        Ok(Some(MetricMap {
            positions: position.iter().map(|x| [x.re, x.im]).collect(),
            headings: heading.iter().map(|z| z.im.atan2(z.re)).collect(),
            error: (sum / count.max(1) as f64).sqrt() / unit,
        }))
    }

    /// Positions, in the unit of the steps' distances, `n`.
    pub fn positions(&self) -> &[[f64; 2]] {
        &self.positions
    }

    /// Headings, radians, `n`.
    pub fn headings(&self) -> &[f64] {
        &self.headings
    }

    /// By how much the way from state to state misses the known ones, root mean square, in lengths of a move: a map of features
    /// that tell all states apart has about 0.3, one that is of no use 1 and more.
    pub fn error(&self) -> f64 {
        self.error
    }
}

/// States on the way of the robot.
struct Path<'a> {
    /// `f × n`.
    phi: MatRef<'a, f64>,
    steps: &'a [Option<Step>],
    /// Mean length of a move.
    unit: f64,
}

impl Path<'_> {
    /// Steps with the states before them.
    fn links(&self) -> impl Iterator<Item = (usize, Step)> + '_ {
        self.steps.iter().enumerate().filter_map(|(t, step)| Some((t, (*step)?)))
    }

    /// Directions `e^{iθ}` of the linear function of the features that turns as the robot does.
    fn linear_headings(&self) -> Vec<c64> {
        let f = self.phi.nrows();
        let links: Vec<(usize, Step)> = self.links().collect();
        let columns = |of: &dyn Fn(usize, Step) -> (usize, f64)| {
            let of: Vec<(usize, f64)> = links.iter().map(|&(t, step)| of(t, step)).collect();
            Mat::from_fn(f, of.len(), |i, j| of[j].1 * self.phi[(i, of[j].0)])
        };
        let (before, after) = (columns(&|t, _| (t, 1.0)), columns(&|t, _| (t + 1, 1.0)));
        let along = columns(&|t, step| (t + 1, step.turn.cos())) * before.transpose();
        let across = columns(&|t, step| (t + 1, step.turn.sin())) * before.transpose();
        // |wᵀφ′ − e^{iα} wᵀφ|² over the real and the imaginary part of w.
        let same = &before * before.transpose() + &after * after.transpose() - &along - along.transpose();
        let mixed = &across - across.transpose();
        let both = Mat::from_fn(2 * f, 2 * f, |i, j| match (i < f, j < f) {
            (true, true) => same[(i, j)],
            (false, false) => same[(i - f, j - f)],
            (true, false) => mixed[(i, j - f)],
            (false, true) => mixed[(j, i - f)],
        });
        let Ok(eigen) = both.self_adjoint_eigen(Side::Lower) else {
            // Of features without bounds; every direction is as good.
            return vec![c64::new(1.0, 0.0); self.phi.ncols()];
        };
        let w = eigen.U().col(0);
        let of = |t: usize| {
            let part = |from: usize| (0..f).map(|i| w[from + i] * self.phi[(i, t)]).sum::<f64>();
            c64::new(part(0), part(f))
        };
        directions((0..self.phi.ncols()).map(of).collect())
    }

    fn smooth_headings(&self, heading: &[c64], error: f64) -> Vec<c64> {
        let links = self.steps.iter().map(|step| {
            step.map(|step| Link {
                weight: TURN_ERROR.powi(-2),
                factor: c64::new(step.turn.cos(), step.turn.sin()),
                shift: c64::new(0.0, 0.0),
            })
        });
        smoothed(heading, error.powi(-2), &links.collect::<Vec<_>>())
    }

    fn smooth_positions(&self, position: &[c64], heading: &[c64], error: f64) -> Vec<c64> {
        let links = self.steps.iter().enumerate().map(|(t, step)| {
            step.map(|step| Link {
                weight: (self.unit * if step.distance.is_some() { MOVE_ERROR } else { BLOCKED_ERROR }).powi(-2),
                factor: c64::new(1.0, 0.0),
                shift: heading[t + 1] * step.distance.unwrap_or(0.0),
            })
        });
        smoothed(position, (self.unit * error).powi(-2), &links.collect::<Vec<_>>())
    }

    /// By how much positions have to be stretched, so that pieces of the path are as long as its moves: noise of the features makes a
    /// map a little too small.
    fn stretch(&self, position: &[c64], heading: &[c64]) -> f64 {
        let (mut along, mut known) = (0.0, 0.0);
        for start in (0..self.steps.len().saturating_sub(STRETCHED)).step_by(STRETCHED) {
            let moves = (start..start + STRETCHED).map(|t| Some(heading[t + 1] * self.steps[t]?.distance?));
            let Some(moved) = moves.sum::<Option<c64>>() else { continue };
            along += ((position[start + STRETCHED] - position[start]) * moved.conj()).re;
            known += moved.norm_sqr();
        }
        if along > 0.0 { known / along } else { 1.0 }
    }

    fn normal_equations(&self) -> faer::linalg::solvers::PartialPivLu<f64> {
        let mut sums = self.phi * self.phi.transpose();
        (0..sums.nrows()).for_each(|i| sums[(i, i)] += RIDGE * self.phi.ncols() as f64);
        sums.partial_piv_lu()
    }

    /// The linear function of the features that is nearest to some values, at all states.
    fn linear(&self, solver: &faer::linalg::solvers::PartialPivLu<f64>, values: &[c64]) -> Vec<c64> {
        let values = Mat::from_fn(values.len(), 2, |t, k| if k == 0 { values[t].re } else { values[t].im });
        let fitted = self.phi.transpose() * solver.solve(self.phi * values);
        (0..self.phi.ncols()).map(|t| c64::new(fitted[(t, 0)], fitted[(t, 1)])).collect()
    }
}

/// States in two halves that tell each other's values, by their neighbours.
struct Halves {
    /// For each state, its place in the list of its half.
    places: Vec<usize>,
    /// The states of each half, and the neighbours of each of them in the other half.
    halves: [(Vec<usize>, Neighbours); 2],
}

impl Halves {
    fn new(points: MatRef<'_, f32>, options: LocalOptions) -> Result<Self, ValueError> {
        let n = points.ncols();
        let of_half = |half: usize| (0..n).filter(|t| t / PIECE % 2 == half).collect::<Vec<usize>>();
        let at = |places: &[usize]| Mat::from_fn(points.nrows(), places.len(), |i, j| points[(i, places[j])]);
        let mut places = vec![0; n];
        let half = |half: usize| {
            let (from, to) = (of_half(1 - half), of_half(half));
            let (instances, asked) = (Instances::new(at(&from), vec![from.len()], options)?, at(&to));
            let of_block = |block: usize| {
                let start = block * AT_ONCE;
                instances.neighbours(0, asked.as_ref().subcols(start, AT_ONCE.min(to.len() - start)))
            };
            let found = map_all(to.len().div_ceil(AT_ONCE), of_block);
            Ok((to, Neighbours::concat(found)))
        };
        let halves = [half(0)?, half(1)?];
        for (states, _) in &halves {
            states.iter().enumerate().for_each(|(place, &t)| places[t] = place);
        }
        Ok(Halves { places, halves })
    }

    /// What the neighbours of each state say of its value.
    fn estimates(&self, values: &[c64]) -> Vec<c64> {
        // Neighbours are numbered within the other half.
        let of_half = |half: usize| self.halves[half].0.iter().map(|&t| (values[t].re, values[t].im)).unzip();
        let of_halves: [(Vec<f64>, Vec<f64>); 2] = [of_half(0), of_half(1)];
        let of = |t: usize| {
            let half = t / PIECE % 2;
            let (neighbours, (real, imaginary)) = (&self.halves[half].1, &of_halves[1 - half]);
            c64::new(neighbours.estimate(self.places[t], real), neighbours.estimate(self.places[t], imaginary))
        };
        map_all(self.places.len(), of)
    }
}

/// `x′ = factor · x + shift` is expected of two states that follow each other.
#[derive(Clone, Copy)]
struct Link {
    weight: f64,
    factor: c64,
    shift: c64,
}

/// The `x` that minimise `Σ weight |x_t − y_t|² + Σ weight |x_{t+1} − factor x_t − shift|²`: a tridiagonal system.
fn smoothed(y: &[c64], weight: f64, links: &[Option<Link>]) -> Vec<c64> {
    let mut diagonal = vec![weight; y.len()];
    let mut x: Vec<c64> = y.iter().map(|y| y * weight).collect();
    for (t, link) in links.iter().enumerate() {
        let Some(link) = link else { continue };
        // Factors are of length 1.
        diagonal[t] += link.weight;
        diagonal[t + 1] += link.weight;
        x[t] -= link.factor.conj() * link.shift * link.weight;
        x[t + 1] += link.shift * link.weight;
    }
    for (t, link) in links.iter().enumerate() {
        let Some(link) = link else { continue };
        let lower = link.factor * (link.weight / diagonal[t]);
        diagonal[t + 1] -= link.weight * link.weight / diagonal[t];
        let before = x[t];
        x[t + 1] += lower * before;
    }
    let last = y.len() - 1;
    x[last] /= diagonal[last];
    for (t, link) in links.iter().enumerate().rev() {
        let after = link.map_or(c64::new(0.0, 0.0), |link| link.factor.conj() * x[t + 1] * link.weight);
        x[t] = (x[t] + after) / diagonal[t];
    }
    x
}

/// Numbers that fall evenly, as ratios, from the first to the second one.
fn falling([first, last]: [f64; 2], count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |k| first * (last / first).powf(k as f64 / (count - 1) as f64))
}

/// The same numbers with length 1.
fn directions(mut z: Vec<c64>) -> Vec<c64> {
    for z in &mut z {
        let length = z.norm();
        *z = if length > 0.0 { *z / length } else { c64::new(1.0, 0.0) };
    }
    z
}
