//! What slow features must look like when the true state is known: optimal responses, in the order of their slowness.
//!
//! A state `s` of `p` coordinates lives in a box; each coordinate is an [`Axis`] that is *free* (it ends at walls, which
//! reflect) or *cyclic* (its ends are the same place, like a heading). Functions of one axis of width `L`, with
//! `u = (s − low)/L` in [0, 1]:
//!
//! | axis | number `j` | function `ψ_j` | wave number `κ_j` |
//! |---|---|---|---|
//! | both | 0 | 1 | 0 |
//! | free | 1, 2, 3 … | cos(jπu) | jπ/L |
//! | cyclic | 1, 3, 5 … | sin((j+1)πu) | (j+1)π/L |
//! | cyclic | 2, 4, 6 … | cos(jπu) | jπ/L |
//!
//! The optimal responses are their products `φ_n(s) = Π_d c_d ψ_{n_d}(s_d)` with `c_d = √2`, or 1 where `n_d = 0`; all
//! numbers zero is the constant and does not count. When the velocities along the axes are uncorrelated with each other
//! and do not depend on the state, the slowness of a response is
//!
//! `Δ_n = Σ_d κ_{n_d}² ⟨ṡ_d²⟩`,
//!
//! so the mean square speed along each axis decides the order. [`OptimalResponses::slowest`] lists the first `k` of them.
//!
//! Equal slowness: within a group of equally slow responses any rotation is as good (proposition *mixture responses*), so
//! slow feature analysis finds the span of a group, not its members. [`OptimalResponses::groups`] tells them apart.
//!
//! A robot that drives where it looks has `ẋ = v cos θ`: its velocity does depend on the state, and the formula is an
//! approximation. Averaged over all headings the motion is isotropic (`⟨ẋ²⟩ = ½⟨v²⟩`, [`plane_motion`]), so responses without
//! heading keep their Δ. Those with one turn of the heading do not (for `f(x)·√2 cos θ` the share of `⟨v²⟩` is ¾, not ½),
//! and derivatives of responses whose headings differ by two turns are correlated. Fast turning keeps such pairs far apart.
//!
//! # Errata of the thesis
//! - Cyclic and free boundary: the left side has index `i`, the right side `j`; they are the same number.
//! - Three dimensions: the parity test "`i` even / odd" belongs to the number `l` of the heading, since only the heading
//!   has sines; there `l` counts functions (1: sine, 2: cosine of one turn), so a cosine of number `l` has `l/2` turns.
//! - The factor √2³ gives unit variance only where all three numbers are non-zero: a number 0 contributes 1, not √2.
//!
//! # Reference
//! Thesis §4.1.2; Wiskott, Neural Computation 15 (2003); Franzius, Sprekeler & Wiskott, PLoS Comp. Biol. 3 (2007).

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;
use std::f64::consts::{PI, SQRT_2};
use std::ops::Range;

use faer::{Mat, MatRef};
use thiserror::Error;

/// The most responses that are listed: values over more features than this are out of reach (LSPI costs `O(f³)`).
pub const MOST_RESPONSES: usize = 1 << 16;

/// The most axes of a box. A rigid body with all its joints has fewer.
pub const MOST_AXES: usize = 16;

/// Responses count as equally slow when their Δ differ by less than this share: rounding makes about 1e-15 of it.
const EQUAL_SLOWNESS: f64 = 1e-9;

/// Slowness of the first function of an axis must lie in this range, so that no sum of theirs overflows or vanishes.
const UNIT_SLOWNESS: Range<f64> = 1e-280..1e280;

/// Why there are no optimal responses.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum TheoryError {
    /// An axis without a proper width.
    #[error("an axis from {low} to {high} is not allowed: both must be finite, with low < high")]
    Axis {
        /// Lower end.
        low: f64,
        /// Upper end.
        high: f64,
    },
    /// A box of no axes or too many.
    #[error("a box of {0} axes is not allowed: it must have 1 to {MOST_AXES}")]
    Axes(usize),
    /// Lists or matrices that do not fit each other.
    #[error("{what} has {found}, but {expected} is needed")]
    Shape {
        /// What does not fit.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size that fits.
        expected: usize,
    },
    /// An axis along which nothing moves has infinitely many functions of slowness 0.
    #[error(
        "the mean square speed {speed} along axis {axis} is not allowed: it must be > 0 and finite, \
         and give its slowest function a slowness from 1e-280 to 1e280"
    )]
    Speed {
        /// Which axis.
        axis: usize,
        /// Its mean square speed.
        speed: f64,
    },
    /// Too many responses, or none.
    #[error("{asked} responses are asked for: allowed are 1 to {most}")]
    Responses {
        /// Responses asked for.
        asked: usize,
        /// The most there are.
        most: usize,
    },
    /// A coordinate that is not a number, or too far away to tell its phase.
    #[error("coordinate {axis} of point {point} is {value}: it must be finite and within 1e9 widths of the axis")]
    Point {
        /// Which point.
        point: usize,
        /// Which axis.
        axis: usize,
        /// The coordinate.
        value: f64,
    },
}

impl TheoryError {
    fn unless_fits(what: &'static str, found: usize, expected: usize) -> Result<(), TheoryError> {
        if found == expected { Ok(()) } else { Err(TheoryError::Shape { what, found, expected }) }
    }
}

/// What happens at the ends of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Boundary {
    /// The state is stopped or reflected, like a position between walls.
    Free,
    /// The ends are the same place, like 0 and 2π of a heading.
    Cyclic,
}

/// One coordinate of a box: its ends, and what happens there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Axis {
    low: f64,
    width: f64,
    boundary: Boundary,
}

impl Axis {
    /// An axis from `low` to `high` that ends at walls.
    ///
    /// # Errors
    /// Ends that are not finite or not in ascending order.
    pub fn free(low: f64, high: f64) -> Result<Self, TheoryError> {
        Self::new(low, high, Boundary::Free)
    }

    /// An axis from `low` to `high` whose ends are the same place.
    ///
    /// # Errors
    /// Ends that are not finite or not in ascending order.
    pub fn cyclic(low: f64, high: f64) -> Result<Self, TheoryError> {
        Self::new(low, high, Boundary::Cyclic)
    }

    fn new(low: f64, high: f64, boundary: Boundary) -> Result<Self, TheoryError> {
        let width = high - low;
        if !(low.is_finite() && width > 0.0 && width.is_finite()) {
            return Err(TheoryError::Axis { low, high });
        }
        Ok(Axis { low, width, boundary })
    }

    /// The lower end.
    pub fn low(&self) -> f64 {
        self.low
    }

    /// The distance of the ends.
    pub fn width(&self) -> f64 {
        self.width
    }

    /// What happens at the ends.
    pub fn boundary(&self) -> Boundary {
        self.boundary
    }

    /// Half waves of function `j` over the width: `κ_j = half_waves · π / L`.
    fn half_waves(&self, j: usize) -> f64 {
        match self.boundary {
            Boundary::Free => j as f64,
            Boundary::Cyclic => 2.0 * j.div_ceil(2) as f64,
        }
    }

    /// Wave number `κ_j` of function `j`, in radians per unit of the axis.
    pub fn wave_number(&self, j: usize) -> f64 {
        self.half_waves(j) * PI / self.width
    }

    /// Function `ψ_j` at coordinate `s`, of amplitude 1; outside of the box a free axis is mirrored, a cyclic one goes round.
    ///
    /// NaN if `s` is not finite.
    pub fn wave(&self, j: usize, s: f64) -> f64 {
        // Two widths are a whole period of every function: the remainder keeps the phase exact far away.
        let u = ((s - self.low) / self.width) % 2.0;
        let phase = PI * ((self.half_waves(j) * u) % 2.0);
        if self.boundary == Boundary::Cyclic && j % 2 == 1 { phase.sin() } else { phase.cos() }
    }

    /// Refuse a coordinate whose phase cannot be told.
    pub(crate) fn unless_near(&self, point: usize, axis: usize, value: f64) -> Result<(), TheoryError> {
        if ((value - self.low) / self.width).abs() < 1e9 {
            Ok(())
        } else {
            Err(TheoryError::Point { point, axis, value })
        }
    }
}

/// Mean square speeds along (x, y, θ) of a robot on the plane, from those of its driving and turning: `⟨v²⟩/2, ⟨v²⟩/2, ⟨ω²⟩`.
pub fn plane_motion(mean_square_speed: f64, mean_square_turn: f64) -> [f64; 3] {
    [0.5 * mean_square_speed, 0.5 * mean_square_speed, mean_square_turn]
}

/// One optimal response: which functions it is the product of, and how slow it is.
#[derive(Debug, Clone, PartialEq)]
pub struct Response {
    /// Number of the function along each axis; 0 where the response does not depend on that axis.
    pub indices: Vec<usize>,
    /// Slowness `Δ`, in 1/time², with the unit of time of the speeds.
    pub slowness: f64,
}

/// The slowest optimal responses of a box, in ascending order of slowness.
///
/// Equally slow responses stand in the lexicographic order of their numbers.
///
/// ```
/// use adagio::slow::theory::{Axis, OptimalResponses, plane_motion};
/// use faer::Mat;
///
/// # fn main() -> Result<(), adagio::slow::theory::TheoryError> {
/// // A room of 3 m × 1.8 m and a heading; slow driving, fast turning.
/// let room = [Axis::free(0.0, 3.0)?, Axis::free(0.0, 1.8)?, Axis::cyclic(0.0, std::f64::consts::TAU)?];
/// let theory = OptimalResponses::slowest(&room, &plane_motion(0.02, 0.5), 4)?;
/// let numbers: Vec<_> = theory.responses().iter().map(|r| r.indices.clone()).collect();
/// assert_eq!(numbers, [[1, 0, 0], [0, 1, 0], [1, 1, 0], [2, 0, 0]]); // places before headings
///
/// // The slowest tells the two ends of the long wall apart.
/// let ends = Mat::from_fn(3, 2, |axis, point| if axis == 0 && point == 1 { 3.0 } else { 0.0 });
/// let phi = theory.evaluate(ends.as_ref())?;
/// assert!((phi[(0, 0)] - 2f64.sqrt()).abs() < 1e-12 && (phi[(0, 1)] + 2f64.sqrt()).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §4.1.2, proposition *3d state space*, for boxes of any dimension; see the module for its errata.
#[derive(Debug, Clone, PartialEq)]
pub struct OptimalResponses {
    axes: Vec<Axis>,
    responses: Vec<Response>,
    cut: usize,
}

impl OptimalResponses {
    /// The `k` slowest responses in a box, for the given mean square speed `⟨ṡ_d²⟩` along each axis.
    ///
    /// # Units
    /// Speeds: (unit of the axis / unit of time)², e.g. m²/s² and rad²/s²; Δ is then in 1/s².
    ///
    /// # Errors
    /// No axes or too many, another number of speeds than of axes, a speed that is not positive, `k` outside
    /// 1 … [`MOST_RESPONSES`].
    pub fn slowest(axes: &[Axis], mean_square_speeds: &[f64], k: usize) -> Result<Self, TheoryError> {
        if axes.is_empty() || axes.len() > MOST_AXES {
            return Err(TheoryError::Axes(axes.len()));
        }
        TheoryError::unless_fits("the list of speeds", mean_square_speeds.len(), axes.len())?;
        if k == 0 || k > MOST_RESPONSES {
            return Err(TheoryError::Responses { asked: k, most: MOST_RESPONSES });
        }
        let mut units = Vec::with_capacity(axes.len());
        for (axis, (side, &speed)) in axes.iter().zip(mean_square_speeds).enumerate() {
            let unit = (PI / side.width).powi(2) * speed;
            if !UNIT_SLOWNESS.contains(&unit) {
                return Err(TheoryError::Speed { axis, speed });
            }
            units.push(unit);
        }
        let mut responses = ascending(axes, &units, k);
        let cut = responses.len() - k;
        responses.truncate(k);
        Ok(OptimalResponses { axes: axes.to_vec(), responses, cut })
    }

    /// The box.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// The responses, slowest first.
    pub fn responses(&self) -> &[Response] {
        &self.responses
    }

    /// Ranges of equally slow responses, in order; only the span of each is determined.
    pub fn groups(&self) -> Vec<Range<usize>> {
        equal_ranges(&self.responses)
    }

    /// How many responses are as slow as the last one but were not asked for. Only if this is 0 is the span of all
    /// responses determined.
    pub fn cut(&self) -> usize {
        self.cut
    }

    /// How many of the slowest responses surely do not depend on an axis: those before the first group with one that does.
    ///
    /// For the heading, these are the responses from which place cells can be read (thesis §4.2.3).
    ///
    /// # Errors
    /// An axis the box does not have.
    pub fn invariant_to(&self, axis: usize) -> Result<usize, TheoryError> {
        if axis >= self.axes.len() {
            return Err(TheoryError::Shape {
                what: "the number of the axis",
                found: axis,
                expected: self.axes.len() - 1,
            });
        }
        let depends = |group: &Range<usize>| self.responses[group.clone()].iter().any(|r| r.indices[axis] > 0);
        Ok(self.groups().into_iter().find(depends).map_or(self.responses.len(), |group| group.start))
    }

    /// The responses at given states.
    ///
    /// # Shapes
    /// `points: p × n` gives `k × n`.
    ///
    /// # Errors
    /// Points of another dimension than the box, or not finite.
    pub fn evaluate(&self, points: MatRef<'_, f64>) -> Result<Mat<f64>, TheoryError> {
        TheoryError::unless_fits("the number of coordinates of a point", points.nrows(), self.axes.len())?;
        let largest: Vec<usize> = (0..self.axes.len())
            .map(|axis| self.responses.iter().map(|response| response.indices[axis]).max().unwrap_or(0))
            .collect();
        let mut phi = Mat::zeros(self.responses.len(), points.ncols());
        for point in 0..points.ncols() {
            let mut waves = Vec::with_capacity(self.axes.len());
            for (axis, side) in self.axes.iter().enumerate() {
                let s = points[(axis, point)];
                side.unless_near(point, axis, s)?;
                let unit_variance = |j| side.wave(j, s) * if j == 0 { 1.0 } else { SQRT_2 };
                waves.push((0..=largest[axis]).map(unit_variance).collect::<Vec<f64>>());
            }
            for (i, response) in self.responses.iter().enumerate() {
                phi[(i, point)] = response.indices.iter().zip(&waves).map(|(&j, wave)| wave[j]).product();
            }
        }
        Ok(phi)
    }
}

/// The `k` slowest responses and those as slow as the last of them, in ascending order.
///
/// Numbers are grown from the constant: a step raises one number by one, never before the last non-zero one, so that
/// every list of numbers is reached on one way only. No step makes a response slower, hence the heap misses none.
fn ascending(axes: &[Axis], units: &[f64], k: usize) -> Vec<Response> {
    let slowness =
        |indices: &[usize]| -> f64 { (0..axes.len()).map(|d| units[d] * axes[d].half_waves(indices[d]).powi(2)).sum() };
    let mut waiting = BinaryHeap::from([Reverse(Candidate(Response { indices: vec![0; axes.len()], slowness: 0.0 }))]);
    let mut found: Vec<Response> = Vec::with_capacity(k);
    let mut constant = true;
    // Every response has followers along its last axis, so the heap never runs empty.
    while let Some(Reverse(Candidate(next))) = waiting.pop() {
        if found.len() >= k && !equally_slow(&found[k - 1], &next) {
            break;
        }
        let last = next.indices.iter().rposition(|&j| j > 0).unwrap_or(0);
        for d in last..axes.len() {
            let mut indices = next.indices.clone();
            indices[d] += 1;
            waiting.push(Reverse(Candidate(Response { slowness: slowness(&indices), indices })));
        }
        if !constant {
            found.push(next);
        }
        constant = false;
    }
    for range in equal_ranges(&found) {
        found[range].sort_by(|a, b| a.indices.cmp(&b.indices));
    }
    found
}

fn equally_slow(slower: &Response, faster: &Response) -> bool {
    faster.slowness <= slower.slowness * (1.0 + EQUAL_SLOWNESS)
}

fn equal_ranges(responses: &[Response]) -> Vec<Range<usize>> {
    let mut ranges = Vec::new();
    let mut start = 0;
    for i in 1..=responses.len() {
        if i == responses.len() || !equally_slow(&responses[start], &responses[i]) {
            ranges.push(start..i);
            start = i;
        }
    }
    ranges
}

/// A response in the order of slowness, then of its numbers.
#[derive(PartialEq)]
struct Candidate(Response);

impl Eq for Candidate {}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.0.slowness.total_cmp(&other.0.slowness).then_with(|| self.0.indices.cmp(&other.0.indices))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

/// The most states of a discrete walk: all its responses then take 128 MiB.
pub const MOST_STATES: usize = 1 << 12;

/// Optimal responses of a discrete walk over `N` states.
#[derive(Debug, Clone)]
pub struct WalkResponses {
    /// Slowness `Δ` per step, ascending, `k`.
    pub slowness: Vec<f64>,
    /// The responses, `k × N`, with mean 0 and variance 1 over the states.
    pub responses: Mat<f64>,
}

/// The `k` slowest responses of the walk over `states` states in a row or ring, each step to either neighbour alike.
///
/// In a row the walk stands still where it would leave: `φ_j(s) = √2 cos(jπ(s+½)/N)`, `Δ_j = 2(1 − cos(jπ/N))`. In a ring:
/// `√2 sin`, `√2 cos` of `2πjs/N`, `Δ_j = 2(1 − cos(2πj/N))`, in pairs; for even `N` the last has no partner and is ±1.
///
/// ```
/// use adagio::slow::theory::{Boundary, discrete_walk};
///
/// let walk = discrete_walk(20, Boundary::Free, 3).unwrap();
/// assert!((walk.slowness[0] - 0.024623).abs() < 1e-6);
/// assert!((walk.slowness[2] - 0.217987).abs() < 1e-6);
/// ```
///
/// # Errors
/// More responses than `states − 1`, or none; more states than [`MOST_STATES`].
pub fn discrete_walk(states: usize, boundary: Boundary, k: usize) -> Result<WalkResponses, TheoryError> {
    let most = states.min(MOST_STATES).saturating_sub(1);
    if k == 0 || k > most || states > MOST_STATES {
        return Err(TheoryError::Responses { asked: k, most });
    }
    let n = states as f64;
    let angle = |j: usize| match boundary {
        Boundary::Free => j as f64 * PI / n,
        Boundary::Cyclic => 2.0 * PI * j.div_ceil(2) as f64 / n,
    };
    let alternating = |j: usize| boundary == Boundary::Cyclic && 2 * j.div_ceil(2) == states;
    let responses = Mat::from_fn(k, states, |row, s| {
        let (j, s) = (row + 1, s as f64);
        match boundary {
            Boundary::Free => SQRT_2 * (angle(j) * (s + 0.5)).cos(),
            Boundary::Cyclic if alternating(j) => (angle(j) * s).cos(),
            Boundary::Cyclic if j % 2 == 1 => SQRT_2 * (angle(j) * s).sin(),
            Boundary::Cyclic => SQRT_2 * (angle(j) * s).cos(),
        }
    });
    // 2(1 − cos a) = 4 sin²(a/2), without cancellation for small a.
    let slowness = (1..=k).map(|j| 4.0 * (0.5 * angle(j)).sin().powi(2)).collect();
    Ok(WalkResponses { slowness, responses })
}
