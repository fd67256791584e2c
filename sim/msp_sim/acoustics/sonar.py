"""The sonar equation of a sensor: the largest angle at which it detects a wall, at ranges that were not measured.

Its three parameters are fitted to a table of breakaway angles (report 4.3.3), and give half angles beyond the table. An
echo is detected if its level (`msp_sim.acoustics.echo`) is above the detection threshold.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from msp_range.acoustics.beam import NARROWEST_HALF_ANGLE_DEG, BreakawayTable
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.acoustics.atmosphere import Atmosphere
from msp_sim.acoustics.echo import WALL, echo_level_db
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

    Breakaway angles of a wall determine how the level falls off the axis, but hardly the level on the axis: the fit to
    the report's table has 3 to 10 dB above the threshold, by which grass or snow would hardly be detected, yet
    ultrasonic sensors measure snow depth. Use it for half angles, and not for weak targets.
    """

    source_level_db: float
    """Level on the axis at 1 m, relative to the detection threshold at range 0 [dB]."""
    piston_diameter_m: float
    """Diameter of the flat circular piston with the same directivity [m]."""
    gain_db_per_m: float
    """How much the receiver's gain grows, or its threshold falls, with each metre of range [dB/m]."""
    frequency_hz: float
    """Frequency of the ping [Hz]."""

    def excess_db(self, range_m: float) -> float:
        """EL(R) - DT(R) of a wall straight ahead in the air of `ROOM` [dB]: detected if 0 or more.

        The detection threshold is DT(R) = -g R relative to that at range 0: such sensors raise their gain while they
        wait for the echo, because a late echo is weak. A gain that is linear in dB over time is assumed; the sensor's
        actual gain is not published.
        """
        piston = self.piston_diameter_m, self.frequency_hz
        return echo_level_db(self.source_level_db, range_m, 0.0, WALL, ROOM, *piston) + self.gain_db_per_m * range_m

    def half_angle_deg(self, range_m: float) -> float | None:
        """Largest angle off the axis at which a wall is detected, at a perpendicular distance above 0 [deg].

        Up to the piston's first null, or to 90 deg if it has none; None if the wall is not detected even on the axis.
        Side lobes do not count.
        """
        excess_db = self.excess_db(range_m)
        return None if excess_db < 0.0 else self._angle_deg(excess_db)

    def _angle_deg(self, excess_db: float) -> float:
        """Angle in the main lobe at which the two-way level is so much (0 or more) below that on the axis [deg]."""
        wavelength_m = ROOM.wavelength_m(self.frequency_hz)
        sine = main_lobe_x(excess_db / 2.0) * wavelength_m / (math.pi * self.piston_diameter_m)
        return math.degrees(math.asin(min(sine, 1.0)))

    def misses_deg(self, table: BreakawayTable) -> list[float]:
        """How far the half angles are from those of a table [deg].

        Below the threshold the angle is continued as its mirror image, so that a fit can recover.
        """
        excesses_db = [self.excess_db(range_m) for range_m in table.ranges_m]
        return [
            math.copysign(self._angle_deg(abs(excess_db)), excess_db) - angle_deg
            for excess_db, angle_deg in zip(excesses_db, table.half_angles_deg, strict=True)
        ]

    def fits(self, table: BreakawayTable) -> bool:
        """Whether every angle of a table is met within a step of the motor."""
        is_heard = all(self.excess_db(range_m) >= 0.0 for range_m in table.ranges_m)
        return is_heard and all(abs(miss_deg) <= STEP_DEG for miss_deg in self.misses_deg(table))


def fit_sonar(table: BreakawayTable, frequency_hz: float, on_axis_m: float = 0.0) -> Sonar:
    """Fit the sonar equation to the half angles of a table by least squares.

    It has three parameters and the report's table four rows, so one degree of freedom is left, and agreement with the
    table is weak evidence. `leave_one_out` is a better test. Beyond the table the equation is an extrapolation.

    The table's angles are those against a large flat wall that reflects nearly all, in air as `ROOM`. `on_axis_m` is
    the range up to which a wall is detected on the axis [m], a constraint of the fit; at least the table's last range.
    ValueError if the table has fewer rows than the equation has parameters.

    Examples
    --------
    >>> report = BreakawayTable(ranges_m=(0.5, 1.0, 1.5, 2.0), half_angles_deg=(23.4, 18.0, 14.4, 12.6))
    >>> sonar = fit_sonar(report, 42_000.0, on_axis_m=5.0)
    >>> [f"{sonar.half_angle_deg(range_m):.1f}" for range_m in report.ranges_m]
    ['23.4', '17.9', '14.5', '12.5']
    """
    if len(table.ranges_m) < PARAMETERS:
        raise ValueError(
            f"found {len(table.ranges_m)} breakaway angles, expected at least {PARAMETERS}: "
            "the sonar equation has that many parameters"
        )
    kept_m = max(on_axis_m, table.ranges_m[-1])

    def sonar_of(parameters: Sequence[float]) -> Sonar:
        # The first parameter is the excess on the axis at that range: at least 0 dB.
        excess_db, log_diameter, gain_db_per_m = parameters
        silent = Sonar(0.0, math.exp(log_diameter), gain_db_per_m, frequency_hz)
        return replace(silent, source_level_db=excess_db - silent.excess_db(kept_m))

    # A piston that is 12 dB down (two-way), x = 2.2, at the widest angle of the table.
    diameter_m = 2.2 * ROOM.wavelength_m(frequency_hz) / (math.pi * math.sin(math.radians(table.half_angles_deg[0])))
    start = [3.0, math.log(diameter_m), 5.0]
    best = least_squares(
        lambda parameters: sonar_of(parameters).misses_deg(table),
        start,
        jac="3-point",
        bounds=([0.0, -math.inf, 0.0], math.inf),
        x_scale="jac",
        **dict.fromkeys(("ftol", "xtol", "gtol"), 1e-15),
    )
    return sonar_of(best.x.tolist())


def fit_beam(
    rows: Iterable[tuple[float, float]], sensor: SensorModel, on_axis_cm: float | None
) -> tuple[BreakawayTable, Sonar, BreakawayTable]:
    """The measured table, the sonar equation through it, and the table with the equation's rows beyond.

    `rows` have range [cm] and half angle [deg], `on_axis_cm` is the range at which a wall is at least detected on the
    axis [cm]; None: not known. ValueError as for `fit_sonar`.
    """
    ranges_cm, angles_deg = zip(*rows, strict=True)
    table = BreakawayTable(tuple(range_cm / 100.0 for range_cm in ranges_cm), angles_deg)
    sonar = fit_sonar(table, sensor.frequency_hz, (on_axis_cm or 0.0) / 100.0)
    return table, sonar, extended_beam(table, sonar, sensor.maximum_cm / 100.0)


def leave_one_out(table: BreakawayTable, frequency_hz: float, on_axis_m: float = 0.0) -> list[float | None]:
    """Predict each half angle of a table from its other rows [deg]; None if no echo is predicted.

    With four rows and three parameters each prediction comes from an exact fit to the three others, so it tests the
    shape of the equation only. Arguments and errors are those of `fit_sonar`, of one row less.
    """
    predicted: list[float | None] = []
    for i, left_out_m in enumerate(table.ranges_m):
        ranges_m, angles_deg = np.delete([table.ranges_m, table.half_angles_deg], i, axis=1).tolist()
        others = BreakawayTable(tuple(ranges_m), tuple(angles_deg))
        predicted.append(fit_sonar(others, frequency_hz, on_axis_m).half_angle_deg(left_out_m))
    return predicted


def extended_beam(table: BreakawayTable, sonar: Sonar, maximum_m: float) -> BreakawayTable:
    """A measured table, extended by the sonar equation that is fitted to it, with a row each 25 cm.

    The measured rows are unchanged. Beyond them the angle is the equation's, but never increases with range: a gain
    that exceeds the losses would widen the beam, which has not been observed. The table ends where the equation
    predicts no echo or at the sensor's longest range, and with the measured rows if the equation does not fit (an error
    of more than a step): beyond that its last angle is only assumed.
    """
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
