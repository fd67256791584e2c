"""Each downward sensor in flight against its own reading model: which one has begun to read otherwise?

Every reading enters with the height that it alone gives; findings leave, such as 'front_left: often too
short'. A reading is compared, a turn later, with the height by the other sensors (`msp_range.health.neighbours`):

    x = (h - h_others - b) / sqrt(sigma^2 + var(h_others)),   e = (x - phi x_before) / sqrt(1 - phi^2)

b is the sensor's own slow offset (mounting, slope and tufts below it) and phi the correlation of successive errors, the
larger of the model's and the one that all sensors show. Each alternative to the model has a likelihood ratio L:

    short      e < -4, and neither the reading before nor the one after agrees: then it is no object
               L = 6^k / (1 + 5 p), k = 1 for a short reading and 0 for another; odds six times the model's
    missed     no echo where the others see ground nearer than 80 % of the maximum, and the sensor looks straight down
               but for 3 deg less than the half angle of its beam; L of the same form
    wider      L = exp(e^2/s (1/c - 1/3) / 2) sqrt(c/3), at most for e^2/s of 13: the variance is 3 times, not c times
    shifted    the others agree on level ground and the vehicle moves: L = exp(2 y - 2), y the absolute difference
               without b, less 3 cm and three times the roughness r, in deviations; L is bounded, so that it takes 15 s
               at least. r is the rms of the others' offsets from their mean, over 150 readings
    repeats    the same answer again while the others show a climb that it should have followed; odds twelve times

s is the mean square of the other sensors' e where that is more than 1, and p the larger of the model's probability and
what the others show beyond two standard errors. So what is common to all sensors (rough or soft ground, bushes, a wrong
temperature, a model that is wrong of all) is no finding of one of them, and cannot be seen here.

L is fed to `msp_range.health.evidence.Evidence`, which gives the mean time between false reports a lower bound. The
bound holds where the model's numbers, or the others' where they replace them, are not exceeded by a sensor in order.
"""

import math
from collections.abc import Mapping

from msp_range.geometry import Vector
from msp_range.health.evidence import Evidence, Occurrences
from msp_range.health.expected import Expected, missed_share
from msp_range.health.finding import Kind, SensorFinding
from msp_range.health.neighbours import GroundUse, Sighting, reference

FALSE_ALARM_H = 2000.0
"""Mean flying time between two false findings of a vehicle, at least [h], where all holds that the bound assumes. At
1,000 there were three in 1,000 drawn hours, of which one is left. Ten times as much finds a sensor with 10 % short
readings 8 s later."""
WEIGHTS: dict[Kind, float] = {"short": 0.35, "missed": 0.2, "wider": 0.35, "shifted": 0.05, "repeats": 0.05}
"""Share of the false alarms that each alternative may have; half of it costs 3 s of 60 s."""
ODDS, REPEAT_ODDS = 6.0, 12.0
"""Odds of the alternatives over the model's: fewer find a small change sooner and a large one later."""
OFF = 4.0
"""A reading this many deviations nearer than the others is short."""
AGREE_M = 0.12
"""Two successive readings of a sensor this close see the same thing, which is an object [m]."""
WIDER, TOLERATED = 3.0, 1.2
"""Variance over the model's: of the alternative, and what counts as in order. Doubled deviation gives 3.4 with the
error of the reference. More tolerance is later: at 1.3 a doubled deviation is found after 30 s."""
MOST_SQUARE = 13.0
"""A reading counts for a wider distribution by no more than this square: what is farther off is another kind. At 12 a
doubled deviation is found 2 s later; larger lets random readings and a few steps of the ground look like scatter."""
WIDER_NORM, WIDER_SLOPE = math.sqrt(TOLERATED / WIDER), 0.5 * (1.0 / TOLERATED - 1.0 / WIDER)
LEVEL_M, SHIFT_M = 0.015, 0.03
"""Other sensors whose offsets differ by less than the first see level ground; a shift up to the second may be the
mounting's, the attitude's or the slope's [m]. Larger asks over slopes too, and is wrong there."""
SHIFT_ASKED_M, MOST_SHIFT_M = 0.015, 0.25
"""A shift is asked for where the sensor's slow offset exceeds the first [m], to save time; what is farther off than the
second is an object or a hole."""
LEVEL_SENSORS = 3
"""So many other sensors at least must agree that the ground is level: two are on one line."""
ROUGH, ROUGH_READINGS = 3.0, 150
"""So many times the ground's roughness, a mean over so many of its readings, is no shift of a sensor: the others agree
on rough ground too, for half a minute. In 150 drawn hours of hovering over ground that is rough by 3 cm there were five
false shifts without it, and none with it; over level ground another 1.5 cm are no shift."""
SHIFT_LOG = 0.5
"""A reading's logarithm of L counts for a shift by no more: 38 readings at least, so that no tuft is one."""
MOVES_M_S, TILTS_COS = 0.15, 0.9986
"""A vehicle moves that climbs or sinks this fast [m/s], or leans by 3 deg. A hover over one stone must not count."""
FOLLOWS_M, FOLLOWS = 0.03, 3.0
"""A reading has to differ from the one before where the height has changed by so much [m], and so many deviations."""
REPEATS = 0.05
"""Probability that it repeats all the same, at most: whole centimetres and the reference's error."""
NEAREST_M, FARTHEST = 0.4, 0.8
"""Nearer to the ground [m] and beyond this share of the maximum nothing is asked: landed, and echoes grow faint."""
OFFSET_READINGS, SCALE_READINGS = 20, 25
"""A sensor's offset and scatter are means over so many of its readings. Shorter ones hide what a sensor does slowly;
with 50 for the scatter a vehicle that began to move over rough grass was ahead of it for 20 s, and a good sensor was
reported once in four hours of short flights."""
CORRELATION_SHARE = 0.005
"""Share of a reading of any sensor in the correlation: a mean over 50 readings of each of four."""
STEP = 0.8
"""Two differences in a row of one sign, whose geometric mean exceeds this share of what makes a reading short, and
which differ by less, are a step of the offset, which is then learned at once. At 0.6 rough ground makes steps, and one
of them moves the reference of the other sensors and makes theirs; at 1 a stone of 8 cm counts as scatter."""
WARM_UP = 10
"""Readings that only teach the offset."""
MOST_CORRELATION = 0.95
TURNS_APART = 1.7
"""Readings up to so many turns apart are successive: beyond them nothing is known of the correlation."""
BAROMETER_M_S = 0.3
"""A single sensor's repeats count as far as the barometer's climb is more than this [m/s], its error."""
MOST_NEIGHBOURS = 3
"""Readings before and after one among which its reference is looked for: a turn of four sensors."""


class _Sensor:
    """One sensor: what its model says, and what was seen of it."""

    def __init__(self, index: int, name: str, expected: Expected, readings: float) -> None:
        self.index, self.name, self.expected = index, name, expected
        self.faces_level = expected.boresight[2] > expected.facing_cosine
        self.others: list[_Sensor] = []
        self.short = Occurrences(readings / WEIGHTS["short"], ODDS)
        self.missed = Occurrences(readings / WEIGHTS["missed"], ODDS)
        self.repeats = Occurrences(readings / WEIGHTS["repeats"], REPEAT_ODDS)
        self.wider, self.shifted = Evidence(readings / WEIGHTS["wider"]), Evidence(readings / WEIGHTS["shifted"])
        self.findings: dict[Kind, SensorFinding] = {}
        # Slow means of its readings: how many there were, offset from the others [m], mean square of e, and of the
        # others' offsets the variance [m^2].
        self.readings, self.offset_m, self.scale, self.rough_m2 = 0, 0.0, 1.0, 0.0
        # The reading before: normalised difference and its time, difference [m], answer and its time, and the height by
        # the others [m], or of a single sensor its own.
        self.x, self.x_s = 0.0, -math.inf
        self.seen_m: float | None = None
        self.raw: int | None = None
        self.time_s = -math.inf
        self.height_m: float | None = None
        # Whether that was short and waits for the next one, and the probability that it was.
        self.has_pending, self.short_probability = False, 0.0


class SensorWatch:
    """All sensors of the fused stream.

    Parameters
    ----------
    sensors
        What the model of each says, by name, in the order of the airframe.
    turn_s
        From a sensor's reading to its next one [s].

    Attributes
    ----------
    findings
        What is found now, the oldest first.
    """

    def __init__(self, sensors: Mapping[str, Expected], turn_s: float) -> None:
        count = len(sensors)
        readings = FALSE_ALARM_H * 3600.0 * count / turn_s
        self._sensors = [_Sensor(i, name, each, readings) for i, (name, each) in enumerate(sensors.items())]
        for sensor in self._sensors:
            sensor.others = [each for each in self._sensors if each is not sensor]
        self._of = {sensor.name: sensor for sensor in self._sensors}
        self._successive_s = TURNS_APART * turn_s
        self._middle = min(count - 1, MOST_NEIGHBOURS)
        self._window: list[Sighting] = []
        self._model_correlation = max([each.correlation for each in sensors.values()], default=0.0)
        self._product, self._square = 0.0, 1.0
        # Sum of the offsets [m], and of the mean squares of the sensors that are not found to be wider.
        self._offsets_m, self._scales, self._in_order = 0.0, float(count), count
        self.findings: list[SensorFinding] = []

    @property
    def is_single(self) -> bool:
        """Whether there is one sensor only, which is asked for codes and repeats and nothing else."""
        return self._middle == 0

    def update(
        self,
        name: str,
        time_s: float,
        seen: GroundUse,
        height_m: float | None,
        std_m: float | None,
        raw: int | None,
        climb_m_s: float,
        down: Vector | None,
    ) -> None:
        """Update with a reading, in the order of their times.

        Parameters
        ----------
        name
            Of the sensor.
        time_s, seen, height_m, raw
            As in `Sighting`.
        std_m
            Deviation that the reading comes with [m]; None without a range.
        climb_m_s
            How fast the vehicle climbs by all sensors [m/s]; of a single one by its barometer, 0 where there is none.
        down
            Straight down, a unit vector in body FRD; None where the attitude is not known.
        """
        own = self._of[name]
        if height_m is None and seen is not GroundUse.MISSED:
            seen = GroundUse.NOTHING
        common_m = height_m - own.offset_m if height_m is not None and seen is GroundUse.GROUND else None
        std_m = own.expected.spread * (std_m or 0.0)
        sighting = Sighting(time_s, own.index, common_m, std_m, seen, height_m, raw, climb_m_s, down)
        if self._middle == 0:
            self._alone(own, sighting)
            return
        window = self._window
        window.append(sighting)
        if len(window) > 2 * self._middle:
            sighting = window[self._middle]
            if sighting.seen is not GroundUse.NOTHING:
                self._compare(self._sensors[sighting.sensor], sighting)
            del window[0]

    def _alone(self, own: _Sensor, sighting: Sighting) -> None:
        """The only sensor: codes after a range, and repeats while the barometer shows a climb."""
        before_m = own.height_m
        if before_m is not None and NEAREST_M < before_m < FARTHEST * own.expected.maximum_m:
            self._echo(own, sighting, before_m)
        elapsed_s = sighting.time_s - own.time_s
        if elapsed_s < self._successive_s:
            self._repeat(own, sighting, max(abs(sighting.climb_m_s) - BAROMETER_M_S, 0.0) * elapsed_s)
        own.time_s, own.height_m, own.raw = sighting.time_s, sighting.height_m, sighting.raw
        if own.findings:
            self._settle(own)

    def _compare(self, own: _Sensor, sighting: Sighting) -> None:
        """A reading with the others' around it."""
        if own.wider.is_found:
            scale = self._scales / (self._in_order or 1)
        else:
            scale = (self._scales - own.scale) / (self._in_order - 1 or 1)
        scale = scale if scale > 1.0 else 1.0
        others = reference(self._window, self._middle, scale)
        if others is None or not others.height_m > NEAREST_M:
            return
        time_s, std_m, seen, height_m = sighting.time_s, sighting.std_m, sighting.seen, sighting.height_m
        expected, others_m = own.expected, others.height_m
        if others_m < FARTHEST * expected.maximum_m:
            self._echo(own, sighting, others_m)
        before_m, own.height_m = own.height_m, others_m
        if before_m is not None and time_s - own.time_s < self._successive_s:
            self._repeat(own, sighting, abs(others_m - before_m))
        own.time_s, own.raw = time_s, sighting.raw
        if own.findings:
            self._settle(own)
        if seen is GroundUse.REPEATED:
            return
        if height_m is None or seen is GroundUse.MISSED:
            self._confirm_short(own)
            own.seen_m, own.x, own.x_s = None, 0.0, -math.inf
            return
        off_m = height_m - others_m
        variance_m2 = std_m * std_m + others.variance_m2
        deviation_m = math.sqrt(variance_m2)
        x = (off_m - own.offset_m) / deviation_m
        e = x
        if own.x_s > time_s - self._successive_s and (phi := self._correlation()) > 0.0:
            e = (x - phi * own.x) / math.sqrt(1.0 - phi * phi)
        limit = OFF * math.sqrt(scale)
        agrees = own.seen_m is not None and abs(off_m - own.seen_m) < AGREE_M
        if own.has_pending:
            if agrees:
                own.has_pending = False
            else:
                self._confirm_short(own)
        own.seen_m = off_m
        is_ground = seen is GroundUse.GROUND
        # Two large differences in a row that are alike: a stone or an edge below the sensor.
        step = STEP * limit
        has_stepped = own.x * x > step * step and abs(own.x - x) < step
        if own.readings > WARM_UP:
            if e >= -limit:
                own.short.nones += 1
            elif not agrees:
                span = max(others_m - expected.minimum_m, 0.0) / (expected.maximum_m - expected.minimum_m)
                own.has_pending, own.short_probability = True, expected.short + expected.random * span
            if is_ground and not has_stepped:
                square = e * e / scale
                ratio = math.exp((square if square < MOST_SQUARE else MOST_SQUARE) * WIDER_SLOPE) * WIDER_NORM
                # The rest of the variance is the reference's.
                own_share = std_m * std_m / variance_m2
                if own.wider.update(ratio, own_share, square - 1.0 + own_share):
                    self._report(own, "wider", own.wider)
            if abs(own.offset_m - self._offsets_m / len(self._sensors)) > SHIFT_ASKED_M:
                self._shift(own, sighting, others.climb_m_s, off_m, deviation_m)
        if not is_ground:
            own.x, own.x_s = 0.0, -math.inf
        elif has_stepped:
            self._move(own, 0.5 * (x + own.x) * deviation_m)
            own.x, own.x_s = 0.0, -math.inf
        else:
            self._learn(own, x, e, limit, deviation_m, time_s)

    def _correlation(self) -> float:
        phi = self._product / self._square
        if phi < self._model_correlation:
            return self._model_correlation
        return phi if phi < MOST_CORRELATION else MOST_CORRELATION

    def _move(self, own: _Sensor, by_m: float) -> None:
        own.offset_m += by_m
        self._offsets_m += by_m

    def _learn(self, own: _Sensor, x: float, e: float, limit: float, deviation_m: float, time_s: float) -> None:
        """Offset, scatter and correlation, by a reading of the ground."""
        own.readings += 1
        change_m = x * deviation_m / (own.readings if own.readings < OFFSET_READINGS else OFFSET_READINGS)
        before, before_s = own.x, own.x_s
        own.x = x
        if abs(e) > limit:
            own.x_s = -math.inf
            change_m *= limit / abs(e)
        else:
            own.x_s = time_s
            change = (e * e - own.scale) / (own.readings if own.readings < SCALE_READINGS else SCALE_READINGS)
            own.scale += change
            if not own.wider.is_found:
                self._scales += change
            if before_s > time_s - self._successive_s:
                self._product += (x * before - self._product) * CORRELATION_SHARE
            self._square += (x * x - self._square) * CORRELATION_SHARE
        self._move(own, change_m)
        count = len(own.others)
        if count >= LEVEL_SENSORS:
            level_m = (self._offsets_m - own.offset_m) / count
            variance_m2 = sum([each.offset_m * each.offset_m for each in own.others]) / count - level_m * level_m
            own.rough_m2 += (variance_m2 - own.rough_m2) / min(own.readings, ROUGH_READINGS)

    def _echo(self, own: _Sensor, sighting: Sighting, range_m: float) -> None:
        """An echo from ground in range, or none."""
        if sighting.seen is not GroundUse.MISSED:
            own.missed.nones += 1
        elif self._faces(own, sighting.down) and own.missed.happens(
            missed_share(own.expected, range_m), [each.missed for each in own.others]
        ):
            self._report(own, "missed", own.missed.evidence)

    def _repeat(self, own: _Sensor, sighting: Sighting, moved_m: float) -> None:
        """The same answer where the height has changed, or another one."""
        if moved_m < FOLLOWS_M or moved_m < FOLLOWS * sighting.std_m or sighting.seen is GroundUse.MISSED:
            return
        if sighting.raw is None or sighting.raw != own.raw:
            own.repeats.nones += 1
        elif own.repeats.happens(REPEATS, [each.repeats for each in own.others]):
            self._report(own, "repeats", own.repeats.evidence)

    def _confirm_short(self, own: _Sensor) -> None:
        """The short reading before was one: the reading after it does not agree."""
        if own.has_pending:
            own.has_pending = False
            if own.short.happens(own.short_probability, [each.short for each in own.others]):
                self._report(own, "short", own.short.evidence)

    def _shift(self, own: _Sensor, sighting: Sighting, climb_m_s: float, off_m: float, deviation_m: float) -> None:
        """A difference from others that agree on level ground, while the vehicle moves."""
        if sighting.down is None or (sighting.down[2] > TILTS_COS and abs(climb_m_s) < MOVES_M_S):
            return
        offsets_m = [each.offset_m for each in own.others if not each.shifted.is_found]
        if len(offsets_m) < LEVEL_SENSORS or max(offsets_m) - min(offsets_m) > LEVEL_M:
            return
        off_m -= sum(offsets_m) / len(offsets_m)
        if abs(off_m) < MOST_SHIFT_M:
            tolerated_m = SHIFT_M + ROUGH * math.sqrt(max(own.rough_m2, 0.0))
            ratio = math.exp(min(2.0 * (abs(off_m) - tolerated_m) / deviation_m - 2.0, SHIFT_LOG))
            if own.shifted.update(ratio, 1.0, off_m):
                self._report(own, "shifted", own.shifted)

    def _settle(self, own: _Sensor) -> None:
        """What has not happened to a sensor with a finding may end it."""
        rare: tuple[tuple[Kind, Occurrences], ...]
        rare = (("short", own.short), ("missed", own.missed), ("repeats", own.repeats))
        for kind, each in rare:
            if each.evidence.is_found and each.settle():
                self._report(own, kind, each.evidence)

    def _report(self, own: _Sensor, kind: Kind, evidence: Evidence) -> None:
        """Begin or end a finding."""
        sign = -1
        if evidence.is_found:
            finding = SensorFinding(own.name, kind, math.sqrt(evidence.ratio) if kind == "wider" else evidence.ratio)
            own.findings[kind] = finding
            self.findings.append(finding)
        else:
            sign = 1
            self.findings.remove(own.findings.pop(kind))
        if kind == "wider":
            self._in_order += sign
            self._scales += sign * own.scale

    @staticmethod
    def _faces(own: _Sensor, down: Vector | None) -> bool:
        if down is None:
            return own.faces_level
        x, y, z = own.expected.boresight
        return down[0] * x + down[1] * y + down[2] * z > own.expected.facing_cosine
