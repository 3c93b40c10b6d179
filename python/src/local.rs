//! Values of actions from the transitions nearby.

use adagio::faer::MatRef;
use adagio::snapshot::Snapshot;
use adagio::value::{self, LocalBatch, LocalOptions, ValueError};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arguments::{Count, refused};
use crate::arrays::{columns, list, rows};
use crate::lspi::actions;
use crate::state;
use crate::threads::work;

/// Values at points.
#[pyclass(module = "adagio._adagio")]
pub struct LocalValues(value::LocalValues);

#[pymethods]
impl LocalValues {
    /// Values of a single transition, to restore others into.
    #[new]
    fn new() -> PyResult<Self> {
        let single = || {
            let mut batch = LocalBatch::new(1, 1)?;
            batch.push(&[0.0], 0, 0.0, None)?;
            batch.fit(&LocalOptions::default(), 0.0)
        };
        single().map(LocalValues).map_err(refused)
    }

    /// Values of transitions; nothing follows where an episode `ended`.
    #[staticmethod]
    #[allow(clippy::too_many_arguments)] // all of them parameters of the estimator
    fn fit(
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        taken: PyReadonlyArray1<'_, i64>,
        rewards: PyReadonlyArray1<'_, f64>,
        next: PyReadonlyArray2<'_, f64>,
        ended: PyReadonlyArray1<'_, bool>,
        n_actions: Count,
        neighbours: Count,
        ridge: f64,
        gamma: f64,
    ) -> PyResult<Self> {
        let (points, next, rewards) = (columns(&points)?, columns(&next)?, list(&rewards)?);
        let (actions, ended) = (actions(list(&taken)?)?, list(&ended)?);
        let n = points.ncols();
        let lengths =
            [("actions", actions.len()), ("rewards", rewards.len()), ("next", next.ncols()), ("terminal", ended.len())];
        work(py, || {
            if let Some(&(what, found)) = lengths.iter().find(|(_, found)| *found != n) {
                return Err(ValueError::Length { what, found, expected: n });
            }
            let mut batch = LocalBatch::new(points.nrows(), n_actions.0)?;
            let point = |of: MatRef<'_, f64>, t| of.col(t).iter().copied().collect::<Vec<f64>>();
            for t in 0..n {
                let to = (!ended[t]).then(|| point(next, t));
                batch.push(&point(points, t), actions[t], rewards[t], to.as_deref())?;
            }
            batch.fit(&LocalOptions { neighbours: neighbours.0, ridge }, gamma)
        })
        .map(LocalValues)
    }

    /// Sweeps done.
    #[getter]
    fn iterations(&self) -> usize {
        self.0.fit().iterations
    }

    /// Whether values settled.
    #[getter]
    fn converged(&self) -> bool {
        self.0.fit().converged
    }

    /// Share of the transitions after which the greedy policy arrives.
    #[getter]
    fn arrival(&self) -> f64 {
        self.0.arrival()
    }

    /// Values, samples × actions.
    fn action_values<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = columns(&points)?;
        let q = work(py, || self.0.action_values(points))?;
        Ok(rows(py, q.as_ref()))
    }

    /// Greedy actions.
    fn policy<'py>(&self, py: Python<'py>, points: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let points = columns(&points)?;
        let policy = work(py, || self.0.policy(points))?;
        Ok(PyArray1::from_iter(py, policy.chosen().into_iter().map(|action| action as i64)))
    }

    fn __getstate__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (mut snapshot, mut values) = (Snapshot::new(), self.0.clone());
        work(py, || snapshot.inner("values", &mut values))?;
        state::parts(py, snapshot)
    }

    fn __setstate__(&mut self, py: Python<'_>, parts: &Bound<'_, PyDict>) -> PyResult<()> {
        let (mut snapshot, mut values) = (state::restoring(parts)?, self.0.clone());
        work(py, || snapshot.inner("values", &mut values))?;
        self.0 = values;
        Ok(())
    }
}
