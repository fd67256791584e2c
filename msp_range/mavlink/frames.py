"""Find complete valid MAVLink frames in received bytes.

pymavlink's own parser frees its buffer only when a call ends exactly with a frame: with bytes that always end inside a
frame it grew by 95 MB a minute. Here at most one incomplete frame is kept. Frames of both versions are found, as
https://mavlink.io/en/guide/serialization.html describes them.
"""

import re
from collections import namedtuple
from functools import cache
from itertools import islice
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx

from msp_range.mavlink.dialect import MESSAGES, dialect

MAX_FALSE_STARTS = 64
"""After a false start of a frame the search continues at the next byte, to find a frame that begins inside the false
one. After this many in one call it continues at the false frame's end, so that malicious bytes cannot cost more than 64
additional checksums. 8192 random bytes have about 32; a smaller number would lose frames that follow such noise, a
larger one makes the worst call longer (64 take 0.2 ms on a desktop computer)."""

_START = re.compile(rb"\xfe|\xfd(?=.?\Z|.[\x00\x01])", re.DOTALL)
"""Version 1, or version 2 with no flag or the one for a signature: a frame with another flag must not be accepted."""
_VERSION_1, _VERSION_2 = 0xFE, 0xFD
_LAYOUT = {_VERSION_1: (5, 6), _VERSION_2: (7, 10)}
"""Where the message's id begins, which system and component are in front of, and where it ends and the fields begin."""
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
        kind = MESSAGES[self.message_id]
        wire = kind.unpacker
        # MAVLink 2 leaves out zeros at the end, and a later version of a message may be longer.
        values = wire.unpack(self.payload.ljust(wire.size, b"\0")[: wire.size])
        if len(values) > len(kind.lengths):  # Some fields are arrays.
            each = iter(values)
            values = [next(each) if length == 1 else tuple(islice(each, length)) for length in kind.lengths]
        return _message_type(self.message_id)(kind.msgname, *values)


@cache
def _message_type(message_id: int) -> Any:
    """The type of a message: its name, and the values of its fields in their order on the wire."""
    kind = MESSAGES[message_id]
    return namedtuple(kind.msgname, ("msgname", *kind.ordered_fieldnames))


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
        false_starts = start = 0
        end = len(stream)
        while start < end and (found := _START.search(stream, start)):
            start = found.start()
            if start + _CLAIM_BYTES > end:
                break
            version, payload_bytes, flags = stream[start : start + _CLAIM_BYTES]
            id_at, payload_at = _LAYOUT[version]
            payload_end = payload_at + payload_bytes
            stop = start + payload_end + _CHECKSUM_BYTES
            if version == _VERSION_2 and flags & SIGNED:
                stop += SIGNATURE_BYTES
            if stop > end:
                break
            data = stream[start:stop]
            message_id = int.from_bytes(data[id_at:payload_at], "little")
            kind = MESSAGES.get(message_id)
            if kind is None:
                # A frame of another dialect, or noise: it counts as a frame if another frame or nothing follows.
                is_frame = stop == end or stream[stop] in _LAYOUT
            # It also covers a byte for the definition of the message. pymavlink's own object takes five times as long.
            elif is_frame := data[payload_end : payload_end + _CHECKSUM_BYTES] == mcrf4xx(
                data[1:payload_end] + bytes((kind.crc_extra,))
            ).to_bytes(_CHECKSUM_BYTES, "little"):
                frames.append(Frame(message_id, data[id_at - 2], data[id_at - 1], data, data[payload_at:payload_end]))
            false_starts += not is_frame
            start = stop if is_frame or false_starts > MAX_FALSE_STARTS else start + 1
        else:
            start = end
        self._incomplete = stream[start:]
        return frames
