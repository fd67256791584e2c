"""Several downward sensors -> the ground below the vehicle, and the one distance that an autopilot expects.

Corrected readings enter, in the order of their times; with each leaves what the stream says now (`Outcome`): the
distance along the vehicle's down axis, 'above the maximum', or nothing. A reading that fits the ground's filter updates
it. Those that do not are votes for another ground, objects below one sensor, or outliers. Whether the ground may be
sent is decided in `msp_range.fusion.support`.
"""

import math
from collections.abc import Mapping

from msp_range.filters.chain import UNCONFIRMED
from msp_range.fusion import garbled
from msp_range.fusion.above import AboveMaximum
from msp_range.fusion.attitude import Attitude
from msp_range.fusion.garbled import GarbledAnswers
from msp_range.fusion.ground_filter import Ground, GroundFilter
from msp_range.fusion.mounting import LEVEL, DownwardSensor, View, spans_plane
from msp_range.fusion.objects import Below
from msp_range.fusion.odd import LONGEST_GAP_S, LevelHeight, odd_one
from msp_range.fusion.outcome import FIXED, GARBLED, OBJECT, OUTLIER, PAST, REPEATED, SUSPECT, Fused, Outcome
from msp_range.fusion.response import LEVEL_RISE, MotionResponse
from msp_range.fusion.start import Candidate, Found, Start
from msp_range.fusion.stuck import StuckWatch
from msp_range.fusion.support import GroundSupport
from msp_range.fusion.vertical import Known, VerticalMotion
from msp_range.fusion.votes import Sight, step_m, working
from msp_range.fusion.windows import SHORTEST_GAP_S, Windows
from msp_range.geometry import Matrix, Vector
from msp_range.health import Condition
from msp_range.reading import Reading, Status

OTHER_PER_M = 0.002
"""Probability density of readings that are not of the ground: some percent, spread over some metres [1/m]. A reading
that the ground explains less well than this is not taken for the ground."""
GATE_M, GATE_M_S2, GATE_WIDEST_M = 0.25, 1.0, 1.0
"""A reading farther off than this is not of the ground, however little is known of the vehicle's motion: with readings
0.1 s apart [m], for an acceleration of twice the second where they are farther apart [m/s^2], and at most [m]. Wider
takes an outlier for the ground after a manoeuvre, narrower loses the ground in one."""
DOUBTFUL_PER_M, DOUBTFUL_M = 0.3, 0.10
"""The same of a reading that is also a fault code, or one that a sensor keeps repeating [1/m, m]: neither may pass for
ground that is merely near it."""
STILL_M_S, STILL_SIGMAS = 0.2, 2.0
"""A fault code counts as ground while the vehicle climbs or sinks no faster than this by its barometer [m/s], to so
many standard deviations: one that climbs past it while all sensors have the code must get away from it."""
STEP_STD_M, STEP_CLIMB_STD_M_S = 0.1, 0.3
"""What a step of the ground leaves uncertain of the height [m] and of its rate [m/s]: the first readings beyond an edge
may be of its flank, and the vehicle's motion goes on. A smaller height or a larger rate takes the next reading's
difference for a climb of 2 m/s, and loses the ground."""
LEVEL_SHARE = 0.3
"""Share of a reading in what its sensor sees lately: the last second of four."""
ROUGH_READINGS = 30.0
"""The roughness of the ground is a mean over so many readings."""
ROUGHEST_M = 0.08
"""More scatter than this about the plane is not put down to roughness [m]."""
NEARER_M = 0.15
"""The surface may be nearer than a sensor's minimum by this, as on the ground [m]: such a reading shows a response to
the vehicle's motion no closer. Less takes a landing that bounces for one, more finds ice on the sensors later."""
FIT_READINGS = 10.0
"""The mean square of the normalised innovations is taken over so many readings: a second of four sensors."""
FIT_CAP, FIT_OUTLIER = 25.0, 12.0
"""A reading counts in it by no more than the first, one of five standard deviations; an outlier of a sensor that
otherwise sees the ground by the second. What is not used is not in the estimate, but where it is much of what these
sensors say, what is used was chosen from it. Larger doubts the ground for longer after one outlier."""
FIT_TOLERATED = 1.5
"""Up to this mean square the stated variance stands, beyond it the variance grows with it. Ten readings of a filter
that is right exceed it in one of ten turns; larger believes a noisy sensor's small variance for longer."""


class _Sensor:
    """One downward sensor: where it sits, and what is known of its last readings."""

    def __init__(self, mounted: DownwardSensor) -> None:
        self.mounted = mounted
        self.sight = Sight()
        self.below = Below()
        self.stuck = StuckWatch()
        self.is_ground_in_doubt = False
        self.foot_m = mounted.foot_m(0.0)
        self.level: tuple[float, LevelHeight] | None = None


class Fusion:
    """The downward sensors as one.

    Parameters
    ----------
    sensors
        By name.
    attitude
        Knows how the vehicle is turned.
    windows
        How long what a sensor saw counts.
    motion
        How the vehicle moves by its accelerometer and barometer; None: nobody says.
    maximum_m
        The longest distance from the reference point that the sensors can measure [m].

    Attributes
    ----------
    level_height_m
        Height of the reference point by the newest reading alone, were the ground level [m]; None without a range.
    down
        Straight down as a unit vector, body FRD; None where the attitude is not known.
    """

    def __init__(
        self,
        sensors: Mapping[str, DownwardSensor],
        attitude: Attitude,
        windows: Windows,
        motion: VerticalMotion | None = None,
        maximum_m: float = 7.65,
    ) -> None:
        self._sensors = {name: _Sensor(mounted) for name, mounted in sensors.items()}
        self._sights = [sensor.sight for sensor in self._sensors.values()]
        self._attitude = attitude
        self._windows = windows
        self._motion = motion or VerticalMotion()
        self._gate_m = min(GATE_M + GATE_M_S2 * max(windows.gap_s**2 - SHORTEST_GAP_S**2, 0.0), GATE_WIDEST_M)
        self._support = GroundSupport(self._sights, windows, GATE_WIDEST_M)
        self._start = Start(windows, self._motion)
        self._response = MotionResponse(self._motion, windows.turn_s)
        self._maximum_m = maximum_m
        self._above = AboveMaximum(maximum_m, self._motion)
        self._odd: _Sensor | None = None
        self._filter: GroundFilter | None = None
        self._time_s = self._known_s = float("-inf")
        self._garbled = GarbledAnswers()
        self._steps_m = 0.0
        self._rough_m2 = 0.0
        self._shared_m2 = self._nearest = 0.0
        self._fit = 1.0
        self._tilted = False
        self.level_height_m: float | None = None
        self.down: Vector | None = None

    @property
    def ground(self) -> Ground | None:
        """Height, climb and slope with their covariance at the time of the newest reading; None: not known."""
        return None if self._filter is None else self._filter.ground()

    def set_maximum(self, maximum_m: float) -> None:
        """The longest distance that the sensors can measure is another one, because the air is [m]."""
        self._maximum_m = self._above.maximum_m = maximum_m

    @property
    def climb_m_s(self) -> float:
        """How fast the height grows [m/s]; 0 where it is not known."""
        return 0.0 if self._filter is None else self._filter.climb_m_s

    @property
    def fit(self) -> float:
        """Mean square of the last innovations over their variance: about 1 where the stated deviation is right."""
        return self._fit

    @property
    def is_tied(self) -> bool:
        """Whether the newest readings of as many sensors are off the ground as on it, or of more."""
        since_s = self._time_s - self._windows.fresh_s
        newest = [seen.is_ground for sight in self._sights if (seen := sight.newest(since_s)) is not None]
        return 2 * sum(newest) <= len(newest)

    def condition(self) -> Condition:
        """Answers that come a ping late, for `msp_range.health.Health.set`."""
        text = "Range: answers are those of the ping before" if self._response.is_late else None
        remedy = "switch the sensors' power off and on; check that pings are acknowledged"
        return Condition("late answers", text, "Range: answers are in time again", remedy=remedy)

    def object_m(self, sensor: str) -> float | None:
        """Height over the ground of what is below a sensor and is not ground, negative for a hole [m]; or None."""
        return self._sensors[sensor].below.object_m

    def is_ground_in_doubt(self, sensor: str) -> bool:
        """Whether the ground that the others see may be what this sensor sees, with a byte lost on the bus."""
        return self._sensors[sensor].is_ground_in_doubt

    def update(self, reading: Reading, now_s: float) -> Outcome:
        """Update with one reading.

        Parameters
        ----------
        reading
            Corrected.
        now_s
            When it is passed on [s].

        Raises
        ------
        KeyError
            Not one of the downward sensors.
        """
        sensor = self._sensors[reading.sensor]
        self.level_height_m = None
        time_s = max(reading.time_s, self._time_s)
        self._predict(time_s)
        rotation = self._rotation(time_s)
        reading = self._unless_stuck(sensor, reading)
        sensor.sight.read_s, sensor.sight.works = time_s, not reading.status.is_fault
        if reading.range_m is None:
            self._on_nothing(sensor, reading)
            rejected: str | None = reading.status.value
        elif self._filter is None:
            rejected = self._on_first(sensor, reading, reading.range_m, rotation)
        else:
            rejected = self._on_range(self._filter, sensor, reading, reading.range_m, rotation)
            if rejected == GARBLED:
                reading = Reading(reading.time_s, reading.sensor, Status.GARBLED, raw=reading.raw)
                sensor.sight.works = False
        if reading.suspect:
            self._above.update_with_code()
        else:
            faces = sensor.mounted.faces_ground(rotation[2])
            self._above.update(reading.sensor, reading.status is Status.NO_ECHO, sensor.sight.works, faces)
        is_enough = self._support.is_enough(time_s, now_s, rejected is None) and not self._response.is_late
        if self._filter is not None and is_enough:
            fused = self._down_axis(self._filter, rotation)
            known = Known(time_s, fused.range_m, fused.height_m, fused.climb_m_s, self._motion.mark(time_s))
            self._above.on_ground_seen(known)
            self._start.on_ground_seen(known)
            is_above = fused.range_m > self._maximum_m
            return Outcome(reading, None if is_above else fused, is_above, rejected)
        return Outcome(reading, None, not self._support.is_seen(time_s) and self._above.decide(time_s), rejected)

    def _predict(self, time_s: float) -> None:
        if self._filter is not None:
            if time_s - self._known_s > self._windows.memory_s:
                self._filter = None
                self._start.clear()
            else:
                self._filter.predict(time_s - self._time_s, self._motion.acceleration(self._time_s, time_s))
        self._time_s = time_s

    def _rotation(self, time_s: float) -> Matrix:
        rotation = self._attitude.rotation_at(time_s)
        self.down = None if rotation is None else rotation[2]
        if (rotation is not None) != self._tilted:
            self._tilted = rotation is not None
            if self._filter is not None:
                self._filter.level()  # Slopes were of the other frame.
        return rotation or LEVEL

    def _unless_stuck(self, sensor: _Sensor, reading: Reading) -> Reading:
        """The reading; without its range where the sensor is stuck."""
        if reading.raw is None:
            return reading
        height_m = None if self._filter is None else self._filter.height_m - self._steps_m
        stuck = sensor.stuck.update(
            reading.raw, reading.range_m, height_m, self._motion, self._time_s, reading.status is Status.AT_MINIMUM
        )
        if not stuck or reading.range_m is None:
            return reading
        status = Status.FIXED if sensor.stuck.is_fixed else Status.STUCK
        return Reading(reading.time_s, reading.sensor, status, raw=reading.raw)

    def _was_garbled(self, known: GroundFilter, sensor: _Sensor, reading: Reading, range_m: float, view: View) -> bool:
        """Whether a reading is the ground's, garbled on the bus; then it keeps what is known of the ground up to date.

        It is no reason to send a distance, but without it the garbled answers of all sensors would soon be the only
        ground that is known.
        """
        raw = reading.raw
        if not raw or reading.suspect:
            return False
        answers_m = [word * range_m / raw for word in sensor.mounted.garbled_from(raw)]
        variance_m2 = _variance_m2(reading)
        known_m2 = known.variance(1.0, 0.0, 0.0)
        off_m = self._garbled.innovation_m(self._time_s, answers_m, view.expected_m, known_m2 + variance_m2)
        if off_m is None:
            return False
        known.update(view, off_m, variance_m2 + garbled.STD_M**2, OTHER_PER_M, False)
        self._known_s = self._time_s
        return True

    def _on_nothing(self, sensor: _Sensor, reading: Reading) -> None:
        sensor.sight.nothing(self._time_s)
        sensor.below.nothing(self._time_s, self._windows.memory_s)
        self._start.without(reading.sensor)

    def _on_first(self, sensor: _Sensor, reading: Reading, range_m: float, rotation: Matrix) -> str | None:
        """A reading where no ground is known, or the known one is lost; None where it made one, else why not."""
        view = sensor.mounted.view(rotation, 0.0, 0.0, 0.0)
        if view is None or reading.suspect:
            self._on_nothing(sensor, reading)
            return SUSPECT if reading.suspect else PAST

        def height_m(of_range_m: float) -> float:
            return (of_range_m - view.expected_m) / view.by_height

        scale = range_m / reading.raw if reading.raw else 1.0
        found = self._start.add(
            Candidate(
                self._time_s,
                reading.sensor,
                height_m(range_m),
                _variance_m2(reading) / view.by_height**2,
                tuple([height_m(word * scale) for word in sensor.mounted.garbled_from(reading.raw or 0)]),
                self._motion.mark(self._time_s),
            ),
            working(self._sights, self._time_s, self._windows),
        )
        if found is None:
            if self._filter is None:
                sensor.sight.nothing(self._time_s)
            return UNCONFIRMED
        self._begin(found, view)
        return None

    def _begin(self, found: Found, view: View) -> None:
        newest, earlier = found.newest, found.earlier
        climbed_m = 0.0 if self._filter is None else self._filter.height_m - self._steps_m
        self._filter = GroundFilter(
            newest.height_m,
            newest.variance_m2,
            newest.height_m - earlier.height_m,
            newest.time_s - earlier.time_s,
            (-view.by_north / view.by_height, -view.by_east / view.by_height),
            self._motion.rate(self._time_s),
        )
        self._steps_m = newest.height_m - climbed_m
        self._support.on_new_ground(found.in_doubt)
        self._start.clear()
        self._response.clear()
        self._odd = None
        for name, sensor in self._sensors.items():
            sensor.sight.clear()
            sensor.below.clear()
            sensor.level = None
            if name in found.sensors:
                sensor.sight.ground(earlier.time_s if name == earlier.sensor else self._time_s)
        self._on_ground(self._sensors[newest.sensor], view)

    def _on_range(
        self, known: GroundFilter, sensor: _Sensor, reading: Reading, range_m: float, rotation: Matrix
    ) -> str | None:
        """A reading against the known ground: None where it updated it, else why not."""
        if self.down is not None and self._windows.gap_s < LONGEST_GAP_S and not reading.suspect:
            self._look_for_odd(known, sensor, range_m, rotation)
        view = sensor.mounted.view(rotation, known.height_m, known.rise_north, known.rise_east)
        if view is None:
            self._on_nothing(sensor, reading)
            return PAST
        innovation_m = range_m - view.expected_m
        off_m = innovation_m / view.by_height
        sloping_m = (view.by_north * known.rise_north + view.by_east * known.rise_east) / view.by_height
        self.level_height_m = known.height_m + off_m + sloping_m
        sight, below = sensor.sight, sensor.below
        far = abs(innovation_m) >= self._gate_m and not below.is_object(off_m)
        if far and self._was_garbled(known, sensor, reading, range_m, view):
            self._on_nothing(sensor, reading)
            return GARBLED
        sight.repeated = sensor.stuck.repeated
        doubtful = reading.suspect or sight.repeated
        other_per_m, most_m = (DOUBTFUL_PER_M, DOUBTFUL_M) if doubtful else (OTHER_PER_M, self._gate_m)
        fits = abs(innovation_m) <= most_m and sensor is not self._odd and not (reading.suspect and self._climbs())
        # What a sensor repeats is nothing new; where it is stuck, it would hold the ground when the vehicle moves.
        is_new = not (sight.repeated and self._others_see_more())
        if fits and not is_new:
            self._on_ground(sensor, view)
            return None
        variance_m2 = _variance_m2(reading) + self._rough_m2
        sensor.foot_m = sensor.mounted.foot_m(range_m)
        shows_slope = self._shows_slope(sensor)
        height_m = known.height_m + off_m
        square = known.update(view, innovation_m, variance_m2, other_per_m, shows_slope) if fits else None
        if square is not None or self._response.expects(height_m):
            may_slope = not shows_slope or math.hypot(known.rise_north, known.rise_east) > LEVEL_RISE
            noise_m2 = _variance_m2(reading) / view.by_height**2
            if reading.status is Status.AT_MINIMUM:
                noise_m2 += NEARER_M * NEARER_M
            self._response.update(reading.sensor, self._time_s, height_m, noise_m2, may_slope)
            if self._response.is_fixed:
                self._on_fixed()
                return FIXED
        if square is not None:
            self._scatter(square, variance_m2)
            self._on_ground(sensor, view)
            return None
        is_object = below.is_object(off_m)
        if not is_new or (doubtful and not is_object):
            return self._set_aside(sensor, reading, off_m, is_object)
        return self._on_off(known, sensor, reading, off_m, view, rotation)

    def _on_fixed(self) -> None:
        """What the sensors see as ground is fixed to the vehicle: no ground is known."""
        since_s = self._time_s - self._windows.fresh_s
        for name in self._response.sees(since_s):
            self._sensors[name].stuck.hold()
        for sensor in self._sensors.values():
            sensor.sight.clear()
            sensor.below.clear()
        self._filter = None
        self._start.clear()
        self._response.clear()

    def _set_aside(self, sensor: _Sensor, reading: Reading, off_m: float, is_object: bool) -> str:
        """A reading that has no vote for another ground."""
        if is_object:
            sensor.sight.off(self._time_s, off_m)
            sensor.below.off(self._time_s, off_m, True)
            return OBJECT
        sensor.sight.nothing(self._time_s)
        sensor.below.nothing(self._time_s, self._windows.memory_s)
        return SUSPECT if reading.suspect else REPEATED

    def _is_due(self) -> bool:
        """Whether a sensor that saw the ground last has not been read since: it may see it in its next turn."""
        seen_s = self._support.seen_s
        return any(sight.read_s <= seen_s and sight.votes_ground(seen_s) for sight in self._sights)

    def _climbs(self) -> bool:
        """Whether the vehicle climbs or sinks for sure, by its barometer."""
        rate = self._motion.rate(self._time_s)
        return rate is not None and abs(rate.m_s) > STILL_M_S + STILL_SIGMAS * math.sqrt(rate.variance)

    def _others_see_more(self) -> bool:
        """Whether two sensors see the ground that do not repeat themselves."""
        since_s = self._time_s - self._windows.fresh_s
        newest = [sight.newest(since_s) for sight in self._sights if not sight.repeated]
        return sum([seen is not None and seen.is_ground for seen in newest]) >= 2

    def _look_for_odd(self, known: GroundFilter, sensor: _Sensor, range_m: float, rotation: Matrix) -> None:
        """Find the sensor that does not fit into the plane of the others; the ground is then that of the others."""
        flat = sensor.mounted.view(rotation, known.height_m, 0.0, 0.0)
        if flat is None:
            return
        higher_m = (range_m - flat.expected_m) / flat.by_height
        by_north, by_east = flat.by_north / flat.by_height, flat.by_east / flat.by_height
        since_s = self._time_s - self._windows.fresh_s
        off_m = math.inf
        if sensor.level is not None and sensor.level[0] >= since_s:
            off_m = higher_m - sensor.level[1].higher_m
        if abs(off_m) < GATE_M:
            higher_m -= (1.0 - LEVEL_SHARE) * off_m
        elif abs(higher_m - by_north * known.rise_north - by_east * known.rise_east) > self._gate_m:
            return
        sensor.level = self._time_s, LevelHeight(higher_m, by_north, by_east)
        seen = [each for each in self._sensors.values() if each.level is not None and each.level[0] >= since_s]
        found = odd_one([each.level[1] for each in seen if each.level is not None])
        before, self._odd = self._odd, None if found is None else seen[found[0]]
        if found is not None and self._odd is not before:
            known.tilt(found[1].lower_m, found[1].rise_north, found[1].rise_east)
            self._move_levels(found[1].lower_m)

    def _move_levels(self, by_m: float) -> None:
        """The ground is now taken to be ``by_m`` lower than before."""
        for each in self._sensors.values():
            if each.level is not None:
                time_s, level = each.level
                each.level = time_s, level._replace(higher_m=level.higher_m - by_m)

    def _shows_slope(self, newest: _Sensor) -> bool:
        """Whether this sensor and the others that see the ground now span a plane."""
        since_s = self._time_s - self._windows.fresh_s
        sees = [(sensor, sensor.sight.newest(since_s)) for sensor in self._sensors.values()]
        return spans_plane(
            [each.foot_m for each, seen in sees if each is newest or (seen is not None and seen.is_ground)]
        )

    def _scatter(self, square: float, variance_m2: float) -> None:
        """The ground's roughness grows where readings scatter more than they should, and falls where less."""
        change_m2 = (min(square, FIT_CAP) - 1.0) * variance_m2 / ROUGH_READINGS
        self._rough_m2 = min(max(self._rough_m2 + change_m2, 0.0), ROUGHEST_M**2)
        self._fit += (min(square, FIT_CAP) - self._fit) / FIT_READINGS

    def _on_ground(self, sensor: _Sensor, view: View) -> None:
        sensor.sight.ground(self._time_s)
        sensor.below.ground(self._time_s)
        self._support.on_ground(self._time_s)
        self._known_s = self._time_s
        self._shared_m2 = view.shared_variance_m2
        self._nearest = view.nearest

    def _on_off(
        self, known: GroundFilter, sensor: _Sensor, reading: Reading, off_m: float, view: View, rotation: Matrix
    ) -> str | None:
        """A reading that is not of the ground: of a step, of an object, or of nothing."""
        time_s, windows = self._time_s, self._windows
        sensor.sight.off(time_s, off_m)
        sensor.below.off(time_s, off_m, self._support.is_seen(time_s))
        if reading.raw and reading.range_m:
            by_raw_m = reading.range_m / reading.raw
            ground = round(view.expected_m / by_raw_m)
            longer_m = [abs(word - reading.raw) * by_raw_m for word in sensor.mounted.garbled_from(ground)]
            sensor.is_ground_in_doubt = min(longer_m, default=math.inf) < garbled.AGAIN_M
        known_object = sensor.below.is_object(off_m)
        self._support.on_other(reading.sensor, off_m, known_object)
        if sensor.sight.votes_ground(time_s - windows.held_s):
            self._fit += (FIT_OUTLIER - self._fit) / FIT_READINGS
        lower_m = step_m(sensor.sight, self._sights, time_s, windows)
        if lower_m is not None:
            known.shift(lower_m, STEP_STD_M**2, STEP_CLIMB_STD_M_S**2)
            self._response.shift(lower_m)
            self._steps_m += lower_m
            for each in self._sensors.values():
                each.sight.move(lower_m)
                each.below.move(lower_m)
                each.level = None
            self._on_ground(sensor, view)
            return None
        if time_s - self._support.seen_s > windows.lost_s and not self._is_due() and reading.range_m is not None:
            return self._on_first(sensor, reading, reading.range_m, rotation)
        return OBJECT if known_object else OUTLIER

    def _down_axis(self, known: GroundFilter, rotation: Matrix) -> Fused:
        """d = h / (e . G) along the body's down axis e; autopilots correct it for the tilt themselves."""
        north, east, down = rotation[0][2], rotation[1][2], rotation[2][2]
        along = max(down + known.rise_north * north + known.rise_east * east, 0.1)
        range_m = known.height_m / along
        slopes = -range_m / along
        # Readings to the nearest point give h / |G|, so that the height follows the slope that is estimated.
        bends = self._nearest * range_m / (1 + known.rise_north**2 + known.rise_east**2)
        variance_m2 = known.variance(
            1 / along, slopes * north + bends * known.rise_north, slopes * east + bends * known.rise_east
        )
        if self._fit > FIT_TOLERATED:
            variance_m2 *= self._fit
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
