//! What regression refuses.

use faer::MatRef;
use thiserror::Error;

use crate::dictionary::DictionaryError;
use crate::kernel::KernelError;

/// The most numbers that are stored on the word of a size alone (8 GiB): more are a mistake in that size.
const MOST_NUMBERS: usize = 1 << 30;

/// Why a function could not be fitted, applied or selected.
#[derive(Debug, Error, Clone, PartialEq)]
pub enum RegressionError {
    /// Matrices that do not fit each other.
    #[error("{what} has {found}, but {expected} is needed")]
    Shape {
        /// What does not fit.
        what: &'static str,
        /// Its size.
        found: usize,
        /// The size that fits.
        expected: usize,
    },
    /// More numbers than can be stored.
    #[error("{what} of {rows} × {columns} numbers is not allowed: it must have at most {MOST_NUMBERS} in all")]
    Size {
        /// What would be too large.
        what: &'static str,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
    },
    /// A value that cannot be summed in squares.
    #[error("{what} {index} holds a value that is not finite, or one beyond ±1e150, whose square is too large")]
    NotFinite {
        /// Input or target.
        what: &'static str,
        /// Its column.
        index: usize,
    },
    /// Numbers that are finite, but whose squares, sums or ratios are not.
    #[error("{0} left the range of f64: scale the inputs or targets down")]
    Overflow(&'static str),
    /// The regulariser must not be negative.
    #[error("lambda = {0} is not allowed: it must be ≥ 0 and finite")]
    Lambda(f64),
    /// Nothing to learn from.
    #[error("a fit needs at least 1 sample: there are 0")]
    NoSamples,
    /// Cross-validation needs something on both sides of each split.
    #[error("{folds} folds of {samples} samples are not allowed: there must be at least 2, and at least 1 sample each")]
    Folds {
        /// Folds asked for.
        folds: usize,
        /// Samples there are.
        samples: usize,
    },
    /// A withheld test set must leave samples on both sides.
    #[error(
        "a test share of {share} of {samples} samples is not allowed: it must be in (0, 1) and leave a sample on each side"
    )]
    Share {
        /// The share asked for.
        share: f64,
        /// Samples there are.
        samples: usize,
    },
    /// A dictionary needs room for a support vector.
    #[error("0 support vectors are not allowed: there must be at least 1")]
    NoSupportVectors,
    /// A selection among nothing.
    #[error("the list of {0} to select from is empty")]
    EmptyGrid(&'static str),
    /// The eigenvalue iteration did not converge.
    #[error("the eigenvalues of a {0} × {0} matrix did not converge")]
    Eigenvalues(usize),
    /// What the kernel refuses.
    #[error(transparent)]
    Kernel(#[from] KernelError),
    /// What the dictionary refuses.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
}

impl RegressionError {
    /// Refuse what no memory holds.
    pub(super) fn unless_stored(what: &'static str, rows: usize, columns: usize) -> Result<(), Self> {
        match rows.checked_mul(columns) {
            Some(numbers) if numbers <= MOST_NUMBERS => Ok(()),
            _ => Err(RegressionError::Size { what, rows, columns }),
        }
    }

    /// Refuse what has another size than needed.
    pub(super) fn unless_fits(what: &'static str, found: usize, expected: usize) -> Result<(), Self> {
        if found == expected { Ok(()) } else { Err(RegressionError::Shape { what, found, expected }) }
    }
}

/// Values beyond this have squares that sums have no room for.
const LARGEST: f64 = 1e150;

/// Refuse matrices with values whose squares are not finite, naming the column.
pub(super) fn check_finite(what: &'static str, matrix: MatRef<'_, f64>) -> Result<(), RegressionError> {
    match (0..matrix.ncols()).find(|&j| matrix.col(j).iter().any(|value| !(-LARGEST..=LARGEST).contains(value))) {
        Some(index) => Err(RegressionError::NotFinite { what, index }),
        None => Ok(()),
    }
}
