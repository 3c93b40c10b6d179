//! Slow features that follow a stream without any covariance matrix.

use std::sync::Mutex;

use adagio::slow::coherence::CoherenceError;
use adagio::slow::coherence::incremental::{IncrementalSlow, Options};
use adagio::snapshot::{Snapshot, SnapshotError};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::{Count, refused};
use crate::arrays::{columns, rows};
use crate::links::{Clock, Lengths, Times};
use crate::state;
use crate::threads::{get, in_blocks, with, work};

/// Samples between which Ctrl-C is heard.
const BLOCK: usize = 1024;

struct Stream {
    slow: IncrementalSlow,
    clock: Clock,
}

impl Stream {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("slow", &mut self.slow)?;
        snapshot.scope("clock", |snapshot| self.clock.persist(snapshot))
    }
}

/// What a stream is made with.
#[derive(Clone, Copy)]
struct Settings {
    inputs: usize,
    options: Options,
    seed: u64,
}

impl Settings {
    fn begin(&self) -> PyResult<Stream> {
        let mut random = adagio::random::stream(self.seed, "incremental slow features");
        let slow = IncrementalSlow::new(self.inputs, self.options, &mut random).map_err(refused)?;
        Ok(Stream { slow, clock: Clock::default() })
    }
}

/// Incremental slow features.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct IncrementalStream {
    settings: Settings,
    stream: Mutex<Stream>,
}

#[pymethods]
impl IncrementalStream {
    #[new]
    #[allow(clippy::too_many_arguments)] // all of them parameters of the estimator
    fn new(
        inputs: Count,
        features: Count,
        whitened: Count,
        smallest_variance: f64,
        start: f64,
        peak: f64,
        ramp: Count,
        seed: Count,
    ) -> PyResult<Self> {
        let (features, whitened, ramp) = (features.0, whitened.0, ramp.0);
        let options = Options { features, whitened, smallest_variance, start, peak, ramp };
        let settings = Settings { inputs: inputs.0, options, seed: seed.0 as u64 };
        Ok(IncrementalStream { stream: Mutex::new(settings.begin()?), settings })
    }

    fn __getnewargs__(&self) -> (usize, usize, usize, f64, f64, f64, usize, u64) {
        let Settings { inputs, options: o, seed } = self.settings;
        (inputs, o.features, o.whitened, o.smallest_variance, o.start, o.peak, o.ramp, seed)
    }

    /// Take a block of samples. Those before one that is refused are taken.
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
        let clock = get(py, &self.stream, |stream| stream.clock.clone())?;
        let (links, clock) = clock.links(x.ncols(), dt, &lengths, &times)?;
        in_blocks(py, &self.stream, (x.ncols(), BLOCK), |stream, start, size| {
            let mut frame = vec![0.0; x.nrows()];
            for (column, link) in x.subcols(start, size).col_iter().zip(&links[start..start + size]) {
                frame.iter_mut().zip(column.iter()).for_each(|(to, from)| *to = *from);
                stream.slow.update(&frame, *link)?;
            }
            Ok::<_, CoherenceError>(())
        })?;
        get(py, &self.stream, |stream| stream.clock = clock)
    }

    /// Weights, features × inputs.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let map = get(py, &self.stream, |stream| stream.slow.map())?;
        Ok(rows(py, map.weights.as_ref()))
    }

    /// Features of samples.
    fn apply<'py>(&self, py: Python<'py>, x: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let x = columns(&x)?;
        let map = get(py, &self.stream, |stream| stream.slow.map())?;
        let y = work(py, || map.apply(x))?;
        Ok(rows(py, y.as_ref()))
    }

    /// Slowness of each feature, lately.
    #[getter]
    fn slowness<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let slowness = get(py, &self.stream, |stream| stream.slow.slowness().to_vec())?;
        Ok(PyArray1::from_vec(py, slowness))
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mut snapshot = Snapshot::new();
        with(py, &self.stream, |stream| stream.persist(&mut snapshot))?;
        state::parts(py, snapshot)
    }

    fn __setstate__(&self, py: Python<'_>, parts: &Bound<'_, PyDict>) -> PyResult<()> {
        let (mut snapshot, mut stream) = (state::restoring(parts)?, self.settings.begin()?);
        work(py, || stream.persist(&mut snapshot))?;
        get(py, &self.stream, |content| *content = stream)
    }
}
