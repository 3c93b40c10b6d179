//! Values of actions that are linear in features, by least-squares policy iteration.

use adagio::faer::{Mat, MatRef, Par};
use adagio::value::{Fit, Lspi, LspiOptions, Outcomes, Samples, Start, ValueError};
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::arguments::{Count, refused};
use crate::arrays::{columns, list, rows};
use crate::threads::work;

/// Action numbers, none of them negative.
///
/// # Errors
/// A negative one.
pub fn actions(numbers: &[i64]) -> PyResult<Vec<usize>> {
    let number = |(index, &action): (usize, &i64)| {
        usize::try_from(action)
            .map_err(|_| refused(format!("sample {index} has action {action}: actions count from 0")))
    };
    numbers.iter().enumerate().map(number).collect()
}

/// Policy iteration over transitions; `ended` where nothing follows.
#[pyfunction]
#[allow(clippy::too_many_arguments)] // all of them parameters of the estimator
pub fn lspi(
    py: Python<'_>,
    phi: PyReadonlyArray2<'_, f64>,
    taken: PyReadonlyArray1<'_, i64>,
    rewards: PyReadonlyArray1<'_, f64>,
    next: PyReadonlyArray2<'_, f64>,
    ended: PyReadonlyArray1<'_, bool>,
    weights: PyReadonlyArray1<'_, f64>,
    n_actions: Count,
    gamma: f64,
    ridge: f64,
    mixing: f64,
    max_iterations: Count,
    tolerance: f64,
    start: &str,
    seed: Count,
    soft: bool,
    closeness: Option<f64>,
) -> PyResult<ActionWeights> {
    let start = match start {
        "uniform" => Start::Uniform,
        "drawn" => Start::Drawn(seed.0 as u64),
        "first" => Start::First,
        _ => {
            let allowed = "\"uniform\", \"drawn\" or \"first\"";
            return Err(refused(format!("start = {start:?} is not allowed: it must be {allowed}")));
        }
    };
    let max_iterations = max_iterations.0;
    let options = LspiOptions { gamma, ridge, mixing, max_iterations, tolerance, start, soft, closeness };
    let (phi, next, rewards) = (columns(&phi)?, columns(&next)?, list(&rewards)?);
    let (actions, weights, ended) = (actions(list(&taken)?)?, list(&weights)?, list(&ended)?);
    work(py, || {
        if ended.len() != next.ncols() {
            return Err(ValueError::Length { what: "terminal", found: ended.len(), expected: next.ncols() });
        }
        let samples = Samples { phi, actions: &actions, weights };
        let problem = Lspi::new(samples, n_actions.0, Par::rayon(0))?;
        let stopped;
        let next = if ended.contains(&true) {
            stopped = without(next, ended);
            stopped.as_ref()
        } else {
            next
        };
        problem.fit(&Outcomes { next, rewards, allowed: None }, &options)
    })
    .map(ActionWeights)
}

/// The features after transitions: none where the episode ended.
fn without(next: MatRef<'_, f64>, ended: &[bool]) -> Mat<f64> {
    Mat::from_fn(next.nrows(), next.ncols(), |i, t| if ended[t] { 0.0 } else { next[(i, t)] })
}

/// Values of actions as weights of features.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct ActionWeights(Fit);

#[pymethods]
impl ActionWeights {
    #[new]
    fn new(
        weights: PyReadonlyArray2<'_, f64>,
        iterations: Count,
        converged: bool,
        cycle: Option<Count>,
        untried: Vec<Count>,
    ) -> PyResult<Self> {
        let (weights, untried) = (columns(&weights)?.to_owned(), untried.into_iter().map(|action| action.0).collect());
        let fit = Fit { weights, iterations: iterations.0, converged, cycle: cycle.map(|count| count.0), untried };
        match fit.untried.iter().find(|&&action| action >= fit.weights.ncols()) {
            Some(action) => Err(refused(format!("action {action} of {} was not tried", fit.weights.ncols()))),
            None => Ok(ActionWeights(fit)),
        }
    }

    fn __getnewargs__<'py>(
        &self,
        py: Python<'py>,
    ) -> (Bound<'py, PyArray2<f64>>, usize, bool, Option<usize>, Vec<usize>) {
        (self.weights(py), self.0.iterations, self.0.converged, self.0.cycle, self.0.untried.clone())
    }

    /// Weights, actions × features.
    #[getter]
    fn weights<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<f64>> {
        rows(py, self.0.weights.as_ref())
    }

    /// Evaluations done.
    #[getter]
    fn iterations(&self) -> usize {
        self.0.iterations
    }

    /// Whether weights and greedy actions stopped changing.
    #[getter]
    fn converged(&self) -> bool {
        self.0.converged
    }

    /// Length of the circle that the policy ran in, if it did.
    #[getter]
    fn cycle(&self) -> Option<usize> {
        self.0.cycle
    }

    /// Values, samples × actions.
    fn action_values<'py>(
        &self,
        py: Python<'py>,
        phi: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let phi = columns(&phi)?;
        let q = work(py, || self.0.action_values(phi))?;
        Ok(rows(py, q.as_ref()))
    }

    /// Greedy actions.
    fn policy<'py>(&self, py: Python<'py>, phi: PyReadonlyArray2<'py, f64>) -> PyResult<Bound<'py, PyArray1<i64>>> {
        let phi = columns(&phi)?;
        let policy = work(py, || self.0.policy(phi))?;
        Ok(PyArray1::from_iter(py, policy.chosen().into_iter().map(|action| action as i64)))
    }
}
