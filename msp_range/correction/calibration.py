"""A sensor's calibration: its mean reading as a piecewise linear function of true range, and the inverse.

By the knots of a sensor model file, `forward` gives the reading for a true range (for the simulator and the
likelihood), and `inverse` the range for a reading (for the bridge). Piecewise linear, because the literature that the
report follows corrects such range finders in this way (Gontean and others). Knots are valid for air at the sensor's
calibration temperature: offset and scale arise in the sensor's clock and not in the air.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Protocol

from msp_range.numbers import Numbers

if TYPE_CHECKING:
    from collections.abc import Sequence

SLOPES = (0.5, 2.0)
"""Limits of the slope [cm of reading per cm of range]; a flatter or steeper segment is an error and not a
calibration."""


@dataclass(frozen=True)
class Calibration:
    """Mean reading as a function of true range, linear between knots and extrapolated beyond them.

    Parameters
    ----------
    true_cm
        True ranges of the knots [cm], strictly increasing: none (the reading is the range) or at least two.
    reading_cm
        Mean reading at each [cm], strictly growing.

    Raises
    ------
    ValueError
        A single knot, different lengths, knots that do not increase, or a slope outside `SLOPES`.

    Examples
    --------
    >>> calibration = Calibration(true_cm=(100.0, 200.0, 400.0), reading_cm=(102.0, 203.0, 405.0))
    >>> print(calibration.forward(300.0), calibration.inverse(405.0))
    304.0 400.0
    """

    true_cm: tuple[float, ...] = ()
    reading_cm: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.true_cm) != len(self.reading_cm) or len(self.true_cm) == 1:
            raise ValueError(
                f"found {len(self.true_cm)} true ranges and {len(self.reading_cm)} readings as knots, "
                "expected none or at least two pairs: one alone has no slope"
            )
        knots = zip(self.true_cm, self.reading_cm, strict=True)
        for (true_cm, reading_cm), (next_cm, next_reading_cm) in pairwise(knots):
            rise_cm, run_cm = next_reading_cm - reading_cm, next_cm - true_cm
            if not (run_cm > 0.0 and SLOPES[0] * run_cm <= rise_cm <= SLOPES[1] * run_cm):
                raise ValueError(
                    f"found the knots ({true_cm:g}, {reading_cm:g}) and ({next_cm:g}, {next_reading_cm:g}) cm, "
                    "expected true ranges that grow from knot to knot, and readings that grow by "
                    f"{SLOPES[0]:g} to {SLOPES[1]:g} times as much"
                )

    @property
    def is_identity(self) -> bool:
        """True if there are no knots: the reading is the range."""
        return not self.true_cm

    def forward(self, true_cm: Numbers) -> Numbers:
        """Mean reading [cm], before rounding and limits, at a true range [cm]; NaN and infinity are kept."""
        return true_cm if self.is_identity else piecewise_linear(self.true_cm, self.reading_cm, true_cm)

    def inverse(self, reading_cm: Numbers) -> Numbers:
        """Range [cm] with this mean reading: the inverse of `forward`."""
        return reading_cm if self.is_identity else piecewise_linear(self.reading_cm, self.true_cm, reading_cm)


IDENTITY = Calibration()
"""The reading is the range."""


class Knot(Protocol):
    """A knot of a calibration: a true range, and the mean reading there [cm]."""

    @property
    def true_cm(self) -> float: ...
    @property
    def reading_cm(self) -> float: ...


def curve_through(knots: Sequence[Knot]) -> Calibration:
    """The calibration through these knots; ValueError as of `Calibration`."""
    return Calibration(tuple(knot.true_cm for knot in knots), tuple(knot.reading_cm for knot in knots))


def piecewise_linear(x: tuple[float, ...], y: tuple[float, ...], at: Numbers) -> Numbers:
    """Value of the piecewise linear function through points, extrapolated beyond them."""
    if isinstance(at, int | float):
        i = bisect_right(x[1:-1], at)
        return y[i] + (y[i + 1] - y[i]) / (x[i + 1] - x[i]) * (at - x[i])
    import numpy as np  # A vehicle needs single ranges only, and starts faster without this package.

    places, values = np.array(x), np.array(y)
    pieces = np.searchsorted(places[1:-1], at, side="right")
    slopes = np.diff(values) / np.diff(places)
    return np.asarray(values[pieces] + slopes[pieces] * (at - places[pieces]))
