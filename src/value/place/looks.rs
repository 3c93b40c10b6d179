//! How much one image looks like what was seen at each place.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::hash::{BuildHasherDefault, Hasher};
use std::ops::Range;

use super::{PlaceMap, Pose};

/// Cells: so many moves along each axis, and so many headings.
const SIDE: f64 = 0.6;
const HEADINGS: i32 = 24;
/// States of a cell that are asked.
const MOST: usize = 8;
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

/// Square of the floor and heading.
type Cell = (i32, i32, i32);
type ByCell<T> = HashMap<Cell, T, BuildHasherDefault<Mix>>;

/// Cells are looked up thousands of times for each image, and nobody chooses them to collide: three multiplications are enough.
#[derive(Debug, Clone, Default)]
struct Mix(u64);

impl Hasher for Mix {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|&byte| self.write_i32(i32::from(byte)));
    }

    fn write_i32(&mut self, number: i32) {
        self.0 = (self.0.rotate_left(23) ^ u64::from(number.cast_unsigned())).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn finish(&self) -> u64 {
        self.0 ^ self.0 >> 32
    }
}

fn cell(pose: Pose) -> Cell {
    let square = |at: f64| (at / SIDE).round() as i32;
    let heading = (pose.heading / TAU * f64::from(HEADINGS)).round() as i64;
    (square(pose.x), square(pose.y), heading.rem_euclid(i64::from(HEADINGS)) as i32)
}

/// States by the cells that they lie in.
#[derive(Debug, Clone, Default)]
pub(super) struct Cells(ByCell<Vec<u32>>);

impl Cells {
    /// All that have poses, evenly thinned where they are many.
    pub fn of(poses: &[Option<Pose>]) -> Self {
        let mut cells = Cells::default();
        for (state, pose) in poses.iter().enumerate().filter_map(|(state, pose)| Some((state, (*pose)?))) {
            cells.0.entry(cell(pose)).or_default().push(state as u32);
        }
        for states in cells.0.values_mut().filter(|states| states.len() > MOST) {
            *states = (0..MOST).map(|k| states[k * states.len() / MOST]).collect();
        }
        cells
    }

    /// A state has another pose now; of a full cell, the state that came first is left out.
    pub fn place(&mut self, state: u32, from: Option<Pose>, to: Option<Pose>) {
        if let Some(states) = from.and_then(|from| self.0.get_mut(&cell(from))) {
            states.retain(|&of| of != state);
        }
        if let Some(to) = to {
            let states = self.0.entry(cell(to)).or_default();
            if states.len() == MOST {
                states.remove(0);
            }
            states.push(state);
        }
    }
}

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
