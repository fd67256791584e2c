"""The sonar equation of a sensor: the largest angle at which it detects a wall, at ranges that were not measured.

A table of breakaway angles (report 4.3.3) enters, its three parameters are fitted, half angles beyond the table leave.
An echo is detected if its level (`msp_sim.acoustics.echo`) is above the detection threshold.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from msp_range.acoustics.beam import NARROWEST_HALF_ANGLE_DEG, BreakawayTable
from msp_sim.acoustics.atmosphere import Atmosphere
from msp_sim.acoustics.echo import WALL, Target, echo_level_db
from msp_sim.acoustics.piston import main_lobe_x

STEP_DEG = 1.8
"""Step of the report's motor [deg]: the uncertainty of a breakaway angle, and so the largest error of an accepted
fit."""

PARAMETERS = 3
"""Number of parameters (source level, piston, gain), and so the smallest number of rows for a fit."""

STEP_M = 0.25
"""Distance of the rows that the equation adds to a table [m]; between them the angle is linear to 0.1 deg."""

ROOM = Atmosphere()
"""The air of the report's laboratory: 20 deg C, 50 %, one atmosphere. Absorption and gain add up to
one slope over range, so an error of the absorption is compensated by the fitted gain."""


@dataclass(frozen=True)
class Sonar:
    """A sonar equation, EL(R, theta) >= DT(R).

    Parameters
    ----------
    source_level_db
        Level on the axis at 1 m, relative to the detection threshold at range 0 [dB].
    piston_diameter_m
        Diameter of the flat circular piston with the same directivity [m].
    gain_db_per_m
        How much the receiver's gain grows, or its threshold falls, with each metre of range [dB/m].
    frequency_hz
        Frequency of the ping [Hz].

    Notes
    -----
    Breakaway angles of a wall determine how the level falls off the axis, but hardly the level on the axis: the fit to
    the report's table has 3 to 10 dB above the threshold, by which grass or snow would hardly be detected, yet
    ultrasonic sensors measure snow depth. Use it for half angles, and not for weak targets.
    """

    source_level_db: float
    piston_diameter_m: float
    gain_db_per_m: float
    frequency_hz: float

    def excess_db(
        self, range_m: float, off_axis_rad: float = 0.0, target: Target = WALL, air: Atmosphere = ROOM
    ) -> float:
        """EL(R, theta) - DT(R) [dB]: detected if 0 or more. Arguments as in `echo_level_db`.

        The detection threshold is DT(R) = -g R relative to that at range 0: such sensors raise their gain while they
        wait for the echo, because a late echo is weak. A gain that is linear in dB over time is assumed; the sensor's
        actual gain is not published.
        """
        level_db = echo_level_db(
            self.source_level_db, range_m, off_axis_rad, target, air, self.piston_diameter_m, self.frequency_hz
        )
        return level_db + self.gain_db_per_m * range_m

    def half_angle_rad(self, range_m: float, target: Target = WALL, air: Atmosphere = ROOM) -> float | None:
        """Largest angle off the axis at which the target is detected.

        Parameters
        ----------
        range_m
            Perpendicular distance, above 0 [m].
        target, air
            What reflects, and what is between.

        Returns
        -------
        float or None
            0 up to the piston's first null, or to pi / 2 if it has none [rad]; None if the target is not detected even
            on the axis. Side lobes do not count.
        """
        excess_db = self.excess_db(range_m, 0.0, target, air)
        if excess_db < 0.0:
            return None
        return _angle_rad(excess_db, self.piston_diameter_m, air.wavelength_m(self.frequency_hz))

    def half_angle_deg(self, range_m: float) -> float | None:
        """`half_angle_rad` of a wall in the air of `ROOM` [deg]."""
        angle_rad = self.half_angle_rad(range_m)
        return None if angle_rad is None else math.degrees(angle_rad)

    def fits(self, table: BreakawayTable) -> bool:
        """Whether every angle of a table is met within a step of the motor."""
        return all(
            (fitted_deg := self.half_angle_deg(range_m)) is not None and abs(fitted_deg - angle_deg) <= STEP_DEG
            for range_m, angle_deg in zip(table.ranges_m, table.half_angles_deg, strict=True)
        )


def fit_sonar(table: BreakawayTable, frequency_hz: float, on_axis_m: float | None = None) -> Sonar:
    """Fit the sonar equation to the half angles of a table by least squares.

    It has three parameters and the report's table four rows, so one degree of freedom is left, and agreement with the
    table is weak evidence. `leave_one_out` is a better test. Beyond the table the equation is an extrapolation.

    Parameters
    ----------
    table
        Breakaway angles against a large flat wall that reflects nearly all, at least three rows.
    frequency_hz
        Frequency of the ping [Hz].
    on_axis_m
        Range up to which a wall is detected on the axis [m]; a constraint of the fit. None: the table's last range.

    Returns
    -------
    Sonar
        Fitted with the air of `ROOM`.

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
            "the sonar equation has that many parameters"
        )
    kept_m = max(on_axis_m or 0.0, table.ranges_m[-1])
    wavelength_m = ROOM.wavelength_m(frequency_hz)

    def sonar_of(parameters: Sequence[float]) -> Sonar:
        # The first parameter is the excess on the axis at that range: at least 0 dB.
        excess_db, log_diameter, gain_db_per_m = parameters
        silent = Sonar(0.0, math.exp(log_diameter), gain_db_per_m, frequency_hz)
        return replace(silent, source_level_db=excess_db - silent.excess_db(kept_m))

    def misses_deg(parameters: Sequence[float]) -> list[float]:
        sonar, misses = sonar_of(parameters), []
        for range_m, angle_deg in zip(table.ranges_m, table.half_angles_deg, strict=True):
            # Below the threshold the angle is continued as its mirror image, so that the fit can recover.
            excess_db = sonar.excess_db(range_m)
            angle_rad = math.copysign(_angle_rad(abs(excess_db), sonar.piston_diameter_m, wavelength_m), excess_db)
            misses.append(math.degrees(angle_rad) - angle_deg)
        return misses

    # A piston that is 12 dB down (two-way), x = 2.2, at the widest angle of the table.
    diameter_m = 2.2 * wavelength_m / (math.pi * math.sin(math.radians(table.half_angles_deg[0])))
    start = [3.0, math.log(diameter_m), 5.0]
    exact = dict.fromkeys(("ftol", "xtol", "gtol"), 1e-15)
    lower = [0.0, -math.inf, 0.0]
    return sonar_of(least_squares(misses_deg, start, "3-point", (lower, math.inf), x_scale="jac", **exact).x.tolist())


def leave_one_out(table: BreakawayTable, frequency_hz: float, on_axis_m: float | None = None) -> list[float | None]:
    """Predict each half angle of a table from its other rows.

    With four rows and three parameters each prediction comes from an exact fit to the three others, so it tests the
    shape of the equation only.

    Parameters
    ----------
    table, frequency_hz, on_axis_m
        As in `fit_sonar`, at least four rows.

    Returns
    -------
    list of float or None
        Predicted half angle of each row [deg]; None if no echo is predicted.

    Raises
    ------
    ValueError
        Without one row there are too few.
    """
    predicted: list[float | None] = []
    for i, left_out_m in enumerate(table.ranges_m):
        ranges_m, angles_deg = np.delete([table.ranges_m, table.half_angles_deg], i, axis=1).tolist()
        others = BreakawayTable(tuple(ranges_m), tuple(angles_deg))
        predicted.append(fit_sonar(others, frequency_hz, on_axis_m).half_angle_deg(left_out_m))
    return predicted


def extended_beam(
    table: BreakawayTable, maximum_m: float, frequency_hz: float, on_axis_m: float | None = None
) -> BreakawayTable:
    """A measured table, extended by the sonar equation that is fitted to it.

    The measured rows are unchanged. Beyond them the angle is the equation's, but never increases with range: a gain
    that exceeds the losses would widen the beam, which has not been observed. The table ends where the equation
    predicts no echo, and with the measured rows if it cannot be fitted (too few rows, or an error of more than a step):
    beyond that its last angle is only assumed.

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
    if len(table.ranges_m) < PARAMETERS:
        return table
    sonar = fit_sonar(table, frequency_hz, on_axis_m)
    if not sonar.fits(table):
        return table
    ranges_m, angles_deg = list(table.ranges_m), list(table.half_angles_deg)
    while ranges_m[-1] < maximum_m:
        range_m = min(ranges_m[-1] + STEP_M, maximum_m)
        angle_deg = sonar.half_angle_deg(range_m)
        if angle_deg is None:
            break
        ranges_m.append(range_m)
        angles_deg.append(min(angles_deg[-1], max(angle_deg, NARROWEST_HALF_ANGLE_DEG)))
    return BreakawayTable(tuple(ranges_m), tuple(angles_deg))


def _angle_rad(excess_db: float, diameter_m: float, wavelength_m: float) -> float:
    """Angle in the main lobe at which a piston's two-way level is ``excess_db`` (0 or more) down [rad]."""
    sine = main_lobe_x(excess_db / 2.0) * wavelength_m / (math.pi * diameter_m)
    return math.asin(sine) if sine < 1.0 else math.pi / 2
