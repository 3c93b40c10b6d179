//! Slow features in the space of a kernel, over the support vectors of a dictionary.

use std::sync::Mutex;

use adagio::dictionary::{self, Parameters};
use adagio::faer::Par;
use adagio::kernel::Kernel;
use adagio::slow::{SlowError, SlowModel, SlowStream, SolveOptions, StreamOptions, solve_with};
use adagio::snapshot::{Snapshot, SnapshotError};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::{Count, refused, when_full};
use crate::arrays::{columns, list, rows};
use crate::links::{Clock, Lengths, Times};
use crate::state;
use crate::threads::{get, in_blocks, with, work};

/// The width of a radial kernel at which ALD keeps a share of the samples, but at least half their median distance.
#[pyfunction]
pub fn width_for_share(
    py: Python<'_>,
    x: PyReadonlyArray2<'_, f64>,
    nu: f64,
    share: f64,
    exponent: f64,
) -> PyResult<f64> {
    let x = columns(&x)?;
    work(py, || dictionary::width_for_share(x, nu, share, |sigma| Kernel::radial(sigma, exponent), Par::rayon(0)))
}

struct Stream {
    sums: SlowStream<f64>,
    clock: Clock,
}

impl Stream {
    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.inner("sums", &mut self.sums)?;
        snapshot.scope("clock", |snapshot| self.clock.persist(snapshot))
    }
}

/// What a stream is made with.
#[derive(Clone)]
struct Settings {
    sigma: f64,
    exponent: f64,
    nu: f64,
    budget: usize,
    when_full: String,
    retained: usize,
}

impl Settings {
    fn begin(&self, py: Python<'_>) -> PyResult<Stream> {
        let (kernel, when_full) =
            (Kernel::radial(self.sigma, self.exponent).map_err(refused)?, when_full(&self.when_full)?);
        work(py, || {
            let Settings { nu, budget, .. } = *self;
            let ald = dictionary::Ald::new(Parameters { kernel, nu, budget, when_full, par: Par::rayon(0) })?;
            let sums = SlowStream::new(ald, StreamOptions { retained: self.retained, ..StreamOptions::default() })?;
            Ok::<_, SlowError>(Stream { sums, clock: Clock::default() })
        })
    }
}

/// A dictionary and running sums over the coordinates of the samples of a stream.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct KernelStream {
    settings: Settings,
    stream: Mutex<Stream>,
}

#[pymethods]
impl KernelStream {
    #[new]
    fn new(
        py: Python<'_>,
        sigma: f64,
        exponent: f64,
        nu: f64,
        budget: Count,
        when_full: String,
        retained: Count,
    ) -> PyResult<Self> {
        let settings = Settings { sigma, exponent, nu, budget: budget.0, when_full, retained: retained.0 };
        Ok(KernelStream { stream: Mutex::new(settings.begin(py)?), settings })
    }

    fn __getnewargs__(&self) -> (f64, f64, f64, usize, &str, usize) {
        let Settings { sigma, exponent, nu, budget, when_full, retained } = &self.settings;
        (*sigma, *exponent, *nu, *budget, when_full, *retained)
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
        let clock = get(py, &self.stream, |stream| stream.clock.clone())?;
        let (links, clock) = clock.links(x.ncols(), dt, &lengths, &times)?;
        in_blocks(py, &self.stream, (x.ncols(), BLOCK), |stream, start, size| {
            stream.sums.push(x.subcols(start, size), &links[start..start + size]).map(drop)
        })?;
        get(py, &self.stream, |stream| stream.clock = clock)
    }

    /// The slowest features of all samples.
    fn solve(&self, py: Python<'_>, features: Count, regularizer: f64) -> PyResult<KernelModel> {
        let model = with(py, &self.stream, |stream| {
            let options = SolveOptions { par: Par::rayon(0), ..SolveOptions::default() };
            let moments = stream.sums.settled_moments()?;
            let solved = solve_with(moments, features.0, regularizer, None, &options)?;
            SlowModel::new(stream.sums.dictionary(), &solved)
        })?;
        Ok(KernelModel(model))
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mut snapshot = Snapshot::new();
        with(py, &self.stream, |stream| stream.persist(&mut snapshot))?;
        state::parts(py, snapshot)
    }

    fn __setstate__(&self, py: Python<'_>, parts: &Bound<'_, PyDict>) -> PyResult<()> {
        let (mut snapshot, mut stream) = (state::restoring(parts)?, self.settings.begin(py)?);
        work(py, || stream.persist(&mut snapshot))?;
        get(py, &self.stream, |content| *content = stream)
    }
}

/// Samples that are judged together, as the agent does it.
const BLOCK: usize = 128;

/// Slow features as functions of kernel values.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct KernelModel(SlowModel<f64>);

#[pymethods]
impl KernelModel {
    #[new]
    fn new(
        sigma: f64,
        exponent: f64,
        support_vectors: PyReadonlyArray2<'_, f64>,
        projection: PyReadonlyArray2<'_, f64>,
        offset: PyReadonlyArray1<'_, f64>,
        slowness: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Self> {
        let kernel = Kernel::radial(sigma, exponent).map_err(refused)?;
        let (members, projection) = (columns(&support_vectors)?.to_owned(), columns(&projection)?.to_owned());
        let (offset, slowness) = (list(&offset)?.to_vec(), list(&slowness)?.to_vec());
        Ok(KernelModel(SlowModel::from_parts(kernel, members, projection, offset, slowness).map_err(refused)?))
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> Parts<'py> {
        let model = &self.0;
        // The kernel of a stream is always a radial one.
        let (sigma, exponent) = (model.kernel.sigma().unwrap_or(1.0), model.kernel.exponent().unwrap_or(2.0));
        let projection = rows(py, model.projection.as_ref());
        let offset = PyArray1::from_slice(py, &model.offset);
        (sigma, exponent, self.support_vectors(py), projection, offset, self.slowness(py))
    }

    /// Width of the kernel.
    #[getter]
    fn sigma(&self) -> Option<f64> {
        self.0.kernel.sigma()
    }

    /// Support vectors × inputs.
    #[getter]
    fn support_vectors<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        rows(py, self.0.members.as_ref().as_ref())
    }

    /// Slowness of each feature.
    #[getter]
    fn slowness<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.slowness)
    }

    /// Features of samples, without the constant one.
    fn apply<'py>(&self, py: Python<'py>, x: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let x = columns(&x)?;
        let phi = work(py, || self.0.apply(x, Par::rayon(0)))?;
        Ok(rows(py, phi.as_ref().subrows(1, phi.nrows() - 1)))
    }
}

/// What a model is made of.
type Parts<'py> = (
    f64,
    f64,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);
