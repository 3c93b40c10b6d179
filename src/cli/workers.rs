//! Processes that work on logs side by side, on this machine or on others.

use std::collections::VecDeque;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use super::Ending;
use crate::learn::Work;
use crate::lock::lock;

/// How often a part is tried.
const TRIES: usize = 3;
/// How long a worker without work waits for some.
const WAIT: Duration = Duration::from_millis(50);
/// What ssh ends with where there is no connection.
const NOT_REACHED: i32 = 255;
pub const INTERRUPTED: &str = "it was interrupted";

/// A host in each line, for one worker.
pub fn read_hosts(file: &Path) -> Result<Vec<Option<String>>, Ending> {
    let text = std::fs::read_to_string(file)
        .map_err(|cause| Ending::Usage(format!("cannot read the hosts {}: {cause}", file.display())))?;
    let hosts: Vec<Option<String>> = text
        .lines()
        .map(str::trim)
        .filter(|line| !line.is_empty() && !line.starts_with('#'))
        .map(|line| Some(line.to_owned()))
        .collect();
    match hosts.iter().flatten().find(|host| host.starts_with('-') || host.contains(char::is_whitespace)) {
        Some(host) => Err(Ending::Usage(format!("{}: {host:?} is no host: there is one in each line", file.display()))),
        None if hosts.is_empty() => Err(Ending::Usage(format!("{} names no host", file.display()))),
        None => Ok(hosts),
    }
}

/// Have work done, by one process at a time for each of `workers`: on this machine, or on a host. A host on which one fails gets no more.
pub fn work_off(
    workers: &[Option<String>],
    work: &[Work],
    done: &(dyn Fn() + Sync),
    stop: &AtomicBool,
) -> Result<(), String> {
    let todo: Mutex<VecDeque<(&Work, usize)>> = Mutex::new(work.iter().map(|of| (of, 0)).collect());
    let (left, failed) = (AtomicUsize::new(work.len()), Mutex::new(None::<String>));
    let goes_on = || left.load(Ordering::Relaxed) > 0 && !stop.load(Ordering::Relaxed) && lock(&failed).is_none();
    std::thread::scope(|scope| {
        for host in workers {
            scope.spawn(|| {
                while goes_on() {
                    let Some((of, tries)) = lock(&todo).pop_front() else {
                        // Another one may fail, and leave its work to this one.
                        std::thread::sleep(WAIT);
                        continue;
                    };
                    match process(of, host.as_deref()) {
                        Ok(()) => {
                            left.fetch_sub(1, Ordering::Relaxed);
                            done();
                        }
                        Err(Failure::Interrupted) => *lock(&failed) = Some(INTERRUPTED.into()),
                        Err(_) if stop.load(Ordering::Relaxed) => {}
                        Err(Failure::NotReached(text)) => {
                            eprintln!("warning: {text}: it gets no more work");
                            lock(&todo).push_front((of, tries));
                            return;
                        }
                        Err(Failure::Failed(text)) if tries + 1 < TRIES => {
                            eprintln!("warning: {}: {text}: once more", of.log.display());
                            lock(&todo).push_back((of, tries + 1));
                            if host.is_some() && workers.len() > 1 {
                                return;
                            }
                        }
                        Err(Failure::Failed(text)) => *lock(&failed) = Some(format!("{}: {text}", of.log.display())),
                    }
                }
            });
        }
    });
    match lock(&failed).take() {
        Some(text) => Err(text),
        None if stop.load(Ordering::Relaxed) => Err(INTERRUPTED.into()),
        None if left.load(Ordering::Relaxed) > 0 => Err("no worker is left".into()),
        None => Ok(()),
    }
}

/// Why a part was not made.
enum Failure {
    /// Somebody has ended it.
    Interrupted,
    /// The host.
    NotReached(String),
    Failed(String),
}

/// One part, by a process of its own.
fn process(work: &Work, host: Option<&str>) -> Result<(), Failure> {
    let program = std::env::current_exe().map_err(|error| Failure::Failed(error.to_string()))?;
    let Work { verb, log, frames, scenario, dictionary, out } = work;
    let frames = format!("{}..{}", frames.start, frames.end);
    let words: [&Path; 11] = [
        &program,
        verb.as_ref(),
        log,
        "--frames".as_ref(),
        frames.as_ref(),
        "--scenario".as_ref(),
        scenario,
        "--dictionary".as_ref(),
        dictionary,
        "--out".as_ref(),
        out,
    ];
    let mut command = Command::new(if host.is_some() { Path::new("ssh") } else { words[0] });
    match host {
        None => command.args(&words[1..]),
        Some(host) => {
            let quoted = words.map(|word| format!("'{}'", word.to_string_lossy().replace('\'', "'\\''")));
            command.args(["-o", "BatchMode=yes", host, &quoted.join(" ")])
        }
    };
    let output = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped()).output();
    let output = output.map_err(|error| Failure::Failed(format!("a worker cannot be started: {error}")))?;
    let said = String::from_utf8_lossy(&output.stderr);
    match (output.status.code(), host) {
        (Some(0), _) => Ok(()),
        (None, _) if was_interrupted(output.status) => Err(Failure::Interrupted),
        (Some(NOT_REACHED), Some(host)) => {
            Err(Failure::NotReached(format!("{host} cannot be reached: {}", said.trim())))
        }
        (_, host) => {
            let host = host.map_or(String::new(), |host| format!(" on {host}"));
            Err(Failure::Failed(format!("a worker{host} ended with {}: {}", output.status, said.trim())))
        }
    }
}

#[cfg(unix)]
fn was_interrupted(status: ExitStatus) -> bool {
    use std::os::unix::process::ExitStatusExt as _;
    const SIGINT: i32 = 2;
    status.signal() == Some(SIGINT)
}

#[cfg(not(unix))]
fn was_interrupted(_: ExitStatus) -> bool {
    false
}
