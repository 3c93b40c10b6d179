//! Linear slow features: sums over a stream, and what they are solved to.

use std::sync::Mutex;

use adagio::faer::{MatMut, Par};
use adagio::slow::{self, SlowError};
use adagio::snapshot::{Snapshot, SnapshotError};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::Count;
use crate::arrays::{columns, list, rows, table};
use crate::links::{Clock, Lengths, Times};
use crate::state;
use crate::threads::{get, in_blocks, work};

/// Samples between which Ctrl-C is heard.
const BLOCK: usize = 8192;

#[derive(Clone)]
struct Stream {
    sums: slow::LinearStream,
    clock: Clock,
}

impl Stream {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("sums", &mut self.sums)?;
        snapshot.scope("clock", |snapshot| self.clock.persist(snapshot))
    }
}

/// Running sums over the samples of a stream.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct LinearStream(Mutex<Stream>);

impl LinearStream {
    fn empty(py: Python<'_>) -> PyResult<Stream> {
        // The number of threads is that of our own.
        work(py, || Ok::<_, SlowError>(Stream { sums: slow::LinearStream::on(Par::rayon(0)), clock: Clock::default() }))
    }

    fn copy(&self, py: Python<'_>) -> PyResult<Stream> {
        get(py, &self.0, |stream| stream.clone())
    }
}

#[pymethods]
impl LinearStream {
    #[new]
    fn new(py: Python<'_>) -> PyResult<Self> {
        Ok(LinearStream(Mutex::new(Self::empty(py)?)))
    }

    /// Take a block of samples.
    #[pyo3(signature = (x, dt, lengths=None, times=None))]
    fn push(
        &self,
        py: Python<'_>,
        x: PyReadonlyArray2<'_, f64>,
        dt: f64,
        lengths: Lengths,
        times: Times<'_>,
    ) -> PyResult<()> {
        let x = columns(&x)?;
        let clock = get(py, &self.0, |stream| stream.clock.clone())?;
        let (links, clock) = clock.links(x.ncols(), dt, &lengths, &times)?;
        in_blocks(py, &self.0, (x.ncols(), BLOCK), |stream, start, size| {
            stream.sums.push(x.subcols(start, size), &links[start..start + size])
        })?;
        get(py, &self.0, |stream| stream.clock = clock)
    }

    /// The slowest features of all samples; without a number, as many as there are directions with variance.
    #[pyo3(signature = (features, regularizer))]
    fn solve(&self, py: Python<'_>, features: Option<Count>, regularizer: f64) -> PyResult<LinearModel> {
        let sums = self.copy(py)?.sums;
        let all = sums.inputs().unwrap_or(0);
        work(py, || match (sums.solve(features.map_or(all, |count| count.0), regularizer), features) {
            (Err(SlowError::Features { rank, .. }), None) if rank > 0 => sums.solve(rank, regularizer),
            (solved, _) => solved,
        })
        .map(LinearModel)
    }

    /// Both streams one after the other, without a derivative from one to the other.
    fn __add__(&self, py: Python<'_>, other: &Self) -> PyResult<Self> {
        let (mut both, other) = (self.copy(py)?, other.copy(py)?);
        let sums = work(py, || both.sums.append(&other.sums).map(|()| both.sums))?;
        let clock = if other.sums.inputs().is_some() { other.clock } else { both.clock };
        Ok(LinearStream(Mutex::new(Stream { sums, clock })))
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (mut snapshot, mut stream) = (Snapshot::new(), self.copy(py)?);
        work(py, || stream.persist(&mut snapshot))?;
        state::parts(py, snapshot)
    }

    fn __setstate__(&self, py: Python<'_>, parts: &Bound<'_, PyDict>) -> PyResult<()> {
        let (mut snapshot, mut stream) = (state::restoring(parts)?, Self::empty(py)?);
        work(py, || stream.persist(&mut snapshot))?;
        get(py, &self.0, |content| *content = stream)
    }
}

/// Affine functions of a sample.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct LinearModel(slow::LinearSfa);

#[pymethods]
impl LinearModel {
    #[new]
    fn new(
        weights: PyReadonlyArray2<'_, f64>,
        mean: PyReadonlyArray1<'_, f64>,
        slowness: PyReadonlyArray1<'_, f64>,
        rank_deficit: Count,
    ) -> PyResult<Self> {
        Ok(LinearModel(slow::LinearSfa {
            weights: columns(&weights)?.to_owned(),
            mean: list(&mean)?.to_vec(),
            slowness: list(&slowness)?.to_vec(),
            rank_deficit: rank_deficit.0,
        }))
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> Parts<'py> {
        (self.weights(py), self.mean(py), self.slowness(py), self.0.rank_deficit)
    }

    /// Weights, features × inputs.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        rows(py, self.0.weights.as_ref())
    }

    /// Mean of the inputs.
    #[getter]
    fn mean<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.mean)
    }

    /// Slowness of each feature.
    #[getter]
    fn slowness<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.slowness)
    }

    /// Inputs that say nothing new.
    #[getter]
    fn rank_deficit(&self) -> usize {
        self.0.rank_deficit
    }

    /// Features of samples.
    fn apply<'py>(&self, py: Python<'py>, x: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let x = columns(&x)?;
        let (features, samples) = (self.0.outputs(), x.ncols());
        let y = work(py, || {
            let mut y = vec![0.0; features * samples];
            let outputs = MatMut::from_column_major_slice_mut(&mut y, features, samples);
            self.0.apply_into(x, outputs, Par::rayon(0)).map(|()| y)
        })?;
        Ok(table(py, y, samples, features))
    }
}

/// What a model is made of.
type Parts<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>, usize);
