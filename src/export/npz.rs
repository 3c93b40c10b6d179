//! Arrays for Python: `numpy.load` opens the files.
//!
//! An array is written row by row to a file of its own, since how many rows there are is only known at the end; then all
//! arrays of a table are put into one `.npz`, a ZIP archive of `.npy` files. Memory does not grow with the number of rows.
//!
//! # Reference
//! NumPy, format specification of `.npy`, version 1.0.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// A number that an array can hold.
pub trait Element: Copy {
    /// NumPy's name of the type.
    const TYPE: &'static str;

    /// Add its bytes.
    fn put(self, bytes: &mut Vec<u8>);
}

macro_rules! element {
    ($($type:ty = $name:literal),+ $(,)?) => {
        $(impl Element for $type {
            const TYPE: &'static str = $name;

            fn put(self, bytes: &mut Vec<u8>) {
                bytes.extend_from_slice(&self.to_le_bytes());
            }
        })+
    };
}

element!(u8 = "|u1", i8 = "|i1", u32 = "<u4", i32 = "<i4", u64 = "<u8", f32 = "<f4", f64 = "<f8");

impl Element for bool {
    const TYPE: &'static str = "|b1";

    fn put(self, bytes: &mut Vec<u8>) {
        bytes.push(self.into());
    }
}

/// An array that is being written.
pub struct Array<T> {
    name: &'static str,
    /// Shape of a row; empty for a row that is one number.
    row: Vec<usize>,
    rows: usize,
    path: PathBuf,
    file: BufWriter<File>,
    bytes: Vec<u8>,
    element: std::marker::PhantomData<T>,
}

/// An array that is complete.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArrayEntry {
    /// Its name in the `.npz`.
    pub name: &'static str,
    /// NumPy's name of the type of its numbers.
    pub element: &'static str,
    /// Its shape.
    pub shape: Vec<usize>,
    path: PathBuf,
}

impl<T: Element> Array<T> {
    /// An array without rows; its numbers go to a file in `folder` until it is packed.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn create(folder: &Path, name: &'static str, row: &[usize]) -> io::Result<Self> {
        let path = folder.join(name);
        let file = BufWriter::new(File::create_new(&path)?);
        Ok(Array { name, row: row.to_vec(), rows: 0, path, file, bytes: Vec::new(), element: std::marker::PhantomData })
    }

    /// Add a row.
    ///
    /// # Errors
    /// The operating system refuses; a row of another length is [`io::ErrorKind::InvalidInput`].
    pub fn push(&mut self, row: &[T]) -> io::Result<()> {
        let length = self.row.iter().product::<usize>();
        if row.len() != length {
            let text = format!("a row of {} numbers for the array {} of rows of {length}", row.len(), self.name);
            return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
        }
        self.bytes.clear();
        row.iter().for_each(|value| value.put(&mut self.bytes));
        self.rows += 1;
        self.file.write_all(&self.bytes)
    }

    /// No more rows.
    ///
    /// # Errors
    /// The operating system refuses.
    pub fn finish(mut self) -> io::Result<ArrayEntry> {
        self.file.flush()?;
        let shape = [&[self.rows][..], &self.row].concat();
        Ok(ArrayEntry { name: self.name, element: T::TYPE, shape, path: self.path })
    }
}

/// Put arrays into one `.npz` file, which must not exist; the files that they were in are removed.
///
/// # Errors
/// The operating system refuses.
pub fn pack(path: &Path, arrays: &[ArrayEntry]) -> io::Result<()> {
    let mut archive = ZipWriter::new(BufWriter::new(File::create_new(path)?));
    // Not compressed, as `numpy.savez` does it; and of any size.
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
    for array in arrays {
        archive.start_file(format!("{}.npy", array.name), options)?;
        archive.write_all(&header(array.element, &array.shape))?;
        io::copy(&mut BufReader::new(File::open(&array.path)?), &mut archive)?;
        std::fs::remove_file(&array.path)?;
    }
    archive.finish()?.flush()
}

/// What stands before the numbers of a `.npy` file: type and shape as a Python dictionary, up to a multiple of 64 bytes.
fn header(element: &str, shape: &[usize]) -> Vec<u8> {
    // A tuple of one has a comma, too.
    let shape: String = shape.iter().map(|length| format!("{length}, ")).collect();
    let text = format!("{{'descr': '{element}', 'fortran_order': False, 'shape': ({}), }}", shape.trim_end());
    const BEFORE: usize = 10;
    let padding = 63 - (BEFORE + text.len()) % 64;
    let length = (text.len() + padding + 1) as u16;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend(length.to_le_bytes());
    bytes.extend(text.bytes());
    bytes.extend(std::iter::repeat_n(b' ', padding));
    bytes.push(b'\n');
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_those_of_numpy() {
        let bytes = header("<f8", &[3, 4]);
        assert_eq!(bytes.len(), 128);
        assert_eq!(&bytes[..10], b"\x93NUMPY\x01\x00\x76\x00");
        let text = std::str::from_utf8(&bytes[10..]).unwrap();
        assert!(text.starts_with("{'descr': '<f8', 'fortran_order': False, 'shape': (3, 4,), }"), "{text}");
        assert!(text.ends_with(" \n"));
        for length in 0..200 {
            assert_eq!(header("|u1", &[10usize.pow(length % 18); 3]).len() % 64, 0);
        }
        assert!(std::str::from_utf8(&header("|b1", &[7])[10..]).unwrap().contains("'shape': (7,)"));
    }

    #[test]
    fn rows_of_another_length_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut array = Array::<u32>::create(folder.path(), "a", &[2, 3]).unwrap();
        array.push(&[1; 6]).unwrap();
        assert_eq!(array.push(&[1; 5]).unwrap_err().kind(), io::ErrorKind::InvalidInput);
        let written = array.finish().unwrap();
        assert_eq!((written.element, &written.shape[..]), ("<u4", &[1, 2, 3][..]));
        let path = folder.path().join("a.npz");
        pack(&path, &[written]).unwrap();
        assert!(path.is_file() && !folder.path().join("a").exists());
        assert!(pack(&path, &[]).is_err(), "nothing is overwritten");
    }
}
