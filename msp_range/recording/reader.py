"""Recordings read back, whole or cut anywhere by a power failure.

An MCAP file enters, JSON messages leave in the order in which they were recorded. The unit that a cut leaves whole or
loses is the chunk (a second of flight); its checksum is verified, so that what a dying disk left behind is not taken
for data. Format: https://mcap.dev/spec.
"""

import contextlib
import io
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

import orjson
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, Metadata
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from msp_range.recording.error import RecordingError
from msp_range.recording.writer import METADATA_NAME

_RECORD = struct.Struct("<BQ")
"""What every record begins with: opcode, length of the content."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""What a message begins with: channel, sequence, log time [ns], publish time [ns]."""


class Message(NamedTuple):
    """One recorded message; ``time_s`` is on the bridge's clock, or since 1970 in a file of another program."""

    topic: str
    time_s: float
    message: dict[str, Any]


class Recording:
    """An MCAP file; iterate over it for its `Message` s, as often as you like.

    Channels that are not JSON are passed over.

    Parameters
    ----------
    path
        The file.

    Attributes
    ----------
    cut
        True where the file was not closed: the power failed, or it is still being written.
    damaged_chunks
        How many chunks the last iteration had to leave out because their checksum was wrong.
    files
        The airframe file that was flown, as ``airframe.yaml``, and those that it names; empty where there are none.
    metadata
        What the recorder was given to name the flight.
    profile
        The file's MCAP profile, empty in a recording of the bridge.

    Raises
    ------
    RecordingError
        No such file, or not an MCAP file.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self.cut = True
        self.damaged_chunks = 0
        self.files: dict[str, str] = {}
        self.metadata: dict[str, str] = {}
        self.profile = ""
        with self._open() as file:
            magic = file.read(len(MCAP0_MAGIC))
            if not MCAP0_MAGIC.startswith(magic):
                raise RecordingError(f"{self.path}: not an MCAP recording: it begins with {magic!r}")
            for opcode, length in _whole_records(file):
                # What stands outside of the chunks has no checksum; where it is damaged, the messages still count.
                with contextlib.suppress(McapError, ValueError, struct.error):
                    self._look_at(opcode, length, file)
        self._clock_start_s = float(self.metadata.get("clock_start_s", "0"))
        self._utc_start_ns = int(self.metadata.get("utc_start_ns", "0"))

    def __iter__(self) -> Iterator[Message]:
        topics: dict[int, str] = {}
        for opcode, content in self.records():
            if opcode == Opcode.MESSAGE:
                channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content)
                topic = topics.get(channel_id)
                if topic is not None:
                    time_s = self._clock_start_s + (log_time_ns - self._utc_start_ns) / 1e9
                    yield Message(topic, time_s, self._decode(topic, content[MESSAGE_HEAD.size :]))
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(as_stream(content))
                if channel.message_encoding == "json":
                    topics[channel.id] = channel.topic

    def utc_s(self, time_s: float) -> float:
        """Seconds since 1970 of a time on the bridge's clock, by the computer's idea of UTC at the start."""
        return self._utc_start_ns / 1e9 + (time_s - self._clock_start_s)

    def records(self) -> Iterator[tuple[int, bytes]]:
        """Every whole record of the data section as (opcode, content), chunks taken apart."""
        self.damaged_chunks = 0
        with self._open() as file:
            for opcode, length in _whole_records(file):
                if opcode == Opcode.CHUNK:
                    yield from _records_in(self._unpack(file.read(length)))
                elif opcode == Opcode.DATA_END:
                    return
                else:
                    yield opcode, file.read(length)

    def _open(self) -> IO[bytes]:
        try:
            return self.path.open("rb")
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot be read: {error.strerror}") from None

    def _look_at(self, opcode: int, length: int, file: IO[bytes]) -> None:
        if opcode == Opcode.HEADER:
            self.profile = Header.read(as_stream(file.read(length))).profile
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(as_stream(file.read(length)))
            if metadata.name == METADATA_NAME:
                self.metadata = metadata.metadata
        elif opcode == Opcode.ATTACHMENT:
            attachment = Attachment.read(as_stream(file.read(length)))
            self.files[attachment.name] = attachment.data.decode()
        elif opcode == Opcode.FOOTER:
            file.seek(length, io.SEEK_CUR)
            self.cut = file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC

    def _unpack(self, content: bytes) -> bytes:
        try:
            stream, length = get_chunk_data_stream(Chunk.read(as_stream(content)), validate_crc=True)
            return stream.read(length)
        except Exception:  # every decompressor has its own errors; whatever it says, this chunk is lost
            self.damaged_chunks += 1
            return b""

    def _decode(self, topic: str, text: bytes) -> dict[str, Any]:
        try:
            message = orjson.loads(text)
        except ValueError as error:
            raise RecordingError(f"{self.path}: a message of {topic} is not JSON: {error}") from None
        if not isinstance(message, dict):
            return {"value": message}
        return {key: value for key, value in message.items() if value is not None}


def is_recording(path: Path | str) -> bool:
    """True where the file begins as an MCAP file does.

    Raises
    ------
    RecordingError
        It cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            return file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None


def _whole_records(file: IO[bytes]) -> Iterator[tuple[int, int]]:
    """(opcode, length) of each record that is there to its end, with the file standing at its content.

    It ends at a cut, and where the disk left zeros: no record has opcode 0.
    """
    size = os.fstat(file.fileno()).st_size
    position = len(MCAP0_MAGIC)
    while position + _RECORD.size <= size:
        file.seek(position)
        opcode, length = _RECORD.unpack(file.read(_RECORD.size))
        position += _RECORD.size + length
        if opcode == 0 or position > size:
            return
        yield opcode, length


def _records_in(data: bytes) -> Iterator[tuple[int, bytes]]:
    position = 0
    while position < len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        position += _RECORD.size
        yield opcode, data[position : position + length]
        position += length


def as_stream(content: bytes) -> ReadDataStream:
    """What the mcap package's records are read from."""
    return ReadDataStream(io.BytesIO(content))
