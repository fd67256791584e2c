"""The airframe file that is flown, and how another one takes its place while the service runs (SIGHUP).

A valid file is taken at once, but never while the vehicle is armed; one that is not valid, or whose bus another process
uses, changes nothing. Either is reported to the pilot and logged.
"""

from collections.abc import Callable

from msp_range.bridge import Bridge
from msp_range.bus.smbus import KernelBus
from msp_range.config import Airframe
from msp_range.health import Severity
from msp_range.log import Log


class FlownAirframe:
    """The airframe and its bus, which is locked against other processes from here on.

    Parameters
    ----------
    airframe
        What to fly at first.
    load
        Reads the airframe file again.
    requests
        One entry for each time that the file is to be read again; emptied here.
    log
        Where the details go.

    Attributes
    ----------
    airframe : Airframe
        What is to be flown.
    bus : KernelBus
        Its bus.

    Raises
    ------
    BusInUse
        Another process works on the bus.
    """

    def __init__(self, airframe: Airframe, load: Callable[[], Airframe], requests: list[int], log: Log) -> None:
        self._load = load
        self._requests = requests
        self._log = log
        self.airframe = airframe
        self.bus = KernelBus(self.airframe.bus)
        self.bus.claim()

    def has_changed(self, bridge: Bridge) -> bool:
        """Read the file again where that was asked for and can be done now; True: another airframe is to be flown."""
        if not self._requests:
            return False
        armed = bridge.link.autopilot_armed
        waits = "Range: airframe reload waits for disarming" if armed else None
        bridge.health.set("reload", waits, "Range: disarmed, reloading the airframe", Severity.INFO)
        if armed:
            return False
        self._requests.clear()
        try:
            airframe = self._load()
            bus = KernelBus(airframe.bus)
            if bus.path != self.bus.path:
                bus.claim()
                self.bus.close()
                self.bus = bus
        except Exception as error:  # whatever it is, the vehicle flies on with what it has
            self._log.error("airframe file not reloaded", error=str(error) or repr(error))
            bridge.notify(Severity.WARNING, "Range: airframe file not valid, old one flies")
            return False
        self.airframe = airframe
        bridge.notify(Severity.INFO, "Range: airframe file reloaded")
        return True
