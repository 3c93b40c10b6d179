//! From the mcap crate's records to those of [`Record`]: which channel is which topic and type.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use mcap::{
    parse_record,
    records::{self, op},
};

use super::{Channel, Record, lengths};
use crate::log::writer::with_sources;

/// The schemas and channels seen so far.
#[derive(Default)]
pub(super) struct Definitions {
    schemas: BTreeMap<u16, Schema>,
    /// The schema of channels without one, whose number is 0.
    none: Schema,
    channels: BTreeMap<u16, Defined>,
    /// What the file says of itself: its profile.
    pub(super) profile: Option<String>,
    /// Channels that messages named but that are not defined; each is complained of once.
    missing: BTreeSet<u16>,
}

#[derive(Default)]
struct Schema {
    name: Arc<str>,
    encoding: String,
    definition: Vec<u8>,
}

struct Defined {
    topic: Arc<str>,
    schema: u16,
    encoding: String,
    metadata: BTreeMap<String, String>,
}

impl Definitions {
    fn schema(&self, id: u16) -> Option<&Schema> {
        if id == 0 { Some(&self.none) } else { self.schemas.get(&id) }
    }

    /// A channel, as the file defines it.
    pub(super) fn channel(&self, id: u16) -> Option<Channel<'_>> {
        let channel = self.channels.get(&id)?;
        let schema = self.schema(channel.schema)?;
        Some(Channel {
            topic: &channel.topic,
            encoding: &channel.encoding,
            metadata: &channel.metadata,
            schema: &schema.name,
            schema_encoding: &schema.encoding,
            definition: &schema.definition,
        })
    }

    /// Takes note of a definition, or returns a record for the user. The error says what is wrong.
    pub(super) fn take(&mut self, kind: u8, body: &[u8]) -> Result<Option<Record>, String> {
        match kind {
            op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA | op::ATTACHMENT => {
                lengths::check(kind, body)?;
            }
            // Indexes and sums: all of it follows from the records themselves.
            _ => return Ok(None),
        }
        match parse_record(kind, body).map_err(|cause| with_sources(&cause))? {
            records::Record::Header(header) => {
                self.profile.get_or_insert(header.profile);
                Ok(None)
            }
            records::Record::Schema { header, data } => {
                let (name, encoding) = (header.name.into(), header.encoding);
                self.schemas.insert(header.id, Schema { name, encoding, definition: data.into_owned() });
                Ok(None)
            }
            records::Record::Channel(channel) => {
                let (topic, schema) = (channel.topic.into(), channel.schema_id);
                let (encoding, metadata) = (channel.message_encoding, channel.metadata);
                self.channels.insert(channel.id, Defined { topic, schema, encoding, metadata });
                Ok(None)
            }
            records::Record::Message { header, data } => self.message(header, data.into_owned()),
            records::Record::Metadata(metadata) => {
                Ok(Some(Record::Metadata { name: metadata.name, map: metadata.metadata }))
            }
            records::Record::Attachment { header, data, .. } => Ok(Some(Record::Attachment {
                name: header.name,
                media_type: header.media_type,
                log_time_ns: header.log_time,
                create_time_ns: header.create_time,
                data: data.into_owned(),
            })),
            _ => Ok(None),
        }
    }

    fn message(&mut self, header: records::MessageHeader, data: Vec<u8>) -> Result<Option<Record>, String> {
        let id = header.channel_id;
        let definition = self.channels.get(&id).and_then(|channel| {
            let schema = self.schema(channel.schema)?;
            Some((Arc::clone(&channel.topic), Arc::clone(&schema.name)))
        });
        match definition {
            Some((topic, schema)) => Ok(Some(Record::Message {
                topic,
                schema,
                channel: id,
                sequence: header.sequence,
                log_time_ns: header.log_time,
                publish_time_ns: header.publish_time,
                data,
            })),
            None if self.missing.insert(id) => {
                Err(format!("a message is on channel {id}, whose definition is missing; its messages are left out"))
            }
            None => Ok(None),
        }
    }
}
