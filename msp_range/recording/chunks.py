"""An MCAP file written chunk by chunk, made for many small messages.

The records are the mcap package's own, but for messages and their index: its `Writer` takes 4.2 us of a desktop's time
for a message and its entry in the index, more than the JSON of the message, and packing them here takes 0.6 us.
Format: https://mcap.dev/spec.
"""

import struct
import zlib
from collections.abc import Sequence
from typing import Protocol

import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"
LIBRARY = "msp-range"
_COMPRESSION = "zstd"
_COMPRESSION_LEVEL = 1
"""With the few kilobytes of a second of flight a higher level takes longer and saves nothing."""
_MESSAGE = struct.Struct("<BQHIQQ")
"""Opcode, length of the rest, channel, sequence, log time [ns], publish time [ns]; then the message."""
_MESSAGE_OPCODE = int(Opcode.MESSAGE)
_MESSAGE_HEAD_BYTES = _MESSAGE.size - 9
_INDEX = struct.Struct("<BQHI")
"""Opcode, length of the rest, channel, length of the entries."""
_INDEX_ENTRY = struct.Struct("<QQ")
"""Log time [ns], offset in the chunk."""
_FOOTER_BEFORE_CRC = struct.Struct("<BQQQ")


class Sink(Protocol):
    """Where the bytes go."""

    def write(self, data: bytes) -> object:
        """Take ``data`` behind what was written before."""
        ...


class ChunkWriter:
    """Writes one file; what is not in a finished chunk is lost with it.

    Parameters
    ----------
    sink
        Takes the bytes, from the file's first to its last.
    """

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._position = 0
        self._chunk = bytearray()
        self._times_ns: list[int] = []
        self._entries: dict[int, bytearray] = {}
        self._compress = zstandard.ZstdCompressor(level=_COMPRESSION_LEVEL).compress
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._counts: dict[int, int] = {}
        self._write(MAGIC + _bytes(Header(profile="", library=LIBRARY)))

    def add_metadata(self, name: str, metadata: dict[str, str]) -> None:
        """Write name and value pairs, at once and outside of a chunk."""
        offset, length = self._write(_bytes(Metadata(name=name, metadata=metadata)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, time_ns: int, data: bytes) -> None:
        """Write a file, at once and outside of a chunk."""
        record = Attachment(create_time=time_ns, log_time=time_ns, name=name, media_type=media_type, data=data)
        offset, length = self._write(_bytes(record))
        index = AttachmentIndex(
            offset=offset,
            length=length,
            log_time=time_ns,
            create_time=time_ns,
            data_size=len(data),
            name=name,
            media_type=media_type,
        )
        self._attachments.append(index)

    def add_schema(self, name: str, data: bytes) -> int:
        """Add a JSON schema; returns its id."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding="jsonschema", data=data)
        self._schemas.append(schema)
        self._chunk += _bytes(schema)
        return schema.id

    def add_channel(self, topic: str, schema_id: int) -> int:
        """Add a channel of JSON messages; returns its id."""
        channel = Channel(
            id=len(self._channels) + 1, topic=topic, message_encoding="json", schema_id=schema_id, metadata={}
        )
        self._channels.append(channel)
        self._entries[channel.id] = bytearray()
        self._counts[channel.id] = 0
        self._chunk += _bytes(channel)
        return channel.id

    def add_message(self, channel_id: int, time_ns: int, data: bytes) -> None:
        """Add a message to the chunk in progress."""
        chunk = self._chunk
        self._times_ns.append(time_ns)
        self._entries[channel_id] += _INDEX_ENTRY.pack(time_ns, len(chunk))
        chunk += _MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE_HEAD_BYTES + len(data), channel_id, 0, time_ns, time_ns)
        chunk += data

    def finish_chunk(self) -> None:
        """Write the chunk in progress, unless it has no messages."""
        if not self._times_ns:
            return
        content = bytes(self._chunk)
        chunk = Chunk(
            compression=_COMPRESSION,
            data=self._compress(content),
            message_start_time=min(self._times_ns),
            message_end_time=max(self._times_ns),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        offset, length = self._write(_bytes(chunk))
        index = bytearray()
        index_offsets = {}
        for channel_id, entries in self._entries.items():
            if entries:
                index_offsets[channel_id] = self._position + len(index)
                index += _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel_id, len(entries)) + entries
                self._counts[channel_id] += len(entries) // _INDEX_ENTRY.size
                entries.clear()
        self._write(bytes(index))
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=offset,
                chunk_length=length,
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                message_index_offsets=index_offsets,
                message_index_length=len(index),
                compression=_COMPRESSION,
                compressed_size=len(chunk.data),
                uncompressed_size=len(content),
            )
        )
        self._chunk.clear()
        self._times_ns.clear()

    def finish(self) -> None:
        """Write the last chunk, and the summary with which other tools find their way."""
        self.finish_chunk()
        self._write(_bytes(DataEnd(data_section_crc=0)))
        summary = bytearray()
        offsets = bytearray()
        groups: list[tuple[Opcode, Sequence[McapRecord]]] = [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]
        for opcode, records in groups:
            group = b"".join(_bytes(record) for record in records)
            if group:
                start = self._position + len(summary)
                offsets += _bytes(SummaryOffset(group_opcode=opcode, group_start=start, group_length=len(group)))
                summary += group
        offsets_start = self._position + len(summary)
        footer = _FOOTER_BEFORE_CRC.pack(Opcode.FOOTER, 20, self._position, offsets_start)
        crc = zlib.crc32(summary + offsets + footer)
        footer_record = Footer(summary_start=self._position, summary_offset_start=offsets_start, summary_crc=crc)
        self._write(bytes(summary + offsets) + _bytes(footer_record) + MAGIC)

    def _statistics(self) -> Statistics:
        return Statistics(
            message_count=sum(self._counts.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=len(self._attachments),
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_start_time=min((each.message_start_time for each in self._chunks), default=0),
            message_end_time=max((each.message_end_time for each in self._chunks), default=0),
            channel_message_counts=self._counts,
        )

    def _write(self, data: bytes) -> tuple[int, int]:
        """Write ``data``; returns where it begins and its length."""
        offset = self._position
        self._sink.write(data)
        self._position += len(data)
        return offset, len(data)


def _bytes(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data
