//! `Recorded`: a run that is over, or goes on elsewhere, as far as its log says.

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use adagio::cli::Ending;
use adagio::cli::export::{model_of, recorded};
use adagio::export::{Model, export};
use adagio::faer::{Mat, Par};
use adagio::policy::{self, columns};
use adagio::replay::Recording;
use adagio::robot::Action;
use adagio::scenario::{Scenario, Vision};
use adagio::vision::{Observation, check_size, observe};
use numpy::{PyArray2, PyReadonlyArrayDyn};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::agent::{image_of, pose_of, raised};
use crate::arrays::rows;
use crate::threads::work;

/// A recorded run.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct Recorded {
    run: PathBuf,
    recording: Recording,
    scenario: Arc<Scenario>,
    /// Its newest model, read when it is asked for; why there is none.
    model: OnceLock<Result<Arc<Model>, String>>,
}

impl Recorded {
    fn model(&self) -> Result<&Arc<Model>, String> {
        let read = || {
            model_of(&self.run).map(Arc::new).map_err(|ending| match ending {
                Ending::Failed(text) | Ending::Usage(text) | Ending::DataLoss(text) => text,
            })
        };
        self.model.get_or_init(read).as_ref().map_err(Clone::clone)
    }

    /// Images of any size as the model sees them.
    fn seen(&self, images: Vec<PyReadonlyArrayDyn<'_, u8>>) -> PyResult<Vec<Observation>> {
        images.iter().map(|image| seen(image, &self.scenario.vision)).collect()
    }
}

/// An image of any size as a model sees it.
fn seen(image: &PyReadonlyArrayDyn<'_, u8>, vision: &Vision) -> PyResult<Observation> {
    let image = image_of(image)?;
    check_size(&image, vision).map_err(PyValueError::new_err)?;
    Ok(observe(&image, vision, 0))
}

fn check_task(model: &Model, task: usize) -> PyResult<()> {
    let tasks = model.learned.weights.len();
    if task < tasks {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("there is no task number {task}: there are {tasks}")))
}

#[pymethods]
impl Recorded {
    #[new]
    fn new(py: Python<'_>, run: PathBuf) -> PyResult<Self> {
        let (recording, scenario) = py.detach(|| recorded(&run)).map_err(raised)?;
        Ok(Recorded { run, recording, scenario, model: OnceLock::new() })
    }

    /// The complete scenario.
    #[getter]
    fn scenario(&self) -> String {
        self.scenario.text.clone()
    }

    #[getter]
    fn actions(&self) -> Vec<String> {
        let set = &self.scenario.robot.actions;
        set.iter().map(|action| set.name(action).to_owned()).collect()
    }

    #[getter]
    fn tasks(&self) -> Vec<String> {
        self.scenario.tasks.iter().map(|task| task.name.clone()).collect()
    }

    /// Write all arrays into a folder, which exists and is empty; `about.json`.
    fn export(&self, py: Python<'_>, out: PathBuf) -> PyResult<String> {
        let written = work(py, || {
            let model = self.model().ok().map(Arc::as_ref);
            Ok::<_, Infallible>(export(&self.recording, &self.run, &self.scenario, model, false, &out))
        })?;
        let about = written.map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
        serde_json::to_string(&about).map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }

    /// Why there is no model, if there is none.
    fn without_model(&self, py: Python<'_>) -> Option<String> {
        py.detach(|| self.model().err())
    }

    /// Features of images by the newest model, images × features.
    fn features<'py>(
        &self,
        py: Python<'py>,
        images: Vec<PyReadonlyArrayDyn<'py, u8>>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let model = py.detach(|| self.model()).map_err(PyRuntimeError::new_err)?;
        let seen = self.seen(images)?;
        let features = work(py, || {
            Ok::<_, Infallible>(match seen.is_empty() {
                true => Mat::zeros(model.learned.model.features(), 0),
                false => model.learned.features(columns(seen.iter()).as_ref(), Par::rayon(0)),
            })
        })?;
        Ok(rows(py, features.as_ref()))
    }

    /// Values of all actions for a task, images × actions.
    fn q_values<'py>(
        &self,
        py: Python<'py>,
        images: Vec<PyReadonlyArrayDyn<'py, u8>>,
        task: usize,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let model = py.detach(|| self.model()).map_err(PyRuntimeError::new_err)?;
        let actions = model.learned.actions();
        check_task(model, task)?;
        let seen = self.seen(images)?;
        let values = work(py, || {
            let values: Vec<_> = seen.iter().map(|image| model.learned.q_values(image, task)).collect();
            Ok::<_, Infallible>(Mat::from_fn(actions, seen.len(), |action, j| values[j][action]))
        })?;
        Ok(rows(py, values.as_ref()))
    }

    /// A pilot to the goal of a task, by the newest model.
    fn pilot(&self, py: Python<'_>, task: usize) -> PyResult<Pilot> {
        let model = py.detach(|| self.model()).map_err(PyRuntimeError::new_err)?.clone();
        check_task(&model, task)?;
        let pilot = policy::Pilot::new(&model.scenario, task);
        Ok(Pilot { model, pilot: Mutex::new(pilot) })
    }
}

/// Drives to the goal of a task by a model that learns nothing more.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct Pilot {
    model: Arc<Model>,
    pilot: Mutex<policy::Pilot>,
}

#[pymethods]
impl Pilot {
    /// The action behind an image; none where the model tells that it is there.
    fn act(
        &self,
        py: Python<'_>,
        image: PyReadonlyArrayDyn<'_, u8>,
        blocked: bool,
        odometry: Option<(f64, f64, f64)>,
    ) -> PyResult<Option<usize>> {
        let (seen, odometry) = (seen(&image, &self.model.scenario.vision)?, pose_of("odometry", odometry)?);
        let action = work(py, || {
            let mut pilot = self.pilot.lock().unwrap_or_else(PoisonError::into_inner);
            Ok::<_, Infallible>(pilot.act(&self.model.learned, &seen, blocked, odometry))
        })?;
        Ok(action.map(Action::index))
    }

    /// Begin anew, from anywhere.
    fn reset(&self, py: Python<'_>) {
        py.detach(|| self.pilot.lock().unwrap_or_else(PoisonError::into_inner).begin());
    }
}
