"""Moving average (report eq 13, causal: the mean of the newest readings, not of later ones)."""

from collections.abc import Sequence
from typing import Literal

from pydantic import Field

from msp_range.filters.base import Estimate, Windowed
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section


class MovingAverageParameters(Section):
    """Mean of the last ``window`` readings; delays a ramp by half a window."""

    filter: Literal["moving_average"]
    """the word moving_average"""
    window: int = Field(5, ge=1, le=1000)
    """number of readings (whole number, 1 to 1000)"""

    def make(self, sensor: SensorModel) -> Windowed:
        """Make a filter in its initial state."""
        return Windowed(self.window, _mean)


def _mean(ranges_m: Sequence[float], mean_variance_m2: float) -> Estimate:
    """y[i] = (1/M) sum over j = 0..M-1 of x[i - j]."""
    return Estimate(sum(ranges_m) / len(ranges_m), mean_variance_m2)
