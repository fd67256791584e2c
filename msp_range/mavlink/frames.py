"""Find complete valid MAVLink frames in received bytes.

pymavlink's own parser frees its buffer only when a call ends exactly with a frame: with bytes that always end inside a
frame it grew by 95 MB a minute. Here at most one incomplete frame is kept. Frames of both versions are found, as
https://mavlink.io/en/guide/serialization.html describes them.
"""

import re
import struct
from collections.abc import Callable, Hashable, Sequence
from functools import cache
from itertools import accumulate
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx

from msp_range.mavlink.dialect import dialect

MAX_FALSE_STARTS = 64
"""After a false start of a frame the search continues at the next byte, to find a frame that begins inside the false
one. After this many in one call it continues at the false frame's end, so that malicious bytes cannot cost more than 64
additional checksums. 8192 random bytes have about 32; a smaller number would lose frames that follow such noise, a
larger one makes the worst call longer (64 take 0.2 ms on a desktop computer)."""

MAX_FRAME_BYTES = 280
"""MAVLink 2 with the longest payload and a signature."""

_START = re.compile(rb"\xfe|\xfd(?=.?\Z|.[\x00\x01])", re.DOTALL)
"""Version 1, or version 2 with no flag or the one for a signature: a frame with another flag must not be accepted."""
_VERSION_1, _VERSION_2 = 0xFE, 0xFD
_HEADER_BYTES = {_VERSION_1: 6, _VERSION_2: 10}
_CHECKSUM_BYTES, SIGNATURE_BYTES = 2, 13
SIGNED = 0x01
_HEADER = struct.Struct("<BBBBBBHB")
"""Header of version 2 after the first byte: payload's length, two bytes of flags, sequence, system, component, and the
message id in two parts."""


Values = Callable[[Any], tuple[Any, ...]]
"""Picks values of a message in another order."""


class Frame(NamedTuple):
    """A frame with a valid checksum.

    Attributes
    ----------
    message_id, system, component
        Message id, and the ids of its sender.
    data
        All its bytes.
    """

    message_id: int
    system: int
    component: int
    data: bytes

    @property
    def is_autopilot_heartbeat(self) -> bool:
        """True for the HEARTBEAT of an autopilot, by its component id and its field ``autopilot``."""
        if self.message_id != dialect.MAVLINK_MSG_ID_HEARTBEAT or self.component != dialect.MAV_COMP_ID_AUTOPILOT1:
            return False
        # On the wire: custom_mode (4 bytes), type, autopilot. MAVLink 2 leaves out zeros at the end, and the last field
        # is the version, which is not zero.
        autopilot_at = _HEADER_BYTES[self.data[0]] + 5
        return self.data[1] > 5 and self.data[autopilot_at] != dialect.MAV_AUTOPILOT_INVALID

    @property
    def is_signed(self) -> bool:
        """Whether it has a signature, right or wrong."""
        return self.data[0] == _VERSION_2 and bool(self.data[2] & SIGNED)

    @property
    def payload(self) -> bytes:
        """The fields as they are on the wire."""
        start = _HEADER_BYTES[self.data[0]]
        return self.data[start : start + self.data[1]]

    def decode(self) -> Any:
        """Decode the message; pymavlink's decoder would verify the checksum again, which takes three times as long."""
        kind, in_order = _layout(self.message_id)
        wire = kind.unpacker
        # MAVLink 2 leaves out zeros at the end, and a later version of a message may be longer.
        values = wire.unpack(self.payload.ljust(wire.size, b"\0")[: wire.size])
        message = kind(*in_order(values))
        header = message.get_header()
        header.srcSystem, header.srcComponent = self.system, self.component
        return message


@cache
def _layout(message_id: int) -> tuple[Any, Values]:
    """A message's class, and what puts its values on the wire into the order of its fields, arrays as tuples."""
    kind = dialect.mavlink_map[message_id]
    ends = list(accumulate(kind.lengths))
    places = [
        slice(end - length, end) if length > 1 else end - 1 for end, length in zip(ends, kind.lengths, strict=True)
    ]
    return kind, _all_of(itemgetter, [places[place] for place in kind.orders])


def pack(message: Any, system: int, component: int, sequence: int) -> bytes:
    """A message as a MAVLink 2 frame; pymavlink's packing gives the same bytes and takes four times as long.

    Examples
    --------
    >>> heartbeat = dialect.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3)
    >>> pack(heartbeat, 7, 1, 0) == heartbeat.pack(dialect.MAVLink(None, 7, 1))
    True
    """
    kind: Any = type(message)
    fields, arrays_at = _fields(kind)
    values = [*fields(message)]
    for at in arrays_at:
        values[at : at + 1] = values[at]
    return _frame(kind, values, system, component, sequence)


def pack_values(kind: Any, values: Sequence[float], system: int, component: int, sequence: int) -> bytes:
    """The frame of a message of numbers, from its fields in the order of pymavlink's constructor.

    The message itself is never made, which takes as long as the rest.

    Examples
    --------
    >>> system_time = dialect.MAVLink_system_time_message
    >>> pack_values(system_time, (0, 42), 7, 1, 0) == pack(system_time(0, 42), 7, 1, 0)
    True
    """
    return _frame(kind, _on_wire(kind)(values), system, component, sequence)


def _frame(kind: Any, values: Sequence[Any], system: int, component: int, sequence: int) -> bytes:
    """A frame from the values in their order on the wire."""
    payload: bytes = kind.unpacker.pack(*values).rstrip(b"\0") or b"\0"  # without zeros at the end, but not empty
    id_low, id_high = kind.id & 0xFFFF, kind.id >> 16
    body = _HEADER.pack(len(payload), 0, 0, sequence, system, component, id_low, id_high) + payload
    return b"\xfd" + body + _checksum(body, kind).to_bytes(2, "little")


def checked_again(frame: bytes) -> bytes:
    """A MAVLink 2 frame without signature, with the checksum of what it holds now."""
    kind = dialect.mavlink_map[int.from_bytes(frame[7:10], "little")]
    return frame[:-_CHECKSUM_BYTES] + _checksum(frame[1:-_CHECKSUM_BYTES], kind).to_bytes(2, "little")


@cache
def _fields(kind: Hashable) -> tuple[Values, list[int]]:
    """A getter of a message's fields in their order on the wire, and the places of its arrays, the last one first."""
    message: Any = kind
    types = dict(zip(message.fieldnames, message.fieldtypes, strict=False))
    # pymavlink keeps a text as it was given under another name, and has it as a str under its own.
    names = [
        f"_{name}_raw" if length and types.get(name) == "char" else name
        for name, length in zip(message.ordered_fieldnames, message.array_lengths, strict=True)
    ]
    arrays_at = [at for at, length in enumerate(message.lengths) if length > 1]
    return _all_of(attrgetter, names), arrays_at[::-1]


@cache
def _on_wire(kind: Any) -> Values:
    """A getter that puts the values of all fields into their order on the wire."""
    return _all_of(itemgetter, [kind.fieldnames.index(name) for name in kind.ordered_fieldnames])


def _all_of(getter: Callable[..., Callable[[Any], Any]], items: Sequence[Any]) -> Values:
    """A getter of several items, which returns a tuple also if there is only one."""
    get = getter(*items)
    return get if len(items) > 1 else lambda whole: (get(whole),)


def _checksum(body: bytes, kind: Any) -> int:
    """Checksum of a frame without its first byte; it also covers a byte for the definition of the message."""
    # pymavlink's own object for it takes five times as long.
    return mcrf4xx(body + bytes((kind.crc_extra,)))


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

    def __init__(self) -> None:
        self._incomplete = b""

    @property
    def kept_bytes(self) -> int:
        """Length of the incomplete frame: less than `MAX_FRAME_BYTES`."""
        return len(self._incomplete)

    def read(self, arrived: bytes) -> list[Frame]:
        """The frames completed by ``arrived``, in order."""
        if not arrived:
            return []
        stream = self._incomplete + arrived
        frames: list[Frame] = []
        false_starts = 0
        start, end = 0, len(stream)
        while found := _START.search(stream, start):
            start = found.start()
            stop = start + _claimed_bytes(stream[start : start + 3])
            if stop > end:
                break
            frame, passes = _check(stream, start, stop)
            if frame is not None:
                frames.append(frame)
            if passes:
                start = stop
                continue
            false_starts += 1
            start = start + 1 if false_starts <= MAX_FALSE_STARTS else stop
        else:
            start = end
        self._incomplete = stream[start:]
        return frames


def _claimed_bytes(header: bytes) -> int:
    """Length of the frame that begins with these bytes, by its header."""
    if len(header) < 3:
        return MAX_FRAME_BYTES
    version, payload_bytes, flags = header
    if version == _VERSION_1:
        return _HEADER_BYTES[version] + payload_bytes + _CHECKSUM_BYTES
    return _HEADER_BYTES[version] + payload_bytes + _CHECKSUM_BYTES + SIGNATURE_BYTES * (flags & SIGNED)


def _check(stream: bytes, start: int, stop: int) -> tuple[Frame | None, bool]:
    """The frame from ``start`` to ``stop`` if its checksum is valid, and whether to continue after it."""
    checksum_at = stop - _CHECKSUM_BYTES
    if stream[start] == _VERSION_1:
        system, component, message_id = stream[start + 3 : start + 6]
    else:
        _, flags, _, _, system, component, id_low, id_high = _HEADER.unpack_from(stream, start + 1)
        message_id = id_low | id_high << 16
        checksum_at -= SIGNATURE_BYTES * (flags & SIGNED)
    kind = dialect.mavlink_map.get(message_id)
    if kind is None:
        # A frame of another dialect, or noise: it counts as a frame if another frame or nothing follows.
        return None, stop == len(stream) or stream[stop] in _HEADER_BYTES
    if _checksum(stream[start + 1 : checksum_at], kind) != stream[checksum_at] | stream[checksum_at + 1] << 8:
        return None, False
    return Frame(message_id, system, component, stream[start:stop]), True
