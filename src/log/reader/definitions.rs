//! From the mcap crate's records to those of [`Record`]: which channel is which topic and type.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use mcap::{
    parse_record,
    records::{self, op},
};

use super::{Record, lengths};
use crate::log::writer::with_sources;

/// The schemas and channels seen so far.
#[derive(Default)]
pub(super) struct Definitions {
    schemas: BTreeMap<u16, Arc<str>>,
    /// Topic and schema number of a channel.
    channels: BTreeMap<u16, (Arc<str>, u16)>,
    /// Channels that messages named but that are not defined; each is complained of once.
    missing: BTreeSet<u16>,
}

impl Definitions {
    /// Takes note of a definition, or returns a record for the user. The error says what is wrong.
    pub(super) fn take(&mut self, kind: u8, body: &[u8]) -> Result<Option<Record>, String> {
        match kind {
            op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA | op::ATTACHMENT => {
                lengths::check(kind, body)?;
            }
            // Indexes and sums: all of it follows from the records themselves.
            _ => return Ok(None),
        }
        match parse_record(kind, body).map_err(|cause| with_sources(&cause))? {
            records::Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name.into());
                Ok(None)
            }
            records::Record::Channel(channel) => {
                let entry = (channel.topic.into(), channel.schema_id);
                self.channels.insert(channel.id, entry);
                Ok(None)
            }
            records::Record::Message { header, data } => self.message(header, data.into_owned()),
            records::Record::Metadata(metadata) => {
                Ok(Some(Record::Metadata { name: metadata.name, map: metadata.metadata }))
            }
            records::Record::Attachment { header, data, .. } => Ok(Some(Record::Attachment {
                name: header.name,
                media_type: header.media_type,
                data: data.into_owned(),
            })),
            _ => Ok(None),
        }
    }

    fn message(&mut self, header: records::MessageHeader, data: Vec<u8>) -> Result<Option<Record>, String> {
        let id = header.channel_id;
        let definition = self.channels.get(&id).and_then(|(topic, schema)| {
            let schema = self.schemas.get(schema)?;
            Some((Arc::clone(topic), Arc::clone(schema)))
        });
        match definition {
            Some((topic, schema)) => Ok(Some(Record::Message {
                topic,
                schema,
                sequence: header.sequence,
                log_time_ns: header.log_time,
                data,
            })),
            None if self.missing.insert(id) => {
                Err(format!("a message is on channel {id}, whose definition is missing; its messages are left out"))
            }
            None => Ok(None),
        }
    }
}
