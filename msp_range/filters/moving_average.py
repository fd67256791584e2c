"""Moving average (report eq 13, causal: the mean of the newest readings, not of later ones)."""

from collections import deque
from typing import Literal

from pydantic import Field

from msp_range.filters.base import Estimate
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section


class MovingAverageParameters(Section):
    """Mean of the last ``window`` readings; delays a ramp by half a window."""

    filter: Literal["moving_average"]
    """the word moving_average"""
    window: int = Field(5, ge=1, le=1000)
    """number of readings (whole number, 1 to 1000)"""

    def make(self, sensor: SensorModel | None = None) -> "MovingAverage":
        """Make a filter in its initial state."""
        return MovingAverage(self.window)


class MovingAverage:
    """y[i] = (1/M) sum over j = 0..M-1 of x[i - j]; of fewer until there are M readings."""

    def __init__(self, window: int) -> None:
        self._recent: deque[Estimate] = deque(maxlen=window)

    def update(self, time_s: float, measured: Estimate) -> Estimate:
        """Variance of the mean of independent readings: sum of the variances / M^2."""
        self._recent.append(measured)
        count = len(self._recent)
        return Estimate(
            sum([each.range_m for each in self._recent]) / count,
            sum([each.variance_m2 for each in self._recent]) / count**2,
        )

    def reset(self) -> None:
        """Forget all readings."""
        self._recent.clear()
