//! The inverted pendulum: a pole on a cart, to be kept upright by pushes of −50, 0 or 50 N, each with up to 10 N of noise,
//! ten times a second. Falling below the horizontal costs 1 and ends the episode.
//!
//! With `u` the push, `α = 1/(m + M)`, pole `m` = 2 kg and `l` = 0.5 m, cart `M` = 8 kg:
//! `θ̈ = (g sin θ − α m l θ̇² sin(2θ)/2 − α cos θ · u) / (4l/3 − α m l cos² θ)`.
//! A step of 0.1 s is integrated in ten Euler steps, which the source leaves open.
//!
//! # Reference
//! Lagoudakis & Parr 2003, §9.2. They report that 1000 random training episodes (about 6 steps each) give policies that
//! balance about 2850 of 3000 steps on average (γ = 0.95).

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use faer::MatRef;
use rand::{Rng, RngExt};

use crate::value::error::finite_matrix;
use crate::value::{Batch, ValueError, greedy};

/// Pushes of the three actions, N.
pub const FORCES: [f64; 3] = [-50.0, 0.0, 50.0];
/// Largest noise of a push, N.
pub const NOISE: f64 = 10.0;
/// Discount of the published experiment.
pub const GAMMA: f64 = 0.95;
/// Number of features.
pub const FEATURES: usize = 10;

const GRAVITY: f64 = 9.8; // m/s²
const POLE_MASS: f64 = 2.0; // kg
const CART_MASS: f64 = 8.0; // kg
const LENGTH: f64 = 0.5; // m
const STEP: f64 = 0.1; // s
const EULER_STEPS: u32 = 10;
/// Largest angle and angular speed of a start; the source says "perturbed from upright".
const PERTURBATION: f64 = 0.2;

/// The state of the pole.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pendulum {
    /// θ from upright, rad.
    pub angle: f64,
    /// θ̇, rad/s.
    pub speed: f64,
}

impl Pendulum {
    /// A pole that was pushed a little out of the upright position.
    pub fn perturbed(rng: &mut impl Rng) -> Self {
        let mut little = || rng.random_range(-PERTURBATION..PERTURBATION);
        Pendulum { angle: little(), speed: little() }
    }

    /// Whether the pole is below the horizontal (or not a number).
    pub fn has_fallen(&self) -> bool {
        !(self.angle.abs() <= FRAC_PI_2 && self.speed.is_finite())
    }

    /// One step under a push `force` in N.
    pub fn pushed(self, force: f64) -> Self {
        let alpha = 1.0 / (POLE_MASS + CART_MASS);
        let alpha_ml = alpha * POLE_MASS * LENGTH;
        let dt = STEP / f64::from(EULER_STEPS);
        let Pendulum { mut angle, mut speed } = self;
        for _ in 0..EULER_STEPS {
            let centrifugal = alpha_ml * speed * speed * (2.0 * angle).sin() / 2.0;
            let acceleration = (GRAVITY * angle.sin() - centrifugal - alpha * angle.cos() * force)
                / (4.0 * LENGTH / 3.0 - alpha_ml * angle.cos().powi(2));
            angle += dt * speed;
            speed += dt * acceleration;
        }
        Pendulum { angle, speed }
    }

    /// One step of an action, with noise.
    ///
    /// # Errors
    /// An action out of range.
    pub fn step(self, action: usize, rng: &mut impl Rng) -> Result<Self, ValueError> {
        let force = FORCES.get(action).ok_or(ValueError::Action { index: 0, action, actions: FORCES.len() })?;
        Ok(self.pushed(force + rng.random_range(-NOISE..NOISE)))
    }

    /// A constant and nine Gaussian bumps of variance 1 around angles −π/4, 0, π/4 and speeds −1, 0, 1.
    pub fn features(&self) -> [f64; FEATURES] {
        let mut phi = [1.0; FEATURES];
        let mut place = 1;
        for angle in [-FRAC_PI_4, 0.0, FRAC_PI_4] {
            for speed in [-1.0, 0.0, 1.0] {
                let squared = (self.angle - angle).powi(2) + (self.speed - speed).powi(2);
                phi[place] = (-squared / 2.0).exp();
                place += 1;
            }
        }
        phi
    }
}

/// Transitions of episodes that start near upright, with random actions until the pole falls.
///
/// # Errors
/// None for any number of episodes.
pub fn random_episodes(episodes: usize, rng: &mut impl Rng) -> Result<Batch, ValueError> {
    let mut batch = Batch::new(FEATURES, FORCES.len())?;
    for _ in 0..episodes {
        let mut pole = Pendulum::perturbed(rng);
        while !pole.has_fallen() {
            let action = rng.random_range(0..FORCES.len());
            let next = pole.step(action, rng)?;
            let after = next.features();
            let (reward, seen) = if next.has_fallen() { (-1.0, None) } else { (0.0, Some(after.as_slice())) };
            batch.push(&pole.features(), action, reward, seen, 1.0)?;
            pole = next;
        }
    }
    Ok(batch)
}

/// How many of `longest` steps the greedy policy of some weights, `10 × 3`, keeps a perturbed pole up.
///
/// # Errors
/// Weights of another shape, or that are not finite.
pub fn balanced_steps(weights: MatRef<'_, f64>, longest: usize, rng: &mut impl Rng) -> Result<usize, ValueError> {
    if weights.nrows() != FEATURES {
        return Err(ValueError::Features { what: "weights", found: weights.nrows(), expected: FEATURES });
    }
    if weights.ncols() != FORCES.len() {
        return Err(ValueError::Length { what: "weights", found: weights.ncols(), expected: FORCES.len() });
    }
    finite_matrix("weights", weights)?;
    let mut pole = Pendulum::perturbed(rng);
    for steps in 0..longest {
        let phi = pole.features();
        let value = |a: usize| phi.iter().enumerate().map(|(i, p)| p * weights[(i, a)]).sum::<f64>();
        pole = pole.step(greedy((0..FORCES.len()).map(value)), rng)?;
        if pole.has_fallen() {
            return Ok(steps);
        }
    }
    Ok(longest)
}
