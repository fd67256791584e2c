"""Whether the bus works, from the rangings that it failed."""

import errno

from msp_range.health.conditions import Condition, Severity
from msp_range.sensors.polling import Ranging

WORKS_AGAIN_S = 2.0
"""A bus that has worked for this long since its last fault works again [s]. One that fails again within it is reported
once; longer reports later that it is back."""
_NOT_OPENED = {errno.ENOENT: "no I2C bus: enable I2C", errno.EACCES: "no permission for the I2C bus"}

_REMEDY = "check the adapter's plug, the wires of data and clock and the sensors' power; msp-range doctor says more"


class BusHealth:
    """The bus that all sensors are on."""

    _text = ""
    _fault_s, _last_s = float("-inf"), 0.0

    def on_stuck(self, now_s: float) -> None:
        """Record that a transfer does not end: every device waits for it, whatever it ends with."""
        if self._works:
            self._text = "Range: I2C bus locked up, transfer does not end"
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
            what = "I2C bus locked up, reopening" if error.locked_up else "I2C bus gone, reopening"
            if error.never_opened:
                what = _NOT_OPENED.get(error.errno or 0, "I2C bus cannot be opened")
            self._text = f"Range: {what} (errno {error.errno})"

    def condition(self) -> Condition:
        """As it is now."""
        text, over = None if self._works else self._text, "Range: I2C bus works again"
        return Condition("bus", text, over, Severity.ERROR, remedy=_REMEDY)
