"""The other ends of a link in one process: a transport in memory, and components that speak on it."""

from typing import Any

from msp_range.mavlink.dialect import dialect


class MemoryTransport:
    """A transport whose far side is two attributes: what has arrived, and the frames that were sent."""

    description = "memory"
    connected = True
    last_error: str | None = None

    def __init__(self) -> None:
        self.arrived = bytearray()
        self.frames: list[bytes] = []
        self.takes = True
        self.closed = False

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
    """A MAVLink component that makes frames; an autopilot unless told otherwise."""

    def __init__(self, system: int = 1, component: int = 1, dialect: Any = dialect) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._dialect = dialect

    def frame(self, message: Any, *, mavlink1: bool = False) -> bytes:
        """One message of its own."""
        frame: bytes = message.pack(self._mav, force_mavlink1=mavlink1)
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame

    def heartbeat(self, *, mavlink1: bool = False) -> bytes:
        """A quadcopter's under ArduPilot."""
        d = self._dialect
        beat = d.MAVLink_heartbeat_message(
            d.MAV_TYPE_QUADROTOR, d.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, d.MAV_STATE_STANDBY, 3
        )
        return self.frame(beat, mavlink1=mavlink1)
