"""The first ground: readings that agree with each other, where no ground is known or the known one is lost.

Heights by single readings enter, a height with its rate leaves once enough of them lie on one line over time, or on the
climb of the vehicle by its barometer: the more of them, the more readings there are that do not.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from msp_range.fusion.vertical import Known, Mark, VerticalMotion
from msp_range.fusion.windows import Windows

AGREE_M = 0.15
"""Heights of one ground lie within this of a line over time [m]: by a slope between the sensors, and noise. Smaller
misses a start over a slope, larger takes outliers for ground."""
FASTEST_M_S, SURE_M_S = 5.0, 1.0
"""A vehicle climbs or sinks no faster than the first, where no barometer says how fast [m/s]. Up to the second two
readings are enough; a faster line goes through any two, so it takes a third one."""
READINGS, READINGS_ALONE, READINGS_IN_DOUBT = 2, 4, 4
"""Heights that have to agree: at least; of a sensor that alone gives ranges while others get no echo; and where other
readings of the last turn do not agree, or the sensors that do are half of those that work or fewer. Two outliers agree
often enough, four hardly ever."""
SURE_STD_M_S = 0.3
"""The barometer's rate is used once its standard deviation is below this [m/s]: in the second after its first value."""
CLIMB_SIGMAS = 3.0
"""A climb by the barometer is believed to this many standard deviations."""
READINGS_KEPT = 4
"""Heights of each sensor that are kept."""
REMEMBERED_M = 1.0
"""The ground that was known before explains a garbled reading while the vehicle is known to be within this of where it
was [m]."""


class Candidate(NamedTuple):
    """A height by one reading.

    Attributes
    ----------
    time_s, sensor
        When and whose.
    height_m, variance_m2
        Of the reference point over the ground that it shows [m], and the variance of its error [m^2].
    garbled_m
        Heights that the reading would stand for if its bytes had been garbled on the bus [m].
    mark
        Where the vehicle was by its barometer.
    """

    time_s: float
    sensor: str
    height_m: float
    variance_m2: float
    garbled_m: tuple[float, ...]
    mark: Mark | None


class Found(NamedTuple):
    """A first ground: the newest height, an earlier one that agrees, who sees it, and whether others do not."""

    newest: Candidate
    earlier: Candidate
    sensors: set[str]
    in_doubt: bool


class Start:
    """Collects heights until enough of them agree.

    Parameters
    ----------
    windows
        How long a height counts.
    motion
        How the vehicle moves by its barometer.
    """

    def __init__(self, windows: Windows, motion: VerticalMotion) -> None:
        self._windows = windows
        self._motion = motion
        self._heights: dict[str, deque[Candidate]] = {}
        self._known: Known | None = None

    def clear(self) -> None:
        """Forget all heights."""
        self._heights.clear()

    def on_ground_seen(self, known: Known) -> None:
        """Remember the ground, to distinguish its garbled forms from another one."""
        self._known = known

    def without(self, sensor: str) -> None:
        """The sensor's newest reading had no range: it has no say."""
        self._heights.pop(sensor, None)

    def add(self, newest: Candidate, working: int) -> Found | None:
        """Take a height; the first ground, once enough readings agree on it.

        A reading speaks for nothing, and against nothing, where it is the garbled form of another one's.

        Parameters
        ----------
        newest
            The height.
        working
            How many sensors are in order, whether they give ranges or get no echo.
        """
        self._heights.setdefault(newest.sensor, deque(maxlen=READINGS_KEPT)).append(newest)
        if self._known is not None:
            known = Candidate(self._known.time_s, "", self._known.height_m, 0.0, (), self._known.mark)
            if self._slack_m(known, newest) < REMEMBERED_M and self._is_garbled(newest, known):
                return None
        since_s = newest.time_s - self._windows.memory_s
        heights = [each for of in self._heights.values() for each in of if each.time_s >= since_s]
        best: Found | None = None
        for rate_m_s in self._rates(newest, heights):
            found = self._on_line(newest, heights, rate_m_s, working)
            if found is not None and (best is None or len(found.sensors) > len(best.sensors)):
                best = found
        return best

    def _rates(self, newest: Candidate, heights: Sequence[Candidate]) -> list[float | None]:
        """Rates of climb to try [m/s]: the barometer's, as None, or none and those to each earlier height."""
        measured = self._motion.rate(newest.time_s)
        if measured is not None and measured.variance < SURE_STD_M_S**2:
            return [None]
        rates: list[float | None] = [0.0]
        for each in heights:
            elapsed_s = newest.time_s - each.time_s
            if elapsed_s > 0.0 and abs(newest.height_m - each.height_m) <= FASTEST_M_S * elapsed_s:
                rates.append((newest.height_m - each.height_m) / elapsed_s)
        return rates

    def _on_line(
        self, newest: Candidate, heights: Sequence[Candidate], rate_m_s: float | None, working: int
    ) -> Found | None:
        agreeing = [each for each in heights if self._agrees(each, newest, rate_m_s)]
        since_s = newest.time_s - self._windows.fresh_s
        sensors = {each.sensor for each in agreeing}
        others = [each for each in heights if each.time_s >= since_s and each not in agreeing]
        garbled = [each for each in others if self._is_garbled(each, newest)]
        against = [each for each in others if each not in garbled]
        # More garbled answers than good ones may as well be good ones, and this one off by the value of a byte.
        outnumbered = len({each.sensor for each in garbled}) > len(sensors)
        if outnumbered or any(self._is_garbled(newest, each) for each in against):
            return None
        needed = READINGS
        if rate_m_s is not None and abs(rate_m_s) > SURE_M_S:
            needed += 1
        if len(sensors) == 1 and working > 1:
            needed = max(needed, READINGS_ALONE)
        if against or (len(sensors) > 1 and 2 * len(sensors) <= working):
            needed = max(needed, READINGS_IN_DOUBT)
        if len(agreeing) < needed or len(agreeing) <= 2 * len(against):
            return None
        return Found(newest, min(agreeing), sensors, bool(against))

    def _agrees(self, early: Candidate, late: Candidate, rate_m_s: float | None, late_m: float | None = None) -> bool:
        """Whether two heights are of one ground of a vehicle that climbs so, or as its barometer says."""
        height_m = late.height_m if late_m is None else late_m
        slack_m = AGREE_M
        if rate_m_s is None:
            climb = self._motion.climbed(early.mark, late.time_s)
            if climb is None:
                return False
            climbed_m, slack_m = climb.height_m, slack_m + CLIMB_SIGMAS * climb.std_m
        else:
            climbed_m = rate_m_s * (late.time_s - early.time_s)
        return abs(height_m - early.height_m - climbed_m) <= slack_m

    def _slack_m(self, early: Candidate, late: Candidate) -> float:
        """How far apart two heights of one ground may be [m]."""
        climb = self._motion.climbed(early.mark, late.time_s)
        if climb is None:
            return AGREE_M + FASTEST_M_S * (late.time_s - early.time_s)
        return AGREE_M + CLIMB_SIGMAS * climb.std_m

    def _is_garbled(self, doubted: Candidate, other: Candidate) -> bool:
        """Whether a reading is the garbled form of another one's, which may be earlier or later."""
        early, late = sorted((doubted, other))
        slack_m = self._slack_m(early, late)
        climb = self._motion.climbed(early.mark, late.time_s)
        climbed_m = 0.0 if climb is None else climb.height_m
        sign = 1.0 if late is doubted else -1.0
        return any(abs(garbled_m - other.height_m - sign * climbed_m) <= slack_m for garbled_m in doubted.garbled_m)
