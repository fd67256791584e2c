"""The sonar equation of one kind of sensor: how far off its axis it hears a wall, at ranges where nobody measured.

A table of breakaway angles (report 4.3.3) enters, its three parameters are fitted, half angles beyond the table leave.
An echo is heard where its level (`msp_range.acoustics.echo`) is over the detection threshold.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

from msp_range.acoustics.atmosphere import Atmosphere
from msp_range.acoustics.beam import NARROWEST_HALF_ANGLE_DEG, BreakawayTable
from msp_range.acoustics.echo import WALL, Target, echo_level_db
from msp_range.acoustics.least_squares import least_squares
from msp_range.acoustics.piston import main_lobe_x

STEP_DEG = 1.8
"""Step of the report's motor [deg]: what a breakaway angle is known to, and a fit must come as near."""

PARAMETERS = 3
"""Source level, piston, gain: a table with fewer rows cannot tell them."""

STEP_M = 0.25
"""Between the rows that the equation adds to a table [m]: the angle is linear in between to 0.1 deg."""

ROOM = Atmosphere()
"""The air of the report's laboratory: 20 deg C, 50 %, one atmosphere. Its absorption and the gain add up to one slope
over range, so what the real air took is in the fitted gain."""


@dataclass(frozen=True)
class Sonar:
    """A sonar equation, EL(R, theta) >= DT(R).

    Parameters
    ----------
    source_level_db
        On the axis at 1 m, over the detection threshold at no range [dB].
    piston_diameter_m
        Of the flat circular piston that would have the same directivity [m].
    gain_db_per_m
        How much the receiver's gain grows, or its threshold falls, with each metre of range [dB/m].
    frequency_hz
        Of the ping [Hz].

    Notes
    -----
    Angles against a mirror fix how the level falls off the axis, not how much there is to spare on it: the fit to the
    report's table has 3 to 10 dB, so that grass or snow would hardly be heard, yet ultrasonic sensors measure the
    depth of snow. Take half angles from it, and nothing about weak targets.
    """

    source_level_db: float
    piston_diameter_m: float
    gain_db_per_m: float
    frequency_hz: float

    def threshold_db(self, range_m: float) -> float:
        """Detection threshold DT(R) = -g R, over that at no range [dB].

        Sensors like this one raise their gain while they wait for the echo, since a late echo is a weak one. A gain
        that is linear in dB over time is assumed; what it is in the part is not published.
        """
        return -self.gain_db_per_m * range_m

    def excess_db(
        self, range_m: float, off_axis_rad: float = 0.0, target: Target = WALL, air: Atmosphere = ROOM
    ) -> float:
        """EL(R, theta) - DT(R) [dB]: 0 or more is heard. Arguments as in `echo_level_db`."""
        level = echo_level_db(
            self.source_level_db, range_m, off_axis_rad, target, air, self.piston_diameter_m, self.frequency_hz
        )
        return level - self.threshold_db(range_m)

    def half_angle_rad(self, range_m: float, target: Target = WALL, air: Atmosphere = ROOM) -> float | None:
        """Largest angle off the axis at which the target is heard.

        Parameters
        ----------
        range_m
            Perpendicular distance, above 0 [m].
        target, air
            What reflects, and what is between.

        Returns
        -------
        float or None
            0 up to the piston's first null, or pi / 2 where it has none [rad]; None where nothing is heard even on the
            axis. Side lobes do not count.
        """
        excess_db = self.excess_db(range_m, 0.0, target, air)
        if excess_db < 0.0:
            return None
        return _angle_rad(excess_db, self.piston_diameter_m, air.wavelength_m(self.frequency_hz))


def fit_sonar(table: BreakawayTable, frequency_hz: float, on_axis_m: float | None = None) -> Sonar:
    """The sonar equation whose half angles are nearest to a table's, in the sense of least squares.

    It has three parameters. The report's table has four rows: one degree of freedom is left, so agreement with the
    table is hardly evidence. `leave_one_out` is the honest question, and beyond the table the equation is an
    extrapolation whose shape is assumed.

    Parameters
    ----------
    table
        Breakaway angles against a large flat wall that reflects nearly all, at least three rows.
    frequency_hz
        Of the ping [Hz].
    on_axis_m
        Range at which a wall is heard on the axis at least [m]; the fit keeps to it. None: the table's last range.

    Returns
    -------
    Sonar
        In the air of `ROOM`.

    Raises
    ------
    ValueError
        The table has fewer rows than the equation has parameters.

    Examples
    --------
    >>> report = BreakawayTable(ranges_m=(0.5, 1.0, 1.5, 2.0), half_angles_deg=(23.4, 18.0, 14.4, 12.6))
    >>> sonar = fit_sonar(report, 42_000.0, on_axis_m=5.0)
    >>> [f"{math.degrees(sonar.half_angle_rad(range_m)):.1f}" for range_m in report.ranges_m]
    ['23.4', '17.9', '14.5', '12.5']
    """
    if len(table.ranges_m) < PARAMETERS:
        raise ValueError(
            f"found {len(table.ranges_m)} breakaway angles, expected at least {PARAMETERS}: "
            "the sonar equation has so many parameters"
        )
    kept_m = max(on_axis_m or 0.0, table.ranges_m[-1])
    wavelength_m = ROOM.wavelength_m(frequency_hz)

    def sonar_of(parameters: Sequence[float]) -> Sonar:
        # The first parameter is the excess on the axis at the range to keep to: at least 0 dB.
        excess_db, log_diameter, gain_db_per_m = parameters
        silent = Sonar(0.0, math.exp(log_diameter), gain_db_per_m, frequency_hz)
        source_level_db = excess_db - silent.excess_db(kept_m)
        return Sonar(source_level_db, silent.piston_diameter_m, gain_db_per_m, frequency_hz)

    def misses_deg(parameters: Sequence[float]) -> list[float]:
        sonar = sonar_of(parameters)
        # Below the threshold the angle goes on as its mirror image, so that the fit finds its way back.
        excesses_db = [sonar.excess_db(range_m) for range_m in table.ranges_m]
        angles_rad = [
            math.copysign(_angle_rad(abs(excess_db), sonar.piston_diameter_m, wavelength_m), excess_db)
            for excess_db in excesses_db
        ]
        return [
            math.degrees(angle_rad) - angle_deg
            for angle_rad, angle_deg in zip(angles_rad, table.half_angles_deg, strict=True)
        ]

    # A piston that is 12 dB down there and back, x = 2.2, at the widest angle of the table.
    diameter_m = 2.2 * wavelength_m / (math.pi * math.sin(math.radians(table.half_angles_deg[0])))
    start = [3.0, math.log(diameter_m), 5.0]
    return sonar_of(least_squares(misses_deg, start, [0.0, -math.inf, 0.0]))


def leave_one_out(table: BreakawayTable, frequency_hz: float, on_axis_m: float | None = None) -> list[float | None]:
    """Each half angle of a table as the other rows predict it.

    With four rows and three parameters each prediction comes from an equation that passes through the three others
    exactly: it tests the equation's shape and nothing else.

    Parameters
    ----------
    table, frequency_hz, on_axis_m
        As in `fit_sonar`, at least four rows.

    Returns
    -------
    list of float or None
        Predicted half angle of each row [deg]; None where no echo is predicted.

    Raises
    ------
    ValueError
        Without one there are too few rows.
    """
    predicted: list[float | None] = []
    for i, range_m in enumerate(table.ranges_m):
        others = BreakawayTable(_without(table.ranges_m, i), _without(table.half_angles_deg, i))
        angle_rad = fit_sonar(others, frequency_hz, on_axis_m).half_angle_rad(range_m)
        predicted.append(None if angle_rad is None else math.degrees(angle_rad))
    return predicted


@lru_cache(maxsize=16)
def extended_beam(
    table: BreakawayTable, maximum_m: float, frequency_hz: float, on_axis_m: float | None = None
) -> BreakawayTable:
    """A measured table, carried on by the sonar equation that is fitted to it.

    The measured rows stay as they are. Beyond them the angle is the equation's but never grows with range: a gain that
    outruns the losses would widen the beam, which nobody has seen. Where the equation predicts no echo, or none can be
    had (too few rows, a fit that misses one by more than a step), the last angle is held and `known_to_m` says from
    where on.

    Parameters
    ----------
    table
        Measured breakaway angles.
    maximum_m
        Longest range of the sensor [m].
    frequency_hz, on_axis_m
        As in `fit_sonar`.

    Returns
    -------
    BreakawayTable
        The table with a row each 25 cm up to the longest range.
    """
    ranges_m, angles_deg = list(table.ranges_m), list(table.half_angles_deg)
    sonar = _trusted_fit(table, frequency_hz, on_axis_m)
    known_to_m = ranges_m[-1]
    while sonar is not None and known_to_m < maximum_m:
        range_m = min(known_to_m + STEP_M, maximum_m)
        angle_rad = sonar.half_angle_rad(range_m)
        if angle_rad is None:
            break
        known_to_m = range_m
        ranges_m.append(range_m)
        angles_deg.append(min(angles_deg[-1], max(math.degrees(angle_rad), NARROWEST_HALF_ANGLE_DEG)))
    return BreakawayTable(
        tuple(ranges_m), tuple(angles_deg), known_to_m=known_to_m if known_to_m < maximum_m else math.inf
    )


def _trusted_fit(table: BreakawayTable, frequency_hz: float, on_axis_m: float | None) -> Sonar | None:
    if len(table.ranges_m) < PARAMETERS:
        return None
    sonar = fit_sonar(table, frequency_hz, on_axis_m)
    for range_m, angle_deg in zip(table.ranges_m, table.half_angles_deg, strict=True):
        angle_rad = sonar.half_angle_rad(range_m)
        if angle_rad is None or abs(math.degrees(angle_rad) - angle_deg) > STEP_DEG:
            return None
    return sonar


def _angle_rad(excess_db: float, diameter_m: float, wavelength_m: float) -> float:
    """Angle within the main lobe at which a piston is ``excess_db``, 0 or more, down there and back [rad]."""
    sine = main_lobe_x(excess_db / 2.0) * wavelength_m / (math.pi * diameter_m)
    return math.asin(sine) if sine < 1.0 else math.pi / 2


def _without(values: Sequence[float], i: int) -> tuple[float, ...]:
    return (*values[:i], *values[i + 1 :])
