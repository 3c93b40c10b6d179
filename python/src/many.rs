//! `learn`: one model from many logs, on whatever runs Python functions.

use std::convert::Infallible;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

use adagio::cli::PartArgs;
use adagio::cli::learn::{Order, learn_with, part};
use adagio::learn::{Job, Work};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

use crate::agent::raised;
use crate::threads::work;

/// Learn from logs; `engine` is called with lists of the arguments of [`learn_part`], and has them done. The report as JSON, and its folder.
///
/// # Errors
/// `ValueError` for logs that do not fit, whatever the engine raises, `RuntimeError` for the rest.
#[pyfunction]
#[pyo3(signature = (logs, scenario, sets, out, evaluate, engine))]
pub fn learn(
    py: Python<'_>,
    logs: Vec<PathBuf>,
    scenario: Option<PathBuf>,
    sets: Vec<String>,
    out: Option<PathBuf>,
    evaluate: bool,
    engine: Py<PyAny>,
) -> PyResult<(String, PathBuf)> {
    let failed: Mutex<Option<PyErr>> = Mutex::new(None);
    // Ctrl-C is raised by the engine.
    let stop = AtomicBool::new(false);
    let order = Order {
        logs: &logs,
        scenario: scenario.as_deref(),
        set: &sets,
        out: out.as_deref(),
        evaluate,
        quiet: true,
        stop: &stop,
    };
    // On this thread, where Ctrl-C reaches the engine.
    let learned = py.detach(|| {
        let run = |parts: &[Work], _: &(dyn Fn() + Sync)| {
            let parts: Vec<_> = parts
                .iter()
                .map(|of| (of.verb, &of.log, (of.frames.start, of.frames.end), &of.scenario, &of.dictionary, &of.out))
                .collect();
            Python::attach(|py| engine.call1(py, (parts,))).map(drop).map_err(|error| {
                let text = error.to_string();
                *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                text
            })
        };
        learn_with(&order, &run)
    });
    if let Some(error) = failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        return Err(error);
    }
    let (report, out) = learned.map_err(raised)?;
    let json = serde_json::to_string(&report).map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
    Ok((json, out))
}

/// One part of that, of some frames of a log: what `adagio members` or `adagio moments` does.
///
/// # Errors
/// A log that cannot be read, a part that cannot be written.
#[pyfunction]
pub fn learn_part(
    py: Python<'_>,
    verb: &str,
    log: PathBuf,
    frames: (u64, u64),
    scenario: PathBuf,
    dictionary: PathBuf,
    out: PathBuf,
) -> PyResult<()> {
    let job = Job::of_verb(verb).ok_or_else(|| PyValueError::new_err(format!("there is no work {verb:?}")))?;
    let args = PartArgs { log, frames: Some(frames.0..frames.1), scenario, dictionary: Some(dictionary), out };
    work(py, || Ok::<_, Infallible>(part(&args, &job)))?.map_err(raised)
}
