//! Values of actions by where the robot is.
//!
//! Where a map says where states lie, it is known what an action does at any pose near them, tried there or not: a turn leaves the robot
//! where it stands, and a move leads as far as moves lead, unless those that began nearby were stopped. So values need no transition of
//! each action at each place: they are found on a lattice of poses, and interpolated between these.
//!
//! # Reference
//! Davies 1997 (value iteration with interpolation on a grid); Gordon 1995 (it converges, since interpolation averages).

use std::f64::consts::{PI, TAU};

use faer::Mat;

use super::lattice::Lattice;
use super::metric::MotionNoise;
use super::states::BySquare;
use super::{Pose, turned};
use crate::kernel::products::map_all;
use crate::value::error::{discount, finite_list, parameter};
use crate::value::local::{MOST_SWEEPS, SETTLED, SWEEPS, worth_of};
use crate::value::{Fit, MapStep, ValueError};

/// What an action did is known from so many transitions that began nearest, within this distance; a radian is as far as so many moves.
const NEAREST: usize = 4;
const REACH: f64 = 1.2;
const TURN: f64 = 2.0;
/// A way is known where at least this share of an interpolation is.
const KNOWN: f64 = 0.5;
/// Of these, so many that were stopped stop the robot for certain.
const STOPPED: f64 = 0.5;
/// Width over which rewards are averaged, and how far that is looked for, moves.
const WIDTH: f64 = 0.3;
const FAR: f64 = 0.9;

/// A transition.
#[derive(Debug, Clone, Copy)]
pub struct PlaceStep {
    /// Number of the action.
    pub action: usize,
    /// Where it began.
    pub from: Pose,
    /// Where it led.
    pub to: Pose,
    /// Whether something stopped it.
    pub blocked: bool,
}

/// What came of each transition for one task, in the order of the steps: `N` each.
#[derive(Debug, Clone, Copy)]
pub struct PlaceOutcomes<'a> {
    /// Rewards, without those of what is to be avoided.
    pub rewards: &'a [f64],
    /// Rewards of what is to be avoided, at any cost; 0 elsewhere.
    pub avoided: &'a [f64],
    /// Whether the episode ended.
    pub ended: &'a [bool],
}

/// Where actions lead, on a lattice.
#[derive(Debug)]
pub struct Planner<'a> {
    lattice: Lattice,
    steps: &'a [PlaceStep],
    tried: Vec<bool>,
    /// For each pose and action: where it leads, and with which weights. Empty: nobody knows.
    leads: Vec<Vec<Vec<(u32, f32)>>>,
}

impl<'a> Planner<'a> {
    /// From transitions. `motions`: what each action does where nothing stops it; `unit`: length of a move.
    ///
    /// # Errors
    /// No transitions, one of an action that there is not, poses that are not finite, noise outside its ranges, a unit that is not above 0.
    pub fn new(motions: &[MapStep], steps: &'a [PlaceStep], noise: MotionNoise, unit: f64) -> Result<Self, ValueError> {
        noise.check()?;
        parameter("unit", unit, unit > 0.0 && unit.is_finite(), "above 0")?;
        if steps.is_empty() {
            return Err(ValueError::Empty);
        }
        for step in steps {
            if step.action >= motions.len() {
                return Err(ValueError::Length {
                    what: "the motions",
                    found: motions.len(),
                    expected: step.action + 1,
                });
            }
            let sum = |pose: Pose| pose.x + pose.y + pose.heading;
            let sum = sum(step.from) + sum(step.to);
            parameter("pose", sum, sum.is_finite(), "finite")?;
        }
        let lattice = Lattice::new(steps.iter().map(|step| step.from));
        let actions: Vec<Tried> = (0..motions.len()).map(|action| Tried::new(action, steps)).collect();
        let leads = |number: usize| {
            let from = lattice.pose(number);
            let of = |(action, &motion): (&Tried, &MapStep)| {
                let mut leads: Vec<(u32, f32)> = Vec::new();
                for (to, weight) in action.outcomes(from, motion, (noise, unit)) {
                    // It cannot go where nobody was.
                    let to = if lattice.is_way(from, to) >= KNOWN { to } else { from };
                    let share = weight / lattice.known(to);
                    leads.extend(lattice.around(to).map(|(of, part)| (of as u32, (share * part) as f32)));
                }
                leads.sort_unstable_by_key(|of| of.0);
                leads.dedup_by(|next, of| {
                    next.0 == of.0 && {
                        of.1 += next.1;
                        true
                    }
                });
                leads
            };
            actions.iter().zip(motions).map(of).collect()
        };
        let leads = map_all(lattice.len(), leads);
        let tried = actions.iter().map(|action| !action.steps.is_empty()).collect();
        Ok(Planner { lattice, steps, tried, leads })
    }

    /// Q-values for one task, in [`Fit::weights`]: on the lattice, for [`values_at`](Planner::values_at). Of an action that was never tried nothing
    /// is known: −∞. Penalties are bounded as in [`LocalOutcomes::bounded`](crate::value::LocalOutcomes::bounded).
    ///
    /// # Errors
    /// Lists of other lengths than there were steps, rewards that are not finite, γ outside [0, 1).
    pub fn fit(&self, outcomes: &PlaceOutcomes<'_>, gamma: f64) -> Result<Fit, ValueError> {
        discount(gamma)?;
        let PlaceOutcomes { rewards, avoided, ended } = outcomes;
        for (what, found) in [("rewards", rewards.len()), ("avoided", avoided.len()), ("ended", ended.len())] {
            if found != self.steps.len() {
                return Err(ValueError::Length { what, found, expected: self.steps.len() });
            }
        }
        finite_list("rewards", rewards)?;
        finite_list("avoided", avoided)?;
        let there = self.there(outcomes);
        let (n, actions) = (self.lattice.len(), self.tried.len());
        // What it is worth to come to a pose.
        let worth = |number: usize, value: f64| {
            let [reward, avoided, ended] = there[Lattice::point(number)];
            worth_of(reward, gamma * (1.0 - ended) * value, true) + avoided
        };
        let mut coming: Vec<f64> = (0..n).map(|number| worth(number, 0.0)).collect();
        let q = |coming: &[f64], number: usize, action: usize| {
            let leads = &self.leads[number][action];
            let sum = || leads.iter().map(|&(to, weight)| f64::from(weight) * coming[to as usize]).sum::<f64>();
            (!leads.is_empty()).then(sum)
        };
        let best = |coming: &[f64], number: usize| {
            let known = (0..actions).filter_map(|action| q(coming, number, action));
            known.fold(f64::NEG_INFINITY, f64::max)
        };
        let mut fit = Fit { weights: Mat::new(), iterations: 0, converged: false, cycle: None, untried: Vec::new() };
        let most = (SWEEPS / (1.0 - gamma)).min(MOST_SWEEPS).ceil() as usize;
        while !fit.converged && fit.iterations < most {
            let (mut size, mut change) = (0.0f64, 0.0f64);
            for k in 0..n {
                // Back and forth: what is known at one end is soon known at the other.
                let number = if fit.iterations.is_multiple_of(2) { k } else { n - 1 - k };
                let value = best(&coming, number);
                if value == f64::NEG_INFINITY {
                    continue;
                }
                let new = worth(number, value);
                (size, change) = (size.max(new.abs()), change.max((new - coming[number]).abs()));
                coming[number] = new;
            }
            fit.iterations += 1;
            fit.converged = change <= SETTLED * size;
        }
        fit.untried = (0..actions).filter(|&action| !self.tried[action]).collect();
        fit.weights = Mat::from_fn(n, actions, |number, action| match q(&coming, number, action) {
            Some(value) => value,
            // What nobody knows is as good as to lose a step.
            None if self.tried[action] => gamma * best(&coming, number).max(0.0),
            None => f64::NEG_INFINITY,
        });
        Ok(fit)
    }

    /// Q-values of a fit at a pose, for each action; `None` where nobody was near it.
    pub fn values_at(&self, fit: &Fit, pose: Pose) -> Option<Vec<f64>> {
        self.lattice.mean(fit.weights.as_ref(), pose)
    }

    /// At each point of the floor: reward, that of what is to be avoided, and how probable it is that the episode ends.
    fn there(&self, outcomes: &PlaceOutcomes<'_>) -> Vec<[f64; 3]> {
        let mut sums = vec![[0.0; 4]; self.lattice.points()];
        for (i, step) in self.steps.iter().enumerate() {
            let told = [1.0, outcomes.rewards[i], outcomes.avoided[i], f64::from(u8::from(outcomes.ended[i]))];
            for (point, squared) in self.lattice.near(step.to, FAR) {
                let weight = (-0.5 * squared / (WIDTH * WIDTH)).exp();
                sums[point].iter_mut().zip(told).for_each(|(sum, told)| *sum += weight * told);
            }
        }
        sums.into_iter().map(|[all, rest @ ..]| rest.map(|sum| if all > 0.0 { sum / all } else { 0.0 })).collect()
    }
}

/// The transitions of one action, by the squares of a move that they began in.
struct Tried {
    steps: Vec<PlaceStep>,
    squares: BySquare<Vec<u32>>,
}

impl Tried {
    fn new(action: usize, steps: &[PlaceStep]) -> Self {
        let steps: Vec<PlaceStep> = steps.iter().filter(|step| step.action == action).copied().collect();
        let mut squares: BySquare<Vec<u32>> = BySquare::default();
        for (step, number) in steps.iter().zip(0..) {
            squares.entry(square(step.from)).or_default().push(number);
        }
        Tried { steps, squares }
    }

    /// Where the action may lead from a pose, and how probable that is.
    fn outcomes(&self, from: Pose, motion: MapStep, by: (MotionNoise, f64)) -> Vec<(Pose, f64)> {
        if motion.distance == Some(0.0) && motion.turn != 0.0 && !self.steps.is_empty() {
            return vec![(Pose { heading: from.heading + motion.turn, ..from }, 1.0)];
        }
        let [x, y] = square(from);
        let squares = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [x.saturating_add(dx), y.saturating_add(dy)]));
        let began = squares.filter_map(|square| self.squares.get(&square)).flatten();
        let near = began.filter_map(|&number| {
            let step = &self.steps[number as usize];
            let turn = TURN * turned(step.from.heading, from.heading);
            let squared = (step.from.x - from.x).powi(2) + (step.from.y - from.y).powi(2) + turn * turn;
            (squared < REACH * REACH).then_some((squared, step))
        });
        let mut near: Vec<(f64, &PlaceStep)> = near.collect();
        if near.len() > NEAREST {
            near.select_nth_unstable_by(NEAREST, |a, b| a.0.total_cmp(&b.0));
            near.truncate(NEAREST);
        }
        let weight = |of: &(f64, &PlaceStep)| 1.0 - of.0 / (REACH * REACH);
        let sum = |near: &[(f64, &PlaceStep)]| near.iter().map(weight).sum::<f64>();
        let stopped: Vec<(f64, &PlaceStep)> = near.iter().filter(|of| of.1.blocked).copied().collect();
        if sum(&stopped) > STOPPED * sum(&near) {
            near = stopped;
        }
        let all = sum(&near);
        near.iter().map(|of| (led(from, of.1, motion, by), weight(of) / all)).collect()
    }
}

/// Where a step like one of the past leads from a pose.
fn led(from: Pose, like: &PlaceStep, motion: MapStep, (noise, unit): (MotionNoise, f64)) -> Pose {
    let (dx, dy) = (like.to.x - like.from.x, like.to.y - like.from.y);
    let by = (like.to.heading - like.from.heading + PI).rem_euclid(TAU) - PI;
    match motion.distance {
        // What nothing stops goes its way, whatever the map says.
        Some(distance) if !like.blocked && noise.slides == 0.0 => {
            let heading = from.heading + motion.turn;
            let way = distance / unit;
            Pose { x: from.x + way * heading.cos(), y: from.y + way * heading.sin(), heading }
        }
        _ => {
            let (sin, cos) = (from.heading - like.from.heading).sin_cos();
            Pose { x: from.x + cos * dx - sin * dy, y: from.y + sin * dx + cos * dy, heading: from.heading + by }
        }
    }
}

fn square(pose: Pose) -> [i32; 2] {
    [pose.x, pose.y].map(|at| (at / REACH).round() as i32)
}
