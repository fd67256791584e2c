"""Recordings read back, whole or cut anywhere by a power failure, damaged or made by somebody who means harm.

JSON messages of an MCAP file are read in the order in which they were recorded. Which records of a damaged file are
whole is decided in `msp_range.recording.mcap_records`; here a message that is not what its topic holds is left out and
counted as well, so that whoever reads them can rely on the types of `msp_range.recording.topics`.
"""

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import orjson
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata
from mcap.writer import MCAP0_MAGIC

from msp_range.input_file import CONTROL, open_input
from msp_range.recording.error import RecordingError
from msp_range.recording.mcap_records import Losses, RawMessage, Record, read_record, read_records, whole_records
from msp_range.recording.topics import LARGEST_TIME_S, LONGEST_TOPIC, Message, Topic, read_back
from msp_range.recording.writer import METADATA_NAME

LARGEST_FILE_BYTES = 2**40
"""Recordings are read piece by piece, so this only keeps out what is no file of a disk."""
MOST_ATTACHED_BYTES = 4 * 2**20
"""Attached files that are kept, all together: an airframe and its models have 10 kB."""
_KEPT = frozenset({Opcode.HEADER, Opcode.METADATA, Opcode.ATTACHMENT, Opcode.FOOTER})


def newest_recording(folder: str) -> Path | None:
    """The recording of a folder that was written last; None where there is none.

    Raises
    ------
    RecordingError
        The folder cannot be read.
    """
    try:
        return max(Path(folder).glob("*.mcap"), key=lambda each: each.stat().st_mtime, default=None)
    except OSError as error:
        raise RecordingError(f"{folder}: cannot be read: {error.strerror}") from None


class Recording:
    """An MCAP file; iterate over it for its `Message` s, as often as you like.

    Channels that are not JSON are passed over.

    Parameters
    ----------
    path
        The file.
    salvage
        Read on where even the beginning of the file is damaged.

    Attributes
    ----------
    cut
        True where the file was not closed: the power failed, or it is still being written.
    has_magic
        True where the first bytes are those of an MCAP file.
    losses
        What the last iteration had to leave out.
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

    def __init__(self, path: Path | str, *, salvage: bool = False) -> None:
        self.path = Path(path)
        self.cut = True
        self.losses = Losses()
        self.files: dict[str, str] = {}
        self.metadata: dict[str, str] = {}
        self.profile = ""
        self._attached_bytes = 0
        with _opened(self.path) as file:
            magic = file.read(len(MCAP0_MAGIC))
            self.has_magic = MCAP0_MAGIC.startswith(magic)
            if not (salvage or self.has_magic):
                raise RecordingError(
                    f"{self.path}: not an MCAP recording: it begins with {magic!r}; expected what msp-range run or "
                    "msp-sim fly recorded"
                )
            for opcode, position, length in whole_records(file, Losses()):
                if opcode in _KEPT:
                    self._keep(read_record(file, opcode, position, length))
                if opcode == Opcode.FOOTER:
                    self.cut = os.pread(file.fileno(), len(MCAP0_MAGIC), position + length) != MCAP0_MAGIC

    def __iter__(self) -> Iterator[Message]:
        start_s, utc_start_ns = self._start()
        topics: dict[int, tuple[str, Topic | None] | None] = {}
        for record in self.records():
            if isinstance(record, RawMessage):
                if record.channel_id not in topics:
                    self.losses.messages += 1
                elif (known := topics[record.channel_id]) is not None:
                    topic, form = known
                    message = _decoded(record.data, form)
                    if message is None:
                        self.losses.messages += 1
                    else:
                        yield Message(topic, start_s + (record.log_time_ns - utc_start_ns) / 1e9, message)
            elif isinstance(record, Channel):
                if len(record.topic) > LONGEST_TOPIC or CONTROL.search(record.topic):
                    self.losses.records += 1
                elif record.message_encoding == "json":
                    topics[record.id] = (record.topic, read_back(record.topic))
                else:
                    topics[record.id] = None

    def utc_s(self, time_s: float) -> float:
        """Seconds since 1970 of a time on the bridge's clock, by the computer's idea of UTC at the start."""
        start_s, utc_start_ns = self._start()
        return utc_start_ns / 1e9 + (time_s - start_s)

    def records(self) -> Iterator[Record]:
        """Every whole record, chunks taken apart; `losses` counts the others."""
        self.losses = Losses()
        with _opened(self.path) as file:
            yield from read_records(file, self.losses)

    def _start(self) -> tuple[float, int]:
        """The bridge's time [s] and UTC [ns] at the start; zero in a file of another program."""
        given = {name: self.metadata.get(name, "0") for name in ("clock_start_s", "utc_start_ns")}
        try:
            start_s, utc_start_ns = float(given["clock_start_s"]), int(given["utc_start_ns"])
        except ValueError:
            start_s, utc_start_ns = math.nan, 0
        # A comparison with NaN is false.
        if abs(start_s) <= LARGEST_TIME_S and 0 <= utc_start_ns <= LARGEST_TIME_S * 1e9:
            return start_s, utc_start_ns
        found = ", ".join(f"{name} {value[:40]!r}" for name, value in given.items())
        raise RecordingError(f"{self.path}: metadata {METADATA_NAME}: found {found}, expected times of a recording")

    def _keep(self, record: Record | None) -> None:
        if isinstance(record, Header):
            self.profile = record.profile
        elif isinstance(record, Metadata) and record.name == METADATA_NAME:
            self.metadata = record.metadata
        elif isinstance(record, Attachment) and self._attached_bytes + len(record.data) <= MOST_ATTACHED_BYTES:
            # What is no text is no airframe file.
            with contextlib.suppress(UnicodeDecodeError):
                self.files[record.name] = record.data.decode()
                self._attached_bytes += len(record.data)


def _decoded(data: bytes, form: Topic | None) -> dict[str, Any] | None:
    """A message without its unknown values; None where it is not JSON, or not of its topic's form."""
    try:
        message = orjson.loads(data)
    except ValueError:
        return None
    if not isinstance(message, dict):
        return {"value": message} if form is None else None
    known = {key: value for key, value in message.items() if value is not None}
    return known if form is None or form.fits(known) else None


def is_recording(path: Path | str) -> bool:
    """True where the file is named as an MCAP file, or begins as one.

    Raises
    ------
    RecordingError
        It cannot be read.
    """
    with _opened(path) as file:
        return Path(path).suffix == ".mcap" or file.read(len(MCAP0_MAGIC)) == MCAP0_MAGIC


def _opened(path: Path | str) -> BinaryIO:
    try:
        return open_input(path, LARGEST_FILE_BYTES)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
