//! `experiment`: an experiment over many seeds, on whatever runs Python functions.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use adagio::cli::experiment::order;
use adagio::cli::{Ending, ExperimentArgs};
use adagio::experiment::{Experiment, ExperimentError, Scope, Seeds, keep, run};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::agent::raised;
use crate::arguments::{Count, refused};
use crate::threads::interruptible;

/// The process that has done a seed: agents of experiments leave threads behind that a forked process would wait for.
static WORKED: AtomicU32 = AtomicU32::new(0);

const FORKED: &str = "this process was forked from one that had done experiments itself, and has none of its threads: \
                      ProcessPoolExecutor(mp_context=multiprocessing.get_context(\"spawn\"))";

/// Name, whether quick, whether smoke, support vectors, world, folders of packages.
type What = (String, bool, bool, Option<Count>, Option<String>, Vec<PathBuf>);

/// Do an experiment; `engine` is called with a list of the arguments of [`experiment_seed`], and has them done. `result.json`, and its
/// folder.
///
/// # Errors
/// `ValueError` for what the experiment does not have, whatever the engine raises, `RuntimeError` for the rest.
#[pyfunction]
#[pyo3(signature = (what, seeds, out, cache, engine))]
pub fn experiment(
    py: Python<'_>,
    what: What,
    seeds: Vec<Count>,
    out: Option<PathBuf>,
    cache: Option<PathBuf>,
    engine: &Bound<'_, PyAny>,
) -> PyResult<(String, PathBuf)> {
    let (experiment, mut scope, out) = interruptible(py, |_| checked(&what, &seeds, out, cache))?.map_err(raised)?;
    // Workers may be elsewhere.
    (scope.cache, scope.quiet) = (std::path::absolute(&scope.cache)?, true);
    if out.exists() {
        return Err(refused(ExperimentError::Exists(out)));
    }
    let (name, quick, smoke, vectors, world, data) = &what;
    let what = (name, quick, smoke, vectors.map(|number| number.0), world, data);
    let parts: Vec<_> = scope.seeds.iter().map(|&seed| (what, seed, &scope.cache)).collect();
    engine.call1((parts,))?;
    let (result, _) = interruptible(py, |stop| run(experiment, &scope, &out, stop).map_err(ended))?.map_err(raised)?;
    let json = serde_json::to_string(&result).map_err(|error| PyRuntimeError::new_err(error.to_string()))?;
    Ok((json, out))
}

/// One seed of that: its settings are in the cache then.
///
/// # Errors
/// Those of [`experiment`].
#[pyfunction]
pub fn experiment_seed(py: Python<'_>, what: What, seed: Count, cache: PathBuf) -> PyResult<()> {
    let (process, before) = (std::process::id(), WORKED.load(Ordering::Relaxed));
    if before != 0 && before != process {
        return Err(PyRuntimeError::new_err(FORKED));
    }
    WORKED.store(process, Ordering::Relaxed);
    let job = |stop: &AtomicBool| {
        let (experiment, scope, _) = checked(&what, &[seed], None, Some(cache))?;
        keep(experiment, &scope, stop).map_err(ended)
    };
    interruptible(py, job)?.map_err(raised)
}

/// The arguments of the command, checked as it does; on threads of our own, as rayon's others would not survive a fork.
fn checked(
    (name, quick, smoke, vectors, world, data): &What,
    seeds: &[Count],
    out: Option<PathBuf>,
    cache: Option<PathBuf>,
) -> Result<(&'static Experiment, Scope, PathBuf), Ending> {
    let usage = |error: ExperimentError| Ending::Usage(error.to_string());
    let args = ExperimentArgs {
        name: Some(name.clone()),
        quick: *quick,
        smoke: *smoke,
        vectors: vectors.map(|number| number.0),
        seeds: Seeds::new(seeds.iter().map(|seed| seed.0 as u64)).map_err(usage)?,
        world: world.clone(),
        data: data.clone(),
        out,
        cache,
        threads: None,
        quiet: true,
        json: false,
    };
    order(name, &args)
}

fn ended(error: ExperimentError) -> Ending {
    match error {
        ExperimentError::Exists(_) | ExperimentError::Data { .. } => Ending::Usage(error.to_string()),
        _ => Ending::from(error),
    }
}
