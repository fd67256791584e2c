"""Each downward sensor in flight against its own reading model: which one has begun to read otherwise?

It is updated with every reading and the height that it alone gives, and keeps findings, such as 'front_left: often too
short'. A reading is compared, a turn later, with the height by the other sensors (`msp_range.health.neighbours`):

    x = (h - h_others - b) / sqrt(sigma^2 + var(h_others)),   e = (x - phi x_before) / sqrt(1 - phi^2)

b is the sensor's own slow offset (mounting, slope and tufts below it) and phi the correlation of successive errors, the
larger of the model's and the one that all sensors show. Each alternative to the model has a likelihood ratio L:

    short      e < -4, and neither the reading before nor the one after agrees: then it is no object
               L = 6^k / (1 + 5 p), k = 1 for a short reading and 0 for another; odds six times the model's
    missed     no echo where the others see ground nearer than 80 % of the maximum, and the sensor looks straight down
               but for 3 deg less than the half angle of its beam; L of the same form
    wider      L = exp(e^2/s (1/c - 1/3) / 2) sqrt(c/3), at most for e^2/s of 15: the variance is 3 times, not c times;
               a reading with which a step of the ground began is taken back
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
from statistics import fmean

from msp_range.geometry import Vector, dot
from msp_range.health.evidence import Evidence, Occurrences
from msp_range.health.expected import Expected
from msp_range.health.finding import Kind, SensorFinding
from msp_range.health.neighbours import GroundUse, Sighting, reference

FALSE_ALARM_H = 2000.0
"""Mean flying time between two false findings of a vehicle, at least [h], where all holds that the bound assumes. At
1,000 there were three in 1,000 drawn hours, of which one is left. Ten times as much finds a sensor with 10 % short
readings 8 s later."""
WEIGHTS: dict[Kind, float] = {"short": 0.35, "missed": 0.2, "wider": 0.35, "shifted": 0.05, "repeats": 0.05}
"""Share of the false alarms that each alternative may have; half of it costs 3 s of 60 s."""
ODDS: dict[Kind, float] = {"short": 6.0, "missed": 6.0, "repeats": 12.0}
"""Odds of the alternatives over the model's: fewer find a small change sooner and a large one later."""
OFF = 4.0
"""A reading this many deviations nearer than the others is short."""
AGREE_M = 0.12
"""Two successive readings of a sensor this close see the same thing, which is an object [m]."""
WIDER, TOLERATED = 3.0, 1.15
"""Variance over the model's: of the alternative, and what counts as in order. Doubled deviation gives 3.4 with the
error of the reference. With 1.2 a doubled deviation is found after more than 30 s; with 1.1, and the next constant at
13, five of 900 flights over rough grass report a good sensor, with 1.15 one."""
MOST_SQUARE = 15.0
"""A reading counts for a wider distribution by no more than this square: what is farther off is another kind. At 13 a
doubled deviation is found half a second later; larger lets random readings look like scatter."""
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
LEVEL: Vector = (0.0, 0.0, 1.0)
"""Straight down where the attitude is not known."""
MOST_NEIGHBOURS = 3
"""Readings before and after one among which its reference is looked for: a turn of four sensors."""


class _Sensor:
    """One sensor: what its model says, and what was seen of it."""

    # Slow means of its readings: how many there were, offset from the others [m], mean square of e, and of the others'
    # offsets the variance [m^2].
    readings, offset_m, scale, rough_m2 = 0, 0.0, 1.0, 0.0
    # The reading before: normalised difference and its time, difference [m], answer and its time, and the height by the
    # others [m], or of a single sensor its own.
    x, x_s = 0.0, -math.inf
    seen_m: float | None = None
    raw: float | None = None
    time_s = -math.inf
    height_m: float | None = None
    # The probability that it was short, where it was and waits for the next one.
    short_probability: float | None = None

    def __init__(self, name: str, expected: Expected, readings: float, findings: list[SensorFinding]) -> None:
        self.name, self.expected, self._findings = name, expected, findings
        self.others: list[_Sensor] = []
        self.rare = {kind: Occurrences(readings / WEIGHTS[kind], odds) for kind, odds in ODDS.items()}
        self.wider, self.shifted = Evidence(readings / WEIGHTS["wider"]), Evidence(readings / WEIGHTS["shifted"])

    def learn(self, change_m: float, e: float, limit: float) -> None:
        """Offset and scatter, by a reading of the ground."""
        self.readings += 1
        change_m /= min(self.readings, OFFSET_READINGS)
        if abs(e) > limit:
            change_m *= limit / abs(e)
        else:
            self.scale += (e * e - self.scale) / min(self.readings, SCALE_READINGS)
        self.offset_m += change_m
        offsets_m = [other.offset_m for other in self.others]
        if len(offsets_m) >= LEVEL_SENSORS:
            variance_m2 = fmean([offset_m**2 for offset_m in offsets_m]) - fmean(offsets_m) ** 2
            self.rough_m2 += (variance_m2 - self.rough_m2) / min(self.readings, ROUGH_READINGS)

    def happens(self, kind: Kind, probability: float) -> None:
        """Something rare happens, which has this probability by the model."""
        if self.rare[kind].happens(probability, [other.rare[kind] for other in self.others]):
            self.report(kind, self.rare[kind])

    def confirm_short(self) -> None:
        """The short reading before was one: the reading after it does not agree."""
        if self.short_probability is not None:
            self.happens("short", self.short_probability)
            self.short_probability = None

    def shift(self, sighting: Sighting, climb_m_s: float, off_m: float, deviation_m: float) -> None:
        """A difference from others that agree on level ground, while the vehicle moves."""
        if sighting.down is None or (sighting.down[2] > TILTS_COS and abs(climb_m_s) < MOVES_M_S):
            return
        offsets_m = [other.offset_m for other in self.others if not other.shifted.is_found]
        if len(offsets_m) < LEVEL_SENSORS or max(offsets_m) - min(offsets_m) > LEVEL_M:
            return
        off_m -= fmean(offsets_m)
        if abs(off_m) < MOST_SHIFT_M:
            tolerated_m = SHIFT_M + ROUGH * math.sqrt(max(self.rough_m2, 0.0))
            ratio = math.exp(min(2.0 * (abs(off_m) - tolerated_m) / deviation_m - 2.0, SHIFT_LOG))
            if self.shifted.update(ratio, 1.0, off_m):
                self.report("shifted", self.shifted)

    def report(self, kind: Kind, evidence: Evidence) -> None:
        """Begin or end a finding."""
        if evidence.is_found:
            size = math.sqrt(evidence.ratio) if kind == "wider" else evidence.ratio
            self._findings.append(SensorFinding(self.name, kind, size))
        else:
            self._findings[:] = [
                finding for finding in self._findings if (finding.sensor, finding.kind) != (self.name, kind)
            ]


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
    is_single
        Whether there is one sensor only, which is asked for codes and repeats and nothing else.
    findings
        What is found now, the oldest first.
    """

    def __init__(self, sensors: Mapping[str, Expected], turn_s: float) -> None:
        count = len(sensors)
        self.is_single = count == 1
        readings = FALSE_ALARM_H * 3600.0 * count / turn_s
        self.findings: list[SensorFinding] = []
        self._sensors = {name: _Sensor(name, each, readings, self.findings) for name, each in sensors.items()}
        for sensor in self._sensors.values():
            sensor.others = [each for each in self._sensors.values() if each is not sensor]
        self._successive_s = TURNS_APART * turn_s
        self._middle = min(count - 1, MOST_NEIGHBOURS)
        self._window: list[Sighting] = []
        self._model_correlation = max([each.correlation for each in sensors.values()], default=0.0)
        self._product, self._square = 0.0, 1.0

    def update(self, sighting: Sighting) -> None:
        """Update with a reading, in the order of their times."""
        own, seen, height_m = self._sensors[sighting.sensor], sighting.seen, sighting.height_m
        if height_m is None and seen is not GroundUse.MISSED:
            seen = GroundUse.NOTHING
        common_m = height_m - own.offset_m if height_m is not None and seen is GroundUse.GROUND else None
        sighting = sighting._replace(seen=seen, std_m=own.expected.spread * sighting.std_m, common_m=common_m)
        if self.is_single:
            # Repeats count while the barometer shows a climb.
            moved_m = max(abs(sighting.climb_m_s) - BAROMETER_M_S, 0.0) * (sighting.time_s - own.time_s)
            self._count(own, sighting, own.height_m, moved_m, height_m)
            return
        window = self._window
        window.append(sighting)
        if len(window) > 2 * self._middle:
            sighting = window[self._middle]
            if sighting.seen is not GroundUse.NOTHING:
                self._compare(self._sensors[sighting.sensor], sighting)
            del window[0]

    def _count(
        self, own: _Sensor, sighting: Sighting, range_m: float | None, moved_m: float, height_m: float | None
    ) -> None:
        """What a single sensor is asked for, too: an echo from ground in range, and an answer that follows the height.

        ``moved_m``: by how much that has changed since its reading before, to ``height_m``.
        """
        seen, expected = sighting.seen, own.expected
        if range_m is not None and NEAREST_M < range_m < FARTHEST * expected.maximum_m:
            if seen is not GroundUse.MISSED:
                own.rare["missed"].nones += 1
            elif dot(sighting.down or LEVEL, expected.boresight) > expected.facing_cosine:
                own.happens("missed", expected.missed_at(range_m))
        if (
            sighting.time_s - own.time_s < self._successive_s
            and moved_m >= max(FOLLOWS_M, FOLLOWS * sighting.std_m)
            and seen is not GroundUse.MISSED
        ):
            if sighting.raw is None or sighting.raw != own.raw:
                own.rare["repeats"].nones += 1
            else:
                own.happens("repeats", REPEATS)
        own.time_s, own.height_m, own.raw = sighting.time_s, height_m, sighting.raw
        # What has not happened to a sensor with a finding may end it.
        for kind, each in own.rare.items():
            if each.is_found and each.settle():
                own.report(kind, each)

    def _compare(self, own: _Sensor, sighting: Sighting) -> None:
        """A reading with the others' around it."""
        scales = [other.scale for other in own.others if not other.wider.is_found]
        scale = max(fmean(scales or [1.0]), 1.0)
        others = reference(self._window, self._middle, scale)
        if others is None or not others.height_m > NEAREST_M:
            return
        time_s, std_m, seen, height_m = sighting.time_s, sighting.std_m, sighting.seen, sighting.height_m
        expected, others_m = own.expected, others.height_m
        moved_m = 0.0 if own.height_m is None else abs(others_m - own.height_m)
        self._count(own, sighting, others_m, moved_m, others_m)
        if seen is GroundUse.REPEATED:
            return
        before, is_successive = own.x, own.x_s > time_s - self._successive_s
        own.x, own.x_s = 0.0, -math.inf
        if height_m is None or seen is GroundUse.MISSED:
            own.confirm_short()
            own.seen_m = None
            return
        off_m = height_m - others_m
        variance_m2 = std_m * std_m + others.variance_m2
        deviation_m = math.sqrt(variance_m2)
        x = (off_m - own.offset_m) / deviation_m
        e = x
        if is_successive:
            phi = max(min(self._product / self._square, MOST_CORRELATION), self._model_correlation, 0.0)
            e = (x - phi * before) / math.sqrt(1.0 - phi * phi)
        limit = OFF * math.sqrt(scale)
        agrees = own.seen_m is not None and abs(off_m - own.seen_m) < AGREE_M
        if agrees:
            own.short_probability = None
        own.confirm_short()
        own.seen_m = off_m
        is_ground = seen is GroundUse.GROUND
        # Two large differences in a row that are alike: a stone or an edge below the sensor.
        step = STEP * limit
        has_stepped = before * x > step * step and abs(before - x) < step
        if own.readings > WARM_UP:
            if e >= -limit:
                own.rare["short"].nones += 1
            elif not agrees:
                span = max(others_m - expected.minimum_m, 0.0) / (expected.maximum_m - expected.minimum_m)
                own.short_probability = expected.short + expected.random * span
            if has_stepped:
                own.wider.retract()
            elif is_ground:
                square = e * e / scale
                ratio = math.exp(min(square, MOST_SQUARE) * WIDER_SLOPE) * WIDER_NORM
                # The rest of the variance is the reference's.
                own_share = std_m * std_m / variance_m2
                if own.wider.update(ratio, own_share, square - 1.0 + own_share):
                    own.report("wider", own.wider)
            if abs(own.offset_m - fmean([sensor.offset_m for sensor in self._sensors.values()])) > SHIFT_ASKED_M:
                own.shift(sighting, others.climb_m_s, off_m, deviation_m)
        if is_ground and has_stepped:
            own.offset_m += 0.5 * (x + before) * deviation_m
        elif is_ground:
            if abs(e) <= limit:
                own.x_s = time_s
                if is_successive:
                    self._product += (x * before - self._product) * CORRELATION_SHARE
                self._square += (x * x - self._square) * CORRELATION_SHARE
            own.x = x
            own.learn(x * deviation_m, e, limit)
