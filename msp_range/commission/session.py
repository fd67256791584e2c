"""What the steps work on: the airframe file, the person, and where the samples of the vehicle come from.

That is a bridge of this program, or the socket of one that runs already. Both give the records of some seconds. Neither
goes on while the vehicle is armed.
"""

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msp_range.bridge import Bridge
from msp_range.bus import Bus
from msp_range.bus.smbus import BusInUse, KernelBus
from msp_range.clock import Clock
from msp_range.commission.operator import Operator
from msp_range.config import Airframe, load_airframe
from msp_range.doctor.autopilot import CONNECT_S, Tap, silence
from msp_range.doctor.computer import Computer
from msp_range.mavlink.signing import signing_of
from msp_range.mavlink.transport import Transport, open_transport
from msp_range.recording.topics import Message
from msp_range.watch.client import LONGEST_PACKET, connect, packets
from msp_range.watch.place import sockets
from msp_range.watch.view import autopilot_message
from msp_range.yaml_file import ConfigError

ATTITUDE_HZ = 10.0
"""Rate of attitudes that is asked for [Hz]: a hand turns a vehicle by 3 degrees between two of them."""
RETURNED_HZ = 5.0
"""Rate of the autopilot's own distances that is asked for [Hz]."""
SILENT_S = 2.0
"""A running bridge that sends nothing for this long hangs [s]: it sends its status twice a second."""
ENDED = "the running bridge ended or hangs: start it again, or stop the service, then again"


def _refuse_armed(is_armed: bool | None) -> None:
    """Go on while the vehicle is disarmed, and known to be: nobody should hold an armed one in his hands."""
    if is_armed:
        raise ConfigError("the vehicle is armed: disarm it and take the propellers off; nothing was changed")
    if is_armed is None:
        raise ConfigError(
            "the autopilot's heartbeat is lost, so nobody knows whether the vehicle is armed; nothing was changed. "
            "'msp-range doctor' looks for the reason"
        )


class OwnBridge:
    """A bridge of this program on the vehicle's bus and link, and what it shows.

    Parameters
    ----------
    airframe, bus, clock, transport
        As `msp_range.bridge.Bridge` has them.
    computer
        Where it is looked for who else has the link.
    """

    def __init__(self, airframe: Airframe, bus: Bus, clock: Clock, transport: Transport, computer: Computer) -> None:
        self._clock, self._computer, self._transport = clock, computer, Tap(transport)
        self._records: list[Message] = []
        self._bridge = Bridge(
            airframe,
            bus,
            clock,
            self._transport,
            on_message=self._on_message,
            wanted={"ATTITUDE": ATTITUDE_HZ, "DISTANCE_SENSOR": RETURNED_HZ},
            signing=signing_of(airframe.link.signing_key, clock),
        )
        self._bridge.show_to(self._keep)

    def begin(self, airframe: Airframe) -> None:
        """Wait for the autopilot's heartbeat, by which it is seen whether the vehicle is armed.

        Raises
        ------
        ConfigError
            None comes; the text says why.
        """
        end_s = self._clock.now() + CONNECT_S
        while not self._bridge.link.autopilot_is_present:
            if self._clock.now() >= end_s:
                found = silence(airframe, self._computer, self._transport, self._clock)
                raise ConfigError(f"{airframe.link.url}: no autopilot is received: {found.text} -> {found.remedy}")
            self._bridge.step()

    def record(self, duration_s: float) -> list[Message]:
        """Everything that is received in the next seconds.

        Raises
        ------
        ConfigError
            The vehicle is armed, or nobody knows.
        """
        end_s, self._records, link = self._clock.now() + duration_s, [], self._bridge.link
        while self._clock.now() < end_s:
            self._bridge.step()
            _refuse_armed(link.autopilot_armed or (False if link.autopilot_is_present else None))
        return self._records

    def _keep(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        self._records.append(Message(topic, time_s, message))

    def _on_message(self, now_s: float, message: Any) -> None:
        if (shown := autopilot_message(message)) is not None:
            self._keep("/autopilot", now_s, shown)


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
        flown = {sensor["name"]: sensor["address"] for sensor in greeting.message["sensors"]}
        if flown != {sensor.name: sensor.shown_address for sensor in airframe.sensors}:
            raise ConfigError(
                "the running bridge has other sensors or addresses than the file: sudo systemctl reload msp-range if "
                "it flies this file, else sudo systemctl stop msp-range"
            )

    def record(self, duration_s: float) -> list[Message]:
        """As `OwnBridge.record`; raises ConfigError, too, where the bridge ends or hangs."""
        # What has waited in the socket since the last time is dropped.
        self._connection.setblocking(False)
        with suppress(BlockingIOError, ConnectionResetError):
            while self._connection.recv(LONGEST_PACKET):
                pass
        self._connection.settimeout(SILENT_S)
        end_s = self._now() + duration_s
        records: list[Message] = []
        with suppress(TimeoutError):
            for packet in self._packets:
                if packet.topic == "/status":
                    _refuse_armed(packet.message["link"]["armed"])
                records.append(packet)
                if self._now() >= end_s:
                    return records
        raise ConfigError(ENDED)


Live = OwnBridge | RunningBridge
"""A vehicle whose sensors are being polled."""


@dataclass
class Session:
    """A commissioning session: the vehicle, and the person who works on it."""

    path: Path
    """The airframe file."""
    computer: Computer
    clock: Clock
    """The computer whose files doctor looks at, and the clock."""
    operator: Operator
    """The person at the terminal or with the phone."""
    make_bus: Callable[[int | str], KernelBus] = KernelBus
    make_transport: Callable[[str, Clock], Transport] = open_transport
    """Open the bus and the transport that the airframe file names."""
    recording: Path | None = None
    """A recorded flight for the last steps; None: the newest one in the airframe's folder."""
    port: int = 2
    """Number of the autopilot's port, as in `msp-range params`."""
    measured: dict[str, dict[str, object]] = field(default_factory=dict)
    """What the steps so far have measured, by step."""

    def airframe(self) -> Airframe:
        """The airframe as its file is now."""
        return load_airframe(self.path)

    def check_disarmed(self) -> None:
        """Go on only if a heartbeat says now that the vehicle is disarmed.

        Raises
        ------
        ConfigError
            It is armed, or nobody knows.
        """
        # Also where the file names another autopilot than the one that is received, which is what may be corrected.
        airframe = self.airframe()
        link = airframe.link.model_copy(update={"system_id": None})
        with self.live(airframe.model_copy(update={"link": link})):
            pass

    @contextmanager
    def live(self, airframe: Airframe | None = None) -> Iterator[Live]:
        """The vehicle's sensors and autopilot: those of a bridge that runs already, or of one made for this.

        Parameters
        ----------
        airframe
            None: as its file is now.

        Raises
        ------
        ConfigError
            Another program uses the bus, or no autopilot is received.
        """
        airframe = airframe or self.airframe()
        bus = self.make_bus(airframe.bus)
        # Serial ports are locked one by one when a sensor is pinged: whether a bridge runs is what its socket shows.
        in_use, connection = None, None if airframe.on_i2c else connect(sockets())
        try:
            if airframe.on_i2c:
                bus.claim()
        except BusInUse as error:
            in_use, connection = error, connect(sockets())
        with ExitStack() as stack:
            if connection is not None:
                stack.enter_context(connection)
                live: Live = RunningBridge(connection, self.clock.now)
            elif in_use is not None:
                raise ConfigError(f"{in_use}: sudo systemctl stop msp-range, then again")
            else:
                stack.callback(bus.close)
                transport = self.make_transport(airframe.link.url, self.clock)
                stack.callback(transport.close)
                live = OwnBridge(airframe, bus, self.clock, transport, self.computer)
            live.begin(airframe)
            live.record(1.0)
            yield live
