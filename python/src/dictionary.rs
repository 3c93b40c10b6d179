//! Support vectors by approximate linear dependence.

use std::sync::Mutex;

use adagio::dictionary::{self, DictionaryError, Parameters, Selection};
use adagio::faer::{MatRef, Par};
use adagio::kernel::Kernel;
use adagio::snapshot::{Snapshot, SnapshotError};
use numpy::{PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::{Count, refused, when_full};
use crate::arrays::{columns, rows};
use crate::state;
use crate::threads::{get, in_blocks, with, work};

struct Chosen {
    ald: dictionary::Ald<f64>,
    /// Number of the sample that each support vector was.
    indices: Vec<usize>,
    samples: usize,
}

impl Chosen {
    fn observe(&mut self, x: MatRef<'_, f64>) -> Result<(), DictionaryError> {
        let block = self.ald.observe(x)?;
        self.indices.extend(block.accepted.iter().map(|place| self.samples + place));
        self.samples += x.ncols();
        if let Some(thinning) = self.ald.thin()? {
            self.indices = thinning.keep().iter().map(|&place| self.indices[place]).collect();
        }
        Ok(())
    }

    fn persist(&mut self, snapshot: &mut Snapshot) -> Result<(), SnapshotError> {
        snapshot.scope("ald", |snapshot| self.ald.persist(snapshot))?;
        snapshot.value("indices", &mut self.indices)?;
        snapshot.value("samples", &mut self.samples)?;
        let fits = self.indices.len() == self.ald.dictionary().len();
        snapshot.check("indices", fits, "another number than there are support vectors")
    }
}

/// What a dictionary is made with.
#[derive(Clone)]
struct Settings {
    sigma: f64,
    exponent: f64,
    nu: f64,
    budget: usize,
    when_full: String,
}

impl Settings {
    fn begin(&self, py: Python<'_>) -> PyResult<Chosen> {
        let (kernel, when_full) =
            (Kernel::radial(self.sigma, self.exponent).map_err(refused)?, when_full(&self.when_full)?);
        let Settings { nu, budget, .. } = *self;
        let ald = work(py, || dictionary::Ald::new(Parameters { kernel, nu, budget, when_full, par: Par::rayon(0) }))?;
        Ok(Chosen { ald, indices: Vec::new(), samples: 0 })
    }
}

/// A dictionary that grows by approximate linear dependence.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct Ald {
    settings: Settings,
    chosen: Mutex<Chosen>,
}

/// Samples that are judged together, as the agent does it.
const BLOCK: usize = 128;

#[pymethods]
impl Ald {
    #[new]
    fn new(py: Python<'_>, sigma: f64, exponent: f64, nu: f64, budget: Count, when_full: String) -> PyResult<Self> {
        let settings = Settings { sigma, exponent, nu, budget: budget.0, when_full };
        Ok(Ald { chosen: Mutex::new(settings.begin(py)?), settings })
    }

    fn __getnewargs__(&self) -> (f64, f64, f64, usize, &str) {
        let Settings { sigma, exponent, nu, budget, when_full } = &self.settings;
        (*sigma, *exponent, *nu, *budget, when_full)
    }

    /// Judge samples in their order.
    fn observe(&self, py: Python<'_>, x: PyReadonlyArray2<'_, f64>) -> PyResult<()> {
        let x = columns(&x)?;
        in_blocks(py, &self.chosen, (x.ncols(), BLOCK), |chosen, start, size| chosen.observe(x.subcols(start, size)))
    }

    /// Newton coordinates of samples, samples × support vectors.
    fn coordinates<'py>(&self, py: Python<'py>, x: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let x = columns(&x)?;
        let v = with(py, &self.chosen, |chosen| chosen.ald.dictionary().coordinates(x))?;
        Ok(rows(py, v.as_ref()))
    }

    /// Support vectors × inputs.
    #[getter]
    fn support_vectors<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let members = get(py, &self.chosen, |chosen| chosen.ald.dictionary().members().to_owned())?;
        Ok(rows(py, members.as_ref()))
    }

    /// Width of the kernel.
    #[getter]
    fn sigma(&self) -> f64 {
        self.settings.sigma
    }

    /// Number of the sample that each support vector was, from 0.
    #[getter]
    fn indices<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let indices = get(py, &self.chosen, |chosen| chosen.indices.iter().map(|&i| i as i64).collect())?;
        Ok(PyArray1::from_vec(py, indices))
    }

    /// Number of support vectors.
    fn __len__(&self, py: Python<'_>) -> PyResult<usize> {
        get(py, &self.chosen, |chosen| chosen.indices.len())
    }

    /// The threshold at this moment.
    #[getter]
    fn nu(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        get(py, &self.chosen, |chosen| chosen.ald.nu())
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mut snapshot = Snapshot::new();
        with(py, &self.chosen, |chosen| chosen.persist(&mut snapshot))?;
        state::parts(py, snapshot)
    }

    fn __setstate__(&self, py: Python<'_>, parts: &Bound<'_, PyDict>) -> PyResult<()> {
        let (mut snapshot, mut chosen) = (state::restoring(parts)?, self.settings.begin(py)?);
        work(py, || chosen.persist(&mut snapshot))?;
        get(py, &self.chosen, |content| *content = chosen)
    }
}
