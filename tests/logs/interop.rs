//! Promise: other tools open a log as it is. Read here with PyPI rosbags, and with mcap and
//! mcap-ros2-support, and compared field by field with what was written; and judged by the rules of `mcap doctor` and by rerun.
//!
//! `ADAGIO_PYTHON` names the Python (default `python3`). Without the packages the test says that
//! it checked nothing; `ADAGIO_REQUIRE_PYTHON=1` makes that a failure.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use crate::common::{adagio, read_with_python, satisfies_other_tools, smoke_run, stderr};
use crate::log_samples::{Written, write_samples};
use adagio::log::{Compression, LogOptions, LogReader, LogWriter, Record, topics};
use serde_json::{Map, Value};

const ROUNDS: u32 = 8;

#[test]
fn rosbags_and_mcap_ros2_read_what_was_written() {
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run_000.mcap");
        let written = write_log(&path, compression);
        let Some(seen) = read_with_python(&path) else {
            return;
        };
        for reader in ["rosbags", "mcap_ros2"] {
            compare(&seen[reader]["topics"], &written, reader);
        }
        for (topic, entry) in seen["rosbags"]["topics"].as_object().unwrap() {
            let own = entry["type"].as_str().unwrap().starts_with("adagio_msgs/");
            assert!(own || entry["as_in_ros2"] == true, "{topic} is not as ROS 2 defines it");
        }
        let file = &seen["mcap_ros2"];
        assert_eq!(file["profile"], "ros2");
        assert_eq!(file["library"], concat!("adagio ", env!("CARGO_PKG_VERSION")));
        assert_eq!(file["metadata"]["adagio"]["seed"], "7");
        assert_eq!(file["attachments"][0]["name"], "checkpoint");
        assert_eq!(file["attachments"][0]["bytes"], 5000);
        satisfies_other_tools(&[path]);
    }
}

/// Every way in which a log comes about: the files of a run that rotates, of one that was cut off and goes on, of a replay with
/// other settings, and what was recovered of a file that was not closed and of one that is damaged.
#[test]
fn other_tools_are_satisfied_with_every_kind_of_log() {
    let folder = tempfile::tempdir().unwrap();
    let files = |run: &str| -> Vec<PathBuf> {
        adagio::log::log_files(&folder.path().join(run)).unwrap().into_iter().map(|(_, path)| path).collect()
    };
    let at = |name: &str| folder.path().join(name);
    smoke_run(folder.path(), "rotated", &["--actions", "200", "--set", "log.file_mb=0.3"]);
    let mut logs = files("rotated");
    assert!(logs.len() >= 3, "{} files", logs.len());

    let whole = std::fs::read(smoke_run(folder.path(), "cut", &["--actions", "120"]).join("run_000.mcap")).unwrap();
    let unclosed = &whole[..whole.len() / 2];
    std::fs::write(at("cut/run_000.mcap"), unclosed).unwrap();
    std::fs::remove_file(at("cut/report.json")).unwrap();
    let mut damaged = whole.clone();
    damaged[whole.len() / 3] ^= 1;
    std::fs::write(at("damaged.mcap"), damaged).unwrap();
    for (arguments, codes) in [
        (&["resume", "cut", "--quiet", "--no-report"][..], [0, 0]),
        (&["recover", "cut/run_000.mcap", "--out", "closed.mcap"], [0, 3]),
        (&["recover", "damaged.mcap", "--out", "mended.mcap"], [3, 3]),
        (&["replay", "rotated", "--set", "slow.features=20", "--out", "other", "--quiet", "--no-report"], [0, 0]),
    ] {
        let output = adagio(folder.path(), arguments);
        assert!(codes.contains(&output.status.code().unwrap()), "{arguments:?}: {}", stderr(&output));
    }
    // The file that was cut off has no end, and no tool is satisfied with that; what was recovered of it has.
    logs.extend(files("cut").into_iter().skip(1));
    logs.extend(files("other"));
    logs.extend(["closed.mcap", "mended.mcap"].map(at));
    assert!(logs.len() >= 7, "{logs:?}");
    satisfies_other_tools(&logs);
}

#[test]
fn our_own_reader_reads_what_was_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run_000.mcap");
    let written = write_log(&path, Compression::Zstd);
    let mut seen = Vec::new();
    for record in LogReader::open(&path).unwrap() {
        if let Record::Message { topic, schema, sequence, log_time_ns, .. } = record.unwrap() {
            seen.push((topic.to_string(), schema.to_string(), sequence, log_time_ns));
        }
    }
    let expected: Vec<_> =
        written.iter().map(|w| (w.topic.to_owned(), w.message_type.to_owned(), w.sequence, w.stamp_ns)).collect();
    assert_eq!(seen, expected);
}

#[test]
fn other_readers_read_the_log_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--actions", "120"]);
    let path = run.join("run_000.mcap");
    let Some(seen) = read_with_python(&path) else {
        return;
    };
    let own = adagio::log::summarise(&path).unwrap();
    assert_eq!(own.messages["/camera/observation"], 601);
    for reader in ["rosbags", "mcap_ros2"] {
        let topics = seen[reader]["topics"].as_object().unwrap();
        let counts: BTreeMap<String, u64> = topics
            .iter()
            .map(|(topic, entry)| (topic.clone(), entry["count"].as_u64().unwrap()))
            .filter(|(_, count)| *count > 0)
            .collect();
        assert_eq!(counts, own.messages, "{reader}");
        let first = &topics["/camera/observation"]["messages"][0]["fields"];
        assert_eq!((first["width"].as_u64(), first["height"].as_u64()), (Some(32), Some(16)));
        // Vision corrects the mean to 128; only rounding and saturation move it.
        let mean = first["data_mean"].as_f64().unwrap();
        assert!((mean - 128.0).abs() < 4.0, "{reader}: mean {mean}");
        let model = &topics["/adagio/model"]["messages"][0]["fields"];
        assert_eq!(model["epoch"], 1);
        let slowness: Vec<f64> =
            model["slowness"].as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect();
        assert!(slowness.windows(2).all(|pair| pair[0] <= pair[1]) && slowness.len() == 60);
    }
}

fn write_log(path: &Path, compression: Compression) -> Vec<Written> {
    let options = LogOptions { compression, chunk_bytes: 8192, ..LogOptions::default() };
    let metadata = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let mut log = LogWriter::create(path, &options, &metadata).unwrap();
    let mut written = Vec::new();
    write_samples(&mut log, ROUNDS, &mut written, |_, _| Ok(())).unwrap();
    log.attach("checkpoint", "application/octet-stream", &[9; 5000], crate::log_samples::START_NS).unwrap();
    let totals = log.finish().unwrap();
    assert_eq!(totals.messages, written.len() as u64);
    assert_eq!(totals.bytes, path.metadata().unwrap().len());
    written
}

fn compare(seen: &Value, written: &[Written], reader: &str) {
    let seen = seen.as_object().unwrap();
    assert_eq!(seen.len(), topics::ALL.len(), "{reader}");
    for (topic, entry) in seen {
        let expected: Vec<&Written> = written.iter().filter(|w| w.topic == topic).collect();
        assert_eq!(entry["type"], expected[0].message_type, "{reader} {topic}");
        assert_eq!(entry["count"], expected.len(), "{reader} {topic}");
        for (message, expected) in entry["messages"].as_array().unwrap().iter().zip(&expected) {
            assert_eq!(message["stamp_ns"], expected.stamp_ns, "{reader} {topic}");
            // As text and back: serde_json may read a number one bit off what it was.
            let text = expected_fields(&expected.message).to_string();
            let fields: Value = serde_json::from_str(&text).unwrap();
            assert_eq!(message["fields"], fields, "{reader} {topic} {}", expected.sequence);
        }
    }
}

/// A message as the script prints it: matrices in one row, and the mean of an image's pixels.
fn expected_fields(message: &Value) -> Value {
    match message {
        Value::Object(fields) => {
            let mut fields: Map<_, _> =
                fields.iter().map(|(name, value)| (name.clone(), expected_fields(value))).collect();
            if fields.contains_key("encoding") {
                let pixels = fields["data"].as_array().unwrap();
                let sum: u64 = pixels.iter().map(|pixel| pixel.as_u64().unwrap()).sum();
                fields.insert("data_mean".into(), (sum as f64 / pixels.len() as f64).into());
            }
            Value::Object(fields)
        }
        Value::Array(rows) if rows.iter().any(Value::is_array) => {
            rows.iter().flat_map(|row| row.as_array().unwrap()).cloned().collect()
        }
        other => other.clone(),
    }
}
