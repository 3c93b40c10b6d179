//! The one interface of all selections.

use std::fmt::{self, Debug};
use std::sync::Arc;

use faer::{Mat, MatRef};

use super::{Block, Dictionary, DictionaryError, Thinning};
use crate::kernel::Scalar;
#[cfg(feature = "snapshot")]
use crate::snapshot::{Snapshot, SnapshotError};

/// A dictionary with a rule for what it takes, and for what leaves when the budget is exceeded.
///
/// Observations are given in blocks by [`observe`](Selection::observe). Where [`is_over_budget`](Selection::is_over_budget)
/// says so afterwards, [`thin`](Selection::thin) brings the dictionary back to its budget and tells what becomes of
/// coordinates; whoever has summed over coordinates applies it to the sums, as [`SlowStream`](crate::slow::SlowStream) does.
pub trait Selection<T: Scalar>: Debug + Send {
    /// The support vectors so far.
    fn dictionary(&self) -> &Dictionary<T>;

    /// Whether it decides on a stream. If not, it needs all observations in one block.
    fn is_streaming(&self) -> bool;

    /// Judge a block of observations, `d × b`.
    ///
    /// # Errors
    /// Observations of another length than earlier ones, or with values that are not finite; nothing is changed then.
    fn observe(&mut self, x: MatRef<'_, T>) -> Result<Block, DictionaryError>;

    /// The largest number of support vectors between blocks.
    fn budget(&self) -> usize;

    /// Whether nothing more will be accepted, or only in exchange for something else.
    fn is_full(&self) -> bool;

    /// Whether more was accepted than the budget allows, so that [`thin`](Selection::thin) has to be called.
    fn is_over_budget(&self) -> bool {
        false
    }

    /// Bring the dictionary back to its budget. `None` if nothing had to leave.
    ///
    /// # Errors
    /// Features that cannot be computed for the support vectors, where a selection judges by features; nothing has left
    /// then. Otherwise none that a dictionary of accepted observations can meet.
    fn thin(&mut self) -> Result<Option<Thinning>, DictionaryError> {
        Ok(None)
    }

    /// The threshold ν on the residual at this moment; `None` where there is none.
    fn nu(&self) -> Option<f64>;

    /// Save or restore what it has become, see [`Persist`](crate::snapshot::Persist); its parameters are those that it was
    /// made with.
    ///
    /// # Errors
    /// A selection that cannot be saved; parts that are missing or do not fit.
    #[cfg(feature = "snapshot")]
    fn persist(&mut self, _snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        Err(SnapshotError::Unable("this selection of support vectors"))
    }

    /// Take new features to judge observations by. Only [`FeatureAld`](super::FeatureAld) has a use for them.
    ///
    /// # Errors
    /// Features that cannot be computed for the support vectors.
    fn adopt(&mut self, _features: FeatureMap<T>) -> Result<(), DictionaryError> {
        Ok(())
    }
}

/// A function from observations, `d × n`, to features, `f × n`.
type Features<T> = dyn Fn(MatRef<'_, T>) -> Result<Mat<f64>, String> + Send + Sync;

/// Features of observations, in whose space a [`FeatureAld`](super::FeatureAld) judges.
#[derive(Clone)]
pub struct FeatureMap<T: Scalar>(Arc<Features<T>>);

impl<T: Scalar> FeatureMap<T> {
    /// Features from a function of observations, `d × n`, that gives `f × n`, or says why it cannot.
    pub fn new(features: impl Fn(MatRef<'_, T>) -> Result<Mat<f64>, String> + Send + Sync + 'static) -> Self {
        FeatureMap(Arc::new(features))
    }

    pub(super) fn of(&self, x: MatRef<'_, T>) -> Result<Mat<f64>, DictionaryError> {
        let features = (self.0)(x).map_err(DictionaryError::Features)?;
        if features.ncols() != x.ncols() {
            let (found, expected) = (features.ncols(), x.ncols());
            return Err(DictionaryError::Shape { what: "the number of feature columns", found, expected });
        }
        Ok(features)
    }
}

impl<T: Scalar> Debug for FeatureMap<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("FeatureMap")
    }
}
