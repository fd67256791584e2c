"""What goes out, watched: silence of a stream, readings that disagree, and a deviation that is too small.

It is updated with every stream's messages and the use of every reading, and returns conditions, which
`msp_range.health.Health` reports when they change. A sensor's own faults are not here: this is what the autopilot gets
of it all.
"""

from collections import deque
from collections.abc import Collection, Iterable

from msp_range.health.finding import SensorFinding
from msp_range.pilot_texts import Condition, Text

FUSED = "the fused stream"
"""Its name here, which no sensor can have."""
DISAGREE_READINGS = 8
"""The share of readings that were not used is taken over so many, two turns of four sensors. Fewer report what two
outliers can do, more report later."""
DISAGREE_SHARE = 0.5
"""Where more than this share of the readings was not used, the readings disagree [share]; no echo agrees with silence.
At half of them one sensor of two, or two of four, are faulty and the others still agree."""
NOISY_FIT = 4.0
"""Mean square of the normalised innovations from which the readings are noisy: twice the deviation that their model
states. The variance that is sent grows with it already; this is where the pilot should know."""
LASTS_S, OVER_S = 1.0, 3.0
"""A condition is reported when it has lasted so long, and over when it has been gone so long [s]: a step of the ground
takes less than the first, and one that flickers is reported once."""


class _Lasting:
    """A condition that has to last, and to stay away."""

    active = False
    _changes_s: float | None = None

    def update(self, present: bool, now_s: float) -> bool:
        """Whether the condition counts now."""
        if present == self.active:
            self._changes_s = None
        elif self._changes_s is None:
            self._changes_s = now_s
        elif now_s - self._changes_s >= (LASTS_S if present else OVER_S):
            self.active, self._changes_s = present, None
        return self.active


class OutputWatch:
    """The streams of a vehicle, as an autopilot sees them.

    Parameters
    ----------
    streams
        Names of the streams that should always have something usable: `FUSED`, and sensors with one of their own.
    silence_s
        Nothing usable for longer than this is reported [s].
    start_s
        Now [s].
    """

    def __init__(self, streams: Iterable[str], silence_s: float, start_s: float) -> None:
        self._silence_s = silence_s
        # When each stream has been silent for too long, if it stays so.
        self._limits_s = dict.fromkeys(streams, start_s + silence_s)
        self._silent = {
            name: (Text.FUSED_SILENT if name == FUSED else Text.SILENT).of(sensor=name) for name in self._limits_s
        }
        self._used: deque[bool] = deque(maxlen=DISAGREE_READINGS)
        self._fit = 1.0
        self._disagree, self._noisy = _Lasting(), _Lasting()

    def on_usable(self, stream: str, now_s: float) -> None:
        """Note that a distance, or 'above the maximum', of a stream has gone out."""
        self._limits_s[stream] = now_s + self._silence_s

    def on_range(self, used: bool, fit: float) -> None:
        """Note whether a reading agrees with what is sent, and the mean square of the normalised innovations."""
        self._used.append(used)
        self._fit = fit

    def next_event_s(self, now_s: float) -> float:
        """When the next stream will have been silent for too long [s], if it stays so; infinity: all are by now."""
        return min([limit_s for limit_s in self._limits_s.values() if limit_s > now_s], default=float("inf"))

    def conditions(
        self, now_s: float, failing: Collection[str], finding: SensorFinding | None = None
    ) -> list[Condition]:
        """As they are now.

        Parameters
        ----------
        now_s
            Now [s].
        failing
            Sensors whose own faults are reported, and not their silence.
        finding
            What was found of a sensor last, the second source of 'noisy'.
        """
        found = []
        for name, limit_s in self._limits_s.items():
            silent = self._silent[name].when(now_s >= limit_s, sensor=name)
            found.append(silent._replace(is_reported=False) if name in failing else silent)
        rejected = self._used.count(False)
        disagree = len(self._used) == DISAGREE_READINGS and rejected > DISAGREE_SHARE * DISAGREE_READINGS
        found.append(Text.DISAGREE.when(self._disagree.update(disagree, now_s)))
        noisy = Text.NOISY.when(self._noisy.update(self._fit > NOISY_FIT, now_s))
        found.append(noisy if finding is None else noisy._replace(text=finding.text, remedy=finding.remedy))
        return found
