#!/usr/bin/env python3
"""Open a log with other people's readers and print what they see, as JSON.

    read_log.py FILE [--messages N]

FILE is read twice: with rosbags, and with mcap + mcap-ros2-support. Both decode every message of
every topic by the definitions in the file. For each topic the number of messages and the fields of
the first N messages are printed (N = 3 by default; negative for all). Numbers that JSON does not
have (infinite, not a number) become null; a field `data` of an image also gives `data_mean`.
For a type that ROS 2 itself defines, `as_in_ros2` says whether FILE defines it alike (RIHS01 hash).

Exit codes: 0 both readers read everything; 1 a reader failed; 3 a package is not installed.
"""

import argparse
import dataclasses
import json
import math
import sys
from pathlib import Path

try:
    import mcap.reader
    import mcap_ros2.decoder
    import rosbags.highlevel
    import rosbags.typesys
except ImportError as missing:
    print(f"{missing} (pip install rosbags mcap mcap-ros2-support)", file=sys.stderr)
    sys.exit(3)


def plain(value):
    """A decoded value as numbers, texts, lists and dictionaries."""
    if isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, (bytes, bytearray, memoryview)):
        return list(bytes(value))
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if dataclasses.is_dataclass(value):  # rosbags
        # Its generated classes list a definition's constants as fields, told by their type only.
        fields = dataclasses.fields(value)
        names = [field.name for field in fields if not str(field.type).startswith("ClassVar")]
    else:  # mcap-ros2-support
        names = value.__slots__
    fields = {name: plain(getattr(value, name)) for name in names}
    if "encoding" in fields and fields.get("data"):
        fields["data_mean"] = sum(fields["data"]) / len(fields["data"])
    return fields


class Topics:
    """What one reader saw."""

    def __init__(self, keep):
        self.keep = keep
        self.topics = {}

    def declare(self, topic, message_type):
        self.topics.setdefault(topic, {"type": message_type, "count": 0, "messages": []})

    def add(self, topic, stamp_ns, message):
        entry = self.topics[topic]
        entry["count"] += 1
        if self.keep < 0 or len(entry["messages"]) < self.keep:
            entry["messages"].append({"stamp_ns": stamp_ns, "fields": plain(message)})


def read_with_rosbags(path, keep):
    seen = Topics(keep)
    ros2 = rosbags.typesys.get_typestore(rosbags.typesys.Stores.LATEST)
    with rosbags.highlevel.AnyReader([path]) as reader:
        for connection in reader.connections:
            name = connection.msgtype
            seen.declare(connection.topic, name)
            if name in ros2.types:
                same = reader.typestore.hash_rihs01(name) == ros2.hash_rihs01(name)
                seen.topics[connection.topic]["as_in_ros2"] = same
        for connection, stamp_ns, raw in reader.messages():
            seen.add(connection.topic, stamp_ns, reader.deserialize(raw, connection.msgtype))
    return {"topics": seen.topics}


def read_with_mcap(path, keep):
    seen = Topics(keep)
    with path.open("rb") as file:
        reader = mcap.reader.make_reader(
            file, decoder_factories=[mcap_ros2.decoder.DecoderFactory()], validate_crcs=True
        )
        summary = reader.get_summary()
        for channel in summary.channels.values():
            seen.declare(channel.topic, summary.schemas[channel.schema_id].name)
        for _schema, channel, record, message in reader.iter_decoded_messages():
            seen.add(channel.topic, record.log_time, message)
        header = reader.get_header()
        return {
            "topics": seen.topics,
            "profile": header.profile,
            "library": header.library,
            "metadata": {record.name: record.metadata for record in reader.iter_metadata()},
            "attachments": [
                {"name": item.name, "media_type": item.media_type, "bytes": len(item.data)}
                for item in reader.iter_attachments()
            ],
        }


def main():
    parser = argparse.ArgumentParser(description="Open a log with rosbags and mcap-ros2-support.")
    parser.add_argument("file", type=Path)
    parser.add_argument("--messages", type=int, default=3, metavar="N")
    arguments = parser.parse_args()
    result = {
        "rosbags": read_with_rosbags(arguments.file, arguments.messages),
        "mcap_ros2": read_with_mcap(arguments.file, arguments.messages),
    }
    json.dump(result, sys.stdout, allow_nan=False)
    print()


if __name__ == "__main__":
    main()
