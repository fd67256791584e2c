"""Whether the bus works, from the rangings that it failed."""

import errno

from msp_range.health.conditions import Condition, Severity
from msp_range.sensors.polling import Ranging

WORKS_AGAIN_S = 2.0
"""A bus that has worked for this long since its last fault works again [s]. One that fails again within it is reported
once; longer reports later that it is back."""
_NOT_OPENED = {errno.ENOENT: "no I2C bus: enable I2C", errno.EACCES: "no permission for the I2C bus"}


class BusHealth:
    """The bus that all sensors are on."""

    def __init__(self) -> None:
        self._text = ""
        self._fault_s = float("-inf")

    def on_ranging(self, now_s: float, ranging: Ranging) -> None:
        """Check a ranging for a fault that is the bus's and not its sensor's."""
        error = ranging.error
        if error is not None and error.bus_at_fault:
            self._fault_s = now_s
            what = "I2C bus locked up, reopening" if error.locked_up else "I2C bus gone, reopening"
            if error.never_opened:
                what = _NOT_OPENED.get(error.errno or 0, "I2C bus cannot be opened")
            self._text = f"Range: {what} (errno {error.errno})"

    def conditions(self, now_s: float) -> list[Condition]:
        """As it is now."""
        works = now_s - self._fault_s > WORKS_AGAIN_S
        return [Condition("bus", None if works else self._text, "Range: I2C bus works again", Severity.ERROR)]
