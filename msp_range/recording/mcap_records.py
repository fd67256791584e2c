"""The records of an MCAP file, whichever of its bytes are damaged.

A file's whole records are read in their order, and what had to be left out is counted. The unit that a cut or a flipped
bit costs is the chunk (a second of flight), whose checksum is verified; outside of chunks it is the record. After a
damaged place the search for the next record goes on byte by byte. What a record claims of its own size is believed only
within limits, so that no file can ask for more memory or time than its own size is worth. Format:
https://mcap.dev/spec.
"""

import io
import itertools
import os
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, NamedTuple, TypeAlias

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Footer, Header, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

LARGEST_RECORD_BYTES = 16 * 2**20
"""A record or a chunk's content that is larger is left out. Chunks have 4 kB in our recordings and 1 to 4 MB in those
of other programs; recovering one of this size needs six times its memory."""
MOST_EXPANSION = 100
"""Bytes that chunks may have unpacked for each byte of the file. Ours have 10, and zstd makes 10,000 of a bomb."""
FREE_EXPANSION_BYTES = 4 * 2**20
"""Bytes that may be unpacked of the smallest file, in which one chunk can be worth more than `MOST_EXPANSION`: messages
of no content are 130,000, which are read in 0.7 s."""
FARTHEST_SEARCH_BYTES = 16 * 2**20
"""How far behind a damaged place the next record is looked for, in 0.3 s: more is not damaged but another file."""
MOST_TRIES = 100_000
"""Places at which a record could begin that are looked at in a file, 3 us each; in noise there is one in 2^36 bytes."""
LONGEST_CHUNK_S = 3600.0
"""A damaged chunk that claims to hold more than this has its times damaged too [s]."""

_HEAD = struct.Struct("<BQ")
"""What every record begins with: opcode, length of the content."""
_MESSAGE = struct.Struct("<HIQQ")
"""What a message begins with: channel, sequence, log time [ns], publish time [ns]."""
_CHUNK_TIMES = struct.Struct("<QQ")
_TEXT, _LONG = -4, -8
_FORMS: dict[int, tuple[int, ...]] = {
    Opcode.HEADER: (_TEXT, _TEXT),
    Opcode.FOOTER: (20,),
    Opcode.SCHEMA: (2, _TEXT, _TEXT, _TEXT),
    Opcode.CHANNEL: (4, _TEXT, _TEXT, _TEXT),
    Opcode.CHUNK: (28, _TEXT, _LONG),
    Opcode.MESSAGE_INDEX: (2, _TEXT),
    Opcode.CHUNK_INDEX: (32, _TEXT, 8, _TEXT, 16),
    Opcode.ATTACHMENT: (16, _TEXT, _TEXT, _LONG, 4),
    Opcode.ATTACHMENT_INDEX: (40, _TEXT, _TEXT),
    Opcode.STATISTICS: (42, _TEXT),
    Opcode.METADATA: (_TEXT, _TEXT),
    Opcode.METADATA_INDEX: (16, _TEXT),
    Opcode.SUMMARY_OFFSET: (17,),
    Opcode.DATA_END: (4,),
}
"""Lengths of each record's fields [bytes]; -4 and -8 stand for a field whose own length comes first, in 4 or 8 bytes.
That these fill the record's length exactly tells a record from what only looks like one. Messages have no such form."""
_KINDS: dict[int, Any] = {
    Opcode.HEADER: Header,
    Opcode.FOOTER: Footer,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
}
_INDEXES = frozenset(_FORMS) - frozenset(_KINDS) - {Opcode.CHUNK}
"""Records that say where the others are, which no reader here asks."""
_CANDIDATE = re.compile(rb"(?=[\x01-\x0f].{4}\0{4})", re.DOTALL)
"""Where a record of less than 4 GB could begin."""
_PRIVATE = 0x80
"""Opcodes from here on are any program's own."""


class RawMessage(NamedTuple):
    """A message as it is in the file."""

    channel_id: int
    sequence: int
    log_time_ns: int
    publish_time_ns: int
    data: bytes


Record: TypeAlias = Header | Schema | Channel | RawMessage | Metadata | Attachment | Footer


@dataclass
class Losses:
    """What of a file could not be used; its text is for a person."""

    chunks: int = 0
    """Chunks whose checksum was wrong, or that could not be unpacked."""
    seconds: float = 0.0
    """How long those chunks were, by their own account [s]."""
    records: int = 0
    """Other records that were damaged, too large or of an unknown kind."""
    messages: int = 0
    """Messages of a damaged topic, or that are not what their topic holds."""
    skipped_bytes: int = 0
    """Bytes between two records that belong to none."""
    tail_bytes: int = 0
    """Bytes behind the last whole record, where the end of the file is missing."""

    def __bool__(self) -> bool:
        return self != Losses()

    def __str__(self) -> str:
        parts = [
            (self.chunks, f"{_counted(self.chunks, 'damaged chunk')} ({self.seconds:.1f} s)"),
            (self.records, _counted(self.records, "damaged or unknown record")),
            (self.messages, f"{_counted(self.messages, 'message')} that cannot be read"),
            (self.skipped_bytes, f"{_counted(self.skipped_bytes, 'byte')} between records"),
            (self.tail_bytes, f"the last {_counted(self.tail_bytes, 'byte')}, where the file was cut"),
        ]
        return ", ".join(text for count, text in parts if count) or "nothing"


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def read_records(file: BinaryIO, losses: Losses) -> Iterator[Record]:
    """Every record that is whole, chunks taken apart, in the order of the file.

    Schemas and channels of the summary at the end come first: they stand in for those of a damaged chunk.

    Parameters
    ----------
    file
        An MCAP file.
    losses
        What is left out is counted here.
    """
    yield from _summary(file)
    may_unpack_bytes = FREE_EXPANSION_BYTES
    has_chunks = False
    for opcode, position, length in whole_records(file, losses):
        may_unpack_bytes += MOST_EXPANSION * length
        if opcode == Opcode.CHUNK:
            has_chunks = True
            data = _unpacked(_content(file, position, length), may_unpack_bytes)
            if data is None:
                start_ns, end_ns = _CHUNK_TIMES.unpack(os.pread(file.fileno(), _CHUNK_TIMES.size, position))
                duration_s = (end_ns - start_ns) / 1e9
                losses.chunks += 1
                losses.seconds += duration_s if 0.0 <= duration_s <= LONGEST_CHUNK_S else 0.0
            else:
                may_unpack_bytes -= len(data)
                yield from _records_in(data, losses)
        elif opcode not in _INDEXES:
            record = read_record(file, opcode, position, length)
            # No program writes messages into chunks and outside of them: this is another record, damaged.
            if record is None or (has_chunks and opcode == Opcode.MESSAGE):
                losses.records += 1
            else:
                yield record


def read_record(file: BinaryIO, opcode: int, position: int, length: int) -> Record | None:
    """A record outside of chunks; None where it is damaged, too large or of an unknown kind."""
    return _parsed(opcode, _content(file, position, length))


def _content(file: BinaryIO, position: int, length: int) -> bytes:
    return os.pread(file.fileno(), length, position) if length <= LARGEST_RECORD_BYTES else b""


def _parsed(opcode: int, content: bytes) -> Record | None:
    try:
        if opcode == Opcode.MESSAGE:
            channel_id, sequence, log_time_ns, publish_time_ns = _MESSAGE.unpack_from(content)
            return RawMessage(channel_id, sequence, log_time_ns, publish_time_ns, content[_MESSAGE.size :])
        checksum = int.from_bytes(content[-4:], "little")
        if opcode not in _KINDS or (opcode == Opcode.ATTACHMENT and checksum not in (0, zlib.crc32(content[:-4]))):
            return None
        record: Record = _KINDS[opcode].read(ReadDataStream(io.BytesIO(content)))
        return record
    except (McapError, ValueError, struct.error):
        return None


def _unpacked(content: bytes, most_bytes: int) -> bytes | None:
    """What a chunk holds; None where it is damaged, or more than it may be."""
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(content)))
        size = chunk.uncompressed_size
        if size > min(most_bytes, LARGEST_RECORD_BYTES):
            return None
        # One byte more than there should be shows a chunk that goes on.
        if chunk.compression == "zstd":
            unpacker = zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD_BYTES)
            with unpacker.stream_reader(chunk.data) as stream:
                data: bytes | None = stream.read(size + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
        else:
            data = chunk.data if chunk.compression == "" else None
    except (McapError, ValueError, struct.error, zstandard.ZstdError, RuntimeError):
        return None
    if data is None or len(data) != size or chunk.uncompressed_crc not in (0, zlib.crc32(data)):
        return None
    return data


def _records_in(data: bytes, losses: Losses) -> Iterator[Record]:
    position = 0
    while position + _HEAD.size <= len(data):
        opcode, length = _HEAD.unpack_from(data, position)
        position += _HEAD.size
        content = data[position : position + length]
        position += length
        record = _parsed(opcode, content) if len(content) == length else None
        if record is None:
            # The checksum is right, so the chunk was made like this, and what follows is no more to be believed.
            losses.records += 1
            return
        yield record


def whole_records(file: BinaryIO, losses: Losses) -> Iterator[tuple[int, int, int]]:
    """(opcode, position of the content, its length) of every record outside of chunks that is whole, to the footer."""
    size = os.fstat(file.fileno()).st_size
    position = len(MCAP0_MAGIC)
    tries = itertools.count()
    while True:
        found = _record_at(file, position, size)
        if found is None:
            begin = _next_record(file, position + 1, size, tries)
            if begin is None:
                losses.tail_bytes += max(0, size - position)
                return
            losses.skipped_bytes += begin - position
            position = begin
            continue
        opcode, length = found
        yield opcode, position + _HEAD.size, length
        position += _HEAD.size + length
        if opcode == Opcode.FOOTER:
            return


def _record_at(file: BinaryIO, position: int, size: int) -> tuple[int, int] | None:
    """Opcode and length of the record at a position; None where there is none that is whole."""
    head = os.pread(file.fileno(), _HEAD.size, position)
    if len(head) < _HEAD.size:
        return None
    opcode, length = _HEAD.unpack(head)
    if position + _HEAD.size + length > size:
        return None
    if opcode in _FORMS:
        is_whole = _has_form(file, opcode, position + _HEAD.size, length)
    else:
        is_whole = opcode >= _PRIVATE or (opcode == Opcode.MESSAGE and length >= _MESSAGE.size)
    return (opcode, length) if is_whole else None


def _has_form(file: BinaryIO, opcode: int, position: int, length: int) -> bool:
    used = 0
    for part in _FORMS[opcode]:
        if part < 0:
            used += int.from_bytes(os.pread(file.fileno(), -part, position + used), "little")
        used += abs(part)
        if used > length:
            return False
    return used == length


def _next_record(file: BinaryIO, position: int, size: int, tries: Iterator[int]) -> int | None:
    """Where the next record that has its form begins; None where there is none near."""
    last = min(size, position + FARTHEST_SEARCH_BYTES)
    while position < last:
        block = os.pread(file.fileno(), 2**16, position)
        for found in _CANDIDATE.finditer(block):
            begin = position + found.start()
            if next(tries) > MOST_TRIES:
                return None
            if block[found.start()] in _FORMS and _record_at(file, begin, size) is not None:
                return begin
        # A head may lie across the end of the block.
        position += max(1, len(block) - _HEAD.size + 1)
    return None


def _summary(file: BinaryIO) -> Iterator[Schema | Channel]:
    """Schemas and channels that the end of a closed file repeats."""
    begin = os.fstat(file.fileno()).st_size - len(MCAP0_MAGIC) - 20 - _HEAD.size
    if begin < 0 or os.pread(file.fileno(), _HEAD.size, begin) != _HEAD.pack(Opcode.FOOTER, 20):
        return
    position = int.from_bytes(os.pread(file.fileno(), 8, begin + _HEAD.size), "little")
    while 0 < position < begin and (found := _record_at(file, position, begin)) is not None:
        opcode, length = found
        position += _HEAD.size
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            record = read_record(file, opcode, position, length)
            if isinstance(record, Schema | Channel):
                yield record
        position += length
