//! The program and what it leaves, and other people's tools that judge it.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use adagio::gpu::{Adapters, Gpu};
use serde_json::Value;

use super::package_file;

/// A graphics processor, or a driver in software (Mesa's) where there is none. Where there is neither, a test says so and checks
/// nothing; `ADAGIO_REQUIRE_GPU=1` makes that a failure. Tests take turns: with a driver some waited forever where several opened and
/// closed devices at once.
pub fn device() -> Option<(MutexGuard<'static, ()>, Arc<Gpu>)> {
    static TURN: Mutex<()> = Mutex::new(());
    let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    match Gpu::open(Adapters::Any) {
        Ok(gpu) => Some((turn, gpu)),
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

/// A run folder once more.
pub fn copy(run: &Path, to: &Path) {
    assert!(Command::new("cp").arg("-r").args([run, to]).status().unwrap().success());
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
