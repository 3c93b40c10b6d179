//! How much one image looks like what was seen at each place.

use std::array::from_fn;
use std::ops::Range;

use super::Pose;
use super::goals::SIDE;
use super::states::{BySquare, HEADINGS, PlaceMap, beside, cell};

/// Standard deviation of where states count, moves; weight of those one heading further.
const NEARBY: f64 = 0.6;
const TURNED: f64 = 0.5;
/// How far that is looked for, cells; states that count less than this do not count.
const REACH: i32 = 2;
const ACROSS: usize = 5;
const LEAST: f64 = 0.1;
/// How many states of chance are set against those of a pose.
const CHANCE: f64 = 2.0;
/// Where nothing was seen yet: of a map that grows, an image is more probable there than by chance, as it is like those next to it; of
/// one that is known, robots are hardly there. As logarithms.
pub(super) const GROWS: f64 = 0.3;
pub(super) const KNOWN: f64 = -1.0;
/// What was seen at a pose says this much about it at most, as logarithms.
const TRUSTED: Range<f64> = -4.0..4.0;

/// One image before a map.
pub(super) struct Looks<'a> {
    map: &'a PlaceMap,
    seen: &'a [f32],
    /// These states do not count.
    without: Range<usize>,
    by_chance: f64,
    unseen: f64,
    /// How much a square so far away counts, along each axis.
    weights: [[f64; ACROSS]; ACROSS],
    /// What the states over a square of the floor say together, and how many they are, by heading; and the ratios there. Not a number:
    /// nobody asked yet.
    told: BySquare<[[f64; 2]; HEADINGS]>,
    ratios: BySquare<[f64; HEADINGS]>,
}

impl<'a> Looks<'a> {
    pub fn new(map: &'a PlaceMap, seen: &'a [f32], without: Range<usize>, unseen: f64) -> Self {
        let by_chance = map.chance(seen, &without);
        Looks {
            map,
            seen,
            without,
            by_chance,
            unseen: unseen.exp(),
            weights: from_fn(|dx| from_fn(|dy| weight(dx as i32 - REACH, dy as i32 - REACH))),
            told: BySquare::default(),
            ratios: BySquare::default(),
        }
    }

    /// Logarithm of how much more often such an image is seen at a pose than elsewhere.
    pub fn log_ratio(&mut self, pose: Pose) -> f64 {
        let ([x, y], heading) = cell(pose);
        let known = self.ratios.get(&[x, y]).map_or(f64::NAN, |of| of[heading]);
        if !known.is_nan() {
            return known;
        }
        let (mut sum, mut count) = (0.0, 0.0);
        for (dx, weights) in (-REACH..).zip(self.weights) {
            for (dy, near) in (-REACH..).zip(weights).filter(|of| of.1 > LEAST) {
                let square = [x.saturating_add(dx), y.saturating_add(dy)];
                let told = self.told.entry(square).or_insert([[f64::NAN; 2]; HEADINGS]);
                for at in beside(heading) {
                    if told[at][0].is_nan() {
                        let states = self.map.cells.over(square).into_iter().flat_map(|over| &over[at]);
                        let states = states.filter(|&&state| !self.without.contains(&(state as usize)));
                        told[at] = states.fold([0.0; 2], |[sum, count], &state| {
                            [sum + self.map.likeness(state, self.seen), count + 1.0]
                        });
                    }
                    let weight = if at == heading { near } else { near * TURNED };
                    (sum, count) = (sum + weight * told[at][0], count + weight * told[at][1]);
                }
            }
        }
        let ratio = (sum + CHANCE * self.unseen * self.by_chance) / ((count + CHANCE) * self.by_chance);
        let ratio = ratio.ln().clamp(TRUSTED.start, TRUSTED.end);
        self.ratios.entry([x, y]).or_insert([f64::NAN; HEADINGS])[heading] = ratio;
        ratio
    }
}

fn weight(dx: i32, dy: i32) -> f64 {
    (-0.5 * f64::from(dx * dx + dy * dy) * (SIDE / NEARBY).powi(2)).exp()
}
