//! How much one image looks like what was seen at each place.

use std::collections::HashMap;
use std::ops::Range;

use super::Pose;
use super::goals::SIDE;
use super::states::{ByCell, Cell, HEADINGS, PlaceMap, cell};

/// Standard deviation of where states count, moves; weight of those one heading further.
const NEARBY: f64 = 0.6;
const TURNED: f64 = 0.5;
/// How far that is looked for, cells; states that count less than this do not count.
const REACH: i32 = 2;
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
    /// What the states of a cell say together, and how many they are.
    told: ByCell<[f64; 2]>,
    ratios: ByCell<f64>,
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
            told: HashMap::default(),
            ratios: HashMap::default(),
        }
    }

    /// Logarithm of how much more often such an image is seen at a pose than elsewhere.
    pub fn log_ratio(&mut self, pose: Pose) -> f64 {
        let cell = cell(pose);
        if let Some(&ratio) = self.ratios.get(&cell) {
            return ratio;
        }
        let (mut sum, mut count) = (0.0, 0.0);
        for dx in -REACH..=REACH {
            for dy in -REACH..=REACH {
                let near = (-0.5 * f64::from(dx * dx + dy * dy) * (SIDE / NEARBY).powi(2)).exp();
                for turn in (-1..=1).filter(|_| near > LEAST) {
                    let weight = if turn == 0 { near } else { near * TURNED };
                    let heading = (cell.2 + turn).rem_euclid(HEADINGS);
                    let told = self.of_cell((cell.0.saturating_add(dx), cell.1.saturating_add(dy), heading));
                    (sum, count) = (sum + weight * told[0], count + weight * told[1]);
                }
            }
        }
        let ratio = (sum + CHANCE * self.unseen * self.by_chance) / ((count + CHANCE) * self.by_chance);
        let ratio = ratio.ln().clamp(TRUSTED.start, TRUSTED.end);
        self.ratios.insert(cell, ratio);
        ratio
    }

    fn of_cell(&mut self, cell: Cell) -> [f64; 2] {
        *self.told.entry(cell).or_insert_with(|| {
            let states = self.map.cells.0.get(&cell).into_iter().flatten();
            let states = states.filter(|&&state| !self.without.contains(&(state as usize)));
            states.fold([0.0; 2], |[sum, count], &state| [sum + self.map.likeness(state, self.seen), count + 1.0])
        })
    }
}
