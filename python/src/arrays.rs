//! NumPy arrays as matrices, and the way back.

use adagio::faer::MatRef;
use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

/// An array of samples × features as features × samples, without a copy.
///
/// # Errors
/// An array that is not in C order.
pub fn columns<'a>(array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<MatRef<'a, f64>> {
    let (samples, features) = (array.shape()[0], array.shape()[1]);
    let values = array.as_slice().ok().filter(|_| array.is_c_contiguous());
    let fault = "the array is not contiguous in C order: numpy.ascontiguousarray makes one that is";
    let values = values.ok_or_else(|| PyTypeError::new_err(fault))?;
    Ok(MatRef::from_column_major_slice(values, features, samples))
}

/// The values of a list.
///
/// # Errors
/// A list that is not contiguous.
pub fn list<'a, T: numpy::Element>(array: &'a PyReadonlyArray1<'_, T>) -> PyResult<&'a [T]> {
    array
        .as_slice()
        .map_err(|_| PyTypeError::new_err("the list is not contiguous: numpy.ascontiguousarray makes one that is"))
}

/// A matrix of features × samples as an array of samples × features.
pub fn rows<'py, T: numpy::Element + Copy>(py: Python<'py>, matrix: MatRef<'_, T>) -> Bound<'py, PyArray2<T>> {
    let mut values = Vec::with_capacity(matrix.nrows() * matrix.ncols());
    // Columns of a matrix may stand apart in storage.
    matrix.col_iter().for_each(|column| values.extend(column.iter().copied()));
    table(py, values, matrix.ncols(), matrix.nrows())
}

/// `rows · columns` values as an array, without a copy.
pub fn table<T: numpy::Element>(py: Python<'_>, values: Vec<T>, rows: usize, columns: usize) -> Bound<'_, PyArray2<T>> {
    let array = Array2::from_shape_vec((rows, columns), values);
    // Whoever calls has counted them; a panic is an exception.
    array.expect("as many values as the shape says").into_pyarray(py)
}
