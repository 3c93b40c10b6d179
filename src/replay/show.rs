//! A difference between a recording and its repetition, field by field.

use serde::Serialize;
use serde_json::Value;

use super::Recording;
use crate::log::{Difference, LogError, Record, topics};

/// A difference for people and scripts.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ShownDifference {
    /// The topic.
    pub topic: &'static str,
    /// Number of the message on its topic, from 0.
    pub index: usize,
    /// Its time, nanoseconds.
    pub stamp_ns: u64,
    /// What is different: name of the field, its recorded value, its value now.
    pub fields: Vec<(String, String, String)>,
}

/// Fields that are shown; a matrix may differ in all its values.
const MOST_FIELDS: usize = 8;

/// Find the recorded message of a difference again, and say in which fields it differs.
///
/// # Errors
/// A file that cannot be read any more.
pub fn show(recording: &Recording, difference: &Difference) -> Result<ShownDifference, LogError> {
    let of_topic = |record: Result<Record, LogError>| match record {
        Ok(Record::Message { topic, data, .. }) if *topic == *difference.topic => Some(Ok(data)),
        Err(error @ (LogError::Open { .. } | LogError::Read { .. })) => Some(Err(error)),
        _ => None,
    };
    let mut bodies = recording.records().filter_map(of_topic).enumerate();
    let found = bodies.find(|(index, body)| body.is_err() || *index == difference.index);
    let recorded = found.map(|(_, body)| body).transpose()?;
    let as_json =
        |body: Option<&[u8]>| body.and_then(|body| topics::to_json(difference.topic, body)).unwrap_or_default();
    let (before, now) = (as_json(recorded.as_deref()), as_json(difference.found.as_deref()));
    let mut fields = Vec::new();
    match difference.found {
        None => fields.push(("message".to_owned(), "recorded".to_owned(), "does not come".to_owned())),
        Some(_) => list("", &before, &now, &mut fields),
    }
    fields.truncate(MOST_FIELDS);
    let Difference { topic, index, stamp_ns, .. } = *difference;
    Ok(ShownDifference { topic, index, stamp_ns, fields })
}

fn list(name: &str, before: &Value, now: &Value, fields: &mut Vec<(String, String, String)>) {
    if before == now || fields.len() >= MOST_FIELDS {
        return;
    }
    match (before, now) {
        (Value::Object(a), Value::Object(b)) => {
            for (key, value) in a {
                let inner = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                list(&inner, value, b.get(key).unwrap_or(&Value::Null), fields);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (place, (value, other)) in a.iter().zip(b).enumerate() {
                list(&format!("{name}[{place}]"), value, other, fields);
            }
        }
        _ => fields.push((name.to_owned(), short(before), short(now))),
    }
}

fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= 80 { text } else { text.chars().take(77).chain("...".chars()).collect() }
}
