"""The possible readings of a range finder: a grid between two limits, and codes for 'no echo'.

An MB1242 reports whole centimetres from 20 to 765, where 765 is also its code for no echo, which sometimes arrives as
255; other sensors have other limits and another step.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from msp_range.arrays import Array
from msp_range.reading_model.kernel import is_on_grid, on_grid
from msp_range.reading_model.sensor_model import SATURATED_CM, SensorModel


@dataclass(frozen=True)
class ReadingGrid:
    """Readings from the shortest to the longest, which is also the code for 'no echo'.

    Raises
    ------
    ValueError
        The sensor saturates, and 255 lies between two steps.

    Examples
    --------
    >>> lidar = ReadingGrid(minimum_cm=5, maximum_cm=8000, resolution_cm=5)
    >>> print(lidar.nearest([6.0, 8002.0, 9000.0]).tolist())
    [5.0, 8000.0, 9000.0]
    """

    minimum_cm: float
    maximum_cm: float
    resolution_cm: float = 1.0
    """Limits and step as in a sensor model file."""
    saturates: bool = False
    """Whether some no-echo codes arrive as 255."""

    def __post_init__(self) -> None:
        shares = self.saturates and self.minimum_cm <= SATURATED_CM <= self.maximum_cm
        if shares and not is_on_grid(SATURATED_CM, self.resolution_cm):
            raise ValueError(f"expected a second code outside of the limits or on the grid, found {SATURATED_CM} cm")

    @classmethod
    def of(cls, sensor: SensorModel) -> "ReadingGrid":
        """The grid of a sensor model file."""
        saturates = sensor.reading_model.saturated_fraction > 0.0
        return cls(sensor.minimum_cm, sensor.maximum_cm, sensor.resolution_cm, saturates)

    @property
    def codes_cm(self) -> tuple[float, ...]:
        """Readings that may be codes for 'no echo'."""
        return (self.maximum_cm, SATURATED_CM) if self.saturates else (self.maximum_cm,)

    def nearest(self, reading_cm: ArrayLike) -> Array:
        """Readings rounded to the grid; those outside the limits are unchanged."""
        reading, half = np.asarray(reading_cm, dtype=np.float64), self.resolution_cm / 2
        inside = (reading > self.minimum_cm - half) & (reading < self.maximum_cm + half)
        return np.where(inside, on_grid(reading, self.resolution_cm), reading)
