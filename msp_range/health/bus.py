"""Whether the bus works, from the rangings that it failed."""

import errno

from msp_range.pilot_texts import Condition, Text
from msp_range.sensors.polling import Ranging

WORKS_AGAIN_S = 2.0
"""A bus that has worked for this long since its last fault works again [s]. One that fails again within it is reported
once; longer reports later that it is back."""
_NOT_OPENED = {errno.ENOENT: Text.NO_BUS, errno.EACCES: Text.BUS_REFUSED}


class BusHealth:
    """The bus that all sensors are on."""

    _fault = Text.BUS
    _fault_s, _last_s = float("-inf"), 0.0

    def on_stuck(self, now_s: float) -> None:
        """Record that a transfer does not end: every device waits for it, whatever it ends with."""
        if self._works:
            self._fault = Text.BUS_STUCK
        self._fault_s = self._last_s = now_s

    @property
    def _works(self) -> bool:
        # Not by the time that has passed: one transfer may take longer than that.
        return self._last_s - self._fault_s > WORKS_AGAIN_S

    def on_ranging(self, now_s: float, ranging: Ranging) -> None:
        """Check a ranging for a fault that is the bus's and not its sensor's."""
        error = ranging.error
        self._last_s = now_s
        if error is not None and error.bus_at_fault:
            self._fault_s = now_s
            fault = Text.BUS_LOCKED_UP if error.locked_up else Text.BUS
            if error.never_opened:
                fault = _NOT_OPENED.get(error.errno or 0, Text.BUS_NOT_OPENED)
            self._fault = fault.when(True, errno=error.errno)

    def condition(self) -> Condition:
        """As it is now."""
        return self._fault.when(not self._works)
