"""Where the samples of a vehicle come from: a bridge of this program, or the socket of one that runs already.

Both give the records of some seconds. Neither goes on while the vehicle is armed.
"""

import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from msp_range.bridge import Bridge
from msp_range.bus import Bus
from msp_range.clock import Clock
from msp_range.config import Airframe
from msp_range.doctor.autopilot import Tap, silence
from msp_range.doctor.computer import Computer
from msp_range.mavlink.signing import signing_of
from msp_range.mavlink.transport import Transport
from msp_range.recording.topics import Message
from msp_range.watch.client import LONGEST_PACKET, packets
from msp_range.watch.view import autopilot_message
from msp_range.yaml_file import ConfigError

ATTITUDE_HZ = 10.0
"""Rate of attitudes that is asked for [Hz]: a hand turns a vehicle by 3 degrees between two of them."""
RETURNED_HZ = 5.0
"""Rate of the autopilot's own distances that is asked for [Hz]."""
CONNECT_S = 6.0
"""How long to wait for a heartbeat, which comes once a second [s]."""
SILENT_S = 2.0
"""A running bridge that says nothing for so long hangs [s]: it sends its status twice a second."""
AUTOPILOT_TOPIC = "/autopilot"
ENDED = "the running bridge ended or hangs: start it again, or stop the service, then again"


class Armed(ConfigError):
    """The vehicle is armed, so nobody should hold it in his hands."""

    def __init__(self) -> None:
        super().__init__("the vehicle is armed: disarm it and take the propellers off; nothing was changed")


class HeartbeatLost(ConfigError):
    """Nobody knows any more whether the vehicle is armed."""

    def __init__(self) -> None:
        super().__init__(
            "the autopilot's heartbeat is lost, so nobody knows whether the vehicle is armed; nothing was changed. "
            "'msp-range doctor' looks for the reason"
        )


class Live(Protocol):
    """A vehicle whose sensors are being polled."""

    def begin(self, airframe: Airframe) -> None:
        """Check that it is this vehicle, and that it can be seen whether it is armed.

        Raises
        ------
        ConfigError
            It is not so.
        """

    def record(self, duration_s: float) -> list[Message]:
        """Everything that is received in the next seconds.

        Raises
        ------
        Armed, HeartbeatLost
            The vehicle is armed, or nobody knows.
        """


class _Kept:
    """The records of a bridge, kept in memory."""

    fault: str | None = None

    def __init__(self) -> None:
        self.records: list[Message] = []

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        self.records.append(Message(topic, time_s, message))

    def flush_if_due(self, now_s: float) -> None:
        """Nothing is written to a disk."""


class OwnBridge:
    """A bridge of this program on the vehicle's bus and link.

    Parameters
    ----------
    airframe, bus, clock, transport
        As `msp_range.bridge.Bridge` has them.
    computer
        Where it is looked for who else has the link.
    """

    def __init__(self, airframe: Airframe, bus: Bus, clock: Clock, transport: Transport, computer: Computer) -> None:
        self._clock, self._computer = clock, computer
        self._transport = transport = Tap(transport)
        self._kept = _Kept()
        self._bridge = Bridge(
            airframe,
            bus,
            clock,
            transport,
            recorder=self._kept,
            on_message=self._on_message,
            wanted={"ATTITUDE": ATTITUDE_HZ, "DISTANCE_SENSOR": RETURNED_HZ},
            signing=signing_of(airframe.link.signing_key, clock),
        )

    def begin(self, airframe: Airframe) -> None:
        """Wait for the autopilot's heartbeat; raises ConfigError with the reason why none comes."""
        end_s = self._clock.now() + CONNECT_S
        while not self._bridge.link.autopilot_is_present:
            if self._clock.now() >= end_s:
                found = silence(airframe, self._computer, self._transport, self._clock)
                raise ConfigError(f"{airframe.link.url}: no autopilot is received: {found.text} -> {found.remedy}")
            self._bridge.step()

    def record(self, duration_s: float) -> list[Message]:
        """Everything that is received in the next seconds; raises `Armed` as soon as the vehicle is armed."""
        end_s = self._clock.now() + duration_s
        self._kept.records.clear()
        while self._clock.now() < end_s:
            self._bridge.step()
            if self._bridge.link.autopilot_armed:
                raise Armed
            if not self._bridge.link.autopilot_is_present:
                raise HeartbeatLost
        return list(self._kept.records)

    def _on_message(self, now_s: float, message: Any) -> None:
        shown = autopilot_message(message)
        if shown is not None:
            self._kept.write(AUTOPILOT_TOPIC, now_s, shown)


class RunningBridge:
    """A bridge that runs already, through its socket.

    Parameters
    ----------
    connection
        As `msp_range.watch.client.connect` gives it.
    """

    def __init__(self, connection: socket.socket, now: Callable[[], float]) -> None:
        self._connection = connection
        self._connection.settimeout(SILENT_S)
        self._packets = packets(connection)
        self._now = now

    def begin(self, airframe: Airframe) -> None:
        """Check that its sensors are those of an airframe.

        Raises
        ------
        ConfigError
            It was started with another file, or before the file was changed, or sends nothing.
        """
        greeting = None
        with suppress(TimeoutError):
            greeting = next(self._packets, None)
        if greeting is None:
            raise ConfigError(ENDED)
        flown = {each["name"]: each["address"] for each in greeting.message["sensors"]}
        if flown != {sensor.name: f"0x{sensor.address:02x}" for sensor in airframe.sensors}:
            raise ConfigError(
                "the running bridge has other sensors or addresses than the file: sudo systemctl reload msp-range if "
                "it flies this file, else sudo systemctl stop msp-range"
            )

    def record(self, duration_s: float) -> list[Message]:
        """Everything that is received in the next seconds; raises `Armed` as soon as the vehicle is armed."""
        self._skip_old()
        end_s = self._now() + duration_s
        records: list[Message] = []
        with suppress(TimeoutError):
            for packet in self._packets:
                if packet.topic == "/status" and (armed := packet.message["link"]["armed"]) is not False:
                    raise Armed if armed else HeartbeatLost
                records.append(packet)
                if self._now() >= end_s:
                    return records
        raise ConfigError(ENDED)

    def _skip_old(self) -> None:
        """Drop what has waited in the socket since the last time."""
        self._connection.setblocking(False)
        with suppress(BlockingIOError, ConnectionResetError):
            while self._connection.recv(LONGEST_PACKET):
                pass
        self._connection.settimeout(SILENT_S)
