"""What the autopilot received, compared with the truth.

MAVLink messages as pymavlink parsed them, with the times at which they came, and a `Truth` enter; a `Verdict` leaves.
Nothing of the bridge's own records or objects is looked at. The rules:

Valid
    A DISTANCE_SENSOR that looks down (orientation 25) with min < current <= max and a quality other than 1. It holds
    until the next one of that orientation, and for 0.5 s at most, ArduPilot's time-out.
Above the maximum
    current > max, whatever the quality. It is wrong where every true distance at its receipt is less than the
    maximum by more than the tolerance.
Wrong distance
    The held distance is off by more than the tolerance, or a wrong 'above the maximum', for over 0.5 s without a break.
    A valid one is compared with the truth now. The tolerance is 50 cm.
Hostile families
    The tolerance is max(20 cm, 5 % of the true distance). It is less than what a vehicle that climbs at 2 m/s moves
    between an echo and the next message, so that the truth at the message's own time stamp counts as well as that now.
Honest, covered
    A valid message's error is within 3, or 1.96, stated deviations: the root of the covariance in cm^2. Compared with
    the truth at the message's own time stamp, since a deviation is that of a measurement and not of its age; where the
    stamp is over 0.5 s from the receipt, at the receipt. Covariance 255 is neither, but where the quality is 0 (both
    unknown) the message is left out. Shares are of time: a message counts as long as it holds.
Sure
    A valid message with a quality of 90 or more, which ArduSub takes.
Judged time
    From the silence limit after the start, and after each time the autopilot came back, while it listens. 'In range' is
    the part of it in which the true distance lies where a sensor in this air can measure it.
Silence
    The time between two messages that an autopilot can use (valid, or above the maximum; where they are wrong, they
    count as that), or from the start, or to the end, where that is longer than the limit: max(1 s, twice the longest
    time between two readings of one downward sensor).
Reported
    A silence: from 1 s before its beginning until the limit + 0.5 s after it a STATUSTEXT of severity WARNING or worse
    has come that is not on an object or a hole alone (without 'or fault'), nor on the air's temperature, or the last
    HEARTBEAT before that deadline says CRITICAL. A wrong distance: the same from 1 s before its beginning until 2 s
    after it, texts on temperature included. That the air's temperature lags, 'up to 48 cm off', reports an error of no
    more than that from then on, until a text says that this is over.
False object
    A STATUSTEXT with 'object' or 'hole' while none of the grounds of the last 2 s was 8 cm from another.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from evaluation.faults.truth import Truth, nearest_error_m

TIME_OUT_S = 0.5
"""ArduPilot's AP_RangeFinder takes a MAVLink range finder for gone after this [s]."""
WRONG_M, WRONG_S = 0.5, 0.5
REPORT_AFTER_LIMIT_S = 0.5
REPORT_WRONG_S = 2.0
REPORT_BEFORE_S = 1.0
"""A report may come a little before what it is about: a sensor is found to be bad, and then the others fail [s]."""
LATEST_STAMP_S = 0.5
GRID_S = 0.025
"""Time between two comparisons with the truth [s]; what is shorter is not seen."""
EDGE_GRID_S = 0.1
"""Time between two looks for an edge below [s]: an edge lasts 2 s at least."""
COVARIANCE_UNKNOWN, QUALITY_INVALID = 255, 1
PROBABILITIES = (0.8, 0.9, 0.99, 0.999, 0.9999)
"""Lower limits by which the recorded probability is compared with how often a distance is wrong."""
LEANS_RAD, LEANS = math.radians(5.0), ("below 5 deg", "above 5 deg")
"""From this lean on the coverage has a row of its own."""
QUALITY_SURE = 90
"""ArduSub's RNGFND_SQ_MIN: it drops a distance of less."""

_ON_OBJECTS = re.compile(r"^(?!.*\bfault\b).*\b(object|hole|ground below)\b", re.IGNORECASE)
_IS_OBJECT = re.compile(r"\b(object|hole)\b")
_ON_AIR = re.compile(r"\b(air temp|temperature|thermometer)", re.IGNORECASE)
_LAGS_CM = re.compile(r"air temp lags, up to (\d+) cm off")


class Distance(NamedTuple):
    """A DISTANCE_SENSOR that looks down: time of receipt and of its stamp [s of the flight], and its fields in metres.

    ``std_m`` is None where the covariance is unknown.
    """

    time_s: float
    stamp_s: float
    current_m: float
    minimum_m: float
    maximum_m: float
    std_m: float | None
    quality: int

    @property
    def is_valid(self) -> bool:
        """Whether an autopilot takes it for a distance."""
        return self.minimum_m < self.current_m <= self.maximum_m and self.quality != QUALITY_INVALID

    @property
    def is_above(self) -> bool:
        """Whether it reports that nothing is within the maximum."""
        return self.current_m > self.maximum_m

    @property
    def is_usable(self) -> bool:
        """Whether an autopilot takes anything from it."""
        return self.is_valid or self.is_above


class Event(NamedTuple):
    """A wrong distance or a silence: when it began and how long it lasted [s], the largest error [m], who reported it.

    ``reported`` is 'text', 'critical' or None.
    """

    from_s: float
    for_s: float
    worst_m: float
    reported: str | None


@dataclass
class Verdict:
    """What became of one flight; times in seconds."""

    flown_s: float
    judged_s: float = 0.0
    in_range_s: float = 0.0
    """Of the flight; judged; judged with the truth within the sensors' range."""
    valid_s: float = 0.0
    honest_s: float = 0.0
    covered_s: float = 0.0
    """With a valid message; within 3 stated deviations; within 1.96."""
    sure_s: float = 0.0
    sure_honest_s: float = 0.0
    """Of valid_s and honest_s the part with a sure message."""
    honest_in_range_s: float = 0.0
    """Within 3 stated deviations while the truth is within the sensors' range."""
    faulty_s: float = 0.0
    faulty_in_range_s: float = 0.0
    faulty_honest_s: float = 0.0
    """Of judged_s, in_range_s and honest_in_range_s the part in which a sensor's fault lasts."""
    covered_by: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Of covered_s and valid_s the parts by lean and motion, such as 'below 5 deg, hover'."""
    wrong: list[Event] = field(default_factory=list)
    silences: list[Event] = field(default_factory=list)
    """Events."""
    longest_gap_s: float = 0.0
    """Between two messages that an autopilot can use, whether longer than the limit or not."""
    above_wrong: int = 0
    above_wrong_s: float = 0.0
    """Wrong messages 'above the maximum', and how long they held."""
    false_objects: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    """Texts."""
    edges: list[tuple[float, float]] = field(default_factory=list)
    """Beginning and longest silence of each edge."""
    messages: int = 0
    """DISTANCE_SENSOR that look down."""


class Received:
    """What came from the bridge.

    Parameters
    ----------
    messages
        (time of the flight [s], message) in order.
    boots_s
        When the autopilot's clock was at zero [s of the flight], in order; the first is before the flight.
    """

    def __init__(self, messages: Sequence[tuple[float, Any]], boots_s: Sequence[float]) -> None:
        self.distances: list[Distance] = []
        self.texts: list[tuple[float, int, str]] = []
        self._states: list[tuple[float, int]] = []
        for time_s, message in messages:
            kind = message.get_type()
            if kind == "DISTANCE_SENSOR" and message.orientation == mavlink.MAV_SENSOR_ROTATION_PITCH_270:
                boot_s = max(each for each in boots_s if each <= time_s)
                self.distances.append(_distance(time_s, boot_s, message))
            elif kind == "STATUSTEXT":
                self.texts.append((time_s, message.severity, message.text))
            elif kind == "HEARTBEAT":
                self._states.append((time_s, message.system_status))

    def report(
        self, from_s: float, to_s: float, *, air_counts: bool, faulty_from_s: Mapping[str, float] | None = None
    ) -> str | None:
        """How something was reported between two times: 'text', 'critical' or None.

        ``faulty_from_s`` has the names of the sensors, each with the time from which it is faulty [s]; with it a text
        about sensors that are healthy at its time does not count.
        """
        for time_s, severity, text in self.texts:
            about_another = _ON_OBJECTS.search(text) or (_ON_AIR.search(text) and not air_counts)
            named = [name for name in faulty_from_s or () if re.search(rf"\b{name}\b", text)]
            if faulty_from_s and named and all(faulty_from_s[name] > time_s for name in named):
                continue
            if from_s <= time_s <= to_s and severity <= mavlink.MAV_SEVERITY_WARNING and not about_another:
                return "text"
        before = [state for time_s, state in self._states if time_s <= to_s]
        return "critical" if before and before[-1] == mavlink.MAV_STATE_CRITICAL else None

    def stated_off_m(self, time_s: float) -> float:
        """How far off a distance may be by the last text on the air's temperature until a time [m]."""
        on_air = [text for text_s, _, text in self.texts if text_s <= time_s and _ON_AIR.search(text)]
        stated = _LAGS_CM.search(on_air[-1]) if on_air else None
        return 0.0 if stated is None else int(stated[1]) / 100


def _distance(time_s: float, boot_s: float, message: Any) -> Distance:
    stamp_s = max(message.time_boot_ms / 1e3 + boot_s, 0.0)
    if abs(stamp_s - time_s) > LATEST_STAMP_S:
        stamp_s = time_s
    std_m = None if message.covariance == COVARIANCE_UNKNOWN else math.sqrt(message.covariance) / 100
    return Distance(
        time_s,
        stamp_s,
        message.current_distance / 100,
        message.min_distance / 100,
        message.max_distance / 100,
        std_m,
        message.signal_quality,
    )


@dataclass(frozen=True)
class Conditions:
    """What a flight is judged by, besides its messages."""

    duration_s: float
    """Of the flight [s]."""
    limit_s: float
    """Longest silence [s]."""
    nearest_m: float
    farthest_m: float
    """True distances that the sensors can measure in this air [m]."""
    listens_s: Sequence[tuple[float, float]]
    faulty_s: Sequence[tuple[float, float]] = ()
    """From when to when the autopilot listened, and when sensors are faulty [s]."""
    faulty_from_s: Mapping[str, float] | None = None
    """By sensor, the time from which it is faulty [s], infinite for a healthy one; None: unknown."""
    wrong_m: float = WRONG_M
    wrong_share: float = 0.0
    """The tolerance: so far off [m], or by this share of the true distance, whichever is more."""
    stamp_counts: bool = False
    """Whether a distance that was right at its own time stamp is right as long as it holds."""

    def tolerance_m(self, true_m: float) -> float:
        """How far off a distance may be [m]."""
        return max(self.wrong_m, self.wrong_share * true_m)


def judge(received: Received, truth: Truth, conditions: Conditions) -> Verdict:
    """Compare what was received with the truth."""
    verdict = Verdict(conditions.duration_s, messages=len(received.distances))
    distances = received.distances
    errors_m = [
        nearest_error_m(each.current_m, truth.distances_m(each.stamp_s)) if each.is_valid else None
        for each in distances
    ]
    above_wrong = [_is_above_wrong(each, truth, conditions) for each in distances]
    verdict.above_wrong = sum(above_wrong)
    off: list[tuple[float, float]] = []
    index = -1
    for i in range(round(conditions.duration_s / GRID_S)):
        time_s = i * GRID_S
        while index + 1 < len(distances) and distances[index + 1].time_s <= time_s:
            index += 1
        held = distances[index] if index >= 0 and time_s - distances[index].time_s < TIME_OUT_S else None
        trues_m = truth.distances_m(time_s)
        if held is not None and held.is_valid:
            off_m, stamp_off_m = nearest_error_m(held.current_m, trues_m), errors_m[index]
            if conditions.stamp_counts and stamp_off_m is not None:
                off_m = min(off_m, stamp_off_m, key=abs)
            if abs(off_m) > conditions.tolerance_m(held.current_m - off_m):
                off.append((time_s, off_m))
        if held is not None and above_wrong[index]:
            verdict.above_wrong_s += GRID_S
            off.append((time_s, held.maximum_m - max(trues_m)))
        if not any(start_s + conditions.limit_s <= time_s < end_s for start_s, end_s in conditions.listens_s):
            continue
        error_m = errors_m[index] if held is not None else None
        in_range = conditions.nearest_m <= trues_m[0] <= conditions.farthest_m
        faulty = any(start_s <= time_s < end_s for start_s, end_s in conditions.faulty_s)
        _count(verdict, held, error_m, in_range, faulty)
        if held is not None and _counts(held, error_m):
            lean_rad, motion = truth.motion(time_s)
            key = f"{LEANS[lean_rad >= LEANS_RAD]}, {motion}"
            covered_s, valid_s = verdict.covered_by.get(key, (0.0, 0.0))
            covered_s += GRID_S * (held.std_m is not None and abs(error_m or 0.0) <= 1.96 * held.std_m)
            verdict.covered_by[key] = (covered_s, valid_s + GRID_S)
    verdict.wrong = _wrong(off, received, conditions)
    usable_s = [each.time_s for each in distances if each.is_usable]
    for start_s, end_s in conditions.listens_s:
        _silences(verdict, [each for each in usable_s if start_s <= each < end_s], start_s, end_s, received, conditions)
    warnings = [
        (f"{time_s:.1f} s: {text}", _IS_OBJECT.search(text), truth.is_uneven(time_s))
        for time_s, severity, text in received.texts
        if severity <= mavlink.MAV_SEVERITY_WARNING
    ]
    verdict.false_objects = [text for text, is_object, is_uneven in warnings if is_object and not is_uneven]
    verdict.warnings = [text for text, is_object, is_uneven in warnings if not (is_object and is_uneven)]
    verdict.edges = _edges(usable_s, truth, conditions)
    return verdict


def _is_above_wrong(distance: Distance, truth: Truth, conditions: Conditions) -> bool:
    """Whether a message is 'above the maximum' while the ground is nearer."""
    if not distance.is_above:
        return False
    trues_m = truth.distances_m(distance.time_s)
    if conditions.stamp_counts:
        trues_m = [*trues_m, *truth.distances_m(distance.stamp_s)]
    true_m = max(trues_m)
    return true_m < distance.maximum_m - conditions.tolerance_m(true_m)


def _edges(usable_s: Sequence[float], truth: Truth, conditions: Conditions) -> list[tuple[float, float]]:
    """Beginning of each edge and its longest silence [s]."""
    edges: list[tuple[float, float]] = []
    began_s = None
    for i in range(math.ceil(conditions.duration_s / EDGE_GRID_S) + 1):
        time_s = i * EDGE_GRID_S
        if truth.is_uneven(time_s) and time_s < conditions.duration_s:
            began_s = time_s if began_s is None else began_s
        elif began_s is not None:
            gaps = zip([0.0, *usable_s], [*usable_s, conditions.duration_s], strict=True)
            longest_s = max(to_s - from_s for from_s, to_s in gaps if to_s > began_s and from_s < time_s)
            edges.append((round(began_s, 3), round(longest_s, 3)))
            began_s = None
    return edges


def _counts(held: Distance, error_m: float | None) -> bool:
    """Whether a held message states a distance and how sure it is."""
    return error_m is not None and not (held.std_m is None and held.quality == 0)


def _count(verdict: Verdict, held: Distance | None, error_m: float | None, in_range: bool, faulty: bool) -> None:
    """Add one moment of the judged time; ``error_m`` is that of the held distance at its own time."""
    verdict.judged_s += GRID_S
    verdict.in_range_s += GRID_S * in_range
    verdict.faulty_s += GRID_S * faulty
    verdict.faulty_in_range_s += GRID_S * (faulty and in_range)
    if held is None or error_m is None or not _counts(held, error_m):
        return
    sure_s = GRID_S * (held.quality >= QUALITY_SURE)
    verdict.valid_s += GRID_S
    verdict.sure_s += sure_s
    if held.std_m is not None and abs(error_m) <= 3.0 * held.std_m:
        verdict.honest_s += GRID_S
        verdict.sure_honest_s += sure_s
        verdict.honest_in_range_s += GRID_S * in_range
        verdict.faulty_honest_s += GRID_S * (faulty and in_range)
        verdict.covered_s += GRID_S * (abs(error_m) <= 1.96 * held.std_m)


def _wrong(off: Sequence[tuple[float, float]], received: Received, conditions: Conditions) -> list[Event]:
    events = []
    if off:
        times_s, errors_m = np.array(off).T
        breaks = np.flatnonzero(np.diff(times_s) > 1.5 * GRID_S) + 1
        for some_s, some_m in zip(np.split(times_s, breaks), np.split(errors_m, breaks), strict=True):
            from_s, for_s = float(some_s[0]), float(some_s[-1] - some_s[0]) + GRID_S
            if for_s > WRONG_S + GRID_S / 2:
                report = received.report(
                    from_s - REPORT_BEFORE_S,
                    from_s + REPORT_WRONG_S,
                    air_counts=True,
                    faulty_from_s=conditions.faulty_from_s,
                )
                worst_m = float(some_m[np.argmax(np.abs(some_m))])
                if report is None and abs(worst_m) <= received.stated_off_m(from_s):
                    report = "text"
                events.append(Event(round(from_s, 3), round(for_s, 3), round(worst_m, 2), report))
    return events


def _silences(
    verdict: Verdict,
    usable_s: Sequence[float],
    start_s: float,
    end_s: float,
    received: Received,
    conditions: Conditions,
) -> None:
    limit_s = conditions.limit_s
    for from_s, to_s in zip([start_s, *usable_s], [*usable_s, end_s], strict=True):
        verdict.longest_gap_s = max(verdict.longest_gap_s, round(to_s - from_s, 3))
        deadline_s = from_s + limit_s + REPORT_AFTER_LIMIT_S
        if to_s - from_s > limit_s:
            report = received.report(from_s - REPORT_BEFORE_S, deadline_s, air_counts=False)
            if report is None and deadline_s > end_s:
                continue  # There was no time left to report it.
            verdict.silences.append(Event(round(from_s, 3), round(to_s - from_s, 3), 0.0, report))
