//! Promise: a full disk, a killed run or damaged bytes cost what they touch, and are told. Never
//! a panic, and never memory that the bytes only claim
//! (to see the latter, run it under `ulimit -v 700000`).

use std::{
    collections::BTreeMap,
    io::{self, Cursor, Write},
    time::{Duration, Instant},
};

use crate::log_samples::{START_NS, decode_all, write_samples};
use adagio::log::{
    Compression, Ending, FileTotals, LogError, LogOptions, LogReader, LogWriter, Message, Record, cdr,
    messages::{Decision, Header},
    summarise, topics,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const COMPRESSIONS: [Compression; 3] = [Compression::Zstd, Compression::Lz4, Compression::None];

fn options(compression: Compression) -> LogOptions {
    LogOptions { compression, chunk_bytes: 4096, ..LogOptions::default() }
}

/// A log of `rounds` rounds with an attachment and a flush after each, in memory.
fn write_log<W: Write>(sink: W, compression: Compression, rounds: u32) -> Result<FileTotals, LogError> {
    let metadata = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let mut log = LogWriter::with_sink(sink, "test", &options(compression), &metadata)?;
    write_samples(&mut log, rounds, &mut Vec::new(), |log, round| {
        log.attach("checkpoint", "text/plain", b"weights", START_NS + u64::from(round))
    })?;
    log.finish()
}

fn good_log(compression: Compression, rounds: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_log(&mut bytes, compression, rounds).unwrap();
    bytes
}

/// Reads bytes to the end: records, errors, ending.
fn read(bytes: &[u8]) -> (Vec<Record>, Vec<LogError>, Ending) {
    let mut reader = LogReader::new(Cursor::new(bytes), "test");
    let (mut records, mut errors) = (Vec::new(), Vec::new());
    for item in reader.by_ref() {
        match item {
            Ok(record) => records.push(record),
            Err(error) => errors.push(error),
        }
    }
    let ending = reader.ending().expect("the iterator has ended").clone();
    (records, errors, ending)
}

fn decode_any(record: &Record) {
    if let Record::Message { data, .. } = record {
        decode_all(data);
    }
}

// ---- a sink that fails

/// Accepts `left` calls, then fails once, then would accept more.
struct FailingSink {
    left: u32,
    failed: bool,
    failed_to_flush: bool,
    bytes: Vec<u8>,
}

impl FailingSink {
    fn after(calls: u32) -> Self {
        Self { left: calls, failed: false, failed_to_flush: false, bytes: Vec::new() }
    }

    fn call(&mut self) -> io::Result<()> {
        assert!(!self.failed, "nothing may be written after a failure");
        if self.left == 0 {
            self.failed = true;
            return Err(io::Error::other("disk on fire"));
        }
        self.left -= 1;
        Ok(())
    }
}

impl Write for &mut FailingSink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.call()?;
        // In small pieces, so that it fails inside of records as well.
        let piece = &bytes[..bytes.len().min(100)];
        self.bytes.extend_from_slice(piece);
        Ok(piece.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.call().inspect_err(|_| self.failed_to_flush = true)
    }
}

#[test]
fn a_write_that_fails_is_told_with_its_cause_whenever_it_comes() {
    for compression in COMPRESSIONS {
        let mut complete = None;
        for calls in 0..5000 {
            let mut sink = FailingSink::after(calls);
            match write_log(&mut sink, compression, 3) {
                Ok(totals) => {
                    assert_eq!(totals.bytes, sink.bytes.len() as u64);
                    complete = Some(calls);
                    break;
                }
                Err(error) => {
                    let text = error.to_string();
                    assert!(matches!(error, LogError::Write { .. }), "{text}");
                    assert!(text.contains("disk on fire"), "call {calls}: {text}");
                }
            }
            // What was accepted before is a log that was cut off, unless only the last flush failed.
            let (_, _, ending) = read(&sink.bytes);
            let complete = ending == Ending::Complete;
            assert!(!complete || sink.failed_to_flush, "call {calls}");
        }
        let calls = complete.expect("the log is complete after enough calls");
        assert!(calls > 200, "only {calls} calls were tried");
    }
}

#[test]
fn every_call_after_a_failure_reports_the_first_cause() {
    // In the middle of the first messages: how much is written before them follows from the table of topics.
    let mut sink = FailingSink::after(u32::MAX);
    drop(LogWriter::with_sink(&mut sink, "test", &options(Compression::None), &BTreeMap::new()).unwrap());
    let mut sink = FailingSink::after(u32::MAX - sink.left + 20);
    let mut log = LogWriter::with_sink(&mut sink, "test", &options(Compression::None), &BTreeMap::new()).unwrap();
    let image = crate::log_samples::image(Header::default(), 0);
    let now = Instant::now();
    let mut errors = Vec::new();
    for sequence in 0..20 {
        errors.extend(log.write(topics::OBSERVATION, sequence, 0, &image).err());
    }
    assert!(!errors.is_empty());
    errors.extend(log.flush().err());
    errors.extend(log.tick(now).err());
    errors.extend(log.attach("a", "b", b"c", 0).err());
    let before = errors.len();
    errors.extend(log.finish().err());
    assert_eq!(errors.len(), before + 1);
    for error in errors {
        assert!(error.to_string().contains("disk on fire"), "{error}");
    }
}

#[test]
fn an_existing_file_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run_000.mcap");
    std::fs::write(&path, "precious").unwrap();
    let error = LogWriter::create(&path, &LogOptions::default(), &BTreeMap::new()).err().unwrap();
    assert!(error.to_string().contains("never overwritten"), "{error}");
    assert_eq!(std::fs::read(&path).unwrap(), b"precious");
}

#[test]
fn what_was_flushed_survives_a_kill() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run_000.mcap");
    let mut log = LogWriter::create(&path, &LogOptions::default(), &BTreeMap::new()).unwrap();
    let image = crate::log_samples::image(Header::default(), 0);
    let start = Instant::now();
    log.tick(start).unwrap();
    for sequence in 0..10 {
        log.write(topics::OBSERVATION, sequence, 0, &image).unwrap();
    }
    log.tick(start + Duration::from_millis(999)).unwrap();
    assert_eq!(summarise(&path).unwrap().messages.values().sum::<u64>(), 0);
    log.tick(start + Duration::from_millis(1000)).unwrap();
    let summary = summarise(&path).unwrap();
    assert_eq!(summary.messages["/camera/observation"], 10);
    assert_eq!(summary.ending, Ending::NoFooter);
    // As after a kill: the writer is never dropped.
    std::mem::forget(log);
}

#[test]
fn missing_observations_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run_000.mcap");
    let metadata = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let mut log = LogWriter::create(&path, &LogOptions::default(), &metadata).unwrap();
    for sequence in [0, 1, 4, 5, 9, 9] {
        let image = crate::log_samples::image(Header::default(), sequence);
        log.write(topics::OBSERVATION, sequence, u64::from(sequence) + 10, &image).unwrap();
    }
    let totals = log.finish().unwrap();
    let summary = summarise(&path).unwrap();
    assert_eq!(summary.bytes, totals.bytes);
    assert_eq!(summary.stamps_ns, Some((10, 19)));
    assert_eq!(summary.metadata["adagio"], metadata);
    assert_eq!(summary.ending, Ending::Complete);
    let holes: Vec<_> = summary.holes.iter().map(|hole| (hole.after, hole.before)).collect();
    assert_eq!(holes, [(1, 4), (5, 9)]);
    assert_eq!((summary.missing, summary.out_of_order), (5, 1));
}

// ---- a file that was cut off

#[test]
fn a_file_cut_anywhere_gives_its_complete_chunks() {
    for compression in COMPRESSIONS {
        let bytes = good_log(compression, 3);
        let (all, errors, ending) = read(&bytes);
        assert_eq!(ending, Ending::Complete);
        assert!(errors.is_empty());
        let mut last = 0;
        for length in (0..bytes.len()).step_by(7).chain([bytes.len() - 1]) {
            let (records, errors, ending) = read(&bytes[..length]);
            assert!(all.starts_with(&records), "cut at {length}");
            assert!(records.len() >= last, "cut at {length}");
            last = records.len();
            match ending {
                Ending::NoFooter => assert!(errors.is_empty(), "cut at {length}"),
                Ending::Damaged { offset, .. } => {
                    // Cut right behind the footer, what is missing starts where the file ends.
                    assert!(offset <= length as u64, "cut at {length}: damaged at {offset}");
                    assert_eq!(errors.len(), 1, "cut at {length}");
                }
                Ending::Complete => panic!("cut at {length} is not complete"),
            }
        }
        assert_eq!(last, all.len(), "the summary section holds no records");
    }
}

#[test]
fn a_cut_behind_the_nth_attachment_gives_n_rounds() {
    let bytes = good_log(Compression::Zstd, 5);
    let attachment = |bytes: &[u8]| bytes.windows(7).position(|window| window == b"weights");
    let mut end = 0;
    for round in 1..=5 {
        // The data and its checksum of four bytes end the record.
        end += attachment(&bytes[end..]).unwrap() + 7 + 4;
        let (records, _, ending) = read(&bytes[..end]);
        assert_eq!(ending, Ending::NoFooter);
        assert_eq!(records.len(), 1 + round * (topics::ALL.len() + 1));
    }
}

// ---- bytes that were changed

#[test]
fn a_damaged_chunk_costs_only_itself() {
    let bytes = good_log(Compression::None, 4);
    let (all, ..) = read(&bytes);
    // The text of round 1 of 0 to 3, inside of a chunk.
    let at = bytes.windows(8).position(|window| window == b"round 1:").unwrap();
    let mut damaged = bytes;
    damaged[at] ^= 1;
    let (records, errors, ending) = read(&damaged);
    assert_eq!(errors.len(), 1);
    assert!(errors[0].to_string().contains("CRC"), "{}", errors[0]);
    assert!(matches!(ending, Ending::Damaged { offset, .. } if offset < at as u64));
    let sequences = |records: &[Record]| -> Vec<u32> {
        let mut numbers: Vec<u32> = records
            .iter()
            .filter_map(|record| match record {
                Record::Message { topic, sequence, .. } if &**topic == "/rosout" => Some(*sequence),
                _ => None,
            })
            .collect();
        numbers.sort_unstable();
        numbers
    };
    assert_eq!(sequences(&all), [0, 1, 2, 3]);
    assert_eq!(sequences(&records), [0, 2, 3]);
}

#[test]
fn twenty_thousand_damaged_logs_are_read_without_panic() {
    let logs = COMPRESSIONS.map(|compression| good_log(compression, 1));
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let mut found = 0;
    for round in 0..20_000 {
        let mut bytes = logs[round % logs.len()].clone();
        for _ in 0..random.random_range(1..4) {
            let at = random.random_range(0..bytes.len());
            bytes[at] = match random.random_range(0..4) {
                0 => 0,
                1 => 0xff,
                2 => bytes[at] ^ (1 << random.random_range(0..8)),
                _ => random.random(),
            };
        }
        let (records, errors, ending) = read(&bytes);
        for record in &records {
            decode_any(record);
        }
        if let Ending::Damaged { .. } = ending {
            assert!(!errors.is_empty());
            found += 1;
        }
    }
    // The rest hit bytes without a checksum (texts of metadata, indexes) or changed nothing.
    assert!(found > 10_000, "only {found} of 20 000 were noticed");
}

#[test]
fn chunks_without_checksum_are_read_without_panic() {
    // Another program may leave checksums out; then damage reaches what is inside.
    let mut random = ChaCha8Rng::seed_from_u64(10);
    for compression in [Some(mcap::Compression::Zstd), None] {
        let mut good = Cursor::new(Vec::new());
        let mut writer = mcap::WriteOptions::new()
            .compression(compression)
            .calculate_chunk_crcs(false)
            .calculate_attachment_crcs(false)
            .create(&mut good)
            .unwrap();
        let schema = writer.add_schema(Decision::TYPE, "ros2msg", b"").unwrap();
        let channel = writer.add_channel(schema, "/adagio/decision", "cdr", &BTreeMap::new()).unwrap();
        let header = mcap::records::MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
        let body = cdr::encode(&Decision::default()).unwrap();
        for _ in 0..4 {
            writer.write_to_known_channel(&header, &body).unwrap();
        }
        writer
            .attach(&mcap::Attachment {
                log_time: 0,
                create_time: 0,
                name: "a".into(),
                media_type: "b".into(),
                data: (&[1, 2, 3][..]).into(),
            })
            .unwrap();
        writer.finish().unwrap();
        drop(writer);
        let good = good.into_inner();
        assert_eq!(read(&good).2, Ending::Complete);
        for _ in 0..20_000 {
            let mut bytes = good.clone();
            let at = random.random_range(0..bytes.len());
            bytes[at] = random.random();
            for record in &read(&bytes).0 {
                decode_any(record);
            }
        }
    }
}
