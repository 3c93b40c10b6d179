//! Processes that work on logs side by side, on this machine or on others.

use std::collections::VecDeque;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::Ending;
use crate::learn::Work;

/// How often a part is tried.
const TRIES: usize = 3;

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

/// Have work done, by one process at a time for each of `workers`: on this machine, or on a host.
pub fn work_off(
    workers: &[Option<String>],
    work: &[Work],
    done: &(dyn Fn() + Sync),
    stop: &AtomicBool,
) -> Result<(), String> {
    let todo: Mutex<VecDeque<(&Work, usize)>> = Mutex::new(work.iter().map(|of| (of, 0)).collect());
    let failed = Mutex::new(None::<String>);
    let goes_on = || !stop.load(Ordering::Relaxed) && lock(&failed).is_none();
    std::thread::scope(|scope| {
        for host in workers {
            scope.spawn(|| {
                while goes_on() {
                    let Some((of, tries)) = lock(&todo).pop_front() else { break };
                    match process(of, host.as_deref()) {
                        Ok(()) => done(),
                        Err(_) if stop.load(Ordering::Relaxed) => {}
                        Err(text) if tries + 1 < TRIES => {
                            eprintln!("warning: {}: {text}: once more", of.log.display());
                            lock(&todo).push_back((of, tries + 1));
                        }
                        Err(text) => *lock(&failed) = Some(format!("{}: {text}", of.log.display())),
                    }
                }
            });
        }
    });
    match lock(&failed).take() {
        Some(text) => Err(text),
        None if stop.load(Ordering::Relaxed) => Err("it was interrupted".into()),
        None => Ok(()),
    }
}

/// One part, by a process of its own.
fn process(work: &Work, host: Option<&str>) -> Result<(), String> {
    let program = std::env::current_exe().map_err(|error| error.to_string())?;
    let Work { verb, log, scenario, dictionary, out } = work;
    let words: [&Path; 9] = [
        &program,
        verb.as_ref(),
        log,
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
    let output = output.map_err(|error| format!("a worker cannot be started: {error}"))?;
    if output.status.success() {
        return Ok(());
    }
    let host = host.map_or(String::new(), |host| format!(" on {host}"));
    Err(format!("a worker{host} ended with {}: {}", output.status, String::from_utf8_lossy(&output.stderr).trim()))
}

pub fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}
