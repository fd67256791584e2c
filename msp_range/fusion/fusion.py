"""Several downward sensors -> the ground below the vehicle, and the one distance that an autopilot expects.

`Fusion` is updated with each corrected reading, in the order of their times, and answers with what the stream says now
(`Outcome`): the distance along the vehicle's down axis, 'above the maximum', or nothing. What each reading is of, and
which surface is the ground, is decided in `msp_range.fusion.belief`.
"""

import math
from collections import deque
from collections.abc import Mapping

from msp_range.filters.chain import UNCONFIRMED
from msp_range.fusion.above import AboveMaximum
from msp_range.fusion.attitude import AttitudeTrack
from msp_range.fusion.belief import STEP_CLIMB_STD_M_S, STEP_STD_M, Belief, Surface
from msp_range.fusion.ground_filter import GroundFilter
from msp_range.fusion.look import Look, Seen
from msp_range.fusion.modes import (
    AGAIN_M,
    AGAIN_S,
    DOUBTFUL_M,
    DOUBTFUL_PER_M,
    GARBLED_STD_M,
    GATE_M,
    GATE_M_S2,
    GATE_SIGMAS,
    GATE_WIDEST_M,
    LOW_M,
    ODD_GAP_S,
    OTHERS_IN_A_ROW,
    P_AGAIN,
    P_GARBLED,
    P_OUTLIER,
    PER_M,
    STILL_M_S,
    STILL_SIGMAS,
    SURE,
    SensorMode,
    normal_per_m,
)
from msp_range.fusion.mounting import LEVEL, DownwardSensor, spans_plane
from msp_range.fusion.odd import OddSensor
from msp_range.fusion.outcome import FIXED, GARBLED, OBJECT, OUTLIER, PAST, REPEATED, SUSPECT, Fused, Outcome
from msp_range.fusion.response import LEVEL_RISE, NEAR_M, HeightReading
from msp_range.fusion.vertical import Known, VerticalMotion
from msp_range.fusion.windows import SHORTEST_GAP_S, Windows
from msp_range.geometry import Matrix, Vector
from msp_range.numbers import limited
from msp_range.pilot_texts import Condition, Text
from msp_range.reading import Reading, Status

ROUGH_READINGS = 30.0
"""The roughness of the ground is a mean over so many readings."""
ROUGHEST_M = 0.08
"""More scatter than this about the plane is not put down to roughness [m]."""
NEARER_M = 0.15
"""The surface may be nearer than a sensor's minimum by this, as on the ground [m]: such a reading shows a response to
the vehicle's motion no closer. Less takes a landing that bounces for one, more finds ice on the sensors later."""
LIFTS = 0.75
"""A reading beyond the minimum is of a take-off where it is off from the height that the acceleration predicts by at
most this share of how far it is off the ground known so far, else an outlier: 0.99 in a landed vehicle, 0.67 in a
take-off that the sensors see late. Smaller loses such a take-off."""
FIT_READINGS = 10.0
"""The mean square of the normalised innovations is taken over so many readings: a second of four sensors."""
FIT_CAP, FIT_OUTLIER = 25.0, 12.0
"""A reading counts in it by no more than the first, one of five standard deviations; an outlier of a sensor that
otherwise sees the ground by the second. What is not used is not in the estimate, but where it is much of what these
sensors say, what is used was chosen from it. Larger doubts the ground for longer after one outlier."""
CONFIDENCE_READINGS = 20
"""The confidence in a distance falls with the share of so many readings that contradict it, by `FIT_OUTLIER` or more:
one outlier makes it 95 %, three within two seconds of four sensors 85 %. With ten ArduSub, which drops less than 90 %,
would drop distances for two outliers."""
FIT_TOLERATED = 1.5
"""Up to this mean square the stated variance stands, beyond it the variance grows with it. Ten readings of a filter
that is right exceed it in one of ten turns; larger believes a noisy sensor's small variance for longer."""
STALE_S = 0.25
"""A ranging that is over this long after its time says nothing of now [s]: the program or the bus stood still."""


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
    fit
        Mean square of the last innovations over their variance: about 1 where the stated deviation is right.
    """

    def __init__(
        self,
        sensors: Mapping[str, DownwardSensor],
        attitude: AttitudeTrack,
        windows: Windows,
        motion: VerticalMotion | None = None,
        maximum_m: float = 7.65,
    ) -> None:
        self._modes = {name: SensorMode(mounted) for name, mounted in sensors.items()}
        self._attitude = attitude
        self._windows = windows
        self._motion = motion or VerticalMotion()
        self._gate_m = min(GATE_M + GATE_M_S2 * max(windows.gap_s**2 - SHORTEST_GAP_S**2, 0.0), GATE_WIDEST_M)
        self._belief = Belief(list(self._modes.values()), self._motion, windows)
        self._above = AboveMaximum(maximum_m, self._motion)
        self._odd = OddSensor(self._gate_m, windows.fresh_s)
        self._time_s = self._garbled_s = float("-inf")
        self._rough_m2 = 0.0
        self._others = 0
        self._asked: SensorMode | None = None  # The last one out of turn, and whether its answer is still to come.
        self._waits = False
        self._shared_m2 = self._nearest = 0.0
        self.fit = 1.0
        self._agree = deque([True] * CONFIDENCE_READINGS, CONFIDENCE_READINGS)
        self.level_height_m: float | None = None
        self.down: Vector | None = None

    def set_maximum(self, maximum_m: float) -> None:
        """The longest distance that the sensors can measure is another one, because the air is [m]."""
        self._above.maximum_m = maximum_m

    @property
    def climb_m_s(self) -> float:
        """How fast the height grows [m/s]; 0 where it is not known."""
        return 0.0 if self._belief.ground is None else self._belief.ground.filter.climb_m_s

    @property
    def confidence(self) -> float:
        """Probability of the ground, times the share of the last readings that do not contradict it."""
        return self._belief.sure * sum(self._agree) / CONFIDENCE_READINGS

    def asks_again(self, outcome: Outcome) -> bool:
        """Whether a reading's sensor is to be asked out of turn: for the first of an outlier, or for late answers.

        Where another sensor sees something else, too, the extra turn would delay the readings that decide. For late
        answers one sensor after the other is asked: two that are both asked again are in turn again.
        """
        ground, mode = self._belief.ground, self._modes[outcome.reading.sensor]
        is_next = not self._waits and mode is not self._asked
        self._waits = self._waits and mode is not self._asked
        if outcome.fused is None or ground is None:
            return False
        if is_next and ground.response.may_be_late:
            self._asked, self._waits = mode, True
            return True
        if outcome.rejected != OUTLIER or mode.readings > 1:
            return False
        return all(each.sees in (None, ground) for each in self._modes.values() if each is not mode)

    def conditions(self) -> list[Condition]:
        """Answers a ping late, readings of nothing, and what is perhaps no ground: for `msp_range.health`."""
        ground = self._belief.ground
        return [
            Text.LATE.when(ground is not None and ground.response.is_late),
            Text.SCATTER.when(self._belief.is_scattered),
            self._belief.doubt or Text.STEEP.when(False),
        ]

    def object_m(self, sensor: str) -> float | None:
        """Height over the ground of what is below a sensor and is not ground, negative for a hole [m]; or None."""
        return self._modes[sensor].object_m

    def is_ground_in_doubt(self, sensor: str) -> bool:
        """Whether the ground that the others see may be what this sensor sees, with a byte lost on the bus."""
        return self._modes[sensor].is_ground_in_doubt

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
        mode, belief = self._modes[reading.sensor], self._belief
        self.level_height_m = None
        time_s = self._time_s = max(reading.time_s, self._time_s)
        belief.predict(time_s)
        rotation = self._rotation(time_s)
        reading = self._unless_stuck(mode, reading)
        mode.since_s, mode.read_s = time_s - mode.read_s, time_s
        mode.works = not reading.status.is_fault
        if reading.range_m is None:
            rejected: str | None = reading.status.value
            if time_s - mode.ranged_s > self._windows.memory_s:
                mode.object_m = None
        else:
            mode.ranged_s = time_s
            std_m = 0.01 if reading.std_m is None else reading.std_m
            variance_m2 = std_m * std_m if math.isfinite(std_m) else 1.0
            look = Look(mode, reading, reading.range_m, variance_m2, mode.mounted.turned(rotation))
            rejected = self._on_range(look)
            if rejected == GARBLED:
                reading = Reading(reading.time_s, reading.sensor, Status.GARBLED, raw=reading.raw)
                mode.works = False
        belief.weigh()
        self._count_stray(mode, reading)
        if reading.range_m is not None:
            rejected = self._against(belief.ground, look, rejected)
            is_known = mode.sees is not None and mode.sees.evidence > 0.0
            self._others = 0 if rejected is None else self._others + (rejected != OBJECT and not is_known)
        mode.last_raw = reading.raw
        if reading.suspect:
            self._above.update_with_code()
        else:
            faces = mode.mounted.faces_ground(rotation[2])
            self._above.update(reading.sensor, reading.status is Status.NO_ECHO, mode.works, faces)
        return self._outcome(reading, rejected, rotation, now_s)

    def _outcome(self, reading: Reading, rejected: str | None, rotation: Matrix, now_s: float) -> Outcome:
        """What is sent after a reading: the distance, 'above the maximum', or nothing."""
        ground, time_s = self._belief.ground, self._time_s
        if ground is not None and self._may_be_sent(ground, now_s, rejected is None):
            fused = self._down_axis(ground.filter, rotation)
            known = Known(time_s, fused.range_m, fused.height_m, fused.climb_m_s, self._motion.mark(time_s))
            self._above.on_ground_seen(known)
            self._belief.on_sent(known)
            is_above = fused.range_m > self._above.maximum_m
            return Outcome(reading, None if is_above else fused, is_above, rejected)
        is_seen = ground is not None and self._is_seen(ground)
        return Outcome(reading, None, not is_seen and self._above.decide(time_s), rejected)

    def _count_stray(self, mode: SensorMode, reading: Reading) -> None:
        """Count the reading of this sensor before, if nobody has seen the same since, as an outlier."""
        stray, mode.stray = mode.stray, None
        if stray is not None:
            again = [each for each in self._modes.values() if each is not mode or reading.range_m is not None]
            if not any(each.sees is stray for each in again):
                self._update_fit(FIT_OUTLIER)

    def _may_be_sent(self, ground: Surface, now_s: float, was_ground: bool) -> bool:
        """Whether the ground is sure, and a sensor has seen it just now."""
        if self._belief.sure < SURE or ground.response.misleads or now_s - self._time_s > STALE_S:
            return False
        if not self._is_seen(ground) or self._others >= OTHERS_IN_A_ROW:
            return False
        fewest = 1 if ground is self._belief.proven else 2
        return was_ground or len(self._belief.sees(ground, self._time_s - self._windows.held_s)) >= fewest

    def _rotation(self, time_s: float) -> Matrix:
        rotation = self._attitude.rotation_at(time_s)
        if (rotation is None) != (self.down is None):
            self._belief.level()
        self.down = None if rotation is None else rotation[2]
        return rotation or LEVEL

    def _unless_stuck(self, mode: SensorMode, reading: Reading) -> Reading:
        """The reading; without its range where the sensor is stuck."""
        if reading.raw is None or reading.status.is_fault:
            return reading
        others_see = self._belief.best_seen(mode)
        least = reading.status is Status.AT_MINIMUM
        stuck = mode.is_stuck(reading.raw, reading.range_m, others_see, self._motion, self._time_s, least)
        if not stuck or reading.range_m is None:
            return reading
        mode.sees, mode.seen_s = None, float("-inf")
        status = Status.FIXED if mode.is_fixed else Status.STUCK
        return Reading(reading.time_s, reading.sensor, status, raw=reading.raw)

    def _on_range(self, look: Look) -> str | None:
        """Give a reading to the surface that it is of; None, or why it is of none."""
        belief, mode, reading = self._belief, look.mode, look.reading
        ground, parent, suspect = belief.ground, belief.proven, reading.suspect
        if ground is not None and self.down is not None and self._windows.gap_s < ODD_GAP_S and not suspect:
            self._odd.update(ground.filter, look, self._time_s)
        seen = look.over(None if parent is None else parent.filter)
        if seen is None:
            return PAST
        variance_m2 = look.variance_m2 + self._rough_m2
        seen_over: dict[Surface, Seen] = {}
        densities: dict[Surface, float] = {}
        for surface in belief.surfaces:
            if (mode is self._odd.mode and surface is ground) or (suspect and surface is not parent):
                continue
            at = seen if surface is parent else look.over(surface.filter)
            if at is None:
                continue
            gate_m = GATE_WIDEST_M
            if parent is not None or surface.evidence > 0.0:
                gate_m = limited(GATE_SIGMAS * math.sqrt(variance_m2), self._gate_m, GATE_WIDEST_M)
            if abs(at.innovation_m) <= (DOUBTFUL_M if suspect else gate_m):
                density = surface.filter.density(at.view, at.innovation_m, variance_m2)
                if density < 0.5 / gate_m and surface.filter.variance(1.0, 0.0, 0.0) > gate_m * gate_m:
                    density = 0.5 / gate_m  # Of so slow a polling any reading within the gate is as likely.
                if not suspect or (density > DOUBTFUL_PER_M and not self._climbs()):
                    seen_over[surface], densities[surface] = at, density
        found, share = belief.best_of(mode, None if suspect else look.range_m, densities)
        if parent is not None and found is None and not suspect and self._lifts_off(parent, look, seen):
            mode.see(parent, self._time_s)
            return self._on_surface(parent, look, look.over(parent.filter) or seen, PER_M)
        known = list(belief.surfaces) if parent is None else [parent]
        if not suspect and found not in known and any(self._is_fixed_after_all(surface, look) for surface in known):
            return FIXED
        if found is not None:
            mode.see(found, self._time_s, share)
            return self._on_surface(found, look, seen_over[found], densities[found])
        if suspect or self._was_garbled(look):
            mode.see(None, float("-inf"))
            return SUSPECT if suspect else GARBLED
        if mode.repeated and ground is not None and self._others_see(ground):
            mode.see(None, self._time_s)
            return REPEATED
        raw = None if mode.repeated else reading.raw
        new = belief.start(mode, seen.height_m, look.variance_m2, seen.view, raw)
        mode.see(new, self._time_s)
        return UNCONFIRMED

    def _on_surface(self, surface: Surface, look: Look, seen: Seen, density: float) -> str | None:
        """Update a surface with a reading of it; why it is no ground after all, else None."""
        look.mode.foot_m = look.mode.mounted.foot_m(look.range_m)
        if look.mode.repeated and self._others_see(surface):
            # What a sensor repeats is nothing new: it would hold the ground when the vehicle moves.
            self._belief.seen(surface)
            return None
        variance_m2 = look.variance_m2 + self._rough_m2
        shows_slope = self._spans_plane(surface)
        square = surface.filter.update(seen.view, seen.innovation_m, variance_m2, shows_slope)
        if self._is_fixed(surface, look, seen, shows_slope):
            return FIXED
        if surface is self._belief.ground:
            self._scatter(square, variance_m2)
            self._shared_m2, self._nearest = seen.view.shared_variance_m2, seen.view.nearest
            if look.is_least:
                self._shared_m2 += NEARER_M * NEARER_M / 3  # Evenly distributed from there on.
        self._belief.hit(look.mode, surface, density, look.reading.raw, look.is_least)
        return None

    def _spans_plane(self, surface: Surface) -> bool:
        """Whether the sensors that see a surface now show its slope."""
        return spans_plane([each.foot_m for each in self._belief.sees(surface, self._time_s - self._windows.fresh_s)])

    def _others_see(self, surface: Surface) -> bool:
        """Whether two sensors see a surface that do not repeat themselves."""
        others = self._belief.sees(surface, self._time_s - self._windows.fresh_s)
        return sum([not each.repeated for each in others]) >= 2

    def _is_fixed(self, surface: Surface, look: Look, seen: Seen, shows_slope: bool, moves_all: bool = True) -> bool:
        """Update how a surface answers to the vehicle's motion; whether it is fixed to the vehicle."""
        known, since_s = surface.filter, self._time_s - self._windows.fresh_s
        slopes = not shows_slope or math.hypot(known.rise_north, known.rise_east) > LEVEL_RISE
        may_slope = known.height_m > LOW_M and slopes
        surface.response.update(self._height_reading(look, seen), known.climb_m_s, may_slope, moves_all)
        if not surface.response.is_fixed:
            return False
        answered = [self._modes[name] for name in surface.response.sees(since_s)]
        for mode in [*self._belief.sees(surface, since_s), *answered]:
            mode.hold()
        self._belief.forget(surface)
        return True

    def _height_reading(self, look: Look, seen: Seen) -> HeightReading:
        variance_m2 = look.variance_m2 / seen.view.by_height**2
        if look.is_least:
            variance_m2 += NEARER_M * NEARER_M
        return HeightReading(look.reading.sensor, self._time_s, look.mode.since_s, seen.height_m, variance_m2)

    def _lifts_off(self, parent: Surface, look: Look, seen: Seen) -> bool:
        """Whether a reading is of the ground that the vehicle has just left, by its acceleration; then it moves there.

        While the sensors read their minimum the filter of the height does not see that the vehicle climbs.
        """
        if self._time_s - parent.least_s > self._windows.fresh_s:
            return False
        off_m = seen.height_m - parent.filter.height_m
        if parent.response.offs_m(self._height_reading(look, seen))[0] > min(NEAR_M, LIFTS * abs(off_m)):
            return False
        parent.filter.shift(off_m, STEP_STD_M**2, STEP_CLIMB_STD_M_S**2)
        return True

    def _is_fixed_after_all(self, surface: Surface, look: Look) -> bool:
        """`_is_fixed` by a reading that is not of a surface, where its response expects one like it."""
        seen = look.over(surface.filter)
        if seen is None or not surface.response.expects(self._height_reading(look, seen)):
            return False
        return self._is_fixed(surface, look, seen, self._spans_plane(surface), look.is_least)

    def _was_garbled(self, look: Look) -> bool:
        """Whether a reading is the ground's, garbled on the bus; then it keeps what is known of the ground up to date.

        It is no reason to send a distance, but without it the garbled answers of all sensors would soon be the only
        ground that is known.
        """
        expected, parent = self._belief.expected(), self._belief.reference
        seen = look.over(None if parent is None else parent.filter)
        if expected is None or seen is None:
            return False
        height_m, std_m = expected
        offs_m = [seen.height_m + higher_m - height_m for higher_m in look.garbled_m(seen)]
        off_m = min(offs_m, key=abs, default=math.inf)
        chance = P_AGAIN if self._time_s - self._garbled_s < AGAIN_S else P_GARBLED
        is_garbled = chance * normal_per_m(off_m, math.hypot(std_m, GARBLED_STD_M)) > P_OUTLIER * PER_M
        if not is_garbled or abs(off_m) > AGAIN_M:
            return False
        self._garbled_s = self._time_s
        if parent is not None:
            innovation_m = off_m * seen.view.by_height
            parent.filter.update(seen.view, innovation_m, look.variance_m2 + GARBLED_STD_M**2, False)
            parent.kept_s = self._time_s
        return True

    def _against(self, ground: Surface | None, look: Look, rejected: str | None) -> str | None:
        """A reading against the ground: None where it is of it, else why not."""
        mode = look.mode
        seen = None if ground is None else look.over(ground.filter)
        if ground is None or seen is None:
            return rejected or UNCONFIRMED
        known, view = ground.filter, seen.view
        sloping_m = (view.by_north * known.rise_north + view.by_east * known.rise_east) / view.by_height
        self.level_height_m = seen.height_m + sloping_m
        if rejected in (SUSPECT, REPEATED, FIXED):
            return rejected
        if mode.sees is ground:
            mode.below(None, True)
            return None if self._belief.sure >= SURE or ground is self._belief.proven else UNCONFIRMED
        lower_m = seen.height_m if mode.sees is None else mode.sees.filter.height_m
        off_m = lower_m - known.height_m
        mode.below(off_m, self._belief.sure >= SURE and self._is_seen(ground))
        words = look.garbled_words(round(view.expected_m / look.by_raw_m))
        longer_m = [abs(word * look.by_raw_m - look.range_m) for word in words]
        mode.is_ground_in_doubt = min(longer_m, default=math.inf) < AGAIN_M
        is_new = mode.readings < 2
        is_stray = is_new and not any(each.has_edge_at(off_m) for each in self._modes.values())
        mode.stray = mode.sees if is_stray else None
        self._agree.append(not is_new)
        return OUTLIER if mode.object_m is None else OBJECT

    def _is_seen(self, ground: Surface) -> bool:
        return self._time_s - ground.seen_s <= self._windows.newest_s

    def _climbs(self) -> bool:
        """Whether the vehicle climbs or sinks for sure, by its barometer."""
        rate = self._motion.rate(self._time_s)
        return rate is not None and abs(rate.m_s) > STILL_M_S + STILL_SIGMAS * math.sqrt(rate.variance)

    def _scatter(self, square: float, variance_m2: float) -> None:
        """The ground's roughness grows where readings scatter more than they should, and falls where less."""
        change_m2 = (min(square, FIT_CAP) - 1.0) * variance_m2 / ROUGH_READINGS
        self._rough_m2 = limited(self._rough_m2 + change_m2, 0.0, ROUGHEST_M**2)
        self._update_fit(square)
        self._agree.append(square < FIT_OUTLIER)

    def _update_fit(self, square: float) -> None:
        """Update with a reading's squared deviation from the ground over its variance."""
        self.fit += (min(square, FIT_CAP) - self.fit) / FIT_READINGS

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
        if self.fit > FIT_TOLERATED:
            variance_m2 *= self.fit
        return Fused(
            range_m,
            variance_m2 + self._shared_m2,
            known.height_m,
            known.climb_m_s,
            known.rise_north,
            known.rise_east,
            self._belief.sure,
        )
