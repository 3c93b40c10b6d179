//! Arguments and errors.

use std::fmt::Display;

use adagio::dictionary::WhenFull;
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBool;

/// What the library refuses, with its text.
pub fn refused(cause: impl Display) -> PyErr {
    PyValueError::new_err(cause.to_string())
}

/// A whole number from 0 on.
#[derive(Debug, Clone, Copy)]
pub struct Count(pub usize);

impl<'py> FromPyObject<'_, 'py> for Count {
    type Error = PyErr;

    fn extract(object: Borrowed<'_, 'py, PyAny>) -> PyResult<Self> {
        if object.is_instance_of::<PyBool>() {
            return Err(PyTypeError::new_err(format!("{} is not a whole number", *object)));
        }
        object.extract().map(Count).map_err(|error: PyErr| {
            if error.is_instance_of::<PyOverflowError>(object.py()) {
                return refused(format!("{} is not allowed: it must be a whole number from 0 to 2⁶⁴ − 1", *object));
            }
            error
        })
    }
}

/// What happens at the budget of a dictionary, by its name.
///
/// # Errors
/// Another name.
pub fn when_full(name: &str) -> PyResult<WhenFull> {
    match name {
        "stop" => Ok(WhenFull::Stop),
        "raise_nu" => Ok(WhenFull::RaiseNu),
        "replace" => Ok(WhenFull::Replace),
        _ => Err(refused(format!(
            "when_full = {name:?} is not allowed: it must be \"stop\", \"raise_nu\" or \"replace\""
        ))),
    }
}
