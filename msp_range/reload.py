"""Replace the airframe file while the service runs (SIGHUP).

A valid file is used at once, but never while the vehicle is armed; an invalid one, or one whose bus another process
uses, changes nothing. Both are reported to the pilot and logged.
"""

from collections.abc import Callable

from msp_range.bridge import Bridge
from msp_range.bus.smbus import KernelBus
from msp_range.config import Airframe
from msp_range.log import Log
from msp_range.pilot_texts import Text


class FlownAirframe:
    """The present airframe and its bus, which is locked against other processes from construction on.

    Parameters
    ----------
    airframe
        The first airframe.
    load
        Reads the airframe file again.
    requests
        One entry for each request to read the file again; emptied here.
    log
        Log for the details.

    Attributes
    ----------
    airframe : Airframe
        The present airframe.
    bus : KernelBus
        The airframe's bus.

    Raises
    ------
    BusInUse
        Another process uses the bus.
    """

    def __init__(self, airframe: Airframe, load: Callable[[], Airframe], requests: list[int], log: Log) -> None:
        self._load = load
        self._requests = requests
        self._log = log
        self.airframe = airframe
        self.bus = KernelBus(self.airframe.bus)
        if airframe.on_i2c:
            self.bus.claim()

    def has_changed(self, bridge: Bridge) -> bool:
        """Read the file again if that was requested and is allowed now; True if the airframe has changed."""
        if not self._requests:
            return False
        armed = bridge.link.autopilot_armed
        bridge.health.set(Text.RELOAD_WAITS.when(armed))
        if armed:
            return False
        self._requests.clear()
        try:
            airframe = self._load()
            bus = KernelBus(airframe.bus)
            if bus.path != self.bus.path:
                if airframe.on_i2c:
                    bus.claim()
                self.bus.close()
                self.bus = bus
        except Exception as error:  # after any error the vehicle continues with the present airframe
            self._log.error("airframe file not reloaded", error=str(error) or repr(error))
            bridge.notify(*Text.NOT_VALID.said())
            return False
        self.airframe = airframe
        bridge.notify(*Text.RELOADED.said())
        return True
