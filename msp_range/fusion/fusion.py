"""Several downward sensors -> the ground below the vehicle, and the one distance that an autopilot expects.

Corrected readings and the autopilot's attitude enter, in the order of their times; the distance along the vehicle's
down axis leaves, with the height, the climb and the slope behind it (`Fusion.ground`). Readings that do not fit are
left out of the ground and judged by `msp_range.fusion.sightings`; a sensor that is stuck is found by
`msp_range.fusion.stuck`.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

from msp_range.fusion.attitude import Attitude
from msp_range.fusion.ground_filter import Ground, GroundFilter
from msp_range.fusion.mounting import LEVEL, DownwardSensor, View
from msp_range.fusion.sightings import AGREE_M, WINDOW_S, Sight, step_m
from msp_range.fusion.stuck import StuckWatch
from msp_range.geometry import Matrix
from msp_range.reading import Reading, Status

OTHER_PER_M = 0.002
"""Probability density of readings that are not of the ground: some percent, spread over some metres [1/m]. A reading
that the ground explains less well than this is not taken for the ground."""
GATE_M = 0.25
"""A reading farther off than this is not of the ground, however little is known of the vehicle's motion [m]."""
DOUBTFUL_PER_M, DOUBTFUL_M = 0.3, 0.10
"""The same of a reading that is also a fault code, or one that a sensor keeps repeating [1/m, m]: neither may pass for
ground that is merely near it."""
NEWEST_S = 0.25
"""A distance without a reading needs another sensor's reading that is no older than this [s]: two turns at most."""
SENSORS_WITHOUT_A_READING = 2
"""Sensors that must have seen the ground within the window for a distance where the newest reading gave none."""
STALE_S = 0.25
"""A ranging that is over this long after its time tells nothing of now [s]: the program or the bus stood still."""
MEMORY_S = 1.5
"""Ground not seen for this long is no longer known [s]."""
LOST_S = 0.35
"""Where no reading was of the ground for this long, the next two that agree make a new one [s]."""
STARTS_AGREE_M, FASTEST_M_S, FASTEST_ALONE_M_S = 0.20, 4.0, 1.0
"""The first two readings differ by no more than this: by a slope and their noise [m], by a climb [m/s]; two of one
sensor are farther apart in time, and must agree the better."""
STEP_STD_M, STEP_CLIMB_STD_M_S = 0.05, 1.0
"""What a step of the ground leaves uncertain of the height and of its rate."""
ROUGH_READINGS = 30.0
"""The roughness of the ground is a mean over so many readings."""
ROUGHEST_M = 0.08
"""More scatter than this about the plane is not put down to roughness [m]."""


class Fused(NamedTuple):
    """The distance for the autopilot and what it comes from.

    Attributes
    ----------
    range_m, variance_m2
        From the reference point along the body's down axis to the plane of the ground [m], and the variance of its
        error [m^2].
    height_m, climb_m_s, rise_north, rise_east
        As in `msp_range.fusion.ground_filter.Ground`.
    """

    range_m: float
    variance_m2: float
    height_m: float
    climb_m_s: float
    rise_north: float
    rise_east: float

    def record(self, time_s: float) -> dict[str, float]:
        """The message of a recording's ``/fused``."""
        range_m, variance_m2, height_m, climb_m_s, rise_north, rise_east = self
        return {
            "time_s": time_s,
            "range_m": range_m,
            "variance_m2": variance_m2,
            "height_m": height_m,
            "climb_m_s": climb_m_s,
            "rise_north": rise_north,
            "rise_east": rise_east,
        }


class Fusion:
    """The downward sensors as one.

    Parameters
    ----------
    sensors
        By name.
    attitude
        Knows how the vehicle is turned.

    Attributes
    ----------
    ground
        Where the ground is, after the newest reading; None: not known.
    """

    def __init__(self, sensors: Mapping[str, DownwardSensor], attitude: Attitude) -> None:
        self._sensors = sensors
        self._attitude = attitude
        self._stuck = {name: StuckWatch() for name in sensors}
        self._sights = {name: Sight() for name in sensors}
        self._filter: GroundFilter | None = None
        self._time_s = float("-inf")
        self._seen_s = float("-inf")
        self._steps_m = 0.0
        self._rough_m2 = 0.0
        self._shared_m2 = 0.0
        self._tilted = False
        self._first: tuple[str, float, float] | None = None
        self._strange_m: float | None = None
        self._doubtful = False

    @property
    def ground(self) -> Ground | None:
        """Height, climb and slope with their covariance at the time of the newest reading."""
        return None if self._filter is None else self._filter.ground()

    def object_m(self, sensor: str) -> float | None:
        """Height over the ground of what is below a sensor and is not ground, negative for a hole [m]; or None."""
        return self._sights[sensor].object_m

    def judge(self, reading: Reading) -> Reading:
        """The reading; without its range where the sensor is stuck."""
        if reading.raw is None:
            return reading
        climbed_m = None if self._filter is None else self._filter.height_m - self._steps_m
        if not self._stuck[reading.sensor].take(reading.raw, climbed_m) or not reading.status.has_range:
            return reading
        return Reading(reading.time_s, reading.sensor, Status.STUCK, raw=reading.raw)

    def update(self, reading: Reading, now_s: float) -> Fused | None:
        """Take one reading; the fused distance at its time, or None where nothing is known well enough.

        Where the reading is not of the ground, two other sensors must have seen it, one of them just now.

        Parameters
        ----------
        reading
            Corrected, and judged by `judge`.
        now_s
            When it is told [s].

        Raises
        ------
        KeyError
            Not one of the downward sensors.
        """
        sensor, sight = self._sensors[reading.sensor], self._sights[reading.sensor]
        time_s = max(reading.time_s, self._time_s)
        if self._filter is not None:
            if time_s - self._seen_s > MEMORY_S:
                self._filter, self._first = None, None
            else:
                self._filter.predict(time_s - self._time_s)
        self._time_s = time_s
        rotation = self._rotation(time_s)
        if reading.range_m is None:
            sight.nothing(time_s)
        elif self._filter is None:
            self._start(reading, reading.range_m, sensor, rotation)
        else:
            self._take(reading, reading.range_m, sensor, rotation)
        if self._filter is None:
            return None
        if self._seen_s < time_s and not (now_s - time_s <= STALE_S and self._others_saw_it(time_s)):
            return None
        return self._down_axis(self._filter, rotation)

    def _others_saw_it(self, time_s: float) -> bool:
        if self._doubtful or time_s - self._seen_s > NEWEST_S:
            return False
        saw = [sight for sight in self._sights.values() if sight.off_m is None and time_s - sight.seen_s <= WINDOW_S]
        return len(saw) >= SENSORS_WITHOUT_A_READING

    def _rotation(self, time_s: float) -> Matrix:
        rotation = self._attitude.rotation_at(time_s)
        if (rotation is not None) != self._tilted:
            self._tilted = rotation is not None
            if self._filter is not None:
                self._filter.level()  # Slopes were of the other frame.
        return rotation or LEVEL

    def _start(self, reading: Reading, range_m: float, sensor: DownwardSensor, rotation: Matrix) -> None:
        """Two readings that agree make the first ground: of two sensors, or of one twice where there is no other."""
        view = sensor.view(rotation, 0.0, 0.0, 0.0)
        if view is None or reading.suspect:
            return
        height_m = (range_m - view.expected_m) / view.by_height
        before, self._first = self._first, (reading.sensor, reading.time_s, height_m)
        if before is None or reading.time_s - before[1] > MEMORY_S:
            return
        elapsed_s, higher_m = reading.time_s - before[1], height_m - before[2]
        fastest_m_s = FASTEST_ALONE_M_S if reading.sensor == before[0] else FASTEST_M_S
        if abs(higher_m) > STARTS_AGREE_M + fastest_m_s * elapsed_s:
            return
        climbed_m = 0.0 if self._filter is None else self._filter.height_m - self._steps_m
        self._filter = GroundFilter(height_m, _variance_m2(reading) / view.by_height**2, higher_m, elapsed_s)
        self._first, self._steps_m = None, height_m - climbed_m
        self._shared_m2 = view.shared_variance_m2
        self._seen_s = self._time_s
        self._sights[before[0]].ground(before[1])
        self._sights[reading.sensor].ground(self._time_s)

    def _take(self, reading: Reading, range_m: float, sensor: DownwardSensor, rotation: Matrix) -> None:
        known = self._filter
        assert known is not None
        sight, time_s = self._sights[reading.sensor], self._time_s
        view = sensor.view(rotation, known.height_m, known.rise_north, known.rise_east)
        if view is None:
            sight.nothing(time_s)
            return
        innovation_m = range_m - view.expected_m
        off_m = innovation_m / view.by_height
        variance_m2 = _variance_m2(reading) + self._rough_m2
        sight.repeated = self._stuck[reading.sensor].repeated
        doubtful = reading.suspect or sight.repeated
        other_per_m, most_m = (DOUBTFUL_PER_M, DOUBTFUL_M) if doubtful else (OTHER_PER_M, GATE_M)
        if sight.repeated and self._others_tell_more():
            # What a sensor repeats is nothing new; where it is stuck, it would hold the ground when the vehicle moves.
            if abs(innovation_m) <= most_m:
                self._seen(sight, view)
            elif sight.is_object(off_m):
                sight.aside(time_s, off_m, told=True)
            else:
                sight.nothing(time_s)
            return
        square = None
        if abs(innovation_m) <= most_m:
            square = known.update(view, innovation_m, variance_m2, other_per_m)
        if square is not None:
            self._scatter(square, variance_m2)
            self._seen(sight, view)
            return
        if doubtful and not sight.is_object(off_m):
            sight.nothing(time_s)
        else:
            self._set_aside(known, reading.sensor, off_m, view)
            if time_s - self._seen_s > LOST_S:
                self._start(reading, range_m, sensor, rotation)

    def _others_tell_more(self) -> bool:
        """Whether sensors enough see the ground that do not repeat themselves."""
        time_s = self._time_s
        fresh = [
            sight
            for sight in self._sights.values()
            if sight.off_m is None and not sight.repeated and time_s - sight.seen_s <= WINDOW_S
        ]
        return len(fresh) >= SENSORS_WITHOUT_A_READING

    def _scatter(self, square: float, variance_m2: float) -> None:
        """The ground's roughness grows where readings scatter more than they should, and falls where less."""
        change_m2 = (square - 1.0) * variance_m2 / ROUGH_READINGS
        self._rough_m2 = min(max(self._rough_m2 + change_m2, 0.0), ROUGHEST_M**2)

    def _seen(self, sight: Sight, view: View) -> None:
        sight.ground(self._time_s)
        self._strange_m, self._doubtful = None, False
        self._seen_s = self._time_s
        self._shared_m2 = view.shared_variance_m2

    def _set_aside(self, known: GroundFilter, name: str, off_m: float, view: View) -> None:
        """A reading that is not of the ground: of a step, of an object, or of nothing."""
        sight, time_s = self._sights[name], self._time_s
        others = [each for other, each in self._sights.items() if other != name and time_s - each.seen_s <= WINDOW_S]
        before_m = sight.off_m
        alone = not others and before_m is not None and abs(off_m - before_m) < AGREE_M
        sight.aside(time_s, off_m, sum([each.off_m is None for each in others]) >= min(2, len(self._sensors) - 1) > 0)
        # Two in a row that agree on another height: which of the two is the ground is open, unless one is known.
        known_object = sight.object_m is not None
        self._doubtful = not known_object and self._strange_m is not None and abs(off_m - self._strange_m) < AGREE_M
        self._strange_m = None if known_object else off_m
        lower_m = off_m if alone else step_m(sight, self._sights.values(), time_s)
        if lower_m is None:
            return
        known.shift(lower_m, STEP_STD_M**2, STEP_CLIMB_STD_M_S**2)
        self._steps_m += lower_m
        for each in self._sights.values():
            each.moved(lower_m)
        self._seen(sight, view)

    def _down_axis(self, known: GroundFilter, rotation: Matrix) -> Fused:
        """d = h / (e . G) along the body's down axis e; autopilots correct it for the tilt themselves."""
        north, east, down = rotation[0][2], rotation[1][2], rotation[2][2]
        along = max(down + known.rise_north * north + known.rise_east * east, 0.1)
        range_m = known.height_m / along
        slopes = -range_m / along
        variance_m2 = known.variance(1 / along, slopes * north, slopes * east)
        return Fused(
            range_m,
            variance_m2 + self._shared_m2,
            known.height_m,
            known.climb_m_s,
            known.rise_north,
            known.rise_east,
        )


def _variance_m2(reading: Reading) -> float:
    """Of a reading's error [m^2]; a centimetre's where nothing is known of it."""
    std_m = 0.01 if reading.std_m is None else reading.std_m
    return std_m * std_m if math.isfinite(std_m) else 1.0
