//! Representations of states that are known: tables, and trigonometric polynomials.
//!
//! # Reference
//! Thesis §3.1.2 (tabular) and §3.1.3 (trigonometric).

use faer::{Mat, MatRef};
use thiserror::Error;

use crate::slow::theory::{Axis, Boundary, TheoryError};

/// The most features of a representation: values over more are out of reach (LSPI costs `O(f³)`).
pub const MOST_FEATURES: usize = 1 << 16;

/// Why there is no representation.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum RepresentationError {
    /// No features, or too many.
    #[error("a representation of {found} features is not allowed: it must have 1 to {MOST_FEATURES}")]
    Size {
        /// Number of features, at most `usize::MAX`.
        found: usize,
    },
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
    /// A number outside its range.
    #[error("{what} is {found}: allowed are 0 to {largest}")]
    Range {
        /// What is out of range.
        what: &'static str,
        /// The number.
        found: usize,
        /// The largest that is allowed.
        largest: usize,
    },
    /// A point that cannot be represented.
    #[error(transparent)]
    Point(#[from] TheoryError),
}

impl RepresentationError {
    fn unless_fits(what: &'static str, found: usize, expected: usize) -> Result<(), RepresentationError> {
        if found == expected { Ok(()) } else { Err(RepresentationError::Shape { what, found, expected }) }
    }

    fn unless_below(what: &'static str, found: usize, end: usize) -> Result<(), RepresentationError> {
        if found < end { Ok(()) } else { Err(RepresentationError::Range { what, found, largest: end - 1 }) }
    }
}

/// One feature per state of a finite set: 1 in that state, 0 elsewhere.
///
/// # Reference
/// Thesis §3.1.2, definition *tabular representation*.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tabular {
    states: usize,
}

impl Tabular {
    /// The table of `states` states.
    ///
    /// # Errors
    /// No states, or more than [`MOST_FEATURES`].
    pub fn new(states: usize) -> Result<Self, RepresentationError> {
        if states == 0 || states > MOST_FEATURES {
            return Err(RepresentationError::Size { found: states });
        }
        Ok(Tabular { states })
    }

    /// Number of features, which is the number of states.
    pub fn size(&self) -> usize {
        self.states
    }

    /// Features of states given by their numbers, from 0: `f × n` for `n` states.
    ///
    /// # Errors
    /// A number that is none of a state.
    pub fn apply(&self, states: &[usize]) -> Result<Mat<f64>, RepresentationError> {
        let mut phi = Mat::zeros(self.states, states.len());
        for (column, &state) in states.iter().enumerate() {
            RepresentationError::unless_below("the number of a state", state, self.states)?;
            phi[(state, column)] = 1.0;
        }
        Ok(phi)
    }
}

/// All products of the first waves along the axes of a box; the first feature is the constant 1.
///
/// A representation turns a state into `f` numbers over which values are linear. A [`Tabular`] one has a number per state
/// and represents every value function exactly. A [`Trigonometric`] one, for states in a box of `p` coordinates, has
/// all products of the first waves of each coordinate: any continuous function is approximated as their number grows.
///
/// Symbols: `p` coordinates, degree `d_i` of coordinate `i`, `f_i` functions of it, `f = Π f_i` features;
/// `ψ_j` as in [`crate::slow::theory`], amplitude 1.
///
/// | coordinate | functions | `f_i` |
/// |---|---|---|
/// | cyclic, e.g. a heading | 1, sin 2πu, cos 2πu, … , sin 2πd_i u, cos 2πd_i u | 2 d_i + 1 |
/// | free, e.g. a position between walls | 1, cos πu, … , cos d_i πu | d_i + 1 |
///
/// with `u` in [0, 1] over the box. Sines and cosines of whole turns take the same value at both ends; so for a free
/// coordinate they could not tell the two walls apart, and half waves of cosines are what the optimal responses
/// are made of (thesis §4.1.2).
///
/// # Errata of the thesis
/// - Eq. `trig_basis_fun` has period 1: cos(jπx) for even j, sin((j+1)πx) for odd j are whole waves of 2πx. On the stated
///   domain [−1, 1] every function repeats itself, `φ(x) = φ(x + 1)`, so φ would not be injective, i.e. no representation
///   by the thesis's own definition, and theorem 4.25 would not hold. The printed functions fit a box of width 1; on
///   [−1, 1] the arguments are half as large. Here `u` runs from 0 to 1 over whatever box is given, which is right for both.
/// - The theorem holds for functions of a circle: over a whole period the ends must agree. "Every continuous function" needs
///   the cosines of half waves (the even functions on the doubled box), as the thesis says itself in §4.1.2.
/// - The size is `m = Π_n (2d_n + 1)`, printed with `d_p`; in the definition of the representation the numbers run over
///   `n_i ∈ {0, …, 2d_i}`, printed as `{1, …, d_i}`; and features are counted from 0, since `μ(0, …, 0) = 0`.
///
/// ```
/// use adagio::slow::theory::Axis;
/// use adagio::value::Trigonometric;
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// // Position between walls up to 4 half waves, heading up to 2 turns.
/// let pose = Trigonometric::new(&[
///     (Axis::free(0.0, 3.0)?, 4),
///     (Axis::free(0.0, 1.8)?, 4),
///     (Axis::cyclic(0.0, std::f64::consts::TAU)?, 2),
/// ])?;
/// assert_eq!(pose.size(), 5 * 5 * 5);
///
/// // Feature (1, 0, 2) is cos(πx/3) · cos θ.
/// let feature = pose.index(&[1, 0, 2])?;
/// let phi = pose.point(&[1.0, 0.4, 0.7])?;
/// assert!((phi[feature] - (std::f64::consts::PI / 3.0).cos() * 0.7f64.cos()).abs() < 1e-12);
/// # Ok(())
/// # }
/// ```
///
/// # Reference
/// Thesis §3.1.3, definition *trigonometric representation*.
#[derive(Debug, Clone, PartialEq)]
pub struct Trigonometric {
    axes: Vec<Axis>,
    /// Functions of each axis, `f_i`.
    counts: Vec<usize>,
    size: usize,
}

impl Trigonometric {
    /// The representation of a box, with a degree for each of its axes.
    ///
    /// # Errors
    /// No axes; more than [`MOST_FEATURES`] products.
    pub fn new(box_and_degrees: &[(Axis, usize)]) -> Result<Self, RepresentationError> {
        if box_and_degrees.is_empty() {
            return Err(RepresentationError::Size { found: 0 });
        }
        let count = |(axis, degree): &(Axis, usize)| match axis.boundary() {
            Boundary::Free => degree.saturating_add(1),
            Boundary::Cyclic => degree.saturating_mul(2).saturating_add(1),
        };
        let counts: Vec<usize> = box_and_degrees.iter().map(count).collect();
        let size = counts.iter().fold(1usize, |product, &count| product.saturating_mul(count));
        if size > MOST_FEATURES {
            return Err(RepresentationError::Size { found: size });
        }
        Ok(Trigonometric { axes: box_and_degrees.iter().map(|&(axis, _)| axis).collect(), counts, size })
    }

    /// Number of features `f`, the constant included.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Number of functions `f_i` of each axis, the constant included.
    pub fn counts(&self) -> &[usize] {
        &self.counts
    }

    /// The index function `μ(n_1, …, n_p) = Σ_i n_i Π_{j>i} f_j`: which feature is the product of these functions.
    ///
    /// # Errors
    /// Another number of functions than of axes; a function beyond the degree.
    pub fn index(&self, numbers: &[usize]) -> Result<usize, RepresentationError> {
        RepresentationError::unless_fits("the list of functions", numbers.len(), self.counts.len())?;
        let mut index = 0;
        for (&number, &count) in numbers.iter().zip(&self.counts) {
            RepresentationError::unless_below("the number of a function", number, count)?;
            index = index * count + number;
        }
        Ok(index)
    }

    /// The inverse of [`Trigonometric::index`]: which functions a feature is the product of.
    ///
    /// # Errors
    /// A feature the representation does not have.
    pub fn numbers(&self, index: usize) -> Result<Vec<usize>, RepresentationError> {
        RepresentationError::unless_below("the number of a feature", index, self.size)?;
        let mut rest = index;
        let mut numbers = vec![0; self.counts.len()];
        for (number, &count) in numbers.iter_mut().zip(&self.counts).rev() {
            *number = rest % count;
            rest /= count;
        }
        Ok(numbers)
    }

    /// Features of one state.
    ///
    /// # Errors
    /// A state of another dimension than the box, or not finite.
    pub fn point(&self, state: &[f64]) -> Result<Vec<f64>, RepresentationError> {
        RepresentationError::unless_fits("the number of coordinates of a state", state.len(), self.axes.len())?;
        self.column(0, |axis| state[axis])
    }

    /// Features of a block of states: `p × n` gives `f × n`.
    ///
    /// # Errors
    /// States of another dimension than the box, or not finite.
    pub fn apply(&self, states: MatRef<'_, f64>) -> Result<Mat<f64>, RepresentationError> {
        RepresentationError::unless_fits("the number of coordinates of a state", states.nrows(), self.axes.len())?;
        let mut phi = Mat::zeros(self.size, states.ncols());
        for n in 0..states.ncols() {
            for (i, value) in self.column(n, |axis| states[(axis, n)])?.into_iter().enumerate() {
                phi[(i, n)] = value;
            }
        }
        Ok(phi)
    }

    /// All products, the last axis running fastest.
    fn column(&self, point: usize, state: impl Fn(usize) -> f64) -> Result<Vec<f64>, RepresentationError> {
        let mut products = vec![1.0];
        for (i, (axis, &count)) in self.axes.iter().zip(&self.counts).enumerate() {
            axis.unless_near(point, i, state(i))?;
            let waves: Vec<f64> = (0..count).map(|j| axis.wave(j, state(i))).collect();
            products = products.iter().flat_map(|product| waves.iter().map(move |wave| product * wave)).collect();
        }
        Ok(products)
    }
}
