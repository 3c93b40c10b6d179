//! Promise: no bytes make a parser panic, abort, hang, or take much more memory than they have themselves.
//!
//! Each test runs itself once more as a process whose address space is limited, and that says which input it is at: so even
//! an abort is told with its number. `ADAGIO_LONG=1` takes a million inputs for each parser.
//!
//! One input again: `ADAGIO_INPUT=log:1234 cargo test --release --test mutations -- --nocapture logs`.

#![cfg(unix)]

mod common;
mod log_samples;
#[path = "mutations/mutate.rs"]
mod mutate;
#[path = "mutations/targets.rs"]
mod targets;

use std::collections::BTreeMap;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use adagio::log::{Compression, LogOptions, LogWriter, MAX_RECORD_BYTES};
use common::{adagio, generator, package_file, records_of, stderr};
use log_samples::{START_NS, write_samples};

/// Address space of the processes that parse, kilobytes. One chunk and what is in it have 64 MiB each at most.
const ADDRESS_SPACE_KB: u64 = 1_000_000;

/// A parser, with what it is fed and what it may take.
struct Parser {
    name: &'static str,
    /// Inputs of an ordinary run, which takes some seconds.
    inputs: u64,
    /// Bytes that it may take whatever the input, and for each byte of it.
    memory: (u64, u64),
    targets: &'static [fn(&[u8])],
    corpus: fn() -> Vec<Vec<u8>>,
    mutated: fn(&mut rand_chacha::ChaCha8Rng, &[Vec<u8>]) -> Vec<u8>,
}

/// Inputs of a long run.
const MANY: u64 = 1_000_000;

const LOG: Parser = Parser {
    name: "log",
    inputs: 8000,
    // The reader's window; a record, its messages decoded, as JSON.
    memory: (1 << 18, 64),
    targets: &[targets::log, targets::recover],
    corpus: || vec![own_log(Compression::None, 2), own_log(Compression::None, 1), foreign_log(None)],
    mutated: |rng, corpus| mutate::log(rng, corpus, records_of),
};

const COMPRESSED_LOG: Parser = Parser {
    name: "compressed_log",
    inputs: 6000,
    // A chunk of a few bytes may stand for one of the largest that is accepted.
    memory: (MAX_RECORD_BYTES + (1 << 20), 64),
    targets: &[targets::log, targets::recover],
    corpus: || {
        let foreign = foreign_log(Some(mcap::Compression::Zstd));
        vec![own_log(Compression::Zstd, 2), own_log(Compression::Lz4, 2), foreign]
    },
    mutated: |rng, corpus| mutate::log(rng, corpus, records_of),
};

const CDR: Parser = Parser {
    name: "cdr",
    inputs: 200_000,
    // A list of empty texts has 4 bytes for each of them here, 24 in memory, and both halves while it grows.
    memory: (1 << 12, 24),
    targets: &[targets::cdr],
    corpus: messages,
    mutated: mutate::bytes,
};

const CHECKPOINT: Parser = Parser {
    name: "checkpoint",
    inputs: 20_000,
    // The plan of the largest room of its scenario has 4 000 000 cells.
    memory: (12_000_000, 32),
    targets: &[targets::checkpoint],
    corpus: checkpoints,
    mutated: mutate::checkpoint,
};

const SCENARIO: Parser = Parser {
    name: "scenario",
    inputs: 20_000,
    memory: (80_000_000, 64),
    targets: &[targets::scenario],
    corpus: scenarios,
    mutated: mutate::scenario,
};

#[test]
fn logs() {
    parse(&LOG, "logs");
}

#[test]
fn compressed_logs() {
    parse(&COMPRESSED_LOG, "compressed_logs");
}

#[test]
fn messages_of_all_types() {
    parse(&CDR, "messages_of_all_types");
}

#[test]
fn checkpoints_of_runs() {
    parse(&CHECKPOINT, "checkpoints_of_runs");
}

#[test]
fn scenario_files() {
    parse(&SCENARIO, "scenario_files");
}

/// Inputs that once were too much for a parser, or are made to be.
#[test]
fn inputs_that_once_failed() {
    let mut count = 0;
    for parser in [&LOG, &CDR, &CHECKPOINT, &SCENARIO] {
        let folder = package_file("tests/inputs").join(parser.name);
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            eprintln!("{}", path.display()); // if it hangs
            let bytes = std::fs::read(&path).unwrap();
            let memory = if parser.name == "log" { COMPRESSED_LOG.memory } else { parser.memory };
            feed(parser.targets, memory, &bytes, &path.display().to_string());
            count += 1;
        }
    }
    assert!(count >= 8, "{count} files in tests/inputs");
}

// ---- inputs, one after the other

/// Where a limited process finds the checkpoint that was made for it: a run needs more address space than it has.
const MADE: &str = "ADAGIO_MADE_CHECKPOINT";

/// Where a limited process is told its work: first input, number of inputs, file for the number of the present one.
const WORK: &str = "ADAGIO_MUTATIONS";

fn parse(parser: &Parser, test: &str) {
    if let Ok(work) = std::env::var(WORK) {
        let [first, count, progress]: [&str; 3] =
            work.split(':').collect::<Vec<_>>().try_into().expect("first:count:file");
        return work_through(parser, first.parse().unwrap(), count.parse().unwrap(), Some(Path::new(progress)));
    }
    if let Ok(input) = std::env::var("ADAGIO_INPUT") {
        let (name, number) = input.split_once(':').expect("ADAGIO_INPUT is parser:number");
        if name == parser.name {
            let number = number.parse().expect("ADAGIO_INPUT is parser:number");
            let mutated = (parser.mutated)(&mut generator(number), &(parser.corpus)());
            let path = std::env::temp_dir().join(format!("{name}_{number}"));
            std::fs::write(&path, mutated).unwrap();
            eprintln!("the input is {}", path.display());
            work_through(parser, number, 1, None);
        }
        return;
    }
    let count = if common::long() { MANY } else { parser.inputs };
    let folder = tempfile::tempdir().unwrap();
    let progress = folder.path().join("progress");
    let made = folder.path().join("checkpoint");
    if parser.name == CHECKPOINT.name {
        std::fs::write(&made, &checkpoints()[0]).unwrap();
    }
    let output = Command::new("sh")
        .args(["-c", &format!("ulimit -v {ADDRESS_SPACE_KB} && exec \"$0\" \"$@\"")])
        .arg(std::env::current_exe().unwrap())
        .args([test, "--exact", "--nocapture", "--test-threads=1"])
        .env(WORK, format!("0:{count}:{}", progress.display()))
        .env(MADE, &made)
        .output()
        .unwrap();
    let at = std::fs::read(&progress).unwrap_or_default();
    let at = at.try_into().map_or(0, u64::from_le_bytes);
    assert!(
        output.status.success(),
        "{}: {}\nrepeat it with ADAGIO_INPUT={}:{at} cargo test --release --test mutations -- --nocapture {test}",
        output.status,
        stderr(&output),
        parser.name
    );
    assert_eq!(at + 1, count, "all inputs were parsed");
}

fn work_through(parser: &Parser, first: u64, count: u64, progress: Option<&Path>) {
    let corpus = (parser.corpus)();
    for input in &corpus {
        feed(parser.targets, parser.memory, input, "an input before mutation");
    }
    let progress = progress.map(|path| std::fs::File::create(path).unwrap());
    for number in first..first + count {
        if let Some(file) = &progress {
            file.write_all_at(&number.to_le_bytes(), 0).unwrap();
        }
        let mutated = (parser.mutated)(&mut generator(number), &corpus);
        feed(parser.targets, parser.memory, &mutated, &format!("input {number}"));
    }
}

/// Parse an input. The first target may not take more memory than the input allows.
fn feed(targets: &[fn(&[u8])], (constant, factor): (u64, u64), input: &[u8], what: &str) {
    let begin = std::time::Instant::now();
    let counted = allocation_counter::measure(|| targets[0](input));
    targets[1..].iter().for_each(|target| target(input));
    let most = constant + factor * input.len() as u64;
    assert!(counted.bytes_max <= most, "{what}: {} bytes of memory for {} of input", counted.bytes_max, input.len());
    let seconds = begin.elapsed().as_secs();
    assert!(seconds < 20, "{what}: it takes {seconds} s");
}

// ---- what is mutated

/// A log of ours with an attachment after each round.
fn own_log(compression: Compression, rounds: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let metadata = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let options = LogOptions { compression, chunk_bytes: 4096, ..LogOptions::default() };
    let mut log = LogWriter::with_sink(&mut bytes, "test", &options, &metadata).unwrap();
    write_samples(&mut log, rounds, &mut Vec::new(), |log, round| {
        log.attach("checkpoint", "text/plain", b"weights", START_NS + u64::from(round))
    })
    .unwrap();
    log.finish().unwrap();
    bytes
}

/// A log without checksums, so that damage reaches what is inside, with a channel without a schema.
fn foreign_log(compression: Option<mcap::Compression>) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new()
        .compression(compression)
        .compression_threads(0)
        .chunk_size(Some(200))
        .calculate_chunk_crcs(false)
        .calculate_data_section_crc(false)
        .calculate_summary_section_crc(false)
        .calculate_attachment_crcs(false)
        .create(&mut bytes)
        .unwrap();
    let schema = writer.add_schema("rcl_interfaces/msg/Log", "ros2msg", b"string msg").unwrap();
    let channels = [
        writer.add_channel(schema, "/rosout", "cdr", &BTreeMap::new()).unwrap(),
        writer.add_channel(0, "/plain", "text", &BTreeMap::from([("a".to_owned(), "b".to_owned())])).unwrap(),
    ];
    for sequence in 0..6 {
        for channel_id in channels {
            let header = mcap::records::MessageHeader { channel_id, sequence, log_time: 1, publish_time: 2 };
            writer.write_to_known_channel(&header, &[0, 1, 0, 0, 5, 6, 7, 8]).unwrap();
        }
    }
    let (name, media_type, data) = ("a".into(), "b".into(), (&[1, 2, 3][..]).into());
    writer.attach(&mcap::Attachment { log_time: 0, create_time: 0, name, media_type, data }).unwrap();
    writer.finish().unwrap();
    drop(writer);
    bytes.into_inner()
}

/// Messages of every type.
fn messages() -> Vec<Vec<u8>> {
    let log = own_log(Compression::None, 4);
    let mut bodies = Vec::new();
    for record in adagio::log::LogReader::new(log.as_slice(), "test") {
        if let Ok(adagio::log::Record::Message { data, .. }) = record {
            bodies.push(data);
        }
    }
    assert_eq!(bodies.len(), 4 * adagio::log::topics::ALL.len());
    bodies
}

fn smoke_text() -> String {
    std::fs::read_to_string(package_file("scenarios/smoke.toml")).unwrap()
}

/// A small scenario, the one of the first steps, and its complete file.
fn scenarios() -> Vec<Vec<u8>> {
    let smoke = smoke_text();
    let complete = adagio::scenario::Scenario::parse(&smoke, Path::new("scenario.toml"), &[]).unwrap().text;
    let small =
        "[[world.wall]]\npoints = [[0, 0], [3, 0], [3, 2], [0, 2]]\nclosed = true\n[[task]]\ngoal = [1.5, 0.9]\n";
    [small, &smoke, small, &complete].map(|text| text.as_bytes().to_vec()).to_vec()
}

/// The checkpoint of a run of some seconds, with few support vectors and small observations.
fn checkpoints() -> Vec<Vec<u8>> {
    if let Ok(path) = std::env::var(MADE) {
        return vec![std::fs::read(path).unwrap()];
    }
    let folder = tempfile::tempdir().unwrap();
    let smoke: PathBuf = package_file("scenarios/smoke.toml");
    let mut arguments = vec!["run", smoke.to_str().unwrap(), "--quiet", "--out", "run", "--actions", "30"];
    for set in [
        "vision.width=4",
        "vision.height=2",
        "camera.detail=vision",
        "dictionary.budget=12",
        "dictionary.sigma_frames=50",
        "slow.features=4",
        "agent.resolve_frames=100",
        "agent.latency_frames=50",
        "evaluate.starts=1",
        "evaluate.decode_train=30",
        "evaluate.decode_test=3",
    ] {
        arguments.extend(["--set", set]);
    }
    let output = adagio(folder.path(), &arguments);
    assert!(output.status.success(), "{}", stderr(&output));
    let path = folder.path().join("run").join(adagio::agent::CHECKPOINT_NAME);
    let bytes = std::fs::read(&path).unwrap();
    adagio::agent::read_checkpoint(&bytes, &path).unwrap();
    vec![bytes]
}
