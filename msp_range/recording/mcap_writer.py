"""Writes an MCAP file for a loop that must not wait: messages are kept as they come, packed and written in chunks.

Channels and messages become chunks compressed with zstandard, indexes and a summary, as Foxglove and the mcap tools
want them. The mcap package's own writer takes seven times as long for a message, some 4 us on a desktop computer, and
keeps an object of 1 kB for every chunk, where the bytes are 0.2 kB. Format: https://mcap.dev/spec.
"""

import zlib
from collections import Counter
from collections.abc import Mapping
from struct import Struct
from typing import Any

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

from msp_range.recording.background_file import BackgroundFile

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 2**20
"""A chunk of this size is ended whoever asks for it: what the mcap package's writer does, and a limit to memory."""
COMPRESSION, COMPRESSION_LEVEL = "zstd", 1
"""zstandard's quickest normal level: half the time of its usual level 3, and 1.5 % more bytes for chunks of 8 kB. LZ4
takes half of that time again, and 1.6 times the bytes."""

_MESSAGE_HEAD, _INDEX_HEAD, _PLACE = Struct("<BQHIQQ"), Struct("<BQHI"), Struct("<QQ")
_HEAD_BYTES = Struct("<BQ").size
"""What every record begins with: opcode, length of what follows."""


class McapWriter:
    """One MCAP file in progress.

    Parameters
    ----------
    file
        Empty; it is not closed here.
    library
        What the header names as the program that wrote it.
    """

    def __init__(self, file: BackgroundFile, library: str) -> None:
        self._file = file
        self._compressor = zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
        self._schemas: dict[str, Schema] = {}
        self._channels: list[Channel] = []
        self._definitions = b""
        """Schemas and channels that are new in the chunk in progress."""
        self._messages: list[tuple[int, int, bytes]] = []
        """Channel, time [ns] and content of each message of the chunk in progress: packed together when it ends."""
        self._messages_bytes = 0
        self._message_counts: Counter[int] = Counter()
        self._first_ns, self._last_ns = 2**64, 0
        self._chunks = 0
        self._chunk_indexes = bytearray()
        self._attachment_indexes: list[AttachmentIndex] = []
        self._metadata_indexes: list[MetadataIndex] = []
        file.write(MAGIC + _packed(Header("", library)))

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write texts by name, under a name for all of them."""
        record = _packed(Metadata(name, dict(entries)))
        self._metadata_indexes.append(MetadataIndex(self._file.tell(), len(record), name))
        self._file.write(record)

    def add_attachment(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write a whole file of another kind."""
        record = _packed(Attachment(time_ns, time_ns, name, media_type, data))
        index = AttachmentIndex(self._file.tell(), len(record), time_ns, time_ns, len(data), name, media_type)
        self._attachment_indexes.append(index)
        self._file.write(record)

    def add_channel(self, topic: str, schema_name: str, schema: bytes) -> int:
        """Begin a topic of JSON messages; the number of its channel. Schemas of one name are one."""
        if schema_name not in self._schemas:
            self._schemas[schema_name] = Schema(len(self._schemas) + 1, schema, "jsonschema", schema_name)
            self._definitions += _packed(self._schemas[schema_name])
        channel = Channel(len(self._channels) + 1, topic, "json", {}, self._schemas[schema_name].id)
        self._channels.append(channel)
        self._definitions += _packed(channel)
        return channel.id

    def add_message(self, channel: int, time_ns: int, data: bytes) -> None:
        """Write one message into the chunk in progress."""
        self._messages.append((channel, time_ns, data))
        self._messages_bytes += _MESSAGE_HEAD.size + len(data)
        if self._messages_bytes > CHUNK_BYTES:
            self._end_chunk()

    def flush(self) -> None:
        """End the chunk in progress, and hand over what was written."""
        self._end_chunk()
        self._file.flush()

    def finish(self) -> None:
        """Write the end of the file: indexes and what readers want to know first."""
        self._end_chunk()
        self._file.write(_packed(DataEnd(0)))
        statistics = Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self._message_counts,
            chunk_count=self._chunks,
            message_count=self._message_counts.total(),
            message_end_time=self._last_ns,
            message_start_time=self._first_ns if self._chunks else 0,
            metadata_count=len(self._metadata_indexes),
            schema_count=len(self._schemas),
        )
        groups: dict[int, bytes | bytearray] = {
            Opcode.SCHEMA: _packed(*self._schemas.values()),
            Opcode.CHANNEL: _packed(*self._channels),
            Opcode.STATISTICS: _packed(statistics),
            Opcode.CHUNK_INDEX: self._chunk_indexes,
            Opcode.ATTACHMENT_INDEX: _packed(*self._attachment_indexes),
            Opcode.METADATA_INDEX: _packed(*self._metadata_indexes),
        }
        start = position = self._file.tell()
        end = b""
        for opcode, group in groups.items():
            if group:
                end += _packed(SummaryOffset(opcode, position, len(group)))
                position += len(group)
        # The last four bytes of a footer are the checksum of all in front of them.
        end += _packed(Footer(start, position, 0))[:-4]
        # One by one: the index of an hour has 1 MB, and what copies of it take the allocator may keep.
        checksum = 0
        for part in (*groups.values(), end):
            self._file.write(part)
            checksum = zlib.crc32(part, checksum)
        self._file.write(checksum.to_bytes(4, "little") + MAGIC)

    def _end_chunk(self) -> None:
        """Write the chunk in progress and the indexes of its messages; one without messages waits for some."""
        if not self._messages:
            return
        content = bytearray(self._definitions)
        fields_bytes = _MESSAGE_HEAD.size - _HEAD_BYTES
        indexes: dict[int, bytearray] = {}  # for each channel, time [ns] and place in the chunk of its messages
        for channel, time_ns, data in self._messages:
            indexes.setdefault(channel, bytearray()).extend(_PLACE.pack(time_ns, len(content)))
            content += _MESSAGE_HEAD.pack(Opcode.MESSAGE, fields_bytes + len(data), channel, 0, time_ns, time_ns)
            content += data
        times_ns = [time_ns for _, time_ns, _ in self._messages]
        chunk = Chunk(
            compression=COMPRESSION,
            data=self._compressor.compress(content),
            message_end_time=max(times_ns),
            message_start_time=min(times_ns),
            uncompressed_crc=zlib.crc32(content),
            uncompressed_size=len(content),
        )
        start, record = self._file.tell(), bytearray(_packed(chunk))
        chunk_length = len(record)
        offsets = {}
        for channel, index in indexes.items():
            self._message_counts[channel] += len(index) // _PLACE.size
            offsets[channel] = start + len(record)
            length = _INDEX_HEAD.size - _HEAD_BYTES + len(index)
            record += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, length, channel, len(index))
            record += index
        self._file.write(record)
        self._chunk_indexes += _packed(
            ChunkIndex(
                chunk_length=chunk_length,
                chunk_start_offset=start,
                compression=COMPRESSION,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=len(record) - chunk_length,
                message_index_offsets=offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        self._first_ns = min(self._first_ns, chunk.message_start_time)
        self._last_ns = max(self._last_ns, chunk.message_end_time)
        self._chunks += 1
        self._definitions, self._messages, self._messages_bytes = b"", [], 0


def _packed(*records: McapRecord) -> bytes:
    builder: Any = RecordBuilder()
    for record in records:
        record.write(builder)
    packed: bytes = builder.end()
    return packed
