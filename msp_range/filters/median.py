"""Moving median (report eq 14, made causal: the report's window includes later readings)."""

import math
from collections import deque
from statistics import median
from typing import Literal

from pydantic import Field

from msp_range.filters.base import Estimate
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section


class MedianParameters(Section):
    """Median of the last ``window`` readings; removes single outliers, delays a step by half a window."""

    filter: Literal["median"]
    """the word median"""
    window: int = Field(3, ge=1, le=999)
    """number of readings (whole number, 1 to 999)"""

    def make(self, sensor: SensorModel | None = None) -> "Median":
        """Make a filter in its initial state."""
        return Median(self.window)


class Median:
    """y[i] = median of x[i - M + 1] ... x[i]; of fewer until there are M readings."""

    def __init__(self, window: int) -> None:
        self._recent: deque[Estimate] = deque(maxlen=window)

    def update(self, time_s: float, measured: Estimate) -> Estimate:
        """Variance of the median of M independent normal readings, about (pi / 2) sigma^2 / M, for M of 3 or more."""
        self._recent.append(measured)
        count = len(self._recent)
        variance_m2 = sum([each.variance_m2 for each in self._recent]) / count**2
        if count > 2:
            variance_m2 *= math.pi / 2
        return Estimate(median([each.range_m for each in self._recent]), variance_m2)

    def reset(self) -> None:
        """Forget all readings."""
        self._recent.clear()
