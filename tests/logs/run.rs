//! Promise: the files of a run's log hold every message exactly once and in order, whatever happens to a file: it is closed for
//! its size or age, deleted for the budget, cannot be written at any call, or vanishes. What cannot be kept is told.

use std::collections::BTreeMap;
use std::io::{self, Cursor, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::satisfies_other_tools;
use adagio::log::messages::{Header, Image, Log};
use adagio::log::run::Repeating;
use adagio::log::{
    Compression, Ending, Expected, LogError, LogOptions, LogReader, Record, Rotation, RunLog, RunTotals, Storage, cdr,
    topics,
};

// ---- a disk in memory

/// What the disk refuses, counted in calls of write and flush over all files, from 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Fault {
    #[default]
    None,
    /// These calls: one, or a few that follow each other.
    At(u32, u32),
    /// Every call from this one on.
    From(u32),
    /// As before, and no file can be created either.
    Full(u32),
}

#[derive(Default)]
struct Disk {
    files: BTreeMap<u32, Vec<u8>>,
    removed: Vec<u32>,
    calls: u32,
    fault: Fault,
    /// Files that cannot be created, cut or removed.
    uncreatable: Vec<u32>,
    uncuttable: bool,
    undeletable: bool,
}

impl Disk {
    fn refuses(&self, call: u32) -> bool {
        match self.fault {
            Fault::None => false,
            Fault::At(first, last) => (first..=last).contains(&call),
            Fault::From(first) | Fault::Full(first) => call >= first,
        }
    }

    fn call(&mut self) -> io::Result<()> {
        self.calls += 1;
        if self.refuses(self.calls) { Err(io::Error::other(format!("refused call {}", self.calls))) } else { Ok(()) }
    }
}

#[derive(Clone, Default)]
struct Shared(Arc<Mutex<Disk>>);

impl Shared {
    fn with(fault: Fault) -> Self {
        Shared(Arc::new(Mutex::new(Disk { fault, ..Disk::default() })))
    }

    fn disk(&self) -> std::sync::MutexGuard<'_, Disk> {
        self.0.lock().unwrap()
    }
}

struct Sink(Shared, u32);

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut disk = self.0.disk();
        disk.call()?;
        // In pieces, so that it fails inside of records as well.
        let piece = &bytes[..bytes.len().min(700)];
        // A file that vanished is written still, as an operating system does.
        if let Some(file) = disk.files.get_mut(&self.1) {
            file.extend_from_slice(piece);
        }
        Ok(piece.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.disk().call()
    }
}

impl Storage for Shared {
    fn create(&mut self, number: u32) -> io::Result<Box<dyn Write + Send>> {
        let mut disk = self.disk();
        let next = disk.calls + 1;
        if disk.uncreatable.contains(&number) || matches!(disk.fault, Fault::Full(_)) && disk.refuses(next) {
            return Err(io::ErrorKind::StorageFull.into());
        }
        if disk.files.contains_key(&number) {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        disk.files.insert(number, Vec::new());
        Ok(Box::new(Sink(self.clone(), number)))
    }

    fn holds(&self, number: u32) -> bool {
        self.disk().files.contains_key(&number)
    }

    fn cut(&mut self, number: u32, bytes: u64) -> io::Result<()> {
        let mut disk = self.disk();
        if disk.uncuttable {
            return Err(io::ErrorKind::PermissionDenied.into());
        }
        disk.files.get_mut(&number).ok_or(io::ErrorKind::NotFound)?.truncate(bytes as usize);
        Ok(())
    }

    fn remove(&mut self, number: u32) -> io::Result<()> {
        let mut disk = self.disk();
        if disk.undeletable {
            return Err(io::ErrorKind::PermissionDenied.into());
        }
        disk.files.remove(&number).ok_or(io::ErrorKind::NotFound)?;
        disk.removed.push(number);
        Ok(())
    }

    fn name(&self, number: u32) -> String {
        format!("file {number}")
    }
}

// ---- what is written and what is read

fn options() -> LogOptions {
    LogOptions { compression: Compression::Zstd, chunk_bytes: 4096, flush_interval: Duration::from_millis(100) }
}

fn metadata() -> BTreeMap<String, String> {
    BTreeMap::from([("seed".to_owned(), "7".to_owned())])
}

fn create(disk: &Shared, rotation: Rotation) -> Result<RunLog, LogError> {
    RunLog::create(disk.clone(), &options(), rotation, &metadata())
}

/// A message whose bytes do not compress, and differ from those of any other.
fn image(number: u32) -> Image {
    let mut data = vec![0; 600];
    ChaCha8Rng::seed_from_u64(number.into()).fill(&mut data[..]);
    Image {
        header: Header::new(u64::from(number), "camera"),
        height: 20,
        width: 30,
        encoding: "mono8".into(),
        step: 30,
        data,
        ..Image::default()
    }
}

fn stamp_ns(number: u32) -> u64 {
    1_000_000_000 + u64::from(number)
}

fn put(log: &mut RunLog, number: u32) -> Result<(), LogError> {
    log.write(topics::OBSERVATION, number, stamp_ns(number), &image(number))
}

/// What all files of a disk hold together.
#[derive(Default)]
struct Found {
    numbers: Vec<u32>,
    attachments: Vec<String>,
    /// What the log says of itself.
    said: Vec<String>,
    errors: Vec<String>,
    endings: Vec<Ending>,
    bytes: u64,
}

impl Found {
    fn messages(&self) -> u64 {
        (self.numbers.len() + self.said.len()) as u64
    }
}

fn read(disk: &Shared) -> Found {
    let mut found = Found::default();
    for (number, bytes) in &disk.disk().files {
        found.bytes += bytes.len() as u64;
        let mut reader = LogReader::new(Cursor::new(bytes.as_slice()), "test");
        let mut file = None;
        for record in reader.by_ref() {
            match record {
                Ok(record @ Record::Message { .. }) => {
                    let Record::Message { topic, sequence, log_time_ns, .. } = &record else { continue };
                    if **topic == *topics::DIAGNOSTICS.name() {
                        let log: Log = record.decode().unwrap();
                        assert_eq!(log.name, "adagio.log");
                        found.said.push(log.msg);
                        continue;
                    }
                    assert_eq!(record.decode::<Image>().unwrap(), image(*sequence));
                    assert_eq!(*log_time_ns, stamp_ns(*sequence));
                    found.numbers.push(*sequence);
                }
                Ok(Record::Metadata { map, .. }) => file = Some(map),
                Ok(Record::Attachment { name, data, .. }) => {
                    assert_eq!(data, vec![5; 3000]);
                    found.attachments.push(name);
                }
                Err(error) => found.errors.push(error.to_string()),
            }
        }
        // Every file that was begun says which run it is of, and which file it is.
        let file = file.unwrap_or_else(|| panic!("file {number} of {} bytes has no metadata", bytes.len()));
        assert_eq!((file["seed"].as_str(), &file["file"]), ("7", &number.to_string()));
        found.endings.push(reader.ending().unwrap().clone());
    }
    found
}

fn first(count: u32) -> Vec<u32> {
    (0..count).collect()
}

/// Bytes of a file without messages: it begins with the definitions of all topics, and ends with where they are.
fn definitions() -> usize {
    let empty = Shared::default();
    create(&empty, Rotation::NEVER).unwrap().finish().unwrap();
    empty.disk().files[&0].len()
}

// ---- rotation

#[test]
fn files_that_are_closed_for_their_size_are_whole_and_together_hold_every_message_once() {
    let disk = Shared::default();
    let rotation = Rotation { file_bytes: 20_000, ..Rotation::NEVER };
    let mut log = create(&disk, rotation).unwrap();
    for number in 0..200 {
        put(&mut log, number).unwrap();
    }
    let totals = log.finish().unwrap();
    let found = read(&disk);
    assert_eq!((&found.numbers, found.errors.len(), found.said.len()), (&first(200), 0, 0));
    assert!(found.endings.iter().all(|ending| *ending == Ending::Complete));
    assert!((5..20).contains(&found.endings.len()), "{} files", found.endings.len());
    let sizes: Vec<usize> = disk.disk().files.values().map(Vec::len).collect();
    // Definitions of all topics, and the index, go beyond the size at which a file is closed.
    let most = 20_000 + definitions();
    assert!(sizes[..sizes.len() - 1].iter().all(|size| (20_000..most).contains(size)), "{sizes:?}, at most {most}");
    assert_eq!((totals.files, totals.bytes, totals.messages), (sizes.len() as u64, found.bytes, 200));
    assert!(totals.failures.is_empty());
}

#[test]
fn files_are_closed_for_their_age_unless_nothing_was_written() {
    let disk = Shared::default();
    let rotation = Rotation { file_age: Some(Duration::from_secs(60)), ..Rotation::NEVER };
    let mut log = create(&disk, rotation).unwrap();
    let start = Instant::now();
    // A message every ten seconds, but none in the third and fourth minute.
    let mut expected = Vec::new();
    for tick in 0..36 {
        if !(12..24).contains(&tick) {
            put(&mut log, tick).unwrap();
            expected.push(tick);
        }
        log.tick(start + Duration::from_secs(10 * u64::from(tick))).unwrap();
    }
    let totals = log.finish().unwrap();
    let found = read(&disk);
    assert_eq!((&found.numbers, found.errors.len()), (&expected, 0));
    assert!(found.endings.iter().all(|ending| *ending == Ending::Complete));
    assert_eq!((totals.files, found.endings.len()), (5, 5));
}

#[test]
fn a_file_that_cannot_be_begun_leaves_the_old_one_going_on_until_it_has_doubled() {
    let disk = Shared::default();
    disk.disk().uncreatable = vec![1];
    let rotation = Rotation { file_bytes: 20_000, ..Rotation::NEVER };
    let mut log = create(&disk, rotation).unwrap();
    for number in 0..40 {
        put(&mut log, number).unwrap();
    }
    disk.disk().uncreatable.clear();
    for number in 40..200 {
        put(&mut log, number).unwrap();
    }
    let totals = log.finish().unwrap();
    let found = read(&disk);
    assert_eq!((&found.numbers, found.errors.len()), (&first(200), 0));
    assert_eq!(totals.failures.len(), 1, "{:?}", totals.failures);
    assert!(totals.failures[0].contains("file 1") && totals.failures[0].contains("file 0 goes on"));
    let definitions = definitions();
    let sizes: Vec<usize> = disk.disk().files.values().map(Vec::len).collect();
    // And with what is in which chunk, here less than 2 kB.
    assert!((40_000..42_000 + definitions).contains(&sizes[0]), "{sizes:?}, {definitions} without messages");
    // Then files have their size again.
    assert!(sizes.len() > 4 && sizes[1..].iter().all(|&size| size < 20_000 + definitions), "{sizes:?}, {definitions}");
}

#[test]
fn a_file_of_another_program_in_the_way_is_left_alone() {
    let disk = Shared::default();
    let mut log = create(&disk, Rotation { file_bytes: 20_000, ..Rotation::NEVER }).unwrap();
    disk.disk().files.insert(1, b"precious".to_vec());
    for number in 0..200 {
        put(&mut log, number).unwrap();
    }
    log.finish().unwrap();
    assert_eq!(disk.disk().files.remove(&1).unwrap(), b"precious");
    let found = read(&disk);
    assert_eq!((found.numbers, found.errors.len()), (first(200), 0));
    assert!(disk.disk().files.contains_key(&2));
}

// ---- the budget

#[test]
fn the_budget_deletes_the_oldest_closed_files_and_says_so() {
    let disk = Shared::default();
    let rotation = Rotation { file_bytes: 20_000, budget_bytes: Some(70_000), ..Rotation::NEVER };
    let mut log = create(&disk, rotation).unwrap();
    for number in 0..400 {
        put(&mut log, number).unwrap();
        let size: usize = disk.disk().files.values().map(Vec::len).sum();
        // At most the index of a file that was closed just now, and a chunk, go beyond it.
        assert!(size < 90_000, "{size} bytes at message {number}");
    }
    let totals = log.finish().unwrap();
    let removed = disk.disk().removed.clone();
    assert_eq!(removed, first(removed.len() as u32), "the oldest first");
    assert!(removed.len() > 5 && totals.deleted_files == removed.len() as u64);
    let found = read(&disk);
    assert_eq!((found.errors.len(), totals.bytes, totals.files), (0, found.bytes, found.endings.len() as u64));
    let kept = found.numbers.len() as u32;
    assert_eq!(found.numbers, (400 - kept..400).collect::<Vec<_>>(), "the newest are kept without a hole");
    assert!(kept > 30, "{kept}");
    // It is said in the file that was open then, which may have been deleted since.
    let last = format!("file {}", removed.len() - 1);
    assert!(found.said.iter().any(|text| text.contains(&last) && text.contains("log.budget_mb")), "{:?}", found.said);
    assert_eq!(totals.messages, 400 + u64::from(removed.len() as u32), "one message for each file that went");
}

#[test]
fn a_file_that_cannot_be_deleted_is_told_once_and_the_run_goes_on() {
    let disk = Shared::default();
    disk.disk().undeletable = true;
    let rotation = Rotation { file_bytes: 20_000, budget_bytes: Some(50_000), ..Rotation::NEVER };
    let mut log = create(&disk, rotation).unwrap();
    for number in 0..120 {
        put(&mut log, number).unwrap();
    }
    let totals = log.finish().unwrap();
    let found = read(&disk);
    assert_eq!((&found.numbers, totals.deleted_files), (&first(120), 0));
    let about_0 = totals.failures.iter().filter(|text| text.starts_with("file 0 cannot be deleted")).count();
    assert_eq!((about_0, found.said.len()), (1, totals.failures.len()));
}

#[test]
fn a_run_that_goes_on_deletes_its_earlier_files_too_and_none_of_others() {
    let disk = Shared::default();
    disk.disk().files.insert(9, vec![0; 30_000]);
    let rotation = Rotation { file_bytes: 20_000, budget_bytes: Some(60_000), ..Rotation::NEVER };
    let mut log = create(&disk, rotation).unwrap();
    (0..60).for_each(|number| put(&mut log, number).unwrap());
    log.finish().unwrap();
    let sizes: Vec<(u32, u64)> = disk
        .disk()
        .files
        .iter()
        .filter(|(number, _)| **number != 9)
        .map(|(n, bytes)| (*n, bytes.len() as u64))
        .collect();
    let mut log = RunLog::append(disk.clone(), &options(), rotation, &metadata(), &sizes).unwrap();
    (60..120).for_each(|number| put(&mut log, number).unwrap());
    log.finish().unwrap();
    assert!(disk.disk().removed.starts_with(&[0, 1]), "{:?}", disk.disk().removed);
    assert!(disk.disk().files.remove(&9).is_some());
    assert!(read(&disk).numbers.ends_with(&(100..120).collect::<Vec<_>>()));
}

// ---- a disk that fails

const MESSAGES: u32 = 60;

/// A short run with everything in it: chunks, timed flushes, rotation by size, a budget, an attachment. How many messages were
/// written, how many of these were flushed for certain, and how it ended.
fn short_run(disk: &Shared, budget_bytes: Option<u64>) -> (u32, u32, Result<RunTotals, LogError>) {
    let (mut written, mut safe) = (0, 0);
    let rotation = Rotation { file_bytes: 16_000, budget_bytes, ..Rotation::NEVER };
    let result = (|| {
        let mut log = create(disk, rotation)?;
        let start = Instant::now();
        for number in 0..MESSAGES {
            if let Err(error) = put(&mut log, number) {
                // Every later call says the same, and writes nothing.
                let calls = disk.disk().calls;
                for again in [put(&mut log, number).err(), log.flush().err(), log.tick(start).err(), log.finish().err()]
                {
                    assert_eq!(again.unwrap().to_string(), error.to_string());
                }
                assert_eq!(disk.disk().calls, calls);
                return Err(error);
            }
            written += 1;
            log.tick(start + Duration::from_millis(15 * u64::from(number)))?;
            if number % 17 == 3 {
                log.flush()?;
                safe = written;
            }
            if number == 40 {
                log.attach("checkpoint", "text/plain", &[5; 3000], stamp_ns(number))?;
                safe = written;
            }
        }
        log.finish()
    })();
    (written, safe, result)
}

/// Calls of a run that meets no fault.
fn calls_of_a_short_run(budget_bytes: Option<u64>) -> u32 {
    let disk = Shared::default();
    let (written, _, result) = short_run(&disk, budget_bytes);
    assert_eq!((written, result.unwrap().failures.len()), (MESSAGES, 0));
    let calls = disk.disk().calls;
    assert!(calls > 100, "{calls} calls are no test");
    calls
}

/// All messages are there in order and once, and the totals are right.
fn assert_whole(disk: &Shared, totals: &RunTotals, what: &str) {
    let found = read(disk);
    assert_eq!((&found.numbers, &found.errors), (&first(MESSAGES), &Vec::new()), "{what}");
    assert_eq!(found.attachments, ["checkpoint"], "{what}");
    assert!(!found.endings.iter().any(|ending| matches!(ending, Ending::Damaged { .. })), "{what}");
    let counted = (totals.files, totals.bytes, totals.messages);
    assert_eq!(counted, (found.endings.len() as u64, found.bytes, found.messages()), "{what}");
}

/// The files that were closed, in a folder.
fn closed_files(disk: &Shared, folder: &Path, name: &str) -> Vec<PathBuf> {
    let mut files = Vec::new();
    for (number, bytes) in &disk.disk().files {
        let mut reader = LogReader::new(Cursor::new(bytes.as_slice()), "test");
        reader.by_ref().for_each(drop);
        if reader.ending() == Some(&Ending::Complete) {
            files.push(folder.join(format!("{name}_{number}.mcap")));
            std::fs::write(&files[files.len() - 1], bytes).unwrap();
        }
    }
    files
}

#[test]
fn other_tools_are_satisfied_with_what_a_failing_disk_leaves() {
    let folder = tempfile::tempdir().unwrap();
    let mut files = Vec::new();
    for call in (1..=calls_of_a_short_run(None)).step_by(25) {
        let disk = Shared::with(Fault::At(call, call));
        if short_run(&disk, None).2.is_ok() {
            files.extend(closed_files(&disk, folder.path(), &call.to_string()).into_iter().next_back());
        }
    }
    assert!(files.len() >= 4, "{files:?}");
    satisfies_other_tools(&files);
}

#[test]
fn a_disk_that_fails_once_or_twice_costs_no_message_whichever_call_it_is() {
    for call in 1..=calls_of_a_short_run(None) {
        for length in [0, 1, 2] {
            let disk = Shared::with(Fault::At(call, call + length));
            let what = format!("calls {call} to {}", call + length);
            match short_run(&disk, None).2 {
                Ok(totals) => {
                    assert_whole(&disk, &totals, &what);
                    assert!(
                        totals.failures.iter().any(|text| text.contains(&format!("refused call {call}"))),
                        "{what}"
                    );
                }
                Err(error) => {
                    // Not even the first file could be begun.
                    assert!(read(&disk).endings.is_empty(), "{what}: {error}");
                    assert!(error.to_string().contains(&format!("refused call {call}")), "{what}: {error}");
                }
            }
        }
    }
}

#[test]
fn a_disk_that_fails_from_some_call_on_keeps_what_was_flushed_and_the_first_cause_is_told() {
    for call in 1..=calls_of_a_short_run(None) {
        for fault in [Fault::From(call), Fault::Full(call)] {
            let disk = Shared::with(fault);
            let (written, safe, result) = short_run(&disk, None);
            let found = read(&disk);
            assert!(found.errors.is_empty(), "{fault:?}: {:?}", found.errors);
            match result {
                // Only the index of the last file is missing, or of one before.
                Ok(totals) => {
                    assert_eq!((written, found.numbers), (MESSAGES, first(MESSAGES)), "{fault:?}");
                    assert!(!totals.failures.is_empty(), "{fault:?}");
                }
                // Not even the first file could be made.
                Err(LogError::Create { cause, .. }) => {
                    assert_eq!((fault, cause.kind()), (Fault::Full(1), io::ErrorKind::StorageFull));
                }
                Err(error) => {
                    assert!(matches!(error, LogError::Write { .. }), "{fault:?}: {error}");
                    let text = error.to_string();
                    // The place and the first cause. A few calls earlier a new file may have been tried, for the size of this one.
                    let number = |text: &str| text.split(|c: char| !c.is_ascii_digit()).next().unwrap().parse::<u32>();
                    let first_cause = number(text.split("refused call ").nth(1).unwrap()).unwrap();
                    assert!((call..call + 4).contains(&first_cause), "{fault:?}: {text}");
                    assert!(
                        text.contains("file ") && text.matches("writing the log").count() == 1,
                        "{fault:?}: {text}"
                    );
                    let count = found.numbers.len() as u32;
                    assert_eq!(found.numbers, first(count), "{fault:?}");
                    assert!(
                        (safe..=written + 1).contains(&count),
                        "{fault:?}: {safe} of {written} flushed, {count} found"
                    );
                }
            }
        }
    }
}

#[test]
fn a_failure_while_the_budget_deletes_repeats_nothing() {
    let budget = Some(40_000);
    for call in 1..=calls_of_a_short_run(budget) {
        let disk = Shared::with(Fault::At(call, call));
        let Ok(totals) = short_run(&disk, budget).2 else { continue };
        let found = read(&disk);
        let kept = found.numbers.len() as u32;
        assert_eq!(found.numbers, (MESSAGES - kept..MESSAGES).collect::<Vec<_>>(), "call {call}");
        assert!(found.errors.is_empty(), "call {call}: {:?}", found.errors);
        assert_eq!((totals.files, totals.bytes), (found.endings.len() as u64, found.bytes), "call {call}");
        let mut said = found.said.clone();
        said.dedup();
        assert_eq!(said, found.said, "call {call}: nothing is said twice");
    }
}

#[test]
fn a_file_that_cannot_be_cut_is_told() {
    let calls = calls_of_a_short_run(None);
    for call in 1..=calls {
        let disk = Shared::with(Fault::At(call, call));
        disk.disk().uncuttable = true;
        let Ok(totals) = short_run(&disk, None).2 else { continue };
        let mut numbers = read(&disk).numbers;
        // The end of the file that failed may be there again in the next one.
        numbers.sort_unstable();
        numbers.dedup();
        assert_eq!(numbers, first(MESSAGES), "call {call}");
        // Unless the fault met a file that was only begun.
        let told = totals.failures.iter().any(|text| text.contains("cannot be cut"));
        let only_begun = totals.failures.iter().any(|text| text.ends_with("goes on"));
        assert!(told || only_begun, "call {call}: {:?}", totals.failures);
    }
}

#[test]
fn a_file_that_vanishes_is_followed_by_a_new_one() {
    let disk = Shared::default();
    let mut log = create(&disk, Rotation::NEVER).unwrap();
    (0..20).for_each(|number| put(&mut log, number).unwrap());
    log.flush().unwrap();
    (20..22).for_each(|number| put(&mut log, number).unwrap());
    disk.disk().files.remove(&0);
    // What was not flushed when it went is not lost, whether a full chunk, the clock or the end flushes it.
    (22..40).for_each(|number| put(&mut log, number).unwrap());
    let totals = log.finish().unwrap();
    let found = read(&disk);
    assert_eq!((found.numbers, found.errors.len()), ((20..40).collect(), 0));
    assert!(found.said[0].contains("file 0") && found.said[0].contains("the file is gone"), "{:?}", found.said);
    assert_eq!((totals.files, totals.bytes, totals.failures.len()), (1, found.bytes, 1));

    for last in ["tick", "attach", "finish"] {
        let disk = Shared::default();
        let mut log = create(&disk, Rotation::NEVER).unwrap();
        let start = Instant::now();
        log.tick(start).unwrap();
        put(&mut log, 0).unwrap();
        disk.disk().files.remove(&0);
        match last {
            "tick" => log.tick(start + Duration::from_secs(1)).unwrap(),
            "attach" => log.attach("checkpoint", "text/plain", &[5; 3000], 0).unwrap(),
            _ => {}
        }
        log.finish().unwrap();
        let found = read(&disk);
        assert_eq!((found.numbers, found.attachments.len()), (vec![0], usize::from(last == "attach")), "{last}");
    }
}

#[test]
fn a_folder_that_vanishes_ends_the_log_with_its_cause() {
    let disk = Shared::default();
    let mut log = create(&disk, Rotation::NEVER).unwrap();
    (0..3).for_each(|number| put(&mut log, number).unwrap());
    disk.disk().files.clear();
    disk.disk().uncreatable = (0..10).collect();
    let error = log.flush().unwrap_err().to_string();
    assert!(error.contains("writing the log file 0") && error.contains("the file is gone"), "{error}");
    assert_eq!(log.finish().unwrap_err().to_string(), error);
}

// ---- going on behind a recording

#[test]
fn a_run_that_goes_on_writes_only_what_the_recording_does_not_hold() {
    let mut expected = Expected::default();
    let topic = topics::TRANSITION.name();
    for number in 0..10u32 {
        expected.record(topics::OBSERVATION.name(), stamp_ns(number), &cdr::encode(&image(number)).unwrap());
    }
    expected.record(topic, 5, b"another");
    let disk = Shared::default();
    let mut log = create(&disk, Rotation::NEVER).unwrap().expecting(expected.clone(), Repeating::Skip);
    (0..15).for_each(|number| put(&mut log, number).unwrap());
    let error = log.write(topics::TRANSITION, 3, 5, &Default::default()).unwrap_err();
    assert!(matches!(&error, LogError::Differs { topic: found, sequence: 3 } if *found == topic), "{error}");
    // A difference leaves the log as it was.
    put(&mut log, 15).unwrap();
    let totals = log.finish().unwrap();
    assert_eq!(read(&disk).numbers, (10..16).collect::<Vec<_>>());
    assert_eq!((totals.messages, totals.expected.unwrap().first_difference().unwrap().topic), (6, topic));

    // With the other choice all of it is written.
    let disk = Shared::default();
    let mut log = create(&disk, Rotation::NEVER).unwrap().expecting(expected, Repeating::Write);
    (0..15).for_each(|number| put(&mut log, number).unwrap());
    log.finish().unwrap();
    assert_eq!(read(&disk).numbers, first(15));
}
