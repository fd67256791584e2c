"""The frames of a telemetry log (.tlog) with some messages, a piece of the log at a time.

Before each frame are the microseconds since 1970 at which it arrived, in eight bytes. numpy finds where frames could
begin, and each one's length says which of those is the next: only the wanted ones are looked at, and all of a message
in a piece become rows at once. Frames: https://mavlink.io/en/guide/serialization.html.
"""

from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from fastcrc.crc16 import mcrf4xx

from msp_lab.logs.log import struct_layout
from msp_range.arrays import Column, Indices
from msp_range.input_file import open_input
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.frames import SIGNATURE_BYTES, SIGNED
from msp_range.recording.reader import LARGEST_FILE_BYTES

LATEST_US = 4_000_000_000_000_000
"""Later times are not believed [us], this is in the year 2096: the log is damaged there."""
MOST_BAD_BYTES = 2**20
"""After this many bytes in no frame nothing more is read: the log was overwritten there. Fewer: a log with a few lost
sectors ends there; more: a file that is none is read on."""
_PIECE_BYTES = 2**20
"""The log is read in pieces of this size, which fit into a processor's cache. Larger ones are slower."""
_STAMP_BYTES, _LEAST_FRAME, _LONGEST_FRAME = 8, 3, 280
_VERSION_1, _VERSION_2 = 0xFE, 0xFD
_BEHIND = _LONGEST_FRAME + 2 * _STAMP_BYTES
"""So many zeros are put behind a piece: there a frame is looked at that may not be whole."""
_FOUND = np.dtype([(name, int) for name in ("begin", "fields", "length", "message_id", "sender")])
"""A frame in a piece: where it and its fields begin, how many bytes these have, the message, and the sender."""


class TelemetryFrames:
    """The frames of a log with one of these messages, and how many bytes of how many are in no frame.

    Parameters
    ----------
    wanted
        Ids of messages of the dialect.
    """

    def __init__(self, wanted: Collection[int]) -> None:
        self._crc_extra = {each: bytes((dialect.mavlink_map[each].crc_extra,)) for each in wanted}
        self._start_us: int | None = None
        self.bad_bytes = self.size = 0

    def of(self, path: Path, progress: Callable[[float], None]) -> Iterator[tuple[int, Column]]:
        """The id of a wanted message and its frames in a piece of the log, in their order.

        The frames are rows with ``time_s``, when each arrived since the first wanted one [s]; ``place``, where it is in
        the file; ``sender``, 256 times its system and its component; and ``values``, its fields by their names.
        """
        with open_input(path, LARGEST_FILE_BYTES) as file:
            self.size = file.seek(0, 2)
            file.seek(0)
            rest, skipped = b"", 0
            while skipped <= MOST_BAD_BYTES and (block := file.read(_PIECE_BYTES)):
                size = len(rest) + len(block)
                data = rest + block + bytes(_BEHIND)
                begins, ends, end = _chain(data, size, _LEAST_FRAME if file.tell() >= self.size else _LONGEST_FRAME)
                frames = self._wanted(data, begins)
                bad = np.append(begins - _STAMP_BYTES, end) - np.append(0, ends)
                after = np.searchsorted(begins, frames["begin"][-1]) + 1 if frames.size else 0
                skipped = int(bad[after:].sum()) + (0 if frames.size else skipped)
                self.bad_bytes += int(bad.sum())
                for message_id in dict.fromkeys(frames["message_id"].tolist()):
                    rows = self._rows(data, frames[frames["message_id"] == message_id], message_id)
                    rows["place"] += file.tell() - size
                    yield message_id, rows
                rest = data[end:size]
                progress(file.tell() / self.size)
            self.bad_bytes += len(rest) + self.size - file.tell()

    def _wanted(self, data: bytes, begins: Indices) -> Column:
        """The frames of wanted messages whose checksum is right, as `_FOUND`."""
        content = np.frombuffer(data, np.uint8)
        found = np.zeros(begins.size, _FOUND)
        is_2 = content[begins] == _VERSION_2
        id_at = begins + np.where(is_2, 7, 5)
        found["begin"], found["length"], found["fields"] = begins, content[begins + 1], id_at + np.where(is_2, 3, 1)
        found["sender"] = 256 * content[id_at - 2].astype(int) + content[id_at - 1]
        found["message_id"] = content[id_at]
        found["message_id"] += is_2 * (256 * content[id_at + 1].astype(int) + 65_536 * content[id_at + 2].astype(int))
        # A frame with another flag than that of a signature must not be accepted.
        found = found[np.isin(found["message_id"], list(self._crc_extra)) & ~(is_2 & (content[begins + 2] > SIGNED))]
        ends = found["fields"] + found["length"]
        places = zip(found["begin"].tolist(), ends.tolist(), found["message_id"].tolist(), strict=True)
        checksums = [mcrf4xx(data[begin + 1 : end] + self._crc_extra[each]) for begin, end, each in places]
        is_whole = content[ends] + 256 * content[ends + 1].astype(int) == np.array(checksums)
        return np.asarray(found[is_whole])

    def _rows(self, data: bytes, found: Column, message_id: int) -> Column:
        """The frames of one message as rows."""
        kind = dialect.mavlink_map[message_id]
        layout = struct_layout(kind.unpacker.format, tuple(kind.ordered_fieldnames))
        stamps_us = _anywhere(data, np.dtype(">u8"))[found["begin"] - _STAMP_BYTES]
        if self._start_us is None:
            self._start_us = int(stamps_us[0])
        values = _anywhere(data, layout)[found["fields"]]
        # MAVLink 2 leaves out zeros at the end.
        values.view(np.uint8).reshape(found.size, -1)[np.arange(layout.itemsize) >= found["length"][:, None]] = 0
        rows = np.zeros(found.size, [("time_s", float), ("place", int), ("sender", int), ("values", layout)])
        rows["time_s"] = stamps_us / 1e6 - self._start_us / 1e6
        rows["place"], rows["sender"], rows["values"] = found["begin"], found["sender"], values
        return rows


def _chain(data: bytes, size: int, longest: int) -> tuple[Indices, Indices, int]:
    """Where frames begin and end, each followed by a time and another one, and where the next piece goes on.

    Only frames are looked for that have so many bytes and a time before the end of the data, which have this size.
    """
    content = np.frombuffer(data, np.uint8)
    may_begin = (content == _VERSION_1) | (content == _VERSION_2)
    begins = np.flatnonzero(may_begin[_STAMP_BYTES : max(_STAMP_BYTES, size - longest)]) + _STAMP_BYTES
    signature = SIGNATURE_BYTES * (content[begins + 2] & SIGNED).astype(int)
    ends = begins + content[begins + 1] + np.where(content[begins] == _VERSION_2, 12 + signature, 8)
    next_begins = ends + _STAMP_BYTES
    goes_on = may_begin[next_begins] & (_anywhere(data, np.dtype(">u8"))[ends] < LATEST_US)
    is_frame = (ends <= size) & ((next_begins >= size) | goes_on)
    begins, ends, next_begins = begins[is_frame], ends[is_frame], next_begins[is_frame]
    # After each frame the first one that begins behind it.
    following = np.searchsorted(begins, next_begins).tolist()
    chain, at = [], 0
    while at < len(following):
        chain.append(at)
        at = following[at]
    begins, ends = begins[chain], ends[chain]
    return begins, ends, max(size - longest - _STAMP_BYTES, int(ends[-1]) if chain else 0)


def _anywhere(data: bytes, layout: np.dtype[Any]) -> Column:
    """What the data are from each of their bytes on."""
    return np.ndarray(len(data) - layout.itemsize + 1, layout, data, strides=(1,))
