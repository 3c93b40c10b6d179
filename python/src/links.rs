//! How samples follow each other: `lengths` and `times` as links.

use adagio::slow::{Link, SlowError};
use adagio::snapshot::{Snapshot, SnapshotError};
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use thiserror::Error;

use crate::arguments::{Count, refused};
use crate::arrays::list;

/// What a block of samples comes with: the lengths of sequences, and times.
pub type Lengths = Option<Vec<Count>>;
/// See [`Lengths`].
pub type Times<'py> = Option<PyReadonlyArray1<'py, f64>>;

/// Where a stream stands.
#[derive(Debug, Clone, Default)]
pub struct Clock {
    started: bool,
    /// Time of the last sample, where times are given.
    last: Option<f64>,
}

/// What is wrong with lengths or times.
#[derive(Debug, Error)]
enum LinkError {
    #[error("lengths have the sum {sum}, but there are {samples} samples")]
    Lengths { sum: usize, samples: usize },
    #[error("there are {times} times for {samples} samples: one each is needed")]
    Times { times: usize, samples: usize },
    #[error("times must be given for all parts of a sequence or for none: lengths begin a new sequence")]
    Mixed,
    #[error(transparent)]
    Slow(#[from] SlowError),
}

impl Clock {
    /// Links of the next block of samples, and where the stream stands after it.
    ///
    /// Without `lengths` the block goes on with what came before; with them, each sequence is one of its own.
    ///
    /// # Errors
    /// Lengths or times that do not fit the samples, times that do not ascend within a sequence.
    pub fn links(
        &self,
        samples: usize,
        dt: f64,
        lengths: &Lengths,
        times: &Times<'_>,
    ) -> PyResult<(Vec<Option<Link>>, Clock)> {
        let lengths: Option<Vec<usize>> = lengths.as_ref().map(|all| all.iter().map(|length| length.0).collect());
        self.next(samples, dt, lengths, times.as_ref().map(list).transpose()?).map_err(refused)
    }

    fn next(
        &self,
        samples: usize,
        dt: f64,
        lengths: Option<Vec<usize>>,
        times: Option<&[f64]>,
    ) -> Result<(Vec<Option<Link>>, Clock), LinkError> {
        let goes_on = self.started && lengths.is_none() && samples > 0;
        let sequences = lengths.unwrap_or_else(|| vec![samples]);
        let sum = sequences.iter().fold(0usize, |sum, &length| sum.saturating_add(length));
        if sum != samples {
            return Err(LinkError::Lengths { sum, samples });
        }
        if let Some(times) = times.map(<[f64]>::len)
            && times != samples
        {
            return Err(LinkError::Times { times, samples });
        }
        if goes_on && self.last.is_some() != times.is_some() {
            return Err(LinkError::Mixed);
        }
        let mut links = Link::sequences(&sequences, dt)?;
        if let Some(times) = times {
            let mut start = 0;
            for length in sequences {
                let end = start + length;
                links[start..end].copy_from_slice(&at_times(&times[start..end], start)?);
                start = end;
            }
        }
        if goes_on {
            links[0] = match (self.last, times) {
                (Some(last), Some(times)) => at_times(&[last, times[0]], 0)?[1],
                _ => Some(Link { dt, weight: 1.0 }),
            };
        }
        let last = if samples > 0 { times.map(|times| times[samples - 1]) } else { self.last };
        Ok((links, Clock { started: self.started || samples > 0, last }))
    }

    /// For [`adagio::snapshot::Persist`].
    ///
    /// # Errors
    /// Parts that are missing.
    pub fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.value("started", &mut self.started)?;
        let mut bits = self.last.map(f64::to_bits);
        snapshot.value("last", &mut bits)?;
        self.last = bits.map(f64::from_bits);
        Ok(())
    }
}

/// Links of a sequence with times; errors have the numbers of samples from `start` on.
fn at_times(times: &[f64], start: usize) -> Result<Vec<Option<Link>>, SlowError> {
    Link::at_times(times, f64::INFINITY).map_err(|error| match error {
        SlowError::Link { at, dt, weight } => SlowError::Link { at: at + start, dt, weight },
        other => other,
    })
}
