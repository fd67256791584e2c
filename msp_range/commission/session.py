"""What the steps work on: the airframe file, this computer's bus and link, and the person."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from msp_range.bus.smbus import BusInUse, KernelBus
from msp_range.clock import Clock
from msp_range.commission.live import Live, OwnBridge, RunningBridge
from msp_range.commission.operator import Person
from msp_range.config import Airframe, load_airframe
from msp_range.doctor.computer import Computer
from msp_range.mavlink.transport import Transport, open_transport
from msp_range.watch.client import connect
from msp_range.watch.place import sockets
from msp_range.yaml_file import ConfigError


@dataclass
class Session:
    """One vehicle and one person."""

    path: Path
    """The airframe file."""
    computer: Computer
    clock: Clock
    """The computer whose files doctor looks at, and the clock."""
    operator: Person
    """The person."""
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

    @contextmanager
    def live(self) -> Iterator[Live]:
        """The vehicle's sensors and autopilot: those of a bridge that runs already, or of one made for this.

        Raises
        ------
        ConfigError
            Another program uses the bus, or no autopilot is received.
        """
        airframe = self.airframe()
        bus = self.make_bus(airframe.bus)
        with ExitStack() as stack:
            try:
                bus.claim()
            except BusInUse as error:
                connection = connect(sockets())
                if connection is None:
                    raise ConfigError(f"{error}: sudo systemctl stop msp-range, then again") from None
                stack.enter_context(connection)
                live: Live = RunningBridge(connection, self.clock.now)
            else:
                stack.callback(bus.close)
                transport = self.make_transport(airframe.link.url, self.clock)
                stack.callback(transport.close)
                live = OwnBridge(airframe, bus, self.clock, transport, self.computer)
            live.begin(airframe)
            live.record(1.0)
            yield live
