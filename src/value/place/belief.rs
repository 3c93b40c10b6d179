//! Where the robot may be.

use std::f64::consts::{PI, TAU};

use rand::{Rng, RngExt};

use super::states::Hashed;
use super::{MotionNoise, Pose, around, nearest, turned};
use crate::value::error::parameter;
use crate::value::{MapStep, ValueError};

/// Particles of a belief, behind the first images.
pub(super) const PARTICLES: usize = 500;
/// They may be more by so many until they are drawn anew.
const ROOM: usize = 100;
/// Poses belong together that are in the same square of so many moves and the same of so many sectors, and all that are no further from
/// the mean of these than so many moves and radians.
const SQUARE: f64 = 2.0;
const SECTORS: i64 = 8;
const NEAR: (f64, f64) = (2.5, 0.5);
/// Share of the newest image in how much was expected.
const NEWEST: f64 = 0.05;

/// Particles, each a pose (x, y, heading) and its probability; how much was expected; draws so far; fractions bit by bit.
pub type BeliefParts = (Vec<[u64; 4]>, u64, u64);

/// Poses where the robot may be, each with its probability, which sum to 1. None of them: nothing is known yet.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Belief {
    pub(super) particles: Vec<(Pose, f64)>,
    /// Running mean of how much better than by chance what was seen had been expected, as a logarithm.
    pub(super) expected: f64,
    /// How often random numbers were drawn for it.
    pub(super) draws: u64,
}

impl Belief {
    /// Where the robot may be: the most probable pose with all around it, then that of the others, and so on, at most `count`
    /// of them until they make up `share`; and how probable each is, the most probable first.
    pub fn modes(&self, count: usize, share: f64) -> Vec<(Pose, f64)> {
        let (mut left, mut modes, mut told) = (self.particles.clone(), Vec::new(), 0.0);
        while modes.len() < count && told < share && !left.is_empty() {
            let (mode, around) = mode(&left);
            left.retain(|of| !is_near(of.0, mode));
            told += around;
            modes.push((mode, around));
        }
        // What lies around a pose may be more than around one that is more probable alone.
        modes.sort_by(|a, b| b.1.total_cmp(&a.1));
        modes
    }

    /// Particles and the rest, bit by bit.
    pub fn to_parts(&self) -> BeliefParts {
        let bits = |&(pose, probability): &(Pose, f64)| [pose.x, pose.y, pose.heading, probability].map(f64::to_bits);
        (self.particles.iter().map(bits).collect(), self.expected.to_bits(), self.draws)
    }

    /// What these were the parts of.
    ///
    /// # Errors
    /// A pose that is not finite, a probability that is none.
    pub fn from_parts((particles, expected, draws): BeliefParts) -> Result<Self, ValueError> {
        let of = |bits: [u64; 4]| {
            let [x, y, heading, probability] = bits.map(f64::from_bits);
            let finite = [x, y, heading].iter().all(|number| number.is_finite());
            parameter("pose", x + y + heading, finite, "finite")?;
            parameter("probability", probability, (0.0..=1.0 + 1e-9).contains(&probability), "0 to 1")?;
            Ok((Pose { x, y, heading }, probability))
        };
        let particles = particles.into_iter().map(of).collect::<Result<_, ValueError>>()?;
        Ok(Belief { particles, expected: f64::from_bits(expected), draws })
    }

    /// One step later.
    pub(super) fn drive(&mut self, noise: MotionNoise, step: MapStep, unit: f64, rng: &mut impl Rng) {
        self.particles.iter_mut().for_each(|of| of.0 = noise.after(of.0, step, unit, rng));
    }

    /// With so much probability it is elsewhere; where there is no elsewhere, it is where it was.
    pub(super) fn doubt(&mut self, probability: f64, elsewhere: impl ExactSizeIterator<Item = Pose>) {
        if elsewhere.len() == 0 {
            return;
        }
        self.particles.iter_mut().for_each(|of| of.1 *= 1.0 - probability);
        let share = probability / elsewhere.len() as f64;
        self.particles.extend(elsewhere.map(|pose| (pose, share)));
    }

    /// Weigh all particles by how probable at each pose what was perceived is, a logarithm; how probable it was in all.
    pub(super) fn weigh(&mut self, mut log_probability: impl FnMut(Pose) -> f64) -> f64 {
        if self.particles.is_empty() {
            return 0.0;
        }
        self.particles.iter_mut().for_each(|of| of.1 *= log_probability(of.0).exp());
        let sum = self.particles.iter().map(|of| of.1).sum::<f64>();
        self.particles.iter_mut().for_each(|of| of.1 /= sum);
        sum.ln()
    }

    /// Take note of how much what was perceived at the newest state had been expected.
    pub(super) fn expected(&mut self, expected: f64) {
        self.expected = (1.0 - NEWEST) * self.expected + NEWEST * expected;
    }

    /// Where few particles hold most of the probability, draw them anew; which ones these were.
    pub(super) fn resample(&mut self, rng: &mut impl Rng) -> Option<Vec<u32>> {
        let squares = self.particles.iter().map(|of| of.1 * of.1).sum::<f64>();
        if (PARTICLES..=PARTICLES + ROOM).contains(&self.particles.len()) && 2.0 / squares > PARTICLES as f64 {
            return None;
        }
        let drawn = draw(self.particles.iter().map(|of| of.1), PARTICLES, rng);
        let share = 1.0 / PARTICLES as f64;
        self.particles = drawn.iter().map(|&of| (self.particles[of as usize].0, share)).collect();
        Some(drawn)
    }
}

/// Draw by weight, at even distances (systematic resampling).
pub(super) fn draw(weights: impl ExactSizeIterator<Item = f64> + Clone, count: usize, rng: &mut impl Rng) -> Vec<u32> {
    let (last, sum) = (weights.len().saturating_sub(1), weights.clone().sum::<f64>());
    let first = rng.random_range(0.0..1.0);
    let (mut drawn, mut until) = (Vec::with_capacity(count), 0.0);
    for (place, weight) in weights.enumerate() {
        until += weight / sum * count as f64;
        while drawn.len() < count && (first + drawn.len() as f64) < until || place == last && drawn.len() < count {
            drawn.push(place as u32);
        }
    }
    drawn
}

fn is_near(a: Pose, b: Pose) -> bool {
    (a.x - b.x).powi(2) + (a.y - b.y).powi(2) < NEAR.0 * NEAR.0 && turned(a.heading, b.heading) < NEAR.1
}

/// Mean of poses whose headings are next to one, and their probability.
fn mean<'a>(of: impl Iterator<Item = &'a (Pose, f64)>, heading: f64) -> (Pose, f64) {
    let mut sums = [0.0; 4];
    for &(pose, weight) in of {
        let turned = around(pose.heading - heading + PI) - PI;
        sums.iter_mut().zip([1.0, pose.x, pose.y, turned]).for_each(|(sum, part)| *sum += weight * part);
    }
    let [weight, x, y, turned] = sums;
    (Pose { x: x / weight, y: y / weight, heading: heading + turned / weight }, weight)
}

/// The mean of the poses of the most probable place, and how probable it is.
pub(super) fn mode(particles: &[(Pose, f64)]) -> (Pose, f64) {
    let square = |pose: Pose| {
        let sector = nearest(pose.heading / TAU * SECTORS as f64).rem_euclid(SECTORS);
        [nearest(pose.x / SQUARE), nearest(pose.y / SQUARE), sector]
    };
    let mut squares: Hashed<[i64; 3], f64> = Hashed::default();
    particles.iter().for_each(|of| *squares.entry(square(of.0)).or_default() += of.1);
    let more = |a: &([i64; 3], f64), b: &([i64; 3], f64)| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0));
    let Some((most, _)) = squares.into_iter().max_by(more) else { return (Pose::default(), 0.0) };
    let sector = most[2] as f64 / SECTORS as f64 * TAU;
    let middle = mean(particles.iter().filter(|of| square(of.0) == most), sector).0;
    let near = mean(particles.iter().filter(|of| is_near(of.0, middle)), middle.heading);
    if near.1 > 0.0 { near } else { (middle, 0.0) }
}
