"""Several downward sensors -> one distance along the vehicle's down axis, as an autopilot expects it.

A robust line through the newest readings of all downward sensors (Theil and Sen: the median of the slopes between
pairs, then the median of what is left), taken at the time of the newest. So a climb does not make the older readings
lag, and one sensor that sees something else, or a single wild reading, does not move it.

A sensor that looks down at an angle reads either the slant range along its axis or the distance of the nearest point
of the ground within its beam, which is the perpendicular. Which of them is a parameter of the sensor model; where it is
unknown the result lies midway and its variance covers both.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from msp_range.filters.base import Estimate

WINDOW_S = 0.65
"""Readings older than this are left out [s]: a round of four sensors at ten readings a second, and half of one."""
MOST_POINTS = 5
"""Readings in the line at most: an odd number, so that at a step the majority is on one side of it."""
NEWEST_S = 0.25
"""A distance without a reading needs another sensor's reading that is no older than this [s]: two turns at most."""
FASTEST_M_S = 5.0
"""Two readings that would need a faster vehicle show a step of the ground and not motion [m/s]."""
SHORTEST_BASE_S = 0.28
"""Two or three readings show a speed where this much time lies between the first and the last of them [s]."""
HARDEST_M_S2 = 4.0
"""The vehicle's speed changes by at most this much [m/s^2]; a step of the ground would seem to change it at once."""
SENSORS_WITHOUT_A_READING = 2
"""Sensors that must have seen the ground within the window for a distance where the newest reading gave none."""
MAD_TO_STD = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""

Oblique = Literal["slant", "nearest", "unknown"]


@dataclass(frozen=True, slots=True)
class DownwardSensor:
    """Where a sensor that looks down sits and what it reads at an angle.

    Attributes
    ----------
    cos_tilt
        Cosine of the angle between its boresight and the body's down axis.
    below_reference_m
        How far below the fused distance's reference point it is mounted [m].
    oblique
        What it reads over flat ground at that angle.
    """

    cos_tilt: float
    below_reference_m: float
    oblique: Oblique

    def down_distance(self, measured: Estimate) -> Estimate:
        """Distance from the reference point along the body's down axis to level ground.

        slant: d = r cos(tilt); nearest: d = r; unknown: midway. The variance is the reading's alone; see
        `oblique_variance_m2` for the rest.
        """
        range_m, variance_m2 = measured
        slant_m = range_m * self.cos_tilt
        if self.oblique == "slant":
            down_m = slant_m
        elif self.oblique == "nearest":
            down_m = range_m
        else:
            down_m = (range_m + slant_m) / 2
        return Estimate(down_m + self.below_reference_m, variance_m2)

    def oblique_variance_m2(self, range_m: float) -> float:
        """((r - r cos(tilt)) / 2)^2 where it is unknown which of the two the sensor reads, else 0 [m^2].

        It is the same error in every reading, so it does not average out.
        """
        return (range_m * (1 - self.cos_tilt) / 2) ** 2 if self.oblique == "unknown" else 0.0


class _Point(NamedTuple):
    """A down distance, what its variance is, and how much of an error all of its sensor's readings may share."""

    time_s: float
    down_m: float
    variance_m2: float
    shared_variance_m2: float
    sensor: str


class Fusion:
    """The downward sensors' streams as one."""

    def __init__(self, sensors: Mapping[str, DownwardSensor]) -> None:
        self.sensors = sensors
        self._recent: deque[_Point] = deque(maxlen=MOST_POINTS)
        self._speed_m_s = 0.0
        self._speed_s = float("-inf")

    def includes(self, sensor: str) -> bool:
        """True where this sensor's readings belong to the fused stream."""
        return sensor in self.sensors

    def update(self, sensor: str, time_s: float, measured: Estimate) -> Estimate:
        """Take one filtered reading; returns the fused distance at its time.

        Raises
        ------
        KeyError
            ``sensor`` is not a downward sensor.
        """
        mounted = self.sensors[sensor]
        down_m, variance_m2 = mounted.down_distance(measured)
        recent = self._recent
        recent.append(_Point(time_s, down_m, variance_m2, mounted.oblique_variance_m2(measured.range_m), sensor))
        while time_s - recent[0].time_s > WINDOW_S:
            recent.popleft()
        return self._line_at(list(recent), time_s)

    def at(self, time_s: float) -> Estimate | None:
        """The fused distance at a time without a reading; two sensors must have seen the ground, one just now."""
        fresh = [point for point in self._recent if time_s - point.time_s <= WINDOW_S]
        if len({point.sensor for point in fresh}) < SENSORS_WITHOUT_A_READING:
            return None
        if time_s - fresh[-1].time_s > NEWEST_S:
            return None
        return self._line_at(fresh, time_s)

    def _line_at(self, points: list[_Point], time_s: float) -> Estimate:
        """Theil-Sen line through the points at ``time_s``, and the variance of its value there.

        The value at the end of a straight line through n points has about 4 / n of a point's variance; a point's
        variance is the larger of what the points state and of their scatter about the line. What a sensor's readings
        share does not average out and is added.
        """
        slope_m_s = self._slope(points, time_s)
        if len(points) % 2 == 0:
            points = points[1:]
        count = len(points)
        moved = [point.down_m + slope_m_s * (time_s - point.time_s) for point in points]
        fused_m = _median(moved)
        scatter_m = MAD_TO_STD * _median([abs(each - fused_m) for each in moved])
        variance_m2 = max(sum([point.variance_m2 for point in points]) / count, scatter_m * scatter_m)
        shared_m2 = sum([point.shared_variance_m2 for point in points]) / count
        return Estimate(fused_m, variance_m2 * min(1.0, 4 / count) + shared_m2)

    def _slope(self, points: list[_Point], time_s: float) -> float:
        """Vertical speed [m/s]: the median over pairs, moved from the last one by no more than a vehicle can."""
        # Of sensors that ping together the nearer one's echo may come later in the order of answers.
        elapsed_s = min(max(time_s - self._speed_s, 0.0), WINDOW_S)
        self._speed_s = max(time_s, self._speed_s)
        slopes = []
        earlier: list[tuple[float, float]] = []
        for point in points:
            time_i, down_i = point.time_s, point.down_m
            for time_j, down_j in earlier:
                if time_i > time_j and abs(down_i - down_j) <= FASTEST_M_S * (time_i - time_j):
                    slopes.append((down_i - down_j) / (time_i - time_j))
            earlier.append((time_i, down_i))
        # Two or three readings that lie close together say more about noise than about speed.
        enough = len(points) > 3 or points[-1].time_s - points[0].time_s >= SHORTEST_BASE_S
        wanted_m_s = _median(slopes) if slopes and enough else 0.0
        reach_m_s = HARDEST_M_S2 * elapsed_s
        self._speed_m_s += min(max(wanted_m_s - self._speed_m_s, -reach_m_s), reach_m_s)
        return self._speed_m_s


def _median(values: list[float]) -> float:
    """`statistics.median` without its checks: it is the most frequent call of the bridge."""
    ordered = sorted(values)
    half = len(ordered) // 2
    return ordered[half] if len(ordered) % 2 else (ordered[half - 1] + ordered[half]) / 2
