//! Matrices in numpy's file format, version 1.0: a text header, then the values.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use faer::Mat;

/// Write the transpose of a matrix: its columns are the rows of the array.
///
/// `kind` is numpy's name of the number type, `bytes` gives its bytes.
pub fn write<T: Copy, const SIZE: usize>(
    path: &Path,
    kind: &str,
    matrix: &Mat<T>,
    bytes: impl Fn(T) -> [u8; SIZE],
) -> io::Result<()> {
    let shape = format!("({}, {})", matrix.ncols(), matrix.nrows());
    let mut header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic string, version, length and header together are a multiple of 64 bytes, and end with a line feed.
    let before = 10;
    header += &" ".repeat((64 - (before + header.len() + 1) % 64) % 64);
    header.push('\n');
    let mut file = BufWriter::new(File::create(path)?);
    file.write_all(b"\x93NUMPY\x01\x00")?;
    file.write_all(&(header.len() as u16).to_le_bytes())?;
    file.write_all(header.as_bytes())?;
    for column in 0..matrix.ncols() {
        for row in 0..matrix.nrows() {
            file.write_all(&bytes(matrix[(row, column)]))?;
        }
    }
    file.flush()
}
