"""A filter: exponential smoothing with a time constant."""

import math
from typing import Literal

from pydantic import Field

from msp_range.filters.base import Estimate
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section


class LowPassParameters(Section):
    """y += (1 - exp(-dt / tau)) (x - y); delays a ramp by the time constant."""

    filter: Literal["low_pass"]
    """the word low_pass"""
    time_constant_s: float = Field(0.3, gt=0, le=10)
    """tau [s]"""

    def make(self, sensor: SensorModel) -> "LowPass":
        """A filter in its starting state."""
        return LowPass(self.time_constant_s)


class LowPass:
    """Exponential smoothing of ranges; the variance is that of a weighted mean of independent readings."""

    def __init__(self, time_constant_s: float) -> None:
        self._time_constant_s = time_constant_s
        self._last: tuple[float, Estimate] | None = None

    def update(self, time_s: float, measured: Estimate) -> Estimate:
        """Move towards the reading by as much as the time since the last one allows."""
        estimate = measured
        if self._last is not None:
            last_s, before = self._last
            weight = -math.expm1(-(time_s - last_s) / self._time_constant_s)
            estimate = Estimate(
                before.range_m + weight * (measured.range_m - before.range_m),
                (1.0 - weight) ** 2 * before.variance_m2 + weight**2 * measured.variance_m2,
            )
        self._last = time_s, estimate
        return estimate

    def reset(self) -> None:
        """Forget all readings."""
        self._last = None
