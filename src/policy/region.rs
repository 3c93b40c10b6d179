//! What counts as being at a goal that was shown: nearness to what was marked there.

use faer::{ColRef, Mat, MatRef};

use crate::value::{Instances, LocalOptions, ValueError};

/// Of the marks, this share is compared with a state: those that look most like it, and so have about its heading. A map is not
/// equally right for all headings; what it misses is the same for both then.
const COMPARED: f64 = 0.2;

/// A state that looks less like every mark than this many times what lies there does is somewhere else: where no known states are
/// near, their places say nothing. What lies there is told by this share of the known states that do.
const UNLIKE: f64 = 1.5;
const TOLD_BY: f64 = 0.95;

/// The states that lie near the marks of a goal, on a map that was learned from what actions do
/// ([`MetricMap`](crate::value::MetricMap)).
///
/// States and marks are points in coordinates of the slowest features ([`points`](super::points)).
#[derive(Debug, Clone, PartialEq)]
pub struct GoalRegion {
    /// States whose places are known, as one action of local values.
    states: Instances,
    /// Their places, x and y, in lengths of a move.
    places: [Vec<f64>; 2],
    /// `p × M`.
    marks: Mat<f32>,
    /// Places of the marks, `2 × M`.
    marked: Mat<f64>,
    /// Nearer than this is there, lengths of a move.
    within: f64,
    /// The squared distance from all marks, in coordinates of features, at which a state is somewhere else.
    unlike: f64,
}

impl GoalRegion {
    /// The states nearer than `within` to marks, `p × M`, by the places of some states, `p × n` and `2 × n`, in lengths of a move.
    ///
    /// # Errors
    /// No marks, shapes that do not fit, values that are not finite.
    pub fn new(
        states: Mat<f32>,
        places: MatRef<'_, f64>,
        marks: Mat<f32>,
        within: f64,
        options: LocalOptions,
    ) -> Result<Self, ValueError> {
        let n = states.ncols();
        if marks.ncols() == 0 {
            return Err(ValueError::Empty);
        }
        if places.nrows() != 2 {
            return Err(ValueError::Features { what: "places", found: places.nrows(), expected: 2 });
        }
        let states = Instances::new(states, vec![n], options)?;
        let places = [0, 1].map(|axis| places.row(axis).iter().copied().collect::<Vec<f64>>());
        let marked = places_of(&states, &places, marks.as_ref())?;
        let mut region = GoalRegion { states, places, marks, marked, within, unlike: f64::INFINITY };
        let known = (0..n).filter_map(|j| {
            let (unlike, distance) =
                region.compare(region.states.points().col(j), [0, 1].map(|axis| region.places[axis][j]));
            (distance < within).then_some(unlike)
        });
        let mut known: Vec<f64> = known.collect();
        known.sort_by(f64::total_cmp);
        let told = known.get((known.len() as f64 * TOLD_BY) as usize).copied();
        region.unlike = told.map_or(f64::INFINITY, |told| told * UNLIKE * UNLIKE);
        Ok(region)
    }

    /// The squared distance of a point from the mark that is most like it, in coordinates of features, and that of its place from
    /// those of the marks that are like it.
    fn compare(&self, point: ColRef<'_, f32>, place: [f64; 2]) -> (f64, f64) {
        let compared = ((self.marks.ncols() as f64 * COMPARED).round() as usize).max(1);
        let mut like: Vec<(f64, usize)> =
            self.marks.col_iter().enumerate().map(|(k, mark)| (squared(mark, point), k)).collect();
        like.select_nth_unstable_by(compared - 1, |a, b| a.0.total_cmp(&b.0));
        let like = &like[..compared];
        let mean = |axis: usize| like.iter().map(|&(_, k)| self.marked[(axis, k)]).sum::<f64>() / compared as f64;
        let unlike = like.iter().map(|of| of.0).fold(f64::INFINITY, f64::min);
        (unlike, (place[0] - mean(0)).hypot(place[1] - mean(1)))
    }

    /// The same, of states within a distance of the marks alone: places farther off are of no use to it.
    ///
    /// # Errors
    /// Those of [`GoalRegion::new`].
    pub fn near(self, distance: f64) -> Result<Self, ValueError> {
        let far = |j: usize, k: usize| {
            (self.places[0][j] - self.marked[(0, k)]).hypot(self.places[1][j] - self.marked[(1, k)]) > distance
        };
        let kept: Vec<usize> =
            (0..self.states.len()).filter(|&j| !(0..self.marks.ncols()).all(|k| far(j, k))).collect();
        if kept.is_empty() {
            return Ok(self);
        }
        let points = self.states.points();
        let states = Mat::from_fn(points.nrows(), kept.len(), |i, j| points[(i, kept[j])]);
        let places = Mat::from_fn(2, kept.len(), |axis, j| self.places[axis][kept[j]]);
        let options = self.states.options();
        GoalRegion::new(states, places.as_ref(), self.marks, self.within, options)
    }

    /// Points of the states, `p × n`.
    pub fn states(&self) -> MatRef<'_, f32> {
        self.states.points()
    }

    /// Places of the states, `2 × n`, lengths of a move.
    pub fn places(&self) -> Mat<f64> {
        Mat::from_fn(2, self.states.len(), |axis, j| self.places[axis][j])
    }

    /// Points of the marks, `p × M`.
    pub fn marks(&self) -> MatRef<'_, f32> {
        self.marks.as_ref()
    }

    /// How places are told from those of neighbours.
    pub fn options(&self) -> LocalOptions {
        self.states.options()
    }

    /// The distance at which nearness ends, lengths of a move.
    pub fn within(&self) -> f64 {
        self.within
    }

    /// Whether each of some points, `p × n`, lies in it. One that is not finite does not.
    pub fn holds(&self, points: MatRef<'_, f32>) -> Vec<bool> {
        let Ok(places) = places_of(&self.states, &self.places, points) else { return vec![false; points.ncols()] };
        let holds = |j: usize| {
            let (unlike, distance) = self.compare(points.col(j), [places[(0, j)], places[(1, j)]]);
            distance < self.within && unlike <= self.unlike
        };
        (0..points.ncols()).map(holds).collect()
    }
}

/// Places of points by their neighbours among the states, `2 × n`.
fn places_of(states: &Instances, places: &[Vec<f64>; 2], points: MatRef<'_, f32>) -> Result<Mat<f64>, ValueError> {
    let found = states.action_values(&[&places[0], &places[1]], points)?;
    Ok(Mat::from_fn(2, points.ncols(), |axis, j| found[axis][(0, j)]))
}

fn squared(a: ColRef<'_, f32>, b: ColRef<'_, f32>) -> f64 {
    a.iter().zip(b.iter()).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum()
}
