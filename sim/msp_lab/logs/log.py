"""A flight log, whatever program wrote it: range finders, what is known of the flight, and possible references.

Each format has a file of its own that makes a `VehicleLog`; everything after that is the same for all of them. Units
are those of the names, times are seconds on the log's own clock.
"""

import re
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any, Self

import numpy as np

from msp_lab.readings.clock_runs import ClockRun, Stamps, continuous
from msp_lab.readings.column_map import ColumnMap
from msp_range.arrays import Array, Column, Flags, angle_deg
from msp_range.mavlink.orientation import DOWN

LONGEST_GAP_S = 1.0
"""Values are interpolated between samples that are no farther apart than this, or than three times the usual interval
of the series [s]. Longer: a value is made up where the log was silent; shorter: series of 1 Hz have holes."""
PAUSE_INTERVALS = 10.0
"""Samples that are so many mean intervals apart have a pause between them, which is no time that they cover. Fewer: a
link that stutters has a higher rate than its sensor; more: short pauses count as slow samples."""

RTK_FIXED = 6
"""Kind of a satellite fix, in MAVLink, ArduPilot and PX4 alike: RTK, to centimetres; a float solution (5) is off by
decimetres."""
LARGEST_VALUE = 1e9
"""A value this large, in any unit of a log, is a damaged one: as a height, a million kilometres. The
square of much more is not a number."""
TILT, CLIMB, THROTTLE = "tilt_deg", "climb_m_s", "throttle"
LARGEST_IN_QUATERNION = 1.01
"""A quaternion's number that is larger is a damaged one: they are at most 1, but for rounding. Larger makes a tilt of
180 deg of damage."""
CONTEXT = {
    TILT: "angle between the vehicle's down axis and straight down [deg]",
    CLIMB: "vertical speed, up is positive [m/s]",
    THROTTLE: "throttle, 0 to 1",
    "air_temperature_c": "air temperature, by a thermometer in the air [deg C]",
    "humidity_pct": "relative humidity [%]",
    "board_temperature_c": "temperature of the autopilot's barometer, which its electronics warm [deg C]",
    "vibration_m_s2": "vibration of the accelerometer, as the autopilot measures it [m/s^2]",
}
"""What a log may know of the time of a reading."""


def ignored(share: float) -> None:
    """Progress that nobody is shown."""


@dataclass(frozen=True)
class LogRequest:
    """What is asked of the reader of a format."""

    progress: Callable[[float], None] = ignored
    """Called with the share of the file that is read."""
    field: str = ""
    """The field that is to be read as a reference, as ``--truth column:`` names it; empty: none."""
    column_map: ColumnMap | None = None
    """Columns of a CSV file."""
    maximum_cm: float = np.inf
    """Reading of no echo, for recordings and CSV files; the other formats state it."""


@dataclass(frozen=True)
class LogFormat:
    """A kind of log, as `msp_lab.logs.opening.FORMATS` and entry points of the group ``msp_lab.logs`` list them."""

    what: str
    """What such a file is, for people: ``PX4 ULog``."""
    ending: str
    """Ending of its files' names, in small letters."""
    reader: str
    """``module:function`` of the function that makes a `VehicleLog` of a path and a `LogRequest`, imported when needed;
    it raises RecordingError for a file that it cannot read, or OSError where it cannot be opened."""
    begins: bytes = b""
    """First bytes of its files; empty: they are known by their ending alone."""
    is_flight: bool = True
    """Whether its readings can only be compared once ``msp-lab import`` has joined them with the flight."""


@dataclass(frozen=True)
class Series:
    """A quantity over time."""

    source: str
    """Where the log has it, such as ``RFND.Dist`` or ``/mocap/pose``."""
    time_s: Array
    values: Array
    """In the order of time, of equal length; the unit is that of the name under which it is kept."""

    def __len__(self) -> int:
        return self.time_s.size

    @property
    def rate_hz(self) -> float:
        """Samples per second of the time that they cover; NaN for fewer than two.

        Pauses are left out: `PAUSE_INTERVALS` mean intervals and longer. Of samples that arrive several at once, as
        over a radio link, the median interval says nothing.

        Examples
        --------
        >>> in_bursts_s = np.repeat(np.arange(10.0), 3) + np.tile([0.0, 0.002, 0.004], 10)
        >>> time_s = np.concatenate([in_bursts_s, in_bursts_s + 1000.0])
        >>> round(Series("", time_s, time_s).rate_hz, 1)
        3.2
        """
        gaps_s = np.diff(self.time_s)
        gaps_s = gaps_s[gaps_s < PAUSE_INTERVALS * gaps_s.mean()] if gaps_s.size else gaps_s
        return float(1.0 / gaps_s.mean()) if gaps_s.any() else float("nan")

    def during(self, begins_s: float, ends_s: float, later_s: float) -> "Series":
        """The samples between two times, moved ``later_s`` back in time [s]."""
        first, last = np.searchsorted(self.time_s, (begins_s, ends_s))
        return Series(self.source, self.time_s[first:last] - later_s, self.values[first:last])

    def known(self) -> "Series":
        """Without the samples that are not a number, or none that a vehicle measures."""
        good = np.abs(self.values) < LARGEST_VALUE
        return self if good.all() else Series(self.source, self.time_s[good], self.values[good])

    @property
    def longest_hole_s(self) -> float:
        """Values are interpolated between samples that are no farther apart [s]; NaN for fewer than two."""
        gaps_s = np.diff(self.known().time_s)
        return max(LONGEST_GAP_S, 3.0 * float(np.median(gaps_s))) if gaps_s.size else float("nan")

    def at(self, time_s: Array) -> Array:
        """Values at other times, on straight lines between samples; NaN outside and in gaps.

        Examples
        --------
        >>> height = Series("", np.array([0.0, 1.0, 2.0, 9.0]), np.array([0.0, 2.0, 2.0, 2.0]))
        >>> height.at(np.array([0.5, 5.0, 10.0])).tolist()
        [1.0, nan, nan]
        """
        series = self.known()
        if len(series) < 2:
            return np.full(time_s.shape, np.nan)
        return between_samples(time_s, series.time_s, series.values, series.longest_hole_s)


@dataclass(frozen=True)
class _OfSeries:
    """Base of what has series."""

    def during(self, *span_s: float) -> Self:
        """All of its series from one time to another, as `Series.during`."""
        parts = {name: part.during(*span_s) for name, part in vars(self).items() if isinstance(part, Series)}
        return replace(self, **parts)


@dataclass(frozen=True)
class Ranger(_OfSeries):
    """A range finder's readings."""

    name: str
    """What the log calls it, or what distinguishes it from its other ones."""
    series: Series
    """Readings [cm]; NaN: no answer, or nearer than the minimum that the log states. Readings beyond the maximum that
    the log states are that maximum: no echo."""
    is_down: bool = True
    """Whether it looks down along the vehicle's axis."""
    maximum_cm: float = np.inf
    """Reading of no echo; infinite where the log does not state it."""
    columns: Mapping[str, Column] = field(default_factory=dict)
    """What the log says of each reading, in the names of the CSV form."""
    near: Series | None = None
    """Times of the readings that are nearer than the minimum that the log states."""
    code_cm: float = np.nan
    """Where it does not: the sensor's code of no echo. Other readings may be beyond it, of another sensor."""

    @property
    def too_near(self) -> int:
        """How many readings are nearer than the minimum that the log states."""
        return 0 if self.near is None else len(self.near)

    @property
    def echoes_cm(self) -> Array:
        """Readings that are of something [cm]; NaN: no echo, or no answer."""
        found = self.series.values.copy()
        # Not two arrays of conditions at once: a log may have ten million readings.
        found[~(found < self.maximum_cm)] = np.nan
        found[found == self.code_cm] = np.nan
        return found


@dataclass(frozen=True)
class TruthSource(_OfSeries):
    """A possible true range."""

    kind: str
    """How ``--truth`` calls it."""
    series: Series
    """Height above the ground or a range along the beam [m]."""
    has_datum: bool = False
    """Whether its zero is the ground's height; otherwise a constant is taken off."""
    along_beam: bool = False
    """Whether it is a range along the vehicle's down axis and not a height."""
    std: Series | None = None
    """Standard deviation of its error as the log states it [m]."""
    refused: str = ""
    """Why it is no independent reference; empty: it is one."""
    ranger: str = ""
    """The range finder of the same log whose readings it is; empty: none."""


def truth_source(kind: str, found: Series | None, std: Series | None = None, refused: str = "") -> TruthSource | None:
    """A possible true range with these of its fields; None: the log does not have it."""
    return None if found is None else TruthSource(kind, found, std=std, refused=refused)


@dataclass(frozen=True)
class VehicleLog:
    """What a log holds that matters here."""

    path: Path
    """The file."""
    form: str
    """What wrote it, for people: ``ArduPilot dataflash``."""
    rangers: tuple[Ranger, ...]
    """Its range finders."""
    context: Mapping[str, Series]
    """Names of `CONTEXT` -> series."""
    references: tuple[TruthSource, ...]
    """Possible references, the best ones first."""
    notes: tuple[str, ...] = ()
    """What was lost, or is worth knowing, a sentence each."""
    clock: tuple[ClockRun, ...] = ()
    """The runs between steps of its clock, on whose continuous form its times are; none: it does not step."""

    def runs(self) -> "Iterator[VehicleLog]":
        """The log itself, or what it holds between the steps of its clock, each with the times of the log."""
        ends_s = [run.start_s for run in self.clock[1:]] + [np.inf]
        for number, (run, end_s) in enumerate(zip(self.clock, ends_s, strict=False)):
            span = (run.start_s, end_s, run.later_s)
            yield replace(
                self,
                rangers=tuple(ranger for whole in self.rangers if len((ranger := whole.during(*span)).series)),
                context={name: found for name, whole in self.context.items() if len(found := whole.during(*span))},
                references=tuple(truth for whole in self.references if len((truth := whole.during(*span)).series)),
                notes=(*self.notes[: 0 if number else None], *([run.note] if number else [])),
                clock=(),
            )
        if not self.clock:
            yield self


def make_log(
    path: Path,
    form: str,
    rangers: Iterable[Ranger],
    context: Mapping[str, Series | None],
    references: Iterable[TruthSource | None],
    notes: Iterable[str] = (),
    clock: tuple[ClockRun, ...] = (),
) -> VehicleLog:
    """A log without the series and references that it lacks, which are None or empty."""
    known = {name: found for name, found in context.items() if found is not None and len(found)}
    return VehicleLog(path, form, tuple(rangers), known, tuple(filter(None, references)), tuple(notes), clock)


def between_samples(at_s: Array, time_s: Array, values: Array, longest_s: float) -> Array:
    """Values at other times, on straight lines between samples that are no farther apart; NaN elsewhere."""
    after = np.clip(np.searchsorted(time_s, at_s), 1, time_s.size - 1)
    inside = (at_s >= time_s[0]) & (at_s <= time_s[-1]) & (time_s[after] - time_s[after - 1] <= longest_s)
    return np.where(inside, np.interp(at_s, time_s, values), np.nan)


def series(source: str, time_s: Array, values: Array) -> Series:
    """A series in the order of time; samples of one time count once.

    Examples
    --------
    >>> series("a", np.array([1.0, 0.0, 1.0]), np.array([5.0, 4.0, 6.0])).values.tolist()
    [4.0, 5.0]
    """
    time_s, rows = np.unique(np.asarray(time_s, dtype=float), return_index=True)
    return Series(source, time_s, np.asarray(values, dtype=float)[rows])


@cache
def number_at(path: str) -> Callable[[Any], Any]:
    """What finds the number of a field of `MessageColumns` in a message."""
    way, _, place = path.rpartition(".")
    if not place.isdigit():
        return attrgetter(path)
    array_at = number_at(way)
    return lambda message: array_at(message)[int(place)]


class MessageColumns:
    """Numbers of one sender's messages by field, with the time of each, at once or collected while a log is read.

    A field that is collected is a name, or names and places in arrays on the way to the number: ``pose.covariance.0``.

    Parameters
    ----------
    source
        Name of the sender.
    values
        Field -> numbers, (n,).
    time_s
        When the messages were stamped, (n,) [s].
    place
        Where in the log they are, as in `Stamps`, (n,).
    other_s
        Their times by another clock, (n,) [s].
    before_s
        How long before its stamp each was measured, (n,) [s].
    """

    def __init__(
        self,
        source: str,
        values: Mapping[str, Any],
        time_s: Column | None = None,
        place: Column | None = None,
        other_s: Column | None = None,
        before_s: Column | float = 0.0,
    ) -> None:
        self.source = source
        self.values = dict(values)
        self.before_s = before_s
        self._time_s: Any = array("d") if time_s is None else time_s
        self._place: Any = array("q") if place is None else place
        self._other_s: Any = array("d") if other_s is None else other_s

    @classmethod
    def collecting(cls, source: str, fields: Iterable[str]) -> "MessageColumns":
        """Columns of these fields, for messages that are added one after the other."""
        return cls(source, {field: array("d") for field in fields})

    def add(self, time_s: float, numbers: Iterable[float], place: int, other_s: float) -> None:
        """Add a message's fields in their order, at a place in the log and a time of another clock."""
        self._time_s.append(time_s)
        self._other_s.append(other_s)
        self._place.append(place)
        for values, number in zip(self.values.values(), numbers, strict=True):
            values.append(number)

    def extend(self, time_s: Array, values: Column | Mapping[str, Column], place: Column, other_s: Array) -> None:
        """Add messages by the arrays of their times and fields, (n,), which mean what they do in `add`."""
        self._time_s.frombytes(np.asarray(time_s, dtype=float).tobytes())
        self._other_s.frombytes(np.asarray(other_s, dtype=float).tobytes())
        self._place.frombytes(np.asarray(place, dtype=np.int64).tobytes())
        for name, kept in self.values.items():
            kept.frombytes(np.asarray(values[name], dtype=float).tobytes())

    def __contains__(self, field: str) -> bool:
        return field in self.values

    def __getitem__(self, field: str) -> Array:
        return np.array(self.values[field], dtype=float)

    def get(self, field: str, otherwise: float) -> Array:
        """A field, or where the messages do not have it the same number for all."""
        return self[field] if field in self else np.full(len(self._time_s), otherwise)

    @property
    def stamps(self) -> Stamps:
        """The times of its messages."""
        return Stamps(np.asarray(self._place), np.asarray(self._time_s), np.asarray(self._other_s))

    def restamp(self, time_s: Array) -> None:
        """Give its messages other times [s]."""
        self._time_s = time_s

    def series(self, field: str = "", values: Array | None = None) -> Series:
        """A field, or what follows from several, as a series."""
        found = self.unsorted(field, self[field] if values is None else values)
        return series(found.source, found.time_s, found.values)

    def unsorted(self, field: str, values: Array) -> Series:
        """What follows from a field, in the order in which the messages were added."""
        source = f"{self.source}.{field}" if field else self.source
        return Series(source, np.asarray(self._time_s) - self.before_s, values)


class LoggedFlight(dict[str, MessageColumns]):
    """A log's messages by the name of their sender."""

    def series(self, sender: str, field: str, factor: float = 1.0) -> Series | None:
        """A field times a factor; None: the log does not have it."""
        return self.combined(sender, (field,), lambda values: factor * values, field)

    def combined(self, sender: str, fields: Sequence[str], of: Callable[..., Array], name: str = "") -> Series | None:
        """What follows from several fields of a sender, under a name; None: the log does not have all of them."""
        found = self.get(sender)
        if found is None or not all(len(found.values.get(field, ())) for field in fields):
            return None
        return found.series(name, of(*(found[field] for field in fields)))

    def fixed(self, receiver: str, kind: str, altitude: str, factor: float = 1.0) -> Series | None:
        """An altitude where a receiver has a fixed RTK solution; None: it never has one."""

        def where_fixed(kinds: Array, altitudes: Array) -> Array:
            return np.where(kinds == RTK_FIXED, factor * altitudes, np.nan)

        found = self.combined(receiver, (kind, altitude), where_fixed, altitude)
        return found if found is not None and len(found.known()) else None


def make_continuous(senders: Iterable[MessageColumns]) -> tuple[ClockRun, ...]:
    """Put the times of all senders of a log on a clock that never steps; the runs between the steps."""
    senders = list(senders)
    times_s, runs = continuous([sender.stamps for sender in senders])
    for sender, time_s in zip(senders, times_s, strict=True):
        sender.restamp(time_s)
    return runs


@cache
def struct_layout(form: str, names: tuple[str, ...] = ()) -> np.dtype[Any]:
    """A little-endian format of `struct` as a layout of numpy, whose fields have these names, or ``f0``, ``f1`` ...

    Examples
    --------
    >>> struct_layout("<B2H16s", ("a", "b", "c"))
    dtype([('a', 'u1'), ('b', '<u2', (2,)), ('c', 'S16')])
    """
    kinds: list[Any] = []
    for count, letter in re.findall(r"(\d*)([a-zA-Z])", form):
        kind = f"<{letter}" if letter != "s" else f"S{count or 1}"
        kinds.append((kind, int(count)) if count and letter != "s" else kind)
    return np.dtype(list(zip(names or [f"f{index}" for index in range(len(kinds))], kinds, strict=True)))


def tilt_of_quaternion_deg(x: Array, y: Array) -> Array:
    """`tilt_deg` from a quaternion's second and third number: its cosine is the rotation matrix's last element.

    Examples
    --------
    >>> print(tilt_of_quaternion_deg(np.array([0.0, 0.6, 1e200]), np.array([0.0, 0.8, 0.0])))
    [  0. 180.  nan]
    """
    x, y = (np.where(np.abs(each) < LARGEST_IN_QUATERNION, each, np.nan) for each in (x, y))
    return angle_deg(1.0 - 2.0 * (x**2 + y**2))


def longest_m(maximum_m: Array) -> float:
    """The longest range that a log states [m]; infinite where it states none, as zero is none.

    Examples
    --------
    >>> longest_m(np.array([0.0, 7.0])), longest_m(np.array([0.0, np.nan, np.inf]))
    (7.0, inf)
    """
    known = maximum_m[np.isfinite(maximum_m) & (maximum_m > 0.0)]
    return float(known.max()) if known.size else np.inf


def rounded_cm(range_m: Array | float) -> Array:
    """Ranges in centimetres, to a hundredth of a millimetre, since logs keep 32-bit numbers."""
    return np.round(100.0 * np.asarray(range_m, dtype=float), 3)


def looks_down(orientation: Array) -> bool:
    """Whether MAVLink's orientations of a range finder's readings are downwards."""
    return int(np.median(orientation)) == DOWN


def magnitude(*axes: Array) -> Array:
    """Length of a vector of these components."""
    return np.sqrt(sum(axis**2 for axis in axes))


def make_ranger(
    name: str,
    ranges: Series,
    is_down: bool,
    maximum_m: Array,
    is_too_near: Flags,
    no_answer: Flags,
) -> Ranger:
    """A range finder whose log states its limits.

    Parameters
    ----------
    name, is_down
        As of `Ranger`.
    ranges
        What it read [m], in the order of the log; beyond the maximum is no echo.
    maximum_m
        Longest ranges that the log states, as of `longest_m`.
    is_too_near
        Which readings are nearer than its shortest one. Autopilots do not use them, and what a sensor reports there
        is another thing for each sensor, so they count as no answer.
    no_answer
        Which are no answer; where no maximum is stated, infinite ones are none either.
    """
    maximum_cm = float(rounded_cm(longest_m(maximum_m)))
    reading_cm = np.minimum(rounded_cm(ranges.values), maximum_cm)
    reading_cm[np.isposinf(reading_cm) | no_answer] = np.nan
    order = np.argsort(ranges.time_s, kind="stable")
    time_s, reading_cm, is_too_near = ranges.time_s[order], reading_cm[order], is_too_near[order]
    is_too_near = is_too_near & ~np.isnan(reading_cm)
    reading_cm[is_too_near] = np.nan
    found, near = (Series(ranges.source, time_s[rows], reading_cm[rows]) for rows in (slice(None), is_too_near))
    return Ranger(name, found, is_down, maximum_cm, near=near)
