//! What counts as being at a place that was shown: nearness to what was marked there, on a map of the floor.

use std::sync::Arc;

use faer::{ColRef, Mat, MatRef};

use crate::value::{Instances, ValueError};

/// Of the marks, this share is compared with a state: those that look most like it, and so have about its heading. A map is not
/// equally right for all headings; what it misses is the same for both then.
const COMPARED: f64 = 0.2;

/// A state that looks less like every mark than this share of the actions there make a difference is somewhere else: where the map
/// is wrong, or knows nothing, another place may lie on the marks.
const TOLD_BY: f64 = 0.95;
/// Actions are there if they begin at one of so many states nearest to a mark; of so many marks at most.
const ACTIONS: usize = 5;
const ASKED: usize = 100;

/// Where states lie on the floor, by those whose places are known ([`MetricMap`](crate::value::MetricMap)).
#[derive(Debug, Clone)]
pub struct FloorMap {
    /// In coordinates of the slowest features ([`points`](super::points)); local values have the same, and search them once for both.
    instances: Arc<Instances>,
    /// Their places, x and y, in lengths of a move.
    places: [Vec<f64>; 2],
}

impl FloorMap {
    /// The map of some states by their places, `2 × N`, in lengths of a move.
    ///
    /// # Errors
    /// Another number of places than of states.
    pub fn new(instances: Arc<Instances>, places: MatRef<'_, f64>) -> Result<Self, ValueError> {
        if places.nrows() != 2 {
            return Err(ValueError::Features { what: "places", found: places.nrows(), expected: 2 });
        }
        if places.ncols() != instances.len() {
            return Err(ValueError::Length { what: "places", found: places.ncols(), expected: instances.len() });
        }
        let places = [0, 1].map(|axis| places.row(axis).iter().copied().collect::<Vec<f64>>());
        Ok(FloorMap { instances, places })
    }

    /// The states whose places are known.
    pub fn instances(&self) -> &Arc<Instances> {
        &self.instances
    }

    /// Their places, `2 × N`, lengths of a move.
    pub fn places(&self) -> Mat<f64> {
        Mat::from_fn(2, self.instances.len(), |axis, j| self.places[axis][j])
    }

    /// The places in the form that values of actions have: [`Instances::action_values`] of both and of what transitions are worth
    /// search neighbours once.
    pub fn coordinates(&self) -> [&[f64]; 2] {
        [&self.places[0], &self.places[1]]
    }

    /// The place of a state from what the neighbours of each action say of both coordinates, `A × n` each.
    pub fn place(&self, found: &[Mat<f64>], j: usize) -> [f64; 2] {
        let counts = self.instances.counts();
        [0, 1].map(|axis| {
            let told = counts.iter().enumerate().filter(|(_, count)| **count > 0);
            told.map(|(a, &count)| found[axis][(a, j)] * count as f64).sum::<f64>() / self.instances.len() as f64
        })
    }

    /// Places of points, `2 × n`.
    ///
    /// # Errors
    /// Points of another dimension or not finite.
    pub fn places_of(&self, points: MatRef<'_, f32>) -> Result<Mat<f64>, ValueError> {
        let found = self.instances.action_values(&self.coordinates(), points)?;
        let places: Vec<[f64; 2]> = (0..points.ncols()).map(|j| self.place(&found, j)).collect();
        Ok(Mat::from_fn(2, places.len(), |axis, j| places[j][axis]))
    }
}

/// The places near the marks of a goal, or of what is to be avoided.
#[derive(Debug, Clone, PartialEq)]
pub struct GoalRegion {
    /// In coordinates of the slowest features, `p × M`.
    marks: Mat<f32>,
    /// Places of the marks, `2 × M`, lengths of a move.
    marked: Mat<f64>,
    /// Nearer than this is there, lengths of a move.
    within: f64,
    /// The squared distance from all marks, in coordinates of features, at which a state is somewhere else.
    unlike: f64,
    /// Centre of the marks' places, and the farthest of them from it: states beyond need not be compared.
    around: ([f64; 2], f64),
}

impl GoalRegion {
    /// What is nearer than `within` to marks, `p × M`. How unlike the marks a state may look there is told by what actions change
    /// near them: states before and after some, `p × n`.
    ///
    /// # Errors
    /// No marks, shapes that do not fit, values that are not finite.
    pub fn new(
        map: &FloorMap,
        marks: Mat<f32>,
        within: f64,
        [before, after]: [MatRef<'_, f32>; 2],
    ) -> Result<Self, ValueError> {
        if after.nrows() != before.nrows() || after.ncols() != before.ncols() {
            return Err(ValueError::Length { what: "states after", found: after.ncols(), expected: before.ncols() });
        }
        let marked = map.places_of(marks.as_ref())?;
        let near = |mark: ColRef<'_, f32>| {
            let mut nearest: Vec<(f64, usize)> = before.col_iter().map(|state| squared(mark, state)).zip(0..).collect();
            nearest.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
            nearest.truncate(ACTIONS);
            nearest.into_iter().map(|(_, j)| squared(before.col(j), after.col(j))).collect::<Vec<f64>>()
        };
        let asked = marks.ncols().div_ceil(ASKED).max(1);
        let mut changes: Vec<f64> = marks.col_iter().step_by(asked).flat_map(near).collect();
        changes.sort_by(f64::total_cmp);
        let told = changes.get((changes.len() as f64 * TOLD_BY) as usize).copied();
        GoalRegion::from_parts(marks, marked, within, told.unwrap_or(f64::INFINITY))
    }

    /// The same from what it consists of, see the functions of these names.
    ///
    /// # Errors
    /// No marks, shapes that do not fit.
    pub fn from_parts(marks: Mat<f32>, marked: Mat<f64>, within: f64, unlike: f64) -> Result<Self, ValueError> {
        let count = marks.ncols();
        if count == 0 {
            return Err(ValueError::Empty);
        }
        if marked.nrows() != 2 || marked.ncols() != count {
            return Err(ValueError::Length { what: "places of marks", found: marked.ncols(), expected: count });
        }
        let centre = [0, 1].map(|axis| marked.row(axis).iter().sum::<f64>() / count as f64);
        let from_centre = |k: usize| (marked[(0, k)] - centre[0]).hypot(marked[(1, k)] - centre[1]);
        let farthest = (0..count).map(from_centre).fold(0.0, f64::max);
        Ok(GoalRegion { marks, marked, within, unlike, around: (centre, farthest) })
    }

    /// Points of the marks, `p × M`.
    pub fn marks(&self) -> MatRef<'_, f32> {
        self.marks.as_ref()
    }

    /// Places of the marks, `2 × M`, lengths of a move.
    pub fn marked(&self) -> MatRef<'_, f64> {
        self.marked.as_ref()
    }

    /// The distance at which nearness ends, lengths of a move.
    pub fn within(&self) -> f64 {
        self.within
    }

    /// The squared distance from all marks, in coordinates of features, at which a state is somewhere else.
    pub fn unlike(&self) -> f64 {
        self.unlike
    }

    /// Whether a state lies in it, by its point and its place. One that is not finite does not.
    pub fn holds(&self, point: ColRef<'_, f32>, place: [f64; 2]) -> bool {
        self.depth(point, place) > 0.0
    }

    /// How far inside a state lies: 1 at the marks, 0 where nearness ends and farther away.
    pub fn depth(&self, point: ColRef<'_, f32>, place: [f64; 2]) -> f64 {
        let (centre, farthest) = self.around;
        if (place[0] - centre[0]).hypot(place[1] - centre[1]) > farthest + self.within {
            return 0.0;
        }
        let compared = ((self.marks.ncols() as f64 * COMPARED).round() as usize).max(1);
        let mut like: Vec<(f64, usize)> =
            self.marks.col_iter().enumerate().map(|(k, mark)| (squared(mark, point), k)).collect();
        like.select_nth_unstable_by(compared - 1, |a, b| a.0.total_cmp(&b.0));
        let like = &like[..compared];
        let mean = |axis: usize| like.iter().map(|&(_, k)| self.marked[(axis, k)]).sum::<f64>() / compared as f64;
        let distance = (place[0] - mean(0)).hypot(place[1] - mean(1));
        // Not a number where the place is none.
        if distance < self.within && like.iter().any(|of| of.0 <= self.unlike) {
            1.0 - distance / self.within
        } else {
            0.0
        }
    }
}

fn squared(a: ColRef<'_, f32>, b: ColRef<'_, f32>) -> f64 {
    a.iter().zip(b.iter()).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum()
}
