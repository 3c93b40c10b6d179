//! What is done with bytes that may come from anywhere, one function for each parser. They must return, whatever the bytes:
//! the tests and the fuzz targets call the same ones.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use adagio::agent::read_checkpoint;
use adagio::log::messages::{
    Decision, DictionaryGrowth, Evaluation, FrameTaken, GoalMoved, Health, Image, LaserScan, Log, ModelRequest,
    ModelUpdate, Odometry, PlaceBelief, PolicyUpdate, PoseStamped, Prospect, RunEnd, Transition, TwistStamped,
};
use adagio::log::{Ending, LogReader, Message, Record, cdr, recover_into, topics};
use adagio::scenario::Scenario;

/// All that a log holds, as far as it can be read.
#[derive(Debug, Default, PartialEq)]
struct Content {
    messages: Vec<(String, String, u32, u64, u64, Vec<u8>)>,
    attachments: Vec<(String, String, u64, u64, Vec<u8>)>,
    metadata: Vec<(String, BTreeMap<String, String>)>,
}

/// Read a log to its end, and decode each message.
pub fn log(bytes: &[u8]) {
    read(bytes, |record| {
        if let Record::Message { topic, data, .. } = &record {
            let _ = topics::to_json(topic, data);
        }
    });
}

/// Recover a log: the new one is complete, and holds what can be read of the old one and nothing else.
pub fn recover(bytes: &[u8]) {
    let mut new = Vec::new();
    let Ok(reader) = LogReader::new(Cursor::new(bytes), "old").with_summary() else { unreachable!("memory is read") };
    recover_into(reader, &mut new, "new").expect("memory takes what it is given");
    let (old, (copied, ending)) = (content(bytes).0, content(&new));
    assert_eq!(ending, Some(Ending::Complete));
    assert_eq!(old, copied, "the copy is not what was read");
}

fn content(bytes: &[u8]) -> (Content, Option<Ending>) {
    let mut found = Content::default();
    let ending = read(bytes, |record| match record {
        Record::Message { topic, schema, sequence, log_time_ns, publish_time_ns, data, .. } => {
            let (topic, schema) = (topic.to_string(), schema.to_string());
            found.messages.push((topic, schema, sequence, log_time_ns, publish_time_ns, data));
        }
        Record::Attachment { name, media_type, log_time_ns, create_time_ns, data } => {
            found.attachments.push((name, media_type, log_time_ns, create_time_ns, data));
        }
        Record::Metadata { name, map } => found.metadata.push((name, map)),
    });
    (found, ending)
}

fn read(bytes: &[u8], mut with: impl FnMut(Record)) -> Option<Ending> {
    let mut reader = LogReader::new(Cursor::new(bytes), "test").with_summary().expect("memory is read");
    loop {
        for record in reader.by_ref() {
            match record {
                Ok(record) => with(record),
                Err(error) => assert!(!error.to_string().is_empty()),
            }
        }
        if !reader.go_on().expect("memory is read") {
            return reader.ending().cloned();
        }
    }
}

/// Decode bytes as every message type.
pub fn cdr(bytes: &[u8]) {
    decode::<Image>(bytes);
    decode::<LaserScan>(bytes);
    decode::<Odometry>(bytes);
    decode::<PoseStamped>(bytes);
    decode::<TwistStamped>(bytes);
    decode::<Log>(bytes);
    decode::<Decision>(bytes);
    decode::<FrameTaken>(bytes);
    decode::<GoalMoved>(bytes);
    decode::<ModelRequest>(bytes);
    decode::<RunEnd>(bytes);
    decode::<Transition>(bytes);
    decode::<DictionaryGrowth>(bytes);
    decode::<PlaceBelief>(bytes);
    decode::<Prospect>(bytes);
    decode::<ModelUpdate>(bytes);
    decode::<PolicyUpdate>(bytes);
    decode::<Evaluation>(bytes);
    decode::<Health>(bytes);
}

/// What is decoded is encoded and decoded to the same.
fn decode<M: Message>(bytes: &[u8]) {
    let Ok(message) = cdr::decode::<M>(bytes) else { return };
    let once = cdr::encode(&message).expect("it was decoded");
    // By their bytes: what is not a number does not equal itself.
    let again = cdr::decode::<M>(&once).expect("it was encoded");
    assert_eq!(cdr::encode(&again).expect("it was decoded"), once);
}

/// Read a checkpoint.
pub fn checkpoint(bytes: &[u8]) {
    match read_checkpoint(bytes, Path::new("checkpoint.safetensors")) {
        // Its digest is that of its content.
        Ok((learned, scenario)) => assert!(learned.digest().len() == 64 && !scenario.tasks.is_empty()),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// Read a scenario; one that is valid means the same when it is complete.
pub fn scenario(bytes: &[u8]) {
    let text = String::from_utf8_lossy(bytes);
    match Scenario::parse(&text, Path::new("scenario.toml"), &[]) {
        Ok(scenario) => {
            let again = Scenario::parse(&scenario.text, Path::new("scenario.toml"), &[]);
            assert_eq!(again.expect("the complete file is valid"), scenario);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}
