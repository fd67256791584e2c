"""The sensor's beam: the largest angle off its axis at which a surface still gives an echo, as a function of range.

The half angle at a range and the field of view follow from a table of measured breakaway angles (report 4.3.3: the
largest angle of incidence with a reliable range). Between the table's rows the angle is interpolated linearly; outside
of them it is constant. The bridge's table has additional rows beyond the measured ones, from
`msp_sim.acoustics.sonar`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property

from msp_range.numbers import Numbers

NARROWEST_HALF_ANGLE_DEG = 6.0
"""Smallest half angle that is used [deg]: a choice, about half of the smallest measured one (12.6 at 200 cm). A smaller
value lets the predicted beam get narrower at long range."""


@dataclass(frozen=True)
class BreakawayTable:
    """Breakaway half angle as a function of range: never increasing, and at least 6 degrees for sound.

    Angles are between the sensor's axis and the surface's normal, to either side.

    Parameters
    ----------
    ranges_m
        Perpendicular distances to the surface [m], strictly growing, at least one.
    half_angles_deg
        Largest angle with a reliable range at each of them [deg], between 0 and 90.
    narrowest_deg
        Smaller half angles are replaced by this one [deg]; 0 for a laser.

    Raises
    ------
    ValueError
        The lengths differ, the ranges do not grow, or an angle is impossible or larger than the one before.

    Examples
    --------
    >>> beam = BreakawayTable(ranges_m=(0.5, 1.0, 1.5, 2.0), half_angles_deg=(23.4, 18.0, 14.4, 12.6))
    >>> print(f"{math.degrees(beam.half_angle_rad(1.25)):.1f}")
    16.2
    """

    ranges_m: tuple[float, ...]
    half_angles_deg: tuple[float, ...]
    narrowest_deg: float = NARROWEST_HALF_ANGLE_DEG

    def __post_init__(self) -> None:
        if len(self.ranges_m) != len(self.half_angles_deg) or not self.ranges_m:
            raise ValueError(
                f"found {len(self.ranges_m)} ranges and {len(self.half_angles_deg)} half angles, "
                "expected the same number of both, at least one"
            )
        for range_m, angle_deg in zip(self.ranges_m, self.half_angles_deg, strict=True):
            if not (range_m > 0.0 and 0.0 < angle_deg < 90.0):
                raise ValueError(
                    f"found a half angle of {angle_deg:g} deg at {100.0 * range_m:g} cm, "
                    "expected a range above 0 cm and an angle between 0 and 90 deg"
                )
        for i in range(1, len(self.ranges_m)):
            if not self.ranges_m[i] > self.ranges_m[i - 1]:
                raise ValueError(
                    f"found {100.0 * self.ranges_m[i]:g} cm after {100.0 * self.ranges_m[i - 1]:g} cm, "
                    "expected ranges that grow from row to row"
                )
            if self.half_angles_deg[i] > self.half_angles_deg[i - 1]:
                raise ValueError(
                    f"found {self.half_angles_deg[i]:g} deg at {100.0 * self.ranges_m[i]:g} cm after "
                    f"{self.half_angles_deg[i - 1]:g} deg at {100.0 * self.ranges_m[i - 1]:g} cm, "
                    "expected angles that do not increase with range: a distant echo is received at smaller angles only"
                )

    @cached_property
    def _half_angles_rad(self) -> tuple[float, ...]:
        return tuple(math.radians(max(angle_deg, self.narrowest_deg)) for angle_deg in self.half_angles_deg)

    def half_angle_rad(self, range_m: Numbers) -> Numbers:
        """Half angle of the beam at a range.

        Parameters
        ----------
        range_m : float or ndarray
            Perpendicular distance to the surface [m]. NaN gives NaN.

        Returns
        -------
        float or ndarray, same shape
            Angle from the axis [rad], linear between the table's rows and held outside them.
        """
        ranges_m, angles_rad = self.ranges_m, self._half_angles_rad
        if not isinstance(range_m, int | float):
            import numpy as np  # A vehicle needs single ranges only, and starts faster without this package.

            return np.interp(range_m, ranges_m, angles_rad)
        if range_m <= ranges_m[0]:
            return angles_rad[0]
        if range_m >= ranges_m[-1]:
            return angles_rad[-1]
        i = bisect_right(ranges_m, range_m, 1, len(ranges_m) - 1)
        share = (range_m - ranges_m[i - 1]) / (ranges_m[i] - ranges_m[i - 1])
        return angles_rad[i - 1] + share * (angles_rad[i] - angles_rad[i - 1])

    def field_of_view_rad(self, range_m: Numbers) -> Numbers:
        """Whole angle of the beam at a range [rad], twice `half_angle_rad`."""
        return 2.0 * self.half_angle_rad(range_m)
