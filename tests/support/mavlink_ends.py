"""The other ends of a link in one process: a transport in memory, components that speak on it, and a reader."""

import struct
from typing import Any

from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import TransportStats


class MemoryTransport:
    """A transport whose far side is two attributes: what has arrived, and the frames that were sent."""

    description = "memory"
    connected = True
    quiet_until_s = float("-inf")
    files: tuple[int, ...] = ()
    last_error: str | None = None

    def __init__(self) -> None:
        self.arrived = bytearray()
        self.frames: list[bytes] = []
        self.takes = True
        self.closed = False
        self.stats = TransportStats()

    def send(self, frame: bytes) -> bool:
        if self.takes:
            self.frames.append(frame)
        return self.takes

    def receive(self) -> bytes:
        arrived = bytes(self.arrived)
        self.arrived.clear()
        return arrived

    def close(self) -> None:
        self.closed = True


class Component:
    """A MAVLink component that makes frames; an autopilot by default."""

    def __init__(self, system: int = 1, component: int = 1, dialect: Any = dialect) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._dialect = dialect

    def frame(self, message: Any, *, mavlink1: bool = False) -> bytes:
        """One message of its own."""
        frame: bytes = message.pack(self._mav, force_mavlink1=mavlink1)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def heartbeat(self, *, mavlink1: bool = False, armed: bool = False) -> bytes:
        """A quadcopter's under ArduPilot."""
        d = self._dialect
        mode = d.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        beat = d.MAVLink_heartbeat_message(
            d.MAV_TYPE_QUADROTOR, d.MAV_AUTOPILOT_ARDUPILOTMEGA, mode, 0, d.MAV_STATE_STANDBY, 3
        )
        return self.frame(beat, mavlink1=mavlink1)


# common.xml, DISTANCE_SENSOR: the largest fields first, then the extensions in their order.
_DISTANCE_SENSOR_ID, _DISTANCE_SENSOR_CRC_EXTRA = 132, 85
_DISTANCE_SENSOR = struct.Struct("<IHHHBBBBff4fB")


def read_distance_sensor(frame: bytes) -> dict[str, Any] | None:
    """The fields of a MAVLink 2 DISTANCE_SENSOR frame, read by hand; None for any other frame.

    A float is the double of the same value as the single that is on the wire.
    """
    assert frame[0] == 0xFD
    if int.from_bytes(frame[7:10], "little") != _DISTANCE_SENSOR_ID:
        return None
    payload_end = 10 + frame[1]
    checksum = crc_x25(frame[1:payload_end] + bytes([_DISTANCE_SENSOR_CRC_EXTRA]))
    assert frame[payload_end:] == checksum.to_bytes(2, "little")
    values = _DISTANCE_SENSOR.unpack(frame[10:payload_end].ljust(_DISTANCE_SENSOR.size, b"\0"))
    names = (
        "time_boot_ms",
        "min_distance",
        "max_distance",
        "current_distance",
        "type",
        "id",
        "orientation",
        "covariance",
        "horizontal_fov",
        "vertical_fov",
    )
    first = dict(zip(names, values, strict=False))
    return {**first, "quaternion": list(values[10:14]), "signal_quality": values[14]}


def crc_x25(covered: bytes) -> int:
    """MAVLink's checksum: CRC-16/MCRF4XX, bit by bit.

    Examples
    --------
    >>> hex(crc_x25(b"123456789"))
    '0x6f91'
    """
    crc = 0xFFFF
    for byte in covered:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0x8408 if crc & 1 else 0)
    return crc
