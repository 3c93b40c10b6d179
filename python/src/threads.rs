//! Heavy work: without the interpreter, on threads of our own, and with panics as exceptions.

use std::convert::Infallible;
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::arguments::refused;

/// How long Ctrl-C may wait.
const PATIENCE: Duration = Duration::from_millis(50);

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
    let done = py.detach(|| caught(|| Ok(pool()?.install(job))));
    done.map_err(PyRuntimeError::new_err)?.map_err(refused)
}

/// As [`work`], for work that ends early when it is asked to: Ctrl-C asks it.
///
/// # Errors
/// `KeyboardInterrupt`, a panic as `RuntimeError`; and what the work returns.
pub fn interruptible<T: Send>(py: Python<'_>, job: impl FnOnce(&AtomicBool) -> T + Send) -> PyResult<T> {
    let stop = AtomicBool::new(false);
    let mut interrupt = None;
    let done = py.detach(|| {
        std::thread::scope(|scope| {
            let (end, ended) = channel::<Infallible>();
            let stop = &stop;
            let worker = scope.spawn(move || {
                let _end = end;
                caught(|| Ok(pool()?.install(|| job(stop))))
            });
            while ended.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout) {
                if let Err(error) = Python::attach(|py| py.check_signals()) {
                    stop.store(true, Ordering::Relaxed);
                    interrupt = Some(error);
                }
            }
            worker.join().unwrap_or_else(|_| Err("a fault of adagio itself".into()))
        })
    });
    match interrupt {
        Some(error) => Err(error),
        None => done.map_err(PyRuntimeError::new_err),
    }
}

/// Do something with the content of an object, for which other Python threads wait.
///
/// They wait without the interpreter, which this one may need; and outside of the pool: a thread there that waits for a
/// part of its work takes up other work meanwhile, and would end up waiting for itself.
///
/// # Errors
/// Those of [`work`]; an earlier panic left the content in an unknown state.
pub fn with<C: Send, T: Send, E: Display + Send>(
    py: Python<'_>,
    content: &Mutex<C>,
    job: impl FnOnce(&mut C) -> Result<T, E> + Send,
) -> PyResult<T> {
    let done = py.detach(|| {
        caught(|| {
            let spoilt = |_| "this object is not to be used: an earlier call ended in a fault of adagio itself";
            let (pool, mut content) = (pool()?, content.lock().map_err(spoilt)?);
            let content: &mut C = &mut content;
            Ok(pool.install(|| job(content)))
        })
    });
    done.map_err(PyRuntimeError::new_err)?.map_err(refused)
}

/// A value from the content of an object, or a change of it that cannot fail.
///
/// # Errors
/// An earlier panic left the content in an unknown state.
pub fn get<C: Send, T: Send>(py: Python<'_>, content: &Mutex<C>, job: impl FnOnce(&mut C) -> T + Send) -> PyResult<T> {
    with(py, content, |content| Ok::<_, Infallible>(job(content)))
}

/// As [`with`] for one block of samples after the other, `(start, size)`; between them Ctrl-C is heard.
///
/// # Errors
/// Those of [`with`], and `KeyboardInterrupt`; the blocks before are done.
pub fn in_blocks<C: Send, E: Display + Send>(
    py: Python<'_>,
    content: &Mutex<C>,
    (samples, size): (usize, usize),
    job: impl Fn(&mut C, usize, usize) -> Result<(), E> + Sync,
) -> PyResult<()> {
    for start in (0..samples).step_by(size) {
        with(py, content, |content| job(content, start, size.min(samples - start)))?;
        py.check_signals()?;
    }
    Ok(())
}

/// A panic as an error.
fn caught<T>(job: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(job)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no text");
        Err(format!("a fault of adagio itself: {text}"))
    })
}
