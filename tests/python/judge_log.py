#!/usr/bin/env python3
"""Judge logs as other people's tools do.

    judge_log.py FILE...

Each FILE must satisfy all of them:
- rosbags, and mcap + mcap-ros2-support: every message of every topic is decoded by the definitions in the file.
- the rules of `mcap doctor`: kinds and order of records, every reference to another record, times, sizes, offsets,
  checksums and counts (here once more, since that tool is not in a package registry).
- rerun: `rerun mcap check` finds nothing, `rerun mcap convert` writes a recording without a warning about the file.

Exit codes: 0 all are satisfied; 1 one is not, told on stderr; 3 a package is not installed.
"""

import io
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

try:
    import mcap.reader
    import mcap_ros2.decoder
    import rosbags.highlevel
    from mcap import opcode, records
    from mcap.data_stream import ReadDataStream
    from mcap.stream_reader import breakup_chunk
except ImportError as missing:
    print(f"{missing} (pip install rosbags mcap mcap-ros2-support rerun-sdk)", file=sys.stderr)
    sys.exit(3)

RERUN = Path(sys.executable).parent / "rerun"
MAGIC = b"\x89MCAP0\r\n"


def demand(holds, what):
    if not holds:
        raise ValueError(what)


def rosbags_reads(path):
    with rosbags.highlevel.AnyReader([path]) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


def mcap_ros2_reads(path):
    with path.open("rb") as file:
        reader = mcap.reader.make_reader(
            file, decoder_factories=[mcap_ros2.decoder.DecoderFactory()], validate_crcs=True
        )
        statistics = reader.get_summary().statistics
        count = sum(1 for _ in reader.iter_decoded_messages())
        demand(count == statistics.message_count, f"{count} of {statistics.message_count} messages are read")


def framed(data):
    """Place, kind and body of each record."""
    demand(data.startswith(MAGIC) and data.endswith(MAGIC), "magic bytes at both ends")
    at, end = len(MAGIC), len(data) - len(MAGIC)
    while at < end:
        demand(at + 9 <= end, f"a whole record at {at}")
        kind, length = struct.unpack_from("<BQ", data, at)
        demand(at + 9 + length <= end, f"the record at {at} ends within the file")
        yield at, kind, data[at + 9 : at + 9 + length]
        at += 9 + length


def parsed(kind, body):
    reader = {
        opcode.Opcode.HEADER: records.Header,
        opcode.Opcode.FOOTER: records.Footer,
        opcode.Opcode.SCHEMA: records.Schema,
        opcode.Opcode.CHANNEL: records.Channel,
        opcode.Opcode.CHUNK: records.Chunk,
        opcode.Opcode.MESSAGE_INDEX: records.MessageIndex,
        opcode.Opcode.CHUNK_INDEX: records.ChunkIndex,
        opcode.Opcode.ATTACHMENT: records.Attachment,
        opcode.Opcode.ATTACHMENT_INDEX: records.AttachmentIndex,
        opcode.Opcode.STATISTICS: records.Statistics,
        opcode.Opcode.METADATA: records.Metadata,
        opcode.Opcode.METADATA_INDEX: records.MetadataIndex,
        opcode.Opcode.SUMMARY_OFFSET: records.SummaryOffset,
        opcode.Opcode.DATA_END: records.DataEnd,
    }.get(kind)
    return reader and reader.read(ReadDataStream(io.BytesIO(body)))


class Doctor:
    """The rules of `mcap doctor` on one file."""

    def __init__(self, data):
        self.data = data
        self.schemas, self.channels = {}, {}
        self.messages, self.latest = {}, {}
        self.times = []
        self.chunks, self.attachments, self.metadata = {}, {}, {}
        self.indexed = {"chunks": set(), "attachments": set(), "metadata": set()}
        self.open_chunk = None
        self.statistics = None

    def examine(self):
        places = list(framed(self.data))
        demand(places[0][1] == opcode.Opcode.HEADER, "the first record is the header")
        demand(places[-1][1] == opcode.Opcode.FOOTER, "the last record is the footer")
        ends = [at for at, kind, _ in places if kind == opcode.Opcode.DATA_END]
        demand(len(ends) == 1, "one end of data")
        for at, kind, body in places:
            record = parsed(kind, body)
            demand(record is not None, f"a known kind of record at {at}, not {kind}")
            self.visit(at, record, len(body) + 9, at < ends[0], at == places[0][0])
        self.in_the_end(ends[0], places)

    def visit(self, at, record, length, in_data, first):
        name = type(record).__name__
        if name == "Header":
            demand(first, "one header")
            demand(record.library != "" and record.profile == "ros2", "library and profile are named")
        elif name == "Schema":
            self.schema(record)
        elif name == "Channel":
            self.channel(record)
        elif name == "Chunk":
            demand(in_data, "chunks stand before the end of data")
            self.chunk(at, record, length)
        elif name == "MessageIndex":
            demand(self.open_chunk is not None, "message indices follow their chunk")
            times = self.open_chunk["times"].get(record.channel_id)
            demand(times is not None, f"channel {record.channel_id} has messages in the chunk")
            demand(sorted(record.records) == sorted(times), f"index of channel {record.channel_id} lists its messages")
            self.open_chunk["indices"][record.channel_id] = at
        elif name == "Attachment":
            end = at + length
            crc = struct.unpack("<I", self.data[end - 4 : end])[0]
            demand(crc in (0, zlib.crc32(self.data[at + 9 : end - 4])), f"checksum of attachment {record.name}")
            self.attachments[at] = (record, length)
        elif name == "Metadata":
            self.metadata[at] = (record, length)
        elif name == "ChunkIndex":
            demand(not in_data, "indices stand after the end of data")
            self.chunk_index(record)
        elif name == "AttachmentIndex":
            found = self.attachments.get(record.offset)
            demand(found is not None, f"an attachment at {record.offset}")
            theirs = (found[0].name, found[0].media_type, found[0].log_time, len(found[0].data), found[1])
            ours = (record.name, record.media_type, record.log_time, record.data_size, record.length)
            demand(ours == theirs, f"index of attachment {record.name}")
            self.indexed["attachments"].add(record.offset)
        elif name == "MetadataIndex":
            found = self.metadata.get(record.offset)
            demand(found is not None and (found[0].name, found[1]) == (record.name, record.length), "index of metadata")
            self.indexed["metadata"].add(record.offset)
        elif name == "Statistics":
            demand(self.statistics is None, "one record of statistics")
            self.statistics = record
        if name not in ("Chunk", "MessageIndex"):
            self.close_chunk()

    def schema(self, record):
        demand(record.id != 0, "no schema has the number 0")
        demand(record.name != "" and record.encoding != "" and record.data, f"schema {record.id} says what it is")
        demand(self.schemas.setdefault(record.id, record) == record, f"schema {record.id} is always the same")

    def channel(self, record):
        demand(record.schema_id in self.schemas, f"channel {record.id} has a schema before it")
        demand(record.topic != "" and record.message_encoding == "cdr", f"channel {record.id} says what it is")
        demand(self.channels.setdefault(record.id, record) == record, f"channel {record.id} is always the same")

    def chunk(self, at, record, length):
        self.close_chunk()
        demand(record.compression in ("", "lz4", "zstd"), f"a known compression, not {record.compression}")
        times = {}
        for inner in breakup_chunk(record, validate_crc=True):
            if isinstance(inner, records.Schema):
                self.schema(inner)
            elif isinstance(inner, records.Channel):
                self.channel(inner)
            else:
                demand(inner.channel_id in self.channels, f"a message of the unknown channel {inner.channel_id}")
                self.messages[inner.channel_id] = self.messages.get(inner.channel_id, 0) + 1
                times.setdefault(inner.channel_id, []).append(inner.log_time)
                # Over all channels `mcap doctor` only warns of it: several actors write one log.
                last = self.latest.get(inner.channel_id, 0)
                demand(inner.log_time >= last, f"time goes on in channel {inner.channel_id}, in the chunk at {at}")
                self.latest[inner.channel_id] = inner.log_time
        every = [time for channel in times.values() for time in channel] or [0]
        said = (record.message_start_time, record.message_end_time)
        demand(said == (min(every), max(every)), f"times of the chunk at {at}")
        if any(times.values()):
            self.times += [min(every), max(every)]
        self.open_chunk = {"record": record, "length": length, "at": at, "indices": {}, "times": self.offsets(record)}
        self.chunks[at] = self.open_chunk

    @staticmethod
    def offsets(chunk):
        """Time and offset of each message of a chunk, by channel."""
        plain = records.Chunk(
            compression="", data=uncompressed(chunk), message_end_time=0, message_start_time=0,
            uncompressed_crc=0, uncompressed_size=0,
        ).data
        demand(len(plain) == chunk.uncompressed_size, "size of a chunk before compression")
        found, at = {}, 0
        while at < len(plain):
            kind, length = struct.unpack_from("<BQ", plain, at)
            if kind == opcode.Opcode.MESSAGE:
                channel, _, time = struct.unpack_from("<HIQ", plain, at + 9)
                found.setdefault(channel, []).append((time, at))
            at += 9 + length
        return found

    def close_chunk(self):
        if self.open_chunk is not None:
            missing = set(self.open_chunk["times"]) - set(self.open_chunk["indices"])
            demand(not missing, f"message indices of channels {missing}")
            self.open_chunk = None

    def chunk_index(self, record):
        chunk = self.chunks.get(record.chunk_start_offset)
        demand(chunk is not None, f"a chunk at {record.chunk_start_offset}")
        of = chunk["record"]
        theirs = (of.message_start_time, of.message_end_time, of.compression, of.uncompressed_size, len(of.data))
        ours = (
            record.message_start_time, record.message_end_time, record.compression,
            record.uncompressed_size, record.compressed_size,
        )
        demand(ours == theirs and record.chunk_length == chunk["length"], f"index of the chunk at {chunk['at']}")
        demand(record.message_index_offsets == chunk["indices"], f"message indices of the chunk at {chunk['at']}")
        self.indexed["chunks"].add(record.chunk_start_offset)

    def in_the_end(self, data_end, places):
        for kind, all_of in (("chunks", self.chunks), ("attachments", self.attachments), ("metadata", self.metadata)):
            demand(self.indexed[kind] == set(all_of), f"all {kind} are in the index")
        said = self.statistics
        demand(said is not None, "statistics")
        counts = (said.message_count, said.schema_count, said.channel_count, said.chunk_count)
        found = (sum(self.messages.values()), len(self.schemas), len(self.channels), len(self.chunks))
        demand(counts == found, f"statistics: messages, schemas, channels, chunks {counts}, found {found}")
        counts = (said.attachment_count, said.metadata_count)
        found = (len(self.attachments), len(self.metadata))
        demand(counts == found, f"statistics: attachments, metadata {counts}, found {found}")
        by_channel = {channel: count for channel, count in said.channel_message_counts.items() if count > 0}
        demand(by_channel == self.messages, "statistics: messages by channel")
        if self.times:
            demand((said.message_start_time, said.message_end_time) == (min(self.times), max(self.times)), "their times")
        at, _, body = places[-1]
        footer = parsed(opcode.Opcode.FOOTER, body)
        summary = data_end + 9 + 4
        demand(footer.summary_start == summary, f"the summary begins at {summary}")
        checked = self.data[summary : at + 9 + 16]
        demand(footer.summary_crc in (0, zlib.crc32(checked)), "checksum of the summary")
        end = next(body for place, _, body in places if place == data_end)
        crc = struct.unpack("<I", end)[0]
        demand(crc in (0, zlib.crc32(self.data[:data_end])), "checksum of the data")


def uncompressed(chunk):
    if chunk.compression == "zstd":
        import zstandard

        return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=max(1, chunk.uncompressed_size))
    if chunk.compression == "lz4":
        import lz4.frame

        return lz4.frame.decompress(chunk.data)
    return chunk.data


def doctor(path):
    Doctor(path.read_bytes()).examine()


def rerun_reads(path):
    checked = subprocess.run([RERUN, "mcap", "check", "--full", path], capture_output=True, text=True, check=False)
    rows = [line for line in checked.stdout.splitlines() if "/" in line and line.rstrip().endswith("—")]
    bad = [line for line in checked.stdout.splitlines() if line.startswith(("warn", "err"))]
    demand(checked.returncode == 0 and rows and not bad, f"rerun mcap check: {checked.stdout}{checked.stderr}")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.rrd"
        run = subprocess.run(
            [RERUN, "mcap", "convert", path, "-o", out], capture_output=True, text=True, check=False
        )
        told = [line for line in (run.stdout + run.stderr).splitlines() if "WARN" in line or "ERROR" in line]
        # That a path is no name of an entry has nothing to do with the file.
        told = [line for line in told if "Application ID requires migration" not in line]
        demand(run.returncode == 0 and not told and out.stat().st_size > 0, f"rerun mcap convert: {told}{run.stderr}")


def main():
    if not RERUN.exists():
        print(f"no {RERUN} (pip install rerun-sdk)", file=sys.stderr)
        sys.exit(3)
    bad = 0
    for name in sys.argv[1:]:
        for judge in (rosbags_reads, mcap_ros2_reads, doctor, rerun_reads):
            try:
                judge(Path(name))
            except Exception as fault:  # whatever a reader says of a file
                print(f"{name}: {judge.__name__}: {type(fault).__name__}: {fault}", file=sys.stderr)
                bad += 1
    print(f"{len(sys.argv) - 1} logs")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
