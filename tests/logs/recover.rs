//! Promise: `adagio recover` copies everything that can still be read, of a log of any program, into a file that every reader
//! opens; it says what is lost, and touches nothing that is there already.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use crate::common::{CHUNK, adagio, read_with_python, records_of, satisfies_other_tools, smoke_run, stderr, stdout};
use crate::log_samples::{START_NS, write_samples};
use adagio::log::{Compression, Ending, LogOptions, LogReader, LogWriter, Record, Recovered, recover_into, summarise};
use serde_json::Value;

/// Topic, number, times and body of every message, every attachment and every metadata record.
#[derive(Debug, Default, Clone, PartialEq)]
struct Content {
    messages: Vec<(String, u32, u64, u64, Vec<u8>)>,
    attachments: Vec<(String, String, u64, u64, Vec<u8>)>,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    errors: Vec<String>,
}

fn content(bytes: &[u8]) -> (Content, Ending) {
    let mut reader = LogReader::new(Cursor::new(bytes), "test").with_summary().unwrap();
    let mut found = Content::default();
    for record in reader.by_ref() {
        match record {
            Ok(Record::Message { topic, sequence, log_time_ns, publish_time_ns, data, .. }) => {
                found.messages.push((topic.to_string(), sequence, log_time_ns, publish_time_ns, data));
            }
            Ok(Record::Attachment { name, media_type, log_time_ns, create_time_ns, data }) => {
                found.attachments.push((name, media_type, log_time_ns, create_time_ns, data));
            }
            Ok(Record::Metadata { name, map }) => found.metadata.push((name, map)),
            Err(error) => found.errors.push(error.to_string()),
        }
    }
    (found, reader.ending().unwrap().clone())
}

/// What is recovered from some bytes, which must be a complete log.
fn recovered(bytes: &[u8]) -> (Content, Recovered) {
    let mut sink = Vec::new();
    let reader = LogReader::new(Cursor::new(bytes), "old").with_summary().unwrap();
    let found = recover_into(reader, &mut sink, "new").unwrap();
    let (content, ending) = content(&sink);
    assert_eq!((ending, content.errors.len()), (Ending::Complete, 0));
    let copied: u64 = found.messages.values().sum();
    assert_eq!((copied, found.attachments), (content.messages.len() as u64, content.attachments.len() as u64));
    (content, found)
}

/// A closed log with a chunk for each round, and an attachment behind every fourth.
fn good_log(compression: Compression, rounds: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let metadata = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let options = LogOptions { compression, chunk_bytes: 1 << 20, ..LogOptions::default() };
    let mut log = LogWriter::with_sink(&mut bytes, "test", &options, &metadata).unwrap();
    write_samples(&mut log, rounds, &mut Vec::new(), |log, round| {
        if round % 4 == 2 {
            log.attach("checkpoint", "text/plain", b"weights", START_NS + u64::from(round))?;
        }
        log.flush()
    })
    .unwrap();
    log.finish().unwrap();
    bytes
}

/// Place and length of the chunks of a log.
fn chunks_of(bytes: &[u8]) -> Vec<(usize, usize)> {
    records_of(bytes).into_iter().filter(|(_, kind, _)| *kind == CHUNK).map(|(at, _, length)| (at, length)).collect()
}

/// All but the messages of one round.
fn without_round(all: &Content, round: u32) -> Content {
    let mut rest = all.clone();
    rest.messages.retain(|message| message.1 != round);
    rest
}

#[test]
fn a_length_that_is_destroyed_costs_the_chunk_that_it_is_of_and_no_other() {
    for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
        let bytes = good_log(compression, 9);
        let (all, ending) = content(&bytes);
        assert_eq!(ending, Ending::Complete);
        // The first chunk holds the definitions alone.
        let chunks = chunks_of(&bytes);
        assert_eq!(chunks.len(), 10);
        for (round, &(at, length)) in chunks[1..].iter().enumerate() {
            let length = length as u64;
            let wrong = [0, 1, 40, length - 300, length - 1, length + 1, length + 9, length + 700, 2 * length];
            // Larger than the file, than any record, than any memory.
            for wrong in wrong.into_iter().chain([1 << 24, 1 << 27, 1 << 40, u64::MAX]) {
                let mut damaged = bytes.clone();
                damaged[at + 1..at + 9].copy_from_slice(&wrong.to_le_bytes());
                let what = format!("{compression:?}: the length {length} of chunk {round} is {wrong}");
                let (rest, found) = recovered(&damaged);
                // Without compression even the messages of that chunk may be found.
                let whole = compression == Compression::None && rest.messages == all.messages;
                assert!(whole || rest.messages == without_round(&all, round as u32).messages, "{what}");
                assert_eq!(rest.metadata, all.metadata, "{what}");
                // An attachment right behind may go with it; no other does.
                let behind = usize::from(round % 4 == 2);
                assert!(rest.attachments.len() + behind >= all.attachments.len(), "{what}");
                assert!(
                    found.lost >= 1 && found.losses[0].contains(&format!("byte {at}:")),
                    "{what}: {:?}",
                    found.losses
                );
                assert!(matches!(found.ending, Ending::Damaged { offset, .. } if offset == at as u64), "{what}");
            }
        }
    }
}

#[test]
fn sizes_inside_of_a_chunk_that_are_destroyed_cost_that_chunk_and_no_other() {
    let bytes = good_log(Compression::Zstd, 9);
    let (all, _) = content(&bytes);
    for (round, &(at, _)) in chunks_of(&bytes)[1..].iter().enumerate() {
        // Size before compression, length of the compression's name, compressed size.
        for (place, size) in [(25, 8), (37, 4), (45, 8)] {
            for wrong in [0, 1, 1 << 20, u32::MAX.into(), u64::MAX] {
                let mut damaged = bytes.clone();
                damaged[at + place..at + place + size].copy_from_slice(&wrong.to_le_bytes()[..size]);
                let what = format!("chunk {round}: {size} bytes at {place} are {wrong}");
                let (rest, found) = recovered(&damaged);
                assert_eq!(rest.messages, without_round(&all, round as u32).messages, "{what}");
                assert_eq!(rest.attachments, all.attachments, "{what}");
                assert!(found.lost >= 1, "{what}");
            }
        }
    }
}

#[test]
fn any_byte_of_a_chunk_costs_that_chunk_and_that_of_the_definitions_none() {
    let bytes = good_log(Compression::Zstd, 5);
    let (all, _) = content(&bytes);
    let (mut costly, mut harmless) = (0, 0);
    for (number, &(at, length)) in chunks_of(&bytes).iter().enumerate() {
        for place in (at..at + 9 + length).step_by(31) {
            let mut damaged = bytes.clone();
            damaged[place] ^= 0x5a;
            let (rest, found) = recovered(&damaged);
            let what = format!("byte {place}, {} of chunk {number}", place - at);
            // Earliest and latest stamp are not needed, nor is every bit of what is compressed.
            if found.lost == 0 {
                assert_eq!(rest, all, "{what}");
                harmless += 1;
                continue;
            }
            costly += 1;
            // The summary holds the definitions once more.
            let left = if number == 0 { all.clone() } else { without_round(&all, number as u32 - 1) };
            assert_eq!(rest.messages, left.messages, "{what}");
        }
    }
    assert!(costly > 200 && harmless < 20, "{costly} bytes cost a chunk, {harmless} nothing");
}

#[test]
fn what_was_recovered_is_recovered_without_loss() {
    let bytes = good_log(Compression::Lz4, 6);
    let (at, _) = chunks_of(&bytes)[3];
    let mut damaged = bytes;
    damaged[at + 200] ^= 1;
    let mut once = Vec::new();
    let reader = || LogReader::new(Cursor::new(damaged.clone()), "old");
    assert!(recover_into(reader(), &mut once, "new").unwrap().lost > 0);
    let (again, found) = recovered(&once);
    assert_eq!((found.lost, found.ending), (0, Ending::Complete));
    assert_eq!(again, content(&once).0);
}

#[test]
fn a_log_of_another_program_is_copied_as_it_is() {
    let mut bytes = Cursor::new(Vec::new());
    let mut writer = mcap::WriteOptions::new()
        .profile("another")
        .compression(Some(mcap::Compression::Lz4))
        .compression_threads(0)
        .create(&mut bytes)
        .unwrap();
    let texts = |key: &str| BTreeMap::from([(key.to_owned(), "value".to_owned())]);
    let schema = writer.add_schema("point", "jsonschema", b"{\"type\": \"object\"}").unwrap();
    let json = writer.add_channel(schema, "/point", "json", &texts("of the channel")).unwrap();
    let same_topic = writer.add_channel(schema, "/point", "json", &texts("another publisher")).unwrap();
    // The format allows channels without a schema.
    let plain = writer.add_channel(0, "/plain", "text", &BTreeMap::new()).unwrap();
    for sequence in 0..300u32 {
        for channel_id in [json, same_topic, plain] {
            let times = (1000 + u64::from(sequence), 2000 + u64::from(sequence));
            let header =
                mcap::records::MessageHeader { channel_id, sequence, log_time: times.0, publish_time: times.1 };
            writer.write_to_known_channel(&header, format!("{{\"x\": {sequence}}}").as_bytes()).unwrap();
        }
        if sequence % 50 == 0 {
            writer.flush().unwrap();
        }
    }
    let data = (&b"picture"[..]).into();
    let (name, media_type) = ("map.png".into(), "image/png".into());
    writer.attach(&mcap::Attachment { log_time: 5, create_time: 3, name, media_type, data }).unwrap();
    writer.write_metadata(&mcap::records::Metadata { name: "site".into(), metadata: texts("hall") }).unwrap();
    writer.finish().unwrap();
    drop(writer);
    let bytes = bytes.into_inner();

    let (all, _) = content(&bytes);
    assert_eq!((all.messages.len(), all.attachments.len(), all.metadata.len()), (900, 1, 1));
    assert_eq!((all.attachments[0].2, all.attachments[0].3), (5, 3));
    let (copied, found) = recovered(&bytes);
    assert_eq!((&copied, found.lost), (&all, 0));

    // With a damaged chunk, too, and with everything that the file says of its channels.
    let folder = tempfile::tempdir().unwrap();
    let (at, length) = chunks_of(&bytes)[2];
    let mut damaged = bytes;
    damaged[at + length / 2] ^= 0xff;
    std::fs::write(folder.path().join("foreign.mcap"), damaged).unwrap();
    let output = adagio(folder.path(), &["recover", "foreign.mcap"]);
    assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
    let new = std::fs::read(folder.path().join("foreign.recovered.mcap")).unwrap();
    let summary = mcap::Summary::read(&new).unwrap().unwrap();
    let channels: BTreeMap<(String, String), (String, Option<String>)> = summary
        .channels
        .values()
        .map(|channel| {
            let metadata = channel.metadata.keys().next().cloned().unwrap_or_default();
            let schema = channel
                .schema
                .as_ref()
                .map(|schema| format!("{} {} {}", schema.name, schema.encoding, String::from_utf8_lossy(&schema.data)));
            ((channel.topic.clone(), metadata), (channel.message_encoding.clone(), schema))
        })
        .collect();
    let json = ("json".to_owned(), Some("point jsonschema {\"type\": \"object\"}".to_owned()));
    let key = |topic: &str, metadata: &str| (topic.to_owned(), metadata.to_owned());
    assert_eq!(
        channels,
        BTreeMap::from([
            (key("/plain", ""), ("text".to_owned(), None)),
            (key("/point", "another publisher"), json.clone()),
            (key("/point", "of the channel"), json),
        ])
    );
    let mut reader = LogReader::open(&folder.path().join("foreign.recovered.mcap")).unwrap();
    let messages = reader.by_ref().filter(|record| matches!(record, Ok(Record::Message { .. }))).count();
    assert!((700..900).contains(&messages), "{messages}");
    assert_eq!(reader.profile(), Some("another"));
}

// ---- the command

#[test]
fn exit_codes_and_words_say_what_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--actions", "60", "--set", "log.chunk_bytes=8192"]);
    let whole = std::fs::read(run.join("run_000.mcap")).unwrap();
    let (all, _) = content(&whole);
    let chunks = chunks_of(&whole);
    let (at, _) = chunks[chunks.len() / 2];
    let mut destroyed = whole.clone();
    destroyed[at + 1..at + 9].copy_from_slice(&u64::MAX.to_le_bytes());
    let cases = [
        ("whole", &whole[..], 0, "nothing that was written is lost\n"),
        ("unclosed", &whole[..at], 0, "nothing that was written is lost; the log had not been closed"),
        ("cut", &whole[..at + 100], 3, "1 records are lost:"),
        ("destroyed", &destroyed[..], 3, "claims 18446744073709551615 bytes"),
    ];
    for (name, bytes, code, words) in cases {
        let file = format!("{name}.mcap");
        std::fs::write(folder.path().join(&file), bytes).unwrap();
        let output = adagio(folder.path(), &["recover", &file, "--out", &format!("{name}_new.mcap")]);
        assert_eq!(output.status.code(), Some(code), "{name}: {}{}", stdout(&output), stderr(&output));
        assert!(stdout(&output).contains(words), "{name}: {}", stdout(&output));
        let json = adagio(folder.path(), &["recover", &file, "--out", &format!("{name}_json.mcap"), "--json"]);
        assert_eq!(json.status.code(), Some(code), "{name}");
        let json: Value = serde_json::from_slice(&json.stdout).unwrap();
        assert_eq!(json["lost_records"].as_u64().unwrap() > 0, code == 3, "{name}: {json}");
        assert_eq!(json["closed"], name == "whole", "{name}");

        let new = folder.path().join(format!("{name}_new.mcap"));
        let (kept, ending) = content(&std::fs::read(&new).unwrap());
        assert_eq!((ending, kept.errors.len(), &kept.metadata), (Ending::Complete, 0, &all.metadata), "{name}");
        let share = kept.messages.len() as f64 / all.messages.len() as f64;
        match name {
            "whole" => assert_eq!(kept, all),
            "unclosed" | "cut" => assert!(all.messages.starts_with(&kept.messages) && (0.3..0.7).contains(&share)),
            // One chunk is missing, and what came behind it is there.
            _ => {
                assert!(share > 0.8 && share < 1.0, "{share}");
                assert_eq!((kept.messages.last(), &kept.attachments), (all.messages.last(), &all.attachments));
                assert!(json["missing_observations"].as_u64().unwrap() > 0);
            }
        }
        satisfies_other_readers(&new);
    }
}

/// The file is read to its end by other programs, with the messages that we read.
fn satisfies_other_readers(path: &Path) {
    let Some(seen) = read_with_python(path) else { return };
    let own = summarise(path).unwrap();
    for reader in ["rosbags", "mcap_ros2"] {
        let counts: BTreeMap<String, u64> = seen[reader]["topics"]
            .as_object()
            .unwrap()
            .iter()
            .map(|(topic, entry)| (topic.clone(), entry["count"].as_u64().unwrap()))
            .filter(|(_, count)| *count > 0)
            .collect();
        assert_eq!(counts, own.messages, "{reader} on {}", path.display());
    }
    satisfies_other_tools(&[path.to_owned()]);
}

#[test]
fn a_run_can_be_replayed_from_what_was_recovered() {
    let folder = tempfile::tempdir().unwrap();
    let run = smoke_run(folder.path(), "run", &["--actions", "60"]);
    let whole = std::fs::read(run.join("run_000.mcap")).unwrap();
    std::fs::write(folder.path().join("cut.mcap"), &whole[..whole.len() * 3 / 4]).unwrap();
    let output = adagio(folder.path(), &["recover", "cut.mcap", "--out", "new.mcap"]);
    assert!([Some(0), Some(3)].contains(&output.status.code()), "{}", stderr(&output));
    let output = adagio(folder.path(), &["replay", "new.mcap", "--out", "again", "--quiet", "--no-report"]);
    assert!(output.status.success(), "{}", stderr(&output));
}

#[test]
fn what_exists_is_not_touched() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("log.mcap"), good_log(Compression::Zstd, 2)).unwrap();
    for out in ["log.recovered.mcap", "mine.mcap"] {
        std::fs::write(folder.path().join(out), "precious").unwrap();
    }
    for arguments in [&["recover", "log.mcap"][..], &["recover", "log.mcap", "--out", "mine.mcap"]] {
        let output = adagio(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains("never overwritten"), "{}", stderr(&output));
    }
    for out in ["log.recovered.mcap", "mine.mcap"] {
        assert_eq!(std::fs::read(folder.path().join(out)).unwrap(), b"precious");
    }
    // Nor is a file made where there is nothing to recover.
    let output = adagio(folder.path(), &["recover", "nowhere.mcap", "--out", "new.mcap"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("cannot open the log nowhere.mcap"), "{}", stderr(&output));
    assert!(!folder.path().join("new.mcap").exists());
}
