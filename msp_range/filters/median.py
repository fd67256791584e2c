"""Moving median (report eq 14, made causal: the report's window includes later readings)."""

import math
from collections.abc import Sequence
from statistics import median
from typing import Literal

from pydantic import Field

from msp_range.filters.base import Estimate, Windowed
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section


class MedianParameters(Section):
    """Median of the last ``window`` readings; removes single outliers, delays a step by half a window."""

    filter: Literal["median"]
    """the word median"""
    window: int = Field(3, ge=1, le=999)
    """number of readings (whole number, 1 to 999)"""

    def make(self, sensor: SensorModel) -> Windowed:
        """Make a filter in its initial state."""
        return Windowed(self.window, _median)


def _median(ranges_m: Sequence[float], mean_variance_m2: float) -> Estimate:
    """y[i] = median of x[i - M + 1] ... x[i]; its variance is about (pi / 2) sigma^2 / M, for M of 3 or more.

    That is the variance of the median of M independent normal readings.
    """
    return Estimate(median(ranges_m), mean_variance_m2 * (math.pi / 2 if len(ranges_m) > 2 else 1.0))
