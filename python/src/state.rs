//! The state of an object as a dictionary of arrays and texts: what `pickle` takes.

use std::collections::BTreeMap;

use adagio::faer::MatRef;
use adagio::snapshot::{Matrix, Snapshot, Values};
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::rows;

/// The state of an object that was saved as these parts.
///
/// # Errors
/// No memory.
pub fn parts(py: Python<'_>, snapshot: Snapshot) -> PyResult<Bound<'_, PyDict>> {
    let state = PyDict::new(py);
    for (name, Matrix { rows: height, columns, values }) in &snapshot.matrices {
        match values {
            Values::F64(values) => state.set_item(name, rows(py, view(values, *height, *columns)))?,
            Values::F32(values) => state.set_item(name, rows(py, view(values, *height, *columns)))?,
            Values::U8(values) => state.set_item(name, rows(py, view(values, *height, *columns)))?,
        }
    }
    for (name, text) in &snapshot.texts {
        state.set_item(name, text)?;
    }
    Ok(state)
}

fn view<T>(values: &[T], rows: usize, columns: usize) -> MatRef<'_, T> {
    MatRef::from_column_major_slice(values, rows, columns)
}

/// The parts of a state, to restore an object from.
///
/// # Errors
/// Parts that are neither arrays nor texts.
pub fn restoring(state: &Bound<'_, PyDict>) -> PyResult<Snapshot> {
    let (mut matrices, mut texts) = (BTreeMap::new(), BTreeMap::new());
    for (name, part) in state {
        let name: String = name.extract()?;
        if let Ok(text) = part.extract::<String>() {
            texts.insert(name, text);
        } else if let Some(matrix) =
            matrix(&part, Values::F64).or_else(|| matrix(&part, Values::F32)).or_else(|| matrix(&part, Values::U8))
        {
            matrices.insert(name, matrix);
        } else {
            return Err(PyTypeError::new_err(format!("{name} is neither a text nor an array of two dimensions")));
        }
    }
    Ok(Snapshot::restoring(matrices, texts))
}

/// A matrix of one kind of numbers, if this is one.
fn matrix<T: numpy::Element + Copy>(part: &Bound<'_, PyAny>, kind: fn(Vec<T>) -> Values) -> Option<Matrix> {
    let array: PyReadonlyArray2<'_, T> = part.extract().ok()?;
    let (columns, rows) = (array.shape()[0], array.shape()[1]);
    // In the order of C, however it is stored.
    let values = array.as_array().iter().copied().collect();
    Some(Matrix { rows, columns, values: kind(values) })
}
