//! `Agent`: a run that a Python program drives.

use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, TryLockError};
use std::time::Duration;

use adagio::cli::Ending;
use adagio::cli::program::{Session, SessionError, Step};
use adagio::robot::Pose;
use adagio::vision::Image;
use nalgebra::Point2;
use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::create_exception;
use pyo3::exceptions::{PyRuntimeError, PyTypeError, PyValueError};
use pyo3::prelude::*;

/// How long a call waits until it looks whether somebody has pressed Ctrl-C.
const PATIENCE: Duration = Duration::from_millis(100);

/// The most pixels that an image may have.
const MOST_PIXELS: usize = 1 << 26;

/// A run that a Python program drives.
#[pyclass(frozen, module = "adagio._adagio")]
pub struct Agent {
    session: Mutex<Session>,
    run: PathBuf,
    actions: Vec<String>,
    tasks: Vec<String>,
}

create_exception!(adagio, RunOver, PyRuntimeError, "The run is over: its last action is done, or it was closed.");

/// Why a session refuses something, as Python has it.
fn refused(cause: SessionError) -> PyErr {
    let text = cause.to_string();
    match cause {
        SessionError::Wrong(_) => PyValueError::new_err(text),
        SessionError::Over(_) => RunOver::new_err(text),
        SessionError::Turn(_) | SessionError::Failed(_) => PyRuntimeError::new_err(text),
    }
}

/// How a command ended, as Python has it: a scenario that is not valid is a wrong value.
pub fn raised(ending: Ending) -> PyErr {
    match ending {
        Ending::Usage(text) => PyValueError::new_err(text),
        Ending::Failed(text) | Ending::DataLoss(text) => PyRuntimeError::new_err(text),
    }
}

/// Pixels of an array of height × width × 3, or height × width, of 8 bits.
pub fn image_of(array: &PyReadonlyArrayDyn<'_, u8>) -> PyResult<Image> {
    let shape = array.shape();
    let (height, width, channels) = match *shape {
        [height, width] => (height, width, 1),
        [height, width, channels @ (1 | 3)] => (height, width, channels),
        _ => {
            let text = format!(
                "an image has the shape (height, width, 3), (height, width, 1) or (height, width), not {shape:?}"
            );
            return Err(PyValueError::new_err(text));
        }
    };
    if height == 0 || width == 0 || height.saturating_mul(width) > MOST_PIXELS {
        return Err(PyValueError::new_err(format!("an image has 1 to {MOST_PIXELS} pixels, not {height} × {width}")));
    }
    let pixels = array.as_array();
    let rgb = match channels {
        3 => pixels.iter().copied().collect(),
        _ => pixels.iter().flat_map(|&grey| [grey; 3]).collect(),
    };
    Ok(Image { width, height, cropped: false, rgb })
}

/// A pose that was given under a name.
pub fn pose_of(name: &str, pose: Option<(f64, f64, f64)>) -> PyResult<Option<Pose>> {
    let Some((x, y, heading)) = pose else { return Ok(None) };
    if ![x, y, heading].iter().all(|value| value.is_finite()) {
        let text = format!("{name} = ({x}, {y}, {heading}): it must be finite numbers, metres and radians");
        return Err(PyValueError::new_err(text));
    }
    Ok(Some(Pose::new(Point2::new(x, y), heading)))
}

/// The action behind what was shown last, when it is decided on.
fn decided(py: Python<'_>, session: &mut Session) -> PyResult<usize> {
    loop {
        if let Some(action) = py.detach(|| session.action(PATIENCE)).map_err(refused)? {
            return Ok(action.index());
        }
        py.check_signals()?;
    }
}

impl Agent {
    fn of(session: Session) -> Self {
        let scenario = session.scenario();
        let set = &scenario.robot.actions;
        let actions = set.iter().map(|action| set.name(action).to_owned()).collect();
        let tasks = scenario.names().map(str::to_owned).collect();
        let run = session.run().to_owned();
        Agent { session: Mutex::new(session), run, actions, tasks }
    }

    /// Calls of two threads at a time would mix their frames.
    fn alone(&self) -> PyResult<MutexGuard<'_, Session>> {
        match self.session.try_lock() {
            Ok(session) => Ok(session),
            Err(TryLockError::Poisoned(poisoned)) => Ok(poisoned.into_inner()),
            Err(TryLockError::WouldBlock) => {
                Err(PyRuntimeError::new_err("another thread is in a call of this agent: one at a time"))
            }
        }
    }
}

#[pymethods]
impl Agent {
    /// A new run: of a scenario file with overrides, or of a scenario's text.
    #[staticmethod]
    #[pyo3(signature = (scenario, text, sets, out))]
    fn begin(
        py: Python<'_>,
        scenario: Option<PathBuf>,
        text: &str,
        sets: Vec<String>,
        out: Option<PathBuf>,
    ) -> PyResult<Self> {
        let of = scenario.as_deref().ok_or(text);
        py.detach(|| Session::begin(of, &sets, out.as_deref())).map(Agent::of).map_err(raised)
    }

    /// An interrupted run goes on.
    #[staticmethod]
    fn resume(py: Python<'_>, run: PathBuf) -> PyResult<Self> {
        py.detach(|| Session::resume(&run)).map(Agent::of).map_err(raised)
    }

    #[getter]
    fn run(&self) -> PathBuf {
        self.run.clone()
    }

    #[getter]
    fn actions(&self) -> Vec<String> {
        self.actions.clone()
    }

    #[getter]
    fn tasks(&self) -> Vec<String> {
        self.tasks.clone()
    }

    /// Show what an action came to, and decide on the next; none at the end of an episode. Behind Ctrl-C, the action that is owed.
    #[pyo3(signature = (image, rewards, pose, blocked, done, reset))]
    #[allow(clippy::too_many_arguments)] // all of them are one call's
    fn act(
        &self,
        py: Python<'_>,
        image: PyReadonlyArrayDyn<'_, u8>,
        rewards: Vec<(Option<String>, f64)>,
        pose: Option<(f64, f64, f64)>,
        blocked: bool,
        done: bool,
        reset: bool,
    ) -> PyResult<Option<usize>> {
        let image = image_of(&image)?;
        if let Some((_, reward)) = rewards.iter().find(|(_, reward)| !reward.is_finite()) {
            return Err(PyValueError::new_err(format!("reward = {reward}: it must be a finite number")));
        }
        let step = Step { pose: pose_of("pose", pose)?, blocked, rewards, done, reset };
        let session = &mut *self.alone()?;
        // Ctrl-C has interrupted the call before: its action comes first, and is void where an episode begins.
        if session.owes_action() {
            let action = decided(py, session)?;
            if !reset {
                return Ok(Some(action));
            }
        }
        py.detach(|| session.show(image, &step)).map_err(refused)?;
        if done { Ok(None) } else { decided(py, session).map(Some) }
    }

    /// Show an image that was taken during an action.
    #[pyo3(signature = (image, pose))]
    fn observe(
        &self,
        py: Python<'_>,
        image: PyReadonlyArrayDyn<'_, u8>,
        pose: Option<(f64, f64, f64)>,
    ) -> PyResult<()> {
        let (image, pose) = (image_of(&image)?, pose_of("pose", pose)?);
        let session = &mut *self.alone()?;
        py.detach(|| session.observe(image, pose)).map_err(refused)
    }

    fn mark(&self, text: &str) -> PyResult<()> {
        self.alone()?.mark(text).map_err(refused)
    }

    fn goto(&self, task: &str) -> PyResult<()> {
        self.alone()?.goto(task).map_err(refused)
    }

    /// End the run; `report.json`.
    fn close(&self, py: Python<'_>) -> PyResult<String> {
        let session = &mut *self.alone()?;
        let report = py.detach(|| session.close()).map_err(PyRuntimeError::new_err)?;
        serde_json::to_string(report).map_err(|error| PyRuntimeError::new_err(error.to_string()))
    }

    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err("an agent that drives cannot be pickled: close it, and resume its run"))
    }
}
