//! Heavy work: without the interpreter, on threads of our own, and with panics as exceptions.

use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::arguments::refused;

/// The threads, and the process that they belong to.
static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// The threads of this process: a forked one has none of its parent's, and would wait for them for ever.
fn pool() -> Result<Arc<ThreadPool>, String> {
    let mut slot = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    let process = std::process::id();
    if let Some((owner, pool)) = &*slot
        && *owner == process
    {
        return Ok(pool.clone());
    }
    let threads = ThreadPoolBuilder::new().thread_name(|i| format!("adagio-{i}")).build();
    let pool = Arc::new(threads.map_err(|cause| format!("no threads could be started: {cause}"))?);
    // There is nobody to stop in the parent's pool.
    std::mem::forget(slot.replace((process, pool.clone())));
    Ok(pool)
}

/// Do something while other Python threads run.
///
/// # Errors
/// What the work refuses as `ValueError`, a panic as `RuntimeError`.
pub fn work<T: Send, E: Display + Send>(py: Python<'_>, job: impl FnOnce() -> Result<T, E> + Send) -> PyResult<T> {
    let done = py.detach(|| {
        let pool = pool()?;
        catch_unwind(AssertUnwindSafe(|| pool.install(job))).map_err(|panic| {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no text");
            format!("a fault of adagio itself: {text}")
        })
    });
    done.map_err(PyRuntimeError::new_err)?.map_err(refused)
}

/// Do something for one block of samples after the other, `(start, size)`, and hear Ctrl-C in between.
///
/// # Errors
/// Those of [`work`], and `KeyboardInterrupt`; the blocks before are done.
pub fn in_blocks<E: Display + Send>(
    py: Python<'_>,
    samples: usize,
    size: usize,
    mut job: impl FnMut(usize, usize) -> Result<(), E> + Send,
) -> PyResult<()> {
    for start in (0..samples).step_by(size) {
        work(py, || job(start, size.min(samples - start)))?;
        py.check_signals()?;
    }
    Ok(())
}

/// The content of an object that several Python threads may use; call it without the interpreter, which the one that has the
/// content may need.
///
/// # Errors
/// An earlier panic left it in an unknown state.
pub fn lock<T>(content: &Mutex<T>) -> Result<MutexGuard<'_, T>, String> {
    content
        .lock()
        .map_err(|_| "this object is not to be used: an earlier call ended in a fault of adagio itself".into())
}
