"""The possible readings of a range finder: a grid between two limits, and codes for 'no echo'.

An MB1242 reports whole centimetres from 20 to 765, where 765 is also its code for no echo, which sometimes arrives as
255; other sensors have other limits and another step. Readings enter, their cells on the grid leave.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msp_range.arrays import Array
from msp_range.reading_model.sensor_model import SATURATED_CM, SensorModel

ON_GRID = 1e-3
"""Tolerance for readings on the grid, as a share of a step: for rounding errors of metres converted to centimetres."""

NO_ECHO = -1
"""Cell of the no-echo code."""
SECOND_NO_ECHO = -2
"""Cell of the second no-echo code."""
NOWHERE = -3
"""Cell of impossible readings."""


@dataclass(frozen=True)
class ReadingGrid:
    """Readings minimum_cm, minimum_cm + resolution_cm, ... maximum_cm, which is also the code for 'no echo'.

    Parameters
    ----------
    minimum_cm, maximum_cm
        Shortest and longest reading.
    resolution_cm
        Step of the readings; for a nearly continuous sensor the resolution with which its file was written.
    second_no_echo_cm
        Code as which some missed echoes arrive, on the grid (255 of an MB1242) or outside its limits; None: there is no
        second code.

    Raises
    ------
    ValueError
        The second code lies between two steps.

    Examples
    --------
    >>> lidar = ReadingGrid(minimum_cm=5, maximum_cm=8000, resolution_cm=5)
    >>> print(lidar.cells, lidar.cell([5, 20, 8000, 22, -7]))
    1600 [ 0  3 -1 -3 -3]
    """

    minimum_cm: float
    maximum_cm: float
    resolution_cm: float = 1.0
    second_no_echo_cm: float | None = None

    def __post_init__(self) -> None:
        code_cm, cell = self.second_no_echo_cm, self.second_cell
        if code_cm is not None and cell is not None:
            off_cm = self.minimum_cm + self.resolution_cm * cell - code_cm
            if abs(off_cm) > ON_GRID * self.resolution_cm:
                raise ValueError(f"expected a second code outside of the limits or on the grid, found {code_cm:g} cm")

    @classmethod
    def of(cls, sensor: SensorModel) -> "ReadingGrid":
        """The grid of a sensor model file: 255 is a second code if some missed echoes arrive as it."""
        saturates = sensor.reading_model.saturated_fraction > 0.0
        second_cm = SATURATED_CM if saturates and sensor.minimum_cm <= SATURATED_CM < sensor.maximum_cm else None
        return cls(sensor.minimum_cm, sensor.maximum_cm, sensor.resolution_cm, second_cm)

    @cached_property
    def cells(self) -> int:
        """Number of readings on the grid."""
        return round((self.maximum_cm - self.minimum_cm) / self.resolution_cm) + 1

    @property
    def second_cell(self) -> int | None:
        """Cell of the grid that the second code shares; None if it is off the grid, or there is none."""
        code_cm = self.second_no_echo_cm
        if code_cm is None or not self.minimum_cm <= code_cm <= self.maximum_cm:
            return None
        return round((code_cm - self.minimum_cm) / self.resolution_cm)

    def cell(self, reading_cm: ArrayLike) -> NDArray[np.int64]:
        """Cell of each reading: 0 for the shortest, `NO_ECHO`, `SECOND_NO_ECHO`, or `NOWHERE`."""
        reading = np.asarray(reading_cm, dtype=np.float64)
        steps = (reading - self.minimum_cm) / self.resolution_cm
        nearest = np.rint(steps)
        on_grid = (np.abs(steps - nearest) <= ON_GRID) & (nearest >= 0) & (nearest < self.cells)
        cell = np.full(reading.shape, NOWHERE, dtype=np.int64)
        cell[on_grid] = nearest[on_grid]
        for code_cm, name in ((self.maximum_cm, NO_ECHO), (self.second_no_echo_cm, SECOND_NO_ECHO)):
            if code_cm is not None:
                cell[np.abs(reading - code_cm) <= ON_GRID * self.resolution_cm] = name
        return cell

    def nearest(self, reading_cm: ArrayLike) -> Array:
        """Readings rounded to the grid; codes and readings outside the limits are unchanged."""
        reading = np.array(reading_cm, dtype=np.float64)
        half = self.resolution_cm / 2
        inside = (reading > self.minimum_cm - half) & (reading < self.maximum_cm + half)
        inside &= self.cell(reading) == NOWHERE
        steps = np.rint((reading[inside] - self.minimum_cm) / self.resolution_cm)
        reading[inside] = self.minimum_cm + self.resolution_cm * steps
        return reading
