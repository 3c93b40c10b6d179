//! What several tests share.
#![allow(dead_code)] // each test binary uses its own part of it

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;

use faer::{Mat, MatRef, Par};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use adagio::dictionary::{Ald, Dictionary, Parameters, WhenFull};
use adagio::gpu::{Adapters, Gpu};
use adagio::kernel::Kernel;
use adagio::slow::{Link, Moments};

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
    Parameters { kernel: Kernel::gaussian(sigma).unwrap(), nu, budget, when_full: WhenFull::Stop, par: Par::Seq }
}

pub fn ald(sigma: f64, nu: f64, budget: usize) -> Ald<f64> {
    Ald::new(parameters(sigma, nu, budget)).unwrap()
}

/// Moments of a whole series at once, by their definition.
pub fn batch_moments(v: MatRef<'_, f64>, links: &[Option<Link>]) -> Moments {
    let mut moments = Moments::new(Par::Seq);
    moments.widen(v.nrows()).unwrap();
    let linked: Vec<(usize, Link)> = links.iter().enumerate().filter_map(|(t, l)| l.map(|l| (t, l))).collect();
    let rates = Mat::from_fn(v.nrows(), linked.len(), |i, j| {
        let (t, link) = linked[j];
        link.weight.sqrt() * (v[(i, t)] - v[(i, t - 1)]) / link.dt
    });
    moments.add(v, rates.as_ref(), linked.iter().map(|(_, l)| l.weight).sum()).unwrap();
    moments
}

/// Links of random length and weight, with a gap now and then.
pub fn random_links(n: usize, seed: u64) -> Vec<Option<Link>> {
    let mut rng = generator(seed);
    (0..n)
        .map(|t| {
            let linked = t > 0 && rng.random_range(0.0..1.0) < 0.9;
            let link = Link { dt: rng.random_range(0.1..1.0), weight: rng.random_range(0.2..5.0) };
            linked.then_some(link)
        })
        .collect()
}

/// Mean, covariance and rate agree to a relative tolerance.
pub fn assert_same_moments(a: &Moments, b: &Moments, tolerance: f64) {
    assert_eq!(a.size(), b.size());
    assert!((a.frames() - b.frames()).abs() < 1e-9 && (a.links() - b.links()).abs() < 1e-9);
    for (a, b) in [(a.mean(), b.mean()), (a.covariance(), b.covariance()), (a.rate(), b.rate())] {
        let difference = relative_difference(a.as_ref(), b.as_ref());
        assert!(difference < tolerance, "moments differ by {difference}");
    }
}

/// Correlation of two series.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
    let (ma, mb) = (mean(a), mean(b));
    let dot =
        |x: &[f64], mx: f64, y: &[f64], my: f64| -> f64 { x.iter().zip(y).map(|(x, y)| (x - mx) * (y - my)).sum() };
    dot(a, ma, b, mb) / (dot(a, ma, a, ma) * dot(b, mb, b, mb)).sqrt()
}

/// Largest difference of two matrices, as a share of the largest entry of the second.
pub fn relative_difference(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> f64 {
    assert_eq!((a.nrows(), a.ncols()), (b.nrows(), b.ncols()));
    (a - b).norm_max() / b.norm_max()
}

/// Condition of a dictionary's kernel matrix, the square of that of its factor: rounding passes through solves with it.
pub fn condition(dictionary: &Dictionary<f64>) -> f64 {
    let singular = dictionary.factor().svd().unwrap();
    (singular.S()[0] / singular.S()[dictionary.len() - 1]).powi(2)
}

/// A file of this package.
pub fn package_file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// A graphics processor, or a driver in software (Mesa's) where there is none. Where there is neither, a test says so and checks
/// nothing; `ADAGIO_REQUIRE_GPU=1` makes that a failure.
pub fn device() -> Option<Arc<Gpu>> {
    match Gpu::open(Adapters::Any) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = env::var("ADAGIO_REQUIRE_GPU").is_ok_and(|value| value == "1");
            assert!(!required, "ADAGIO_REQUIRE_GPU is set: {error}");
            eprintln!("nothing is checked: {error}");
            None
        }
    }
}

/// Run the real program in a folder. It uses no graphics processor, so that two runs do not differ by who was faster.
pub fn adagio(folder: &Path, arguments: &[&str]) -> Output {
    adagio_on("none", folder, arguments)
}

/// Run the real program in a folder, on the graphics processors that [`adagio::gpu::SETTING`] allows.
pub fn adagio_on(gpu: &str, folder: &Path, arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_adagio"));
    program.current_dir(folder).args(arguments).env(adagio::gpu::SETTING, gpu).output().unwrap()
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Run the smoke scenario into `folder/name`, which must succeed, without drawings; the run folder.
pub fn smoke_run(folder: &Path, name: &str, arguments: &[&str]) -> PathBuf {
    let scenario = package_file("scenarios/smoke.toml");
    let mut all = vec!["run", scenario.to_str().unwrap(), "--quiet", "--no-report", "--out", name];
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
    let printed = python("read_log.py", &[path.to_str().unwrap(), "--messages=-1"])?;
    Some(serde_json::from_str(&printed).unwrap())
}

/// Demand that other people's tools are satisfied with logs; see `tests/python/judge_log.py`.
pub fn satisfies_other_tools(logs: &[PathBuf]) {
    assert!(!logs.is_empty());
    let names: Vec<&str> = logs.iter().map(|path| path.to_str().unwrap()).collect();
    if let Some(printed) = python("judge_log.py", &names) {
        assert_eq!(printed.trim(), format!("{} logs", logs.len()));
    }
}

/// What a script of `tests/python` prints, which must succeed; `None` if its packages are missing, and that is allowed.
///
/// `ADAGIO_PYTHON` names the Python (default `python3`); `ADAGIO_REQUIRE_PYTHON=1` makes missing packages a failure.
pub fn python(script: &str, arguments: &[&str]) -> Option<String> {
    let path = package_file("tests/python").join(script);
    let python = env::var("ADAGIO_PYTHON").unwrap_or_else(|_| "python3".into());
    let output = Command::new(&python).arg(path).args(arguments).output();
    let missing = match &output {
        Err(cause) => format!("{python} does not start: {cause}"),
        Ok(output) if output.status.code() == Some(3) => format!("{python}: {}", stderr(output).trim()),
        Ok(output) => {
            assert!(output.status.success(), "{script} failed on {arguments:?}: {}", stderr(output));
            return Some(stdout(output));
        }
    };
    let required = env::var("ADAGIO_REQUIRE_PYTHON").is_ok_and(|value| value == "1");
    assert!(!required, "NOT CHECKED with {script}: {missing}");
    eprintln!("NOT CHECKED with {script}: {missing}");
    None
}

/// What a script of `tests/browser` saw, or `None` if there is no browser, and that is allowed.
///
/// `ADAGIO_BROWSER` names the folder of its packages (see `.ci/run`); `ADAGIO_REQUIRE_BROWSER=1` makes a missing one a failure.
pub fn browser(script: &str, arguments: &[&str]) -> Option<Value> {
    let path = package_file("tests/browser").join(script);
    let output = Command::new("node").arg(path).args(arguments).output();
    let missing = match output {
        Err(cause) => format!("node does not start: {cause}"),
        Ok(output) if output.status.code() == Some(3) => stderr(&output).trim().to_owned(),
        Ok(output) => {
            assert!(output.status.success(), "{}", stderr(&output));
            return Some(serde_json::from_slice(&output.stdout).unwrap());
        }
    };
    let required = env::var("ADAGIO_REQUIRE_BROWSER").is_ok_and(|value| value == "1");
    assert!(!required, "NOT CHECKED in a browser: {missing}");
    eprintln!("NOT CHECKED in a browser: {missing}");
    None
}

/// The records of a log as they lie in it: place, kind, length of the body.
pub fn records_of(log: &[u8]) -> Vec<(usize, u8, usize)> {
    let (mut at, mut found) = (8_usize, Vec::new());
    while at.saturating_add(9) <= log.len() {
        let length = u64::from_le_bytes(log[at + 1..at + 9].try_into().unwrap()) as usize;
        found.push((at, log[at], length));
        // A length of a damaged log may be anything.
        at = at.saturating_add(9).saturating_add(length);
    }
    found
}

/// The kind of a chunk's record.
pub const CHUNK: u8 = 0x06;
