//! What several tests share.
#![allow(dead_code)] // each test binary uses its own part of it

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use faer::{Mat, MatRef, Par};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use adagio::dictionary::Parameters;
use adagio::kernel::Kernel;

pub fn generator(seed: u64) -> ChaCha8Rng {
    ChaCha8Rng::seed_from_u64(seed)
}

/// A smooth random path of `n` points in `[0, 1]^d`, one a column: what a camera stream looks like to a dictionary.
pub fn random_path(d: usize, n: usize, seed: u64) -> Mat<f64> {
    let mut rng = generator(seed);
    let mut point = vec![0.5f64; d];
    let mut path = Mat::zeros(d, n);
    for j in 0..n {
        for (i, value) in point.iter_mut().enumerate() {
            *value = (*value + rng.random_range(-0.08..0.08)).clamp(0.0, 1.0);
            path[(i, j)] = *value;
        }
    }
    path
}

pub fn parameters(sigma: f64, nu: f64, budget: usize) -> Parameters {
    Parameters { kernel: Kernel::gaussian(sigma).unwrap(), nu, budget, par: Par::Seq }
}

/// Largest difference of two matrices, as a share of the largest entry of the second.
pub fn relative_difference(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
    assert_eq!((a.nrows(), a.ncols()), (b.nrows(), b.ncols()));
    (a - b).norm_max() / b.norm_max()
}

/// A file of this package.
pub fn package_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Run the real program in a folder.
pub fn adagio(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_adagio")).current_dir(folder).args(arguments).output().unwrap()
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Run the smoke scenario into `folder/name`, which must succeed; the run folder.
pub fn smoke_run(folder: &Path, name: &str, arguments: &[&str]) -> PathBuf {
    let scenario = package_file("scenarios/smoke.toml");
    let mut all = vec!["run", scenario.to_str().unwrap(), "--quiet", "--out", name];
    all.extend(arguments);
    let output = adagio(folder, &all);
    assert!(output.status.success(), "{}", stderr(&output));
    folder.join(name)
}

/// The report of a run folder.
pub fn report(run: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(run.join("report.json")).unwrap()).unwrap()
}

/// What the Python readers see, or `None` if their packages are missing.
pub fn read_with_python(path: &Path) -> Option<Value> {
    let script = package_file("tests/python/read_log.py");
    let python = env::var("ADAGIO_PYTHON").unwrap_or_else(|_| "python3".into());
    let output = Command::new(&python).arg(script).arg(path).arg("--messages=-1").output();
    let missing = match &output {
        Err(cause) => format!("{python} does not start: {cause}"),
        Ok(output) if output.status.code() == Some(3) => {
            format!("{python}: {}", String::from_utf8_lossy(&output.stderr).trim())
        }
        Ok(output) => {
            let errors = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "a reader failed on {}: {errors}", path.display());
            return Some(serde_json::from_slice(&output.stdout).unwrap());
        }
    };
    let required = env::var("ADAGIO_REQUIRE_PYTHON").is_ok_and(|value| value == "1");
    assert!(!required, "NOT CHECKED with other readers: {missing}");
    eprintln!("NOT CHECKED with other readers: {missing}");
    None
}
