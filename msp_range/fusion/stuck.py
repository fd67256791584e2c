"""A sensor that keeps answering the same while the vehicle moves.

Raw answers enter with how far the vehicle has climbed, by all sensors and by its barometer; the verdict leaves. A
constant answer alone says nothing: over calm ground a good sensor repeats itself too. That the ground comes or goes and
the answer does not is what no good sensor does. What `msp_range.fusion.response` finds to be fixed to the vehicle is
held here until the sensor reads something else.
"""

from collections import deque

from msp_range.fusion.vertical import Mark, VerticalMotion

STUCK_READINGS = 3
"""The same answer at least this many times in a row."""
REPEATED_READINGS = 5
"""With the same answer this many times in a row a sensor may be stuck: it is believed only where others agree."""
STUCK_M = 0.15
"""While the height over the ground has changed by this much by all sensors [m]: three times what a good sensor's noise
would hide."""
STUCK_ALONE_M, STUCK_SIGMAS = 0.5, 3.0
"""Or while the vehicle has climbed or sunk by this much [m], and so many standard deviations, by its barometer: then
all sensors may be stuck. A vehicle that follows a slope to a centimetre over that height looks the same; it answers
something else again within a reading or two."""
ANEW_READINGS, ANEW_M = 3, 0.05
"""A stuck sensor answers anew after so many other answers in a row, or with one that is nearer than this to the answer
that it kept [m], as a good one does with its noise. With fewer, one missed echo lets a sensor that is held at its
minimum give that for the ground again; more report for longer that a sensor is stuck that no longer is."""
FIXED_M = 0.08
"""What is fixed to the vehicle moves by less than this [m]: a strap or a sling in the wash of the rotors. Smaller lets
one that swings count as ground again, larger keeps the ground out for longer where it is about as near."""
MARK_EACH_S, MARKS = 2.0, 3
"""Its climb is taken from the first of the answers and from the last few seconds, in which the barometer has drifted
less: between marks [s], and how many are kept."""


class StuckWatch:
    """One sensor's answers."""

    def __init__(self) -> None:
        self._raw: int | None = None
        self._range_m: float | None = None
        self._times = 0
        self._others = 0
        self._since_m = 0.0
        self._marks: deque[tuple[float, Mark]] = deque(maxlen=MARKS)
        self._first: Mark | None = None
        self._stuck = False
        self._fixed_m: float | None = None

    def hold(self) -> None:
        """What the sensor sees now is fixed to the vehicle."""
        self._fixed_m, self._others = self._range_m, 0

    @property
    def is_fixed(self) -> bool:
        """Whether it sees something that is fixed to the vehicle."""
        return self._fixed_m is not None

    @property
    def repeated(self) -> bool:
        """Whether the newest answer is one of many alike."""
        return self._times >= REPEATED_READINGS and not self._others

    def update(
        self,
        raw: int,
        range_m: float | None,
        height_m: float | None,
        motion: VerticalMotion,
        time_s: float,
        at_minimum: bool = False,
    ) -> bool:
        """Whether the sensor is stuck, by its newest answer.

        Parameters
        ----------
        raw, range_m
            The answer as it came, and the range that it stands for, if any [m].
        height_m
            How high the vehicle is by all sensors [m]: over any level, without the steps of the ground. None: not
            known.
        motion, time_s
            How the vehicle moves by its barometer, and the time of the answer [s].
        at_minimum
            Whether the answer stands for this range or less: as on the ground, where a barometer shows gusts as climbs.
        """
        if self._fixed_m is not None and range_m is not None:
            self._others = 0 if abs(range_m - self._fixed_m) < FIXED_M else self._others + 1
            if self._others < ANEW_READINGS:
                return True
            self._fixed_m = None
        if raw != self._raw:
            self._others += 1
            if self._stuck and self._others < ANEW_READINGS and not self._is_near(range_m):
                return False
            self._raw, self._range_m, self._times, self._stuck = raw, range_m, 0, False
            self._marks.clear()
            self._first = None
        self._others = 0
        if self._times == 0 or height_m is None:
            self._since_m = height_m or 0.0
        if not self._marks or time_s - self._marks[-1][0] >= MARK_EACH_S:
            mark = motion.mark(time_s)
            if mark is not None:
                self._marks.append((time_s, mark))
                self._first = self._first or mark
        self._times += 1
        if self._times >= STUCK_READINGS and height_m is not None and abs(height_m - self._since_m) >= STUCK_M:
            self._stuck = True
        if self.repeated and not self._stuck and not at_minimum:
            climbs = [motion.climbed(mark, time_s) for mark in (self._first, *(mark for _, mark in self._marks))]
            self._stuck = any(
                abs(climb.height_m) >= max(STUCK_ALONE_M, STUCK_SIGMAS * climb.std_m) for climb in climbs if climb
            )
        return self._stuck

    def _is_near(self, range_m: float | None) -> bool:
        return range_m is not None and self._range_m is not None and abs(range_m - self._range_m) < ANEW_M
