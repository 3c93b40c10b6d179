//! Transitions between points, collected one by one and owned in one place, and the local values of them.

use faer::{Mat, MatRef};

use super::error::{finite_list, finite_matrix};
use super::{Fit, Instances, Local, LocalOptions, LocalOutcomes, Policy, ValueError};
#[cfg(feature = "snapshot")]
use crate::snapshot::{Persist, Snapshot, SnapshotError};

/// Transitions `(x, a, r, x′)` between points, ready for local values; [`Batch`](super::Batch) is the same for linear ones.
///
/// Points may lie anywhere and be of any scale: they are centred in `f64` before distances are taken in `f32`.
///
/// ```
/// use adagio::value::{LocalBatch, LocalOptions};
///
/// // A corridor from 0 to 1, steps of 0.1 to the left (0) and right (1), the goal at its right end.
/// let mut batch = LocalBatch::new(1, 2)?;
/// for t in 0..100 {
///     let (x, action) = (f64::from(t / 2) / 50.0, t as usize % 2);
///     let next = if action == 1 { x + 0.1 } else { (x - 0.1).max(0.0) };
///     let arrived = next >= 1.0;
///     batch.push(&[x], action, f64::from(u8::from(arrived)), (!arrived).then_some(&[next]))?;
/// }
/// let values = batch.fit(&LocalOptions { neighbours: 4, ..LocalOptions::default() }, 0.9)?;
/// assert_eq!(values.best(&[0.33])?, 1);
/// assert_eq!(values.arrival(), 1.0);
/// # Ok::<(), adagio::value::ValueError>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct LocalBatch {
    dimensions: usize,
    number_of_actions: usize,
    /// Points one after another; where an episode ended, the point before it stands for the one after it.
    from: Vec<f64>,
    to: Vec<f64>,
    actions: Vec<usize>,
    rewards: Vec<f64>,
    ended: Vec<bool>,
}

impl LocalBatch {
    /// An empty batch for points with this many coordinates.
    ///
    /// # Errors
    /// No coordinates, no actions, more than 32 actions.
    pub fn new(dimensions: usize, actions: usize) -> Result<Self, ValueError> {
        if dimensions == 0 {
            return Err(ValueError::Features { what: "points", found: 0, expected: 1 });
        }
        if actions == 0 {
            return Err(ValueError::NoActions);
        }
        if actions > u32::BITS as usize {
            return Err(ValueError::AllowedBits(actions));
        }
        let (from, to, rewards) = Default::default();
        Ok(LocalBatch {
            dimensions,
            number_of_actions: actions,
            from,
            to,
            actions: Vec::new(),
            rewards,
            ended: Vec::new(),
        })
    }

    /// Add a transition; `next` is `None` where the episode ended.
    ///
    /// # Errors
    /// Points of another dimension, an action out of range, values that are not finite. The batch is then as it was.
    pub fn push(&mut self, x: &[f64], action: usize, reward: f64, next: Option<&[f64]>) -> Result<(), ValueError> {
        let to = next.unwrap_or(x);
        for (what, point) in [("x", x), ("next", to)] {
            if point.len() != self.dimensions {
                return Err(ValueError::Features { what, found: point.len(), expected: self.dimensions });
            }
            finite_list(what, point)?;
        }
        if action >= self.number_of_actions {
            return Err(ValueError::Action { index: self.len(), action, actions: self.number_of_actions });
        }
        finite_list("rewards", &[reward])?;
        self.from.extend_from_slice(x);
        self.to.extend_from_slice(to);
        self.actions.push(action);
        self.rewards.push(reward);
        self.ended.push(next.is_none());
        Ok(())
    }

    /// Number of transitions `N`.
    pub fn len(&self) -> usize {
        self.actions.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.actions.is_empty()
    }

    /// Local values of the transitions, see [`Local::fit`]; every action may follow.
    ///
    /// # Errors
    /// An empty batch, options outside their ranges, γ outside [0, 1).
    pub fn fit(&self, options: &LocalOptions, gamma: f64) -> Result<LocalValues, ValueError> {
        let mut order: Vec<usize> = (0..self.len()).collect();
        order.sort_by_key(|&t| self.actions[t]);
        let counts = (0..self.number_of_actions).map(|a| self.actions.iter().filter(|&&taken| taken == a).count());
        let origin = Origin::of(MatRef::from_column_major_slice(&self.from, self.dimensions, self.len()));
        let points = |all: &[f64]| {
            let all = MatRef::from_column_major_slice(all, self.dimensions, self.len());
            origin.points("points", Mat::from_fn(self.dimensions, self.len(), |i, j| all[(i, order[j])]).as_ref())
        };
        let instances = Instances::new(points(&self.from)?, counts.collect(), *options)?;
        let rewards: Vec<f64> = order.iter().map(|&t| self.rewards[t]).collect();
        let ended: Vec<bool> = order.iter().map(|&t| self.ended[t]).collect();
        let (allowed, bounded) = (vec![u32::MAX; self.len()], vec![false; self.len()]);
        let outcomes = LocalOutcomes { rewards: &rewards, allowed: &allowed, ended: &ended, bounded: &bounded };
        let local = Local::new(&instances, points(&self.to)?.as_ref())?;
        let fit = local.fit(&outcomes, gamma)?;
        let arrival = local.arrival(&outcomes, &fit)?;
        Ok(LocalValues { origin, fit, arrival, instances })
    }
}

/// How points become those of [`Instances`].
#[derive(Debug, Clone, PartialEq)]
struct Origin {
    mean: Vec<f64>,
    /// A power of two.
    scale: f64,
}

impl Origin {
    fn of(points: MatRef<'_, f64>) -> Self {
        let n = points.ncols() as f64;
        let mean: Vec<f64> = points.row_iter().map(|row| row.iter().map(|x| x / n).sum()).collect();
        let away = |x: &f64, mean: &f64| (x / 2.0 - mean / 2.0).abs();
        let of_row = |(row, mean): (faer::RowRef<'_, f64>, &f64)| row.iter().map(|x| away(x, mean)).fold(0.0, f64::max);
        let farthest = points.row_iter().zip(&mean).map(of_row).fold(0.0, f64::max);
        // The largest number is about 1 then, and neither large nor small ones leave the range of f32.
        let scale = if farthest > 0.0 { (-farthest.log2()).round().min(1023.0).exp2() } else { 1.0 };
        Origin { mean, scale }
    }

    fn points(&self, what: &'static str, points: MatRef<'_, f64>) -> Result<Mat<f32>, ValueError> {
        if points.nrows() != self.mean.len() {
            return Err(ValueError::Features { what, found: points.nrows(), expected: self.mean.len() });
        }
        finite_matrix(what, points)?;
        // Halves, whose difference does not overflow. What is too far away for f32 is as far as it goes.
        let point = |i: usize, j: usize| (points[(i, j)] / 2.0 - self.mean[i] / 2.0) * self.scale;
        let far = f64::from(f32::MAX.sqrt());
        Ok(Mat::from_fn(points.nrows(), points.ncols(), |i, j| point(i, j).clamp(-far, far) as f32))
    }
}

/// Local values of a [`LocalBatch`].
#[derive(Debug, Clone, PartialEq)]
pub struct LocalValues {
    origin: Origin,
    instances: Instances,
    fit: Fit,
    arrival: f64,
}

impl LocalValues {
    /// `Q(x, a)` of points, `p × n`: `A × n`; −∞ for actions that were never tried.
    ///
    /// # Errors
    /// Points of another dimension, or not finite.
    pub fn action_values(&self, points: MatRef<'_, f64>) -> Result<Mat<f64>, ValueError> {
        let worth: Vec<f64> = self.fit.weights.col(0).iter().copied().collect();
        let points = self.origin.points("points", points)?;
        Ok(self.instances.action_values(&[&worth], points.as_ref())?.swap_remove(0))
    }

    /// The greedy policy at points, `p × n`.
    ///
    /// # Errors
    /// Points of another dimension, or not finite.
    pub fn policy(&self, points: MatRef<'_, f64>) -> Result<Policy, ValueError> {
        Policy::greedy(self.action_values(points)?.as_ref())
    }

    /// The greedy action at a point.
    ///
    /// # Errors
    /// A point of another dimension, or not finite.
    pub fn best(&self, x: &[f64]) -> Result<usize, ValueError> {
        Ok(self.policy(MatRef::from_column_major_slice(x, x.len(), 1))?.chosen()[0])
    }

    /// The share of transitions after which the greedy policy arrives, see [`Local::arrival`].
    pub fn arrival(&self) -> f64 {
        self.arrival
    }

    /// Sweeps, whether the values settled, and what each transition is worth: those of action 0 first, in the order in which they
    /// came, then those of action 1, and so on.
    pub fn fit(&self) -> &Fit {
        &self.fit
    }
}

/// Restored into any other.
#[cfg(feature = "snapshot")]
impl Persist for LocalValues {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.numbers("mean", &mut self.origin.mean)?;
        snapshot.number("scale", &mut self.origin.scale)?;
        snapshot.inner("instances", &mut self.instances)?;
        snapshot.matrix("worth", &mut self.fit.weights, |rows, columns| (rows, columns))?;
        snapshot.value("iterations", &mut self.fit.iterations)?;
        snapshot.value("converged", &mut self.fit.converged)?;
        snapshot.value("untried", &mut self.fit.untried)?;
        snapshot.number("arrival", &mut self.arrival)?;
        let worth = &self.fit.weights;
        let fits = self.origin.mean.len() == self.instances.points().nrows()
            && (worth.nrows(), worth.ncols()) == (self.instances.len(), 1);
        snapshot.check("worth", fits, "the sizes do not fit each other")
    }
}
