"""Find complete valid MAVLink frames in received bytes.

pymavlink's own parser frees its buffer only when a call ends exactly with a frame: with bytes that always end inside a
frame it grew by 95 MB a minute. Here at most one incomplete frame is kept. Frames of both versions are found, as
https://mavlink.io/en/guide/serialization.html describes them.
"""

import re
from itertools import islice
from types import SimpleNamespace
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx

from msp_range.mavlink.dialect import dialect

MAX_FALSE_STARTS = 64
"""After a false start of a frame the search continues at the next byte, to find a frame that begins inside the false
one. After this many in one call it continues at the false frame's end, so that malicious bytes cannot cost more than 64
additional checksums. 8192 random bytes have about 32; a smaller number would lose frames that follow such noise, a
larger one makes the worst call longer (64 take 0.2 ms on a desktop computer)."""

_START = re.compile(rb"\xfe|\xfd(?=.?\Z|.[\x00\x01])", re.DOTALL)
"""Version 1, or version 2 with no flag or the one for a signature: a frame with another flag must not be accepted."""
_VERSION_1, _VERSION_2 = 0xFE, 0xFD
_HEADER_BYTES = {_VERSION_1: 6, _VERSION_2: 10}
_CHECKSUM_BYTES, SIGNATURE_BYTES = 2, 13
_CLAIM_BYTES = 3
"""From so many bytes a frame's length is known."""
SIGNED = 0x01


class Frame(NamedTuple):
    """A frame with a valid checksum."""

    message_id: int
    system: int
    component: int
    """Message id, and the ids of its sender."""
    data: bytes
    """All its bytes."""
    payload: bytes
    """The fields as they are on the wire."""

    @property
    def is_autopilot_heartbeat(self) -> bool:
        """True for the HEARTBEAT of an autopilot, by its component id and its field ``autopilot``."""
        return (
            self.message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT
            and self.component == dialect.MAV_COMP_ID_AUTOPILOT1
            # On the wire: custom_mode (4 bytes), type, autopilot. MAVLink 2 leaves out zeros at the end, and the last
            # field is the version, which is not zero.
            and len(self.payload) > 5
            and self.payload[5] != dialect.MAV_AUTOPILOT_INVALID
        )

    @property
    def is_signed(self) -> bool:
        """Whether it has a signature, right or wrong."""
        return self.data[0] == _VERSION_2 and bool(self.data[2] & SIGNED)

    def decode(self) -> Any:
        """The fields by their names, text as bytes, and the message's name as ``msgname``.

        pymavlink's decoder would verify the checksum again, and make an object that can be sent.
        """
        kind = dialect.mavlink_map[self.message_id]
        wire = kind.unpacker
        # MAVLink 2 leaves out zeros at the end, and a later version of a message may be longer.
        values = wire.unpack(self.payload.ljust(wire.size, b"\0")[: wire.size])
        if len(values) > len(kind.lengths):  # Some fields are arrays.
            each = iter(values)
            values = [next(each) if length == 1 else tuple(islice(each, length)) for length in kind.lengths]
        return SimpleNamespace(msgname=kind.msgname, **dict(zip(kind.ordered_fieldnames, values, strict=True)))


def text_of(field: bytes) -> str:
    """A message's text, which ends at its first zero."""
    return field.partition(b"\0")[0].decode("ascii", "replace")


class FrameReader:
    """Finds the frames in one sender's bytes, which may be split anywhere.

    Frames of a message that is not in the dialect are skipped, because their checksum cannot be computed.

    Examples
    --------
    >>> heartbeat = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(dialect.MAVLink(None, 7, 1))
    >>> reader = FrameReader()
    >>> reader.read(b"noise" + heartbeat[:9])
    []
    >>> [(frame.message_id, frame.system, frame.component) for frame in reader.read(heartbeat[9:])]
    [(0, 7, 1)]
    """

    _incomplete = b""

    def read(self, arrived: bytes) -> list[Frame]:
        """The frames completed by ``arrived``, in order."""
        stream = self._incomplete + arrived
        frames: list[Frame] = []
        false_starts = 0
        start, end = 0, len(stream)
        while found := _START.search(stream, start):
            start = found.start()
            if start + _CLAIM_BYTES > end:
                break
            version, payload_bytes, flags = stream[start : start + _CLAIM_BYTES]
            stop = start + _HEADER_BYTES[version] + payload_bytes + _CHECKSUM_BYTES
            if version == _VERSION_2:
                stop += SIGNATURE_BYTES * (flags & SIGNED)
            if stop > end:
                break
            frame, passes = _check(stream, start, stop)
            if frame is not None:
                frames.append(frame)
            false_starts += not passes
            start = stop if passes or false_starts > MAX_FALSE_STARTS else start + 1
        else:
            start = end
        self._incomplete = stream[start:]
        return frames


def _check(stream: bytes, start: int, stop: int) -> tuple[Frame | None, bool]:
    """The frame from ``start`` to ``stop`` if its checksum is valid, and whether to continue after it."""
    data = stream[start:stop]
    if data[0] == _VERSION_1:
        system, component, message_id = data[3:6]
    else:
        system, component, message_id = data[5], data[6], int.from_bytes(data[7:10], "little")
    kind = dialect.mavlink_map.get(message_id)
    if kind is None:
        # A frame of another dialect, or noise: it counts as a frame if another frame or nothing follows.
        return None, stop == len(stream) or stream[stop] in _HEADER_BYTES
    header_bytes = _HEADER_BYTES[data[0]]
    end = header_bytes + data[1]
    # It also covers a byte for the definition of the message. pymavlink's own object for it takes five times as long.
    checksum = mcrf4xx(data[1:end] + bytes((kind.crc_extra,)))
    if checksum != int.from_bytes(data[end : end + _CHECKSUM_BYTES], "little"):
        return None, False
    return Frame(message_id, system, component, data, data[header_bytes:end]), True
