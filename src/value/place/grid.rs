//! Poses on a grid, and what a motion does to a probability of each.

use std::f64::consts::TAU;

use crate::value::MapStep;

/// What a move may be instead of itself: probability, share of its length that is driven, share that it slips to the left. Robots
/// slide along walls and are stopped halfway.
const MOVES: [(f64, f64, f64); 6] =
    [(0.5, 1.0, 0.0), (0.12, 0.6, 0.0), (0.08, 1.3, 0.0), (0.1, 0.8, 0.4), (0.1, 0.8, -0.4), (0.1, 0.3, 0.0)];
/// Of an action that a wall has stopped, in lengths of a move.
const STOPS: [(f64, f64, f64); 5] =
    [(0.8, 0.0, 0.0), (0.05, 0.5, 0.0), (0.05, -0.5, 0.0), (0.05, 0.0, 0.5), (0.05, 0.0, -0.5)];
/// Of a turn.
const STAYS: [(f64, f64, f64); 1] = [(1.0, 0.0, 0.0)];
/// A place and a direction. Units: lengths of a move, radians counter-clockwise.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Pose {
    /// Along the first axis.
    pub x: f64,
    /// Along the second axis.
    pub y: f64,
    /// From the first axis to the second.
    pub heading: f64,
}

/// `headings × size × size` poses. Both axes close on themselves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Grid {
    pub headings: usize,
    pub size: usize,
}

impl Grid {
    pub fn cells(self) -> usize {
        self.headings * self.size * self.size
    }

    /// Number of the cell of a pose.
    pub fn cell(self, pose: Pose) -> usize {
        let wrap = |at: f64| at.round().rem_euclid(self.size as f64) as usize % self.size;
        let heading = (pose.heading / TAU * self.headings as f64).round().rem_euclid(self.headings as f64) as usize;
        ((heading % self.headings) * self.size + wrap(pose.x)) * self.size + wrap(pose.y)
    }

    /// Heading, and place along both axes.
    pub fn parts(self, cell: usize) -> (usize, usize, usize) {
        (cell / (self.size * self.size), cell / self.size % self.size, cell % self.size)
    }

    pub fn pose(self, cell: usize) -> Pose {
        let (heading, x, y) = self.parts(cell);
        Pose { x: x as f64, y: y as f64, heading: TAU * heading as f64 / self.headings as f64 }
    }

    /// The cell that is so many further along both axes.
    pub fn shifted(self, cell: usize, by: [isize; 2]) -> usize {
        let (heading, x, y) = self.parts(cell);
        let wrap = |at: usize, by: isize| (at as isize + by).rem_euclid(self.size as isize) as usize;
        (heading * self.size + wrap(x, by[0])) * self.size + wrap(y, by[1])
    }

    /// By how many cells one lies beyond another along both axes.
    pub fn away(self, cell: usize, from: usize) -> [isize; 2] {
        let ((_, ax, ay), (_, bx, by)) = (self.parts(cell), self.parts(from));
        let size = self.size as isize;
        [(ax, bx), (ay, by)].map(|(a, b)| (a as isize - b as isize + size / 2).rem_euclid(size) - size / 2)
    }

    /// Whether a cell is within two moves of another, with its heading.
    pub fn is_near(self, cell: usize, of: usize) -> bool {
        self.parts(cell).0 == self.parts(of).0 && self.away(cell, of).iter().all(|by| by.abs() <= 2)
    }

    /// What a step does; `unit`: length of a move; `veers`: standard deviation of the heading behind it, radians.
    pub fn motion(self, step: MapStep, unit: f64, veers: f64) -> Motion {
        let turned = step.turn / TAU * self.headings as f64;
        let (whole, part) = (turned.floor(), turned - turned.floor());
        let heading = |whole: f64| whole.rem_euclid(self.headings as f64) as usize % self.headings;
        // As much as makes that standard deviation.
        let veers = ((veers * self.headings as f64 / TAU).powi(2) / 2.0).min(0.5);
        let turns =
            [(-1.0, veers), (0.0, 1.0 - 2.0 * veers), (1.0, veers)].into_iter().flat_map(|(more, probability)| {
                [(heading(whole + more), (1.0 - part) * probability), (heading(whole + more + 1.0), part * probability)]
            });
        let turns = turns.filter(|turn| turn.1 > 0.0).collect();
        let spread = (0..self.headings).map(|heading| {
            let (sin, cos) = (TAU * heading as f64 / self.headings as f64).sin_cos();
            let mut to: Vec<([isize; 2], f64)> = Vec::new();
            let (outcomes, length) = match step.distance {
                None => (&STOPS[..], 1.0),
                Some(0.0) => (&STAYS[..], 1.0),
                Some(distance) => (&MOVES[..], distance / unit),
            };
            for &(probability, ahead, left) in outcomes {
                let (ahead, left) = (ahead * length, left * length);
                let at = [cos * ahead - sin * left, sin * ahead + cos * left];
                let corner = at.map(f64::floor);
                let part = [at[0] - corner[0], at[1] - corner[1]];
                for (dx, wx) in [(0.0, 1.0 - part[0]), (1.0, part[0])] {
                    for (dy, wy) in [(0.0, 1.0 - part[1]), (1.0, part[1])] {
                        let by = [(corner[0] + dx) as isize, (corner[1] + dy) as isize];
                        match to.iter_mut().find(|of| of.0 == by) {
                            Some(of) => of.1 += probability * wx * wy,
                            None => to.push((by, probability * wx * wy)),
                        }
                    }
                }
            }
            to.retain(|of| of.1 > 0.0);
            to
        });
        Motion { grid: self, turns, spread: spread.collect() }
    }
}

/// How probable each shift is.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    grid: Grid,
    /// By how many headings it turns.
    turns: Vec<(usize, f64)>,
    /// For each new heading, by how many cells it moves.
    spread: Vec<Vec<([isize; 2], f64)>>,
}

impl Motion {
    /// Where a cell may lead to, and how probably.
    pub fn from(&self, cell: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let Grid { headings, size } = self.grid;
        let (heading, rest) = (cell / (size * size), cell % (size * size));
        self.turns.iter().flat_map(move |&(by, share)| {
            let turned = (heading + by) % headings;
            let at = turned * size * size + rest;
            self.spread[turned].iter().map(move |&(by, probability)| (self.grid.shifted(at, by), share * probability))
        })
    }
}
