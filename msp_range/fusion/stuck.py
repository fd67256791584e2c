"""A sensor that keeps answering the same while the vehicle moves.

Raw answers and how far the vehicle has climbed by all sensors enter; the verdict leaves. A constant answer alone says
nothing: over calm ground a good sensor repeats itself too. That the ground comes or goes and the answer does not is
what no good sensor does.
"""

STUCK_READINGS = 3
"""The same answer at least this many times in a row."""
REPEATED_READINGS = 5
"""With the same answer this many times in a row a sensor may be stuck: it is believed only where others agree."""
STUCK_M = 0.15
"""While the height over the ground has changed by this much [m]: three times what a good sensor's noise would hide."""


class StuckWatch:
    """One sensor's answers."""

    def __init__(self) -> None:
        self._raw: int | None = None
        self._times = 0
        self._since_m = 0.0
        self._stuck = False

    @property
    def repeated(self) -> bool:
        """Whether the newest answer is one of many alike."""
        return self._times >= REPEATED_READINGS

    def take(self, raw: int, climbed_m: float | None) -> bool:
        """Whether the sensor is stuck, by its newest answer.

        Parameters
        ----------
        raw
            The answer as it came.
        climbed_m
            How far the vehicle is above where it once was [m]: of any origin, without the steps of the ground. None:
            not known.
        """
        if raw != self._raw or climbed_m is None:
            self._raw, self._times, self._stuck = raw, 0, False
            if climbed_m is not None:
                self._since_m = climbed_m
        self._times += 1
        if self._times >= STUCK_READINGS and climbed_m is not None and abs(climbed_m - self._since_m) >= STUCK_M:
            self._stuck = True
        return self._stuck
