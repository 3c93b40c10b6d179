//! Where the files of a run's log are kept.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Where the files of a run are kept, by their numbers.
pub trait Storage: Send {
    /// Begin a file, which must not exist.
    ///
    /// # Errors
    /// It exists, or the operating system refuses.
    fn create(&mut self, number: u32) -> io::Result<Box<dyn Write + Send>>;

    /// Whether a file that was begun is still where it was.
    fn holds(&self, number: u32) -> bool;

    /// Shorten a file.
    ///
    /// # Errors
    /// The operating system refuses.
    fn cut(&mut self, number: u32, bytes: u64) -> io::Result<()>;

    /// Delete a file.
    ///
    /// # Errors
    /// The operating system refuses.
    fn remove(&mut self, number: u32) -> io::Result<()>;

    /// Name of a file, for people.
    fn name(&self, number: u32) -> String;
}

/// A run's folder as storage.
#[derive(Debug, Clone)]
pub struct Folder(PathBuf);

impl Folder {
    /// Storage in a folder, which must exist.
    pub fn new(path: &Path) -> Self {
        Folder(path.to_owned())
    }

    fn path(&self, number: u32) -> PathBuf {
        self.0.join(format!("run_{number:03}.mcap"))
    }
}

impl Storage for Folder {
    fn create(&mut self, number: u32) -> io::Result<Box<dyn Write + Send>> {
        Ok(Box::new(File::create_new(self.path(number))?))
    }

    fn holds(&self, number: u32) -> bool {
        self.path(number).is_file()
    }

    fn cut(&mut self, number: u32, bytes: u64) -> io::Result<()> {
        OpenOptions::new().write(true).open(self.path(number))?.set_len(bytes)
    }

    fn remove(&mut self, number: u32) -> io::Result<()> {
        std::fs::remove_file(self.path(number))
    }

    fn name(&self, number: u32) -> String {
        self.path(number).display().to_string()
    }
}

/// Storage that keeps nothing: for a repetition that is only compared.
#[derive(Debug, Clone, Copy)]
pub struct NullStorage;

impl Storage for NullStorage {
    fn create(&mut self, _: u32) -> io::Result<Box<dyn Write + Send>> {
        Ok(Box::new(io::sink()))
    }

    fn holds(&self, _: u32) -> bool {
        true
    }

    fn cut(&mut self, _: u32, _: u64) -> io::Result<()> {
        Ok(())
    }

    fn remove(&mut self, _: u32) -> io::Result<()> {
        Ok(())
    }

    fn name(&self, _: u32) -> String {
        "(not kept)".into()
    }
}

/// The numbers and paths of a run folder's log files, in order.
///
/// # Errors
/// The folder cannot be read.
pub fn log_files(run: &Path) -> io::Result<Vec<(u32, PathBuf)>> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(run)? {
        let path = entry?.path();
        files.extend(log_number(&path).map(|number| (number, path)));
    }
    files.sort();
    Ok(files)
}

/// The number of a log file of a run folder, by its name.
pub fn log_number(path: &Path) -> Option<u32> {
    let name = path.file_name()?.to_str()?;
    name.strip_prefix("run_")?.strip_suffix(".mcap")?.parse().ok()
}
