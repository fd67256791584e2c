"""Writes an MCAP file for a loop that must not wait: messages are kept as they come, packed and written in chunks.

Channels and messages enter, bytes leave to a file: chunks compressed with zstandard, indexes and a summary, as Foxglove
and the mcap tools want them. The mcap package's own writer takes seven times as long for a message, some 4 us on a
desktop computer, and keeps an object of 1 kB for every chunk, where the bytes are 0.2 kB. Format: https://mcap.dev/spec.
"""

import zlib
from collections.abc import Iterable, Mapping
from struct import Struct

import zstandard

from msp_range.recording.background_file import BackgroundFile

MAGIC = b"\x89MCAP0\r\n"
CHUNK_BYTES = 2**20
"""A chunk of this size is ended whoever asks for it: what the mcap package's writer does, and a limit to memory."""
COMPRESSION, COMPRESSION_LEVEL = "zstd", 1
"""zstandard's quickest normal level: half the time of its usual level 3, and 1.5 % more bytes for chunks of 8 kB. LZ4
takes half of that time again, and 1.6 times the bytes."""

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX, _CHUNK_INDEX = range(0x01, 0x09)
_ATTACHMENT, _ATTACHMENT_INDEX, _STATISTICS, _METADATA, _METADATA_INDEX, _SUMMARY_OFFSET, _DATA_END = range(0x09, 0x10)

_HEAD = Struct("<BQ")
_MESSAGE_HEAD = Struct("<BQHIQQ")
_INDEX_HEAD = Struct("<BQHI")
_MESSAGE_FIELD_BYTES, _INDEX_FIELD_BYTES = _MESSAGE_HEAD.size - _HEAD.size, _INDEX_HEAD.size - _HEAD.size
_U16, _U32, _U64, _TWO_U64, _COUNT = Struct("<H"), Struct("<I"), Struct("<Q"), Struct("<QQ"), Struct("<HQ")
_CHUNK_FIELDS, _CHUNK_INDEX_FIELDS, _FOOTER_FIELDS = Struct("<QQQI"), Struct("<QQQQ"), Struct("<QQI")
_ATTACHMENT_INDEX_FIELDS, _STATISTICS_FIELDS, _OFFSET_FIELDS = Struct("<QQQQQ"), Struct("<QHIIIIQQ"), Struct("<BQQ")


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
        self._schemas: dict[str, bytes] = {}
        self._channels: list[bytes] = []
        self._definitions = b""
        """Schemas and channels that are new in the chunk in progress."""
        self._messages: list[tuple[int, int, bytes]] = []
        """Channel, time [ns] and content of each message of the chunk in progress: packed together when it ends."""
        self._messages_bytes = 0
        self._message_counts: dict[int, int] = {}
        self._first_ns, self._last_ns = 2**64, 0
        self._chunks = 0
        self._chunk_indexes = bytearray()
        self._attachment_indexes: list[bytes] = []
        self._metadata_indexes: list[bytes] = []
        file.write(MAGIC + _record(_HEADER, _text("") + _text(library)))

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write texts by name, under a name for all of them."""
        record = _record(_METADATA, _text(name) + _block(_text(key) + _text(text) for key, text in entries.items()))
        place = _TWO_U64.pack(self._file.tell(), len(record))
        self._metadata_indexes.append(_record(_METADATA_INDEX, place + _text(name)))
        self._file.write(record)

    def add_attachment(self, time_ns: int, name: str, media_type: str, data: bytes) -> None:
        """Write a whole file of another kind."""
        what = _text(name) + _text(media_type)
        content = _TWO_U64.pack(time_ns, time_ns) + what + _U64.pack(len(data)) + data
        record = _record(_ATTACHMENT, content + _U32.pack(zlib.crc32(content)))
        fields = _ATTACHMENT_INDEX_FIELDS.pack(self._file.tell(), len(record), time_ns, time_ns, len(data))
        self._attachment_indexes.append(_record(_ATTACHMENT_INDEX, fields + what))
        self._file.write(record)

    def add_channel(self, topic: str, schema_name: str, schema: bytes) -> int:
        """Begin a topic of JSON messages; the number of its channel. Schemas of one name are one."""
        if schema_name not in self._schemas:
            number = _U16.pack(len(self._schemas) + 1)
            what = _text(schema_name) + _text("jsonschema") + _U32.pack(len(schema)) + schema
            self._schemas[schema_name] = _record(_SCHEMA, number + what)
            self._definitions += self._schemas[schema_name]
        channel = len(self._channels) + 1
        of_schema = list(self._schemas).index(schema_name) + 1
        what = _U16.pack(channel) + _U16.pack(of_schema) + _text(topic) + _text("json") + _block([])
        self._channels.append(_record(_CHANNEL, what))
        self._definitions += self._channels[-1]
        return channel

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
        self._file.write(_record(_DATA_END, _U32.pack(0)))
        start = position = self._file.tell()
        groups: dict[int, bytes | bytearray] = {
            _SCHEMA: b"".join(self._schemas.values()),
            _CHANNEL: b"".join(self._channels),
            _STATISTICS: _record(_STATISTICS, self._statistics()),
            _CHUNK_INDEX: self._chunk_indexes,
            _ATTACHMENT_INDEX: b"".join(self._attachment_indexes),
            _METADATA_INDEX: b"".join(self._metadata_indexes),
        }
        end = b""
        for opcode, group in groups.items():
            if group:
                end += _record(_SUMMARY_OFFSET, _OFFSET_FIELDS.pack(opcode, position, len(group)))
                position += len(group)
        end += _HEAD.pack(_FOOTER, _FOOTER_FIELDS.size) + _TWO_U64.pack(start, position)
        # One by one: the index of an hour has 1 MB, and what copies of it take the allocator may keep.
        checksum = 0
        for part in (*groups.values(), end):
            self._file.write(part)
            checksum = zlib.crc32(part, checksum)
        self._file.write(_U32.pack(checksum) + MAGIC)

    def _end_chunk(self) -> None:
        """Write the chunk in progress and the indexes of its messages; one without messages waits for some."""
        if not self._messages:
            return
        content = bytearray(self._definitions)
        indexes: dict[int, bytearray] = {}  # for each channel, time [ns] and place in the chunk of its messages
        for channel, time_ns, data in self._messages:
            indexes.setdefault(channel, bytearray()).extend(_TWO_U64.pack(time_ns, len(content)))
            content += _MESSAGE_HEAD.pack(_MESSAGE, _MESSAGE_FIELD_BYTES + len(data), channel, 0, time_ns, time_ns)
            content += data
        times_ns = [time_ns for _, time_ns, _ in self._messages]
        first_ns, last_ns = min(times_ns), max(times_ns)
        packed = self._compressor.compress(content)
        checksum = zlib.crc32(content)
        fields = _CHUNK_FIELDS.pack(first_ns, last_ns, len(content), checksum) + _text(COMPRESSION)
        chunk = _record(_CHUNK, fields + _U64.pack(len(packed)) + packed)
        start = self._file.tell()
        parts, index_places = [chunk], []
        end = start + len(chunk)
        for channel, index in indexes.items():
            index_places.append(_COUNT.pack(channel, end))
            head = _INDEX_HEAD.pack(_MESSAGE_INDEX, _INDEX_FIELD_BYTES + len(index), channel, len(index))
            parts.append(head + index)
            end += len(parts[-1])
            count = len(index) // _TWO_U64.size
            self._message_counts[channel] = self._message_counts.get(channel, 0) + count
        self._file.write(b"".join(parts))
        self._chunk_indexes += _record(
            _CHUNK_INDEX,
            _CHUNK_INDEX_FIELDS.pack(first_ns, last_ns, start, len(chunk))
            + _block(index_places)
            + _U64.pack(end - start - len(chunk))
            + _text(COMPRESSION)
            + _TWO_U64.pack(len(packed), len(content)),
        )
        self._first_ns, self._last_ns = min(self._first_ns, first_ns), max(self._last_ns, last_ns)
        self._chunks += 1
        self._definitions, self._messages, self._messages_bytes = b"", [], 0

    def _statistics(self) -> bytes:
        return _STATISTICS_FIELDS.pack(
            sum(self._message_counts.values()),
            len(self._schemas),
            len(self._channels),
            len(self._attachment_indexes),
            len(self._metadata_indexes),
            self._chunks,
            self._first_ns if self._chunks else 0,
            self._last_ns,
        ) + _block(_COUNT.pack(channel, count) for channel, count in self._message_counts.items())


def _record(opcode: int, content: bytes) -> bytes:
    return _HEAD.pack(opcode, len(content)) + content


def _text(text: str) -> bytes:
    data = text.encode()
    return _U32.pack(len(data)) + data


def _block(parts: Iterable[bytes | bytearray]) -> bytes:
    """Parts with the bytes of all of them in front."""
    data = b"".join(parts)
    return _U32.pack(len(data)) + data
